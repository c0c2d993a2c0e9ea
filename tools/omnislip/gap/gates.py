"""Gates: mistakes of recording, told before any physics is looked for.

What a log shows is compared with what its encoders say: J+ of eq. (3) turns their steps into a
motion of the body, without a model of motors or friction. That is right but for slip, so only what
no slip can do counts. A gate either mends a log (a pose or turn rate that jumps for one sample is
blanked), cuts it (a gap in time, a camera that starts anew somewhere else), or says in one sentence
why the logs cannot be used as they are. Set-points in place of applied duties show last: a ramped
duty has to explain the log far better than the logged one does with everything that was found for
it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from omnislip.gap.machine import Machine, count_rad, stall_acceleration_rad_s2, stall_current_a
from omnislip.gap.noise import (
    STEP_S,
    YAW,
    RunawayError,
    first_guess,
    track_all,
    track_recordings,
    tune_noise,
)
from omnislip.gap.recordings import (
    ELECTRIC_CHANNELS,
    ROBOT_CHANNELS,
    make_run,
    unwrap_counts,
    wheel_jacobian,
)
from omnislip.log_file import POSE_COLUMNS, Log

Array = npt.NDArray[np.float64]

MOST_ROW_S = 0.5
GAP_S = 0.1
"""Rows may be missing; from here on the log is cut."""
LATE_S, CAMERA_LATE_S = 0.08, 0.15
"""Lags up to here are no mistake: of the gyro, or a camera that is early; of a camera that is late,
which is an effect with a size (of 0.13 and 0.14 s it came right, beside 0.18 s nonsense came)."""
MOST_SKEW = 0.04
"""Of two clocks: what clock_skew describes, and a fifth less."""
SLIP_LATE_S = 0.25
"""The body may follow slipping wheels as late as this."""
MOST_LAG_S = 0.6
GRID_S = 0.01
WINDOW_S = 0.2
ALIKE = 0.9
"""Correlation of two sensors from which on their scale and lag can be judged."""
AS_ALIKE = 0.05
"""Difference of correlations that does not tell one period of a wave from another."""
PLAUSIBLE_SCALE = {
    "gyro/z_rad_s": (0.3, 3.0),
    "pose/theta_rad": (0.15, 4.0),
    "pose/x_m": (0.15, 4.0),
}
"""Factor between sensor and wheels; hard slip makes the body's share of the wheels' way small."""
LIKE_SLIDING = 0.2
"""Spread of that factor, as a share of it, from which too small a one may be hard slip (a robot on
a patch of ice: 0.42), which no two windows have alike. Three of four logs have less, and the
gentlest log of 95 % of robots 0.07."""
WHEELS = "against the encoders"
UNITS = {
    "gyro/z_rad_s": {180 / np.pi: "degrees per second", 1e3: "thousandths of rad/s"},
    "pose/theta_rad": {180 / np.pi: "degrees", 1e3: "thousandths of rad"},
    "pose/x_m": {1e3: "millimetres", 1e2: "centimetres", 1e-3: "kilometres"},
}
LEAST_TURN_RAD_S, LEAST_TURN_RAD = 0.2, 0.5
"""Turning, and how far in all, by which a scale can be told."""
STEP_M, STEP_M_S = 0.05, 1.0
TURN_RAD, TURN_RAD_S = 0.15, 2.0
"""How far a picture may be from where its neighbours' motion puts it: offset, rate."""
NEIGHBOURS = 7
"""Pictures whose median motion counts: one that is false spoils two of six steps."""
MOST_JUMPS = 0.05
FALSE_RATE_RAD_S, FALSE_RATE_RAD_S2 = 1.0, 500.0
"""No torque turns a body so fast, above its neighbours' median, for a sample and back: offset, and
rate for the time between samples."""
RESOLUTIONS = 2.0
"""Least steps of a camera that a robot goes before it should show another pose."""
STILL_S = 0.3
MOST_TURN_RAD = 0.5
BLIND_DUTY = 0.15
OTHER_MOTION = 0.5
"""Share of RMS by which two wheels' speeds, or duties, differ if one is not the other's copy."""
LEAST_WAY_M = 0.3
"""What never changes in a log is dead if the robot has gone as far as this."""
OTHER_TRAVEL, OTHER_SPEED = 0.06, 0.15
"""Share by which travel per turn and speed may differ between logs of one robot."""
MOST_SPREAD = 0.2
"""Of that of one robot, from the lowest tenth to the highest: 0.03 to 0.09 of those with other
wheels or gears, where steady wheels slide under a body that follows slowly 0.35 and more."""
SURE = 5.0
LOOK_AT_S = 20.0
RAMPS_1_S = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
RAMP_GAIN, RAMP_GAIN_OWN = 1.0, 0.1
"""Log-likelihood per reading that a ramp has to gain by a first guess of the noise, and by noise
that fits each: set-points of 1 to 12 per second gained 0.7 to 12, and 0.6 to 1.2."""
LOST = -1e300
"""Log-likelihood where the filter loses the robot."""
LEAST_VISIBLE = 0.5
"""Share of the effects that logs must be able to show at a size worth looking for."""


@dataclass(frozen=True)
class Checked:
    """Logs after the gates: mended, where to cut them (run, time), and why not to use them."""

    logs: list[Log]
    cuts: list[tuple[str, float]]
    complaint: str | None
    told: list[str] = field(default_factory=list)
    """What was mended and where it was cut, in sentences."""


