"""Logs: what is read is what was written, and every bad cell is named by its line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.errors import InputError
from omnislip.log_file import (
    ROBOT_OPTIONAL,
    ROBOT_REQUIRED,
    Log,
    read_log,
    read_logs,
    without_copies,
    write_log,
)

AXIS = "t_s,axis/command,axis/position_m\n0.0,1.0,0.0\n0.1,2.0,0.5\n0.2,3.0,1.5\n"
ODOMETRY_HEADER = "t_s," + ",".join(f"wheel/{wheel}/encoder_counts" for wheel in (1, 2, 3))
ODOMETRY_HEADER += ",pose/x_m,pose/y_m,pose/theta_rad\n"


def robot_log(rows: int = 4) -> Log:
    duty = {name: np.linspace(-1, 1, rows) for name in ROBOT_REQUIRED if name.endswith("duty")}
    counts = {
        name: np.arange(rows) * 20000.0 % 65536 for name in ROBOT_REQUIRED if "counts" in name
    }
    return Log("run", np.arange(rows) * 0.005, duty | counts)


def robot_csv(tmp_path: Path, column: str, cells: list[str]) -> Path:
    """Write a robot log of which one column holds the given cells as they are."""
    log = robot_log(len(cells))
    frame = pd.DataFrame({"t_s": log.t_s, **log.columns}).astype(str)
    frame[column] = cells
    path = tmp_path / "run.csv"
    frame.to_csv(path, index=False)
    return path


def error_of(path: Path, kind: str) -> str:
    with pytest.raises(InputError) as caught:
        read_log(path, kind)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def test_axis_log(write):
    log = read_log(write("bench.csv", AXIS), "axis")
    assert log.name == "bench"
    np.testing.assert_array_equal(log.t_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(log.columns["axis/command"], [1.0, 2.0, 3.0])
    assert list(log.columns) == ["axis/command", "axis/position_m"]


def test_blank_optional_cells_are_not_a_number(tmp_path):
    log = read_log(robot_csv(tmp_path, "pose/x_m", ["0.5", "", " ", "nan"]), "robot")
    np.testing.assert_array_equal(log.columns["pose/x_m"], [0.5, np.nan, np.nan, np.nan])


@pytest.mark.parametrize("end", ["\n", "\n\n", ",,\n"])
def test_blank_lines_at_the_end_are_no_rows(end, write):
    assert len(read_log(write("bench.csv", AXIS + end), "axis").t_s) == 3


def test_a_long_cell_is_cut(tmp_path):
    path = robot_csv(tmp_path, "wheel/1/encoder_counts", ["0", "x" * 5000, "0"])
    assert len(error_of(path, "robot")) < len(str(path)) + 120


def test_odometry_log_has_as_many_wheels_as_columns(write):
    rows = "0.0,0,0,0,0.0,0.0,0.0\n0.1,5,5,5,,,\n0.2,9,9,9,0.1,0.0,0.0\n"
    log = read_log(write("run.csv", ODOMETRY_HEADER + rows), "odometry")
    np.testing.assert_array_equal(log.columns["wheel/3/encoder_counts"], [0, 5, 9])
    np.testing.assert_array_equal(log.columns["pose/x_m"], [0.0, np.nan, 0.1])


def test_odometry_needs_poses(write):
    rows = "0.0,0,0,0,0.0,0.0,0.0\n0.1,5,5,5,,,\n"
    message = error_of(write("run.csv", ODOMETRY_HEADER + rows), "odometry")
    assert "'pose/x_m' needs a value in at least 2 rows" in message


# Column of a robot log, its cells, words the error line must contain.
BAD_CELLS = {
    "text": ("wheel/2/duty", ["0", "x1", "0"], ["line 3", "wheel/2/duty", "'x1'"]),
    "underscores": ("wheel/2/duty", ["0", "0_0.5", "0"], ["line 3", "'0_0.5'"]),
    "blank duty": ("wheel/1/duty", ["0", "0", ""], ["line 4", "wheel/1/duty", "every row"]),
    "nan duty": ("wheel/1/duty", ["nan", "0", "0"], ["line 2", "wheel/1/duty", "every row"]),
    "infinite duty": ("wheel/1/duty", ["0", "inf", "0"], ["line 3", "finite"]),
    "infinite pose": ("pose/x_m", ["", "-inf", ""], ["line 3", "pose/x_m", "finite"]),
    "duty in percent": ("wheel/4/duty", ["0", "0", "50"], ["line 4", "-1 to 1", "50"]),
    "duty below -1": ("wheel/4/duty", ["0", "-1.001", "0"], ["line 3", "-1 to 1"]),
    "counts in turns": ("wheel/1/encoder_counts", ["0", "0.5", "1"], ["line 3", "whole number"]),
    "time stands": ("t_s", ["0", "1", "1"], ["line 4", "t_s", "increase"]),
    "time goes back": ("t_s", ["0", "2", "1"], ["line 4", "1.0 follows 2.0"]),
    "blank time": ("t_s", ["0", "", "1"], ["line 3", "t_s"]),
    "unknown column": ("gyro/z_deg_s", ["0", "0", "0"], ["gyro/z_deg_s", "'gyro/z_rad_s'"]),
    "fifth wheel": ("wheel/5/duty", ["0", "0", "0"], ["wheel/5/duty"]),
}
# Text of an axis log, words the error line must contain.
BAD_FILES = {
    "empty": ("", ["run.csv: empty; a header row is expected"]),
    "blank lines": ("\n\n", ["run.csv: empty; a header row is expected"]),
    "header only": ("t_s,axis/command,axis/position_m\n", ["at least 2 rows", "0"]),
    "one row": ("t_s,axis/command,axis/position_m\n0,0,0\n", ["at least 2 rows", "1"]),
    "no header": ("0.0,1.0,2.0\n0.1,1.0,2.0\n", ["first column must be 't_s'", "'0.0'"]),
    "time not first": (AXIS.replace("t_s,axis/command", "axis/command,t_s"), ["first column"]),
    "semicolons": (AXIS.replace(",", ";"), ["'t_s;axis/command", "commas separate columns"]),
    "comment line": ("# bench\n" + AXIS, ["must be 't_s'", "# bench", "no comment lines"]),
    "column missing": (AXIS.replace("axis/position_m", "axis/speed_m_s"), ["axis/position_m"]),
    "column doubled": (AXIS.replace("position_m", "command"), ["axis/command", "twice"]),
    "row too long": (AXIS + "0.3,1,2,3\n", ["line 5"]),
    "row cut off": (AXIS + "0.3,1\n", ["line 5", "axis/position_m"]),
    "line blank": (AXIS + "\n0.3,1,2\n", ["line 5", "t_s"]),
    "binary": ("\x00\x01\x02", ["t_s"]),
}


@pytest.mark.parametrize("case", BAD_CELLS)
def test_bad_cell_is_named_by_its_line(case, tmp_path):
    column, cells, words = BAD_CELLS[case]
    message = error_of(robot_csv(tmp_path, column, cells), "robot")
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file_is_named(case, write):
    text, words = BAD_FILES[case]
    message = error_of(write("run.csv", text), "axis")
    assert [word for word in words if word not in message] == []


def test_files_that_are_no_logs(tmp_path, write):
    assert "cannot be read" in error_of(tmp_path / "none.csv", "axis")
    assert "cannot be read" in error_of(tmp_path / "none.parquet", "axis")
    assert ".csv or .parquet" in error_of(tmp_path / "run.xlsx", "axis")
    assert "not a .parquet log" in error_of(write("run.parquet", AXIS), "axis")
    assert "empty; a header row" in error_of(write("run.parquet", ""), "axis")
    for name, content in {"latin": b"t_s,\xe9\n0,1\n1,2\n", "wide": AXIS.encode("utf-16")}.items():
        (tmp_path / f"{name}.csv").write_bytes(content)
        message = error_of(tmp_path / f"{name}.csv", "axis")
        assert "not a .csv log: it must be text in UTF-8" in message


def test_bad_row_of_a_parquet_log_is_named(tmp_path):
    frame = pd.DataFrame({"t_s": [0.0, 0.1], "axis/command": [1.0, 2.0]})
    frame["axis/position_m"] = [0.0, np.nan]
    frame.to_parquet(tmp_path / "run.parquet")
    assert "row 2: 'axis/position_m'" in error_of(tmp_path / "run.parquet", "axis")


FINITE = st.floats(-1e300, 1e300)


@st.composite
def robot_logs(draw) -> Log:
    rows = draw(st.integers(2, 6))

    def column(elements: st.SearchStrategy) -> np.ndarray:
        return np.array(draw(st.lists(elements, min_size=rows, max_size=rows)))

    t_s = np.sort(draw(st.lists(FINITE, min_size=rows, max_size=rows, unique=True)))
    columns = {
        name: column(st.floats(-1, 1) if name.endswith("duty") else st.integers(0, 65535))
        for name in ROBOT_REQUIRED
    }
    optional = draw(st.lists(st.sampled_from(ROBOT_OPTIONAL), unique=True))
    columns |= {name: column(FINITE | st.just(np.nan)) for name in optional}
    return Log("run", t_s, columns)


@given(robot_logs(), st.sampled_from(["run.csv", "run.parquet"]))
def test_a_written_log_reads_back_the_same(tmp_path_factory, log, name):
    path = tmp_path_factory.getbasetemp() / name
    write_log(log, path)
    back = read_log(path, "robot")
    np.testing.assert_array_equal(back.t_s, log.t_s)
    assert list(back.columns) == list(log.columns)
    for column, values in log.columns.items():
        np.testing.assert_array_equal(back.columns[column], values)


def test_writing_keeps_the_old_file_when_it_fails(tmp_path, monkeypatch):
    path = tmp_path / "run.csv"
    path.write_text("precious")

    def fail(*_args: object, **_options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pd.DataFrame, "to_csv", fail)
    with pytest.raises(InputError, match=r"run\.csv: cannot be written: No space left"):
        write_log(robot_log(), path)
    assert path.read_text() == "precious"
    assert [item.name for item in tmp_path.iterdir()] == ["run.csv"]


def test_logs_of_the_same_file_name_are_told_apart_by_their_folders(tmp_path):
    names = ["day_1/a/run_1", "day_2/a/run_1", "day_2/b/run_1", "day_2/b/run_2"]
    paths = [tmp_path / f"{name}.csv" for name in names]
    for number, path in enumerate(paths):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{AXIS}{number + 1},0,0\n")
    logs = read_logs(paths, "axis")
    assert [log.name for log in logs] == [*names[:2], "b/run_1", "run_2"]
    assert [log.series for log in logs] == ["a", "a", "b", "b"]


def test_a_copy_of_a_log_is_told_and_not_used(write):
    paths = [write("run.csv", AXIS), write("other.csv", f"{AXIS}9,0,0\n"), write("copy.csv", AXIS)]
    kept, told = without_copies(read_logs(paths, "axis"))
    assert [log.name for log in kept] == ["run", "other"]
    assert told == ["copy: holds the same as run, not used"]


def test_a_line_with_too_many_cells_is_named(write):
    with pytest.raises(InputError, match=r"line 3: 5 cells, but the header has 3"):
        read_log(write("run.csv", "t_s,axis/command,axis/position_m\n0,0,0\n1,0,0,0,0\n"), "axis")


def test_a_log_of_another_kind_is_told(write):
    words = "'axis/command' is of kind 'axis', the model is of kind 'robot'"
    with pytest.raises(InputError, match=words):
        read_log(write("run.csv", AXIS), "robot")


def test_a_log_that_is_given_twice_is_refused(tmp_path, write):
    path = write("run.csv", AXIS)
    with pytest.raises(InputError, match=r"run\.csv: this log is given twice"):
        read_logs([path, path.parent / "." / "run.csv"], "axis")
