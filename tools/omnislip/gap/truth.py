"""Robot logs with hidden effects: the independent truth of the blind benchmark.

A `TruthCase` says what is hidden and how the robot is driven; `generate` returns the logs and the
truth, `write_case` writes them with the robot.toml that an engineer would believe. Same case, same
bytes. True base parameters = nominal (1 + z sd), z normal but within +-2, sd = base_offset_sd times
`BASE_OFFSET_WEIGHTS`; the believed robot.toml carries these sds as its tolerances. So a base offset
alone is never an effect. Noise: first-order coloured forces on body and shafts
(`PROCESS_NOISE_SD`), white noise of the sensors, encoder edges, rows near 200 Hz on ticks of 0.1 ms
with jitter and losses, camera poses near 50 Hz.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import lfilter

from omnislip.errors import InputError
from omnislip.files import replace_file, write_text
from omnislip.gap import truth_plant as plant_model
from omnislip.gap.truth_effects import (
    EFFECTS,
    UNKNOWN_EFFECTS,
    HiddenEffect,
    apply_effect,
    draw_effect,
    parse_effect,
    typical_effect,
)
from omnislip.gap.truth_excitation import (
    EXCITATIONS,
    feed_forward_duty,
    programme,
    shaft_reference,
)

Array = NDArray[np.float64]

SENSORS = ("gyro", "pose", "supply", "current")
COMPOSITIONS = ("null", "single", "double", "triple", "unknown", "impact")
WHEEL_ANGLES_DEG = (30.0, 150.0, 210.0, 330.0)

NOMINAL: dict[str, float] = {
    "robot.mass_kg": 20.0,
    "robot.inertia_kg_m2": 0.55,
    "robot.wheel_radius_m": 0.05,
    "robot.wheel_distance_m": 0.2,
    "motor.resistance_ohm": 0.6,
    "motor.torque_constant_nm_a": 0.0255,
    "motor.back_emf_constant_v_s_rad": 0.0255,
    "motor.gear_ratio": 12.0,
    "motor.inertia_kg_m2": 2.5e-5,
    "motor.viscous_friction_nm_s": 1.5e-5,
    "motor.supply_v": 24.0,
    "contact.mu_drive": 0.6,
    "contact.mu_roller": 0.05,
    "contact.slip_stiffness_s_m": 40.0,
    "contact.gravity_m_s2": 9.81,
    "encoder.counts_per_rev": 2000.0,
}
# Standard deviation of a true value about its nominal one, in units of base_offset_sd; keys left
# out are exact. Radius and distance are measured with a calliper. k2 and k3 are one physical
# constant and move together.
BASE_OFFSET_WEIGHTS: dict[str, float] = {
    "robot.mass_kg": 1.0,
    "robot.inertia_kg_m2": 1.0,
    "robot.wheel_radius_m": 0.1,
    "robot.wheel_distance_m": 0.2,
    "motor.resistance_ohm": 1.0,
    "motor.torque_constant_nm_a": 1.0,
    "motor.inertia_kg_m2": 1.0,
    "motor.viscous_friction_nm_s": 1.0,
    "motor.supply_v": 1.0,
    "contact.mu_drive": 1.0,
    "contact.mu_roller": 1.0,
    "contact.slip_stiffness_s_m": 1.0,
}
_PLANT_FIELDS = {
    "robot.mass_kg": "mass_kg",
    "robot.inertia_kg_m2": "inertia_kg_m2",
    "robot.wheel_radius_m": "radius_m",
    "robot.wheel_distance_m": "distance_m",
    "motor.resistance_ohm": "resistance_ohm",
    "motor.torque_constant_nm_a": "torque_constant_nm_a",
    "motor.gear_ratio": "gear",
    "motor.inertia_kg_m2": "shaft_inertia_kg_m2",
    "motor.viscous_friction_nm_s": "viscous_nm_s",
    "motor.supply_v": "supply_v",
    "contact.mu_drive": "mu_drive",
    "contact.mu_roller": "mu_roller",
    "contact.slip_stiffness_s_m": "slip_stiffness_s_m",
    "contact.gravity_m_s2": "gravity_m_s2",
    "encoder.counts_per_rev": "counts_per_rev",
}

# World force x, y (N), yaw torque (N m): bumps of an ordinary floor under 20 kg. Shaft torque (N
# m): 0.75 % of the 0.2 N m of a brisk start.
PROCESS_NOISE_SD = np.array([1.5, 1.5, 0.1, 1.5e-3, 1.5e-3, 1.5e-3, 1.5e-3])
POSE_NOISE_SD = np.array([0.75e-3, 0.75e-3, 2e-3])  # m, m, rad
SUPPLY_NOISE_SD_V = 0.05
CURRENT_NOISE_SD_A = 0.1
_JITTER_SD_TICKS = 3.0
_CAMERA_S = 0.02

# Wheel-speed controller: duty per rad/s, duty per rad; the feed-forward is the believed back-EMF.
_PROPORTIONAL = 0.006
_INTEGRAL = 0.03

# One stream of random numbers per purpose, so that an effect changes no draw of another purpose.
_STREAM_BASE, _STREAM_COMMANDS, _STREAM_NOISE, _STREAM_SENSORS, _STREAM_CASE = range(5)


@dataclass(frozen=True)
class TruthCase:
    """What is hidden and how the robot is driven.

    effects: dicts {"name", "parameters", optional "wheel" 1..4, "run" "run_01"}. friction_curve:
    atan, tanh, brush or, never at random, rational, straight, peaked. excitation: rich, ordinary,
    poor. sensors: of gyro, pose, supply, current. noise_level scales process and sensor noise, 0 is
    off; row_s is the time between rows, disorder scales their jitter and losses. Raises InputError
    for anything else.
    """

    seed: int
    effects: tuple[Mapping[str, Any], ...] = ()
    friction_curve: str = "atan"
    excitation: str = "rich"
    closed_loop: bool = False
    sensors: tuple[str, ...] = ("gyro", "pose")
    runs: int = 8
    run_duration_s: float = 6.0
    noise_level: float = 1.0
    base_offset_sd: float = 0.02
    row_s: float = 0.005
    disorder: float = 1.0

    def __post_init__(self) -> None:
        """Check every field."""
        _check_choice("friction_curve", self.friction_curve, plant_model.FRICTION_CURVES)
        _check_choice("excitation", self.excitation, EXCITATIONS)
        for sensor in self.sensors:
            _check_choice("sensors", sensor, SENSORS)
        _check_range("runs", self.runs, 1, 99)
        _check_range("run_duration_s", self.run_duration_s, 1.0, 600.0)
        _check_range("noise_level", self.noise_level, 0.0, 100.0)
        _check_range("base_offset_sd", self.base_offset_sd, 0.0, 0.3)
        _check_range("row_s", self.row_s, 0.001, 0.05)
        _check_range("disorder", self.disorder, 0.0, 10.0)
        for effect in self.hidden():
            if effect.run is not None:
                _check_choice(f"effect {effect.name}: run", effect.run, self.run_names())

    def hidden(self) -> list[HiddenEffect]:
        """The checked effects."""
        return [parse_effect(effect) for effect in self.effects]

    def run_names(self) -> list[str]:
        """File stems of the runs."""
        return [f"run_{k + 1:02d}" for k in range(self.runs)]


def _check_choice(key: str, value: str, known: Sequence[str]) -> None:
    if value not in known:
        raise InputError(f"{key}: {value!r} is not one of {', '.join(known)}")


def _check_range(key: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"{key}: {value} is not within {low} to {high}")


def true_parameters(case: TruthCase) -> dict[str, float]:
    """Base values of the robot that made the logs, effects not included."""
    rng = np.random.default_rng([case.seed, _STREAM_BASE])
    values = dict(NOMINAL)
    for key, weight in BASE_OFFSET_WEIGHTS.items():
        values[key] *= 1.0 + case.base_offset_sd * weight * _normal_within_two(rng)
    values["motor.back_emf_constant_v_s_rad"] = values["motor.torque_constant_nm_a"]
    return values


def _normal_within_two(rng: np.random.Generator) -> float:
    z = 3.0
    while abs(z) > 2.0:
        z = rng.standard_normal()
    return float(z)


def build_plant(
    parameters: Mapping[str, float], effects: Sequence[HiddenEffect], friction_curve: str, run: str
) -> NDArray[np.void]:
    """Plant record (1,) of one run: base parameters, then the effects that act in it."""
    plant = plant_model.neutral_plant()
    for key, field in _PLANT_FIELDS.items():
        plant[field] = parameters[key]
    plant["curve"] = plant_model.FRICTION_CURVES.index(friction_curve)
    for effect in effects:
        if effect.run in (None, run):
            apply_effect(plant, effect)
    return plant


def generate(case: TruthCase) -> tuple[list[pd.DataFrame], dict[str, Any]]:
    """Logs of all runs in log format and the truth as a dict that JSON can hold."""
    parameters = true_parameters(case)
    milliseconds = round(case.run_duration_s * 1e3)
    commands = programme(
        np.random.default_rng([case.seed, _STREAM_COMMANDS]),
        case.excitation,
        case.runs,
        milliseconds,
    )
    logs = [
        _run_log(
            case, build_plant(parameters, case.hidden(), case.friction_curve, name), k, command
        )
        for k, (name, command) in enumerate(zip(case.run_names(), commands, strict=True))
    ]
    return logs, _truth(case, parameters)


def _truth(case: TruthCase, parameters: Mapping[str, float]) -> dict[str, Any]:
    effects = case.hidden()
    outside = any(effect.name in UNKNOWN_EFFECTS for effect in effects)
    verdict = "unknown_effect" if outside else "effect_found" if effects else "no_gap"
    return {
        "schema": "omnislip-truth/1",
        "seed": case.seed,
        "expected_verdict": verdict,
        "effects": [effect.as_dict() for effect in effects],
        "physics": {
            effect.name: UNKNOWN_EFFECTS[effect.name].physics
            for effect in effects
            if effect.name in UNKNOWN_EFFECTS
        },
        # a contact law that is not the believed arctangent: naming it is no error
        "also_true": [] if case.friction_curve == "atan" else ["contact_shape"],
        "parameters": dict(parameters),
        "friction_curve": case.friction_curve,
        "excitation": case.excitation,
        "closed_loop": case.closed_loop,
        "sensors": list(case.sensors),
        "runs": case.run_names(),
        "run_duration_s": case.run_duration_s,
        "noise_level": case.noise_level,
        "base_offset_sd": case.base_offset_sd,
        "row_s": case.row_s,
        "disorder": case.disorder,
    }


def _run_log(case: TruthCase, plant: NDArray[np.void], index: int, command: Array) -> pd.DataFrame:
    rng = np.random.default_rng([case.seed, _STREAM_NOISE, index])
    bearing_rad = np.radians(WHEEL_ANGLES_DEG)
    convert = shaft_reference if case.closed_loop else feed_forward_duty
    feed_forward = NOMINAL["motor.back_emf_constant_v_s_rad"] / NOMINAL["motor.supply_v"]
    start_pose = np.array([*rng.uniform(-0.3, 0.3, 2), rng.uniform(-np.pi, np.pi)])
    start_angle_rad = rng.uniform(0.0, 200.0, 4)
    noise = case.noise_level * coloured_noise(rng, len(command))
    history, duty = plant_model.simulate_run(
        plant,
        convert(command, NOMINAL, bearing_rad),
        np.array([feed_forward, _PROPORTIONAL, _INTEGRAL]),
        case.closed_loop,
        noise,
        start_pose,
        start_angle_rad,
    )
    sensor_rng = np.random.default_rng([case.seed, _STREAM_SENSORS, index])
    return _sample(case, plant, history, duty, sensor_rng)


def coloured_noise(
    rng: np.random.Generator, rows: int, corner_hz: tuple[float, float] = (10.0, 30.0)
) -> Array:
    """(rows, 7) per millisecond, sd `PROCESS_NOISE_SD`, first order, corner between two."""
    keep = np.exp(-2.0 * np.pi * rng.uniform(*corner_hz) * 1e-3)
    white = rng.standard_normal((rows, PROCESS_NOISE_SD.size))
    drive = np.sqrt(1.0 - keep * keep)
    level, _ = lfilter([drive], [1.0, -keep], white, axis=0, zi=keep * white[:1])
    return level * PROCESS_NOISE_SD


def row_ticks(
    rng: np.random.Generator, ticks: int, nominal_ticks: int = 50, disorder: float = 1.0
) -> NDArray[np.int64]:
    """Ticks (0.1 ms) of the rows: nominal distance, jitter 0.3 ms, 0.1 to 1 % of the rows lost."""
    nominal = np.arange(0, ticks - nominal_ticks, nominal_ticks)
    most = int(0.4 * nominal_ticks)
    jitter = rng.normal(0.0, _JITTER_SD_TICKS * disorder, nominal.size)
    sampled = nominal + np.clip(np.rint(jitter), -most, most).astype(np.int64)
    sampled[0] = 0
    kept = rng.random(nominal.size) >= disorder * rng.uniform(0.001, 0.01)
    kept[0] = True
    return sampled[kept]


def mean_duty(duty: Array, sampled: NDArray[np.int64], nominal_ticks: int = 50) -> Array:
    """Mean of duty (n, 4) per ms from each row to the next; last row: over the nominal time."""
    fine = np.repeat(duty, plant_model.TICKS_PER_MS, axis=0)
    total = np.vstack([np.zeros(4), np.cumsum(fine, axis=0)])
    edges = np.append(sampled, min(sampled[-1] + nominal_ticks, len(fine)))
    return np.diff(total[edges], axis=0) / np.diff(edges)[:, None]


def encoder_counts(plant: NDArray[np.void], angle_rad: Array) -> NDArray[np.int64]:
    """Counts of angles (rows, 4): whole edges, 16-bit wrap, channels in the wired order."""
    edges = np.floor(angle_rad * plant["counts_per_rev"][0] / (2.0 * np.pi)).astype(np.int64)
    order = plant["encoder_order"][0].astype(int) - 1
    return (edges & 0xFFFF)[:, order]


def _sample(
    case: TruthCase,
    plant: NDArray[np.void],
    history: Array,
    duty: Array,
    rng: np.random.Generator,
) -> pd.DataFrame:
    nominal_ticks = round(case.row_s / plant_model.STEP_S)
    sampled = row_ticks(rng, len(history) - 1, nominal_ticks, case.disorder)
    rows = history[sampled]
    t_s = sampled * plant_model.STEP_S
    applied = mean_duty(duty, sampled, nominal_ticks)
    counts = encoder_counts(plant, rows[:, plant_model.ENCODER_ANGLE])
    columns: dict[str, Any] = {"t_s": np.round(t_s, 4)}
    for i in range(4):
        columns[f"wheel/{i + 1}/duty"] = np.round(np.clip(applied[:, i], -1.0, 1.0), 6)
    for i in range(4):
        columns[f"wheel/{i + 1}/encoder_counts"] = counts[:, i]
    measured = {
        "gyro": _gyro(rng, case.noise_level, rows),
        "pose": _pose(rng, case, plant, history, t_s),
        "supply": _supply(rng, case.noise_level, rows),
        "current": _currents(rng, case.noise_level, rows),
    }
    for sensor in SENSORS:
        if sensor in case.sensors:
            columns |= measured[sensor]
    return pd.DataFrame(columns)


def _gyro(rng: np.random.Generator, level: float, rows: Array) -> dict[str, Array]:
    sd_rad_s = rng.uniform(0.002, 0.005)
    rate = rows[:, plant_model.GYRO] + level * sd_rad_s * rng.standard_normal(len(rows))
    return {"gyro/z_rad_s": np.round(rate, 5)}


def _pose(
    rng: np.random.Generator,
    case: TruthCase,
    plant: NDArray[np.void],
    history: Array,
    t_s: Array,
) -> dict[str, Array]:
    """Camera near 50 Hz: row t shows the pose of t / (1 + skew) - delay, turned by the angle."""
    seen = _camera_rows(rng, len(t_s), max(1, round(_CAMERA_S / case.row_s)))
    shown_s = t_s[seen] / (1.0 + plant["clock_skew"][0]) - plant["pose_delay_s"][0]
    ticks_s = np.arange(len(history)) * plant_model.STEP_S
    pose = np.stack([np.interp(shown_s, ticks_s, history[:, k]) for k in range(3)], axis=1)
    cos_a, sin_a = np.cos(plant["pose_rotation_rad"][0]), np.sin(plant["pose_rotation_rad"][0])
    pose[:, :2] = pose[:, :2] @ np.array([[cos_a, sin_a], [-sin_a, cos_a]])
    pose += case.noise_level * POSE_NOISE_SD * rng.standard_normal(pose.shape)
    table = np.full((len(t_s), 3), np.nan)
    table[seen] = np.round(pose, 6)
    names = ("pose/x_m", "pose/y_m", "pose/theta_rad")
    return {name: table[:, k] for k, name in enumerate(names)}


def _camera_rows(rng: np.random.Generator, rows: int, every: int = 4) -> NDArray[np.int64]:
    """Rows with a pose: every few, one row early or late at random; the first row always."""
    nominal = np.arange(0, rows, every)
    seen = np.clip(nominal + rng.integers(-1, 2, nominal.size), 0, rows - 1)
    seen[0] = 0
    return np.unique(seen)


def _supply(rng: np.random.Generator, level: float, rows: Array) -> dict[str, Array]:
    noise = level * SUPPLY_NOISE_SD_V * rng.standard_normal(len(rows))
    return {"supply/voltage_v": np.round(rows[:, plant_model.SUPPLY] + noise, 3)}


def _currents(rng: np.random.Generator, level: float, rows: Array) -> dict[str, Array]:
    true_a = rows[:, plant_model.CURRENT]
    measured = np.round(true_a + level * CURRENT_NOISE_SD_A * rng.standard_normal(true_a.shape), 3)
    return {f"wheel/{i + 1}/current_a": measured[:, i] for i in range(4)}


def robot_toml(base_offset_sd: float) -> str:
    """The believed robot: nominal values, tolerances = standard deviations of the true values."""
    lines: list[str] = []
    for section in ("robot", "motor", "contact", "encoder"):
        lines.append(f"[{section}]")
        if section == "robot":
            lines += ['name = "msl-omni-4"', f"wheel_angles_deg = {list(WHEEL_ANGLES_DEG)}"]
        for key, value in NOMINAL.items():
            if key.startswith(section + "."):
                text = f"{value:.0f}" if key == "encoder.counts_per_rev" else repr(value)
                lines.append(f"{key.removeprefix(section + '.')} = {text}")
        lines.append("")
    lines += ["[tolerance]", f"default = {max(base_offset_sd, 1e-3):g}"]
    for key, weight in BASE_OFFSET_WEIGHTS.items():
        if weight != 1.0:
            lines.append(f'"{key}" = {weight * max(base_offset_sd, 1e-3):g}')
    return "\n".join(lines) + "\n"


def write_case(case: TruthCase, directory: Path | str) -> dict[str, Any]:
    """Writes run_01.csv ..., robot.toml (believed) and truth.json; returns the truth.

    InputError when the directory cannot be written.
    """
    directory = Path(directory)
    logs, truth = generate(case)
    for name, log in zip(case.run_names(), logs, strict=True):
        with replace_file(directory / f"{name}.csv") as temporary:
            log.to_csv(temporary, index=False, lineterminator="\n")
    write_text(directory / "robot.toml", robot_toml(case.base_offset_sd))
    write_text(directory / "truth.json", json.dumps(truth, indent=2, allow_nan=False) + "\n")
    return truth


def random_case(
    seed: int,
    composition: str = "single",
    names: Sequence[str] = (),
    excitation: str | None = None,
) -> TruthCase:
    """A case with drawn sizes, contact curve, control, sensors and noise.

    composition: `null` nothing hidden, `single`, `double` or `triple` from the catalogue, `unknown`
    from outside it, `impact` one or two pushes. `names` fixes the effects instead of drawing them,
    `excitation` the programme.
    """
    _check_choice("composition", composition, COMPOSITIONS)
    rng = np.random.default_rng([seed, _STREAM_CASE])
    sensors = [("gyro",), ("gyro", "pose"), SENSORS][int(rng.integers(0, 3))]
    effects = []
    for name in names or _draw_names(rng, composition):
        drawn = int(rng.integers(1, 9))
        runs = [f"run_{(drawn - 1 + k) % 8 + 1:02d}" for k in range(8)]
        free = [run for run in runs if run not in [effect.run for effect in effects]]
        effects.append(draw_effect(rng, name, free[0]))
    for effect in effects:
        need = (EFFECTS | UNKNOWN_EFFECTS)[effect.name].needs
        if need and need not in sensors:
            sensors = ("gyro", "pose")
    curve = str(rng.choice(plant_model.FRICTION_CURVES[:3], p=[0.4, 0.3, 0.3]))
    drawn = str(rng.choice(EXCITATIONS))
    return TruthCase(
        seed=seed,
        effects=tuple(effect.as_dict() for effect in effects),
        friction_curve="atan" if any(e.name == "contact_shape" for e in effects) else curve,
        excitation=excitation or drawn,
        closed_loop=bool(rng.random() < 0.5),
        sensors=sensors,
        noise_level=float(np.exp(rng.uniform(np.log(0.5), np.log(2.0)))),
    )


def _draw_names(rng: np.random.Generator, composition: str) -> list[str]:
    if composition == "unknown":
        return [str(rng.choice(list(UNKNOWN_EFFECTS)))]
    if composition == "impact":
        return ["impact"] * int(rng.integers(1, 3))
    count = {"null": 0, "single": 1, "double": 2, "triple": 3}[composition]
    drawable = [name for name, effect in EFFECTS.items() if effect.drawn]
    return [str(name) for name in rng.choice(drawable, count, replace=False)]


def main() -> None:
    """Writes one case: python -m omnislip.gap.truth DIR --effect dead_zone --seed 7."""
    parser = argparse.ArgumentParser(description="Write robot logs with a hidden effect.")
    parser.add_argument("directory", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effect", help="hidden at its typical size; left out: nothing hidden")
    arguments = parser.parse_args()
    try:
        effects = (typical_effect(arguments.effect).as_dict(),) if arguments.effect else ()
        write_case(TruthCase(arguments.seed, effects), arguments.directory)
    except InputError as error:
        parser.exit(2, f"omnislip: error: {error}\n")


if __name__ == "__main__":
    main()
