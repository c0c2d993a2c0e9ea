"""Sweeps: one scenario simulated many times, with keys of the scenario and of its robot varied.

    [sweep]
    kind = "random"                              # or "grid": every combination, last key fastest
    cases = 200                                  # random only
    seed = 1                                     # random only, default 0
    [vary]
    robot.mass_kg = { uniform = [15.0, 25.0] }             # between two values
    contact.slip_stiffness_s_m = { log_uniform = [10.0, 100.0] }
    motor.supply_v = { normal = [24.0, 0.5] }              # mean, standard deviation
    scenario.seed = { whole = [1, 1000000] }               # whole numbers, both ends included
    scenario.controller = ["plain", "slip"]                # one of a list (grid: each of it)
    command.1.velocity.vx_m_s = { linear = [0.5, 2.0, 4] } # grid only: from, to, how many values
    effects.dead_zone.duty = { logarithmic = [0.01, 0.1, 3] } # grid only

A key is the place in the file it belongs to: tables scenario, log, sensors, command and impact are
those of the scenario, all others those of its model file. Commands, impacts, wheels and other
elements of lists are numbered from 1; those of velocity, pose and arrival_velocity have the names
given in scenario.py. An effect is varied as effects.NAME.PARAMETER, of one wheel as
effects.NAME.wheel_2.PARAMETER; one that the model lacks is added. The firmware is set for the
varied values of the robot; what it shall not know of is varied as an effect. Draws of a key depend
on seed and key alone: more cases or other keys leave them as they are.

Results in the folder: summary.parquet, one row per case: case (from 1), log, the varied keys, the
numbers of measures.py, error (why a case could not be simulated; its numbers are then blank);
logs/case_000001.parquet and so on (log_file.py); finished.jsonl, from which a run that was stopped
goes on (compute.py).
"""

import copy
import io
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from omnislip.compute import Outcome, run_cases
from omnislip.errors import InputError
from omnislip.files import check_known, check_numbers, check_table, load_toml, replace_file
from omnislip.log_file import log_frame
from omnislip.measures import measure
from omnislip.model_file import parse_model, read_model
from omnislip.scenario import Scenario, parse_scenario, read_scenario, robot_path
from omnislip.simulate import make_log, simulate_truth

KINDS = ("grid", "random")
SCENARIO_TABLES = ("scenario", "log", "sensors", "command", "impact")
ELEMENT_NAMES = {
    "velocity": ("vx_m_s", "vy_m_s", "omega_rad_s"),
    "arrival_velocity": ("vx_m_s", "vy_m_s", "omega_rad_s"),
    "pose": ("x_m", "y_m", "theta_rad"),
}
SPREADS = ("linear", "logarithmic")
WHEEL_MARKS = {f"wheel_{wheel}": wheel for wheel in range(1, 5)}
DRAWS = ("uniform", "log_uniform", "normal", "whole")
MAX_CASES = 100_000
SUMMARY = "summary.parquet"

Tables = dict[str, Any]
Draw = Callable[[np.random.Generator, int], Sequence[Any]]


@dataclass(frozen=True)
class Sweep:
    """The cases of a sweep: for each the value of every varied key, in the order of the file."""

    path: Path
    cases: list[dict[str, Any]]


def read_sweep(path: Path | str) -> Sweep:
    """Read and check a sweep file. InputError names the file, the key and what would be right."""
    path = Path(path)
    data = load_toml(path)
    check_known(data, ["sweep", "vary"], "table", path)
    head = check_table(data.get("sweep", {}), "sweep", path)
    check_known(head, ["kind", "cases", "seed"], "key in [sweep]", path)
    if head.get("kind") not in KINDS:
        raise InputError(
            f"{path}: 'sweep.kind' must be one of {', '.join(KINDS)}, not {head.get('kind')!r}"
        )
    vary = dict(_flat(check_table(data.get("vary", {}), "vary", path)))
    if not vary:
        raise InputError(f"{path}: [vary] needs at least one key such as robot.mass_kg")
    cases = _grid(head, vary, path) if head["kind"] == "grid" else _random(head, vary, path)
    return Sweep(path, cases)


