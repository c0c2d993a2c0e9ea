"""`omnislip gap benchmark`: hide effects with the independent generator, see what is found.

A case is a data set of 8 runs of 6 s at 200 Hz. Cases run side by side, each on one thread, and a
second call computes only what is missing (compute.py). Every case has its folder with the logs, the
truth, gap.json and result.json; results.parquet has one row per case. Cases of the development set
may be looked at and learned from; those of the sealed set have other seeds and are for the final
figure.

How strongly a data set shows what is hidden in it says the oracle: it knows which effects are
hidden and fits their sizes. lambda = fall of the objective (inference.py) from the refitted keys to
the oracle, over the inflation. Below 25 nothing can be seen, and saying nothing is right.

A friction curve of the truth that is not the believed arctangent is an effect of its own; naming it
(`contact_shape`) is right, and not naming it is no fault.
"""

import json
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from omnislip.compute import Outcome, run_cases
from omnislip.files import replace_file
from omnislip.gap.find import Findings, find_gap, to_json
from omnislip.gap.inference import Data, Fit, Hypothesis, fit, weigh
from omnislip.gap.machine import Candidate, Machine
from omnislip.gap.metrics import gap_table, replay_all
from omnislip.gap.noise import tune_noise
from omnislip.gap.recordings import Run
from omnislip.gap.truth import TruthCase, random_case, write_case
from omnislip.gap.truth_effects import EFFECTS, UNKNOWN_EFFECTS

CURVE_EFFECT = "contact_shape"
SEEDS = {"development": 1_000, "sealed": 5_000_000}
RESULTS = "results.parquet"
WIRING_EFFECTS = ("wheel_permutation", "encoder_sign", "motor_sign")
VISIBLE = 25.0
IN_TIME_S = 0.015
SIZES = {
    "tiny": {"null": 1, "single": 3, "double": 1, "unknown": 1, "impact": 1, "wiring": 1},
    "small": {"null": 20, "single": 57, "double": 20, "unknown": 13, "impact": 8, "wiring": 3},
    "full": {"null": 150, "single": 171, "double": 84, "unknown": 52, "impact": 28, "wiring": 12},
}
"""Cases of each class. Singles and unknowns go round the effects in turn."""


@dataclass(frozen=True)
class Task:
    """One data set to make and to solve."""

    name: str
    kind: str
    case: TruthCase


def tasks(which: str, size: str, kinds: Iterable[str] = ()) -> list[Task]:
    """Return the cases of a set; a smaller size is a part of the larger one."""
    chosen = set(kinds) or set(SIZES[size])
    return [
        _task(which, kind, number)
        for kind, count in SIZES[size].items()
        if kind in chosen
        for number in range(count)
    ]


def _task(which: str, kind: str, number: int) -> Task:
    first = SEEDS[which] + 10_000 * list(SIZES["full"]).index(kind)
    seed = first + number
    rng = np.random.default_rng([seed, 77])
    if kind == "wiring":
        case = _wiring_case(seed, rng, WIRING_EFFECTS[number % len(WIRING_EFFECTS)])
    else:
        case = _driven_well(random_case(seed, kind, _names(kind, number)), rng)
    if kind == "null" and number % 3 == 2:  # noise and rows at their worst
        case = replace(case, noise_level=3.0, disorder=4.0)
    hidden = "+".join(dict.fromkeys(e["name"] for e in case.effects)) or case.friction_curve
    return Task(f"{kind}_{number:03d}_{hidden}", kind, case)


def _names(kind: str, number: int) -> list[str]:
    if kind == "single":
        drawable = [name for name, effect in EFFECTS.items() if effect.drawn]
        order = np.random.default_rng(0).permutation(len(drawable))
        return [drawable[order[number % len(drawable)]]]
    if kind == "unknown":
        return [list(UNKNOWN_EFFECTS)[number % len(UNKNOWN_EFFECTS)]]
    return []


def _driven_well(case: TruthCase, rng: np.random.Generator) -> TruthCase:
    """Return the case with the sensors and programmes that most of the users have."""
    sensors = case.sensors if rng.random() < 0.2 else ("gyro", "pose")
    excitation = str(rng.choice(["rich", "ordinary", "poor"], p=[0.6, 0.35, 0.05]))
    return replace(case, sensors=sensors, excitation=excitation)


