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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip.gap.inference import (
    Check,
    Data,
    Evidence,
    Fit,
    Hypothesis,
    at_bound,
    check_unseen,
    costs_refitted,
    fit,
    fit_more,
    fitted_without_each_unit,
    free_of_fitted,
    inflation_of,
    left_by_shapes,
    most_along,
    prior_penalty,
    solve_within,
    weigh,
)
from omnislip.gap.leftover import (
    Leftover,
    Shape,
    find_leftover,
    responses,
    shapes_instead,
)
from omnislip.gap.machine import CURVE, LESS_GRIP, PHASE, WHOLE, Candidate, Machine
from omnislip.gap.metrics import improvement, replay_all
from omnislip.gap.noise import (
    Noise,
    RunawayError,
    some_runs,
    track_all,
    tune_noise,
    tuned_likelihood,
)
from omnislip.gap.recordings import Run
from omnislip.gap.side_by_side import side_by_side
from omnislip.gap.terms import dictionary

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]

ALPHA = 0.01
SHAPE_SHARE = 1e-3
"""Square of how far a plant may be off an effect's shape: 3 % of what the effect does. And off the
law of its friction over slip: of seven families, the keys of another one fitted to them, 0.4 to
2.1 % was left to an effect that changes it."""
MOST_EFFECTS, MOST_STEPS, MOST_VAIN_STEPS = 4, 6, 2
"""The last: steps in turn whose effect is needless by the noise that is left beside it."""
NEIGHBOURS, RIVALS = 16, 4
REFITS = 12
FULL_REFITS = 3
NEAR, NEAR_TO_FULL = 0.7, 0.5
"""Share of the best quick fit's gain, and of the gain that is asked of a full one, that a quick fit
must reach to be fitted fully."""
VISIBLE_GAIN = 25.0
LEAST_PROMISE = 8.0
"""Promised gain below which no refit could bring a candidate past the threshold of chance."""
RIVAL_MARGIN, NEARLY = 10.0, 0.01
"""Gain beyond chance within which rivals cannot be told apart; and share of an effect's gain within
which the noise that was tuned beside it may have decided against a rival."""
NEARLY_AT_FIRST = 0.1
"""The second where neither has been in the model: its noise fits neither."""
EQUAL = 1.0
"""Gains that differ by less are the same."""
CONVERGED = 0.05
"""Share of a candidate's gain that refitting without it may find."""
SHORTEST_LAG_ROWS = 0.1
SURE_GAIN = 200.0
"""Gain beyond chance that no chance gives: something is there, though perhaps not alone or not
under this name."""
REPLAYS_ALIKE = 0.1
"""Mean square in noise floors of what is between two replays below which they judge no effect."""
AHEAD_GAIN = 50.0
"""Gain beyond chance, twice what chance reaches over everything tried, from which a refused effect
is worth looking one step ahead, and none is needless: another one that is missing blurs it."""
BEAM, BEAM_REFITS = 3, 6
PULLED_BY = (1.5, 2.0, 3.0)
"""How much larger an effect may be than noise that covers it lets it seem."""
RESAMPLES, LEAST_UNITS_TO_RESAMPLE = 1000, 4
MOST_TUNINGS, FEW_TUNINGS, LEAST_TUNINGS, SETTLED = 6, 3, 2, 1.0
"""Times that noise and model are fitted in turn, at most; the same to look for pushes or one step
ahead, for what passes settles again; times after which a fit that moves further than the one before
ends it (a rough Q has many minima); and change of Q by what the fit moved that ends it."""
PATCH_SCALES, PATCH_SHARE = (0.3, 0.5, 0.7, 0.9), 0.2
"""Grips of a patch to try; share of the best promise from which its edges are looked for: those of
the screen are coarse, but explain more than a fifth of what the right ones do."""
NEAR_BY_PLACES = 0.5
"""Share of the best gain that a patch must reach by the places of a grid for finer ones, and no
less than stands out from chance: most logs know no patch."""
FINE_PLACES, EDGE_HALVINGS, EDGE_STEPS = np.linspace(-1.0, 1.0, 33), 3, np.array([-1.0, 1.0])
"""An edge moves over a grid, then over a finer one (beside the right effects 10 mm decide), then by
halves, quarters and eighths of its spacing."""
THRESHOLDS = {"encoder_dropout": 1}
"""Parameters that only the rows show in which a speed passes them."""
THRESHOLD_SPAN, THRESHOLD_PLACES, THRESHOLD_BEYOND = 2.0**0.5, 57, (0.6, 1.05)
THRESHOLD_STEPS = tuple(1.035 ** (0.5**halving) for halving in range(1, 5))
SIZE_FACTORS = (0.8, 1.0, 1.25)
"""How far around a threshold its interval is sought; places over its starts and a share beyond, by
3.5 % from one to the next, for its valley is as narrow; steps from the best; factors of the
size."""
CURVES = ("low_grip", "slip_stiffness_error", "grip_falloff")
"""What changes the friction over slip: where its curve is not the believed one, two of these can
stand for one of them beside another curve."""
FRICTION_OVER_SLIP = (CURVE, *CURVES)
WITHIN_LAW = "no more than friction is off its law on any floor"
CONFIDENCE = 1.959964
"""Standard deviations of a 95 % interval."""
PROFILE_STEPS, PROFILE_BETWEEN = 0.5 ** np.arange(12.0, -1.0, -1.0), 9
"""Where between a value and its last an end of its interval is looked for, and places in the step
that holds the end."""
DELAY, FAR_DELAYS_ROWS = "actuation_delay", (1.5, 2.0, 3.0, 4.0, 6.0)
FAR_SIZES = {"gear_backlash": (0.4, 1.35, 13), "bristle_relaxation": (0.2, 1.6, 9)}
"""Delays, in rows, and sizes where no derivative leads: the first in its scale, its factor to the
next and how many (plays of 4 to 150 mrad of a robot, bristles of 0.2 to 9 mm). Of 63 mrad a play of
40 explains less than none."""
FAR_STEPS = (0.5, 0.25)
"""Steps from the best of them, in rows or steps from size to size."""


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


@dataclass(frozen=True)
class Selected:
    """One effect of the final model with its evidence and the rivals that do as well.

    `stability` is the share of resamples of the runs in which none of the others explains more,
    nor none at all; NaN with too few runs to resample.
    """

    candidate: Candidate
    values: Array
    interval: Array
    """(parameters, 2): between which the values are with 95 % confidence."""
    evidence: Evidence
    rivals: tuple[str, ...]
    stability: float
    left: float
    """Gain that the other effects would leave to it if they were off by all that they do."""
    instead: Shape | None = None
    """What explains most in its place without a name; of the friction curve nothing."""
    law_gain: float = 0.0
    """Gain that it may owe to friction's law, which is off on any floor; 0 for what does not change
    the friction over slip."""


@dataclass(frozen=True)
class Outcome:
    """What the search found: the base fit, the final fit, every trial, limits of detection."""

    base: Fit
    final: Fit
    ladder: tuple[Fit, ...]
    """Refits: base, with the first effect, the first two, ..."""
    selected: tuple[Selected, ...]
    trials: tuple[Trial, ...]
    leftover: tuple[Leftover, ...]
    """What the final model leaves and no effect of the catalogue explains, strongest first."""
    limits: dict[str, dict[str, float]]
    data: Data
    neighbours: dict[str, list[Candidate]]
    """Of each effect that was chosen, what promised most then: what it may have been taken for."""

    def without_effects(self) -> "Outcome":
        """Return the outcome with the base fit as the final one."""
        return replace(self, final=self.base, ladder=self.ladder[:1], selected=())


class MistakenError(Exception):
    """A better model, with so many `effects`, shows that runs are not what they were taken for."""

    def __init__(self, effects: int) -> None:
        super().__init__()
        self.effects = effects


@dataclass(frozen=True)
class Screened:
    """A candidate with the gain that the linearised model promises and the sizes to start from."""

    promise: float
    candidate: Candidate
    start: Array
    limit: Array
    """Sizes, in steps of the screen, whose gain would stand out from chance; of a size that is
    infinite when absent the largest start whose gain would, or 0."""


