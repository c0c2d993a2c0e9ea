"""Which verdict a search deserves: names only where they explain what is to be explained."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from scipy.stats import binom, norm

from omnislip.gap.inference import Fit, prior_penalty
from omnislip.gap.judge import (
    ALPHA,
    FRICTION_OVER_SLIP,
    SURE_GAIN,
    VARIES_SURELY,
    WITHIN_LAW,
    Trial,
    within_row,
)
from omnislip.gap.leftover import Leftover
from omnislip.gap.machine import CURVE, KEY_REACH
from omnislip.gap.metrics import LEAST_EXCESS, REPEATED, GapTable
from omnislip.gap.noise import LASTING_RATE_1_S
from omnislip.gap.predictable import BEAT_S, EQUATIONS, OWN_PASTS_S, Predictable
from omnislip.gap.search import Outcome
from omnislip.gap.selected import Selected

Array = npt.NDArray[np.float64]

STABLE = 0.9
"""Share of resamples of the runs in which a name has to hold."""
LEAST_REST = 80.0
"""Gain beyond chance that a leftover term must have at least: where nothing is missing, how
commands moved within rows leaves up to 60 in violent driving."""
IN_PLACES, IN_PLACES_SHARE = 300.0, 0.02
"""Gain, inflated as it may be, that chance did not give any refused effect where nothing is missing
(36 nulls: 216 once, of friction near rest, else 76 at most), and share of what is named: the square
of a seventh (beside 34 right names that close the gap 0.006 at most)."""
PREDICTED_SHARE, SENSOR_SHARE, CURRENT_SHARE = 0.15, 0.05, 0.15
_SHORT_S, _LONGER_S = (own[0] for own in OWN_PASTS_S[:2])
LASTING_SHARES = {
    _SHORT_S: float(np.exp(-2.0 * LASTING_RATE_1_S * _SHORT_S)),
    _LONGER_S: 1.5 * float(np.exp(-2.0 * LASTING_RATE_1_S * _LONGER_S)),
    BEAT_S: 0.15,
}
"""Share of the filter's disturbances that is predicted from what the robot did, and from their own
past. Where nothing is missing the first is below 0.1, beside right names too. The second is what
the slowest chance tells of itself 60 ms ahead (0.34): what fades within a tenth of a second gave
0.31 at most, of 10 Hz and more below 0.01; unknown effects that pass for chance and that nothing
else tells 0.39 to 0.9. And half as much again as that chance tells 120 ms ahead (0.17): there it
gave 0.11 at most, loads that swing 0.23 to 0.51. The third is what beats: chance tells 0.04 at most
of itself 0.3 s ahead, a load of 2.6 Hz 0.29. Innovations of a sensor are white: of 50 models
with nothing missing they told 0.01 of themselves at most, those of a supply that dips on its own
0.29, of a marker on a mast 0.33. Currents are read at an instant, whose command no log has: just
after a fast controller moved they told 0.07. More than half of the runs that hold disturbances
have to be helped, two or more: some hardly excite what is missing."""
VARIES = 1.0 / 3.0
"""Change of an effect's size from half second to half second, relative to itself, from which it is
not what is there, where that is no chance. What is nearest to unknown effects varied by 0.1 to 0.8,
and none of 37 was told by a change of less alone. Four of 50 right pairs varied by 0.19 to 0.26:
beside lost counts, by a wheel's zero, another law."""
UNSTEADY, UNSTEADY_LEAST = 0.1, 100.0
"""The same change, and what it leaves of the gain, from which the name carries a caution."""
NAMELESS, NAMELESS_GAIN = 1.1, 50.0
"""How much more a nameless term must explain than a name in its place, and by what gain beyond
chance: beside right names the best such term explains as much at most (1.0)."""
EXPLAINED, PROVEN = 0.9, 0.5
"""Share of the gap on held-out runs that effects must be able to close, where much of it is left to
judge by and where little is: in their intervals the names of 132 models closed 0.95 and more, those
of three robots that lack nothing but the friction curve 0.2 to 0.55."""
FAR_EXCESS = 24.0
"""The same from which no floor is an excuse: five floors off in RMSE, where nothing is missing 1.8
at most (150 nulls against repeated manoeuvres; the predictor's noise gives higher floors)."""
SURE = 3.0
"""Standard errors by which an excess has to stand out."""
FAINT_GAIN = 100.0
"""Gain beyond chance from which a change of the friction curve is no faint one: twice what a curve
gains that is 1.5 % of the way to another law."""
KEY_AT_END, KEYS_BY_CHANCE = 2.0 * float(norm.sf(KEY_REACH)), 1e-3
"""Chance that one believed key is two tolerances off; and that so many are, below which the model
is wrong in something else."""


