"""The catalogue of effects: sound descriptions, and each effect does something."""

import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from engine_run import motors, parameter_set, simulate
from omnislip import _core
from omnislip.model_file import WIRING

CATALOGUE = {effect["name"]: effect for effect in _core.effects()}
DATA = Path(os.environ.get("OMNISLIP_DATA", Path(__file__).parents[2] / "../shared/data"))
DESIGN = DATA.parent / "design.md"


def size(parameter):
    """Typical value of an effect that has one, else a value well off neutral."""
    if math.isinf(parameter["neutral"]) and parameter["typical"] > 0.0:
        return parameter["typical"]
    return parameter["neutral"] + parameter["typical"]


# An axis like a motor of the robot, so that the typical sizes are typical of it too.
BASE = {
    "robot": {},
    "axis": {
        "axis.inertia": 2.5e-5,
        "axis.input_gain": 1.02,
        "axis.back_emf": 1.1e-3,
        "axis.friction_speed": 2.0,
        "axis.pendulum_mass_kg": 1e-3,
    },
    "odometry": {f"odometry.wheel_angles_deg[{i}]": 45.0 * i for i in range(8)},
}


def cases(kind):
    return [name for name, effect in CATALOGUE.items() if kind in effect["kinds"]]


def run(kind, effects):
    rng = np.random.default_rng(11)
    most = 8.0 if kind == "odometry" else 0.8  # rad/s of wheels, or a duty
    command = np.repeat(rng.uniform(-most, most, (30, motors(kind))), 10, axis=0)
    time = np.arange(len(command)) * 0.01
    initial = np.zeros({"robot": 14, "axis": 2, "odometry": 3}[kind])
    sets = [parameter_set(kind, BASE[kind]), parameter_set(kind, BASE[kind], effects)]
    return simulate(sets, time, command, initial, kind)


@pytest.mark.parametrize("kind", ["robot", "axis", "odometry"])
def test_every_effect_of_typical_size_shows_in_the_outputs(kind):
    silent = []
    for name in cases(kind):
        effects = [(name, p["name"], size(p)) for p in CATALOGUE[name]["parameters"]]
        if (kind, name) == ("axis", "current_limit"):
            effects = [(name, "limit_a", 0.3)]  # a torque there, and the command asks for 0.8
        if (kind, name) == ("odometry", "encoder_dropout"):  # encoders of wheels, not of motors
            effects = [(name, "fraction", 0.05), (name, "speed_rad_s", 3.0)]
        believed, with_effect = run(kind, effects)
        assert np.isfinite(with_effect).all(), name
        if np.abs(with_effect - believed).max() < 1e-4:
            silent.append(name)
    assert silent == []


def test_effect_on_one_wheel_is_not_the_effect_on_all():
    same = []
    for name in cases("robot"):
        effect = CATALOGUE[name]
        if effect["per_wheel"]:
            everywhere = [(name, p["name"], size(p)) for p in effect["parameters"]]
            alone = [(*parameter, 2) for parameter in everywhere]
            if np.abs(run("robot", everywhere)[1] - run("robot", alone)[1]).max() < 1e-4:
                same.append(name)
    assert same == []


@pytest.mark.parametrize("name", CATALOGUE)
def test_description_is_complete_and_its_bounds_are_in_order(name):
    effect = CATALOGUE[name]
    assert effect["summary"].endswith(".")
    assert effect["equation"] and effect["where"] and effect["source"]
    assert effect["kinds"] and effect["parameters"]
    assert any(p["typical"] != 0.0 for p in effect["parameters"])
    for parameter in effect["parameters"]:
        assert re.fullmatch(r"[a-z0-9_]+", parameter["name"])
        assert parameter["unit"]
        assert parameter["low"] <= parameter["neutral"] <= parameter["high"]
        assert parameter["low"] <= size(parameter) <= parameter["high"]


def moved_differently(name):
    """What of a robot's start changes how it moves with an effect: shaft angles, or its pose."""
    rng = np.random.default_rng(11)
    command = np.repeat(rng.uniform(-0.8, 0.8, (30, 4)), 10, axis=0)
    time = np.arange(len(command)) * 0.01
    effects = [(name, p["name"], size(p)) for p in CATALOGUE[name]["parameters"]]
    if name == "slippery_patch":
        effects = [(name, "x_min_m", -0.2), (name, "x_max_m", 0.2), (name, "scale", 0.5)]
    model = [parameter_set("robot", BASE["robot"], effects)]
    begun = {"": np.zeros(14), "angle": np.zeros(14), "place": np.zeros(14)}
    begun["angle"][4:8] = 1.0, 2.0, 3.0, 4.0
    begun["place"][11:14] = 0.3, -0.2, 0.7
    moved = {}
    for what, initial in begun.items():
        [outputs] = simulate(model, time, command, initial, "robot")
        moved[what] = np.hstack([outputs[:, :4] - outputs[0, :4], outputs[:, 4:5]])
    same = moved.pop("")
    return [what for what, own in moved.items() if not np.allclose(own, same, rtol=1e-6, atol=1e-6)]


@pytest.mark.parametrize("name", cases("robot"))
def test_what_an_effect_goes_with_is_what_it_says(name):
    assert moved_differently(name) == CATALOGUE[name]["goes_with"]


def test_names_are_unique():
    assert len(CATALOGUE) == len(_core.effects())
    for kind in ("robot", "axis", "odometry"):
        names = [p["name"] for p in _core.base_parameters(kind)]
        assert len(set(names)) == len(names)


def documented_effects():
    """{effect: [alternative names, per parameter]}; wheel and run are no parameters."""
    rows = re.findall(r"^\| ([a-z_, ]+) \| ([^|]+) \| [^|]+ \|$", DESIGN.read_text(), re.MULTILINE)
    documented = {}
    for names, columns in rows:
        entries = [re.sub(r"\(.*?\)|\[.*?\]", "", entry).split() for entry in columns.split(",")]
        for name in names.split(", "):
            documented[name] = [
                [word for word in entry if "_" in word] or entry[:1]
                for entry in entries
                if entry[0] not in ("wheel", "wheels", "run", "optional")
            ]
    return documented


@pytest.mark.skipif(not DESIGN.exists(), reason="the design table is not beside the data")
def test_the_design_table_is_in_the_plant_with_its_names():
    """But for the wiring, which acts on logs, and the impact, which is a push of a run."""
    documented = documented_effects()
    assert set(documented) - set(CATALOGUE) == {"name", "impact", *WIRING}
    for name, effect in CATALOGUE.items():
        names = {parameter["name"] for parameter in effect["parameters"]}
        for alternatives in documented.get(name, []):
            assert names & set(alternatives), f"{name}: {alternatives}"
