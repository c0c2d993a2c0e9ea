"""What an unknown effect looks like: which equation lacks what, as a curve over what it depends on.

The force that is missing in one equation is taken for any function of one quantity q: straight
between some knots, f(q) = sum_j f_j hat_j(q). What a unit of each f_j does to the whitened
innovations is linear (rows.py), so the f_j follow by least squares beside the fitted parameters,
with their covariance. Every pair of equation and quantity is tried; the one that explains most, of
each run by the curve that fits the others, is shown. A regular beat in time is looked for in the
spectrum of the filter's disturbances and then fitted as a wave, alone or in proportion to the
command; every run has its own phase of it.

A short formula for the curve is a hypothesis for people to judge: the one or two shapes of a list
or the bump with the smallest BIC, for which its place and width count, too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from omnislip.gap.inference import Data, Fit, check_columns, free_of_fitted, inflation_of
from omnislip.gap.leftover import Leftover, is_driven
from omnislip.gap.machine import Machine
from omnislip.gap.noise import DISTURBANCES, track_all
from omnislip.gap.predictable import MOVED
from omnislip.gap.recordings import Run, of_encoders
from omnislip.gap.search import Outcome
from omnislip.gap.side_by_side import side_by_side
from omnislip.gap.terms import (
    CAMERA_HEADING,
    GYRO_SHAPES,
    Quantity,
    against_rotation,
    roller_friction,
    swings,
)

Array = npt.NDArray[np.float64]

KNOTS = 9
OUTER = (1.0, 99.0)
"""Percentiles of the quantity at which its curve ends."""
FREQUENCIES_HZ = np.geomspace(0.7, 40.0, 600)
PEAK = 12.0
"""Power of a beat over the median of its spectrum (6.6 is the largest of 600 by chance in one run,
1 %)."""
SLOW_SHARE = 0.02
SHAFT_TORQUE = "torque"
BEATING = ("wheel/1/torque", "world/force_x", "world/force_y", "body/moment")
"""Equations, alone or first of all wheels, in which a beat is looked for."""
P_VALUE = 1e-6
"""Over all pairs of equation and quantity."""
MOST_TERMS = 3
"""Of those that pass, strongest first, what they depend on is tried."""
SWINGS_SHOWN, SWING_POINTS = 3.0, 121
"""Of a load, periods and points of its curve."""
PAIR_PENALTY = 3.0
"""How much more than by BIC a second shape has to explain, and a bump: there are many of them."""


@dataclass(frozen=True)
class Equation:
    """An equation that may lack a force: how a unit of it pushes states or shows in sensors."""

    name: str
    symbol: str
    unit: str
    size: float
    """Unit of the force per unit of the state's rate."""
    motor: int
    quantities: tuple[Quantity, ...]
    push: Callable[[Array], dict[int, Array]] = lambda _x: {}
    """state (rows, n) -> rate of each pushed state (rows,)"""
    outputs: tuple[int, ...] = ()


@dataclass(frozen=True)
class Unknown:
    """A missing force: where, on what it depends, its curve, and a formula as a hypothesis.

    `x`, `y`, `deviation` (knots,) in the units named; of a wave: over one period. `formula_share`
    is what the formula explains of the curve, `formula_y` (knots,) its values.
    """

    equation: str
    dependence: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    deviation: Array
    gain: float
    validation_gain: float
    formula: str
    formula_share: float
    formula_y: Array = field(repr=False)


@dataclass(frozen=True)
class Curve:
    """A pair of equation (names of its members) and quantity, with its sizes."""

    name: str
    equation: Equation
    quantity: Quantity
    knots: Array
    sizes: Array
    covariance: Array
    gain: float
    p_value: float
    validation_gain: float
    helps: bool
    """Whether most of the runs gain by the curve that fits the others."""


