"""The dictionary of terms that a model may lack: where each pushes and on what it depends.

A term is a force, moment or torque on some states, or what sensors show besides, as a function of
state, command and time (leftover.py judges them). Most are laws that robots have and that no effect
of the catalogue is; the others are the shapes that effects have, for what is nearly one of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from omnislip.gap.answers import CHANCE_S
from omnislip.gap.machine import Machine, no_load_speed_rad_s
from omnislip.gap.recordings import of_encoders

Array = npt.NDArray[np.float64]
Of = Callable[[Array, Array], Array]
"""(state (rows, n), command (rows, motors)) -> (rows, motors)"""

SHAFT_ORDERS, WHEEL_ORDERS, HEADING_ORDERS = range(2, 13), range(1, 7), (1, 2)
SLOW_RAD_S, SLOW_M_S, SMALL_SHARE = 2.0, 0.05, 0.02
GYRO, CAMERA, CAMERA_HEADING = 4, (5, 6), 7
SUPPLY_LAGS_S, WARM_S, COMMAND_LAGS_S = (0.02, 0.2, 2.0), (0.5, 2.0, 8.0), (0.02, 0.1)
BEYOND_PERCENT = (75.0, 95.0)
EDGE_M, SLOW_YAW_RAD_S = 0.02, 0.05
SMOOTHED = 9
"""Rows over which a rate of change is taken."""
CHANGE_S, RIM_SHARES = 0.1, (0.3, 0.5, 0.7)
"""Of an odometry: over which its accelerations are taken, and beyond which speeds of a wheel's own
it may slip."""
EVERYWHERE = {"every wheel": (0, 1, 2, 3), **{f"wheel/{i + 1}": (i,) for i in range(4)}}
BEATING = ("world/force_x", "world/force_y", "every wheel/torque")


@dataclass(frozen=True)
class Quantity:
    """Something that a missing force may depend on; `period` where it comes back to itself."""

    name: str
    unit: str
    of: Callable[[Array, Array, Array, int], Array]
    """(state (rows, n), command (rows, motors), time (rows,), motor) -> (rows,)"""
    period: float | None = None
    frequency_hz: float | None = None
    """Of a wave: the quantity is then what the wave is in proportion to."""
    phases_rad: Array | None = None
    """Of a wave or an angle: its phase (runs,) where the log began: no beat waits for it."""


@dataclass(frozen=True)
class Term:
    """One entry of the dictionary: which states it pushes, and how it depends on state and time."""

    equation: str
    dependence: str
    states: tuple[int, ...]
    shape: Callable[[Array, Array, Array, int], Array]
    """(state (rows, n), command (rows, motors), time (rows,), pushed state) -> (rows,)"""
    outputs: tuple[int, ...] = ()
    """Sensors that show the term as it is, instead of states that it pushes."""
    jointly: str = ""
    """On what it depends together with others of its equation: two phases of a wave."""
    turning: bool = False
    """Whether that is an angle or time, which a log counts from where it began."""
    over: Quantity | None = None
    """What it is a wave over, or otherwise depends on."""
    swing: tuple[float, float] | None = None
    """Of a load that swings: its frequency in Hz and damping ratio."""

    @property
    def name(self) -> tuple[str, str]:
        """Equation and dependence."""
        return self.equation, self.dependence


def dictionary(machine: Machine) -> list[Term]:
    """Return the terms that are tried for a kind of machine."""
    if machine.kind == "odometry":
        return _odometry_terms(machine)
    if machine.kind == "axis":
        return [Term("axis/force", name, (0,), shape) for name, shape in SHAFT_SHAPES.items()]
    turn = {"the wheel angle": 1.0 / float(machine.model.values["motor.gear_ratio"])}
    terms = []
    for where, wheels in EVERYWHERE.items():
        terms += [
            Term(f"{where}/torque", name, wheels, shape) for name, shape in SHAFT_SHAPES.items()
        ]
        terms += _angle_terms(f"{where}/torque", SHAFT_ANGLE, states=wheels)
        terms += _angle_terms(f"{where}/friction", turn, wheels, factor=against_rotation)
        shown = where.replace("wheel", "encoder")
        terms += _angle_terms(f"{shown}/angle", SHAFT_ANGLE | TWICE_SHAFT_ANGLE, outputs=wheels)
    terms += [Term("gyro", name, (), shape, (GYRO,)) for name, shape in GYRO_SHAPES.items()]
    terms += [Term("camera", name, (), shape, CAMERA) for name, shape in CAMERA_SHAPES.items()]
    terms += [Term("body/moment", name, (10,), shape) for name, shape in YAW_SHAPES.items()]
    for axis, state in (("x", 8), ("y", 9)):
        terms += [
            Term(f"body/force_{axis}", name, (state,), shape) for name, shape in BODY_SHAPES.items()
        ]
        terms += [
            Term(f"world/force_{axis}", name, (8, 9), in_world(axis, shape))
            for name, shape in WORLD_SHAPES.items()
        ]
    return terms


def nameless(machine: Machine) -> list[Term]:
    """Return further terms of a robot: what no effect of the catalogue comes near."""
    angles = _wheel_angles(float(machine.model.values["motor.gear_ratio"]))
    no_load_rad_s = no_load_speed_rad_s(machine)
    of_motors = MOTOR_SHAPES | _current_shapes(no_load_rad_s)
    if machine.holds_commands:  # what moves within rows does the like of it
        of_motors |= HELD_SHAPES
    terms = [
        Term(f"{where}/torque", name, wheels, shape, over=Quantity(name, "1", shape))
        for where, wheels in EVERYWHERE.items()
        for name, shape in of_motors.items()
    ]
    for i in range(4):
        terms += _angle_terms(f"wheel/{i + 1}/torque", angles, states=(i,))
        terms += _angle_terms(f"encoder/{i + 1}/angle", angles, outputs=(i,))
        terms += _roller_terms(machine, i)
    terms += _heading_terms()
    return terms + [
        Term("every wheel/torque", name, (0, 1, 2, 3), shape, over=Quantity(name, "1", shape))
        for name, shape in _supply_shapes(no_load_rad_s).items()
    ]


def patterns(machine: Machine) -> list[Term]:
    """Return terms that no verdict needs: higher orders of the shaft, wheels against each other."""
    if machine.kind != "robot":
        return []
    many = {f"{order} times the shaft angle": float(order) for order in SHAFT_ORDERS}
    orders = [
        term for i in range(4) for term in _angle_terms(f"wheel/{i + 1}/torque", many, states=(i,))
    ]
    return orders + [
        Term("null space of the wheels/torque", name, (0, 1, 2, 3), shape)
        for name, shape in NULL_SPACE_SHAPES.items()
    ]


def turned(heading_rad: Array, vector: Array) -> Array:
    """Turn vectors (rows, 2) by angles (rows,): by headings from body to world."""
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return np.stack(
        [cos * vector[:, 0] - sin * vector[:, 1], sin * vector[:, 0] + cos * vector[:, 1]], axis=1
    )


def _shown_velocity(x: Array, output: int) -> Array:
    """Rate (rows,) of what a camera shows of the place: the velocity along an axis of the world."""
    return turned(x[:, 13], x[:, 8:10])[:, output - CAMERA[0]]


def _shaft(function: Callable[[Array, Array], Array]) -> Callable[..., Array]:
    return lambda x, d, t, i: function(x[:, i], d[:, i])


def _along(time_s: Array, values: Array) -> Array:
    """Rate of change, smoothed over some rows."""
    kernel = np.ones(SMOOTHED) / SMOOTHED
    return np.convolve(np.gradient(values, time_s), kernel, mode="same")


def _slows(time_s: Array, speed: Array) -> Array:
    """1 where a speed falls, 0 elsewhere: as it went until `CHANCE_S` before.

    What disturbs it later slows it, too, and would pass for a force that acts where it slows.
    """
    lead = SMOOTHED // 2 + round(CHANCE_S / float(np.median(np.diff(time_s))))
    falls = _along(time_s, speed**2) < 0.0
    return np.concatenate([np.zeros(lead), falls])[: len(falls)]


SHAFT_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": _shaft(lambda w, d: np.ones_like(w)),
    "direction of rotation": _shaft(lambda w, d: np.tanh(w / SLOW_RAD_S)),
    "speed": _shaft(lambda w, d: w),
    "speed squared, against it": _shaft(lambda w, d: w * np.abs(w)),
    "speed to the fifth": _shaft(lambda w, d: (w / 100.0) ** 5),
    "speed either way": _shaft(lambda w, d: np.abs(w)),
    "command": _shaft(lambda w, d: d),
    "command cubed": _shaft(lambda w, d: d**3),
    "sign of the command": _shaft(lambda w, d: np.sign(d)),
    "size of the command, against rotation": _shaft(
        lambda w, d: np.abs(d) * np.tanh(w / SLOW_RAD_S)
    ),
    "direction of rotation while it slows": lambda x, d, t, i: (
        np.tanh(x[:, i] / SLOW_RAD_S) * _slows(t, x[:, i])
    ),
    "time and command": lambda x, d, t, i: t * d[:, i],
    "time and speed": lambda x, d, t, i: t * x[:, i],
}

NULL_SPACE = np.array([1.0, -1.0, 1.0, -1.0])
"""Speeds of the wheels that move no body (model: V1 - V2 + V3 - V4 = 0)."""
NULL_SPACE_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": lambda x, d, t, i: np.full(len(x), NULL_SPACE[i]),
    "wheels that turn against each other": lambda x, d, t, i: (
        NULL_SPACE[i] * (x[:, :4] @ NULL_SPACE)
    ),
    "commands against each other": lambda x, d, t, i: NULL_SPACE[i] * (d @ NULL_SPACE),
}


def against_rotation(speed_rad_s: Array) -> Array:
    """Return the direction of friction on shafts, smooth about rest."""
    return -np.tanh(speed_rad_s / SLOW_RAD_S)


SHAFT_ANGLE, TWICE_SHAFT_ANGLE = {"the shaft angle": 1.0}, {"twice the shaft angle": 2.0}
WAVES = {"sine": np.sin, "cosine": np.cos}


def _wheel_angles(gear: float) -> dict[str, float]:
    """Return what comes back with each turn of the wheel, or some times in it, per shaft angle."""
    return {
        "the wheel angle" if order == 1 else f"{order} times the wheel angle": order / gear
        for order in WHEEL_ORDERS
    }


def _angle_terms(
    equation: str,
    angles: dict[str, float],
    states: tuple[int, ...] = (),
    outputs: tuple[int, ...] = (),
    factor: Callable[[Array], Array] = np.ones_like,
) -> list[Term]:
    """Waves over each of the angles, times a function of the shafts' speeds."""
    one_wheel = "every" not in equation  # each wheel stands where it stands
    terms = []
    for name, ratio in angles.items():

        def of(x: Array, d: Array, t: Array, i: int, ratio: float = ratio) -> Array:
            return ratio * x[:, 4 + i]

        terms += _two_phases(
            equation, name, of, lambda x, i: factor(x[:, i]), states, outputs, one_wheel
        )
    return terms


