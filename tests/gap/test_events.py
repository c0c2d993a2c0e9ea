"""Impacts: found at their time, sized with the plant, cut out of the logs."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap import events, find, recordings
from omnislip.gap.events import (
    Impact,
    as_effect,
    beside_lost_rows,
    find_impacts,
    known_pushes,
    pieces,
    shows,
    too_often,
    without_repeated,
)
from omnislip.gap.inference import Data
from omnislip.gap.machine import Machine
from omnislip.gap.noise import CONTACT, SUPPLY, first_guess, track_all, tune_noise
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis, first_model
from omnislip.gap.truth import TruthCase, write_case
from omnislip.log_file import POSE_COLUMNS, Log, read_log
from omnislip.model_file import IMPACT_KEYS, NOMINAL_ROBOT, Effect, read_model, write_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, simulate_truth
from truth_bench import logs_of, runs_of

PUSHES = [(1.5, -1.0, 0.0), (-0.5, 6.0, 0.1)]


def found_in(folder, push=None, stamps_s=0.0, **changed):
    """Rows are stamped that much too early or late (standard deviation)."""
    numbers = dict(zip(IMPACT_KEYS, (2.5031, *(push or ())), strict=False))
    hidden = {"name": "impact", "parameters": numbers, "run": "run_02", "wheel": None}
    case = TruthCase(
        seed=3, effects=(hidden,) if push else (), runs=3, run_duration_s=5.0, **changed
    )
    write_case(case, folder)
    model = read_model(folder / "robot.toml")
    machine = Machine(model, electric="current" in case.sensors)
    logs = [read_log(path, "robot") for path in sorted(folder.glob("run_*.csv"))]
    rng = np.random.default_rng(0)
    logs = [replace(one, t_s=one.t_s + stamps_s * rng.normal(size=len(one.t_s))) for one in logs]
    runs = [make_run(machine, log) for log in logs]
    noise, model = first_model(machine, runs)
    return find_impacts(machine, runs, model.flat(machine.believed), noise)


def test_no_push_is_told_before_it_is_known_where_in_its_play_each_gear_is():
    """Of 30 mrad: the last shaft has turned by all of it in row 150, one that turns back in 90."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    [run, *_] = runs_of(machine, TruthCase(seed=3, runs=1, run_duration_s=3.0))
    values, noise = machine.believed, first_guess(machine, [run])
    [track] = track_all(machine, [run], values, noise, keep_linear=True)
    play = values.copy()
    play[machine.place("gear_backlash", "angle_rad", None)[0]] = 0.03
    across_rad = 0.03 * machine.model.values["motor.gear_ratio"]
    rows = np.arange(len(run.t_s))
    filtered = np.zeros((len(rows), track.filter_states))
    filtered[:, 4:7] = 1.0 + across_rad * np.minimum(rows / [[20.5], [149.5], [89.5]], 1.01).T
    filtered[95:, 6] = 1.0
    assert events._teeth_known_s(machine, run, filtered, values) == -np.inf
    assert events._teeth_known_s(machine, run, filtered, play) > run.t_s[-1]
    filtered[:, 7] = -filtered[:, 4]
    filtered[0, 7] = -1.0
    known_s = events._teeth_known_s(machine, run, filtered, play)
    assert known_s == pytest.approx(run.t_s[150] + events.HORIZON_S)
    ratio, _, _ = events.Jumps(machine, run, track, known_s=known_s).ratios()
    begun = run.t_s >= known_s
    assert not ratio[~begun].any() and ratio[begun].all()
    ratio, _, _ = events.Jumps(machine, run, track, known_s=np.inf).ratios()
    assert not ratio[:-1].any()


@pytest.mark.parametrize("push", PUSHES)
def test_a_push_is_found_at_its_time(tmp_path, push):
    """The lighter push is 0.09 m/s while the wheels drive; what it leaves shows when to 15 ms."""
    (impact,) = found_in(tmp_path, push)
    assert impact.run == "run_02"
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)
    assert abs(impact.time_s - 2.5031) < 3 * impact.time_deviation_s


def test_pushes_are_told_by_motion_not_by_volts_and_amperes():
    """Those show where in its row a command is, which a replay does not know."""
    machine = Machine(read_model(NOMINAL_ROBOT), electric=True)
    sensors = ("gyro", "pose", "supply", "current")
    case = TruthCase(seed=3, runs=1, run_duration_s=3.0, closed_loop=True, sensors=sensors)
    [run] = runs_of(machine, case)
    values, noise = machine.believed, first_guess(machine, [run])
    [track] = track_all(machine, [run], values, noise, keep_linear=True)
    outputs = run.outputs.shape[1]
    whitening = track.whitening.reshape(-1, outputs, outputs)
    assert not whitening[:, :SUPPLY, SUPPLY:].any()
    assert whitening[:, SUPPLY:, :SUPPLY].any()
    assert events.Jumps(machine, run, track).white.shape[1] == SUPPLY < outputs
    filtered = track.state.reshape(len(run.t_s), -1)
    other = run.outputs.copy()
    other[:, SUPPLY:] += 5.0
    windows = [
        events._Window(machine, one, 300, values, noise, filtered)
        for one in (run, replace(run, outputs=other))
    ]
    assert windows[0].quiet == windows[1].quiet > 0.0
    assert windows[0].readings == windows[1].readings > 0


