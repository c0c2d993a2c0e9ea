"""The firmware drives the plant: what it believes, what the encoders say, what the robot does.

Bounds come from three numbers: one count is 13 um of rim, the firmware sees speeds in steps of
0.13 mm/s, and 2.5 ms late (middle of its speed window). So dead reckoning of a run of T s at v m/s
may lag 2.5 ms v and drift 0.065 mm/s T; each is used with a factor of 2.
"""

import numpy as np
import pytest
from loop_run import (
    CONTROLLERS,
    FAULT_UNDER_VOLTAGE,
    LIMIT_ACCELERATION,
    LIMIT_NONE,
    LIMIT_TRACTION,
    LIMIT_VOLTAGE,
    RAD_PER_COUNT,
    RIM_PER_SHAFT_M,
    blow,
    command,
    effect,
    rolled,
    run,
    shaft_angles_rad,
    steady_speed_without_slip_model,
    to_body,
    unwrapped,
)

DIRECTIONS = {
    f"{45 * k} deg": np.array([np.cos(k * np.pi / 4), np.sin(k * np.pi / 4)]) for k in range(8)
}
DRIVE_TIME_S = 3.0


def dead_reckoning_bound_m(speed_m_s, duration_s):
    return 2 * (2.5e-3 * speed_m_s + 0.065e-3 * duration_s)


def assert_encoders_show_the_shafts(truth):
    """Counts are the shaft's angle rounded down: behind by 0 to 1.

    The trapezoidal rule adds h^2 / 12 times the change of acceleration: 0.4 counts in a start at
    0.3 of the supply, 12000 rad/s2.
    """
    behind = shaft_angles_rad(truth) / RAD_PER_COUNT - unwrapped(truth["encoder_counts"])
    assert behind.min() > -0.4 and behind.max() < 1.4
    assert behind.max() > 0.5  # counts that were exact would not be counts


# ---- velocity ----


def drive(direction, controller):
    return run([command("velocity", *direction, 0.0)], DRIVE_TIME_S, controller)


@pytest.mark.parametrize("name", DIRECTIONS)
def test_slip_model_reaches_the_speed_and_knows_its_place(name):
    """Command, belief, encoders and plant agree in all eight directions."""
    direction = DIRECTIONS[name]
    truth = drive(direction, "slip")
    speed = truth["velocity"][-200:, :2].mean(axis=0)
    lost = np.linalg.norm(truth["odometry"][-1, :2] - truth["pose"][-1, :2])
    np.testing.assert_allclose(speed, direction, atol=1e-3)
    assert 1e-6 < lost < dead_reckoning_bound_m(1.0, DRIVE_TIME_S)
    assert np.abs(truth["pose"][:, 2]).max() < 1e-3
    assert_encoders_show_the_shafts(truth)


