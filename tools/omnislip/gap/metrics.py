"""How wrong is the simulator: errors of replays on runs that were not fitted.

A replay starts from the filtered state, runs freely with the logged command for one second, and
starts again; its error is measured minus simulated. Per channel: RMSE of the believed model, of the
refitted one and of the one with the effects; beside them the noise floor, what chance alone would
leave. Runs count alike; the pieces of one that was cut are one run. The excess G = mean square
error - floor^2, in units of floor^2, averaged over channels; the closed fraction is
(G_refit - G_after) / G_refit, with an interval by bootstrap over runs. With fewer than
`LEAST_RUNS` it is over one-second windows: these hang together within a run, so that the interval
is rather too narrow.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, track_all
from omnislip.gap.recordings import Run, body_errors

Array = npt.NDArray[np.float64]

WINDOW_S = 1.0
BOOTSTRAPS, LEAST_RUNS = 2000, 3
LEAST_EXCESS = 0.5
"""Excess of the square error, in noise floors, that counts as something left."""
PREDICTED, REPEATED = "the predictor's noise", "repeated manoeuvres"
"""Where a noise floor comes from."""
OTHER_COMMANDS = 0.02
"""Mean square of what two commands differ by, over the sum of their variances, from which on they
are no repetition."""
OTHER_CHANCE = 100.0
"""Mean square by which two runs of the same commands differ, over that of the nearest quarter of
such pairs, from which on no chance does that: it is another robot, floor or load."""
OVERLAP, OUT_OF_STEP = 0.8, 0.1
"""Share of the shorter of two runs that both must hold, and share of a window by which their
restarts may be apart: the error of a replay depends on the time since its start."""


@dataclass(frozen=True)
class Replays:
    """Replay errors of one run: `errors` (models, rows, channels), NaN where not sampled."""

    run: Run
    errors: Array
    floor_variance: Array
    """(rows, channels) that the predictor's noise gives to a replay."""
    counted: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Closed:
    """Closed share of the gap with a 90 % interval; None when there is no gap to close or to judge.

    `over` says in words what was drawn anew for the interval; `gap` is what there is to close, the
    excess of the square error in floors.
    """

    value: float | None
    low: float | None
    high: float | None
    over: str | None = None
    gap: float = np.inf


@dataclass(frozen=True)
class Left:
    """Mean excess of the square error of the last model, in floors, and its standard error."""

    excess: float
    standard_error: float
    usual: float = 0.0
    """The same of the run that was fitted in which it is largest, beside a floor by the predictor's
    noise: that is one for all runs, and chance may be larger in some. 0 where the model leaves much
    of the runs that were fitted."""


@dataclass(frozen=True)
class GapTable:
    """RMSE per channel in the log's units: rows of `rmse` are the models, columns the channels."""

    channels: tuple[str, ...]
    rmse: Array
    floor: Array
    floor_source: str
    closed: Closed
    left: Left
    runs: tuple[str, ...]


def replay_all(
    machine: Machine, runs: Sequence[Run], noise: Noise, sets: Sequence[Array]
) -> list[Replays]:
    """Replay every parameter set over every run; each model's own filter finds its states."""
    columns = []
    for values in sets:
        tracks = track_all(machine, runs, values, noise, floor_window_s=WINDOW_S)
        errors = machine.engine.replays(
            [run.recording for run in runs], tracks, values[None], 1e-3, WINDOW_S
        )
        columns.append([(e[0], t) for e, t in zip(errors, tracks, strict=True)])
    replays = []
    for index, run in enumerate(runs):
        sampled = np.where(np.isnan(run.outputs), np.nan, 1.0)
        errors = np.stack([column[index][0] for column in columns]) * sampled * run.scale
        errors = body_errors(run, errors)
        last_track = columns[-1][index][1]
        floor = last_track.replay_variance.reshape(run.outputs.shape) * run.scale**2
        # The first restart is at the first row past the settling time; its error is the old one's.
        counted = run.t_s >= run.settled_s
        counted[np.argmax(counted)] = False
        replays.append(Replays(run, errors, floor, counted))
    return replays


def gap_table(replays: Sequence[Replays], others: Sequence[Replays] = ()) -> GapTable:
    """Summarise replays whose first three models are believed, refit and after.

    `others` are replays of the runs that were fitted: they may repeat a manoeuvre of those that
    count, and show what the model leaves where it was made.
    """
    run = replays[0].run
    seen = [c for c in range(len(run.channels)) if any(_sampled(r, c) for r in replays)]
    repetitions = _repetitions([*replays, *others])
    repeated = None if repetitions is None else _mean(repetitions, axis=0)
    estimated = _mean(np.stack([_mean_floor(pieces) for pieces in _by_run(replays)]), axis=0)
    floor = estimated if repeated is None else _repeated_floor(run, repeated, estimated)
    floor = floor[seen]
    source = PREDICTED if repeated is None else REPEATED
    rmse = np.sqrt(_mean(_run_moments(replays)[:, :, seen], axis=0))
    left = left_over(replays, seen, floor)
    if repeated is None:
        left = replace(left, usual=_usual_excess(others))
    else:
        # A floor from few seconds is as uncertain as they are.
        scatter = _standard_error(_mean(repetitions[:, seen] / floor, axis=1))
        error = float(np.hypot(left.standard_error, (1.0 + left.excess) * scatter))
        left = replace(left, standard_error=error)
    return GapTable(
        tuple(run.channels[c] for c in seen),
        rmse,
        np.sqrt(floor),
        source,
        closed_fraction(replays, seen, floor),
        left,
        tuple(r.run.name for r in replays),
    )