def _two_phases(
    equation: str,
    name: str,
    of: Callable[[Array, Array, Array, int], Array],
    factor: Callable[[Array, int], Array],
    states: tuple[int, ...],
    outputs: tuple[int, ...] = (),
    turning: bool = True,
) -> list[Term]:
    """Sine and cosine of an angle, times a function of the state and of what is pushed."""

    def shape(x: Array, d: Array, t: Array, i: int, wave: str) -> Array:
        return WAVES[wave](of(x, d, t, i)) * factor(x, i)

    angle = Quantity(name.removeprefix("the "), "rad", of, 2.0 * np.pi)
    return [
        Term(
            equation,
            f"{wave} of {name}",
            states,
            partial(shape, wave=wave),
            outputs,
            name,
            turning=turning,
            over=angle,
        )
        for wave in WAVES
    ]


def roller_friction(machine: Machine, wheel: int, x: Array) -> dict[int, Array]:
    """Return what a unit of friction of a wheel's rollers pushes: rates of the body (rows,).

    Along the rollers' way, which leads straight away from the centre, and turns nothing.
    """
    bearing = np.deg2rad(machine.model.values["robot.wheel_angles_deg"][wheel])
    along = np.array([np.cos(bearing), np.sin(bearing)])
    against = -np.tanh(x[:, 8:10] @ along / SLOW_M_S)
    return {8: against * along[0], 9: against * along[1]}


