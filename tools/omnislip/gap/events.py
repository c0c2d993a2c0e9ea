"""Impacts: sudden jumps of the body's momentum, found before the structure search.

A push at row k adds a jump (dvx, dvy, dw) to the state. What it does to the whitened innovations of
the next tenth of a second is linear in the jump, with the matrices of the filter (leftover.py gives
the recursion). With S the response and r the innovations, the generalised likelihood ratio of
Willsky and Jones (1976) is

    g_k = b' A^-1 b,   A = sum S'S,   b = -sum S'r,   jump = A^-1 b

chi-squared with 3 degrees of freedom where nothing happened. A missing effect raises g everywhere,
so an impact has to stand out from the run's own level and to explain most of the error around it.

The linear jump is right for a tap. A hard push makes wheels slide, so the size is fitted again with
the plant itself: free-running from the state before the push, for the horizon, over a grid of times
between the two rows. Against the plant's own replay without a push it has to gain and to explain as
much: where wheels break loose the linear response feigns pushes that the plant does without. Then
the log is cut: what follows sees the pieces before and after.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, track_all, track_recordings
from omnislip.gap.recordings import Run
from omnislip.log_file import Log
from omnislip.model_file import IMPACT_KEYS, Effect, Model

Array = npt.NDArray[np.float64]

HORIZON_S = 0.1
LEAST_RATIO = 60.0
"""g beyond which chance is out of the question (p = 6e-13; rows of an hour: 7e5)."""
OVER_LEVEL = 12.0
"""Factor by which g must exceed the 80th percentile of its run (4.6 where nothing is wrong)."""
EXPLAINED = 0.35
"""Share of the squared innovations of the horizon that the jump must take away."""
REPLAYED = 0.8
"""The same share of the plant's own replay: pushes of 0.06 to 0.5 m/s explained 0.96 and more of
it, what wheels that break loose in violent driving feign 0.5 to 0.77."""
LEAST_JUMP_M_S = 0.04
"""A seam in the floor or a wheel that spins up makes smaller jumps: no push to be named."""
MOST_JUMP_M_S = 2.5
COMMAND_JUMP = 0.1
"""Change of a duty from row to row after which wheels may break loose."""
MOST_MISFIT = 9.0
"""A jump that leaves errors three times their standard deviation is not what happened."""
APART_S = 0.3
REPLAY_STEP_S = 1e-3
CUT_S = 0.05
"""Left out after a push: the contact of the pusher."""
LEAST_PIECE_S = 1.0
VELOCITY = slice(8, 11)
PROBE = np.array([0.05, 0.05, 0.1])
# Of the filtered state before a push: shaft speeds, encoder angles, body velocity, pose.
STATE_VARIANCE = np.array([0.25] * 4 + [1e-6] * 4 + [1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])


@dataclass(frozen=True)
class Impact:
    """A push: in which run, when, and the jump of momentum."""

    run: str
    time_s: float
    impulse: Array
    """(x N s, y N s, theta N m s), world frame"""
    deviation: Array
    misfit: float = 0.0
    """Mean square error after the push, in its standard deviations."""
    gain: float = np.inf
    """By how much the push lowers the squared errors of the plant's own replay, and the share."""
    explained: float = 1.0

    def jump_m_s(self, machine: Machine) -> float:
        """Return the jump of a wheel's hub, at most."""
        speed = float(np.hypot(*self.impulse[:2])) / machine.believed[0]
        return speed + abs(self.impulse[2]) / machine.believed[1] * machine.believed[3]

    def near(self, other: "Impact") -> bool:
        """Whether both are the same push."""
        return self.run == other.run and abs(self.time_s - other.time_s) < APART_S


def find_impacts(
    machine: Machine, runs: Sequence[Run], values: Array, noise: Noise
) -> list[Impact]:
    """Return the impacts in the runs, by run and time."""
    if machine.kind != "robot":
        return []
    impacts = []
    for run in runs:
        track = track_all(machine, [run], values, noise, keep_linear=True)[0]
        pushes = _Pushes(machine, run, track)
        ratio, jump, explained = pushes.ratios()
        level = float(np.percentile(ratio, 80))
        for peak in _peaks(run.t_s, ratio, max(LEAST_RATIO, OVER_LEVEL * level)):
            if explained[peak] >= EXPLAINED:
                row = pushes.likeliest_row(peak)
                filtered = track.state.reshape(len(run.t_s), -1)[row - 1]
                before = filtered[: machine.engine.states]
                impact = _size_up(machine, run, row, values, noise, before, jump[row])
                least = max(LEAST_JUMP_M_S, _feigned_m_s(machine, run, row))
                plausible = least <= impact.jump_m_s(machine) <= MOST_JUMP_M_S
                confirmed = impact.gain >= LEAST_RATIO and impact.explained >= REPLAYED
                if plausible and confirmed and impact.misfit <= MOST_MISFIT:
                    impacts.append(impact)
    return impacts


