"""Which balance fails: forces and torques that the raw measurements ask for, less the model's.

The equations of motion in weak form, beside the filter's corrections of where.py. With a bump phi
over a window of half width T, phi = c (1 - (t / T)^2)^4 with integral 1, any signal y obeys

    integral phi y'' = integral phi'' y,      integral phi y' = -integral phi' y

so that the derivatives go to phi, which is known exactly, and counts, gyro and camera enter as they
were logged. Between samples y is a straight line, which makes the integrals finite sums (that of
phi y itself by the mean of both ends); steady motion leaves nothing whatever the jitter of the
rows. The noise of the sensors goes through the same sums. The model's accelerations are averaged by
the same phi: its step from each row's filtered state to the next row, with what its drives remember
and what acts late, and without what the filter's disturbances push.

    wheel i              r_i = J_i (theta_i'' - model): torque at the shaft
    body                 r_b = M (acceleration by camera and gyro - model): forces, moment
    body, any contact    r_b + (N / R) H r: a contact law that is wrong pushes wheels and floor
                         alike and leaves this as it is
    null space, forces   (N / R) n . r, n = (1, -1, 1, -1): wheels against each other move no body
    null space, speeds   n . V, V_i = R theta_i' / N: slip that a rigid robot cannot have
    gyro, camera         turning by the gyro less that by the camera: blind to all forces
    gyro, wheels         turning by the gyro less that by the wheels
    camera, wheels       velocity by the camera less that by the wheels: slip, radius, mounting

N / R is the gear over the wheel's radius, H = J' of eq. (3). Speeds, and what compares two sensors,
are of what replays leave (measured less simulated), so that a model that has the slip or the
sensor's fault leaves nothing.

What is wrong in a driver, a motor or a bearing fails its wheel and the body for any contact; in the
contact law its wheel and the body, but not the body for any contact; on the body both of the
body's. A sensor that is wrong fails its comparison with the others, and then the balances that it
enters say nothing of forces. A model that is wrong also pulls the filtered states astray, which
blurs this.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import WINDOW_S, Replays
from omnislip.gap.noise import (
    DISTURBANCES,
    GYRO,
    HEADING,
    POSE_XY,
    SHAFT,
    Noise,
    corrections,
    track_all,
)
from omnislip.gap.recordings import Run, rim_m_per_rad, wheel_jacobian
from omnislip.gap.terms import NULL_SPACE

Array = npt.NDArray[np.float64]

HALF_S = 0.15
"""Half width of a window: seven samples of a camera of 50 Hz on each side of its middle."""
CENTRES_S = np.arange(HALF_S, WINDOW_S - HALF_S, HALF_S)
"""Middles of the windows after each restart of the replays: none holds another restart."""
LEAST_SAMPLES = 6
"""Of a sensor within a window: fewer do not resolve the bump."""
WHEELS, BODY = SHAFT, slice(4, 7)
FORCES = (("force along x", "N"), ("force along y", "N"), ("moment", "N m"))
_SHAPE = np.polynomial.Polynomial([1.0, 0.0, -1.0]) ** 4
_INTEGRAL = _SHAPE.integ() / (_SHAPE.integ()(1.0) - _SHAPE.integ()(-1.0))


@dataclass(frozen=True)
class Balance:
    """What a balance leaves: root mean squares over windows, and that of sensor noise alone."""

    name: str
    unit: str
    rms: Array
    """(models,)"""
    noise: float


class Bumps:
    """Weights (windows, samples) of a signal's samples at `t_s`, for bumps around `centres_s`.

    `mean`, `rate` and `acceleration` give the integrals of phi y, phi y' and phi y''; NaN in a
    window of too few samples. `share` (windows, samples - 1) is that of phi between samples.
    """

    def __init__(self, t_s: Array, centres_s: Array) -> None:
        after_s = t_s - centres_s[:, None]
        enough = np.sum(np.abs(after_s) < HALF_S, axis=1) >= LEAST_SAMPLES
        enough &= np.any(after_s <= -HALF_S, axis=1) & np.any(after_s >= HALF_S, axis=1)
        place = np.clip(after_s / HALF_S, -1.0, 1.0)
        blank = np.where(enough, 1.0, np.nan)[:, None]
        step_s, edge = np.diff(t_s), np.zeros((len(centres_s), 1))
        share = np.diff(_INTEGRAL(place))
        steeper = np.diff(_INTEGRAL.deriv()(place)) / HALF_S
        shared = np.hstack([edge, share, edge])
        self.share = blank * share
        self.mean = blank * 0.5 * (shared[:, 1:] + shared[:, :-1])
        self.rate = -blank * np.diff(np.hstack([edge, share / step_s, edge]))
        self.acceleration = blank * np.diff(np.hstack([edge, steeper / step_s, edge]))


def find_balances(
    machine: Machine, replays: Sequence[Replays], noise: Noise, sets: Sequence[Array]
) -> list[Balance]:
    """Return what the balances of a robot leave beside `sets`, by which its runs were replayed.

    Without those for which no run has the sensors; none for other machines.
    """
    if machine.kind != "robot":
        return []
    tracks = [track_all(machine, [one.run for one in replays], s, noise) for s in sets]
    found: dict[tuple[str, str], list[tuple[Array, Array]]] = {}
    for index, one in enumerate(replays):
        windows = _Windows(machine, one, noise, sets, [own[index] for own in tracks])
        for name, unit, values, deviation in (*windows.of_forces(), *windows.of_sensors()):
            found.setdefault((name, unit), []).append((values, deviation))
    rows = []
    for key, runs in found.items():
        values, deviation = (np.concatenate(part, axis=-1) for part in zip(*runs, strict=True))
        seen = np.isfinite(values[-1])
        if seen.any():
            rows.append(Balance(*key, _rms(values[:, seen]), float(_rms(deviation[seen]))))
    return rows


def _rms(values: Array) -> Array:
    """Root mean square along the windows (..., windows)."""
    return np.sqrt(np.mean(values**2, axis=-1))


class _Windows:
    """Balances over the windows of one run: (name, unit, (models, windows), noise (windows,))."""

    def __init__(
        self,
        machine: Machine,
        one: Replays,
        noise: Noise,
        sets: Sequence[Array],
        tracks: Sequence[_core.Track],
    ) -> None:
        run = one.run
        restarts_s = np.arange(run.settled_s, run.t_s[-1], WINDOW_S)
        centres_s = (restarts_s[:, None] + CENTRES_S).ravel()
        self._radius_m = rim_m_per_rad(machine)
        self._jacobian = wheel_jacobian(machine)
        self._outputs, self._errors = run.outputs, one.errors / run.scale
        self._sd = np.sqrt(noise.output)
        # A sensor that shows nothing keeps its blanks, and says nothing.
        blank = np.isnan(run.outputs[:, : HEADING + 1])
        self._seen = (~blank | blank.all(axis=0)).T
        self._bumps = [Bumps(run.t_s[seen], centres_s) for seen in self._seen]
        heading_rad = tracks[-1].state.reshape(len(run.t_s), -1)[:, 13]
        self._heading_rad = np.interp(centres_s, run.t_s, heading_rad)
        between = [_accelerations(run, track) for track in tracks]
        self._model = Bumps(run.t_s, centres_s).share @ np.stack(between)
        inertias = [machine.inertias(values) for values in sets]
        self._shafts = np.stack([shafts for _, _, shafts in inertias])[:, None]
        self._masses = np.array([[mass, mass, inertia] for mass, inertia, _ in inertias])[:, None]

    def of_forces(self) -> Iterator[tuple[str, str, Array, Array]]:
        """Measured accelerations less the model's, as torques and forces."""
        second, first = self._weak("acceleration", self._outputs), self._weak("rate", self._outputs)
        sd_second, sd_first = self._noise("acceleration"), self._noise("rate")
        torque = self._shafts * (second[:, WHEELS] - self._model[:, :, WHEELS])
        sd_torque = self._shafts[-1] * sd_second[:, WHEELS]
        for k in range(4):
            yield f"wheel {k + 1}: torque", "N m", torque[..., k], sd_torque[:, k]
        against = NULL_SPACE / self._radius_m
        sd_against = np.sqrt(sd_torque**2 @ against**2)
        yield "null space of the wheels: force", "N", torque @ against, sd_against
        measured = np.hstack([second[:, POSE_XY], first[:, GYRO, None]])
        own = self._masses * self._in_body(measured - self._model[:, :, BODY])
        sd_measured = np.hstack([sd_second[:, POSE_XY], sd_first[:, GYRO, None]])
        sd_own = self._masses[-1] * sd_measured
        part = self._jacobian / self._radius_m
        any_contact = own + torque @ part
        sd_any_contact = np.sqrt(sd_own**2 + sd_torque**2 @ part**2)
        for k, (name, unit) in enumerate(FORCES):
            yield f"body: {name}", unit, own[..., k], sd_own[:, k]
            yield f"body, any contact: {name}", unit, any_contact[..., k], sd_any_contact[:, k]

    def of_sensors(self) -> Iterator[tuple[str, str, Array, Array]]:
        """What replays leave of speeds, of each two sensors that should see the same."""
        rate, mean = self._weak("rate", self._errors), self._weak("mean", self._errors)
        sd_rate, sd_mean = self._noise("rate"), self._noise("mean")
        rim, sd_rim = self._radius_m * rate[..., WHEELS], self._radius_m * sd_rate[:, WHEELS]
        sd_null = np.sqrt(np.sum(sd_rim**2, axis=1))
        yield "null space of the wheels: speed", "m/s", rim @ NULL_SPACE, sd_null
        to_body = np.linalg.pinv(self._jacobian).T
        wheels, sd_wheels = rim @ to_body, np.sqrt(sd_rim**2 @ to_body**2)
        turning, camera = mean[..., GYRO], rate[..., HEADING]
        sd_turning = sd_mean[:, GYRO]
        sd = np.hypot(sd_turning, sd_rate[:, HEADING])
        yield "gyro less camera: turning", "rad/s", turning - camera, sd
        sd = np.hypot(sd_turning, sd_wheels[:, 2])
        yield "gyro less wheels: turning", "rad/s", turning - wheels[..., 2], sd
        # A replay that has turned too far goes astray sideways though its speed is right.
        ahead = self._weak("rate", self._outputs)[:, POSE_XY]
        sideways = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1) * mean[..., HEADING, None]
        velocity = self._in_body(rate[..., POSE_XY] - sideways) - wheels[..., :2]
        sd = np.hypot(sd_rate[:, POSE_XY], sd_wheels[:, :2])
        for k, name in enumerate(("speed along x", "speed along y")):
            yield f"camera less wheels: {name}", "m/s", velocity[..., k], sd[:, k]

    def _weak(self, kind: str, signals: Array) -> Array:
        """Return the weak derivative (..., windows, channels) of signals (..., rows, channels)."""
        pairs = enumerate(zip(self._seen, self._bumps, strict=True))
        return np.stack(
            [signals[..., seen, c] @ getattr(bumps, kind).T for c, (seen, bumps) in pairs], axis=-1
        )

    def _noise(self, kind: str) -> Array:
        """Return what the sensors' noise makes of it (windows, channels)."""
        lengths = [np.linalg.norm(getattr(bumps, kind), axis=1) for bumps in self._bumps]
        return np.stack(lengths, axis=-1) * self._sd[: HEADING + 1]

    def _in_body(self, vectors: Array) -> Array:
        """Turn (..., windows, 2 or more) along the world's axes into those along the body's."""
        cosine, sine = np.cos(self._heading_rad), np.sin(self._heading_rad)
        x, y, *rest = np.moveaxis(vectors, -1, 0)
        return np.stack([cosine * x + sine * y, cosine * y - sine * x, *rest], axis=-1)


def _accelerations(run: Run, track: _core.Track) -> Array:
    """Return the model's accelerations (rows - 1, 7) of shafts, of body along the world, of yaw.

    Means from each row to the next of the filter's own step, less what its disturbances push.
    """
    state = track.state.reshape(len(run.t_s), -1)
    stepped = (state - corrections(track))[1:]
    disturbed = state[:-1, DISTURBANCES]
    push = track.push.reshape(len(run.t_s), -1, disturbed.shape[1])[:-1]
    stepped[:, : push.shape[1]] -= np.einsum("rij,rj->ri", push, disturbed)
    change = _speeds(stepped) - _speeds(state[:-1])
    return change / np.diff(run.t_s)[:, None]


def _speeds(state: Array) -> Array:
    """Return speeds (rows, 7) of shafts, of the body along the world's axes, of turning."""
    along, across, turning, heading = state[:, 8], state[:, 9], state[:, 10], state[:, 13]
    cosine, sine = np.cos(heading), np.sin(heading)
    world = (cosine * along - sine * across, sine * along + cosine * across, turning)
    return np.column_stack([state[:, SHAFT], *world])