def describe_unknown(outcome: Outcome) -> Unknown | None:
    """Return what explains most, or None if nothing helps runs that were not fitted."""
    values = outcome.final.hypothesis.flat(outcome.data.believed)
    machine = outcome.data.machine
    study, found = _Study(outcome.data, outcome.final, values), equations(machine, values)
    found = [one for one in found if is_driven(outcome.data, one.name)]
    tried = [*study.all_pairs(found), *study.of_terms(found, outcome.leftover[:MOST_TERMS])]
    passed = [one for one in tried if one.p_value * len(tried) < P_VALUE and one.helps]
    best = max(passed, key=lambda one: one.validation_gain, default=None)
    least = best.validation_gain if best else 0.0
    loads = [one for one in outcome.leftover if one.terms[0].swing and one.validation_gain > least]
    if loads:
        return _swinging(max(loads, key=lambda one: one.validation_gain), machine, values)
    if best is not None:
        return _put_together(best)
    alone = [one for one in outcome.leftover if len(one.terms) == 1 and one.gain > one.covered]
    return study.line_of(found, alone[0]) if alone else None


class _Study:
    """Fits curves to what a model leaves of the data."""

    def __init__(self, data: Data, fitted: Fit, values: Array) -> None:
        self._data, self._fitted, self._values = data, fitted, values
        self._tracks = track_all(data.machine, data.runs, values, data.noise, keep_linear=True)

    def all_pairs(self, found: Sequence[Equation]) -> list[Curve]:
        """Every quantity in every equation; wheels also all together, with the same curve."""
        groups: dict[str, list[Equation]] = {}
        for equation in found:
            groups.setdefault(equation.symbol + equation.unit, []).append(equation)
        pairs = [
            (members, quantity)
            for members in groups.values()
            for quantity in (*members[0].quantities, *self._waves(members))
        ]
        curves = side_by_side(lambda pair: list(self._pair(*pair)), pairs)
        return [curve for own in curves for curve in own]

    def of_terms(self, found: Sequence[Equation], leftover: Sequence[Leftover]) -> Iterator[Curve]:
        """What the terms depend on that pass, each in its own equation."""
        for one in leftover:
            quantity, members = one.terms[0].over, _members(found, one)
            if quantity is None or not members:
                continue
            if one.sizes.ndim > 1:
                quantity = replace(quantity, phases_rad=np.arctan2(*one.sizes[:, ::-1].T))
            elif quantity.name in {own.name for own in members[0].quantities}:
                continue
            yield from self._pair(members, quantity)

    def line_of(self, found: Sequence[Equation], one: Leftover) -> Unknown:
        """Describe a term by the straight line that it is over its own values."""
        [term], [size], members = one.terms, one.sizes, _members(found, one)
        if members:
            symbol, unit, per_rate = members[0].symbol, members[0].unit, members[0].size
        elif term.states:
            symbol, unit, per_rate = "force", "N", self._data.machine.inertias(self._values)[0]
        else:
            of_heading = term.outputs == (CAMERA_HEADING,)
            symbol, unit, per_rate = "shown besides", "rad" if of_heading else "m", 1.0
        sign = -1.0 if term.outputs else 1.0  # as of a curve
        moved = (term.states + term.outputs)[0]
        values = [term.shape(x, run.command, run.time_s, moved) for run, x in self._states()]
        x = np.linspace(*np.percentile(np.concatenate(values), OUTER), KNOTS)
        slope = sign * per_rate * float(size)
        return Unknown(
            one.equation,
            one.dependence,
            one.dependence,
            f"{symbol} ({unit})",
            x,
            slope * x,
            np.abs(slope * x) * np.sqrt(one.inflation / one.gain),
            one.gain,
            one.validation_gain,
            f"{symbol} / ({unit}) = {slope:.3g} times {one.dependence}, in SI units",
            1.0,
            slope * x,
        )

    def _pair(self, members: Sequence[Equation], quantity: Quantity) -> Iterator[Curve]:
        knots = self._knots(members, quantity)
        if knots is None:
            return
        columns = [self._columns(one, quantity, knots) for one in members]
        alone = [(one.name, one, own) for one, own in zip(members, columns, strict=True)]
        if len(members) > 1:
            alone.append((_every(members[0].name), members[0], sum(columns)))
        for name, equation, own in alone:
            tried = self._fit(name, equation, quantity, knots, own)
            if tried is not None:
                yield tried

    def _fit(
        self, name: str, equation: Equation, quantity: Quantity, knots: Array, columns: Array
    ) -> Curve | None:
        """Least squares of the sizes beside the fitted parameters."""
        free = free_of_fitted(self._fitted, columns)
        gram = free.T @ free
        if not np.trace(gram) > 0:
            return None
        inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
        sizes = -inverse @ (free.T @ self._fitted.residual)
        after = self._fitted.residual + free @ sizes
        inflation = inflation_of(self._data, free, after, gram)
        check = check_columns(self._data, self._fitted.residual, free)
        gain = float(sizes @ gram @ sizes)
        phases = 0 if quantity.phases_rad is None else len(quantity.phases_rad)
        freedom = np.linalg.matrix_rank(gram, hermitian=True) + phases
        sign = -1.0 if equation.outputs else 1.0  # a sensor shows it, a state is pushed by it
        return Curve(
            name,
            equation,
            quantity,
            knots,
            sign * equation.size * sizes,
            equation.size**2 * inflation * inverse,
            gain,
            float(chi2.sf(gain / inflation, freedom)),
            check.gain,
            check.helps,
        )

    def _knots(self, members: Sequence[Equation], quantity: Quantity) -> Array | None:
        """Where the curve bends; None for a quantity that hardly changes."""
        if quantity.frequency_hz is not None:
            return np.zeros(2)
        if quantity.period is not None:
            return np.linspace(0.0, quantity.period, KNOTS)[:-1]
        values = np.concatenate(
            [
                quantity.of(state, run.command, run.time_s, one.motor)
                for one in members
                for run, state in self._states()
            ]
        )
        low, high = np.percentile(values, OUTER)
        return np.linspace(low, high, KNOTS) if high - low > 1e-9 else None

    def _states(self) -> Iterator[tuple[Run, Array]]:
        for run, track in zip(self._data.runs, self._tracks, strict=True):
            yield run, track.state.reshape(len(run.t_s), -1)

    def _columns(self, equation: Equation, quantity: Quantity, knots: Array) -> Array:
        """Whitened change of the innovations by a unit at each knot (m, knots)."""
        phases_rad = quantity.phases_rad

        def pushes(number: int, run: Run, state: Array, seen: Array) -> tuple[Array, Array]:
            phase_rad = 0.0 if phases_rad is None else phases_rad[number]
            goes_with = seen if equation.outputs else state
            hats = _hats(quantity, knots, run, goes_with, equation.motor, phase_rad)
            push = np.zeros((*state.shape, hats.shape[1]))
            shown = np.zeros((*run.outputs.shape, hats.shape[1]))
            for index, rate in equation.push(state).items():
                push[:, index] = rate[:, None] * hats
            for index in equation.outputs:
                shown[:, index] = hats
            shown[np.isnan(run.outputs)] = 0.0
            return push, shown

        return self._data.responses(self._tracks, pushes)

    def _waves(self, members: Sequence[Equation]) -> list[Quantity]:
        """Regular beats in the disturbances that the filter saw in these equations."""
        if members[0].name not in BEATING or self._data.machine.kind != "robot":
            return []
        found = []
        weights: dict[str, Callable[..., Array]] = {"": lambda x, d, t, i: np.ones(len(x))}
        if members[0].symbol == SHAFT_TORQUE:
            weights["the command"] = lambda x, d, t, i: d[:, i]
            weights["the size of the command"] = lambda x, d, t, i: np.abs(d[:, i])
        for name, weight in weights.items():
            power = _power(self._spectra(members, weight, FREQUENCIES_HZ))
            peak = int(np.argmax(power))
            if power[peak] > PEAK * np.median(power):
                near = FREQUENCIES_HZ[peak] * np.linspace(0.99, 1.01, 41)
                spectra = self._spectra(members, weight, near)
                best = int(np.argmax(_power(spectra)))
                phases_rad = np.angle(spectra[:, :, best].sum(axis=1))
                found.append(Quantity(name, "1", weight, None, float(near[best]), phases_rad))
        return found

    def _spectra(
        self, members: Sequence[Equation], weight: Callable[..., Array], frequencies_hz: Array
    ) -> npt.NDArray[np.complex128]:
        """Fourier sums (runs, equations, frequencies) of the weighted disturbances."""
        spectra = []
        for run, state in self._states():
            turn = np.exp(-2j * np.pi * np.outer(frequencies_hz, run.time_s))
            pushed = np.zeros((len(members), *state.shape))
            for own, one in zip(pushed, members, strict=True):
                for index, rate in one.push(state).items():
                    own[:, index] = rate
            seen = np.einsum("mkj,kj->km", pushed[:, :, MOVED], state[:, DISTURBANCES])
            weights = [weight(state, run.command, run.time_s, one.motor) for one in members]
            spectra.append((turn @ (np.stack(weights, axis=1) * (seen - seen.mean(axis=0)))).T)
        return np.stack(spectra)


