"""Which effects are missing: forward search with full refits, then drop and swap.

Each step screens the whole catalogue with secants (one batch), refits the most promising
candidates fully, and takes the best one if all of these hold:

    chance       p-value of its gain, times the number of things tried, below `ALPHA`
    validation   on each run, by sizes that were fitted to the others, the gain is positive in sum,
                 and in 3 of 4 runs or beyond its scatter from run to run; free replays come nearer,
                 too (leave one out; the linear step that takes a run out of a fit is nearly exact).
                 A run of which the others tell too little does not judge
    shape        it gains more than the other effects leave if they are 3 % off in what they do
                 (`left_by_shapes`): no plant has an effect's shape exactly

The base keys are refitted with every candidate, because they absorb much of most effects. After a
step the noise is tuned again (an explained defect no longer counts as noise), and every accepted
effect must still be needed. At the end every effect is compared with its rivals in its place: one
that is likelier by the noise that fits it takes it. Those that do as well within `RIVAL_MARGIN`, or
within what a controller feigns, cannot be told from it with these logs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from omnislip.gap.ahead import FAR_SIZES, Ahead, Further
from omnislip.gap.inference import EQUAL, Data, Evidence, Fit, Hypothesis, check_unseen, fit, weigh
from omnislip.gap.judge import (
    DELAY,
    LEAST_PROMISE,
    MOST_EFFECTS,
    Trial,
    beside_short_delay,
    beside_turning,
    drop_needless,
    judge_candidate,
    no_more_than_chance,
)
from omnislip.gap.leftover import Leftover, Shape, find_leftover, one_law, responses
from omnislip.gap.limits import detection_limits
from omnislip.gap.machine import Candidate, Machine
from omnislip.gap.noise import Noise, RunawayError
from omnislip.gap.recordings import Run
from omnislip.gap.refit import extend_effects, refit_each, settle_placed, whole_numbers
from omnislip.gap.rivals import (
    NEARLY_AT_FIRST,
    RIVAL_MARGIN,
    RIVALS,
    Compared,
    curves_in,
    drop_wandering,
    swap_effects,
    take_likeliest,
    take_one_of_curve,
)
from omnislip.gap.screen import Screened, screen
from omnislip.gap.selected import Selected, select_effects
from omnislip.gap.settle import (
    Progress,
    believed_hypothesis,
    likelihood_judges,
    log_posterior,
    settle,
)
from omnislip.gap.side_by_side import side_by_side
from omnislip.gap.terms import dictionary

MOST_STEPS, MOST_VAIN_STEPS = 6, 2
"""The last: steps in turn whose effect is needless by the noise that is left beside it."""
REFITS, NEIGHBOURS = 12, 16
"""Of the candidates that promise most: those refitted, and those that may be rivals of the best."""
CONVERGED = 0.05
"""Share of a candidate's gain that refitting without it may find."""


@dataclass(frozen=True)
class Found:
    """What another search may go on from: a model, its noise, and how it came about."""

    model: Hypothesis
    noise: Noise
    neighbours: dict[str, list[Candidate]]
    """As `Outcome` has them."""
    trials: tuple[Trial, ...]
    mistaken: bool = False
    """Whether the runs were taken for those of another machine, or for others: then a name may be
    another's."""
    elsewhere: bool = False
    """Whether other logs were fitted."""


@dataclass(frozen=True)
class Outcome:
    """What the search found: the base fit, the final fit, every trial."""

    base: Fit
    final: Fit
    ladder: tuple[Fit, ...]
    """Refits: base, with the first effect, the first two, ..."""
    selected: tuple[Selected, ...]
    trials: tuple[Trial, ...]
    leftover: tuple[Leftover, ...]
    """What the final model leaves and no effect of the catalogue explains, strongest first."""
    data: Data
    neighbours: dict[str, list[Candidate]]
    """Of each effect that was chosen, what promised most then: what it may have been taken for."""

    @cached_property
    def law(self) -> Shape | None:
        """One term that explains what takes all the names."""
        return one_law(self.data, self.ladder)

    @cached_property
    def limits(self) -> dict[str, dict[str, float]]:
        """Limits of detection beside the base fit, by candidate and parameter of its file."""
        candidates = self.data.machine.candidates_for(self.data.runs)
        return detection_limits(self.data, self.base, screen(self.data, self.base, candidates))

    @property
    def widest(self) -> Hypothesis:
        """The final model with a patch in the floor as wide as the logs leave open."""
        model = self.final.hypothesis
        x = model.x.copy()
        for one in self.selected:
            first = model.own(model.place_of(one.candidate.name)).start
            for low, high in one.candidate.spans:
                x[first + low], x[first + high] = one.interval[low, 0], one.interval[high, 1]
        return replace(model, x=x)

    @property
    def found(self) -> Found:
        """What another search may go on from."""
        return Found(self.final.hypothesis, self.data.noise, self.neighbours, self.trials)

    def without_effects(self) -> "Outcome":
        """Return the outcome with the base fit as the final one."""
        return replace(self, final=self.base, ladder=self.ladder[:1], selected=())


