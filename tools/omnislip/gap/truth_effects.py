"""Hidden effects of the truth generator: names, parameters, sizes, where they enter the plant.

`EFFECTS` speaks the vocabulary of `robot.toml` and `gap.json`; `UNKNOWN_EFFECTS` is physics that
this vocabulary does not hold, to see whether a workflow admits that it does not know. A size is
drawn log-uniformly over one decade around the typical value (less where the decade would leave
physics), so a solver cannot live on a prior of the sizes. Effects that change a believed key of
`robot.toml` begin above two of its tolerances: below that they are no effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omnislip.errors import InputError


@dataclass(frozen=True)
class Draw:
    """A parameter: the plant field, what happens to it (`add`, `scale`, `set`), the sizes drawn.

    kind: `size` log-uniform low..high, `signed` the same with either sign, `loss` 1 - size,
    `change` 1 +- size, `uniform` low..high, `whole` an integer low..high, `keep` always low.
    """

    plant_field: str
    operation: str
    kind: str
    low: float
    high: float
    optional: bool = False

    def typical(self) -> float:
        """Geometric (uniform: arithmetic) middle of the range, positive branch."""
        if self.kind in ("uniform", "whole"):
            middle = 0.5 * (self.low + self.high)
            return float(round(middle)) if self.kind == "whole" else middle
        size = float(np.sqrt(self.low * self.high)) if self.kind != "keep" else self.low
        return {"loss": 1.0 - size, "change": 1.0 + size}.get(self.kind, size)

    def sample(self, rng: np.random.Generator) -> float:
        """One random value."""
        if self.kind == "keep":
            return self.low
        if self.kind == "uniform":
            return float(rng.uniform(self.low, self.high))
        if self.kind == "whole":
            return float(rng.integers(int(self.low), int(self.high) + 1))
        size = float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        sign = float(rng.choice([-1.0, 1.0]))
        return {
            "size": size,
            "signed": sign * size,
            "loss": 1.0 - size,
            "change": 1.0 + sign * size,
        }[self.kind]


@dataclass(frozen=True)
class Effect:
    """What the tables say of an effect.

    wheel: `one` (must be given), `any` (one or all), `none`. needs: the sensor without which a log
    cannot show it. drawn: whether `random_case` may hide it. physics: for the unknown ones.
    """

    parameters: Mapping[str, Draw]
    wheel: str = "none"
    needs: str = ""
    drawn: bool = True
    physics: str = ""
    requires_run: bool = False


def _size(plant_field: str, typical: float, operation: str = "add", span: float = 10.0) -> Draw:
    return Draw(plant_field, operation, "size", typical / span**0.5, typical * span**0.5)


def _signed(plant_field: str, typical: float, span: float = 10.0) -> Draw:
    return Draw(plant_field, "add", "signed", typical / span**0.5, typical * span**0.5)


def _loss(plant_field: str, low: float, high: float) -> Draw:
    return Draw(plant_field, "scale", "loss", low, high)


def _change(plant_field: str, low: float, high: float) -> Draw:
    return Draw(plant_field, "scale", "change", low, high)


def _set(plant_field: str, low: float, high: float, kind: str = "size") -> Draw:
    return Draw(plant_field, "set", kind, low, high)


def _phase(plant_field: str) -> Draw:
    return Draw(plant_field, "set", "uniform", -np.pi, np.pi)


def _bound(plant_field: str) -> Draw:
    return Draw(plant_field, "set", "keep", 0.0, 0.0, optional=True)


EFFECTS: dict[str, Effect] = {
    # supply, driver, motor
    "supply_sag": Effect({"source_resistance_ohm": _size("source_resistance_ohm", 0.12)}),
    "state_of_charge_drift": Effect({"rate_1_s": _size("charge_rate_1_s", 0.008)}),
    "dead_zone": Effect({"duty": _size("dead_zone_duty", 0.03)}, "any"),
    "driver_nonlinearity": Effect({"cubic": _signed("cubic", 0.4)}, "any"),
    "actuation_delay": Effect({"delay_s": _size("delay_s", 0.006)}, "any"),
    "driver_lag": Effect({"time_constant_s": _size("lag_s", 0.006)}, "any"),
    "armature_inductance": Effect({"inductance_h": _size("inductance_h", 1.5e-3)}, "any"),
    "current_limit": Effect({"limit_a": _set("current_limit_a", 2.0, 6.5)}, "any"),
    "driver_freewheel": Effect(
        {"braking_fraction": _set("braking_fraction", 0.0, 0.7, "uniform")}, "any"
    ),
    "winding_heating": Effect({"coefficient": _size("heating_1_a2_s", 3e-3)}, "any"),
    "weak_motor": Effect({"scale": _loss("torque_constant_nm_a", 0.05, 0.3)}, "one"),
    "torque_constant_error": Effect({"scale": _change("torque_constant_nm_a", 0.06, 0.25)}),
    "motor_inertia_error": Effect({"inertia_kg_m2": _size("shaft_inertia_kg_m2", 1.5e-5)}, "any"),
    # friction on the shaft
    "viscous_friction_error": Effect({"viscous_friction_nm_s": _size("viscous_nm_s", 1e-4)}, "any"),
    "coulomb_friction": Effect({"torque_nm": _size("coulomb_nm", 0.008)}, "any"),
    "asymmetric_friction": Effect(
        {
            "torque_nm": _size("forward_coulomb_nm", 0.008),
            "viscous_nm_s": _size("forward_viscous_nm_s", 5e-5),
        },
        "any",
    ),
    "stribeck_friction": Effect(
        {
            "torque_nm": _size("stribeck_nm", 0.012),
            "speed_rad_s": _set("stribeck_speed_rad_s", 6.0, 40.0),
        },
        "any",
    ),
    "load_dependent_friction": Effect({"coefficient": _size("load_friction", 0.12)}, "any"),
    "quadratic_wheel_drag": Effect({"coefficient": _size("quadratic_drag", 3e-7)}, "any"),
    "one_wheel_drag": Effect({"torque_nm": _size("coulomb_nm", 0.012)}, "one"),
    "cogging": Effect(
        {
            "torque_nm": _size("cogging_nm", 0.008),
            "cycles_per_rev": _set("cogging_cycles", 4, 14, "whole"),
            "phase_rad": _phase("cogging_phase_rad"),
        },
        "any",
    ),
    "gear_backlash": Effect({"angle_rad": _size("backlash_rad", 0.02)}, "any"),
    "shaft_compliance": Effect(
        {
            "stiffness_nm_rad": _set("stiffness_nm_rad", 30.0, 300.0),
            "damping_nm_s_rad": _set("damping_nm_s_rad", 0.05, 0.2),
        },
        "any",
    ),
    # wheel geometry
    "wheel_radius_error": Effect({"scale": _change("radius_m", 0.008, 0.05)}, "any"),
    "wheel_eccentricity": Effect(
        {
            "amplitude": _size("eccentricity", 0.02),
            "phase_rad": _phase("eccentricity_phase_rad"),
        },
        "one",
    ),
    "wheel_angle_error": Effect({"angle_rad": _signed("angle_error_rad", 0.03)}, "one"),
    "wheel_distance_error": Effect({"scale": _change("distance_m", 0.01, 0.06)}),
    # contact
    "low_grip": Effect({"scale": _loss("mu_drive", 0.1, 0.6)}),
    "uneven_grip": Effect({"scale": _loss("mu_drive", 0.1, 0.7)}, "one"),
    "slip_stiffness_error": Effect({"scale": _change("slip_stiffness_s_m", 0.1, 0.7)}),
    "grip_falloff": Effect(
        {
            "fraction": _set("falloff", 0.1, 0.6),
            "speed_m_s": _set("falloff_speed_m_s", 0.1, 0.6),
        }
    ),
    "grip_drift": Effect({"rate_1_s": _size("grip_rate_1_s", 0.03)}),
    "contact_shape": Effect({"blend": _set("shape_blend", 0.3, 1.3, "uniform")}),
    "bristle_relaxation": Effect({"length_m": _size("bristle_m", 1.5e-3)}),
    "carpet_anisotropy": Effect(
        {"cos2": _signed("carpet_cos2", 0.12, 6.0), "sin2": _signed("carpet_sin2", 0.12, 6.0)}
    ),
    "slippery_patch": Effect(
        {
            "x_min_m": _set("patch_x_min_m", -0.3, 0.1, "uniform"),
            "x_max_m": _set("patch_x_max_m", 0.3, 0.8, "uniform"),
            "y_min_m": _bound("patch_y_min_m"),
            "y_max_m": _bound("patch_y_max_m"),
            "scale": Draw("patch_scale", "set", "loss", 0.2, 0.8),
        }
    ),
    "roller_friction": Effect({"mu": _size("mu_roller", 0.04)}, "any"),
    "roller_ripple": Effect(
        {"amplitude": _size("ripple", 0.12), "rollers": _set("rollers", 8, 20, "whole")}
    ),
    "rolling_resistance": Effect({"coefficient": _size("rolling_resistance", 0.015)}, "any"),
    # body
    "load_transfer": Effect({"cog_height_m": _size("cog_height_m", 0.12)}),
    "diagonal_load_bias": Effect({"force_n": _signed("diagonal_load_n", 10.0)}),
    "payload": Effect({"mass_kg": _size("mass_kg", 3.0, span=6.0)}),
    "inertia_error": Effect({"inertia_kg_m2": _size("inertia_kg_m2", 0.12)}),
    "cog_offset": Effect({"x_m": _signed("cog_x_m", 0.015), "y_m": _signed("cog_y_m", 0.015)}),
    "floor_slope": Effect(
        {"x_m_s2": _signed("slope_x_m_s2", 0.12), "y_m_s2": _signed("slope_y_m_s2", 0.12)}
    ),
    "body_drag": Effect({"coefficient_n_s_m": _size("drag_n_s_m", 5.0)}),
    "quadratic_body_drag": Effect({"coefficient": _size("quadratic_drag_n_s2_m2", 6.0)}),
    "tether_spring": Effect(
        {
            "stiffness_n_m": _size("tether_n_m", 8.0),
            "x_m": _set("tether_x_m", -1.0, 1.0, "uniform"),
            "y_m": _set("tether_y_m", -1.0, 1.0, "uniform"),
        }
    ),
    "yaw_scrub": Effect({"torque_nm": _size("scrub_nm", 0.8)}),
    "impact": Effect(
        {
            "time_s": _set("impact_time_s", 1.0, 5.0, "uniform"),
            "impulse_x_n_s": Draw("impulse_x_n_s", "set", "signed", 1.2, 12.0),
            "impulse_y_n_s": Draw("impulse_y_n_s", "set", "signed", 1.2, 12.0),
            "impulse_theta_n_m_s": Draw("impulse_theta_n_m_s", "set", "signed", 0.03, 0.3),
        },
        drawn=False,
        requires_run=True,
    ),
    # sensors and wiring
    "pose_latency": Effect({"delay_s": _size("pose_delay_s", 0.025)}, needs="pose"),
    "pose_rotation": Effect({"angle_rad": _signed("pose_rotation_rad", 0.03)}, needs="pose"),
    "clock_skew": Effect({"fraction": _signed("clock_skew", 0.004)}, needs="pose"),
    "gyro_bias": Effect({"rate_rad_s": _signed("gyro_bias_rad_s", 0.02)}, needs="gyro"),
    "gyro_scale": Effect({"scale": _change("gyro_scale", 0.01, 0.08)}, needs="gyro"),
    "encoder_scale": Effect({"scale": _change("encoder_scale", 0.008, 0.05)}, "any"),
    "encoder_dropout": Effect(
        {
            "fraction": _size("dropout", 0.04),
            "speed_rad_s": _set("dropout_speed_rad_s", 60.0, 150.0, "uniform"),
        },
        "one",
    ),
    "wheel_permutation": Effect({"wheels": _set("encoder_order", 0.0, 0.0, "keep")}, drawn=False),
    "encoder_sign": Effect({}, "one", drawn=False),
    "motor_sign": Effect({}, "one", drawn=False),
}

UNKNOWN_EFFECTS: dict[str, Effect] = {
    "bump_map": Effect(
        {
            "force_n": _set("bump_n", 4.0, 25.0),
            "width_m": _set("bump_width_m", 0.08, 0.2, "uniform"),
        },
        physics="bumps on a 0.5 m grid push the body away from their tops",
    ),
    "fifth_order_drag": Effect(
        {"torque_nm": _size("fifth_drag_nm", 0.06)},
        "any",
        physics="shaft torque -T (W / 300 rad/s)^5",
    ),
    "thermal_torque_constant": Effect(
        {"loss_1_a2_s": _size("thermal_loss_1_a2_s", 1.5e-3)},
        "one",
        physics="the magnets of one motor weaken with int i^2 dt",
    ),
    "pwm_beat": Effect(
        {"torque_nm": _size("beat_nm", 0.12), "frequency_hz": _set("beat_hz", 3.0, 25.0)},
        "any",
        physics="torque T abs(d) sin(2 pi f t): two PWM carriers beat",
    ),
    "adhesive_patch": Effect(
        {
            "force_n": _size("adhesive_n", 8.0),
            "x_m": _set("adhesive_x_m", -0.2, 0.4, "uniform"),
            "width_m": _set("adhesive_width_m", 0.3, 0.8, "uniform"),
        },
        physics="a sticky stripe across the floor brakes the body with a constant force",
    ),
    "sine_floor": Effect(
        {
            "amplitude_m_s2": _size("wave_m_s2", 0.5),
            "length_m": _set("wave_length_m", 0.6, 1.8, "uniform"),
        },
        physics="gravity component that varies as a sine of the place",
    ),
    "lateral_speed_force": Effect(
        {"coefficient_n_s2_m2": _signed("lateral_n_s2_m2", 8.0)},
        physics="force c v^2 at right angles to the velocity",
    ),
    "wheel_puncture": Effect(
        {"rate_1_s": _size("puncture_1_s", 0.01)},
        "one",
        physics="the radius of one wheel shrinks with time",
    ),
    "driver_outage": Effect(
        {
            "duration_s": _size("outage_s", 0.02),
            "period_s": _set("outage_period_s", 0.2, 0.8, "uniform"),
        },
        "one",
        physics="one driver cuts out for a moment, again and again",
    ),
    "supply_ripple": Effect(
        {
            "amplitude": _size("supply_ripple", 0.08),
            "frequency_hz": _set("supply_ripple_hz", 1.2, 12.0),
        },
        physics="the bus voltage oscillates on its own",
    ),
    "tight_spot": Effect(
        {"torque_nm": _size("tight_spot_nm", 0.03)},
        "one",
        physics="friction T max(0, sin(wheel angle))^4: a bent axle rubs once per turn",
    ),
    "encoder_ripple": Effect(
        {"angle_rad": _size("encoder_ripple_rad", 0.12)},
        "any",
        physics="eccentric code disc: error A sin(shaft angle) in the counts",
    ),
    "gyro_acceleration_sensitivity": Effect(
        {"rate_s_m": _signed("gyro_g_s_m", 0.02)},
        needs="gyro",
        physics="gyro reads c times the sideways acceleration",
    ),
}


@dataclass(frozen=True)
class HiddenEffect:
    """One effect: name, parameters, wheel 1..4 or None for all, run (file stem) or None for all."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    wheel: int | None = None
    run: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """The form written to truth.json."""
        return {
            "name": self.name,
            "wheel": self.wheel,
            "run": self.run,
            "parameters": dict(self.parameters),
        }