def _power(spectra: npt.NDArray[np.complex128]) -> Array:
    """Power (frequencies,) of all runs and equations, whatever their phases."""
    return np.sum(np.abs(spectra) ** 2, axis=(0, 1))


def _every(name: str) -> str:
    """Name of all wheels together: 'wheel/1/torque' -> 'every wheel/torque'; others as they are."""
    if name.count("/") < 2:
        return name
    first, _, last = name.split("/")
    return f"every {first}/{last}"


def _members(found: Sequence[Equation], one: Leftover) -> list[Equation]:
    """Return the equations of a term: one, those of all wheels, or none."""
    return [e for e in found if one.equation in (e.name, _every(e.name))]


def _hats(
    quantity: Quantity, knots: Array, run: Run, state: Array, motor: int, phase_rad: float
) -> Array:
    """Value of each knot's hat function in every row (rows, knots); of a wave its two phases."""
    q = quantity.of(state, run.command, run.time_s, motor)
    if quantity.frequency_hz is not None:
        angle = 2.0 * np.pi * quantity.frequency_hz * run.time_s + phase_rad
        return np.stack([q * np.sin(angle), q * np.cos(angle)], axis=1)
    count = len(knots)
    if quantity.period is not None:
        place = np.mod(q / quantity.period + phase_rad / (2 * np.pi), 1.0) * count
    else:
        place = np.clip((q - knots[0]) / (knots[-1] - knots[0]), 0.0, 1.0) * (count - 1)
    distance = np.abs(place[:, None] - np.arange(count))
    if quantity.period is not None:
        distance = np.minimum(distance, count - distance)
    return np.maximum(1.0 - distance, 0.0)


