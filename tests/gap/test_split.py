"""Which runs are fitted and which are held out, and what of long logs is used."""

from dataclasses import replace

import numpy as np
import pytest
from axis_bench import Bench, make_log, make_machine
from omnislip.gap.machine import Machine
from omnislip.gap.split import split_runs, usable_runs
from omnislip.log_file import POSE_COLUMNS, Log
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import robot_log, stretches

ROBOT = Machine(read_model(NOMINAL_ROBOT))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9, 12, 20])
def test_no_row_is_in_two_parts_of_the_split(count, tmp_path):
    machine = make_machine(tmp_path)
    logs = [make_log(Bench(), seed) for seed in range(count)]
    split = split_runs(machine, logs)
    parts = [stretches(part) for part in (split.fitting, split.held_out)]
    assert all(parts)
    assert sum(map(len, parts)) == len(set.union(*parts)) == sum(len(log.t_s) for log in logs)
    assert len(parts[1]) >= 0.1 * sum(map(len, parts))
    assert len(parts[0]) >= 0.5 * sum(map(len, parts))


def test_what_ends_before_it_can_be_replayed_is_not_held_out(tmp_path):
    """The last quarter begins at 3 s, and a push at 3.3 s leaves less than a second after it."""
    machine = make_machine(tmp_path)
    log = make_log(Bench(), 1, duration_s=4.0)
    assert not split_runs(machine, [log], [(log.name, 3.3)]).held_out
    later = split_runs(machine, [log], [(log.name, 3.6)])
    assert [run.duration_s for run in later.held_out] == pytest.approx([0.59])


def long_logs(*rows, **columns):
    """Logs of a robot by their rows."""
    return [replace(robot_log(n, **columns), name=f"run_{k:03d}") for k, n in enumerate(rows)]


@pytest.mark.parametrize(
    "rows",
    [[120_000], [40_000] * 3, [12_000] * 12, [1200] * 200, [8100] * 5, [120_000, 1600, 1600, 1600]],
    ids=lambda rows: f"{len(rows)} of up to {max(rows)}",
)
def test_of_long_logs_stretches_from_all_over_are_used(rows):
    logs = long_logs(*rows)
    split = split_runs(ROBOT, logs)
    for runs, most_s in ((split.fitting, 120.0), (split.held_out, 40.0)):
        assert max(run.duration_s for run in runs) < 15.0
        assert sum(run.duration_s for run in runs) < 1.2 * most_s
    assert sum(run.duration_s for run in split.fitting) > 0.75 * 120.0
    assert not stretches(split.fitting) & stretches(split.held_out)
    if len(rows) < 12:  # a unit at least of each log that is not held out
        assert len({run.name for run in split.fitting}) >= 0.6 * len(rows)
    whole_s = sum(rows) * 0.005
    assert f"of {whole_s:.0f} s" in split.thinned
    names = [log.name for log in logs]
    begins_s = np.cumsum([0, *rows[:-1]]) * 0.005
    used = [*split.fitting, *split.held_out]
    times_s = [begins_s[names.index(run.name)] + run.t_s[0] for run in used]
    gaps_s = np.diff(np.sort([0.0, *times_s, whole_s]))
    assert np.max(gaps_s) < 0.3 * whole_s