def parse_effect(raw: Mapping[str, Any]) -> HiddenEffect:
    """Checked effect from {"name", "parameters", optional "wheel", "run"}.

    Raises InputError with one line that says what would be right.
    """
    unknown = set(raw) - {"name", "parameters", "wheel", "run"}
    if unknown or "name" not in raw:
        raise InputError(f"effect {dict(raw)!r}: keys are name, parameters, wheel, run")
    effect = HiddenEffect(
        raw["name"], dict(raw.get("parameters", {})), raw.get("wheel"), raw.get("run")
    )
    spec = effect_spec(effect.name)
    _check_parameters(effect, spec)
    _check_wheel(effect, spec)
    if spec.requires_run and effect.run is None:
        raise InputError(f"effect {effect.name}: needs run, for example run_01")
    return effect


def effect_spec(name: str) -> Effect:
    """Table entry; InputError for a name in neither table."""
    spec = EFFECTS.get(name) or UNKNOWN_EFFECTS.get(name)
    if spec is None:
        known = ", ".join([*EFFECTS, *UNKNOWN_EFFECTS])
        raise InputError(f"unknown effect {name!r}; known are {known}")
    return spec


def _check_parameters(effect: HiddenEffect, spec: Effect) -> None:
    wrong = sorted(set(effect.parameters) - set(spec.parameters))
    missing = [
        name
        for name, draw in spec.parameters.items()
        if not draw.optional and name not in effect.parameters
    ]
    if wrong or missing:
        expected = ", ".join(spec.parameters) or "none"
        raise InputError(f"effect {effect.name}: parameters are {expected}")
    for name, value in effect.parameters.items():
        if not np.all(np.isfinite(np.asarray(value, dtype=float))):
            raise InputError(f"effect {effect.name}: {name} must be finite, not {value}")


