"""What the rows of a log hide: how the command moved within them, and with what.

A log at 200 Hz holds the mean command of every row. A controller at 1 kHz moves it within the row,
and partly in answer to what disturbs the wheels in that row. Three consequences are systematic,
not noise, and would pass for lags, friction or inductance. None can be measured; each is a column
by which the innovations may be off, its size free within a normal prior:

    rise       a command that rises evenly within a row gives the shaft the same speed as its mean,
               but less way; where the contact settles within a row (wheels that grip), what counts
               is where the command ends; and a current that is measured at the row's begin flows
               under less than the mean. The plant itself says what: innovations with commands that
               rise, less those with commands that are held. A column of deviation 1: a command that
               is held from row to row has none of it. The rate is that of a parabola through the
               means of three rows, and a second column leaves a tenth of its change open (all of it
               would pass for the difference of a delay and a lag); in a closed loop, where the row
               after answers this one, the rate is that from the row before.
    feedback   the controller takes speed away that a disturbance gave within the row. What is new
               in a row's command (less its prediction from the rows before, outliers clipped) comes
               with a disturbance that it answers: at most one that cancels it, so the prior's
               deviation is 1; a column for that row and for each of the next two, of each pattern
               of wheels: those of a body that moves, those of one that turns, and wheels that work
               against each other, for how much of each is answered differs. (One column for all
               draws keys by several of their deviations.) Only where the command follows the
               innovations: a log in closed loop.
    rounding   such a controller reads rounded counts and answers the rounding too: what is new in a
               row's command comes with an error of the encoder at the row's end. Deviation that of
               a count, 1 / sqrt(12), where the command is one deviation off what was expected.

Integrating the sizes out of the likelihood (covariance I + N N' in place of I) is a projection of
the whitened innovations: with N = U S V', r becomes r - U (1 - 1 / sqrt(1 + S^2)) U' r.
(Feedback within the sampling interval in identification: Ljung, System Identification, 1999, 13.4.)
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.gap.noise import count_rad, stall_acceleration_rad_s2
from omnislip.gap.recordings import Run, wheel_jacobian
from omnislip.log_file import POSE_COLUMNS

Array = npt.NDArray[np.float64]

FOLLOWS = 0.002
"""Share of what is new in a command that innovations must explain for a closed loop, in rows where
the command hardly changes: elsewhere a model that is a little off gives as much in open loop."""
FEIGNED_GAIN = 100.0
"""Gain up to which answers feign effects in spite of the columns: what passed all other tests in 68
logs of closed loops in which nothing was missing gained at most 58. In open loop no answer is seen
beside a model that is right."""
UNSEEN, UNDRIVEN = 2.0, 4.0
"""Times as much where no camera tells what the robot does (178 was promised once), and where a
direction is not driven: there it moves by nothing but disturbances and the answers to them (273
passed in one of eight such logs)."""
DRIVEN = 0.02
"""Of the speed of the strongest direction: 0.002 where a robot goes to and fro, 0.05 and more where
it turns, too."""
BEYOND_CHANCE = 4.0
"""Times what chance explains of so many rows (F of PAST and very many: once in 1000)."""
ROUNDING = 1e-6
"""Of a command's size: less is nothing new (a timer has steps of 1e-3, a log six digits)."""
CALM = 1.0
"""Changes of a command in such rows, in their deviations."""
PAST = 6
"""Rows from which a command is predicted."""
CLIP = 3.0
ANSWERED_ROWS = 3
RISING_STEP_S = 1e-3
RATE_DEVIATION = 0.1
"""Of the rate of a row's rise, as a share of how far the rate from the row before is from it."""
CHANCE_S = 0.03
"""Disturbances fade at 40 per second or faster (noise.py)."""
CREEP_RAD_S = 2.0
"""Speed of a shaft below which the sign of its friction is smooth (sim/robot_plant.h)."""


@dataclass(frozen=True)
class News:
    """What is new in the commands (rows, 4) of each run; share of it that innovations explain."""

    new: list[Array]
    share: float
    seen: bool
    """Whether a camera sees the robot."""
    driven: bool
    """Whether the robot is driven in all directions."""

    @property
    def answers(self) -> bool:
        """Whether commands answer what disturbs the wheels: whether a loop is closed."""
        return self.share > FOLLOWS

    @property
    def feigned_gain(self) -> float:
        """Gain beyond chance that a controller's answers feign where nothing is missing."""
        if not self.answers:
            return 0.0
        feigned = FEIGNED_GAIN if self.seen else UNSEEN * FEIGNED_GAIN
        return feigned if self.driven else UNDRIVEN * feigned


