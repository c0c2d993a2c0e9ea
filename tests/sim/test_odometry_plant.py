"""The odometry plant against closed forms: geometry, effects on it, clocks."""

import numpy as np
import pytest
from engine_run import parameter_set, simulate
from hypothesis import given
from hypothesis import strategies as st
from omnislip import _core

RADIUS_M, DISTANCE_M = 0.05, 0.2
OMNI4 = [30.0, 150.0, 210.0, 330.0]
STEP_S = 0.1


def base(angles_deg=OMNI4, roller_deg=0.0):
    """Base values of a robot with these wheels; the others are not there."""
    angles = [*angles_deg, *[np.nan] * (8 - len(angles_deg))]
    named = {f"odometry.wheel_angles_deg[{i}]": angle for i, angle in enumerate(angles)}
    named |= {
        "odometry.wheel_radius_m": RADIUS_M,
        "odometry.wheel_distance_m": DISTANCE_M,
        "odometry.roller_angle_deg": roller_deg,
    }
    return named


def jacobian(angles_deg):
    """J of eq. (3): body velocity to rim speeds."""
    g = np.deg2rad(angles_deg)
    return np.stack([-np.sin(g), np.cos(g), np.full(len(g), DISTANCE_M)], axis=1)


def rates_of(velocity, angles_deg=OMNI4):
    """Encoder rates (8,) of a body velocity (vx, vy, w) without slip."""
    rates = np.zeros(8)
    rates[: len(angles_deg)] = jacobian(angles_deg) @ velocity / RADIUS_M
    return rates


def drive(rates, effects=(), seconds=4.0, first=(0.0, 0.0, 0.0), **geometry):
    """Pose (rows, 3) shown while the encoders turn with `rates`, (8,) or (rows, 8).

    The camera shows the robot at `first` when it begins.
    """
    t_s = np.arange(0.0, seconds + STEP_S / 2, STEP_S)
    command = np.broadcast_to(rates, (len(t_s), 8))
    sets = [parameter_set("odometry", base(**geometry), effects)]
    return t_s, simulate(sets, t_s, command, first, kind="odometry")[0]


def arc(velocity, t_s):
    """Pose on the circle of a constant body velocity."""
    vx, vy, w = velocity
    turn = np.exp(1j * w * t_s)
    place = (vx + 1j * vy) * ((turn - 1) / (1j * w) if w else t_s)
    return np.stack([place.real, place.imag, w * t_s], axis=1)


@pytest.mark.parametrize("angles", [OMNI4, [300.0, 60.0, 180.0], [0.0, 72.0, 144.0, 216.0, 288.0]])
@pytest.mark.parametrize("velocity", [(0.3, 0.0, 0.0), (0.0, 0.2, 0.0), (0.2, -0.1, 0.5)])
def test_any_number_of_wheels_follows_the_circle(angles, velocity):
    t_s, pose = drive(rates_of(velocity, angles), angles_deg=angles)
    np.testing.assert_allclose(pose, arc(velocity, t_s), atol=2e-7)


@given(st.lists(st.floats(-20.0, 20.0), min_size=4, max_size=4))
def test_wheels_that_disagree_move_the_body_by_least_squares(rates):
    padded = np.array([*rates, 0.0, 0.0, 0.0, 0.0])
    values = parameter_set("odometry", base())
    engine = _core.Engine("odometry")
    found = engine.derivatives(values, np.zeros((1, 3)), padded[None])[0]
    expected = np.linalg.pinv(jacobian(OMNI4)) @ np.array(rates) * RADIUS_M
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("angles", [[90.0, 270.0], [300.0, 120.0], [90.0, 90.0, 270.0, 270.0]])
def test_parallel_wheels_do_not_move_along_their_axle(angles):
    """Two wheels or two tracks: forward by the mean of the sides, turning by their difference."""
    ahead = np.exp(1j * (np.deg2rad(angles[0]) - np.pi / 2))
    t_s, pose = drive(
        rates_of((0.3 * ahead.real, 0.3 * ahead.imag, 0.5), angles), angles_deg=angles
    )
    expected = arc((0.3 * ahead.real, 0.3 * ahead.imag, 0.5), t_s)
    np.testing.assert_allclose(pose, expected, atol=2e-7)


def test_mecanum_wheel_pushes_with_the_cosine_of_its_roller_angle():
    velocity = np.array([0.2, 0.1, 0.3])
    t_s, pose = drive(rates_of(velocity) / np.cos(np.pi / 4), roller_deg=45.0)
    np.testing.assert_allclose(pose, arc(velocity, t_s), atol=2e-7)


def test_lateral_slip_and_turning_loss_shorten_their_motion_only():
    effects = [("lateral_slip", "fraction", 0.1), ("turning_loss", "fraction", 0.2)]
    t_s, pose = drive(rates_of((0.2, 0.1, 0.5)), effects)
    np.testing.assert_allclose(pose, arc((0.2, 0.09, 0.4), t_s), atol=2e-7)


def test_radius_and_encoder_scale_are_the_same_thing_the_other_way_round():
    _, larger = drive(rates_of((0.2, 0.1, 0.5)), [("wheel_radius_error", "scale", 1.25, 2)])
    _, fewer = drive(rates_of((0.2, 0.1, 0.5)), [("encoder_scale", "scale", 0.8, 2)])
    np.testing.assert_allclose(larger, fewer, atol=1e-12)


def test_distance_error_scales_the_turn_inversely():
    t_s, pose = drive(rates_of((0.0, 0.0, 0.5)), [("wheel_distance_error", "scale", 1.25)])
    np.testing.assert_allclose(pose[:, 2], 0.4 * t_s, atol=1e-12)


