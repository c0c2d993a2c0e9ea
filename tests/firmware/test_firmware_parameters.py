"""The SI values of a model become the firmware's raw parameters; the table in C is the judge."""

import math
import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from omnislip.firmware_parameters import (
    firmware_parameters,
    kinematic_matrix,
    null_vector,
    pseudo_inverse,
)
from omnislip.link.protocol import PARAMETERS

NOMINAL = {
    "robot.mass_kg": 20.0,
    "robot.inertia_kg_m2": 0.55,
    "robot.wheel_radius_m": 0.05,
    "robot.wheel_distance_m": 0.20,
    "robot.wheel_angles_deg": [30.0, 150.0, 210.0, 330.0],
    "motor.resistance_ohm": 0.6,
    "motor.torque_constant_nm_a": 0.0255,
    "motor.back_emf_constant_v_s_rad": 0.0255,
    "motor.gear_ratio": 12.0,
    "motor.inertia_kg_m2": 2.5e-5,
    "motor.viscous_friction_nm_s": 1.5e-5,
    "motor.supply_v": 24.0,
    "contact.mu_drive": 0.6,
    "contact.mu_roller": 0.05,
    "contact.slip_stiffness_s_m": 40.0,
    "contact.gravity_m_s2": 9.81,
    "encoder.counts_per_rev": 2000,
}


def test_nominal_robot_gives_the_defaults_of_the_table():
    defaults = {name: row.default for name, row in PARAMETERS.items()}
    assert firmware_parameters(NOMINAL) == defaults


@given(
    mass=st.floats(8.0, 40.0),
    radius=st.floats(0.03, 0.08),
    distance=st.floats(0.15, 0.4),
    resistance=st.floats(0.4, 1.5),
    supply=st.floats(12.0, 48.0),
    half_angle=st.floats(20.0, 70.0),
)
def test_robots_of_this_class_fit_the_limits_of_the_table(
    mass, radius, distance, resistance, supply, half_angle
):
    changed = {
        "robot.mass_kg": mass,
        "robot.wheel_radius_m": radius,
        "robot.wheel_distance_m": distance,
        "robot.wheel_angles_deg": [half_angle, 180 - half_angle, 180 + half_angle, -half_angle],
        "robot.inertia_kg_m2": 0.5 * mass * distance**2,
        "motor.resistance_ohm": resistance,
        "motor.supply_v": supply,
    }
    assert_within_the_table(firmware_parameters(NOMINAL | changed))


def assert_within_the_table(raw: dict[str, int]) -> None:
    assert list(raw) != [] and set(raw) == set(PARAMETERS)
    for name, row in PARAMETERS.items():
        assert row.minimum <= raw[name] <= row.maximum, name


@st.composite
def robots(draw, mass_kg, wheel_radius_m, wheel_distance_m, power_w, supply_v, lines):
    """Robots of a league. Motors: no-load speed of shaft and rim, power at half of that speed 1 to
    4 times the rated power; the encoder has `lines`, four counts each."""

    def between(low, high):
        return draw(st.floats(low, high))

    mass = between(*mass_kg)
    distance, radius, supply = (
        between(*wheel_distance_m),
        between(*wheel_radius_m),
        between(*supply_v),
    )
    no_load_rad_s, no_load_m_s = between(200.0, 1200.0), between(2.0, 5.0)
    gear = max(1.0, no_load_rad_s * radius / no_load_m_s)
    half_angle = between(30.0, 60.0)
    return {
        "robot.mass_kg": mass,
        "robot.inertia_kg_m2": between(0.3, 0.7) * mass * distance**2,
        "robot.wheel_radius_m": radius,
        "robot.wheel_distance_m": distance,
        "robot.wheel_angles_deg": [half_angle, 180 - half_angle, 180 + half_angle, -half_angle],
        "motor.resistance_ohm": supply**2 / (4.0 * between(*power_w) * between(1.0, 4.0)),
        "motor.torque_constant_nm_a": supply / no_load_rad_s,
        "motor.back_emf_constant_v_s_rad": supply / no_load_rad_s,
        "motor.gear_ratio": gear,
        "motor.inertia_kg_m2": between(5e-7, 3e-5),
        "motor.viscous_friction_nm_s": between(0.0, 2e-5),
        "motor.supply_v": supply,
        "contact.mu_drive": between(0.3, 0.9),
        "contact.mu_roller": between(0.0, 0.1),
        "contact.slip_stiffness_s_m": between(10.0, 100.0),
        "contact.gravity_m_s2": 9.81,
        "encoder.counts_per_rev": 4 * draw(st.integers(*lines)),
    }


SMALL_SIZE = robots((2.0, 3.0), (0.025, 0.035), (0.07, 0.09), (12.0, 70.0), (7.0, 25.0), (64, 4096))
MIDDLE_SIZE = robots((20.0, 40.0), (0.04, 0.08), (0.15, 0.25), (50.0, 200.0), (18, 48), (64, 4096))
ANY_OF_THEM = robots((2.0, 40.0), (0.025, 0.08), (0.06, 0.3), (5.0, 200.0), (7.0, 48.0), (64, 4096))


