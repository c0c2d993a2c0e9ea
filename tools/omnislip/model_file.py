"""The model file robot.toml: what is believed about a machine, how well, and its extra effects.

[model] kind says what the machine is (default "robot"):
    robot     four driven omni wheels; tables [robot] [motor] [contact] [encoder]
    axis      one driven axis, translating (mass_kg, N) or turning (inertia_kg_m2, N m). The mass or
              inertia is that of all that moves: of a pendulum, too
    odometry  geometry of a robot with 2 to 8 wheels, encoders only. The encoders are counted per
              turn of the wheel, so that positive counts turn the robot counter-clockwise. Two
              wheels on one axle, or two tracks, have angles that differ by 180 degrees. A mecanum
              wheel has roller_angle_deg = 45 (0, the default, is an omni wheel); wheel_angles_deg
              and wheel_distance_m are then those of the line in which it pushes: a wheel at (x, y)
              whose rollers push along (cos b, sin b) has the angle b - 90 degrees and the distance
              x sin b - y cos b

[tolerance] gives the relative standard deviation of each believed value: `default` and one entry
per key. Gear ratio, gravity, counts and angles are taken as exact, whatever the default; a single
number among them is not where it has an entry of its own. Each [[effects.NAME]] table adds one
effect of the catalogue to the model. A [define.NAME] table defines an effect of the user's own
(user_effects.py). Every key has its unit in its name; unknown and missing keys are errors.
"""

import copy
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from omnislip import _core
from omnislip.errors import InputError
from omnislip.files import (
    check_known,
    check_number,
    check_numbers,
    check_table,
    load_toml,
    write_text,
)
from omnislip.user_effects import read_entries

DEFAULT_TOLERANCE = 0.02
NOMINAL_ROBOT = Path(__file__).parent / "robots" / "msl_omni_4.toml"

LEAST_OF_PENDULUM = 0.8
"""Share of a pendulum's mass times its squared length, each believed to some percents, that the
inertia of its axis must have."""

POSITIVE = "greater than 0"
NOT_NEGATIVE = "0 or more"
COUNT = "a whole number greater than 0"
ANGLES = "a list of angles, one per wheel"
ACUTE = "0 or more and less than 90"

NEVER_FITTED = {
    "robot.wheel_angles_deg",
    "odometry.wheel_angles_deg",
    "odometry.counts_per_rev",
    "axis.supply_v",
}

ROBOT_KEYS = {
    "robot.mass_kg": POSITIVE,
    "robot.inertia_kg_m2": POSITIVE,
    "robot.wheel_radius_m": POSITIVE,
    "robot.wheel_distance_m": POSITIVE,
    "robot.wheel_angles_deg": ANGLES,
    "motor.resistance_ohm": POSITIVE,
    "motor.torque_constant_nm_a": POSITIVE,
    "motor.back_emf_constant_v_s_rad": POSITIVE,
    "motor.gear_ratio": POSITIVE,
    "motor.inertia_kg_m2": POSITIVE,
    "motor.viscous_friction_nm_s": NOT_NEGATIVE,
    "motor.supply_v": POSITIVE,
    "contact.mu_drive": POSITIVE,
    "contact.mu_roller": NOT_NEGATIVE,
    "contact.slip_stiffness_s_m": POSITIVE,
    "contact.gravity_m_s2": POSITIVE,
    "encoder.counts_per_rev": COUNT,
}
# Input gains: force (or torque) per volt, per ampere, or at duty 1.
TRANSLATING_AXIS_KEYS = {
    "axis.mass_kg": POSITIVE,
    "axis.input_gain_n_v": POSITIVE,
    "axis.input_gain_n_a": POSITIVE,
    "axis.input_gain_n": POSITIVE,
    "axis.back_emf_n_s_m": NOT_NEGATIVE,
    "axis.viscous_friction_n_s_m": NOT_NEGATIVE,
    "axis.supply_v": POSITIVE,
}
TURNING_AXIS_KEYS = {
    "axis.inertia_kg_m2": POSITIVE,
    "axis.input_gain_nm_v": POSITIVE,
    "axis.input_gain_nm_a": POSITIVE,
    "axis.input_gain_nm": POSITIVE,
    "axis.back_emf_nm_s_rad": NOT_NEGATIVE,
    "axis.viscous_friction_nm_s_rad": NOT_NEGATIVE,
    "axis.pendulum_mass_kg": POSITIVE,
    "axis.pendulum_length_m": POSITIVE,
    "axis.gravity_m_s2": POSITIVE,
    "axis.supply_v": POSITIVE,
}
# The catalogue of effects speaks of shafts and currents. In the file of an axis its parameters have
# the names, and so the units, of what the axis knows.
TURNING_NAMES = {"limit_a": "limit_nm"}
TRANSLATING_NAMES = {
    "limit_a": "limit_n",
    "torque_nm": "force_n",
    "viscous_friction_nm_s": "viscous_friction_n_s_m",
    "viscous_nm_s": "viscous_n_s_m",
    "speed_rad_s": "speed_m_s",
    "cycles_per_rev": "cycles_per_m_2pi",
    "angle_rad": "play_m",
    "stiffness_nm_rad": "stiffness_n_m",
    "damping_nm_s_rad": "damping_n_s_m",
}
ODOMETRY_KEYS = {
    "odometry.wheel_radius_m": POSITIVE,
    "odometry.wheel_distance_m": POSITIVE,
    "odometry.wheel_angles_deg": ANGLES,
    "odometry.counts_per_rev": COUNT,
    "odometry.roller_angle_deg": ACUTE,
}
OPTIONAL_ODOMETRY_KEYS = ("odometry.roller_angle_deg",)
KINDS = ("robot", "axis", "odometry")
MIN_ODOMETRY_WHEELS, MAX_ODOMETRY_WHEELS = 2, 8


