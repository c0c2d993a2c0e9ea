"""An effect that a user defined is found by name where it hides, and stays in the amended model."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json, write_results
from omnislip.gap.report import render
from omnislip.log_file import write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, with_definitions, write_model
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario
from omnislip.user_effects import read_definitions

PACKAGE = NOMINAL_ROBOT.parents[1]
EXAMPLE = PACKAGE / "effects" / "cubic_wheel_drag.toml"
HIDDEN_NM_S3 = 4e-10


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The shipped identification run of a robot with cubic drag, judged by a model without."""
    folder = tmp_path_factory.mktemp("cubic")
    scenario = read_scenario(PACKAGE / "scenarios" / "identification.toml")
    robot = with_definitions(scenario.model, read_definitions(EXAMPLE), EXAMPLE)
    robot = replace(robot, effects=[Effect("cubic_wheel_drag", {"c_nm_s3": HIDDEN_NM_S3})])
    write_log(run_scenario(replace(scenario, model=robot)).log, folder / "run.csv")
    write_model(scenario.model, folder / "robot.toml")
    findings = find_gap(folder / "robot.toml", [folder / "run.csv"], lambda _: None, EXAMPLE)
    write_results(findings, folder / "gap", render(findings, "omnislip gap find"))
    return findings, folder / "gap"


def test_a_hidden_cubic_drag_is_found_by_name_and_nothing_else(found):
    """No jerk of the shipped run's duty is taken for a push."""
    [effect] = to_json(found[0])["effects"]
    assert (effect["name"], effect["wheel"]) == ("cubic_wheel_drag", None)
    size = effect["parameters"]["c_nm_s3"]
    assert size["value"] == pytest.approx(HIDDEN_NM_S3, rel=0.03)
    assert 0 < size["high"] - size["low"] < 0.1 * HIDDEN_NM_S3


def test_it_is_ranked_among_the_others(found):
    first = [t for t in found[0].outcome.trials if t.step == 1]
    gains = {t.candidate.name: t.evidence.gain for t in first}
    assert max(gains, key=gains.get) == "cubic_wheel_drag"
    assert gains["quadratic_wheel_drag"] > 0.5 * gains["cubic_wheel_drag"]
    assert all(np.isfinite(list(gains.values())))


def test_the_report_tells_what_it_is(found):
    page = (found[1] / "report.html").read_text()
    assert "Drag on the shaft that grows with the cube of the speed." in page
    assert "N m s^3" in page


def test_the_amended_model_reads_without_the_file_of_effects(found):
    model = read_model(found[1] / "robot.toml")
    [effect] = model.effects
    assert effect.name == "cubic_wheel_drag"
    assert model.definitions.keys() == {"cubic_wheel_drag"}
