"""Other methods on the same runs, judged by the same replays: what naming effects is worth.

plain refit     the believed keys fitted without regard to their tolerances, no effect added
sparse terms    SINDy on the discrepancy: acceleration derived from the filtered position, minus
                what the refitted model gives, is regressed on a library of terms with PySINDy's
                sequentially thresholded least squares (Brunton, Proctor, Kutz, PNAS 2016;
                Kaheman et al., IFAC 2019); the threshold is the one of a grid that leaves the
                smallest replay error on the runs that check the choice. Single axes only.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, filtfilt

from omnislip.errors import InputError
from omnislip.gap.findings import Findings
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import WINDOW_S, channel_rmse, replay_all
from omnislip.gap.noise import track_all
from omnislip.gap.recordings import Run
from omnislip.gap.settle import believed_hypothesis, settle

Array = npt.NDArray[np.float64]

FREE = 0.45
"""Tolerance with which a key may move by 90 %."""
CUT_SHARE = 0.1
"""Cut of the low pass before deriving, of half the sampling rate."""
THRESHOLDS = np.logspace(-3, 0, 13)
STEP_S = 1e-3


@dataclass(frozen=True)
class Peer:
    """A method's name, what it found in words, and its RMSE per channel on the held-out runs."""

    name: str
    found: str
    rmse: dict[str, float]


def plain_refit(findings: Findings) -> tuple[Peer, Array]:
    """Fit the believed keys, each free by 90 %; returns also the parameter set."""
    split, given = findings.split, findings.machine
    machine = given.of(replace(given.model, tolerance={"default": FREE}))
    noise = findings.outcome.data.noise
    _, fitted = settle(machine, split.fitting, believed_hypothesis(machine), noise)
    values = fitted.hypothesis.flat(machine.believed)
    rmse = channel_rmse(replay_all(machine, split.held_out, noise, [values]))
    moved = [
        f"{p.label} {float(x / machine.believed[p.places[0]]):.2f}"
        for p, x in zip(fitted.hypothesis.base, fitted.hypothesis.x, strict=True)
    ]
    found = "factors on the believed values: " + ", ".join(moved)
    return Peer("plain refit of all keys", found, {c: float(v[0]) for c, v in rmse.items()}), values


def sparse_terms(findings: Findings) -> Peer:
    """Regress the discrepancy of the refitted axis on a library of terms."""
    try:
        from pysindy import STLSQ
    except ImportError:
        raise InputError("pysindy is not installed: .venv/bin/pip install pysindy") from None
    split, machine = findings.split, findings.machine
    believed = machine.believed
    refit = findings.outcome.ladder[0].hypothesis.flat(believed)
    checking = [run for run in split.fitting if run.unit == split.fitting[-1].unit]
    library = [_library(machine, run) for run in split.fitting if run.unit != checking[0].unit]
    terms = np.concatenate([part[0] for part in library])
    target = np.concatenate([part[1] - _known(machine, refit, part[2]) for part in library])
    scale = np.maximum(np.std(terms, axis=0), 1e-12)
    scale[0] = 1.0
    best, best_error = None, np.inf
    for threshold in THRESHOLDS * np.std(target):
        optimizer = STLSQ(threshold=threshold, alpha=1e-6)
        weights = np.ravel(optimizer.fit(terms / scale, target[:, None]).coef_) / scale
        error = _replay_rmse(findings, checking, refit, weights)
        if error < best_error:
            best, best_error = weights, error
    kept = [name for name, weight in zip(TERMS, best, strict=True) if weight != 0]
    rmse = {split.held_out[0].channels[0]: _replay_rmse(findings, split.held_out, refit, best)}
    return Peer("PySINDy on the discrepancy", "acceleration terms: " + ", ".join(kept), rmse)


