"""Logs as the replay engine takes them: SI units, wraps removed, a first guess of the state."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.errors import InputError
from omnislip.gap.machine import Machine, count_rad, stall_acceleration_rad_s2
from omnislip.gap.within_rows import joined, parted_at_jumps, rises
from omnislip.log_file import AXIS_OPTIONAL, POSE_COLUMNS, Log
from omnislip.model_file import Model

Array = npt.NDArray[np.float64]

ROBOT_CHANNELS = (
    *(f"wheel/{wheel}/encoder_counts" for wheel in range(1, 5)),
    "gyro/z_rad_s",
    "pose/x_m",
    "pose/y_m",
    "pose/theta_rad",
)
ELECTRIC_CHANNELS = ("supply/voltage_v", *(f"wheel/{wheel}/current_a" for wheel in range(1, 5)))
"""Outputs that follow when logs have any of them: a Machine that is `electric`."""


ODOMETRY_CHANNELS = ("pose/forward_m", "pose/lateral_m", "pose/theta_rad")
"""Errors of an odometry are told along and across the robot (`body_errors`)."""
PAST_S = 0.1
LOST = 1.5
"""Rows after which the next one comes late."""
SLOW_M_S = 0.1
"""Speed of a wheel's rim below which a robot is as good as at rest."""
STILL_M_S = 0.02
"""Speed of a rim in the first row below which nothing drives a robot yet: who starts harder has
gone, within rows, where currents that lag behind the commands took it, and no log tells those."""
SLIDING_M_S = 0.2
"""By how much wheels that slide misjudge the speed of a robot; beyond it the filter's linear
path would begin wrong, below it finds the velocity by itself."""
FIRST_ROWS = 3
"""Rows by which the first speeds of the shafts are told."""
SHAFT_VARIANCE, PLACE_VARIANCE = 25.0, 1e-4
"""Of the first state: (5 rad/s)^2, and (1 cm)^2 or (0.6 deg)^2."""
STARTING_VARIANCE = 1e-3
"""(m/s)^2 of a robot that begins: a floor gives it 0.03 m/s in a row of 5 ms."""
GLANCE_S, LEAST_GLANCES = 0.2, 5
"""For which the camera is looked at for the first velocity, and poses it must show meanwhile."""
READ_AMID = 0.5
"""Share of the row before in the command under which a current flows where a row begins: what moves
jumps before that as often as after. Of 12 sets of logs 11 are likelier so than by the row's own, by
90 to 4,500; of four in loops at 1 kHz all are likeliest so, by 90 and more than 0.25 or 0.75."""
UNSEEN_SETTLE_S = 1.0
"""After which the filter has found a first velocity that only wheels tell: of 118 pieces that began
amid violent driving four were wrong by three deviations after 0.25 s, none after 0.75 s."""


