"""OptiOdom: wheel encoders of omnidirectional robots and their pose by motion capture.

Source: R. B. Sousa, M. R. Petry, P. G. Costa, A. P. Moreira, "OptiOdom: a Generic Approach for
Odometry Calibration of Wheeled Mobile Robots", J. Intell. Robot. Syst. 105:39, 2022.

    omni4   four mecanum wheels, 100 Hz; 11520 counts per turn of a wheel
    omni3   three omni wheels, 25 Hz; 12288 counts per turn of a wheel

A run becomes a log in a folder of its series; every tenth of a second a row is kept, which loses
nothing of the counts and is much shorter than any manoeuvre. The models hold the factory's values.
A robot's encoders count clockwise turns positive: here the sign is the other way round, as in every
model of this project.
"""

import gzip
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from omnislip.errors import InputError
from omnislip.log_file import Log, write_log
from omnislip.model_file import Model, write_model

Array = npt.NDArray[np.float64]

ROW_S = 0.1
COMPACT = "omni4_all116_compact.npz"
COMPACT_UNIT = 1e-5
"""Metres and radians of a unit of the poses in the compact file."""
TOLERANCE = {"default": 0.02}


@dataclass(frozen=True)
class Robot:
    """A robot of the data set: sampling time, counts per turn, counts in a unit of its files."""

    name: str
    sampling_s: float
    counts_per_unit: float
    believed: Model


OMNI4 = Robot(
    "omni4",
    0.01,
    11520.0,
    Model(
        kind="odometry",
        name="optiodom_omni4",
        values={
            "odometry.wheel_radius_m": 0.03,
            # l1 + l2 = 0.4 m are the sides; half of each is the way to the wheel's rolling line.
            "odometry.wheel_distance_m": 0.2 / math.sqrt(2),
            "odometry.wheel_angles_deg": [45.0, 315.0, 135.0, 225.0],
            "odometry.counts_per_rev": 11520.0,
            "odometry.roller_angle_deg": 45.0,
        },
        tolerance=TOLERANCE,
    ),
)
OMNI3 = Robot(
    "omni3",
    0.04,
    1.0,
    Model(
        kind="odometry",
        name="optiodom_omni3",
        values={
            "odometry.wheel_radius_m": 0.051,
            "odometry.wheel_distance_m": 0.195,
            "odometry.wheel_angles_deg": [300.0, 60.0, 180.0],
            "odometry.counts_per_rev": 12288.0,
        },
        tolerance=TOLERANCE,
    ),
)


def import_optiodom(data: Path, out: Path) -> list[Path]:
    """Write ROBOT/SERIES/RUN.csv and ROBOT.toml to `out`; returns the models' paths.

    InputError if a file is missing or not as the authors publish it.
    """
    folder = data / "optiodom_omni"
    written = []
    for robot in (OMNI4, OMNI3):
        runs = 0
        for log in read_runs(folder, robot):
            write_log(log, out / robot.name / log.series / f"{log.name}.csv")
            runs += 1
        if not runs:
            raise InputError(
                f"{folder}: no runs of {robot.name} there; fetch them with tools/fetch-data, or "
                "name the folder of the data sets with --data"
            )
        written.append(out / f"{robot.name}.toml")
        write_model(robot.believed, written[-1])
    return written


def read_runs(folder: Path, robot: Robot, row_s: float = ROW_S) -> Iterator[Log]:
    """Give every run of a robot, rows `row_s` apart; from the compact file where there is one."""
    compact = folder / COMPACT
    if robot is OMNI4 and compact.exists():
        with np.load(compact) as runs:
            names = [key.removesuffix("_ticks") for key in runs.files if key.endswith("_ticks")]
            for name in names:
                shape, series, run = name.split("_")
                pose = np.cumsum(runs[f"{name}_gt_d"], axis=0, dtype=np.float64) * COMPACT_UNIT
                name = f"{shape}_{series}"
                yield _to_log(robot, name, run, runs[f"{name}_{run}_ticks"], pose, row_s)
        return
    for path in sorted(folder.glob(f"{robot.name}_*/*_run-*.csv.gz")):
        shape, series = path.parent.name.split("_")[1:]
        run = path.name.removesuffix(".csv.gz").split("_")[1]
        pose, counts = _read_run(path, robot)
        yield _to_log(robot, f"{shape[:4]}_{series}", run, counts, pose, row_s)


def _read_run(path: Path, robot: Robot) -> tuple[Array, Array]:
    """Return pose (rows, 3) and counts per cycle (rows, wheels) of one file."""
    wheels = len(robot.believed.values["odometry.wheel_angles_deg"])
    try:
        with gzip.open(path, "rt", encoding="utf-8") as file:
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, EOFError, ValueError) as error:
        raise InputError(f"{path}: not a run of OptiOdom: {error}") from None
    if table.shape[1] != 4 + wheels:
        raise InputError(
            f"{path}: not a run of {robot.name}: {table.shape[1]} columns, not {4 + wheels}"
        )
    step_s = float(np.median(np.diff(table[:, 0])))
    if abs(step_s - robot.sampling_s) > 1e-3 * robot.sampling_s:
        raise InputError(f"{path}: rows are {step_s:.4g} s apart, not {robot.sampling_s} s")
    counts = table[:, 4:] * robot.counts_per_unit
    if np.abs(counts - np.round(counts)).max() > 1e-3:
        raise InputError(f"{path}: encoder values are no whole counts")
    return table[:, 1:4], np.round(counts)


def _to_log(robot: Robot, series: str, run: str, counts: Array, pose: Array, row_s: float) -> Log:
    """A log of every n-th row; `counts` of a row belong to the cycle that ends there."""
    every = max(1, round(row_s / robot.sampling_s))
    total = -np.cumsum(counts, axis=0, dtype=np.float64)[::every]
    columns = {f"wheel/{i + 1}/encoder_counts": total[:, i] for i in range(total.shape[1])}
    columns |= dict(zip(("pose/x_m", "pose/y_m", "pose/theta_rad"), pose[::every].T, strict=True))
    t_s = np.arange(len(total)) * every * robot.sampling_s
    return Log(f"{series}_{run}", t_s, columns, series)
