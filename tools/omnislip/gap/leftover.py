"""Is anything left that no effect of the catalogue explains?

A missing term is a force, moment or torque that depends on the state. Along the filtered states of
the final model every term of a small dictionary (equation x wheel pattern x dependence) is a known
function of time; what it would do to the innovations is linear in its size (`whitened_response` in
rows.py derives it); a term of a sensor is added to what it shows. Each term is tested like an
effect: gain T over what the fitted parameters leave, inflation by block sums, and the gain on each
run by the size that fits the others. A term that passes says where something is missing and on what
it depends, not what it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip.gap.inference import (
    Data,
    Fit,
    check_columns,
    free_of_fitted,
    inflation_of,
    left_by_shapes,
)
from omnislip.gap.machine import CURVE, Candidate, Machine
from omnislip.gap.noise import track_all
from omnislip.gap.recordings import Run
from omnislip.gap.side_by_side import side_by_side

Array = npt.NDArray[np.float64]

P_VALUE = 1e-6
"""Over all terms. To say that no known effect is the cause takes more than to name one."""
UNKNOWN_SHARE, CURVE_SHARE = 0.01, 1e-3
"""Square of how far the plant may be off an effect's shape, and off the friction curve's, which has
parameters enough for it. A term that gains more than they leave makes the verdict unknown: names
are right in place perhaps, but wrong in shape."""
IN_ITS_PLACE = 0.5
"""Share of an effect's gain that a term must take over to stand in its place."""
MOST_SHAPES = 5
SHAFT_ORDERS = range(2, 13)
SLOW_RAD_S = 2.0
GYRO, CAMERA = 4, (5, 6)


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


@dataclass(frozen=True)
class Leftover:
    """A term that is missing: where, on what it depends, and how surely.

    `covered` is the gain that the effects of the model may leave to it by their shapes.
    """

    equation: str
    dependence: str
    gain: float
    inflation: float
    p_value: float
    validation_gain: float
    covered: float


@dataclass(frozen=True)
class Shape:
    """A nameless term, or one along both axes of the body, and its gain alone on some model."""

    equation: str
    dependence: str
    gain: float


def dictionary(machine: Machine) -> list[Term]:
    """Return the terms that are tried for a kind of machine."""
    if machine.kind == "odometry":
        return [
            Term(f"odometry/{part}", name, (0, 1, 2), _of_odometry(machine, index, shape))
            for index, part in enumerate(("forward", "lateral", "turning"))
            for name, shape in MOTION_SHAPES.items()
        ]
    if machine.kind == "axis":
        return [Term("axis/force", name, (0,), shape) for name, shape in SHAFT_SHAPES.items()]
    rubbing = _rubbing_shapes(float(machine.model.values["motor.gear_ratio"]))
    terms = [
        Term(equation, name, states, shape)
        for equation, states in {
            "every wheel/torque": (0, 1, 2, 3),
            **{f"wheel/{i + 1}/torque": (i,) for i in range(4)},
        }.items()
        for name, shape in {**SHAFT_SHAPES, **ANGLE_SHAPES, **rubbing}.items()
    ]
    terms += [Term("gyro", name, (), shape, (GYRO,)) for name, shape in GYRO_SHAPES.items()]
    terms += [Term("camera", name, (), shape, CAMERA) for name, shape in CAMERA_SHAPES.items()]
    terms += [
        Term(equation, name, (), shape, outputs)
        for equation, outputs in {
            "every encoder/angle": (0, 1, 2, 3),
            **{f"encoder/{i + 1}/angle": (i,) for i in range(4)},
        }.items()
        for name, shape in {**ANGLE_SHAPES, **TWICE_SHAPES}.items()
    ]
    terms += [Term("body/moment", name, (10,), shape) for name, shape in YAW_SHAPES.items()]
    for axis, state in (("x", 8), ("y", 9)):
        terms += [
            Term(f"body/force_{axis}", name, (state,), shape) for name, shape in BODY_SHAPES.items()
        ]
        terms += [
            Term(f"world/force_{axis}", name, (8, 9), _in_world(axis, shape))
            for name, shape in WORLD_SHAPES.items()
        ]
    return terms


