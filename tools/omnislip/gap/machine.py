"""A model file as a point in the parameter space of the plant.

A parameter set of `omnislip._core` is one flat vector: the believed (base) values, then every
parameter of every effect, wheel by wheel. This module knows which place means what.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.waves import waves_along
from omnislip.model_file import Effect, Model, axis_names

if TYPE_CHECKING:
    from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

# Known exactly, unless [tolerance] names them: gearing and gravity, angles of the mounting, counts
# of the disc.
EXACT_KEYS = (
    "robot.wheel_angles_deg",
    "motor.gear_ratio",
    "contact.gravity_m_s2",
    "encoder.counts_per_rev",
    "axis.gravity_m_s2",
    "axis.supply_v",
    "odometry.wheel_angles_deg",
    "odometry.roller_angle_deg",
    "odometry.counts_per_rev",
)
KEY_REACH = 2.0
"""Tolerances by which a believed key may move; one that would go further is told by name."""
AXIS_KEYS = {
    "mass_kg": "axis.inertia",
    "inertia_kg_m2": "axis.inertia",
    "back_emf_n_s_m": "axis.back_emf",
    "back_emf_nm_s_rad": "axis.back_emf",
    "viscous_friction_n_s_m": "axis.viscous_friction",
    "viscous_friction_nm_s_rad": "axis.viscous_friction",
    "pendulum_mass_kg": "axis.pendulum_mass_kg",
    "pendulum_length_m": "axis.pendulum_length_m",
    "gravity_m_s2": "axis.gravity_m_s2",
}
# Dry friction is smoothed over this speed: slow enough to be dry, fast enough to integrate.
AXIS_FRICTION_SPEED = {"linear": 1e-3, "rotary": 0.05}
# The catalogue speaks of shafts; a translating axis says the same with its own units.
TURNING_UNITS = {"limit_a": "N m"}
TRANSLATING_UNITS = {
    "limit_a": "N",
    "torque_nm": "N",
    "viscous_friction_nm_s": "N s/m",
    "viscous_nm_s": "N s/m",
    "speed_rad_s": "m/s",
    "cycles_per_rev": "rad/m",
    "angle_rad": "m",
    "stiffness_nm_rad": "N/m",
    "damping_nm_s_rad": "N s/m",
}
OF_ITS_OWN_SIZE = ("mass_kg", "inertia_kg_m2", "duty")
"""Sizes that may be anything on an axis of grams or of tons, commanded in duty or in volt."""
AXIS_COMMAND = 3.0
"""A command (V, A) that a limit worth looking for would clip."""
AXIS_RESONANCE_RAD_S = 2 * math.pi * 50.0
"""Where a two-mass drive worth looking for rings: screws and belts lie between 20 and 100 Hz."""
OF_THE_DRIVE = ("N m/rad", "N m s/rad")
"""Units of springs and dampers: as much larger as the drive's inertia at the wheel is, they ring at
the same frequency."""
OF_THE_BODY = ("kg", "N", "N s/m", "N s^2/m^2", "N/m")
"""Units of what is as much larger as the robot is heavier."""
INERTIA = "kg m^2"
PERIODIC_UNIT = "rad"
PENDULUM = "axis.pendulum_mass_kg"
NEEDS = {
    "pendulum_zero_error": (PENDULUM,),
    "payload": ("robot.mass_kg", "axis.mass_kg", PENDULUM),
}
"""Effects of what a machine may not have, and the keys of which one says that it has it."""
PHASE = "phase_rad"
CURVE = "contact_shape"
"""The effect that is another friction curve."""
PATCH = "slippery_patch"
PATCH_LABELS = ("x_min_m", "x_max_m", "y_min_m", "y_max_m", "scale")
"""The effect that has a place in the floor, and its edges before its size."""
CELL_SHARES = (15, 30, 45, 60, 75, 90)
"""Percentiles of the places in a log, along x and along y, between which lie the cells that the
screen puts together to such places."""
POSE_X, LEAST_POSES = 5, 50
PLACES = 25
CURRENT_LIMIT, CURRENT, LIMITS_APART = "current_limit", slice(9, 13), 0.1
"""Outputs that are currents; logarithm of the factor within which two limits are the same to start
from."""
CLIPPED, CLIPPED_ALIKE = (90.0, 99.0), 0.9
"""Percentiles of currents that are the same where a limit clips them, but for noise: normal ones
have 0.64 there."""
DROPOUT, SPEED_SHARES, STILL_RAD_S = "encoder_dropout", (0.25, 0.5, 0.7, 0.85, 0.95, 1.0), 1.0
"""Speeds from which an encoder may lose counts, as shares of the fastest that it shows; what counts
as that of one which stands still in all logs."""
COGGING = "cogging"
# A size that is infinite when absent (stiffness, limit) is sought up to so many typical ones: a
# gear ten times stiffer shows in no log and would be integrated in tiny steps.
MOST_OF_ABSENT = 10.0
LESS_GRIP = 0.05
"""Share of the grip by which to see what friction does: all of it, for it is proportional."""
MOST_DAMPING = 20.0


@dataclass(frozen=True)
class Parameter:
    """A number that can be fitted: where it stands in the flat vector and how it is bounded."""

    label: str
    places: tuple[int, ...]
    scale: float
    low: float
    high: float


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing, on one wheel or (wheel None) on all."""

    effect: str
    wheel: int | None
    parameters: tuple[Parameter, ...]
    amplitudes: tuple[int, ...]
    """Which of `parameters` are zero-able sizes; the others shape the effect."""
    starts: tuple[dict[int, float], ...] = field(default=({},))
    """Values of the shaping parameters to start a fit from, by index into `parameters`."""
    edges_m: tuple[tuple[float, ...], ...] = ()
    """Places at which the first of `parameters` may lie, the edges of a patch in the floor."""

    @property
    def name(self) -> str:
        """Name for people: 'weak_motor (wheel 3)'."""
        return name_on_wheel(self.effect, self.wheel)

    @property
    def spans(self) -> tuple[tuple[int, int], ...]:
        """Two by two, which of `parameters` are the edges of a patch in the floor: along x, y."""
        return tuple((k, k + 1) for k in range(0, len(self.edges_m), 2))

    def along_x(self) -> "Candidate":
        """Return a patch in the floor that has edges along x only, from its cells."""
        own = (0, 1, *self.amplitudes)
        cells = {(start[0], start[1]) for start in self.starts}
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in own),
            amplitudes=(2,),
            starts=tuple({0: low, 1: high} for low, high in sorted(cells)),
            edges_m=self.edges_m[:2],
        )

    @property
    def places(self) -> tuple[int, ...]:
        """Where its parameters stand in the flat vector, which has the catalogue's order."""
        return tuple(place for parameter in self.parameters for place in parameter.places)


