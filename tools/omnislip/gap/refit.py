"""Candidates fitted beside all of a model: from several sizes, quickly, the best of them fully.

Where no derivative leads, to edges of a patch and to thresholds, places are tried.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from omnislip.gap.floor import move_edges
from omnislip.gap.inference import (
    VISIBLE_GAIN,
    Data,
    Fit,
    Hypothesis,
    at_bound,
    costs_refitted,
    fit,
    fit_more,
    weigh,
)
from omnislip.gap.judge import ALPHA, LEAST_PROMISE, differs_from_none, no_more_than_chance
from omnislip.gap.machine import PHASE, WHOLE, Candidate, Machine
from omnislip.gap.screen import Screened, half_turn, neutral_sizes, reach_of
from omnislip.gap.settle import SETTLED, settle
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]

FULL_REFITS = 3
NEAR, NEAR_TO_FULL = 0.7, 0.5
"""Share of the best quick fit's gain, and of the gain that is asked of a full one, that a quick fit
must reach to be fitted fully."""
PATCH_SHARE = 0.2
"""Share of the best promise from which the edges of a patch are looked for: those of the screen are
coarse, but explain more than a fifth of what the right ones do."""
NEAR_BY_PLACES = 0.5
"""Share of the best gain that a patch must reach by the places of a grid for finer ones, and no
less than stands out from chance: most logs know no patch."""
THRESHOLDS = {"encoder_dropout": 1}
"""Parameters that only the rows show in which a speed passes them."""
THRESHOLD_PLACES, THRESHOLD_BEYOND = 57, (0.6, 1.05)
THRESHOLD_STEPS = tuple(1.035 ** (0.5**halving) for halving in range(1, 5))
SIZE_FACTORS = (0.8, 1.0, 1.25)
"""Places of a threshold over its starts and a share beyond, by 3.5 % from one to the next, for its
valley is as narrow; steps from the best; factors of the size."""


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
        sizes = neutral_sizes(data, current, candidate, shapes)
        for index in candidate.amplitudes:
            if not np.isfinite(sizes[index]):
                sizes[index] = screened.start[index]
                continue
            amount = float(np.clip(share * screened.start[index], -most, most))
            sizes[index] = sizes[index] + reach_of(candidate, data.machine, index) * amount
        starts.append(np.clip(sizes, low + margin, high - margin))
    return list(np.unique(starts, axis=0))


def refit_each(
    data: Data, current: Fit, screened: Sequence[Screened], asked: float = LEAST_PROMISE
) -> list[Fit]:
    """Fit the current model with one more effect, each from the better of its starts.

    All of them quickly, fully those that may be the best and gain what is `asked`.
    """
    fits = refit_quickly(data, current, screened)
    order = np.argsort([one.objective for one in fits])
    best = current.objective - min((one.objective for one in fits), default=np.inf)
    least = max(NEAR * best, NEAR_TO_FULL * asked)
    hopeful = [k for k in order[:FULL_REFITS] if current.objective - fits[k].objective > least]
    whole = side_by_side(lambda k: fit(data, fits[k].hypothesis, last=fits[k].jacobian), hopeful)
    for k, one in zip(hopeful, whole, strict=True):
        fits[k] = one
    return fits


def refit_quickly(data: Data, current: Fit, screened: Sequence[Screened]) -> list[Fit]:
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
    return move_edges(data, current, start, wanted) if candidate.edges_m else start


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


def place_again(data: Data, fitted: Fit, first: int = 0) -> Fit:
    """Move the edges of a patch or a threshold again, beside the other effects as they are.

    If it is of effect number `first` or a later one.
    """
    for index, effect in enumerate(fitted.hypothesis.effects):
        if (effect.edges_m or effect.effect in THRESHOLDS) and index >= first:
            start = fitted.hypothesis.moved_last(index)
            moved = fit(data, _edges_moved(data, fitted.sharing(index), start))
            fitted = moved if moved.objective < fitted.objective else fitted
    return fitted


def _without_needless_edges(data: Data, fitted: Fit, patch: Candidate) -> Fit:
    """Return the model with a patch that ends along x only, if that explains as much as `patch`."""
    index = fitted.hypothesis.place_of(patch.name)
    shared, values = fitted.sharing(index), fitted.hypothesis.values_of(index)
    kept = [0, 1, *patch.amplitudes]
    spill = shared.hypothesis.with_effect(patch, values)
    band = shared.hypothesis.with_effect(patch.along_x(), values[kept])
    costs = costs_refitted(data, shared, [spill, band])
    inflation = weigh(data, fitted.refitted_without(data, index), fitted, index).inflation
    across = len(values) - len(kept)
    needless = no_more_than_chance(float(costs[1] - costs[0]), inflation, across)
    return fit(data, band) if needless else fitted


def settle_placed(data: Data, fitted: Fit) -> tuple[Data, Fit]:
    """Move edges and thresholds again, and settle with the noise that is left where they moved.

    A patch ends across x only where that explains more than chance.
    """
    moved = place_again(data, fitted)
    for effect in moved.hypothesis.effects:
        if len(effect.spans) > 1:
            moved = _without_needless_edges(data, moved, effect)
    if fitted.objective - moved.objective < SETTLED:
        return data, moved
    return settle(data.machine, data.runs, moved.hypothesis, data.noise, last=moved.jacobian)


def extend_effects(machine: Machine, data: Data, fitted: Fit) -> Fit:
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
    offered = [Screened(0.0, one, np.array([0.1])) for one in machine.refinements(effect)]
    ordered, passing = fitted.moved_last(place), []
    for one, refined in zip(offered, refit_each(data, ordered, offered), strict=True):
        evidence = weigh(data, ordered, refined, index)
        absent = neutral_sizes(data, ordered.hypothesis, one.candidate)
        differs = differs_from_none(
            one.candidate, refined.hypothesis.values_of(-1) - absent, evidence
        )
        bound = at_bound(refined, len(refined.hypothesis.x) - 1)
        if evidence.p_value < ALPHA and differs and not bound:
            passing.append(refined)
    best = min(passing, key=lambda one: one.objective, default=None)
    return None if best is None else replace(best, hypothesis=best.hypothesis.last_two_joined())


def whole_numbers(data: Data, fitted: Fit) -> Fit:
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
                if no_more_than_chance(lost, inflation, 1):
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
        turned = half_turn(moved) if parameter.label == PHASE else moved
        sizes[k] = np.clip(turned, parameter.low, parameter.high)
    x = held.x.copy()
    x[places] = sizes
    return replace(held, x=x)
