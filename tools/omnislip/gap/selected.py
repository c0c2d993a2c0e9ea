"""The effects of the final model: sizes with intervals, rivals that do as well, stability."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import EQUAL, Data, Evidence, Fit, costs_refitted
from omnislip.gap.judge import LAW_ENTERS, left_by_law, left_by_others
from omnislip.gap.leftover import Shape, shapes_instead
from omnislip.gap.machine import CURVE, PHASE, Candidate
from omnislip.gap.refit import THRESHOLDS
from omnislip.gap.rivals import RIVAL_MARGIN, Compared
from omnislip.gap.screen import half_turn

Array = npt.NDArray[np.float64]

RESAMPLES, LEAST_UNITS_TO_RESAMPLE = 1000, 4
THRESHOLD_SPAN = 2.0**0.5
"""How far around a threshold its interval is sought."""
CONFIDENCE = 1.959964
"""Standard deviations of a 95 % interval."""
PROFILE_STEPS, PROFILE_BETWEEN = 0.5 ** np.arange(12.0, -1.0, -1.0), 9
"""Where between a value and its last an end of its interval is looked for, and places in the step
that holds the end."""


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
    """Gain that it may owe to the law of friction, off on any floor; 0 for what is of its own."""


def select_effects(
    data: Data, final: Fit, free: Array, compared: Sequence[Compared]
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
                values[i] = half_turn(values[i])
        stability = stability_of(data, final, [one.without, *losers])
        left = left_by_others(data, one.without, final, index)
        interval = find_interval(data, final, index, values, one.evidence)
        evidence, shape = one.evidence, instead.get(index)
        law = left_by_law(data, one.without, final) if effect.effect in LAW_ENTERS else 0.0
        selected.append(
            Selected(effect, values, interval, evidence, tuple(equals), stability, left, shape, law)
        )
    return tuple(sorted(selected, key=lambda s: (s.candidate.effect == CURVE, -s.evidence.gain)))


def find_interval(data: Data, final: Fit, index: int, values: Array, evidence: Evidence) -> Array:
    """Return the ends (parameters, 2) of the values' 95 % intervals.

    Edges and thresholds have them where Q has risen by as much as chance gives: no derivative
    holds there, and what nobody drove over leaves an edge open as far as anybody drove.
    """
    half = CONFIDENCE * np.sqrt(np.diag(final.covariance(index, evidence.inflation)))
    ends = values[:, None] + half[:, None] * [-1.0, 1.0]
    effect, limit = final.hypothesis.effects[index], CONFIDENCE**2 * evidence.inflation
    lasts = {}
    for edge, driven_m in enumerate(effect.edges_m):
        lasts[edge] = min(driven_m[0], values[edge]), max(driven_m[-1], values[edge])
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
