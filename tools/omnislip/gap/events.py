"""Impacts: sudden jumps of the body's momentum, found before the structure search.

A push at row k adds a jump (dvx, dvy, dw) to the state. What it does to the whitened innovations of
the next tenth of a second is linear in the jump, with the matrices of the filter (leftover.py gives
the recursion). With S the response and r the innovations, the generalised likelihood ratio of
Willsky and Jones (1976) is

    g_k = b' A^-1 b,   A = sum S'S,   b = -sum S'r,   jump = A^-1 b

chi-squared with 3 degrees of freedom where nothing happened. A missing effect raises g everywhere,
so an impact has to stand out from the run's own level and to explain most of the error around it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, track_all
from omnislip.gap.recordings import Run

Array = npt.NDArray[np.float64]

HORIZON_S = 0.1
LEAST_RATIO = 60.0
"""g beyond which chance is out of the question (p = 6e-13; rows of an hour: 7e5)."""
OVER_LEVEL = 8.0
"""Factor by which g must exceed the 95th percentile of its run."""
EXPLAINED = 0.5
"""Share of the squared innovations of the horizon that the jump must take away."""
APART_S = 0.3
VELOCITY = slice(8, 11)


@dataclass(frozen=True)
class Impact:
    """A push: when, and the jump of the body's velocity (body frame) and momentum (world frame)."""

    run: str
    row: int
    time_s: float
    jump: Array
    """(vx m/s, vy m/s, omega rad/s)"""
    impulse: Array
    """(x N s, y N s, theta N m s), world frame"""
    deviation: Array
    ratio: float


def find_impacts(
    machine: Machine, runs: Sequence[Run], values: Array, noise: Noise
) -> list[Impact]:
    """Return the impacts in the runs, by run and time."""
    if machine.kind != "robot":
        return []
    impacts = []
    for run in runs:
        track = track_all(machine, [run], values, noise, keep_linear=True)[0]
        ratio, jump, covariance, explained = _ratios(machine, run, track)
        level = float(np.percentile(ratio, 95))
        peaks = _peaks(run.t_s, ratio, max(LEAST_RATIO, OVER_LEVEL * level))
        for row in peaks:
            if explained[row] < EXPLAINED:
                continue
            heading = track.state.reshape(len(run.t_s), -1)[row, 13]
            impacts.append(_impact(machine, run, row, jump[row], covariance[row], heading, ratio))
    return impacts


def _impact(
    machine: Machine,
    run: Run,
    row: int,
    jump: Array,
    covariance: Array,
    heading: float,
    ratio: Array,
) -> Impact:
    mass, inertia = machine.believed[0], machine.believed[1]
    turn = np.array(
        [
            [np.cos(heading), -np.sin(heading), 0.0],
            [np.sin(heading), np.cos(heading), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    to_world = np.diag([mass, mass, inertia]) @ turn
    before = 0.5 * (run.t_s[row - 1] + run.t_s[row])  # between two rows, no telling where
    return Impact(
        run.name,
        row,
        float(before),
        jump,
        to_world @ jump,
        np.sqrt(np.diag(to_world @ covariance @ to_world.T)),
        float(ratio[row]),
    )


def _ratios(machine: Machine, run: Run, track: object) -> tuple[Array, Array, Array, Array]:
    """Return g, the jump, its covariance and the explained share for a push before each row."""
    n, m, rows = machine.engine.states, machine.engine.outputs, len(run.t_s)
    sampled = ~np.isnan(run.outputs)
    slope = np.where(sampled[:, :, None], track.slope.reshape(rows, m, n), 0.0)
    gain, whitening = track.gain.reshape(rows, n, m), track.whitening.reshape(rows, m, m)
    innovation = np.where(sampled, track.innovation.reshape(rows, m), 0.0)
    white = np.einsum("rij,rj->ri", whitening, innovation)
    carry = track.transition.reshape(rows, n, n)
    carry = carry - carry @ gain @ slope
    horizon = max(3, round(HORIZON_S / float(np.median(np.diff(run.t_s)))))
    error = np.zeros((rows, n, 3))
    error[:, VELOCITY] = np.eye(3)
    information, right = np.zeros((rows, 3, 3)), np.zeros((rows, 3))
    energy = np.zeros(rows)
    for ahead in range(horizon):
        # Row k of `error` is the error at row k + ahead after a push before row k.
        seen = slice(ahead, rows)
        at = np.arange(rows - ahead)
        response = -(whitening[seen] @ slope[seen]) @ error[at]
        information[at] += response.transpose(0, 2, 1) @ response
        right[at] -= np.einsum("rij,ri->rj", response, white[seen])
        energy[at] += np.sum(white[seen] ** 2, axis=1)
        error[at] = carry[seen] @ error[at]
    information += 1e-9 * np.eye(3)
    jump = np.linalg.solve(information, right[:, :, None])[:, :, 0]
    ratio = np.einsum("ri,ri->r", right, jump)
    early = run.t_s < run.t_s[0] + HORIZON_S
    ratio[early] = 0.0
    return ratio, jump, np.linalg.inv(information), ratio / np.maximum(energy, 1e-12)


def _peaks(t_s: Array, ratio: Array, threshold: float) -> list[int]:
    """Rows of the local maxima above the threshold, strongest first claiming its surroundings."""
    left, found = ratio.copy(), []
    while left.max(initial=0.0) > threshold:
        row = int(np.argmax(left))
        found.append(row)
        left[np.abs(t_s - t_s[row]) < APART_S] = 0.0
    return sorted(found)
