"""Whether a candidate is taken, or stays: the tests of chance, of other runs, and of shapes."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip.gap.answers import FEIGNED_GAIN
from omnislip.gap.inference import (
    VISIBLE_GAIN,
    Check,
    Data,
    Evidence,
    Fit,
    Hypothesis,
    fit,
    fit_more,
    fitted_without_each_unit,
    left_by_shapes,
    most_along,
    spread_over_runs,
    weigh,
)
from omnislip.gap.machine import CURVE, LESS_GRIP, Candidate
from omnislip.gap.metrics import improvement, replay_all
from omnislip.gap.noise import RunawayError
from omnislip.gap.screen import neutral_sizes
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]

ALPHA = 0.01
SHAPE_SHARE = 1e-3
"""Square of how far a plant may be off an effect's shape: 3 % of what the effect does. And off the
law of its friction over slip: of seven families, the keys of another one fitted to them, 0.4 to
2.1 % was left to an effect that changes it."""
MOST_EFFECTS = 4
LEAST_PROMISE = 8.0
"""Promised gain below which no refit could bring a candidate past the threshold of chance."""
SHORTEST_LAG_ROWS = 0.125
"""A command that jumps at a share p of a row is p (1 - p) / 2 rows behind what its mean says."""
SURE_GAIN = 200.0
"""Gain beyond chance that no chance gives: something is there, though perhaps not alone or not
under this name."""
REPLAYS_ALIKE = 0.1
"""Mean square in noise floors of what is between two replays below which they judge no effect."""
AHEAD_GAIN = 50.0
"""Gain beyond chance, twice what chance reaches over everything tried, from which a refused effect
is worth looking one step ahead, and none is needless: another one that is missing blurs it."""
CURVES = ("low_grip", "slip_stiffness_error", "grip_falloff")
"""What changes the friction over slip: where its curve is not the believed one, two of these can
stand for one of them beside another curve."""
FRICTION_OVER_SLIP = (CURVE, *CURVES)
LAW_ENTERS = (*FRICTION_OVER_SLIP, "bristle_relaxation")
"""Also what takes a part of what friction is off its law: bristles hold what friction allows."""
TOO_SHORT = "shorter than the log can time: an eighth of a row"
LITTLE_CURVED = 0.1
"""Share of every other law to start a free curve from."""
BENT_SHARE, BEYOND_SHARE = 1.0 / 9.0, 0.02
"""Of what friction leaves that is 3 % off its law: what 1 % leaves. And of an effect's gain: what a
curve may explain besides where the effect is no law's, by its numbers alone."""
WITHIN_LAW = "no more than friction is off its law on any floor"
DELAY = "actuation_delay"
DRIFTS, LEAST_BEYOND_DRIFT = ("gyro_bias",), 3.0
"""Sizes that are no robot's: every gyro's zero wanders by some 1e-4 rad/s, from run to run by more
than its noise tells. One is missing that is so many times as large as it wanders."""
LAGS = (DELAY, "driver_lag", "armature_inductance")
TURNING = ("inertia_error", "wheel_distance_error", "yaw_scrub")
"""What shows only where a robot is turned. Where nothing but disturbances does that, and a
controller answers them, all of it is what the model of the disturbances is off by: in a robot that
went to and fro its inertia gained 270, at two and a half times of what it was."""
VARIES_SURELY = 3.0
"""Inflation, 1 for white residuals, from which a size that changes does so by more than chance."""
WEAK, WANDERS = 0.01, 0.5
"""Share of what is named that a weak effect explains; change of its size from half second to half
second, relative to itself, from which it is none. Of 379 names none that was right varied by more
than 0.34; two false ones that were this weak by 0.85 and 0.87."""


@dataclass(frozen=True)
class Trial:
    """A candidate as it was tried in one step, and why it was taken or not.

    `chance` bounds the probability that anything of all that is tried gains as much by chance.
    """

    step: int
    candidate: Candidate
    values: Array
    evidence: Evidence
    chance: float
    validation_gain: float
    checked: bool
    """Whether runs could judge it by what fits the others."""
    reason: str
    accepted: bool