# Wiring mistakes are mended in the logs before the plant sees them. wheel_permutation: encoder
# column i shows wheel wheels[i], or duty (and current) of column i are of that wheel, or both; the
# signs: counts, or duty, of one wheel the other way round.
WIRING = ("wheel_permutation", "encoder_sign", "motor_sign")
WHEEL_COLUMNS = {
    "encoders": ("encoder_counts",),
    "motors": ("duty", "current_a"),
    "both": ("encoder_counts", "duty", "current_a"),
}
"""Columns of a wheel that have changed places, by `of`; without it those of the encoders.

The driver measures the current in the sense of its duty."""
ENCODERS, MOTORS, BOTH = WHEEL_COLUMNS
# A push in one run, world frame, at the centre of gravity: the log is cut there.
IMPACT_KEYS = ("time_s", "impulse_x_n_s", "impulse_y_n_s", "impulse_theta_n_m_s")
# Effects that are added to a mass or an inertia, and the keys of which one holds it: something of
# it must be left.
ADDED_TO = {
    "payload": ("robot.mass_kg", "axis.mass_kg", "axis.pendulum_mass_kg", "axis.inertia_kg_m2"),
    "inertia_error": ("robot.inertia_kg_m2", "axis.inertia_kg_m2", "axis.mass_kg"),
    "motor_inertia_error": ("motor.inertia_kg_m2",),
}


@dataclass(frozen=True)
class Effect:
    """One effect of the catalogue; `wheel` None means all wheels, `run` None all runs."""

    name: str
    parameters: dict[str, float | str | list[int]]
    wheel: int | None = None
    run: str | None = None


@dataclass(frozen=True)
class Model:
    """A model file: flat keys such as 'robot.mass_kg', in SI units as their names say."""

    kind: str
    values: dict[str, float | list[float]]
    tolerance: dict[str, float] = field(default_factory=lambda: {"default": DEFAULT_TOLERANCE})
    effects: list[Effect] = field(default_factory=list)
    name: str = ""
    path: Path | None = None
    definitions: dict[str, dict[str, Any]] = field(default_factory=dict)
    """The user's own effects, as written in [define.NAME]."""
    own_effects: list[dict[str, Any]] = field(default_factory=list)
    """Their entries beside those of the catalogue (user_effects.read_entries)."""

    @property
    def catalogue(self) -> list[dict[str, Any]]:
        """Entries of all effects that this model may have: of the catalogue, then the user's."""
        return [*_core.effects(), *self.own_effects]

    def tolerance_of(self, key: str) -> float:
        """Return the relative standard deviation with which the value of `key` is believed."""
        return self.tolerance.get(key, self.tolerance["default"])

    def to_core(self) -> tuple[dict[str, float], list[dict[str, Any]]]:
        """Return parameters and effects of a robot as omnislip._core.simulate takes them.

        Lists become one entry per element, 'robot.wheel_angles_deg[0]'. Parameters that an effect
        leaves out get their neutral value.
        """
        parameters: dict[str, float] = {}
        for key, value in self.values.items():
            if isinstance(value, list):
                parameters |= {f"{key}[{index}]": item for index, item in enumerate(value)}
            else:
                parameters[key] = value
        return parameters, [self._effect_to_core(effect) for effect in self.plant_effects()]

    def plant_effects(self) -> list[Effect]:
        """Return what is no wiring and no push; a wheel's effect after that of all wheels.

        The last one counts where both have a parameter.
        """
        plant = [effect for effect in self.effects if effect.name not in (*WIRING, "impact")]
        return sorted(plant, key=lambda effect: effect.wheel is not None)

    def _effect_to_core(self, effect: Effect) -> dict[str, Any]:
        entry = next(entry for entry in self.catalogue if entry["name"] == effect.name)
        neutral = {parameter["name"]: parameter["neutral"] for parameter in entry["parameters"]}
        return {
            "name": effect.name,
            "wheel": effect.wheel,
            "parameters": neutral | effect.parameters,
        }