@dataclass(frozen=True)
class Run:
    """One recording: a log, or a piece of one.

    `outputs` (rows, channels) in the engine's units (encoder angles in rad, pose unwrapped), NaN
    where not sampled; `scale` (channels,) turns them into the units of the log's columns.
    """

    name: str
    t_s: Array
    command: Array
    outputs: Array
    channels: tuple[str, ...]
    scale: Array
    recording: _core.Recording
    off: npt.NDArray[np.bool_] | None = None
    """Rows (rows,) in which the drive of an axis is switched off; `command` is 0 there."""
    unit: str = ""
    """Runs of a unit have things in common by chance: they are left out together."""
    log_begin_s: float = 0.0
    """`t_s` of the first row of the log."""
    jumped: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))
    """Rows that begin where commands jump within a row of the log."""
    at_rest: bool = False
    """Whether a robot is known to stand in the first row, and not to start there."""
    held: bool = True
    """Whether commands are held within rows; else they rise there as their means tell."""
    parted: "Run | None" = None
    """Of a run whose commands jump where rows begin: itself if they jumped within rows."""
    reads_before: bool = False
    """Whether electric sensors are read before a held command begins, not after; of commands that
    move they show either."""

    @property
    def time_s(self) -> Array:
        """Time (rows,) since the log began, also of a piece: what drifts goes on from piece to
        piece."""
        return self.t_s - self.log_begin_s

    @property
    def duration_s(self) -> float:
        """Time from the first row to the last."""
        return float(self.t_s[-1] - self.t_s[0])

    @property
    def settled_s(self) -> float:
        """Time from which on the filter has found the initial state."""
        return float(self.t_s[0]) + self.recording.settle_s

    @cached_property
    def row_s(self) -> float:
        """Time from row to row, the median."""
        return float(np.median(np.diff(self.t_s)))

    @property
    def log_rows(self) -> npt.NDArray[np.intp]:
        """Rows that the log has, too."""
        return np.delete(np.arange(len(self.t_s)), self.jumped)

    @property
    def logged_command(self) -> Array:
        """Commands (rows of the log, motors) as logged, means over those rows."""
        length_s = np.diff(self.t_s, append=self.t_s[-1] + self.row_s)[:, None]
        rows = self.log_rows
        sums = np.add.reduceat(length_s * self.command, rows, axis=0)
        return sums / np.add.reduceat(length_s, rows, axis=0)

    @property
    def rise(self) -> Array:
        """By how much commands rise within each row (rows, motors) of the recording."""
        if self.held:
            return np.zeros_like(self.command)
        return rises(self.t_s, self.command, self.jumped)

    def commanded(self, command: Array) -> "Run":
        """Return the run as if this had been its command (rows, motors)."""
        run = replace(self, command=command, recording=self.recording.commanded(command))
        return run if self.held else replace(run, recording=run.recording.rising(run.rise))

    def moving_in_rows(self) -> "Run":
        """Return the run as if commands moved within rows as the means of those tell."""
        run = self.parted or self
        recording = run.recording.reading_before(READ_AMID)
        return replace(run, held=False, recording=recording).commanded(run.command)

    def held_in_rows(self) -> "Run":
        """Return the run as if commands had been held within rows, but for jumps there."""
        run = self.parted or self
        recording = run.recording.rising(0.0 * run.command).reading_before(run.reads_before)
        return replace(run, held=True, recording=recording)

    def set_with_rows(self) -> "Run":
        """Return the run as if commands had been held and jumped where rows begin.

        Rows beside lost ones are means of several commands: there they jump as the means tell.
        """
        run = self.held_in_rows()
        whole = run.t_s[run.jumped + 1] - run.t_s[run.jumped - 1] < LOST * run.row_s
        command = joined(run.t_s, run.command, run.jumped[whole])
        return replace(run.commanded(command), parted=run)

    def taken_as(self, machine: Machine) -> "Run":
        """Return the run with commands that move as those of this robot do."""
        if machine.jumps_with_rows:
            return self.set_with_rows()
        return self.held_in_rows() if machine.holds_commands else self.moving_in_rows()


def make_run(machine: Machine, log: Log, begin: int = 0, end: int | None = None) -> Run:
    """Turn rows begin..end of a log into a run."""
    rows = slice(begin, end)
    t_s = np.ascontiguousarray(log.t_s[rows])
    jumped, settle_s = np.zeros(0, np.intp), _core.SETTLE_S
    at_rest, begun_variance = False, None
    if machine.kind == "odometry":
        return _odometry_run(machine, log, rows, t_s)
    if machine.kind == "robot":
        command, outputs = _robot_signals(machine, log, rows)
        rim_m_s = _begun_rim_speeds(machine, t_s, outputs)
        begins = begin == 0 and bool(np.max(np.abs(rim_m_s)) < SLOW_M_S)
        if begins:
            mean_m_s = _rim_speeds(machine, t_s, outputs, 1)
            at_rest = bool(np.max(np.abs(mean_m_s)) < STILL_M_S)
            begun_variance = _begun_variance(machine, command, rim_m_s, mean_m_s)
        else:
            rim_m_s = _rim_speeds(machine, t_s, outputs, FIRST_ROWS)
        state, seen = _first_state(machine, t_s, outputs, rim_m_s)
        if not sees_pose(log):
            state[11:14] = reckoned_pose(machine, log, begin)
        settle_s = _core.SETTLE_S if begins or seen else UNSEEN_SETTLE_S
        t_s, command, outputs, jumped = parted_at_jumps(t_s, command, outputs)
        channels: tuple[str, ...] = robot_channels(machine)
        counts_per_rad = machine.model.values["encoder.counts_per_rev"] / (2 * np.pi)
        scale = np.array([counts_per_rad] * 4 + [1.0] * (len(channels) - 4))
    else:
        position = _position(machine)
        command = np.ascontiguousarray(log.columns["axis/command"][rows, None])
        outputs = np.ascontiguousarray(log.columns[position][rows, None])
        span = min(len(t_s) - 1, 5)
        speed = (outputs[span, 0] - outputs[0, 0]) / (t_s[span] - t_s[0])
        state = np.array([speed, outputs[0, 0]])
        channels, scale = (position,), np.ones(1)
    recording = machine.recording(t_s, command, outputs, state, settle_s, begun_variance)
    if machine.kind == "robot":
        recording = recording.missing(_untold(machine, log, t_s))
        if begin > 0:
            recording = recording.warmed(*_past_currents(machine, log, begin))
    # The engine reads a blank command as "drive off"; for everybody else that is no command.
    off = np.isnan(command[:, 0])
    run = Run(
        log.name,
        t_s,
        np.nan_to_num(command),
        outputs,
        channels,
        scale,
        recording,
        off,
        log.name,
        float(log.t_s[0]),
        jumped,
        at_rest,
        reads_before=machine.reads_before,
    )
    return run.taken_as(machine) if machine.kind == "robot" else run