def check(machine: Machine, logs: Sequence[Log]) -> Checked:
    """Pass the logs of a robot through the gates; logs of an axis are only cut at their gaps."""
    cuts, told = [], []
    for log in logs:
        gaps_s = _gaps(log)
        cuts += [(log.name, t) for t in gaps_s]
        told += _told(log, "rows are missing, the log is cut there:", gaps_s)
    if machine.kind != "robot":
        return Checked(list(logs), cuts, None, told)
    mended, doubts = [], []
    for log in logs:
        doubt = _doubtful_duty(machine, log)
        if doubt:
            doubts.append(f"{log.name}: {doubt}")
            continue
        better, false_s = _without_false_rates(log)
        complaint = _complaint(machine, better)
        if complaint:
            return Checked(list(logs), cuts, f"{log.name}: {complaint}")
        told += _told(log, "false gyro/z_rad_s, not used:", false_s)
        better, again_s = _without_repeats(machine, better)
        told += _told(log, "the camera shows the last pose again, not used:", again_s)
        better, false_s, jumps_s, often = _without_jumps(better)
        if often:
            complaint = f"{log.name}: the pose jumps again and again, first at {often:.2f} s"
            return Checked(list(logs), cuts, complaint)
        mended.append(better)
        cuts += [(log.name, t) for t in jumps_s]
        told += _told(log, "false pose, not used:", false_s)
        told += _told(log, "the pose goes on from another place, the log is cut there:", jumps_s)
    if doubts and not mended:
        return Checked(list(logs), cuts, doubts[0])
    told += [f"{doubt}; the log is not used" for doubt in doubts]
    return Checked(mended, cuts, _other_robot(machine, mended), told)


def _told(log: Log, what: str, times_s: Sequence[float]) -> list[str]:
    """Return one sentence about these times of a log, the first of them named; none of none."""
    if not times_s:
        return []
    more = f" and {len(times_s) - 3} more" if len(times_s) > 3 else ""
    return [f"{log.name}: {what} {', '.join(f'{t:.3f} s' for t in times_s[:3])}{more}"]


def rows_far_apart(logs: Sequence[Log]) -> str | None:
    """Say which log has its rows too far apart, or None. Anything else takes hours on them."""
    for log in logs:
        if log.row_s > MOST_ROW_S:
            return (
                f"the rows of {log.name} are {log.row_s:g} s apart, at most {MOST_ROW_S:g} s show "
                "how a machine moves; t_s counts seconds"
            )
    return None


def _complaint(machine: Machine, log: Log) -> str | None:
    """Return the first reason why this log cannot be used."""
    for gate in (
        _jumping_counts,
        _stuck_encoder,
        _copied_counts,
        _clipped_gyro,
        _flat,
        _wrong_scale,
        _electric,
        _late,
    ):
        complaint = gate(machine, log)
        if complaint:
            return complaint
    return None


# ---- what the encoders say ----


def _wheel_travel_m(machine: Machine, log: Log) -> Array:
    """Way of the wheels' rims (rows, 4)."""
    values = machine.model.values
    metre = 2 * np.pi * values["robot.wheel_radius_m"] / values["motor.gear_ratio"]
    counts = [unwrap_counts(log.columns[name]) for name in ROBOT_CHANNELS[:4]]
    return np.stack(counts, axis=1) * (metre / values["encoder.counts_per_rev"])


def _body_travel(machine: Machine, log: Log) -> Array:
    """Way of the body in its own frame and turn (rows, 3): m, m, rad."""
    return _wheel_travel_m(machine, log) @ np.linalg.pinv(wheel_jacobian(machine)).T


def _sampled(log: Log, *names: str) -> npt.NDArray[np.intp]:
    """Rows in which each of the columns has a value: none where a column is not logged."""
    if any(name not in log.columns for name in names):
        return np.array([], dtype=np.intp)
    return np.flatnonzero(~np.isnan([log.columns[name] for name in names]).any(axis=0))


def _turn_rates(machine: Machine, log: Log) -> tuple[Array, Array, Array] | None:
    """Grid of 10 ms, turn rate of the wheels and of the gyro on it, both averaged over 50 ms."""
    rows = _sampled(log, "gyro/z_rad_s")
    if rows.size < 50:
        return None
    grid = np.arange(log.t_s[0], log.t_s[-1], GRID_S)
    turned = np.interp(grid, log.t_s, _body_travel(machine, log)[:, 2])
    shown = np.interp(grid, log.t_s[rows], log.columns["gyro/z_rad_s"][rows])
    return grid, _over_50_ms(np.gradient(turned, GRID_S)), _over_50_ms(shown)


def _over_50_ms(values: Array) -> Array:
    """Means of what is on the grid."""
    return np.convolve(values, np.ones(5) / 5, "same")


def _lag_s(reference: Array, shown: Array) -> tuple[float, float]:
    """Lag of `shown` behind `reference` (both on 10 ms), and their correlation at that lag.

    A wave is as much like itself half a period later: of what is as much alike, the least lag.
    """
    most = round(MOST_LAG_S / GRID_S)
    if len(reference) < 4 * most:
        return 0.0, 0.0
    alike = np.zeros(2 * most + 3)  # of all shifts; what lies beyond is not alike
    for shift in range(-most, most + 1):
        a = reference[most - shift : len(reference) - most - shift]
        b = shown[most : len(shown) - most]
        if a.std() > 0 and b.std() > 0:
            alike[most + 1 + shift] = abs(float(np.corrcoef(a, b)[0, 1]))
    peak = (alike[1:-1] >= alike[:-2]) & (alike[1:-1] >= alike[2:])
    likely = np.flatnonzero(peak & (alike[1:-1] >= alike.max() - AS_ALIKE)) - most
    shift = likely[np.argmin(np.abs(likely))]
    return float(shift * GRID_S), float(alike[most + 1 + shift])