@pytest.mark.parametrize("push", PUSHES)
def test_a_push_is_found_in_a_loop_at_1_khz_whose_currents_are_logged(tmp_path, push):
    sensors = ("gyro", "pose", "supply", "current")
    [impact] = found_in(tmp_path, push, closed_loop=True, sensors=sensors)
    assert impact.run == "run_02"
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)


@pytest.mark.parametrize("push", PUSHES)
def test_momentum_of_a_push_is_right_within_a_fifth(tmp_path, push):
    """A fifth, for grip and mass are only believed."""
    (impact,) = found_in(tmp_path, push)
    error = np.hypot(*(impact.impulse[:2] - push[:2]))
    assert error < 0.2 * np.hypot(*push[:2])
    assert np.all(np.abs(impact.impulse - push) < 3 * impact.deviation)


def pushed_twice(pushes):
    """Two pushes (time in s, N s, N s, N m s) while the robot drives: machine, log and noise."""
    model = read_model(NOMINAL_ROBOT)
    hidden = [
        Effect("impact", dict(zip(IMPACT_KEYS, push, strict=True)), run="run") for push in pushes
    ]
    driving = [{"t_s": 0.0, "kind": "velocity", "value": [0.3, 0.2, 0.5]}]
    pushed = replace(model, effects=hidden)
    scenario = Scenario("run", 5.0, pushed, driving, sensors=Sensors(pose_noise_m=0.001), seed=1)
    machine = Machine(model)
    log = make_log(scenario, simulate_truth(scenario))
    calm = replace(scenario, model=model, seed=2)
    noise = tune_noise(
        machine, [make_run(machine, make_log(calm, simulate_truth(calm)))], machine.believed
    )
    return machine, log, noise


HARD, LIGHT = (-2.7, 7.0, 0.0), (2.0, 0.0, 0.0)


@pytest.mark.parametrize("sizes", [(LIGHT, HARD), (HARD, LIGHT)])
def test_a_light_push_just_before_or_after_a_hard_one_is_found(sizes):
    machine, log, noise = pushed_twice([(2.3, *sizes[0]), (2.5, *sizes[1])])
    found = find_impacts(machine, [make_run(machine, log)], machine.believed, noise)
    assert [impact.time_s for impact in found] == pytest.approx([2.3, 2.5], abs=0.015)
    # In a run that begins behind the first one the second shows, and what nobody did does not.
    behind = make_run(machine, log, begin=470)
    later = [found[1], replace(found[1], time_s=3.0)]
    shown = [shows(machine, behind, push, machine.believed, noise) for push in later]
    assert shown == [True, False]


def test_what_soon_follows_something_stronger_that_is_no_push_is_none(monkeypatch):
    machine, log, noise = pushed_twice([(2.3, *HARD), (2.5, *LIGHT)])
    size_up = events._size_up

    def refused(machine, run, row, *others):
        impact = size_up(machine, run, row, *others)
        return replace(impact, gain=0.0) if run.t_s[row] < 2.4 else impact

    monkeypatch.setattr(events, "_size_up", refused)
    assert find_impacts(machine, [make_run(machine, log)], machine.believed, noise) == []


def pushed_while_turning(latency_s):
    """A robot that turns at 5 rad/s below a camera that is late, and is pushed at 2.5 s."""
    model = read_model(NOMINAL_ROBOT)
    model = replace(model, effects=[Effect("pose_latency", {"delay_s": latency_s})])
    push = Effect("impact", dict(zip(IMPACT_KEYS, (2.5, 2.0, 0.0, 0.0), strict=True)), run="run")
    driving = [{"t_s": 0.0, "kind": "velocity", "value": [0.3, 0.2, 5.0]}]
    pushed = replace(model, effects=[*model.effects, push])
    sensors = Sensors(pose_noise_m=0.001)
    scenario = Scenario("run", 4.0, pushed, driving, sensors=sensors, seed=1)
    machine = Machine(model)
    calm = replace(scenario, model=model, seed=2)
    run, quiet = (make_run(machine, make_log(s, simulate_truth(s))) for s in (scenario, calm))
    return machine, run, tune_noise(machine, [quiet], machine.believed)


def test_a_push_is_sized_up_right_though_a_wheel_that_slides_grips_less(monkeypatch):
    """By the model's grip of that wheel the robot would have got a quarter more."""
    model, push = read_model(NOMINAL_ROBOT), (7.0, 0.0, 0.0)
    driving = [{"t_s": 0.0, "kind": "velocity", "value": [0.5, 0.3, 0.5]}]
    machine = Machine(model)

    def driven(*effects):
        robot = replace(model, effects=list(effects))
        scenario = Scenario("run", 4.0, robot, driving, sensors=Sensors(pose_noise_m=0.001), seed=1)
        return make_run(machine, make_log(scenario, simulate_truth(scenario)))

    noise = tune_noise(machine, [driven()], machine.believed)
    impulse = dict(zip(IMPACT_KEYS, (2.5, *push), strict=True))
    run = driven(
        Effect("uneven_grip", {"scale": 0.9}, wheel=3), Effect("impact", impulse, run="run")
    )
    deviations = []
    for grip in (events.GRIP, 1e-6):
        monkeypatch.setattr(events, "GRIP", grip)
        (impact,) = find_impacts(machine, [run], machine.believed, noise)
        assert impact.time_s == pytest.approx(2.5, abs=0.005)
        deviations.append(np.max(np.abs(impact.impulse - push) / impact.deviation))
    assert deviations[0] < 3.0 and deviations[1] > 5.0


