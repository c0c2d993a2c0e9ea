"""What of the logs is used, which runs are fitted and which held out, and whether they suffice."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from omnislip._core import SETTLE_S
from omnislip.gap.events import pieces
from omnislip.gap.gates import rows_far_apart
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import ODOMETRY_CHANNELS, UNSEEN_SETTLE_S, Run, first_pose, make_run
from omnislip.log_file import Log

Array = npt.NDArray[np.float64]

RUNS_TO_HOLD_OUT_WHOLE = 5
SERIES_TO_HOLD_OUT_WHOLE = 3
LEAST_UNITS, LEAST_PART_S = 5, 2.0
"""Parts of runs that check each other, where the logs are few, and their least length."""
HELD_OUT_SHARE = 0.25
WHOLE_RUNS = ("whole series (folders) of runs", "whole runs")
"""How runs are held out where there are enough."""
LEAST_TIME_S = 3.0
LEAST_TRAVEL = 20.0
"""Motion, in steps of the position sensor, below which nothing can be learned."""
LEAST_ROWS, LEAST_SETTLED = 50, 2.0
"""Of a piece that is used: rows, and times that the filter takes to settle."""
LONGEST_RUN_S = 60.0
"""Of a robot's log that is filtered at once: its matrices take 1.6 MB per second at 200 Hz."""
STRETCH_S, MOST_FITTED_S, MOST_HELD_OUT_S = 10.0, 120.0, 40.0
"""Of a robot's longer logs the liveliest stretches are fitted and held out, so much together: 40 s
name what shows at all, and time and memory go with what is fitted."""


@dataclass(frozen=True)
class Split:
    """Which runs are fitted, and check the choice by turns, and which are only looked at last."""

    fitting: list[Run]
    held_out: list[Run]
    how: str
    thinned: str | None = None
    """What is used of long logs, in words."""

    @property
    def enough(self) -> bool:
        """Whether there is a run to fit, another to check it, and one to hold out."""
        return len({run.unit for run in self.fitting}) > 1 and bool(self.held_out)

    @property
    def logs_held_out(self) -> list[str]:
        """Names of the logs of which nothing is fitted."""
        fitted = {run.name for run in self.fitting}
        return list(dict.fromkeys(run.name for run in self.held_out if run.name not in fitted))


def too_cut(split: Split) -> str:
    """Return why a split that is not enough is none."""
    return (
        f"between pushes and gaps too little is left to fit, to check and to hold out: each "
        f"takes pieces of {LEAST_ROWS} rows and {LEAST_SETTLED * SETTLE_S:g} s, or "
        f"{LEAST_SETTLED * UNSEEN_SETTLE_S:g} s where no camera sees how a robot goes ({split.how})"
    )


@dataclass(frozen=True)
class Part:
    """Rows first..end of a log, its unit, and whether it is held out."""

    unit: str
    held_out: bool
    log: Log
    first: int
    end: int

    @property
    def rows(self) -> int:
        """How many."""
        return self.end - self.first

    @property
    def row_s(self) -> float:
        """Time from row to row."""
        return _row_s(self.log, self.first, self.end)

    @property
    def duration_s(self) -> float:
        """Time that its rows take, without gaps between them."""
        return self.rows * self.row_s

    @property
    def liveliness(self) -> float:
        """Variance of a robot's commands."""
        names = [f"wheel/{wheel}/duty" for wheel in range(1, 5)]
        duties = [self.log.columns[name][self.first : self.end] for name in names]
        return float(np.sum(np.var(np.nan_to_num(duties), axis=1)))


def _row_s(log: Log, first: int, end: int) -> float:
    """Return the median time from row to row of rows first..end of a log."""
    return float(np.median(np.diff(log.t_s[first:end]))) if end - first > 1 else 0.0


def _evenly(first: int, end: int, count: int) -> list[tuple[int, int]]:
    """Cut rows first..end into `count` even parts: (begin, end)."""
    return list(pairwise(np.linspace(first, end, count + 1).round().astype(int).tolist()))


