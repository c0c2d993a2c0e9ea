"""Impacts: sudden jumps of the body's momentum, found before the structure search.

A push at row k adds a jump (dvx, dvy, dw) to the state. What it does to the whitened innovations of
the next tenth of a second is linear in the jump, with the matrices of the filter (leftover.py gives
the recursion). With S the response and r the innovations, the generalised likelihood ratio of
Willsky and Jones (1976) is

    g_k = b' A^-1 b,   A = sum S'S,   b = -sum S'r,   jump = A^-1 b

chi-squared with 3 degrees of freedom where nothing happened. A missing effect raises g everywhere,
so an impact has to stand out from the run's own level and to explain most of the error around it.

The linear jump is right for a tap. A hard push makes wheels slide, so the size is fitted again with
the plant itself: free-running from a state before the push, over a grid of times in the rows up to
it. Against the plant's own replay without a push it has to gain and to explain as much: where
wheels break loose the linear response feigns pushes that the plant does without. That replay may
take each jump of the commands beside the push up to a row earlier or later, for the mean of a row
does not tell when within it they jumped. In both replays each wheel may grip somewhat better or
worse than the model has it: how fast a wheel slides hangs on the last percents of its grip, and
its load and the floor under it change by some. Then the log is cut: what follows sees the pieces
before and after.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from omnislip import _core
from omnislip.gap.machine import LESS_GRIP, POSE_X, Machine, stall_current_a
from omnislip.gap.metrics import WINDOW_S
from omnislip.gap.noise import (
    ENCODER,
    STAMP_S,
    SUPPLY,
    Noise,
    run_free,
    stamp_slope,
    track_all,
    track_recordings,
)
from omnislip.gap.recordings import Run, rim_m_per_rad
from omnislip.gap.side_by_side import side_by_side
from omnislip.gap.within_rows import joined
from omnislip.log_file import Log
from omnislip.model_file import IMPACT_KEYS, Effect, Model

Array = npt.NDArray[np.float64]

HORIZON_S = 0.1
LEAST_RATIO = 60.0
"""g beyond which chance is out of the question (p = 6e-13; rows of an hour: 7e5)."""
OVER_LEVEL = 12.0
"""Factor by which g must exceed the 80th percentile of its run (4.6 where nothing is wrong)."""
EXPLAINED, HARD_EXPLAINED, HARD_M_S = 0.3, 0.15, 0.25
"""Share of the squared innovations of the horizon that the jump must take away; the second is
enough from so many m/s on, for after a hard push wheels slide, and the linear response is far off
(0.35 for a push of 0.32 m/s, less than 0.3 for one of 0.54). For light ones it would let through
what an unknown effect does."""
BY_FRICTION, MOST_OFF = 0.7, 0.15
"""Without a camera, share of g from which on friction that is off by so much at most explains what
a push would. Of 55 true pushes it explained 0.36 at most, of what a filter found out when wheels
gripped again 0.9 and more."""
REPLAYED = 0.88
"""Share of the squared errors of the plant's own replay. Beside believed models 151 replays near
pushes of 0.05 to 0.5 m/s explained 0.8 and more, all but two of them 0.9; of 167 of what wheels
feigned 35 less than this."""
GRIP, MOST_GRIP = 0.05, 3.0
"""Of the grip of a wheel in a moment: standard deviation as a share, and how many at most. Without
a camera grips are held: while wheels slide encoders cannot tell them from the robot's velocity."""
HOPEFUL = 0.6
"""The same share at one of every `COARSE` times, below which the others are not tried."""
LEAST_JUMP_M_S = 0.045
"""A seam in the floor or a wheel that spins up makes smaller jumps: no push to be named."""
MOST_JUMP_M_S = 2.5
COMMAND_JUMP = 0.1
"""Change of a duty from row to row after which wheels may break loose."""
MOST_MISFIT, ALONE, HARD_ALONE = 9.0, 0.95, 0.9
"""A jump that leaves errors three times their standard deviation is not what happened; unless it
explains such a share of a replay, the second if it is hard and a camera sees it: a push lasts some
10 ms, and while it does a robot that gains 0.3 m/s is 2 mm from where a jump has it, twice the
camera's noise (one left five times, one 4.5). By encoders alone wheels that slide feigned 0.948."""
LEAST_DEVIATIONS = 4.0
"""Of its size that a push must have. Those of 0.05 m/s had six by both axes together, what closed
loops feign two: by the size alone that is 8.5 and 2.8 where both axes are alike."""
APART_S = 0.3
REPEATED_S = 0.02
"""Difference of the times of what repeats in another run."""
DRIVEN, STIRRED, TURNED = 0.1, 0.05, 0.2
"""Duty with which a robot drives; by which it moves before a jump where the robot does something,
or before and just after, which may be an answer to a push."""
DRIVEN_ALIKE, PUSHED_ALIKE = 0.3, 0.5
"""Share of that movement by which commands differ that are alike; share of the larger by which
jumps do: in two drills of reversals 0.14 and 0.29 at most."""
LEAST_BETWEEN_S = 4.0
"""Mean time from push to push below which they are none."""
LOST_ROWS = 2
"""Rows missing together from which on the command there is not known well enough to tell a push:
a row's duty is said to hold until the next one, and may have been its own row's only."""
LEAST_ROWS = 3
"""By which a push is told at least."""
REPLAY_STEP_S = 1e-3
TIMES, SPAN_S, SPAN_ROWS, COARSE = 12, 0.024, 2, 4
"""How many times of a push are tried, over that span or so many rows up to the likeliest row."""
BEFORE_S, CUT_S = 0.01, 0.05
"""Left out before and after the time of a push: how early a light one may have been, and the
contact of the pusher."""
LEAST_PIECE_S = 1.0
VELOCITY, HEADING, POSE = slice(8, 11), 13, slice(POSE_X, POSE_X + 3)
MOTION = slice(0, SUPPLY)
"""Outputs that show how the robot moves, none of volts and amperes."""
PROBE = np.array([0.05, 0.05, 0.1])
WHEELS = 4
SIDESTEP = 0.01
"""Step of a slope of replay errors, as a share of `PROBE` and of the deviation of a grip."""
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
    time_deviation_s: float = 0.0
    misfit: float = 0.0
    """Mean square error after the push, in its standard deviations."""
    gain: float = np.inf
    """By how much the push lowers the squared errors of the plant's own replay, and the share of
    what is beyond chance."""
    explained: float = 1.0
    jump: Array = field(default_factory=lambda: np.zeros(3))
    """(m/s, m/s, rad/s), along the robot's axes"""
    seen: bool = True
    """Whether a camera saw it."""

    @property
    def confirmed(self) -> bool:
        """Whether the plant's own replay says that this happened."""
        shows_how_long = self.seen and float(np.hypot(*self.jump[:2])) >= HARD_M_S
        alone = HARD_ALONE if shows_how_long else ALONE
        fits = self.misfit <= MOST_MISFIT or self.explained >= alone
        return self.gain >= LEAST_RATIO and self.explained >= REPLAYED and fits

    def jump_m_s(self, machine: Machine) -> float:
        """Return the jump of a wheel's hub, at most, by what is known to a quarter of its size.

        By encoders alone a push that sets wheels sliding may be anything; a turn that comes with
        it is no reason to tell it.
        """
        push_n_s = _if_known(self.impulse[:2], self.deviation[:2])
        turn_n_m_s = _if_known(self.impulse[2:], self.deviation[2:])
        mass_kg, inertia_kg_m2, _, distance_m = machine.believed[:4]
        return float(push_n_s / mass_kg + turn_n_m_s / inertia_kg_m2 * distance_m)

    def near(self, other: "Impact") -> bool:
        """Whether both may be the same push, seen by two models."""
        return self.run == other.run and abs(self.time_s - other.time_s) < APART_S

    def just_after(self, other: "Impact") -> bool:
        """Whether wheels may still slide from the other one."""
        return self.run == other.run and 0.0 < self.time_s - other.time_s < APART_S

    def same_as(self, other: "Impact") -> bool:
        """Whether both are the same push, seen by one model."""
        return self.run == other.run and abs(self.time_s - other.time_s) < HORIZON_S


