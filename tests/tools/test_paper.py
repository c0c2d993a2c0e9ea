"""The paper's experiment: how its figures are read off a run, and what a run produces."""

import json

import numpy as np
import pytest
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.paper import Case, Outcome, all_cases, case_scenario, measure, ratios, run_experiment


def made_up_truth() -> dict[str, np.ndarray]:
    """Speed 1.485 m/s with one tick of 1.53; after the impact at 1.5 s, y peaks and settles."""
    t_s = np.arange(3000) / 1000
    x_speed_m_s = np.full(3000, 1.485)
    x_speed_m_s[300] = 1.53
    y_m = np.where(t_s < 1.5, 0.0, -0.05)
    y_m[1600] = -0.08
    return {
        "t_s": t_s,
        "velocity": np.stack([x_speed_m_s, 0 * t_s, 0 * t_s], axis=1),
        "pose": np.stack([t_s, y_m, 0 * t_s], axis=1),
    }


def test_figures_of_a_run():
    outcome = measure(Case("plain", 1.5, 10.0), made_up_truth())
    assert outcome.impact_t_s == 1.5
    assert outcome.speed_overshoot_percent == pytest.approx(2.0)
    assert outcome.speed_error_percent == pytest.approx(-1.0)
    assert outcome.peak_y_m == pytest.approx(0.08)
    assert outcome.remaining_y_m == pytest.approx(0.05)


def test_ratio_is_without_over_with_slip_model():
    outcomes = [
        Outcome("plain", 1.85, 10.0, 1.4, 0.0, 0.0, peak_y_m=0.06, remaining_y_m=0.05),
        Outcome("slip", 1.85, 10.0, 1.4, 0.0, 0.0, peak_y_m=0.03, remaining_y_m=0.01),
        Outcome("slip", 2.35, 10.0, 1.4, 0.0, 0.0, peak_y_m=0.03, remaining_y_m=0.01),
    ]
    [row] = ratios(outcomes)
    assert (row["impact_x_m"], row["impulse_y_n_s"]) == (1.85, 10.0)
    assert row["peak_y_ratio"] == pytest.approx(2.0)
    assert row["remaining_y_ratio"] == pytest.approx(5.0)


def test_sweep_hits_both_controllers_alike():
    cases = all_cases()
    hits = {
        name: {(case.impact_x_m, case.impulse_y_n_s) for case in cases if case.controller == name}
        for name in ("plain", "slip")
    }
    assert hits["plain"] == hits["slip"]
    assert {x_m for x_m, _ in hits["plain"]} == {2.35, 1.85}


def test_scenarios_differ_only_in_the_controller():
    model = read_model(NOMINAL_ROBOT)
    plain, slip = (case_scenario(Case(name, 2.35, 10.0), model) for name in ("plain", "slip"))
    assert (plain.slip_compensation, slip.slip_compensation) == (False, True)
    assert (plain.commands, plain.impulses) == (slip.commands, slip.impulses)
    assert plain.duration_s == slip.duration_s


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """The four runs with the reference impulse: folder and result."""
    out = tmp_path_factory.mktemp("paper")
    return out, run_experiment([case for case in all_cases() if case.impulse_y_n_s == 10.0], out)


def test_experiment_leaves_figures_logs_and_json(experiment):
    out, result = experiment
    assert json.loads((out / "paper.json").read_text()) == result
    assert len(result["runs"]) == 4
    assert len(result["ratios"]) == 2
    assert sorted(path.name for path in out.iterdir()) == [
        "figure_6.png",
        "paper.json",
        "plain_1850_mm.csv",
        "plain_2350_mm.csv",
        "push.gif",
        "same_impact.png",
        "slip_1850_mm.csv",
        "slip_2350_mm.csv",
        "sweep.png",
    ]


def test_every_run_reaches_the_impact_at_speed(experiment):
    for run in experiment[1]["runs"]:
        assert abs(run["speed_error_percent"]) < 2
        assert 0 < run["peak_y_m"] < 1
        assert run["remaining_y_m"] <= run["peak_y_m"]


def test_the_paper_is_right_that_the_slip_model_leaves_less_displacement(experiment):
    for row in experiment[1]["ratios"]:
        assert row["peak_y_ratio"] >= 1
        assert row["remaining_y_ratio"] > 1