def sees_pose(log: Log) -> bool:
    """Whether a camera shows a robot anywhere in a log."""
    return any(np.isfinite(log.columns[name]).any() for name in POSE_COLUMNS if name in log.columns)


def reckoned_pose(machine: Machine, log: Log, row: int) -> Array:
    """Return the pose (3,) in a row by dead reckoning from where the log begins.

    Where it has turned by gyro, if there is one, how far it has gone by its wheels: a floor that
    slopes pulls a later piece of the log from where it pulled the first.
    """
    forward, left, turn = _reckoned_steps(machine, log)[:, :row]
    x_m, y_m, begun_rad = log.begun_at
    heading = begun_rad + np.append(0.0, np.cumsum(turn))
    way = np.sum((forward + 1j * left) * np.exp(1j * (heading[:-1] + 0.5 * turn)))
    return np.array([x_m + way.real, y_m + way.imag, heading[-1]])


def _reckoned_steps(machine: Machine, log: Log) -> Array:
    """Return how far a robot goes forward, to the left and round (3, rows - 1) from row to row."""
    turned_rad = np.diff(
        [unwrap_counts(log.columns[name]) for name in ROBOT_CHANNELS[:4]]
    ) * count_rad(machine)
    inverse = np.linalg.pinv(wheel_jacobian(machine)) * rim_m_per_rad(machine)
    steps = np.nan_to_num(inverse @ turned_rad)
    gyro = log.columns.get(ROBOT_CHANNELS[4], np.full(len(log.t_s), np.nan))
    by_gyro = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(log.t_s)
    steps[2] = np.where(np.isnan(by_gyro), steps[2], by_gyro)
    return steps


def first_pose(log: Log, begin: int, end: int) -> int:
    """Return the row of begin..end at which the pose columns are known first; `end` if none is.

    `begin` where the filter is still settling then: a run starts from its first pose, but where the
    camera is lost for longer the robot has gone on meanwhile.
    """
    poses = [log.columns[name][begin:end] for name in POSE_COLUMNS if name in log.columns]
    seen = [np.flatnonzero(~np.isnan(values)) for values in poses]
    first = begin + max((int(rows[0]) for rows in seen if rows.size), default=end - begin)
    settling = first < end and log.t_s[first] - log.t_s[begin] < _core.SETTLE_S
    return begin if settling else first


def _odometry_run(machine: Machine, log: Log, rows: slice, t_s: Array) -> Run:
    """Encoder rates (rows, wheels) in rad/s drive the model, the pose is what it is judged by."""
    rad_per_count = 2 * np.pi / float(machine.model.values["odometry.counts_per_rev"])
    names = [f"wheel/{wheel}/encoder_counts" for wheel in range(1, machine.wheels + 1)]
    if names[-1] not in log.columns or f"wheel/{machine.wheels + 1}/encoder_counts" in log.columns:
        raise InputError(f"{log.name}: the model has {machine.wheels} wheels, the log has others")
    angles = np.stack([unwrap_counts(log.columns[name][rows]) for name in names], axis=1)
    rates = np.diff(angles * rad_per_count, axis=0) / np.diff(t_s)[:, None]
    rates = np.concatenate([rates, rates[-1:]])
    pose = np.stack([log.columns[name][rows] for name in ROBOT_CHANNELS[5:]], axis=1)
    turn = (rates @ of_encoders(machine))[:-1, 2] * np.diff(t_s)
    pose[:, 2] = _unwrap_sampled(t_s, pose[:, 2], np.append(0.0, np.cumsum(turn)))
    first = np.array([column[~np.isnan(column)][0] for column in pose.T])
    padded = np.zeros((len(t_s), machine.engine.motors))
    padded[:, : machine.wheels] = rates
    recording = machine.engine.recording(t_s, padded, pose, first)
    return Run(
        log.name,
        t_s,
        rates,
        pose,
        ODOMETRY_CHANNELS,
        np.ones(3),
        recording,
        unit=log.name,
        log_begin_s=float(log.t_s[0]),
    )


