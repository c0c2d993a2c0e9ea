"""Intervals of the effects that are named, and what they owe to the law of friction."""

import numpy as np
from axis_bench import silent
from omnislip.gap.inference import fit, weigh
from omnislip.gap.leftover import responses
from omnislip.gap.rivals import compare_all
from omnislip.gap.selected import find_interval, select_effects
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.terms import dictionary
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from truth_bench import robot_runs


def test_an_edge_that_nobody_drove_over_is_open_as_far_as_anybody_drove(tmp_path):
    """And one that was is known to millimetres."""
    hidden = {"x_min_m": -0.15, "x_max_m": 9.0, "scale": 0.5}
    effect = HiddenEffect("slippery_patch", hidden).as_dict()
    case = TruthCase(seed=8, effects=(effect,), runs=2, run_duration_s=4.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    patch = candidates["slippery_patch"].along_x()
    end_m = patch.edges_m[1][-1]
    start = believed_hypothesis(robot).with_effect(patch, [-0.15, end_m - 0.02, 0.5])
    data, found = settle(robot, runs, start)
    evidence = weigh(data, fit(data, found.hypothesis.without(0)), found, 0)
    values = found.hypothesis.values_of(0)
    low, high = find_interval(data, found, 0, values, evidence).T
    assert (low < values).all()
    assert (values < high).all()
    assert low[0] < -0.15 < high[0] < low[0] + 0.005
    assert high[1] == end_m


def test_a_current_limit_is_no_better_known_than_what_an_ampere_is(tmp_path):
    """Half the current through twice the resistance and torque constant moves a robot alike.

    Each is believed to 2 % and nothing else tells: 2 % / sqrt(2) is the least deviation.
    """
    effect = HiddenEffect("current_limit", {"limit_a": 4.0}).as_dict()
    case = TruthCase(seed=8, effects=(effect,), excitation="rich", runs=2, run_duration_s=3.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["current_limit"], [5.0])
    data, found = settle(robot, runs, start)
    evidence = weigh(data, fit(data, found.hypothesis.without(0)), found, 0)
    [limit_a] = values = found.hypothesis.values_of(0)
    [[low_a, high_a]] = find_interval(data, found, 0, values, evidence)
    assert low_a < 4.0 < high_a
    assert evidence.gain > 1e5
    assert 1.9 * 0.02 / np.sqrt(2.0) < (high_a - limit_a) / limit_a < 0.06


def test_bristles_may_owe_as_much_to_the_law_of_friction_as_its_curve(tmp_path):
    """And dry friction of the shafts, which is of its own, nothing."""
    hidden = [
        HiddenEffect("bristle_relaxation", {"length_m": 1e-3}),
        HiddenEffect("coulomb_friction", {"torque_nm": 0.004}),
    ]
    effects = tuple(one.as_dict() for one in hidden)
    case = TruthCase(seed=8, effects=effects, excitation="rich", runs=2, run_duration_s=3.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot)
    start = start.with_effect(candidates["bristle_relaxation"], [1e-3, 0.0])
    start = start.with_effect(candidates["coulomb_friction"], [0.004])
    data, found = settle(robot, runs, start)
    free = responses(data, found, dictionary(robot))
    selected = select_effects(data, found, free, compare_all(data, found, {}, silent))
    laws = {one.candidate.effect: (one.law_gain, one.evidence.gain) for one in selected}
    gain, own = laws["bristle_relaxation"]
    assert 1e-3 * own < gain < own
    assert laws["coulomb_friction"][0] == 0.0
