"""The far end of the parameter formats in closed loop: a robot of the small-size league.

2.4 kg on wheels of 27 mm with a grip of 3.5 N each, an eighth of the nominal robot's, driven by
motors of 50 W.
"""

import dataclasses

import numpy as np
import pytest
from omnislip import _core
from omnislip.gains import gains
from omnislip.model_file import NOMINAL_ROBOT, read_model

ROBOT = dataclasses.replace(
    read_model(NOMINAL_ROBOT),
    values={
        "robot.mass_kg": 2.4,
        "robot.inertia_kg_m2": 0.0087,
        "robot.wheel_radius_m": 0.027,
        "robot.wheel_distance_m": 0.08,
        "robot.wheel_angles_deg": [33.0, 147.0, 225.0, 315.0],
        "motor.resistance_ohm": 1.03,
        "motor.torque_constant_nm_a": 0.0335,
        "motor.back_emf_constant_v_s_rad": 0.0335,
        "motor.gear_ratio": 3.6,
        "motor.inertia_kg_m2": 1.35e-5,
        "motor.viscous_friction_nm_s": 3e-6,
        "motor.supply_v": 22.2,
        "contact.mu_drive": 0.6,
        "contact.mu_roller": 0.05,
        "contact.slip_stiffness_s_m": 40.0,
        "contact.gravity_m_s2": 9.81,
        "encoder.counts_per_rev": 1440,
    },
)
PLAIN, SLIP = 0, 1


def run(commands, duration_s, slip_compensation, impulses=()):
    """1 kHz arrays of the closed loop; commands are (t_s, vx, vy, omega) in the body frame."""
    firmware = gains(ROBOT).raw | {"slip_compensation": slip_compensation}
    given = [
        {"t_s": t_s, "kind": "velocity", "value": list(velocity)} for t_s, *velocity in commands
    ]
    plant = ROBOT.to_core()[0]
    return _core.simulate(plant, [], firmware, given, list(impulses), duration_s)


def lost_mm(truth) -> float:
    """How far belief is from truth at the end."""
    return 1e3 * float(np.hypot(*(truth["odometry"] - truth["pose"])[-1, :2]))


def test_it_drives_as_told_and_knows_where_it_is():
    way = [(0.0, 1.5, 0.0, 0.0), (2.0, 0.0, 1.0, 3.0), (3.5, 0.0, 0.0, 0.0)]
    truth = run(way, 5.0, SLIP)
    assert not truth["fault"].any()
    assert truth["velocity"][1900] == pytest.approx([1.5, 0.0, 0.0], abs=0.01)
    assert truth["velocity"][3400, 2] == pytest.approx(3.0, abs=0.03)
    assert truth["velocity"][-1] == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)
    assert lost_mm(truth) < lost_mm(run(way, 5.0, PLAIN)) / 3.0


def test_a_blow_leaves_it_a_third_of_the_way_off_course():
    way = [(0.0, 1.5, 0.0, 0.0)]
    blow = {"x_m": 2.35, "impulse_x_n_s": 0.0, "impulse_y_n_s": 0.5, "impulse_theta_n_m_s": 0.0}
    remaining_m = []
    for controller in (PLAIN, SLIP):
        calm, hit = run(way, 4.0, controller), run(way, 4.0, controller, [blow])
        remaining_m.append(abs(hit["pose"][-1, 1] - calm["pose"][-1, 1]))
    assert remaining_m[SLIP] < remaining_m[PLAIN] / 3.0
