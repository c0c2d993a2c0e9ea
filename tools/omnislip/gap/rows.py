"""What the rows of a log hide: how the command moved within them.

A log at 200 Hz holds the mean command of every row. A controller at 1 kHz moves it within the row.
What follows is systematic, not noise, and would pass for lags, friction or inductance. What the
means tell of it is in the recordings (within_rows.py); what they do not is a column by which the
innovations may be off, its size free within a normal prior:

    rise       a command that rises evenly within a row gives the shaft the same speed as its mean,
               but less way; where the contact settles within a row (wheels that grip), what counts
               is where the command ends; and a current that is measured at the row's begin flows
               under less than the mean. The plant itself says what: innovations with commands that
               rise more, less those of the recording. Where commands move, more is
               `SIZE_DEVIATION` of their rises. Where they are taken as held it is all of a rise at
               the rate of a parabola through the means of three rows, for a controller may yet be
               faster than them. A second column leaves a tenth of the change of that rate open
               (all of it would pass for the difference of a delay and a lag).
    reading    a current is read at an instant, and means do not tell which command that finds: a
               controller at 1 kHz has set it up to a millisecond ago, always as long in one log,
               and shakes it from tick to tick by what its sensors count. Where it steps between
               two rows, as at every picture of a camera, a recording has half of both
               (recordings.py; taken for the row's own that pulls currents the way a robot drives: a
               null had half as much viscous friction again). Three columns leave open
               by how much of the changes of commands around its row a current is off: of that into
               the row, and of its first and second differences from row to row. (Without them a log
               that lacked nothing had an inductance of 0.1 mH by a gain of 2,400, and 30 % more
               viscous friction by 340; with them 220 and 130.)

Integrating the sizes out of the likelihood (covariance I + N N' in place of I) is a projection of
the whitened innovations: with N = U S V', r becomes r - U (1 - 1 / sqrt(1 + S^2)) U' r.

In closed loop both are of commands without their news, for a row also answers the one before. Where
it is taken to hold them, how far they rise all the same is found and taken out in place of the
first column (answers.py).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.machine import CURRENT, Machine, stall_current_a
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

RISING_STEP_S = 1e-3
SIZE_DEVIATION = 0.3
"""Of how far commands rise, of what the means of the rows tell: ramps that end within a row, and
controllers a few times as fast as the rows."""
RATE_DEVIATION = 0.1
"""Of the rate of a row's rise, as a share of how far the rate from the row before is from it."""
READ_DEVIATION = 0.5
"""Of the command at which a current is read, as a share of how it changes around that row."""


def hidden_columns(
    machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track], values: Array
) -> Array:
    """Return what commands that move within rows do to a robot's whitened innovations.

    By the plant with the flat set `values`, whose tracks they are: columns (all rows * outputs, 2,
    or 5 where currents are read and commands move).
    """
    rises = [rise_of(run, from_before=False) for run in runs]
    before = [rise_of(run, from_before=True) for run in runs]
    more = [
        rise if run.held else SIZE_DEVIATION * run.rise
        for run, rise in zip(runs, rises, strict=True)
    ]
    unsure = [RATE_DEVIATION * (b - r) for b, r in zip(before, rises, strict=True)]
    driven = [[run.recording for run in runs], _rising(runs, more), _rising(runs, unsure)]
    found = machine.engine.innovations(
        [one for group in driven for one in group],
        list(tracks) * len(driven),
        values[None],
        step_s=RISING_STEP_S,
    )
    known, *rising = (
        np.concatenate([array[0] for array in found[first : first + len(runs)]]).ravel()
        for first in range(0, len(found), len(runs))
    )
    columns = [one - known for one in rising]
    if machine.electric and not machine.holds_commands:
        columns += _read_amid(machine, runs, tracks)
    return np.stack(columns, axis=1)


def _read_amid(machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]) -> list[Array]:
    """Return columns (all rows * outputs,) for currents that flow by what commands change nearby.

    Each by the deviation of one of three sizes.
    """
    found = []
    for run, track in zip(runs, tracks, strict=True):
        change = np.diff(run.command, axis=0, prepend=run.command[:1])
        change[-1] = 0.0  # the last row's command is the mean of no row
        padded = np.pad(change, ((1, 1), (0, 0)))
        before, after = padded[:-2], padded[2:]
        around = np.stack([change, after - before, after - 2.0 * change + before], axis=2)
        shown = np.zeros((*run.outputs.shape, around.shape[2]))
        shown[:, CURRENT] = READ_DEVIATION * stall_current_a(machine) * around
        shown[np.isnan(run.outputs)] = 0.0
        pushed = np.zeros((len(shown), track.filter_states, shown.shape[2]))
        response = machine.engine.response(run.recording, track, pushed, shown)
        found.append(response.reshape(-1, shown.shape[2]))
    return list(np.concatenate(found).T)


def _rising(runs: Sequence[Run], more: Sequence[Array]) -> list[_core.Recording]:
    return [run.recording.rising(run.rise + own) for run, own in zip(runs, more, strict=True)]


def rise_of(run: Run, from_before: bool) -> Array:
    """Return by how much commands rise within each row (rows, 4), if they move smoothly.

    At the rate from the row before, or that of a parabola through the means of three rows; jumps
    are no rates.
    """
    length_s = np.diff(run.t_s)[:, None]
    way_s = 0.5 * (length_s[1:] + length_s[:-1])
    rates = np.diff(run.command[:-1], axis=0) / way_s
    rates[run.jumped - 1] = np.nan
    none = np.full((1, run.command.shape[1]), np.nan)
    before, after = np.vstack([none, rates]), np.vstack([rates, none])
    if from_before:
        before[0] = 0.0
        between = before
    else:
        reach_s = np.vstack([none[:, :1], way_s, none[:, :1]])
        between = (reach_s[1:] * before + reach_s[:-1] * after) / (reach_s[1:] + reach_s[:-1])
    rate = np.where(np.isnan(between), np.where(np.isnan(before), after, before), between)
    return np.vstack([np.nan_to_num(rate) * length_s, np.zeros_like(none)])


class Projection:
    """Takes the part of residuals (..., m) that hidden columns (m, n) may have caused."""

    def __init__(self, columns: Array) -> None:
        self._axes, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        self._share = 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)
        self.log_determinant = float(np.sum(np.log1p(sizes**2)))
        """Of the covariance of white residuals with what is hidden."""

    def apply(self, residuals: Array) -> Array:
        """Return the residuals, used up, without that part."""
        if self._share.size:
            residuals -= ((residuals @ self._axes) * self._share) @ self._axes.T
        return residuals
