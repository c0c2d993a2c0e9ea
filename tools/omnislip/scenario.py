"""The scenario file: what a simulated robot is told to do, what hits it, and what is logged.

[scenario]  name, duration_s, robot (model file, relative to the scenario; default: the nominal
            robot), controller ("slip" or "plain": with or without slip compensation), seed
[log]       rate_hz (default 200), pose_rate_hz (default 50)
[sensors]   default 0 unless said otherwise; noise is the standard deviation of each sample
            gyro_noise_rad_s, gyro_bias_rad_s
            pose_noise_m, pose_noise_rad, pose_delay_s, pose_dropout_fraction (camera)
            current_noise_a, current_resolution_a (log only; resolution 0: not rounded)
            and, seen by the firmware too:
            supply_noise_v, supply_resolution_v (default 0.001)
            encoder_start_counts = [c1, c2, c3, c4], 0 to 65535: the counters at t = 0; the
            fraction is the phase, the share of a count already turned
[[command]] t_s and one of: velocity = [vx_m_s, vy_m_s, omega_rad_s] (body frame),
            pose = [x_m, y_m, theta_rad] with optional arrival_velocity (world frame),
            duty = [d1, d2, d3, d4], stop = true. Holds until the next command.
[[impact]]  t_s or x_m (first time the robot passes it), and any of impulse_x_n_s,
            impulse_y_n_s, impulse_theta_n_m_s (world frame)

All effects of the model file act, an impact only where its `run` is the name of the scenario;
mistakes of wiring do not: a simulated robot is wired right.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omnislip.errors import InputError
from omnislip.files import check_known, check_number, check_numbers, check_table, load_toml
from omnislip.model_file import NOMINAL_ROBOT, Model, read_model

CONTROL_RATE_HZ = 1000
CONTROLLERS = ("slip", "plain")
MAX_DURATION_S = 600.0
IMPULSES = ("impulse_x_n_s", "impulse_y_n_s", "impulse_theta_n_m_s")


# Smallest and largest value of each key of [sensors]; 0 to 100 where nothing else is said.
SENSOR_RANGES = {
    "gyro_bias_rad_s": (-100.0, 100.0),
    "pose_delay_s": (0.0, 1.0),
    "pose_dropout_fraction": (0.0, 1.0),
    "supply_resolution_v": (0.001, 10.0),
}
MAX_START_COUNTS = 65535.0


@dataclass(frozen=True)
class Sensors:
    """Errors of the simulated sensors; what each means stands at the head of this file."""

    gyro_noise_rad_s: float = 0.0
    gyro_bias_rad_s: float = 0.0
    pose_noise_m: float = 0.0
    pose_noise_rad: float = 0.0
    pose_delay_s: float = 0.0
    pose_dropout_fraction: float = 0.0
    supply_noise_v: float = 0.0
    supply_resolution_v: float = 0.001
    current_noise_a: float = 0.0
    current_resolution_a: float = 0.0
    encoder_start_counts: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Scenario:
    """A scenario; commands and impulses are the dictionaries omnislip._core.simulate takes."""

    name: str
    duration_s: float
    model: Model
    commands: list[dict[str, Any]]
    impulses: list[dict[str, float]] = field(default_factory=list)
    slip_compensation: bool = True
    seed: int = 0
    rate_hz: int = 200
    pose_rate_hz: int = 50
    sensors: Sensors = Sensors()


def read_scenario(path: Path | str) -> Scenario:
    """Read and check a scenario file. InputError names the file, the key and what is right."""
    path = Path(path)
    data = load_toml(path)
    return parse_scenario(data, path, read_model(robot_path(data, path)))


def robot_path(data: dict[str, Any], path: Path) -> Path:
    """Return the model file that the parsed scenario file `data` names."""
    head = check_table(data.get("scenario", {}), "scenario", path)
    if "robot" not in head:
        return NOMINAL_ROBOT
    return path.parent / _text(head["robot"], "scenario.robot", path)


def parse_scenario(data: dict[str, Any], path: Path, model: Model) -> Scenario:
    """Return the scenario of the parsed file `data`, driven by the robot `model`."""
    if model.kind != "robot":
        raise InputError(f"{model.path}: a scenario needs a model of kind 'robot'")
    check_known(data, ["scenario", "log", "sensors", "command", "impact"], "table", path)
    head = check_table(data.get("scenario", {}), "scenario", path)
    check_known(
        head, ["name", "duration_s", "robot", "controller", "seed"], "key in [scenario]", path
    )
    duration_s = _in_range(
        head.get("duration_s"), "scenario.duration_s", 0.01, MAX_DURATION_S, path
    )
    rate_hz, pose_rate_hz = _read_rates(check_table(data.get("log", {}), "log", path), path)
    return Scenario(
        name=_text(head.get("name", path.stem), "scenario.name", path),
        duration_s=duration_s,
        model=model,
        commands=_read_list(data, "command", _read_command, path),
        impulses=_read_list(data, "impact", _read_impact, path),
        slip_compensation=_read_controller(head.get("controller", "slip"), path) == "slip",
        seed=_whole(head.get("seed", 0), "scenario.seed", path),
        rate_hz=rate_hz,
        pose_rate_hz=pose_rate_hz,
        sensors=_read_sensors(check_table(data.get("sensors", {}), "sensors", path), path),
    )


def format_scenario(scenario: Scenario, robot: str, comment: str) -> str:
    """Return the text of a scenario file; `robot` is the model file, relative to the scenario."""
    head = {
        "name": scenario.name,
        "duration_s": scenario.duration_s,
        "robot": robot,
        "controller": "slip" if scenario.slip_compensation else "plain",
        "seed": scenario.seed,
    }
    lines = [f"# {comment}", "[scenario]", *_lines(head), "", "[log]"]
    lines += _lines({"rate_hz": scenario.rate_hz, "pose_rate_hz": scenario.pose_rate_hz})
    lines += ["", "[sensors]", *_lines(asdict(scenario.sensors))]
    for command in scenario.commands:
        value, rest = command["value"], {}
        if command["kind"] == "pose":
            value, rest = value[:3], {"arrival_velocity": value[3:]}
        given = {command["kind"]: value if command["kind"] != "stop" else True}
        lines += ["", "[[command]]", *_lines({"t_s": command["t_s"]} | given | rest)]
    for impact in scenario.impulses:
        lines += ["", "[[impact]]", *_lines(impact)]
    return "\n".join(lines) + "\n"


def _lines(table: dict[str, Any]) -> list[str]:
    # JSON of these values is TOML.
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]


def _text(value: object, where: str, path: Path) -> str:
    if not isinstance(value, str):
        raise InputError(f"{path}: '{where}' must be a text, not {value!r}")
    return value


def _whole(value: object, where: str, path: Path) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{path}: '{where}' must be a whole number, 0 or more, not {value!r}")
    return value


def _in_range(value: object, where: str, low: float, high: float, path: Path) -> float:
    if value is None:
        raise InputError(f"{path}: missing key: {where}")
    number = check_number(value, where, path)
    if not low <= number <= high:
        raise InputError(f"{path}: '{where}' must be {low:g} to {high:g}, not {number:g}")
    return number


def _read_controller(value: object, path: Path) -> str:
    if value not in CONTROLLERS:
        raise InputError(
            f"{path}: 'scenario.controller' must be one of {', '.join(CONTROLLERS)}, not {value!r}"
        )
    return str(value)


def _read_rates(table: dict[str, Any], path: Path) -> tuple[int, int]:
    check_known(table, ["rate_hz", "pose_rate_hz"], "key in [log]", path)
    rate_hz = _whole(table.get("rate_hz", 200), "log.rate_hz", path)
    if rate_hz == 0 or CONTROL_RATE_HZ % rate_hz:
        raise InputError(f"{path}: 'log.rate_hz' must divide {CONTROL_RATE_HZ}, {rate_hz} does not")
    pose_rate_hz = _whole(table.get("pose_rate_hz", 50), "log.pose_rate_hz", path)
    if pose_rate_hz == 0 or rate_hz % pose_rate_hz:
        raise InputError(
            f"{path}: 'log.pose_rate_hz' must divide log.rate_hz = {rate_hz}, "
            f"{pose_rate_hz} does not"
        )
    return rate_hz, pose_rate_hz


def _read_sensors(table: dict[str, Any], path: Path) -> Sensors:
    check_known(table, Sensors.__dataclass_fields__, "key in [sensors]", path)
    values: dict[str, Any] = {}
    for key, item in table.items():
        where = f"sensors.{key}"
        if key == "encoder_start_counts":
            counts = check_numbers(item, 4, where, path)
            values[key] = tuple(_in_range(c, where, 0.0, MAX_START_COUNTS, path) for c in counts)
        else:
            values[key] = _in_range(item, where, *SENSOR_RANGES.get(key, (0.0, 100.0)), path)
    return Sensors(**values)


def _read_list(
    data: dict[str, Any],
    name: str,
    read_one: Callable[[dict[str, Any], str, Path], dict[str, Any]],
    path: Path,
) -> list[dict[str, Any]]:
    tables = data.get(name, [])
    if not isinstance(tables, list):
        raise InputError(f"{path}: '{name}' must be written [[{name}]]")
    where = [f"{name} {number}" for number in range(1, len(tables) + 1)]
    items = [
        read_one(check_table(table, place, path), place, path)
        for table, place in zip(tables, where, strict=True)
    ]
    times = [item["t_s"] for item in items if "t_s" in item]
    if times != sorted(times):
        raise InputError(f"{path}: the [[{name}]] tables must be in the order of their t_s")
    return items


def _read_time(table: dict[str, Any], where: str, path: Path) -> float:
    return _in_range(table.get("t_s"), f"{where}: t_s", 0.0, MAX_DURATION_S, path)


def _read_command(table: dict[str, Any], where: str, path: Path) -> dict[str, Any]:
    kinds = ["velocity", "pose", "duty", "stop"]
    check_known(table, ["t_s", "arrival_velocity", *kinds], f"key in [[{where}]]", path)
    given = [kind for kind in kinds if kind in table]
    if len(given) != 1:
        raise InputError(f"{path}: [[{where}]] needs exactly one of {', '.join(kinds)}")
    kind = given[0]
    if "arrival_velocity" in table and kind != "pose":
        raise InputError(f"{path}: [[{where}]] 'arrival_velocity' belongs to a pose command")
    value = _read_command_value(kind, table, where, path)
    return {"t_s": _read_time(table, where, path), "kind": kind, "value": value}


def _read_command_value(kind: str, table: dict[str, Any], where: str, path: Path) -> list[float]:
    if kind == "stop":
        if table["stop"] is not True:
            raise InputError(f"{path}: [[{where}]] 'stop' can only be true")
        return []
    value = check_numbers(table[kind], 4 if kind == "duty" else 3, f"{where}: {kind}", path)
    if kind == "duty" and max(map(abs, value)) > 1:
        raise InputError(f"{path}: '{where}: duty' must be in -1 to 1, not {value}")
    if kind == "pose":
        arrival = table.get("arrival_velocity", [0.0, 0.0, 0.0])
        value += check_numbers(arrival, 3, f"{where}: arrival_velocity", path)
    return value


def _read_impact(table: dict[str, Any], where: str, path: Path) -> dict[str, float]:
    check_known(table, ["t_s", "x_m", *IMPULSES], f"key in [[{where}]]", path)
    if ("t_s" in table) == ("x_m" in table):
        raise InputError(f"{path}: [[{where}]] needs exactly one of t_s, x_m")
    if not any(key in table for key in IMPULSES):
        raise InputError(f"{path}: [[{where}]] needs at least one of {', '.join(IMPULSES)}")
    impact = {key: check_number(item, f"{where}: {key}", path) for key, item in table.items()}
    if "t_s" in impact:
        _read_time(table, where, path)
    return dict.fromkeys(IMPULSES, 0.0) | impact