def search(
    machine: Machine,
    runs: Sequence[Run],
    noise: Noise | None,
    progress: Progress,
    start: Hypothesis | None = None,
    mistaken: Callable[[Hypothesis, Noise], bool] | None = None,
    before: Outcome | None = None,
) -> Outcome:
    """Find the missing effects on runs of two units or more.

    From a first `noise` and believed keys `start` that fit better than the file's, or none.
    `mistaken` is asked, by each better model and its noise, whether what the runs were taken for
    was wrong; then MistakenError is raised. `before`: what was found when other pushes were cut out
    of the same logs, to go on from if all of that holds.
    """
    candidates = machine.candidates_for(runs)
    tried = sum(len(candidate.starts) for candidate in candidates)
    progress("fitting the believed model")
    data, base = settle(machine, runs, start or believed_hypothesis(machine), noise)
    base_values = base.hypothesis
    current, trials = base, []
    settled, compared = base, dict[int, _Compared]()
    limits, curves = None, set[str]()
    neighbours: dict[str, list[Candidate]] = {}
    steps = vain = 0
    again = _again(machine, runs, before, tried) if before else None
    if again is not None:
        progress("going on from what was found before")
        limits = _limits(machine, screen(data, base, candidates))
        (data, current), neighbours = again, dict(before.neighbours)
        settled, curves = current, _curves_in(current)
        taken = {effect.name for effect in current.hypothesis.effects}
        candidates = [c for c in candidates if c.name not in taken]
        steps = max(trial.step for trial in before.trials if trial.accepted)
        trials = [trial for trial in before.trials if trial.step <= steps]
    for step in range(steps + 1, MOST_STEPS + 1):
        if len(current.hypothesis.effects) == MOST_EFFECTS or vain == MOST_VAIN_STEPS:
            break
        progress(f"step {step}: screening {len(candidates)} effects")
        screened = screen(data, current, candidates)
        limits = limits or _limits(machine, screened)
        worth = [s for s in screened[:REFITS] if s.promise > LEAST_PROMISE]
        found = _try(data, current, worth, step, tried, progress)
        accepted = next((fitted for trial, fitted in found if trial.accepted), None)
        ahead = _Ahead(data, current, candidates, step, tried, progress)
        # By the filter of a model without them some effects promise nothing.
        far = [ahead.far(c, accepted) for c in candidates if c.effect in (DELAY, *FAR_SIZES)]
        further = max(filter(None, far), key=_Further.gain, default=None)
        if further is not None:
            reason = f"explains less than {further.trial.candidate.name} far from none"
            found = [(_gives_way(trial, reason), one) for trial, one in found]
        elif accepted is None:
            further = ahead.best(found, worth)
        trials += [*(trial for trial, _ in found), *ahead.trials]
        if further is not None:
            data, current, accepted = further.data, further.without, further.fitted
        if accepted is None:
            break
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
        if mistaken is not None and mistaken(current.hypothesis, data.noise):
            raise MistakenError(len(current.hypothesis.effects))
        settled = current
        data, current = _patch_settled(data, _extend(machine, data, current))
        current = _drop_needless(data, current, tried)
        chosen = current.hypothesis.effects
        current, compared = _swap(data, current, neighbours, progress)
        if _curves_in(current) != curves:  # else they have been compared
            data, current = _one_of_curve(data, current, neighbours, progress)
            curves = _curves_in(current)
        taken = {effect.name for effect in current.hypothesis.effects}
        candidates = [c for c in (*candidates, *chosen) if c.name not in taken]
        vain = vain + 1 if set(current.hypothesis.parameters) == had else 0
    final = current
    if current is not settled:
        progress("fitting the final model")
        data, final = settle(machine, runs, current.hypothesis, data.noise, last=current.jacobian)
        data, final = _patch_settled(data, _extend(machine, data, final))
        final = _drop_needless(data, final, tried)
    final = _whole_numbers(data, final)
    known = compared if final is settled else None
    data, final, compared = _likeliest(data, final, neighbours, tried, progress, known)
    progress("looking for what no effect explains")
    free = responses(data, final, dictionary(machine))
    leftover = find_leftover(data, final, free)
    ladder = _ladder(data, base_values, final)
    selected = _select(data, final, free, compared)
    return Outcome(
        ladder[0],
        final,
        ladder,
        selected,
        tuple(trials),
        tuple(leftover),
        limits or {},
        data,
        neighbours,
    )


def _again(
    machine: Machine, runs: Sequence[Run], before: Outcome, tried: int
) -> tuple[Data, Fit] | None:
    """Settle a model that was found before; None if it has no effects, or not all of them hold."""
    model = before.final.hypothesis
    if not model.effects:
        return None
    try:
        data, settled = settle(machine, runs, model, before.data.noise)
    except RunawayError:
        return None
    holds = _drop_needless(data, settled, tried) is settled
    return (data, settled) if holds else None


def believed_hypothesis(machine: Machine) -> Hypothesis:
    """Return the believed model: no effect, every key that may move at its value."""
    base = tuple(machine.base_parameters())
    return Hypothesis(base, (), np.array([machine.believed[p.places[0]] for p in base]))


def first_model(
    machine: Machine,
    runs: Sequence[Run],
    like: tuple[Noise, Hypothesis] | None = None,
    tunings: int = FEW_TUNINGS,
) -> tuple[Noise, Hypothesis]:
    """Return noise and fit of a model that is near enough to see pushes beside it.

    The believed keys within their tolerance and a free friction curve: what is off in most robots.
    `like`: those of nearly the same runs, to start from.
    """
    noise, start = like or (None, believed_hypothesis(machine))
    if like is None:
        for candidate in [c for c in machine.candidates() if c.effect == CURVE]:
            start = start.with_effect(candidate, [0.1])
    data, fitted = settle(machine, runs, start, noise, tunings)
    return data.noise, fitted.hypothesis


def settle(
    machine: Machine,
    runs: Sequence[Run],
    start: Hypothesis,
    noise: Noise | None = None,
    tunings: int = MOST_TUNINGS,
    last: Array | None = None,
) -> tuple[Data, Fit]:
    """Tune the noise at `start` and fit, until predictor and model agree or for so many times.

    Noise that was tuned for keys which are off gives others that are off in another way. `last`: as
    `fit` has it.
    """
    hypothesis, before = start, np.inf
    scale = np.array([p.scale for p in start.parameters])
    for tuning in range(tunings):
        values = hypothesis.flat(machine.believed)
        noise = tune_noise(machine, runs, values, noise, paths=1)
        data = Data(machine, runs, noise, hypothesis)
        fitted = fit(data, hypothesis, last=last)
        last = fitted.jacobian
        moved = (fitted.hypothesis.x - hypothesis.x) / scale
        hypothesis = fitted.hypothesis
        way = float(moved @ fitted.information @ moved)
        if way < SETTLED or (way > before and tuning >= LEAST_TUNINGS):
            break
        before = way
    return data, fitted


def _ladder(data: Data, base: Hypothesis, final: Fit) -> tuple[Fit, ...]:
    """Add the effects of the final model one by one, in the order in which they were found."""
    rungs = [fit(data, base)]
    hypothesis = final.hypothesis
    for index, effect in enumerate(hypothesis.effects[:-1]):
        start = rungs[-1].hypothesis.with_effect(effect, hypothesis.values_of(index))
        rungs.append(fit(data, start, last=final.jacobian[:, : len(start.x)]))
    return (*rungs, final) if hypothesis.effects else tuple(rungs)


