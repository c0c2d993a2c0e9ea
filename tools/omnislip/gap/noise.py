"""The noise of the predictor: how much of a prediction error is chance.

The extended Kalman filter of the engine needs variances: per second for the states that the world
pushes at random (shaft speeds, body velocity, yaw rate), per sample for each sensor. What rollers
and seams of a floor do at a wheel's contact pushes its shaft and the body at once: that has a
variance of its own. (Taken for independent, forces of 1 to 2 N make logs less likely by 800 to
2,800, in log, pull believed keys to their ends and feign soft gears.) All are fitted by maximum
likelihood of the innovations. The sizes start from the data: second differences of a sensor hold
its noise and hardly any motion. The sensors of a robot stay near what these show: a model that is
far off would else be blamed on them, and with sensors that nobody believes no missing effect can be
seen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.errors import InputError
from omnislip.gap.machine import (
    CURRENT,
    Machine,
    count_rad,
    stall_acceleration_rad_s2,
    stall_current_a,
)
from omnislip.gap.recordings import SHAFT_VARIANCE, Run, first_variance, wheel_jacobian

Array = npt.NDArray[np.float64]

SHAFT, ENCODER, BODY, YAW = slice(0, 4), slice(4, 8), slice(8, 10), 10
DISTURBANCES = slice(-7, None)
GYRO, POSE_XY, HEADING, SUPPLY = 4, slice(5, 7), 7, 8
COLOUR_RATE, CONTACT = 11, 12
"""Places of the disturbances' rate and of forces at contacts among the logarithms of a robot."""
TUNING_TIME_S = 12.0
PATHS, ROUNDS, TRIALS = 4, 12, 4
PROBE = 0.2
PULL = 0.04
"""Information of the guess about each logarithm: a standard deviation of five."""
COLOUR_RATE_1_S = 100.0
CONTACT_N2 = 0.25
"""First guess of the variance of the forces at a wheel's contact."""
COLOUR_RATES_1_S = (40.0, 600.0)
"""To choose a model: what lasts longer may be what is missing, what is shorter is white."""
LASTING_RATE_1_S = 9.0
"""Rate down to which chance may fade where nothing is to be named any more but a model is judged: a
bandwidth of 1.4 Hz. Replays of a second feel it: what fades in a tenth of a second doubles their
square error against what fades in a fortieth. Slower than that is no chance (predictable.py)."""
LEAST = 5.0
"""How far a logarithm may fall below its guess: below that a variance no longer matters."""
SENSOR_MARGIN = 2.0
"""How far that of a sensor may be beyond its second differences at rest and in motion: errors that
last hardly show in these (a factor of 2.7 in the standard deviation)."""
QUIET, WINDOW_ROWS = 10.0, 20
"""A sensor at rest: percentile of the variances of windows."""
STEP_S = 5e-3
"""Longest integration step of predictions; stiffness and jumps ask for shorter ones. Against steps
of 10 us it changes whitened innovations by 0.002 to 0.006 (standard deviation, six logs), their sum
of squares by less than 2; by 21 where shafts follow in 3 ms, at twice that length a step."""
STAMP_S = 5e-4
"""Standard deviation of what the stamp of a row may be off by, where something else is to be told
from it: a system that stamps what it reads when it finds time."""
UNSURE = 100.0
"""Added to the information of each logarithm where a step is damped: of what hardly tells on the
likelihood an e-fold may change much that does. Climbs end 10 to 130 higher, in fewer rounds."""
CONVERGED, LITTLE = 3.0, 0.01
"""Gain of log-likelihood below which another round is not worth it, alone and as a share of what
was gained before: where that is much the model is off, and will be fitted before the next path."""


def stamp_slope(t_s: Array, outputs: Array, track: _core.Track) -> Array:
    """Return what sensors read more (rows, outputs) per second that a row's stamp is late.

    Of a track with its matrices; 0 where nothing was sampled.
    """
    rows, count = outputs.shape
    rate = np.gradient(track.state.reshape(rows, -1), t_s, axis=0)
    late = np.einsum("rij,rj->ri", track.slope.reshape(rows, count, -1), rate)
    return np.where(np.isnan(outputs), 0.0, late)


