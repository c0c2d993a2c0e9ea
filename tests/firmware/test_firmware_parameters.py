"""The SI values of a model become the firmware's raw parameters; the table in C is the judge."""

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.firmware_parameters import (
    firmware_parameters,
    kinematic_matrix,
    null_vector,
    pseudo_inverse,
    q_bits,
)

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
TABLE_LINE = re.compile(r"PARAMETER\((\w+), [^,]+, (\d+), (-?\d+), (-?\d+), (-?\d+), \"[^\"]+\"\)")


def table() -> dict[str, tuple[int, int, int, int]]:
    """Name -> (q_bits, minimum, maximum, default) of firmware/parameters.def."""
    text = (Path(__file__).parents[2] / "firmware" / "parameters.def").read_text()
    rows = TABLE_LINE.findall(text)
    assert len(rows) == text.count("\nPARAMETER(")
    return {name: tuple(int(number) for number in numbers) for name, *numbers in rows}


def test_nominal_robot_gives_the_defaults_of_the_table():
    defaults = {name: row[3] for name, row in table().items()}
    assert firmware_parameters(NOMINAL) == defaults


def test_q_bits_of_the_names_are_those_of_the_table():
    assert all(q_bits(name) == row[0] for name, row in table().items())


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
    raw = firmware_parameters(NOMINAL | changed)
    for name, (_, minimum, maximum, _) in table().items():
        assert minimum <= raw[name] <= maximum, name


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
        ("motor.supply_v", 5.0, "motor.supply_v"),
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
