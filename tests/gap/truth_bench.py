"""Logs of the independent generator, in memory or in a folder, and their runs; a plain log."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from omnislip.gap.inference import Data, Fit, fit
from omnislip.gap.machine import Candidate, Machine
from omnislip.gap.recordings import Run, make_run
from omnislip.gap.screen import screen
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase, generate, write_case
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.log_file import Log, read_log
from omnislip.model_file import NOMINAL_ROBOT, read_model

LAGS = ("actuation_delay", "driver_lag", "armature_inductance")


def logs_of(case: TruthCase) -> list[Log]:
    """The logs of a case."""
    logs, _ = generate(case)
    return [
        Log(name, log["t_s"].to_numpy(), {c: log[c].to_numpy(float) for c in log.columns[1:]})
        for name, log in zip(case.run_names(), logs, strict=True)
    ]


def runs_of(machine: Machine, case: TruthCase) -> list[Run]:
    """The logs of a case as runs of the believed robot."""
    return [make_run(machine, log) for log in logs_of(case)]


def promises(data: Data, names: tuple[str, ...] = LAGS) -> dict[str, float]:
    """Gain that each effect promises beside the fitted keys."""
    base = fit(data, believed_hypothesis(data.machine), iterations=4)
    asked = [c for c in data.machine.candidates() if c.effect in names]
    return {s.candidate.effect: s.promise for s in screen(data, base, asked)}


def robot_runs(case: TruthCase, folder: Path) -> tuple[Machine, list[Run], dict[str, Candidate]]:
    """The robot of a case's logs, its runs, and its candidates by their effects."""
    write_case(case, folder)
    robot = Machine(read_model(folder / "robot.toml"))
    logs = [read_log(path, "robot") for path in sorted(folder.glob("run_*.csv"))]
    runs = [replace(make_run(robot, log), unit=log.name) for log in logs]
    candidates = robot.candidates_for(runs)
    return robot, runs, {c.effect: c for c in candidates}


def robot_with_magnets(
    magnets: float, folder: Path
) -> tuple[Machine, list[Run], dict[str, Candidate]]:
    """The same of a robot whose motors cog; the phase is 1 rad."""
    hidden = {"torque_nm": 0.008, "cycles_per_rev": magnets, "phase_rad": 1.0}
    effect = HiddenEffect("cogging", hidden).as_dict()
    case = TruthCase(seed=3, runs=2, run_duration_s=3.0, base_offset_sd=0.0, effects=(effect,))
    return robot_runs(case, folder)


def lag_named(
    folder: Path, hidden: str, named: str
) -> tuple[Data, Fit, dict[str, list[Candidate]]]:
    """Data with 1.5 ms of lag or delay, their fit under a name, and what may stand in its place."""
    robot = Machine(read_model(NOMINAL_ROBOT))
    labels = {c.effect: c.parameters[0].label for c in robot.candidates()}
    effect = HiddenEffect(hidden, {labels[hidden]: 0.0015}).as_dict()
    case = TruthCase(seed=77, effects=(effect,), excitation="rich", runs=2)
    robot, runs, candidates = robot_runs(case, folder)
    start = believed_hypothesis(robot).with_effect(candidates[named], [0.001])
    rivals = {named: [candidates[name] for name in LAGS if name != named]}
    return *settle(robot, runs, start), rivals


def robot_log(rows: int, **columns: np.ndarray) -> Log:
    """A log of a robot whose wheels swing to and fro, in step."""
    t_s = np.arange(rows) * 0.005
    wave = 0.3 * np.sin(5 * t_s)
    values = {f"wheel/{w}/duty": wave for w in range(1, 5)}
    turned = np.round(-3000 * np.cos(5 * t_s))
    values |= {f"wheel/{w}/encoder_counts": turned for w in range(1, 5)}
    return Log("run", t_s, values | columns)


def stretches(runs: list[Run]) -> set[tuple[str, float]]:
    """(name, row time) of every row."""
    return {(run.name, float(t)) for run in runs for t in run.t_s}
