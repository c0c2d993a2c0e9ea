"""Is what the filter takes for chance predictable?

A filter with noise to spare follows any log, and a gap that no known effect explains then passes
for noise. But chance cannot be predicted. The filter's disturbances (noise.py: one of each shaft,
of the body along x and y, of the yaw) are learned by boosted trees from everything that a missing
force may depend on: commands and how they changed, speeds, angles, place, time. A model learned on
other runs that explains a share of them in runs it has not seen has found something real:

    share = 1 - sum (d - d_predicted)^2 / sum d^2        over runs that were not learned from

It is zero or below where only chance is left. What holds chance must not predict it: speeds and
place are the filter's, corrected by the same measurements as the disturbances, and gave 15 % away
where a robot drove to and fro and they hardly varied. What was corrected in the last 30 ms,
longer than chance lasts, is therefore taken out of them: they are what the model made of the state
of then. In a closed loop commands answer chance too, and all is taken from then.

Nor does chance last. What bumps of the floor, sticky places or a ripple of the supply add need not
go with any of these, but it goes on for a tenth of a second and more, where chance has faded. So
the disturbances' own past is asked too, linearly. (Chance of a bandwidth of 10 Hz tells nothing of
itself after 60 ms, of 3 Hz a tenth, of 1.6 Hz 0.3, and after 120 ms the square of that: verdict.py
asks for more. A load that swings tells as much of itself after 120 ms, where it swings back. What
beats goes on where nothing else does, and a second of its past tells it out of as much chance.) But
a floor that is a little out of level pushes for as long as it takes to cross: of a force or moment
on the body the share is taken of no less than that (`UNEVEN_M_S2`).

Nor does what a driver makes of its command have to be smooth: a bridge that knows coarse steps of
duty pushes every way in turn, over steps that no tree resolves. So each shaft's disturbances are
asked, too, for any curve over its own command, in fine bins, beside what is linear in how that
command changed: for that is how a controller answers chance.

What sensors show besides need not move the robot: a supply that dips, a marker on a mast that
sways. Innovations of a sensor are white where nothing is missing, and tell at most 1 % of
themselves after 60 ms (or three readings of a slow one). They are asked for their own past, too,
but for what a clock that drifts and skips shows in all of them, and a camera for where in their
play gears are.

No term has to be guessed beforehand, so this finds hysteresis, products and thresholds too; it does
not say what they are (unknown.py tries to). Beside effects that explain nearly everything a small
rest may well be predictable, for no shape is exact: then the share is one of `REST` of the
disturbances without the effects, where that is more. Nor is any law of friction exact: what
friction is off by goes on as long as wheels slide, so the share is taken of no less than
`FRICTION_SHARE` of what friction does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from omnislip import _core
from omnislip.gap.answers import foreseen, lead_rows
from omnislip.gap.machine import CURRENT, LESS_GRIP, Machine
from omnislip.gap.noise import (
    BODY,
    DISTURBANCES,
    ENCODER,
    SHAFT,
    STAMP_S,
    YAW,
    Noise,
    stamp_slope,
    track_all,
)
from omnislip.gap.recordings import Run, wheel_jacobian
from omnislip.gap.side_by_side import side_by_side
from omnislip.log_file import POSE_COLUMNS

Array = npt.NDArray[np.float64]

EQUATIONS = (
    *(f"wheel/{wheel}/torque" for wheel in range(1, 5)),
    "body/force_x",
    "body/force_y",
    "body/moment",
)
BINS, BIN_ROWS, SINCE_S = 60, 5.0, 0.0075
"""Of a command, with as many rows each; rows of nothing by which each is held to none; and time
after which disturbances show what it did."""
ROW_S = 0.01
"""Disturbances last some 10 ms: rows nearer than that tell the same."""
FOLDS = 4
LEAST_RUNS = 3
OWN_PASTS_S = (
    (0.06, 0.09, 0.13, 0.18),
    (0.12, 0.15, 0.18, 0.24),
    tuple(np.arange(0.3, 1.3, 0.04).tolist()),
)
"""At the first of each most chance has faded, at the last what goes on for longer still shows. Of
the third nothing of it is left, and what beats goes on."""
BEAT_S = OWN_PASTS_S[2][0]
SENSOR_PAST_S, LEAST_READINGS = OWN_PASTS_S[0], 3
"""Own past of a sensor, and how many readings earlier it ends at least."""
MOVES_ROWS = np.array([-3, -2, -1, 1, 2, 3])
"""Rows before and after one whose command tells how it moves within that."""
REST = 0.2
SEEN = 1e-3
"""Share of the variance that the noise allows below which the filter saw no disturbances: what it
makes of rounded counts in a simulation is the same in every run of the same commands."""
FRICTION_SHARE = 1e-4
"""Square of how far friction may be off, its keys and curve fitted. Where its law was a double
exponential, disturbances were 0.4 % of friction and told 0.37 of themselves; a stuck roller's were
6 %, those of a driver that folds back as it warms 24 %."""
UNEVEN_M_S2 = 0.05
"""Acceleration by a floor that is 5 mm per metre out of level, as finished floors are: it lasts for
as long as it takes to cross, and is chance to anybody. (0.06 m/s2 that faded within some 0.2 s told
0.5 of themselves after 60 ms, 0.04 m/s2 0.3 in a robot that lacks nothing; what a wheel did that
lifts off told 0.16 m/s2.) What beats or swings back is no floor."""
STIRRED = 0.5
"""Share of what runs hold of the disturbances in the mean from which one has a vote."""
MOVED = np.r_[SHAFT, BODY, YAW]
"""States that the equations move."""
PAST_S = (0.005, 0.01, 0.02, 0.05)
TREES = {"max_iter": 50, "learning_rate": 0.1, "max_leaf_nodes": 8, "min_samples_leaf": 40}


@dataclass(frozen=True)
class Predictable:
    """Share of the disturbances of one equation, or of the innovations of one sensor, that is
    predicted, from their own past or from what the robot did, as learned on other runs, or parts of
    few (of a shaft also by a curve over its own command); in how many of these that is nearer than
    nothing, of those that hold enough of them: a hollow in the floor stirs the runs that come by.
    """

    equation: str
    from_own_past: bool
    ahead_s: float
    """By how long the own past is earlier; 0 of what the robot did."""
    share: float
    runs_helped: int
    runs: int
    by_own_command: bool = False


def predictable_shares(
    machine: Machine,
    runs: Sequence[Run],
    noise: Noise,
    values: Array,
    tracks: Sequence[_core.Track],
    without: Array,
    answers: bool,
) -> list[Predictable]:
    """Return the shares of each equation, largest first.

    `values` are those of the final model, `tracks` its filter's with their matrices, `without` are
    the values of the refitted model without effects; `answers` tells whether loops are closed. Only
    robots have disturbances. `runs` may be pieces; pieces of a log are learned together, or, of
    fewer than three logs, those of a unit: of each log a part, for chance fades within moments.
    Nothing where there are fewer than three of these, either.
    """
    if machine.kind != "robot":
        return []
    logs = [run.name for run in runs]
    if len(set(logs)) < LEAST_RUNS:
        logs = [run.unit for run in runs]
    names = list(dict.fromkeys(logs))
    if len(names) < LEAST_RUNS:
        return []
    features, driven, pasts, targets, there, friction, owners = [], [], [], [], [], [], []
    gear = float(machine.model.values["motor.gear_ratio"])
    after = _states(runs, tracks)
    unnamed = track_all(machine, runs, without, noise)
    before = _states(runs, unnamed)
    owned = [names.index(name) for name in logs]
    for run, track, state, unexplained, own in zip(runs, tracks, after, before, owned, strict=True):
        rows = _sparse_rows(run)
        seen = np.maximum(rows - lead_rows(run), 0) if answers else rows
        features.append(_features(run, state if answers else foreseen(run, track), gear)[seen])
        driven.append(_driven_by(run, rows))
        pasts.append([_own_past(run, state[:, DISTURBANCES], rows, s) for s in OWN_PASTS_S])
        targets.append(state[rows][:, DISTURBANCES])
        there.append(unexplained[rows][:, DISTURBANCES])
        friction.append(_friction(machine, values, state[rows], run.command[rows]))
        owners.append(np.full(len(rows), own))
    x, u, y, owner = (np.concatenate(each) for each in (features, driven, targets, owners))
    own_pasts = [np.concatenate(each) for each in zip(*pasts, strict=True)]
    least = REST * np.sum(np.concatenate(there) ** 2, axis=0)
    least = np.maximum(least, SEEN * np.diagonal(noise.coloured) * len(y))
    least = np.maximum(least, FRICTION_SHARE * np.sum(np.concatenate(friction) ** 2, axis=0))
    believed = machine.model.values
    lever_1_m = believed["robot.mass_kg"] / believed["robot.inertia_kg_m2"]
    lever_1_m *= believed["robot.wheel_distance_m"]
    uneven = len(y) * (UNEVEN_M_S2 * np.repeat([0.0, 1.0, lever_1_m], [4, 2, 1])) ** 2

    def shares_of(index: int) -> list[Predictable]:
        equation, target = EQUATIONS[index], y[:, index]
        asked = [(x, _by_trees, 0.0, least[index])]
        for past, (ahead_s, *_) in zip(own_pasts, OWN_PASTS_S, strict=True):
            fades = ahead_s < BEAT_S and target @ past[:, index, 0] > 0.0
            floors = uneven[index] if fades else 0.0
            asked.append((past[:, index], _by_line, ahead_s, max(least[index], floors)))
        if index < u.shape[1]:
            asked.append((u[:, index], _by_bins, 0.0, least[index]))
        return [
            _share(equation, target, owner, known, predicted, ahead_s, of_no_less)
            for known, predicted, ahead_s, of_no_less in asked
        ]

    shares = side_by_side(shares_of, range(len(EQUATIONS)))
    found = [one for own in shares for one in own]
    found += _of_sensors(runs, tracks, unnamed, owned, _within_play(machine, values))
    return sorted(found, key=lambda one: -one.share)


def _share(
    equation: str,
    target: Array,
    owner: npt.NDArray[np.int64],
    known: Array,
    predicted: Callable[[Array, Array, Array], Array],
    ahead_s: float,
    least: float,
    feigned: float = 0.0,
) -> Predictable:
    """Learn a target (rows,) from what is known (rows, features), log by log (`owner`, rows).

    Of what it tells, the variance `feigned` is no news.
    """
    logs = int(owner.max()) + 1
    whole = np.bincount(owner, target**2, minlength=logs)
    error = np.empty_like(target)
    for first in range(min(FOLDS, logs)):
        unseen = owner % FOLDS == first
        learned = predicted(known[~unseen], target[~unseen], known[unseen])
        error[unseen] = target[unseen] - learned
    left = np.bincount(owner, error**2, minlength=logs)
    told = whole.sum() - left.sum() - feigned * len(target)
    share = float(told / max(whole.sum(), least, 1e-300))
    stirred = whole >= STIRRED * whole.mean()
    helped, voters = int(np.sum(left[stirred] < whole[stirred])), int(stirred.sum())
    past, command = predicted is _by_line, predicted is _by_bins
    return Predictable(equation, past, ahead_s, share, helped, voters, command)


def _of_sensors(
    runs: Sequence[Run],
    tracks: Sequence[_core.Track],
    unnamed: Sequence[_core.Track],
    owned: Sequence[int],
    within_play: dict[str, float],
) -> list[Predictable]:
    """Return the share of each sensor's innovations that their own past tells.

    `tracks` are those of the final model with their matrices, `unnamed` of the one without effects.
    What the stamps of rows may be off by is taken out of the first, and where in its row a command
    is out of currents, though it is taken as held. `owned`: numbers of the logs.
    `within_play`: variance of what nothing tells, by channel, of those that show it.
    """
    found = []
    as_stamped = [_without_stamps(run, track) for run, track in zip(runs, tracks, strict=True)]
    for output, channel in enumerate(runs[0].channels):
        targets, pasts, owners, there = [], [], [], 0.0
        for run, white, before, own in zip(runs, as_stamped, unnamed, owned, strict=True):
            rows = np.flatnonzero(~np.isnan(run.outputs[:, output]) & (run.t_s >= run.settled_s))
            if len(rows) < 2:
                continue
            innovation = white[rows, output]
            if output >= CURRENT.start:
                wheel = output - CURRENT.start
                innovation = _without_moves(innovation, run.command[:, wheel], rows)
            unexplained = before.innovation.reshape(run.outputs.shape)[rows, output]
            t_s, interval_s = run.t_s[rows], float(np.median(np.diff(run.t_s[rows])))
            slower = max(1.0, LEAST_READINGS * interval_s / SENSOR_PAST_S[0])
            then_s = t_s[:, None] - slower * np.array(SENSOR_PAST_S)
            pasts.append(np.interp(then_s, t_s, innovation) * (then_s >= t_s[0]))
            targets.append(innovation)
            owners.append(np.full(len(rows), own))
            there += float(np.sum(unexplained**2))
        if len(np.unique(np.concatenate(owners or [[]]))) < LEAST_RUNS:
            continue
        target, past, owner = (np.concatenate(each) for each in (targets, pasts, owners))
        ahead_s = SENSOR_PAST_S[0]
        least, feigned = REST * there, within_play.get(channel, 0.0)
        found.append(_share(channel, target, owner, past, _by_line, ahead_s, least, feigned))
    return found


def _without_moves(innovation: Array, command: Array, rows: npt.NDArray[np.intp]) -> Array:
    """Innovations (rows,) of a current without what is linear in the command's changes (all rows,).

    A current is read at an instant, and where the command was then, within its row, no log has.
    """
    near = np.clip(rows[:, None] + MOVES_ROWS, 0, len(command) - 1)
    moves = command[near] - command[rows][:, None]
    return innovation - _by_line(moves, innovation, moves)


def _within_play(machine: Machine, values: Array) -> dict[str, float]:
    """Return the variance of each channel of the pose beside the shafts where gears have play.

    Where in its play p a gear is nothing tells, and it stays there for a while: a wheel is up to
    R p / 2 off, at either end of it, and the body by J+ of eq. (3).
    """
    play_rad = values[list(machine.place("gear_backlash", "angle_rad", None))]
    rim_m = 0.5 * float(machine.model.values["robot.wheel_radius_m"]) * play_rad
    along, across, turned = np.sum((np.linalg.pinv(wheel_jacobian(machine)) * rim_m) ** 2, axis=1)
    in_world = 0.5 * (along + across)
    return dict(zip(POSE_COLUMNS, (in_world, in_world, turned), strict=True))


def _without_stamps(run: Run, track: _core.Track) -> Array:
    """Innovations (rows, outputs) without what a late stamp of each row likely does to them.

    Clocks that drift and skip tell of themselves: all sensors are as much further on as they go in
    that time.
    """
    rows, outputs = run.outputs.shape
    sampled = ~np.isnan(run.outputs)
    innovation = np.where(sampled, track.innovation.reshape(rows, outputs), 0.0)
    late = stamp_slope(run.t_s, run.outputs, track)
    whitening = track.whitening.reshape(rows, outputs, outputs)
    white, white_late = (np.einsum("rij,rj->ri", whitening, each) for each in (innovation, late))
    told = np.sum(white_late**2, axis=1) + STAMP_S**-2
    late_s = np.sum(white_late * white, axis=1) / told
    return innovation - late_s[:, None] * late


def _friction(machine: Machine, values: Array, state: Array, command: Array) -> Array:
    """Return what friction along the drives does to the equations (rows, equations)."""
    here = np.ascontiguousarray(state[:, : machine.engine.states])
    rates = [
        machine.engine.derivatives(own, here, command)
        for own in (values, machine.with_less_grip(values))
    ]
    return (rates[0] - rates[1])[:, MOVED] / LESS_GRIP


def _own_past(
    run: Run, disturbances: Array, rows: npt.NDArray[np.int64], earlier_s: Sequence[float]
) -> Array:
    """Disturbances (rows, equations, lags) before `rows`; zero where the filter had not settled."""
    then_s = run.t_s[rows][:, None] - np.array(earlier_s)
    known = then_s >= run.settled_s
    past = [np.interp(then_s, run.t_s, column) * known for column in disturbances.T]
    return np.stack(past, axis=1)


def _by_line(x: Array, y: Array, unseen: Array) -> Array:
    return unseen @ np.linalg.lstsq(x, y, rcond=None)[0]


def _driven_by(run: Run, rows: npt.NDArray[np.intp]) -> Array:
    """Own command (rows, wheels, 1 + lags) that drove each shaft before `rows`, and its changes."""
    drove = run.t_s[rows] - SINCE_S
    earlier = [
        np.stack([column[_rows_at(run.t_s, drove - past_s)] for column in run.command.T], axis=1)
        for past_s in (0.0, *PAST_S)
    ]
    return np.stack([earlier[0], *(earlier[0] - past for past in earlier[1:])], axis=2)


def _rows_at(t_s: Array, times_s: Array) -> npt.NDArray[np.intp]:
    """Row that lasts at each time: its command holds until the next one."""
    return np.maximum(np.searchsorted(t_s, times_s, side="right") - 1, 0)


def _by_bins(x: Array, y: Array, unseen: Array) -> Array:
    """Return what a curve over the command x[:, 0] adds to what is linear in it and its changes."""
    edges = np.unique(np.quantile(x[:, 0], np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
    held = np.searchsorted(edges, x[:, 0])[:, None] == np.arange(len(edges) + 1)
    columns = np.hstack([x, held])
    square = columns.T @ columns
    square[np.diag_indices_from(square)] += np.r_[
        np.zeros(x.shape[1]), np.full(held.shape[1], BIN_ROWS)
    ]
    curve = np.linalg.lstsq(square, columns.T @ y, rcond=None)[0][x.shape[1] :]
    return curve[np.searchsorted(edges, unseen[:, 0])]


def _by_trees(x: Array, y: Array, unseen: Array) -> Array:
    """Return what trees that learned `y` (rows,) from `x` (rows, features) say of other rows.

    On one core: where another program has the second, threads that wait for each other at every
    leaf take a hundred times as long.
    """
    learned = HistGradientBoostingRegressor(**TREES, random_state=0)
    with threadpool_limits(1, user_api="openmp"):
        return learned.fit(x, y).predict(unseen)


def _states(runs: Sequence[Run], tracks: Sequence[_core.Track]) -> list[Array]:
    """Filtered states (rows, states) of each run."""
    return [t.state.reshape(len(run.t_s), -1) for run, t in zip(runs, tracks, strict=True)]


def _sparse_rows(run: Run) -> npt.NDArray[np.int64]:
    """Rows some `ROW_S` apart, after the filter has settled."""
    stride = max(1, round(ROW_S / run.row_s))
    first = int(np.searchsorted(run.t_s, run.settled_s))
    return run.log_rows[run.log_rows >= first][::stride]


def _features(run: Run, state: Array, gear: float) -> Array:
    """What a missing force may depend on (rows, features)."""
    command, time_s = run.command, run.time_s
    earlier = [
        np.stack([np.interp(time_s - past, time_s, column) for column in command.T], axis=1)
        for past in PAST_S
    ]
    angles = state[:, ENCODER]
    return np.concatenate(
        [
            command,
            *(command - past for past in earlier),
            state[:, SHAFT],
            *(wave(angle) for angle in (angles, angles / gear) for wave in (np.sin, np.cos)),
            state[:, 8:14],
            time_s[:, None],
        ],
        axis=1,
    )
