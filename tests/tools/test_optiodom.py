"""Import of the OptiOdom runs, on made-up runs of their format and, if at hand, on the real."""

import gzip

import numpy as np
import pytest
from omnislip.errors import InputError
from omnislip.importers import data_folder
from omnislip.importers.optiodom import COMPACT, OMNI3, OMNI4, import_optiodom, read_runs
from omnislip.log_file import read_log
from omnislip.model_file import read_model


@pytest.fixture
def folder(tmp_path):
    """A data folder with one run of each robot: 0.5 s, wheels turning steadily."""
    folder = tmp_path / "data" / "optiodom_omni"
    store(folder, "omni4_square_01", table(0.01, 51, np.array([1, 2, 3, 4]) / 11520))
    store(folder, "omni3_circular_02", table(0.04, 13, np.array([10, -10, 5])))
    return folder


def table(step_s, rows, per_cycle):
    t_s = np.arange(rows) * step_s
    odometry = np.outer(np.arange(rows) > 0, per_cycle)
    return np.column_stack([t_s, t_s, -t_s, 0.1 * t_s, odometry])


def store(folder, series, values):
    path = folder / series / f"{series.split('_')[2]}_run-01.csv.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    with gzip.open(path, "wt") as file:
        np.savetxt(file, values, delimiter=",")


def test_runs_become_logs_in_folders_of_their_series(folder, tmp_path):
    written = import_optiodom(folder.parent, tmp_path / "out")
    assert [path.name for path in written] == ["omni4.toml", "omni3.toml"]
    log = read_log(tmp_path / "out" / "omni4" / "squa_01" / "squa_01_run-01.csv", "odometry")
    assert log.series == "squa_01"
    np.testing.assert_allclose(log.t_s, np.arange(6) * 0.1)
    # Ten cycles a row; clockwise counts are negative in our logs.
    np.testing.assert_array_equal(log.columns["wheel/3/encoder_counts"], -30 * np.arange(6))
    np.testing.assert_allclose(log.columns["pose/y_m"], -log.t_s)


def test_nothing_of_the_counts_is_lost_between_the_kept_rows(folder):
    (fine,) = read_runs(folder, OMNI3, row_s=0.04)
    (coarse,) = read_runs(folder, OMNI3, row_s=0.12)
    assert coarse.columns["wheel/1/encoder_counts"][-1] == -10 * 12
    assert fine.columns["wheel/1/encoder_counts"][-1] == -10 * 12


def test_models_are_the_factory_values(folder, tmp_path):
    import_optiodom(folder.parent, tmp_path / "out")
    model = read_model(tmp_path / "out" / "omni4.toml")
    assert model.kind == "odometry"
    assert model.values["odometry.wheel_radius_m"] == 0.03
    assert model.values["odometry.roller_angle_deg"] == 45.0


BAD = {
    "columns": (table(0.01, 51, np.array([1, 2, 3]) / 11520), "7 columns, not 8"),
    "rate": (table(0.02, 51, np.array([1, 2, 3, 4]) / 11520), "0.02 s apart"),
    "counts": (table(0.01, 51, np.array([0.5, 2, 3, 4]) / 11520), "no whole counts"),
}


@pytest.mark.parametrize("values, named", BAD.values(), ids=BAD)
def test_what_is_no_run_is_named(folder, tmp_path, values, named):
    store(folder, "omni4_square_01", values)
    with pytest.raises(InputError, match=rf"01_run-01\.csv\.gz: .*{named}"):
        import_optiodom(folder.parent, tmp_path / "out")


def test_missing_runs_say_where_they_come_from(tmp_path):
    with pytest.raises(InputError, match="tools/fetch-data"):
        import_optiodom(tmp_path, tmp_path / "out")


@pytest.mark.skipif(
    not (data_folder() / "optiodom_omni" / COMPACT).exists(),
    reason="the compact file of all runs is not there",
)
def test_real_runs_are_the_same_from_both_kinds_of_file(tmp_path):
    data = data_folder() / "optiodom_omni"
    series = "squa_080920201205"
    compact = [log for log in read_runs(data, OMNI4) if log.series == series]
    (tmp_path / "omni4_square_080920201205").symlink_to(data / "omni4_square_080920201205")
    raw = list(read_runs(tmp_path, OMNI4))
    assert [log.name for log in raw] == [log.name for log in compact]
    for one, other in zip(raw, compact, strict=True):
        for name, values in one.columns.items():
            np.testing.assert_allclose(values, other.columns[name], atol=1e-5)