def _wiring_case(seed: int, rng: np.random.Generator, name: str) -> TruthCase:
    """Return a case of one mistake; motors and encoders are wired in open loop only."""
    if name == "wheel_permutation":
        order = [1, 2, 3, 4]
        while order == [1, 2, 3, 4]:
            order = [int(i) for i in rng.permutation([1, 2, 3, 4])]
        effect = {"name": name, "parameters": {"wheels": order}}
    else:
        effect = {"name": name, "wheel": int(rng.integers(1, 5))}
    return TruthCase(seed=seed, effects=(effect,))


def run_benchmark(
    out: Path,
    chosen: Sequence[Task],
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Return one row per case, and write them all to `out`.

    `scheduler`, `progress`: as in run_cases. But for the time it took, a row is the same wherever
    its case was computed.
    """
    rows = run_cases(solve, {task.name: asdict(task) for task in chosen}, out, scheduler, progress)
    with replace_file(out / RESULTS) as temporary:
        pd.DataFrame(rows).to_parquet(temporary, index=False)
    return rows


def solve(case: dict[str, Any]) -> Outcome:
    """Make and solve one of the tasks, given as a dict; the files of its folder, and its row."""
    task = Task(**case | {"case": TruthCase(**case["case"])})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = write_case(task.case, folder)
        begin = time.monotonic()
        findings = find_gap(folder / "robot.toml", sorted(folder.glob("run_*.csv")), _silent)
        seconds = time.monotonic() - begin
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    found = to_json(findings)
    found["inputs_sha256"] = {Path(p).name: mark for p, mark in found["inputs_sha256"].items()}
    row = score(truth, found) | {"name": task.name, "kind": task.kind, "time_s": seconds}
    row |= _ask_oracle(findings, truth)
    files |= {"gap.json": _json(found), "result.json": _json(row)}
    return Outcome(row, {f"{task.name}/{name}": content for name, content in files.items()})


def _silent(_text: str) -> None:
    pass


def _json(value: dict[str, Any]) -> bytes:
    return json.dumps(value, indent=1).encode()


def score(truth: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Compare gap.json with the truth; see the head of the module for what counts as right."""
    wanted = [(e["name"], e["wheel"]) for e in truth["effects"]]
    allowed = {(name, None) for name in truth["also_true"]}
    named = [(e["name"], e["wheel"]) for e in found["effects"]]
    counted = [pair for pair in named if pair not in allowed]
    sets = [
        {_label(*n), *e["ambiguous_with"]} for n, e in zip(named, found["effects"], strict=True)
    ]
    judged = [s for n, s in zip(named, sets, strict=True) if n not in allowed]
    return {
        "hidden": [_label(*pair) for pair in wanted],
        "friction_curve": truth["friction_curve"],
        "closed_loop": truth["closed_loop"],
        "excitation": truth["excitation"],
        "sensors": truth["sensors"],
        "verdict": found["verdict"],
        "expected_verdict": truth["expected_verdict"],
        "named": [_label(*pair) for pair in named],
        "ambiguous": [sorted(s) for s in sets],
        "unknown": [f"{u['equation']}: {u['dependence']}" for u in found["unknown"][:3]],
        "nearest": [_label(e["name"], e["wheel"]) for e in found["nearest"]],
        "first": bool(counted) and counted[0] in wanted if wanted else not counted,
        "exact": sorted(set(counted), key=str) == sorted(set(wanted), key=str),
        "recall": [pair in named for pair in wanted],
        "wheel": _wheel_right(wanted, named),
        "in_set": [any(_label(*pair) in s for s in sets) for pair in wanted],
        "set_size": [len(s) for s in judged],
        "sizes": _size_errors(truth, found),
        "impacts": _impacts_in_time(truth, found),
    }


def _label(name: str, wheel: int | None) -> str:
    return name if wheel is None else f"{name} (wheel {wheel})"


def _wheel_right(wanted: Sequence[tuple], named: Sequence[tuple]) -> bool | None:
    """Whether effects of one wheel are named with that wheel; None where none is named."""
    pairs = [(w, n) for w in wanted for n in named if w[0] == n[0] and w[1] is not None]
    return any(w == n for w, n in pairs) if pairs else None


def _size_errors(truth: dict[str, Any], found: dict[str, Any]) -> list[dict[str, Any]]:
    """Error of every number of the effects that were named, and whether its interval holds it.

    A size is compared relatively; that of a scale is what it lacks to one.
    """
    errors = []
    for hidden in truth["effects"]:
        for effect in found["effects"]:
            if (effect["name"], effect["wheel"]) != (hidden["name"], hidden["wheel"]):
                continue
            if hidden["name"] == "impact":
                continue
            for key, value in hidden["parameters"].items():
                if key not in effect["parameters"] or isinstance(value, list):
                    continue
                one = effect["parameters"][key]
                size = abs(value - 1.0) if "scale" in key else abs(value)
                if size == 0 or not np.isfinite(size):
                    continue
                inside = one["low"] <= value <= one["high"]
                error = abs(one["value"] - value) / size
                errors.append({"parameter": key, "error": error, "inside": inside})
    return errors


def _impacts_in_time(truth: dict[str, Any], found: dict[str, Any]) -> dict[str, Any] | None:
    """How many pushes were found at their time, and how many there are in truth and in gap.json."""
    pushes = [e for e in truth["effects"] if e["name"] == "impact"]
    seen = [e for e in found["effects"] if e["name"] == "impact"]
    if not pushes and not seen:
        return None
    late = [
        min(
            (
                abs(s["parameters"]["time_s"]["value"] - p["parameters"]["time_s"])
                for s in seen
                if s["run"] == p["run"]
            ),
            default=np.inf,
        )
        for p in pushes
    ]
    return {
        "in_time": sum(one <= IN_TIME_S for one in late),
        "hidden": len(pushes),
        "found": len(seen),
    }


def _ask_oracle(findings: Findings, truth: dict[str, Any]) -> dict[str, Any]:
    """Fit the true structure: how visible it is, and how much of the gap it closes.

    `lambda` is None where the catalogue cannot hold the truth (unknown, wiring, impact).
    """
    nothing = {"lambda": None, "gap_closed": None, "gap_closed_oracle": None}
    machine, outcome = findings.machine, findings.outcome
    runs = [*findings.split.fitting, *findings.split.validation]
    structure = _true_structure(machine, runs, truth)
    if outcome is None or structure is None:
        return nothing
    base = outcome.ladder[0].hypothesis
    sizes = [outcome.ladder[0].hypothesis.x] + [np.array(values) for _, values in structure]
    oracle = Hypothesis(base.base, tuple(c for c, _ in structure), np.concatenate(sizes))
    values = oracle.flat(machine.believed)
    data = Data(machine, runs, tune_noise(machine, runs, values, outcome.data.noise), values)
    fitted = fit(data, oracle)
    visible = None
    if truth["effects"]:
        visible = min(_lambda(data, fitted, i) for i in range(len(truth["effects"])))
    models = [machine.believed, base.flat(machine.believed)]
    closed = []
    for hypothesis in (outcome.final.hypothesis, fitted.hypothesis):
        sets = [*models, hypothesis.flat(machine.believed)]
        table = gap_table(replay_all(machine, findings.split.held_out, data.noise, sets))
        closed.append(table.closed.value)
    return {"lambda": visible, "gap_closed": closed[0], "gap_closed_oracle": closed[1]}


def _lambda(data: Data, fitted: Fit, index: int) -> float:
    without = fit(data, fitted.hypothesis.without(index))
    evidence = weigh(data, without.objective, fitted, index)
    return evidence.gain / evidence.inflation


def _true_structure(
    machine: Machine, runs: Sequence[Run], truth: dict[str, Any]
) -> list[tuple[Candidate, list[float]]] | None:
    candidates = [*machine.candidates(), *machine.floor_candidates(runs)] if runs else []
    known = {(c.effect, c.wheel): c for c in candidates}
    if not known:
        return None
    structure = []
    for effect in truth["effects"]:
        candidate = known.get((effect["name"], effect["wheel"]))
        if candidate is None:
            return None
        sizes = [effect["parameters"].get(p.label, 0.0) for p in candidate.parameters]
        low, high = ([getattr(p, k) for p in candidate.parameters] for k in ("low", "high"))
        structure.append((candidate, list(np.clip(sizes, low, high))))
    if truth["friction_curve"] != "atan":
        structure.append((known[CURVE_EFFECT, None], [0.7]))
    return structure


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the figures of all classes: share with its 95 % Wilson interval, or median.

    Singles and doubles count where the oracle sees every hidden effect (`VISIBLE`).
    """
    of = {kind: [r for r in rows if r["kind"] == kind] for kind in SIZES["full"]}
    seen = {k: [r for r in of[k] if (r["lambda"] or 0) >= VISIBLE] for k in ("single", "double")}
    both = seen["single"] + seen["double"]
    sizes = [s for r in both for s in r["sizes"]]
    pushes = [r["impacts"] for r in of["impact"] if r["impacts"]]
    closed = [
        r["gap_closed"] / r["gap_closed_oracle"]
        for r in both
        if r["gap_closed"] is not None and (r["gap_closed_oracle"] or 0) > 0.05
    ]
    misnamed = [r["verdict"] == "effect_found" and not r["first"] for r in of["unknown"]]
    return {
        "single: first name right": _share([r["first"] for r in seen["single"]]),
        "single: exact set": _share([r["exact"] for r in seen["single"]]),
        "wheel right": _share([r["wheel"] for r in both if r["wheel"] is not None]),
        "size error, median": _median([s["error"] for s in sizes]),
        "interval holds the size": _share([s["inside"] for s in sizes]),
        "null: false alarm": _share([not r["exact"] for r in of["null"]]),
        "double: both found": _share([all(r["recall"]) for r in seen["double"]]),
        "double: exact set": _share([r["exact"] for r in seen["double"]]),
        "unknown: flagged": _share([r["verdict"] == "unknown_effect" for r in of["unknown"]]),
        "unknown: misnamed": _share(misnamed),
        "truth inside the ambiguity set": _share([i for r in both for i in r["in_set"]]),
        "ambiguity set, mean size": _mean([n for r in both for n in r["set_size"]]),
        "gap closed against the oracle, median": _median(closed),
        "impacts in time": {
            "hits": sum(p["in_time"] for p in pushes),
            "of": sum(p["hidden"] for p in pushes),
            **_wilson(sum(p["in_time"] for p in pushes), sum(p["hidden"] for p in pushes)),
        },
        "wiring: right": _share([r["exact"] for r in of["wiring"]]),
        "time, median s": _median([r["time_s"] for r in rows]),
    }


def _share(hits: Sequence[bool]) -> dict[str, Any]:
    return {"hits": sum(hits), "of": len(hits), **_wilson(sum(hits), len(hits))}


def _wilson(hits: int, count: int) -> dict[str, float | None]:
    """Share and its 95 % interval (Wilson 1927)."""
    if count == 0:
        return {"value": None, "low": None, "high": None}
    z, share = 1.959964, hits / count
    middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return {"value": share, "low": float(middle - half), "high": float(middle + half)}


def _median(values: Sequence[float]) -> dict[str, Any]:
    return {"value": float(np.median(values)) if len(values) else None, "of": len(values)}


def _mean(values: Sequence[float]) -> dict[str, Any]:
    return {"value": float(np.mean(values)) if len(values) else None, "of": len(values)}


def draw_confusion(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw hidden effect against the first name given (png)."""
    pairs = []
    for row in rows:
        if row["kind"] not in ("single", "unknown", "null", "wiring"):
            continue
        hidden = _bare(row["hidden"][0]) if row["hidden"] else "nothing"
        given = [n for n in map(_bare, row["named"]) if n != CURVE_EFFECT or hidden == n]
        silent = "unknown" if row["verdict"] == "unknown_effect" else "nothing"
        pairs.append((hidden, given[0] if given else silent))
    truth = sorted({t for t, _ in pairs})
    names = sorted({n for _, n in pairs}, key=lambda n: (n not in truth, n))
    table = np.zeros((len(truth), len(names)))
    for hidden, given in pairs:
        table[truth.index(hidden), names.index(given)] += 1
    figure = Figure(figsize=(4 + 0.2 * len(names), 3 + 0.2 * len(truth)), layout="constrained")
    axes = figure.subplots()
    shown = np.where(table > 0, table, np.nan) / table.sum(axis=1, keepdims=True)
    axes.imshow(shown, cmap="viridis_r", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(truth)), truth, fontsize=7)
    axes.set(xlabel="first name given", ylabel="hidden")
    for (i, j), count in np.ndenumerate(table):
        if count:
            axes.text(j, i, f"{count:.0f}", ha="center", va="center", fontsize=6, color="white")
    with replace_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)


def _bare(label: str) -> str:
    return label.split(" (")[0]