def _if_known(jump: Array, deviation: Array) -> float:
    """Return the size of a jump if that is known to a quarter, else 0.

    Of what is open across it the size has its square over twice the size.
    """
    size = float(np.linalg.norm(jump))
    along = float(np.sum((jump * deviation) ** 2)) / max(size, 1e-12) ** 2
    across = (float(np.sum(deviation**2)) - along) / (2.0 * max(size, 1e-12))
    return size if size > LEAST_DEVIATIONS * np.hypot(np.sqrt(along), across) else 0.0


def find_impacts(
    machine: Machine,
    runs: Sequence[Run],
    values: Array,
    noise: Noise,
    known: Sequence[Impact] = (),
) -> list[Impact]:
    """Return the impacts in the runs, by run and time.

    `known` ones were found beside another model, and are looked for from what they were there.
    """
    if machine.kind != "robot":
        return []
    found = side_by_side(lambda run: _impacts_in(machine, run, values, noise, known), runs)
    return without_repeated(runs, [impact for own in found for impact in own])


def _impacts_in(
    machine: Machine, run: Run, values: Array, noise: Noise, known: Sequence[Impact]
) -> list[Impact]:
    [track] = track_all(machine, [run], values, noise, keep_linear=True)
    filtered, impacts = track.state.reshape(len(run.t_s), -1), []
    pushes = Jumps(machine, run, track, known_s=_teeth_known_s(machine, run, filtered, values))
    ratio, jump, explained = pushes.ratios()
    level = float(np.percentile(ratio[pushes.first :], 80))
    threshold = max(LEAST_RATIO, OVER_LEVEL * level)
    rows = peaks(run.t_s, ratio, threshold, HORIZON_S + SPAN_S)
    highest = peaks(run.t_s, ratio, threshold)
    unseen = bool(np.isnan(run.outputs[:, POSE_X]).all())
    by_friction = np.zeros(len(run.t_s))
    if rows and unseen:
        by_friction = _by_friction(machine, run, values, noise, pushes)
    for peak in rows:
        pushed = bool(impacts) and run.t_s[peak] - impacts[-1].time_s < APART_S
        if peak not in highest and not pushed:
            continue  # what follows something else that is no push is none
        if explained[peak] >= HARD_EXPLAINED and by_friction[peak] < BY_FRICTION * ratio[peak]:
            behind_s = impacts[-1].time_s + HORIZON_S if impacts else -np.inf
            row = pushes.likeliest_row(peak, (ratio > threshold) & (run.t_s > behind_s))
            impact = _size_up(machine, run, row, values, noise, filtered, jump[row])
            if not impact.confirmed or run.t_s[row] - impact.time_s < SPAN_S / TIMES:
                # After a hard push, or in a long one, g may be largest at a row that foresees it.
                foreseen_s = run.t_s[row]
                for later_s in (SPAN_S / 2.0, SPAN_S):
                    behind = int(np.searchsorted(run.t_s[:-2], foreseen_s + later_s))
                    later = _size_up(machine, run, behind, values, noise, filtered, jump[behind])
                    confirms = later.confirmed and not impact.confirmed
                    if confirms or later.misfit < impact.misfit:
                        row, impact = behind, later
            elif impact.time_s < run.t_s[row] - SPAN_S * (1.0 - 2.0 / TIMES):
                begun = _begun(machine, run, pushes, peak, row, values, noise, filtered, unseen)
                if begun:
                    row = int(np.searchsorted(run.t_s, begun.time_s + SPAN_S / 2.0))
                    impact = _size_up(machine, run, row, values, noise, filtered, begun.jump, 1)
            least_m_s = LEAST_JUMP_M_S if explained[peak] >= EXPLAINED else HARD_M_S
            if _tells(machine, run, row, impact, values, least_m_s):
                impacts.append(impact)
    for one in known:
        # Along a better filter that knows of no hard push its linear response may point backwards.
        around = np.abs(run.t_s - one.time_s) < HORIZON_S
        shown = one.run == run.name and ratio[around].max(initial=0.0) > threshold
        if not shown or any(one.near(other) for other in impacts):
            continue
        row = int(np.searchsorted(run.t_s[:-2], one.time_s + SPAN_S / 2.0))
        impact = _size_up(machine, run, row, values, noise, filtered, one.jump, 1)
        if _tells(machine, run, row, impact, values, HARD_M_S):
            impacts.append(impact)
    impacts = [
        one
        for one in impacts
        if not any(
            _does_both(machine, run, other, one, values, noise, filtered) for other in impacts
        )
    ]
    told = list[Impact]()
    for one in sorted(impacts, key=lambda one: one.time_s):
        # Several peaks may show the same push.
        other = next((other for other in told if one.same_as(other)), None)
        if other is None:
            told.append(one)
        elif _likelier(machine, run, other, one, values, noise, filtered):
            told[told.index(other)] = one
    return told