def read_model(path: Path | str) -> Model:
    """Read and check a model file. InputError names the file, the key and what would be right."""
    path = Path(path)
    return parse_model(load_toml(path), path)


def parse_model(data: Mapping[str, Any], path: Path) -> Model:
    """Return the model of the parsed file `data`; `path` is for the messages."""
    data = copy.deepcopy(dict(data))
    header = check_table(data.pop("model", {}), "model", path)
    check_known(header, ["kind"], "key in [model]", path)
    kind = header.get("kind", "robot")
    if kind not in KINDS:
        raise InputError(f"{path}: model.kind must be one of {', '.join(KINDS)}, not {kind!r}")
    tolerance = check_table(data.pop("tolerance", {}), "tolerance", path)
    effects = check_table(data.pop("effects", {}), "effects", path)
    definitions = check_table(data.pop("define", {}), "define", path)
    name = data.get(kind, {}).pop("name", "") if isinstance(data.get(kind), dict) else ""
    if not isinstance(name, str):
        raise InputError(f"{path}: '{kind}.name' must be a text, not {name!r}")
    values = _read_values(kind, data, path)
    own_effects = _read_own_effects(definitions, kind, path)
    return Model(
        kind=kind,
        values=values,
        tolerance=_read_tolerance(tolerance, values, path),
        effects=_read_effects(effects, kind, values, [*_core.effects(), *own_effects], path),
        name=name,
        path=path,
        definitions=definitions,
        own_effects=own_effects,
    )


def axis_names(values: Mapping[str, Any]) -> dict[str, str]:
    """Return catalogue name -> name in the file of the parameters that an axis calls otherwise."""
    if "axis.mass_kg" in values:
        return TRANSLATING_NAMES
    return TURNING_NAMES if "axis.inertia_kg_m2" in values else {}


def with_definitions(model: Model, tables: Mapping[str, Any], path: Path) -> Model:
    """Return the model with more effects of the user's, from the [define.NAME] of another file."""
    doubled = [name for name in tables if name in model.definitions]
    if doubled:
        raise InputError(f"{path}: '{doubled[0]}' is defined in {model.path} already")
    definitions = model.definitions | dict(tables)
    own_effects = [*model.own_effects, *_read_own_effects(tables, model.kind, path)]
    return replace(model, definitions=definitions, own_effects=own_effects)


def write_model(model: Model, path: Path | str) -> None:
    """Write `model` so that read_model gives it back; whole or not at all."""
    write_text(Path(path), format_model(model))


def format_model(model: Model) -> str:
    """Return the text of the model file."""
    lines = ["# Model of a machine for omnislip. The unit of a value is in the name of its key."]
    if model.kind != "robot":
        lines += ["", "[model]", f"kind = {_toml(model.kind)}"]
    for section, table in _sections(model).items():
        lines += ["", f"[{section}]", *(f"{key} = {_toml(item)}" for key, item in table.items())]
    lines += ["", "[tolerance] # relative standard deviation of the values above"]
    lines += [f"{_toml_key(key)} = {_toml(item)}" for key, item in model.tolerance.items()]
    for name, table in model.definitions.items():
        lines += ["", f"[define.{name}]"]
        lines += [f"{key} = {_toml(item)}" for key, item in table.items()]
    for effect in model.effects:
        lines += ["", f"[[effects.{effect.name}]]"]
        lines += [f"{key} = {_toml(item)}" for key, item in _effect_table(effect).items()]
    return "\n".join(lines) + "\n"