@dataclass(frozen=True)
class Noise:
    """Variances: `process` (states,) per second, `output` (outputs,), `initial` (states,).

    `coloured` (pushes, pushes) is the lasting covariance of the disturbances of shafts and body,
    which fade at `colour_rate_1_s` (sim/replay.h); none for other machines.

    `timing_s2` is the variance of the rows' times, `unresolved` that of a shaft's acceleration by
    commands that move within a row ((rad/s2)^2 per squared duty), `unresolved_current` that of a
    current for the same reason (A^2 per squared duty).
    """

    process: Array
    output: Array
    initial: Array
    timing_s2: float
    unresolved: float
    logs: Array
    """Logarithms of the fitted variances."""
    unresolved_current: float = 0.0
    coloured: Array = field(default_factory=lambda: np.zeros((0, 0)))
    colour_rate_1_s: float = COLOUR_RATE_1_S


class RunawayError(InputError):
    """A model whose filter grows without bounds on a log."""


def track_all(
    machine: Machine,
    runs: Sequence[Run],
    values: Array,
    noise: Noise,
    keep_linear: bool = False,
    floor_window_s: float = 0.0,
) -> list[_core.Track]:
    """Run the filter of one parameter set over all runs: as `track_recordings`."""
    recordings = [run.recording for run in runs]
    return track_recordings(machine, recordings, values, noise, STEP_S, keep_linear, floor_window_s)


def corrections(track: _core.Track) -> Array:
    """What the filter of a track corrects its states by in every row (rows, filter states)."""
    states = track.filter_states
    rows = len(track.state) // states
    gain = track.gain.reshape(rows, states, -1)
    innovation = np.nan_to_num(track.innovation.reshape(rows, -1))
    return np.einsum("rij,rj->ri", gain, innovation)


def require_following(runs: Sequence[Run], tracks: Sequence[_core.Track]) -> None:
    """Raise RunawayError if a filter has diverged."""
    for run, track in zip(runs, tracks, strict=True):
        require_finite(run, np.array(track.log_likelihood))


def require_finite(run: Run, values: Array) -> None:
    """Raise RunawayError if what a model says of a run has grown without bounds."""
    if not np.isfinite(values).all():
        raise RunawayError(
            f"{run.name}: the model does not follow this log, its motion grows without bounds; "
            "check masses, inertias and effects of the model file"
        )


def track_recordings(
    machine: Machine,
    recordings: Sequence[_core.Recording],
    values: Array,
    noise: Noise,
    step_s: float,
    keep_linear: bool = False,
    floor_window_s: float = 0.0,
) -> list[_core.Track]:
    """Run the filter of one parameter set over recordings, with steps of at most `step_s`.

    `keep_linear` keeps its matrices. With a `floor_window_s` it finds what variance the noise gives
    to replays that start again so often.
    RunawayError for a set that is too stiff to be followed.
    """
    try:
        return machine.engine.track(
            list(recordings),
            values,
            noise.process,
            noise.output,
            noise.initial,
            noise.timing_s2,
            noise.unresolved,
            noise.unresolved_current,
            noise.coloured.ravel().tolist(),
            noise.colour_rate_1_s,
            step_s=step_s,
            floor_window_s=floor_window_s,
            keep_linear=keep_linear,
        )
    except ValueError as error:
        if machine.engine.fastest_rate_1_s(values) <= _core.FASTEST_RATE_1_S:
            raise
        raise RunawayError(str(error)) from None


def run_free(
    machine: Machine,
    t_s: Array,
    command: Array,
    start: Array,
    values: Array,
    noise: Noise,
    step_s: float,
) -> Array:
    """Return the filter's states (rows, states) where nothing is measured, from `start` on."""
    blank = np.full((len(t_s), machine.engine.outputs), np.nan)
    recording = machine.recording(t_s, command, blank, start)
    [track] = track_recordings(machine, [recording], values, noise, step_s)
    return track.state.reshape(len(t_s), -1)


@dataclass(frozen=True)
class Guess:
    """Logarithms of the variances before they are fitted, and how far they may move."""

    logs: Array
    low: Array
    high: Array


def first_guess(machine: Machine, runs: Sequence[Run]) -> Noise:
    """Return the noise that the sensors' second differences and experience suggest."""
    make, start = NOISES[machine.kind]
    return make(machine, start(runs).logs)


def tune_noise(
    machine: Machine,
    runs: Sequence[Run],
    values: Array,
    start: "Noise | None" = None,
    paths: int = PATHS,
    slowest_1_s: float = COLOUR_RATES_1_S[0],
) -> Noise:
    """Fit the variances on some 12 s of the runs by maximum likelihood.

    Fisher scoring in the logarithms, damped as by Levenberg and Marquardt, along the path of a
    filter, which is then followed again with the noise that was found.
    `start` is a noise that was fitted before; from there few steps are enough. One of the `paths`
    is enough where the model is fitted again afterwards. A robot's chance fades at `slowest_1_s` or
    faster.
    """
    return _tuned(machine, runs, values, start, paths, slowest_1_s)[0]