def _check_wheel(effect: HiddenEffect, spec: Effect) -> None:
    if effect.wheel is None:
        if spec.wheel == "one":
            raise InputError(f"effect {effect.name}: needs wheel 1, 2, 3 or 4")
    elif spec.wheel == "none":
        raise InputError(f"effect {effect.name}: is not of one wheel, leave wheel out")
    elif effect.wheel not in (1, 2, 3, 4):
        raise InputError(f"effect {effect.name}: wheel is 1, 2, 3 or 4, not {effect.wheel}")


def apply_effect(plant: np.ndarray, effect: HiddenEffect) -> None:
    """Changes the plant record (shape (1,)) in place."""
    wheels = slice(None) if effect.wheel is None else effect.wheel - 1
    if effect.name in ("encoder_sign", "motor_sign"):
        plant["encoder_scale" if effect.name == "encoder_sign" else "motor_sign"][0, wheels] *= -1.0
        return
    for name, value in effect.parameters.items():
        draw = effect_spec(effect.name).parameters[name]
        _apply_value(plant, draw, value, wheels)


def _apply_value(
    plant: np.ndarray, draw: Draw, value: float | Sequence[float], wheels: int | slice
) -> None:
    target = plant[draw.plant_field]
    where = (0, wheels) if target.ndim == 2 else (0,)
    if draw.operation == "add":
        target[where] += value
    elif draw.operation == "scale":
        target[where] *= value
    else:
        target[where] = value


def draw_effect(rng: np.random.Generator, name: str, run: str | None = None) -> HiddenEffect:
    """The named effect with a random size, and a random wheel where it is of one wheel."""
    spec = effect_spec(name)
    values = {key: draw.sample(rng) for key, draw in spec.parameters.items() if not draw.optional}
    wheel = int(rng.integers(1, 5)) if spec.wheel == "one" else None
    if name in ("wheel_radius_error", "encoder_scale"):
        wheel = int(rng.integers(1, 5))  # a common scale is an alias of the other one
    return HiddenEffect(name, values, wheel, run if spec.requires_run else None)


def typical_effect(name: str, wheel: int = 3) -> HiddenEffect:
    """The named effect at its typical size; on `wheel` where it is of one wheel."""
    spec = effect_spec(name)
    values = {key: draw.typical() for key, draw in spec.parameters.items() if not draw.optional}
    return HiddenEffect(
        name,
        values,
        wheel if spec.wheel == "one" else None,
        "run_01" if spec.requires_run else None,
    )