def find_leftover(data: Data, fitted: Fit, free: Array) -> list[Leftover]:
    """Return the terms that pass, strongest first; `free` are the responses to them."""
    return _passing(data, fitted, dictionary(data.machine), free)


def find_shapes(data: Data, refit: Fit) -> list[Leftover]:
    """Return what the gap of a model without its effects looks like: the best term per equation.

    To see, not to judge: terms that tell parity, order of the shaft, frame and null space apart.
    """
    best: dict[str, Leftover] = {}
    terms = [*dictionary(data.machine), *_patterns(data.machine)]
    for found in _passing(data, refit, terms, responses(data, refit, terms)):
        best.setdefault(found.equation, found)
    return list(best.values())[:MOST_SHAPES]


def _patterns(machine: Machine) -> list[Term]:
    """Return terms that no verdict needs: higher orders of the shaft, wheels against each other."""
    if machine.kind != "robot":
        return []
    orders = [
        Term(f"wheel/{i + 1}/torque", f"{name} of {order} times the shaft angle", (i,), shape)
        for i in range(4)
        for order in SHAFT_ORDERS
        for name, shape in _order_shapes(order).items()
    ]
    return orders + [
        Term("null space of the wheels/torque", name, (0, 1, 2, 3), shape)
        for name, shape in NULL_SPACE_SHAPES.items()
    ]


def _order_shapes(order: int) -> dict[str, Callable[..., Array]]:
    return {
        "sine": lambda x, d, t, i: np.sin(order * x[:, 4 + i]),
        "cosine": lambda x, d, t, i: np.cos(order * x[:, 4 + i]),
    }


def shapes_instead(
    data: Data, final: Fit, free: Array, without: Sequence[Fit]
) -> list[Shape | None]:
    """Return for each model without one effect what explains most in the place of that.

    `free` are the final model's responses to the dictionary. A term counts that loses most of its
    own gain beside the effect, and gains it without: what is missing besides is no matter of the
    name. None where no term does.
    """
    terms = dictionary(data.machine)
    beside = _gains_of_shapes(final, free, terms)
    gains = side_by_side(
        lambda one: _gains_of_shapes(one, responses(data, one, terms), terms), without
    )
    found = []
    for one, alone in zip(without, gains, strict=True):
        named = one.objective - final.objective
        instead = [
            Shape(*name, gain)
            for name, gain in alone.items()
            if gain - beside[name] > IN_ITS_PLACE * named
        ]
        found.append(max(instead, key=lambda shape: shape.gain, default=None))
    return found


def _gains_of_shapes(
    fitted: Fit, free: Array, terms: Sequence[Term]
) -> dict[tuple[str, str], float]:
    """Gain of each term alone, and of each of the body along both of its axes."""
    places = {(term.equation, term.dependence): [k] for k, term in enumerate(terms)}
    for (equation, dependence), [k] in list(places.items()):
        if equation == "body/force_x":
            across = places["body/force_y", dependence]
            places["body/force", dependence] = [k, *across]
    gains = {}
    for name, own in places.items():
        column = free[:, own]
        slope = column.T @ fitted.residual
        gains[name] = float(slope @ np.linalg.pinv(column.T @ column, hermitian=True) @ slope)
    return gains


def responses(data: Data, fitted: Fit, terms: Sequence[Term]) -> Array:
    """Return what a unit of each term changes of residuals (m, terms) beside what was fitted."""
    values = fitted.hypothesis.flat(data.believed)
    tracks = track_all(data.machine, data.runs, values, data.noise, keep_linear=True)
    columns = data.responses(tracks, lambda _, run, state: _pushes(state, run, terms))
    return free_of_fitted(fitted, columns)


