"""Names on measured data: less of it must not change a name without a warning."""

from pathlib import Path

import numpy as np
import pytest
from omnislip.gap.find import find_gap, to_json
from omnislip.gap.machine import Machine
from omnislip.gap.measured import (
    NOISE_STEPS,
    closed_loop_errors,
    first_half,
    halved_rate,
    noisier,
    surprises,
)
from omnislip.importers import data_folder
from omnislip.importers.bam import import_bam, published_model, read_records
from omnislip.log_file import Log, read_log, write_log

BAM = data_folder() / "bam_xl330"
needs_data = pytest.mark.skipif(not BAM.exists(), reason="tools/fetch-data was not run")
AXIS = Log(
    "run",
    np.arange(6) * 0.1,
    {
        "axis/command": np.array([1.0, 3.0, 2.0, np.nan, np.nan, np.nan]),
        "axis/position_rad": np.array([0.0, 0.01, 0.03, 0.03, 0.04, 0.04]),
    },
)


def test_half_the_rate_keeps_what_the_command_did_on_average():
    log = halved_rate(AXIS)
    np.testing.assert_allclose(log.t_s, [0.0, 0.2, 0.4])
    np.testing.assert_allclose(log.columns["axis/command"], [2.0, 2.0, np.nan])
    np.testing.assert_allclose(log.columns["axis/position_rad"], [0.0, 0.03, 0.04])


def test_first_half_and_noise_leave_the_commands_alone():
    assert len(first_half(AXIS).t_s) == 3
    noisy = noisier(AXIS, 0)
    np.testing.assert_array_equal(noisy.columns["axis/command"], AXIS.columns["axis/command"])
    change = noisy.columns["axis/position_rad"] - AXIS.columns["axis/position_rad"]
    assert 0.0 < np.abs(change).max() < 5 * NOISE_STEPS * 0.01


@pytest.fixture(scope="module")
def bam(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bam")
    *logs, model = import_bam(data_folder(), folder)
    return model, [read_log(path, "axis") for path in logs]


def found(model: Path, logs: list[Log], folder: Path) -> dict:
    paths = [folder / f"{log.name}.csv" for log in logs]
    for path, log in zip(paths, logs, strict=True):
        write_log(log, path)
    return to_json(find_gap(model, paths, lambda text: None))


def said(verdict: str, *effects: tuple[str, list[str]]) -> dict:
    listed = [{"name": name, "ambiguous_with": rivals} for name, rivals in effects]
    return {"verdict": verdict, "effects": listed, "cautions": []}


def test_another_name_without_a_warning_is_a_surprise():
    everything = said("effect_found", ("coulomb_friction", ["stribeck_friction"]))
    other = ("driver_lag", [])
    assert surprises(said("effect_found", other), everything) == ["driver_lag"]
    assert surprises(said("unknown_effect", other), everything) == []
    assert surprises(said("effect_found", other) | {"cautions": ["few logs"]}, everything) == []
    assert surprises(said("effect_found", ("driver_lag", ["coulomb_friction"])), everything) == []
    assert surprises(said("effect_found", ("stribeck_friction", [])), everything) == []


def warned_or_same(numbers: dict, name: str) -> bool:
    """Whether `name` is found, or a rival of what is found, or nothing is claimed."""
    names = {n for e in numbers["effects"] for n in (e["name"], *e["ambiguous_with"])}
    return name in names or numbers["verdict"] in ("unknown_effect", "insufficient_data")


@needs_data
def test_half_of_the_runs_name_the_same_friction(bam, tmp_path):
    model, logs = bam
    numbers = found(model, logs[::2], tmp_path)
    assert warned_or_same(numbers, "load_dependent_friction")
    assert "stribeck_friction" not in [e["name"] for e in numbers["effects"]]


@needs_data
def test_half_the_rate_names_the_same_friction(bam, tmp_path):
    model, logs = bam
    numbers = found(model, [halved_rate(log) for log in logs], tmp_path)
    assert warned_or_same(numbers, "load_dependent_friction")
    assert "stribeck_friction" not in [e["name"] for e in numbers["effects"]]


@pytest.mark.skipif(
    not (BAM / "published_params_xl330_m1.json").exists(), reason="the authors' file is not there"
)
def test_the_authors_model_has_the_error_that_they_found():
    machine = Machine(published_model(BAM / "published_params_xl330_m1.json"))
    errors = closed_loop_errors(machine, machine.believed, read_records(data_folder()))
    # 86 mrad in their own simulator, which steps and stops otherwise.
    assert 1e3 * errors.mean() == pytest.approx(86.0, abs=2.0)