def equations(machine: Machine, values: Array) -> list[Equation]:
    """Return the equations of a machine and what a force in them may depend on."""
    if machine.kind == "axis":
        return _axis_equations(machine, values)
    if machine.kind == "odometry":
        return _odometry_equations(machine)
    return _robot_equations(machine, values)


TIME = Quantity("time", "s", lambda x, d, t, i: t)


def _robot_equations(machine: Machine, values: Array) -> list[Equation]:
    model = machine.model.values
    gear = float(model["motor.gear_ratio"])
    mass, inertia, shafts = machine.inertias(values)
    turn = 2.0 * np.pi
    angle = Quantity("shaft angle", "rad", lambda x, d, t, i: x[:, 4 + i], turn)
    wheel_angle = Quantity("wheel angle", "rad", lambda x, d, t, i: x[:, 4 + i] / gear, turn)
    wheel = (
        Quantity("shaft speed", "rad/s", lambda x, d, t, i: x[:, i]),
        Quantity("command", "1", lambda x, d, t, i: d[:, i]),
        angle,
        wheel_angle,
        TIME,
    )
    along = Quantity("speed along x", "m/s", lambda x, d, t, i: x[:, 8])
    across = Quantity("speed along y", "m/s", lambda x, d, t, i: x[:, 9])
    turning = Quantity("yaw rate", "rad/s", lambda x, d, t, i: x[:, 10])
    heading = Quantity("heading", "rad", lambda x, d, t, i: x[:, 13], turn)
    place_x = Quantity("place x", "m", lambda x, d, t, i: x[:, 11])
    place_y = Quantity("place y", "m", lambda x, d, t, i: x[:, 12])
    body = (along, across, turning, TIME)
    accelerations = [
        Quantity(name, "m/s2", GYRO_SHAPES[name])
        for name in ("acceleration along x", "acceleration along y")
    ]
    found = [
        Equation(
            f"wheel/{i + 1}/torque",
            SHAFT_TORQUE,
            "N m",
            shafts[i],
            i,
            wheel,
            lambda x, i=i: {i: _one(x)},
        )
        for i in range(4)
    ]
    found += [
        Equation(
            f"wheel/{i + 1}/friction",
            "torque against rotation",
            "N m",
            shafts[i],
            i,
            (angle, wheel_angle, TIME),
            lambda x, i=i: {i: against_rotation(x[:, i])},
        )
        for i in range(4)
    ]
    found += [
        Equation(
            f"wheel/{i + 1}/roller friction",
            "force against the rollers' way",
            "N",
            mass,
            i,
            (wheel_angle, TIME),
            lambda x, i=i: roller_friction(machine, i, x),
        )
        for i in range(4)
    ]
    found += [
        Equation("body/force_x", "force along x", "N", mass, 0, body, lambda x: {8: _one(x)}),
        Equation("body/force_y", "force along y", "N", mass, 0, body, lambda x: {9: _one(x)}),
        Equation(
            "body/moment",
            "moment",
            "N m",
            inertia,
            0,
            (turning, along, across, heading, place_x, place_y, TIME),
            lambda x: {10: _one(x)},
        ),
        Equation(
            "world/force_x",
            "force along world x",
            "N",
            mass,
            0,
            (place_x, place_y, TIME),
            lambda x: {8: np.cos(x[:, 13]), 9: -np.sin(x[:, 13])},
        ),
        Equation(
            "world/force_y",
            "force along world y",
            "N",
            mass,
            0,
            (place_x, place_y, TIME),
            lambda x: {8: np.sin(x[:, 13]), 9: np.cos(x[:, 13])},
        ),
        Equation(
            "body/drag",
            "force against the velocity",
            "N",
            mass,
            0,
            (
                Quantity("speed", "m/s", lambda x, d, t, i: np.hypot(x[:, 8], x[:, 9])),
                place_x,
                place_y,
            ),
            _against_velocity,
        ),
        Equation(
            "gyro",
            "yaw rate shown",
            "rad/s",
            1.0,
            0,
            (turning, along, across, *accelerations, TIME),
            outputs=(4,),
        ),
    ]
    found += [
        Equation(f"encoder/{i + 1}/angle", "angle shown", "rad", 1.0, i, (angle,), outputs=(i,))
        for i in range(4)
    ]
    return found