def split_runs(
    machine: Machine, logs: Sequence[Log], pushes: Sequence[tuple[str, float]] = ()
) -> Split:
    """Hold out whole series where there are three, else whole runs where there are five.

    Else the last run, or the end of the one; the others are then cut into parts. A series is a
    folder of logs: what its runs have in common (day, floor, clocks) must not help the model on the
    runs that judge it. A series, run or part is a unit of the runs that are fitted: a choice is
    checked on each by what fits the others.

    A log is cut at its pushes (run, time). Of a long log the liveliest stretches are used.
    """
    series = list(dict.fromkeys(log.series for log in logs))
    if len(series) >= SERIES_TO_HOLD_OUT_WHOLE:
        held = [series[k] for k in _every_fifth(len(series))]
        parts = [Part(log.series, log.series in held, log, 0, len(log.t_s)) for log in logs]
        how = WHOLE_RUNS[0]
    elif len(logs) >= RUNS_TO_HOLD_OUT_WHOLE:
        held = _every_fifth(len(logs))
        parts = [Part(f"run {k}", k in held, log, 0, len(log.t_s)) for k, log in enumerate(logs)]
        how = WHOLE_RUNS[1]
    elif len(logs) > 1:
        parts = [Part(logs[-1].name, True, logs[-1], 0, len(logs[-1].t_s))]
        for log in logs[:-1]:
            parts += _cut(log, len(log.t_s), math.ceil(LEAST_UNITS / (len(logs) - 1)))
        how = "the last run held out; parts of the others check each other"
    else:
        [log] = logs
        end = round((1.0 - HELD_OUT_SHARE) * len(log.t_s))
        parts = [*_cut(log, end, LEAST_UNITS), Part(log.name, True, log, end, len(log.t_s))]
        how = "one run only: its last quarter held out, parts of the rest check each other"
    used = parts
    if machine.kind == "robot":
        used = _liveliest([part for part in parts if not part.held_out], MOST_FITTED_S)
        used += _liveliest([part for part in parts if part.held_out], MOST_HELD_OUT_S)
    fitting, held_out = [], []
    for part in used:
        runs = usable_runs(machine, part.log, pushes, part.first, part.end)
        (held_out if part.held_out else fitting).extend(replace(r, unit=part.unit) for r in runs)
    thinned = None
    if sum(part.rows for part in used) < sum(part.rows for part in parts):
        whole_s = sum(part.duration_s for part in parts)
        fitted_s, held_s = (sum(run.duration_s for run in runs) for runs in (fitting, held_out))
        thinned = (
            f"of {whole_s:.0f} s the liveliest stretches are used: {fitted_s:.0f} s are fitted, "
            f"{held_s:.0f} s held out"
        )
    return Split(fitting, held_out, how, thinned)


def all_runs(
    machine: Machine, logs: Sequence[Log], pushes: Sequence[tuple[str, float]]
) -> list[Run]:
    """Return the runs that are fitted and those that are held out."""
    split = split_runs(machine, logs, pushes)
    return [*split.fitting, *split.held_out]


def _liveliest(parts: Sequence[Part], most_s: float) -> list[Part]:
    """Return the parts, or stretches of them of some `most_s` together.

    From each stratum of a unit, so that what drifts and what is met in one place only is seen, that
    in which the commands vary most; where there are more units than stretches, from each stratum of
    all. Stretches begin at the same times of all logs: manoeuvres that are repeated stay so.
    """
    if sum(part.duration_s for part in parts) <= most_s:
        return list(parts)
    units: dict[str, list[Part]] = {}
    for part in parts:
        units.setdefault(part.unit, []).extend(_stretches(part))
    stretches = [one for own in units.values() for one in own]
    mean_s = sum(one.duration_s for one in stretches) / len(stretches)
    share = min(most_s / mean_s / len(stretches), 1.0)
    groups = list(units.values()) if share * len(stretches) >= len(units) else [stretches]
    chosen = []
    for own in groups:
        strata = np.array_split(np.arange(len(own)), max(round(share * len(own)), 1))
        chosen += [max((own[k] for k in some), key=lambda one: one.liveliness) for some in strata]
    return chosen