def _tells(
    machine: Machine, run: Run, row: int, impact: Impact, values: Array, least_m_s: float
) -> bool:
    """Whether an impact is confirmed, and larger than commands feign and than so many m/s."""
    least_m_s = max(least_m_s, _feigned_m_s(machine, run, row, values))
    return impact.confirmed and least_m_s <= impact.jump_m_s(machine) <= MOST_JUMP_M_S


def _teeth_known_s(machine: Machine, run: Run, filtered: Array, values: Array) -> float:
    """Return the time from which on it is known where in its play each gear is.

    A log does not tell where it begins, until each shaft has turned by all of its play once. Teeth
    that meet sooner or later than a replay has them start the robot as a push would: one of 0.13
    m/s was told so, another of 0.16 m/s.
    """
    play_rad = values[machine.place("gear_backlash", "angle_rad", None)[0]]
    if play_rad <= 0.0:
        return -np.inf
    turned_rad = np.abs(filtered[:, ENCODER] - filtered[0, ENCODER])
    crossed = turned_rad > machine.model.values["motor.gear_ratio"] * play_rad
    known = np.maximum.accumulate(crossed).all(axis=1)
    first = int(np.argmax(known)) if known.any() else -1
    return float(run.t_s[first]) + HORIZON_S


def _by_friction(machine: Machine, run: Run, values: Array, noise: Noise, pushes: "Jumps") -> Array:
    """Return what friction of another size explains of the horizon from each row on, as g (rows,).

    While wheels slide only friction tells how the robot goes if no camera does. A filter that has
    it a little wrong finds out all at once where they grip, as after a push.
    """
    less = machine.with_less_grip(values)
    [track] = track_all(machine, [run], less, noise, keep_linear=True)
    change = (Jumps(machine, run, track).white - pushes.white) / LESS_GRIP
    both, own = np.sum(change * pushes.white, axis=1), np.sum(change**2, axis=1)
    ahead = np.ones(pushes.horizon)
    both, own = (np.convolve(part, ahead)[pushes.horizon - 1 :] for part in (both, own))
    share = np.clip(-both / np.maximum(own, 1e-12), -MOST_OFF, MOST_OFF)
    return np.nan_to_num(-share * (2.0 * both + share * own))  # that filter may lose the robot


def shows(machine: Machine, run: Run, push: Impact, values: Array, noise: Noise) -> bool:
    """Whether a push stands out from chance, at its time, in a run that begins shortly before it.

    There may be no time for the filter to settle, and none to know the level of the run.
    """
    [track] = track_all(machine, [run], values, noise, keep_linear=True)
    ratio, *_ = Jumps(machine, run, track).ratios(first_row=1)
    near = np.abs(run.t_s - push.time_s) <= max(SPAN_S, SPAN_ROWS * run.row_s)
    return bool(ratio[near].max(initial=0.0) > LEAST_RATIO)


def _does_both(
    machine: Machine,
    run: Run,
    push: Impact,
    later: Impact,
    values: Array,
    noise: Noise,
    filtered: Array,
) -> bool:
    """Whether a push alone explains what follows as well as what a later one was told for.

    Where wheels slide the filter may find out long after a push how the robot goes since.
    """
    if not later.just_after(push):
        return False
    between_s = later.time_s - push.time_s
    row = int(np.searchsorted(run.t_s, push.time_s))
    window = _Window(machine, run, row, values, noise, filtered, between_s + HORIZON_S)
    alone = min(fit.cost for fit in _fit_jumps(window, window.times_s[::-1], push.jump))
    return alone - min(push.misfit, later.misfit) * window.readings < LEAST_RATIO


def _likelier(
    machine: Machine,
    run: Run,
    push: Impact,
    other: Impact,
    values: Array,
    noise: Noise,
    filtered: Array,
) -> bool:
    """Whether the other one of two that are the same push is where it was.

    By the plant's own replay from before both: behind a push a filter without one is so far off
    that a later one gains more (6,900 by one 65 ms late; 1,600 where it was).
    """
    first, last = sorted((push, other), key=lambda one: one.time_s)
    between_s = last.time_s - first.time_s
    if between_s < SPAN_S:
        return other.gain > push.gain
    rows = [int(np.searchsorted(run.t_s, one.time_s)) for one in (first, last)]
    window = _Window(machine, run, rows[0], values, noise, filtered, between_s + HORIZON_S, rows[1])
    fits = _fit_jumps(window, window.times_s[::-1], last.jump)
    best_s = min(fits, key=lambda fit: fit.cost).time_s
    return abs(best_s - other.time_s) < abs(best_s - push.time_s)