def name_on_wheel(effect: str, wheel: int | None) -> str:
    """Return the name for people of an effect on one wheel, or (None) on all."""
    return effect if wheel is None else f"{effect} (wheel {wheel})"


def effect_and_wheel(name: str) -> tuple[str, int | None]:
    """Return effect and wheel of such a name."""
    effect, _, wheel = name.removesuffix(")").partition(" (wheel ")
    return effect, int(wheel) if wheel else None


def axis_is_linear(model: Model) -> bool:
    """Return whether an axis model translates (mass, N) rather than turns (inertia, N m)."""
    return "axis.mass_kg" in model.values


class Machine:
    """The believed machine: flat values, the engine that replays it, and what may be fitted.

    An `electric` robot's outputs hold bus voltage and motor currents too. One that
    `holds_commands` within the rows of its logs has a controller as slow as they are, and whose
    command `jumps_with_rows` one that acts where they begin; one that `reads_before` it acts shows
    currents and voltage under the command of the row before.
    """

    def __init__(
        self,
        model: Model,
        electric: bool = False,
        holds_commands: bool = False,
        reads_before: bool = False,
        jumps_with_rows: bool = False,
    ) -> None:
        self.model = model
        self.kind = model.kind
        self.linear = model.kind == "axis" and axis_is_linear(model)
        self.engine = _core.Engine(model.kind, user_effects=model.own_effects, electric=electric)
        self.electric = electric
        self.holds_commands = holds_commands
        self.reads_before = reads_before
        self.jumps_with_rows = jumps_with_rows
        self.wheels = len(model.values.get(f"{model.kind}.wheel_angles_deg", [0.0]))
        """Wheels of the machine; an axis counts as one."""
        self.catalogue = {e["name"]: e for e in model.catalogue if model.kind in e["kinds"]}
        self._places = self._layout()
        self.believed = self._flat_values()

    def of(
        self,
        model: Model,
        holds_commands: bool | None = None,
        reads_before: bool | None = None,
        jumps_with_rows: bool | None = None,
    ) -> "Machine":
        """Return the machine of another model; sensors and, if not said, controller stay."""
        held = self.holds_commands if holds_commands is None else holds_commands
        before = self.reads_before if reads_before is None else reads_before
        with_rows = self.jumps_with_rows if jumps_with_rows is None else jumps_with_rows
        return Machine(model, self.electric, held, before and held, with_rows and held)

    def recording(
        self,
        t_s: Array,
        command: Array,
        outputs: Array,
        state: Array,
        settle_s: float = _core.SETTLE_S,
        begun_variance: Array | None = None,
    ) -> _core.Recording:
        """Return what `_core.Engine.recording` does, its sensors read when this machine does."""
        made = self.engine.recording(t_s, command, outputs, state, settle_s, begun_variance)
        return made.reading_before() if self.reads_before else made

    def place(self, effect: str, parameter: str, wheel: int | None) -> tuple[int, ...]:
        """Return where a parameter of an effect stands; all wheels' places for wheel None."""
        stride, first = self._places[effect, parameter]
        if wheel is None or stride == 1:
            return tuple(range(first, first + stride))
        return (first + wheel - 1,)

    def with_less_grip(self, values: Array) -> Array:
        """Return a flat set of a robot on a floor of `LESS_GRIP` less grip."""
        [less] = self.with_grips(values, np.array([[1.0 - LESS_GRIP]]))
        return less

    def with_grips(self, values: Array, shares: Array) -> Array:
        """Return flat sets (sets, parameters) of a robot whose wheels have other grip.

        `shares` (sets, wheels) of what they have by `values`, a flat set.
        """
        sets = np.tile(values, (len(shares), 1))
        sets[:, list(self.place("low_grip", "scale", None))] *= shares
        return sets

    def shown_s(self, values: Array, time_s: Array) -> Array:
        """Return the times whose pose a robot's camera shows in rows of some times (rows,).

        `values` are a flat set.
        """
        [delay_s], [fraction] = (
            values[list(self.place(effect, parameter, None))]
            for effect, parameter in (("pose_latency", "delay_s"), ("clock_skew", "fraction"))
        )
        return time_s - (delay_s + fraction * time_s)

    def inertias(self, values: Array) -> tuple[float, float, Array]:
        """Return mass, inertia (kg m2) and those of the shafts (wheels,) of a robot, effects in it.

        `values` are a flat set.
        """
        keys = self._key_places()
        mass, inertia, shafts = (
            values[list(keys[key])] + values[list(self.place(effect, parameter, None))]
            for key, effect, parameter in (
                ("robot.mass_kg", "payload", "mass_kg"),
                ("robot.inertia_kg_m2", "inertia_error", "inertia_kg_m2"),
                ("motor.inertia_kg_m2", "motor_inertia_error", "inertia_kg_m2"),
            )
        )
        return float(mass[0]), float(inertia[0]), shafts

    def base_parameters(self) -> list[Parameter]:
        """Return the believed keys that the base fit may move, within `KEY_REACH` tolerances."""
        return [self._base_parameter(key) for key in self.model.values if self._may_move(key)]

    def candidates(self) -> list[Candidate]:
        """Return every effect of the catalogue that this model may lack, wheel by wheel.

        An effect of the model is offered again: its size may be wrong.
        """
        found = []
        for entry in self.catalogue.values():
            wheels: Iterable[int | None] = (None,)
            if self.wheels > 1 and entry["scope"] == "single":
                wheels = range(1, self.wheels + 1)
            elif self.wheels > 1 and entry["scope"] == "common or single":
                wheels = (None, *range(1, self.wheels + 1))
            needs = NEEDS.get(entry["name"])
            if needs is None or any(key in self.model.values for key in needs):
                found += [self._candidate(entry, wheel) for wheel in wheels]
        return [candidate for candidate in found if self._has_starts(candidate)]

    def candidates_for(self, runs: Sequence["Run"]) -> list[Candidate]:
        """Return the candidates with starts from what the runs show: speeds, currents, places."""
        by = {DROPOUT: self._by_speed, CURRENT_LIMIT: self._by_current, COGGING: self._by_way}
        found = [by[c.effect](c, runs) if c.effect in by else c for c in self.candidates()]
        return [c for c in (*found, *self.floor_candidates(runs)) if c.starts]

    def _by_speed(self, candidate: Candidate, runs: Sequence["Run"]) -> Candidate:
        wheel = (candidate.wheel or 1) - 1
        if self.kind == "odometry":
            speeds = [np.abs(run.command[:, wheel]) for run in runs]
        else:
            angles = [run.outputs[:, wheel] for run in runs]
            speeds = [
                np.abs(np.diff(a) / np.diff(r.t_s)) for a, r in zip(angles, runs, strict=True)
            ]
        fastest = max(float(np.nanpercentile(np.concatenate(speeds), 99.9)), STILL_RAD_S)
        return replace(candidate, starts=tuple({1: share * fastest} for share in SPEED_SHARES))

    def _by_current(self, candidate: Candidate, runs: Sequence["Run"]) -> Candidate:
        """Start limits in proportion to what makes wheels slide, too, and where currents end.

        Besides in proportion to stall: of a robot that a tenth of that sets sliding more shows
        nowhere.
        """
        if self.kind != "robot":
            return candidate
        limits = [start[0] for start in candidate.starts]
        nominal = SHAPE_GRIDS[CURRENT_LIMIT, "limit_a"]
        limits += [self._grip_current_ratio * limit for limit in nominal]
        ends_a = self.clipped_at_a(runs)
        limits += [ends_a] if ends_a else []
        apart = [
            limit
            for number, limit in enumerate(limits)
            if all(abs(np.log(limit / other)) > LIMITS_APART for other in limits[:number])
        ]
        return replace(candidate, starts=tuple({0: limit} for limit in apart))

    def _by_way(self, candidate: Candidate, runs: Sequence["Run"]) -> Candidate:
        """Start waves along the way of an axis where its accelerations show them, too.

        A screw, a belt, magnets or a motor behind a gear repeat with any length, not with a turn.
        """
        if self.kind != "axis":
            return candidate
        turns = "axis.inertia_kg_m2" in self.model.values
        shown = waves_along(runs, turns)
        starts = candidate.starts if turns else ()
        phases = SHAPE_GRIDS[candidate.effect, PHASE]
        starts += tuple({1: n, 2: phase} for n, phase in product(shown, phases))
        force, waves, phase = candidate.parameters
        most = max([waves.high, *(2.0 * n for n in shown)])
        return replace(
            candidate, parameters=(force, replace(waves, high=most), phase), starts=starts
        )

    def clipped_at_a(self, runs: Sequence["Run"]) -> float | None:
        """Return where logged currents end, if a tenth of them do."""
        if not self.electric:
            return None
        shown = np.abs(np.concatenate([run.outputs[:, CURRENT].ravel() for run in runs]))
        if np.isnan(shown).all():
            return None
        some, most = np.nanpercentile(shown, CLIPPED)
        return float(most) if some > CLIPPED_ALIKE * most else None

    def floor_candidates(self, runs: Sequence["Run"]) -> list[Candidate]:
        """Return what depends on the place, with starts from the places that the pose shows."""
        if self.kind != "robot":
            return []
        xy_m = np.concatenate([run.outputs[:, POSE_X : POSE_X + 2] for run in runs])
        xy_m = xy_m[~np.isnan(xy_m).any(axis=1)]
        return [self.patch(xy_m)] if len(xy_m) >= LEAST_POSES else []

    def patch(self, xy_m: Array) -> Candidate:
        """Return a patch in the floor; its starts are the cells in which the body was.

        `xy_m` (rows, 2) are places of the body.
        """
        entries = {p["name"]: p for p in self.catalogue[PATCH]["parameters"]}
        parameters = [self._effect_parameter(PATCH, entries[n], None) for n in PATCH_LABELS]
        ends_m, places_m = [], []
        for axis_m in xy_m.T:
            inner = np.percentile(axis_m, CELL_SHARES)
            edges = np.unique([axis_m.min() - 0.1, *inner, axis_m.max() + 0.1])
            above = np.searchsorted(edges, axis_m, side="right")
            ends_m += [edges[above - 1], edges[above]]
            places_m += [tuple(np.linspace(edges[0], edges[-1], PLACES).tolist())] * 2
        cells = np.unique(np.column_stack(ends_m), axis=0)
        starts = tuple(dict(enumerate(cell)) for cell in cells.tolist())
        return Candidate(PATCH, None, tuple(parameters), (4,), starts, tuple(places_m))

    def extensions(self, effect: str) -> list[Candidate]:
        """Return what refines an effect that is already in the model: not an effect of its own."""
        entry = self.catalogue[effect]
        return [
            Candidate(effect, None, (self._effect_parameter(effect, p, None),), (0,))
            for p in entry["parameters"]
            if (effect, p["name"]) in EXTENSIONS
        ]

    def refinements(self, candidate: Candidate) -> list[Candidate]:
        """Return the extensions of an effect that it does not have yet."""
        have = {p.label for p in candidate.parameters}
        return [e for e in self.extensions(candidate.effect) if e.parameters[0].label not in have]

    def effect_of(self, candidate: Candidate, values: Iterable[float]) -> Effect:
        """Return the effect of a model file that a candidate with these values is."""
        parameters = {
            self.file_parameter(p.label): float(v)
            for p, v in zip(candidate.parameters, values, strict=True)
            if np.isfinite(v)
        }
        return Effect(candidate.effect, parameters, candidate.wheel)

    def amended_model(self, base: Mapping[str, float], effects: list[Effect]) -> Model:
        """Return the model with moved base keys (factor on the believed value) and new effects."""
        values = {
            key: value * base.get(key, 1.0) if isinstance(value, float) else value
            for key, value in self.model.values.items()
        }
        changed = {(effect.name, effect.wheel) for effect in effects}
        kept = [
            e
            for e in self.model.effects
            if e.name not in self.catalogue or (e.name, e.wheel) not in changed
        ]
        return replace(self.model, values=values, effects=[*kept, *effects], path=None)

    def sign_of(self, effect: str, parameter: str) -> float:
        """Return the direction in which a size is usually off: -1 or 1."""
        entry = self.catalogue[effect]["parameters"]
        return math.copysign(1.0, next(p["typical"] for p in entry if p["name"] == parameter))

    def file_parameter(self, parameter: str) -> str:
        """Return the name of a catalogue parameter in this machine's files."""
        return axis_names(self.model.values).get(parameter, parameter)

    def infinite_when_absent(self, effect: str, file_parameter: str) -> bool:
        """Whether a size, by its name in this machine's files, is infinite without the effect."""
        label = self._catalogue_parameter(file_parameter)
        return bool(np.isinf(self.believed[self.place(effect, label, None)[0]]))

    def unit(self, effect: str, parameter: str) -> str:
        """Return the unit of a catalogue parameter on this machine."""
        units = TRANSLATING_UNITS if self.linear else TURNING_UNITS if self.kind == "axis" else {}
        if parameter in units:
            return units[parameter]
        entry = self.catalogue[effect]["parameters"]
        return next(p["unit"] for p in entry if p["name"] == parameter)

    def _layout(self) -> dict[tuple[str, str], tuple[int, int]]:
        place = len(_core.base_parameters(self.kind))
        places = {}
        for entry in self.model.catalogue:
            stride = self.engine.motors if entry["per_wheel"] else 1
            for parameter in entry["parameters"]:
                places[entry["name"], parameter["name"]] = (stride, place)
                place += stride
        return places

    def _flat_values(self) -> Array:
        values = np.empty(self.engine.parameters)
        for entry in self.model.catalogue:
            for parameter in entry["parameters"]:
                stride, first = self._places[entry["name"], parameter["name"]]
                values[first : first + stride] = parameter["neutral"]
        base = _core.base_parameters(self.kind)
        values[: len(base)] = [parameter["default"] for parameter in base]
        if self.kind == "odometry":
            angles = [p["name"].startswith("odometry.wheel_angles_deg") for p in base]
            values[: len(base)][angles] = np.nan  # wheels it does not have
        for key, places in self._key_places().items():
            values[list(places)] = self.model.values[key]
        if self.kind == "axis":
            speed = AXIS_FRICTION_SPEED["linear" if self.linear else "rotary"]
            values[[p["name"] for p in base].index("axis.friction_speed")] = speed
        for effect in self.model.plant_effects():
            if effect.name in self.catalogue:
                self._apply(values, effect)
        return values

    def _apply(self, values: Array, effect: Effect) -> None:
        """Write an effect of the model file into the flat vector."""
        for name, value in effect.parameters.items():
            catalogue_name = self._catalogue_parameter(name)
            places = list(self.place(effect.name, catalogue_name, effect.wheel))
            values[places] = value

    def _catalogue_parameter(self, name: str) -> str:
        names = axis_names(self.model.values)
        return next((known for known, own in names.items() if own == name), name)

    def _key_places(self) -> dict[str, tuple[int, ...]]:
        names = [parameter["name"] for parameter in _core.base_parameters(self.kind)]
        if self.kind != "axis":
            keys = {key: [key] for key in self.model.values if key != "odometry.counts_per_rev"}
            angles = f"{self.kind}.wheel_angles_deg"
            keys[angles] = [f"{angles}[{i}]" for i in range(self.wheels)]
        else:
            keys = {}
            for key in self.model.values:
                short = key.split(".")[1]
                gain = short.startswith("input_gain")
                plant_key = "axis.input_gain" if gain else AXIS_KEYS.get(short)
                if plant_key:
                    keys[key] = [plant_key]
        return {key: tuple(names.index(n) for n in plant) for key, plant in keys.items()}

    def _may_move(self, key: str) -> bool:
        exact = key in EXACT_KEYS and key not in self.model.tolerance
        return not exact and self.model.values[key] != 0 and self.model.tolerance_of(key) > 0

    def _base_parameter(self, key: str) -> Parameter:
        value = float(self.model.values[key])  # type: ignore[arg-type]
        deviation = abs(value) * self.model.tolerance_of(key)
        most = KEY_REACH * deviation
        return Parameter(key, self._key_places()[key], deviation, value - most, value + most)

    def _candidate(self, entry: dict, wheel: int | None) -> Candidate:
        own = [p for p in entry["parameters"] if (entry["name"], p["name"]) not in EXTENSIONS]
        parameters = [self._effect_parameter(entry["name"], p, wheel) for p in own]
        sizes = [i for i, p in enumerate(own) if p["typical"] != 0]
        shapes = {i: p for i, p in enumerate(own) if p["typical"] == 0}
        starts = _shape_starts(entry["name"], {**shapes, **_infinite(own)})
        if self.kind == "axis" and not math.isfinite(own[0]["neutral"]):  # the grid is a robot's
            ratio = [
                p.scale / (entry["typical"] or entry["neutral"])
                for p, entry in zip(parameters, own, strict=True)
            ]
            starts = tuple({i: x * ratio[i] for i, x in start.items()} for start in starts)
        else:
            size = [self._size(entry["name"], p) for p in own]
            starts = tuple({i: x * size[i] for i, x in start.items()} for start in starts)
        return Candidate(entry["name"], wheel, tuple(parameters), tuple(sizes), starts)

    def _effect_parameter(self, effect: str, entry: dict, wheel: int | None) -> Parameter:
        scale = self._scale(effect, entry)
        places = self.place(effect, entry["name"], wheel)
        low, high = entry["low"], entry["high"]
        if entry["typical"] != 0:  # the catalogue's bounds are those of the nominal robot
            low, high = (end * self._size(effect, entry) for end in (low, high))
        if self.kind == "axis" and entry["name"] in OF_ITS_OWN_SIZE:
            low, high = (math.copysign(math.inf, end) if end else 0.0 for end in (low, high))
        if self.kind == "axis" and entry["name"] == "limit_a":
            low = 0.01 * scale  # the catalogue's bound is in ampere
        if not math.isfinite(entry["neutral"]) and entry["typical"] != 0:
            high = min(high, MOST_OF_ABSENT * scale)
        if entry["name"] == "damping_nm_s_rad":  # beyond, the spring is bridged
            high = MOST_DAMPING * scale
        if entry["name"] == PHASE:  # a fit may go on past half a turn
            low, high = 2.0 * low, 2.0 * high
        return Parameter(entry["name"], places, scale, low, high)

    def _has_starts(self, candidate: Candidate) -> bool:
        """Whether every shaping parameter has a value to start from; a floor patch has none."""
        shapes = [p for i, p in enumerate(candidate.parameters) if i not in candidate.amplitudes]
        return all(np.isfinite(self.believed[list(p.places)]).all() for p in shapes)

    def _scale(self, effect: str, entry: dict) -> float:
        """Size worth looking for: of an axis from its own scale, if that says one."""
        if self.kind == "axis" and effect not in self.model.definitions:
            own = self._axis_size(effect, entry["name"])
            if own is not None:
                return own
        scale = abs(entry["typical"]) if entry["typical"] != 0 else _shape_scale(entry)
        return scale * self._size(effect, entry)

    def _size(self, effect: str, parameter: dict) -> float:
        """How much larger a parameter of the catalogue is in this robot than in the nominal one.

        A secant has to reach as far as the effect may: friction that blocks a smaller motor tells
        nothing of friction that slows it, and beside a larger one it is lost in rounding.
        """
        if self.kind != "robot" or effect in self.model.definitions:
            return 1.0
        unit = parameter["unit"]
        common = self._sizes.get(unit, 1.0)
        return self._sizes.get((self.catalogue[effect]["where"], unit), common)

    def _ratio(self, key: str) -> float:
        """How much larger a key is than that of the nominal robot."""
        nominal = {p["name"]: p["default"] for p in _core.base_parameters("robot")}
        value = float(self.model.values[key])  # type: ignore[arg-type]
        return value / nominal[key] if value > 0 else 1.0

    @property
    def _grip_current_ratio(self) -> float:
        """How much larger the current is that makes a wheel slide: mu m g R / (4 n k2)."""
        ratio = self._ratio
        force = ratio("contact.mu_drive") * ratio("robot.mass_kg") * ratio("contact.gravity_m_s2")
        at_shaft = ratio("robot.wheel_radius_m") / ratio("motor.gear_ratio")
        return force * at_shaft / ratio("motor.torque_constant_nm_a")

    @cached_property
    def _sizes(self) -> dict[str | tuple[str, str], float]:
        """Sizes by unit, or by what it is about and unit: those of motors, drives and bodies."""
        ratio = self._ratio
        resistance, mass = ratio("motor.resistance_ohm"), ratio("robot.mass_kg")
        distance, motor = ratio("robot.wheel_distance_m"), ratio("motor.inertia_kg_m2")
        stall_a = ratio("motor.supply_v") / resistance
        stall_nm = ratio("motor.torque_constant_nm_a") * stall_a
        fastest = ratio("motor.supply_v") / ratio("motor.back_emf_constant_v_s_rad")
        sizes: dict[str | tuple[str, str], float] = dict.fromkeys(OF_THE_BODY, mass)
        sizes |= dict.fromkeys(OF_THE_DRIVE, motor * ratio("motor.gear_ratio") ** 2)
        return sizes | {
            "A": stall_a,
            "1/(A^2 s)": stall_a**-2,
            "ohm": resistance,
            "H": resistance,
            "N m": stall_nm,
            "N m s": stall_nm / fastest,
            "N m s^2": stall_nm / fastest**2,
            ("shaft", "rad/s"): fastest,
            ("motor", INERTIA): motor,
            ("body", INERTIA): ratio("robot.inertia_kg_m2"),
            ("body", "N m"): mass * distance,
            ("body", "m"): distance,
        }

    def _axis_size(self, effect: str, parameter: str) -> float | None:
        """Size from the force of an axis at unit command, its inertia and friction."""
        inertia, gain, _, viscous = self.believed[:4]
        viscous_size = max(0.1 * viscous, 0.01 * inertia)
        load_share = self.catalogue["shaft_compliance"]["parameters"][2]["neutral"]
        reduced = load_share * (1.0 - load_share) * inertia
        sizes = {
            "torque_nm": 0.1 * gain,
            "limit_a": AXIS_COMMAND * gain,
            "viscous_friction_nm_s": viscous_size,
            "viscous_nm_s": viscous_size,
            "mass_kg": 0.05 * (self.model.values.get(PENDULUM) or inertia),
            "inertia_kg_m2": 0.05 * inertia,
            "stiffness_nm_rad": reduced * AXIS_RESONANCE_RAD_S**2,
            "damping_nm_s_rad": 0.4 * reduced * AXIS_RESONANCE_RAD_S,  # damping ratio 0.2
        }
        if effect == "quadratic_wheel_drag":
            return viscous_size**2 / (0.1 * gain)  # as strong as the viscous at 0.1 gain
        return sizes.get(parameter)