def test_a_hard_push_that_is_known_is_looked_for_from_what_it_was(monkeypatch):
    """Where nothing of what the filter shows leads there: the replay from that size decides."""
    model = read_model(NOMINAL_ROBOT)
    driving = [{"t_s": 0.0, "kind": "velocity", "value": [0.5, 0.3, 0.5]}]
    machine = Machine(model)
    runs, impacts = [], []
    for push_n_s in (7.0, 3.0):  # 0.35 and 0.15 m/s
        effect = Effect(
            "impact", dict(zip(IMPACT_KEYS, (2.5, push_n_s, 0, 0), strict=True)), run="run"
        )
        robot = replace(model, effects=[effect])
        scenario = Scenario("run", 4.0, robot, driving, sensors=Sensors(pose_noise_m=0.001), seed=1)
        runs.append(make_run(machine, make_log(scenario, simulate_truth(scenario))))
    noise = tune_noise(machine, runs[1:], machine.believed)
    for run in runs:
        impacts += find_impacts(machine, [run], machine.believed, noise)
    hard, light = impacts
    monkeypatch.setattr(events, "peaks", lambda *_: [])

    def found(run, known):
        return find_impacts(machine, [run], machine.believed, noise, known)

    assert found(runs[0], []) == []
    (again,) = found(runs[0], [hard])
    assert again.impulse == pytest.approx(hard.impulse, abs=0.3)
    assert again.time_s == pytest.approx(hard.time_s, abs=0.005)
    assert found(runs[0], [replace(hard, run="other")]) == []
    assert found(runs[0], [replace(hard, time_s=1.5)]) == []
    assert found(runs[1], [light]) == []


@pytest.mark.parametrize("latency_s", [0.0, 0.035])
def test_a_push_is_sized_up_by_what_a_late_camera_can_have_seen(latency_s):
    """It shows 0.175 rad less than the robot has turned, and the push 35 ms later."""
    machine, run, noise = pushed_while_turning(latency_s)
    (impact,) = find_impacts(machine, [run], machine.believed, noise)
    assert impact.time_s == pytest.approx(2.5, abs=0.015)
    assert impact.misfit < 2.0
    assert impact.impulse == pytest.approx([2.0, 0.0, 0.0], abs=0.2)


def test_a_push_is_looked_for_behind_a_row_that_foresees_it_by_most_of_a_horizon():
    machine, run, noise = pushed_while_turning(0.0)
    [track] = track_all(machine, [run], machine.believed, noise, keep_linear=True)
    pushes, pushed = events.Jumps(machine, run, track), int(np.searchsorted(run.t_s, 2.5))
    raised = np.zeros(len(run.t_s), dtype=bool)
    for early in (0, 6, 12):
        assert abs(pushes.likeliest_row(pushed - early, raised) - pushed) <= 1


def test_a_push_behind_the_row_that_foresees_it_is_found(tmp_path, monkeypatch):
    likeliest = events.Jumps.likeliest_row
    monkeypatch.setattr(events.Jumps, "likeliest_row", lambda *own: likeliest(*own) - 5)
    (impact,) = found_in(tmp_path, (7.0, 0.0, 0.0))
    assert impact.time_s == pytest.approx(2.5031, abs=0.005)


def test_a_push_that_does_not_fit_at_its_row_is_tried_behind_it(tmp_path, monkeypatch):
    """In one of 22 ms the likeliest row may be before its middle, and a jump there fits badly."""
    size_up, sized = events._size_up, []

    def unfit_at_first(machine, run, row, *others):
        found = size_up(machine, run, row, *others)
        sized.append(row)
        if len(sized) > 1:
            return found
        early_s = run.t_s[row] - 0.01
        return replace(found, time_s=early_s, misfit=11.3, explained=0.85)

    monkeypatch.setattr(events, "_size_up", unfit_at_first)
    (impact,) = found_in(tmp_path, (7.0, 0.0, 0.0))
    assert impact.time_s == pytest.approx(2.5031, abs=0.005)
    assert len(sized) == 3 and sorted(sized) == sized


def test_a_push_long_before_the_row_that_shows_it_is_found_without_a_camera(tmp_path, monkeypatch):
    """While wheels slide encoders tell nothing of where the robot goes."""
    likeliest, push = events.Jumps.likeliest_row, (7.0, 0.0, 0.0)
    monkeypatch.setattr(events.Jumps, "likeliest_row", lambda *own: likeliest(*own) + 10)
    (impact,) = found_in(tmp_path, push, sensors=(), excitation="ordinary")
    assert impact.time_s == pytest.approx(2.5031, abs=0.005)
    assert np.hypot(*impact.impulse[:2]) == pytest.approx(7.0, rel=0.2)
    monkeypatch.setattr(events, "_begun", lambda *_: None)
    late = found_in(tmp_path / "late", push, sensors=(), excitation="ordinary")
    assert all(abs(impact.time_s - 2.5031) > 0.02 for impact in late)


