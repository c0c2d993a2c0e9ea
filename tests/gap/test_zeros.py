"""Encoders that count from elsewhere: zeros are found from what repeats, and from nothing else."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.evaluate import evaluate_model
from omnislip.gap.first_models import first_models
from omnislip.gap.machine import count_rad
from omnislip.gap.recordings import machine_for
from omnislip.gap.split import split_runs
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.gap.words import OTHER_ZEROS
from omnislip.gap.zeros import find_zeros, moved
from omnislip.log_file import Log, write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model
from truth_bench import logs_of

GEAR = read_model(NOMINAL_ROBOT).values["motor.gear_ratio"]
COGGING = HiddenEffect("cogging", {"torque_nm": 0.01, "cycles_per_rev": 5.0, "phase_rad": 1.0})
ECCENTRIC = HiddenEffect("wheel_eccentricity", {"amplitude": 0.03, "phase_rad": 1.0}, 2)
RIPPLE = HiddenEffect("roller_ripple", {"amplitude": 0.25, "rollers": 9.0})
DRAG = HiddenEffect("one_wheel_drag", {"torque_nm": 0.01}, 3)
EFFECTS = [COGGING, ECCENTRIC, RIPPLE, DRAG]
PER_RAD = {COGGING.name: 5.0, ECCENTRIC.name: 1.0 / GEAR, RIPPLE.name: 9.0 / GEAR}


@cache
def logs_with(number):
    hidden = () if number is None else (EFFECTS[number].as_dict(),)
    return logs_of(TruthCase(seed=5, runs=4, run_duration_s=5.0, effects=hidden))


def robot_logs(effect=None):
    """Four logs of a robot with an effect, its encoders counting from the shafts' zero."""
    return logs_with(None if effect is None else EFFECTS.index(effect))


def elsewhere(logs):
    """The same with encoders that count from anywhere, and by how many counts (logs, 4)."""
    off = np.random.default_rng(1).integers(-20_000, 20_000, (len(logs), 4))
    return [moved(log, {log.name: -by}) for log, by in zip(logs, off, strict=True)], off


def zeros_of(logs, model=None):
    model = model or read_model(NOMINAL_ROBOT)
    robot = machine_for(model, logs)
    machine, noise, first = first_models(robot, split_runs(robot, logs).fitting)
    return machine, find_zeros(machine, logs, [], noise, first)


def angles_off(machine, logs, zeros, off, per_rad, wheels):
    """Phase by which what repeats is off in each log and at each wheel, as exp(i x)."""
    found = np.array([zeros[log.name] for log in logs])
    turned = per_rad * count_rad(machine) * (found - off)
    return np.exp(1j * turned[:, [wheel - 1 for wheel in wheels]])


@pytest.mark.parametrize("effect", [COGGING, ECCENTRIC, RIPPLE], ids=lambda one: one.name)
def test_what_repeats_tells_where_encoders_count_from(effect):
    """One phase of a wheel or of cogging is its own, a ripple's is 0; and then it is all told."""
    there = robot_logs(effect)
    logs, off = elsewhere(there)
    machine, zeros = zeros_of(logs)
    assert list(zeros) == [log.name for log in logs]
    wheels = (1, 2, 3, 4) if effect.wheel is None else (effect.wheel,)
    turned = angles_off(machine, logs, zeros, off, PER_RAD[effect.name], wheels)
    phase = 1.0 if effect is RIPPLE else turned.mean()
    assert np.abs(np.angle(turned / phase)).max() < 0.15
    _, again = zeros_of([moved(log, zeros) for log in logs])
    assert again == {}


def test_a_model_that_has_it_keeps_its_phase():
    logs, off = elsewhere(robot_logs(ECCENTRIC))
    known = read_model(NOMINAL_ROBOT)
    known = replace(known, effects=[Effect(ECCENTRIC.name, dict(ECCENTRIC.parameters), 2)])
    machine, zeros = zeros_of(logs, known)
    turned = angles_off(machine, logs, zeros, off, PER_RAD[ECCENTRIC.name], [2])
    assert np.abs(np.angle(turned)).max() < 0.15


@pytest.mark.parametrize("effect", [None, COGGING, ECCENTRIC, RIPPLE])
def test_encoders_that_count_from_the_same_place_are_left_alone(effect):
    _, zeros = zeros_of(robot_logs(effect))
    assert zeros == {}


def test_where_nothing_repeats_no_zero_is_told():
    _, zeros = zeros_of(elsewhere(robot_logs(DRAG))[0])
    assert zeros == {}


@given(st.lists(st.integers(-40_000, 40_000), min_size=4, max_size=4))
def test_moving_counts_moves_those_of_its_log_and_nothing_else(by):
    counts = {
        f"wheel/{wheel}/encoder_counts": np.array([3.0, 5.0, np.nan]) for wheel in range(1, 5)
    }
    log = Log("run_01", np.arange(3.0), {**counts, "gyro/z_rad_s": np.ones(3)})
    assert moved(log, {"run_02": np.array(by)}) is log
    there = moved(log, {"run_01": np.array(by)})
    for wheel, own in enumerate(by, start=1):
        name = f"wheel/{wheel}/encoder_counts"
        np.testing.assert_array_equal(there.columns[name], counts[name] + own)
    assert there.columns["gyro/z_rad_s"] is log.columns["gyro/z_rad_s"]


def test_evaluate_asks_where_encoders_count_from(tmp_path):
    """A robot that is right is as right where its encoders count from elsewhere."""
    there = robot_logs(ECCENTRIC)
    model = read_model(NOMINAL_ROBOT)
    model = replace(model, effects=[Effect(ECCENTRIC.name, dict(ECCENTRIC.parameters), 2)])
    write_model(model, tmp_path / "robot.toml")
    figures = []
    for logs in (there, elsewhere(there)[0]):
        paths = [tmp_path / f"{log.name}.csv" for log in logs]
        for log, path in zip(logs, paths, strict=True):
            write_log(log, path)
        figures.append(evaluate_model(tmp_path / "robot.toml", paths, lambda _: None))
    same, other = figures
    assert OTHER_ZEROS in other["recording"]
    assert OTHER_ZEROS not in same["recording"]
    for channel, own in other["channels"].items():
        assert own["rmse"] == pytest.approx(same["channels"][channel]["rmse"], rel=0.05)
