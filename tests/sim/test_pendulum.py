"""The pendulum of an axis: energy while the drive is off, load of the gear, zero of the reading."""

import numpy as np
import pytest
from engine_run import parameter_set, simulate
from omnislip import _core

BASE = {
    "axis.inertia": 0.006,
    "axis.input_gain": 0.1,
    "axis.back_emf": 0.04,
    "axis.pendulum_mass_kg": 0.5,
    "axis.pendulum_length_m": 0.1,
    "axis.friction_speed": 0.05,
}
WEIGHT_NM = 0.5 * 0.1 * 9.81


def acceleration(position, speed, command, effects=()):
    values = parameter_set("axis", BASE, effects)
    states = np.array([[speed, position]])
    return _core.Engine("axis").derivatives(values, states, np.array([[command]]))[0, 0]


def test_a_blank_command_means_no_current_and_so_no_brake():
    driven, off = acceleration(0.3, 2.0, 0.0), acceleration(0.3, 2.0, np.nan)
    assert off == pytest.approx(-WEIGHT_NM * np.sin(0.3) / 0.006)
    assert driven == pytest.approx(off - 0.04 * 2.0 / 0.006)


def test_energy_stays_while_the_drive_is_off():
    t_s = np.arange(0.0, 3.0, 0.005)
    off = np.full((len(t_s), 1), np.nan)
    angle = simulate([parameter_set("axis", BASE)], t_s, off, [0.0, 1.0], "axis")[0][:, 0]
    speed = np.gradient(angle, t_s)
    energy = 0.003 * speed**2 - WEIGHT_NM * np.cos(angle)
    assert np.ptp(energy[2:-2]) < 2e-3 * np.ptp(np.cos(angle)) * WEIGHT_NM
    assert angle.max() == pytest.approx(1.0, abs=1e-4)


def test_a_drive_that_is_off_is_so_in_every_lane_and_row():
    t_s = np.arange(0.0, 1.0, 0.005)
    command = np.where(t_s < 0.5, 2.0, np.nan)[:, None]
    sets = [parameter_set("axis", BASE | {"axis.back_emf": e}) for e in (0.0, 0.02, 0.04)]
    together = simulate(np.stack(sets), t_s, command, kind="axis")
    alone = [simulate([one], t_s, command, kind="axis")[0] for one in sets]
    np.testing.assert_allclose(together, np.stack(alone), atol=1e-12)


def test_a_payload_hangs_at_the_end_of_the_pendulum():
    payload = [("payload", "mass_kg", 0.25)]
    inertia = 0.006 + 0.25 * 0.1**2
    assert acceleration(0.3, 0.0, 0.0, payload) == pytest.approx(
        -1.5 * WEIGHT_NM * np.sin(0.3) / inertia
    )


def test_load_dependent_friction_feels_the_weight_while_the_motor_gives_nothing():
    friction = [("load_dependent_friction", "coefficient", 0.2)]
    without, loaded = acceleration(0.5, 1.0, np.nan), acceleration(0.5, 1.0, np.nan, friction)
    weight = WEIGHT_NM * np.sin(0.5)
    assert 0.006 * (loaded - without) == pytest.approx(-0.2 * weight)


def test_load_dependent_friction_feels_the_motor_where_it_is_stronger_than_the_weight():
    friction = [("load_dependent_friction", "coefficient", 0.2)]
    without, loaded = acceleration(0.0, 1.0, 5.0), acceleration(0.0, 1.0, 5.0, friction)
    assert 0.006 * (loaded - without) == pytest.approx(-0.2 * (0.5 - 0.04))


def test_pendulum_hangs_where_its_zero_is():
    zero = [("pendulum_zero_error", "angle_rad", 0.03)]
    assert acceleration(0.03, 0.0, 0.0, zero) == pytest.approx(0.0, abs=1e-12)
    assert acceleration(0.0, 0.0, 0.0, zero) > 0.0


def test_current_limit_of_an_axis_is_a_torque():
    limit = [("current_limit", "limit_a", 0.3)]
    assert acceleration(0.0, 0.0, 7.0, limit) == pytest.approx(0.3 / 0.006)
    assert acceleration(0.0, 0.0, -7.0, limit) == pytest.approx(-0.3 / 0.006)
    assert acceleration(0.0, 0.0, 2.0, limit) == pytest.approx(0.2 / 0.006)
