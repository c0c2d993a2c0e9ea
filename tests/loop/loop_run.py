"""The firmware in closed loop with the plant, as the tests call it; and closed forms beside it.

Nominal robot of omnislip.model_file.NOMINAL_ROBOT. Commands are omnislip._core.simulate's.
"""

import numpy as np
from omnislip import _core
from omnislip.firmware_parameters import firmware_parameters
from omnislip.model_file import NOMINAL_ROBOT, read_model

MODEL = read_model(NOMINAL_ROBOT)
VALUES = MODEL.values
PARAMETERS = MODEL.to_core()[0]
FIRMWARE = firmware_parameters(VALUES)

LIMIT_NONE, LIMIT_ACCELERATION, LIMIT_TRACTION, LIMIT_VOLTAGE = 0, 2, 3, 4
FAULT_NONE, FAULT_UNDER_VOLTAGE = 0, 2
CONTROLLERS = {"plain": 0, "slip": 1}
RIM_PER_SHAFT_M = VALUES["robot.wheel_radius_m"] / VALUES["motor.gear_ratio"]
RAD_PER_COUNT = 2 * np.pi / VALUES["encoder.counts_per_rev"]
WHEEL_LOAD_N = VALUES["robot.mass_kg"] * VALUES["contact.gravity_m_s2"] / 4
BEARINGS_RAD = np.deg2rad(VALUES["robot.wheel_angles_deg"])
DRIVE = np.stack([-np.sin(BEARINGS_RAD), np.cos(BEARINGS_RAD)], axis=1)
ROLLER = np.stack([np.cos(BEARINGS_RAD), np.sin(BEARINGS_RAD)], axis=1)
JACOBIAN = np.column_stack([DRIVE, np.full(4, VALUES["robot.wheel_distance_m"])])


def command(kind: str, *value: float, t_s: float = 0.0) -> dict:
    return {"t_s": t_s, "kind": kind, "value": list(value)}


def blow(t_s: float, y_n_s: float) -> dict:
    return {
        "t_s": t_s,
        "impulse_x_n_s": 0.0,
        "impulse_y_n_s": y_n_s,
        "impulse_theta_n_m_s": 0.0,
    }


def run(
    commands,
    duration_s,
    controller="slip",
    effects=(),
    impulses=(),
    step_s=1e-3,
    parameters=None,
    firmware=None,
):
    """1 kHz arrays of the closed loop; `parameters` and `firmware` replace nominal values."""
    raw = FIRMWARE | {"slip_compensation": CONTROLLERS[controller]} | (firmware or {})
    plant = PARAMETERS | (parameters or {})
    return _core.simulate(
        plant, list(effects), raw, list(commands), list(impulses), duration_s, step_s
    )


def effect(name: str, wheel: int | None = None, **parameters: float) -> dict:
    return {"name": name, "wheel": wheel, "parameters": parameters}


def unwrapped(counts):
    """(n, 4) counts since the first row, without the wraps of the 16-bit counters."""
    steps = np.diff(counts.astype(np.int64), axis=0)
    steps = (steps + 2**15) % 2**16 - 2**15
    return np.vstack([np.zeros((1, 4), np.int64), np.cumsum(steps, axis=0)])


def shaft_angles_rad(truth):
    """(n, 4) integral of the plant's shaft speeds by the trapezoidal rule."""
    speed = truth["wheel_speed_rad_s"]
    return np.vstack([np.zeros(4), np.cumsum((speed[1:] + speed[:-1]) / 2e3, axis=0)])


def rolled(truth):
    """(n, 3) body displacement that the encoders show: J+ times the rim paths (no turning)."""
    paths = unwrapped(truth["encoder_counts"]) * RAD_PER_COUNT * RIM_PER_SHAFT_M
    return paths @ np.linalg.pinv(JACOBIAN).T


def to_body(pose):
    """World displacement of a robot that does not turn is its body displacement."""
    return pose - pose[0]


def arctan_law(slip_m_s, grip_n):
    """Friction force of eq. (13) in N."""
    return grip_n * 2 / np.pi * np.arctan(VALUES["contact.slip_stiffness_s_m"] * slip_m_s)


def roller_force_n(direction, speed_m_s):
    """(2,) force of the four rollers on a body that moves at `speed_m_s` along `direction`."""
    grip_n = VALUES["contact.mu_roller"] * WHEEL_LOAD_N
    return -arctan_law(ROLLER @ direction * speed_m_s, grip_n) @ ROLLER


def steady_speed_without_slip_model(direction, speed_m_s):
    """Body speed (2,) when the rims run as for rolling but must overcome the rollers.

    The drive forces carry the rollers' force, F = (H+) f with the least norm; the slip each of
    them needs by eq. (13) is what the body lacks.
    """
    force_n = np.linalg.pinv(DRIVE.T) @ -roller_force_n(direction, speed_m_s)
    share = force_n / (VALUES["contact.mu_drive"] * WHEEL_LOAD_N)
    slip_m_s = np.tan(share * np.pi / 2) / VALUES["contact.slip_stiffness_s_m"]
    return direction * speed_m_s - np.linalg.pinv(DRIVE) @ slip_m_s
