"""Which effects are missing: forward search with full refits, then drop and swap.

Each step screens the whole catalogue with secants (one batch), refits the most promising
candidates fully, and takes the best one if all of these hold:

    chance       p-value of its gain, times the number of things tried, below `ALPHA`
    validation   on runs that were not fitted the gain is positive in sum, and in 3 of 4 runs or
                 beyond its scatter from run to run
    size         at least `LEAST_SHARE` of all that effects have gained so far

The base keys are refitted with every candidate, because they absorb much of most effects. After a
step the noise is tuned again (an explained defect no longer counts as noise), and every accepted
effect must still be needed. At the end every effect is compared with its rivals in its place: those
that do as well within `RIVAL_MARGIN` cannot be told from it with these logs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2
from scipy.stats import t as student

from omnislip.gap.inference import (
    Data,
    Evidence,
    Fit,
    Hypothesis,
    fit,
    free_of_fitted,
    inflation_of,
    objective,
    weigh,
)
from omnislip.gap.leftover import Leftover, find_leftover
from omnislip.gap.machine import Candidate, Machine
from omnislip.gap.noise import Noise, tune_noise
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]

ALPHA = 0.01
LEAST_SHARE = 0.01
MOST_EFFECTS = 4
REFITS = 12
VISIBLE_GAIN = 25.0
LEAST_PROMISE = 8.0
"""Promised gain below which no refit could bring a candidate past the threshold of chance."""
RIVAL_MARGIN = 10.0
DROP_P_VALUE = 0.01
CONVERGED = 0.05
"""Share of a candidate's gain that refitting without it may find."""
VALIDATION_SHARE = 0.75
SCATTER_P_VALUE = 0.01
SHORTEST_LAG_ROWS = 0.1


@dataclass(frozen=True)
class Trial:
    """A candidate as it was tried in one step, and why it was taken or not."""

    step: int
    candidate: Candidate
    values: Array
    evidence: Evidence
    validation_gain: float
    reason: str
    accepted: bool


