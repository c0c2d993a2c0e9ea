"""`omnislip gap benchmark`: hide effects with the independent generator, see what is found.

A case is a data set of 8 runs of 6 s at 200 Hz. Cases run side by side, each on one thread, and a
second call computes only what is missing (compute.py). Every case has its folder with the logs, the
truth, gap.json and result.json; results.parquet has one row per case. Cases of the development set
may be looked at and learned from; those of the sealed set have other seeds and are for the final
figure.

How strongly a data set shows what is hidden in it says the oracle: it knows which effects are
hidden and fits their sizes. lambda = fall of the objective (inference.py) from the refitted keys to
the oracle, over the inflation. Below 25 nothing can be seen, and saying nothing is right. Logs that
the workflow refused show as much as others: there lambda is of the runs that would be fitted.

A friction curve of the truth that is not the believed arctangent is an effect of its own; naming it
(`contact_shape`) is right, and not naming it is no fault.

Simpler methods (baselines.py) answer from the same logs and are scored by the same rules, where the
workflow did not refuse the logs. A case that raises an exception is a row, too: nothing of it is
right, its traceback is in error.txt of its folder, and the next call tries it again.
"""

import json
import math
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from omnislip.compute import Outcome, run_cases
from omnislip.files import replace_file
from omnislip.gap.baselines import METHODS, ask_baselines, check_installed, replay_errors
from omnislip.gap.find import find_gap
from omnislip.gap.findings import Findings, to_json
from omnislip.gap.inference import Data, Fit, Hypothesis, fit, weigh
from omnislip.gap.machine import CURVE, PHASE, Candidate, Machine, name_on_wheel
from omnislip.gap.metrics import gap_table, replay_all
from omnislip.gap.noise import judging_noise, tune_noise
from omnislip.gap.recordings import Run
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.split import split_runs
from omnislip.gap.truth import TruthCase, random_case, write_case
from omnislip.gap.truth_effects import EFFECTS, UNKNOWN_EFFECTS
from omnislip.log_file import read_logs

Array = npt.NDArray[np.float64]
Pair = tuple[str, int | None]