def without_repeated(runs: Sequence[Run], impacts: Sequence[Impact]) -> list[Impact]:
    """Return the pushes that no other run has at the same time of the same commands.

    Nor that is alike wherever the commands move so, or the other way round. Nobody pushes so; it is
    what the robot does there by itself. Where every run of a simulated scenario has the same push,
    it is refused too.
    """
    commands = [_commands_before(runs, push) for push in impacts]
    around = [_commands_before(runs, push, SPAN_ROWS) for push in impacts]
    pushes = list(zip(impacts, commands, around, strict=True))
    return [one[0] for one in pushes if not any(_repeats(one, other) for other in pushes)]


def beside_lost_rows(log: Log, time_s: float) -> bool:
    """Whether rows are missing where a push seems to begin: what was commanded there is unknown."""
    lost = log.rows_missing(LOST_ROWS)
    begins, ends = log.t_s[:-1][lost] - log.row_s, log.t_s[1:][lost] + log.row_s
    return bool(np.any((begins <= time_s) & (time_s <= ends)))


def too_often(runs: Sequence[Run], impacts: Sequence[Impact]) -> bool:
    """Whether there are more jumps of velocity than anybody pushes: the floor does that."""
    duration_s = sum(float(run.t_s[-1] - run.t_s[0]) for run in runs)
    return len(impacts) * LEAST_BETWEEN_S > max(duration_s, LEAST_BETWEEN_S)


def _repeats(pushed: tuple[Impact, Array, Array], pushed_too: tuple[Impact, Array, Array]) -> bool:
    """Whether a push is as another one, each with the commands before it and around it."""
    (one, own, own_around), (other, others, others_around) = pushed, pushed_too
    if one is other:
        return False
    if one.run != other.run and abs(one.time_s - other.time_s) <= REPEATED_S:
        return bool(np.abs(own - others).max() < COMMAND_JUMP)
    # Where a command jumps within the row it comes just after what it feigns.
    driven, stirred = np.abs(own).max() >= DRIVEN, np.ptp(own, axis=0).max() >= STIRRED
    moved = np.ptp(own_around, axis=0).max()
    if not driven or not (stirred or moved >= TURNED):
        return False
    jump, jump_of_other = one.jump / PROBE, other.jump / PROBE
    most = PUSHED_ALIKE * max(np.linalg.norm(jump), np.linalg.norm(jump_of_other))
    return any(
        np.abs(own_around - way * others_around).max() < DRIVEN_ALIKE * moved
        and np.linalg.norm(jump - way * jump_of_other) < most
        for way in (1.0, -1.0)
    )


def run_around(runs: Sequence[Run], push: Impact) -> Run:
    """Return the run in which a push is; a log may be in several."""
    return next(r for r in runs if r.name == push.run and r.t_s[0] <= push.time_s <= r.t_s[-1])


def _commands_before(runs: Sequence[Run], push: Impact, rows_after: int = 0) -> Array:
    """Commands (times, 4) in the horizon before a push, and in some rows after it."""
    run = run_around(runs, push)
    time_s = push.time_s - np.linspace(-rows_after * run.row_s, HORIZON_S, TIMES)
    return np.stack([np.interp(time_s, run.t_s, column) for column in run.command.T], axis=1)


def _feigned_m_s(machine: Machine, run: Run, row: int, model: Array) -> float:
    """Return the jump of the body that jumps of the command before and beside the row may feign.

    When within a row wheels break loose or grip again the log does not tell: for up to a row on
    either side of a jump the body is pulled with mu g, or is not; by a small jump with what it
    changes of the motors' pull, and by as much again that the wheels take up and give back. The
    times of jumps in several rows are independent, so they add in squares. What earlier jumps of
    the horizon left shows no later than where the wheels grip. Jumps after the row may answer the
    push. Drivers that brake only under a reversed command switch where it changes its sign within a
    row, and what then slides may do so to the end of the next.
    """
    values = machine.model.values
    slide_m_s2 = 2.0 * values["contact.mu_drive"] * values["contact.gravity_m_s2"]
    rows_s = np.diff(run.t_s, append=run.t_s[-1])
    into = np.abs(np.diff(run.command, axis=0, prepend=run.command[:1]))
    out_of = np.abs(np.diff(run.command, axis=0, append=run.command[-1:]))
    jumps = into.max(axis=1) > COMMAND_JUMP
    pull_m_s2 = np.minimum(slide_m_s2, 2.0 * _stall_m_s2(machine) * into.mean(axis=1))
    pull_m_s2[~jumps] = 0.0
    beside = slice(max(row - 1, 0), row + 3)
    before = slice(int(np.searchsorted(run.t_s, run.t_s[row] - HORIZON_S)), beside.start)
    feigned_m_s = float(np.linalg.norm(rows_s[before] * pull_m_s2[before]))
    feigned_m_s += float(rows_s[beside].max() * pull_m_s2[beside].max())
    if model[machine.place("driver_freewheel", "braking_fraction", None)[0]] != 1.0:
        most = np.maximum(into, out_of)
        switches = np.any((np.abs(run.command) <= 0.5 * most) & (most > 0.0), axis=1)
        sliding = switches.copy()
        sliding[1:] |= switches[:-1]
        near = slice(before.start, beside.stop)
        beyond_m_s = rows_s * (slide_m_s2 - pull_m_s2)
        feigned_m_s += float(np.sum(beyond_m_s[near][sliding[near]]))
    return feigned_m_s