@dataclass(frozen=True)
class Selected:
    """One effect of the final model with its evidence and the rivals that do as well."""

    candidate: Candidate
    values: Array
    evidence: Evidence
    rivals: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What the search found: the base fit, the final fit, every trial, limits of detection."""

    base: Fit
    final: Fit
    ladder: tuple[Fit, ...]
    """Refits on all runs but the held-out ones: base, with the first effect, the first two, ..."""
    selected: tuple[Selected, ...]
    trials: tuple[Trial, ...]
    leftover: tuple[Leftover, ...]
    """What the final model leaves and no effect of the catalogue explains, strongest first."""
    limits: dict[str, dict[str, float]]
    data: Data


@dataclass(frozen=True)
class Screened:
    """A candidate with the gain that the linearised model promises and the sizes to start from."""

    promise: float
    candidate: Candidate
    start: Array
    limit: Array
    """Sizes, in steps of the screen, whose gain would stand out from chance."""


def search(
    machine: Machine,
    fitting: Sequence[Run],
    validation: Sequence[Run],
    noise: Noise | None,
    progress: Progress,
) -> Outcome:
    """Find the missing effects on `fitting` and `validation` runs, from a first `noise` or none."""
    candidates = machine.candidates()
    tried = sum(len(candidate.starts) for candidate in candidates)
    progress("fitting the believed model")
    data, base = settle(machine, fitting, believed_hypothesis(machine), noise)
    base_values = base.hypothesis
    current, trials, gained = base, [], 0.0
    limits = None
    for step in range(1, MOST_EFFECTS + 1):
        progress(f"step {step}: screening {len(candidates)} effects")
        screened = screen(data, current, candidates)
        if limits is None:
            limits = {s.candidate.name: _limit(machine, s) for s in screened}
        checks = Data(machine, validation, data.noise, current.hypothesis.flat(machine.believed))
        worth = [s for s in screened[:REFITS] if s.promise > LEAST_PROMISE]
        found = _try(data, checks, current, worth, step, tried, gained, progress)
        trials += [trial for trial, _ in found]
        accepted = [(trial, fitted) for trial, fitted in found if trial.accepted]
        if not accepted:
            break
        trial, fitted = accepted[0]
        without = fit(data, fitted.hypothesis.without(len(current.hypothesis.effects)))
        if without.objective < current.objective - CONVERGED * max(1.0, trial.evidence.gain):
            current = without  # the gain was that of the keys, which had not settled
            continue
        gained += trial.evidence.gain
        data, current = settle(machine, fitting, fitted.hypothesis, data.noise)
        current = _drop_needless(data, _extend(machine, data, current))
        taken = {effect.name for effect in current.hypothesis.effects}
        candidates = [c for c in candidates if c.name not in taken]
    progress("looking for what no effect explains")
    checks = Data(machine, validation, data.noise, current.hypothesis.flat(machine.believed))
    leftover = find_leftover(data, checks, current)
    progress("fitting the final model on all runs but the held-out ones")
    data, final = settle(machine, [*fitting, *validation], current.hypothesis, data.noise)
    ladder = _ladder(data, base_values, final)
    selected = _compare_rivals(machine, data, final, progress)
    return Outcome(
        ladder[0], final, ladder, selected, tuple(trials), tuple(leftover), limits or {}, data
    )


def believed_hypothesis(machine: Machine) -> Hypothesis:
    """Return the believed model: no effect, every key that may move at its value."""
    base = tuple(machine.base_parameters())
    return Hypothesis(base, (), np.array([machine.believed[p.places[0]] for p in base]))


def settle(
    machine: Machine, runs: Sequence[Run], start: Hypothesis, noise: Noise | None = None
) -> tuple[Data, Fit]:
    """Tune the noise at `start`, fit, and once more from there: predictor and model agree.

    With a `noise` to start from, one tuning is enough.
    """
    hypothesis = start
    tunings = 2 if noise is None else 1
    for round_number in range(2):
        values = hypothesis.flat(machine.believed)
        if round_number < tunings:
            noise = tune_noise(machine, runs, values, noise)
        data = Data(machine, runs, noise, values)
        fitted = fit(data, hypothesis)
        hypothesis = fitted.hypothesis
    return data, fitted


def _ladder(data: Data, base: Hypothesis, final: Fit) -> tuple[Fit, ...]:
    """Add the effects of the final model one by one, in the order in which they were found."""
    rungs = [fit(data, base)]
    hypothesis = final.hypothesis
    for index, effect in enumerate(hypothesis.effects[:-1]):
        start = rungs[-1].hypothesis.with_effect(effect, hypothesis.values_of(index))
        rungs.append(fit(data, start))
    return (*rungs, final) if hypothesis.effects else tuple(rungs)


def screen(data: Data, current: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Rank candidates by the gain that one linear step from the current model promises."""
    variants = [(c, start) for c in candidates for start in c.starts]
    points, owners = [], []
    flat = current.hypothesis.flat(data.believed)
    for number, (candidate, start) in enumerate(variants):
        for amplitude in candidate.amplitudes:
            points.append(_moved(data.machine, flat, candidate, start, amplitude))
            owners.append(number)
    residuals = data.residuals(np.stack(points))
    ranked: dict[str, Screened] = {}
    for number, (candidate, start) in enumerate(variants):
        columns = (residuals[[i for i, o in enumerate(owners) if o == number]] - current.residual).T
        found = _promise(data, current, candidate, start, columns)
        best = ranked.get(candidate.name)
        if best is None or found.promise > best.promise:
            ranked[candidate.name] = found
    return sorted(ranked.values(), key=lambda s: -s.promise)


def _neutral(candidate: Candidate, machine: Machine, start: dict[int, float]) -> Array:
    """Sizes of the candidate when it is absent, shaping parameters at `start`."""
    values = np.array([machine.believed[p.places[0]] for p in candidate.parameters])
    values[list(start)] = list(start.values())
    return values


def _reach(candidate: Candidate, machine: Machine, amplitude: int) -> float:
    """Change from absence to a size worth looking for; from infinity it is the size itself."""
    parameter = candidate.parameters[amplitude]
    neutral = machine.believed[parameter.places[0]]
    sign = machine.sign_of(candidate.effect, parameter.label)
    return parameter.scale * sign if np.isfinite(neutral) else parameter.scale


def _moved(
    machine: Machine, flat: Array, candidate: Candidate, start: dict[int, float], amplitude: int
) -> Array:
    sizes = _neutral(candidate, machine, start)
    reach = _reach(candidate, machine, amplitude)
    sizes[amplitude] = sizes[amplitude] + reach if np.isfinite(sizes[amplitude]) else reach
    return machine.with_effect(flat, candidate, sizes)


