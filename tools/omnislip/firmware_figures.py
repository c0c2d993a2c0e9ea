"""The figures of the firmware, from the nominal robot in closed loop: `omnislip figures`.

impulses   1.5 m/s along x, a blow at x = 2.35 m or 1.85 m in one of eight directions. Displacement:
           how far the robot is from where the same controller is without the blow; remaining 1.5 s
           after it, and at its peak. Saturated: a wheel's force passes 0.93 of its grip, beyond
           which the observer does not invert the friction law, for 10 ms or more.
odometry   20 s of velocity commands that change every 0.4 to 0.9 s; distance between belief and
           truth at the end and on average, with the true grip as believed and 17 % off.
steps      body: 0 to 1 m/s along x. wheel 1: 0.15 m/s at the rim within 10 ms (the format's
           largest acceleration), with the body's inertia out of the feed-forward and no traction
           limit. Rise from 10 to 90 %, overshoot, within 2 % for good.
tuning     the blows of 6 N s with one gain of both controllers at a time multiplied by a factor:
           whether the baseline is tuned as well as it can be.
stopping   from 1.5 m/s on a third of the grip, which the firmware knows, with no acceleration
           limit, with and without traction limit; the floor's friction falls by 40 % when a wheel
           slides, or does not.

Both controllers have the same gains, feed-forward, limits and plant: those of `omnislip gains`;
they differ in the parameter slip_compensation alone.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.files import write_text
from omnislip.firmware_parameters import SLIP_SATURATION, firmware_parameters
from omnislip.model_file import NOMINAL_ROBOT, read_model

Array = npt.NDArray[np.float64]
Truth = dict[str, Array]

SPEED_M_S = 1.5
PLACES_M = (2.35, 1.85)
IMPULSES_N_S = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0)
DIRECTIONS_DEG = tuple(range(0, 360, 45))
AFTER_S = 1.5
CONTROLLERS = {"plain": 0, "slip": 1}
TUNED_GAINS = (
    "speed_gain_q15",
    "speed_integral_q22",
    "position_gain_q20",
    "heading_gain_q20",
)
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
TUNED_AT_N_S = 6.0
GRIPS = (0.6, 0.5, 0.7)
ODOMETRY_SEEDS = tuple(range(6))
NO_ACCELERATION_LIMIT = {"acceleration_limit_q10": 32767}
NO_TRACTION_LIMIT = {"traction_limit_q8": 32767}
NO_BODY = {"mass_q8": 128, "inertia_q13": 16}
MODEL = read_model(NOMINAL_ROBOT)


@dataclass(frozen=True)
class Case:
    """One piece of work: a figure, and what varies in it."""

    figure: str
    arguments: tuple[float | str, ...]


def all_cases() -> list[Case]:
    """Return the work of `run_figures`, in order."""
    blows = [Case("impulses", (j, x)) for j in IMPULSES_N_S for x in PLACES_M]
    odometry = [Case("odometry", (grip,)) for grip in GRIPS]
    tuning = [Case("tuning", (gain,)) for gain in TUNED_GAINS]
    return [*blows, *odometry, *tuning, Case("steps", ()), Case("stopping", ())]


def run_figures(cases: Iterable[Case], out: Path) -> dict[str, Any]:
    """Run `cases`, write figures.json to `out`; return what it holds."""
    work = {
        "impulses": blow_rows,
        "odometry": odometry_rows,
        "tuning": tuning_rows,
        "steps": step_rows,
        "stopping": stopping_rows,
    }
    result: dict[str, Any] = {"schema": "omnislip-figures/1", "parameters": _firmware()}
    for case in cases:
        result.setdefault(case.figure, []).extend(work[case.figure](*case.arguments))
    write_text(out / "figures.json", json.dumps(result, indent=1) + "\n")
    return result


def _firmware() -> dict[str, int]:
    return firmware_parameters(MODEL.values)


def _run(
    commands: list[tuple[float, float, float, float]],
    duration_s: float,
    controller: str,
    *,
    plant: dict[str, float] | None = None,
    firmware: dict[str, int] | None = None,
    impulses: list[dict[str, float]] | None = None,
    effects: list[dict[str, Any]] | None = None,
) -> Truth:
    """Closed loop with velocity commands (t_s, vx, vy, omega)."""
    raw = _firmware() | {"slip_compensation": CONTROLLERS[controller]} | (firmware or {})
    given = [
        {"t_s": t_s, "kind": "velocity", "value": list(velocity)} for t_s, *velocity in commands
    ]
    parameters = MODEL.to_core()[0] | (plant or {})
    return _core.simulate(parameters, effects or [], raw, given, impulses or [], duration_s)


def tables(result: dict[str, Any]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Return title and rows of what a reader wants to see of `result`."""
    return [
        ("blows in eight directions at two places", impulse_table(result["impulses"])),
        ("belief against truth, 20 s of hard driving; believed grip 0.6", result["odometry"]),
        ("blows of 6 N s with one gain multiplied by a factor", result["tuning"]),
        ("step responses", result["steps"]),
        ("stopping on a third of the grip", result["stopping"]),
    ]