def _roller_terms(machine: Machine, wheel: int) -> list[Term]:
    """Rollers that turn badly at some places of a wheel."""
    gear = float(machine.model.values["motor.gear_ratio"])
    return _two_phases(
        f"wheel/{wheel + 1}/roller friction",
        "the wheel angle",
        lambda x, d, t, i: x[:, 4 + wheel] / gear,
        lambda x, state: roller_friction(machine, wheel, x)[state],
        (8, 9),
    )


def _heading_terms() -> list[Term]:
    """What a camera says of the heading besides: by that itself, by the place, or by time."""
    terms = [
        Term(
            "camera/heading", f"place {axis}", (), partial(_column, state=state), (CAMERA_HEADING,)
        )
        for axis, state in (("x", 11), ("y", 12))
    ]
    terms.append(Term("camera/heading", "time", (), lambda x, d, t, i: t, (CAMERA_HEADING,)))
    for order in HEADING_ORDERS:
        name = "the heading" if order == 1 else f"{order} times the heading"
        terms += _two_phases(
            "camera/heading",
            name,
            lambda x, d, t, i, order=order: order * x[:, 13],
            lambda x, i: np.ones(len(x)),
            (),
            (CAMERA_HEADING,),
            turning=False,
        )
    return terms


def _column(x: Array, d: Array, t: Array, i: int, state: int) -> Array:
    return x[:, state]


