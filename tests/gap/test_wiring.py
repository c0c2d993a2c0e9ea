"""Wiring mistakes: mended in the logs, found by trying every one."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.gap.machine import Machine
from omnislip.gap.report import render
from omnislip.gap.truth import TruthCase, generate, write_case
from omnislip.gap.truth_effects import typical_effect
from omnislip.gap.wiring import find_wirings, mend
from omnislip.log_file import Log, read_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, simulate_truth

MACHINE = Machine(read_model(NOMINAL_ROBOT))
MISTAKES = [
    Effect("wheel_permutation", {"wheels": [2, 1, 3, 4]}),
    Effect("wheel_permutation", {"wheels": [3, 1, 4, 2]}),
    Effect("encoder_sign", {}, 2),
    Effect("motor_sign", {}, 4),
]
MOTORS_IN_OTHER_PLACES = [
    Effect("wheel_permutation", {"wheels": [1, 2, 4, 3], "of": "both"}),
    Effect("wheel_permutation", {"wheels": [2, 3, 1, 4], "of": "both"}),
    Effect("wheel_permutation", {"wheels": [1, 3, 2, 4], "of": "motors"}),
    Effect("wheel_permutation", {"wheels": [4, 3, 1, 2], "of": "motors"}),
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
    assert find_wirings(MACHINE, logs_of(tmp_path, (as_hidden(effect),), sensors)) == [[effect]]


@pytest.mark.parametrize("effect", MOTORS_IN_OTHER_PLACES)
@pytest.mark.parametrize(
    "signs", [[], [Effect("motor_sign", {}, 1), Effect("encoder_sign", {}, 2)]]
)
@pytest.mark.parametrize("sensors", [("pose",), ("gyro", "pose", "current")])
def test_motors_may_have_changed_places_alone_or_with_their_encoders(
    tmp_path, effect, signs, sensors
):
    logs = [miswired(log, [effect, *signs]) for log in logs_of(tmp_path, (), sensors)]
    [found] = find_wirings(MACHINE, logs)
    assert found[0] == effect
    assert sorted(map(repr, found[1:])) == sorted(map(repr, signs))


@pytest.mark.parametrize("of", ["encoders", "motors"])
def test_without_gyro_and_camera_wheels_across_are_told_by_what_the_motors_feel(tmp_path, of):
    """Rims add up to a motion of a body either way: to one that the duties cause or not."""
    order = {"wheels": [3, 2, 1, 4]} | ({} if of == "encoders" else {"of": of})
    across = Effect("wheel_permutation", order)
    logs = [miswired(log, [across]) for log in logs_of(tmp_path, (), ())]
    assert find_wirings(MACHINE, logs) == [[across]]


def test_duty_and_current_of_motors_that_changed_places_move_together():
    log = some_log()
    currents = {f"wheel/{w}/current_a": 100.0 * w + np.arange(3.0) for w in range(1, 5)}
    log = dataclasses.replace(log, columns=log.columns | currents)
    moved = mend(log, [Effect("wheel_permutation", {"wheels": [2, 3, 4, 1], "of": "motors"})])
    for column, wheel in ((1, 2), (2, 3), (3, 4), (4, 1)):
        for signal in ("duty", "current_a"):
            shown = log.columns[f"wheel/{column}/{signal}"]
            assert np.array_equal(moved.columns[f"wheel/{wheel}/{signal}"], shown)
        own = f"wheel/{wheel}/encoder_counts"
        assert np.array_equal(moved.columns[own], log.columns[own])


def test_two_mistakes_are_found_together(tmp_path):
    both = (as_hidden(MISTAKES[2]), as_hidden(MISTAKES[3]))
    [found] = find_wirings(MACHINE, logs_of(tmp_path, both))
    assert sorted(effect.name for effect in found) == ["encoder_sign", "motor_sign"]


def signs(name, *wheels):
    return [Effect(name, {}, wheel) for wheel in wheels]


MANY = {
    "all encoders": signs("encoder_sign", 1, 2, 3, 4),
    "all motors": signs("motor_sign", 1, 2, 3, 4),
    "a wheel's both": signs("encoder_sign", 1) + signs("motor_sign", 1),
    "order and signs": [
        Effect("wheel_permutation", {"wheels": [3, 4, 2, 1]}),
        *signs("encoder_sign", 2, 3),
        *signs("motor_sign", 1),
    ],
}
EVERYTHING = MANY["all encoders"] + MANY["all motors"]


@pytest.mark.parametrize("sensors", [("gyro",), ("pose",), ("gyro", "pose")])
@pytest.mark.parametrize("mistakes", MANY)
def test_many_mistakes_are_found_at_once(tmp_path, mistakes, sensors):
    hidden = tuple(as_hidden(effect) for effect in MANY[mistakes])
    assert find_wirings(MACHINE, logs_of(tmp_path, hidden, sensors)) == [MANY[mistakes]]


@pytest.mark.parametrize("mistakes", ["all encoders", "all motors"])
def test_without_gyro_and_camera_nothing_tells_encoders_from_motors(tmp_path, mistakes):
    hidden = tuple(as_hidden(effect) for effect in MANY[mistakes])
    found = find_wirings(MACHINE, logs_of(tmp_path, hidden, ()))
    assert len(found) == 2
    assert all(wiring in found for wiring in (MANY["all encoders"], MANY["all motors"]))


@pytest.mark.parametrize(("sensors", "seen"), [((), False), (("gyro",), False), (("pose",), True)])
def test_everything_reversed_shows_against_a_camera_only(tmp_path, sensors, seen):
    hidden = tuple(as_hidden(effect) for effect in EVERYTHING)
    found = find_wirings(MACHINE, logs_of(tmp_path, hidden, sensors))
    assert found == [EVERYTHING if seen else []]


def test_a_gyro_upside_down_is_no_wiring_of_the_wheels(tmp_path):
    logs = logs_of(tmp_path, (), ("gyro",))
    turned = [
        dataclasses.replace(g, columns=g.columns | {"gyro/z_rad_s": -g.columns["gyro/z_rad_s"]})
        for g in logs
    ]
    assert find_wirings(MACHINE, turned) == [[]]


# Rows of sensors, seconds, excitation, friction curve: what healthy logs may be like.
HEALTHY = [
    ((), 1.0, "rich", "tanh"),
    ((), 2.0, "poor", "brush"),
    (("gyro",), 1.0, "ordinary", "atan"),
    (("gyro",), 5.0, "poor", "brush"),
    (("pose",), 2.0, "rich", "tanh"),
    (("gyro", "pose", "supply", "current"), 3.0, "rich", "brush"),
]


@pytest.mark.parametrize(("sensors", "seconds", "excitation", "curve"), HEALTHY)
@pytest.mark.parametrize("hidden", [(), ("current_limit",), ("slippery_patch", "load_transfer")])
def test_healthy_logs_are_wired_right(sensors, seconds, excitation, curve, hidden):
    """Their believed keys are off by 10 %, their noise threefold."""
    case = TruthCase(
        seed=11,
        effects=tuple(typical_effect(name).as_dict() for name in hidden),
        friction_curve=curve,
        excitation=excitation,
        closed_loop=bool(hidden),
        sensors=sensors,
        runs=1,
        run_duration_s=seconds,
        noise_level=3.0,
        base_offset_sd=0.1,
    )
    [log], _ = generate(case)
    columns = {c: log[c].to_numpy(float) for c in log.columns[1:]}
    assert find_wirings(MACHINE, [Log("run", log["t_s"].to_numpy(), columns)]) == [[]]


@pytest.mark.parametrize("angles_deg", [(45.0, 135.0, 225.0, 315.0), (20.0, 100.0, 215.0, 300.0)])
@pytest.mark.parametrize("mistakes", [[], MANY["a wheel's both"], MANY["order and signs"]])
def test_wheels_may_stand_at_any_angles(angles_deg, mistakes):
    values = MACHINE.model.values | {"robot.wheel_angles_deg": list(angles_deg)}
    model = dataclasses.replace(MACHINE.model, values=values)
    generator = np.random.default_rng(2)
    velocities = generator.uniform(-1, 1, (8, 3)) * (0.8, 0.8, 3.0)
    commands = [
        {"t_s": 0.5 * k, "kind": "velocity", "value": velocity.tolist()}
        for k, velocity in enumerate(velocities)
    ]
    sensors = Sensors(gyro_noise_rad_s=0.003, pose_noise_m=0.001, pose_noise_rad=0.002)
    scenario = Scenario("run", 4.0, model, commands, sensors=sensors)
    log = make_log(scenario, simulate_truth(scenario))
    assert find_wirings(Machine(model), [miswired(log, mistakes)]) == [mistakes]


def miswired(log, mistakes):
    """The log as these mistakes would have it: the reverse of `mend`."""
    backwards = [
        Effect(
            m.name,
            m.parameters | {"wheels": [m.parameters["wheels"].index(w) + 1 for w in range(1, 5)]},
        )
        if m.name == "wheel_permutation"
        else m
        for m in reversed(mistakes)
    ]
    return mend(log, backwards)


def test_a_wiring_is_told_though_the_logs_are_refused(tmp_path):
    """What they are refused for has nothing to do with it: the supply is in millivolts."""
    logs_of(tmp_path, tuple(as_hidden(effect) for effect in MANY["all encoders"]), ())
    paths = sorted(tmp_path.glob("run_*.csv"))
    for path in paths:
        frame = pd.read_csv(path)
        frame["supply/voltage_v"] = 24e3
        frame.to_csv(path, index=False)
    findings = find_gap(tmp_path / "robot.toml", paths, lambda _: None)
    result = to_json(findings)
    assert result["verdict"] == "insufficient_data"
    assert "is it in mV?" in result["sentence"]
    assert "cannot tell this wiring from" in result["sentence"]
    names = [effect["name"] for effect in result["effects"]]
    assert names in (["encoder_sign"] * 4, ["motor_sign"] * 4)
    [other] = {"encoder_sign", "motor_sign"} - set(names)
    assert all(effect["ambiguous_with"] == [other] for effect in result["effects"])
    assert all(
        [r["wheel"] for r in effect["rivals"]] == [1, 2, 3, 4] for effect in result["effects"]
    )
    assert findings.amended.effects == findings.wiring
    assert render(findings, "omnislip").count(f"<h3>{names[0]} (wheel") == 4


def test_an_order_of_wheels_is_a_parameter_like_others(tmp_path):
    """With value, low and high: it is known exactly."""
    logs_of(tmp_path, (as_hidden(MISTAKES[1]),))
    path = tmp_path / "run_01.csv"
    pd.read_csv(path).assign(**{"supply/voltage_v": 24e3}).to_csv(path, index=False)
    result = to_json(find_gap(tmp_path / "robot.toml", [path], lambda _: None))
    assert result["verdict"] == "insufficient_data"
    [told] = result["effects"]
    order = MISTAKES[1].parameters["wheels"]
    assert told["parameters"] == {"wheels": {"value": order, "low": order, "high": order}}
    assert told["ambiguous_with"] == told["rivals"] == []


@pytest.mark.parametrize("name, size", [("weak_motor", {"scale": 0.6}), (None, {})])
def test_a_robot_that_is_only_wrong_in_its_physics_is_wired_right(tmp_path, name, size):
    hidden = ({"name": name, "wheel": 1, "parameters": size, "run": None},) if name else ()
    assert find_wirings(MACHINE, logs_of(tmp_path, hidden)) == [[]]


def test_the_amended_model_reads_the_miswired_logs_without_a_gap(tmp_path):
    logs_of(tmp_path, (as_hidden(MISTAKES[0]),))
    paths = sorted(tmp_path.glob("run_*.csv"))
    first = find_gap(tmp_path / "robot.toml", paths, lambda _: None)
    assert first.verdict == "effect_found"
    from omnislip.model_file import write_model

    write_model(first.amended, tmp_path / "amended.toml")
    second = find_gap(tmp_path / "amended.toml", paths, lambda _: None)
    assert (second.verdict, second.wiring) == ("no_gap", [])