def _stall_m_s2(machine: Machine) -> float:
    """Return how fast the motors would start the body at full duty if all pulled one way."""
    values = machine.model.values
    shaft_nm = stall_current_a(machine) * values["motor.torque_constant_nm_a"]
    return 4.0 * shaft_nm / rim_m_per_rad(machine) / values["robot.mass_kg"]


def as_effect(impact: Impact) -> Effect:
    """Return the impact as it stands in a model file."""
    numbers = dict(zip(IMPACT_KEYS, (impact.time_s, *impact.impulse.tolist()), strict=True))
    return Effect("impact", numbers, run=impact.run)


def known_pushes(model: Model, logs: Sequence[Log]) -> list[tuple[str, float]]:
    """Return log and time of the impacts that a model file names.

    A name without folders means every log of that file name.
    """
    return [
        (log.name, effect.parameters["time_s"])
        for effect in model.effects
        if effect.name == "impact"
        for log in logs
        if f"/{log.name}".endswith(f"/{effect.run}")
    ]


def pieces(log: Log, pushes: Sequence[tuple[str, float]]) -> list[tuple[int, int]]:
    """Return the row ranges between the pushes (run, time) of a log that are long enough to use."""
    edges = [0]
    for time_s in sorted(time_s for run, time_s in pushes if run == log.name):
        edges += [int(np.searchsorted(log.t_s, t)) for t in (time_s - BEFORE_S, time_s + CUT_S)]
    edges.append(len(log.t_s))
    ranges = list(zip(edges[::2], edges[1::2], strict=True))
    return [(a, b) for a, b in ranges if b > a and log.t_s[b - 1] - log.t_s[a] > LEAST_PIECE_S]


def _begun(
    machine: Machine,
    run: Run,
    pushes: "Jumps",
    peak: int,
    row: int,
    values: Array,
    noise: Noise,
    filtered: Array,
    unseen: bool,
) -> "_JumpFit | None":
    """Return the jump of a push long before the row where it shows, if that explains more.

    Encoders do not tell how a robot goes whose wheels slide: a filter without a push finds out
    where they grip, or from the camera where it is, and the linear response takes the push for one
    there (one of 0.25 m/s, 45 ms later, as a turn; one of 0.12 m/s 26 ms later beside a camera). So
    times before the row, back to where the state is known, are compared by the plant's own replay,
    all over the rows that g of the `peak` looks at; from the earliest on, for what is left of a
    push has to be large. What replays are off by less than expected, all of them are.
    """
    back_s = APART_S if unseen else HORIZON_S
    first = max(pushes.earliest, int(np.searchsorted(run.t_s, run.t_s[row] - back_s)))
    end = min(peak + pushes.horizon, len(run.t_s) - 1)
    ahead_s = float(run.t_s[end] - run.t_s[first])
    window = _Window(machine, run, first, values, noise, filtered, ahead_s, row)
    fits = _fit_jumps(window, window.times_s, np.zeros(3))
    best = min(fits, key=lambda fit: fit.cost)
    before = run.t_s[row] - best.time_s > SPAN_S
    least = LEAST_RATIO * min(best.cost / window.readings, 1.0)
    return best if before and fits[-1].cost - best.cost > least else None


def _size_up(
    machine: Machine,
    run: Run,
    row: int,
    values: Array,
    noise: Noise,
    filtered: Array,
    jump: Array,
    way: int = -1,
) -> Impact:
    """Fit the jump with the plant for times around the row, all judged by the same rows.

    A light push leaves open to some milliseconds when it was, and at another time it would have
    been of another size. Time and size are means over the times, weighted by their likelihood;
    the deviations hold what the fit at one time leaves open and how the times differ. What the
    same replay is off by just before, though not more than the filter expects, is chance that no
    push has to explain. `way`: -1 where the jump is one of the row, 1 where it is one before it.
    """
    window = _Window(machine, run, row, values, noise, filtered)
    earlier = int(np.searchsorted(run.t_s, run.t_s[row] - HORIZON_S - SPAN_S))
    before = _Window(machine, run, max(earlier, 1), values, noise, filtered)
    chance = min(before.quiet / before.readings, 1.0) * window.readings
    fits = _fit_jumps(window, window.times_s[:: way * COARSE], jump)
    if _explained(window.quiet, fits, chance) >= HOPEFUL:
        others = [t for t in window.times_s[::way] if t not in {fit.time_s for fit in fits}]
        fits += _fit_jumps(window, others, min(fits, key=lambda fit: fit.cost).jump)
    least = min(fit.cost for fit in fits)
    misfit = least / window.readings
    spread = max(1.0, misfit)
    weight = np.exp(-0.5 * (np.array([fit.cost for fit in fits]) - least) / spread)
    weight /= np.sum(weight)
    mass, inertia, _ = machine.inertias(values)
    maps = [np.diag([mass, mass, inertia]) @ window.to_world(fit.time_s) for fit in fits]
    impulses = np.array([m @ fit.jump for m, fit in zip(maps, fits, strict=True)])
    variances = [
        np.diag(m @ (fit.covariance * spread) @ m.T) for m, fit in zip(maps, fits, strict=True)
    ]
    times = np.array([fit.time_s for fit in fits])
    impulse, time_s = weight @ impulses, float(weight @ times)
    jumped = weight @ np.array([fit.jump for fit in fits])
    deviation = np.sqrt(weight @ (np.array(variances) + (impulses - impulse) ** 2))
    time_deviation = float(np.sqrt(weight @ (times - time_s) ** 2 + window.grid_s**2 / 12.0))
    quiet = window.least_without_push()
    gain, explained = quiet - least, _explained(quiet, fits, chance)
    return Impact(
        run.name,
        time_s,
        impulse,
        deviation,
        time_deviation,
        misfit,
        gain,
        explained,
        jumped,
        window.seen,
    )


