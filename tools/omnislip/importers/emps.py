"""EMPS: a motor with a ball screw that moves a carriage, two records of 24.84 s at 1 kHz.

Source: A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of EMPS", Workshop on
Nonlinear System Identification Benchmarks, 2019. train.csv is their DATA_EMPS.mat, test.csv
DATA_EMPS_PULSES.mat, the same movement with disturbance pulses in the command. The position is that
of the encoder on the motor, in metres of the carriage; an encoder at the end of the screw and an
accelerometer on the load exist and are in neither record.

The model is what a user would believe beforehand: force = 35.15 N/V of drive input, mass, viscous
friction; no other friction and no offset.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.io

from omnislip.errors import InputError
from omnislip.log_file import Log, write_log
from omnislip.model_file import Model, write_model

Array = npt.NDArray[np.float64]

RECORDS = {"train": "DATA_EMPS.mat", "test": "DATA_EMPS_PULSES.mat"}
# What the units of the files are known by.
ROW_S, GAIN_N_V, MOST_DRIVE_V, STROKE_M = 1e-3, 35.1507, 10.0, 0.5
BELIEVED = Model(
    kind="axis",
    name="emps",
    values={
        "axis.mass_kg": 95.1,
        "axis.input_gain_n_v": GAIN_N_V,
        "axis.viscous_friction_n_s_m": 203.5,
    },
    tolerance={"default": 0.05},
)


def import_emps(data: Path, out: Path) -> list[Path]:
    """Write train.csv, test.csv and emps.toml to `out` from the files in `data`/emps.

    Returns the paths written. InputError if a file is missing or not as the authors publish it;
    nothing is written then.
    """
    logs = [read_record(data, name) for name in RECORDS]
    written = []
    for log in logs:
        written.append(out / f"{log.name}.csv")
        write_log(log, written[-1])
    written.append(out / "emps.toml")
    write_model(BELIEVED, written[-1])
    return written


def read_pulses(data: Path) -> Array:
    """Return the pulses (rows,) that the authors added to the drive input of the test record."""
    return _read_columns(data / "emps" / RECORDS["test"], ("pulses_N",))[0]


def read_record(data: Path, name: str) -> Log:
    """Return a record, "train" or "test", as a log."""
    path = data / "emps" / RECORDS[name]
    t_s, position_m, drive_v = _read_columns(path, ("t", "qm", "vir"))
    gain_n_v = float(_read_columns(path, ("gtau",))[0][0])
    step_s = float(np.median(np.diff(t_s)))
    for quantity, fits in (
        (f"rows are {step_s:.4g} s apart, not {ROW_S} s", abs(step_s - ROW_S) < 0.01 * ROW_S),
        (f"gtau is {gain_n_v:.6g} N/V, not {GAIN_N_V}", abs(gain_n_v - GAIN_N_V) < 1e-3),
        (f"vir exceeds {MOST_DRIVE_V:g} V", np.abs(drive_v).max() <= MOST_DRIVE_V),
        (f"qm exceeds {STROKE_M:g} m", np.abs(position_m).max() <= STROKE_M),
    ):
        if not fits:
            raise InputError(f"{path}: not the EMPS record: {quantity}")
    return Log(name, t_s, {"axis/command": drive_v, "axis/position_m": position_m})


def _read_columns(path: Path, keys: tuple[str, ...]) -> list[Array]:
    if not path.is_file():
        raise InputError(
            f"{path}: not found; fetch it with tools/fetch-data, or name its folder with --data"
        )
    try:
        record = scipy.io.loadmat(path, variable_names=keys)
        columns = [record[key].ravel().astype(np.float64) for key in keys]
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not the EMPS record: {error}") from None
    if len({len(column) for column in columns}) > 1:
        raise InputError(f"{path}: not the EMPS record: {', '.join(keys)} differ in length")
    return columns
