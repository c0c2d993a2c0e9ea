"""Import of the BAM records, on made-up records of their format and, if at hand, on the real."""

import gzip
import json

import numpy as np
import pytest
from omnislip.errors import InputError
from omnislip.importers import data_folder
from omnislip.importers.bam import import_bam, read_records, servo_duty
from omnislip.log_file import read_log
from omnislip.model_file import read_model


def record(**changed):
    entries = [
        {
            "timestamp": 0.005 * k,
            "position": 0.1 * k,
            "goal_position": 0.2,
            "load": load,
            "input_volts": 8.0,
            "torque_enable": k < 3,
        }
        for k, load in enumerate([885, 65536 - 885, 442.5, 0, 0])
    ]
    content = {"mass": 0.49, "length": 0.1, "kp": 200, "trajectory": "lift_and_drop"}
    return content | {"entries": entries} | changed


@pytest.fixture
def write(tmp_path):
    """Store a record as the authors do; returns the data folder."""

    def _write(content):
        folder = tmp_path / "data" / "bam_xl330"
        folder.mkdir(parents=True, exist_ok=True)
        with gzip.open(folder / "raw_2026.json.gz", "wt") as file:
            json.dump(content, file)
        return folder.parent

    return _write


def test_load_becomes_volts_and_a_drive_that_is_off_a_blank_command(write, tmp_path):
    written = import_bam(write(record()), tmp_path / "out")
    assert [path.name for path in written] == ["01_kp200_lift_and_drop.csv", "bam_xl330.toml"]
    log = read_log(written[0], "axis")
    np.testing.assert_allclose(log.columns["axis/command"], [8.0, -8.0, 4.0, np.nan, np.nan])
    np.testing.assert_allclose(log.columns["axis/position_rad"], 0.1 * np.arange(5))


def test_model_believes_the_data_sheet_and_no_friction(write, tmp_path):
    model = read_model(import_bam(write(record()), tmp_path / "out")[-1])
    assert "axis.viscous_friction_nm_s_rad" not in model.values
    assert model.effects == []
    # At the no-load speed of the data sheet the torque is gone.
    torque = 5.0 * model.values["axis.input_gain_nm_v"]
    assert torque == pytest.approx(10.8 * model.values["axis.back_emf_nm_s_rad"])


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"mass": 0.5}, "mass and length"),
        ({"entries": [{"timestamp": 0.0}]}, "load"),
        ({"entries": "none"}, "not a record"),
    ],
)
def test_what_is_no_record_is_named(write, tmp_path, changed, named):
    data = write(record(**changed))
    with pytest.raises(InputError, match=rf"raw_2026\.json\.gz: .*{named}"):
        import_bam(data, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_another_servo_is_refused(write, tmp_path):
    entries = [entry | {"load": 2000} for entry in record()["entries"]]
    with pytest.raises(InputError, match="load or supply out of range"):
        import_bam(write(record(entries=entries)), tmp_path / "out")


def test_missing_records_say_where_they_come_from(tmp_path):
    with pytest.raises(InputError, match="tools/fetch-data"):
        import_bam(tmp_path, tmp_path / "out")


def test_position_loop_saturates():
    # One count of 4096 at gain 256 is a duty of 1 / 885.
    error = np.array([2 * np.pi / 4096, 10.0, -10.0])
    np.testing.assert_allclose(servo_duty(256.0, error), [1 / 885, 1.0, -1.0])


@pytest.mark.skipif(
    not (data_folder() / "bam_xl330").exists(), reason="tools/fetch-data was not run"
)
def test_real_records_obey_their_position_loop():
    records = read_records(data_folder())
    assert len(records) == 16
    for one in records:
        error = one.goal_rad - one.position_rad
        told = servo_duty(one.gain, error)[one.on]
        # The servo reads both a little later: a few rows of motion.
        assert np.median(np.abs(told - one.duty[one.on])) < 0.03