@dataclass(frozen=True)
class _JumpFit:
    """The jump (m/s, m/s, rad/s; body frame) that fits best at one time; cost in variances."""

    time_s: float
    jump: Array
    covariance: Array
    cost: float


class _Window:
    """The rows around a push as whitened replay errors that depend on its time and jump.

    Its times are those up to the row, or to a last one after it. The plant runs free from the
    filtered state before the earliest of them. What a late camera shows of before that is not
    known, and what it shows of before a push is as without it. Grips (wheels,) are in deviations,
    `GRIP`, from the model's and count as readings of their own. Commands are held within rows: over
    so few rows what they do there is little beside the noise of a replay. What a row's stamp may be
    off by, all its sensors are on by as far as they go in that time: errors are whitened against
    that, too. With d what they go in a standard deviation of the stamp, (I + d d')^-1/2 takes a
    share 1 - 1 / sqrt(1 + d'd) of the errors along d away. Volts and amperes are not looked at:
    they show where in its row a command is, and so errors that no push explains.
    """

    def __init__(
        self,
        machine: Machine,
        run: Run,
        row: int,
        values: Array,
        noise: Noise,
        filtered: Array,
        horizon_s: float = HORIZON_S,
        last: int | None = None,
    ) -> None:
        earliest_s = min(run.t_s[row] - SPAN_S, run.t_s[max(row - SPAN_ROWS, 0)])
        first = max(int(np.searchsorted(run.t_s, earliest_s, side="right")), 1)
        end = int(np.searchsorted(run.t_s, run.t_s[row] + horizon_s)) + 1
        self._machine, self._values = machine, values
        self._noise = replace(noise, initial=STATE_VARIANCE)
        self._t_s = run.t_s[first - 1 : end]
        self._command = run.command[first - 1 : end]
        self._outputs = run.outputs[first - 1 : end].copy()
        self._outputs[0] = np.nan
        self._outputs[:, SUPPLY:] = np.nan
        self._shown_s = machine.shown_s(values, self._t_s)
        self._outputs[self._shown_s < self._t_s[0], POSE] = np.nan
        self._start = filtered[first - 1][: machine.engine.states]
        calm = self._recording(self._t_s, self._command, self._outputs, self._start)
        track = self._track(calm, keep_linear=True)
        self._tracks = dict[int, _core.Track]()
        """Of so many rows."""
        self._weight = 1.0 / np.sqrt(track.replay_variance.reshape(self._outputs.shape))
        self._late = STAMP_S * stamp_slope(self._t_s, self._outputs, track) * self._weight
        self.seen = not np.isnan(self._outputs[:, POSE_X]).all()
        self._grip = GRIP if self.seen else 0.0
        [self._calm_errors] = self._replayed(calm, values[None])
        self._calm = self._whitened(self._calm_errors, 0)
        latest_s = run.t_s[row if last is None else last]
        edges_s = np.linspace(max(earliest_s, self._t_s[0]), latest_s, TIMES + 1)
        self.times_s = (0.5 * (edges_s[1:] + edges_s[:-1])).tolist()
        self._row = row + 1 - first
        self._parted = run.jumped[(run.jumped >= first) & (run.jumped < end - 1)] + 1 - first
        self.quiet = float(np.nansum(self._calm**2))
        self.readings = max(np.count_nonzero(~np.isnan(self._outputs)), 1)
        self.grid_s = float(edges_s[1] - edges_s[0])

    def least_without_push(self) -> float:
        """Return the least square of the replay errors without a push, at the likeliest grips.

        And commands jump when it is likeliest: each jump beside the push up to a row earlier or
        later, in rows that were parted at jumps of the command as they are or with the mean of the
        log's row.
        """
        least = self._least_by(self._command)
        if not self._parted.size:
            return least
        return min(least, self._least_by(joined(self._t_s, self._command, self._parted)))

    def _least_by(self, command: Array) -> float:
        change = np.diff(command, axis=0, prepend=command[:1])
        beside = np.arange(max(self._row - SPAN_ROWS, 1), min(self._row + 3, len(command) - 1))
        jumps = beside[np.abs(change[beside]).max(axis=1, initial=0.0) > COMMAND_JUMP]

        def errors(free: Array) -> Array:
            grips, earlier = free[:WHEELS], free[WHEELS:]
            moved = command.copy()
            for k, share in zip(jumps, earlier, strict=True):
                moved[k - 1 if share > 0.0 else k] += share * change[k]
            recording = self._recording(
                self._t_s, np.clip(moved, -1.0, 1.0), self._outputs, self._start
            )
            [own] = self._replayed(recording, self._gripping(grips[None]))
            return np.append(np.nan_to_num(self._whitened(own, 0)), grips)

        most = np.append(np.full(WHEELS, MOST_GRIP), np.ones(jumps.size))
        found = least_squares(
            errors,
            np.zeros(most.size),
            bounds=(-most, most),
            diff_step=1e-2,
            ftol=1e-3,
            max_nfev=15,
        )
        return 2.0 * float(found.cost)

    def errors(self, time_s: float, free: Array) -> Array:
        """Replay errors (rows * outputs + wheels,) in their standard deviations.

        0 where not sampled. `free` are the jump (m/s, m/s, rad/s) and the grips.
        """
        [errors] = self._pushed(time_s, free[:3], free[None, 3:])
        return errors

    def slopes(self, time_s: float, free: Array) -> Array:
        """Return the slopes (rows * outputs + wheels, 3 + wheels) of `errors`."""
        jump, grips = free[:3], free[3:]
        steps = SIDESTEP * PROBE
        beside = grips + np.vstack([np.zeros(WHEELS), SIDESTEP * np.eye(WHEELS)])
        own, *by_grip = self._pushed(time_s, jump, beside)
        by_jump = [self.errors(time_s, np.append(moved, grips)) for moved in jump + np.diag(steps)]
        change = np.array([*by_jump, *by_grip]) - own
        return change.T / np.append(steps, np.full(WHEELS, SIDESTEP))

    def _pushed(self, time_s: float, jump: Array, grips: Array) -> list[Array]:
        """Return the replay errors after a jump, one for each of some grips (sets, wheels)."""
        row = int(np.searchsorted(self._t_s, time_s, side="right")) - 1
        state = self._states[time_s].copy()
        state[VELOCITY] += jump
        blank = np.full((1, self._outputs.shape[1]), np.nan)
        recording = self._recording(
            np.concatenate([[time_s], self._t_s[row + 1 :]]),
            self._command[row:],
            np.concatenate([blank, self._outputs[row + 1 :]]),
            state,
        )
        before = self._shown_s[row + 1 :] < time_s
        pushed = []
        for errors, own in zip(
            self._replayed(recording, self._gripping(grips)), grips, strict=True
        ):
            after = errors[1:]
            after[before, POSE] = self._calm_errors[row + 1 :][before, POSE]
            white = np.concatenate([self._calm[: row + 1], self._whitened(after, row + 1)])
            pushed.append(np.append(np.nan_to_num(white), own))
        return pushed

    def _gripping(self, grips: Array) -> Array:
        """Return the flat sets (sets, parameters) of floors with some grips (sets, wheels)."""
        return self._machine.with_grips(self._values, 1.0 + self._grip * grips)

    def to_world(self, time_s: float) -> Array:
        """Return the rotation from the body to the world at a time."""
        heading_rad = self._states[time_s][HEADING]
        cos, sin = np.cos(heading_rad), np.sin(heading_rad)
        return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])

    @cached_property
    def _states(self) -> dict[float, Array]:
        """States at the times to try, without a push."""
        t_s = np.union1d(self._t_s, self.times_s)
        row = np.searchsorted(self._t_s, t_s, side="right") - 1
        states = run_free(
            self._machine,
            t_s,
            self._command[row],
            self._start,
            self._values,
            self._noise,
            REPLAY_STEP_S,
        )
        at = np.searchsorted(t_s, self.times_s)
        return dict(zip(self.times_s, states[at, : self._machine.engine.states], strict=True))

    def _recording(self, *recorded: Array) -> _core.Recording:
        """Make a recording that replays run free to the end of."""
        return self._machine.recording(*recorded, settle_s=np.inf)

    def _replayed(self, recording: _core.Recording, sets: Array) -> Array:
        """Return the replay errors (sets, rows, outputs) by some flat sets."""
        rows = recording.rows
        if rows not in self._tracks:  # what runs free follows no filter: any will do
            self._tracks[rows] = self._track(recording)
        [errors] = self._machine.engine.replays(
            [recording], [self._tracks[rows]], sets, REPLAY_STEP_S, WINDOW_S
        )
        return errors

    def _whitened(self, errors: Array, first: int) -> Array:
        """Errors of rows from `first` on in their standard deviations, whatever their stamps."""
        white, late = errors * self._weight[first:], self._late[first:]
        square = np.sum(late**2, axis=1)
        share = (1.0 - 1.0 / np.sqrt(1.0 + square)) / np.maximum(square, 1e-12)
        along = share * np.nansum(late * white, axis=1)
        return white - along[:, None] * late

    def _track(self, recording: _core.Recording, keep_linear: bool = False) -> _core.Track:
        return track_recordings(
            self._machine,
            [recording],
            self._values,
            self._noise,
            REPLAY_STEP_S,
            keep_linear=keep_linear,
            floor_window_s=WINDOW_S,
        )[0]


