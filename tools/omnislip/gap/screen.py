"""The gain that one linear step from a model promises of each candidate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip.gap.floor import best_places
from omnislip.gap.inference import VISIBLE_GAIN, Data, Fit, Hypothesis, solve_within
from omnislip.gap.machine import PHASE, Candidate, Machine
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Screened:
    """A candidate with the gain that the linearised model promises and the sizes to start from."""

    promise: float
    candidate: Candidate
    start: Array


def screen(data: Data, current: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Rank candidates by the gain that one linear step from the current model promises."""
    variants = []
    for candidate in candidates:
        if candidate.edges_m:
            variants += best_places(data, current, candidate)
        else:
            variants += [(candidate, start) for start in candidate.starts]
    points, owners = [], []
    for number, (candidate, start) in enumerate(variants):
        for amplitude in candidate.amplitudes:
            moved = _moved(data, current.hypothesis, candidate, start, amplitude)
            points.append(moved.flat(data.believed))
            owners.append(number)
    columns = (data.residuals(np.stack(points)) - current.residual).T

    def promise(number: int) -> Screened:
        own = [i for i, o in enumerate(owners) if o == number]
        return _promise(data, current, *variants[number], columns[:, own])

    ranked: dict[str, Screened] = {}
    promises = side_by_side(promise, range(len(variants)))
    for (candidate, _), found in zip(variants, promises, strict=True):
        best = ranked.setdefault(candidate.name, found)
        # A patch that ends across x, too, is one of far more.
        dearer = VISIBLE_GAIN * (len(candidate.spans) - len(best.candidate.spans))
        if found.promise > best.promise + dearer:
            ranked[candidate.name] = found
    return sorted(ranked.values(), key=lambda s: -s.promise)


def neutral_sizes(
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


def reach_of(candidate: Candidate, machine: Machine, amplitude: int) -> float:
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
    sizes = neutral_sizes(data, current, candidate, start)
    reach = reach_of(candidate, data.machine, amplitude)
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
) -> Screened:
    """Take one linear step of everything: keys that rest on a bound for its lack come back, too.

    `columns` (m, amplitudes) is what a step of the screen changes.
    """
    start = dict(start)
    phase = [i for i, p in enumerate(candidate.parameters) if p.label == PHASE]
    if phase and columns[:, 0] @ current.residual > 0:  # a wave the other way round
        columns = -columns
        start[phase[0]] = half_turn(start[phase[0]] + np.pi)
    cross = current.jacobian.T @ columns
    whole = np.block([[current.information, cross], [cross.T, columns.T @ columns]])
    slope = np.concatenate([current.slope(data.believed), columns.T @ current.residual])
    low, high = possible_amounts(data, current.hypothesis, candidate)
    below, above = current.hypothesis.room()
    step = solve_within(whole, slope, np.append(below, low), np.append(above, high))
    promise = float(-2.0 * slope @ step - step @ whole @ step)
    amount = step[len(below) :]
    sizes = np.zeros(len(candidate.parameters))
    for index, value in start.items():
        sizes[index] = value
    for k, index in enumerate(candidate.amplitudes):
        sizes[index] = start.get(index, amount[k])
    return Screened(promise, candidate, sizes)


def half_turn(angle_rad: float) -> float:
    """Return the angle within -pi..pi."""
    return float(np.mod(angle_rad + np.pi, 2 * np.pi) - np.pi)


def possible_amounts(data: Data, current: Hypothesis, candidate: Candidate) -> tuple[Array, Array]:
    """Bounds of the amplitudes in steps of the screen."""
    neutral = neutral_sizes(data, current, candidate)
    low, high = np.empty(len(candidate.amplitudes)), np.empty(len(candidate.amplitudes))
    for k, index in enumerate(candidate.amplitudes):
        p, absent = candidate.parameters[index], neutral[index]
        reach = reach_of(candidate, data.machine, index)
        if np.isfinite(absent):
            low[k], high[k] = sorted(((p.low - absent) / reach, (p.high - absent) / reach))
        else:
            low[k], high[k] = 0.0, 1.0
    return low, high
