"""How often do the forces on an axis repeat along its way?

A screw, a belt, the magnets of a linear motor or a motor behind a gear pull with every turn of
theirs, n times per metre or radian; nothing says how often, and a fit leads to n only from less
than half a wave off over all of the way. But the accelerations show it: what commands, speeds and
directions do not explain of them, r at the places q, has a peak in

    P(n) = |sum r exp(i n q)|^2

at n. Second differences of a position hold little else where an axis moves less than half a wave
per row; slower rows are those that show short waves.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.signal import find_peaks

if TYPE_CHECKING:
    from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

PEAKS = 8
"""How many of the waves that show most are worth a fit."""
SLOW, WAYS = 20.0, 2
"""Percentile of the moving rows that are slow enough to show the shortest wave; how much finer than
the way tells apart waves are looked for."""
MOST_PLACES = 2**18


def waves_along(runs: Sequence["Run"], turns: bool) -> list[float]:
    """Return the waves n, in rad/m or per radian, that show most in accelerations.

    `turns`: the axis is a turning one, which may carry a weight.
    """
    parts = [_unexplained(run, turns) for run in runs]
    place, left, moved = (np.concatenate(part) for part in zip(*parts, strict=True))
    moving = moved[moved > 0.0]
    way = float(np.ptp(place)) if len(place) else 0.0
    if way == 0.0 or not len(moving):
        return []
    shortest = 2.0 * max(float(np.percentile(moving, SLOW)), way / MOST_PLACES)
    step = shortest / 4.0
    number = np.floor((place - place.min()) / step).astype(int)
    forces = np.bincount(number, left)
    length = WAYS * 2 ** int(np.ceil(np.log2(len(forces))))
    power = np.abs(np.fft.rfft(forces, length)) ** 2
    waves = 2.0 * np.pi * np.arange(len(power)) / (length * step)
    seen = (waves > 2.0 * np.pi / way) & (waves < 2.0 * np.pi / shortest)
    peaks, _ = find_peaks(np.where(seen, power, 0.0), distance=WAYS)
    best = peaks[np.argsort(-power[peaks])][:PEAKS]
    return [float(n) for n in waves[best]]


def _unexplained(run: "Run", turns: bool) -> tuple[Array, Array, Array]:
    """Return places (rows,), what is left of accelerations there, and how far each row moved."""
    shown = np.isfinite(run.outputs[:, 0])
    t, q = run.t_s[shown], run.outputs[shown, 0]
    command = np.nan_to_num(run.command[shown, 0])
    if len(t) < 3:
        return np.empty(0), np.empty(0), np.empty(0)
    speed = np.diff(q) / np.diff(t)
    acceleration = 2.0 * np.diff(speed) / (t[2:] - t[:-2])
    mean_speed = 0.5 * (speed[1:] + speed[:-1])
    place, moved = q[1:-1], np.abs(q[2:] - q[:-2]) / 2.0
    given = 0.5 * (command[1:-1] + command[:-2])
    columns = [np.ones_like(place), given, mean_speed, np.sign(mean_speed)]
    if turns:
        columns += [np.sin(place), np.cos(place)]
    known = np.column_stack(columns)
    left = acceleration - known @ np.linalg.lstsq(known, acceleration, rcond=None)[0]
    return place, left, moved