def run_sweep(
    scenario: Path,
    sweep: Sweep,
    out: Path,
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> pd.DataFrame:
    """Simulate every case, write logs and summary to `out`; return the summary.

    All cases are checked before the first is simulated. `scheduler`, `progress`: as in run_cases.
    """
    cases = checked_cases(scenario, sweep)
    _check_folder(out, cases)
    results = run_cases(simulate_case, cases, out, scheduler, progress)
    errors = [result["error"] for result in results]
    if all(errors):
        raise InputError(f"{sweep.path}: no case can be simulated; the first: {errors[0]}")
    logs = [None if error else _log_name(name) for name, error in zip(cases, errors, strict=True)]
    frame = pd.DataFrame({"case": range(1, len(cases) + 1), "log": logs})
    frame = pd.concat([frame, pd.DataFrame(sweep.cases), pd.DataFrame(results)], axis=1)
    frame["error"] = frame.pop("error")  # the last column
    with replace_file(out / SUMMARY) as temporary:
        frame.to_parquet(temporary, index=False)
    return frame


def checked_cases(scenario: Path, sweep: Sweep) -> dict[str, Tables]:
    """Return what simulate_case needs of each case: the tables of both files, the varied keys.

    Every case has been checked as the files themselves are; InputError names the first bad one.
    """
    read_scenario(scenario)
    base = load_toml(scenario)
    robots: dict[Path, Tables] = {}
    cases = {}
    for number, varied in enumerate(sweep.cases, start=1):
        name = f"case_{number:06d}"
        try:
            path = robot_path(_with_keys(base, varied, scenario, of_scenario=True), scenario)
            if path not in robots:
                read_model(path)
                robots[path] = load_toml(path)
            files = [str(scenario), str(path)]
            case = {"files": files, "scenario": base, "robot": robots[path], "varied": varied}
            build_scenario(case)
        except InputError as error:
            raise InputError(f"{sweep.path}: case {number}: {error}") from None
        cases[name] = case | {"name": name}
    return cases


def build_scenario(case: Tables) -> Scenario:
    """Return the scenario of one of checked_cases, with the varied keys set."""
    scenario_file, robot_file = map(Path, case["files"])
    robot = _with_keys(case["robot"], case["varied"], robot_file, of_scenario=False)
    scenario = _with_keys(case["scenario"], case["varied"], scenario_file, of_scenario=True)
    return parse_scenario(scenario, scenario_file, parse_model(robot, robot_file))


def simulate_case(case: Tables) -> Outcome:
    """Simulate one of checked_cases; its log becomes a file, its measures the result."""
    try:
        scenario = build_scenario(case)
        truth = simulate_truth(scenario)
        log = make_log(scenario, truth)
    except InputError as error:
        return Outcome({"error": str(error)})
    content = io.BytesIO()
    log_frame(log).to_parquet(content, index=False)
    files = {_log_name(case["name"]): content.getvalue()}
    return Outcome(measure(scenario, truth) | {"error": ""}, files)


def _log_name(name: str) -> str:
    return f"logs/{name}.parquet"


def _check_folder(out: Path, cases: Mapping[str, Any]) -> None:
    others = {path.stem for path in out.glob("logs/case_*.parquet")} - set(cases)
    if others:
        raise InputError(
            f"{out}: holds {len(others)} logs of a larger sweep ({min(others)} and on); "
            "name another folder, or remove this one"
        )


def _flat(tables: Tables, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Give dotted keys and what they vary over; quoted and nested keys mean the same."""
    for name, item in tables.items():
        nested = isinstance(item, dict) and not set(item) & {*SPREADS, *DRAWS}
        yield from _flat(item, f"{prefix}{name}.") if nested else [(prefix + name, item)]


def _grid(head: Tables, vary: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    for key in ("cases", "seed"):
        if key in head:
            raise InputError(f"{path}: 'sweep.{key}' belongs to kind \"random\"")
    values = [_grid_values(key, item, path) for key, item in vary.items()]
    count = math.prod(map(len, values))
    if count > MAX_CASES:
        raise InputError(f"{path}: at most {MAX_CASES} cases, this grid has {count}")
    return [dict(zip(vary, chosen, strict=True)) for chosen in itertools.product(*values)]


def _grid_values(key: str, item: object, path: Path) -> list[Any]:
    if isinstance(item, list):
        return _listed(key, item, path)
    name, numbers = _one_of(SPREADS, key, item, 3, path)
    low, high, count = numbers
    if not count.is_integer() or not 2 <= count <= MAX_CASES:
        raise InputError(f"{path}: 'vary.{key}': the third number of {name} must be 2 or more")
    if name == "linear":
        return np.linspace(low, high, int(count)).tolist()
    if low <= 0 or high <= 0:
        raise InputError(f"{path}: 'vary.{key}': logarithmic needs limits greater than 0")
    return np.geomspace(low, high, int(count)).tolist()


def _random(head: Tables, vary: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    count = _whole(head.get("cases"), "cases", 1, path)
    if count > MAX_CASES:
        raise InputError(f"{path}: at most {MAX_CASES} cases, not {count}")
    seed = _whole(head.get("seed", 0), "seed", 0, path)
    columns = []
    for key, item in vary.items():
        draw = _draw(key, item, path)
        columns.append(draw(np.random.default_rng([seed, *key.encode()]), count))
    return [dict(zip(vary, chosen, strict=True)) for chosen in zip(*columns, strict=True)]


def _draw(key: str, item: object, path: Path) -> Draw:
    """Return the function that draws values of `key`: (generator, how many) -> list."""
    if isinstance(item, list):
        listed = _listed(key, item, path)
        return lambda rng, count: [listed[i] for i in rng.integers(len(listed), size=count)]
    name, (first, second) = _one_of(DRAWS, key, item, 2, path)
    if name == "normal":
        if second < 0:
            raise InputError(f"{path}: 'vary.{key}': the standard deviation must be 0 or more")
        return lambda rng, count: (first + second * rng.standard_normal(count)).tolist()
    if not first <= second:
        raise InputError(f"{path}: 'vary.{key}': the first number of {name} must be the smaller")
    if name == "uniform":
        return lambda rng, count: rng.uniform(first, second, count).tolist()
    if name == "whole":
        if not first.is_integer() or not second.is_integer():
            raise InputError(f"{path}: 'vary.{key}': whole needs whole numbers")
        low, high = int(first), int(second)
        return lambda rng, count: rng.integers(low, high, count, endpoint=True).tolist()
    if first <= 0:
        raise InputError(f"{path}: 'vary.{key}': log_uniform needs limits greater than 0")
    low, high = math.log(first), math.log(second)
    return lambda rng, count: np.exp(rng.uniform(low, high, count)).tolist()


def _listed(key: str, item: list[Any], path: Path) -> list[Any]:
    if not item:
        raise InputError(f"{path}: 'vary.{key}': the list of values is empty")
    return item


def _one_of(
    known: tuple[str, ...], key: str, item: object, count: int, path: Path
) -> tuple[str, list[float]]:
    if not isinstance(item, dict) or len(item) != 1 or next(iter(item)) not in known:
        raise InputError(
            f"{path}: 'vary.{key}' must be a list of values or one of "
            + ", ".join(f"{{ {name} = [...] }}" for name in known)
        )
    [(name, numbers)] = item.items()
    return name, check_numbers(numbers, count, f"vary.{key}.{name}", path)


def _whole(value: object, key: str, low: int, path: Path) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < low:
        raise InputError(
            f"{path}: 'sweep.{key}' must be a whole number, {low} or more, not {value!r}"
        )
    return value


def _with_keys(
    tables: Tables, varied: Mapping[str, Any], path: Path, *, of_scenario: bool
) -> Tables:
    """Return a copy of the tables of one file with those of the varied keys set that are its own.

    Missing tables are made: the check of the file names what does not belong there.
    """
    tables = copy.deepcopy(tables)
    for key, value in varied.items():
        words = key.split(".")
        if (words[0] in SCENARIO_TABLES) == of_scenario:
            if words[0] == "effects":
                words = _effect_words(tables, words, path)
            _set(tables, words, value, f"{path}: '{key}'")
    return tables


def _effect_words(tables: Tables, words: list[str], path: Path) -> list[str]:
    """Return the way to the parameter of an effect, which is added if the model lacks it."""
    marked = len(words) == 4 and words[2] in WHEEL_MARKS
    if len(words) != 3 and not marked:
        raise InputError(
            f"{path}: '{'.'.join(words)}' must be effects.NAME.PARAMETER or "
            "effects.NAME.wheel_1.PARAMETER"
        )
    wheel = {"wheel": WHEEL_MARKS[words[2]]} if marked else {}
    same = tables.setdefault("effects", {}).setdefault(words[1], [])
    for number, table in enumerate(same, start=1):
        if table.get("wheel") == wheel.get("wheel"):
            return ["effects", words[1], str(number), words[-1]]
    same.append(wheel)
    return ["effects", words[1], str(len(same)), words[-1]]


def _set(
    place: object, words: list[str], value: object, where: str, names: tuple[str, ...] = ()
) -> None:
    """Set what the words lead to; `names`: of the elements, if `place` is a list of named ones."""
    word, *rest = words
    slot: str | int = word
    if isinstance(place, list):
        known = names or tuple(str(number) for number in range(1, len(place) + 1))
        if word not in known:
            raise InputError(f"{where}: '{word}' must be one of {', '.join(known) or 'none'}")
        slot = known.index(word)
    elif not isinstance(place, dict):
        raise InputError(f"{where}: nothing can be below {place!r}")
    elif rest:
        place.setdefault(word, {})
    if rest:
        _set(place[slot], rest, value, where, ELEMENT_NAMES.get(word, ()))
    else:
        place[slot] = value