def _promise(
    data: Data, current: Fit, candidate: Candidate, start: dict[int, float], columns: Array
) -> Screened:
    free = free_of_fitted(current, columns)
    gram = free.T @ free
    right = free.T @ current.residual
    amount = -np.linalg.lstsq(gram + 1e-12 * np.eye(len(gram)), right, rcond=None)[0]
    promise = float(-right @ amount)
    sizes = np.zeros(len(candidate.parameters))
    for index, value in start.items():
        sizes[index] = value
    for k, index in enumerate(candidate.amplitudes):
        sizes[index] = amount[k]
    inflation = inflation_of(data, free, current.residual + free @ amount, gram)
    limit = np.sqrt(VISIBLE_GAIN * inflation / np.maximum(np.diag(gram), 1e-12))
    return Screened(promise, candidate, sizes, limit)


def _starting_sizes(machine: Machine, screened: Screened) -> list[Array]:
    """Sizes to start a fit from: hardly there, and the linear estimate up to twice typical."""
    candidate = screened.candidate
    shapes = {i: float(v) for i, v in enumerate(screened.start) if i not in candidate.amplitudes}
    low = np.array([p.low for p in candidate.parameters])
    high = np.array([p.high for p in candidate.parameters])
    margin = np.array([0.01 * p.scale for p in candidate.parameters])
    starts = []
    for most in (0.02, 2.0):
        sizes = _neutral(candidate, machine, shapes)
        for index in candidate.amplitudes:
            reach = _reach(candidate, machine, index)
            amount = float(np.clip(screened.start[index], -most, most))
            sizes[index] = sizes[index] + reach * amount if np.isfinite(sizes[index]) else reach
        starts.append(np.clip(sizes, low + margin, high - margin))
    return starts


def _refit(data: Data, current: Fit, screened: Screened) -> Fit:
    """Fit the current model with one more effect, from the better of the starts."""
    starts = [
        current.hypothesis.with_effect(screened.candidate, sizes)
        for sizes in _starting_sizes(data.machine, screened)
    ]
    costs = objective(data, starts[0], np.stack([start.x for start in starts]))
    return fit(data, starts[int(np.argmin(costs))])


def _try(
    data: Data,
    checks: Data,
    current: Fit,
    screened: Sequence[Screened],
    step: int,
    tried: int,
    gained: float,
    progress: Progress,
) -> list[tuple[Trial, Fit]]:
    """Refit each candidate and judge it; best first."""
    results = []
    for number, one in enumerate(screened, 1):
        progress(f"step {step}: trying {one.candidate.name} ({number} of {len(screened)})")
        fitted = _refit(data, current, one)
        index = len(current.hypothesis.effects)
        results.append((one.candidate, fitted, weigh(data, current.objective, fitted, index)))
    results = _simplest_first(results)
    found: list[tuple[Trial, Fit]] = []
    for candidate, fitted, evidence in results:
        gains = _validation_gains(checks, current.hypothesis, fitted.hypothesis)
        values = fitted.hypothesis.values_of(len(current.hypothesis.effects))
        absent = _neutral(candidate, data.machine, {})
        reason, passed = _verdict(evidence, gains, tried, gained)
        if passed and not _differs(candidate, values - absent, evidence):
            reason, passed = "its size cannot be told from none beside the other parameters", False
        if passed and _within_row(data, candidate, values):
            reason, passed = "shorter than the log can time: a tenth of a row", False
        taken = next((trial for trial, _ in found if trial.accepted), None)
        if passed and taken:
            reason, passed = f"explains less than {taken.candidate.name}", False
        gain = float(np.sum(gains))
        found.append((Trial(step, candidate, values, evidence, gain, reason, passed), fitted))
    return found


def _simplest_first(
    results: list[tuple[Candidate, Fit, Evidence]],
) -> list[tuple[Candidate, Fit, Evidence]]:
    """Sort by gain; a candidate with fewer parameters wins where the others gain nothing on it.

    The gain of each additional parameter has to exceed what chance gives one in a thousand.
    """
    if not results:
        return []
    results = sorted(results, key=lambda r: -r[2].gain)
    best = results[0]
    for rival in results[1:]:
        spared = len(best[0].parameters) - len(rival[0].parameters)
        lost = (best[2].gain - rival[2].gain) / best[2].inflation
        if spared > 0 and lost < chi2.isf(1e-3, spared):
            best = rival
    return [best, *(r for r in results if r is not best)]


def _validation_gains(checks: Data, without: Hypothesis, with_effect: Hypothesis) -> Array:
    """Fall of the squared prediction error in each validation run."""
    flats = np.stack([without.flat(checks.believed), with_effect.flat(checks.believed)])
    before, after = (checks.per_run(r) for r in checks.residuals(flats))
    return np.array([np.sum(b**2) - np.sum(a**2) for b, a in zip(before, after, strict=True)])