# ---- impulses ----


def blow_rows(
    impulse_n_s: float, place_m: float, firmware: dict[str, int] | None = None
) -> list[dict[str, Any]]:
    """Return one row per controller and direction of a blow at this place."""
    duration_s = place_m / SPEED_M_S + 0.6 + AFTER_S
    straight = [(0.0, SPEED_M_S, 0.0, 0.0)]
    rows = []
    for controller in CONTROLLERS:
        calm = _run(straight, duration_s, controller, firmware=firmware)
        for direction_deg in DIRECTIONS_DEG:
            angle = np.deg2rad(direction_deg)
            blow = {
                "x_m": place_m,
                "impulse_x_n_s": impulse_n_s * float(np.cos(angle)),
                "impulse_y_n_s": impulse_n_s * float(np.sin(angle)),
                "impulse_theta_n_m_s": 0.0,
            }
            hit = _run(straight, duration_s, controller, firmware=firmware, impulses=[blow])
            rows.append(
                {
                    "controller": controller,
                    "impulse_n_s": impulse_n_s,
                    "place_m": place_m,
                    "direction_deg": direction_deg,
                }
                | _displacement(calm, hit, place_m)
            )
    return rows


def _displacement(calm: Truth, hit: Truth, place_m: float) -> dict[str, Any]:
    start = int(np.argmax(calm["pose"][:, 0] >= place_m))
    end = start + round(AFTER_S / 1e-3)
    away_m = hit["pose"][start:end, :2] - calm["pose"][start:end, :2]
    distance_m = np.hypot(*away_m.T)
    values: dict[str, Any] = MODEL.values
    load_n = values["robot.mass_kg"] * values["contact.gravity_m_s2"] / 4
    grip_n = values["contact.mu_drive"] * load_n
    share = np.abs(hit["drive_force_n"][start:end]).max(axis=1) / grip_n
    return {
        "peak_mm": 1e3 * float(distance_m.max()),
        "remaining_mm": 1e3 * float(distance_m[-100:].mean()),
        "remaining_y_mm": 1e3 * float(np.abs(away_m[-100:, 1]).mean()),
        "saturated": bool((share > SLIP_SATURATION).sum() >= 10),
    }


