"""What a run comes to: one number for each question asked of many runs.

    final_x_m, final_y_m, final_theta_rad    true pose at the end (world frame)
    odometry_error_m                         distance from there to where odometry ends
    peak_lateral_error_m                     largest distance beside the commanded path
    remaining_lateral_error_m                its mean over the last 0.2 s
    overshoot_percent                        largest of all commands, in percent of what it changes
    max_slip_m_s                             largest slip speed of any wheel
    max_current_a                            largest motor current
    energy_j                                 drawn from the supply, less what flows back

A command's path begins where the robot truly is when the command comes. A velocity (v, w) in the
body frame makes a straight line for w = 0, else a circle of radius |v| / |w|; a pose makes the line
to the goal. Overshoot is read along that line: of a velocity, how far the speed in the commanded
direction goes beyond the commanded one; of a pose, how far the robot goes beyond the goal. Commands
that change the speed by less than 0.05 m/s, the place by less than 0.05 m, or turn meanwhile, are
left out. A number for which no command asks is NaN.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from omnislip.scenario import CONTROL_RATE_HZ, Scenario

Array = npt.NDArray[np.float64]

REMAINING_S = 0.2
MIN_SPEED_CHANGE_M_S = 0.05
MIN_DISTANCE_M = 0.05


def measure(scenario: Scenario, truth: dict[str, Array]) -> dict[str, float]:
    """Return the numbers named above of the 1 kHz arrays `truth` of `scenario`."""
    lateral_m, overshoot = _follow(scenario, truth)
    remaining = lateral_m[truth["t_s"] >= truth["t_s"][-1] - REMAINING_S]
    power_w = truth["supply_v"] * (truth["duty"] * truth["current_a"]).sum(axis=1)
    off_m = truth["odometry"][-1, :2] - truth["pose"][-1, :2]
    final = dict(zip(("final_x_m", "final_y_m", "final_theta_rad"), truth["pose"][-1], strict=True))
    numbers = final | {
        "odometry_error_m": np.hypot(*off_m),
        "peak_lateral_error_m": _over_numbers(np.max, lateral_m),
        "remaining_lateral_error_m": _over_numbers(np.mean, remaining),
        "overshoot_percent": overshoot,
        "max_slip_m_s": np.abs(truth["slip_m_s"]).max(),
        "max_current_a": np.abs(truth["current_a"]).max(),
        "energy_j": power_w.sum() / CONTROL_RATE_HZ,
    }
    return {name: float(number) for name, number in numbers.items()}


def _over_numbers(reduce: Callable[[Array], float], values: Array) -> float:
    numbers = values[np.isfinite(values)]
    return reduce(numbers) if numbers.size else np.nan


def _follow(scenario: Scenario, truth: dict[str, Array]) -> tuple[Array, float]:
    """Return the distance beside the commanded path (n,) and the largest overshoot in percent."""
    t_s, pose = truth["t_s"], truth["pose"]
    lateral_m, overshoots = np.full(len(t_s), np.nan), [np.nan]
    begins = [command["t_s"] for command in scenario.commands]
    for command, (begin, end) in zip(scenario.commands, pairwise([*begins, np.inf]), strict=True):
        # Commands come at whole ticks; the margin is for t_s that are none.
        rows = np.flatnonzero((t_s > begin - 0.5 / CONTROL_RATE_HZ) & (t_s < end - 1e-9))
        if rows.size == 0 or command["kind"] not in ("velocity", "pose"):
            continue
        value = np.array(command["value"])
        if command["kind"] == "velocity":
            lateral_m[rows] = beside_velocity_path(pose[rows], value)
            overshoots.append(_speed_overshoot(truth["velocity"][rows], value))
        else:
            lateral_m[rows], over = beside_line(pose[rows, :2], value[:2])
            overshoots.append(over)
    return lateral_m, _over_numbers(np.max, np.array(overshoots))


def beside_velocity_path(pose: Array, velocity: Array) -> Array:
    """Return the distance of `pose` (n,3) to the path of the body velocity (vx, vy, w) from its
    first row: line or circle."""
    start, theta = pose[0, :2], pose[0, 2]
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    direction = turn @ velocity[:2]
    speed, omega = np.hypot(*direction), velocity[2]
    away = pose[:, :2] - start
    if omega == 0 and speed > 0:
        return np.abs(away[:, 1] * direction[0] - away[:, 0] * direction[1]) / speed
    if omega == 0:
        return np.hypot(*away.T)
    to_centre = np.array([-direction[1], direction[0]]) / omega
    return np.abs(np.hypot(*(away - to_centre).T) - speed / abs(omega))


def beside_line(place: Array, goal: Array) -> tuple[Array, float]:
    """Return the distance of `place` (n,2) to the line from its first row to `goal`, and how far
    beyond the goal it goes, in percent of the way; a short way is a point, without overshoot."""
    way = goal - place[0]
    length = np.hypot(*way)
    if length < MIN_DISTANCE_M:
        return np.hypot(*(place - goal).T), np.nan
    away = place - place[0]
    beyond = (away @ way).max() / length - length
    beside = np.abs(away[:, 1] * way[0] - away[:, 0] * way[1]) / length
    return beside, 100 * max(beyond, 0.0) / length


def _speed_overshoot(velocity: Array, commanded: Array) -> float:
    target = np.hypot(*commanded[:2])
    if commanded[2] != 0 or target == 0:
        return np.nan
    speed = velocity[:, :2] @ commanded[:2] / target
    change = target - speed[0]
    if abs(change) < MIN_SPEED_CHANGE_M_S:
        return np.nan
    return 100 * max(((speed - target) * np.sign(change)).max(), 0.0) / abs(change)