def _sections(model: Model) -> dict[str, dict[str, Any]]:
    sections: dict[str, dict[str, Any]] = {model.kind: {"name": model.name} if model.name else {}}
    for flat_key, value in model.values.items():
        section, key = flat_key.split(".")
        sections.setdefault(section, {})[key] = value
    return sections


def _effect_table(effect: Effect) -> dict[str, Any]:
    marks = {"wheel": effect.wheel, "run": effect.run}
    return {key: item for key, item in marks.items() if item is not None} | effect.parameters


def _toml(value: str | float | list[float] | dict[str, Any]) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, str):
        # JSON strings are TOML strings, except that TOML wants DEL escaped too.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)


def _toml_key(key: str) -> str:
    return _toml(key) if "." in key else key


def _read_values(
    kind: str, sections: Mapping[str, Any], path: Path
) -> dict[str, float | list[float]]:
    rules = _rules(kind, sections)
    check_known(sections, {key.split(".")[0] for key in rules} | {kind}, "table", path)
    flat = {
        f"{section}.{key}": value
        for section, table in sections.items()
        for key, value in check_table(table, section, path).items()
    }
    check_known(flat, rules, "key", path)
    _check_complete(kind, flat, rules, path)
    values = {
        key: _read_value(flat[key], key, rules[key], kind, path) for key in rules if key in flat
    }
    _check_pendulum(values, path)
    return values


def _rules(kind: str, sections: Mapping[str, Any]) -> dict[str, str]:
    if kind == "robot":
        return ROBOT_KEYS
    if kind == "odometry":
        return ODOMETRY_KEYS
    turning = "inertia_kg_m2" in sections.get("axis", {})
    return TURNING_AXIS_KEYS if turning else TRANSLATING_AXIS_KEYS


def _check_complete(kind: str, given: Mapping[str, Any], rules: dict[str, str], path: Path) -> None:
    if kind == "axis":
        _check_axis_complete(given, rules, path)
        return
    missing = [key for key in rules if key not in given and key not in OPTIONAL_ODOMETRY_KEYS]
    if missing:
        raise InputError(f"{path}: missing keys: {', '.join(missing)}")


def _check_axis_complete(given: Mapping[str, Any], rules: dict[str, str], path: Path) -> None:
    if "axis.mass_kg" not in given and "axis.inertia_kg_m2" not in given:
        raise InputError(f"{path}: missing key: axis.mass_kg or axis.inertia_kg_m2")
    gains = [key for key in rules if key.startswith("axis.input_gain")]
    if sum(key in given for key in gains) != 1:
        raise InputError(f"{path}: exactly one of these keys is needed: {', '.join(gains)}")
    if ("axis.pendulum_mass_kg" in given) != ("axis.pendulum_length_m" in given):
        raise InputError(
            f"{path}: a pendulum needs both axis.pendulum_mass_kg and axis.pendulum_length_m"
        )


def _check_pendulum(values: Mapping[str, Any], path: Path) -> None:
    """No pendulum has less inertia than with all its mass in its centre of gravity."""
    length_m = values.get("axis.pendulum_length_m", 0.0)
    least = values.get("axis.pendulum_mass_kg", 0.0) * length_m**2
    inertia = values.get("axis.inertia_kg_m2", math.inf)
    if inertia < LEAST_OF_PENDULUM * least:
        raise InputError(
            f"{path}: 'axis.inertia_kg_m2' is that of all that turns, of the pendulum (mass times "
            f"length squared, {least:.3g}) too, not {inertia:g}"
        )


def _read_value(value: object, key: str, rule: str, kind: str, path: Path) -> float | list[float]:
    if rule == ANGLES:
        count = len(value) if isinstance(value, list) else 0
        most, least = MAX_ODOMETRY_WHEELS, MIN_ODOMETRY_WHEELS
        wanted = 4 if kind == "robot" else min(max(count, least), most)
        angles = check_numbers(value, wanted, key, path)
        if max(angles) - min(angles) < 2.0 * math.pi:
            raise InputError(
                f"{path}: '{key}' has all wheels in the same place; degrees are expected, not "
                f"radians: {value}"
            )
        different = sorted({round(angle % 360.0, 6) for angle in angles})
        parallel = math.isclose(different[-1] - different[0], 180.0)
        if kind == "odometry" and len(different) < 3 and not parallel:
            raise InputError(
                f"{path}: '{key}' needs at least three different angles, or two that differ by 180 "
                f"degrees, not {value}"
            )
        return angles
    number = check_number(value, key, path)
    in_range = number >= 0 if rule in (NOT_NEGATIVE, ACUTE) else number > 0
    in_range = in_range and (rule != ACUTE or number < 90)
    if not in_range or (rule == COUNT and not number.is_integer()):
        raise InputError(f"{path}: '{key}' must be {rule}, not {value}")
    return number


