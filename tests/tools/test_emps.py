"""Import of the EMPS records, on made-up records of their format and, if at hand, on the real."""

import numpy as np
import pytest
import scipy.io
from omnislip.errors import InputError
from omnislip.importers import data_folder
from omnislip.importers.emps import RECORDS, import_emps
from omnislip.log_file import read_log
from omnislip.model_file import read_model


@pytest.fixture
def records(tmp_path):
    """A data folder with two short records as the authors store them: columns of (n, 1)."""
    folder = tmp_path / "data" / "emps"
    folder.mkdir(parents=True)
    t_s = np.arange(5)[:, None] / 1000
    for scale, file in enumerate(RECORDS.values(), 1):
        columns = {"t": t_s, "qm": scale * t_s, "vir": scale + t_s, "gtau": 35.1507}
        scipy.io.savemat(folder / file, columns)
    return folder.parent


def test_records_become_logs_and_a_model(records, tmp_path):
    out = tmp_path / "out"
    written = import_emps(records, out)
    assert [path.name for path in written] == ["train.csv", "test.csv", "emps.toml"]
    log = read_log(out / "test.csv", "axis")
    np.testing.assert_array_equal(log.t_s, np.arange(5) / 1000)
    np.testing.assert_array_equal(log.columns["axis/position_m"], 2 * log.t_s)
    np.testing.assert_array_equal(log.columns["axis/command"], 2 + log.t_s)


def test_model_believes_mass_gain_and_viscous_friction_only(records, tmp_path):
    import_emps(records, tmp_path / "out")
    model = read_model(tmp_path / "out" / "emps.toml")
    assert model.kind == "axis"
    assert sorted(model.values) == [
        "axis.input_gain_n_v",
        "axis.mass_kg",
        "axis.viscous_friction_n_s_m",
    ]
    assert model.effects == []


def test_nothing_is_written_when_a_record_is_missing(records, tmp_path):
    (records / "emps" / "DATA_EMPS_PULSES.mat").unlink()
    with pytest.raises(InputError, match=r"DATA_EMPS_PULSES\.mat: not found; .*tools/fetch-data"):
        import_emps(records, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_that_is_no_record_is_named(records, tmp_path):
    (records / "emps" / "DATA_EMPS.mat").write_bytes(b"not a record of any kind" * 20)
    with pytest.raises(InputError, match=r"DATA_EMPS\.mat: not the EMPS record"):
        import_emps(records, tmp_path / "out")


def test_a_record_without_its_variables_is_named(records, tmp_path):
    scipy.io.savemat(records / "emps" / "DATA_EMPS.mat", {"t": np.arange(5)})
    with pytest.raises(InputError, match="not the EMPS record: 'qm'"):
        import_emps(records, tmp_path / "out")


@pytest.mark.parametrize(
    ("column", "factor", "said"),
    [
        ("t", 1000.0, "rows are 1 s apart, not 0.001 s"),
        ("qm", 1000.0, "qm exceeds 0.5 m"),
        ("vir", 35.1507, "vir exceeds 10 V"),
        ("gtau", 0.005, "gtau is 0.175754 N/V, not 35.1507"),
    ],
)
def test_a_record_in_other_units_is_refused(column, factor, said, records, tmp_path):
    path = records / "emps" / "DATA_EMPS.mat"
    record = {key: scipy.io.loadmat(path)[key] for key in ("t", "qm", "vir", "gtau")}
    scipy.io.savemat(path, record | {column: factor * record[column]})
    with pytest.raises(InputError, match=said):
        import_emps(records, tmp_path / "out")


@pytest.mark.skipif(not (data_folder() / "emps").exists(), reason="tools/fetch-data was not run")
def test_real_records(tmp_path):
    import_emps(data_folder(), tmp_path)
    log = read_log(tmp_path / "train.csv", "axis")
    assert len(log.t_s) == 24841
    assert log.t_s[-1] == pytest.approx(24.84, abs=0.01)
    assert np.abs(log.columns["axis/command"]).max() <= 10.0