def _stretches(part: Part) -> list[Part]:
    """Cut a part at multiples of some seconds since its log began, slivers left to neighbours."""
    length_s = max(STRETCH_S, 2 * LEAST_ROWS * part.row_s)
    number = ((part.log.t_s[part.first : part.end] - part.log.t_s[0]) / length_s).astype(int)
    edges = part.first + np.flatnonzero(np.diff(number)) + 1
    least = 0.5 * length_s / part.row_s
    inner, begin = [], part.first
    for edge in edges:
        if edge - begin >= least and part.end - edge >= least:
            inner.append(int(edge))
            begin = edge
    return [replace(part, first=a, end=b) for a, b in pairwise([part.first, *inner, part.end])]


def usable_runs(
    machine: Machine,
    log: Log,
    pushes: Sequence[tuple[str, float]],
    first: int = 0,
    last: int | None = None,
) -> list[Run]:
    """Return what is long enough to be used of rows first..last between the pushes (run, time).

    A robot's in runs of a minute at most.
    """
    runs = []
    for begin, end in pieces(log, pushes):
        begin, end = max(begin, first), min(end, len(log.t_s) if last is None else last)
        pose = first_pose(log, begin, end)
        # Without a pose an odometry has nothing to be judged by.
        before = [] if machine.kind == "odometry" else [(begin, pose)]
        for rows in (*before, (pose, end)):
            if rows[1] - rows[0] >= LEAST_ROWS:
                count = 1
                if machine.kind == "robot":
                    duration_s = (rows[1] - rows[0]) * _row_s(log, *rows)
                    count = math.ceil(duration_s / LONGEST_RUN_S)
                runs += [make_run(machine, log, *part) for part in _evenly(*rows, count)]
    return [run for run in runs if run.duration_s >= LEAST_SETTLED * run.recording.settle_s]


def _every_fifth(count: int) -> list[int]:
    """Numbers of those that are held out."""
    share = max(1, round(0.2 * count))
    return [round((k + 1) * count / share) - 1 for k in range(share)]


def _cut(log: Log, end: int, count: int) -> list[Part]:
    """Cut the rows of a log before `end` into some parts."""
    count = max(2, min(count, int((log.t_s[end - 1] - log.t_s[0]) / LEAST_PART_S)))
    return [
        Part(f"{log.name}, part {k + 1}", False, log, *rows)
        for k, rows in enumerate(_evenly(0, end, count))
    ]


def too_little(machine: Machine, logs: Sequence[Log]) -> str | None:
    """Return why these logs cannot teach anything, or None."""
    far_apart = rows_far_apart(logs)
    if far_apart:
        return far_apart
    total = sum(float(log.t_s[-1] - log.t_s[0]) for log in logs)
    if total < LEAST_TIME_S:
        return f"the logs hold {total:.2g} s, at least {LEAST_TIME_S:g} s are needed"
    return too_still(machine, logs)


def too_still(machine: Machine, logs: Sequence[Log]) -> str | None:
    """Return what does not move in any of the logs, or None."""
    runs = [make_run(machine, log) for log in logs]
    if all(np.ptp(run.command) == 0 for run in runs):
        return "the command never changes"
    for motor in range(machine.wheels):
        travel = max(_travel(run, motor) for run in runs)
        if travel < LEAST_TRAVEL:
            what = f"wheel {motor + 1}" if machine.wheels > 1 else "the axis"
            return f"{what} hardly moves in any log"
    return None


def _travel(run: Run, motor: int) -> float:
    """Way of a motor in steps of its sensor; an odometry is driven by its encoders."""
    driven = run.channels == ODOMETRY_CHANNELS
    way = np.cumsum(run.command[:, motor]) if driven else run.outputs[:, motor]
    way = way[~np.isnan(way)]
    return float(np.ptp(way)) / _resolution(way)


def _resolution(values: Array) -> float:
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0]
    return float(moved.min()) if moved.size else float("inf")