def _one(x: Array) -> Array:
    return np.ones(len(x))


def _against_velocity(x: Array) -> dict[int, Array]:
    speed = np.hypot(x[:, 8], x[:, 9])
    share = 1.0 / np.maximum(speed, SLOW_SHARE)
    return {8: -x[:, 8] * share, 9: -x[:, 9] * share}


def _axis_equations(machine: Machine, values: Array) -> list[Equation]:
    linear = machine.linear
    effect, parameter = ("payload", "mass_kg") if linear else ("inertia_error", "inertia_kg_m2")
    inertia = float(values[0] + values[machine.place(effect, parameter, None)[0]])
    speed, place = ("m/s", "m") if linear else ("rad/s", "rad")
    quantities = (
        Quantity("speed", speed, lambda x, d, t, i: x[:, 0]),
        Quantity("command", "1", lambda x, d, t, i: d[:, 0]),
        Quantity("position", place, lambda x, d, t, i: x[:, 1], None if linear else 2 * np.pi),
        TIME,
    )
    symbol, unit = ("force", "N") if linear else (SHAFT_TORQUE, "N m")
    return [Equation("axis/force", symbol, unit, inertia, 0, quantities, lambda x: {0: _one(x)})]


def _odometry_equations(machine: Machine) -> list[Equation]:
    per_rate = of_encoders(machine)
    wheels = machine.wheels
    radius_m = float(machine.model.values["odometry.wheel_radius_m"])

    def of_body(name: str, unit: str, of: Callable[[Array], Array]) -> Quantity:
        return Quantity(name, unit, lambda x, u, t, i: of(u[:, :wheels] @ per_rate))

    turning = of_body("turning", "rad/s", lambda v: v[:, 2])
    body = (
        of_body("speed along", "m/s", lambda v: v[:, 0]),
        of_body("speed across", "m/s", lambda v: v[:, 1]),
        turning,
        TIME,
    )
    floor = (of_body("speed", "m/s", lambda v: np.hypot(v[:, 0], v[:, 1])), turning, TIME)
    rim = (Quantity("wheel speed", "rad/s", lambda x, u, t, i: u[:, i]), turning, TIME)

    def moved(x: Array, v: Array) -> dict[int, Array]:
        """Rates of the pose by a velocity (3,) of the body."""
        cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
        return {0: cos * v[0] - sin * v[1], 1: sin * v[0] + cos * v[1], 2: v[2] * _one(x)}

    ahead, left, around = np.eye(3)
    return [
        Equation(
            "odometry/forward", "speed forward", "m/s", 1.0, 0, body, lambda x: moved(x, ahead)
        ),
        Equation(
            "odometry/lateral", "speed to the left", "m/s", 1.0, 0, body, lambda x: moved(x, left)
        ),
        Equation("odometry/turning", "yaw rate", "rad/s", 1.0, 0, body, lambda x: moved(x, around)),
        Equation("floor/speed_x", "drift along x", "m/s", 1.0, 0, floor, lambda x: {0: _one(x)}),
        Equation("floor/speed_y", "drift along y", "m/s", 1.0, 0, floor, lambda x: {1: _one(x)}),
        *(
            Equation(
                f"wheel/{i + 1}/rim speed",
                "rim speed",
                "m/s",
                radius_m,
                i,
                rim,
                lambda x, i=i: moved(x, per_rate[i]),
            )
            for i in range(wheels)
        ),
    ]