class MistakenError(Exception):
    """A better model, that is `found`, shows that runs are those of another `machine`."""

    def __init__(self, found: Found, machine: Machine) -> None:
        super().__init__()
        self.found, self.machine = found, machine


def search(
    machine: Machine,
    runs: Sequence[Run],
    noise: Noise | None,
    progress: Progress,
    start: Hypothesis | None = None,
    other_machine: Callable[[Hypothesis, Noise], Machine | None] | None = None,
    before: Found | None = None,
) -> Outcome:
    """Find the missing effects on runs of two units or more.

    From a first `noise` and believed keys `start` that fit better than the file's, or none.
    `other_machine` is asked, by each better model and its noise, whether the runs are those of
    another; then MistakenError is raised. `before`: what was found when other pushes were cut out
    of the same logs or these were taken for another machine's, to go on from if all of that holds.
    """
    candidates = machine.candidates_for(runs)
    floor = {c.name: c for c in candidates if c.edges_m}
    tried = sum(len(candidate.starts) for candidate in candidates)
    progress("fitting the believed model")
    data, base = settle(machine, runs, start or believed_hypothesis(machine), noise)
    base_values = base.hypothesis
    current, trials = base, []
    settled, compared = base, dict[int, Compared]()
    looked_ahead = False
    curves = set[str]()
    neighbours: dict[str, list[Candidate]] = {}
    steps = vain = 0
    looked_for_loose = False
    again = _again(machine, runs, before, tried) if before else None
    if again is not None:
        progress("going on from what was found before")
        (data, current), neighbours = again, dict(before.neighbours)
        looked_for_loose = True
        looked_ahead = not (before.mistaken or before.elsewhere)
        settled = current
        if before.mistaken:
            current, compared = swap_effects(data, current, neighbours, progress, tried)
        curves = curves_in(current)
        taken = {effect.name for effect in current.hypothesis.effects}
        candidates = [c for c in candidates if c.name not in taken]
        steps = max(trial.step for trial in before.trials if trial.accepted)
        trials = [trial for trial in before.trials if trial.step <= steps]
    for step in range(steps + 1, MOST_STEPS + 1):
        if len(current.hypothesis.effects) == MOST_EFFECTS or vain == MOST_VAIN_STEPS:
            break
        progress(f"step {step}: screening {len(candidates)} effects")
        screened = screen(data, current, candidates)
        worth = [s for s in screened[:REFITS] if s.promise > LEAST_PROMISE]
        found = _try(data, current, worth, step, tried, progress)
        accepted = next((fitted for trial, fitted in found if trial.accepted), None)
        ahead = Ahead(data, current, candidates, step, tried, progress)
        # By the filter of a model without them some effects promise nothing.
        far = [ahead.far(c, accepted) for c in candidates if c.effect in (DELAY, *FAR_SIZES)]
        far.append(ahead.clipped(accepted))
        if accepted is None or not looked_for_loose:  # what is named instead hides them
            far.append(ahead.loose(accepted))
            looked_for_loose |= ahead.looked_for_loose
        further = max(filter(None, far), key=Further.gain, default=None)
        if further is not None:
            reason = f"explains less than {further.trial.candidate.name} far from none"
            found = [(_gives_way(trial, reason), one) for trial, one in found]
        elif accepted is None and not looked_ahead:
            further = ahead.best(found, worth) or ahead.by_another_law([one for one, _ in found])
        trials += [*(trial for trial, _ in found), *ahead.trials]
        if further is not None:
            data, current, accepted = further.data, further.without, further.fitted
        if accepted is None:
            break
        looked_ahead = False
        gain = current.objective - accepted.objective
        keys = accepted.hypothesis.x[: len(current.hypothesis.x)]
        without = fit(data, replace(current.hypothesis, x=keys), last=current.jacobian)
        if without.objective < current.objective - CONVERGED * max(1.0, gain):
            current = without  # the gain was that of the keys, which had not settled
            continue
        had = set(current.hypothesis.parameters)
        nearest = [s.candidate for s in screened[:NEIGHBOURS]]
        # What shows only beside the newest effect may be what an older one was taken for.
        neighbours = {
            name: own + [c for c in nearest if c not in own] for name, own in neighbours.items()
        }
        for fresh in accepted.hypothesis.effects[len(current.hypothesis.effects) :]:
            neighbours[fresh.name] = nearest
            candidates = [c for c in candidates if c.name != fresh.name]
        try:
            data, current = settle(
                machine, runs, accepted.hypothesis, data.noise, last=accepted.jacobian
            )
        except RunawayError:
            trials = [_lost(trial) if trial.step == step else trial for trial in trials]
            break
        other = other_machine(current.hypothesis, data.noise) if other_machine else None
        if other:
            found_so_far = Found(current.hypothesis, data.noise, neighbours, tuple(trials), True)
            raise MistakenError(found_so_far, other)
        settled = current
        data, current = settle_placed(data, extend_effects(machine, data, current))
        current = drop_needless(data, current, tried)
        chosen = current.hypothesis.effects
        asked_again = tried if _more_refused(found) else 0
        current, compared = swap_effects(data, current, neighbours, progress, asked_again)
        if curves_in(current) != curves:  # else they have been compared
            data, current = take_one_of_curve(data, current, neighbours, progress)
            curves = curves_in(current)
        taken = {effect.name for effect in current.hypothesis.effects}
        candidates = [floor.get(c.name, c) for c in (*candidates, *chosen) if c.name not in taken]
        vain = vain + 1 if set(current.hypothesis.parameters) == had else 0
    final = current
    if current is not settled:
        progress("fitting the final model")
        data, final = settle(machine, runs, current.hypothesis, data.noise, last=current.jacobian)
        data, final = settle_placed(data, extend_effects(machine, data, final))
        final = drop_needless(data, final, tried)
    final = whole_numbers(data, final)
    known = compared if final is settled else None
    data, final, compared = take_likeliest(data, final, neighbours, tried, progress, known)
    final, compared = drop_wandering(data, final, neighbours, progress, compared)
    progress("looking for what no effect explains")
    free = responses(data, final, dictionary(machine))
    leftover = find_leftover(data, final, free)
    for beside in (beside_short_delay, beside_turning):
        freer = beside(data, final) if leftover else final
        if freer is not final:
            leftover = find_leftover(data, freer, responses(data, freer, dictionary(machine)))
    ladder = _ladder(data, base_values, final)
    selected = select_effects(data, final, free, compared)
    return Outcome(
        ladder[0],
        final,
        ladder,
        selected,
        tuple(trials),
        tuple(leftover),
        data,
        neighbours,
    )