def test_a_push_that_gains_too_little_at_its_row_is_tried_behind_it(tmp_path, monkeypatch):
    """Of 0.1 m/s in 11 ms: gains of 39, 51 and 82 that fit about as well, 0.18 to 0.20."""
    size_up, sized = events._size_up, []

    def weak_at_first(machine, run, row, *others):
        found = size_up(machine, run, row, *others)
        sized.append(row)
        return found if len(sized) > 1 else replace(found, gain=39.0, misfit=0.01)

    monkeypatch.setattr(events, "_size_up", weak_at_first)
    (impact,) = found_in(tmp_path, (7.0, 0.0, 0.0))
    assert impact.time_s == pytest.approx(2.5031, abs=0.005)
    assert impact.misfit > 0.01


@pytest.mark.parametrize("late_rows", [6, 8])
def test_a_push_some_rows_before_the_one_that_shows_it_is_found_with_a_camera(
    tmp_path, monkeypatch, late_rows
):
    likeliest, push = events.Jumps.likeliest_row, (7.0, 0.0, 0.0)
    monkeypatch.setattr(events.Jumps, "likeliest_row", lambda *own: likeliest(*own) + late_rows)
    (impact,) = found_in(tmp_path, push, friction_curve="tanh")
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)
    assert np.hypot(*impact.impulse[:2]) == pytest.approx(7.0, rel=0.2)
    monkeypatch.setattr(events, "_begun", lambda *_: None)
    late = found_in(tmp_path / "late", push, friction_curve="tanh")
    assert all(abs(impact.time_s - 2.5031) > 0.015 for impact in late)


def test_of_two_times_of_a_push_the_replay_from_before_both_tells_which(tmp_path, monkeypatch):
    """Behind a push a filter that knows none is so far off that one 65 ms later gains more."""
    size_up, peaks = events._size_up, events.peaks

    def gaining(machine, run, row, *others):
        found = size_up(machine, run, row, *others)
        if found.time_s < 2.53:
            return found
        sure = {"impulse": np.array([7.0, 0.0, 0.0]), "deviation": np.full(3, 0.1)}
        return replace(found, gain=1e6, misfit=1.0, explained=0.95, **sure)

    monkeypatch.setattr(events, "_size_up", gaining)
    monkeypatch.setattr(events, "_does_both", lambda *_: False)
    monkeypatch.setattr(events, "_begun", lambda *_: None)
    monkeypatch.setattr(events, "HARD_EXPLAINED", -np.inf)
    monkeypatch.setattr(events, "EXPLAINED", -np.inf)
    monkeypatch.setattr(events.Jumps, "likeliest_row", lambda _, peak, raised: peak)
    monkeypatch.setattr(events, "peaks", lambda *own: [q for p in peaks(*own) for q in (p, p + 13)])
    (impact,) = found_in(tmp_path, (7.0, 0.0, 0.0))
    assert impact.time_s == pytest.approx(2.5031, abs=0.005)
    monkeypatch.setattr(events, "_likelier", lambda m, r, one, other, *_: other.gain > one.gain)
    (late,) = found_in(tmp_path / "late", (7.0, 0.0, 0.0))
    assert late.time_s > 2.53


def test_a_push_that_several_peaks_show_is_told_once(tmp_path, monkeypatch):
    peaks = events.peaks
    monkeypatch.setattr(events, "peaks", lambda *own: [p for p in peaks(*own) for _ in range(2)])
    (impact,) = found_in(tmp_path, PUSHES[0])
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)


@pytest.mark.parametrize(("impulse_n_s", "linear"), [(9.0, True), (12.0, False), (16.0, False)])
def test_a_push_after_which_wheels_slide_is_found(tmp_path, monkeypatch, impulse_n_s, linear):
    """Of 0.45 to 0.8 m/s: of the harder ones the linear response explains less than a light one
    has to leave."""
    push = (impulse_n_s, 0.0, 0.0)
    (impact,) = found_in(tmp_path, push, friction_curve="tanh")
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)
    assert impact.impulse == pytest.approx(push, abs=1.2)
    monkeypatch.setattr(events, "HARD_M_S", 1.0)
    assert bool(found_in(tmp_path / "again", push, friction_curve="tanh")) == linear


def test_a_push_is_found_though_rows_are_stamped_when_there_is_time(tmp_path, monkeypatch):
    """Fast wheels go on by many counts in a fifth of a millisecond, more than a push makes them."""
    (impact,) = found_in(tmp_path, PUSHES[0], stamps_s=2e-4, excitation="rich")
    assert impact.time_s == pytest.approx(2.5031, abs=0.015)
    monkeypatch.setattr(events, "STAMP_S", 1e-9)
    assert found_in(tmp_path / "exact", PUSHES[0], stamps_s=2e-4, excitation="rich") == []


