"""Does the robot do something for moments that its commands do not tell?

What is missing may last no longer than a moment: drivers that coast when their watchdog trips, that
hold a duty while a message is lost, that are blind after a reversal. Over the whole of the logs it
gains little, nothing predicts it, and the noise that is tuned holds it; but chance does not jump.
As for pushes (events.py), g is the likelihood ratio of a jump before each row, here of the four
shafts' speeds: chi-squared with 4 degrees of freedom where nothing happened. A moment is a peak of
g that stands out from chance and from its run's own level. Where a command jumps it is none, for
the mean of a row does not tell when within the row it did, nor where rows were lost; and where it
bends, a jump has to be larger than what that may feign. Nor is it what the rows' stamps may be off
by: a row that was read d late shows every sensor as much further on as it goes in d, and a clock
that skips shows it so from then on. A jump has to gain beside both, each known to some `STAMP_S`.
Nor is it a count: a shaft that hardly turns is rounded the same way in row after row, which is no
white noise, and then the other way (of 64 counts a turn, three wheels at rest at once: g = 45). The
error of a rounded reading is uniform over a count; one may differ by the count over sqrt(6).
Nor is it what the model does of a sudden itself: where an encoder begins to lose counts, a driver
to coast, wheels grip again or pass an edge in the floor, it may be some rows early or late. Nor is
it where teeth meet, for nothing tells before that where in its play a gear is.
A few moments in two logs or more say that something is there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from omnislip import _core
from omnislip.gap.events import COMMAND_JUMP, REPLAY_STEP_S, SPAN_ROWS, Jumps, peaks
from omnislip.gap.machine import (
    CURRENT,
    Machine,
    count_rad,
    no_load_speed_rad_s,
    stall_acceleration_rad_s2,
)
from omnislip.gap.noise import ENCODER, SHAFT, STAMP_S, Noise, run_free
from omnislip.gap.recordings import LOST, Run
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]

HORIZON_S = 0.03
LEAST_RATIO, OVER_LEVEL = 35.0, 6.0
"""g beyond which chance makes one in 300 sets of logs (p = 5e-7 a row), and factor by which it must
exceed the 80th percentile of its run."""
RINGS_S = 0.05
"""For which a soft gear rings (12 N m/rad at a shaft: 40 ms)."""
MISLED = 2.0
"""What a filter may be off by where the model switches, as a factor of what that does to a speed:
what is shown after it says that the switch has not come, so once each way."""
LEAST_MOMENTS, LEAST_LOGS = 3, 2


@dataclass(frozen=True)
class Moment:
    """When shafts were suddenly faster or slower than the model says, and by how much."""

    run: str
    time_s: float
    ratio: float
    jump_rad_s: Array
    """(wheels,)"""


def find_moments(
    machine: Machine,
    runs: Sequence[Run],
    tracks: Sequence[_core.Track],
    values: Array,
    noise: Noise,
) -> list[Moment]:
    """Return the moments in runs beside the model of flat `values`: `tracks` with their matrices.

    None if they are too few, or of what is no robot.
    """
    if machine.kind != "robot":
        return []
    pairs = list(zip(runs, tracks, strict=True))
    found = side_by_side(lambda pair: _moments_in(machine, *pair, values, noise), pairs)
    moments = [moment for own in found for moment in own]
    logs = {moment.run for moment in moments}
    return moments if len(moments) >= LEAST_MOMENTS and len(logs) >= LEAST_LOGS else []


def _moments_in(
    machine: Machine, run: Run, track: _core.Track, values: Array, noise: Noise
) -> list[Moment]:
    jumps = Jumps(machine, run, track, SHAFT, HORIZON_S, outputs=slice(None))
    ratio, jump, _ = jumps.ratios()
    level = float(np.percentile(ratio[jumps.first :], 80))
    least = max(LEAST_RATIO, OVER_LEVEL * level)
    filtered = track.state.reshape(len(run.t_s), -1)
    rate = np.gradient(filtered, run.t_s, axis=0)
    unsure, bent_rad_s = _unsure(run), _feigned_rad_s(machine, run)
    feigned_rad_s = bent_rad_s[:, None] + _met_rad_s(machine, run, filtered, values)
    rounded_rad = count_rad(machine) / np.sqrt(6.0)
    found = []
    for row in peaks(run.t_s, ratio, least):
        most = int(np.argmax(np.abs(jump[row])))
        beyond_rad_s = abs(jump[row, most]) - feigned_rad_s[row, most]
        if unsure[row] or beyond_rad_s <= 0.0:
            continue
        if jumps.ratio_beside_misreadings(row, rate, STAMP_S, rounded_rad) <= least:
            continue
        own_rad_s = _own_jump_rad_s(machine, run, row, filtered, values, noise)[most]
        if beyond_rad_s > MISLED * own_rad_s:
            found.append(Moment(run.name, float(run.t_s[row]), float(ratio[row]), jump[row]))
    return found


def _own_jump_rad_s(
    machine: Machine, run: Run, row: int, filtered: Array, values: Array, noise: Noise
) -> Array:
    """Return by how much shafts (wheels,) suddenly turn otherwise in a model that runs free.

    From shortly before a row on, for what is measured there would make it jump, too: the most by
    which the acceleration of a shaft, or that which its encoder shows, changes from one row beside
    to the next, for as long as a row.
    """
    first = max(row - SPAN_ROWS - _ringing_rows(run), 0)
    rows = slice(first, row + SPAN_ROWS + 1)
    t_s, start = run.t_s[rows], filtered[first][: machine.engine.states]
    free = run_free(machine, t_s, run.command[rows], start, values, noise, REPLAY_STEP_S)
    shown_rad_s = np.diff(free[:, ENCODER], axis=0) / np.diff(t_s)[:, None]
    speeds_rad_s = np.hstack([free[1:, SHAFT], shown_rad_s])
    rate = np.diff(speeds_rad_s, axis=0) / np.diff(t_s)[1:, None]
    bent = np.abs(np.diff(rate, axis=0)) * run.row_s
    return bent[-2 * SPAN_ROWS :].reshape(-1, 2, 4).max(axis=(0, 1))


def _met_rad_s(machine: Machine, run: Run, filtered: Array, values: Array) -> Array:
    """Return the jumps (rows, wheels) of the shafts where teeth meet that crossed all of the play.

    Where in its play a gear is nothing tells before they meet. A motor is free until then: a wheel
    that turns by p behind a gear of ratio n lets it gain v = sqrt(2 a n p), with a of what drives
    it beside, and then a wheel that the floor holds takes all of v away.
    """
    play_rad, load_share = (
        values[list(machine.place("gear_backlash", key, None))]
        for key in ("angle_rad", "load_share")
    )
    driven = np.abs(run.command - filtered[:, SHAFT] / no_load_speed_rad_s(machine))
    most = maximum_filter1d(driven, 2 * _ringing_rows(run) + 1, axis=0)
    free_rad_s2 = most * stall_acceleration_rad_s2(machine) / (1.0 - load_share)
    ratio = machine.model.values["motor.gear_ratio"]
    return np.sqrt(2.0 * free_rad_s2 * ratio * np.abs(play_rad))


def _feigned_rad_s(machine: Machine, run: Run) -> Array:
    """Return the jumps (rows,) that a change of a command within the rows beside may feign.

    Where a command that went evenly changes by c of a sudden, or begins to change, the row's mean
    does not tell when: for half a row the motor has c more or less than by the mean. A soft gear
    rings for a while with what that was off. A logged current is that of an instant, under a
    command of which two means may hold half each: it shows up to 2 c of the no-load speed.
    """
    bent = np.zeros_like(run.command)
    bent[1:-1] = np.abs(np.diff(run.command, 2, axis=0))
    before = _ringing_rows(run)
    size = before + SPAN_ROWS + 1
    most = maximum_filter1d(bent.max(axis=1), size, origin=before - size // 2)
    per_command = stall_acceleration_rad_s2(machine) * run.row_s / 2.0
    if not np.isnan(run.outputs[:, CURRENT]).all():
        per_command += 2.0 * no_load_speed_rad_s(machine)
    return most * per_command


def _ringing_rows(run: Run) -> int:
    return max(SPAN_ROWS, round(RINGS_S / run.row_s))


def _unsure(run: Run) -> npt.NDArray[np.bool_]:
    """Rows (rows,) beside which it is not known what was commanded when."""
    jumped = np.abs(np.diff(run.command, axis=0, prepend=run.command[:1])).max(axis=1)
    lost = np.diff(run.t_s, prepend=run.t_s[0] - run.row_s) > LOST * run.row_s
    parted = np.isin(np.arange(len(run.t_s)), run.jumped)
    beside = np.ones(2 * SPAN_ROWS + 1)
    return np.convolve((jumped > COMMAND_JUMP) | lost | parted, beside, mode="same") > 0