def hill_slope(off: Array) -> Array:
    """Return the slope (..., 2) of exp(-r^2 / 2), the wrong way round, at places (..., 2)."""
    return off * np.exp(-0.5 * np.sum(off**2, axis=-1, keepdims=True))


def hill_term(place_m: Array, width_m: float) -> Term:
    """A force away from a place (2,), as of a hill in the floor with sides of some width.

    Of a height h exp(-r^2 / 2 w^2) the slope: r / w exp(-r^2 / 2 w^2). A hollow pushes to it.
    """
    where = f"({place_m[0]:.2f}, {place_m[1]:.2f}) m"
    name = f"a hill or hollow at {where}, {width_m:.2g} m wide"
    return _placed_term(name, hill_slope, place_m, width_m)


def pull_to(off: Array) -> Array:
    """Return directions (..., 2) away from the middle of places (..., 2), smooth about it."""
    return off / np.sqrt(1.0 + np.sum(off**2, axis=-1, keepdims=True))


def pull_term(place_m: Array, width_m: float) -> Term:
    """A force towards a place (2,) or away from it, as strong from afar: a cable on a reel."""
    where = f"({place_m[0]:.2f}, {place_m[1]:.2f}) m"
    return _placed_term(f"direction to {where}", pull_to, place_m, width_m)


def _placed_term(
    dependence: str, push: Callable[[Array], Array], place_m: Array, width_m: float
) -> Term:
    """A force in the world that is a function of where a place is, in widths."""

    def force(x: Array, d: Array, t: Array, state: int) -> Array:
        pushed = push((x[:, 11:13] - place_m) / width_m)
        return turned(-x[:, 13], pushed)[:, state - 8]

    return Term("world/force", dependence, (8, 9), force)


def beyond_terms(machine: Machine, states: Array, commands: Array) -> list[Term]:
    """What sets in where motors draw, turn or are driven more than in most of some rows.

    Limits, trips and governors, whose thresholds nobody knows: of `states` (rows, n) with
    `commands` (rows, motors) as many as `BEYOND_PERCENT` are below.
    """
    no_load_rad_s = no_load_speed_rad_s(machine)
    quantities: dict[str, Of] = {
        "current": lambda x, d: _current(x, d, no_load_rad_s),
        "speed": lambda x, d: x[:, :4],
        "command": lambda x, d: d,
    }
    terms = []
    for name, of in quantities.items():
        for percent in BEYOND_PERCENT:
            least = float(np.percentile(np.abs(of(states, commands)), percent))

            def shape(
                x: Array, d: Array, t: Array, i: int, of: Of = of, least: float = least
            ) -> Array:
                value = of(x, d)[:, i]
                return np.sign(value) * np.maximum(np.abs(value) - least, 0.0)

            shown = f"{least:.3g}" + (" rad/s" if name == "speed" else " of full")
            dependence = f"{name} beyond {shown}"
            terms += [
                Term(f"{where}/torque", dependence, wheels, shape)
                for where, wheels in EVERYWHERE.items()
            ]
    return terms


def side_terms(axis: int, edge_m: float) -> list[Term]:
    """What a camera shows besides where another one begins to see: place and heading off a bit."""

    def side(x: Array, d: Array, t: Array, i: int) -> Array:
        return np.tanh((x[:, 11 + axis] - edge_m) / EDGE_M)

    dependence = f"side of {'xy'[axis]} = {edge_m:.2f} m"
    return [
        Term(f"camera/{shown}", dependence, (), side, (output,))
        for shown, output in zip(("x", "y", "heading"), (*CAMERA, CAMERA_HEADING), strict=True)
    ]


HELD_SHAPES: dict[str, Callable[..., Array]] = {
    "change of the command, by its size": lambda x, d, t, i: (
        np.mean(np.abs(d), axis=1) * np.diff(d[:, i], prepend=d[0, i])
    ),
}
MOTOR_SHAPES: dict[str, Callable[..., Array]] = {
    **{
        f"command of the {name} wheel": lambda x, d, t, i, further=further: d[:, (i + further) % 4]
        for further, name in ((1, "next"), (2, "opposite"), (3, "previous"))
    },
    **{
        f"command, {lag_s:g} s late": lambda x, d, t, i, lag_s=lag_s: _late(t, d[:, i], lag_s)
        for lag_s in COMMAND_LAGS_S
    },
    "angle turned, against rotation": lambda x, d, t, i: (
        x[:, 4 + i] * np.tanh(x[:, i] / SLOW_RAD_S)
    ),
}


