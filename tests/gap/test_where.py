"""Where the gap sits: an excess that is put somewhere is found there, and described so."""

from dataclasses import replace

import numpy as np
import pytest
from axis_bench import Bench, make_machine, make_runs, silent
from omnislip.gap.inference import Data, fit
from omnislip.gap.leftover import find_shapes
from omnislip.gap.machine import Machine
from omnislip.gap.noise import DISTURBANCES, first_guess, track_all, tune_noise
from omnislip.gap.recordings import Run
from omnislip.gap.search import search
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import typical_effect
from omnislip.gap.where import ROBOT_EQUATIONS, Map, describe, map_gap
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from truth_bench import runs_of

ROWS, ROW_S = 1200, 0.005
EQUATIONS = tuple(ROBOT_EQUATIONS)


def made_up_run(name="run_01"):
    """Wheel i goes to and fro with i + 1 half waves, cubed, so that slow rows hardly accelerate.

    The command has a rhythm of its own: slow rows are not those of small command.
    """
    t_s = np.arange(ROWS) * ROW_S
    phase = np.pi * np.outer(t_s, [1, 2, 3, 4]) / 3
    angle = 100 * np.cumsum(np.sin(phase) ** 3, axis=0) * ROW_S
    outputs = np.hstack([angle, np.zeros((ROWS, 4))])
    return Run(name, t_s, np.sin(2.3 * phase + 0.5), outputs, tuple("abcdefgh"), np.ones(8), None)


def made_up_map(run, equation, inside, inside_share=1.0):
    """Excess of one equation, spread over the rows `inside` and, with the rest, over all others."""
    excess = np.zeros((ROWS, len(EQUATIONS)))
    column = EQUATIONS.index(equation)
    excess[inside, column] = inside_share / inside.sum()
    excess[~inside, column] = (1 - inside_share) / max((~inside).sum(), 1)
    shares = excess.sum(axis=0) / excess.sum()
    return Map(EQUATIONS, (run.t_s,), (excess,), shares, (made_up_states(run),))


def made_up_states(run):
    """Filtered states in which each quantity of the body has a rhythm of its own."""
    states = np.zeros((len(run.t_s), 21))
    states[:, 8:13] = np.sin(np.outer(run.t_s, [1.7, 2.9, 4.3, 5.9, 7.1]) + 0.3)
    return states


def speed_of(run, wheel):
    return np.gradient(run.outputs[:, wheel - 1], run.t_s)


CONDITIONS = {
    "at high speed": lambda run, w: np.abs(speed_of(run, w)) > 0.8 * speed_of(run, w).max(),
    "at low speed": lambda run, w: np.abs(speed_of(run, w)) < 0.2 * speed_of(run, w).max(),
    "turning forwards": lambda run, w: speed_of(run, w) > 0.3 * speed_of(run, w).max(),
    "turning backwards": lambda run, w: speed_of(run, w) < -0.3 * speed_of(run, w).max(),
    "at small command": lambda run, w: np.abs(run.command[:, w - 1]) < 0.2,
    "late in the run": lambda run, w: run.t_s > 0.8 * run.t_s[-1],
    "early in the run": lambda run, w: run.t_s < 0.2 * run.t_s[-1],
    "while braking": lambda run, w: run.command[:, w - 1] * np.sign(speed_of(run, w)) < -0.5,
}


@pytest.mark.parametrize("wheel", [1, 3])
@pytest.mark.parametrize("condition", CONDITIONS)
def test_an_excess_is_found_at_its_wheel_and_in_its_condition(condition, wheel):
    run = made_up_run()
    equation = f"wheel/{wheel}/torque"
    inside = CONDITIONS[condition](run, wheel)
    [place] = describe([run], made_up_map(run, equation, inside))
    assert place.channel == equation
    assert place.share == pytest.approx(1.0)
    assert place.condition.startswith(condition)


BODY_CONDITIONS = {
    "while the body moves fast along x": lambda states: np.abs(states[:, 8]) > 0.9,
    "while the body moves little along y": lambda states: np.abs(states[:, 9]) < 0.2,
    "turning fast": lambda states: np.abs(states[:, 10]) > 0.9,
    "where x is small": lambda states: states[:, 11] < -0.7,
    "where y is large": lambda states: states[:, 12] > 0.7,
}


@pytest.mark.parametrize("equation", ["body/force_y", "pose/heading"])
@pytest.mark.parametrize("condition", BODY_CONDITIONS)
def test_an_excess_of_the_body_is_found_in_its_own_motion(condition, equation):
    run = made_up_run()
    inside = BODY_CONDITIONS[condition](made_up_states(run))
    [place] = describe([run], made_up_map(run, equation, inside))
    assert place.condition.startswith(condition)


def test_without_a_camera_no_place_is_named():
    run = made_up_run()
    inside = BODY_CONDITIONS["where x is small"](made_up_states(run))
    run.outputs[:, 5:8] = np.nan
    [place] = describe([run], made_up_map(run, "body/force_y", inside))
    assert not place.condition.startswith("where")