def judge_candidate(
    data: Data,
    without: Fit,
    fitted: Fit,
    candidate: Candidate,
    evidence: Evidence,
    check: Check,
    step: int,
    tried: int,
    replays: bool = True,
) -> Trial:
    """Judge the last effect of a model against the model `without` it; by `replays` or not."""
    index = len(without.hypothesis.effects)
    values = fitted.hypothesis.values_of(index)
    absent = neutral_sizes(data, without.hypothesis, candidate)
    chance = min(1.0, evidence.p_value * tried)
    reason, passed = _verdict(evidence, chance, check, _feigned_gain(data, candidate))
    if passed and _left_by_shapes(data, without, fitted, index, evidence):
        off = 100 * SHAPE_SHARE**0.5
        reason = f"real perhaps, but effects found would leave as much if {off:.0f} % off in shape"
        passed = False
    if passed and within_law(data, without, fitted, index):
        reason, passed = WITHIN_LAW, False
    if passed and not differs_from_none(candidate, values - absent, evidence):
        reason, passed = "its size cannot be told from none beside the other parameters", False
    sure = evidence.beyond_chance > SURE_GAIN
    if passed and replays and not _replays_better(data, without, fitted, check, sure):
        reason, passed = "helps the predictor but not replays of runs that were not fitted", False
    if passed and within_row(data, candidate, values):
        reason, passed = TOO_SHORT, False
    if passed and drifts(data, fitted, index):
        reason, passed = "wanders from run to run by more than a third of itself", False
    if passed and _short_delay_does(data, without, fitted, evidence, tried):
        reason, passed = "so does a delay that is shorter than the log can time", False
    return Trial(
        step, candidate, values, evidence, chance, check.gain, check.voters.any(), reason, passed
    )


def both_pass(data: Data, without: Fit, both: Fit, check: Check, tried: int) -> bool:
    """Whether two effects together help runs that were not fitted, and none of them is chance."""
    if not check.helps:
        return False
    count, sure = len(without.hypothesis.effects), True
    for index in (count, count + 1):
        effect, sizes = both.hypothesis.effects[index], both.hypothesis.values_of(index)
        rest = both.refitted_without(data, index)
        evidence = weigh(data, rest, both, index)
        if evidence.p_value * tried >= ALPHA:
            return False
        if evidence.beyond_chance < _feigned_gain(data, effect):
            return False
        if _left_by_shapes(data, rest, both, index, evidence):
            return False
        if within_law(data, rest, both, index):
            return False
        away = sizes - neutral_sizes(data, rest.hypothesis, effect)
        if not differs_from_none(effect, away, evidence) or within_row(data, effect, sizes):
            return False
        if drifts(data, both, index):
            return False
        sure = sure and evidence.beyond_chance > SURE_GAIN
    return _replays_better(data, without, both, check, sure)


def no_more_than_chance(gain: float, inflation: float, parameters: int) -> bool:
    """Whether so many parameters that explain nothing gain as much one time in a thousand."""
    return gain / inflation < chi2.isf(1e-3, parameters)


def _replays_better(data: Data, without: Fit, with_effect: Fit, check: Check, sure: bool) -> bool:
    """Whether free replays of runs come nearer to the logs, by sizes fitted without their units.

    Of runs about which the others tell enough (`check`).

    What helps the predictor only, row by row, describes chance and not the robot. But what comes
    and goes with the turns of a shaft hardly moves a replay: there a `sure` gain decides.
    """
    sets = [fitted_without_each_unit(data, one) for one in (without, with_effect)]
    replays = []
    for unit in np.flatnonzero(check.judges):
        runs = [data.runs[k] for k in np.flatnonzero(data.units == unit)]
        try:
            replays += replay_all(data.machine, runs, data.noise, [one[unit] for one in sets])
        except RunawayError:
            return False
    if any(np.any(np.isfinite(r.errors[0]) & ~np.isfinite(r.errors[1])) for r in replays):
        return False  # it runs away
    fall, between = improvement(replays)
    return fall > 0 or (sure and between < REPLAYS_ALIKE)


def _feigned_gain(data: Data, effect: Candidate) -> float:
    """Return the gain beyond chance that a controller's answers feign of an effect.

    The friction curve does no harm where it is named in vain, but others where it is missing.
    """
    if effect.effect in TURNING and not data.driven[2]:
        return np.inf
    return min(data.feigned_gain, FEIGNED_GAIN) if effect.effect == CURVE else data.feigned_gain


def _verdict(
    evidence: Evidence, chance: float, check: Check, feigned_gain: float
) -> tuple[str, bool]:
    if chance >= ALPHA:
        return f"could be chance (p = {chance:.2g} over everything tried)", False
    if evidence.beyond_chance < feigned_gain:
        return "a controller's answers feign as much", False
    voters = int(np.sum(check.voters))
    if not voters:
        return "is seen in no run that the others could check", False
    if check.gain <= 0:
        return "makes runs worse that were not fitted", False
    if not check.helps:
        return f"helps only {check.helped} of {voters} runs that were not fitted", False
    return "explains more than any other effect", True