def _passing(data: Data, fitted: Fit, terms: Sequence[Term], free: Array) -> list[Leftover]:
    found = []
    for index, term in enumerate(terms):
        column = free[:, index : index + 1]
        information = column.T @ column
        if information[0, 0] <= 0:
            continue
        size = -float(column[:, 0] @ fitted.residual) / float(information[0, 0])
        gain = size**2 * float(information[0, 0])
        after = fitted.residual + size * column[:, 0]
        inflation = inflation_of(data, column, after, information)
        p_value = float(chi2.sf(gain / inflation, 1)) * len(terms)
        if p_value >= P_VALUE:
            continue
        check = check_columns(data, fitted.residual, column)
        if check.helps:
            found.append(
                Leftover(
                    term.equation,
                    term.dependence,
                    gain,
                    inflation,
                    min(p_value, 1.0),
                    check.gain,
                    left_by_shapes(data, fitted, column[:, 0], fitted.residual, _covered_share),
                )
            )
    return sorted(found, key=lambda leftover: -leftover.gain)


def _covered_share(effect: Candidate) -> float:
    return CURVE_SHARE if effect.effect == CURVE else UNKNOWN_SHARE


def _pushes(state: Array, run: Run, terms: Sequence[Term]) -> tuple[Array, Array]:
    """What a unit of each term adds: rates of the states (rows, states, terms), and outputs."""
    push = np.zeros((*state.shape, len(terms)))
    shown = np.zeros((*run.outputs.shape, len(terms)))
    time_s = run.time_s
    for index, term in enumerate(terms):
        for pushed in term.states:
            push[:, pushed, index] = term.shape(state, run.command, time_s, pushed)
        for output in term.outputs:
            shown[:, output, index] = term.shape(state, run.command, time_s, output)
    shown[np.isnan(run.outputs)] = 0.0
    return push, shown


def _shaft(function: Callable[[Array, Array], Array]) -> Callable[..., Array]:
    return lambda x, d, t, i: function(x[:, i], d[:, i])


def _along(time_s: Array, values: Array) -> Array:
    """Rate of change, smoothed over some rows."""
    kernel = np.ones(9) / 9
    return np.convolve(np.gradient(values, time_s), kernel, mode="same")


def _slows(time_s: Array, speed: Array) -> Array:
    """1 where a speed falls, 0 elsewhere."""
    return (_along(time_s, speed**2) < 0.0).astype(np.float64)


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

ANGLE_SHAPES: dict[str, Callable[..., Array]] = {
    "sine of the shaft angle": lambda x, d, t, i: np.sin(x[:, 4 + i]),
    "cosine of the shaft angle": lambda x, d, t, i: np.cos(x[:, 4 + i]),
}


TWICE_SHAPES = {
    f"{name} of twice the shaft angle": shape for name, shape in _order_shapes(2).items()
}


def _rubbing_shapes(gear: float) -> dict[str, Callable[..., Array]]:
    """Friction that changes once per turn of the wheel."""
    return {
        f"{name} of the wheel angle, against rotation": lambda x, d, t, i, wave=wave: (
            wave(x[:, 4 + i] / gear) * np.tanh(x[:, i] / SLOW_RAD_S)
        )
        for name, wave in (("sine", np.sin), ("cosine", np.cos))
    }


GYRO_SHAPES: dict[str, Callable[..., Array]] = {
    "acceleration along x": lambda x, d, t, i: _along(t, x[:, 8]) - x[:, 10] * x[:, 9],
    "acceleration along y": lambda x, d, t, i: _along(t, x[:, 9]) + x[:, 10] * x[:, 8],
    "speed along x": lambda x, d, t, i: x[:, 8],
    "speed along y": lambda x, d, t, i: x[:, 9],
    "yaw rate squared": lambda x, d, t, i: x[:, 10] * np.abs(x[:, 10]),
    "time": lambda x, d, t, i: t,
}