def test_wheels_that_grip_later_than_friction_says_are_no_push(monkeypatch):
    """They spin on a slippery floor, and no camera or gyro tells how the robot goes meanwhile."""
    model = read_model(NOMINAL_ROBOT)
    model.values["contact.mu_drive"] = 0.15
    ways = np.array([-1.0, 1.0, 1.0, -1.0])
    driving = [
        {"t_s": t_s, "kind": "duty", "value": (0.9 * np.sin(2.0 * np.pi * t_s) * ways).tolist()}
        for t_s in np.arange(600) / 100
    ]
    machine = Machine(model)

    def run_with_grip(scale, seed):
        hidden = [Effect("low_grip", {"scale": scale})] if scale != 1.0 else []
        robot = replace(model, effects=hidden)
        scenario = Scenario("run", 6.0, robot, driving, sensors=Sensors(), seed=seed)
        log = make_log(scenario, simulate_truth(scenario))
        return make_run(machine, replace(log, columns=_without_gyro(_without_pose(log.columns))))

    noise = tune_noise(machine, [run_with_grip(1.0, 2)], machine.believed)
    run = run_with_grip(0.9, 1)
    assert find_impacts(machine, [run], machine.believed, noise) == []
    monkeypatch.setattr(events, "BY_FRICTION", np.inf)
    (feigned,) = find_impacts(machine, [run], machine.believed, noise)
    assert feigned.jump_m_s(machine) > 0.3


@pytest.mark.parametrize("curve", ["atan", "tanh"])
def test_driving_hard_is_no_push(tmp_path, curve):
    assert found_in(tmp_path, friction_curve=curve) == []


@pytest.mark.parametrize(("share", "push"), [(0.5, None), (1.0, None), (0.0, (1.5, 1.5, 0.0))])
def test_a_jump_of_the_command_at_another_time_within_a_row_is_no_push(share, push):
    """Reversals; in the row before one of them the log shows a share of what comes after it."""
    model, ways = read_model(NOMINAL_ROBOT), np.array([-1.0, 1.0, 1.0, -1.0])
    reversals = [
        {"t_s": float(n), "kind": "duty", "value": (0.5 * (-1) ** n * ways).tolist()}
        for n in range(5)
    ]
    numbers = dict(zip(IMPACT_KEYS, (3.002, *(push or ())), strict=False))
    hidden = [Effect("impact", numbers, run="run")] if push else []
    scenario = Scenario(
        "run", 5.0, replace(model, effects=hidden), reversals, sensors=Sensors(), seed=1
    )
    log = make_log(scenario, simulate_truth(scenario))
    columns = dict(log.columns)
    for name in [f"wheel/{wheel}/duty" for wheel in range(1, 5)]:
        duty = columns[name].copy()
        row = int(np.flatnonzero(np.abs(np.diff(duty)) > 0.4)[2])
        duty[row] += share * (duty[row + 1] - duty[row])
        columns[name] = duty
    machine = Machine(model)
    run = make_run(machine, replace(log, columns=columns))
    noise = tune_noise(machine, [make_run(machine, log)], machine.believed)
    [track] = track_all(machine, [run], machine.believed, noise)
    row = int(np.searchsorted(run.t_s, 3.002))
    filtered = track.state.reshape(len(run.t_s), -1)
    window = events._Window(machine, run, row, machine.believed, noise, filtered)
    least = window.least_without_push()
    if push is None:
        assert window.quiet > 100.0
        assert least < 0.1 * window.quiet
    else:
        assert least > 0.5 * window.quiet > 50.0