def screen(data: Data, current: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Rank candidates by the gain that one linear step from the current model promises."""
    variants = [(c, start) for c in candidates for start in c.starts]
    points, owners = [], []
    for number, (candidate, start) in enumerate(variants):
        for amplitude in candidate.amplitudes:
            moved = _moved(data, current.hypothesis, candidate, start, amplitude)
            points.append(moved.flat(data.believed))
            owners.append(number)
    columns = (data.residuals(np.stack(points)) - current.residual).T
    free = free_of_fitted(current, columns)

    def promise(number: int) -> Screened:
        own = [i for i, o in enumerate(owners) if o == number]
        return _promise(data, current, *variants[number], columns[:, own], free[:, own])

    ranked: dict[str, Screened] = {}
    promises = side_by_side(promise, range(len(variants)))
    for (candidate, _), found in zip(variants, promises, strict=True):
        best = ranked.get(candidate.name, found)
        infinite = ~np.isfinite(_neutral(data, current.hypothesis, candidate))
        infinite = infinite[list(candidate.amplitudes)]
        farthest = np.maximum(found.limit, best.limit)
        better = found if found.promise > best.promise else best
        limit = np.where(infinite, farthest, better.limit)
        ranked[candidate.name] = replace(better, limit=limit)
    return sorted(ranked.values(), key=lambda s: -s.promise)


def _neutral(
    data: Data, without: Hypothesis, candidate: Candidate, start: dict[int, float] | None = None
) -> Array:
    """Sizes of the candidate when it is absent, shaping parameters at `start`.

    A wheel is like all wheels of the model `without` it, then.
    """
    flat = without.flat(data.believed) if candidate.wheel else data.believed
    values = flat[[p.places[0] for p in candidate.parameters]]
    if start:
        values[list(start)] = list(start.values())
    return values


def _reach(candidate: Candidate, machine: Machine, amplitude: int) -> float:
    """Change from absence to a size worth looking for; from infinity it is the size itself."""
    parameter = candidate.parameters[amplitude]
    neutral = machine.believed[parameter.places[0]]
    sign = machine.sign_of(candidate.effect, parameter.label)
    return parameter.scale * sign if np.isfinite(neutral) else parameter.scale


def _moved(
    data: Data,
    current: Hypothesis,
    candidate: Candidate,
    start: dict[int, float],
    amplitude: int,
) -> Hypothesis:
    sizes = _neutral(data, current, candidate, start)
    reach = _reach(candidate, data.machine, amplitude)
    if amplitude not in start:
        finite = np.isfinite(sizes[amplitude])
        sizes[amplitude] = sizes[amplitude] + reach if finite else reach
    return current.with_effect(candidate, sizes)


def _promise(
    data: Data,
    current: Fit,
    candidate: Candidate,
    start: dict[int, float],
    columns: Array,
    free: Array,
) -> Screened:
    """Take one linear step of everything: keys that rest on a bound for its lack come back, too.

    `columns` (m, amplitudes) is what a step of the screen changes, `free` of them is what the
    fitted parameters leave.
    """
    gram = free.T @ free
    start = dict(start)
    phase = [i for i, p in enumerate(candidate.parameters) if p.label == PHASE]
    if phase and free[:, 0] @ current.residual > 0:  # a wave the other way round
        columns = -columns
        start[phase[0]] = _half_turn(start[phase[0]] + np.pi)
    cross = current.jacobian.T @ columns
    whole = np.block([[current.information, cross], [cross.T, columns.T @ columns]])
    slope = np.concatenate([current.slope(data.believed), columns.T @ current.residual])
    low, high = _possible_amounts(data, current.hypothesis, candidate)
    below, above = current.hypothesis.room()
    step = solve_within(whole, slope, np.append(below, low), np.append(above, high))
    promise = float(-2.0 * slope @ step - step @ whole @ step)
    amount = step[len(below) :]
    sizes = np.zeros(len(candidate.parameters))
    for index, value in start.items():
        sizes[index] = value
    for k, index in enumerate(candidate.amplitudes):
        sizes[index] = start.get(index, amount[k])
    inflation = inflation_of(data, free, current.residual + free @ amount, gram)
    visible = max(VISIBLE_GAIN, data.feigned_gain)
    least, gains = visible * inflation, np.maximum(np.diag(gram), 1e-12)
    limit = np.sqrt(least / gains)
    for k, index in enumerate(candidate.amplitudes):
        if index in start:
            limit[k] = start[index] if gains[k] >= least else 0.0
    return Screened(promise, candidate, sizes, limit)


def _half_turn(angle_rad: float) -> float:
    """Return the angle within -pi..pi."""
    return float(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


def _possible_amounts(data: Data, current: Hypothesis, candidate: Candidate) -> tuple[Array, Array]:
    """Bounds of the amplitudes in steps of the screen."""
    neutral = _neutral(data, current, candidate)
    low, high = np.empty(len(candidate.amplitudes)), np.empty(len(candidate.amplitudes))
    for k, index in enumerate(candidate.amplitudes):
        p, absent = candidate.parameters[index], neutral[index]
        reach = _reach(candidate, data.machine, index)
        if np.isfinite(absent):
            low[k], high[k] = sorted(((p.low - absent) / reach, (p.high - absent) / reach))
        else:
            low[k], high[k] = 0.0, 1.0
    return low, high


def _starting_sizes(data: Data, current: Hypothesis, screened: Screened) -> list[Array]:
    """Sizes to start a fit from: hardly there, the linear estimate up to typical and beyond.

    And more than that estimate: play or a dead zone of half the size explains nothing of what the
    other half does, and a delay that passes another row moves other commands.
    """
    candidate = screened.candidate
    shapes = {i: float(v) for i, v in enumerate(screened.start) if i not in candidate.amplitudes}
    low = np.array([p.low for p in candidate.parameters])
    high = np.array([p.high for p in candidate.parameters])
    margin = np.array([0.01 * p.scale for p in candidate.parameters])
    starts = []
    for share, most in ((1.0, 0.02), (1.0, 1.0), (1.0, 5.0), (1.0, 20.0), (1.6, 5.0), (2.5, 5.0)):
        sizes = _neutral(data, current, candidate, shapes)
        for index in candidate.amplitudes:
            if not np.isfinite(sizes[index]):
                sizes[index] = screened.start[index]
                continue
            amount = float(np.clip(share * screened.start[index], -most, most))
            sizes[index] = sizes[index] + _reach(candidate, data.machine, index) * amount
        starts.append(np.clip(sizes, low + margin, high - margin))
    return list(np.unique(starts, axis=0))


def _refit(
    data: Data, current: Fit, screened: Sequence[Screened], asked: float = LEAST_PROMISE
) -> list[Fit]:
    """Fit the current model with one more effect, each from the better of its starts.

    All of them quickly, fully those that may be the best and gain what is `asked`.
    """
    fits = _refit_quickly(data, current, screened)
    order = np.argsort([one.objective for one in fits])
    best = current.objective - min((one.objective for one in fits), default=np.inf)
    least = max(NEAR * best, NEAR_TO_FULL * asked)
    hopeful = [k for k in order[:FULL_REFITS] if current.objective - fits[k].objective > least]
    whole = side_by_side(lambda k: fit(data, fits[k].hypothesis, last=fits[k].jacobian), hopeful)
    for k, one in zip(hopeful, whole, strict=True):
        fits[k] = one
    return fits


def _refit_quickly(data: Data, current: Fit, screened: Sequence[Screened]) -> list[Fit]:
    """Fit the effects' own parameters and, linearly, the others, each from the better start."""
    if not screened:
        return []
    offered = [
        [
            current.hypothesis.with_effect(one.candidate, sizes)
            for sizes in _starting_sizes(data, current.hypothesis, one)
        ]
        for one in screened
    ]
    costs = costs_refitted(data, current, [m for own in offered for m in own])
    edges = np.cumsum([len(own) for own in offered])[:-1]
    starts = [
        own[int(np.argmin(c))] for own, c in zip(offered, np.split(costs, edges), strict=True)
    ]
    hoped = PATCH_SHARE * max(one.promise for one in screened)
    near = NEAR_BY_PLACES * (current.objective - float(costs.min()))
    wanted = current.objective - max(near, VISIBLE_GAIN)
    starts = [
        _edges_moved(data, current, start, wanted) if one.promise >= hoped else start
        for one, start in zip(screened, starts, strict=True)
    ]
    return fit_more(data, current, starts)


def _edges_moved(data: Data, current: Fit, start: Hypothesis, wanted: float = np.inf) -> Hypothesis:
    """Move the edges of a patch in the floor to where they explain most, in turn, or a threshold.

    No derivative leads there: only rows at the edge itself have one. Other effects stay. Both are
    refined where the model costs no more than `wanted`.
    """
    candidate = start.effects[-1]
    if candidate.effect in THRESHOLDS:
        return _threshold_moved(data, current, start, THRESHOLDS[candidate.effect], wanted)
    if not candidate.edges_m:
        return start
    spacing_m = candidate.edges_m[1] - candidate.edges_m[0]
    everywhere = np.array(candidate.edges_m)
    fine_m = spacing_m * np.diff(FINE_PLACES).max()
    steps_m = [fine_m * EDGE_STEPS / 2**level for level in range(1, EDGE_HALVINGS + 1)]
    for edge in (0, 1):
        start = _edge_moved(data, current, start, edge, everywhere, PATCH_SCALES)
    if costs_refitted(data, current, [start])[0] > wanted:
        return start
    for edge in (0, 1, 0, 1):
        start = _edge_moved(data, current, start, edge, everywhere, PATCH_SCALES)
        for near_m in (spacing_m * FINE_PLACES, *steps_m):
            places_m = start.values_of(-1)[edge] + near_m
            start = _edge_moved(data, current, start, edge, places_m)
    return start


def _threshold_moved(
    data: Data, current: Fit, start: Hypothesis, index: int, wanted: float
) -> Hypothesis:
    """Move the parameter `index` of the last effect to where the effect explains most.

    Its size moves along only from there: of half or 1.5 times the right one an effect explains
    three quarters, and of any at a wrong threshold hardly anything.
    """
    candidate = start.effects[-1]
    low, high = ([getattr(p, end) for p in candidate.parameters] for end in ("low", "high"))

    def at_best_of(places: Array, factors: Sequence[float]) -> tuple[Hypothesis, float]:
        offered = []
        for place in places:
            for factor in factors:
                sizes = start.values_of(-1).copy()
                sizes[index] = place
                sizes[list(candidate.amplitudes)] *= factor
                offered.append(current.hypothesis.with_effect(candidate, np.clip(sizes, low, high)))
        costs = costs_refitted(data, current, offered)
        best = int(np.argmin(costs))
        return offered[best], float(costs[best])

    shown = [own[index] for own in candidate.starts]
    ends = np.array([min(shown), max(shown)]) * THRESHOLD_BEYOND
    places = np.geomspace(*ends, THRESHOLD_PLACES)
    start, cost = at_best_of(np.append(places, start.values_of(-1)[index]), [1.0])
    if cost > wanted:
        return start
    for step in THRESHOLD_STEPS:
        near = start.values_of(-1)[index] * np.array([1.0 / step, 1.0, step])
        start, _ = at_best_of(near, SIZE_FACTORS)
    return start


def _edge_moved(
    data: Data,
    current: Fit,
    start: Hypothesis,
    edge: int,
    places_m: Array,
    scales: Sequence[float] = (),
) -> Hypothesis:
    """Move one edge of the patch to the best of the places, with its grip or one of the `scales`.

    Where no run shows which of some places it is, to the narrowest patch: it claims the least.
    """
    candidate, now = start.effects[-1], start.values_of(-1)
    offered = [start]
    for place_m in places_m:
        for scale in (*scales, now[2]):
            sizes = now.copy()
            sizes[edge] = place_m
            sizes[2] = scale
            if sizes[0] < sizes[1]:
                offered.append(current.hypothesis.with_effect(candidate, sizes))
    costs = costs_refitted(data, current, offered)
    widths = np.array([np.ptp(one.values_of(-1)[:2]) for one in offered])
    equal = np.flatnonzero(costs < costs.min() + EQUAL)
    return offered[int(equal[np.argmin(widths[equal])])]


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
    for one, fitted in zip(screened, _refit(data, current, screened), strict=True):
        results.append((one.candidate, fitted, weigh(data, current, fitted, index)))
    results = _simplest_first(results)
    checks = check_unseen(data, current, [fitted for _, fitted, _ in results])
    judged, most = [], np.inf
    for (candidate, fitted, evidence), check in zip(results, checks, strict=True):
        nearly = fitted.objective < most  # else the best that passes decides without replays
        trial = _judge(data, current, fitted, candidate, evidence, check, step, tried, nearly)
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
    if not near or not _likelihood_judges(data):
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
    return _log_posterior(*own)


def _likelihood_judges(data: Data) -> bool:
    """Whether no controller answers within rows (answers.py)."""
    return not data.answers or data.machine.holds_commands


def _judge(
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
    absent = _neutral(data, without.hypothesis, candidate)
    chance = min(1.0, evidence.p_value * tried)
    reason, passed = _verdict(data, evidence, chance, check)
    if passed and _left_by_shapes(data, without, fitted, index, evidence):
        off = 100 * SHAPE_SHARE**0.5
        reason = f"real perhaps, but effects found would leave as much if {off:.0f} % off in shape"
        passed = False
    if passed and _within_law(data, without, fitted, index):
        reason, passed = WITHIN_LAW, False
    if passed and not _differs(candidate, values - absent, evidence):
        reason, passed = "its size cannot be told from none beside the other parameters", False
    sure = evidence.beyond_chance > SURE_GAIN
    if passed and replays and not _replays_better(data, without, fitted, check, sure):
        reason, passed = "helps the predictor but not replays of runs that were not fitted", False
    if passed and within_row(data, candidate, values):
        reason, passed = "shorter than the log can time: a tenth of a row", False
    return Trial(
        step, candidate, values, evidence, chance, check.gain, check.voters.any(), reason, passed
    )


def _lost(trial: Trial) -> Trial:
    """What was accepted along the filter of another model is refused: its own loses the robot."""
    if not trial.accepted:
        return trial
    return replace(trial, accepted=False, reason="the robot does not follow it")


@dataclass(frozen=True)
class _Further:
    """A model with one or two more effects, and that without them, by the noise that fits the
    first."""

    data: Data
    without: Fit
    fitted: Fit
    trial: Trial

    def gain(self) -> float:
        """Fall of Q: by another noise Q itself is another."""
        return self.without.objective - self.fitted.objective


@dataclass(frozen=True)
class _Likely:
    """Log-likelihood of a model by its own filter."""

    likelihood: float
    model: Hypothesis


class _Ahead:
    """One step further, where none was taken or what promises nothing at first explains more.

    Each of the best is judged again by the noise that is left beside it: noise that was tuned
    without an effect covers it and pulls its size, so that a fit gains little of what was promised.
    And two defects may each be refused without the other, so a second one is tried beside it.
    """

    def __init__(
        self,
        data: Data,
        current: Fit,
        candidates: Sequence[Candidate],
        step: int,
        tried: int,
        progress: Progress,
    ) -> None:
        self._data, self._current = data, current
        self._candidates, self._step, self._tried = candidates, step, tried * BEAM
        self._progress = progress
        self.trials: list[Trial] = []

    def best(
        self, refused: Sequence[tuple[Trial, Fit]], screened: Sequence[Screened]
    ) -> _Further | None:
        """Return the best model with one of `refused`, or with one of them and a second effect.

        What promised or gained much, but from few blocks, is judged alone: among pairs of such
        chance has too much choice.
        Pairs with a weaker first effect are tried only where none with a stronger one passes.
        """
        refused = [pair for pair in refused if pair[0].reason != WITHIN_LAW]
        clear = [pair for pair in refused if pair[0].evidence.beyond_chance > AHEAD_GAIN]
        clear = sorted(clear, key=lambda pair: pair[1].objective)[:BEAM]
        rest = {pair[0].candidate.name: pair for pair in refused}
        for trial, _ in clear:
            rest.pop(trial.candidate.name, None)
        promised = {s.candidate.name: s.promise for s in screened}
        hopes = {name: max(promised.get(name, 0.0), rest[name][0].evidence.gain) for name in rest}
        covered = [rest[name] for name in sorted(hopes, key=lambda name: -hopes[name])[:BEAM]]
        covered = [pair for pair in covered if hopes[pair[0].candidate.name] > SURE_GAIN]
        judged = side_by_side(
            lambda pair: self._by_its_noise(
                pair[0].candidate,
                self._larger(pair[0].candidate, pair[1].hypothesis),
                pair[1].jacobian,
            ),
            clear + covered,
        )
        followed = [one for one in judged if one is not None]
        self.trials += [one.trial for one in followed]
        passed = [one for one in followed if one.trial.accepted]
        if len(self._current.hypothesis.effects) + 2 <= MOST_EFFECTS:
            for first in judged[: len(clear)]:
                passed = passed or (self._pairs(first) if first else [])
        best = max(passed, key=_Further.gain, default=None)
        self.trials = [
            replace(trial, accepted=best is not None and trial is best.trial)
            for trial in self.trials
        ]
        return best

    def far(self, candidate: Candidate, accepted: Fit | None) -> _Further | None:
        """Return the model with an effect far from none, if that explains more than anything.

        The predictor of a model without a delay loses the robot by one with it, or takes for chance
        what play or bristles do: each size has to be judged along its own filter. In a closed loop
        a row's mean command holds the answer to what happened within it, so a likelihood that takes
        commands as given prefers those of the row before (in one log without a delay: 3,500 more at
        1.25 rows): what ends nearer than the first of these sizes is none of them.
        """
        current, runs = self._current.hypothesis, self._data.runs
        if candidate.effect == DELAY:
            row_s = max(run.row_s for run in runs)
            sizes, apart, apart_share = row_s * np.array(FAR_DELAYS_ROWS), row_s, 0.0
            sizes = sizes[sizes <= candidate.parameters[0].high]
        else:
            sizes = _far_sizes(candidate)
            apart, apart_share = 0.0, FAR_SIZES[candidate.effect][1] - 1.0
        shapes = [list(start.values()) for start in candidate.starts]

        def likeliest(values: Iterable[Sequence[float]], runs: Sequence[Run]) -> _Likely:
            """Return the likeliest model with the candidate of some values."""
            models = [current.with_effect(candidate, own) for own in values]
            found = side_by_side(lambda model: self._likelihood(model, runs), models)
            none = _Likely(-np.inf, current)
            return max(map(_Likely, found, models), key=lambda one: one.likelihood, default=none)

        few = some_runs(runs)  # enough to see whether any is worth a look
        best = likeliest([[size, *shape] for size in sizes for shape in shapes], few)
        if best.likelihood <= self._likelihood(current, few):
            return None
        best = likeliest([best.model.values_of(-1)], runs)
        least = self._likelihood(accepted.hypothesis if accepted else current, runs)
        if best.likelihood < least + SURE_GAIN / 2:
            return None
        for share in FAR_STEPS:
            size, *shape = best.model.values_of(-1)
            step = share * (apart + apart_share * size)
            beside = likeliest([[size - step, *shape], [size + step, *shape]], runs)
            best = max(best, beside, key=lambda one: one.likelihood)
        if best.model.values_of(-1)[0] < sizes[0]:
            return None
        found = self._by_its_noise(candidate, best.model)
        if found is None:
            return None
        self.trials.append(found.trial)
        size = found.fitted.hypothesis.values_of(len(current.effects))[0]
        return found if found.trial.accepted and size >= sizes[0] else None

    def _likelihood(self, hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
        """Logarithm of that of a model's own filter, by the noise that is known."""
        values = hypothesis.flat(self._data.believed)
        try:
            tracks = track_all(self._data.machine, runs, values, self._data.noise)
        except RunawayError:
            return -np.inf
        return float(np.nan_to_num(sum(t.log_likelihood for t in tracks), nan=-np.inf))

    def _larger(self, candidate: Candidate, start: Hypothesis) -> Hypothesis:
        """Return a model whose last effect was fitted with it of the likeliest of some sizes.

        From a size that was pulled settling creeps: play of 5 mrad for 13 went to 8 in six rounds.
        """
        sizes = start.values_of(-1)
        absent = _neutral(self._data, self._current.hypothesis, candidate)
        amplitudes = [i for i in candidate.amplitudes if np.isfinite(absent[i])]
        if not amplitudes:
            return start
        low, high = ([getattr(p, end) for p in candidate.parameters] for end in ("low", "high"))
        offered = [start]
        for factor in PULLED_BY:
            larger = sizes.copy()
            larger[amplitudes] += (factor - 1.0) * (sizes - absent)[amplitudes]
            offered.append(
                self._current.hypothesis.with_effect(candidate, np.clip(larger, low, high))
            )
        return max(offered, key=lambda one: self._likelihood(one, self._data.runs))

    def _by_its_noise(
        self, candidate: Candidate, start: Hypothesis, last: Array | None = None
    ) -> _Further | None:
        """Judge a candidate by the noise that fits it; None where its own filter loses the robot.

        What pulls as hard as a motor, tooth by tooth, may gain along the filter of another model.
        `last`: as `settle` has it.
        """
        self._progress(f"step {self._step}: looking ahead from {candidate.name}")
        machine, noise = self._data.machine, self._data.noise
        try:
            data, first = settle(machine, self._data.runs, start, noise, FEW_TUNINGS, last)
        except RunawayError:
            return None
        without = fit(data, self._current.hypothesis, last=self._current.jacobian)
        evidence = weigh(data, without, first, len(without.hypothesis.effects))
        [check] = check_unseen(data, without, [first])
        trial = _judge(
            data,
            without,
            first,
            candidate,
            evidence,
            check,
            self._step,
            self._tried,
        )
        trial = replace(trial, reason=f"by the noise that is left beside it: {trial.reason}")
        return _Further(data, without, first, trial)

    def _pairs(self, first: _Further) -> list[_Further]:
        """Return the models with this effect and a second one that pass.

        The second is judged only when both are fitted: a patch in the floor, say, lies somewhere
        else beside the right friction curve.
        """
        data, name = first.data, first.trial.candidate.name
        others = [c for c in self._candidates if c.name != name]
        worth = [
            s for s in screen(data, first.fitted, others)[:BEAM_REFITS] if s.promise > LEAST_PROMISE
        ]
        self._progress(f"step {self._step}: trying others beside {name}")
        index = len(first.fitted.hypothesis.effects)
        found = [
            (fitted, weigh(data, first.fitted, fitted, index))
            for fitted in _refit_quickly(data, first.fitted, worth)
        ]
        found.sort(key=lambda one: -one[1].beyond_chance)

        def judge(one: tuple[Fit, Evidence]) -> _Further:
            quick, evidence = one
            both = _patch_again(data, fit(data, quick.hypothesis, last=quick.jacobian))
            return self._pair(data, first, first.without, both, evidence)

        judged = side_by_side(judge, found[:BEAM])
        far = [self._far_beside(first, c) for c in others if c.effect in FAR_SIZES]
        judged += [one for one in far if one is not None]
        self.trials += [one.trial for one in judged]
        return [one for one in judged if one.trial.accepted]

    def _far_beside(self, first: _Further, candidate: Candidate) -> _Further | None:
        """Return the model with an effect far from none beside the first, if that is likelier.

        Each size by noise that fits it: noise that fits the first alone holds what bristles do, too
        (beside a cogging torque it made them 5,000 to 11,000 less likely than none; by its own they
        are 23,000 likelier).
        """
        data, before = first.data, first.fitted.hypothesis
        shape = list(candidate.starts[0].values())
        sizes = _far_sizes(candidate)[1::3]
        models = [before, *(before.with_effect(candidate, [size, *shape]) for size in sizes)]

        def likelihood(model: Hypothesis) -> float:
            try:
                values = model.flat(data.believed)
                return tuned_likelihood(data.machine, data.runs, values, data.noise)
            except RunawayError:
                return -np.inf

        least, *found = side_by_side(likelihood, models)
        if max(found) < least + SURE_GAIN / 2:
            return None
        name, start = first.trial.candidate.name, models[1 + int(np.argmax(found))]
        self._progress(f"step {self._step}: looking ahead from {name} and {candidate.name}")
        try:
            data, both = settle(data.machine, data.runs, start, data.noise, FEW_TUNINGS)
        except RunawayError:
            return None
        without = fit(data, self._current.hypothesis, last=self._current.jacobian)
        index = len(before.effects)
        evidence = weigh(data, both.refitted_without(data, index), both, index)
        return self._pair(data, first, without, both, evidence)

    def _pair(
        self, data: Data, first: _Further, without: Fit, both: Fit, evidence: Evidence
    ) -> _Further:
        """Judge a model with the first effect and a second one of this evidence beside it."""
        tried, name = self._tried * BEAM, first.trial.candidate.name
        [check] = check_unseen(data, without, [both])
        passes = _both_pass(data, without, both, check, tried)
        reason = f"{name} and this {'pass' if passes else 'do not pass'} together"
        chance, checked = min(1.0, evidence.p_value * tried), bool(check.voters.any())
        second, values = both.hypothesis.effects[-1], both.hypothesis.values_of(-1)
        trial = Trial(
            self._step, second, values, evidence, chance, check.gain, checked, reason, passes
        )
        return _Further(data, without, both, trial)


def _far_sizes(candidate: Candidate) -> Array:
    """Return sizes (sizes,) of an effect to which no derivative leads from none."""
    first, factor, count = FAR_SIZES[candidate.effect]
    sizes = candidate.parameters[0].scale * first * factor ** np.arange(count)
    return sizes[sizes <= candidate.parameters[0].high]


def _both_pass(data: Data, without: Fit, both: Fit, check: Check, tried: int) -> bool:
    """Whether two effects together help runs that were not fitted, and none of them is chance."""
    if not check.helps:
        return False
    count, sure = len(without.hypothesis.effects), True
    for index in (count, count + 1):
        effect, sizes = both.hypothesis.effects[index], both.hypothesis.values_of(index)
        rest = both.refitted_without(data, index)
        evidence = weigh(data, rest, both, index)
        if evidence.p_value * tried >= ALPHA or evidence.beyond_chance < data.feigned_gain:
            return False
        if _left_by_shapes(data, rest, both, index, evidence):
            return False
        if _within_law(data, rest, both, index):
            return False
        absent = _neutral(data, rest.hypothesis, effect)
        if not _differs(effect, sizes - absent, evidence) or within_row(data, effect, sizes):
            return False
        sure = sure and evidence.beyond_chance > SURE_GAIN
    return _replays_better(data, without, both, check, sure)


def _patch_again(data: Data, fitted: Fit) -> Fit:
    """Move the edges of a patch again, beside the other effects of the model as they are."""
    for index, effect in enumerate(fitted.hypothesis.effects):
        if effect.edges_m:
            start = fitted.hypothesis.moved_last(index)
            moved = fit(data, _edges_moved(data, fitted.sharing(index), start))
            fitted = moved if moved.objective < fitted.objective else fitted
    return fitted


def _patch_settled(data: Data, fitted: Fit) -> tuple[Data, Fit]:
    """Move the edges of a patch again, and settle with the noise that is left where they moved."""
    moved = _patch_again(data, fitted)
    if fitted.objective - moved.objective < SETTLED:
        return data, moved
    return settle(data.machine, data.runs, moved.hypothesis, data.noise, last=moved.jacobian)


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
        if spared > 0 and _no_more_than_chance(lost, best[2].inflation, spared):
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


def _no_more_than_chance(gain: float, inflation: float, parameters: int) -> bool:
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


def _verdict(data: Data, evidence: Evidence, chance: float, check: Check) -> tuple[str, bool]:
    if chance >= ALPHA:
        return f"could be chance (p = {chance:.2g} over everything tried)", False
    if evidence.beyond_chance < data.feigned_gain:
        return "a controller's answers feign as much", False
    voters = int(np.sum(check.voters))
    if not voters:
        return "is seen in no run that the others could check", False
    if check.gain <= 0:
        return "makes runs worse that were not fitted", False
    if not check.helps:
        return f"helps only {check.helped} of {voters} runs that were not fitted", False
    return "explains more than any other effect", True


def _left_by_others(data: Data, without: Fit, fitted: Fit, index: int) -> float:
    """Gain of effect `index` that the others would leave if off by all that they do."""
    own = fitted.hypothesis.effects[index]
    change = without.residual - fitted.residual
    return left_by_shapes(
        data, fitted, change, without.residual, lambda effect: 0.0 if effect is own else 1.0
    )


def _left_by_shapes(data: Data, without: Fit, fitted: Fit, index: int, evidence: Evidence) -> bool:
    """Whether the others would leave as much as effect `index` gains if a bit off in shape.

    Of a name's gain only what is beyond chance counts, of the friction curve's all: named in vain
    it does no harm, but what it leaves beside a strong effect passes for an unknown one.
    """
    curve = fitted.hypothesis.effects[index].effect == CURVE
    gain = evidence.gain if curve else evidence.beyond_chance
    return gain < SHAPE_SHARE * _left_by_others(data, without, fitted, index)


def _within_law(data: Data, without: Fit, fitted: Fit, index: int) -> bool:
    """Whether effect `index` changes the friction over slip by no more than any law is off.

    As `left_by_shapes` has it, for what friction does as a whole: all of it, for it is proportional
    to the grip.
    """
    if fitted.hypothesis.effects[index].effect not in CURVES:
        return False
    return without.objective - fitted.objective <= _left_by_law(data, without, fitted)


def _left_by_law(data: Data, without: Fit, fitted: Fit) -> float:
    """Return the gain of `fitted` that friction over slip leaves if off its law as on any floor."""
    less = data.machine.with_less_grip(fitted.hypothesis.flat(data.believed))
    [slipping] = data.residuals(less[None])
    friction = (slipping - fitted.residual)[None] / LESS_GRIP
    [most] = most_along(friction, without.residual - fitted.residual)
    return SHAPE_SHARE * float(most)


def within_row(data: Data, candidate: Candidate, sizes: Array) -> bool:
    """Whether a lag is so short that it may be the averaging of the command over a row."""
    resistance = float(data.machine.model.values.get("motor.resistance_ohm", 1.0))
    seconds = {
        DELAY: sizes[0],
        "driver_lag": sizes[0],
        "armature_inductance": sizes[0] / resistance,
    }
    row_s = min(run.row_s for run in data.runs)
    return seconds.get(candidate.effect, np.inf) < SHORTEST_LAG_ROWS * row_s


def _differs(candidate: Candidate, sizes: Array, evidence: Evidence) -> bool:
    """Whether any size is two standard deviations from none, all other parameters left free."""
    deviations = np.sqrt(np.maximum(np.diag(evidence.covariance), 0.0))
    return any(
        not np.isfinite(sizes[i]) or abs(sizes[i]) > 2.0 * deviations[i]
        for i in candidate.amplitudes
    )


def _extend(machine: Machine, data: Data, fitted: Fit) -> Fit:
    """Refine the effects of the model where that gains more than chance, the best first.

    By the refinement, not by what the rest of the fit still had to gain. One that goes as far as it
    may describes something else that is missing.
    """
    for name in [effect.name for effect in fitted.hypothesis.effects]:
        refined: Fit | None = fitted
        while refined is not None:
            fitted = refined
            refined = _refined(machine, data, fitted, name)
    return fitted


def _refined(machine: Machine, data: Data, fitted: Fit, name: str) -> Fit | None:
    """Return the model with the best refinement of the effect `name`; None where none passes."""
    place = fitted.hypothesis.place_of(name)
    effect, index = fitted.hypothesis.effects[place], len(fitted.hypothesis.effects)
    have = {p.label for p in effect.parameters}
    offered = [
        Screened(0.0, extension, np.array([0.1]), np.array([np.inf]))
        for extension in machine.extensions(effect.effect)
        if extension.parameters[0].label not in have
    ]
    ordered, passing = fitted.moved_last(place), []
    for one, refined in zip(offered, _refit(data, ordered, offered), strict=True):
        evidence = weigh(data, ordered, refined, index)
        absent = _neutral(data, ordered.hypothesis, one.candidate)
        differs = _differs(one.candidate, refined.hypothesis.values_of(-1) - absent, evidence)
        bound = at_bound(refined, len(refined.hypothesis.x) - 1)
        if evidence.p_value < ALPHA and differs and not bound:
            passing.append(refined)
    best = min(passing, key=lambda one: one.objective, default=None)
    return None if best is None else replace(best, hypothesis=best.hypothesis.last_two_joined())


def _whole_numbers(data: Data, fitted: Fit) -> Fit:
    """Hold numbers of teeth and rollers at whole ones where that loses no more than chance.

    A phase, which is that at the angle 0, comes right with them.
    """
    if data.machine.kind != "robot":
        return fitted
    for index, effect in enumerate(fitted.hypothesis.effects):
        for number, parameter in enumerate(effect.parameters):
            if (effect.effect, parameter.label) in WHOLE:
                whole = float(np.round(fitted.hypothesis.values_of(index)[number]))
                held = fit(data, _turned_with(fitted, index, number, whole))
                lost = held.objective - fitted.objective
                without = fitted.refitted_without(data, index)
                inflation = weigh(data, without, fitted, index).inflation
                if _no_more_than_chance(lost, inflation, 1):
                    fitted = held
    return fitted


def _turned_with(fitted: Fit, index: int, number: int, value: float) -> Hypothesis:
    """Hold a parameter of an effect at a value, its other parameters moved with it (one step)."""
    held = fitted.hypothesis.holding(index, number, value)
    effect, before = held.effects[index], fitted.hypothesis.values_of(index)
    places = held.own(index)
    others = [k for k in range(len(before)) if k != number]
    own = fitted.information[places, places]
    change = (value - before[number]) / effect.parameters[number].scale
    step = -np.linalg.pinv(own[np.ix_(others, others)]) @ own[others, number] * change
    sizes = held.values_of(index).copy()
    for k, move in zip(others, step, strict=True):
        parameter = effect.parameters[k]
        moved = sizes[k] + move * parameter.scale
        turned = _half_turn(moved) if parameter.label == PHASE else moved
        sizes[k] = np.clip(turned, parameter.low, parameter.high)
    x = held.x.copy()
    x[places] = sizes
    return replace(held, x=x)


def _drop_needless(data: Data, fitted: Fit, tried: int) -> Fit:
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
            or one.beyond_chance < data.feigned_gain
            or _left_by_shapes(data, without[index], fitted, index, one)
            or _within_law(data, without[index], fitted, index)
        ]
        if not needless:
            break
        fitted = without[min(needless, key=lambda index: judged[index].gain)]
    return fitted


def _swap(
    data: Data, fitted: Fit, neighbours: dict[str, list[Candidate]], progress: Progress
) -> tuple[Fit, dict[int, "_Compared"]]:
    """Put another effect in the place of one where that explains clearly more, or as much simpler.

    The first effect was chosen while the others were still missing. Return also how the effects of
    the model that is left compare, by their numbers; the newest has been compared by its choice.
    """
    index, compared = 0, dict[int, _Compared]()
    while index < len(fitted.hypothesis.effects) - 1:
        effect = fitted.hypothesis.effects[index]
        if index not in compared:
            others = range(index, len(fitted.hypothesis.effects) - 1)
            compared |= _compare(data, fitted, others, neighbours, progress)
        own = compared[index]
        better = [one for one in own.rivals if _takes_its_place(data, effect, own, one)]
        if better:
            best = min(better, key=lambda one: one.objective)
            _may_stand_for(neighbours, best.hypothesis.effects[-1].name, effect)
            fitted, compared = fit(data, best.hypothesis, last=best.jacobian), {}
        else:
            index += 1
    return fitted, compared


def _one_of_curve(
    data: Data, fitted: Fit, neighbours: dict[str, list[Candidate]], progress: Progress
) -> tuple[Data, Fit]:
    """Put another friction curve and one effect in the place of all that change it, where likelier.

    No single exchange leads there: the curve was refined beside the others. Each model is judged by
    its own noise.
    """
    machine, several = data.machine, _curves_in(fitted)
    if len(several) < 2:
        return data, fitted
    others = [name for name in CURVES if {name, CURVE} != several]
    progress(f"comparing {' and '.join(sorted(several))} with {' or '.join(others)} beside a curve")
    known = {candidate.name: candidate for candidate in machine.candidates()}
    bare = fitted.hypothesis
    for index, effect in reversed(list(enumerate(bare.effects))):
        if effect.effect in several:
            bare = bare.without(index)
    curved = fit(data, bare)
    allowed = fitted.objective + NEARLY_AT_FIRST * (curved.objective - fitted.objective)
    [start] = screen(data, curved, [known[CURVE]])
    [curved] = _refit(data, curved, [start])
    starts = screen(data, curved, [known[name] for name in others])
    best, likeliest, name = (data, fitted), _log_posterior(data, fitted), ""
    for one in side_by_side(lambda start: _refit(data, curved, [start])[0], starts):
        if one.objective > allowed or _within_law(data, curved, one, -1):
            continue
        try:
            other = _with_own_noise(data, one)
        except RunawayError:
            continue
        likelihood = _log_posterior(*other)
        if likelihood > likeliest:
            best, likeliest, name = other, likelihood, one.hypothesis.effects[-1].name
    if not name:
        return best
    own = _with_own_noise(data, fitted)
    if likeliest <= _log_posterior(*own):
        return own
    neighbours[name] = [known[other] for other in CURVES]
    return best


def _curves_in(fitted: Fit) -> set[str]:
    """What changes the friction over slip in this model, the curve itself among it."""
    return {effect.effect for effect in fitted.hypothesis.effects} & {*FRICTION_OVER_SLIP}


def _log_posterior(data: Data, fitted: Fit) -> float:
    """Return the logarithm of the likelihood by the data's noise and of the base parameters'.

    What the rows hide is integrated out. Minus infinity where the filter loses the robot.
    """
    hypothesis = fitted.hypothesis
    values = hypothesis.flat(data.believed)
    tracks = track_all(data.machine, data.runs, values, data.noise)
    prior = prior_penalty(hypothesis, data.believed, hypothesis.x)
    likelihood = sum(t.log_likelihood for t in tracks) + data.hidden_likelihood(values)
    return float(np.nan_to_num(likelihood - 0.5 * np.sum(prior**2), nan=-np.inf))


def _takes_its_place(data: Data, effect: Candidate, own: "_Compared", rival: Fit) -> bool:
    """Whether a rival explains clearly more than an effect, or loses only what chance gives."""
    without, judged = own.without, own.evidence
    evidence = weigh(data, without, rival, len(without.hypothesis.effects))
    candidate, sizes = rival.hypothesis.effects[-1], rival.hypothesis.values_of(-1)
    lost = judged.gain - evidence.gain
    spared = len(effect.parameters) - len(candidate.parameters)
    as_good = spared > 0 and _no_more_than_chance(lost, judged.inflation, spared)
    if not as_good and -lost <= RIVAL_MARGIN * evidence.inflation:
        return False
    if _within_law(data, without, rival, -1):
        return False
    [check] = check_unseen(data, without, [rival])
    return check.helps and not within_row(data, candidate, sizes)


def _rivals_of(
    fitted: Fit, effect: Candidate, neighbours: dict[str, list[Candidate]]
) -> list[Candidate]:
    """What promised most when this effect was chosen, and is not in the model."""
    taken = {one.name for one in fitted.hypothesis.effects}
    return [
        c
        for c in neighbours.get(effect.name, [])
        if c.name not in taken and len(c.parameters) <= len(effect.parameters)
    ]


@dataclass(frozen=True)
class _Compared:
    """An effect of a fitted model beside what could stand in its place, refitted there."""

    without: Fit
    evidence: Evidence
    rivals: list[Fit]

    def lost(self, final: Fit) -> list[float]:
        """Return the gain beyond chance that is lost with each rival in the place of the effect."""
        return [(one.objective - final.objective) / self.evidence.inflation for one in self.rivals]


def _compare(
    data: Data,
    fitted: Fit,
    places: Sequence[int],
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
) -> dict[int, _Compared]:
    """Compare effects of the model, by their numbers, with their nearest rivals."""
    for index in places:
        progress(f"comparing {fitted.hypothesis.effects[index].name} with its rivals")
    found = side_by_side(lambda index: _compared(data, fitted, index, neighbours), places)
    return dict(zip(places, found, strict=True))


def _compare_all(
    data: Data,
    fitted: Fit,
    neighbours: dict[str, list[Candidate]],
    progress: Progress,
    known: dict[int, _Compared] | None = None,
) -> list[_Compared]:
    """Compare every effect of the model with its nearest rivals, beside what is known of that."""
    places, known = range(len(fitted.hypothesis.effects)), known or {}
    others = [index for index in places if index not in known]
    compared = known | _compare(data, fitted, others, neighbours, progress)
    return [compared[index] for index in places]


def _compared(
    data: Data, fitted: Fit, index: int, neighbours: dict[str, list[Candidate]]
) -> _Compared:
    without = fitted.refitted_without(data, index)
    evidence = weigh(data, without, fitted, index)
    rivals = _rivals_of(fitted, fitted.hypothesis.effects[index], neighbours)
    nearest = screen(data, without, rivals)[:RIVALS] if rivals else []
    return _Compared(without, evidence, _refit(data, without, nearest, evidence.gain))


def _likeliest(
    data: Data,
    final: Fit,
    neighbours: dict[str, list[Candidate]],
    tried: int,
    progress: Progress,
    known: dict[int, _Compared] | None = None,
) -> tuple[Data, Fit, list[_Compared]]:
    """Put another effect in the place of one where that is likelier, each model by its own noise.

    Noise that was tuned beside a wrong name takes a part of what that leaves for chance: a delay of
    1.4 ms lost 48 to a lag by noise that fits the lag, and is likelier by exp(143) by its own. What
    is better even by the noise of the other needs no margin. No likelihood judges where a
    controller answers within rows (answers.py).
    """
    settled = set[str]()
    compared = _compare_all(data, final, neighbours, progress, known)
    while _likelihood_judges(data):
        near = [
            (index, rival, lost)
            for index, one in enumerate(compared)
            for rival, lost in zip(one.rivals, one.lost(final), strict=True)
            if lost < max(RIVAL_MARGIN, NEARLY * one.evidence.beyond_chance)
            and rival.hypothesis.effects[-1].name not in settled
            and not within_row(data, rival.hypothesis.effects[-1], rival.hypothesis.values_of(-1))
        ]
        if not near:
            break
        own_likelihood = _log_posterior(*_with_own_noise(data, final))
        likelier = []
        for index, rival, lost in near:
            effect, name = final.hypothesis.effects[index], rival.hypothesis.effects[-1].name
            progress(f"comparing {effect.name} and {name}, each by its own noise")
            try:
                own = _with_own_noise(data, rival)
            except RunawayError:
                continue
            likelihood = _log_posterior(*own)
            margin = 0.0 if lost < -RIVAL_MARGIN else 0.5 * RIVAL_MARGIN
            enough = own_likelihood + margin * compared[index].evidence.inflation
            if likelihood <= enough or _within_law(data, compared[index].without, rival, -1):
                continue
            if _helps_unseen(*own, name):
                likelier.append((likelihood, *own, effect, name))
        if not likelier:
            break
        _, data, final, effect, name = max(likelier, key=lambda one: one[0])
        settled.add(effect.name)
        _may_stand_for(neighbours, name, effect)
        data, final = _patch_settled(data, final)
        final = _whole_numbers(data, _drop_needless(data, final, tried))
        compared = _compare_all(data, final, neighbours, progress)
    return data, final, compared


def _with_own_noise(data: Data, fitted: Fit) -> tuple[Data, Fit]:
    """Settle a model with the noise that fits it, and refine its effects."""
    own, one = settle(data.machine, data.runs, fitted.hypothesis, data.noise, last=fitted.jacobian)
    return own, _extend(data.machine, own, one)


def _helps_unseen(data: Data, fitted: Fit, name: str) -> bool:
    """Whether an effect of the model helps runs that were not fitted."""
    place = fitted.hypothesis.place_of(name)
    [check] = check_unseen(data, fitted.refitted_without(data, place), [fitted.moved_last(place)])
    return check.helps


def _may_stand_for(neighbours: dict[str, list[Candidate]], name: str, effect: Candidate) -> None:
    """Note that an effect which gave way to another may stand in its place."""
    others = [c for c in neighbours.get(effect.name, []) if c.name != effect.name]
    neighbours[name] = [effect, *others]


def _select(
    data: Data, final: Fit, free: Array, compared: Sequence[_Compared]
) -> tuple[Selected, ...]:
    """Judge every effect beside all others; strongest first, the friction curve last.

    A friction curve that is not the believed one is so common that it is rarely the news. What a
    controller's answers feign decides nothing between rivals either.
    """
    selected = []
    named = [i for i, e in enumerate(final.hypothesis.effects) if e.effect != CURVE]
    shapes = shapes_instead(data, final, free, [compared[i].without for i in named])
    instead = dict(zip(named, shapes, strict=True))
    pairs = zip(final.hypothesis.effects, compared, strict=True)
    for index, (effect, one) in enumerate(pairs):
        close = [lost < max(RIVAL_MARGIN, data.feigned_gain) for lost in one.lost(final)]
        names = [rival.hypothesis.effects[-1].name for rival in one.rivals]
        equals = [name for name, near in zip(names, close, strict=True) if near]
        losers = [rival for rival, near in zip(one.rivals, close, strict=True) if not near]
        values = final.hypothesis.values_of(index).copy()
        for i, p in enumerate(effect.parameters):
            if p.label == PHASE:
                values[i] = _half_turn(values[i])
        stability = stability_of(data, final, [one.without, *losers])
        left = _left_by_others(data, one.without, final, index)
        interval = _interval(data, final, index, values, one.evidence)
        evidence, shape = one.evidence, instead.get(index)
        slips = effect.effect in FRICTION_OVER_SLIP
        law = _left_by_law(data, one.without, final) if slips else 0.0
        selected.append(
            Selected(effect, values, interval, evidence, tuple(equals), stability, left, shape, law)
        )
    return tuple(sorted(selected, key=lambda s: (s.candidate.effect == CURVE, -s.evidence.gain)))


def _interval(data: Data, final: Fit, index: int, values: Array, evidence: Evidence) -> Array:
    """Return the ends (parameters, 2) of the values' 95 % intervals.

    Edges and thresholds have them where Q has risen by as much as chance gives: no derivative
    holds there, and what nobody drove over leaves an edge open as far as anybody drove.
    """
    half = CONFIDENCE * np.sqrt(np.diag(final.covariance(index, evidence.inflation)))
    ends = values[:, None] + half[:, None] * EDGE_STEPS
    effect, limit = final.hypothesis.effects[index], CONFIDENCE**2 * evidence.inflation
    lasts = {}
    if effect.edges_m:
        driven_m = effect.edges_m[0], effect.edges_m[-1]
        lasts = {
            edge: (min(driven_m[0], x), max(driven_m[1], x)) for edge, x in enumerate(values[:2])
        }
    if effect.effect in THRESHOLDS:
        number = THRESHOLDS[effect.effect]
        lasts = {number: (values[number] / THRESHOLD_SPAN, values[number] * THRESHOLD_SPAN)}
    for number, two in lasts.items():
        ends[number] = [_profile_end(data, final, index, number, last, limit) for last in two]
    return ends


def _profile_end(
    data: Data, final: Fit, index: int, number: int, last: float, limit: float
) -> float:
    """Return the first value of a parameter towards `last` at which Q has risen by limit, or last.

    The other effects are moved by one linear step. Steps double; the last is cut into eighths.
    """
    shared, moved = final.sharing(index), final.hypothesis.moved_last(index)
    effect, sizes = moved.effects[-1], moved.values_of(-1)

    def furthest(values: Array) -> int:
        offered = [shared.hypothesis.with_effect(effect, sizes)]
        for value in values:
            other = sizes.copy()
            other[number] = value
            offered.append(shared.hypothesis.with_effect(effect, other))
        costs = costs_refitted(data, shared, offered)
        return int(np.flatnonzero(costs[1:] - costs[0] < limit).max(initial=-1))

    away = sizes[number] + (last - sizes[number]) * np.concatenate([[0.0], PROFILE_STEPS])
    reached = furthest(away)
    if reached == len(away) - 1:
        return last
    between = np.linspace(away[reached], away[reached + 1], PROFILE_BETWEEN)
    return float(between[max(furthest(between[:-1]), 0) + 1])


def stability_of(data: Data, final: Fit, others: Sequence[Fit]) -> float:
    """Return in which share of resamples of the runs `final` explains as much as all others.

    The fits stay as they are and only the units of runs are drawn anew (resampling of estimated log
    likelihoods: Kishino, Miyata and Hasegawa, J. Mol. Evol. 1990).
    """
    units = int(data.units.max()) + 1
    if units < LEAST_UNITS_TO_RESAMPLE:
        return float("nan")
    squares = [[np.sum(r**2) for r in data.per_run(one.residual)] for one in [final, *others]]
    of_units = data.per_unit(np.array(squares).T)
    lead = of_units[:, 1:] - of_units[:, :1]
    draws = np.random.default_rng(0).multinomial(units, np.full(units, 1.0 / units), RESAMPLES)
    return float(np.mean(np.all(draws @ lead > -EQUAL, axis=1)))


def _limits(machine: Machine, screened: Sequence[Screened]) -> dict[str, dict[str, float]]:
    """Return by effect what `_limit` says."""
    return {one.candidate.name: _limit(machine, one) for one in screened}


def _limit(machine: Machine, screened: Screened) -> dict[str, float]:
    """Smallest size of each parameter that this data would have shown; absent means size 0.

    Of a size that is infinite when absent the largest, if there is one.
    """
    candidate, limits = screened.candidate, {}
    for limit, index in zip(screened.limit, candidate.amplitudes, strict=True):
        parameter = candidate.parameters[index]
        if np.isfinite(machine.believed[parameter.places[0]]):
            limit = abs(_reach(candidate, machine, index)) * limit
        if limit > 0:
            limits[machine.file_parameter(parameter.label)] = float(limit)
    return limits
