"""What commands do within the rows of a log, which holds their means.

**Jumps.** A command that jumps within a row is logged as a mean of what was before and after. All
wheels jump at once, so with levels a before and b after, the row's means m tell when: b - m = share
(b - a) for every wheel. Such a row becomes two, and nothing is measured where the second begins.
Taken as held, a jump to full duty leaves wheels that slide 0.1 m/s from where they are, which no
filter takes for chance. (Harten's subcell resolution, J. Comput. Phys. 1989.)

**Rises.** The way C(t) of a command, its integral, is known at the ends of the rows: its slope
there, by the polynomial of degree 4 through five such ends, is the command where rows meet, kept
between the means of the two rows, for beyond them it jumped. (The edges of the piecewise parabolic
method: Colella and Woodward, J. Comput. Phys. 1984.) A row rises around its mean by the difference
of its ends, but not beyond full duty; a row in which the command would turn around is taken as
held. Taken as held, a sum of sines up to 16 Hz at rows of 5 ms leaves a fifth of what passes for
chance at the shafts to be foretold from the commands.

Whether commands move within rows at all, or a controller holds them, the motion tells (answers.py).
"""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

JUMP = 0.1
"""Change of a duty within a row that is worth a row of its own."""
SETTLED, TAKEN_BACK = 0.05, 0.5
"""Changes just before and after it, as a share of it, beside which it is one: a ramp has as much
again, what fades 0.07 and more. A controller takes much of a jump back within rows."""
AT_ONCE = 0.1
"""Share of the jump by which the means of the wheels may be off one common instant."""
LEAST_SHARE = 0.05
"""Of a row, nearer to whose ends a command jumps with the row."""

REACH = 2
"""Rows on each side of an end that tell the command there."""


def parted_at_jumps(
    t_s: Array, command: Array, outputs: Array
) -> tuple[Array, Array, Array, npt.NDArray[np.intp]]:
    """Return rows, commands and outputs with two rows where commands jump within one; the second.

    Levels are those of the neighbours, going on as they change; a row's mean stays as it is. What
    jumps with the row of a controller that holds its commands for a row stays whole.
    """
    change = np.diff(command, axis=0)
    before, after = change[:-4], change[3:-1]  # from row k - 2, into row k + 2
    mean, next_mean = command[2:-3], command[3:-2]
    level = np.clip(command[1:-4] + 0.5 * before, -1.0, 1.0)
    jump = np.clip(next_mean - 0.5 * after, -1.0, 1.0) - level
    share = _share_before(mean - level, jump)
    held = _share_before(mean - level, next_mean - level)  # beyond the row where it has the jump
    size, whole = np.abs(jump).max(axis=1, initial=0.0), np.sum(np.abs(jump), axis=1)
    further = np.sum(np.abs(before) + np.maximum(np.sign(jump) * after, 0.0), axis=1)
    found = (size > JUMP) & (further < SETTLED * whole)
    found &= np.sum(np.abs(after), axis=1) < TAKEN_BACK * whole
    found &= np.maximum(np.abs(share - 0.5), np.abs(held - 0.5))[:, 0] < 0.5 - LEAST_SHARE
    found &= np.abs(mean - level - (1.0 - share) * jump).max(axis=1, initial=0.0) < AT_ONCE * size
    own = np.flatnonzero(found)
    first, second = (np.clip(mean + part * jump, -1.0, 1.0)[own] for part in (share - 1.0, share))
    row = own + 2
    command = command.copy()
    command[row] = first
    at_s = t_s[row] + share[own, 0] * (t_s[row + 1] - t_s[row])
    return (
        np.insert(t_s, row + 1, at_s),
        np.insert(command, row + 1, second, axis=0),
        np.insert(outputs, row + 1, np.nan, axis=0),
        row + 1 + np.arange(len(row)),
    )


def _share_before(gone: Array, jump: Array) -> Array:
    """Share (rows, 1) of the row before a jump (rows, motors) by how far its mean has gone."""
    square = np.maximum(np.sum(jump**2, axis=1, keepdims=True), 1e-12)
    return 1.0 - np.sum(gone * jump, axis=1, keepdims=True) / square


def rises(t_s: Array, command: Array, jumped: npt.NDArray[np.intp]) -> Array:
    """Return by how much commands (rows, motors) rise within each row; by nothing in the last.

    Rows `jumped` begin where commands jump: nothing goes on from before.
    """
    found = np.zeros_like(command)
    begins = [0, *jumped, len(command) - 1]
    for begin, end in pairwise(begins):
        if end > begin:
            mean = command[begin:end]
            ends = _at_ends(np.diff(t_s[begin : end + 1]), mean)
            first, last = ends[:-1], ends[1:]
            turns = (last - mean) * (mean - first) <= 0.0
            room = 2.0 * np.maximum(1.0 - np.abs(mean), 0.0)
            found[begin:end] = np.where(turns, 0.0, np.clip(last - first, -room, room))
    return found


def _at_ends(length_s: Array, mean: Array) -> Array:
    """Commands (rows + 1, motors) at the ends of rows of these lengths and means (rows, motors).

    With x_j the time from an end to another four, C_j the way to there: C' = sum of w_j C_j, w_j =
    1 / x_j * product over k not j of x_k / (x_k - x_j).
    """
    length_s = np.pad(length_s, REACH, mode="edge")
    mean = np.pad(mean, ((REACH, REACH), (0, 0)), mode="edge")
    time_s = np.concatenate([[0.0], np.cumsum(length_s)])
    way = np.vstack([np.zeros(mean.shape[1]), np.cumsum(length_s[:, None] * mean, axis=0)])
    own = np.arange(REACH, len(time_s) - REACH)
    others = [own + step for step in range(-REACH, REACH + 1) if step]
    x = [time_s[other] - time_s[own] for other in others]
    slope = np.zeros((len(own), mean.shape[1]))
    for j, other in enumerate(others):
        weight = np.prod([x[k] / (x[k] - x[j]) for k in range(len(x)) if k != j], axis=0) / x[j]
        slope += weight[:, None] * (way[other] - way[own])
    before, after = mean[own - 1], mean[own]
    return np.clip(slope, np.minimum(before, after), np.maximum(before, after))