def test_what_begins_while_wheels_slide_begins_with_no_push():
    """By the wheels the first velocity of some of these is off by 0.3 to 1.2 m/s, as much as a push
    makes. The camera tells it; without one the filter finds it out before anything counts."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    logs = logs_of(TruthCase(5, runs=3, run_duration_s=20.0, base_offset_sd=0.0))
    blind = [replace(log, columns=_without_pose(log.columns)) for log in logs]
    noise = tune_noise(machine, [make_run(machine, log) for log in logs], machine.believed)
    assert find_impacts(machine, _pieces(machine, logs), machine.believed, noise) == []
    assert find_impacts(machine, _pieces(machine, blind), machine.believed, noise) == []
    believed_still = [replace(piece, at_rest=True) for piece in _pieces(machine, blind)]
    assert len(find_impacts(machine, believed_still, machine.believed, noise)) >= 3


def test_what_begins_amid_driving_is_followed_as_well_as_what_comes_later():
    machine = Machine(read_model(NOMINAL_ROBOT))
    logs = logs_of(TruthCase(5, runs=3, run_duration_s=20.0, base_offset_sd=0.0))
    noise = tune_noise(machine, [make_run(machine, log) for log in logs], machine.believed)
    pieces = _pieces(machine, logs)
    data = Data(machine, pieces, noise, believed_hypothesis(machine))
    [residual] = data.residuals(machine.believed[None])
    early, late = [], []
    for piece, own in zip(pieces, data.per_run(residual), strict=True):
        counted = piece.t_s[data.kept_rows(piece)]
        squares = np.mean(own.reshape(len(counted), -1) ** 2, axis=1)
        first = counted < piece.settled_s + 0.25
        early.append(squares[first].mean())
        late.append(squares[~first].mean())
    assert max(early) < 2.0 * np.mean(late)


def _without_gyro(columns):
    return {name: value for name, value in columns.items() if not name.startswith("gyro/")}


def _without_pose(columns):
    return {name: value for name, value in columns.items() if name not in POSE_COLUMNS}


def _pieces(machine, logs):
    """Pieces of two seconds from every half second on."""
    return [
        make_run(machine, log, begin, begin + 400)
        for log in logs
        for begin in range(500, 3500, 100)
    ]


@pytest.mark.parametrize(
    ("gain", "explained", "misfit", "speed_m_s", "seen", "confirmed"),
    [
        (1e3, 0.89, 5.0, 0.1, True, True),
        (1e3, 0.89, 27.0, 0.1, True, False),  # something else happened
        (1e5, 0.97, 27.0, 0.1, False, True),  # a push that lasts
        (1e5, 0.92, 27.0, 0.1, True, False),
        (1e5, 0.92, 27.0, 0.3, True, True),  # a hard one moves the robot meanwhile
        (1e5, 0.92, 27.0, 0.3, False, False),
        (1e5, 0.85, 5.0, 0.3, True, False),  # wheels that break loose
        (50.0, 0.97, 1.0, 0.1, True, False),
    ],
)
def test_the_plant_confirms_a_push(gain, explained, misfit, speed_m_s, seen, confirmed):
    deviations, jump = np.full(3, 0.3), np.array([speed_m_s, 0.0, 0.0])
    push = Impact("run_01", 1.0, np.ones(3), deviations, 0.0, misfit, gain, explained, jump, seen)
    assert push.confirmed == confirmed


@pytest.mark.parametrize(
    ("impulse", "deviations", "speed_n_s", "turn_n_m_s"),
    [
        ((3.0, 4.0, 0.5), (0.5, 0.5, 0.1), 5.0, 0.5),
        ((0.1, 0.1, 0.5), (0.5, 0.5, 0.01), 0.0, 0.5),  # it turns the robot alone
        ((0.9, 6.9, 0.06), (3.0, 4.5, 0.01), 0.0, 0.06),  # wheels slid, no camera: only a turn
        ((0.3, -0.4, 0.0), (0.13, 0.0, 0.1), 0.5, 0.0),  # open across it more than along
        ((1.0, 0.0, 0.0), (0.1, 1.0, 0.1), 0.0, 0.0),  # it may go anywhere
        ((1.0, 1.0, 1.0), (0.4, 0.4, 0.4), 0.0, 0.0),  # it may be nothing
    ],
)
def test_a_push_counts_by_what_is_known_to_a_quarter(impulse, deviations, speed_n_s, turn_n_m_s):
    model = read_model(NOMINAL_ROBOT)
    push = Impact("run_01", 1.0, np.array(impulse), np.array(deviations))
    turn_rad_s = turn_n_m_s / model.values["robot.inertia_kg_m2"]
    expected = speed_n_s / model.values["robot.mass_kg"]
    expected += turn_rad_s * model.values["robot.wheel_distance_m"]
    assert push.jump_m_s(Machine(model)) == pytest.approx(expected)


def test_an_impact_is_written_to_a_model_file_and_read_back(tmp_path):
    (impact,) = found_in(tmp_path, PUSHES[1])
    model = read_model(tmp_path / "robot.toml")
    model.effects.append(as_effect(impact))
    write_model(model, tmp_path / "amended.toml")
    assert read_model(tmp_path / "amended.toml").effects == [as_effect(impact)]


@pytest.mark.parametrize(
    ("command_of_other", "run_of_other", "time_of_other_s", "kept"),
    [
        (0.0, "run_02", 2.51, 0),
        (0.0, "run_02", 2.6, 2),
        (0.3, "run_02", 2.51, 2),
        (0.0, "run_01", 2.51, 2),
    ],
    ids=["repeated", "another time", "other commands", "same run"],
)
def test_what_another_run_of_the_same_commands_has_too_is_no_push(
    command_of_other, run_of_other, time_of_other_s, kept
):
    t_s = np.arange(0.0, 5.0, 0.01)
    wave = 0.4 * np.sin(3.0 * t_s)[:, None] * np.ones(4)
    runs = [
        SimpleNamespace(name="run_01", t_s=t_s, command=wave, row_s=0.01),
        SimpleNamespace(name="run_02", t_s=t_s, command=wave + command_of_other, row_s=0.01),
    ]
    push, none = np.array([-0.5, 2.0, 0.0]), np.zeros(3)
    impacts = [Impact("run_01", 2.5, push, none), Impact(run_of_other, time_of_other_s, push, none)]
    assert len(without_repeated(runs, impacts)) == kept


@pytest.mark.parametrize(
    ("other_s", "jump_of_other", "rising", "kept"),
    [
        (3.0, (0.1, 0.2, 0.0), 3.0, 0),  # 1 s later the commands are the same
        (2.5, (-0.1, -0.25, 0.1), 3.0, 0),  # half of that later the opposite ones
        (2.5, (0.1, 0.2, 0.0), 3.0, 2),
        (3.0, (0.2, -0.1, 0.0), 3.0, 2),
        (2.25, (0.1, 0.2, 0.0), 3.0, 2),  # other commands
        (3.0, (0.1, 0.2, 0.0), 0.3, 2),  # commands that hardly move
    ],
)
def test_what_comes_each_time_the_robot_reverses_is_no_push(other_s, jump_of_other, rising, kept):
    t_s = np.arange(0.0, 5.0, 0.01)
    wave = rising / (2.0 * np.pi) * np.sin(2.0 * np.pi * t_s)[:, None] * np.ones(4)
    runs = [SimpleNamespace(name="run_01", t_s=t_s, command=wave, row_s=0.01)]
    impacts = [
        Impact("run_01", at_s, np.ones(3), np.zeros(3), jump=np.array(jump))
        for at_s, jump in ((2.0, (0.1, 0.2, 0.0)), (other_s, jump_of_other))
    ]
    assert len(without_repeated(runs, impacts)) == kept


@pytest.mark.parametrize(("braking_fraction", "before_row"), [(1.0, 4), (0.3, 4), (0.3, 1)])
def test_a_driver_that_freewheels_switches_where_its_command_changes_sign(
    tmp_path, braking_fraction, before_row
):
    """Unsure are rows in which a command may cross zero, and the next: three; 2 mu g each."""
    write_case(TruthCase(seed=3, runs=1, run_duration_s=1.0), tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    t_s = 0.005 * np.arange(10)
    falling = np.array([0.12, 0.12, 0.10, 0.05, 0.01, -0.01, -0.06, -0.1, -0.1, -0.1])
    run = SimpleNamespace(t_s=t_s, command=falling[:, None] * np.ones(4))
    model = machine.believed.copy()
    model[machine.place("driver_freewheel", "braking_fraction", None)[0]] = braking_fraction
    unsure_s = 0.015 if braking_fraction < 1.0 and before_row == 4 else 0.0
    feigned = events._feigned_m_s(machine, run, before_row, model)
    assert feigned == pytest.approx(2.0 * 0.6 * 9.81 * unsure_s)
    still = SimpleNamespace(t_s=t_s, command=np.zeros((10, 4)))
    assert events._feigned_m_s(machine, still, before_row, model) == 0.0


@pytest.mark.parametrize("step", [0.09, 0.11])
def test_a_driver_that_freewheels_may_slide_after_a_jump_of_any_size(step):
    """Two rows next to a command that crosses zero, and what the jump alone may feign less."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    ramp = step * np.clip(np.arange(8) - 3.5, -0.5, 0.5)[:, None] * np.array([1.0, 0.0, 0.0, 0.0])
    run = SimpleNamespace(t_s=0.005 * np.arange(8), command=ramp)
    model = machine.believed.copy()
    model[machine.place("driver_freewheel", "braking_fraction", None)[0]] = 0.3
    slide_m_s = 2.0 * 0.6 * 9.81 * 0.005
    assert events._feigned_m_s(machine, run, 4, model) > 2.0 * slide_m_s