TERMS: dict[str, Callable[[Array, Array, Array, float], Array]] = {
    "1": lambda v, q, u, slow: np.ones_like(v),
    "v": lambda v, q, u, slow: v,
    "v |v|": lambda v, q, u, slow: v * np.abs(v),
    "v^3": lambda v, q, u, slow: v**3,
    "|v|": lambda v, q, u, slow: np.abs(v),
    "sign v": lambda v, q, u, slow: np.tanh(v / slow),
    "u": lambda v, q, u, slow: u,
    "u^3": lambda v, q, u, slow: u**3,
    "|u| sign v": lambda v, q, u, slow: np.abs(u) * np.tanh(v / slow),
    "sin q": lambda v, q, u, slow: np.sin(q),
    "cos q": lambda v, q, u, slow: np.cos(q),
}


def _terms(machine: Machine, v: Array, q: Array, u: Array) -> Array:
    slow = 1e-3 if machine.linear else 0.05  # as in the plant
    driven = np.nan_to_num(u)
    return np.stack([term(v, q, driven, slow) for term in TERMS.values()], axis=-1)


def _library(machine: Machine, run: Run) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Terms (rows, terms), derived acceleration (rows,), and (speed, position, command)."""
    step_s = run.row_s
    grid = np.arange(run.t_s[0], run.t_s[-1], step_s)
    row = np.searchsorted(run.t_s, grid, side="right") - 1
    position = filtfilt(*butter(4, CUT_SHARE), np.interp(grid, run.t_s, run.outputs[:, 0]))
    speed = np.gradient(position, step_s)
    inner = slice(20, -20)  # a filter knows one side only at the ends
    v, q, u = speed[inner], position[inner], _command(run)[row][inner]
    return _terms(machine, v, q, u), np.gradient(speed, step_s)[inner], (v, q, u)


def _command(run: Run) -> Array:
    """The command (rows,), NaN where the drive is off, as the plant takes it."""
    return np.where(run.off, np.nan, run.command[:, 0])


def _known(machine: Machine, values: Array, motion: tuple[Array, Array, Array]) -> Array:
    v, q, u = motion
    states = np.ascontiguousarray(np.stack([v, q], axis=1))
    return machine.engine.derivatives(values, states, np.ascontiguousarray(u[:, None]))[:, 0]


def _replay_rmse(findings: Findings, runs: Sequence[Run], values: Array, weights: Array) -> float:
    """RMSE of replays of WINDOW_S of the model plus the terms, from the final model's states."""
    machine, noise = findings.machine, findings.outcome.data.noise
    final = findings.outcome.final.hypothesis.flat(machine.believed)
    squares, count = 0.0, 0
    for run, track in zip(runs, track_all(machine, runs, final, noise), strict=True):
        states = track.state.reshape(len(run.t_s), 2)
        starts = np.arange(run.settled_s, run.t_s[-1] - 0.1, WINDOW_S)
        rows = np.searchsorted(run.t_s, starts)
        x, t_s = states[rows].copy(), run.t_s[rows].copy()
        command, path = _command(run), []
        for _ in range(round(WINDOW_S / STEP_S)):
            row = np.minimum(np.searchsorted(run.t_s, t_s, side="right") - 1, len(run.t_s) - 1)
            u = command[row]
            first = _rate(machine, values, weights, x, u)
            second = _rate(machine, values, weights, x + STEP_S * first, u)
            x = np.clip(x + STEP_S / 2 * (first + second), -1e6, 1e6)
            t_s = t_s + STEP_S
            path.append(x[:, 1])
        for window, start in enumerate(rows):
            inside = slice(start + 1, np.searchsorted(run.t_s, run.t_s[start] + WINDOW_S))
            times = run.t_s[start] + STEP_S * np.arange(1, len(path) + 1)
            shown = np.interp(run.t_s[inside], times, [p[window] for p in path])
            squares += float(np.sum((run.outputs[inside, 0] - shown) ** 2))
            count += len(shown)
    return float(np.sqrt(squares / max(count, 1)))


def _rate(machine: Machine, values: Array, weights: Array, x: Array, u: Array) -> Array:
    motion = (x[:, 0], x[:, 1], u)
    extra = _terms(machine, *motion) @ weights
    return np.stack([_known(machine, values, motion) + extra, x[:, 0]], axis=1)
