"""Parameter sets by name, and plain simulation through the replay engine of omnislip._core."""

import numpy as np
from omnislip import _core

ROBOT_OUTPUTS = 8  # four shaft angles [rad], turn rate [rad/s], x, y [m], heading [rad]


def motors(kind: str) -> int:
    return {"robot": 4, "axis": 1, "odometry": 8}[kind]


def parameter_set(kind="robot", base=None, effects=()) -> np.ndarray:
    """One parameter set.

    base: {name: value}; effects: (effect, parameter, value) or (effect, parameter, value, wheel)
    with wheel 1..4, without it all wheels.
    """
    names = [p["name"] for p in _core.base_parameters(kind)]
    values = [p["default"] for p in _core.base_parameters(kind)]
    for name, value in (base or {}).items():
        values[names.index(name)] = value
    place = {}
    for effect in _core.effects():
        columns = motors(kind) if effect["per_wheel"] else 1
        for parameter in effect["parameters"]:
            place[effect["name"], parameter["name"]] = slice(len(values), len(values) + columns)
            values += [parameter["neutral"]] * columns
    flat = np.array(values)
    for effect, parameter, value, *wheel in effects:
        where = place[effect, parameter]
        flat[where.start + wheel[0] - 1 if wheel else where] = value
    return flat


def simulate(
    sets, time, command, initial=None, kind="robot", step_s=1e-3, lanes=8, rise=None
) -> np.ndarray:
    """Outputs (sets, rows, outputs) of a replay that nothing restarts and no gain corrects.

    sets: (sets, parameters); time: (rows,) s; command: (rows, motors), held to the next row or,
    with `rise` (rows, motors), rising evenly by that around its mean. The recording "shows" zero
    everywhere, so the engine's errors are the negative of the outputs.
    """
    engine = _core.Engine(kind, lanes)
    silent = np.zeros((len(time), engine.outputs))
    start = np.zeros(engine.states) if initial is None else np.asarray(initial, float)
    recording = engine.recording(time, np.ascontiguousarray(command, float), silent, start)
    if rise is not None:
        recording = recording.rising(np.ascontiguousarray(rise, float))
    certain = np.zeros(engine.states)
    tracks = engine.track([recording], sets[0], certain, np.ones(engine.outputs), certain)
    return -engine.replays([recording], tracks, np.asarray(sets), step_s, 1e9)[0]