CAMERA_SHAPES: dict[str, Callable[..., Array]] = {
    "distance from the middle": lambda x, d, t, i: (
        x[:, 6 + i] * (x[:, 11] ** 2 + x[:, 12] ** 2)  # sensors 5 and 6 show states 11 and 12
    ),
    "place x": lambda x, d, t, i: x[:, 6 + i] * x[:, 11],
    "place y": lambda x, d, t, i: x[:, 6 + i] * x[:, 12],
    "axis": lambda x, d, t, i: x[:, 6 + i] * (1.0 if i == 5 else -1.0),
    "heading, as of a marker ahead of the centre": lambda x, d, t, i: np.cos(
        x[:, 13] - (i == 6) * np.pi / 2
    ),
    "heading, as of a marker beside the centre": lambda x, d, t, i: np.cos(
        x[:, 13] - (i == 6) * np.pi / 2 + np.pi / 2
    ),
}
"""What a camera shows besides. In proportion to the place: a lens that bends, a camera that looks
askew, axes of two scales. With the heading: a marker that is not at the robot's centre."""

YAW_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": lambda x, d, t, i: np.ones(len(x)),
    "direction of turning": lambda x, d, t, i: np.tanh(x[:, 10] / 0.05),
    "yaw rate": lambda x, d, t, i: x[:, 10],
    "yaw rate squared, against it": lambda x, d, t, i: x[:, 10] * np.abs(x[:, 10]),
    "speed along x": lambda x, d, t, i: x[:, 8],
    "speed along y": lambda x, d, t, i: x[:, 9],
    "place x": lambda x, d, t, i: x[:, 11],
    "place y": lambda x, d, t, i: x[:, 12],
    "time": lambda x, d, t, i: t,
}

BODY_SHAPES: dict[str, Callable[..., Array]] = {
    "constant": lambda x, d, t, i: np.ones(len(x)),
    "own speed": lambda x, d, t, i: x[:, i],
    "own speed squared, against it": lambda x, d, t, i: x[:, i] * np.abs(x[:, i]),
    "own speed cubed": lambda x, d, t, i: x[:, i] ** 3,
    "own speed while it slows": lambda x, d, t, i: x[:, i] * _slows(t, x[:, i]),
    "speed across": lambda x, d, t, i: x[:, 17 - i],
    "speed along and across": lambda x, d, t, i: x[:, 8] * x[:, 9],
    "yaw rate": lambda x, d, t, i: x[:, 10],
    "yaw rate and speed across": lambda x, d, t, i: x[:, 10] * x[:, 17 - i],
    "time and speed": lambda x, d, t, i: t * x[:, i],
}

WORLD_SHAPES: dict[str, Callable[[Array, Array], Array]] = {
    "constant": lambda x, t: np.ones(len(x)),
    "place x": lambda x, t: x[:, 11],
    "place y": lambda x, t: x[:, 12],
    "wave along x": lambda x, t: np.sin(6.0 * x[:, 11]),
    "wave along y": lambda x, t: np.sin(6.0 * x[:, 12]),
    "time": lambda x, t: t,
}


def _in_world(axis: str, shape: Callable[[Array, Array], Array]) -> Callable[..., Array]:
    """A force along a world axis, turned into the body frame."""

    def pushed(x: Array, d: Array, t: Array, state: int) -> Array:
        heading = x[:, 13] if axis == "x" else x[:, 13] - np.pi / 2
        part = np.cos(heading) if state == 8 else -np.sin(heading)
        return shape(x, t) * part

    return pushed


MOTION_SHAPES: dict[str, Callable[[Array, Array], Array]] = {
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


def _of_odometry(
    machine: Machine, part: int, shape: Callable[[Array, Array], Array]
) -> Callable[..., Array]:
    """A velocity of the body (forward, lateral, turning) beside the one of the encoders.

    `shape` sees that one (rows, 3), as the believed geometry has it.
    """
    wheels, engine = machine.wheels, machine.engine
    unit = np.zeros((wheels, engine.motors))
    unit[:, :wheels] = np.eye(wheels)
    per_rate = engine.derivatives(machine.believed, np.zeros((wheels, 3)), unit)

    def pushed(x: Array, u: Array, t: Array, state: int) -> Array:
        size = shape(u @ per_rate, t)
        if part == 2 or state == 2:
            return size if part == state else np.zeros(len(x))
        heading = x[:, 2]
        along = (np.cos(heading), np.sin(heading))
        across = (-np.sin(heading), np.cos(heading))
        return size * (along, across)[part][state]

    return pushed
