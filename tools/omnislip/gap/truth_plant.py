"""Independent plant of the truth generator: four-wheeled omnidirectional robot with slip.

It shares nothing with the C++ plant under test, so that a score on its logs is no inverse crime:
other language, other formulation (balance of forces about the wheel centre, moments about the
centre of gravity), other integrator (Heun at 0.1 ms for the mechanics, exact exponentials for the
first-order lags) and other friction curves.

Equations, SI units, body frame at the wheel centre (x forward, y left, theta counter-clockwise),
wheel i at p_i:
    drive      d_i, roller r_i = d_i turned by -90 degrees; hub velocity V_i = v + w x p_i
    slip       s_i = R_i W_i / n - d_i . V_i
    contact    f_i = N_i mu_i phi(s_i) along d_i,  g_i = -N_i mu_roller phi(r_i . V_i) along r_i
    motor      J dW_i/dt = k i_i - b W_i - friction(W_i) - (R_i / n) f_i
    current    i_i = (V d_i - k W_i) / R_a,  V = V0 (1 - rate t) - r sum(i d)
    body       m a_G = F + m g_slope,  Iz dw/dt = M_G
phi has the initial slope 2 k / pi for each curve, x = (2/pi) k s:
    atan (2/pi) atan(k s);  tanh  tanh(x);  brush  x / sqrt(1 + x^2);  rational  x / (1 + |x|);
    straight  x up to 1;  peaked  sin(1.25 atan(x / 1.25)), which falls to 0.92
The parameters are one record of `PLANT`; with the values of `neutral_plant` every effect vanishes
exactly. Source: equations (3)-(13) of the paper with the errata listed beside the plant in `sim/`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 1e-4
TICKS_PER_MS = 10
FRICTION_CURVES = ("atan", "tanh", "brush", "rational", "straight", "peaked")

# Columns of the history that `simulate_run` returns, one row per 0.1 ms tick, after the pose.
VELOCITY = slice(3, 6)
SHAFT_SPEED = slice(6, 10)
ENCODER_ANGLE = slice(10, 14)
CURRENT = slice(14, 18)
SLIP = slice(18, 22)
SUPPLY = 22
GYRO = 23
HISTORY_COLUMNS = 24

# Channels of the process noise, one row per millisecond.
NOISE_CHANNELS = 7  # world force x, y; yaw torque; four shaft torques

WHEEL_FIELDS_WITH_NEUTRAL = {
    # motor and driver
    "resistance_ohm": 0.6,
    "torque_constant_nm_a": 0.0255,
    "shaft_inertia_kg_m2": 2.5e-5,
    "inductance_h": 0.0,
    "current_limit_a": math.inf,
    "braking_fraction": 1.0,
    "heating_1_a2_s": 0.0,
    "dead_zone_duty": 0.0,
    "cubic": 0.0,
    "delay_s": 0.0,
    "lag_s": 0.0,
    "motor_sign": 1.0,
    # friction on the shaft
    "viscous_nm_s": 1.5e-5,
    "coulomb_nm": 0.0,
    "forward_coulomb_nm": 0.0,
    "forward_viscous_nm_s": 0.0,
    "stribeck_nm": 0.0,
    "stribeck_speed_rad_s": 1.0,
    "load_friction": 0.0,
    "quadratic_drag": 0.0,
    "cogging_nm": 0.0,
    "cogging_cycles": 1.0,
    "cogging_phase_rad": 0.0,
    # gear and wheel
    "backlash_rad": 0.0,
    "stiffness_nm_rad": 0.0,
    "damping_nm_s_rad": 0.0,
    "radius_m": 0.05,
    "eccentricity": 0.0,
    "eccentricity_phase_rad": 0.0,
    "angle_error_rad": 0.0,
    # contact
    "mu_drive": 0.6,
    "mu_roller": 0.05,
    "slip_stiffness_s_m": 40.0,
    "falloff": 0.0,
    "falloff_speed_m_s": 1.0,
    "shape_blend": 0.0,
    "bristle_m": 0.0,
    "ripple": 0.0,
    "rollers": 1.0,
    "rolling_resistance": 0.0,
    # sensors
    "encoder_scale": 1.0,
    "dropout": 0.0,
    "dropout_speed_rad_s": math.inf,
    # outside the catalogue
    "fifth_drag_nm": 0.0,
    "thermal_loss_1_a2_s": 0.0,
    "beat_nm": 0.0,
    "beat_hz": 0.0,
    "tight_spot_nm": 0.0,
    "puncture_1_s": 0.0,
    "outage_s": 0.0,
    "outage_period_s": 1.0,
    "encoder_ripple_rad": 0.0,
}
ROBOT_FIELDS_WITH_NEUTRAL = {
    "curve": 0.0,
    "gear": 12.0,
    "supply_v": 24.0,
    "source_resistance_ohm": 0.0,
    "charge_rate_1_s": 0.0,
    "mass_kg": 20.0,
    "inertia_kg_m2": 0.55,
    "distance_m": 0.2,
    "gravity_m_s2": 9.81,
    "counts_per_rev": 2000.0,
    "grip_rate_1_s": 0.0,
    "carpet_cos2": 0.0,
    "carpet_sin2": 0.0,
    "patch_scale": 1.0,
    "patch_x_min_m": -math.inf,
    "patch_x_max_m": math.inf,
    "patch_y_min_m": -math.inf,
    "patch_y_max_m": math.inf,
    "cog_height_m": 0.0,
    "diagonal_load_n": 0.0,
    "cog_x_m": 0.0,
    "cog_y_m": 0.0,
    "slope_x_m_s2": 0.0,
    "slope_y_m_s2": 0.0,
    "drag_n_s_m": 0.0,
    "quadratic_drag_n_s2_m2": 0.0,
    "tether_n_m": 0.0,
    "tether_x_m": 0.0,
    "tether_y_m": 0.0,
    "scrub_nm": 0.0,
    "impact_time_s": math.inf,
    "impulse_x_n_s": 0.0,
    "impulse_y_n_s": 0.0,
    "impulse_theta_n_m_s": 0.0,
    "gyro_bias_rad_s": 0.0,
    "gyro_scale": 1.0,
    "pose_delay_s": 0.0,
    "pose_rotation_rad": 0.0,
    "clock_skew": 0.0,
    # outside the catalogue
    "bump_n": 0.0,
    "bump_width_m": 1.0,
    "wave_m_s2": 0.0,
    "wave_length_m": 1.0,
    "adhesive_n": 0.0,
    "adhesive_x_m": 0.0,
    "adhesive_width_m": 0.0,
    "lateral_n_s2_m2": 0.0,
    "supply_ripple": 0.0,
    "supply_ripple_hz": 0.0,
    "gyro_g_s_m": 0.0,
}
PLANT = np.dtype(
    [(name, "f8", (4,)) for name in WHEEL_FIELDS_WITH_NEUTRAL]
    + [("bearing_rad", "f8", (4,)), ("encoder_order", "f8", (4,))]
    + [(name, "f8") for name in ROBOT_FIELDS_WITH_NEUTRAL]
)

# Values of the current tick, shared by the steps of `simulate_run`.
WORK = np.dtype(
    [
        ("position_m", "f8", (4, 2)),  # of the wheels, body frame
        ("drive", "f8", (4, 2)),  # unit vectors of the drive directions
        ("noise", "f8", (NOISE_CHANNELS,)),
        ("duty", "f8", (4,)),  # that reaches the motors
        ("lagged_duty", "f8", (4,)),
        ("load_n", "f8", (4,)),
        ("current_a", "f8", (4,)),
        ("inductive_a", "f8", (4,)),
        ("heat_a2_s", "f8", (4,)),
        ("slip_m_s", "f8", (4,)),
        ("bristle", "f8", (4,)),  # share of the grip
        ("bus_v", "f8"),
        ("force_x_m_s2", "f8"),  # force on the body per mass without gravity, body frame
        ("force_y_m_s2", "f8"),
    ]
)

# Share of the shaft inertia that sits behind a soft gear, and the stiffness that closes a backlash
# (at the wheel).
_WHEEL_INERTIA_SHARE = 0.2
_TOOTH_STIFFNESS_NM_RAD = 5000.0
_TOOTH_DAMPING_NM_S_RAD = 2.0
COOLING_TIME_S = 60.0
_SIGN_SPEED_RAD_S = 2.0
# State vector: pose, body velocity, then four each of shaft speed, shaft angle, wheel speed, wheel
# angle, counted angle of the encoder.
_STATES = 26
_W, _ANGLE, _WHEEL_W, _WHEEL_ANGLE, _COUNTED = 6, 10, 14, 18, 22


def neutral_plant() -> np.ndarray:
    """One record of `PLANT` (shape (1,)): the nominal robot, no effect."""
    plant = np.zeros(1, PLANT)
    for name, value in {**WHEEL_FIELDS_WITH_NEUTRAL, **ROBOT_FIELDS_WITH_NEUTRAL}.items():
        plant[name] = value
    plant["bearing_rad"] = np.radians([30.0, 150.0, 210.0, 330.0])
    plant["encoder_order"] = [1.0, 2.0, 3.0, 4.0]
    return plant


@njit(cache=True)
def friction_curve(curve: int, slope_times_slip: float) -> float:
    """Share of the friction limit, -1..1, of x = (2/pi) k s; initial slope 1 for each curve."""
    x = slope_times_slip
    if curve == 0:
        return 2.0 / math.pi * math.atan(0.5 * math.pi * x)
    if curve == 1:
        return math.tanh(x)
    if curve == 3:
        return x / (1.0 + abs(x))
    if curve == 4:
        return min(max(x, -1.0), 1.0)
    if curve == 5:
        return math.sin(1.25 * math.atan(x / 1.25))
    return x / math.sqrt(1.0 + x * x)


@njit(cache=True)
def _contact_share(p: np.record, i: int, slip_m_s: float) -> float:
    x = 2.0 / math.pi * p.slip_stiffness_s_m[i] * slip_m_s
    share = friction_curve(int(p.curve), x)
    blend = p.shape_blend[i]
    if blend != 0.0:
        share = (1.0 - blend) * share + blend * math.tanh(x)
    return share


@njit(cache=True)
def _drive_grip(
    p: np.record,
    t: float,
    i: int,
    slip_m_s: float,
    x_m: float,
    y_m: float,
    drive_heading_rad: float,
) -> float:
    """Friction coefficient of the drive direction with all that scales it."""
    mu = p.mu_drive[i] * (1.0 - p.grip_rate_1_s * t)
    if p.falloff[i] != 0.0:
        ratio = slip_m_s / p.falloff_speed_m_s[i]
        mu *= 1.0 - p.falloff[i] * (1.0 - math.exp(-ratio * ratio))
    if p.carpet_cos2 != 0.0 or p.carpet_sin2 != 0.0:
        double = 2.0 * drive_heading_rad
        mu *= 1.0 + p.carpet_cos2 * math.cos(double) + p.carpet_sin2 * math.sin(double)
    inside_x = p.patch_x_min_m <= x_m <= p.patch_x_max_m
    if inside_x and p.patch_y_min_m <= y_m <= p.patch_y_max_m:
        mu *= p.patch_scale
    return max(mu, 0.0)


@njit(cache=True)
def _smooth_sign(speed_rad_s: float) -> float:
    return math.tanh(speed_rad_s / _SIGN_SPEED_RAD_S)


@njit(cache=True)
def shaft_friction_nm(
    p: np.record,
    i: int,
    t: float,
    speed_rad_s: float,
    angle_rad: float,
    motor_nm: float,
    duty: float,
) -> float:
    """Torque that opposes the shaft of wheel i (positive when it brakes a positive speed)."""
    w = speed_rad_s
    sign = _smooth_sign(w)
    level = p.coulomb_nm[i] + p.load_friction[i] * abs(motor_nm)
    if p.stribeck_nm[i] != 0.0:
        level += p.stribeck_nm[i] * math.exp(-((w / p.stribeck_speed_rad_s[i]) ** 2))
    forward = 0.5 * (1.0 + sign) * (p.forward_coulomb_nm[i] + p.forward_viscous_nm_s[i] * w)
    torque = (level + forward) * sign + p.viscous_nm_s[i] * w + p.quadratic_drag[i] * w * abs(w)
    if p.cogging_nm[i] != 0.0:
        torque += p.cogging_nm[i] * math.sin(
            p.cogging_cycles[i] * angle_rad + p.cogging_phase_rad[i]
        )
    if p.fifth_drag_nm[i] != 0.0:
        torque += p.fifth_drag_nm[i] * (w / 300.0) ** 5
    if p.beat_nm[i] != 0.0:
        torque += p.beat_nm[i] * abs(duty) * math.sin(2.0 * math.pi * p.beat_hz[i] * t)
    if p.tight_spot_nm[i] != 0.0:
        torque += p.tight_spot_nm[i] * max(0.0, math.sin(angle_rad / p.gear)) ** 4 * sign
    return torque


@njit(cache=True)
def _limited_current(
    p: np.record, i: int, current_a: float, speed_rad_s: float, duty: float
) -> float:
    """Current after freewheeling and limit."""
    if current_a * speed_rad_s < 0.0 and duty * speed_rad_s >= 0.0:
        current_a *= p.braking_fraction[i]
    limit = p.current_limit_a[i]
    return min(max(current_a, -limit), limit)


@njit(cache=True)
def _torque_constant(p: np.record, i: int, heat_a2_s: float) -> float:
    return p.torque_constant_nm_a[i] * max(0.1, 1.0 - p.thermal_loss_1_a2_s[i] * heat_a2_s)


@njit(cache=True)
def _warm_resistance_ohm(p: np.record, i: int, heat_a2_s: float) -> float:
    return p.resistance_ohm[i] * (1.0 + p.heating_1_a2_s[i] * heat_a2_s)


@njit(cache=True)
def _steady_current(
    p: np.record, i: int, supply_v: float, duty: float, speed_rad_s: float, heat_a2_s: float
) -> float:
    open_v = supply_v * duty - _torque_constant(p, i, heat_a2_s) * speed_rad_s
    return open_v / _warm_resistance_ohm(p, i, heat_a2_s)


@njit(cache=True)
def solve_supply(p: np.record, t: float, y: Array, work: np.record) -> None:
    """Fills the currents and the bus voltage that balances them.

    V + r sum(i(V) d) - V0 is piecewise linear and rises with V, so the secant that starts at V0 and
    0 is exact while no limit acts and ends after a few steps when one does.
    """
    open_v = p.supply_v * (1.0 - p.charge_rate_1_s * t)
    open_v *= 1.0 + p.supply_ripple * math.sin(2.0 * math.pi * p.supply_ripple_hz * t)
    bus_v = open_v
    error = _open_voltage(p, bus_v, y, work) - open_v
    if p.source_resistance_ohm > 0.0:
        last_v, last_error = 0.0, _open_voltage(p, 0.0, y, work) - open_v
        for _ in range(20):
            if abs(error) < 1e-9 or error == last_error:
                break
            next_v = bus_v - error * (bus_v - last_v) / (error - last_error)
            last_v, last_error, bus_v = bus_v, error, next_v
            error = _open_voltage(p, bus_v, y, work) - open_v
    work.bus_v = bus_v


@njit(cache=True)
def _open_voltage(p: np.record, bus_v: float, y: Array, work: np.record) -> float:
    """Open-circuit voltage that this bus voltage would need; fills the currents."""
    drawn_a = 0.0
    for i in range(4):
        if p.inductance_h[i] > 0.0:
            free_a = work.inductive_a[i]
        else:
            free_a = _steady_current(p, i, bus_v, work.duty[i], y[_W + i], work.heat_a2_s[i])
        work.current_a[i] = _limited_current(p, i, free_a, y[_W + i], work.duty[i])
        drawn_a += work.current_a[i] * work.duty[i]
    return bus_v + p.source_resistance_ohm * drawn_a


@njit(cache=True)
def start_work(p: np.record, work: np.record) -> None:
    """Fills what does not change during a run; the rest of `work` is zero at rest."""
    work.bus_v = p.supply_v
    for i in range(4):
        angle = p.bearing_rad[i] + 0.5 * math.pi + p.angle_error_rad[i]
        work.position_m[i, 0] = p.distance_m * math.cos(p.bearing_rad[i])
        work.position_m[i, 1] = p.distance_m * math.sin(p.bearing_rad[i])
        work.drive[i, 0], work.drive[i, 1] = math.cos(angle), math.sin(angle)


@njit(cache=True)
def wheel_loads(p: np.record, work: np.record) -> None:
    """Fills the normal forces: minimum-norm balance of weight, centre of gravity, acceleration."""
    position = work.position_m
    squares_x = squares_y = 0.0
    for i in range(4):
        squares_x += position[i, 0] ** 2
        squares_y += position[i, 1] ** 2
    lever_x = p.gravity_m_s2 * p.cog_x_m - p.cog_height_m * work.force_x_m_s2
    lever_y = p.gravity_m_s2 * p.cog_y_m - p.cog_height_m * work.force_y_m_s2
    for i in range(4):
        load = 0.25 * p.gravity_m_s2
        load += lever_x * position[i, 0] / squares_x + lever_y * position[i, 1] / squares_y
        diagonal = p.diagonal_load_n if i % 2 == 0 else -p.diagonal_load_n
        work.load_n[i] = max(p.mass_kg * load + diagonal, 0.0)


@njit(cache=True)
def _world_force(
    p: np.record, x_m: float, y_m: float, world_vx: float, world_vy: float
) -> tuple[float, float]:
    """World-fixed forces that depend on place and velocity."""
    force_x = -p.tether_n_m * (x_m - p.tether_x_m)
    force_y = -p.tether_n_m * (y_m - p.tether_y_m)
    speed = math.sqrt(world_vx * world_vx + world_vy * world_vy)
    drag = p.drag_n_s_m + p.quadratic_drag_n_s2_m2 * speed
    if p.adhesive_n != 0.0 and abs(x_m - p.adhesive_x_m) < 0.5 * p.adhesive_width_m:
        drag += p.adhesive_n / (speed + 0.02)
    force_x += -drag * world_vx - p.lateral_n_s2_m2 * speed * world_vy
    force_y += -drag * world_vy + p.lateral_n_s2_m2 * speed * world_vx
    if p.bump_n != 0.0:
        bump_x, bump_y = _bump_force(p, x_m, y_m)
        force_x += bump_x
        force_y += bump_y
    return force_x, force_y


@njit(cache=True)
def _bump_force(p: np.record, x_m: float, y_m: float) -> tuple[float, float]:
    force_x = force_y = 0.0
    for row in range(-2, 3):
        for column in range(-2, 3):
            dx = (x_m - 0.5 * row) / p.bump_width_m
            dy = (y_m - 0.5 * column) / p.bump_width_m
            push = p.bump_n * math.exp(-0.5 * (dx * dx + dy * dy))
            force_x += push * dx
            force_y += push * dy
    return force_x, force_y


@njit(cache=True)
def _slope(p: np.record, x_m: float, y_m: float) -> tuple[float, float]:
    """Gravity along the floor, world frame (m/s^2)."""
    slope_x, slope_y = p.slope_x_m_s2, p.slope_y_m_s2
    if p.wave_m_s2 != 0.0:
        slope_x += p.wave_m_s2 * math.sin(2.0 * math.pi * x_m / p.wave_length_m)
        slope_y += p.wave_m_s2 * math.sin(2.0 * math.pi * y_m / p.wave_length_m)
    return slope_x, slope_y


@njit(cache=True)
def derivative(p: np.record, t: float, y: Array, work: np.record, dy: Array) -> None:
    """Fills dy (state derivative) and the currents, slips, bus voltage and force of `work`."""
    cos_t, sin_t = math.cos(y[2]), math.sin(y[2])
    vx, vy, w = y[3], y[4], y[5]
    solve_supply(p, t, y, work)
    force_x = force_y = moment = 0.0
    for i in range(4):
        wheel_x, wheel_y = _wheel(p, t, i, y, work, dy)
        force_x += wheel_x
        force_y += wheel_y
        moment += work.position_m[i, 0] * wheel_y - work.position_m[i, 1] * wheel_x
    world_vx, world_vy = cos_t * vx - sin_t * vy, sin_t * vx + cos_t * vy
    world_x, world_y = _world_force(p, y[0], y[1], world_vx, world_vy)
    rolling = math.hypot(vx, vy) + p.distance_m * abs(w)
    bumps = rolling / (rolling + 0.1)  # a robot at rest meets no bumps
    world_x += bumps * work.noise[0]
    world_y += bumps * work.noise[1]
    force_x += cos_t * world_x + sin_t * world_y
    force_y += -sin_t * world_x + cos_t * world_y
    moment += bumps * work.noise[2] - p.scrub_nm * math.tanh(w / 0.05)

    slope_x, slope_y = _slope(p, y[0], y[1])
    fx, fy = force_x / p.mass_kg, force_y / p.mass_kg
    yaw = (moment - (p.cog_x_m * force_y - p.cog_y_m * force_x)) / p.inertia_kg_m2
    ax = fx + cos_t * slope_x + sin_t * slope_y + yaw * p.cog_y_m + w * w * p.cog_x_m
    ay = fy - sin_t * slope_x + cos_t * slope_y - yaw * p.cog_x_m + w * w * p.cog_y_m
    work.force_x_m_s2, work.force_y_m_s2 = fx, fy
    dy[0], dy[1], dy[2] = world_vx, world_vy, w
    dy[3], dy[4], dy[5] = ax + w * vy, ay - w * vx, yaw


@njit(cache=True)
def _is_soft(p: np.record, i: int) -> bool:
    return p.backlash_rad[i] > 0.0 or p.stiffness_nm_rad[i] > 0.0


@njit(cache=True)
def _wheel(
    p: np.record, t: float, i: int, y: Array, work: np.record, dy: Array
) -> tuple[float, float]:
    """Contact of wheel i: fills its slip and derivatives, returns its force x, y on the body."""
    drive_x, drive_y = work.drive[i, 0], work.drive[i, 1]
    hub_x = y[3] - y[5] * work.position_m[i, 1]
    hub_y = y[4] + y[5] * work.position_m[i, 0]
    along, across = drive_x * hub_x + drive_y * hub_y, drive_y * hub_x - drive_x * hub_y

    soft = _is_soft(p, i)
    wheel_w = y[_WHEEL_W + i] if soft else y[_W + i] / p.gear
    wheel_angle = y[_WHEEL_ANGLE + i] if soft else y[_ANGLE + i] / p.gear
    radius = p.radius_m[i] * (1.0 - p.puncture_1_s[i] * t)
    if p.eccentricity[i] != 0.0:
        radius *= 1.0 + p.eccentricity[i] * math.sin(wheel_angle + p.eccentricity_phase_rad[i])
    work.slip_m_s[i] = radius * wheel_w - along

    pull = _pull(p, t, i, y, work)
    if p.ripple[i] != 0.0:
        pull *= 1.0 + p.ripple[i] * math.sin(p.rollers[i] * wheel_angle)
    _turn_shaft(p, t, i, y, radius * pull, work, dy)
    dy[_WHEEL_ANGLE + i] = wheel_w

    push = pull - work.load_n[i] * p.rolling_resistance[i] * math.tanh(along / 0.02)
    x_roller = 2.0 / math.pi * p.slip_stiffness_s_m[i] * across
    side = -work.load_n[i] * p.mu_roller[i] * friction_curve(int(p.curve), x_roller)
    return push * drive_x + side * drive_y, push * drive_y - side * drive_x


@njit(cache=True)
def _pull(p: np.record, t: float, i: int, y: Array, work: np.record) -> float:
    """Friction force in the drive direction."""
    slip = work.slip_m_s[i]
    heading = y[2] + p.bearing_rad[i] + 0.5 * math.pi + p.angle_error_rad[i]
    share = work.bristle[i] if p.bristle_m[i] > 0.0 else _contact_share(p, i, slip)
    return work.load_n[i] * share * _drive_grip(p, t, i, slip, y[0], y[1], heading)


@njit(cache=True)
def _turn_shaft(
    p: np.record, t: float, i: int, y: Array, road_nm: float, work: np.record, dy: Array
) -> None:
    """Derivatives of shaft, wheel and encoder i under motor, friction and road torque."""
    speed, angle = y[_W + i], y[_ANGLE + i]
    motor_nm = _torque_constant(p, i, work.heat_a2_s[i]) * work.current_a[i]
    net_nm = motor_nm + work.noise[3 + i]
    net_nm -= shaft_friction_nm(p, i, t, speed, angle, motor_nm, work.duty[i])
    inertia = p.shaft_inertia_kg_m2[i]
    if _is_soft(p, i):
        twist = angle / p.gear - y[_WHEEL_ANGLE + i]
        gear_nm = _gear_torque(p, i, twist, speed / p.gear - y[_WHEEL_W + i])
        wheel_inertia = _WHEEL_INERTIA_SHARE * inertia * p.gear * p.gear
        dy[_W + i] = (net_nm - gear_nm / p.gear) / ((1.0 - _WHEEL_INERTIA_SHARE) * inertia)
        dy[_WHEEL_W + i] = (gear_nm - road_nm) / wheel_inertia
    else:
        dy[_W + i] = (net_nm - road_nm / p.gear) / inertia
        dy[_WHEEL_W + i] = dy[_W + i] / p.gear
    dy[_ANGLE + i] = speed
    lost = p.dropout[i] if abs(speed) > p.dropout_speed_rad_s[i] else 0.0
    dy[_COUNTED + i] = speed * p.encoder_scale[i] * (1.0 - lost)


@njit(cache=True)
def _gear_torque(p: np.record, i: int, twist_rad: float, twist_speed_rad_s: float) -> float:
    """Torque of a soft gear at the wheel: spring and damper behind a play of backlash_rad."""
    stiffness, damping = p.stiffness_nm_rad[i], p.damping_nm_s_rad[i]
    if stiffness == 0.0:
        stiffness, damping = _TOOTH_STIFFNESS_NM_RAD, _TOOTH_DAMPING_NM_S_RAD
    half = 0.5 * p.backlash_rad[i]
    if abs(twist_rad) < half:
        return 0.0
    closed = twist_rad - half if twist_rad > 0.0 else twist_rad + half
    torque = stiffness * closed + damping * twist_speed_rad_s
    return torque if half == 0.0 or torque * closed > 0.0 else 0.0  # teeth do not pull


@njit(cache=True)
def _held_duty(duty: Array, tick: int, delay_s: float, i: int) -> float:
    """Mean over one tick of the millisecond-held duty, delayed."""
    start = tick / TICKS_PER_MS - delay_s * 1e3
    row = math.floor(start + 1e-9)
    late = max(0.0, start + 1.0 / TICKS_PER_MS - (row + 1.0)) * TICKS_PER_MS
    early = duty[row, i] if row >= 0 else 0.0
    if late < 1e-6:
        return early
    return (1.0 - late) * early + late * (duty[row + 1, i] if row + 1 >= 0 else 0.0)


@njit(cache=True)
def _driver(p: np.record, duty: Array, tick: int, work: np.record) -> None:
    """Fills the duty that reaches the motors: delay, nonlinearity, dead zone, outage, sign, lag."""
    for i in range(4):
        d = _held_duty(duty, tick, p.delay_s[i], i)
        d += p.cubic[i] * d * d * d
        d = math.copysign(max(abs(d) - p.dead_zone_duty[i], 0.0), d)
        if p.outage_s[i] > 0.0 and (tick * STEP_S) % p.outage_period_s[i] < p.outage_s[i]:
            d = 0.0
        d *= p.motor_sign[i]
        if p.lag_s[i] > 0.0:
            ratio = STEP_S / p.lag_s[i]
            change = (work.lagged_duty[i] - d) * -math.expm1(-ratio)
            work.lagged_duty[i] -= change
            d += change / ratio  # the mean over the tick
        work.duty[i] = d


@njit(cache=True)
def _slow_states(p: np.record, step_s: float, y: Array, work: np.record) -> None:
    """Winding heat, inductive current, bristle deflection after step_s by exact exponentials.

    Bristle: dz/dt = s - |s| z / (length phi(s)), LuGre, deflection `length` when sliding.
    """
    for i in range(4):
        work.heat_a2_s[i] += step_s * (work.current_a[i] ** 2 - work.heat_a2_s[i] / COOLING_TIME_S)
        if p.inductance_h[i] > 0.0:
            steady = _steady_current(p, i, work.bus_v, work.duty[i], y[_W + i], work.heat_a2_s[i])
            resistance_ohm = _warm_resistance_ohm(p, i, work.heat_a2_s[i])
            decay = math.exp(-step_s * resistance_ohm / p.inductance_h[i])
            work.inductive_a[i] = steady + (work.inductive_a[i] - steady) * decay
        if p.bristle_m[i] > 0.0:
            slip = work.slip_m_s[i]
            share = _contact_share(p, i, slip)
            small = 2.0 / math.pi * p.slip_stiffness_s_m[i]
            rate = slip / share if abs(share) > 1e-9 else 1.0 / small
            decay = math.exp(-step_s * rate / p.bristle_m[i])
            work.bristle[i] = share + (work.bristle[i] - share) * decay


@njit(cache=True)
def _measured_angle(p: np.record, y: Array, i: int) -> float:
    angle = y[_COUNTED + i]
    return angle + p.encoder_ripple_rad[i] * math.sin(y[_ANGLE + i])


@njit(cache=True)
def _record(p: np.record, y: Array, dy: Array, work: np.record, row: Array) -> None:
    row[0:6] = y[0:6]
    lateral = dy[4] + y[5] * y[3]
    for i in range(4):
        row[6 + i] = y[_W + i]
        row[10 + i] = _measured_angle(p, y, i)
        row[14 + i] = work.current_a[i]
        row[18 + i] = work.slip_m_s[i]
    row[22] = work.bus_v
    row[23] = p.gyro_scale * y[5] + p.gyro_bias_rad_s + p.gyro_g_s_m * lateral


@njit(cache=True)
def _strike(p: np.record, y: Array) -> None:
    """Impact: the body velocity jumps by the world-frame impulse."""
    cos_t, sin_t = math.cos(y[2]), math.sin(y[2])
    y[3] += (cos_t * p.impulse_x_n_s + sin_t * p.impulse_y_n_s) / p.mass_kg
    y[4] += (-sin_t * p.impulse_x_n_s + cos_t * p.impulse_y_n_s) / p.mass_kg
    y[5] += p.impulse_theta_n_m_s / p.inertia_kg_m2


@njit(cache=True)
def _control(
    p: np.record,
    gains: Array,
    reference: Array,
    millisecond: int,
    history: Array,
    duty: Array,
    integral: Array,
) -> None:
    """Wheel-speed PI with back-EMF feed-forward on encoder counts, gains = (feed-forward, kp, ki).

    The speed is the difference over 4 ms of whole counts, as a counter would deliver it.
    """
    now = millisecond * TICKS_PER_MS
    past = max(0, now - 4 * TICKS_PER_MS)
    count_rad = 2.0 * math.pi / p.counts_per_rev
    for i in range(4):
        counts = math.floor(history[now, 10 + i] / count_rad)
        counts -= math.floor(history[past, 10 + i] / count_rad)
        speed = counts * count_rad / 4e-3
        error = reference[millisecond, i] - speed
        wanted = gains[0] * reference[millisecond, i] + gains[1] * error + integral[i]
        duty[millisecond, i] = min(max(wanted, -1.0), 1.0)
        if wanted == duty[millisecond, i]:
            integral[i] += 1e-3 * gains[2] * error


@njit(cache=True)
def simulate_run(
    plant: NDArray[np.void],
    reference: Array,
    gains: Array,
    closed_loop: bool,
    noise: Array,
    start_pose: Array,
    start_angle_rad: Array,
) -> tuple[Array, Array]:
    """One run from rest.

    plant: record array (1,) of PLANT. reference (n, 4): per millisecond, duty -1..1 when open loop,
    shaft speed in rad/s when closed loop. gains (3,). noise (n, 7): world force x, y (N), yaw
    torque and shaft torques (N m). start_pose (3,), start_angle_rad (4,) shaft. Returns history (10
    n + 1, HISTORY_COLUMNS), duty (n, 4).
    """
    p = plant[0]
    rows = reference.shape[0]
    ticks = rows * TICKS_PER_MS
    duty = np.zeros((rows, 4)) if closed_loop else reference.copy()
    history = np.zeros((ticks + 1, HISTORY_COLUMNS))
    y = _start_state(p, start_pose, start_angle_rad)
    trial, first, second = np.zeros(_STATES), np.zeros(_STATES), np.zeros(_STATES)
    integral = np.zeros(4)
    work = np.zeros(1, WORK)[0]
    start_work(p, work)
    struck = False
    for tick in range(ticks):
        t = tick * STEP_S
        millisecond = tick // TICKS_PER_MS
        if t >= p.impact_time_s and not struck:
            _strike(p, y)
            struck = True
        _record(p, y, first, work, history[tick])
        if closed_loop and tick % TICKS_PER_MS == 0:
            _control(p, gains, reference, millisecond, history, duty, integral)
        _driver(p, duty, tick, work)
        for k in range(NOISE_CHANNELS):
            work.noise[k] = noise[millisecond, k]
        wheel_loads(p, work)
        # half a tick of the slow states on either side of the mechanics: second order together
        _slow_states(p, 0.5 * STEP_S, y, work)
        derivative(p, t, y, work, first)
        for k in range(_STATES):
            trial[k] = y[k] + STEP_S * first[k]
        derivative(p, t + STEP_S, trial, work, second)
        for k in range(_STATES):
            y[k] += 0.5 * STEP_S * (first[k] + second[k])
        _slow_states(p, 0.5 * STEP_S, y, work)
    _record(p, y, first, work, history[ticks])
    return history, duty


@njit(cache=True)
def _start_state(p: np.record, pose: Array, angle_rad: Array) -> Array:
    y = np.zeros(_STATES)
    y[0:3] = pose
    y[_ANGLE : _ANGLE + 4] = angle_rad
    y[_WHEEL_ANGLE : _WHEEL_ANGLE + 4] = angle_rad / p.gear
    y[_COUNTED : _COUNTED + 4] = angle_rad
    return y