def impulse_table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per impulse: medians over directions and places, and the smallest ratio."""
    table = []
    for impulse_n_s in sorted({row["impulse_n_s"] for row in rows}):
        pairs = {}
        for row in rows:
            if row["impulse_n_s"] == impulse_n_s:
                pairs.setdefault((row["place_m"], row["direction_deg"]), {})[row["controller"]] = (
                    row
                )
        both = list(pairs.values())
        ratio = [pair["plain"]["remaining_mm"] / pair["slip"]["remaining_mm"] for pair in both]
        table.append(
            {
                "impulse_n_s": impulse_n_s,
                "saturated_share": float(np.mean([pair["plain"]["saturated"] for pair in both])),
                **{
                    f"{name}_{key}": float(np.median([pair[name][key] for pair in both]))
                    for name in CONTROLLERS
                    for key in ("peak_mm", "remaining_mm")
                },
                "ratio_median": float(np.median(ratio)),
                "ratio_smallest": float(np.min(ratio)),
            }
        )
    return table


# ---- tuning ----


def tuning_rows(gain: str) -> list[dict[str, Any]]:
    """Return what remains of blows with one gain multiplied by each factor, medians."""
    rows = []
    for factor in FACTORS:
        changed = {gain: min(round(_firmware()[gain] * factor), 32767)}
        blows = [row for x in PLACES_M for row in blow_rows(TUNED_AT_N_S, x, changed)]
        [line] = impulse_table(blows)
        rows.append(
            {
                "gain": gain,
                "factor": factor,
                **{f"{name}_remaining_mm": line[f"{name}_remaining_mm"] for name in CONTROLLERS},
            }
        )
    return rows


# ---- odometry ----


def _hard_driving(seed: int) -> list[tuple[float, float, float, float]]:
    generator = np.random.default_rng(seed)
    commands, t_s = [], 0.0
    while t_s < 20.0:
        angle, speed = generator.uniform(0.0, 2 * np.pi), generator.uniform(0.5, 2.3)
        turn = generator.uniform(-5.0, 5.0)
        commands.append((t_s, speed * np.cos(angle), speed * np.sin(angle), turn))
        t_s = round(t_s + generator.uniform(0.4, 0.9), 3)
    return commands


def odometry_rows(mu_drive: float) -> list[dict[str, Any]]:
    """Return one row per controller: means over the seeds."""
    rows = []
    for controller in CONTROLLERS:
        ends, means = [], []
        for seed in ODOMETRY_SEEDS:
            plant = {"contact.mu_drive": mu_drive}
            truth = _run(_hard_driving(seed), 20.0, controller, plant=plant)
            error_m = np.hypot(*(truth["odometry"] - truth["pose"])[:, :2].T)
            ends.append(error_m[-1])
            means.append(error_m.mean())
        rows.append(
            {
                "controller": controller,
                "true_mu_drive": mu_drive,
                "end_mm": 1e3 * float(np.mean(ends)),
                "mean_mm": 1e3 * float(np.mean(means)),
            }
        )
    return rows


# ---- steps ----


def step_rows() -> list[dict[str, Any]]:
    """Return rise time, overshoot and settling of body and wheel for both controllers."""
    rows = []
    for controller in CONTROLLERS:
        body = _run([(0.0, 1.0, 0.0, 0.0)], 3.0, controller)["velocity"][:, 0]
        bare = NO_ACCELERATION_LIMIT | NO_TRACTION_LIMIT | NO_BODY
        wheel = _run([(0.0, 0.3, 0.0, 0.0)], 3.0, controller, firmware=bare)
        speed = np.abs(wheel["wheel_speed_rad_s"][:, 0])
        rows += [
            {"controller": controller, "what": "body, 1 m/s"} | _step(body),
            {"controller": controller, "what": "wheel, 0.15 m/s at the rim"} | _step(speed),
        ]
    return rows


def _step(speed: Array) -> dict[str, float]:
    final = float(speed[-200:].mean())
    outside = np.flatnonzero(np.abs(speed / final - 1.0) > 0.02)
    return {
        "rise_ms": float(np.argmax(speed > 0.9 * final) - np.argmax(speed > 0.1 * final)),
        "overshoot_percent": 100.0 * float(speed.max() / final - 1.0),
        "settling_ms": float(outside[-1] + 1),
    }


# ---- stopping ----


def stopping_rows() -> list[dict[str, Any]]:
    """Return distance, time and odometry error of a stop on low grip, per floor and limit."""
    floors = {
        "constant friction": [],
        "falls by 40 %": [
            {
                "name": "grip_falloff",
                "wheel": None,
                "parameters": {"fraction": 0.4, "speed_m_s": 0.3},
            }
        ],
    }
    # The firmware knows the grip of the floor; its limits follow from it.
    values = MODEL.values | {"contact.mu_drive": 0.2}
    known = firmware_parameters(values) | NO_ACCELERATION_LIMIT
    gently = [(0.1 * n, 0.05 * n, 0.0, 0.0) for n in range(1, 31)]
    rows = []
    for floor, effects in floors.items():
        for limit, firmware in (("with", known), ("without", known | NO_TRACTION_LIMIT)):
            truth = _run(
                [*gently, (5.0, 0.0, 0.0, 0.0)],
                12.0,
                "slip",
                plant={"contact.mu_drive": 0.2},
                firmware=firmware | {"slip_compensation": 1},
                effects=effects,
            )
            rows.append({"floor": floor, "traction_limit": limit} | _stop(truth, 5000))
    return rows


def _stop(truth: Truth, tick: int) -> dict[str, float]:
    speed = np.hypot(*truth["velocity"][tick:, :2].T)
    still = int(np.argmax(speed < 0.02))
    way_m = truth["pose"][tick + still, :2] - truth["pose"][tick, :2]
    lost_m = (truth["odometry"] - truth["pose"])[:, :2]
    return {
        "from_m_s": float(speed[0]),
        "distance_mm": 1e3 * float(np.hypot(*way_m)),
        "time_ms": float(still),
        "odometry_error_mm": 1e3 * float(np.hypot(*(lost_m[-1] - lost_m[tick]))),
    }