def left_by_others(data: Data, without: Fit, fitted: Fit, index: int) -> float:
    """Gain of effect `index` that the others would leave if off by all that they do.

    Of what repeats with an angle, or goes with a place or direction in the world, the shape of an
    effect knows nothing that does not.
    """
    catalogue = data.machine.catalogue

    def goes_with(effect: Candidate) -> set[str]:
        return set(catalogue[effect.effect]["goes_with"])

    own = fitted.hypothesis.effects[index]
    change = without.residual - fitted.residual
    return left_by_shapes(
        data,
        fitted,
        change,
        without.residual,
        lambda effect: 0.0 if effect is own else 1.0,
        lambda effect: bool(goes_with(own) - goes_with(effect)),
    )


def _left_by_shapes(data: Data, without: Fit, fitted: Fit, index: int, evidence: Evidence) -> bool:
    """Whether the others would leave as much as effect `index` gains if a bit off in shape.

    Of a name's gain only what is beyond chance counts, of the friction curve's all: named in vain
    it does no harm, but what it leaves beside a strong effect passes for an unknown one.
    """
    curve = fitted.hypothesis.effects[index].effect == CURVE
    gain = evidence.gain if curve else evidence.beyond_chance
    return gain < SHAPE_SHARE * left_by_others(data, without, fitted, index)


def within_law(data: Data, without: Fit, fitted: Fit, index: int) -> bool:
    """Whether effect `index` changes the friction over slip by no more than any law is off.

    As `left_by_shapes` has it, for what friction does as a whole: all of it, for it is proportional
    to the grip. Not where no law that the curve can take explains as much in the effect's place:
    surely less, or nothing besides, though it can bend as the effect cannot. (Of some thirty such
    effects where the law was another the curve explained 6 to 1,300 % of their gain besides; in
    the place of four that were there, less than they.) Nothing besides tells only from a third of
    what laws are off by on: no curve has the bends of all of them.
    """
    if fitted.hypothesis.effects[index].effect not in CURVES:
        return False
    gain, by_law = without.objective - fitted.objective, left_by_law(data, without, fitted)
    if gain > by_law:
        return False
    beyond = fitted.objective - _any_law(data, without).objective
    if gain > BENT_SHARE * by_law and beyond < BEYOND_SHARE * gain:
        return False
    return beyond > -SURE_GAIN


def fit_other_law(data: Data, model: Hypothesis) -> Fit:
    """Fit a model without the friction curve with the best of the laws that this may become.

    From a law towards tanh, in which direction the curve is screened, may lie nothing of another.
    """
    [curve] = [c for c in data.machine.candidates() if c.effect == CURVE]
    laws = [
        model.with_effect(curve, [LITTLE_CURVED])
        .with_effect(refinement, [LITTLE_CURVED])
        .last_two_joined()
        for refinement in data.machine.refinements(curve)
    ]
    return min(side_by_side(lambda law: fit(data, law), laws), key=lambda one: one.objective)


def _any_law(data: Data, without: Fit) -> Fit:
    """Fit the friction curve with all that refines it in a model, from what of it is there."""
    refined = without.hypothesis
    if CURVE in {effect.effect for effect in refined.effects}:
        refined = refined.moved_last(refined.place_of(CURVE))
    else:
        [curve] = [c for c in data.machine.candidates() if c.effect == CURVE]
        refined = refined.with_effect(curve, [LITTLE_CURVED])
    for refinement in data.machine.refinements(refined.effects[-1]):
        refined = refined.with_effect(refinement, [LITTLE_CURVED]).last_two_joined()
    return fit(data, refined)


def left_by_law(data: Data, without: Fit, fitted: Fit) -> float:
    """Return the gain of `fitted` that friction over slip leaves if off its law as on any floor."""
    less = data.machine.with_less_grip(fitted.hypothesis.flat(data.believed))
    [slipping] = data.residuals(less[None])
    friction = (slipping - fitted.residual)[None] / LESS_GRIP
    [most] = most_along(friction, without.residual - fitted.residual)
    return SHAPE_SHARE * float(most)


def drifts(data: Data, fitted: Fit, index: int) -> bool:
    """Whether a sensor's offset wanders from run to run by more than a third of what it is."""
    if fitted.hypothesis.effects[index].effect not in DRIFTS:
        return False
    [size] = fitted.hypothesis.values_of(index)
    return bool(abs(size) < LEAST_BEYOND_DRIFT * spread_over_runs(data, fitted, index))


