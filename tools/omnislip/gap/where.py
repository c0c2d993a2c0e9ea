"""Where the gap sits: in which equation, at which wheel, in which state, at what time.

The filter of the refitted model corrects its state at every row. A correction of a shaft speed is a
torque that the model lacks, one of the body velocity a force, one of the yaw rate a moment; divided
by what noise alone would make of it (its standard deviation in the filter) it says where and when
the model fails. A robot's disturbances that last (sim/replay.h) are states of that filter; their
corrections belong to the equation that they push. What the effects explain is the fall of these
squared corrections from the refitted model to the one with the effects: its share per equation is
the pattern, its concentration over a state is the condition, its windows are the times.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.machine import POSE_X, Machine
from omnislip.gap.noise import Noise, corrections, track_all
from omnislip.gap.recordings import ODOMETRY_CHANNELS, Run

Array = npt.NDArray[np.float64]

ROBOT_EQUATIONS = {
    **{f"wheel/{wheel}/torque": (wheel - 1, wheel - 8) for wheel in range(1, 5)},
    "body/force_x": (8, -3),
    "body/force_y": (9, -2),
    "body/moment": (10, -1),
    "pose/position": (11, 12),
    "pose/heading": (13,),
}
"""States of the filter that tell of an equation: of the plant, and from the end the disturbances,
before which memory may stand."""
AXIS_EQUATIONS = {"axis/force": (0,)}  # one sensor: force and position are corrected alike
ODOMETRY_EQUATIONS = {"pose/position": (0, 1), "pose/heading": (2,)}
EQUATIONS = {"robot": ROBOT_EQUATIONS, "axis": AXIS_EQUATIONS, "odometry": ODOMETRY_EQUATIONS}
WINDOW_S = 0.25
LEAST_SHARE = 0.05
MOST_ROWS = 4


@dataclass(frozen=True)
class Place:
    """One equation that holds a share of the gap, when, and under which condition."""

    channel: str
    condition: str
    share: float
    windows_s: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class Map:
    """Excess of squared corrections over chance: `excess` per run (rows, equations)."""

    equations: tuple[str, ...]
    t_s: tuple[Array, ...]
    excess: tuple[Array, ...]
    shares: Array
    states: tuple[Array, ...]
    """Filtered states (rows, n) of each run."""


def map_gap(
    machine: Machine, runs: Sequence[Run], noise: Noise, refit: Array, after: Array | None
) -> Map:
    """Return where the refitted model is corrected more than the one with effects (or chance)."""
    equations = EQUATIONS[machine.kind]
    tracks = track_all(machine, runs, refit, noise)
    before = _corrections(runs, tracks, equations)
    if after is None:
        excess = [b - np.sum(b > 0, axis=0, keepdims=True) / len(b) for b in before]
    else:
        later = _corrections(runs, track_all(machine, runs, after, noise), equations)
        excess = [b - a for b, a in zip(before, later, strict=True)]
    total = np.maximum(sum(e.sum(axis=0) for e in excess), 0.0)
    shares = total / max(total.sum(), 1e-12)
    states = [t.state.reshape(len(run.t_s), -1) for run, t in zip(runs, tracks, strict=True)]
    times = tuple(run.t_s for run in runs)
    return Map(tuple(equations), times, tuple(excess), shares, tuple(states))


def describe(runs: Sequence[Run], gap_map: Map) -> list[Place]:
    """Put the map into words: equations with their share, condition and worst windows."""
    states = [_coordinates(*each) for each in zip(runs, gap_map.states, strict=True)]
    places = []
    for index in np.argsort(-gap_map.shares)[:MOST_ROWS]:
        share = float(gap_map.shares[index])
        if share < LEAST_SHARE:
            break
        columns = [e[:, index] for e in gap_map.excess]
        channel = gap_map.equations[index]
        condition = _condition(columns, states, channel)
        places.append(Place(channel, condition, share, _worst_windows(runs, columns)))
    return places


def _corrections(
    runs: Sequence[Run], tracks: Sequence[_core.Track], equations: dict
) -> list[Array]:
    """Squared corrections over their expected variance (rows, equations) of each run."""
    result = []
    for run, track in zip(runs, tracks, strict=True):
        change = corrections(track)
        expected = track.correction_variance.reshape(change.shape)
        ratio = np.divide(change**2, expected, out=np.zeros_like(change), where=expected > 0)
        ratio[run.t_s < run.t_s[0] + WINDOW_S] = 0.0
        result.append(np.stack([ratio[:, own].mean(axis=1) for own in equations.values()], axis=1))
    return result


def _coordinates(run: Run, state: Array) -> dict[str, Array]:
    """Quantities a condition may name, one value per row; 'i|...' belong to wheel i or the body."""
    if run.channels == ODOMETRY_CHANNELS:
        return _motion(run)
    motors = run.command.shape[1]
    angles = _everywhere(run, run.outputs[:, :motors])
    speed = np.gradient(angles, run.t_s, axis=0)
    speed = _smooth(speed)
    acceleration = np.gradient(speed, run.t_s, axis=0)
    found: dict[str, Array] = {"time": run.time_s}
    for i in range(motors):
        own = f"{i + 1}|"
        found[own + "speed"] = np.abs(speed[:, i])
        found[own + "signed speed"] = speed[:, i]
        found[own + "command"] = np.abs(run.command[:, i])
        found[own + "driving"] = run.command[:, i] * np.sign(speed[:, i])
        found[own + "acceleration"] = np.abs(acceleration[:, i])
    if motors > 1:
        found |= {f"body|{name}": values for name, values in _body_motion(run, state).items()}
    found["total command"] = np.sum(np.abs(run.command), axis=1)
    return found


def _body_motion(run: Run, state: Array) -> dict[str, Array]:
    """Filtered motion of a robot's body; its place only where a camera saw it, else NaN."""
    seen = np.nan if np.isnan(run.outputs[:, POSE_X]).all() else 1.0
    return {
        "speed along x": np.abs(state[:, 8]),
        "speed along y": np.abs(state[:, 9]),
        "turning": np.abs(state[:, 10]),
        "place x": seen * state[:, 11],
        "place y": seen * state[:, 12],
    }


