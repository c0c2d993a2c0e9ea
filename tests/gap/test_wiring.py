"""Wiring mistakes: mended in the logs, found by trying every one."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.find import find_gap
from omnislip.gap.machine import Machine
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.wiring import find_wiring, mend
from omnislip.log_file import Log, read_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model

MACHINE = Machine(read_model(NOMINAL_ROBOT))
MISTAKES = [
    Effect("wheel_permutation", {"wheels": [2, 1, 3, 4]}),
    Effect("wheel_permutation", {"wheels": [3, 1, 4, 2]}),
    Effect("encoder_sign", {}, 2),
    Effect("motor_sign", {}, 4),
]


def some_log() -> Log:
    names = [f"wheel/{w}/{q}" for w in range(1, 5) for q in ("duty", "encoder_counts")]
    columns = {name: np.arange(3.0) + 10 * number for number, name in enumerate(names)}
    return Log("run", np.arange(3.0), columns)


def logs_of(folder, effects, sensors=("gyro", "pose")):
    case = TruthCase(seed=5, effects=effects, sensors=sensors, runs=2, run_duration_s=5.0)
    write_case(case, folder)
    return [read_log(path, "robot") for path in sorted(folder.glob("run_*.csv"))]


def as_hidden(effect: Effect) -> dict:
    return {
        "name": effect.name,
        "wheel": effect.wheel,
        "parameters": effect.parameters,
        "run": None,
    }


@given(st.permutations([1, 2, 3, 4]))
def test_a_permuted_log_is_put_back_in_order(order):
    """Column i shows wheel order[i]; mended, column w shows wheel w."""
    right = some_log()
    shown = dict(right.columns)
    for column, wheel in enumerate(order, 1):
        name = f"wheel/{column}/encoder_counts"
        shown[name] = right.columns[f"wheel/{wheel}/encoder_counts"]
    mistake = Effect("wheel_permutation", {"wheels": order})
    mended = mend(dataclasses.replace(right, columns=shown), [mistake])
    assert all(np.array_equal(mended.columns[n], right.columns[n]) for n in right.columns)


@pytest.mark.parametrize("effect", MISTAKES[2:])
def test_a_sign_mended_twice_is_the_log_itself(effect):
    log = some_log()
    twice = mend(mend(log, [effect]), [effect])
    assert all(np.array_equal(twice.columns[n], log.columns[n]) for n in log.columns)
    assert any(
        not np.array_equal(mend(log, [effect]).columns[n], log.columns[n]) for n in log.columns
    )


@pytest.mark.parametrize("effect", MISTAKES)
@pytest.mark.parametrize("sensors", [(), ("gyro", "pose")])
def test_a_mistake_is_found_and_no_other(tmp_path, effect, sensors):
    assert find_wiring(MACHINE, logs_of(tmp_path, (as_hidden(effect),), sensors)) == [effect]


def test_two_mistakes_are_found_one_by_one(tmp_path):
    both = (as_hidden(MISTAKES[2]), as_hidden(MISTAKES[3]))
    found = find_wiring(MACHINE, logs_of(tmp_path, both))
    assert sorted(effect.name for effect in found) == ["encoder_sign", "motor_sign"]


@pytest.mark.parametrize("name, size", [("weak_motor", {"scale": 0.6}), (None, {})])
def test_a_robot_that_is_only_wrong_in_its_physics_is_wired_right(tmp_path, name, size):
    hidden = ({"name": name, "wheel": 1, "parameters": size, "run": None},) if name else ()
    assert find_wiring(MACHINE, logs_of(tmp_path, hidden)) == []


def test_the_amended_model_reads_the_miswired_logs_without_a_gap(tmp_path):
    logs_of(tmp_path, (as_hidden(MISTAKES[0]),))
    paths = sorted(tmp_path.glob("run_*.csv"))
    first = find_gap(tmp_path / "robot.toml", paths, lambda _: None)
    assert first.verdict == "effect_found"
    from omnislip.model_file import write_model

    write_model(first.amended, tmp_path / "amended.toml")
    second = find_gap(tmp_path / "amended.toml", paths, lambda _: None)
    assert (second.verdict, second.wiring) == ("no_gap", [])
