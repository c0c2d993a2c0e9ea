"""`tools/bench`: what the simulation costs here, how exact it is, and MuJoCo beside it.

One run is measured in processor time, batches on threads in time on the clock; each is the best of
as many as half a second takes, five at least. The load of the machine is printed first: other work
takes cores, and slows down what shares one.
"""

import importlib.util
import os
import platform
import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from omnislip import _core
from omnislip.firmware_parameters import firmware_parameters
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import Run, make_run
from omnislip.link.drive import drive
from omnislip.link.record import Recorder
from omnislip.link.session import Session
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import Scenario, read_scenario
from omnislip.simulate import run_scenario, simulate_truth
from omnislip.virtual_robot import VirtualLine, make_robot

Array = npt.NDArray[np.float64]

SCENARIOS = Path(__file__).parent / "scenarios"
REPETITIONS = 5
MEASURED_S = 0.5
SETS = 128
PLANT_STEP_S = 5e-4
CLOSED_LOOP_STEP_S = 1e-3
REFINED_STEP_S = 2.5e-5
MUJOCO_STEP_S = 1e-3
MUJOCO_REFINED_STEP_S = 1e-4
EFFECTS = {
    "supply_sag": {"source_resistance_ohm": 0.1},
    "coulomb_friction": {"torque_nm": 0.005},
    "load_transfer": {"cog_height_m": 0.1},
    "cog_offset": {"x_m": 0.02},
}


def best_time_s(
    work: Callable[[], object], clock: Callable[[], float] = time.process_time
) -> float:
    """Return the shortest of many timings: what the work costs when nothing disturbs it."""
    times = []
    while len(times) < REPETITIONS or sum(times) < MEASURED_S:
        begin = clock()
        work()
        times.append(clock() - begin)
    return min(times)


def main() -> None:
    """Print the tables."""
    console = Console()
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    console.print(f"{cores} cores of {_processor()}")
    console.print(f"programs that wanted a core during the last minute: {load:.1f}")
    steps = _step_times()
    console.print(_models(steps))
    closed_loops, closed_loop_speed = _closed_loops(steps["firmware"])
    console.print(closed_loops)
    console.print(_virtual_robots())
    console.print(_batches())
    if importlib.util.find_spec("mujoco") is None:
        console.print("MuJoCo is not installed: pip install mujoco")
    else:
        console.print(_beside_mujoco(steps["slip"], closed_loop_speed))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    console.print(f"peak memory of this process: {peak_mb:.0f} MB")


def _processor() -> str:
    """Return its name as Linux knows it."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number == 0 else "right")
    return table


def _step_times() -> dict[str, float]:
    model = read_model(NOMINAL_ROBOT)
    parameters, _ = model.to_core()
    effects = [{"name": name, "parameters": numbers} for name, numbers in EFFECTS.items()]
    return _core.step_times_ns(parameters, effects, firmware_parameters(model.values))


def _models(steps: dict[str, float]) -> Table:
    table = _table("one core, one robot", "model", "ns per step", "step", "times real time")
    for name in ("rigid", "slip", "slip, with effects", "axis", "odometry"):
        label = f"slip with {', '.join(EFFECTS)}" if name == "slip, with effects" else name
        speed = PLANT_STEP_S * 1e9 / steps[name]
        table.add_row(label, f"{steps[name]:.0f}", "0.5 ms", f"{speed:,.0f}")
    firmware = f"{1e6 / steps['firmware']:,.0f}"
    table.add_row("firmware alone", f"{steps['firmware']:.0f}", "1 ms tick", firmware)
    return table


def _closed_loops(firmware_ns: float) -> tuple[Table, float]:
    """Return the table and how many times real time the slowest run with the default step is."""
    slowest = float("inf")
    table = _table(
        "closed loop, firmware at 1 kHz, one core",
        "scenario",
        "slip model",
        "step",
        "times real time",
        "firmware",
        "off 25 us steps",
    )
    for name in ("identification", "square", "straight_impact"):
        for compensation in (False, True)[: 1 if name == "identification" else 2]:
            scenario = replace(
                read_scenario(SCENARIOS / f"{name}.toml"), slip_compensation=compensation
            )
            refined = simulate_truth(scenario, step_s=REFINED_STEP_S)["pose"]
            for step_s in (CLOSED_LOOP_STEP_S, CLOSED_LOOP_STEP_S / 2):
                spent_s = best_time_s(
                    lambda run=scenario, step=step_s: simulate_truth(run, step_s=step)
                )
                table.add_row(*_closed_loop(scenario, step_s, refined, firmware_ns, spent_s))
                if step_s == CLOSED_LOOP_STEP_S:
                    slowest = min(slowest, scenario.duration_s / spent_s)
    table.caption = f"{slowest:,.0f} times real time or more at steps of 1 ms"
    return table, slowest


def _closed_loop(
    scenario: Scenario, step_s: float, refined: Array, firmware_ns: float, spent_s: float
) -> Iterator[str]:
    apart_m = np.abs(simulate_truth(scenario, step_s=step_s)["pose"] - refined)[:, :2].max()
    yield scenario.name
    yield "used" if scenario.slip_compensation else "not used"
    yield f"{1e3 * step_s:g} ms"
    yield f"{scenario.duration_s / spent_s:,.0f}"
    # Under given duties most of the firmware rests: its cost of following commands says nothing.
    follows = any(command["kind"] in ("velocity", "pose") for command in scenario.commands)
    yield f"{firmware_ns * 1e-6 * scenario.duration_s / spent_s:.0%}" if follows else "-"
    yield f"{1e3 * apart_m:.4f} mm"


def _virtual_robots() -> Table:
    """Drive and record over the serial line; the host's work is in it."""
    table = _table(
        "virtual robot driven and recorded at 200 rows/s, with the host, one core",
        "firmware runs on",
        "times real time",
    )
    scenario = read_scenario(SCENARIOS / "identification.toml")
    model = read_model(NOMINAL_ROBOT)
    for name, on_board in (("stub HAL", False), ("virtual LF2407A", True)):
        spent = best_time_s(lambda own=on_board: _drive(make_robot(model, None, own), scenario))
        table.add_row(name, f"{scenario.duration_s / spent:,.0f}")
    return table