def hidden_columns(
    machine: Machine,
    runs: Sequence[Run],
    tracks: Sequence[_core.Track],
    values: Array,
    news: News,
) -> Array:
    """Return whitened columns (all rows * outputs, columns) of `tracks` that kept their matrices.

    The tracks are those of the flat parameter set `values`. No column for machines other than
    robots.
    """
    if machine.kind != "robot":
        return np.zeros((sum(len(run.t_s) for run in runs) * machine.engine.outputs, 0))
    columns = _rises(machine, runs, tracks, values, news.answers)
    if news.answers:
        answers = [
            _answers(machine, run, track, new)
            for run, track, new in zip(runs, tracks, news.new, strict=True)
        ]
        columns = np.hstack([np.concatenate(answers), columns])
    return columns


def _rises(
    machine: Machine,
    runs: Sequence[Run],
    tracks: Sequence[_core.Track],
    values: Array,
    follows: bool,
) -> Array:
    """Return what commands that rise within rows do to whitened innovations, by the plant."""
    rises = [rise_of(run, from_before=follows) for run in runs]
    driven = [[run.recording for run in runs], _rising(runs, rises)]
    if not follows:
        before = [rise_of(run, from_before=True) for run in runs]
        unsure = [RATE_DEVIATION * (b - r) for b, r in zip(before, rises, strict=True)]
        driven.append(_rising(runs, unsure))
    found = machine.engine.innovations(
        [one for group in driven for one in group],
        list(tracks) * len(driven),
        values[None],
        step_s=RISING_STEP_S,
    )
    held, *rising = (
        np.concatenate([array[0] for array in found[first : first + len(runs)]]).ravel()
        for first in range(0, len(found), len(runs))
    )
    return np.stack([one - held for one in rising], axis=1)


def _rising(runs: Sequence[Run], rises: Sequence[Array]) -> list[_core.Recording]:
    return [run.recording.rising(rise) for run, rise in zip(runs, rises, strict=True)]


def rise_of(run: Run, from_before: bool) -> Array:
    """Return by how much commands rise within each row (rows, 4), if they move smoothly.

    At the rate from the row before, or that of a parabola through the means of three rows.
    """
    length_s = np.diff(run.t_s)
    middle_s = run.t_s[:-1] + 0.5 * length_s
    command, nothing = run.command[:-1], np.zeros(run.command.shape[1])
    if from_before:
        rate = np.vstack([nothing, np.diff(command, axis=0) / np.diff(middle_s)[:, None]])
    else:
        rate = np.gradient(command, middle_s, axis=0)
    return np.vstack([rate * length_s[:, None], nothing])


def _answers(machine: Machine, run: Run, track: _core.Track, new: Array) -> Array:
    """Return what goes with the answers `new` (rows, 4): (rows * outputs, columns)."""
    rows, outputs = run.outputs.shape
    patterns = _patterns(machine)
    count = len(patterns) * ANSWERED_ROWS
    push = np.zeros((rows, machine.engine.filter_states, count + 1))
    shown = np.zeros((rows, outputs, count + 1))
    full_rad_s2 = stall_acceleration_rad_s2(machine)
    for column in range(count):
        pattern, late = divmod(column, ANSWERED_ROWS)
        push[late:, :4, column] = full_rad_s2 * (new @ patterns[pattern])[: rows - late]
    shown[1:, :4, count] = new[:-1] / max(_spread(new), 1e-12) * count_rad(machine) / np.sqrt(12.0)
    shown[np.isnan(run.outputs)] = 0.0
    return whitened_response(machine, run, track, push, shown).reshape(-1, count + 1)


def _patterns(machine: Machine) -> tuple[Array, Array, Array]:
    """Return projectors (4, 4) on wheels of a body that moves, that turns, and against it."""
    jacobian = wheel_jacobian(machine)
    together = jacobian @ np.linalg.pinv(jacobian)
    turning = jacobian[:, 2:] @ np.linalg.pinv(jacobian[:, 2:])
    return together - turning, turning, np.eye(4) - together


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


def foreseen(run: Run, track: _core.Track) -> Array:
    """States (rows, states) without what was corrected in the last `CHANCE_S`."""
    rows = len(run.t_s)
    gain, transition = track.gain.reshape(rows, -1, run.outputs.shape[1]), track.transition
    transition = transition.reshape(rows, gain.shape[1], -1)
    innovation = np.nan_to_num(track.innovation.reshape(rows, -1))
    corrected = np.einsum("kij,kj->ki", gain, innovation)
    states = track.state.reshape(rows, -1) - corrected
    for _ in range(round(CHANCE_S / float(np.median(np.diff(run.t_s))))):
        corrected[1:] = np.einsum("kij,kj->ki", transition[:-1], corrected[:-1])
        corrected[0] = 0.0
        states -= corrected
    return states


