"""The slip model written a second time, plainly and differently, for scipy to integrate.

Newton's law in the world frame for the centre of gravity, so there is no velocity product and no
moving reference point; forces are summed as vectors wheel by wheel; loads and bus voltage are
solved for, not expanded into closed forms. It shares nothing with the plant but equations (6)-(13).

State (14): shaft speeds W [rad/s], shaft angles [rad], world velocity of the centre of gravity
[m/s], turn rate [rad/s], world position of the centre of gravity [m], heading [rad].
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


@dataclass(frozen=True)
class SlipModel:
    """Parameters in SI units; the defaults are the nominal robot without effects."""

    mass: float = 20.0
    inertia: float = 0.55
    radius: np.ndarray = field(default_factory=lambda: np.full(4, 0.05))
    distance: float = 0.20
    bearing: np.ndarray = field(default_factory=lambda: np.radians([30.0, 150.0, 210.0, 330.0]))
    turned: np.ndarray = field(default_factory=lambda: np.zeros(4))
    resistance: float = 0.6
    motor_constant: float = 0.0255
    gear: float = 12.0
    shaft_inertia: float = 2.5e-5
    viscous: float = 1.5e-5
    dry: float = 0.0
    supply: float = 24.0
    source_resistance: float = 0.0
    current_limit: float = np.inf
    mu_drive: float = 0.6
    mu_roller: float = 0.05
    stiffness: float = 40.0
    gravity: float = 9.81
    cog: np.ndarray = field(default_factory=lambda: np.zeros(2))
    cog_height: float = 0.0


def rotation(angle: float) -> np.ndarray:
    """Matrix (2, 2) from the body to the world frame."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def grip(slip: np.ndarray, model: SlipModel) -> np.ndarray:
    return 2.0 / np.pi * np.arctan(model.stiffness * slip)


def currents(bus: float, duty: np.ndarray, speed: np.ndarray, model: SlipModel) -> np.ndarray:
    free = (bus * duty - model.motor_constant * speed) / model.resistance
    return np.clip(free, -model.current_limit, model.current_limit)


def bus_voltage(duty: np.ndarray, speed: np.ndarray, model: SlipModel) -> float:
    """Root of V = V0 - r sum(i d); the right side falls with V."""
    if model.source_resistance == 0.0:
        return model.supply

    def excess(bus: float) -> float:
        drawn = currents(bus, duty, speed, model) @ duty
        return bus - model.supply + model.source_resistance * drawn

    return brentq(excess, -10.0 * model.supply, 10.0 * model.supply, xtol=1e-13, rtol=1e-15)


def rate_of_change(state: np.ndarray, duty: np.ndarray, model: SlipModel) -> np.ndarray:
    speed, velocity, omega, heading = state[:4], state[8:10], state[10], state[13]
    arm = model.distance * np.array([np.cos(model.bearing), np.sin(model.bearing)]).T - model.cog
    direction = model.bearing + model.turned
    roller = np.array([np.cos(direction), np.sin(direction)]).T
    drive = np.array([-np.sin(direction), np.cos(direction)]).T

    hub = rotation(heading).T @ velocity + omega * np.array([-arm[:, 1], arm[:, 0]]).T
    slip = model.radius * speed / model.gear - np.sum(hub * drive, axis=1)
    sideways = np.sum(hub * roller, axis=1)
    drive_per_load = model.mu_drive * grip(slip, model)
    roller_per_load = -model.mu_roller * grip(sideways, model)
    force_per_load = drive_per_load[:, None] * drive + roller_per_load[:, None] * roller

    load = wheel_loads(arm, force_per_load, model)
    force = load[:, None] * force_per_load
    moment = np.sum(arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0])

    current = currents(bus_voltage(duty, speed, model), duty, speed, model)
    torque = (
        model.motor_constant * current
        - model.viscous * speed
        - model.dry * np.tanh(speed / 2.0)
        - model.radius / model.gear * load * drive_per_load
    )
    return np.concatenate(
        [
            torque / model.shaft_inertia,
            speed,
            rotation(heading) @ force.sum(axis=0) / model.mass,
            [moment / model.inertia],
            velocity,
            [omega],
        ]
    )


def wheel_loads(arm: np.ndarray, force_per_load: np.ndarray, model: SlipModel) -> np.ndarray:
    """Loads of least norm that carry the weight and balance the floor's tipping moment."""
    weight = model.mass * model.gravity
    share = np.linalg.pinv(np.vstack([np.ones(4), arm.T]))
    tipping = -model.cog_height * force_per_load.T
    return np.linalg.solve(np.eye(4) - share[:, 1:] @ tipping, share[:, 0] * weight)


def run(model: SlipModel, time: np.ndarray, duty: np.ndarray, method: str) -> np.ndarray:
    """Outputs of the sensors from rest at the origin under the duty held from row to row.

    time: (n,) s; duty: (n, 4); method: solver of solve_ivp. Returns (n, 8): shaft angles, turn
    rate, pose of the wheel centre.
    """
    state = np.zeros(14)
    state[11:13] = model.cog
    rows = [state]
    for begin, end, held in zip(time[:-1], time[1:], duty[:-1], strict=True):
        solution = solve_ivp(
            lambda _, x, held=held: rate_of_change(x, held, model),
            (begin, end),
            state,
            method=method,
            rtol=1e-10,
            atol=1e-10,
        )
        state = solution.y[:, -1]
        rows.append(state)
    return np.array([outputs(row, model) for row in rows])


def outputs(state: np.ndarray, model: SlipModel) -> np.ndarray:
    centre = state[11:13] - rotation(state[13]) @ model.cog
    return np.concatenate([state[4:8], state[10:11], centre, state[13:14]])