def machine_for(model: Model, logs: Sequence[Log]) -> Machine:
    """Return the believed machine with the outputs that the logs have.

    InputError for an axis that turns whose log shows a way, and the other way round.
    """
    measured = any(_varies(log.columns.get(name)) for log in logs for name in ELECTRIC_CHANNELS)
    machine = Machine(model, electric=model.kind == "robot" and measured)
    if machine.kind == "axis":
        for log in logs:
            if _position(machine) not in log.columns:
                kind = "axis.mass_kg" if machine.linear else "axis.inertia_kg_m2"
                raise InputError(f"{log.name}: a model with {kind} needs {_position(machine)}")
    return machine


def _position(machine: Machine) -> str:
    return "axis/position_m" if machine.linear else "axis/position_rad"


def unused_columns(machine: Machine, logs: Sequence[Log]) -> list[str]:
    """Return what nothing uses: columns that a machine has no output for, constant measurements."""
    known = ELECTRIC_CHANNELS if machine.kind == "robot" else ("gyro/z_rad_s", *AXIS_OPTIONAL)
    unused = []
    for name in known:
        there = [log.columns[name] for log in logs if name in log.columns]
        if machine.kind != "robot" and there:
            unused.append(name)
        elif constant := sum(not _varies(values) for values in there):
            unused.append(f"{name} (does not vary in {constant} of {len(logs)} logs)")
    return unused


def _varies(values: Array | None) -> bool:
    """Whether a column is there and no constant that stands in for a measurement."""
    sampled = values[~np.isnan(values)] if values is not None else np.empty(0)
    return sampled.size > 1 and bool(sampled.min() < sampled.max())


def robot_channels(machine: Machine) -> tuple[str, ...]:
    """Return the columns that the engine's outputs stand for."""
    return ROBOT_CHANNELS + ELECTRIC_CHANNELS if machine.electric else ROBOT_CHANNELS


def unwrap_counts(counts: Array) -> Array:
    """Return cumulative counts from counts that may wrap at 16 bit, from the first count on.

    Right as long as a wheel moves less than 32768 counts from row to row. The first count stays: it
    is the angle of the shaft, and cogging or eccentricity have the same phase in every run.
    """
    step = (np.diff(counts) + 32768) % 65536 - 32768
    return counts[0] + np.concatenate([[0.0], np.cumsum(step)])


def _robot_signals(machine: Machine, log: Log, rows: slice) -> tuple[Array, Array]:
    columns = {name: values[rows] for name, values in log.columns.items()}
    blank = np.full(len(log.t_s[rows]), np.nan)
    command = np.stack([columns[f"wheel/{w}/duty"] for w in range(1, 5)], axis=1)
    rad_per_count = count_rad(machine)
    counts = [unwrap_counts(log.columns[name])[rows] for name in ROBOT_CHANNELS[:4]]
    angles = [count * rad_per_count for count in counts]
    others = [columns.get(name, blank) for name in ROBOT_CHANNELS[4:]]
    turned = np.append(0.0, np.cumsum(_reckoned_steps(machine, log)[2]))
    others[3] = _unwrap_sampled(log.t_s[rows], others[3], turned[rows])
    # What flows goes with a command that has to be known: that of the last row has no row to be the
    # mean of, and what was read before one went with that of the row before, if it is there. Of a
    # first row that is never sure: tens of ampere of a robot that starts.
    commanded = np.arange(len(log.t_s))[rows] < len(log.t_s) - 1
    commanded[0] = False
    if machine.reads_before:
        commanded[1:] &= ~log.rows_missing(1)[rows][: len(commanded) - 1]
    electric = [
        np.where(commanded, columns[name], np.nan) if _varies(columns.get(name)) else blank
        for name in (ELECTRIC_CHANNELS if machine.electric else ())
    ]
    outputs = np.stack([*angles, *others, *electric], axis=1)
    return np.ascontiguousarray(command), outputs


