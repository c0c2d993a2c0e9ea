"""`omnislip gap benchmark`: hide effects with the independent generator, see what is found."""

import json
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from omnislip.files import write_text
from omnislip.gap.find import find_gap, to_json
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import typical_effect
from omnislip.gap.truth_plant import FRICTION_CURVES

TEN = (
    "coulomb_friction",
    "viscous_friction_error",
    "supply_sag",
    "dead_zone",
    "payload",
    "low_grip",
    "weak_motor",
    "cog_offset",
    "floor_slope",
    "asymmetric_friction",
)
# A friction curve that is not the believed one is an effect too, and a fair find.
CURVE_EFFECT = "contact_shape"
FIRST_SEED = 1000


def run_benchmark(
    out: Path, effects: Sequence[str], per_effect: int, progress: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return one row per case; finished cases are read back from `out`."""
    rows = []
    for number, name in enumerate(effects):
        for repetition in range(per_effect):
            folder = out / f"{name}_{repetition + 1:02d}"
            result = folder / "result.json"
            if not result.exists():
                progress(f"{folder.name}: making logs")
                case = _case(name, FIRST_SEED + 100 * repetition + number)
                write_text(result, json.dumps(_run(case, folder, name, progress), indent=1))
            rows.append(json.loads(result.read_text()))
    return rows


def _case(name: str, seed: int) -> TruthCase:
    """Return a case: curves and open or closed loop change with the seed."""
    rng = np.random.default_rng(seed)
    hidden = () if name == "none" else (typical_effect(name, int(rng.integers(1, 5))).as_dict(),)
    return TruthCase(
        seed=seed,
        effects=hidden,
        friction_curve=FRICTION_CURVES[seed % len(FRICTION_CURVES)],
        closed_loop=bool(rng.integers(2)),
    )


def _run(
    case: TruthCase, folder: Path, name: str, progress: Callable[[str], None]
) -> dict[str, Any]:
    truth = write_case(case, folder)
    logs = sorted(folder.glob("run_*.csv"))
    begin = time.monotonic()
    found = to_json(
        find_gap(folder / "robot.toml", logs, lambda text: progress(f"{folder.name}: {text}"))
    )
    named = [(e["name"], e["wheel"]) for e in found["effects"]]
    wanted = [(e["name"], e["wheel"]) for e in truth["effects"]]
    extra = [pair for pair in named if pair not in wanted and pair[0] != CURVE_EFFECT]
    channels = found["gap"]["channels"].values()
    return {
        "hidden": name if not wanted or wanted[0][1] is None else f"{name} (wheel {wanted[0][1]})",
        "friction_curve": case.friction_curve,
        "closed_loop": case.closed_loop,
        "verdict": found["verdict"],
        "named": [n if w is None else f"{n} (wheel {w})" for n, w in named],
        "right": all(pair in named for pair in wanted) and not extra,
        "size_error": _size_error(truth, found),
        "refit_in_floors": _in_floors(channels, "refit"),
        "after_in_floors": _in_floors(channels, "after"),
        "closed_fraction": found["gap"]["closed_fraction"],
        "time_s": time.monotonic() - begin,
    }


def _size_error(truth: dict[str, Any], found: dict[str, Any]) -> float | None:
    """Largest relative error of the hidden effect's parameters, where it was named."""
    errors = []
    for hidden in truth["effects"]:
        for effect in found["effects"]:
            if (effect["name"], effect["wheel"]) == (hidden["name"], hidden["wheel"]):
                errors += [
                    abs(effect["parameters"][key]["value"] / value - 1.0)
                    for key, value in hidden["parameters"].items()
                    if key in effect["parameters"] and value
                ]
    return max(errors) if errors else None


def _in_floors(channels: Collection[dict[str, float]], model: str) -> float:
    ratios = [(c[model] / c["noise_floor"]) ** 2 for c in channels if c["noise_floor"] > 0]
    return float(np.sqrt(np.mean(ratios)))
