"""Where in the floor a patch of other grip lies.

The body is in one place at a time, and of where it was an innovation knows a few rows. So what a
patch changes is the sum of what its parts do: cells or strips of the floor are replayed each, and
every patch that is made of them is judged by sums, its grip by one linear step:

    r = r0 + a sum c_k,    promise = max over a of Q(r0) - Q(r),

c_k what part k changes, free of what the other parameters of the model explain.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import numpy.typing as npt

from omnislip.gap.inference import EQUAL, Data, Fit, Hypothesis, absorbed, costs_refitted
from omnislip.gap.machine import Candidate

Array = npt.NDArray[np.float64]

FULL_GRIP = 1.0
LEAST_PROBE = 0.05
"""Share of the grip that a strip of the floor is given less, at least, to see what it changes."""
FINE_PLACES, EDGE_HALVINGS, EDGE_STEPS = np.linspace(-1.0, 1.0, 33), 3, np.array([-1.0, 1.0])
"""Edges move over a grid, then each over a finer one (beside the right effects 10 mm decide), then
by halves, quarters and eighths of its spacing."""
ROUNDS, PROMISING = 2, 8
"""How often all edges move, at most, and how many of the places on the grid are replayed."""


def best_places(
    data: Data, current: Fit, patch: Candidate
) -> list[tuple[Candidate, dict[int, float]]]:
    """Return the patch of whole cells that promises most, and its edges: along x, and across, too.

    The cells are those that `patch` starts from.
    """
    cells = np.array([list(start.values()) for start in patch.starts])
    [size] = patch.amplitudes
    grip = FULL_GRIP - patch.parameters[size].scale
    amounts = _amounts(patch, grip)
    none, changes = _changes(
        data, current, patch, np.column_stack([cells, np.full(len(cells), grip)])
    )
    spans = [list(combinations(np.unique(cells[:, list(span)]), 2)) for span in patch.spans]
    within = [
        np.array([(cells[:, low] >= a) & (cells[:, high] <= b) for a, b in places])
        for (low, high), places in zip(patch.spans, spans, strict=True)
    ]
    kinds = [(patch.along_x(), list(product(spans[0])), within[0])]
    if len(spans) > 1:
        boxes = (within[0][:, None] & within[1]).reshape(-1, len(cells))
        kinds.append((patch, list(product(*spans)), boxes))
    found = []
    for kind, places, unions in kinds:
        unions[unions.all(axis=1)] = False  # all of the floor is no patch
        promises, _ = _promises(data, none, changes, unions.astype(float), amounts)
        edges_m = np.concatenate(places[int(np.argmax(promises))])
        found.append((kind, {k: float(edge_m) for k, edge_m in enumerate(edges_m)}))
    return found


def move_edges(data: Data, current: Fit, start: Hypothesis, wanted: float) -> Hypothesis:
    """Move the edges of a patch, the last effect of `start`, to where they explain most.

    No derivative leads there: only rows at an edge itself have one. The other effects stay.
    `current` is the model without the patch. Edges are refined where the model costs no more than
    `wanted`.
    """
    patch = start.effects[-1]
    for _ in patch.spans:  # where it ends along x decides about where it does across
        for span in patch.spans:
            start = _over_grid(data, current, start, span)
    if costs_refitted(data, current, [start])[0] > wanted:
        return start
    for _ in range(ROUNDS):
        before = start
        for edge, grid_m in enumerate(patch.edges_m):
            spacing_m = grid_m[1] - grid_m[0]
            fine_m = spacing_m * np.diff(FINE_PLACES).max()
            steps_m = [fine_m * EDGE_STEPS / 2**level for level in range(1, EDGE_HALVINGS + 1)]
            for near_m in (spacing_m * FINE_PLACES, *steps_m):
                start = _edge_moved(data, current, start, edge, near_m)
        if start is before:
            break
    return start


def _over_grid(data: Data, current: Fit, start: Hypothesis, span: tuple[int, int]) -> Hypothesis:
    """Move two opposite edges of the patch over the grid, its grip with them, to what costs least.

    Of those that promise most: in a closed loop, what could be foreseen is no sum of its parts.
    """
    patch, now = start.effects[-1], start.values_of(-1).copy()
    [size], edges, grid_m = patch.amplitudes, list(span), np.array(patch.edges_m[span[0]])
    if abs(now[size] - FULL_GRIP) < LEAST_PROBE:
        now[size] = FULL_GRIP - LEAST_PROBE
    strips = np.tile(now, (len(grid_m) - 1, 1))
    strips[:, edges] = np.column_stack([grid_m[:-1], grid_m[1:]])
    none, changes = _changes(data, current, patch, strips)
    pairs = np.array(list(combinations(range(len(grid_m)), 2)))
    number = np.arange(len(strips))
    unions = (number >= pairs[:, :1]) & (number < pairs[:, 1:])
    promises, amounts = _promises(
        data, none, changes, unions.astype(float), _amounts(patch, now[size])
    )
    offered = [start]
    for best in np.argsort(-promises)[:PROMISING]:
        sizes = now.copy()
        sizes[edges] = grid_m[pairs[best]]
        sizes[size] = FULL_GRIP + amounts[best] * (now[size] - FULL_GRIP)
        offered.append(current.hypothesis.with_effect(patch, sizes))
    return _narrowest(data, current, offered, span)


def _edge_moved(
    data: Data, current: Fit, start: Hypothesis, edge: int, near_m: Array
) -> Hypothesis:
    """Move one edge of the patch to the best of the places so near to it."""
    patch, now = start.effects[-1], start.values_of(-1)
    low, high = span = patch.spans[edge // 2]
    offered = [start]
    for step_m in near_m:
        sizes = now.copy()
        sizes[edge] += step_m
        if sizes[low] < sizes[high]:
            offered.append(current.hypothesis.with_effect(patch, sizes))
    return _narrowest(data, current, offered, span)


def _narrowest(
    data: Data, current: Fit, offered: Sequence[Hypothesis], span: tuple[int, int]
) -> Hypothesis:
    """Return the best; where no run shows which that is, the narrowest, which claims least."""
    costs = costs_refitted(data, current, offered)
    widths = np.array([np.ptp(one.values_of(-1)[list(span)]) for one in offered])
    equal = np.flatnonzero(costs < costs.min() + EQUAL)
    return offered[int(equal[np.argmin(widths[equal])])]


def _amounts(patch: Candidate, grip: float) -> Array:
    """Return between how many times what a patch of this grip does lies what one may do (2,)."""
    parameter = patch.parameters[patch.amplitudes[0]]
    ends = np.array([parameter.low, parameter.high])
    return np.sort((ends - FULL_GRIP) / (grip - FULL_GRIP))


def _changes(data: Data, current: Fit, patch: Candidate, sizes: Array) -> tuple[Fit, Array]:
    """Return the model without a patch, not that of the file either, and what patches change.

    Of the residuals (m, patches), of `sizes` (patches, parameters).
    """
    none = data.believed[[p.places[0] for p in patch.parameters]]
    none[list(patch.amplitudes)] = FULL_GRIP
    model = current.hypothesis
    sets = [model.with_effect(patch, one).flat(data.believed) for one in (none, *sizes)]
    without, *found = data.residuals(np.stack(sets))
    return replace(current, residual=without), (np.stack(found) - without).T


def _promises(
    data: Data, none: Fit, changes: Array, unions: Array, bounds: Array
) -> tuple[Array, Array]:
    """Return what unions (n, parts) of parts promise (n,), and by how much of their `changes`.

    `changes` (m, parts) of the residuals of the model without a patch; `bounds` (2,) of amounts.
    """
    left, weights = absorbed(none, changes)
    slope = unions @ (changes.T @ none.residual - weights.T @ none.slope(data.believed))
    square = np.sum(unions @ (left.T @ changes) * unions, axis=1)
    amounts = np.clip(-slope / np.maximum(square, 1e-9), *bounds)
    return -(2.0 * slope + square * amounts) * amounts, amounts
