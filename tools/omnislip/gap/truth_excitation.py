"""Driving programmes of the truth generator.

A programme is a reference (n, 4) per millisecond: body velocity vx, vy (m/s), w (rad/s) and
null-space twist (m/s, wheel pattern + - + -, which the body does not follow). `shaft_reference`
turns it into shaft speeds for the closed loop, `feed_forward_duty` into a duty by the inverse rigid
model for the open loop. Both use the believed robot only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EXCITATIONS = ("rich", "ordinary", "poor")
REST_MS = 200
_SEGMENT_MS = 1450
_LEG_MS = 1900
_MOST_GRIP = 1.15  # an open loop that asks for more lets the wheels run away
_NULL = np.array([1.0, -1.0, 1.0, -1.0])


def _profile(milliseconds: int, knots_s: list[float], values: list[float]) -> Array:
    return np.interp(np.arange(milliseconds) * 1e-3, knots_s, values)


def _window(milliseconds: int, ramp_ms: int = 150) -> Array:
    t = np.arange(milliseconds)
    edge = np.minimum(t, milliseconds - 1 - t).clip(0, ramp_ms)
    return 0.5 - 0.5 * np.cos(np.pi * edge / ramp_ms)


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _there_and_back(milliseconds: int, speed: float, ramp_s: float) -> Array:
    """Trapezoid to +speed, straight on to -speed, and to rest: ends where it began."""
    end = milliseconds * 1e-3
    half = 0.5 * end
    ramp = min(ramp_s, 0.2 * end)
    knots = [0.0, ramp, half - ramp, half + ramp, end - ramp, end]
    return _profile(milliseconds, knots, [0.0, speed, speed, -speed, -speed, 0.0])


def _multisine(rng: np.random.Generator, milliseconds: int) -> Array:
    """Four random-phase sums of harmonics, one per axis, without a common line.

    Velocity falls as 1 / f above 1 Hz, so that the acceleration stays within the grip.
    """
    t = np.arange(milliseconds) * 1e-3
    base_hz = 1.0 / (milliseconds * 1e-3)
    level = np.array([0.12, 0.2, 0.7, 0.03])
    out = np.zeros((milliseconds, 4))
    for axis, lines in enumerate(rng.permutation(np.arange(1, 16))[:12].reshape(4, 3)):
        for line in lines:
            phase = 2.0 * np.pi * base_hz * line * t + rng.uniform(0.0, 2.0 * np.pi)
            out[:, axis] += np.sin(phase) / max(1.0, base_hz * line)
    return out * level * _window(milliseconds)[:, None]


def _spin(rng: np.random.Generator, milliseconds: int) -> Array:
    out = np.zeros((milliseconds, 4))
    out[:, 2] = _there_and_back(milliseconds, _sign(rng) * rng.uniform(2.0, 5.0), 0.25)
    return out


def _steps(rng: np.random.Generator, milliseconds: int) -> Array:
    """Held random velocities on the three axes together."""
    end = milliseconds * 1e-3
    holds = 4
    level = rng.uniform(-1.0, 1.0, (holds, 3)) * np.array([0.4, 0.5, 1.8])
    level[2:] = -level[:2][::-1]
    out = np.zeros((milliseconds, 4))
    for axis in range(3):
        knots, values = [0.0], [0.0]
        for k in range(holds):
            knots += [(k + 0.6) * end / holds, (k + 1.0) * end / holds]
            values += [level[k, axis]] * 2
        values[-1] = 0.0
        out[:, axis] = _profile(milliseconds, knots, values)
    return out


def _twist(rng: np.random.Generator, milliseconds: int) -> Array:
    """Wheels work against each other: the body stays, the slip ramps through the friction curve."""
    end = milliseconds * 1e-3
    peak = _sign(rng) * rng.uniform(0.08, 0.35)
    out = np.zeros((milliseconds, 4))
    out[:, 3] = _profile(milliseconds, [0.0, 0.3 * end, 0.7 * end, end], [0.0, peak, -peak, 0.0])
    return out


def _hard(rng: np.random.Generator, milliseconds: int) -> Array:
    """Acceleration beyond the grip on x, y or a diagonal."""
    heading = rng.choice(np.arange(8)) * np.pi / 4.0
    speed = rng.uniform(0.8, 1.5)
    ramp = speed / rng.uniform(6.0, 12.0)
    run = _there_and_back(milliseconds, speed, ramp)
    out = np.zeros((milliseconds, 4))
    out[:, 0], out[:, 1] = np.cos(heading) * run, np.sin(heading) * run
    return out


def _slow(rng: np.random.Generator, milliseconds: int) -> Array:
    """Creeping reversals: dead zone, stiction, backlash."""
    t = np.arange(milliseconds) / milliseconds
    axis = int(rng.integers(0, 3))
    size = rng.uniform(0.04, 0.16) * (4.0 if axis == 2 else 1.0)
    triangle = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * int(rng.integers(2, 4)) * t))
    out = np.zeros((milliseconds, 4))
    out[:, axis] = size * triangle
    return out


def _headings(rng: np.random.Generator, milliseconds: int) -> Array:
    """A straight run in any direction while the body turns by up to a right angle."""
    out = np.zeros((milliseconds, 4))
    run = _there_and_back(milliseconds, rng.uniform(0.3, 0.9), 0.35)
    heading = rng.uniform(-np.pi, np.pi)
    out[:, 0], out[:, 1] = np.cos(heading) * run, np.sin(heading) * run
    end = milliseconds * 1e-3
    turn = rng.uniform(-0.5, 0.5) * np.pi / (0.7 * end)
    out[:, 2] = _profile(milliseconds, [0.0, 0.3 * end, 0.7 * end, end], [0.0, turn, turn, 0.0])
    return out


_RICH: tuple[Callable[[np.random.Generator, int], Array], ...] = (
    _multisine,
    _spin,
    _steps,
    _twist,
    _hard,
    _slow,
    _headings,
    _multisine,
    _hard,
)


def _rich(rng: np.random.Generator, milliseconds: int, deck: list[int]) -> Array:
    out = np.zeros((milliseconds, 4))
    for start in range(REST_MS, milliseconds - 400, _SEGMENT_MS):
        length = min(_SEGMENT_MS, milliseconds - start)
        if not deck:
            deck.extend(int(k) for k in rng.permutation(len(_RICH)))
        out[start : start + length] = _RICH[deck.pop()](rng, length)
    return out


def _ordinary(rng: np.random.Generator, milliseconds: int) -> Array:
    """Point-to-point driving between random places within 1.2 m, turning on the way."""
    out = np.zeros((milliseconds, 4))
    place, heading = np.zeros(2), 0.0
    for start in range(REST_MS, milliseconds - 400, _LEG_MS):
        length = min(_LEG_MS, milliseconds - start)
        bell = _profile(
            length, [0.0, 0.3e-3 * length, 0.7e-3 * length, 1e-3 * length], [0, 1, 1, 0]
        )
        path = np.cumsum(bell) / bell.sum()
        goal = rng.uniform(-1.2, 1.2, 2)
        turn = rng.uniform(-1.2, 1.2) if rng.random() < 0.6 else 0.0
        angle = heading + turn * path
        velocity = np.outer(bell / (bell.sum() * 1e-3), goal - place)
        leg = out[start : start + length]
        leg[:, 0] = np.cos(angle) * velocity[:, 0] + np.sin(angle) * velocity[:, 1]
        leg[:, 1] = -np.sin(angle) * velocity[:, 0] + np.cos(angle) * velocity[:, 1]
        leg[:, 2] = turn * bell / (bell.sum() * 1e-3)
        place, heading = goal, heading + turn
    return out


def _poor(rng: np.random.Generator, milliseconds: int) -> Array:
    """Forward and back on a straight line, nothing else."""
    out = np.zeros((milliseconds, 4))
    for start in range(REST_MS, milliseconds - 400, _LEG_MS):
        length = min(_LEG_MS, milliseconds - start)
        speed = rng.uniform(0.3, 1.2)
        out[start : start + length, 0] = _there_and_back(length, speed, 0.4)
    return out


def programme(
    rng: np.random.Generator, excitation: str, runs: int, milliseconds: int
) -> list[Array]:
    """`runs` references (milliseconds, 4).

    With four runs or more the last repeats the first, of eight or more the sixth repeats the third:
    replicates show the noise without a model.
    """
    deck: list[int] = []
    out: list[Array] = []
    for run in range(runs):
        if runs >= 4 and run == runs - 1:
            out.append(out[0])
        elif runs >= 8 and run == 5:
            out.append(out[2])
        elif excitation == "rich":
            out.append(_rich(rng, milliseconds, deck))
        else:
            out.append((_ordinary if excitation == "ordinary" else _poor)(rng, milliseconds))
    return out


def inverse_kinematics(believed: Mapping[str, float], bearing_rad: Array) -> Array:
    """J (4, 3): body velocity to hub speed along the drive directions."""
    lever = np.full(4, believed["robot.wheel_distance_m"])
    return np.stack([-np.sin(bearing_rad), np.cos(bearing_rad), lever], axis=1)


def shaft_reference(reference: Array, believed: Mapping[str, float], bearing_rad: Array) -> Array:
    """Shaft speeds (n, 4) in rad/s for a reference (n, 4)."""
    wheel_m_s = reference[:, :3] @ inverse_kinematics(believed, bearing_rad).T
    wheel_m_s = wheel_m_s + reference[:, 3:] * _NULL
    return wheel_m_s * believed["motor.gear_ratio"] / believed["robot.wheel_radius_m"]


def feed_forward_duty(reference: Array, believed: Mapping[str, float], bearing_rad: Array) -> Array:
    """Duty (n, 4) in -1..1: back-EMF, bearings, inertia, friction of the twist."""
    jacobian = inverse_kinematics(believed, bearing_rad)
    shaft = shaft_reference(reference, believed, bearing_rad)
    inertia = np.array([believed["robot.mass_kg"]] * 2 + [believed["robot.inertia_kg_m2"]])
    body_force = np.gradient(reference[:, :3], 1e-3, axis=0) * inertia
    force = body_force @ np.linalg.pinv(jacobian)
    load_n = believed["robot.mass_kg"] * believed["contact.gravity_m_s2"] / 4.0
    grip_n = load_n * believed["contact.mu_drive"]
    sliding = believed["contact.slip_stiffness_s_m"] * reference[:, 3:] * _NULL
    force = force + grip_n * 2.0 / np.pi * np.arctan(sliding)
    force = np.clip(force, -_MOST_GRIP * grip_n, _MOST_GRIP * grip_n)
    torque = force * believed["robot.wheel_radius_m"] / believed["motor.gear_ratio"]
    torque += np.gradient(shaft, 1e-3, axis=0) * believed["motor.inertia_kg_m2"]
    torque += shaft * believed["motor.viscous_friction_nm_s"]
    volt = torque * believed["motor.resistance_ohm"] / believed["motor.torque_constant_nm_a"]
    volt += shaft * believed["motor.back_emf_constant_v_s_rad"]
    return np.clip(volt / believed["motor.supply_v"], -1.0, 1.0)