def _feigned_m_s(machine: Machine, run: Run, row: int) -> float:
    """Return the jump of the body that jumps of the command before and beside the row may feign.

    When within a row wheels break loose or grip again the log does not tell: for up to a row on
    either side of a jump the body is pulled with mu g, or is not. What earlier jumps of the horizon
    left shows no later than where the wheels grip. Jumps after the row may answer the push.
    """
    values = machine.model.values
    grip_m_s2 = values["contact.mu_drive"] * values["contact.gravity_m_s2"]
    rows_s = np.diff(run.t_s, append=run.t_s[-1])
    jumps = np.abs(np.diff(run.command, axis=0, prepend=run.command[:1])).max(axis=1) > COMMAND_JUMP
    beside = slice(max(row - 1, 0), row + 3)
    before = slice(int(np.searchsorted(run.t_s, run.t_s[row] - HORIZON_S)), beside.start)
    unsure_s = float(np.sum(rows_s[before][jumps[before]]))
    if jumps[beside].any():
        unsure_s += float(rows_s[beside].max())
    return float(2.0 * grip_m_s2 * unsure_s)


def as_effect(impact: Impact) -> Effect:
    """Return the impact as it stands in a model file."""
    numbers = dict(zip(IMPACT_KEYS, (impact.time_s, *impact.impulse.tolist()), strict=True))
    return Effect("impact", numbers, run=impact.run)


def known_pushes(model: Model) -> list[tuple[str, float]]:
    """Return run and time of the impacts that a model file names."""
    return [(e.run or "", e.parameters["time_s"]) for e in model.effects if e.name == "impact"]


def pieces(log: Log, pushes: Sequence[tuple[str, float]]) -> list[tuple[int, int]]:
    """Return the row ranges between the pushes (run, time) of a log that are long enough to use."""
    edges = [0]
    for time_s in sorted(time_s for run, time_s in pushes if run == log.name):
        edges += [int(np.searchsorted(log.t_s, t)) for t in (time_s, time_s + CUT_S)]
    edges.append(len(log.t_s))
    ranges = list(zip(edges[::2], edges[1::2], strict=True))
    return [(a, b) for a, b in ranges if b > a and log.t_s[b - 1] - log.t_s[a] > LEAST_PIECE_S]


def _size_up(
    machine: Machine,
    run: Run,
    row: int,
    values: Array,
    noise: Noise,
    before: Array,
    jump: Array,
) -> Impact:
    """Fit the jump with the plant, for the likeliest time between the two rows."""
    afters = [
        _After(machine, run, row, values, noise, before, share)
        for share in (0.1, 0.3, 0.5, 0.7, 0.9)
    ]
    fits = [_fit_jump(after, jump) for after in afters]
    quiet = min(float(np.sum(after.errors(np.zeros(3)) ** 2)) for after in afters)
    cost, time_s, jump, covariance, readings = min(fits, key=lambda found: found[0])
    mass = values[0] + values[machine.place("payload", "mass_kg", None)[0]]
    inertia = values[1] + values[machine.place("inertia_error", "inertia_kg_m2", None)[0]]
    cos, sin = np.cos(before[13]), np.sin(before[13])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    to_world = np.diag([mass, mass, inertia]) @ turn
    spread = covariance * max(1.0, cost)
    deviation = np.sqrt(np.diag(to_world @ spread @ to_world.T))
    gain = quiet - cost * readings
    return Impact(run.name, time_s, to_world @ jump, deviation, cost, gain, gain / quiet)


class _After:
    """The rows after a push, as whitened replay errors that depend on the jump."""

    def __init__(
        self,
        machine: Machine,
        run: Run,
        row: int,
        values: Array,
        noise: Noise,
        before: Array,
        share: float,
    ) -> None:
        end = int(np.searchsorted(run.t_s, run.t_s[row] + HORIZON_S)) + 1
        gone_s = share * float(run.t_s[row] - run.t_s[row - 1])
        self.time_s = float(run.t_s[row - 1]) + gone_s
        self._machine, self._values = machine, values
        self._t_s = np.concatenate([[self.time_s], run.t_s[row:end]])
        self._command = np.ascontiguousarray(run.command[row - 1 : end])
        blank = np.full((1, run.outputs.shape[1]), np.nan)
        self._outputs = np.concatenate([blank, run.outputs[row:end]])
        slope = machine.engine.derivatives(values, before[None], run.command[row - 1][None])[0]
        self._state = before + gone_s * slope
        self._noise = replace(noise, initial=STATE_VARIANCE)
        self.weight = self._weights()

    def errors(self, jump: Array) -> Array:
        """Replay errors (rows * outputs,) in their standard deviations; 0 where not sampled."""
        recording = self._recording(jump)
        track = self._track(recording)
        error = self._machine.engine.replays([recording], [track], self._values[None])[0][0]
        return np.nan_to_num(error * self.weight).ravel()

    def _recording(self, jump: Array) -> _core.Recording:
        state = self._state.copy()
        state[VELOCITY] += jump
        return self._machine.engine.recording(self._t_s, self._command, self._outputs, state)

    def _track(self, recording: _core.Recording) -> _core.Track:
        return track_recordings(
            self._machine, [recording], self._values, self._noise, REPLAY_STEP_S
        )[0]

    def _weights(self) -> Array:
        variance = self._track(self._recording(np.zeros(3))).replay_variance
        return 1.0 / np.sqrt(variance.reshape(self._outputs.shape))