def test_marker_and_heading_offset_are_rigid():
    effects = [("marker_offset", "x_m", 0.03), ("marker_offset", "y_m", -0.02)]
    effects.append(("heading_offset", "angle_rad", 0.1))
    t_s, pose = drive(rates_of((0.2, 0.1, 0.5)), effects, first=(0.03, -0.02, 0.1))
    true = arc((0.2, 0.1, 0.5), t_s)
    marker = (0.03 - 0.02j) * np.exp(1j * true[:, 2])
    np.testing.assert_allclose(pose[:, 0], true[:, 0] + marker.real, atol=2e-7)
    np.testing.assert_allclose(pose[:, 1], true[:, 1] + marker.imag, atol=2e-7)
    np.testing.assert_allclose(pose[:, 2], true[:, 2] + 0.1, atol=1e-12)


@given(*[st.floats(-2.0, 2.0)] * 3, *[st.floats(-0.2, 0.2)] * 3)
def test_a_camera_that_is_turned_is_a_robot_that_is_turned_the_other_way(x, y, theta, a, mx, my):
    """A log begins where the camera shows the robot, and none tells which of the two it is."""
    marker = [("marker_offset", "x_m", mx), ("marker_offset", "y_m", my)]
    one, other = (
        drive(rates_of((0.2, 0.1, 0.5)), [*marker, (name, "angle_rad", size)], 0.5, (x, y, theta))
        for name, size in (("pose_rotation", a), ("heading_offset", -a))
    )
    np.testing.assert_allclose(one[1][0], [x, y, theta], atol=1e-12)
    np.testing.assert_allclose(one[1], other[1], atol=1e-9)


@pytest.mark.parametrize("delay_s", [0.3, -0.04])
def test_latency_shows_the_pose_of_another_moment_also_while_the_motion_changes(delay_s):
    rng = np.random.default_rng(3)
    rates = np.repeat(rng.uniform(-5.0, 5.0, (9, 4)), 5, axis=0)[:41]
    rates = np.concatenate([rates, np.zeros((41, 4))], axis=1)
    rates[:5] = rates[-5:] = 0.0  # at rest where the delay looks beyond the log
    t_s, prompt = drive(rates)
    _, late = drive(rates, [("pose_latency", "delay_s", delay_s)])
    for channel in range(3):
        # The heading is piecewise linear, the place nearly: arcs of 0.1 s.
        shifted = np.interp(t_s - delay_s, t_s, prompt[:, channel])
        np.testing.assert_allclose(late[:, channel], shifted, atol=2e-3)
    heading = np.interp(t_s - delay_s, t_s, prompt[:, 2])
    np.testing.assert_allclose(late[:, 2], heading, atol=1e-9)


def test_skewed_clock_shows_the_pose_of_an_ever_earlier_moment():
    t_s, pose = drive(rates_of((0.2, 0.1, 0.5)), [("clock_skew", "fraction", 0.02)])
    np.testing.assert_allclose(pose, arc((0.2, 0.1, 0.5), 0.98 * t_s), atol=2e-7)


def test_camera_turned_against_the_world():
    t_s, pose = drive(rates_of((0.2, 0.1, 0.5)), [("pose_rotation", "angle_rad", 0.3)])
    true = arc((0.2, 0.1, 0.5), t_s)
    place = (true[:, 0] + 1j * true[:, 1]) * np.exp(0.3j)
    np.testing.assert_allclose(pose[:, 0] + 1j * pose[:, 1], place, atol=2e-7)


def with_lost_counts(lost, speed_rad_s, rates, angles_deg=OMNI4):
    """Body velocity where the first wheel's encoder shows `rates[0]`, less above a speed."""
    effects = [("encoder_dropout", "fraction", lost, 1)]
    effects += [("encoder_dropout", "speed_rad_s", speed_rad_s, 1)]
    values = parameter_set("odometry", base(angles_deg), effects)
    padded = np.concatenate([rates, np.zeros(8 - len(rates))])
    return _core.Engine("odometry").derivatives(values, np.zeros((1, 3)), padded[None])[0]


@given(
    st.floats(0.05, 0.6),
    st.floats(2.0, 9.0),
    st.floats(0.3, 2.0).filter(lambda share: abs(share - 1) > 1e-6),
    st.sampled_from([-1.0, 1.0]),
)
def test_lost_counts_are_given_back_where_the_other_wheels_miss_them(
    lost, speed_rad_s, share, direction
):
    """At any speed: one above the threshold shows what one below it shows that loses none."""
    velocity = np.array([0.2, -0.1, 0.3])
    velocity *= direction * share * speed_rad_s / rates_of(velocity)[0]
    rates = rates_of(velocity)[:4]
    if share > 1:
        rates[0] *= 1 - lost
    np.testing.assert_allclose(with_lost_counts(lost, speed_rad_s, rates), velocity, atol=1e-9)


@pytest.mark.parametrize("share, lost", [(0.6, False), (0.8, False), (0.95, True), (1.2, True)])
def test_three_wheels_do_not_tell_so_the_rates_are_parted_in_the_middle(share, lost):
    """20 % lost above 5 rad/s: 4 to 5 rad/s are shown on both sides of it, 4.5 amid them."""
    angles = [300.0, 60.0, 180.0]
    rates = np.array([5.0 * share, 1.0, -2.0])
    true = rates / [0.8 if lost else 1.0, 1.0, 1.0]
    expected = np.linalg.solve(jacobian(angles), true * RADIUS_M)
    found = with_lost_counts(0.2, 5.0, rates, angles)
    np.testing.assert_allclose(found, expected, atol=1e-12)
