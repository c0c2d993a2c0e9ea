"""What the rows of a log hide: how the command moved within them, and with what.

A log at 200 Hz holds the mean command of every row. A controller at 1 kHz moves it within the row,
and partly in answer to what disturbs the wheels in that row. Three consequences are systematic,
not noise, and would pass for lags, friction or inductance. None can be measured; each is a column
by which the innovations may be off, its size free within a normal prior:

    feedback   the controller takes speed away that a disturbance gave within the row. What is new
               in a row's command (less its prediction from the rows before, outliers clipped) comes
               with a disturbance that it answers: at most one that cancels it, so the prior's
               deviation is 1; one column if it ends with the row, one if it lasts. Only where the
               command follows the innovations: a log in closed loop.
    rounding   such a controller reads rounded counts and answers the rounding too: what is new in a
               row's command comes with an error of the encoder at the row's end. Deviation that of
               a count, 1 / sqrt(12), where the command is one deviation off what was expected.
    begin      a current is measured at the row's begin, where a command that moves evenly is half
               way between the means of both rows, a command that is held at its own mean.
               Deviation 1 of this half way.

Integrating the sizes out of the likelihood (covariance I + N N' in place of I) is a projection of
the whitened innovations: with N = U S V', r becomes r - U (1 - 1 / sqrt(1 + S^2)) U' r.
(Feedback within the sampling interval in identification: Ljung, System Identification, 1999, 13.4.)
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.gap.noise import CURRENT, count_rad, stall_acceleration_rad_s2, stall_current_a
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

FOLLOWS = 0.01
"""Share of what is new in a command that innovations must explain for a closed loop."""
PAST = 6
"""Rows from which a command is predicted."""
CLIP = 3.0
# Columns: a disturbance that ends with the row, one that lasts, begin and rounding.
SPEED, LASTING, BEGIN, ROUNDING = range(4)


def hidden_columns(machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]) -> Array:
    """Return whitened columns (all rows * outputs, columns) of `tracks` that kept their matrices.

    No column for machines other than robots, and for logs in open loop without currents.
    """
    outputs = machine.engine.outputs
    none = np.zeros((sum(len(run.t_s) for run in runs) * outputs, 0))
    if machine.kind != "robot":
        return none
    news, follows = _news(machine, runs, tracks)
    if not (follows or machine.electric):
        return none
    found = []
    for run, track, new in zip(runs, tracks, news, strict=True):
        rows = len(run.t_s)
        push = np.zeros((rows, machine.engine.filter_states, 4))
        shown = np.zeros((rows, outputs, 4))
        if follows:
            answered_rad_s2 = stall_acceleration_rad_s2(machine) * new
            push[:, :4, SPEED] = answered_rad_s2
            lasting = slice(machine.engine.states, machine.engine.states + 4)
            push[:-1, lasting, LASTING] = answered_rad_s2[:-1] / np.diff(run.t_s)[:, None]
            shown[1:, :4, ROUNDING] = (
                new[:-1] / max(_spread(new), 1e-12) * count_rad(machine) / np.sqrt(12.0)
            )
        if machine.electric:
            change = np.diff(run.command, axis=0, prepend=run.command[:1])
            shown[:, CURRENT, BEGIN] = -0.5 * stall_current_a(machine) * change
        shown[np.isnan(run.outputs)] = 0.0
        found.append(whitened_response(machine, run, track, push, shown).reshape(-1, 4))
    columns = np.concatenate(found)
    return columns[:, np.any(columns != 0.0, axis=0)]


def whitened_response(
    machine: Machine, run: Run, track: _core.Track, push: Array, shown: Array
) -> Array:
    """Return what pushes do to the whitened innovations (rows, outputs, columns).

    `push` (rows, filter states, columns) are rates from each row to the next, `shown` (rows,
    outputs, columns) what sensors show besides. With the transition F, output slope H and gain K of
    the track, the error d of the prediction obeys

        e_k = -H_k d_k + shown_k,     d_(k+1) = F_k (d_k + K_k e_k + push_k dt / 2) + push_k dt / 2
    """
    n, m, rows = machine.engine.filter_states, machine.engine.outputs, len(run.t_s)
    transition = track.transition.reshape(rows, n, n)
    slope = np.where(np.isnan(run.outputs)[:, :, None], 0.0, track.slope.reshape(rows, m, n))
    gain, whitening = track.gain.reshape(rows, n, m), track.whitening.reshape(rows, m, m)
    step_s = np.diff(run.t_s)
    error = np.zeros((n, push.shape[2]))
    response = np.empty((rows, m, push.shape[2]))
    for k in range(rows):
        seen = shown[k] - slope[k] @ error
        response[k] = whitening[k] @ seen
        if k + 1 < rows:
            pushed = 0.5 * step_s[k] * push[k]
            error = transition[k] @ (error + gain[k] @ seen + pushed) + pushed
    return response


class Projection:
    """Takes the part of residuals (..., m) that hidden columns (m, n) may have caused."""

    def __init__(self, columns: Array) -> None:
        self._axes, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        self._share = 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)

    def apply(self, residuals: Array) -> Array:
        """Return the residuals without that part."""
        if not self._share.size:
            return residuals
        return residuals - ((residuals @ self._axes) * self._share) @ self._axes.T


def _news(
    machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]
) -> tuple[list[Array], bool]:
    """Return what is new in the commands (rows, 4) of each run, and whether they follow.

    The prediction is linear in the wheel's last commands and innovations.
    """
    past, now = [], []
    for run, track in zip(runs, tracks, strict=True):
        innovation = np.nan_to_num(track.innovation.reshape(len(run.t_s), -1)[:, :4])
        command = run.command
        last = len(command) - PAST
        rows = [command[PAST - 1 - j : PAST - 1 - j + last] for j in range(PAST)]
        rows += [innovation[PAST - j : PAST - j + last] for j in range(PAST)]
        past.append(np.stack([r.ravel() for r in rows], axis=1))
        now.append(command[PAST:].ravel())
    x, y = np.concatenate(past), np.concatenate(now)
    scale = np.maximum(x.std(axis=0), 1e-12)
    moderate = np.abs(y - x[:, 0]) <= CLIP * max(_spread(y - x[:, 0]), 1e-9)
    left = [_rest(x[moderate][:, :n] / scale[:n], y[moderate]) for n in (PAST, 2 * PAST)]
    energies = [float(r @ r) for r, _ in left]
    follows = energies[1] < (1.0 - FOLLOWS) * energies[0]
    weights = left[1][1] / scale
    news = []
    for run, own, target in zip(runs, past, now, strict=True):
        new = (target - own @ weights).reshape(-1, machine.engine.motors)
        limit = CLIP * max(_spread(new), 1e-12)
        padded = np.zeros(run.command.shape)
        padded[PAST:] = np.clip(new, -limit, limit)
        news.append(padded)
    return news, follows


def _rest(x: Array, y: Array) -> tuple[Array, Array]:
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    return y - x @ weights, weights


def _spread(values: Array) -> float:
    """Robust standard deviation around zero."""
    return float(np.median(np.abs(values))) / 0.6745