@pytest.mark.parametrize("step", [0.12, 1.0])
def test_jumps_of_a_command_feign_what_the_motors_pull_or_the_grip_holds(step):
    """Up to a row of it at each jump of the last tenth of a second, in squares, and beside the row.

    24 V / 0.6 Ohm * 0.0255 N m/A * 12 / 0.05 m on each of four wheels of 20 kg; 2 mu g at most.
    """
    model = read_model(NOMINAL_ROBOT)
    machine, values = Machine(model), model.values
    wheel_n = values["motor.supply_v"] / values["motor.resistance_ohm"]
    wheel_n *= values["motor.torque_constant_nm_a"] * values["motor.gear_ratio"]
    wheel_n /= values["robot.wheel_radius_m"]
    pull_m_s2 = min(2.0 * step * 4.0 * wheel_n / values["robot.mass_kg"], 2.0 * 0.6 * 9.81)
    to_and_fro = 0.5 * step * (-1.0) ** np.arange(40)[:, None] * np.ones(4)
    run = SimpleNamespace(t_s=0.005 * np.arange(40), command=to_and_fro)
    feigned = events._feigned_m_s(machine, run, 30, machine.believed)
    assert feigned == pytest.approx(0.005 * pull_m_s2 * (19.0**0.5 + 1.0))


@pytest.mark.parametrize(
    ("after_s", "shown", "told"), [(0.2, False, 1), (0.2, True, 2), (0.4, False, 2)]
)
def test_what_comes_soon_after_a_push_has_to_show_in_a_run_that_begins_behind_it(
    monkeypatch, after_s, shown, told
):
    """However little of the log is left behind it."""
    model = read_model(NOMINAL_ROBOT)
    driving = [{"t_s": 0.0, "kind": "velocity", "value": [0.3, 0.2, 0.5]}]
    scenario = Scenario("run", 2.0, model, driving, sensors=Sensors(), seed=1)
    log, machine = make_log(scenario, simulate_truth(scenario)), Machine(model)
    begun, first_s = [], 1.5
    pushes = [Impact("run", at_s, np.ones(3), np.zeros(3)) for at_s in (first_s, first_s + after_s)]
    monkeypatch.setattr(find, "find_impacts", lambda *_: pushes)
    monkeypatch.setattr(find, "shows", lambda _, run, *__: begun.append(run.t_s[0]) or shown)
    runs, believed = [make_run(machine, log)], believed_hypothesis(machine)
    assert find._pushes_in(machine, [log], runs, believed, None) == pushes[:told]
    if after_s < events.APART_S:
        assert begun == [pytest.approx(first_s + events.CUT_S, abs=0.006)]


@pytest.mark.parametrize(("pushes", "often"), [(0, False), (1, False), (5, False), (6, True)])
def test_more_than_a_push_every_four_seconds_is_too_often(pushes, often):
    runs = [SimpleNamespace(t_s=np.arange(0.0, 10.05, 0.1)) for _ in range(2)]
    assert too_often(runs, [None] * pushes) == often