def _repeated_floor(run: Run, repeated: Array, estimated: Array) -> Array:
    """Floor of repeated manoeuvres; of currents it holds what their rows hide as well.

    A current is one moment's, the command a row's mean: that difference repeats too, and is chance
    to every model.
    """
    electric = np.array([channel.endswith("current_a") for channel in run.channels])
    floor = np.where(electric, np.fmax(repeated, estimated), repeated)
    return np.where(floor > 0, floor, estimated)


def left_over(replays: Sequence[Replays], seen: Sequence[int], floor: Array) -> Left:
    """Return the excess that the last model leaves, over the windows of one second."""
    windows = np.concatenate([_window_moments(r) for r in replays])[:, -1, seen]
    excess = _mean(windows / floor - 1.0, axis=1)
    return Left(float(np.nanmean(excess)), _standard_error(excess))


def _usual_excess(fitted: Sequence[Replays]) -> float:
    """Return the largest excess of the last model in one of the runs, if it explains most."""
    excess = []
    for pieces in _by_run([one for one in fitted if one.counted.any()]):
        own, floor = range(len(pieces[0].run.channels)), _mean_floor(pieces)
        excess.append(left_over(pieces, own, floor).excess)
    return max(0.0, *excess) if excess and np.mean(excess) < LEAST_EXCESS else 0.0


def _standard_error(samples: Array) -> float:
    """Return that of their mean; one sample does not tell."""
    samples = samples[~np.isnan(samples)]
    return float(np.std(samples) / np.sqrt(len(samples) - 1)) if len(samples) > 1 else np.inf


def improvement(replays: Sequence[Replays]) -> tuple[float, float]:
    """Return by how many noise floors the second model's square error is below the first's.

    Also the mean square, in floors, of what is between both models. Means over channels and windows
    of one second.
    """
    falls, between = [], []
    for one in replays:
        difference = replace(one, errors=one.errors[:1] - one.errors[1:2])
        floor = np.maximum(_mean_floor([one]), np.finfo(float).tiny)
        square = _window_moments(one) / floor
        falls.append(square[:, 0] - square[:, 1])
        between.append(_window_moments(difference)[:, 0] / floor)
    seen = any(np.any(~np.isnan(fall)) for fall in falls)
    fall, apart = (float(np.nanmean(np.concatenate(a))) if seen else 0.0 for a in (falls, between))
    return fall, apart


def channel_rmse(replays: Sequence[Replays]) -> dict[str, Array]:
    """Return RMSE (models,) of every sampled channel over all runs."""
    moments = _run_moments(replays)
    return {
        channel: np.sqrt(_mean(moments[:, :, c], axis=0))
        for c, channel in enumerate(replays[0].run.channels)
        if any(_sampled(r, c) for r in replays)
    }


def closed_fraction(replays: Sequence[Replays], seen: Sequence[int], floor: Array) -> Closed:
    """Return the closed share of the excess and its bootstrap interval."""
    units = _run_moments(replays)[:, :, seen]
    over = f"{len(units)} runs"
    if len(units) < LEAST_RUNS:
        runs = "1 run" if len(units) == 1 else over
        units = np.concatenate([_window_moments(r) for r in replays])[:, :, seen]
        over = f"{len(units)} windows of {WINDOW_S:g} s of {runs}"

    def excess_of(sample: Array) -> Array:
        # 1 is subtracted for the floor; channels count alike because each is in floors.
        return _mean(_mean(sample, axis=0) / floor - 1.0, axis=1)

    def share(sample: Array) -> float:
        excess = excess_of(sample)
        return float((excess[1] - excess[2]) / excess[1]) if excess[1] > 0.05 else np.nan

    value = share(units)
    if len(units) < 2 or not np.isfinite(value):  # one window has no scatter
        return Closed(None, None, None)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(units), (BOOTSTRAPS, len(units)))
    shares = [share(units[draw]) for draw in draws]
    finite = [s for s in shares if np.isfinite(s)]
    low, high = np.percentile(finite, [5, 95]) if finite else (value, value)
    return Closed(value, float(low), float(high), over, float(excess_of(units)[1]))