# ---- one log ----


def _gaps(log: Log) -> list[float]:
    """Times of the last rows before a gap."""
    step_s = np.diff(log.t_s)
    return log.t_s[:-1][step_s > max(GAP_S, 10 * float(np.median(step_s)))].tolist()


def _jumping_counts(machine: Machine, log: Log) -> str | None:
    """A step of the counter that the motor cannot make: a counter of another width, or errors.

    Where rows are uneven it may be their stamps that are off, by as much.
    """
    values = machine.model.values
    counts_per_rad = values["encoder.counts_per_rev"] / (2 * np.pi)
    dt_s = np.diff(log.t_s)
    uneven_s = np.abs(dt_s - log.row_s)
    uneven_s = np.max([uneven_s[:-2], uneven_s[1:-1], uneven_s[2:]], axis=0)
    for wheel, name in enumerate(ROBOT_CHANNELS[:4], 1):
        steps = np.diff(unwrap_counts(log.columns[name]))
        speed = steps / dt_s
        change = np.abs(speed[1:-1] - (speed[2:] + speed[:-2]) / 2) * dt_s[1:-1]
        possible = 2.0 * stall_acceleration_rad_s2(machine) * counts_per_rad * dt_s[1:-1] ** 2 + 20
        possible += np.abs(steps[2:] + steps[:-2]) / (2.0 * log.row_s) * uneven_s
        bad = np.flatnonzero(change > possible)
        if not bad.size:
            continue
        bad = bad[change[bad] > 0.75 * change[bad].max()]  # its neighbours show half a jump
        size = float(np.median(change[bad]))
        at = (
            f"wheel/{wheel}/encoder_counts jumps by about {size:.0f} at {log.t_s[bad[0] + 1]:.3f} s"
        )
        width = round(np.log2(size))
        if bad.size > 1 and abs(size / 2.0**width - 1) < 0.1 and width < 16:
            return f"{at}: it seems to wrap at {width} bit, the log needs 16 bit or no wrap"
        return f"{at}, more than the motor can turn"
    return None


def _stuck_encoder(machine: Machine, log: Log) -> str | None:
    """A counter that stands still while its motor is driven and the other wheels run."""
    steps_m = np.abs(np.diff(_wheel_travel_m(machine, log), axis=0))
    speed, way_m = steps_m / np.diff(log.t_s)[:, None], steps_m.sum(axis=0)
    duty = np.abs(_duties(log)).mean(axis=0)
    for wheel, name in enumerate(ROBOT_CHANNELS[:4], 1):
        still = np.diff(log.columns[name]) == 0
        driven = np.abs(log.columns[f"wheel/{wheel}/duty"][:-1]) > BLIND_DUTY
        others = np.median(np.delete(speed, wheel - 1, axis=1), axis=1) > 0.05
        for begin, end in _stretches(still & driven & others):
            if log.t_s[end] - log.t_s[begin] > STILL_S:
                return (
                    f"{name} stands still from {log.t_s[begin]:.2f} to {log.t_s[end]:.2f} s while "
                    f"its motor is driven and the other wheels turn"
                )
        # A wheel may rightly stand still in a whole log, but its motor then does hardly anything.
        usual_m, usual_duty = (np.median(np.delete(v, wheel - 1)) for v in (way_m, duty))
        if way_m[wheel - 1] == 0 and usual_m > LEAST_WAY_M and duty[wheel - 1] > usual_duty / 2:
            return f"{name} never changes, though its motor is driven and the other wheels turn"
    return None


def _doubtful_duty(machine: Machine, log: Log) -> str | None:
    """A duty that never changes though its wheel turns as much as those whose duties do, or a copy.

    A programme may ask for that in some of the logs; in all of them a column is not what it says.
    """
    duty, way_m = _duties(log), _wheel_travel_m(machine, log)
    turned_m = np.abs(np.diff(way_m, axis=0)).sum(axis=0)
    for wheel in range(4):
        usual_m = np.median(np.delete(turned_m, wheel))
        others_vary = np.all(np.ptp(np.delete(duty, wheel, axis=1), axis=0) > BLIND_DUTY)
        turns = usual_m > LEAST_WAY_M and turned_m[wheel] > usual_m / 2
        if np.ptp(duty[:, wheel]) == 0 and others_vary and turns:
            return (
                f"wheel/{wheel + 1}/duty is {duty[0, wheel] + 0.0:g} in every row, though its "
                "wheel turns as much as the others: log the duty that is applied"
            )
    speed = np.gradient(way_m, log.t_s, axis=0)
    return _copied(("duty", duty), ("encoder_counts", speed))


def _copied_counts(machine: Machine, log: Log) -> str | None:
    """Two wheels that turn alike in every row, though their duties differ."""
    speed = np.gradient(_wheel_travel_m(machine, log), log.t_s, axis=0)
    return _copied(("encoder_counts", speed), ("duty", _duties(log)))


def _copied(alike: tuple[str, Array], other: tuple[str, Array]) -> str | None:
    """Say which wheel's column (rows, 4) is another's in every row, though others differ."""
    for one, two in combinations(range(4), 2):
        same = alike[1][:, one], alike[1][:, two]
        apart = other[1][:, one], other[1][:, two]
        rms = np.sqrt(np.mean(np.square([*apart, apart[0] - apart[1]]), axis=1))
        if np.array_equal(*same) and np.any(same) and rms[2] > OTHER_MOTION * max(rms[:2]):
            return (
                f"wheel/{two + 1}/{alike[0]} is that of wheel {one + 1} in every row, though their "
                f"wheel/*/{other[0]} differ"
            )
    return None


