"""Names on measured data: less of it must not change a name without a warning."""

from pathlib import Path

import numpy as np
import pytest
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.gap.machine import Machine
from omnislip.gap.measured import (
    CASES,
    NOISE_STEPS,
    answer_to_pulses,
    closed_loop_errors,
    first_half,
    halved_rate,
    noisier,
    surprises,
)
from omnislip.gap.recordings import make_run
from omnislip.importers import data_folder
from omnislip.importers.bam import import_bam, published_model, read_records
from omnislip.importers.emps import import_emps
from omnislip.importers.optiodom import import_optiodom
from omnislip.log_file import Log, read_log, write_log
from omnislip.model_file import Model, read_model

BAM = data_folder() / "bam_xl330"
DATA_SETS = ("emps", "bam_xl330", "optiodom_omni")
IMPORTERS = {"emps": import_emps, "bam": import_bam, "optiodom": import_optiodom}
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


@pytest.fixture(scope="module", params=[case.name for case in CASES])
def case(request, tmp_path_factory):
    """A data set with its model, its logs and what all of them say."""
    if not all((data_folder() / name).exists() for name in DATA_SETS):
        pytest.skip("tools/fetch-data was not run")
    chosen = next(case for case in CASES if case.name == request.param)
    folder = tmp_path_factory.mktemp(chosen.name)
    IMPORTERS[chosen.importer](data_folder(), folder)
    model, paths = folder / chosen.model, chosen.logs(folder)
    logs = [read_log(path, read_model(model).kind) for path in paths]
    return chosen.name, model, logs, to_json(find_gap(model, paths, lambda text: None))


def found(model: Path, logs: list[Log], folder: Path) -> dict:
    paths = [folder / log.series / f"{log.name}.csv" for log in logs]
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


def every_second(logs: list[Log]) -> list[Log]:
    return logs[::2]


def half_the_rate(logs: list[Log]) -> list[Log]:
    return [halved_rate(log) for log in logs]


# What may be said of less data is told by `surprises`; this much of the names has to stay.
ALWAYS = {
    "emps": {"coulomb_friction", "asymmetric_friction"},
    "bam_xl330": {"load_dependent_friction"},
    "optiodom_omni4": {"wheel_radius_error", "lateral_slip"},
    "optiodom_omni3": set(),
}
NEVER = {"bam_xl330": {"stribeck_friction"}}
CLOSED = {"emps": 0.95, "bam_xl330": 0.9, "optiodom_omni4": 0.25, "optiodom_omni3": 0.8}
"""Share of the gap on held-out runs that the names close at least."""
REFUTED = {"optiodom_omni4": "pose_latency"}
"""One delay would close 6 % more, but this recorder's circles show 0.02 s, its squares 0.1 s."""


def test_the_names_close_the_gap_on_held_out_runs(case):
    name, _, _, everything = case
    assert everything["gap"]["closed_fraction"]["value"] > CLOSED[name]
    named = everything["effects"] or everything["nearest"]
    assert REFUTED.get(name) not in [effect["name"] for effect in named]


@pytest.mark.parametrize("less", [every_second, half_the_rate])
def test_half_of_the_data_does_not_change_a_name_without_a_warning(case, less, tmp_path):
    name, model, logs, everything = case
    numbers = found(model, less(logs), tmp_path)
    assert surprises(numbers, everything) == []
    for said in (numbers, everything):
        effects = said["effects"] or said["nearest"]
        names = {n for e in effects for n in (e["name"], *e["ambiguous_with"])}
        assert ALWAYS[name] <= names or said["verdict"] == "insufficient_data"
        assert not names & NEVER.get(name, set())


def test_a_dead_time_shows_as_such_in_the_answer_to_pulses():
    rng = np.random.default_rng(1)
    rows, row_s, late_rows = 20000, 1e-3, 3
    pulses = 5.0 * (rng.uniform(size=rows // 10) < 0.05).repeat(10)
    model = Model("axis", {"axis.mass_kg": 10.0, "axis.input_gain_n_v": 20.0})
    machine = Machine(model)
    command = np.roll(pulses, late_rows)  # what the mass feels
    speed = np.concatenate([[0.0], np.cumsum(2.0 * command * row_s)])[:-1]
    place = np.cumsum(speed * row_s) + np.cumsum(command) * row_s**2
    log = Log(
        "run",
        np.arange(rows) * row_s,
        {"axis/command": pulses, "axis/position_m": np.concatenate([[0.0], place[:-1]])},
    )
    for band in answer_to_pulses(machine, machine.believed, make_run(machine, log), pulses):
        assert band.mass_ratio == pytest.approx(1.0, abs=0.02)
        assert band.dead_time_s == pytest.approx(late_rows * row_s, rel=0.02)
        assert band.coherence > 0.9


@pytest.mark.skipif(not BAM.exists(), reason="tools/fetch-data was not run")
def test_the_authors_model_has_the_error_that_they_found():
    machine = Machine(published_model())
    errors = closed_loop_errors(machine, machine.believed, read_records(data_folder()))
    # 86 mrad in their own simulator, which steps and stops otherwise.
    assert 1e3 * errors.mean() == pytest.approx(86.0, abs=2.0)