def _again(
    machine: Machine, runs: Sequence[Run], before: Found, tried: int
) -> tuple[Data, Fit] | None:
    """Settle a model that was found before; None if it has no effects, or not all of them hold."""
    if not before.model.effects:
        return None
    try:
        data, settled = settle(machine, runs, before.model, before.noise)
    except RunawayError:
        return None
    holds = drop_needless(data, settled, tried) is settled
    return (data, settled) if holds else None


def _ladder(data: Data, base: Hypothesis, final: Fit) -> tuple[Fit, ...]:
    """Add the effects of the final model one by one, in the order in which they were found."""
    rungs = [fit(data, base)]
    hypothesis = final.hypothesis
    for index, effect in enumerate(hypothesis.effects[:-1]):
        start = rungs[-1].hypothesis.with_effect(effect, hypothesis.values_of(index))
        rungs.append(fit(data, start, last=final.jacobian[:, : len(start.x)]))
    return (*rungs, final) if hypothesis.effects else tuple(rungs)


def _try(
    data: Data,
    current: Fit,
    screened: Sequence[Screened],
    step: int,
    tried: int,
    progress: Progress,
) -> list[tuple[Trial, Fit]]:
    """Refit each candidate and judge it; best first."""
    if not screened:
        return []
    progress(f"step {step}: trying " + ", ".join(s.candidate.name for s in screened))
    results = []
    index = len(current.hypothesis.effects)
    for one, fitted in zip(screened, refit_each(data, current, screened), strict=True):
        results.append((one.candidate, fitted, weigh(data, current, fitted, index)))
    results = _simplest_first(results)
    checks = check_unseen(data, current, [fitted for _, fitted, _ in results])
    judged, most = [], np.inf
    for (candidate, fitted, evidence), check in zip(results, checks, strict=True):
        nearly = fitted.objective < most  # else the best that passes decides without replays
        trial = judge_candidate(
            data, current, fitted, candidate, evidence, check, step, tried, nearly
        )
        judged.append((trial, fitted))
        if trial.accepted and most == np.inf:
            most = _nearly_as_good(trial, fitted)
    passed = [pair for pair in judged if pair[0].accepted]
    if not passed:
        return judged
    best, taken = passed[0][0], _taken(data, passed, progress)
    name, own = taken.candidate.name, "each by the noise that fits it"
    found = []
    for trial, fitted in judged:
        if trial is taken:
            reason = f"explains nearly as much as {best.candidate.name} and is likelier, {own}"
            told = trial if taken is best else replace(trial, reason=reason)
        elif trial is best:
            told = _gives_way(trial, f"is less likely than {name}, {own}")
        else:
            told = _gives_way(trial, f"explains less than {name}")
        found.append((told, fitted))
    return found


