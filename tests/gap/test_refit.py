"""Where no derivative leads: edges, thresholds, numbers of teeth."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.gap.inference import fit, linearise, weigh
from omnislip.gap.judge import SURE_GAIN
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import make_run
from omnislip.gap.refit import extend_effects, refit_each, settle_placed, whole_numbers
from omnislip.gap.screen import screen
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, simulate_truth
from truth_bench import robot_runs, robot_with_magnets


@pytest.mark.parametrize("share", [0.244, 0.4, 0.78, 0.97])
def test_a_threshold_between_two_starts_is_found(tmp_path, share):
    """An encoder loses counts beyond a share of the fastest speed; starts are at 0.5, 0.7, ..."""
    lost = {"fraction": 0.03, "speed_rad_s": share * 320.0}
    hidden = HiddenEffect("encoder_dropout", lost, 2).as_dict()
    case = TruthCase(seed=5, effects=(hidden,), runs=3, run_duration_s=4.0)
    robot, runs, _ = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    dropout = [c for c in robot.candidates_for(runs) if c.name == "encoder_dropout (wheel 2)"]
    [fitted] = refit_each(data, current, screen(data, current, dropout))
    fraction, speed_rad_s = fitted.hypothesis.values_of(0)
    deviation = np.sqrt(weigh(data, current, fitted, 0).covariance[0, 0])
    assert speed_rad_s == pytest.approx(lost["speed_rad_s"], rel=0.003)
    assert fraction == pytest.approx(lost["fraction"], abs=max(0.03 * fraction, 3.0 * deviation))
    assert deviation < 0.05 * fraction  # few rows are so fast


def test_a_threshold_that_was_drawn_to_a_wrong_place_is_found_again(tmp_path):
    """A fit from a quarter further up moves it within the rows that it divides."""
    lost = {"fraction": 0.03, "speed_rad_s": 0.4 * 320.0}
    hidden = HiddenEffect("encoder_dropout", lost, 2).as_dict()
    case = TruthCase(seed=5, effects=(hidden,), runs=3, run_duration_s=4.0)
    robot, runs, _ = robot_runs(case, tmp_path)
    [dropout] = [c for c in robot.candidates_for(runs) if c.name == "encoder_dropout (wheel 2)"]
    start = believed_hypothesis(robot).with_effect(dropout, [0.03, 1.25 * lost["speed_rad_s"]])
    data, stuck = settle(robot, runs, start)
    assert stuck.hypothesis.values_of(0)[1] > 1.1 * lost["speed_rad_s"]
    _, found = settle_placed(data, stuck)
    assert found.hypothesis.values_of(0)[1] == pytest.approx(lost["speed_rad_s"], rel=0.003)


def test_edges_of_a_patch_that_were_drawn_to_a_wrong_place_are_found_again(tmp_path):
    """Beside the other effects as they are; some centimetres away there is nothing to descend."""
    floor = {"x_min_m": -0.1, "x_max_m": 0.4, "scale": 0.5}
    hidden = HiddenEffect("slippery_patch", floor).as_dict()
    case = TruthCase(seed=8, effects=(hidden,), excitation="rich", runs=2, run_duration_s=4.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(
        candidates["slippery_patch"].along_x(), [floor["x_min_m"] + 0.04, 0.4, 0.52]
    )
    data, stuck = settle(robot, runs, start)
    assert abs(stuck.hypothesis.values_of(0)[0] - floor["x_min_m"]) > 0.015
    data, found = settle_placed(data, stuck)
    edges_m = found.hypothesis.values_of(0)[:2]
    assert edges_m == pytest.approx([floor["x_min_m"], floor["x_max_m"]], abs=0.002)


@pytest.mark.parametrize("magnets", [9.0, 36.0])
def test_every_number_of_magnets_is_looked_for(tmp_path, magnets):
    """One next to it is out of step after some turns, so that no fit leads from there."""
    robot, runs, candidates = robot_with_magnets(magnets, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    [screened] = screen(data, current, [candidates["cogging"]])
    assert screened.promise > SURE_GAIN
    assert screened.start[1] == magnets


@pytest.mark.parametrize("magnets", [7.0, 7.4])
def test_magnets_are_counted_in_whole_numbers_where_the_log_allows(tmp_path, magnets):
    """The phase, which a count off by a hundredth turns within some revolutions, comes right."""
    robot, runs, candidates = robot_with_magnets(magnets, tmp_path)
    start = believed_hypothesis(robot).with_effect(
        candidates["cogging"], [0.008, magnets + 2e-3, 0.9]
    )
    data, fitted = settle(robot, runs, start)
    final = whole_numbers(data, fitted)
    counted = final.hypothesis.values_of(0)
    if magnets == round(magnets):
        assert counted[1] == magnets
        assert counted[2] == pytest.approx(1.0, abs=0.02)
        without = fit(data, final.hypothesis.without(0))
        free, held = (weigh(data, without, one, 0).covariance for one in (fitted, final))
        assert held[1, 1] == 0.0
        assert 0.0 < held[2, 2] < free[2, 2]
    else:
        assert counted[1] == pytest.approx(magnets, abs=0.01)
        assert counted[1] != round(counted[1])


def test_the_derivative_by_a_number_of_cycles_is_that_at_the_place(tmp_path):
    """The first secant turns the phase around; what it gives may be many times too small."""
    robot, runs, candidates = robot_with_magnets(7.0, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["cogging"], [0.008, 7.0, 1.0])
    data, fitted = settle(robot, runs, start)
    number = len(fitted.hypothesis.x) - 2
    _, [around] = linearise(data, [fitted.hypothesis])
    _, [found] = linearise(data, [fitted.hypothesis], last=[0.1 * around])
    size = np.linalg.norm(found[:, number])
    ends = []
    for sign in (1.0, -1.0):
        x = fitted.hypothesis.x.copy()
        x[number] += sign * 1e-2 / size * fitted.hypothesis.parameters[number].scale
        ends.append(data.residuals(fitted.hypothesis.flat(data.believed, x)[None])[0])
    right = (ends[0] - ends[1]) / (2e-2 / size)
    assert np.linalg.norm(found[:, number] - right) < 0.01 * size
    assert np.linalg.norm(around[:, number] - right) > 0.3 * size


@pytest.mark.parametrize("cooling_s", [4.0, 60.0])
def test_windings_that_cool_faster_have_a_time_of_their_own(cooling_s):
    """Three drives to and fro, of 8 s each, in which the resistance grows by a half and more."""
    heating = {"coefficient": 0.02, "cooling_time_s": cooling_s}
    warm = replace(read_model(NOMINAL_ROBOT), effects=[Effect("winding_heating", heating)])
    machine, runs = Machine(read_model(NOMINAL_ROBOT)), []
    for seed in range(3):
        speeds = np.random.default_rng(seed).uniform(-1.5, 1.5, (20, 2))
        driving = [
            {"t_s": 0.4 * k, "kind": "velocity", "value": [*speed.tolist(), 0.0]}
            for k, speed in enumerate(speeds)
        ]
        sensors = Sensors(pose_noise_m=0.001)
        scenario = Scenario(f"run_{seed}", 8.0, warm, driving, sensors=sensors, seed=seed)
        runs.append(make_run(machine, make_log(scenario, simulate_truth(scenario))))
    [found] = [c for c in machine.candidates() if c.name == "winding_heating"]
    start = believed_hypothesis(machine).with_effect(found, [0.01])
    data, fitted = settle(machine, runs, start)
    refined = extend_effects(machine, data, fitted).hypothesis
    names = [p.label for p in refined.effects[0].parameters]
    if cooling_s == 60.0:
        assert names == ["coefficient"]
        assert refined.values_of(0) == pytest.approx([0.02], rel=0.03)
    else:
        assert names == ["coefficient", "cooling_time_s"]
        assert refined.values_of(0) == pytest.approx([0.02, cooling_s], rel=0.1)


@pytest.mark.parametrize("curve", ["rational", "straight"])
def test_a_law_with_a_heavy_tail_or_none_has_a_share_of_its_own(tmp_path, curve):
    """Half the limit is reached at the slip of the slope, or all of it."""
    case = TruthCase(seed=8, friction_curve=curve, excitation="rich", runs=2, run_duration_s=3.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["contact_shape"], [0.1])
    data, bent = settle(robot, runs, start)
    refined = extend_effects(robot, data, bent)
    [law] = refined.hypothesis.effects
    shares = {
        p.label: x for p, x in zip(law.parameters, refined.hypothesis.values_of(0), strict=True)
    }
    assert shares[curve] == pytest.approx(1.0, abs=0.03)
    assert refined.objective < bent.objective - 500.0