@pytest.mark.parametrize("name", DIRECTIONS)
def test_without_slip_model_belief_follows_the_encoders_and_both_miss_the_slip(name):
    """The rims reach the command; the body lacks what the rollers' friction costs, eq. (13)."""
    direction = DIRECTIONS[name]
    truth = drive(direction, "plain")
    bound = dead_reckoning_bound_m(1.0, DRIVE_TIME_S)
    believed, seen, done = truth["odometry"][-1], rolled(truth)[-1], to_body(truth["pose"])[-1]
    np.testing.assert_allclose(believed[:2], seen[:2], atol=bound)
    speed = truth["velocity"][-200:, :2].mean(axis=0)
    expected = steady_speed_without_slip_model(direction, 1.0)
    np.testing.assert_allclose(speed, expected, atol=5e-4)
    # Slip while accelerating comes on top of the steady one.
    lack = seen[:2] @ direction - done[:2] @ direction
    steady = (1.0 - expected @ direction) * DRIVE_TIME_S
    assert 0.7 * steady < lack < 0.05 + steady
    assert_encoders_show_the_shafts(truth)


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("rate", [5.0, -5.0])
def test_spin_turns_on_the_spot(controller, rate):
    truth = run([command("velocity", 0.0, 0.0, rate)], DRIVE_TIME_S, controller)
    turned = truth["pose"][-1, 2]
    believed = truth["odometry"][-1, 2]
    rim_m_s = abs(rate) * 0.2
    assert truth["velocity"][-200:, 2].mean() == pytest.approx(rate, rel=1e-3)
    assert np.abs(np.remainder(believed - turned + np.pi, 2 * np.pi) - np.pi) < (
        dead_reckoning_bound_m(rim_m_s, DRIVE_TIME_S) / 0.2
    )
    assert rolled(truth)[-1, 2] == pytest.approx(turned, rel=0.01)
    assert np.abs(truth["pose"][:, :2]).max() < 1e-3
    assert_encoders_show_the_shafts(truth)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_step_to_1500_mm_s(controller):
    """Overshoot under 5 %; never faster than the grip allows; steady error as derived."""
    truth = run([command("velocity", 1.5, 0.0, 0.0)], DRIVE_TIME_S, controller)
    speed = truth["velocity"][:, 0]
    expected = {
        "plain": steady_speed_without_slip_model(np.array([1.0, 0.0]), 1.5)[0],
        "slip": 1.5,
    }[controller]
    assert -0.02 < speed.max() / 1.5 - 1 < 0.05
    assert speed[-200:].mean() == pytest.approx(expected, abs=1e-3)
    # Along x the four wheels give at most 4 mu N sin 30 = 0.3 g.
    assert np.diff(speed).max() * 1e3 < 0.3 * 9.81
    ninety_percent_s = np.argmax(speed > 1.35) * 1e-3
    assert 1.35 / (0.3 * 9.81) < ninety_percent_s < 1.2


# ---- pose ----

GOALS = {"ahead": (1.0, 0.5, 0.5), "back and turned": (-0.7, 1.2, -1.5), "turn": (0.0, 0.0, 3.0)}


@pytest.mark.parametrize("goal", GOALS)
def test_pose_is_reached_at_rest_with_the_slip_model(goal):
    truth = run([command("pose", *GOALS[goal], 0.0, 0.0, 0.0)], 4.0)
    path_m = np.hypot(*GOALS[goal][:2])
    miss = np.abs(truth["pose"][-1] - GOALS[goal])
    belief = np.abs(truth["odometry"][-1] - GOALS[goal])
    assert belief.max() < 1e-3
    assert miss[:2].max() < dead_reckoning_bound_m(path_m / 4.0, 4.0)
    assert miss[2] < dead_reckoning_bound_m(path_m / 4.0, 4.0) / 0.2
    assert np.abs(truth["velocity"][-1]).max() < 2e-3
    assert_encoders_show_the_shafts(truth)


def test_pose_without_slip_model_is_reached_in_belief_only():
    """Belief and encoders are at the goal, the robot is short of it by the slip it cannot see."""
    goal = np.array(GOALS["ahead"])
    truth = run([command("pose", *goal, 0.0, 0.0, 0.0)], 4.0, "plain")
    assert np.abs(truth["odometry"][-1] - goal).max() < 1e-3
    short = goal[:2] - truth["pose"][-1, :2]
    # Steady slip costs 1.1 % of the way along x; the start and the braking cost about the same.
    assert 0.011 < short[0] / goal[0] < 0.05


# ---- duty, stop, supply ----


def test_duty_command_reaches_the_motors_as_it_is():
    wanted = np.array([0.1, -0.2, 0.3, 0.05])
    truth = run([command("duty", *wanted)], 1.0)
    np.testing.assert_allclose(truth["duty"], np.tile(wanted, (1000, 1)), atol=0.6 / 2**15)
    assert set(truth["limited"]) == {LIMIT_NONE}
    assert_encoders_show_the_shafts(truth)


