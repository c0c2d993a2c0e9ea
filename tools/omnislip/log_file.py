"""Measured or simulated logs: one row per sampling time, first column t_s, groups by '/'.

A blank cell means "not sampled in this row"; it is NaN in memory. Which columns there are:
    robot     wheel/1..4/duty in [-1, 1], mean over the interval from this row to the next;
              wheel/1..4/encoder_counts at t_s, cumulative, 16-bit wrap allowed;
              optional gyro/z_rad_s, supply/voltage_v, wheel/1..4/current_a, pose/x_m, pose/y_m,
              pose/theta_rad (world frame)
    axis      axis/command (volt, ampere or duty, as the model says; blank = drive off, no current
              flows), axis/position_m or axis/position_rad; optional axis/speed_m_s,
              axis/speed_rad_s, supply/voltage_v, which nothing uses yet
    odometry  wheel/1..n/encoder_counts, pose/x_m, pose/y_m, pose/theta_rad; optional gyro/z_rad_s,
              which nothing uses yet
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from omnislip.errors import InputError
from omnislip.files import check_known, replace_file

Array = npt.NDArray[np.float64]
Locate = Callable[[int], str]

LOG_SUFFIXES = (".csv", ".parquet")
POSE_COLUMNS = ["pose/x_m", "pose/y_m", "pose/theta_rad"]
ROBOT_REQUIRED = [f"wheel/{w}/{q}" for w in range(1, 5) for q in ("duty", "encoder_counts")]
ROBOT_OPTIONAL = [
    "gyro/z_rad_s",
    "supply/voltage_v",
    *(f"wheel/{wheel}/current_a" for wheel in range(1, 5)),
    *POSE_COLUMNS,
]
AXIS_POSITIONS = ["axis/position_m", "axis/position_rad"]
AXIS_OPTIONAL = ["axis/speed_m_s", "axis/speed_rad_s", "supply/voltage_v"]
COUNTS_PATTERN = re.compile(r"wheel/[1-9]\d*/encoder_counts")
MIN_ODOMETRY_WHEELS = 2


@dataclass(frozen=True)
class Log:
    """A log: `t_s` (n,) strictly increasing; each column (n,) with NaN where not sampled."""

    name: str
    t_s: Array
    columns: dict[str, Array]
    series: str = ""
    """Folder of the file: logs of one folder were taken under the same conditions."""
    begun_at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y in m and heading in rad of a robot in the first row, where no camera sees it."""

    @property
    def row_s(self) -> float:
        """Usual time from row to row; 0 with one row."""
        return float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0

    def rows_missing(self, least: int) -> npt.NDArray[np.bool_]:
        """Whether so many rows or more are missing behind each row but the last (n - 1,)."""
        return np.diff(self.t_s) > (0.5 + least) * self.row_s

    def holds_same(self, other: "Log") -> bool:
        """Whether another log has the same rows in the same columns."""
        return (
            np.array_equal(self.t_s, other.t_s)
            and self.columns.keys() == other.columns.keys()
            and all(
                np.array_equal(values, other.columns[name], equal_nan=True)
                for name, values in self.columns.items()
            )
        )