def tuned_likelihood(machine: Machine, runs: Sequence[Run], values: Array, start: Noise) -> float:
    """Return the log-likelihood of some 12 s of the runs by noise that fits them."""
    return _tuned(machine, runs, values, start, 1, COLOUR_RATES_1_S[0])[1]


def _tuned(
    machine: Machine,
    runs: Sequence[Run],
    values: Array,
    start: Noise | None,
    paths: int,
    slowest_1_s: float,
) -> tuple[Noise, float]:
    """Return the noise that `tune_noise` finds, and the log-likelihood of the runs it chose."""
    chosen = some_runs(runs)
    make, start_of = NOISES[machine.kind]
    guess = start_of(chosen)
    if machine.engine.pushes:
        guess.low[COLOUR_RATE] = np.log(slowest_1_s)
    logs = trial = guess.logs if start is None else np.clip(start.logs, guess.low, guess.high)
    best = likelihood = -np.inf
    for left in reversed(range(paths + 1)):
        try:
            path = _Path(machine, chosen, values, lambda v: make(machine, v), guess, trial)
        except RunawayError:
            if best == -np.inf:
                raise
            break
        if path.log_likelihood < best:  # too far from the path that it was linear along
            break
        best, likelihood, logs = path.log_likelihood, path.of_filter, trial
        if not left:
            break
        try:
            gained, trial = path.climb(logs)
        except np.linalg.LinAlgError:  # covariances lost in rounding: no way on from here
            break
        if gained < CONVERGED:
            break
    return make(machine, logs), likelihood


def judging_noise(machine: Machine, runs: Sequence[Run], values: Array, noise: Noise) -> Noise:
    """Return the noise by which replays of a model are judged: its chance may last as long as any.

    From the `noise` that it was chosen by; that itself for machines without disturbances.
    """
    if not machine.engine.pushes:
        return noise
    return tune_noise(machine, runs, values, noise, slowest_1_s=LASTING_RATE_1_S)


class _Path:
    """The filter with the noise of `logs` over some runs: the likelihood of others near its path.

    Their prior: a logarithm is likely near its guess.
    """

    def __init__(
        self,
        machine: Machine,
        runs: Sequence[Run],
        values: Array,
        make: Callable[[Array], Noise],
        guess: Guess,
        logs: Array,
    ) -> None:
        self._engine, self._make, self._guess = machine.engine, make, guess
        self._recordings = [run.recording for run in runs]
        self._tracks = track_all(machine, runs, values, make(logs), keep_linear=True)
        require_following(runs, self._tracks)
        self.of_filter = float(sum(track.log_likelihood for track in self._tracks))
        self.log_likelihood = float(self.of_filter - self._pull(logs))

    def climb(self, logs: Array) -> tuple[float, Array]:
        """Return the gain of the log-likelihood and the logarithms at its maximum."""
        low, high = self._guess.low, self._guess.high
        damping, whole = 1.0, 0.0
        for _ in range(ROUNDS):
            here, slope, information = self._score(logs)
            # What rests on a bound does not move: others must not step as if it did.
            free = np.where(slope < 0, logs > low, logs < high)
            slope, information = slope[free], information[np.ix_(free, free)]
            trials = []
            for k in range(TRIALS):
                damped = information + damping * 5.0**k * np.diag(np.diag(information) + UNSURE)
                trial = logs.copy()
                trial[free] += np.clip(np.linalg.solve(damped, slope), -2.0, 2.0)
                trials.append(np.clip(trial, low, high))
            totals, _ = self._look(np.array(trials), with_information=False)
            best = int(np.argmax(totals))
            gained = float(totals[best]) - here
            if not gained > 0:
                break
            whole, logs, damping = whole + gained, trials[best], damping * 5.0**best * 0.2
            if gained < max(CONVERGED, LITTLE * whole):
                break
        return whole, logs

    def _look(self, many: Array, with_information: bool) -> tuple[Array, Array]:
        """Return log-likelihoods (sets,) and what changes from the first set tell (sets, sets).

        With S_k = L_k L_k' the covariance of row k by the first set and A_ik = L_k^-1 dS_ik L_k^-T
        what set i changes of it, that is sum_k tr(A_ik A_jk) / 2.
        """
        noises = [self._make(logs) for logs in many]
        totals, information = self._engine.likelihoods(
            self._recordings,
            self._tracks,
            np.stack([n.process for n in noises]),
            np.stack([n.output for n in noises]),
            np.stack([n.initial for n in noises]),
            np.array([n.timing_s2 for n in noises]),
            np.array([n.unresolved for n in noises]),
            np.array([n.unresolved_current for n in noises]),
            np.stack([n.coloured.ravel() for n in noises]),
            np.array([n.colour_rate_1_s for n in noises]),
            with_information,
        )
        return totals - self._pull(many), information

    def _pull(self, logs: Array) -> Array:
        return np.sum((logs - self._guess.logs) ** 2, axis=-1) * PULL / 2

    def _score(self, logs: Array) -> tuple[float, Array, Array]:
        """Return log-likelihood, its slope and the information at `logs`."""
        unit = np.eye(len(logs))
        totals, told = self._look(np.vstack([logs, logs + PROBE * unit]), with_information=True)
        if not np.isfinite(told).all():
            raise np.linalg.LinAlgError("covariances lost in rounding")
        information = told[1:, 1:] / PROBE**2 + PULL * unit
        slope = (totals[1:] - totals[0]) / PROBE + 0.5 * PROBE * np.diag(information)
        return float(totals[0]), slope, information