@pytest.mark.parametrize("rows", [4000, 12_000])
def test_a_pause_within_a_log_makes_it_no_longer(rows):
    logs = long_logs(*[rows] * 4)
    pause_s = 500.0 * (np.arange(rows) >= rows // 2)
    paused = [replace(log, t_s=log.t_s + pause_s) for log in logs]
    cuts = [(log.name, log.t_s[rows // 2] - 0.02) for log in paused]
    split = split_runs(ROBOT, paused, cuts)
    assert (split.thinned is None) == (split_runs(ROBOT, logs).thinned is None)
    assert sum(run.duration_s for run in split.fitting) > 0.7 * min(3 * rows * 0.005, 120.0)


def test_slow_rows_make_longer_stretches():
    log = replace(robot_log(6000), t_s=np.arange(6000) * 0.25)
    split = split_runs(ROBOT, [log])
    assert sum(run.duration_s for run in split.fitting) > 90.0
    assert min(len(run.t_s) for run in split.fitting) >= 50


def test_manoeuvres_that_are_repeated_stay_so_in_long_logs():
    """Logs of nearly the same length: the same stretches of them, of what is driven alike."""
    twice = 1.0 + (np.arange(16_000) // 2000 % 4 == 1)
    duty = robot_log(16_000).columns["wheel/1/duty"] * twice
    whole = robot_log(16_000, **{f"wheel/{w}/duty": duty for w in range(1, 5)})
    logs = [
        Log(f"run_{k}", whole.t_s[:n], {c: v[:n] for c, v in whole.columns.items()})
        for k, n in enumerate([15_900, 16_000, 15_950, 15_990, 15_930])
    ]
    begins = {round(run.t_s[0], 3) for run in split_runs(ROBOT, logs).fitting}
    assert len(begins) <= 4
    assert all(begin % 10.0 == 0.0 for begin in begins)


def test_of_long_logs_the_liveliest_stretches_are_used():
    """Every third ten seconds the robot drives at twice the duty."""
    twice = 1.0 + (np.arange(120_000) // 2000 % 3 == 1)
    duty = robot_log(120_000).columns["wheel/1/duty"] * twice
    log = robot_log(120_000, **{f"wheel/{w}/duty": duty for w in range(1, 5)})
    split = split_runs(ROBOT, [log])
    assert all(10.0 <= run.t_s[0] % 30.0 < 20.0 for run in split.fitting + split.held_out)


def test_a_minute_is_filtered_at_once_at_most():
    runs = usable_runs(ROBOT, robot_log(26_000), [])
    assert sum(len(run.t_s) for run in runs) == 26_000
    assert max(run.duration_s for run in runs) < 60.0


def test_runs_of_the_same_name_in_two_folders_are_two(tmp_path):
    machine = make_machine(tmp_path)
    logs = [replace(make_log(Bench(), k), series=f"day_{d}") for d in range(2) for k in range(3)]
    split = split_runs(machine, logs)
    assert len(split.held_out) == 1
    assert len({run.unit for run in split.fitting}) == 5


def test_slivers_beside_a_cut_are_not_used(tmp_path):
    """Parts of 2.25 s, the log cut at 2.05 s: 0.15 s are left, in which the filter settles."""
    t_s = np.arange(0.0, 12.0, 0.001)
    log = Log("run", t_s, {"axis/command": np.sin(t_s), "axis/position_m": np.sin(t_s)})
    machine = make_machine(tmp_path)
    split = split_runs(machine, [log], [("run", 2.05)])
    assert [round(run.duration_s, 2) for run in split.fitting] == [2.04, 2.25, 2.25, 2.25]


@pytest.mark.parametrize("lost", [(-1.0, 1.0), (0.5, 3.5), (-1.0, 4.0)], ids=str)
def test_a_run_of_a_robot_starts_from_a_pose_or_has_none(lost):
    """Where the camera is lost at first, the robot has moved when it comes back."""
    log = robot_log(800)
    blank = (log.t_s > lost[0]) & (log.t_s < lost[1])
    pose = {name: np.where(blank, np.nan, log.t_s) for name in POSE_COLUMNS}
    runs = usable_runs(ROBOT, replace(log, columns=log.columns | pose), [])
    assert sum(len(run.t_s) for run in runs) == len(log.t_s)
    seen = [np.flatnonzero(~np.isnan(run.outputs[:, 5])) for run in runs]
    assert all(rows.size == 0 or rows[0] == 0 for rows in seen)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9, 12, 20])
def test_every_unit_is_checked_by_four_others(count, tmp_path):
    """And no row is in two of them."""
    machine = make_machine(tmp_path)
    logs = [make_log(Bench(), seed, duration_s=15.0) for seed in range(count)]
    split = split_runs(machine, logs)
    units = {run.unit for run in split.fitting}
    assert len(units) >= min(5, max(4, count - 1))
    rows = [stretches([run for run in split.fitting if run.unit == unit]) for unit in units]
    assert sum(map(len, rows)) == len(set.union(*rows))