def _read_tolerance(
    table: Mapping[str, Any], values: Mapping[str, Any], path: Path
) -> dict[str, float]:
    # "robot.mass_kg" = 0.01 and robot.mass_kg = 0.01 mean the same to a reader of the file.
    flat: dict[str, Any] = {"default": DEFAULT_TOLERANCE}
    for key, item in table.items():
        nested = item if isinstance(item, dict) else {}
        flat |= {f"{key}.{name}": value for name, value in nested.items()} or {key: item}
    check_known(flat, ["default", *values], "key in [tolerance]", path)
    tolerance = {key: check_number(item, f"tolerance.{key}", path) for key, item in flat.items()}
    for key, item in tolerance.items():
        if item < 0:
            raise InputError(f"{path}: 'tolerance.{key}' must be {NOT_NEGATIVE}, not {item}")
        if item > 0 and key in NEVER_FITTED:
            raise InputError(f"{path}: 'tolerance.{key}' must be 0 or left out: it is not fitted")
    return tolerance


def _read_own_effects(tables: Mapping[str, Any], kind: str, path: Path) -> list[dict[str, Any]]:
    for name in (*WIRING, "impact"):
        if name in tables:
            raise InputError(f"{path}: 'define.{name}': there is an effect of that name already")
    return read_entries(tables, kind, path)


def _read_effects(
    tables: Mapping[str, Any],
    kind: str,
    values: Mapping[str, Any],
    entries: list[dict[str, Any]],
    path: Path,
) -> list[Effect]:
    catalogue = {entry["name"]: entry for entry in entries}
    check_known(tables, [*catalogue, *WIRING, "impact"], "effect", path)
    effects = []
    for name, occurrences in tables.items():
        if not isinstance(occurrences, list):
            raise InputError(f"{path}: effect '{name}' must be written [[effects.{name}]]")
        if name in WIRING or name == "impact":
            if kind != "robot":
                raise InputError(f"{path}: effect '{name}' does not apply to kind '{kind}'")
            read = _read_impact if name == "impact" else _read_wiring
            effects += [read(name, table, path) for table in occurrences]
            continue
        entry = catalogue[name]
        if kind not in entry["kinds"]:
            raise InputError(f"{path}: effect '{name}' does not apply to a model of kind '{kind}'")
        effects += [_read_effect(entry, table, kind, values, path) for table in occurrences]
    _check_once(effects, path)
    return effects


def _check_once(effects: list[Effect], path: Path) -> None:
    seen = set()
    for effect in effects:
        if effect.name != "impact" and (effect.name, effect.wheel) in seen:
            which = f" on wheel {effect.wheel}" if effect.wheel else ""
            raise InputError(f"{path}: effect '{effect.name}'{which} is there twice")
        seen.add((effect.name, effect.wheel))


def _read_effect(
    entry: dict[str, Any], table: object, kind: str, values: Mapping[str, Any], path: Path
) -> Effect:
    where = f"effects.{entry['name']}"
    table = dict(check_table(table, where, path))
    names = axis_names(values)
    known = {names.get(p["name"], p["name"]): p for p in entry["parameters"]}
    wheel_count = len(values.get(f"{kind}.wheel_angles_deg", []))
    wheel = _read_wheel(table.pop("wheel", None), entry, wheel_count, path)
    if "run" in table:
        raise InputError(f"{path}: effect '{entry['name']}' acts on all runs; remove 'run'")
    check_known(table, known, f"parameter of effect '{entry['name']}'", path)
    numbers = {key: check_number(item, f"{where}.{key}", path) for key, item in table.items()}
    for key, number in numbers.items():
        limits = _natural_limits(entry["name"], known[key], kind, values)
        _check_size(number, known[key], limits, f"{where}.{key}", path)
    for low, high in (("x_min_m", "x_max_m"), ("y_min_m", "y_max_m")):
        if numbers.get(low, -math.inf) >= numbers.get(high, math.inf):
            raise InputError(f"{path}: '{where}.{low}' must be less than {high}")
    return Effect(entry["name"], numbers, wheel)


