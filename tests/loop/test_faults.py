"""The supervisor on the plant with effects: no false alarm, and the faults that effects cause."""

import numpy as np
import pytest
from loop_run import FAULT_NONE, FAULT_UNDER_VOLTAGE, blow, command, effect, run
from omnislip import _core

HARD = [
    command("velocity", 1.5, 0.0, 2.0),
    command("velocity", -1.5, 1.0, -3.0, t_s=0.8),
    command("duty", 0.6, -0.6, 0.6, -0.6, t_s=1.6),
    command("duty", -0.6, 0.6, -0.6, 0.6, t_s=1.9),
    command("velocity", 0.0, -1.5, 0.0, t_s=2.2),
    command("pose", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, t_s=3.0),
]
CATALOGUE = [entry for entry in _core.effects() if "robot" in entry["kinds"]]


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry["name"])
def test_no_effect_of_typical_size_is_taken_for_a_fault(entry):
    wheel = {"single": 2}.get(entry["scope"])
    sizes = {p["name"]: p["neutral"] for p in entry["parameters"]}
    for p in entry["parameters"]:
        finite = p["neutral"] if np.isfinite(p["neutral"]) else 0.0
        sizes[p["name"]] = finite + p["typical"] if p["typical"] else p["neutral"]
    hard = effect(entry["name"], wheel, **sizes)
    truth = run(HARD, 4.5, effects=[hard], impulses=[blow(2.6, 10.0)])
    assert set(truth["fault"]) == {FAULT_NONE}


def test_a_supply_that_sags_below_its_minimum_stops_the_robot():
    sag = effect("supply_sag", source_resistance_ohm=0.5)
    truth = run([command("duty", 1.0, 1.0, 1.0, 1.0)], 0.5, effects=[sag])
    first = int(np.argmax(truth["fault"] != FAULT_NONE))
    assert set(truth["fault"][first:]) == {FAULT_UNDER_VOLTAGE}
    assert truth["duty"][:first].any() and not truth["duty"][first:].any()