def count_rad(machine: Machine) -> float:
    """Return the angle of a shaft between two counts."""
    return 2.0 * np.pi / float(machine.model.values["encoder.counts_per_rev"])


def stall_current_a(machine: Machine) -> float:
    """Return the current of a motor at rest at full duty."""
    return machine.model.values["motor.supply_v"] / machine.model.values["motor.resistance_ohm"]


def no_load_speed_rad_s(machine: Machine) -> float:
    """Return how fast a shaft turns at full duty that nothing brakes."""
    return (
        machine.model.values["motor.supply_v"] / machine.model.values["motor.torque_constant_nm_a"]
    )


def stall_acceleration_rad_s2(machine: Machine) -> float:
    """Return how fast a motor at rest that drives nothing starts at full duty."""
    values = machine.model.values
    return (
        stall_current_a(machine)
        * values["motor.torque_constant_nm_a"]
        / values["motor.inertia_kg_m2"]
    )


def _infinite(parameters: Sequence[dict]) -> dict[int, dict]:
    """Sizes that are infinite when absent: a step from there has no slope, so they have starts."""
    return {
        i: p
        for i, p in enumerate(parameters)
        if p["typical"] != 0 and not math.isfinite(p["neutral"])
    }


def _shape_scale(parameter: dict) -> float:
    if parameter["unit"] == PERIODIC_UNIT:
        return 0.3
    return (
        max(0.1 * abs(parameter["neutral"]), 0.05) if math.isfinite(parameter["neutral"]) else 0.3
    )