def _everywhere(run: Run, outputs: Array) -> Array:
    """Outputs (rows, channels) also where they were not sampled, straight between samples."""
    seen = [(run.t_s[~np.isnan(values)], values[~np.isnan(values)]) for values in outputs.T]
    return np.stack([np.interp(run.t_s, *samples) for samples in seen], axis=1)


def _motion(run: Run) -> dict[str, Array]:
    """The same of an odometry, from its measured pose."""
    pose = _everywhere(run, run.outputs)
    rate = _smooth(np.gradient(pose, run.t_s, axis=0))
    along = (rate[:, 0] + 1j * rate[:, 1]) * np.exp(-1j * pose[:, 2])
    return {
        "time": run.time_s,
        "speed along": np.abs(along.real),
        "speed across": np.abs(along.imag),
        "turning": np.abs(rate[:, 2]),
        "change of speed": np.abs(np.gradient(np.abs(along), run.t_s)),
    }


def _smooth(values: Array) -> Array:
    kernel = np.ones(5) / 5
    return np.stack([np.convolve(column, kernel, mode="same") for column in values.T], axis=1)


PHRASES = {
    "time": ("early in the run", "late in the run"),
    "speed": ("at low speed", "at high speed"),
    "signed speed": ("turning backwards", "turning forwards"),
    "command": ("at small command", "at large command"),
    "driving": ("while braking", "while driving"),
    "acceleration": ("at steady speed", "while accelerating"),
    "speed along": ("moving little along itself", "moving fast along itself"),
    "speed across": ("moving little sideways", "moving fast sideways"),
    "speed along x": ("while the body moves little along x", "while the body moves fast along x"),
    "speed along y": ("while the body moves little along y", "while the body moves fast along y"),
    "turning": ("turning little", "turning fast"),
    "place x": ("where x is small", "where x is large"),
    "place y": ("where y is small", "where y is large"),
    "change of speed": ("at steady speed", "while starting or stopping"),
    "total command": ("while the motors draw little", "while all motors draw much"),
}


def _condition(columns: list[Array], states: list[dict[str, Array]], channel: str) -> str:
    """Return the third of a coordinate that holds most of the excess, as a sentence."""
    kind, name, *_ = channel.split("/")
    own = {"wheel": name, "axis": "1"}.get(kind, "body")
    excess = np.concatenate(columns)
    total = excess.sum()
    if total <= 0:
        return "everywhere"
    best, sentence = 0.0, "everywhere"
    for name in states[0]:
        owner, _, short = name.rpartition("|")
        if owner and owner != own:
            continue
        values = np.concatenate([s[name] for s in states])
        for side, phrase in enumerate(PHRASES[short]):
            edge = np.percentile(values, 33 if side == 0 else 67)
            inside = values <= edge if side == 0 else values >= edge
            share, time = excess[inside].sum() / total, inside.mean()
            if share - time > best and share > 0.5:
                best = share - time
                held = f"{100 * min(share, 1.0):.0f} % of it in {100 * time:.0f} % of the time"
                sentence = f"{phrase} ({held})"
    return sentence


def _worst_windows(
    runs: Sequence[Run], columns: list[Array]
) -> tuple[tuple[str, float, float], ...]:
    """The three quarter-second windows with most excess."""
    found = []
    for run, excess in zip(runs, columns, strict=True):
        number = ((run.t_s - run.t_s[0]) / WINDOW_S).astype(int)
        sums = np.bincount(number, excess)
        for window in np.argsort(-sums)[:3]:
            begin = float(run.t_s[0] + window * WINDOW_S)
            found.append((float(sums[window]), (run.name, begin, begin + WINDOW_S)))
    found.sort(reverse=True)
    return tuple(place for _, place in found[:3])
