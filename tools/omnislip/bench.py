"""`tools/bench`: simulated seconds per second of the closed loop and of batched replays."""

import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import Run, make_run
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import Scenario, read_scenario
from omnislip.simulate import run_scenario, simulate_truth

SCENARIO = Path(__file__).parent / "scenarios" / "identification.toml"
REPETITIONS = 5
SETS = 128


def best_time_s(work: Callable[[], object]) -> float:
    """Return the shortest of a few timings: what the work costs when nothing disturbs it."""
    times = []
    for _ in range(REPETITIONS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Print the table of figures."""
    scenario = read_scenario(SCENARIO)
    table = Table(title="simulated seconds per second (best of 5)")
    for heading in ("what", "step", "lanes", "per second"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    for model, changed in _closed_loops(scenario):
        spent = best_time_s(lambda own=changed: simulate_truth(own))
        table.add_row(model, "0.5 ms", "1", f"{changed.duration_s / spent:,.0f}")
    machine = Machine(read_model(NOMINAL_ROBOT))
    run = make_run(machine, run_scenario(scenario).log)
    for lanes in (2, 4, 8):
        engine = _core.Engine("robot", lanes)
        track = _track(engine, machine, run)
        name = f"replays of a log, both cores, {engine.instruction_set}"
        spent = best_time_s(lambda own=(engine, track): _replay_batch(*own, machine, run))
        table.add_row(name, "1 ms", str(engine.lanes), f"{SETS * run.duration_s / spent:,.0f}")
    Console().print(table)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of this process: {peak_mb:.0f} MB")


def _closed_loops(scenario: Scenario) -> list[tuple[str, Scenario]]:
    return [
        ("closed loop, firmware with slip model", replace(scenario, slip_compensation=True)),
        ("closed loop, firmware without slip model", replace(scenario, slip_compensation=False)),
    ]


def _replay_batch(engine: _core.Engine, track: _core.Track, machine: Machine, run: Run) -> None:
    sets = np.tile(machine.believed, (SETS, 1))
    sets[:, 0] *= np.linspace(0.98, 1.02, SETS)
    engine.innovations([run.recording], [track], sets)


def _track(engine: _core.Engine, machine: Machine, run: Run) -> _core.Track:
    ones = np.ones(engine.states)
    return engine.track([run.recording], machine.believed, ones, np.ones(engine.outputs), ones)[0]


if __name__ == "__main__":
    main()