def _duties(log: Log) -> Array:
    """Return the duties (rows, 4)."""
    return np.stack([log.columns[f"wheel/{wheel}/duty"] for wheel in range(1, 5)], axis=1)


def _stretches(mask: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _flat(machine: Machine, log: Log) -> str | None:
    """A sensor that shows one value, always or for a while, though the wheels move the robot."""
    travel = _body_travel(machine, log)
    rate = np.gradient(travel[:, 2], log.t_s)
    for begin, end in _unchanged(log, "gyro/z_rad_s"):
        if np.ptp(_smooth(rate[begin : end + 1])) > 0.5:
            return _stands_still("gyro/z_rad_s", log, begin, end)
    sensors = (
        ("the pose", POSE_COLUMNS, (0.1, 0.1, 0.3)),
        ("the position (pose/x_m, pose/y_m)", POSE_COLUMNS[:2], (LEAST_WAY_M, LEAST_WAY_M, np.inf)),
        ("pose/theta_rad", POSE_COLUMNS[2:], (np.inf, np.inf, 0.3)),
    )
    for name, columns, most in sensors:
        for begin, end in _unchanged(log, *columns):
            if np.any(np.ptp(travel[begin : end + 1], axis=0) > most):
                return _stands_still(name, log, begin, end)
    return _flat_coordinate(log, travel)


def _flat_coordinate(log: Log, travel: Array) -> str | None:
    """One of x and y that never changes, though by wheels and heading the robot goes that way."""
    rows = _sampled(log, *POSE_COLUMNS)
    if rows.size < 10:
        return None
    heading = np.unwrap(log.columns["pose/theta_rad"][rows])
    steps = np.diff(travel[rows, 0] + 1j * travel[rows, 1])
    way = np.cumsum(steps * np.exp(0.5j * (heading[1:] + heading[:-1])))
    for name, gone in zip(POSE_COLUMNS[:2], (way.real, way.imag), strict=True):
        if np.ptp(log.columns[name][rows]) == 0 and np.ptp(gone) > LEAST_WAY_M:
            return _stands_still(name, log, rows[0], rows[-1])
    return None


def _unchanged(log: Log, *names: str) -> list[tuple[int, int]]:
    """First and last row of the stretches over 0.3 s in which no sample of the columns changes."""
    rows = _sampled(log, *names)
    if rows.size < 10:
        return []
    changes = np.any([np.diff(log.columns[name][rows]) != 0 for name in names], axis=0)
    still = [(rows[a], rows[b]) for a, b in _stretches(~changes) if b - a >= 10]
    return [(int(a), int(b)) for a, b in still if log.t_s[b] - log.t_s[a] > STILL_S]


def _smooth(values: Array) -> Array:
    return np.convolve(values, np.ones(10) / 10, "valid") if len(values) > 10 else values


def _stands_still(name: str, log: Log, begin: int, end: int) -> str:
    return (
        f"{name} does not change from {log.t_s[begin]:.2f} to {log.t_s[end]:.2f} s while the "
        f"wheels move the robot"
    )


def _clipped_gyro(machine: Machine, log: Log) -> str | None:
    """The gyro rests at its largest value while the wheels turn the robot faster still."""
    rates = _turn_rates(machine, log)
    if rates is None:
        return None
    grid, wheels, _ = rates
    rows = _sampled(log, "gyro/z_rad_s")
    values = log.columns["gyro/z_rad_s"][rows]
    for limit in (values.max(), values.min()):
        at_limit = values == limit
        long = [s for s in _stretches(at_limit) if s[1] - s[0] >= 5]
        if abs(limit) < 0.2 or sum(b - a for a, b in long) < 10:
            continue
        inside = np.concatenate([rows[a:b] for a, b in long])
        turned = np.interp(log.t_s[inside], grid, wheels) * np.sign(limit)
        if np.median(turned) > 1.1 * abs(limit):
            return (
                f"gyro/z_rad_s is clipped at {limit:g} while the wheels turn the robot at "
                f"{np.median(turned):.2g} rad/s"
            )
    return None


def _windows(
    machine: Machine, log: Log, name: str, rolling_only: bool = False
) -> tuple[Array, Array]:
    """Way of wheels and of a pose column over windows of 0.2 s, where the wheels move at all.

    Nothing where they turn too little to tell a scale: sliding wheels go a little to either side.
    """
    own = [name] if name == "pose/theta_rad" else POSE_COLUMNS[:2]
    rows = _sampled(log, *(POSE_COLUMNS if rolling_only else own))
    if rows.size < 10:
        return np.empty(0), np.empty(0)
    travel = _body_travel(machine, log)[rows]
    stride = max(1, round(WINDOW_S / float(np.median(np.diff(log.t_s[rows])))))
    if name == "pose/theta_rad":
        wheels = travel[stride:, 2] - travel[:-stride, 2]
        shown = log.columns[name][rows]
        shown = shown[stride:] - shown[:-stride]
    else:
        place = np.stack([log.columns[c][rows] for c in POSE_COLUMNS[:2]], axis=1)
        wheels = np.hypot(*(travel[stride:, :2] - travel[:-stride, :2]).T)
        shown = np.hypot(*(place[stride:] - place[:-stride]).T)
    moving = np.abs(wheels) > (0.05 if name == "pose/theta_rad" else 0.03)
    if rolling_only:
        moving &= _rolling(machine, log, rows, stride)
    way = _wheel_travel_m(machine, log)[rows]
    moving &= _pulling_together(machine, way[stride:] - way[:-stride])
    least = 0.0 if rolling_only or name == "pose/x_m" else LEAST_TURN_RAD
    if np.sum(np.abs(wheels[moving])) < least * stride:
        return np.empty(0), np.empty(0)
    return wheels[moving], shown[moving]


def _pulling_together(machine: Machine, way: Array) -> npt.NDArray[np.bool_]:
    """Where the ways of the wheels (n, 4) have more that moves a body than works against itself.

    Elsewhere what the body does says which wheel grips better, not what a turn of the wheels is.
    """
    jacobian = wheel_jacobian(machine)
    body = way @ np.linalg.pinv(jacobian).T @ jacobian.T
    return np.abs(way - body).max(axis=1) < np.abs(body).max(axis=1)


def _rolling(
    machine: Machine, log: Log, rows: npt.NDArray[np.intp], stride: int
) -> npt.NDArray[np.bool_]:
    """Windows in which the wheels hardly slide: steady, nothing in the null space, nearly straight.

    While wheels pull the body or work against each other, their way says little about the body's;
    and the chord of a turn is shorter than its way.
    """
    travel = _wheel_travel_m(machine, log)[rows]
    way = travel[stride:] - travel[:-stride]
    half = travel[stride // 2 : len(travel) - stride + stride // 2] - travel[:-stride]
    jacobian = wheel_jacobian(machine)
    body = way @ np.linalg.pinv(jacobian).T
    most = np.abs(way).max(axis=1)
    uneven = np.abs(half - way * (stride // 2 / stride)).max(axis=1)
    inner = np.abs(way - body @ jacobian.T).max(axis=1)
    pose = np.stack([log.columns[c][rows] for c in POSE_COLUMNS], axis=1)
    whole = _turned(pose[stride:] - pose[:-stride])
    first = _turned(pose[stride // 2 : len(pose) - stride + stride // 2] - pose[:-stride])
    uneven_body = np.abs(first - whole * (stride // 2 / stride))
    pulled = uneven_body > 0.03 * np.abs(whole) + np.array([3e-3, 3e-3, 5e-3])
    return (
        (uneven < 0.03 * most)
        & (inner < 0.02 * most)
        & (np.abs(body[:, 2]) < MOST_TURN_RAD)
        & ~pulled.any(axis=1)
    )


def _wrong_scale(machine: Machine, log: Log) -> str | None:
    """Units, signs and counts per turn: factors between sensor and wheels that are out of reach."""
    rates = _turn_rates(machine, log)
    pairs = {}
    if rates is not None:
        grid, wheels, shown = rates
        travel = _wheel_travel_m(machine, log).T
        rim = np.gradient([np.interp(grid, log.t_s, way) for way in travel], GRID_S, axis=1).T
        turning = (np.abs(wheels) > LEAST_TURN_RAD_S) & _pulling_together(machine, rim)
        if GRID_S * np.sum(np.abs(wheels[turning])) > LEAST_TURN_RAD:
            pairs["gyro/z_rad_s"] = (wheels[turning], shown[turning])
    for name in ("pose/theta_rad", "pose/x_m"):
        pairs[name] = _windows(machine, log, name)
    for name, (wheels, shown) in pairs.items():
        if wheels.size < 20:
            continue
        ratio = float(np.median(shown / wheels))
        spread = float(np.median(np.abs(shown / wheels - ratio)))
        if spread > 0.5 * abs(ratio):
            continue  # nothing that is only a factor
        what = "turn" if name != "pose/x_m" else "way"
        low, high = PLAUSIBLE_SCALE[name]
        if -high < ratio < -low:
            return f"{name} shows the {what} of the wheels with the sign reversed"
        if low < ratio < high:
            continue
        for factor, unit in UNITS[name].items():
            if factor / 2 < abs(ratio) < 2 * factor:
                return f"{name} shows {ratio:.3g} times the {what} of the wheels: is it in {unit}?"
        if abs(ratio) < low and spread > LIKE_SLIDING * abs(ratio):
            continue
        return (
            f"{name} shows {ratio:.3g} times the {what} of the wheels: wrong unit, or "
            f"encoder.counts_per_rev, motor.gear_ratio or robot.wheel_radius_m is wrong?"
        )
    return _wrong_speed(machine, log)


def _wrong_speed(machine: Machine, log: Log) -> str | None:
    """Without other sensors: wheels far beyond the speed that the duty can give."""
    ratio = _speed_per_duty(machine, log)
    if ratio.size >= 20 and np.median(ratio) > 2.0:
        return (
            f"the encoders show {np.median(ratio):.3g} times the speed that the duty can give: is "
            f"the duty scaled, or encoder.counts_per_rev wrong?"
        )
    return None


def _electric(machine: Machine, log: Log) -> str | None:
    """Volts and amperes of a plausible size."""
    limits = {name: 3.0 * stall_current_a(machine) for name in ELECTRIC_CHANNELS[1:]}
    limits[ELECTRIC_CHANNELS[0]] = 3.0 * machine.model.values["motor.supply_v"]
    for name, most in limits.items():
        rows = _sampled(log, name)
        size = float(np.percentile(np.abs(log.columns[name][rows]), 95)) if rows.size else 0.0
        if size > most:
            unit = "V" if name == ELECTRIC_CHANNELS[0] else "A"
            return f"{name} shows up to {size:.4g} {unit}: is it in m{unit}?"
    voltage = ELECTRIC_CHANNELS[0]
    rows = _sampled(log, voltage)
    if rows.size and np.median(log.columns[voltage][rows]) < 0.0:
        return f"{voltage} is below 0: are its two leads exchanged?"
    return None


def _steady_windows(machine: Machine, log: Log) -> list[tuple[slice, int, float, float]]:
    """Windows of 0.2 s in which a wheel and its duty are steady: rows, wheel, shaft speed, duty."""
    rad = count_rad(machine)
    edges = np.arange(0, len(log.t_s), max(1, round(WINDOW_S / log.row_s)))
    found = []
    for wheel in range(4):
        counts = unwrap_counts(log.columns[f"wheel/{wheel + 1}/encoder_counts"])[edges]
        speed = rad * np.diff(counts) / np.diff(log.t_s[edges])
        duty = log.columns[f"wheel/{wheel + 1}/duty"]
        for k, (a, b) in enumerate(pairwise(edges)):
            steady = k > 0 and abs(speed[k] - speed[k - 1]) < 0.1 * abs(speed[k])
            mean = float(duty[a:b].mean())
            if steady and np.ptp(duty[a:b]) < 0.05 and abs(mean) > 0.05:
                found.append((slice(a, b), wheel, float(speed[k]), mean))
    return found


def _speed_per_duty(machine: Machine, log: Log) -> Array:
    """Steady shaft speeds over those of the unloaded motor, all wheels."""
    values = machine.model.values
    no_load = values["motor.supply_v"] / values["motor.back_emf_constant_v_s_rad"]
    steady = _steady_windows(machine, log)
    return np.array([speed / (duty * no_load) for _, _, speed, duty in steady])


def _speed_ratio(machine: Machine, log: Log) -> Array:
    """Steady shaft speeds over those of the believed model under the same duties, all wheels.

    Not per duty: wheels that push a robot askew turn a fifth slower than those that spin it.
    """
    believed = _driven_blindly(machine, log)
    found = []
    for rows, wheel, speed, _ in _steady_windows(machine, log):
        model = believed[rows, wheel]
        if np.ptp(model) < 0.1 * abs(model.mean()):
            found.append(speed / model.mean())
    return np.array(found)


def _driven_blindly(machine: Machine, log: Log) -> Array:
    """States (rows, states) of the believed model that starts at rest, by the duties alone."""
    run = make_run(machine, log)
    start = np.zeros(machine.engine.states)
    start[4:8] = run.outputs[0, :4]
    unseen = np.full_like(run.outputs, np.nan)
    recording = machine.engine.recording(run.t_s, run.command, unseen, start)
    noise = first_guess(machine, [run])
    [track] = track_recordings(machine, [recording], machine.believed, noise, STEP_S)
    return track.state.reshape(len(run.t_s), -1)[run.log_rows]


def _late(machine: Machine, log: Log) -> str | None:
    """Gyro or camera late, or early, by more than an effect of the sensor can describe.

    Slip makes the body follow the wheels late: between wheels and body only a large lag counts, and
    none that the believed model has as well under the same duties. Gyro and camera both see the
    body; where they disagree, the wheels tell which of them is off.
    """
    rates = _turn_rates(machine, log)
    if rates is None or rates[1].std() < 0.1:
        return None
    grid, wheels, gyro = rates
    lag_s, alike = _lag_s(wheels, gyro)
    camera = _camera_turn_rate(log, grid)
    if camera is None:
        if alike <= ALIKE or -LATE_S <= lag_s <= SLIP_LATE_S:
            return None
        beside_s, alike = _lag_s(_believed_turn_rate(machine, log, grid), gyro)
        own_s = beside_s if alike > ALIKE else lag_s
        return f"gyro/z_rad_s is {_words(own_s)} {WHEELS}" if abs(own_s) > LATE_S else None
    inside = ~np.isnan(camera)
    wheels, gyro, camera = wheels[inside], gyro[inside], camera[inside]
    between_s, alike = _lag_s(gyro, camera)
    if alike > ALIKE and abs(between_s) > LATE_S:
        own_s, others_s = lag_s, _lag_s(wheels, camera)[0]
        if abs(own_s) > abs(others_s):
            return f"gyro/z_rad_s is {_words(own_s)} {WHEELS}"
    third = len(gyro) // 3
    parts = [
        _lag_s(gyro[k * third : (k + 1) * third], camera[k * third : (k + 1) * third])
        for k in range(3)
    ]
    clear = [(k, lag_s) for k, (lag_s, alike) in enumerate(parts) if alike > ALIKE]
    if len(clear) >= 2 and abs(clear[-1][1] - clear[0][1]) > CAMERA_LATE_S:
        apart_s = (clear[-1][0] - clear[0][0]) * third * GRID_S
        share = (clear[-1][1] - clear[0][1]) / apart_s
        at_begin_s = clear[0][1] - share * (clear[0][0] + 0.5) * third * GRID_S
        if abs(share) < MOST_SKEW and -LATE_S < at_begin_s < CAMERA_LATE_S:
            return None  # the effect clock_skew
        return (
            f"the pose is {_words(clear[0][1])} against the gyro at first and "
            f"{_words(clear[-1][1])} later: clocks apart by {100 * abs(share):.1f} %"
        )
    if alike > ALIKE and not -LATE_S <= between_s <= CAMERA_LATE_S:
        return f"the pose is {_words(between_s)} against the gyro"
    return None


def _believed_turn_rate(machine: Machine, log: Log, grid: Array) -> Array:
    """Turn rate of the believed model on the grid, averaged over 50 ms; 0 where it is lost."""
    turn_rate = np.interp(grid, log.t_s, _driven_blindly(machine, log)[:, YAW])
    return _over_50_ms(np.nan_to_num(turn_rate))


def _words(lag_s: float) -> str:
    return f"{abs(lag_s):.2f} s {'late' if lag_s >= 0 else 'early'}"


def _camera_turn_rate(log: Log, grid: Array) -> Array | None:
    """Turn rate of the pose on the grid, averaged over 50 ms; NaN where there is no pose."""
    rows = _sampled(log, "pose/theta_rad")
    if rows.size < 50:
        return None
    heading = np.unwrap(log.columns["pose/theta_rad"][rows])
    shown = np.interp(grid, log.t_s[rows], heading, np.nan, np.nan)
    return _over_50_ms(np.gradient(shown, GRID_S))


def _turned(change: Array) -> Array:
    """Changes of a pose (..., 3) with the turn brought into (-pi, pi]."""
    change = change.copy()
    change[..., 2] = (change[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return change


def _without_false_rates(log: Log) -> tuple[Log, list[float]]:
    """Blank single false samples of the gyro, and say when; many are no mistakes but noise."""
    name = "gyro/z_rad_s"
    rows = _sampled(log, name)
    if rows.size < 10:
        return log, []
    shown = log.columns[name][rows]
    most = FALSE_RATE_RAD_S + FALSE_RATE_RAD_S2 * float(np.median(np.diff(log.t_s[rows])))
    false = rows[np.abs(shown - median_filter(shown, 5, mode="mirror")) > most]
    if len(false) > max(3, MOST_JUMPS * len(rows)):
        return log, []
    return _blanked(log, [name], false), log.t_s[false].tolist()


def _blanked(log: Log, names: Sequence[str], rows: npt.NDArray[np.intp]) -> Log:
    columns = dict(log.columns)
    for name in names:
        columns[name] = columns[name].copy()
        columns[name][rows] = np.nan
    return replace(log, columns=columns)


def _without_repeats(machine: Machine, log: Log) -> tuple[Log, list[float]]:
    """Blank poses that a camera shows again although the wheels move the robot, and say when.

    A pose that is measured has noise, and is never the same to the last digit. Where most of what
    is shown in motion are repeats, a recorder fills rows without a picture: all are blanked.
    """
    rows = _sampled(log, *POSE_COLUMNS)
    if rows.size < 10:
        return log, []
    steps = np.abs(np.diff([log.columns[name][rows] for name in POSE_COLUMNS], axis=1))
    same = np.all(steps == 0.0, axis=0)
    shown = [own[own > 0] for own in (steps[:2], steps[2])]
    if not same.any() or not all(own.size for own in shown):
        return log, []
    moved = np.abs(np.diff(_body_travel(machine, log)[rows], axis=0))
    ways = np.hypot(moved[:, 0], moved[:, 1]), moved[:, 2]
    moves = np.any(
        [way > RESOLUTIONS * own.min() for way, own in zip(ways, shown, strict=True)], axis=0
    )
    again = same & moves
    if np.sum(again) > np.sum(moves) / 2:
        again = same
    return _blanked(log, POSE_COLUMNS, rows[1:][again]), log.t_s[rows[1:][again]].tolist()


def _without_jumps(log: Log) -> tuple[Log, list[float], list[float], float | None]:
    """Blank single false poses: their times, and those where the pose goes on from another place.

    A picture is compared with the median motion of its neighbours: the wheels may slide, but a
    body changes its speed only as fast as its grip allows. The last is the time of the first jump
    when there are too many.
    """
    rows = _sampled(log, *POSE_COLUMNS)
    if rows.size < 10:
        return log, [], [], None
    t_s, pose = log.t_s[rows], np.stack([log.columns[c][rows] for c in POSE_COLUMNS], axis=1)
    steps = _turned(np.diff(pose, axis=0)) / np.diff(t_s)[:, None]
    # Mirrored, for a false pose at an end of the log would be its own neighbour.
    rate = median_filter(steps, size=(NEIGHBOURS, 1), mode="mirror")

    def jumps(last: int, now: int) -> bool:
        dt_s = t_s[now] - t_s[last]
        off = np.abs(_turned(pose[now] - pose[last] - rate[now - 1] * dt_s))
        return bool(
            np.hypot(off[0], off[1]) > STEP_M + STEP_M_S * dt_s
            or off[2] > TURN_RAD + TURN_RAD_S * dt_s
        )

    last, false, cuts, first = 0, [], [], None
    for now in range(1, len(rows)):
        if not jumps(last, now):
            last = now
            continue
        first = first if first is not None else float(t_s[now])
        if now + 1 < len(rows) and not jumps(now, now + 1):
            if now == 1:
                false.append(0)  # one pose alone before all others
            else:
                cuts.append(float(t_s[now]))
            last = now
        else:
            false.append(now)
    if len(false) + len(cuts) > max(3, MOST_JUMPS * len(rows)):
        return log, [], [], first
    return _blanked(log, POSE_COLUMNS, rows[false]), t_s[false].tolist(), cuts, None


# ---- all logs ----


def _other_robot(machine: Machine, logs: Sequence[Log]) -> str | None:
    """A log whose wheels carry it farther, or turn faster for a duty, than in all other logs.

    And by the same factor all the time: while wheels slide a body goes as it can.
    """
    if len(logs) < 2:
        return None
    measures = (
        ("goes {:.2f} times as far per turn of its wheels", OTHER_TRAVEL, _travel_ratio),
        ("turns {:.2f} times as far per turn of its wheels", OTHER_TRAVEL, _turn_ratio),
        ("has wheels {:.2f} times as fast at the same duty", OTHER_SPEED, _speed_ratio),
    )
    for words, tolerance, measure in measures:
        found = [measure(machine, log) for log in logs]
        if any(values.size < 10 for values in found):
            continue
        centre = np.array([np.median(values) for values in found])
        error = np.array([_error_of_median(values) for values in found])
        spread = [float(np.ptp(np.percentile(values, (10.0, 90.0)))) for values in found]
        for k, log in enumerate(logs):
            others = np.delete(centre, k)
            ratio = float(centre[k] / np.median(others))
            sure = SURE * np.hypot(error[k], float(np.median(np.delete(error, k))))
            apart = np.abs(centre[k] - others) > np.maximum(sure, tolerance * np.abs(others))
            if apart.all() and spread[k] < MOST_SPREAD * abs(centre[k]):
                told = words.format(ratio)
                if len(logs) > 2:
                    return f"{log.name} looks like another robot than the rest: it {told}"
                other = logs[1 - k].name
                return f"{log.name} and {other} look like two robots: {log.name} {told} as {other}"
    return None


def _error_of_median(values: Array) -> float:
    spread = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return 1.2533 * spread / np.sqrt(len(values) / 10)  # windows overlap


def _travel_ratio(machine: Machine, log: Log) -> Array:
    wheels, shown = _windows(machine, log, "pose/x_m", rolling_only=True)
    return shown / wheels


def _turn_ratio(machine: Machine, log: Log) -> Array:
    wheels, shown = _windows(machine, log, "pose/theta_rad", rolling_only=True)
    turned = (shown + np.pi) % (2 * np.pi) - np.pi
    return turned / wheels


def logged_set_points(machine: Machine, logs: Sequence[Log], found: Array) -> str | None:
    """Return why the duty columns look like set-points and not like what was applied, or None.

    A ramp before the believed model must explain the logs better than the duty as logged does with
    the model `found` for it, by a nat per reading: lags and limits have had their chance there. And
    by a tenth of that by noise that fits each: where wheels break loose a first guess is far off
    for all of them.
    """
    if machine.kind != "robot":
        return None
    looked_at = _first_seconds(logs)
    runs = [make_run(machine, log) for log in looked_at]
    noise = first_guess(machine, runs)
    readings = sum(int(np.count_nonzero(~np.isnan(run.outputs))) for run in runs)

    def worth(tried: Sequence[Log], values: Array, by_own: bool) -> float:
        ways = [make_run(machine, log) for log in tried]
        try:
            own = tune_noise(machine, ways, values, noise, paths=1) if by_own else noise
            tracks = track_all(machine, ways, values, own)
        except RunawayError:
            return LOST
        return float(np.nan_to_num(sum(track.log_likelihood for track in tracks), nan=LOST))

    ramps = {
        r: worth([_ramped(log, r) for log in looked_at], machine.believed, False) for r in RAMPS_1_S
    }
    best = max(ramps, key=ramps.__getitem__)

    def logged(by_own: bool) -> float:
        return max(worth(looked_at, values, by_own) for values in (machine.believed, found))

    if ramps[best] - logged(False) < RAMP_GAIN * readings:
        return None
    own = worth([_ramped(log, best) for log in looked_at], machine.believed, True)
    if own - logged(True) < RAMP_GAIN_OWN * readings:
        return None
    return (
        f"the duty columns look like set-points: the motors follow them with about {best:g} per "
        f"second; log the duty that is applied"
    )


def _first_seconds(logs: Sequence[Log]) -> list[Log]:
    """The first log as far as it counts here."""
    log = logs[0]
    rows = log.t_s - log.t_s[0] < LOOK_AT_S
    columns = {name: values[rows] for name, values in log.columns.items()}
    return [Log(log.name, log.t_s[rows], columns)]


def _ramped(log: Log, rate_1_s: float) -> Log:
    """The log with duties that change by `rate_1_s` at most."""
    columns = dict(log.columns)
    most = rate_1_s * np.diff(log.t_s, append=2 * log.t_s[-1] - log.t_s[-2])
    for wheel in range(1, 5):
        wanted = log.columns[f"wheel/{wheel}/duty"]
        applied = np.empty_like(wanted)
        now = 0.0
        for k, (target, step) in enumerate(zip(wanted, most, strict=True)):
            before = now
            now += float(np.clip(target - now, -step, step))
            applied[k] = (before + now) / 2
        columns[f"wheel/{wheel}/duty"] = applied
    return replace(log, columns=columns)


def too_poor(machine: Machine, limits: dict[str, dict[str, float]]) -> str | None:
    """Return why nothing found means nothing: hardly any effect would have been seen.

    `limits`: detection limits of the search, by the name of the candidate.
    """
    sizes = {
        candidate.name: {
            machine.file_parameter(candidate.parameters[k].label): candidate.parameters[k].scale
            for k in candidate.amplitudes
            if np.isfinite(machine.believed[candidate.parameters[k].places[0]])
        }
        for candidate in machine.candidates()
    }
    seen = [
        any(own.get(key, np.inf) < size for key, size in sizes[name].items())
        for name, own in limits.items()
        if sizes.get(name)
    ]
    if not seen or np.mean(seen) >= LEAST_VISIBLE:
        return None
    return (
        f"only {sum(seen)} of {len(seen)} effects would have been seen by these sensors and "
        "motions at a size worth looking for"
    )