# Parameters that refine an effect once it is named, where it alone does not fit.
EXTENSIONS = {
    (CURVE, "brush"),
    (CURVE, "root"),
    (CURVE, "exponential"),
    (CURVE, "rational"),
    (CURVE, "straight"),
    (CURVE, "peaked"),
    (CURVE, "roller"),
    ("shaft_compliance", "load_share"),
    ("gear_backlash", "load_share"),
    ("gear_backlash", "tooth_frequency_rad_s"),
    ("gear_backlash", "tooth_damping_ratio"),
    ("winding_heating", "cooling_time_s"),
}

WHOLE = {("cogging", "cycles_per_rev"), ("roller_ripple", "rollers")}
"""Numbers of teeth, magnets or rollers, which on a robot are whole."""

# Starting values of shaping parameters; where the fit is not convex one start is not enough.
SHAPE_GRIDS = {
    ("stribeck_friction", "speed_rad_s"): (4.0, 12.0, 40.0),
    # Each number, for one next to it is out of step after some turns; then some of many slots.
    ("cogging", "cycles_per_rev"): tuple(
        float(n) for n in (*range(1, 25), 28, 30, 36, 42, 48, 60, 72, 84)
    ),
    ("roller_ripple", "rollers"): tuple(float(n) for n in range(6, 25)),
    ("grip_falloff", "speed_m_s"): (0.1, 0.3, 0.9),
    ("bristle_relaxation", "rolling"): (0.0, 1.0, 2.0),  # the last: the slip lags
    ("current_limit", "limit_a"): (2.5, 5.0, 9.0, 15.0),
    ("shaft_compliance", "stiffness_nm_rad"): (30.0, 100.0, 300.0),
    ("cogging", "phase_rad"): (0.0, math.pi / 2),
    ("wheel_eccentricity", "phase_rad"): (0.0, math.pi / 2),
}


def _shape_starts(effect: str, shapes: Mapping[int, dict]) -> tuple[dict[int, float], ...]:
    starts: list[dict[int, float]] = [{}]
    for index, parameter in shapes.items():
        own = parameter.get("starts", (parameter["neutral"],))
        grid = SHAPE_GRIDS.get((effect, parameter["name"]), own)
        starts = [{**start, index: value} for start in starts for value in grid]
    return tuple(starts)