SEEDS = {"development": 1_000, "sealed": 5_000_000}
RESULTS, ERROR = "results.parquet", "error.txt"
FAILED, REFUSED = "failed", "insufficient_data"
"""Verdicts of a case that raised an exception, and of one whose logs the workflow did not take."""
WIRING_EFFECTS = ("wheel_permutation", "encoder_sign", "motor_sign")
VISIBLE = 25.0
IN_TIME_S = 0.015
SIZES = {
    "tiny": {"null": 1, "single": 3, "double": 1, "unknown": 1, "impact": 1, "wiring": 1},
    "small": {
        "null": 20,
        "single": 57,
        "double": 20,
        "unknown": 13,
        "impact": 8,
        "wiring": 3,
        "triple": 7,
    },
    "full": {
        "null": 150,
        "single": 171,
        "double": 84,
        "unknown": 52,
        "impact": 28,
        "wiring": 12,
        "triple": 28,
    },
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
    check_installed()
    for task in chosen:  # a case counts as finished while its files are there
        (out / task.name / ERROR).unlink(missing_ok=True)
    rows = run_cases(solve, {task.name: asdict(task) for task in chosen}, out, scheduler, progress)
    with replace_file(out / RESULTS) as temporary:
        pd.DataFrame(rows).to_parquet(temporary, index=False)
    return rows


def solve(case: dict[str, Any]) -> Outcome:
    """Make and solve one of the tasks, given as a dict; the files of its folder, and its row."""
    task = Task(**case | {"case": TruthCase(**case["case"])})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            row = _solve_in(folder, task)
        except ImportError:  # the fault of this machine, not of the case
            raise
        except Exception as error:
            row = _failed(task, error)
            (folder / ERROR).write_text(traceback.format_exc(), encoding="utf-8")
        (folder / "result.json").write_bytes(_json(row))
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    return Outcome(row, {f"{task.name}/{name}": content for name, content in files.items()})


def _solve_in(folder: Path, task: Task) -> dict[str, Any]:
    """Write logs, truth and gap.json into the folder; return the row."""
    truth = write_case(task.case, folder)
    log_paths = sorted(folder.glob("run_*.csv"))
    begin = time.monotonic()
    findings = find_gap(folder / "robot.toml", log_paths, _silent)
    seconds = time.monotonic() - begin
    found = to_json(findings)
    found["inputs_sha256"] = {Path(p).name: mark for p, mark in found["inputs_sha256"].items()}
    (folder / "gap.json").write_bytes(_json(found))
    row = score(truth, found) | _about(task) | {"time_s": seconds}
    row["chance"] = _least_chance(findings)
    oracle, seen = _ask_oracle(findings, log_paths, truth)
    return row | seen | _ask_others(findings, truth, oracle)


def _least_chance(findings: Findings) -> float | None:
    """Return the least bound of chance in the step that ended the search; None without one.

    Where nothing more is missing it should fall below 0.01 in no more than one case of a hundred.
    """
    if findings.outcome is None:
        return None
    trials = findings.outcome.trials
    last = [trial for trial in trials if trial.step == max(t.step for t in trials)]
    refused = [] if any(trial.accepted for trial in last) else last
    return min((trial.chance for trial in refused), default=1.0)


def _about(task: Task) -> dict[str, Any]:
    return {"name": task.name, "kind": task.kind, "error": None}


def _failed(task: Task, error: Exception) -> dict[str, Any]:
    """Row of a case that raised an exception: nothing is right."""
    case = task.case
    hidden = [effect.as_dict() for effect in case.hidden()]
    truth = {"effects": hidden, "also_true": [], "expected_verdict": None}
    keys = ("friction_curve", "closed_loop", "excitation", "sensors")
    found = {"verdict": FAILED, "effects": [], "unknown": [], "nearest": []}
    row = score(truth | {key: asdict(case)[key] for key in keys}, found) | _about(task)
    reason = str(error).strip().splitlines()[-1:]
    row |= {"error": ": ".join([type(error).__name__, *reason]), "time_s": None}
    row |= {"first": False, "exact": False, "chance": None}
    row |= {"wheel": False if any(e["wheel"] is not None for e in hidden) else None}
    return row | NOT_SEEN | dict.fromkeys(METHOD_COLUMNS)


def _silent(_text: str) -> None:
    pass


def _json(value: dict[str, Any]) -> bytes:
    return json.dumps(value, indent=1).encode()


def score(truth: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Compare gap.json with the truth; see the head of the module for what counts as right."""
    wanted, allowed = _wanted(truth)
    named = [(e["name"], e["wheel"]) for e in found["effects"]]
    sets = [
        {name_on_wheel(*n), *(name_on_wheel(r["name"], r["wheel"]) for r in e["rivals"])}
        for n, e in zip(named, found["effects"], strict=True)
    ]
    judged = [s for n, s in zip(named, sets, strict=True) if n not in allowed]
    return {
        "hidden": [name_on_wheel(*pair) for pair in wanted],
        "friction_curve": truth["friction_curve"],
        "closed_loop": truth["closed_loop"],
        "excitation": truth["excitation"],
        "sensors": truth["sensors"],
        "verdict": found["verdict"],
        "expected_verdict": truth["expected_verdict"],
        "named": [name_on_wheel(*pair) for pair in named],
        "ambiguous": [sorted(s) for s in sets],
        "unknown": [f"{u['equation']}: {u['dependence']}" for u in found["unknown"][:3]],
        "nearest": [name_on_wheel(e["name"], e["wheel"]) for e in found["nearest"]],
        **_right(truth, named),
        "recall": [pair in named for pair in wanted],
        "wheel": _wheel_right(wanted, named),
        "in_set": [any(name_on_wheel(*pair) in s for s in sets) for pair in wanted],
        "set_size": [len(s) for s in judged],
        "sizes": _size_errors(truth, found),
        "impacts": _impacts_in_time(truth, found),
    }


def _wanted(truth: dict[str, Any]) -> tuple[list[Pair], set[Pair]]:
    """Effects that are hidden, and those that may be named besides."""
    wanted = [(e["name"], e["wheel"]) for e in truth["effects"]]
    return wanted, {(name, None) for name in truth["also_true"]}


def _right(truth: dict[str, Any], named: Sequence[Pair]) -> dict[str, bool]:
    """Whether the first name and the set of all names are right."""
    wanted, allowed = _wanted(truth)
    counted = [pair for pair in named if pair not in allowed]
    return {
        "first": bool(counted) and counted[0] in wanted if wanted else not counted,
        "exact": set(counted) == set(wanted),
    }


def _wheel_right(wanted: Sequence[tuple], named: Sequence[tuple]) -> bool | None:
    """Whether all effects of one wheel that are named are on that wheel; None where none is."""
    names = {name for name, _ in named}
    of_wheels = [pair for pair in wanted if pair[1] is not None and pair[0] in names]
    return all(pair in named for pair in of_wheels) if of_wheels else None


def _size_errors(truth: dict[str, Any], found: dict[str, Any]) -> list[dict[str, Any]]:
    """Error of every number of the effects that were named, and whether its interval holds it.

    A size is compared relatively; that of a scale is what it lacks to one. Phases go round.
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
                short = value - one["value"]
                if key == PHASE:
                    short = math.remainder(short, 2.0 * math.pi)
                inside = one["low"] <= one["value"] + short <= one["high"]
                errors.append({"parameter": key, "error": abs(short) / size, "inside": inside})
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


NOT_SEEN = {"lambda": None, "gap_closed": None, "gap_closed_oracle": None}


def _ask_oracle(
    findings: Findings, log_paths: Sequence[Path], truth: dict[str, Any]
) -> tuple[Hypothesis | None, dict[str, Any]]:
    """Fit the true structure: its model, how visible it is, how much of the gap it closes.

    `lambda` is None where the catalogue cannot hold the truth (unknown, wiring, impact). Of refused
    logs the oracle tells nothing else.
    """
    machine, outcome = findings.machine, findings.outcome
    split = findings.split if outcome else split_runs(machine, read_logs(log_paths, machine.kind))
    runs = split.fitting
    structure = _true_structure(machine, runs, truth)
    if structure is None or not (outcome or truth["effects"]):
        return None, NOT_SEEN
    base = outcome.ladder[0].hypothesis if outcome else believed_hypothesis(machine)
    noise = outcome.data.noise if outcome else None
    sizes = [base.x] + [np.array(values) for _, values in structure]
    oracle = Hypothesis(base.base, tuple(c for c, _ in structure), np.concatenate(sizes))
    values = oracle.flat(machine.believed)
    data = Data(machine, runs, tune_noise(machine, runs, values, noise), oracle)
    fitted = fit(data, oracle)
    visible = None
    if truth["effects"]:
        visible = min(_lambda(data, fitted, i) for i in range(len(truth["effects"])))
    if outcome is None:
        return None, NOT_SEEN | {"lambda": visible}
    models = [machine.believed, base.flat(machine.believed)]
    judging = judging_noise(machine, runs, fitted.hypothesis.flat(machine.believed), data.noise)
    closed = []
    for hypothesis in (outcome.final.hypothesis, fitted.hypothesis):
        sets = [*models, hypothesis.flat(machine.believed)]
        table = gap_table(replay_all(machine, findings.split.held_out, judging, sets))
        closed.append(table.closed.value)
    seen = {"lambda": visible, "gap_closed": closed[0], "gap_closed_oracle": closed[1]}
    return fitted.hypothesis, seen


METHOD_COLUMNS = (
    *(f"{method}: {what}" for method in METHODS for what in ("named", "first", "exact")),
    *(f"{method}: replay_error" for method in ("workflow", "oracle", *METHODS)),
    "baselines_time_s",
)


def _ask_others(
    findings: Findings, truth: dict[str, Any], oracle: Hypothesis | None
) -> dict[str, Any]:
    """Score the answers of the baselines, and the replays of all models on the held-out runs.

    `replay_error` is in noise floors of the workflow's model; all columns are None where the logs
    were refused.
    """
    row: dict[str, Any] = dict.fromkeys(METHOD_COLUMNS)
    machine, outcome, split = findings.machine, findings.outcome, findings.split
    if outcome is None:
        return row
    begin = time.monotonic()
    answers = ask_baselines(machine, split, outcome.ladder[0].hypothesis, outcome.data.noise)
    row["baselines_time_s"] = time.monotonic() - begin
    models = {"workflow": outcome.final.hypothesis.flat(machine.believed)}
    models |= {name: answer.values for name, answer in answers.items()}
    if oracle is not None:
        models["oracle"] = oracle.flat(machine.believed)
    for name, answer in answers.items():
        row[f"{name}: named"] = [name_on_wheel(*pair) for pair in answer.named]
        row |= {f"{name}: {key}": right for key, right in _right(truth, answer.named).items()}
    errors = replay_errors(machine, split.held_out, findings.noise, list(models.values()))
    for name, error in zip(models, errors, strict=True):
        row[f"{name}: replay_error"] = float(error)
    return row


def _lambda(data: Data, fitted: Fit, index: int) -> float:
    without = fit(data, fitted.hypothesis.without(index))
    evidence = weigh(data, without, fitted, index)
    return evidence.beyond_chance


def _true_structure(
    machine: Machine, runs: Sequence[Run], truth: dict[str, Any]
) -> list[tuple[Candidate, list[float]]] | None:
    candidates = machine.candidates_for(runs) if runs else []
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
        structure.append((known[CURVE, None], [0.7]))
    return structure