def _natural_limits(
    effect: str, parameter: dict[str, Any], kind: str, values: Mapping[str, Any]
) -> tuple[float, float]:
    """Return the limits next to the catalogue's bounds that no machine can pass.

    The bounds are those of the search, for a robot about as big as the nominal one.
    """
    for key in ADDED_TO.get(effect, ()):
        if key in values:
            return -values[key], math.inf
    reach = math.inf
    # Shares, and delays: no part of a machine is a second late, but many a file says milliseconds.
    # The command of an axis is no share, it may be in volt.
    if parameter["unit"] in ("1", "s") and (kind, parameter["name"]) != ("axis", "duty"):
        reach = 1.0
    if effect == "cog_offset":  # beyond the wheels the robot falls over
        reach = values["robot.wheel_distance_m"]
    low = max(limit for limit in (-math.inf, -reach, 0.0) if limit <= parameter["low"])
    return low, min(limit for limit in (0.0, reach, math.inf) if limit >= parameter["high"])


def _check_size(
    number: float, parameter: dict[str, Any], limits: tuple[float, float], where: str, path: Path
) -> None:
    """A limit belongs to what is right where the search goes as far."""
    low, high = limits
    rules = []
    if low == parameter["low"] > -math.inf:
        rules.append((number >= low, f"{low:g} or more"))
    elif low > -math.inf:
        rules.append((number > low, f"greater than {low:g}"))
    if high == parameter["high"] < math.inf:
        rules.append((number <= high, f"{high:g} or less"))
    elif high < math.inf:
        rules.append((number < high, f"less than {high:g}"))
    if not all(holds for holds, _ in rules):
        right = " and ".join(text for _, text in rules)
        raise InputError(f"{path}: '{where}' must be {right}, not {number:g}")


def _read_impact(name: str, table: object, path: Path) -> Effect:
    table = dict(check_table(table, "effects.impact", path))
    run = table.pop("run", None)
    if not isinstance(run, str):
        raise InputError(f"{path}: 'effects.impact.run' must be the name of a run, not {run!r}")
    check_known(table, IMPACT_KEYS, "parameter of effect 'impact'", path)
    if "time_s" not in table:
        raise InputError(f"{path}: 'effects.impact' misses time_s")
    table = dict.fromkeys(IMPACT_KEYS, 0.0) | table
    numbers = {
        key: check_number(item, f"effects.impact.{key}", path) for key, item in table.items()
    }
    return Effect(name, numbers, run=run)


def _read_wiring(name: str, table: object, path: Path) -> Effect:
    where = f"effects.{name}"
    table = dict(check_table(table, where, path))
    if name == "wheel_permutation":
        check_known(table, ["wheels", "of"], f"parameter of effect '{name}'", path)
        wheels = check_numbers(table.get("wheels"), 4, f"{where}.wheels", path)
        if sorted(wheels) != [1.0, 2.0, 3.0, 4.0]:
            raise InputError(f"{path}: '{where}.wheels' must hold 1, 2, 3 and 4 once each")
        of = table.get("of", ENCODERS)
        if of not in list(WHEEL_COLUMNS):
            known = " or ".join(f"'{one}'" for one in WHEEL_COLUMNS)
            raise InputError(f"{path}: '{where}.of' must be {known}, not {of!r}")
        order = {"wheels": [int(wheel) for wheel in wheels]}
        return Effect(name, order | ({"of": of} if "of" in table else {}))
    check_known(table, ["wheel"], f"parameter of effect '{name}'", path)
    single = {"name": name, "scope": "single"}
    return Effect(name, {}, _read_wheel(table.get("wheel"), single, 4, path))


def _read_wheel(value: object, entry: dict[str, Any], wheel_count: int, path: Path) -> int | None:
    name, scope = entry["name"], entry["scope"]
    if value is None:
        if scope == "single":
            raise InputError(f"{path}: effect '{name}' acts on one wheel; add wheel = 1 to 4")
        return None
    if scope == "whole":
        raise InputError(f"{path}: effect '{name}' acts on the whole machine; remove 'wheel'")
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= wheel_count:
        raise InputError(f"{path}: 'effects.{name}.wheel' must be 1 to {wheel_count}, not {value}")
    return value
