"""What the firmware is to believe about a robot: gains, limits and model from its model file.

The values are those of firmware_parameters.py. Effects that the model file adds (as `gap find`
does) are taken into the values where the firmware has a term for them, see EFFECTS; the others are
named, so that nobody believes the firmware to know them.
"""

from collections.abc import Callable
from dataclasses import dataclass

from omnislip.errors import InputError
from omnislip.firmware_parameters import firmware_parameters
from omnislip.link.protocol import PARAMETERS
from omnislip.model_file import Model

Change = Callable[[float, float], float]


def _add(value: float, parameter: float) -> float:
    return value + parameter


def _scale(value: float, parameter: float) -> float:
    return value * parameter


# Effect of all wheels, its parameter, the keys it changes and how.
EFFECTS: dict[str, tuple[str, tuple[str, ...], Change]] = {
    "coulomb_friction": ("torque_nm", ("motor.coulomb_friction_nm",), _add),
    "viscous_friction_error": ("viscous_friction_nm_s", ("motor.viscous_friction_nm_s",), _add),
    "motor_inertia_error": ("inertia_kg_m2", ("motor.inertia_kg_m2",), _add),
    "torque_constant_error": (
        "scale",
        ("motor.torque_constant_nm_a", "motor.back_emf_constant_v_s_rad"),
        _scale,
    ),
    "payload": ("mass_kg", ("robot.mass_kg",), _add),
    "inertia_error": ("inertia_kg_m2", ("robot.inertia_kg_m2",), _add),
    "wheel_radius_error": ("scale", ("robot.wheel_radius_m",), _scale),
    "wheel_distance_error": ("scale", ("robot.wheel_distance_m",), _scale),
    "low_grip": ("scale", ("contact.mu_drive",), _scale),
    "slip_stiffness_error": ("scale", ("contact.slip_stiffness_s_m",), _scale),
    "roller_friction": ("mu", ("contact.mu_roller",), _add),
}


@dataclass(frozen=True)
class Gains:
    """Raw firmware parameters by name, and what became of the effects of the model file."""

    raw: dict[str, int]
    effects_used: list[str]
    effects_not_used: list[str]


def gains(model: Model) -> Gains:
    """Return the firmware parameters of a robot. InputError names the file and the key."""
    if model.kind != "robot":
        raise InputError(f"{model.path}: model.kind is '{model.kind}', gains need a 'robot'")
    values = dict(model.values)
    values["motor.coulomb_friction_nm"] = 0.0
    used, not_used = [], []
    for effect in model.effects:
        parameter, keys, change = EFFECTS.get(effect.name, ("", (), _add))
        if not keys or effect.wheel is not None or effect.run is not None:
            not_used.append(effect.name)
            continue
        used.append(effect.name)
        for key in keys:
            values[key] = change(values[key], effect.parameters[parameter])
    try:
        raw = firmware_parameters(values)
    except ValueError as error:
        raise InputError(f"{model.path}: {error}") from None
    return Gains(raw, used, not_used)


def describe(found: Gains) -> dict[str, object]:
    """Return what `omnislip gains --json` prints: value, unit, raw and text per parameter."""
    return {
        "schema": "omnislip-gains/1",
        "parameters": {
            name: {
                "value": row.value(found.raw[name]),
                "unit": row.unit,
                "raw": found.raw[name],
                "description": row.description,
            }
            for name, row in PARAMETERS.items()
        },
        "effects_used": found.effects_used,
        "effects_not_used": found.effects_not_used,
    }