def news_of(machine: Machine, runs: Sequence[Run], tracks: Sequence[_core.Track]) -> News:
    """Return what is new in the commands beside what the wheel's last commands lead to (linearly).

    Innovations beside a wrong model tell how the robot moves, and where commands follow a programme
    that tells how they go on. So what they explain has to be more than the motion foreseen explains
    as well: an answer is one to what was not. `tracks` keep their matrices. Nothing of machines
    other than robots.
    """
    if machine.kind != "robot":
        return News([], 0.0, True, True)
    past, now, moving = [], [], []
    for run, track in zip(runs, tracks, strict=True):
        innovation = np.nan_to_num(track.innovation.reshape(len(run.t_s), -1)[:, :4])
        command = run.command
        last = len(command) - PAST
        rows = [command[PAST - 1 - j : PAST - 1 - j + last] for j in range(PAST)]
        rows += [innovation[PAST - j : PAST - j + last] for j in range(PAST)]
        past.append(np.stack([r.ravel() for r in rows], axis=1))
        now.append(command[PAST:].ravel())
        moving.append(_motion(foreseen(run, track)[PAST:]))
    x, y, motion = (np.concatenate(each) for each in (past, now, moving))
    scale = np.maximum(x.std(axis=0), 1e-12)
    steps = np.abs(y - x[:, 0]) / max(_spread(y - x[:, 0]), 1e-9)
    calm, moderate = steps <= CALM, steps <= CLIP
    commanded = x[calm, :PAST]
    limit = CLIP * _spread(x[calm, PAST:])
    innovations = np.clip(x[calm, PAST:], -limit, limit)
    share = min(
        _share_explained(known, innovations, y[calm])
        for known in (commanded, np.hstack([commanded, motion[calm]]))
    )
    if share < BEYOND_CHANCE * PAST / np.count_nonzero(calm):
        share = 0.0
    weights = _rest(x[moderate] / scale, y[moderate])[1] / scale
    found = []
    for run, own, target in zip(runs, past, now, strict=True):
        new = (target - own @ weights).reshape(-1, machine.engine.motors)
        limit = CLIP * max(_spread(new), 1e-12)
        padded = np.zeros(run.command.shape)
        padded[PAST:] = np.clip(new, -limit, limit)
        found.append(padded)
    return News(found, float(share), _seen(runs), _driven(machine, tracks))


def _seen(runs: Sequence[Run]) -> bool:
    """Whether a camera sees the robot in any run."""
    places = [runs[0].channels.index(name) for name in POSE_COLUMNS]
    return any(np.isfinite(run.outputs[:, places]).any() for run in runs)


def _driven(machine: Machine, tracks: Sequence[_core.Track]) -> bool:
    """Whether the robot moves in every direction of (x, y, a wheel's way round)."""
    states = [track.state.reshape(-1, machine.engine.filter_states) for track in tracks]
    speed = np.concatenate(states)[:, 8:11]
    speed = speed * [1.0, 1.0, machine.model.values["robot.wheel_distance_m"]]
    least, *_, most = np.linalg.eigvalsh(speed.T @ speed)
    return bool(least >= DRIVEN**2 * most)


def _motion(states: Array) -> Array:
    """How the robot moves (rows * 4, 12): speeds and their signs, from each wheel's view."""
    speed, body = states[:, :4], states[:, 8:11]
    from_wheels = [
        np.hstack([np.roll(speed, -k, axis=1), np.tanh(np.roll(speed, -k, axis=1) / CREEP_RAD_S)])
        for k in range(4)
    ]
    seen = np.stack([np.hstack([one, body, np.ones((len(body), 1))]) for one in from_wheels], 1)
    return seen.reshape(-1, seen.shape[2])


def _share_explained(known: Array, told: Array, target: Array) -> float:
    """Share of what `known` leaves of the target (rows,) that `told` (rows, n) explains.

    0 where it leaves nothing but rounding, as of a command that is held.
    """
    known = known / np.maximum(np.sqrt(np.mean(known**2, axis=0)), 1e-12)
    rest, _ = _rest(known, np.hstack([told, target[:, None]]))
    left = rest.T @ rest
    told_left, slope = left[:-1, :-1], left[:-1, -1]
    if left[-1, -1] <= ROUNDING**2 * (target @ target):
        return 0.0
    return float(slope @ np.linalg.pinv(told_left, hermitian=True) @ slope / left[-1, -1])


def _rest(x: Array, y: Array) -> tuple[Array, Array]:
    weights = np.linalg.lstsq(x, y, rcond=None)[0]
    return y - x @ weights, weights


def _spread(values: Array) -> float:
    """Robust standard deviation around zero."""
    return float(np.median(np.abs(values))) / 0.6745