def some_runs(runs: Sequence[Run]) -> list[Run]:
    """Return runs from the whole range, `TUNING_TIME_S` or more, with every sensor in one.

    Of what rolls on wheels from the liveliest, where they slip, to the calmest. Of an axis by their
    order: how it is driven hardly tells how well its motion is foreseen.
    """
    share = TUNING_TIME_S / max(sum(run.duration_s for run in runs), 1e-9)
    count = int(np.clip(np.ceil(share * len(runs)), 1, len(runs)))
    order = np.arange(len(runs))
    if runs[0].command.shape[1] > 1:
        order = np.argsort([np.var(run.command, axis=0).sum() for run in runs], kind="stable")
    chosen = set(order[np.linspace(0, len(runs) - 1, count).round().astype(int)])
    shown = np.array([~np.isnan(run.outputs).all(axis=0) for run in runs])
    for sensor in shown.T:
        if sensor.any() and not sensor[list(chosen)].any():
            chosen.add(int(np.argmax(sensor)))
    return [runs[k] for k in sorted(chosen)]


def _second_differences(values: Array) -> Array:
    """Second differences of a sensor over their standard deviation for white noise of 1."""
    return np.diff(values[~np.isnan(values)], 2) / np.sqrt(6.0)


def _median_variance(runs: Sequence[Run], columns: Sequence[int], least: float) -> float:
    """Variance of the white noise of sensors; by medians, robust."""
    found = [
        float(np.median(np.abs(second)) ** 2 / 0.6745**2)
        for run in runs
        for c in columns
        for second in [_second_differences(run.outputs[:, c])]
        if second.size
    ]
    return max(float(np.median(found)), least) if found else least


def _quiet_variance(runs: Sequence[Run], columns: Sequence[int], least: float) -> float:
    """The same from where the sensors are quietest: motion has no part in it."""
    windows = []
    for run in runs:
        for c in columns:
            second = _second_differences(run.outputs[:, c])
            count = len(second) // WINDOW_ROWS
            windows.append(second[: count * WINDOW_ROWS].reshape(count, WINDOW_ROWS))
    variances = np.mean(np.concatenate(windows) ** 2, axis=1)
    return max(float(np.percentile(variances, QUIET)), least) if variances.size else least


def _resolution_variance(runs: Sequence[Run], columns: Sequence[int]) -> float:
    """Variance of rounding to the sensors' least step."""
    steps = np.concatenate([np.abs(np.diff(run.outputs[:, c])) for run in runs for c in columns])
    moved = steps[steps > 1e-9]
    return float(moved.min()) ** 2 / 12 if moved.size else 0.0


def _robot_start(runs: Sequence[Run]) -> Guess:
    sensors = [([GYRO], 1e-7), ([5, 6], 1e-8), ([HEADING], 1e-8)]
    if runs[0].outputs.shape[1] > SUPPLY:
        sensors += [([SUPPLY], 1e-5), (range(CURRENT.start, CURRENT.stop), 1e-4)]
    least = [max(floor, _resolution_variance(runs, columns)) for columns, floor in sensors]
    seen = [
        (_median_variance(runs, columns, floor), _quiet_variance(runs, columns, floor))
        for (columns, _), floor in zip(sensors, least, strict=True)
    ]
    moving, quiet = np.log(seen).T
    # A 1 N push on 20 kg for 20 ms at random; 1 % of a motor's stall acceleration likewise.
    # Times are written with 0.01 to 1 ms; commands are mostly held from row to row.
    # Half of the random force lasts from row to row, for some 10 ms.
    half = 0.5 * COLOUR_RATE_1_S
    pushes, rows = [100.0, 1e-3, 1e-2], [1e-9, 1.0]
    lasting = [100.0 * half, 1e-3 * half, 1e-2 * half, COLOUR_RATE_1_S, CONTACT_N2]
    logs = np.concatenate([np.log(pushes), moving[:3], np.log(rows + lasting), moving[3:]])
    low, high = logs - LEAST, np.full(len(logs), np.inf)
    places = [3, 4, 5, *range(CONTACT + 1, len(logs))]
    low[places] = np.minimum(quiet, moving) - SENSOR_MARGIN
    high[places] = moving + SENSOR_MARGIN
    low[COLOUR_RATE], high[COLOUR_RATE] = np.log(COLOUR_RATES_1_S)
    return Guess(logs, low, high)