def _fit_jump(after: _After, jump: Array) -> tuple[float, float, Array, Array, int]:
    """Gauss-Newton; returns mean square error, time, jump, covariance, number of readings."""
    found = least_squares(after.errors, jump, x_scale=PROBE, diff_step=1e-3, max_nfev=15)
    readings = max(np.count_nonzero(found.fun), 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return 2.0 * found.cost / readings, after.time_s, found.x, covariance, readings


class _Pushes:
    """What pushes before each row of a run would do to its whitened innovations."""

    def __init__(self, machine: Machine, run: Run, track: _core.Track) -> None:
        n, m, rows = machine.engine.filter_states, machine.engine.outputs, len(run.t_s)
        sampled = ~np.isnan(run.outputs)
        slope = np.where(sampled[:, :, None], track.slope.reshape(rows, m, n), 0.0)
        gain, whitening = track.gain.reshape(rows, n, m), track.whitening.reshape(rows, m, m)
        innovation = np.where(sampled, track.innovation.reshape(rows, m), 0.0)
        self.white = np.einsum("rij,rj->ri", whitening, innovation)
        self.shown = -(whitening @ slope)
        transition = track.transition.reshape(rows, n, n)
        self.carry = transition - transition @ gain @ slope
        self.horizon = max(3, round(HORIZON_S / float(np.median(np.diff(run.t_s)))))
        self.t_s = run.t_s

    def ratios(self) -> tuple[Array, Array, Array]:
        """Return g, the jump and the explained share for a push before each row."""
        rows, n = len(self.white), self.carry.shape[1]
        error = np.zeros((rows, n, 3))
        error[:, VELOCITY] = np.eye(3)
        information, right = np.zeros((rows, 3, 3)), np.zeros((rows, 3))
        energy = np.zeros(rows)
        for ahead in range(self.horizon):
            # Row k of `error` is the error at row k + ahead after a push before row k.
            seen = slice(ahead, rows)
            at = np.arange(rows - ahead)
            response = self.shown[seen] @ error[at]
            information[at] += response.transpose(0, 2, 1) @ response
            right[at] -= np.einsum("rij,ri->rj", response, self.white[seen])
            energy[at] += np.sum(self.white[seen] ** 2, axis=1)
            error[at] = self.carry[seen] @ error[at]
        jump = np.linalg.solve(information + 1e-9 * np.eye(3), right[:, :, None])[:, :, 0]
        ratio = np.einsum("ri,ri->r", right, jump)
        ratio[self.t_s < self.t_s[0] + HORIZON_S] = 0.0
        return ratio, jump, ratio / np.maximum(energy, 1e-12)

    def likeliest_row(self, peak: int) -> int:
        """Return the row before which a push explains most of the rows around a peak of g.

        g looks one horizon ahead of its row; rows can be compared only over the same rows.
        """
        end = min(peak + self.horizon, len(self.white))
        rows = range(max(1, peak - self.horizon), peak + 1)
        return max(rows, key=lambda row: self._explained_until(row, end))

    def _explained_until(self, row: int, end: int) -> float:
        error = np.zeros((self.carry.shape[1], 3))
        error[VELOCITY] = np.eye(3)
        information, right = 1e-9 * np.eye(3), np.zeros(3)
        for k in range(row, end):
            response = self.shown[k] @ error
            information += response.T @ response
            right -= response.T @ self.white[k]
            error = self.carry[k] @ error
        return float(right @ np.linalg.solve(information, right))


def _peaks(t_s: Array, ratio: Array, threshold: float) -> list[int]:
    """Rows of the local maxima above the threshold, strongest first claiming its surroundings."""
    left, found = ratio.copy(), []
    while left.max(initial=0.0) > threshold:
        row = int(np.argmax(left))
        found.append(row)
        left[np.abs(t_s - t_s[row]) < APART_S] = 0.0
    return sorted(found)