def _swinging(one: Leftover, machine: Machine, values: Array) -> Unknown:
    """Curve and formula of a load or marker that swings: what a stop from 1 m/s or 1 rad/s sets
    going."""
    swing_hz, damping = one.terms[0].swing
    mass, inertia, _ = machine.inertias(values)
    symbol, unit, speed, own = {
        "world/force": ("force", "N", "m/s", mass),
        "body/moment": ("moment", "N m", "rad/s", inertia),
        "camera": ("place shown", "m", "m/s", 1.0),
    }[one.equation]
    x = np.linspace(0.0, SWINGS_SHOWN / swing_hz, SWING_POINTS)
    stop = np.where(x > 0, -1.0, 0.0)
    parts = [term.dependence.split()[0] for term in one.terms]
    sizes = dict(zip(parts, own * one.sizes, strict=True))
    y = sum(size * swings(x, stop, swing_hz, damping, part) for part, size in sizes.items())
    w = 2 * np.pi * swing_hz
    pulls = {"place": (w**2, "y"), "speed": (w, "y'")}
    forces = [f"{size * pulls[part][0]:+.3g} {pulls[part][1]}" for part, size in sizes.items()]
    formula = (
        f"{symbol} / ({unit}) = {' '.join(forces)}, "
        f"y'' + {2 * damping * w:.3g} y' + {w**2:.3g} y = -acceleration"
    )
    return Unknown(
        one.equation,
        one.dependence,
        f"time after a stop from 1 {speed} (s)",
        f"{symbol} ({unit})",
        x,
        y,
        np.abs(y) * np.sqrt(one.inflation / one.gain),
        one.gain,
        one.validation_gain,
        formula,
        1.0,
        y,
    )


def _put_together(best: Curve) -> Unknown:
    """Curve, words and formula of what was found."""
    equation, quantity = best.equation, best.quantity
    y_label = f"{equation.symbol} ({equation.unit})"
    if quantity.frequency_hz is not None:
        return _wave(best, y_label)
    formula, share, formula_y = propose(best, f"{equation.symbol} / ({equation.unit})")
    return Unknown(
        best.name,
        quantity.name,
        f"{quantity.name}" + (f" ({quantity.unit})" if quantity.unit != "1" else ""),
        y_label,
        best.knots,
        best.sizes,
        np.sqrt(np.maximum(np.diag(best.covariance), 0.0)),
        best.gain,
        best.validation_gain,
        formula,
        share,
        formula_y,
    )


def _wave(best: Curve, y_label: str) -> Unknown:
    frequency = best.quantity.frequency_hz
    amplitude = float(np.hypot(*best.sizes))
    phase = float(np.arctan2(best.sizes[1], best.sizes[0]))
    times = f" times {best.quantity.name}" if best.quantity.name else ""
    x = np.linspace(0.0, 1.0 / frequency, 25)
    angle = 2 * np.pi * frequency * x - phase
    basis = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    y = basis @ best.sizes
    deviation = np.sqrt(np.einsum("ij,jk,ik->i", basis, best.covariance, basis))
    formula = (
        f"{best.equation.symbol} / ({best.equation.unit}) = {amplitude:.3g} "
        f"sin(2 pi {frequency:.3g} t/s + phase of the run)" + (f" *{times[6:]}" if times else "")
    )
    return Unknown(
        best.name,
        f"time, a wave of {frequency:.3g} Hz" + times,
        "time (s)",
        y_label,
        x,
        y,
        deviation,
        best.gain,
        best.validation_gain,
        formula,
        1.0,
        y,
    )


