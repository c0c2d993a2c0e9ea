"""Logs that no camera sees begin where what is fixed to the world tells, and else where they do."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from omnislip.gap.evaluate import evaluate_model
from omnislip.gap.first_models import first_models
from omnislip.gap.recordings import machine_for, reckoned_pose, sees_pose
from omnislip.gap.split import split_runs
from omnislip.gap.starts import begun, find_starts
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.gap.words import OTHER_STARTS
from omnislip.log_file import write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model
from truth_bench import logs_of

SLOPE = HiddenEffect("floor_slope", {"x_m_s2": 0.25, "y_m_s2": -0.15})
CARPET = HiddenEffect("carpet_anisotropy", {"cos2": 0.2, "sin2": 0.1})
TETHER = HiddenEffect("tether_spring", {"stiffness_n_m": 8.0, "x_m": 0.6, "y_m": -0.4})
DRAG = HiddenEffect("one_wheel_drag", {"torque_nm": 0.01}, 3)
EFFECTS = {None: (), **{one.name: (one.as_dict(),) for one in (SLOPE, CARPET, TETHER, DRAG)}}
DIRECTED = {SLOPE.name: 1, CARPET.name: 2}


@cache
def seen(name):
    """Four logs of a robot with an effect, seen by a camera."""
    return logs_of(TruthCase(seed=5, runs=4, run_duration_s=6.0, effects=EFFECTS[name]))


def unseen(logs):
    """The same without the camera."""
    return [
        replace(log, columns={k: v for k, v in log.columns.items() if not k.startswith("pose")})
        for log in logs
    ]


def begun_poses(name):
    """Where they begin (4, 3)."""
    columns = ("pose/x_m", "pose/y_m", "pose/theta_rad")
    return np.array([[log.columns[column][0] for column in columns] for log in seen(name)])


def starts_of(logs, model=None):
    robot = machine_for(model or read_model(NOMINAL_ROBOT), logs)
    machine, noise, first = first_models(robot, split_runs(robot, logs).fitting)
    return find_starts(machine, logs, [], noise, first)


def headings(logs, starts):
    return np.array([begun(log, starts).begun_at[2] for log in logs])


def with_effect(one):
    model = read_model(NOMINAL_ROBOT)
    return replace(model, effects=[Effect(one.name, dict(one.parameters), None)])


def off_rad(found, true, rounds):
    """Angle by which headings are off, of an effect that is the same after a part of a turn."""
    return np.abs(np.angle(np.exp(1j * rounds * (found - true)))) / rounds


@pytest.mark.parametrize("effect", [SLOPE, CARPET], ids=lambda one: one.name)
def test_a_direction_tells_how_logs_are_turned(effect):
    logs = unseen(seen(effect.name))
    starts = starts_of(logs)
    found, true = headings(logs, starts), begun_poses(effect.name)[:, 2]
    assert found[0] == 0.0
    assert off_rad(found, true - true[0], DIRECTED[effect.name]).max() < 0.15
    assert starts_of([begun(log, starts) for log in logs]) == {}


def test_a_spring_tells_where_logs_begin():
    """What holds it is in one place, wherever and whichever way the logs begin."""
    logs = unseen(seen(TETHER.name))
    starts = starts_of(logs)
    assert begun(logs[0], starts).begun_at == (0.0, 0.0, 0.0)
    held = TETHER.parameters["x_m"] + 1j * TETHER.parameters["y_m"]
    places = []
    for log, true in zip(logs, begun_poses(TETHER.name), strict=True):
        x_m, y_m, heading = begun(log, starts).begun_at
        from_log = (held - complex(*true[:2])) * np.exp(-1j * true[2])
        places.append(complex(x_m, y_m) + from_log * np.exp(1j * heading))
    assert np.abs(np.array(places) - places[0]).max() < 0.1
    assert starts_of([begun(log, starts) for log in logs]) == {}


def test_starts_that_are_a_bit_off_are_moved_on_by_a_model_that_has_the_effect():
    """A first model that lacks other effects, too, tells them less well."""
    true = begun_poses(SLOPE.name)[:, 2]
    off = np.array([0.0, 0.4, -0.4, 0.2])
    logs = [
        replace(log, begun_at=(0.0, 0.0, float(heading)))
        for log, heading in zip(unseen(seen(SLOPE.name)), true - true[0] + off, strict=True)
    ]
    robot = machine_for(read_model(NOMINAL_ROBOT), logs)
    machine, noise, first = first_models(robot, split_runs(robot, logs).fitting)
    [slope] = [c for c in machine.candidates() if c.effect == SLOPE.name]
    model = first.with_effect(slope, [0.2, 0.1])
    moved = find_starts(machine, logs, [], noise, model)
    assert off_rad(headings(logs, moved), true - true[0], 1).max() < 0.1
    assert find_starts(machine, logs, [], noise, first) == {}  # which knows nothing of it
    there = [begun(log, moved) for log in logs]
    assert find_starts(machine, there, [], noise, model) == {}


@pytest.mark.parametrize("effect", [SLOPE, CARPET], ids=lambda one: one.name)
def test_logs_with_a_camera_are_the_frame_of_the_others(effect):
    logs = seen(effect.name)
    logs = [*logs[:2], *unseen(logs[2:])]
    starts = starts_of(logs)
    assert list(starts) == [log.name for log in logs[2:]]
    off = off_rad(
        headings(logs[2:], starts), begun_poses(effect.name)[2:, 2], DIRECTED[effect.name]
    )
    assert off.max() < 0.15


@pytest.mark.parametrize("name", EFFECTS)
def test_logs_with_a_camera_begin_where_it_says(name):
    assert starts_of(seen(name)) == {}


@pytest.mark.parametrize("name", [None, DRAG.name])
def test_where_nothing_is_fixed_to_the_world_no_start_is_told(name):
    assert starts_of(unseen(seen(name))) == {}


def test_evaluate_asks_where_logs_begin(tmp_path):
    """One log by itself, too: the model says in which direction the floor slopes."""
    write_model(with_effect(SLOPE), tmp_path / "robot.toml")
    logs = seen(SLOPE.name)[:1]
    figures = []
    for own in (logs, unseen(logs)):
        write_log(own[0], tmp_path / "run_01.csv")
        paths = [tmp_path / "run_01.csv"]
        figures.append(evaluate_model(tmp_path / "robot.toml", paths, lambda _: None))
    by_camera, by_slope = figures
    assert OTHER_STARTS not in by_camera["recording"]
    assert OTHER_STARTS in by_slope["recording"]
    for channel in ("encoder", "gyro"):
        [name] = [key for key in by_slope["channels"] if channel in key][:1]
        assert by_slope["channels"][name]["rmse"] < 1.5 * by_camera["channels"][name]["rmse"]


def test_a_piece_of_a_log_begins_where_the_robot_has_got_to():
    for log, first in zip(seen(None), begun_poses(None), strict=True):
        shown = np.flatnonzero(~np.isnan(log.columns["pose/theta_rad"]))
        row = int(shown[len(shown) // 2])
        pose = [log.columns[f"pose/{k}"][row] for k in ("x_m", "y_m", "theta_rad")]
        [blind] = unseen([replace(log, begun_at=tuple(first))])
        assert sees_pose(log) and not sees_pose(blind)
        machine = machine_for(read_model(NOMINAL_ROBOT), [blind])
        off = reckoned_pose(machine, blind, row) - pose
        x_m, y_m = (log.columns[f"pose/{k}_m"][shown[: len(shown) // 2]] for k in "xy")
        way_m = np.hypot(np.diff(x_m), np.diff(y_m)).sum()
        assert np.hypot(*off[:2]) < 0.15 * way_m  # wheels slide
        assert abs(off[2]) < 0.03
        np.testing.assert_allclose(reckoned_pose(machine, blind, 0), first)