def _robot_noise(machine: Machine, logs: Array) -> Noise:
    shaft, body, yaw, gyro, place, heading, timing, share, *rest = np.exp(logs)
    lasting_shaft, lasting_body, lasting_yaw, rate, contact, *electric = rest
    coloured = np.diag(np.repeat([lasting_shaft, lasting_body, lasting_yaw], [4, 2, 1]))
    coloured += contact * contact_forces(machine)
    process = np.zeros(14)
    process[SHAFT], process[BODY], process[YAW] = shaft, body, yaw
    output = np.empty(machine.engine.outputs)
    output[:4] = count_rad(machine) ** 2 / 12
    output[GYRO], output[POSE_XY], output[HEADING] = gyro, place, heading
    if electric:
        output[SUPPLY], output[CURRENT] = electric
    initial = first_variance(machine, SHAFT_VARIANCE, [0.02, 0.02, 0.05])
    unresolved = float(share) * stall_acceleration_rad_s2(machine) ** 2
    unresolved_current = float(share) * stall_current_a(machine) ** 2
    return Noise(
        process,
        output,
        initial,
        float(timing),
        unresolved,
        logs,
        unresolved_current,
        coloured,
        float(rate),
    )


def contact_forces(machine: Machine) -> Array:
    """Return the covariance (7, 7) of the disturbances by a force of 1 N at each wheel's contact.

    Along its drive direction: R / n turns the shaft back, H = J' of eq. (5) pushes the body.
    """
    values = machine.model.values
    mass_kg, inertia_kg_m2 = values["robot.mass_kg"], values["robot.inertia_kg_m2"]
    shaft_kg_m = values["motor.gear_ratio"] * values["motor.inertia_kg_m2"]
    body = wheel_jacobian(machine) / np.array([mass_kg, mass_kg, inertia_kg_m2])
    each = np.hstack([np.eye(4) * -values["robot.wheel_radius_m"] / shaft_kg_m, body])
    return each.T @ each


def _free(variances: Sequence[float]) -> Guess:
    """Guesses of variances that may become as large as they like."""
    logs = np.log(variances)
    return Guess(logs, logs - LEAST, np.full(len(logs), np.inf))


def _axis_start(runs: Sequence[Run]) -> Guess:
    place = _median_variance(runs, [0], 1e-18)
    step_s = runs[0].row_s
    # Speed that the noise of two positions would feign, gained within 50 rows.
    return _free([place / step_s**2 / (50 * step_s), place])


def _axis_noise(machine: Machine, logs: Array) -> Noise:
    push, place = np.exp(logs)
    process, output = np.array([push, 0.0]), np.array([place])
    return Noise(process, output, np.array([place * 1e6, place]), 0.0, 0.0, logs)


def _odometry_start(runs: Sequence[Run]) -> Guess:
    place = _median_variance(runs, [0, 1], 1e-10)
    heading = _median_variance(runs, [2], 1e-10)
    # A millimetre and a third of a degree gone astray in a second.
    return _free([1e-6, 3e-5, place, heading])


def _odometry_noise(machine: Machine, logs: Array) -> Noise:
    slip, turn, place, heading = np.exp(logs)
    process, output = np.array([slip, slip, turn]), np.array([place, place, heading])
    # Of where a robot begins and is turned to nothing is known but what the camera shows: whether
    # that is turned against the world, or the robot in its view, no log tells.
    return Noise(process, output, np.array([1e2, 1e2, 10.0]), 0.0, 0.0, logs)


NOISES = {
    "robot": (_robot_noise, _robot_start),
    "axis": (_axis_noise, _axis_start),
    "odometry": (_odometry_noise, _odometry_start),
}
"""Of each kind of machine: its noise from the logarithms, and those to start from."""
