"""Logs as MCAP files, for PlotJuggler and Foxglove (https://mcap.dev; messages and schemas JSON).

The last word of a column is a field, the words before it are the topic: wheel/1/duty becomes the
field `duty` of topic /wheel/1, which PlotJuggler shows as /wheel/1/duty. A message holds what was
sampled in its row; a row without any makes none. Where a topic has x_m, y_m and theta_rad, its pose
follows once more in the two schemas that Foxglove's 3D panel draws: foxglove.PoseInFrame on
TOPIC/in_frame and, on /tf, foxglove.FrameTransform from `world` to `robot` (column group pose),
`truth` (truth/pose) and so on. Times are t_s; those of a log that begins before 0 count from there.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.writer import Writer

from omnislip.errors import InputError
from omnislip.files import replace_file
from omnislip.log_file import COUNTS_PATTERN, Log
from omnislip.scenario import CONTROL_RATE_HZ

Array = npt.NDArray[np.float64]
Message = tuple[str, dict[str, object]]

POSE_FIELDS = ("x_m", "y_m", "theta_rad")
TRANSFORMS = "/tf"
MAX_TIME_S = 2.0**32  # of the seconds in Foxglove's timestamps


def _object(**properties: object) -> dict[str, object]:
    return {"type": "object", "properties": properties}


NUMBER, TEXT = {"type": "number"}, {"type": "string"}
TIME = _object(sec={"type": "integer"}, nsec={"type": "integer"})
PLACE = _object(x=NUMBER, y=NUMBER, z=NUMBER)
TURN = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
FOXGLOVE_SCHEMAS = {
    "foxglove.PoseInFrame": _object(
        timestamp=TIME, frame_id=TEXT, pose=_object(position=PLACE, orientation=TURN)
    ),
    "foxglove.FrameTransform": _object(
        timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=PLACE, rotation=TURN
    ),
}


def with_truth(log: Log, truth: dict[str, Array]) -> Log:
    """Return the log of a simulated run with what no sensor sees, sampled in the rows of the log.

    truth/pose, odometry/pose (what the firmware believes), truth/velocity (body frame) and, of each
    wheel, truth/wheel/1..4 with shaft speed, slip speed and drive force.
    """
    tick = np.round(log.t_s * CONTROL_RATE_HZ).astype(int)
    groups = {
        "truth/pose": (POSE_FIELDS, truth["pose"]),
        "odometry/pose": (POSE_FIELDS, truth["odometry"]),
        "truth/velocity": (("x_m_s", "y_m_s", "omega_rad_s"), truth["velocity"]),
    }
    names = ("wheel_speed_rad_s", "slip_m_s", "drive_force_n")
    for wheel in range(4):
        values = np.stack([truth[name][:, wheel] for name in names], axis=1)
        groups[f"truth/wheel/{wheel + 1}"] = (names, values)
    columns = {
        f"{group}/{field}": values[tick, index]
        for group, (fields, values) in groups.items()
        for index, field in enumerate(fields)
    }
    return replace(log, columns=log.columns | columns)


def write_mcap(
    log: Log,
    path: Path,
    progress: Callable[[list[int]], Iterable[int]] = lambda rows: rows,
) -> None:
    """Write `log` to an .mcap file, whole or not at all; `progress` wraps the rows it goes through.

    InputError if a time of the log does not fit into the file.
    """
    from_s = min(log.t_s[0], 0.0)
    if log.t_s[-1] - from_s >= MAX_TIME_S:
        raise InputError(f"{path}: MCAP holds times below {MAX_TIME_S:.0f} s, not {log.t_s[-1]:g}")
    times_ns = [round((t - from_s) * 1e9) for t in log.t_s.tolist()]
    groups = _groups(log)
    with replace_file(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library=f"omnislip {version('omnislip')}")
        channels = _register(writer, groups)
        for row in progress(list(range(len(times_ns)))):
            for topic, message in _messages(groups, row, times_ns[row]):
                text = json.dumps(message, separators=(",", ":"))
                writer.add_message(channels[topic], times_ns[row], text.encode(), times_ns[row])
        writer.finish()


def _groups(log: Log) -> dict[str, dict[str, list[float]]]:
    """Return the columns as group -> field -> values; counts are whole numbers."""
    groups: dict[str, dict[str, list[float]]] = {}
    for column, values in log.columns.items():
        group, _, field = column.rpartition("/")
        whole = COUNTS_PATTERN.fullmatch(column) is not None
        groups.setdefault(group, {})[field] = (values.astype(int) if whole else values).tolist()
    return groups


def _register(writer: Writer, groups: dict[str, dict[str, list[float]]]) -> dict[str, int]:
    """Write the schemas and channels; return the channel of each topic."""

    def schema(name: str, content: dict[str, object]) -> int:
        return writer.register_schema(name, "jsonschema", json.dumps(content).encode())

    topics = {}
    for group, fields in groups.items():
        numbers = _object(**dict.fromkeys(fields, NUMBER))
        topics[f"/{group}"] = schema(f"omnislip.{group.replace('/', '.')}", numbers)
    posed = [group for group, fields in groups.items() if set(POSE_FIELDS) <= set(fields)]
    if posed:
        drawn = {name: schema(name, content) for name, content in FOXGLOVE_SCHEMAS.items()}
        topics |= {f"/{group}/in_frame": drawn["foxglove.PoseInFrame"] for group in posed}
        topics[TRANSFORMS] = drawn["foxglove.FrameTransform"]
    return {topic: writer.register_channel(topic, "json", id_) for topic, id_ in topics.items()}


def _messages(
    groups: dict[str, dict[str, list[float]]], row: int, time_ns: int
) -> Iterator[Message]:
    """Give topic and content of every message of one row."""
    for group, fields in groups.items():
        sampled = {
            name: column[row] for name, column in fields.items() if column[row] == column[row]
        }
        if sampled:
            yield f"/{group}", sampled
        if set(POSE_FIELDS) <= set(sampled):
            yield from _pose_messages(group, *(sampled[name] for name in POSE_FIELDS), time_ns)


def _pose_messages(
    group: str, x_m: float, y_m: float, theta_rad: float, time_ns: int
) -> Iterator[Message]:
    timestamp = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
    place = {"x": x_m, "y": y_m, "z": 0.0}
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(theta_rad / 2), "w": math.cos(theta_rad / 2)}
    yield (
        f"/{group}/in_frame",
        {
            "timestamp": timestamp,
            "frame_id": "world",
            "pose": {"position": place, "orientation": turn},
        },
    )
    yield (
        TRANSFORMS,
        {
            "timestamp": timestamp,
            "parent_frame_id": "world",
            "child_frame_id": group.removesuffix("pose").strip("/") or "robot",
            "translation": place,
            "rotation": turn,
        },
    )