def _verdict(evidence: Evidence, gains: Array, tried: int, gained: float) -> tuple[str, bool]:
    chance = min(1.0, evidence.p_value * tried)
    if chance >= ALPHA:
        return f"could be chance (p = {chance:.2g} over everything tried)", False
    if np.sum(gains) <= 0:
        return "makes runs worse that were not fitted", False
    if not helps_most(gains):
        helped = int(np.sum(gains > 0))
        return f"helps only {helped} of {len(gains)} runs that were not fitted", False
    if evidence.gain < LEAST_SHARE * gained:
        return "real perhaps, but under 1 % of what was found", False
    return "explains more than any other effect", True


def helps_most(gains: Array) -> bool:
    """Whether 3 of 4 runs gain or the mean gain is beyond the scatter from run to run (t-test).

    The second is for many runs of which some hardly excite the effect: their gain is nearly 0, of
    either sign, and should not outvote the others.
    """
    if np.mean(gains > 0) >= VALIDATION_SHARE:
        return True
    error = np.std(gains, ddof=1) / np.sqrt(len(gains)) if len(gains) > 1 else np.inf
    return bool(np.mean(gains) > error * student.isf(SCATTER_P_VALUE, max(len(gains) - 1, 1)))


def _within_row(data: Data, candidate: Candidate, sizes: Array) -> bool:
    """Whether a lag is so short that it may be the averaging of the command over a row."""
    resistance = float(data.machine.model.values.get("motor.resistance_ohm", 1.0))
    seconds = {
        "actuation_delay": sizes[0],
        "driver_lag": sizes[0],
        "armature_inductance": sizes[0] / resistance,
    }
    row_s = float(np.median(np.diff(data.runs[0].t_s)))
    return seconds.get(candidate.effect, np.inf) < SHORTEST_LAG_ROWS * row_s


def _differs(candidate: Candidate, sizes: Array, evidence: Evidence) -> bool:
    """Whether any size is two standard deviations from none, all other parameters left free."""
    deviations = np.sqrt(np.maximum(np.diag(evidence.covariance), 0.0))
    return any(
        not np.isfinite(sizes[i]) or abs(sizes[i]) > 2.0 * deviations[i]
        for i in candidate.amplitudes
    )


def _extend(machine: Machine, data: Data, fitted: Fit) -> Fit:
    """Refine the last effect of the model where that gains more than chance."""
    last = fitted.hypothesis.effects[-1]
    for extension in machine.extensions(last.effect):
        one = Screened(0.0, extension, np.array([0.1]), np.array([np.inf]))
        refined = _refit(data, fitted, one)
        index = len(fitted.hypothesis.effects)
        if weigh(data, fitted.objective, refined, index).p_value < ALPHA:
            fitted = replace(refined, hypothesis=refined.hypothesis.last_two_joined())
    return fitted


def _drop_needless(data: Data, fitted: Fit) -> Fit:
    """Drop effects that the later ones have made superfluous."""
    index = 0
    while index < len(fitted.hypothesis.effects) and len(fitted.hypothesis.effects) > 1:
        without = fit(data, fitted.hypothesis.without(index))
        if weigh(data, without.objective, fitted, index).p_value > DROP_P_VALUE:
            fitted = without
        else:
            index += 1
    return fitted


def _compare_rivals(
    machine: Machine, data: Data, final: Fit, progress: Progress
) -> tuple[Selected, ...]:
    selected = []
    taken = {effect.name for effect in final.hypothesis.effects}
    for index, effect in enumerate(final.hypothesis.effects):
        progress(f"comparing {effect.name} with its rivals")
        without = fit(data, final.hypothesis.without(index))
        evidence = weigh(data, without.objective, final, index)
        others = [c for c in machine.candidates() if c.name not in taken]
        rivals = []
        simple = [c for c in others if len(c.parameters) <= len(effect.parameters)]
        for one in screen(data, without, simple)[:4]:
            worse = (_refit(data, without, one).objective - final.objective) / evidence.inflation
            if worse < RIVAL_MARGIN:
                rivals.append(one.candidate.name)
        values = final.hypothesis.values_of(index)
        selected.append(Selected(effect, values, evidence, tuple(rivals)))
    return tuple(selected)


def _limit(machine: Machine, screened: Screened) -> dict[str, float]:
    """Smallest size of each parameter that this data would have shown; absent means size 0."""
    candidate = screened.candidate
    return {
        machine.file_parameter(candidate.parameters[index].label): float(
            abs(_reach(candidate, machine, index)) * screened.limit[k]
        )
        for k, index in enumerate(candidate.amplitudes)
        if np.isfinite(machine.believed[candidate.parameters[index].places[0]])
    }