def closes_nothing(selected: Sequence[Selected], table: GapTable) -> bool:
    """Whether names do not show on held-out runs, where little is left to be named.

    They surely close less than half of what is off there. Or nothing is off, which may be so with a
    weak effect that shows sample by sample; but then its name has to be stable, and no faint change
    of the friction curve: a law that is off by less than any is on a floor is a believed one. Where
    so little is off that runs which hardly excite an effect may be all that there is (a carpet's
    grain where no wheel slips), or so little more than in a run that the model explains (chance
    is larger there), what is sure elsewhere is named.
    """
    if much_is_left(table, selected):
        return False
    if table.closed.high is None:
        return all(one.stability < STABLE or _faint_curve(one) for one in selected)
    if all(_sure(one) for one in selected):
        gap, usual = table.closed.gap, table.left.usual
        return gap - usual >= LEAST_EXCESS and table.closed.high < PROVEN * (1.0 - usual / gap)
    return table.closed.high < PROVEN


def _sure(one: Selected) -> bool:
    return one.stability >= STABLE and one.evidence.beyond_chance > SURE_GAIN


def _faint_curve(one: Selected) -> bool:
    gain = one.evidence.beyond_chance
    return one.candidate.effect == CURVE and gain < min(FAINT_GAIN, one.law_gain)


def judge_outcome(
    outcome: Outcome, table: GapTable, mended: bool, shares: Sequence[Predictable], sudden: bool
) -> str:
    """Name effects only if they explain what is to be explained."""
    if missing_terms(outcome) or surely_refused(outcome) or much_is_left(table, outcome.selected):
        return "unknown_effect"
    if refused_in_places(outcome, table):
        return "unknown_effect"
    if sudden or any(no_chance(one) for one in shares) or varying(outcome.selected):
        return "unknown_effect"
    if too_many_keys(outcome) or better_without_name(outcome.selected) or outcome.law:
        return "unknown_effect"
    return "effect_found" if outcome.selected or mended else "no_gap"


def keys_told(fitted: Fit, believed: Array) -> dict[str, float]:
    """Return the believed keys that are `KEY_REACH` tolerances off or more, and by how many."""
    model = fitted.hypothesis
    moved = zip(model.base, prior_penalty(model, believed, model.x), strict=True)
    return {key.label: float(z) for key, z in moved if abs(z) > KEY_REACH - 1e-6}


def too_many_keys(outcome: Outcome) -> list[str]:
    """Return the believed keys that are far off: more than chance, where nothing is named.

    That takes five of thirteen; in 214 nulls three at most were there. They were pulled by what
    the model lacks, and the noise holds the rest of it.
    """
    if outcome.selected:
        return []
    told = list(keys_told(outcome.final, outcome.data.believed))
    chance = binom.sf(len(told) - 1, len(outcome.final.hypothesis.base), KEY_AT_END)
    return told if chance < KEYS_BY_CHANCE else []


def missing_terms(outcome: Outcome) -> list[Leftover]:
    """Return the terms that explain more than effects which are a bit off would leave."""
    least = max(LEAST_REST, outcome.data.feigned_gain)
    return [
        one
        for one in outcome.leftover
        if one.gain > one.covered and one.gain / one.inflation > least
    ]


def varying(selected: Sequence[Selected]) -> list[Selected]:
    """Return the effects whose size is not the same throughout the logs, where that leaves much.

    A size that varies by v leaves v^2 of its gain. What a weak effect leaves so is nothing beside
    stronger ones.
    """
    return _leaving(selected, VARIES, 0.0)


def unsteady(selected: Sequence[Selected]) -> list[Selected]:
    """Return the effects whose size changes more than chance makes it, as less than exact ones."""
    return _leaving(selected, UNSTEADY, UNSTEADY_LEAST)


def _leaving(selected: Sequence[Selected], share: float, least: float) -> list[Selected]:
    """Return the effects whose size varies by such a share of what is named, leaving the least.

    The friction curve, strong as it may be, covers nothing, and what any law of friction is off by
    is no news.
    """
    named = sum(one.evidence.gain for one in selected if one.candidate.effect != CURVE)
    return [
        one
        for one in selected
        if one.evidence.inflation > VARIES_SURELY
        and one.evidence.variation**2 * one.evidence.gain
        > max(share**2 * max(named, one.evidence.gain), one.law_gain, least)
    ]


def better_without_name(selected: Sequence[Selected]) -> list[Selected]:
    """Return the effects in whose place a nameless term explains surely more: the nearest names.

    A term is linear, an effect is fitted, and shapes of the same meaning gain alike.
    """
    return [
        one
        for one in selected
        if one.instead is not None
        and one.instead.gain > NAMELESS * one.evidence.gain
        and one.instead.gain - one.evidence.gain > NAMELESS_GAIN * one.evidence.inflation
    ]


