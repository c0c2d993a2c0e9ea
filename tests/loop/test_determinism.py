"""Same input, same bytes; finer steps, same run; and what cannot be simulated is refused."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from loop_run import FIRMWARE, PARAMETERS, blow, command, effect, run
from omnislip import _core

HARD = [
    command("velocity", 1.5, 0.0, 0.0),
    command("velocity", -1.0, 1.0, 2.0, t_s=1.0),
    command("duty", 0.4, -0.4, 0.4, -0.4, t_s=2.0),
    command("pose", 0.2, 0.1, 0.3, 0.0, 0.0, 0.0, t_s=2.5),
]
SLIDING = [
    command("duty", 0.5, -0.4, 0.3, -0.6),
    command("duty", -0.5, 0.4, -0.3, 0.6, t_s=0.3),
    command("duty", 0.5, 0.5, -0.5, -0.5, t_s=0.6),
]
ROBOT_EFFECTS = [entry for entry in _core.effects() if "robot" in entry["kinds"]]


def hard_run(**changes):
    return run(HARD, 3.0, impulses=[blow(0.8, 10.0)], **changes)


def as_bytes(truth):
    return {name: values.tobytes() for name, values in truth.items()}


def test_same_input_same_bytes():
    assert as_bytes(hard_run()) == as_bytes(hard_run())


def test_parallel_runs_give_the_same_as_one_after_the_other():
    changes = [
        {"controller": name, "parameters": {"robot.mass_kg": mass}}
        for name in ("plain", "slip")
        for mass in (18.0, 20.0, 22.0, 24.0)
    ]
    serial = [as_bytes(hard_run(**change)) for change in changes]
    with ThreadPoolExecutor(4) as pool:
        parallel = [as_bytes(r) for r in pool.map(lambda change: hard_run(**change), changes * 3)]
    assert parallel == serial * 3
    assert len({r["pose"] for r in serial}) == len(changes)


def test_a_fine_step_moves_the_robot_by_less_than_a_tenth_of_a_millimetre():
    """Open loop: no count may flip by the step, so that only the integration differs."""
    coarse, fine = (run(SLIDING, 1.0, **step) for step in ({}, {"step_s": 1e-4}))
    assert 0 < np.abs(coarse["pose"] - fine["pose"]).max() < 1e-4


def test_error_falls_with_the_step():
    """Fourth order: 2 to the fourth from 0.1 ms to 0.05 ms, with room for the reversals of slip."""
    exact = run(SLIDING, 1.0, step_s=1e-5)["pose"]
    coarse, fine = (
        np.abs(run(SLIDING, 1.0, step_s=step)["pose"] - exact).max() for step in (1e-4, 5e-5)
    )
    assert 8 < coarse / fine < 40
    assert coarse < 1e-6


@pytest.mark.parametrize("entry", ROBOT_EFFECTS, ids=lambda entry: entry["name"])
def test_a_neutral_effect_changes_no_bit(entry):
    neutral = {p["name"]: p["neutral"] for p in entry["parameters"]}
    wheel = {"single": 2}.get(entry["scope"])
    believed = as_bytes(hard_run())
    assert as_bytes(hard_run(effects=[effect(entry["name"], wheel, **neutral)])) == believed


@pytest.mark.parametrize("entry", ROBOT_EFFECTS, ids=lambda entry: entry["name"])
def test_a_typical_effect_changes_the_run_or_its_sensors(entry):
    sizes = {p["name"]: p["neutral"] for p in entry["parameters"]}
    for p in entry["parameters"]:
        finite = p["neutral"] if np.isfinite(p["neutral"]) and p["typical"] else 0.0
        sizes[p["name"]] = finite + p["typical"] if p["typical"] else p["neutral"]
    wheel = {"single": 2}.get(entry["scope"])
    changed = hard_run(effects=[effect(entry["name"], wheel, **sizes)])
    assert as_bytes(changed) != as_bytes(hard_run())
    assert all(np.isfinite(values).all() for values in changed.values())


def call(parameters=PARAMETERS, effects=(), firmware=FIRMWARE, commands=HARD, duration_s=0.1):
    return _core.simulate(parameters, list(effects), firmware, commands, [], duration_s)


def without(table, key):
    return {name: value for name, value in table.items() if name != key}


REFUSED = {
    "missing firmware parameter": ({"firmware": without(FIRMWARE, "mass_q8")}, "mass_q8"),
    "firmware parameter out of range": (
        {"firmware": FIRMWARE | {"command_timeout_ms": 0}},
        "command_timeout_ms",
    ),
    "unknown parameter": ({"parameters": PARAMETERS | {"robot.mas_kg": 1.0}}, r"robot\.mas_kg"),
    "unknown effect": ({"effects": [effect("supply_sagging", x=1.0)]}, "supply_sagging"),
    "wheel of no robot": ({"effects": [effect("weak_motor", 5, scale=0.9)]}, "wheel"),
    "unknown command": ({"commands": [command("jump", 1.0)]}, "stop, velocity, pose or duty"),
    "short command": ({"commands": [command("velocity", 1.0)]}, "number of values"),
    "speed beyond the firmware": ({"commands": [command("velocity", 99.0, 0, 0)]}, "velocity"),
    "place too far": ({"commands": [command("pose", 1e4, 0, 0, 0, 0, 0)]}, "250 m"),
    "pose that takes too long": ({"commands": [command("pose", 240.0, 0, 0, 0, 0, 0)]}, "60 s"),
    "no time": ({"duration_s": 0.0}, "duration_s"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_simulated_is_refused(case):
    changes, expected = REFUSED[case]
    with pytest.raises(ValueError, match=expected):
        call(**changes)


MISSPELT = {
    "unknown firmware parameter": ({"firmware": FIRMWARE | {"mas_q8": 1}}, "mas_q8"),
    "unknown effect parameter": (
        {"effects": [effect("supply_sag", resistance_ohm=0.1)]},
        "resistance_ohm",
    ),
}


@pytest.mark.parametrize("case", MISSPELT)
def test_a_misspelt_name_is_refused(case):
    changes, expected = MISSPELT[case]
    with pytest.raises(ValueError, match=expected):
        call(**changes)


def test_keys_left_out_are_the_nominal_robot():
    assert as_bytes(call(parameters={})) == as_bytes(call())
