"""Logs of the independent generator in memory, for tests that need no folder."""

from omnislip.gap.inference import Data, fit
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import Run, make_run
from omnislip.gap.search import believed_hypothesis, screen
from omnislip.gap.truth import TruthCase, generate
from omnislip.log_file import Log

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
