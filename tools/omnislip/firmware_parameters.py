"""Raw firmware parameters from the SI values of a robot model.

Every parameter of ``firmware/parameters.def`` is computed here, in the closed forms below, and
scaled to the Q format that its name ends in. Symbols: g bearing of a wheel, J kinematic matrix with
rows ``[-sin g, cos g, L]``, J+ its pseudo-inverse, n gear ratio, R wheel radius, N = m g / 4 wheel
load, dt = 1 ms control period.

Gains: seen at the rim, a wheel that drives its share of the robot obeys ``M v' = A u - B v`` with

* ``A = (n/R) k2 / Ra``, ``B = (n/R)^2 (k2 k3 / Ra + b0)``,
* ``M = m / min(sum sin^2 g, sum cos^2 g) + J0 (n/R)^2``, the share of the axis that is hardest to
  move: for x of the nominal robot all of m.

``u = Kp e + Ki integral(e)`` puts both poles of ``M s^2 + (B + A Kp) s + A Ki`` at ``-p``:

    ``Kp = (2 p M - B) / A``,  ``Ki = p^2 M / A``,  ``p = max(10 rad/s, B / M)``

but no faster than ``Kp`` = 1 V s/rad allows: a motor that weak is at full voltage anyway. Where
``B / M`` is above 50 rad/s, a strong motor on a light robot, ``Ki = (50 rad/s)^2 M / A`` leaves one
pole slower, so that the delay below does not matter. A lighter
axis (y, rotation, a wheel that slides) is faster by the ratio of the masses. At 10 rad/s
the fastest, the nominal sliding wheel with M = J0 (n/R)^2, keeps 60 degrees of phase margin with
the 2.5 ms of delay of speed window and hold. The plant is of first order, so the derivative gain
is 0. The position loops run at 0.4 p and 0.5 p, but no faster than 25 rad/s, where 5 ms of delay,
window and observer together, cost 7 degrees. Demanded accelerations use half of the grip,
corrections up to 0.7 of it; rotation no more than the 126 rad/s2 that the firmware can demand.

Observer: an error of 1 % of the grip is an error of 14 % of the slip at 0.93 of the grip, of 25 %
at 0.96; the inversion ends at 0.93. One encoder count is a step of the inertia's force; the filter
lets a twentieth of the grip of it through at most, and takes no less than 4 ms. A blow that changes
the speed by v is seen after dt / (g c), with the gain g and a wheel trusted by c; until then
v dt / (g c) is lost from the odometry: of a blow of 2 N s 0.5 mm with g = 0.4, half of it with 0.8.
Beyond, the speed would carry all the noise of the wheels.

Faults: no wheel load takes four times the current of the full grip for long; an unloaded shaft
cannot turn faster than its supply, with half as much again for a push from outside.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from omnislip.link.protocol import PARAMETERS

TICK_S = 0.001
SPEED_POLE_RAD_S = 10.0
LARGEST_SPEED_GAIN_V_S_RAD = 32767 / 32768
INTEGRAL_POLE_LIMIT_RAD_S = 50.0
POSITION_POLE_LIMIT_RAD_S = 25.0
SPEED_LIMIT_M_S = 2.5
OMEGA_LIMIT_RAD_S = 10.0
ANGULAR_ACCELERATION_LIMIT_RAD_S2 = 126.0
ACCELERATION_GRIP_SHARE = 0.5
TRACTION_GRIP_SHARE = 0.7
SLIP_SATURATION = 0.93
FORCE_FILTER = 0.25
COUNT_GRIP_SHARE = 0.05
SPEED_WINDOW_TICKS = 4
OUTSIDE_POSE_GAIN = 0.25
CURRENT_LIMIT_GRIPS = 4.0
SHAFT_SPEED_LIMIT_NO_LOADS = 1.5
LOWEST_SUPPLY_V = 4.01

Matrix = list[list[float]]


def kinematic_matrix(angles_deg: Sequence[float], distance_m: float) -> Matrix:
    """Return J, 4 rows of 3: rim speeds (m/s) from body velocity (m/s, m/s, rad/s)."""
    bearings_rad = [math.radians(angle) for angle in angles_deg]
    return [[-math.sin(g), math.cos(g), distance_m] for g in bearings_rad]


def _determinant(m: Matrix) -> float:
    (a, b, c), (d, e, f), (g, h, i) = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _inverse(m: Matrix) -> Matrix:
    determinant = _determinant(m)
    rotated = [[m[(r + 1) % 3], m[(r + 2) % 3]] for r in range(3)]

    def cofactor(row: int, column: int) -> float:
        p, q = (column + 1) % 3, (column + 2) % 3
        upper, lower = rotated[row]
        return upper[p] * lower[q] - upper[q] * lower[p]

    return [[cofactor(column, row) / determinant for column in range(3)] for row in range(3)]


def null_vector(j: Matrix) -> list[float]:
    """Return n (4) with n'J = 0, length 2, first entry not negative: the slip signal is n . V_w.

    Raises ValueError when J has not full rank.
    """
    minors = [_determinant(j[:i] + j[i + 1 :]) * (-1.0) ** i for i in range(4)]
    length = math.hypot(*minors)
    if length < 1e-6:
        raise ValueError("robot.wheel_angles_deg: the wheels cannot drive x, y and rotation")
    sign = -1.0 if minors[0] < 0.0 else 1.0
    return [sign * 2.0 * minor / length for minor in minors]


def pseudo_inverse(j: Matrix) -> Matrix:
    """Return J+ = (J'J)^-1 J', 3 rows of 4: body velocity from rim speeds.

    Raises ValueError when J has not full rank.
    """
    null_vector(j)
    normal = [[sum(row[a] * row[b] for row in j) for b in range(3)] for a in range(3)]
    inverse = _inverse(normal)
    return [[sum(inverse[a][b] * row[b] for b in range(3)) for row in j] for a in range(3)]


def _geometry(values: Mapping[str, float], angles_deg: Sequence[float]) -> dict[str, float]:
    j = kinematic_matrix(angles_deg, values["robot.wheel_distance_m"])
    rows = {
        "drive_x_{}_q15": [row[0] for row in j],
        "drive_y_{}_q15": [row[1] for row in j],
        **dict(
            zip(
                ("forward_x_{}_q13", "forward_y_{}_q13", "forward_omega_{}_q13"),
                pseudo_inverse(j),
                strict=True,
            )
        ),
        "null_{}_q13": null_vector(j),
    }
    named = {name.format(i + 1): row[i] for name, row in rows.items() for i in range(4)}
    rim_m = values["robot.wheel_radius_m"] / values["motor.gear_ratio"]
    return named | {
        "wheel_distance_q15": values["robot.wheel_distance_m"],
        "rim_per_shaft_q20": rim_m,
        "shaft_per_rim_q6": 1.0 / rim_m,
        "shaft_speed_per_count_q10": 2.0 * math.pi / values["encoder.counts_per_rev"] / TICK_S,
    }


def _motor(values: Mapping[str, float]) -> dict[str, float]:
    per_rim_1_m = values["motor.gear_ratio"] / values["robot.wheel_radius_m"]
    torque_per_volt = values["motor.torque_constant_nm_a"] / values["motor.resistance_ohm"]
    drag_nm_s = (
        torque_per_volt * values["motor.back_emf_constant_v_s_rad"]
        + values["motor.viscous_friction_nm_s"]
    )
    return {
        "force_per_volt_q10": per_rim_1_m * torque_per_volt,
        "volt_per_force_q13": 1.0 / (per_rim_1_m * torque_per_volt),
        "drag_q14": per_rim_1_m * drag_nm_s,
        "momentum_per_tick_q10": per_rim_1_m * values["motor.inertia_kg_m2"] / TICK_S,
        "coulomb_force_q8": per_rim_1_m * values["motor.coulomb_friction_nm"],
        "current_per_volt_q10": 1.0 / values["motor.resistance_ohm"],
    }


def _contact(values: Mapping[str, float]) -> dict[str, float]:
    load_n = values["robot.mass_kg"] * values["contact.gravity_m_s2"] / 4.0
    return {
        "grip_inverse_q15": 1.0 / (values["contact.mu_drive"] * load_n),
        "slip_per_tangent_q18": 1.0 / values["contact.slip_stiffness_s_m"],
        "slip_saturation_q15": SLIP_SATURATION,
        "roller_grip_q8": values["contact.mu_roller"] * load_n,
        "mass_q8": values["robot.mass_kg"],
        "inertia_q13": values["robot.inertia_kg_m2"],
        "velocity_per_force_q25": TICK_S / values["robot.mass_kg"],
        "omega_per_torque_q16": TICK_S / values["robot.inertia_kg_m2"],
    }


def _observer(values: Mapping[str, float], angles_deg: Sequence[float]) -> dict[str, float]:
    count_rad_s = _geometry(values, angles_deg)["shaft_speed_per_count_q10"] / SPEED_WINDOW_TICKS
    count_n = _motor(values)["momentum_per_tick_q10"] * count_rad_s
    grip_n = 1.0 / _contact(values)["grip_inverse_q15"]
    return {
        "slip_compensation": 1.0,
        "force_filter_q15": min(FORCE_FILTER, COUNT_GRIP_SHARE * grip_n / max(count_n, 1e-9)),
        "observer_gain_q15": 0.8,
        "trust_floor_q15": 0.5,
    }


def _gains(values: Mapping[str, float], angles_deg: Sequence[float]) -> dict[str, float]:
    rim_m = values["robot.wheel_radius_m"] / values["motor.gear_ratio"]
    motor = _motor(values)
    j = kinematic_matrix(angles_deg, values["robot.wheel_distance_m"])
    weakest = min(sum(row[axis] ** 2 for row in j) for axis in (0, 1))
    mass_kg = values["robot.mass_kg"] / weakest + values["motor.inertia_kg_m2"] / rim_m**2
    drag_n_s_m = motor["drag_q14"] / rim_m
    largest_volt_s_m = LARGEST_SPEED_GAIN_V_S_RAD / rim_m
    pole_1_s = min(
        max(SPEED_POLE_RAD_S, drag_n_s_m / mass_kg),
        (drag_n_s_m + motor["force_per_volt_q10"] * largest_volt_s_m) / (2.0 * mass_kg),
    )
    volt_s_m = (2.0 * pole_1_s * mass_kg - drag_n_s_m) / motor["force_per_volt_q10"]
    volt_m = min(pole_1_s, INTEGRAL_POLE_LIMIT_RAD_S) ** 2 * mass_kg / motor["force_per_volt_q10"]
    return {
        "speed_gain_q15": volt_s_m * rim_m,
        "speed_integral_q22": volt_m * rim_m * TICK_S,
        "speed_derivative_q12": 0.0,
        "outside_pose_gain_q15": OUTSIDE_POSE_GAIN,
        "position_gain_q20": min(0.4 * pole_1_s, POSITION_POLE_LIMIT_RAD_S) * TICK_S,
        "heading_gain_q20": min(0.5 * pole_1_s, POSITION_POLE_LIMIT_RAD_S) * TICK_S,
    }


def _limits(values: Mapping[str, float], angles_deg: Sequence[float]) -> dict[str, float]:
    distance_m = values["robot.wheel_distance_m"]
    forward = pseudo_inverse(kinematic_matrix(angles_deg, distance_m))
    grip_n = 1.0 / _contact(values)["grip_inverse_q15"]
    wheel_share = max(abs(entry) for row in forward[:2] for entry in row)
    turning_share = max(abs(entry) for entry in forward[2])
    half_grip_n = ACCELERATION_GRIP_SHARE * grip_n
    rim_m = values["robot.wheel_radius_m"] / values["motor.gear_ratio"]
    no_load_rad_s = values["motor.supply_v"] / values["motor.back_emf_constant_v_s_rad"]
    rim_limit_m_s = 0.6 * no_load_rad_s * rim_m
    grip_a = grip_n * rim_m / values["motor.torque_constant_nm_a"]
    return {
        "speed_limit_q13": min(SPEED_LIMIT_M_S, rim_limit_m_s),
        "omega_limit_q11": min(OMEGA_LIMIT_RAD_S, rim_limit_m_s / distance_m),
        "acceleration_limit_q10": half_grip_n / (wheel_share * values["robot.mass_kg"]),
        "angular_acceleration_limit_q8": min(
            half_grip_n / (turning_share * values["robot.inertia_kg_m2"]),
            ANGULAR_ACCELERATION_LIMIT_RAD_S2,
        ),
        "traction_limit_q8": TRACTION_GRIP_SHARE * grip_n,
        "duty_limit_q15": 32767.0 / 32768.0,
        "supply_minimum_q9": max(LOWEST_SUPPLY_V, 0.5 * values["motor.supply_v"]),
        "current_limit_ma": min(1000.0 * CURRENT_LIMIT_GRIPS * grip_a, 32767.0),
        "encoder_step_limit": SHAFT_SPEED_LIMIT_NO_LOADS
        * no_load_rad_s
        / _geometry(values, angles_deg)["shaft_speed_per_count_q10"],
        "command_timeout_ms": 200.0,
    }


_KEYS = {
    "wheel_distance": "robot.wheel_distance_m",
    "forward": "robot.wheel_angles_deg, robot.wheel_distance_m",
    "rim_per_shaft": "robot.wheel_radius_m, motor.gear_ratio",
    "shaft_per_rim": "robot.wheel_radius_m, motor.gear_ratio",
    "shaft_speed_per_count": "encoder.counts_per_rev",
    "force_per_volt": "motor.torque_constant_nm_a, motor.resistance_ohm",
    "volt_per_force": "motor.torque_constant_nm_a, motor.resistance_ohm",
    "coulomb_force": "motor.coulomb_friction_nm",
    "drag": "motor.back_emf_constant_v_s_rad, motor.viscous_friction_nm_s",
    "momentum_per_tick": "motor.inertia_kg_m2",
    "current_per_volt": "motor.resistance_ohm",
    "current_limit": "motor.torque_constant_nm_a, contact.mu_drive",
    "grip_inverse": "contact.mu_drive, robot.mass_kg",
    "slip_per_tangent": "contact.slip_stiffness_s_m",
    "roller_grip": "contact.mu_roller, robot.mass_kg",
    "mass": "robot.mass_kg",
    "inertia": "robot.inertia_kg_m2",
    "velocity_per_force": "robot.mass_kg",
    "omega_per_torque": "robot.inertia_kg_m2",
    "speed_gain": "motor.resistance_ohm, robot.mass_kg",
    "speed_integral": "motor.resistance_ohm, robot.mass_kg",
    "speed_limit": "motor.supply_v",
    "omega_limit": "motor.supply_v",
    "acceleration_limit": "contact.mu_drive",
    "angular_acceleration_limit": "robot.inertia_kg_m2",
    "traction_limit": "contact.mu_drive, robot.mass_kg",
    "supply_minimum": "motor.supply_v",
    "encoder_step_limit": "encoder.counts_per_rev, motor.supply_v",
}
_POSITIVE_KEYS = (
    "robot.mass_kg",
    "robot.inertia_kg_m2",
    "robot.wheel_radius_m",
    "robot.wheel_distance_m",
    "motor.resistance_ohm",
    "motor.torque_constant_nm_a",
    "motor.back_emf_constant_v_s_rad",
    "motor.gear_ratio",
    "motor.supply_v",
    "contact.mu_drive",
    "contact.slip_stiffness_s_m",
    "contact.gravity_m_s2",
    "encoder.counts_per_rev",
)
_OTHER_KEYS = ("motor.inertia_kg_m2", "motor.viscous_friction_nm_s", "contact.mu_roller")
_OPTIONAL_KEYS = {"motor.coulomb_friction_nm": 0.0}


def _raw(name: str, value: float) -> int:
    row = PARAMETERS[name]
    raw = round(value * 2**row.q_bits)
    # A magnitude of exactly 1 in Q15 is stored as the largest number, 3e-5 less.
    raw = 32767 * (raw // abs(raw)) if abs(raw) == 32768 else raw
    if not row.minimum <= raw <= row.maximum:
        parameter = name.removesuffix(f"_q{row.q_bits}")
        stem = parameter if parameter in _KEYS else parameter.split("_")[0]
        key = _KEYS.get(stem, "robot.wheel_angles_deg")
        low, high = row.value(row.minimum), row.value(row.maximum)
        raise ValueError(
            f"{key}: firmware parameter {name} would be {value:.6g} {row.unit}, "
            f"it must be {low:.6g} to {high:.6g}"
        )
    return raw


def _check(values: Mapping[str, float | Sequence[float]]) -> None:
    for key in (*_POSITIVE_KEYS, *_OTHER_KEYS, *_OPTIONAL_KEYS):
        value = values.get(key, _OPTIONAL_KEYS.get(key))
        if not isinstance(value, (int, float)) or not math.isfinite(value) or value < 0.0:
            raise ValueError(f"{key}: a finite number, not negative, is needed, got {value!r}")
        if key in _POSITIVE_KEYS and value == 0.0:
            raise ValueError(f"{key}: must be greater than 0")
    angles = values.get("robot.wheel_angles_deg")
    if not isinstance(angles, Sequence) or len(angles) != 4:
        raise ValueError(f"robot.wheel_angles_deg: a list of 4 angles is needed, got {angles!r}")
    if values["motor.supply_v"] <= LOWEST_SUPPLY_V:  # type: ignore[operator]
        raise ValueError(f"motor.supply_v: must be above {LOWEST_SUPPLY_V} V")


def firmware_parameters(values: Mapping[str, float | Sequence[float]]) -> dict[str, int]:
    """Return all firmware parameters, name -> raw integer, for the SI values of a robot model.

    ``values`` has the keys of ``robot.toml``, ``"section.key"``; ``robot.wheel_angles_deg`` is a
    list of 4; ``motor.coulomb_friction_nm`` may be absent for 0. Other keys are ignored. Raises
    ValueError, beginning with the key, when a value is missing, out of range or does not fit the
    fixed-point format of the firmware.
    """
    _check(values)
    angles_deg: Sequence[float] = values["robot.wheel_angles_deg"]  # type: ignore[assignment]
    numbers: dict[str, float] = _OPTIONAL_KEYS | {
        key: float(values[key])  # type: ignore[arg-type]
        for key in (*_POSITIVE_KEYS, *_OTHER_KEYS, *_OPTIONAL_KEYS)
        if key in values
    }
    physical = (
        _geometry(numbers, angles_deg)
        | _motor(numbers)
        | _contact(numbers)
        | _observer(numbers, angles_deg)
        | _gains(numbers, angles_deg)
        | _limits(numbers, angles_deg)
    )
    return {name: _raw(name, value) for name, value in physical.items()}