def _untold(machine: Machine, log: Log, t_s: Array) -> Array:
    """Return a shaft's acceleration per duty in rad/s2, times the share of each row (rows,) untold.

    Where rows are missing the mean may be that of the time up to the first of them.
    """
    length_s = np.diff(t_s, append=t_s[-1] + log.row_s)
    share = np.where(length_s > LOST * log.row_s, 1.0 - log.row_s / length_s, 0.0)
    return share * stall_acceleration_rad_s2(machine)


def _past_currents(machine: Machine, log: Log, begin: int) -> tuple[Array, Array]:
    """Return lengths (stretches,) of a log before `begin` and squares (stretches, 4) of currents.

    As the believed motors would let them through when cold: windings are warm where a piece begins.
    They forget in tens of seconds, so means over `PAST_S` do. Where rows are missing for longer
    nothing is known to flow.
    """
    command, outputs = _robot_signals(machine, log, slice(0, begin + 1))
    values, length_s = machine.model.values, np.diff(log.t_s[: begin + 1])
    speed = np.diff(outputs[:, :4], axis=0) / length_s[:, None]
    driving_v = float(values["motor.supply_v"]) * command[:-1]
    driving_v = driving_v - float(values["motor.back_emf_constant_v_s_rad"]) * speed
    current_a = driving_v / float(values["motor.resistance_ohm"])
    stretch = ((log.t_s[:begin] - log.t_s[0]) / PAST_S).astype(int)
    first = np.flatnonzero(np.diff(stretch, prepend=-1))
    current_a[length_s > PAST_S] = 0.0
    heat = np.add.reduceat(length_s[:, None] * np.nan_to_num(current_a) ** 2, first, axis=0)
    whole_s = np.add.reduceat(length_s, first)
    return whole_s, heat / whole_s[:, None]


def _unwrap_sampled(t_s: Array, angle_rad: Array, turned_rad: Array) -> Array:
    """Return headings (rows,) without jumps by whole turns where they are sampled.

    Where the camera is lost for longer, beside what gyro or wheels have turned by.
    """
    sampled = np.flatnonzero(~np.isnan(angle_rad))
    lost = np.diff(t_s[sampled]) > GLANCE_S
    turn = np.where(lost, np.diff(turned_rad[sampled]), 0.0)
    meanwhile = np.concatenate([np.zeros(min(1, sampled.size)), np.cumsum(turn)])
    result = angle_rad.copy()
    result[sampled] = meanwhile + np.unwrap(angle_rad[sampled] - meanwhile)
    return result


def _first_state(
    machine: Machine, t_s: Array, outputs: Array, rim_m_s: Array
) -> tuple[Array, bool]:
    """Return the first state (14,), and whether the camera has seen its velocity.

    From the speeds of the wheels' rims, `rim_m_s` (4,). Body velocity by J+ of eq. (3), pose from
    its first row. Where camera or gyro see that the wheels slide, they tell the velocity: a
    parabola through the poses of GLANCE_S, its slope turned into the robot's axes.
    """
    velocity = np.linalg.pinv(wheel_jacobian(machine)) @ rim_m_s
    first = [column[~np.isnan(column)][:1] for column in outputs[:, 5:8].T]
    pose = [float(value[0]) if value.size else 0.0 for value in first]
    seen = np.full(3, np.nan)
    shown = ~np.isnan(outputs[:, 5:8]).any(axis=1) & (t_s <= t_s[0] + GLANCE_S)
    if shown.sum() >= LEAST_GLANCES:
        passed_s = t_s[shown] - t_s[0]
        slope = np.polynomial.polynomial.polyfit(passed_s, outputs[shown, 5:8], 2)[1]
        along = complex(*slope[:2]) * np.exp(-1j * pose[2])
        seen = np.array([along.real, along.imag, slope[2]])
    by_camera = not np.isnan(seen[0])
    if not np.isnan(outputs[0, 4]):
        seen[2] = outputs[0, 4]
    lever = np.array([1.0, 1.0, float(machine.model.values["robot.wheel_distance_m"])])
    if np.max(lever * np.abs(np.nan_to_num(seen - velocity))) > SLIDING_M_S:
        velocity = np.where(np.isnan(seen), velocity, seen)
    speed = rim_m_s / rim_m_per_rad(machine)
    return np.concatenate([speed, outputs[0, :4], velocity, pose]), by_camera


