"""The plant beside MuJoCo, whose friction is Coulomb's: what both must show, and how much.

The plant's contact is made steep (slip_stiffness_s_m): its creep is what MuJoCo has not.
"""

import numpy as np
import pytest
from engine_run import parameter_set, simulate
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.mujoco_robot import MujocoRobot

GRAVITY_M_S2 = 9.81
STEEP = {"contact.slip_stiffness_s_m": 4000.0}
LOCKED = {"motor.inertia_kg_m2": 10.0}
DIRECTIONS = {
    "ahead": [-1.0, -1.0, 1.0, 1.0],
    "left": [1.0, -1.0, -1.0, 1.0],
    "turn": [1.0, 1.0, 1.0, 1.0],
    "all at once": [0.2, -0.6, 0.4, 1.0],
}


def mujoco_robot(base=None, step_s=2.5e-4):
    parameters, _ = read_model(NOMINAL_ROBOT).to_core()
    return MujocoRobot(parameters | (base or {}), step_s)


def plant_outputs(duty, duration_s, base=None, velocity=(0.0, 0.0)):
    """Outputs of the plant at 10 ms rows: shaft angles, turn rate, pose."""
    time = np.arange(0.0, duration_s + 5e-3, 0.01)
    initial = np.zeros(14)
    initial[8:10] = velocity
    return simulate([parameter_set(base=base)], time, np.tile(duty, (len(time), 1)), initial)[0]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_both_go_the_same_way_and_end_at_the_same_speed(direction):
    """Steady speed under a duty that the grip bears. While rollers slide, MuJoCo's soft contacts
    let go for instants: its rims creep by 12 mm/s, up to 24 mm/s of the body."""
    duty = 0.1 * np.array(DIRECTIONS[direction])
    other = mujoco_robot()
    other.drive(duty, 0.5)
    early = other.pose()
    other.drive(duty, 3.5)
    plant = plant_outputs(duty, 4.0, STEEP)
    speed = np.linalg.norm(plant[-1, 5:7] - plant[-2, 5:7]) / 0.01
    assert np.linalg.norm(other.velocity()[:2]) == pytest.approx(speed, abs=0.03)
    assert other.velocity()[2] == pytest.approx(plant[-1, 4], abs=0.03 / 0.20)
    assert np.linalg.norm(early[:2] - plant[50, 5:7]) < 0.03 * 0.5
    assert np.linalg.norm(plant[50, 5:7]) > 0.05 or direction == "turn"


@pytest.mark.parametrize("mu", [0.2, 0.6])
def test_both_slide_with_the_deceleration_of_the_grip(mu):
    """Wheels locked, rollers almost free: mu g / 2 ahead, mu g sqrt(3) / 2 to the side."""
    base = {"contact.mu_drive": mu, "contact.mu_roller": 1e-3, **LOCKED}
    for velocity, share in (((2.0, 0.0), 0.5), ((0.0, 2.0), np.sqrt(0.75))):
        other = mujoco_robot(base)
        other.drive(np.zeros(4), 0.1)
        other.move(velocity)
        other.drive(np.zeros(4), 0.05)
        before = other.velocity()
        other.drive(np.zeros(4), 0.1)
        lost = np.linalg.norm(before[:2] - other.velocity()[:2]) / 0.1
        y = plant_outputs(np.zeros(4), 0.2, base | STEEP, velocity)[:, 5:7]
        own = np.linalg.norm(y[5] - 2.0 * y[10] + y[15]) / 0.05**2
        assert lost == pytest.approx(mu * GRAVITY_M_S2 * share, rel=0.02)
        assert own == pytest.approx(mu * GRAVITY_M_S2 * share, rel=0.02)


def slip_after(duty, base):
    """Rim speed less hub speed of wheel 4 [m/s] after 0.1 s ahead: (MuJoCo, plant)."""
    direction = np.array(DIRECTIONS["ahead"])
    other = mujoco_robot(base)
    other.drive(np.zeros(4), 0.1)
    other.drive(duty * direction, 0.1)
    y = plant_outputs(duty * direction, 0.1, base)
    rim = (y[-1, 3] - y[-2, 3]) / 0.01 * 0.05 / 12.0
    hub = 0.5 * (y[-1, 5] - y[-2, 5]) / 0.01
    return (
        other.shaft_speed_rad_s()[3] * 0.05 / 12.0 - 0.5 * other.velocity()[0],
        rim - hub,
    )


def test_both_begin_to_slip_where_the_motor_exceeds_the_grip():
    """From rest a motor pushes n k2 V d / (R Ra) = 244.8 d N; less what turns its rotor, 29.4 N of
    grip are exceeded at d = 0.129. Below that MuJoCo's soft contact creeps by 2 cm/s."""
    creeping = slip_after(0.10, STEEP)
    slipping = slip_after(0.17, STEEP)
    assert np.abs(creeping).max() < 0.03
    assert min(slipping) > 0.06
    assert slipping[0] == pytest.approx(slipping[1], abs=0.02)