def read_log(path: Path | str, kind: str | None) -> Log:
    """Read and check a .csv or .parquet log for a model of `kind` robot, axis or odometry.

    None: the kind that the columns speak of. InputError names the file, the line (for .parquet the
    row, first row 1) and what would be right.
    """
    path = Path(path)
    suffix = check_log_path(path)
    try:
        if path.stat().st_size == 0:
            raise pd.errors.EmptyDataError
        frame = _read_csv(path) if suffix == ".csv" else pd.read_parquet(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: empty; a header row is expected, first column 't_s'") from None
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: not a .csv log: it must be text in UTF-8 whose first line is the header"
        ) from None
    except ValueError as error:
        # pandas and pyarrow say in the first line what they met and where.
        said = str(error).splitlines()[0]
        cells = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", said)
        if cells:
            expected, line, seen = cells.groups()
            raise InputError(
                f"{path}: line {line}: {seen} cells, but the header has {expected}"
            ) from None
        raise InputError(f"{path}: not a {suffix} log: {said}") from None
    kind = kind or _kind_of(list(frame.columns))
    first_row, unit = (2, "line") if suffix == ".csv" else (1, "row")

    def locate(index: int) -> str:
        return f"{path}: {unit} {index + first_row}"

    required, sampled = _check_columns(list(frame.columns), kind, path)
    if len(frame) < 2:
        raise InputError(f"{path}: at least 2 rows are needed, there are {len(frame)}")
    columns = {name: _numbers(frame[name], name, locate) for name in frame.columns}
    for name in required:
        _check_sampled(columns[name], name, locate)
    for name in sampled:
        if np.isfinite(columns[name]).sum() < 2:
            raise InputError(f"{path}: column '{name}' needs a value in at least 2 rows")
    _check_ranges(columns, locate)
    t_s = columns.pop("t_s")
    return Log(path.stem, t_s, columns, path.resolve().parent.name)


def read_logs(paths: Sequence[Path | str], kind: str | None) -> list[Log]:
    """Read logs, each with a name of its own; InputError for a log that is given twice.

    Where file names are the same, so many folders are put before them that they differ.
    """
    parts = [Path(path).absolute().with_suffix("").parts for path in paths]
    logs = []
    for path, own in zip(paths, parts, strict=True):
        if parts.count(own) > 1:
            raise InputError(f"{path}: this log is given twice")
        folders = range(1, len(own) + 1)
        tails = (own[-n:] for n in folders if [p[-n:] for p in parts].count(own[-n:]) == 1)
        logs.append(replace(read_log(path, kind), name="/".join(next(tails))))
    return logs


def without_copies(logs: Sequence[Log]) -> tuple[list[Log], list[str]]:
    """Return the logs that hold something of their own, and in sentences which others do not."""
    kept: list[Log] = []
    told = []
    for log in logs:
        same = next((other for other in kept if other.holds_same(log)), None)
        if same is None:
            kept.append(log)
        else:
            told.append(f"{log.name}: holds the same as {same.name}, not used")
    return kept, told


def write_log(log: Log, path: Path | str) -> None:
    """Write `log` to .csv or .parquet (by the suffix), whole or not at all."""
    path = Path(path)
    suffix = check_log_path(path)
    frame = log_frame(log)
    with replace_file(path) as temporary:
        if suffix == ".csv":
            frame.to_csv(temporary, index=False)
        else:
            frame.to_parquet(temporary, index=False)


def log_frame(log: Log) -> pd.DataFrame:
    """Return the table that a log file holds: t_s first, counts as whole numbers."""
    frame = pd.DataFrame({"t_s": log.t_s, **log.columns})
    counts = [name for name in log.columns if COUNTS_PATTERN.fullmatch(name)]
    frame[counts] = frame[counts].astype(np.int64)
    return frame


def check_log_path(path: Path, suffixes: tuple[str, ...] = LOG_SUFFIXES) -> str:
    """Return the suffix of a log file; InputError unless it is one of `suffixes`."""
    if path.suffix not in suffixes:
        *others, last = suffixes
        raise InputError(f"{path}: a log file must end in {', '.join(others)} or {last}")
    return path.suffix


def _read_csv(path: Path) -> pd.DataFrame:
    # As text, so that a cell that is not a number can be named; every line is a row, so that
    # row numbers are line numbers; no header, so that a column given twice is seen.
    as_text = {"header": None, "dtype": str, "skip_blank_lines": False, "na_filter": False}
    header = pd.read_csv(path, nrows=1, **as_text).iloc[0].tolist()
    _check_first_column(header, path)
    rows = pd.read_csv(path, **as_text).iloc[1:].reset_index(drop=True)
    rows.columns = header
    # Editors and spreadsheets leave blank lines at the end.
    filled = np.flatnonzero((rows != "").any(axis="columns"))
    return rows.iloc[: filled[-1] + 1 if filled.size else 0]