def _more_refused(found: Sequence[tuple[Trial, Fit]]) -> bool:
    """Whether one that explained more than what was taken was refused."""
    taken = [trial.evidence.gain for trial, _ in found if trial.accepted]
    return any(trial.evidence.gain > max(taken, default=np.inf) for trial, _ in found)


def _gives_way(trial: Trial, reason: str) -> Trial:
    return replace(trial, accepted=False, reason=reason) if trial.accepted else trial


def _taken(data: Data, passed: Sequence[tuple[Trial, Fit]], progress: Progress) -> Trial:
    """Return what explains most of the candidates that pass, or as much nearly and is likelier.

    With no more parameters, and each by the noise that fits it: that of a model which lacks both is
    large, and to it they differ little. Beside a torque constant 10 % too large, wheels 6 % too
    large explained 0.5 % less than a scale of the encoders, and were likelier by exp(238).
    """
    (best, fitted), *others = passed
    most = _nearly_as_good(best, fitted)
    near = [
        (trial, one)
        for trial, one in others
        if one.objective < most and len(trial.values) <= len(best.values)
    ][:RIVALS]
    if not near or not likelihood_judges(data):
        return best
    names = ", ".join(trial.candidate.name for trial, _ in near)
    progress(f"comparing {best.candidate.name} and {names}, each by its own noise")
    own, *theirs = side_by_side(lambda pair: _own_likelihood(data, pair[1]), [passed[0], *near])
    likeliest = int(np.argmax(theirs))
    enough = own + 0.5 * RIVAL_MARGIN * best.evidence.inflation
    return near[likeliest][0] if theirs[likeliest] > enough else best


def _nearly_as_good(best: Trial, fitted: Fit) -> float:
    """Return Q below which another explains nearly as much as the best, whose fit is given."""
    evidence = best.evidence
    return fitted.objective + max(
        RIVAL_MARGIN * evidence.inflation, NEARLY_AT_FIRST * evidence.gain
    )


def _own_likelihood(data: Data, fitted: Fit) -> float:
    """Return the log posterior of a model by the noise that fits it."""
    try:
        own = settle(data.machine, data.runs, fitted.hypothesis, data.noise, last=fitted.jacobian)
    except RunawayError:
        return -np.inf
    return log_posterior(*own)


def _lost(trial: Trial) -> Trial:
    """What was accepted along the filter of another model is refused: its own loses the robot."""
    if not trial.accepted:
        return trial
    return replace(trial, accepted=False, reason="the robot does not follow it")


def _simplest_first(
    results: list[tuple[Candidate, Fit, Evidence]],
) -> list[tuple[Candidate, Fit, Evidence]]:
    """Sort by gain; a candidate with fewer parameters wins where the others gain nothing on it.

    Of those that are the same to these data, a radius and the scale of its encoder in an odometry,
    the catalogue's first wins and rounding decides nothing. The gain of each additional parameter
    has to exceed what chance gives one in a thousand.
    """
    if not results:
        return []
    results = _equals_in_order(results)
    best = results[0]
    for rival in results[1:]:
        spared = len(best[0].parameters) - len(rival[0].parameters)
        lost = best[2].gain - rival[2].gain
        if spared > 0 and no_more_than_chance(lost, best[2].inflation, spared):
            best = rival
    return [best, *(r for r in results if r is not best)]


def _equals_in_order(
    results: Sequence[tuple[Candidate, Fit, Evidence]],
) -> list[tuple[Candidate, Fit, Evidence]]:
    """Sort by gain; of equal gains the fewer parameters first, then the catalogue's order.

    Also behind the first: it may be refused, and the next one is taken.
    """
    left = sorted(results, key=lambda r: -r[2].gain)
    ordered = []
    while left:
        equals = [r for r in left if left[0][2].gain - r[2].gain < EQUAL]
        ordered += sorted(equals, key=lambda r: (len(r[0].parameters), r[0].places))
        left = left[len(equals) :]
    return ordered