def test_late_in_the_run_is_late_in_the_log_of_which_runs_are_parts():
    """One log of 6 s in four parts, as a single log is cut; the excess is in the last one."""
    whole = made_up_run()
    rows = [slice(k, k + ROWS // 4) for k in range(0, ROWS, ROWS // 4)]
    runs = [
        replace(whole, t_s=whole.t_s[r], command=whole.command[r], outputs=whole.outputs[r])
        for r in rows
    ]
    found = made_up_map(whole, "wheel/2/torque", whole.t_s > 0.8 * whole.t_s[-1])
    t_s, excess, states = (
        tuple(column[0][r] for r in rows) for column in (found.t_s, found.excess, found.states)
    )
    [place] = describe(runs, Map(EQUATIONS, t_s, excess, found.shares, states))
    assert place.condition.startswith("late in the run")


def test_an_excess_spread_over_all_rows_has_no_condition():
    run = made_up_run()
    everywhere = np.ones(ROWS, bool)
    [place] = describe([run], made_up_map(run, "wheel/2/torque", everywhere))
    assert place.condition == "everywhere"


def test_windows_are_where_the_excess_is():
    run = made_up_run()
    inside = (run.t_s >= 2.5) & (run.t_s < 2.75)
    [place] = describe([run], made_up_map(run, "body/moment", inside))
    assert place.windows_s[0][0] == "run_01"
    assert place.windows_s[0][1:] == pytest.approx((2.5, 2.75))


def test_small_shares_are_left_out_and_large_ones_come_first():
    run = made_up_run()
    excess = np.zeros((ROWS, len(EQUATIONS)))
    excess[:, 2], excess[:, 5], excess[:, 6] = 0.7, 0.27, 0.03
    shares = excess.sum(0) / excess.sum()
    gap_map = Map(EQUATIONS, (run.t_s,), (excess,), shares, (made_up_states(run),))
    places = describe([run], gap_map)
    assert [place.channel for place in places] == [EQUATIONS[2], EQUATIONS[5]]
    assert [place.share for place in places] == pytest.approx([0.7, 0.27])


# ---- from logs ----


def test_friction_of_an_axis_is_in_its_force(tmp_path):
    machine = make_machine(tmp_path)
    bench = Bench(coulomb_n=2.0)
    runs = make_runs(machine, bench, range(8))
    outcome = search(machine, runs, None, silent)
    refit, after = (f.hypothesis.flat(machine.believed) for f in (outcome.base, outcome.final))
    found = map_gap(machine, runs, outcome.data.noise, refit, after)
    places = describe(runs, found)
    assert found.shares.sum() == pytest.approx(1.0)
    assert places[0].channel == "axis/force"
    assert places[0].share > 0.5


def test_the_weak_motor_is_found_at_its_wheel():
    """Wheel 3 of a robot has lost torque: its torque equation is corrected most."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    weak = typical_effect("weak_motor", 3).as_dict()
    case = TruthCase(5, (weak,), runs=2, run_duration_s=3.0, base_offset_sd=0.0)
    runs = runs_of(machine, case)
    true = machine.believed.copy()
    true[list(machine.place("weak_motor", "scale", 3))] = weak["parameters"]["scale"]
    noise = tune_noise(machine, runs, true)
    found = map_gap(machine, runs, noise, machine.believed, true)
    assert describe(runs, found)[0].channel == "wheel/3/torque"
    assert found.shares[EQUATIONS.index("wheel/3/torque")] > 0.5


LOOKS = {
    "coulomb_friction": ({}, "every wheel/torque: direction of rotation"),
    "cogging": ({}, "sine of 9 times the shaft angle"),
    "floor_slope": ({"y_m_s2": 0.0}, "world/force_x: constant"),
}


@pytest.mark.parametrize("name", LOOKS)
def test_what_the_gap_looks_like_tells_parity_order_and_frame(name):
    """Friction is odd in the speed, cogging has an order of the shaft, a slope is the world's."""
    changed, looks = LOOKS[name]
    machine = Machine(read_model(NOMINAL_ROBOT))
    hidden = typical_effect(name, None).as_dict()
    hidden["parameters"] |= changed
    case = TruthCase(6, (hidden,), runs=4, run_duration_s=3.0, base_offset_sd=0.0)
    runs = runs_of(machine, case)
    true = machine.believed.copy()
    for label, value in hidden["parameters"].items():
        true[list(machine.place(name, label, None))] = value
    noise = tune_noise(machine, runs, true)
    start = believed_hypothesis(machine)
    data = Data(machine, runs, noise, start)
    shapes = find_shapes(data, fit(data, start))
    strongest = max(shapes, key=lambda shape: shape.gain)
    assert looks in f"{strongest.equation}: {strongest.dependence}"


def test_disturbances_tell_of_what_they_push_beside_memory_too():
    """Springs stand before them in the filter's state."""
    stiff = Machine(read_model(NOMINAL_ROBOT))
    springs = Effect("shaft_compliance", {"stiffness_nm_rad": 100.0, "damping_nm_s_rad": 0.1})
    sprung = Machine(replace(stiff.model, effects=[springs]))
    runs = runs_of(stiff, TruthCase(5, runs=1, run_duration_s=2.0))
    for machine, memory in ((stiff, 0), (sprung, 8)):
        [track] = track_all(machine, runs, machine.believed, first_guess(machine, runs))
        states = np.arange(track.filter_states)
        assert len(states) == 14 + memory + 7
        told = [own[1] for own in ROBOT_EQUATIONS.values() if len(own) == 2][:7]
        assert [states[place] for place in told] == list(states[DISTURBANCES])