def _begun_rim_speeds(machine: Machine, t_s: Array, outputs: Array) -> Array:
    """Speeds (4,) of the wheels' rims in m/s when the first row begins, by a cubic of their angles.

    None where rounding to counts makes as much; no faster than in the first, nor the other way
    round. (A motor gains ten turns a second in a row, and less in the next: where wheels spin up,
    1 - exp(-t / 11 ms) of 2.6 m/s is 0.5 m/s in the mean of the first row, and begins at 0.04 by a
    cubic, at 0.25 by a parabola.)
    """
    mean_m_s = _rim_speeds(machine, t_s, outputs, 1)
    if len(t_s) <= FIRST_ROWS:
        return mean_m_s
    rows = slice(0, FIRST_ROWS + 1)
    slope = np.linalg.inv(np.vander(t_s[rows] - t_s[0], increasing=True))[1]
    begun_rad_s = slope @ outputs[rows, :4]
    rounded_rad_s = 0.5 * np.sum(np.abs(slope)) * count_rad(machine)
    begun_rad_s[np.abs(begun_rad_s) <= rounded_rad_s] = 0.0
    begun_m_s = begun_rad_s * rim_m_per_rad(machine)
    return np.clip(begun_m_s, np.minimum(mean_m_s, 0.0), np.maximum(mean_m_s, 0.0))


def _begun_variance(machine: Machine, command: Array, rim_m_s: Array, mean_m_s: Array) -> Array:
    """Variances (21,) of the first state of a robot that begins, and of what disturbs its shafts.

    A log may miss some milliseconds of a start: then shafts turn as fast as between the begin of
    their first row, `rim_m_s` (4,), and in its mean, `mean_m_s` (4,); body and currents that lag
    behind the command are somewhere between rest and where they go.
    """
    lever_m = float(machine.model.values["robot.wheel_distance_m"])
    speed_rad_s = (mean_m_s - rim_m_s) / rim_m_per_rad(machine)
    lacking = 0.5 * command[0] * stall_acceleration_rad_s2(machine)
    body = STARTING_VARIANCE / np.array([1.0, 1.0, lever_m**2])
    state = first_variance(machine, SHAFT_VARIANCE + (0.5 * speed_rad_s) ** 2, body)
    return np.concatenate([state, lacking**2, np.zeros(3)])


def first_variance(machine: Machine, shafts: npt.ArrayLike, body: npt.ArrayLike) -> Array:
    """Variances (14,) of a robot's first state by those of its speeds, (4,) or one and (3,)."""
    return np.concatenate(
        [
            np.broadcast_to(shafts, 4),
            np.full(4, count_rad(machine) ** 2),
            np.asarray(body),
            np.full(3, PLACE_VARIANCE),
        ]
    )


def _rim_speeds(machine: Machine, t_s: Array, outputs: Array, rows: int) -> Array:
    """Mean speeds (4,) of the wheels' rims in m/s over the first rows."""
    span = min(len(t_s) - 1, rows)
    return (outputs[span, :4] - outputs[0, :4]) / (t_s[span] - t_s[0]) * rim_m_per_rad(machine)


def rim_m_per_rad(machine: Machine) -> float:
    """Return the way of a wheel's rim per angle of its motor's shaft, in m/rad."""
    values = machine.model.values
    return float(values["robot.wheel_radius_m"]) / float(values["motor.gear_ratio"])


def body_errors(run: Run, errors: Array) -> Array:
    """Turn errors (..., rows, channels) of an odometry's x and y into forward and lateral ones.

    Anything else comes back as it is.
    """
    if run.channels != ODOMETRY_CHANNELS:
        return errors
    turn = np.exp(-1j * run.outputs[:, 2])
    along = (errors[..., 0] + 1j * errors[..., 1]) * turn
    return np.stack([along.real, along.imag, errors[..., 2]], axis=-1)


def of_encoders(machine: Machine) -> Array:
    """Return the velocity (wheels, 3) of an odometry's body per rate of each of its encoders."""
    wheels, engine = machine.wheels, machine.engine
    unit = np.zeros((wheels, engine.motors))
    unit[:, :wheels] = np.eye(wheels)
    return engine.derivatives(machine.believed, np.zeros((wheels, 3)), unit)


def wheel_jacobian(machine: Machine) -> Array:
    """J of eq. (3), (4, 3): body velocity to rim speeds."""
    angles = np.deg2rad(np.asarray(machine.model.values["robot.wheel_angles_deg"]))
    distance = float(machine.model.values["robot.wheel_distance_m"])
    return np.stack([-np.sin(angles), np.cos(angles), np.full(4, distance)], axis=1)
