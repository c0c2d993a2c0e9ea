"""What commands do within the rows of a log, which holds their means.

**Jumps.** A command that jumps within a row is logged as a mean of what was before and after. All
wheels jump at once, so with levels a before and b after, the row's means m tell when: b - m = share
(b - a) for every wheel. Such a row becomes two, and nothing is measured where the second begins.
Taken as held, a jump to full duty leaves wheels that slide 0.1 m/s from where they are, which no
filter takes for chance. (Harten's subcell resolution, J. Comput. Phys. 1989.) A controller that
sets its command where rows begin and leads a step of its set point over one gives all wheels a mean
of before and after, too: parted, that row pulls wheels 14 rad/s from where they are, which looked
like a delay of 0.2 ms or a limit of the current. Of held commands the motion tells which it is
(answers.py).

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
SETTLED, SMOOTH, TAKEN_BACK = 0.05, 0.3, 0.5
"""Changes just before and after it, as a share of it, beside which it is one: a ramp has as much
again, what fades 0.07 and more. The second where it leads from or to a steady command, as in a
programme, and what moves does so smoothly: its changes change by less than the first. A controller
takes much of a jump back within rows."""
STEADY = 2e-3
"""The same of a command that is steady: a log has four digits."""
AT_ONCE = 0.1
"""Share of the jump by which the means of the wheels may be off one common instant."""
LEAST_SHARE = 0.05
"""Of a row, nearer to whose ends a command jumps with the row."""
ROUNDS = 4
"""In which the instant of a jump settles to a thousandth of a row."""
REACH = 2
"""Rows on each side of an end that tell the command there."""


def parted_at_jumps(
    t_s: Array, command: Array, outputs: Array
) -> tuple[Array, Array, Array, npt.NDArray[np.intp]]:
    """Return rows, commands and outputs with two rows where commands jump within one; the second.

    On both sides they go on as they changed; a row's mean stays as it is. What jumps with the row
    of a controller that holds its commands for a row stays whole.
    """
    change = np.diff(command, axis=0)
    before, after = change[:-4], change[3:-1]  # from row k - 2, into row k + 2
    mean, last, following = command[2:-3], command[1:-4], command[3:-2]
    share = np.full((len(mean), 1), 0.5)
    for _ in range(ROUNDS):  # the means of both parts depend on their lengths
        left = np.clip(last + 0.5 * (1.0 + share) * before, -1.0, 1.0)
        right = np.clip(following - (1.0 - 0.5 * share) * after, -1.0, 1.0)
        jump = right - left
        share = _share_before(mean - left, jump)
    level = last + 0.5 * before
    held = _share_before(mean - level, following - level)  # beyond the row where it has the jump
    size, whole = np.abs(jump).max(axis=1, initial=0.0), np.sum(np.abs(jump), axis=1)
    onward = np.maximum(np.sign(jump) * after, 0.0)
    further = np.sum(np.abs(before) + onward, axis=1)
    bent = np.abs(np.diff(before, axis=0, prepend=before[:1]))
    bent += (onward > 0.0) * np.abs(np.diff(after, axis=0, append=after[-1:]))
    moved = [np.sum(np.abs(side), axis=1) for side in (before, after)]
    smooth = (further < SMOOTH * whole) & (np.sum(bent, axis=1) < SETTLED * whole)
    smooth &= np.minimum(*moved) < STEADY * whole
    found = (size > JUMP) & ((further < SETTLED * whole) | smooth)
    found &= moved[1] < TAKEN_BACK * whole
    found &= np.maximum(np.abs(share - 0.5), np.abs(held - 0.5))[:, 0] < 0.5 - LEAST_SHARE
    found &= np.abs(mean - left - (1.0 - share) * jump).max(axis=1, initial=0.0) < AT_ONCE * size
    own = np.flatnonzero(found)
    share, mean = share[own], mean[own]
    first = np.clip(mean - (1.0 - share) * jump[own], -1.0, 1.0)
    second = np.clip((mean - share * first) / (1.0 - share), -1.0, 1.0)
    first = np.clip((mean - (1.0 - share) * second) / share, -1.0, 1.0)
    row = own + 2
    command = command.copy()
    command[row] = first
    at_s = t_s[row] + share[:, 0] * (t_s[row + 1] - t_s[row])
    return (
        np.insert(t_s, row + 1, at_s),
        np.insert(command, row + 1, second, axis=0),
        np.insert(outputs, row + 1, np.nan, axis=0),
        row + 1 + np.arange(len(row)),
    )


def joined(t_s: Array, command: Array, second: npt.NDArray[np.intp]) -> Array:
    """Return commands (rows, motors) with the mean of both rows where `second` was parted off."""
    before_s, after_s = t_s[second] - t_s[second - 1], t_s[second + 1] - t_s[second]
    share = (after_s / (before_s + after_s))[:, None]
    command = command.copy()
    mean = (1.0 - share) * command[second - 1] + share * command[second]
    command[second - 1] = command[second] = mean
    return command


def _share_before(gone: Array, jump: Array) -> Array:
    """Share (rows, 1) of the row before a jump (rows, motors) by how far its mean has gone."""
    square = np.maximum(np.sum(jump**2, axis=1, keepdims=True), 1e-12)
    return np.clip(1.0 - np.sum(gone * jump, axis=1, keepdims=True) / square, 0.0, 1.0)


def rises(t_s: Array, command: Array, jumped: npt.NDArray[np.intp]) -> Array:
    """Return by how much commands (rows, motors) rise within each row; by nothing in the last.

    Rows `jumped` begin where commands jump: nothing goes on from before.
    """
    found = np.zeros_like(command)
    for begin, end in pairwise([0, *jumped, len(command) - 1]):
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