def _current(x: Array, d: Array, no_load_rad_s: float) -> Array:
    """Currents (rows, motors) as shares of that at rest and full duty."""
    return d - x[:, :4] / no_load_rad_s


def _late(time_s: Array, values: Array, lag_s: float) -> Array:
    share = 1.0 - np.exp(-np.median(np.diff(time_s)) / lag_s)
    return lfilter([share], [1.0, share - 1.0], values)


def _current_shapes(no_load_rad_s: float) -> dict[str, Callable[..., Array]]:
    """Brushes, iron that saturates, what changes as a motor warms."""

    def current(x: Array, d: Array, i: int) -> Array:
        return _current(x, d, no_load_rad_s)[:, i]

    def warm(x: Array, d: Array, t: Array, i: int, lag_s: float) -> Array:
        return _late(t, current(x, d, i) ** 2, lag_s)

    shapes: dict[str, Callable[..., Array]] = {
        "direction of the current": lambda x, d, t, i: np.tanh(current(x, d, i) / SMALL_SHARE),
        "current cubed": lambda x, d, t, i: current(x, d, i) ** 3,
    }
    for lag_s in WARM_S:
        shapes[f"current, as it warms the motor in {lag_s:g} s"] = lambda x, d, t, i, lag_s=lag_s: (
            current(x, d, i) * warm(x, d, t, i, lag_s)
        )
        shapes[f"direction of rotation, as the motor warms in {lag_s:g} s"] = (
            lambda x, d, t, i, lag_s=lag_s: np.tanh(x[:, i] / SLOW_RAD_S) * warm(x, d, t, i, lag_s)
        )
    return shapes


def _supply_shapes(no_load_rad_s: float) -> dict[str, Callable[..., Array]]:
    """A supply that answers the current late: what all motors draw, smoothed, lowers all duties."""

    def late(x: Array, d: Array, t: Array, i: int, lag_s: float) -> Array:
        drawn = np.sum(d * _current(x, d, no_load_rad_s), axis=1)
        return d[:, i] * _late(t, drawn, lag_s)

    return {
        f"command and the current of all, {lag_s:g} s late": partial(late, lag_s=lag_s)
        for lag_s in SUPPLY_LAGS_S
    }


def swings(time_s: Array, speed: Array, swing_hz: float, damping: float, part: str) -> Array:
    """Place or speed of a load on a spring beside what carries it with a `speed`, as accelerations.

    Its place y obeys y'' + 2 z w y' + w^2 y = -(speed)': w^2 y, or w y'.
    """
    w, c = 2 * np.pi * swing_hz, 2.0 / np.median(np.diff(time_s))  # s = c (1 - 1/z) / (1 + 1/z)
    if part == "place":
        above = -(w**2) * c * np.array([1.0, 0.0, -1.0])
    else:
        above = -w * c**2 * np.array([1.0, -2.0, 1.0])
    fades = 2 * damping * w * c
    below = np.array([c**2 + fades + w**2, 2 * (w**2 - c**2), c**2 - fades + w**2])
    return lfilter(above, below, speed - speed[0])


def swing_terms(kind: str, swing_hz: float, damping: float) -> list[Term]:
    """What a load that swings in the body does to it, by its place and by its speed.

    Or what a camera shows of a marker that swings.
    """

    def shown(x: Array, d: Array, t: Array, output: int, part: str) -> Array:
        return swings(t, _shown_velocity(x, output), swing_hz, damping, part)

    def force(x: Array, d: Array, t: Array, state: int, part: str) -> Array:
        velocity = turned(x[:, 13], x[:, 8:10])
        own = [swings(t, speed, swing_hz, damping, part) for speed in velocity.T]
        return turned(-x[:, 13], np.stack(own, axis=1))[:, state - 8]

    def moment(x: Array, d: Array, t: Array, state: int, part: str) -> Array:
        return swings(t, x[:, state], swing_hz, damping, part)

    states, outputs, shape = {
        "world/force": ((8, 9), (), force),
        "body/moment": ((10,), (), moment),
        "camera": ((), CAMERA, shown),
    }[kind]
    what = "load" if states else "marker"
    load = f"a {what} that swings at {swing_hz:.3g} Hz, damping ratio {damping:g}"
    return [
        Term(
            kind,
            f"{part} of {load}",
            states,
            partial(shape, part=part),
            outputs,
            load,
            swing=(swing_hz, damping),
        )
        for part in ("place", "speed")
    ]