def no_chance(found: Predictable) -> bool:
    """Whether what the filter takes for chance is predicted in most of the runs, two or more."""
    if found.equation not in EQUATIONS:
        least = CURRENT_SHARE if found.equation.endswith("current_a") else SENSOR_SHARE
    else:
        least = LASTING_SHARES[found.ahead_s] if found.from_own_past else PREDICTED_SHARE
    enough = found.runs_helped > max(found.runs / 2, 1)
    return found.share > least and enough


def surely_refused(outcome: Outcome) -> Trial | None:
    """Return what was refused last because it spoilt the other runs, if it is sure.

    A lag that no log can time may be another in each run: of when in a row its controller ticked.
    """
    return _surest(
        outcome,
        lambda trial: (
            trial.checked
            and trial.validation_gain <= 0
            and not within_row(outcome.data, trial.candidate, trial.values)
        ),
    )


def refused_in_places(outcome: Outcome, table: GapTable) -> Trial | None:
    """Return what was refused last because it explains much, but in few places; None if chance may.

    Something is there, then, that has none of the shapes that are known. What is named covers that
    where it surely closes half of the gap, or gains so much more that its own shape, a seventh off,
    leaves as much. What changes the friction over slip is no news, nor is a lag so short
    that commands which move within rows make it.
    """
    trials = _last_trials(outcome)
    if any(trial.accepted for trial in trials) or (table.closed.low or 0.0) > PROVEN:
        return None
    named = sum(s.evidence.gain for s in outcome.selected)
    trials = [t for t in trials if t.candidate.effect not in FRICTION_OVER_SLIP]
    checked = [
        trial
        for trial in trials
        if trial.checked
        and trial.chance >= ALPHA
        and not within_row(outcome.data, trial.candidate, trial.values)
    ]
    most = max(checked, key=lambda trial: trial.evidence.gain, default=None)
    least = max(IN_PLACES, outcome.data.feigned_gain, IN_PLACES_SHARE * named)
    return most if most and most.evidence.gain > least else None


def unchecked_words(outcome: Outcome) -> str | None:
    """Say what is sure, but seen where no other run can check it; None if nothing is."""
    trial = _surest(
        outcome,
        lambda one: not one.checked and one.chance < ALPHA and one.reason != WITHIN_LAW,
    )
    if trial is None:
        return None
    machine, candidate = outcome.data.machine, trial.candidate
    sizes = [
        f"{machine.file_parameter(p.label)} {trial.values[k]:.3g}"
        for k, p in enumerate(candidate.parameters)
        if k in candidate.amplitudes
    ]
    return (
        f"{candidate.name} ({', '.join(sizes)}) would explain what is missing, but too few runs "
        "show it to check that; drive more like those that do"
    )


def _surest(outcome: Outcome, refused: Callable[[Trial], bool]) -> Trial | None:
    """Return what gains most of what was refused so in the last step, if it is sure.

    It gains more, beyond chance, than a controller feigns and than all that is named.
    """
    named = sum(s.evidence.beyond_chance for s in outcome.selected)
    trials = [t for t in _last_trials(outcome) if not t.accepted and refused(t)]
    surest = max(trials, key=lambda trial: trial.evidence.beyond_chance, default=None)
    least = max(SURE_GAIN, outcome.data.feigned_gain, named)
    return surest if surest and surest.evidence.beyond_chance > least else None


def _last_trials(outcome: Outcome) -> list[Trial]:
    last = max((trial.step for trial in outcome.trials), default=0)
    return [trial for trial in outcome.trials if trial.step == last]


def much_is_left(table: GapTable, selected: Sequence[Selected]) -> bool:
    """Whether replays of held-out runs stay clearly above the floor.

    With effects: they surely close less than `EXPLAINED` of the gap, and what is left is more than
    in any run that was fitted and explained, and its own error (surely more, where only the
    friction over slip is named, which is never quite right). Without: against repeated manoeuvres,
    for the predictor's own noise takes a gap that nothing explains for chance. Far above in any
    case, if more than one window says so: a held-out run may hold what no fitted one does, and of
    what comes and goes the mean is as uncertain as it is large.
    """
    left, closed = table.left, table.closed
    if left.excess < LEAST_EXCESS:
        return False
    far, error = left.excess > FAR_EXCESS, left.standard_error
    if closed.high is not None:
        errors = (
            1.0 if any(s.candidate.effect not in FRICTION_OVER_SLIP for s in selected) else SURE
        )
        off = left.excess - left.usual >= errors * error
        return (far or off) and closed.high < EXPLAINED
    if left.excess >= SURE * error and table.floor_source == REPEATED:
        return True
    return far and error < np.inf