def within_row(data: Data, candidate: Candidate, sizes: Array) -> bool:
    """Whether a lag is so short that it may be the averaging of the command over a row."""
    return candidate.effect in LAGS and bool(sizes[0] < shortest_lag(data, candidate.effect))


def shortest_lag(data: Data, effect: str) -> float:
    """Return the size from which on a lag is longer than what averaging over a row does; else 0."""
    if effect not in LAGS:
        return 0.0
    shortest_s = SHORTEST_LAG_ROWS * min(run.row_s for run in data.runs)
    if effect != "armature_inductance":
        return shortest_s
    return shortest_s * float(data.machine.model.values.get("motor.resistance_ohm", 1.0))


def beside_short_delay(data: Data, fitted: Fit, least: float = 0.0) -> Fit:
    """Return the model with a delay so short that no log can time it, if that gains over `least`.

    A controller that ticks within rows leaves it: the mean of a row is of two commands, the later
    one behind. It is no effect to be named, and what it explains is none either, known or unknown.
    """
    delays = [c for c in data.machine.candidates() if c.effect == DELAY]
    if not delays or any(effect.effect in LAGS for effect in fitted.hypothesis.effects):
        return fitted
    [delay], longest_s = delays, shortest_lag(data, DELAY)
    [seconds] = delay.parameters
    short = replace(delay, parameters=(replace(seconds, high=longest_s),))
    [later] = fit_more(data, fitted, [fitted.hypothesis.with_effect(short, [0.5 * longest_s])])
    if fitted.objective - later.objective <= least:
        return fitted
    return fit(data, later.hypothesis, last=later.jacobian)


def beside_turning(data: Data, fitted: Fit) -> Fit:
    """Return the model with any inertia where nothing but disturbances turns the robot (TURNING).

    What that explains is no effect to be named, and what else explains it is none either.
    """
    if data.driven[2] or any(effect.effect in TURNING for effect in fitted.hypothesis.effects):
        return fitted
    inertia = next(c for c in data.machine.candidates() if c.effect == TURNING[0])
    return fit(data, fitted.hypothesis.with_effect(inertia, [inertia.parameters[0].scale]))


def _short_delay_does(
    data: Data, without: Fit, fitted: Fit, evidence: Evidence, tried: int
) -> bool:
    """Whether a delay that no log can time shows, and the last effect explains no more beside it.

    Not whether either does as well: commands that act a tenth of a row late may hide what a carpet
    does as well as feign an inductance.
    """
    timed = beside_short_delay(data, without, VISIBLE_GAIN * evidence.inflation)
    if timed is without:
        return False
    both = beside_short_delay(data, fitted)
    beside = weigh(data, timed, both, len(without.hypothesis.effects))
    if beside.p_value * tried >= ALPHA:
        return True
    return beside.beyond_chance < max(VISIBLE_GAIN, data.feigned_gain)


def differs_from_none(candidate: Candidate, sizes: Array, evidence: Evidence) -> bool:
    """Whether any size is two standard deviations from none, all other parameters left free."""
    deviations = np.sqrt(np.maximum(np.diag(evidence.covariance), 0.0))
    return any(
        not np.isfinite(sizes[i]) or abs(sizes[i]) > 2.0 * deviations[i]
        for i in candidate.amplitudes
    )


def drop_needless(data: Data, fitted: Fit, tried: int) -> Fit:
    """Drop effects, weakest first, that could be chance beside the others or what those leave.

    Not those whose inflation alone, of a few blocks, makes the chance: another effect that is
    missing does that.
    """
    while fitted.hypothesis.effects:
        without = side_by_side(
            lambda index, whole=fitted: whole.refitted_without(data, index),
            range(len(fitted.hypothesis.effects)),
        )
        judged = [weigh(data, w, fitted, index) for index, w in enumerate(without)]
        needless = [
            index
            for index, one in enumerate(judged)
            if (one.p_value * tried >= ALPHA and one.beyond_chance < AHEAD_GAIN)
            or one.beyond_chance < _feigned_gain(data, fitted.hypothesis.effects[index])
            or _left_by_shapes(data, without[index], fitted, index, one)
            or within_law(data, without[index], fitted, index)
            or drifts(data, fitted, index)
        ]
        if not needless:
            break
        fitted = without[min(needless, key=lambda index: judged[index].gain)]
    return fitted