def wave_term(axis: str, number_1_m: Array, phase_rad: float) -> Term:
    """A force along a world axis that is a wave in place, of a wave vector (2,)."""

    def wave(x: Array, t: Array) -> Array:
        return np.cos(x[:, 11:13] @ number_1_m + phase_rad)

    way_deg, length_m = np.rad2deg(np.arctan2(*number_1_m[::-1])), 2 * np.pi / np.hypot(*number_1_m)
    along = Quantity(
        f"place along {way_deg:.0f} deg",
        "m",
        lambda x, d, t, i: x[:, 11:13] @ number_1_m * length_m / (2 * np.pi),
        length_m,
    )
    dependence = f"a wave of {length_m:.2g} m along {way_deg:.0f} deg"
    return Term(f"world/force_{axis}", dependence, (8, 9), in_world(axis, wave), over=along)


def beat_terms(equation: str, beat_hz: float) -> list[Term]:
    """Two phases of a beat in time, of the world's forces or in proportion to the commands."""
    by_command = equation == BEATING[-1]
    states = (0, 1, 2, 3) if by_command else (8, 9)
    name = f"a beat of {beat_hz:.3g} Hz" + (" times the command" if by_command else "")

    def shape(x: Array, d: Array, t: Array, i: int, wave: Callable[[Array], Array]) -> Array:
        beat = wave(2 * np.pi * beat_hz * t)
        if by_command:
            return d[:, i] * beat
        return in_world(equation[-1], lambda x, t: beat)(x, d, t, i)

    weight = Quantity(
        "the command" if by_command else "",
        "1",
        lambda x, d, t, i: d[:, i] if by_command else np.ones(len(x)),
        frequency_hz=beat_hz,
    )
    return [
        Term(
            equation,
            f"{own} of {name}",
            states,
            partial(shape, wave=wave),
            (),
            name,
            turning=True,
            over=weight,
        )
        for own, wave in WAVES.items()
    ]


GYRO_SHAPES: dict[str, Callable[..., Array]] = {
    "acceleration along x": lambda x, d, t, i: _along(t, x[:, 8]) - x[:, 10] * x[:, 9],
    "acceleration along y": lambda x, d, t, i: _along(t, x[:, 9]) + x[:, 10] * x[:, 8],
    "speed along x": lambda x, d, t, i: x[:, 8],
    "speed along y": lambda x, d, t, i: x[:, 9],
    "yaw rate squared": lambda x, d, t, i: x[:, 10] * np.abs(x[:, 10]),
    "slow yaw rate": lambda x, d, t, i: x[:, 10] * np.exp(-((x[:, 10] / SLOW_YAW_RAD_S) ** 2)),
    "shaft speeds squared": lambda x, d, t, i: np.mean(x[:, :4] ** 2, axis=1),
    "time": lambda x, d, t, i: t,
}

CAMERA_SHAPES: dict[str, Callable[..., Array]] = {
    "distance from the middle": lambda x, d, t, i: (
        x[:, 6 + i] * (x[:, 11] ** 2 + x[:, 12] ** 2)  # sensors 5 and 6 show states 11 and 12
    ),
    "place x": lambda x, d, t, i: x[:, 6 + i] * x[:, 11],
    "place y": lambda x, d, t, i: x[:, 6 + i] * x[:, 12],
    "axis": lambda x, d, t, i: x[:, 6 + i] * (1.0 if i == 5 else -1.0),
    "time, along x": lambda x, d, t, i: t * (i == 5),
    "time, along y": lambda x, d, t, i: t * (i == 6),
    "velocity at place x, as of a row that is read later": lambda x, d, t, i: (
        _shown_velocity(x, i) * x[:, 11]
    ),
    "velocity at place y, as of a row that is read later": lambda x, d, t, i: (
        _shown_velocity(x, i) * x[:, 12]
    ),
    "heading, as of a marker ahead of the centre": lambda x, d, t, i: np.cos(
        x[:, 13] - (i == 6) * np.pi / 2
    ),
    "heading, as of a marker beside the centre": lambda x, d, t, i: np.cos(
        x[:, 13] - (i == 6) * np.pi / 2 + np.pi / 2
    ),
}
"""What a camera shows besides. In proportion to the place: a lens that bends, a camera that looks
askew, axes of two scales. With the heading: a marker that is not at the robot's centre. With time:
a camera or a floor that moves."""