def test_equal_duty_spins_at_the_speed_of_the_motor_equation():
    """Steady state of eq. (7), (8) on the spot: the rollers slide, k2 i = b0 W + (R/n) F(slip)."""
    truth = run([command("duty", 0.2, 0.2, 0.2, 0.2)], 3.0)
    shaft = truth["wheel_speed_rad_s"][-1]
    torque = 0.0255 * truth["current_a"][-1]
    load = 1.5e-5 * shaft + RIM_PER_SHAFT_M * truth["drive_force_n"][-1]
    np.testing.assert_allclose(torque, load, rtol=1e-3)
    np.testing.assert_allclose(0.6 * truth["current_a"][-1] + 0.0255 * shaft, 0.2 * 24.0, rtol=1e-3)
    np.testing.assert_allclose(
        truth["velocity"][-1, 2] * 0.2, RIM_PER_SHAFT_M * shaft - truth["slip_m_s"][-1], rtol=1e-6
    )


def test_no_command_means_no_duty():
    truth = run([], 0.2)
    assert not truth["duty"].any()
    assert not truth["pose"].any()
    assert not truth["encoder_counts"].any()


def test_stop_takes_the_duty_away_in_the_same_tick():
    truth = run([command("velocity", 1.0, 0.0, 0.0), command("stop", t_s=1.0)], 2.0)
    assert np.abs(truth["duty"][999]).max() > 0.1
    assert not truth["duty"][1000:].any()
    assert 0 < truth["velocity"][-1, 0] < truth["velocity"][1000, 0]


def test_supply_below_its_minimum_takes_the_duty_away():
    truth = run([command("duty", 0.3, 0.3, 0.3, 0.3)], 0.2, parameters={"motor.supply_v": 11.0})
    assert set(truth["fault"]) == {FAULT_UNDER_VOLTAGE}
    assert not truth["duty"].any()


def test_supply_sags_by_its_current():
    """V0 - V = r sum(i d), in every tick, and the loop still reaches its speed."""
    sag = effect("supply_sag", source_resistance_ohm=0.12)
    truth = run([command("velocity", 1.5, 0.0, 0.0)], 2.0, effects=[sag])
    drawn = (truth["current_a"] * truth["duty"]).sum(axis=1)
    np.testing.assert_allclose(24.0 - truth["supply_v"], 0.12 * drawn, atol=1e-9)
    assert 0.2 < 24.0 - truth["supply_v"].min() < 5.0
    assert truth["velocity"][-200:, 0].mean() == pytest.approx(1.5, rel=5e-3)


# ---- limits have names ----


def test_a_ramp_at_the_acceleration_limit_is_named():
    truth = run([command("velocity", 1.0, 0.0, 0.0)], 1.5)
    assert set(truth["limited"][:600]) == {LIMIT_ACCELERATION}
    assert set(truth["limited"][-500:]) == {LIMIT_NONE}


def test_turning_while_driving_beyond_the_grip_is_named():
    """2 m/s forward at 5 rad/s needs v w = 10 m/s2; the floor gives 0.6 g at best."""
    truth = run([command("velocity", 2.0, 0.0, 5.0)], 2.0)
    assert LIMIT_TRACTION in truth["limited"]
    assert np.linalg.norm(truth["velocity"][-1, :2]) < 0.6 * 9.81 / 5.0
    assert truth["velocity"][-1, 2] == pytest.approx(5.0, rel=1e-2)
    assert np.abs(truth["drive_force_n"]).max() <= 0.6 * 20 * 9.81 / 4


def test_speed_beyond_the_supply_is_named():
    truth = run([command("velocity", 0.0, 2.3, 0.0)], 2.0, parameters={"motor.supply_v": 13.0})
    assert LIMIT_VOLTAGE in truth["limited"]
    assert np.abs(truth["duty"]).max() == pytest.approx(1.0, abs=1e-4)


# ---- a blow moves the plant by its impulse, and the firmware sees only part of it ----


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_blow_changes_the_velocity_by_impulse_over_mass(controller):
    truth = run([command("velocity", 1.0, 0.0, 0.0)], 2.0, controller, impulses=[blow(1.5, 10.0)])
    # The tick's record is after the jump, before the millisecond of friction.
    assert truth["velocity"][1500, 1] - truth["velocity"][1499, 1] == pytest.approx(0.5, abs=1e-3)
    assert truth["pose"][1500, 1] == pytest.approx(truth["pose"][1499, 1], abs=1e-5)
    assert np.diff(unwrapped(truth["encoder_counts"])[1499:1501], axis=0).max() < 200
