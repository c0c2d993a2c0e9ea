"""The numbers of a run against runs made up so that the numbers are known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.measures import beside_line, beside_velocity_path, measure
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.paper import Case, case_scenario
from omnislip.paper import measure as measure_paper
from omnislip.scenario import Scenario
from omnislip.simulate import simulate_truth

MODEL = read_model(NOMINAL_ROBOT)
TICKS = 2000


def made_up(**arrays: np.ndarray) -> dict[str, np.ndarray]:
    """A robot at rest, without what `arrays` gives it."""
    t_s = np.arange(TICKS) / 1000
    rest = {"pose": 3, "odometry": 3, "velocity": 3, "duty": 4, "current_a": 4, "slip_m_s": 4}
    zeros = {name: np.zeros((TICKS, width)) for name, width in rest.items()}
    return {"t_s": t_s, "supply_v": np.full(TICKS, 24.0), **zeros, **arrays}


def scenario(*commands: tuple[float, str, list[float]]) -> Scenario:
    listed = [{"t_s": t_s, "kind": kind, "value": value} for t_s, kind, value in commands]
    return Scenario("made up", TICKS / 1000, MODEL, listed)


def along(x_m: np.ndarray, y_m: np.ndarray, theta_rad: float = 0.0) -> np.ndarray:
    return np.stack([x_m, y_m, np.full(len(x_m), theta_rad)], axis=1)


def test_a_straight_path_is_left_by_y():
    t_s = np.arange(TICKS) / 1000
    y_m = np.where(t_s < 1.0, 0.0, -0.02)
    y_m[1500] = 0.07
    numbers = measure(scenario((0.0, "velocity", [1.0, 0.0, 0.0])), made_up(pose=along(t_s, y_m)))
    assert numbers["peak_lateral_error_m"] == pytest.approx(0.07)
    assert numbers["remaining_lateral_error_m"] == pytest.approx(0.02)
    assert numbers["final_x_m"] == pytest.approx(1.999)
    assert numbers["odometry_error_m"] == pytest.approx(math.hypot(1.999, 0.02))


def test_each_command_begins_its_own_path():
    t_s = np.arange(TICKS) / 1000
    x_m, y_m = np.minimum(t_s, 1.0), np.maximum(t_s - 1.0, 0.0)
    corner = scenario((0.0, "velocity", [1.0, 0.0, 0.0]), (1.0, "velocity", [0.0, 1.0, 0.0]))
    assert measure(corner, made_up(pose=along(x_m, y_m)))["peak_lateral_error_m"] < 1e-12


finite = st.floats(-3, 3)


@given(finite, finite, st.floats(0.1, 3) | st.floats(-3, -0.1) | st.just(0.0), finite, finite)
def test_what_moves_as_commanded_is_on_its_path(vx, vy, omega, x_m, theta_rad):
    # World place under a constant body velocity, by a sum of small steps at their middle headings.
    t_s = np.linspace(0.0, 1.0, 2001)
    middle = theta_rad + omega * (t_s[:-1] + t_s[1]) + -omega * t_s[1] / 2
    step = np.stack(
        [vx * np.cos(middle) - vy * np.sin(middle), vx * np.sin(middle) + vy * np.cos(middle)]
    )
    place = np.concatenate([[[x_m, 0.0]], np.cumsum(step.T, axis=0) * t_s[1] + [x_m, 0.0]])
    pose = np.column_stack([place, theta_rad + omega * t_s])
    beside = beside_velocity_path(pose, np.array([vx, vy, omega]))
    # The midpoint rule errs by (omega dt)^2 / 24 of the way: 4e-7 of 4 m.
    assert beside.max() < 2e-6


def test_beside_a_circle_is_the_distance_to_it():
    # 1 m/s ahead, 0.5 rad/s: radius 2 m, centre 2 m to the left of the start.
    pose = np.array([[0.0, 0.0, 0.0], [0.0, 5.0, 0.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(beside_velocity_path(pose, np.array([1.0, 0.0, 0.5])), [0, 1, 2])


def test_a_robot_told_to_stand_is_beside_where_it_stood():
    pose = np.array([[1.0, 1.0, 0.0], [4.0, 5.0, 0.0]])
    np.testing.assert_allclose(beside_velocity_path(pose, np.zeros(3)), [0, 5])


def test_a_goal_is_overshot_in_percent_of_the_way():
    place = np.array([[0.0, 0.0], [1.0, 0.1], [2.1, 0.0], [2.0, 0.0]])
    beside, overshoot = beside_line(place, np.array([2.0, 0.0]))
    np.testing.assert_allclose(beside, [0, 0.1, 0, 0], atol=1e-15)
    assert overshoot == pytest.approx(5.0)
    beside, overshoot = beside_line(place[:2], np.array([0.0, 0.01]))
    np.testing.assert_allclose(beside, [0.01, math.hypot(1.0, 0.09)])
    assert math.isnan(overshoot)


def test_overshoot_of_a_speed_is_in_percent_of_its_change():
    speed = np.full(TICKS, 1.0)
    speed[0], speed[700], speed[1000:], speed[1800] = 0.0, 1.1, 0.5, 0.4
    speed[1000] = 1.0
    velocity = np.stack([speed, 0 * speed, 0 * speed], axis=1)
    faster = scenario((0.0, "velocity", [1.0, 0.0, 0.0]))
    assert measure(faster, made_up(velocity=velocity))["overshoot_percent"] == pytest.approx(10)
    both = scenario((0.0, "velocity", [1.0, 0.0, 0.0]), (1.0, "velocity", [0.5, 0.0, 0.0]))
    assert measure(both, made_up(velocity=velocity))["overshoot_percent"] == pytest.approx(20)


def test_slip_current_and_energy():
    duty, current_a, slip_m_s = np.zeros((3, TICKS, 4))
    duty[:, 0], current_a[:, 0] = 0.5, 3.0
    duty[:, 1], current_a[:, 1] = 0.5, -1.0
    slip_m_s[5, 2] = -0.3
    moved = made_up(duty=duty, current_a=current_a, slip_m_s=slip_m_s)
    numbers = measure(scenario((0.0, "duty", [0.5, 0.5, 0.0, 0.0])), moved)
    assert numbers["max_slip_m_s"] == 0.3
    assert numbers["max_current_a"] == 3.0
    # 24 V (0.5 * 3 A - 0.5 * 1 A) for 2 s
    assert numbers["energy_j"] == pytest.approx(48.0)
    for name in ("peak_lateral_error_m", "remaining_lateral_error_m", "overshoot_percent"):
        assert math.isnan(numbers[name])


def test_the_paper_experiment_measures_the_same():
    case = Case("plain", 1.85, 10.0)
    own = case_scenario(case, MODEL)
    truth = simulate_truth(own)
    numbers, paper = measure(own, truth), measure_paper(case, truth)
    assert numbers["peak_lateral_error_m"] == pytest.approx(paper.peak_y_m, rel=1e-9)
    assert numbers["remaining_lateral_error_m"] == pytest.approx(paper.remaining_y_m, rel=1e-9)


def test_energy_is_what_the_robot_gets_and_what_becomes_heat():
    # From rest to a steady speed: what is drawn is more than the body's kinetic energy.
    own = replace(case_scenario(Case("plain", 1.85, 0.0), MODEL), duration_s=1.2)
    truth = simulate_truth(own)
    kinetic_j = 0.5 * MODEL.values["robot.mass_kg"] * truth["velocity"][-1, 0] ** 2
    heat_j = MODEL.values["motor.resistance_ohm"] * (truth["current_a"] ** 2).sum() / 1000
    assert measure(own, truth)["energy_j"] > kinetic_j + heat_j