YAW_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": lambda x, d, t, i: np.ones(len(x)),
    "direction of turning": lambda x, d, t, i: np.tanh(x[:, 10] / 0.05),
    "yaw rate": lambda x, d, t, i: x[:, 10],
    "yaw rate squared, against it": lambda x, d, t, i: x[:, 10] * np.abs(x[:, 10]),
    "speed along x": lambda x, d, t, i: x[:, 8],
    "speed along y": lambda x, d, t, i: x[:, 9],
    "speed along x squared, against it": lambda x, d, t, i: x[:, 8] * np.abs(x[:, 8]),
    "speed along y squared, against it": lambda x, d, t, i: x[:, 9] * np.abs(x[:, 9]),
    "speed along x and y": lambda x, d, t, i: x[:, 8] * x[:, 9],
    "speed either way": lambda x, d, t, i: np.hypot(x[:, 8], x[:, 9]),
    "yaw rate and speed along x": lambda x, d, t, i: x[:, 10] * x[:, 8],
    "yaw rate and speed along y": lambda x, d, t, i: x[:, 10] * x[:, 9],
    "place x": lambda x, d, t, i: x[:, 11],
    "place y": lambda x, d, t, i: x[:, 12],
    "time": lambda x, d, t, i: t,
}
"""Moments. By both speeds: a long body that goes aslant through air or over a carpet turns across
its way (Munk), by 30 mN m at 0.3 m/s in one set of logs, less than its noise: without this term
there was no gap in them, with it that gains 1,049."""

BODY_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": lambda x, d, t, i: np.ones(len(x)),
    "own speed": lambda x, d, t, i: x[:, i],
    "own speed squared, against it": lambda x, d, t, i: x[:, i] * np.abs(x[:, i]),
    "own speed cubed": lambda x, d, t, i: x[:, i] ** 3,
    "own speed while it slows": lambda x, d, t, i: x[:, i] * _slows(t, x[:, i]),
    "speed across": lambda x, d, t, i: x[:, 17 - i],
    "speed across squared": lambda x, d, t, i: x[:, 17 - i] ** 2,
    "speed along and across": lambda x, d, t, i: x[:, 8] * x[:, 9],
    "yaw rate": lambda x, d, t, i: x[:, 10],
    "yaw rate squared": lambda x, d, t, i: x[:, 10] ** 2,
    "yaw rate and own speed": lambda x, d, t, i: x[:, 10] * x[:, i],
    "yaw rate and speed across": lambda x, d, t, i: x[:, 10] * x[:, 17 - i],
    "time and speed": lambda x, d, t, i: t * x[:, i],
}

WORLD_SHAPES: dict[str, Callable[[Array, Array], Array]] = {
    "constant": lambda x, t: np.ones(len(x)),
    "place x": lambda x, t: x[:, 11],
    "place y": lambda x, t: x[:, 12],
    "time": lambda x, t: t,
}


def in_world(axis: str, shape: Callable[[Array, Array], Array]) -> Callable[..., Array]:
    """A force along a world axis, turned into the body frame."""

    def pushed(x: Array, d: Array, t: Array, state: int) -> Array:
        heading = x[:, 13] if axis == "x" else x[:, 13] - np.pi / 2
        part = np.cos(heading) if state == 8 else -np.sin(heading)
        return shape(x, t) * part

    return pushed


OfMotion = Callable[[Array, Array], Array]
"""(velocity (rows, 3) along, across, turning as encoders have it, time (rows,)) -> (rows,)"""
OfRim = Callable[[Array, Array, Array], Array]
"""(rate of a wheel (rows,), velocity (rows, 3) as above, time (rows,)) -> (rows,)"""


def _changing(speed: Array, t: Array) -> Array:
    """Return how fast a speed (rows,) changes, over a time that noise leaves alone."""
    rows = max(1, round(CHANGE_S / float(np.median(np.diff(t)))))
    return np.abs(np.gradient(uniform_filter1d(speed, rows), t))