def _fit_jumps(window: _Window, times_s: Sequence[float], jump: Array) -> list[_JumpFit]:
    """Fit the jump at each time, from the fit at the time before; costs to a tenth of a percent."""
    fits = []
    free = np.append(jump, np.zeros(WHEELS))
    most = np.append(np.full(3, np.inf), np.full(WHEELS, MOST_GRIP))
    for time_s in times_s:
        found = least_squares(
            partial(window.errors, time_s),
            free,
            jac=partial(window.slopes, time_s),
            bounds=(-most, most),
            x_scale=np.append(PROBE, np.ones(WHEELS)),
            ftol=1e-3,
            xtol=1e-3,
            max_nfev=15,
        )
        free, covariance = found.x, np.linalg.pinv(found.jac.T @ found.jac)[:3, :3]
        fits.append(_JumpFit(time_s, free[:3], covariance, 2.0 * found.cost))
    return fits


def _explained(quiet: float, fits: Sequence[_JumpFit], chance: float) -> float:
    """Return the share of the error beyond chance that the best of the jumps takes away."""
    gain = quiet - min(fit.cost for fit in fits)
    return gain / max(quiet - chance, gain) if gain > 0.0 else 0.0


class Jumps:
    """What jumps of some states before each row of a run would do to its whitened innovations.

    By default of the body's velocity, as a push makes, to those of counts, gyro and camera: volts
    and amperes show where in its row a command is. None before a state that is known from `known_s`
    on.
    """

    def __init__(
        self,
        machine: Machine,
        run: Run,
        track: _core.Track,
        jumped: slice = VELOCITY,
        horizon_s: float = HORIZON_S,
        outputs: slice = MOTION,
        known_s: float = -np.inf,
    ) -> None:
        n, m, rows = track.filter_states, machine.engine.outputs, len(run.t_s)
        sampled = ~np.isnan(run.outputs)
        slope = np.where(sampled[:, :, None], track.slope.reshape(rows, m, n), 0.0)
        gain, whitening = track.gain.reshape(rows, n, m), track.whitening.reshape(rows, m, m)
        innovation = np.where(sampled, track.innovation.reshape(rows, m), 0.0)
        # Each is free of what those before it tell (`whitening` is lower triangular).
        self.white = np.einsum("rij,rj->ri", whitening, innovation)[:, outputs]
        self.shown = -(whitening @ slope)[:, outputs]
        self._transition = track.transition.reshape(rows, n, n)
        self.carry = self._transition - self._transition @ gain @ slope
        self.horizon = max(LEAST_ROWS, round(horizon_s / run.row_s))
        self._unit = np.eye(n)[:, jumped]
        self.t_s = run.t_s
        # A log that begins at rest begins from a known state. Else the filter has to find it.
        settled_s = run.t_s[0] + HORIZON_S if run.at_rest else run.settled_s
        begun_s = max(settled_s, known_s)
        self.first = min(int(np.searchsorted(run.t_s, begun_s)), rows - 1)
        self.earliest = 1 if run.at_rest and begun_s == settled_s else self.first

    def ratios(self, first_row: int | None = None) -> tuple[Array, Array, Array]:
        """Return g, the jump and the explained share for a jump before each row.

        g is 0 before `first_row`; by default that from which the state is known.
        """
        rows, jumps = len(self.white), self._unit.shape[1]
        error = np.tile(self._unit, (rows, 1, 1))
        information, right = np.zeros((rows, jumps, jumps)), np.zeros((rows, jumps))
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
        jump = np.linalg.solve(information + 1e-9 * np.eye(jumps), right[:, :, None])[:, :, 0]
        ratio = np.einsum("ri,ri->r", right, jump)
        ratio[: self.first if first_row is None else first_row] = 0.0
        return ratio, jump, ratio / np.maximum(energy, 1e-12)

    def ratio_beside_misreadings(
        self, row: int, rate: Array, stamp_s: float, rounded_rad: float
    ) -> float:
        """Return g of a jump before a row beside stamps that are off, a clock that skips there, and
        counts that are rounded otherwise from there on.

        `rate` (rows, filter states): what the state does in a second, for what was read late is
        that much further on. `stamp_s` is the standard deviation of how late, `rounded_rad` that of
        what rounding adds to a shaft's angle.
        """
        end, first = min(row + self.horizon, len(self.white)), max(row - 1, 0)

        def shown_by(error: Array, begin: int) -> Array:
            shown = np.zeros((end - row, self.white.shape[1], error.shape[1]))
            for k in range(begin, end):
                shown[k - row] = self.shown[k] @ error
                error = self.carry[k] @ error
            return shown.reshape(-1, error.shape[1])

        stamps = [shown_by(rate[row][:, None], row)]
        for k in range(first, end):  # the row before may still mislead the filter
            own = shown_by(self._misled(k) @ rate[k][:, None], k + 1)
            if k >= row:
                own.reshape(end - row, -1)[k - row] = self.shown[k] @ rate[k]
            stamps.append(own)
        late, jump = stamp_s * np.hstack(stamps), shown_by(self._unit, row)
        rounded = rounded_rad * shown_by(np.eye(len(self.carry[row]))[:, ENCODER], row)
        misread = np.hstack([late, rounded])
        unsure, free = misread.shape[1], jump.shape[1]
        misread = np.vstack([misread, np.eye(unsure)])
        jump = np.vstack([jump, np.zeros((unsure, free))])
        white = np.r_[self.white[row:end].ravel(), np.zeros(unsure)]
        return _told_by(np.hstack([jump, misread]), white) - _told_by(misread, white)

    def _misled(self, row: int) -> Array:
        """Return what the state is off before the next row by a reading of another one."""
        return self.carry[row] - self._transition[row]

    def likeliest_row(self, peak: int, raised: npt.NDArray[np.bool_]) -> int:
        """Return the row before which a push explains most of the rows around a peak of g.

        g looks one horizon ahead of its row; rows can be compared only over the same rows. A filter
        that expects little chance is misled for long by a hard push: g may be largest where most of
        what misled rows show is still ahead, some rows before the push. While wheels slide the
        sensors may tell of a push long after it: then it lies anywhere where g is `raised` (rows,)
        up to the peak.
        """
        end = min(peak + self.horizon, len(self.white))
        first = peak - self.horizon
        while first > 0 and raised[first - 1] and self.t_s[peak] - self.t_s[first - 1] < APART_S:
            first -= 1
        rows = range(max(self.earliest, first), max(peak + 1, end - LEAST_ROWS))
        return max(rows, key=lambda row: self._explained_until(row, end))

    def _explained_until(self, row: int, end: int) -> float:
        error, jumps = self._unit, self._unit.shape[1]
        information, right = 1e-9 * np.eye(jumps), np.zeros(jumps)
        for k in range(row, end):
            response = self.shown[k] @ error
            information += response.T @ response
            right -= response.T @ self.white[k]
            error = self.carry[k] @ error
        return float(right @ np.linalg.solve(information, right))


def _told_by(response: Array, white: Array) -> float:
    """Return how much of the squares of `white` (rows,) a fit by the columns takes away."""
    left = white - response @ np.linalg.lstsq(response, white, rcond=None)[0]
    return float(white @ white - left @ left)


def peaks(t_s: Array, ratio: Array, threshold: float, claimed_s: float = APART_S) -> list[int]:
    """Rows of the local maxima above the threshold, strongest first claiming its surroundings.

    After it for `claimed_s`, before it only rows that look as far ahead: another push may have come
    there.
    """
    left, found = ratio.copy(), []
    while left.max(initial=0.0) > threshold:
        row = int(np.argmax(left))
        found.append(row)
        since_s = t_s - t_s[row]
        left[(since_s > -HORIZON_S - SPAN_S) & (since_s < claimed_s)] = 0.0
    return sorted(found)