def _check_first_column(names: list[str], path: Path) -> None:
    first = names[0] if names else ""
    if first != "t_s":
        hint = "; commas separate columns" if ";" in first or "\t" in first else ""
        if first.startswith("#"):
            hint = "; a log has no comment lines"
        raise InputError(f"{path}: the first column must be 't_s', not '{first[:40]}'{hint}")


def _check_columns(names: list[str], kind: str, path: Path) -> tuple[list[str], list[str]]:
    """Return the columns wanted in every row, and those wanted in at least two rows."""
    _check_first_column(names, path)
    doubled = [name for name in names if names.count(name) > 1]
    if doubled:
        raise InputError(f"{path}: column '{doubled[0]}' is there twice")
    for shown, column in (("axis", "axis/command"), ("robot", "wheel/1/duty")):
        if column in names and kind != shown:
            raise InputError(
                f"{path}: column '{column}' is of kind '{shown}', the model is of kind '{kind}'"
            )
    required, sampled, optional = _columns_of_kind(kind, names)
    check_known(names, ["t_s", *required, *sampled, *optional], "column", path)
    missing = [name for name in [*required, *sampled] if name not in names]
    if missing:
        raise InputError(f"{path}: missing columns for kind '{kind}': {', '.join(missing)}")
    return ["t_s", *required], sampled


def _kind_of(names: list[str]) -> str:
    if "axis/command" in names:
        return "axis"
    return "robot" if "wheel/1/duty" in names else "odometry"


def _columns_of_kind(kind: str, names: list[str]) -> tuple[list[str], list[str], list[str]]:
    if kind == "robot":
        return ROBOT_REQUIRED, [], ROBOT_OPTIONAL
    if kind == "axis":
        position = next((name for name in AXIS_POSITIONS if name in names), AXIS_POSITIONS[0])
        return [position], ["axis/command"], AXIS_OPTIONAL
    count = sum(COUNTS_PATTERN.fullmatch(name) is not None for name in names)
    wheels = range(1, max(count, MIN_ODOMETRY_WHEELS) + 1)
    return [f"wheel/{wheel}/encoder_counts" for wheel in wheels], POSE_COLUMNS, ["gyro/z_rad_s"]


def _numbers(column: pd.Series, name: str, locate: Locate) -> Array:
    if pd.api.types.is_numeric_dtype(column):
        numbers = column.to_numpy(dtype=np.float64, na_value=np.nan)
    else:
        numbers = np.array([_number(cell, row, name, locate) for row, cell in enumerate(column)])
    infinite = np.flatnonzero(np.isinf(numbers))
    if infinite.size:
        raise InputError(f"{locate(infinite[0])}: '{name}' must be finite or blank")
    return numbers


def _number(cell: object, row: int, name: str, locate: Locate) -> float:
    if isinstance(cell, str) and not cell.strip():
        return np.nan
    try:
        if "_" in str(cell):  # Python takes 1_0 for 10
            raise ValueError
        return float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{locate(row)}: '{name}' must be a number, not {cell!r:.40}") from None


def _check_sampled(values: Array, name: str, locate: Locate) -> None:
    blank = np.flatnonzero(np.isnan(values))
    if blank.size:
        raise InputError(f"{locate(blank[0])}: '{name}' needs a number in every row")


def _check_ranges(columns: dict[str, Array], locate: Locate) -> None:
    backwards = np.flatnonzero(np.diff(columns["t_s"]) <= 0)
    if backwards.size:
        row = backwards[0] + 1
        raise InputError(
            f"{locate(row)}: 't_s' must increase, but {columns['t_s'][row]} follows "
            f"{columns['t_s'][row - 1]}"
        )
    for name, values in columns.items():
        if name.endswith("/duty"):
            bad, right = np.abs(values) > 1, "in -1 to 1"
            if 1.5 < np.nanmax(np.abs(values)) <= 100:
                right += " (it seems to be in percent)"
        elif name.endswith("/encoder_counts"):
            bad, right = values != np.round(values), "a whole number of counts"
        else:
            continue
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(f"{locate(row)}: '{name}' must be {right}, not {values[row]}")