MOTION_SHAPES: dict[str, OfMotion] = {
    "constant": lambda v, t: np.ones(len(v)),
    "speed along": lambda v, t: v[:, 0],
    "speed across": lambda v, t: v[:, 1],
    "turning": lambda v, t: v[:, 2],
    "size of the speed along": lambda v, t: np.abs(v[:, 0]),
    "size of the speed across": lambda v, t: np.abs(v[:, 1]),
    "size of the turning": lambda v, t: np.abs(v[:, 2]),
    "turning and speed along": lambda v, t: v[:, 2] * v[:, 0],
    "turning and speed across": lambda v, t: v[:, 2] * v[:, 1],
    "direction of the speed along": lambda v, t: np.tanh(v[:, 0] / 0.02),
    "direction of the speed across": lambda v, t: np.tanh(v[:, 1] / 0.02),
    "direction of turning": lambda v, t: np.tanh(v[:, 2] / 0.05),
    "time and speed along": lambda v, t: t * v[:, 0],
    "time and speed across": lambda v, t: t * v[:, 1],
    "time and turning": lambda v, t: t * v[:, 2],
}

DRIFT_SHAPES: dict[str, OfMotion] = {
    "constant": lambda v, t: np.ones(len(v)),
    "speed": lambda v, t: np.hypot(v[:, 0], v[:, 1]),
    "size of the turning": lambda v, t: np.abs(v[:, 2]),
}
"""Of what is fixed to the world: a floor that moves, the nap of a carpet."""


def _beyond(share: float) -> OfRim:
    return lambda u, v, t: u * (np.abs(u) > share * np.max(np.abs(u)))


def _uneven(wave: Callable[[Array], Array], order: int) -> OfRim:
    """A wheel out of round, `order` times a turn, from where a log begins."""

    def shape(u: Array, v: Array, t: Array) -> Array:
        turned = np.append(0.0, np.cumsum(u[:-1] * np.diff(t)))
        return u * wave(order * turned)

    return shape


RIM_SHAPES: dict[str, OfRim] = {
    "size of its speed": lambda u, v, t: np.abs(u),
    "speed squared, against it": lambda u, v, t: u * np.abs(u),
    "speed while the robot turns left": lambda u, v, t: u * (v[:, 2] > 0),
    "speed, as it changes": lambda u, v, t: u * _changing(u, t),
    **{f"speed beyond {share:.0%} of its fastest": _beyond(share) for share in RIM_SHARES},
}
"""Of a wheel that slips or whose encoder errs."""


def _odometry_terms(machine: Machine) -> list[Term]:
    """Return velocities beside those of the encoders: of the body, the floor, each wheel's rim."""
    per_rate = of_encoders(machine)
    wheels = range(machine.wheels)

    def term(
        equation: str,
        name: str,
        velocity: OfMotion,
        states: tuple[int, ...] = (0, 1, 2),
        fixed: bool = False,
    ) -> Term:
        """A velocity (rows, 3) by (command, time), along the axes of the body or (fixed) of the
        world, that moves these states."""

        def pushed(x: Array, u: Array, t: Array, state: int) -> Array:
            v = velocity(u, t)
            if state == 2 or fixed:
                return v[:, state]
            return turned(x[:, 2], v[:, :2])[:, state]

        return Term(equation, name, states, pushed)

    def along(part: int, shape: OfMotion) -> OfMotion:
        return lambda u, t: np.eye(3)[part] * shape(u @ per_rate, t)[:, None]

    def of_rims(own: Sequence[int], shape: OfRim) -> OfMotion:
        def velocity(u: Array, t: Array) -> Array:
            v = u @ per_rate
            return np.stack([shape(u[:, i], v, t) for i in own], axis=1) @ per_rate[own]

        return velocity

    motion = [
        term(f"odometry/{equation}", name, along(part, shape), states)
        for part, (equation, states) in enumerate(
            (("forward", (0, 1)), ("lateral", (0, 1)), ("turning", (2,)))
        )
        for name, shape in MOTION_SHAPES.items()
    ]
    drift = [
        term(f"floor/speed_{axis}", name, along(part, shape), (part,), fixed=True)
        for part, axis in enumerate("xy")
        for name, shape in DRIFT_SHAPES.items()
    ]
    rims = {"every wheel": list(wheels), **{f"wheel/{i + 1}": [i] for i in wheels}}
    slips = [
        term(f"{where}/rim speed", name, of_rims(own, shape))
        for where, own in rims.items()
        for name, shape in RIM_SHAPES.items()
    ]
    uneven = [
        replace(
            term(f"wheel/{i + 1}/rim speed", f"{wave} of {name}", of_rims([i], _uneven(of, order))),
            jointly=name,
            turning=True,
        )
        for i in wheels
        for order, name in ((1, "the wheel angle"), (2, "twice the wheel angle"))
        for wave, of in WAVES.items()
    ]
    return [*motion, *drift, *slips, *uneven]