def _sampled(replays: Replays, channel: int) -> bool:
    return bool(np.any(~np.isnan(replays.errors[0][replays.counted, channel])))


def _by_run(replays: Sequence[Replays]) -> list[list[Replays]]:
    """Return the pieces of each run."""
    runs: dict[tuple[str, str], list[Replays]] = {}
    for one in replays:
        runs.setdefault((one.run.unit, one.run.name), []).append(one)
    return list(runs.values())


def _run_moments(replays: Sequence[Replays]) -> Array:
    """Mean square error of each run (runs, models, channels) over all of its pieces."""
    return np.stack(
        [
            _mean_square(np.concatenate([one.errors[:, one.counted] for one in pieces], axis=1))
            for pieces in _by_run(replays)
        ]
    )


def _mean_square(errors: Array) -> Array:
    """Mean square over the sampled rows of (models, rows, channels); NaN where there is none."""
    count = np.sum(~np.isnan(errors), axis=1)
    total = np.nansum(errors**2, axis=1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _mean(values: Array, axis: int) -> Array:
    """Mean of what is not NaN; NaN where there is nothing."""
    count = np.sum(~np.isnan(values), axis=axis)
    total = np.nansum(values, axis=axis)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _window_moments(replays: Replays) -> Array:
    """Mean square error of each one-second window (windows, models, channels).

    There is none in a piece that ends before a replay begins.
    """
    t_s = replays.run.t_s
    number = ((t_s - replays.run.settled_s) / WINDOW_S).astype(int)
    number[~replays.counted] = -1
    count = number.max() + 1
    moments = np.empty((count, len(replays.errors), replays.errors.shape[2]))
    for window in range(count):
        moments[window] = _mean_square(replays.errors[:, number == window])
    return moments


def _mean_floor(pieces: Sequence[Replays]) -> Array:
    """Mean floor variance (channels,) of the sampled rows; NaN where there is none."""
    variances = [
        np.where(np.isnan(one.errors[0]), np.nan, one.floor_variance)[one.counted] for one in pieces
    ]
    return _mean(np.concatenate(variances), axis=0)


def _repetitions(replays: Sequence[Replays]) -> Array | None:
    """Half the mean square difference of replay errors between runs of one manoeuvre.

    By windows of one second (windows, channels). The model's error is the same in both and cancels;
    what is left is chance. None where no window tells of it.
    """
    found = [
        _halved_difference(one, other)
        for one, other in combinations(replays, 2)
        if _repeats(one.run, other.run)
    ]
    found = [windows[(windows > 0).any(axis=1)] for windows in found]
    found = [windows for windows in found if len(windows)]  # copies of a log differ in nothing
    if not found:
        return None
    sizes = np.stack([_mean(windows, axis=0) for windows in found])
    near = np.array([np.percentile(np.nan_to_num(own), 25, method="lower") for own in sizes.T])
    alike = ~np.any((sizes > OTHER_CHANCE * near) & (near > 0), axis=1)
    return np.concatenate([windows for windows, same in zip(found, alike, strict=True) if same])


def _repeats(one: Run, other: Run) -> bool:
    """Whether two runs have the same commands at the same time, and their replays one rhythm."""
    begin, end = max(one.t_s[0], other.t_s[0]), min(one.t_s[-1], other.t_s[-1])
    apart = abs(one.t_s[0] - other.t_s[0]) / WINDOW_S
    if (
        end < OVERLAP * max(one.t_s[-1], other.t_s[-1])
        or end - begin < OVERLAP * min(one.duration_s, other.duration_s)
        or abs(apart - round(apart)) > OUT_OF_STEP
    ):
        return False
    grid = np.linspace(begin, end, 400)
    a, b = (
        np.stack([np.interp(grid, run.t_s, c) for c in run.command.T]).ravel()
        for run in (one, other)
    )
    if min(np.std(a), np.std(b)) == 0:
        return False
    return float(np.mean((a - b) ** 2)) < OTHER_COMMANDS * float(np.var(a) + np.var(b))


def _halved_difference(one: Replays, other: Replays) -> Array:
    """Mean squares (windows, channels) over the times when both were sampled."""
    difference = np.full((1, *one.errors.shape[1:]), np.nan)
    for channel in range(len(one.run.channels)):
        first, second = one.errors[-1][:, channel], other.errors[-1][:, channel]
        known = other.counted & ~np.isnan(second)
        there = one.counted & ~np.isnan(first)
        if min(np.sum(there), np.sum(known)) >= 10:
            t_s, known_s = one.run.t_s, other.run.t_s[known]
            there &= (t_s >= known_s[0]) & (t_s <= known_s[-1])
            again = np.interp(t_s[there], known_s, second[known])
            difference[0, there, channel] = first[there] - again
    return _window_moments(replace(one, errors=difference / np.sqrt(2.0)))[:, 0]