SHAPES: dict[str, Callable[[Array], Array]] = {
    "1": lambda u: np.ones_like(u),
    "sign(u)": lambda u: np.tanh(u / SLOW_SHARE),
    "u": lambda u: u,
    "|u|": lambda u: np.abs(u),
    "u^2": lambda u: u**2,
    "u |u|": lambda u: u * np.abs(u),
    "u^3": lambda u: u**3,
    "u^5": lambda u: u**5,
}
"""Of u = q / largest |q|."""
PERIODIC_SHAPES: dict[str, Callable[[Array], Array]] = {
    "1": lambda u: np.ones_like(u),
    "sin(u)": np.sin,
    "cos(u)": np.cos,
    "sin(2 u)": lambda u: np.sin(2 * u),
    "cos(2 u)": lambda u: np.cos(2 * u),
}

BUMPS = [(place, width) for place in np.linspace(0.0, 0.9, 19) for width in (0.1, 0.2, 0.3, 0.5)]
"""Of |u|: what acts about one speed, one place."""


def _shapes(u: Array, periodic: bool) -> dict[str, tuple[Array, int]]:
    """Return the values (knots,) of each shape and how many numbers it has."""
    table = PERIODIC_SHAPES if periodic else SHAPES
    shapes = {name: (shape(u), 1) for name, shape in table.items()}
    if periodic:
        return shapes
    for place, width in BUMPS:
        bump = np.exp(-(((np.abs(u) - place) / width) ** 2))
        away = "|u|" if place == 0.0 else f"(|u| - {place:.3g})"
        name = f"exp(-({away} / {width:g})^2)"
        shapes[name] = (bump, 3)
        shapes[f"sign(u) {name}"] = (np.sign(u) * bump, 3)
    return shapes


def propose(best: Curve, left: str) -> tuple[str, float, Array]:
    """Return a formula for a curve, the share of its weighted squares it explains, its values."""
    periodic = best.quantity.period is not None
    if periodic:
        largest = float(f"{best.quantity.period / (2 * np.pi):.3g}")
    else:
        largest = float(f"{np.max(np.abs(best.knots)):.2g}")
    table = _shapes(best.knots / largest, periodic)
    weight = np.linalg.pinv(best.covariance, rcond=1e-9, hermitian=True)
    count = len(best.knots)
    total = float(best.sizes @ weight @ best.sizes)
    chosen: tuple[float, tuple[str, ...], Array] | None = None
    plain = [name for name, (_, numbers) in table.items() if numbers == 1]
    for names in [(n,) for n in table] + list(combinations(plain, 2)):
        basis = np.stack([table[n][0] for n in names], axis=1)
        amounts = np.linalg.lstsq(basis.T @ weight @ basis, basis.T @ weight @ best.sizes, 1e-9)[0]
        rest = best.sizes - basis @ amounts
        numbers = [table[n][1] for n in names]
        more = len(names) - 1 + sum(own > 1 for own in numbers)
        penalty = sum(numbers) * np.log(count) + PAIR_PENALTY * more
        # The knots are not the truth either: errors of straight lines between them count as noise.
        cost = count * np.log(max(rest @ weight @ rest, 1.0) / count) + penalty
        if chosen is None or cost < chosen[0]:
            chosen = (float(cost), names, amounts)
    _, names, amounts = chosen
    unit = (
        "1"
        if largest == 1.0 and periodic
        else f"({largest:g} {best.quantity.unit})".replace(" 1)", ")")
    )
    over = "" if unit == "1" else f" / {unit}"
    parts = [
        f"{amount:+.3g}" + ("" if n == "1" else f" {n}")
        for n, amount in zip(names, amounts, strict=True)
    ]
    fitted = np.stack([table[n][0] for n in names], axis=1) @ amounts
    rest = best.sizes - fitted
    share = 1.0 - float(rest @ weight @ rest) / total if total > 0 else 0.0
    formula = f"{left} = " + " ".join(parts)
    if names != ("1",):
        formula += f", u = {best.quantity.name}{over}"
        formula += " + phase of the run" if best.quantity.phases_rad is not None else ""
    return formula, share, fitted