@given(robot=st.one_of(SMALL_SIZE, MIDDLE_SIZE))
def test_robots_of_both_leagues_have_parameters(robot):
    """Within the limits that firmware/README.md states for wheel, gear and motor."""
    rim_m = robot["robot.wheel_radius_m"] / robot["motor.gear_ratio"]
    force_n_v = robot["motor.torque_constant_nm_a"] / robot["motor.resistance_ohm"] / rim_m
    drag_n_s = force_n_v * robot["motor.back_emf_constant_v_s_rad"]
    assume(0.002 < rim_m < 0.031 and 0.25 < force_n_v < 32.0 and drag_n_s < 1.9)
    assert_within_the_table(firmware_parameters(robot))


@given(robot=ANY_OF_THEM)
def test_any_robot_has_parameters_or_is_refused_by_a_key_of_its_own(robot):
    try:
        raw = firmware_parameters(robot)
    except ValueError as error:
        key, _, reason = str(error).partition(": ")
        assert all(name in robot for name in key.split(", "))
        assert reason and "\n" not in reason
    else:
        assert_within_the_table(raw)


@given(
    angles=st.lists(st.floats(0.0, 360.0), min_size=4, max_size=4),
    distance=st.floats(0.1, 0.5),
)
def test_pseudo_inverse_and_null_vector_satisfy_their_definitions(angles, distance):
    j = kinematic_matrix(angles, distance)
    try:
        n = null_vector(j)
    except ValueError:
        return
    assert math.hypot(*n) == pytest.approx(2.0)
    for column in range(3):
        assert sum(n[i] * j[i][column] for i in range(4)) == pytest.approx(0.0, abs=1e-9)
    inverse = pseudo_inverse(j)
    scale = max(abs(entry) for row in inverse for entry in row)
    for a in range(3):
        for b in range(3):
            product = sum(inverse[a][i] * j[i][b] for i in range(4))
            assert product == pytest.approx(float(a == b), abs=1e-9 * scale**2)


def test_pseudo_inverse_of_the_paper():
    a, one_over_l = 2.0 / math.sqrt(3.0), 5.0
    expected = [[-2, -2, 2, 2], [a, -a, -a, a], [one_over_l] * 4]
    found = pseudo_inverse(kinematic_matrix(NOMINAL["robot.wheel_angles_deg"], 0.2))
    for row, expected_row in zip(found, expected, strict=True):
        assert row == pytest.approx([entry / 4.0 for entry in expected_row])


def test_gains_place_both_poles_at_ten_rad_s():
    raw = firmware_parameters(NOMINAL)
    rim = 0.05 / 12.0
    volt_s_m = raw["speed_gain_q15"] / 2**15 / rim
    volt_m = raw["speed_integral_q22"] / 2**22 / rim * 1000.0
    force_per_volt = 0.0255 / 0.6 / rim
    drag = (0.0255 * 0.0255 / 0.6 + 1.5e-5) / rim**2
    mass = 20.0 + 2.5e-5 / rim**2
    assert (drag + force_per_volt * volt_s_m) / mass == pytest.approx(20.0, rel=1e-3)
    assert force_per_volt * volt_m / mass == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("robot.mass_kg", 0.0, "robot.mass_kg"),
        ("robot.mass_kg", 200.0, "robot.mass_kg"),
        ("robot.mass_kg", math.nan, "robot.mass_kg"),
        ("robot.mass_kg", None, "robot.mass_kg"),
        ("robot.inertia_kg_m2", 9.0, "robot.inertia_kg_m2"),
        ("robot.wheel_radius_m", 0.8, "robot.wheel_radius_m"),
        ("robot.wheel_angles_deg", [30.0, 150.0, 210.0], "robot.wheel_angles_deg"),
        ("robot.wheel_angles_deg", [30.0] * 4, "robot.wheel_angles_deg"),
        ("motor.supply_v", 3.0, "motor.supply_v"),
        ("motor.viscous_friction_nm_s", -1.0, "motor.viscous_friction_nm_s"),
        ("contact.slip_stiffness_s_m", 2.0, "contact.slip_stiffness_s_m"),
        ("encoder.counts_per_rev", 4, "encoder.counts_per_rev"),
    ],
)
def test_what_does_not_fit_is_refused_by_key(key, value, named):
    with pytest.raises(ValueError, match=rf"^{re.escape(named)}[,:]"):
        firmware_parameters(NOMINAL | {key: value})


def test_a_missing_key_is_named():
    values = {key: value for key, value in NOMINAL.items() if key != "motor.gear_ratio"}
    with pytest.raises(ValueError, match=r"^motor\.gear_ratio:"):
        firmware_parameters(values)