def test_one_push_is_never_too_often():
    assert not too_often([SimpleNamespace(t_s=np.array([0.0, 2.0]))], [None])


@pytest.mark.parametrize(
    ("run", "cut"), [("run_01", ["a/run_01", "b/run_01"]), ("b/run_01", ["b/run_01"]), ("01", [])]
)
def test_a_push_of_the_model_file_is_one_of_the_logs_it_names(run, cut):
    model = SimpleNamespace(effects=[as_effect(Impact(run, 2.0, np.zeros(3), np.zeros(3)))])
    logs = [Log(name, np.arange(2.0), {}) for name in ("a/run_01", "b/run_01", "run_02")]
    assert known_pushes(model, logs) == [(name, 2.0) for name in cut]


def test_a_log_is_cut_at_its_own_pushes_and_short_pieces_are_dropped():
    t_s = np.arange(0.0, 6.0, 0.01)
    log = Log("run_02", t_s, {})
    cut = pieces(log, [("run_02", 2.0), ("run_02", 2.5), ("run_01", 4.0)])
    spans = [(t_s[a], t_s[b - 1]) for a, b in cut]
    assert spans == [(0.0, pytest.approx(1.98)), (pytest.approx(2.55), pytest.approx(5.99))]


# ---- commands that jump within a row ----

ROBOT = Machine(read_model(NOMINAL_ROBOT))
FULL = np.array([[1.0, 1.0, 1.0, 1.0], [1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0]])
"""Duties that turn a robot, or move it along an axis."""
PARTS = 10


def jumping_log(seed):
    """4 s of a robot whose duties jump at any time, with noise; rows of 5 ms."""
    rng = np.random.default_rng(seed)
    rows, at = 800, 200
    t_s = np.arange(rows * PARTS + 1) * 5e-3 / PARTS
    duty = np.zeros((len(t_s), 4))
    while at < len(t_s):
        steps, level = int(rng.integers(300, 900)), 0.3 * rng.uniform(-1.0, 1.0, 4)
        if rng.integers(0, 3) == 0:
            steps = int(rng.integers(60, 200))
            level = rng.choice([-1.0, 1.0]) * FULL[rng.integers(0, 3)]
        duty[at : at + steps] = level
        at += steps
    silent, still = np.zeros((len(t_s), 8)), np.zeros(14)
    finely = ROBOT.engine.recording(t_s, duty, silent, still)
    tracks = ROBOT.engine.track([finely], ROBOT.believed, still, np.ones(8), still)
    [[error]] = ROBOT.engine.replays([finely], tracks, ROBOT.believed[None], 2.5e-4, 1e9)
    shown = -error[::PARTS]
    mean = duty[:-1].reshape(rows, PARTS, 4).mean(axis=1)
    columns = {f"wheel/{w + 1}/duty": np.append(mean[:, w], duty[-1, w]) for w in range(4)}
    counts = np.floor(shown[:, :4] * 2000 / (2 * np.pi))
    columns |= {f"wheel/{w + 1}/encoder_counts": counts[:, w] for w in range(4)}
    columns["gyro/z_rad_s"] = shown[:, 4] + 0.004 * rng.standard_normal(rows + 1)
    pose = shown[:, 5:8] + rng.standard_normal((rows + 1, 3)) * [1e-3, 1e-3, 3e-3]
    pose[np.arange(rows + 1) % 4 != 0] = np.nan
    columns |= {name: pose[:, k] for k, name in enumerate(POSE_COLUMNS)}
    return Log(f"run_{seed:02d}", t_s[::PARTS], columns)


def test_a_jump_of_the_command_within_a_row_is_no_push(monkeypatch):
    """To full duty, beyond the grip; taken as held for the row it is force at the contacts."""
    logs = [jumping_log(seed) for seed in range(8, 12)]

    def found():
        runs = [make_run(ROBOT, log) for log in logs]
        noise, model = first_model(ROBOT, runs)
        values = model.flat(ROBOT.believed)
        tracks = track_all(ROBOT, runs, values, noise)
        likelihood = sum(track.log_likelihood for track in tracks)
        return find_impacts(ROBOT, runs, values, noise), likelihood, noise.logs[CONTACT]

    impacts, likelihood, contact = found()
    assert impacts == []
    monkeypatch.setattr(recordings, "parted_at_jumps", lambda *rows: (*rows, np.zeros(0, np.intp)))
    _, likelihood_held, contact_held = found()
    assert likelihood > likelihood_held + 1000.0
    assert contact_held > contact + np.log(4.0)


@pytest.mark.parametrize(
    ("lost", "time_s", "beside"),
    [(0, 0.1, False), (1, 0.1, False), (2, 0.1, True), (8, 0.12, True), (8, 0.06, False)],
)
def test_a_push_where_rows_are_missing_is_known_as_such(lost, time_s, beside):
    """Rows of 5 ms, some of them lost behind 0.1 s; a push before, or in, the gap."""
    t_s = np.arange(60) * 0.005
    t_s = np.delete(t_s, np.arange(21, 21 + lost))
    assert beside_lost_rows(Log("run", t_s, {}), time_s) == beside