def _drive(robot: _core.VirtualRobot, scenario: Scenario) -> None:
    session = Session(VirtualLine(robot))
    session.connect()
    recorder = Recorder(session, 200)
    recorder.start()
    drive(session, scenario)
    recorder.finish(scenario.name)


def _batches() -> Table:
    table = _table(
        f"replays of one log, {SETS} parameter sets, steps of 1 ms",
        "instruction set",
        "lanes",
        "threads",
        "simulated seconds per second",
        "times one thread",
    )
    machine = Machine(read_model(NOMINAL_ROBOT))
    run = make_run(machine, run_scenario(read_scenario(SCENARIOS / "identification.toml")).log)
    cores = len(os.sched_getaffinity(0))
    for lanes in (2, 4, 8):
        engine = _core.Engine("robot", lanes)
        track = _track(engine, machine, run)
        alone = 0.0
        for count in sorted({1, 2, cores // 2, cores} & set(range(1, cores + 1))):
            _core.limit_threads(count)
            spent = best_time_s(
                lambda own=(engine, track): _replay_batch(*own, machine, run), time.perf_counter
            )
            speed = SETS * run.duration_s / spent
            alone = alone or speed
            row = (engine.instruction_set, str(engine.lanes), str(count), f"{speed:,.0f}")
            table.add_row(*row, f"{speed / alone:.2f}")
    _core.limit_threads(cores)
    return table


def _replay_batch(engine: _core.Engine, track: _core.Track, machine: Machine, run: Run) -> None:
    sets = np.tile(machine.believed, (SETS, 1))
    sets[:, 0] *= np.linspace(0.98, 1.02, SETS)
    engine.innovations([run.recording], [track], sets)


def _track(engine: _core.Engine, machine: Machine, run: Run) -> _core.Track:
    ones = np.ones(engine.states)
    return engine.track([run.recording], machine.believed, ones, np.ones(engine.outputs), ones)[0]


def _beside_mujoco(slip_step_ns: float, closed_loop_speed: float) -> Table:
    """The duties of a run with firmware, in rows of 5 ms, through both engines.

    The ratios say more than the other figures: they depend little on the machine.
    """
    scenario = replace(read_scenario(SCENARIOS / "square.toml"), duration_s=4.0)
    truth = simulate_truth(scenario)
    duty = truth["duty"].reshape(-1, 5, 4).mean(axis=1)
    reference = _plant_path(duty, 2e-5)
    spent = best_time_s(lambda: _mujoco_path(duty, MUJOCO_STEP_S))
    mujoco_speed = scenario.duration_s / spent
    coarse = _mujoco_path(duty, MUJOCO_STEP_S)
    fine = _mujoco_path(duty, MUJOCO_REFINED_STEP_S)
    table = _table(
        "the same duties for 4 s, one core, no firmware",
        "engine",
        "step",
        "times real time",
        "off its own refined run",
        "off the plant's refined run",
    )
    rows = [("MuJoCo", MUJOCO_STEP_S, mujoco_speed, coarse - fine, coarse - reference)]
    for step_s in (PLANT_STEP_S, MUJOCO_STEP_S):
        own = _plant_path(duty, step_s) - reference
        rows.insert(0, ("omnislip", step_s, step_s * 1e9 / slip_step_ns, own, own))
    for name, step_s, speed, *errors in rows:
        millimetres = [f"{1e3 * np.linalg.norm(e, axis=1).max():.2g} mm" for e in errors]
        table.add_row(name, f"{1e3 * step_s:g} ms", f"{speed:,.0f}", *millimetres)
    ratio = MUJOCO_STEP_S * 1e9 / slip_step_ns / mujoco_speed
    table.caption = (
        f"at steps of 1 ms {ratio:.0f} times as fast as MuJoCo; "
        f"with the firmware in closed loop still {closed_loop_speed / mujoco_speed:.0f} times"
    )
    return table


def _plant_path(duty: Array, step_s: float) -> Array:
    """Return x, y [m] (rows, 2) of the nominal plant from rest, rows of 5 ms."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    engine = machine.engine
    time_s = np.arange(len(duty)) * 5e-3
    silent = np.zeros((len(duty), engine.outputs))
    still = np.zeros(engine.states)
    recording = engine.recording(time_s, np.ascontiguousarray(duty), silent, still)
    track = engine.track([recording], machine.believed, still, np.ones(engine.outputs), still)
    return -engine.replays([recording], track, machine.believed[None], step_s, 1e9)[0][0, :, 5:7]


def _mujoco_path(duty: Array, step_s: float) -> Array:
    from omnislip.mujoco_robot import MujocoRobot

    parameters, _ = read_model(NOMINAL_ROBOT).to_core()
    robot = MujocoRobot(parameters, step_s)
    path = np.zeros((len(duty), 2))
    for row, held in enumerate(duty):
        path[row] = robot.pose()[:2]
        robot.drive(held, 5e-3)
    return path


if __name__ == "__main__":
    main()
