"""A model file as a point of the engine's parameter space: every key, every effect, every wheel."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from axis_bench import MASS_KG, make_machine, model_text
from omnislip import _core
from omnislip.gap.machine import AXIS_KEYS, Machine
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis
from omnislip.log_file import Log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model

ROBOT = Machine(read_model(NOMINAL_ROBOT))
ROBOT_KEYS = [p["name"] for p in _core.base_parameters("robot")]
CATALOGUE = {entry["name"]: entry for entry in _core.effects()}
ROBOT_EFFECTS = [e for e in CATALOGUE.values() if "robot" in e["kinds"]]
AXIS_EFFECTS = [e for e in CATALOGUE.values() if "axis" in e["kinds"]]
ROTARY = """[model]
kind = "axis"
[axis]
inertia_kg_m2 = 0.02
input_gain_nm_a = 1.5
back_emf_nm_s_rad = 0.3
viscous_friction_nm_s_rad = 0.04
pendulum_mass_kg = 0.5
pendulum_length_m = 0.15
gravity_m_s2 = 9.8
"""


def names_of(kind):
    return [p["name"] for p in _core.base_parameters(kind)]


@pytest.mark.parametrize("key", ROBOT_KEYS)
def test_every_key_of_the_robot_stands_in_its_place(key):
    plain, _, number = key.partition("[")
    values = dict(ROBOT.model.values)
    changed = np.array(values[plain], float)
    changed[(int(number[:-1]),) if number else ()] += 0.25
    values[plain] = changed.tolist()
    found = Machine(dataclasses.replace(ROBOT.model, values=values)).believed
    place = ROBOT_KEYS.index(key)
    np.testing.assert_array_equal(np.flatnonzero(found != ROBOT.believed), [place])
    assert found[place] - ROBOT.believed[place] == pytest.approx(0.25)


def test_places_cover_the_whole_vector_once():
    taken = list(range(len(ROBOT_KEYS)))
    for entry in CATALOGUE.values():
        for parameter in entry["parameters"]:
            taken += ROBOT.place(entry["name"], parameter["name"], None)
    assert sorted(taken) == list(range(ROBOT.engine.parameters))


@pytest.mark.parametrize("entry", ROBOT_EFFECTS, ids=lambda entry: entry["name"])
def test_an_effect_of_the_model_file_moves_its_own_places_only(entry):
    for number, parameter in enumerate(entry["parameters"]):
        wheel = {"single": 3}.get(entry["scope"])
        effect = Effect(entry["name"], {parameter["name"]: 0.77}, wheel)
        machine = Machine(dataclasses.replace(ROBOT.model, effects=[effect]))
        places = ROBOT.place(entry["name"], parameter["name"], wheel)
        others = np.setdiff1d(np.arange(ROBOT.engine.parameters), places)
        np.testing.assert_array_equal(machine.believed[list(places)], 0.77, err_msg=str(number))
        np.testing.assert_array_equal(machine.believed[others], ROBOT.believed[others])


def test_one_wheel_is_one_of_the_four_places_of_all():
    every = ROBOT.place("wheel_radius_error", "scale", None)
    assert [ROBOT.place("wheel_radius_error", "scale", w) for w in (1, 2, 3, 4)] == [
        (place,) for place in every
    ]
    assert len(ROBOT.place("payload", "mass_kg", None)) == 1


def test_a_wheel_radius_on_one_wheel_turns_that_wheels_rim():
    """The engine agrees on which wheel is which: its shaft is freed of load by a smaller radius."""
    machine = ROBOT
    values = machine.believed.copy()
    values[list(machine.place("wheel_radius_error", "scale", 3))] = 0.5
    state = np.zeros((1, 14))
    state[0, 2] = 100.0
    command = np.zeros((1, 4))
    plain, small = (
        machine.engine.derivatives(v, state, command) for v in (machine.believed, values)
    )
    changed = np.abs(small - plain)[0, :4] > 1e-6
    np.testing.assert_array_equal(changed, [False, False, True, False])


def test_candidates_are_the_catalogue_wheel_by_wheel():
    names = [candidate.name for candidate in ROBOT.candidates()]
    counts = {"whole": 1, "common": 1, "single": 4, "common or single": 5}
    searched = [e for e in ROBOT_EFFECTS if e["name"] != "slippery_patch"]  # no place to start from
    assert len(names) == len(set(names)) == sum(counts[e["scope"]] for e in searched)
    assert "weak_motor (wheel 3)" in names
    assert "weak_motor" not in names


def test_an_effect_of_the_model_is_offered_again_from_its_size():
    """A size in the file may be wrong as any value: it is fitted from there and replaced."""
    model = dataclasses.replace(ROBOT.model, effects=[Effect("weak_motor", {"scale": 0.9}, 3)])
    machine = Machine(model)
    offered = {candidate.name: candidate for candidate in machine.candidates()}
    (place,) = offered["weak_motor (wheel 3)"].parameters[0].places
    assert machine.believed[place] == 0.9
    amended = machine.amended_model({}, [Effect("weak_motor", {"scale": 0.8}, 3)])
    assert amended.effects == [Effect("weak_motor", {"scale": 0.8}, 3)]


def test_bounds_of_a_weak_motor_hold_the_same_time_constant_and_share_of_its_current():
    """With 30 times the resistance, L / R and a share of the stall current are what they were."""
    nominal = read_model(NOMINAL_ROBOT)
    weak = dataclasses.replace(nominal, values=nominal.values | {"motor.resistance_ohm": 18.0})
    ours, theirs = ({c.name: c for c in Machine(m).candidates()} for m in (nominal, weak))
    for name, factor in (("armature_inductance", 30.0), ("current_limit", 1.0 / 30.0)):
        own, other = ours[name].parameters[0], theirs[name].parameters[0]
        assert (other.low, other.high) == pytest.approx((own.low * factor, own.high * factor))


def limits_of(machine, runs):
    found = {c.name: c for c in machine.candidates_for(runs)}["current_limit"]
    return sorted(start[0] for start in found.starts)


def test_limits_are_looked_for_below_what_makes_wheels_slide():
    """A tenth of the resistance lets ten times the current through, and wheels slide as before."""
    nominal = read_model(NOMINAL_ROBOT)
    strong = dataclasses.replace(nominal, values=nominal.values | {"motor.resistance_ohm": 0.06})
    runs = [SimpleNamespace(outputs=np.zeros((2, 4)), t_s=np.arange(2.0))]
    shares = [2.5, 5.0, 9.0, 15.0]
    assert limits_of(Machine(nominal), runs) == pytest.approx(shares)
    expected = sorted([*shares, *(10.0 * share for share in shares)])
    assert limits_of(Machine(strong), runs) == pytest.approx(expected)


def test_limits_are_looked_for_where_logged_currents_end():
    outputs = np.zeros((1000, 13))
    outputs[:, 9:] = np.clip(np.linspace(-40.0, 40.0, 1000), -0.7, 0.7)[:, None]
    outputs[::2, 9:] = np.nan
    electric = Machine(read_model(NOMINAL_ROBOT), electric=True)
    runs = [SimpleNamespace(outputs=outputs, t_s=np.arange(1000.0))]
    assert limits_of(electric, runs)[0] == pytest.approx(0.7)
    outputs[:, 9:] = np.nan
    assert limits_of(electric, runs) == pytest.approx([2.5, 5.0, 9.0, 15.0])


def test_every_candidate_has_a_size_to_look_for_within_its_bounds():
    for candidate in ROBOT.candidates():
        assert candidate.amplitudes
        for p in candidate.parameters:
            assert p.scale > 0
            assert p.low < p.high


@pytest.mark.parametrize("size", [0.05, 1.0, 4.0])
def test_a_soft_shaft_of_any_robot_is_looked_for_at_the_same_frequencies(size):
    """Springs and dampers go with the inertia of the drive, here that of its motor."""

    def shaft(model):
        candidates = Machine(model).candidates()
        [found] = [one for one in candidates if one.effect == "shaft_compliance"]
        return found

    nominal = read_model(NOMINAL_ROBOT)
    inertia = "motor.inertia_kg_m2"
    other = shaft(
        dataclasses.replace(
            nominal, values=nominal.values | {inertia: size * nominal.values[inertia]}
        )
    )
    known = shaft(nominal)
    for ours, theirs in zip(other.parameters, known.parameters, strict=True):
        numbers = np.array([[one.scale, one.low, one.high] for one in (ours, theirs)])
        np.testing.assert_allclose(numbers[0], size * numbers[1])
    for ours, theirs in zip(other.starts, known.starts, strict=True):
        assert ours == pytest.approx({index: size * value for index, value in theirs.items()})


@pytest.mark.parametrize(
    ("key", "effect", "power"),
    [
        ("motor.supply_v", "coulomb_friction", 1.0),
        ("motor.resistance_ohm", "coulomb_friction", -1.0),
        ("motor.resistance_ohm", "armature_inductance", 1.0),
        ("motor.resistance_ohm", "winding_heating", 2.0),
        ("motor.resistance_ohm", "current_limit", -1.0),
        ("motor.back_emf_constant_v_s_rad", "viscous_friction_error", 1.0),
        ("motor.back_emf_constant_v_s_rad", "quadratic_wheel_drag", 2.0),
        ("motor.inertia_kg_m2", "motor_inertia_error", 1.0),
        ("robot.inertia_kg_m2", "inertia_error", 1.0),
        ("robot.mass_kg", "payload", 1.0),
        ("robot.mass_kg", "diagonal_load_bias", 1.0),
        ("robot.mass_kg", "yaw_scrub", 1.0),
        ("robot.wheel_distance_m", "yaw_scrub", 1.0),
        ("robot.wheel_distance_m", "cog_offset", 1.0),
        ("robot.mass_kg", "low_grip", 0.0),
        ("motor.supply_v", "yaw_scrub", 0.0),
    ],
)
@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_what_is_looked_for_goes_with_motor_and_body(key, effect, power, factor):
    """Friction of a motor is a share of its stall torque, a load one of the mass, and so on."""
    nominal = read_model(NOMINAL_ROBOT)
    values = nominal.values | {key: factor * nominal.values[key]}
    ours, known = (
        {c.effect: c for c in Machine(model).candidates()}[effect]
        for model in (dataclasses.replace(nominal, values=values), nominal)
    )
    for index in known.amplitudes:
        expected = factor**power * known.parameters[index].scale
        assert ours.parameters[index].scale == pytest.approx(expected)
    for start, theirs in zip(ours.starts, known.starts, strict=True):
        assert start == pytest.approx({i: factor**power * x for i, x in theirs.items()})


@pytest.mark.parametrize("name", ["motor_inertia_error", "inertia_error"])
def test_no_more_inertia_may_be_missing_than_there_is(name):
    nominal = read_model(NOMINAL_ROBOT)
    for key in ("motor.inertia_kg_m2", "robot.inertia_kg_m2"):
        small = nominal.values | {key: 0.1 * nominal.values[key]}
        machine = Machine(dataclasses.replace(nominal, values=small))
        candidate = {c.effect: c for c in machine.candidates()}[name]
        own = {"motor_inertia_error": "motor.", "inertia_error": "robot."}[name]
        assert candidate.parameters[0].low > -small[f"{own}inertia_kg_m2"]


@pytest.mark.parametrize("speed_rad_s", [0.0, 40.0, 900.0])
def test_an_encoder_may_lose_counts_from_any_speed_that_it_shows(speed_rad_s):
    """Also of a robot ten times as slow or fast as the nominal one, or whose wheel stands still."""
    t_s = np.arange(100) * 0.005
    columns = {f"wheel/{w}/duty": np.zeros(100) for w in range(1, 5)}
    counts = np.floor(speed_rad_s * t_s * 2000 / (2 * np.pi))
    columns |= {f"wheel/{w}/encoder_counts": counts % 65536 for w in range(1, 5)}
    candidates = ROBOT.candidates_for([make_run(ROBOT, Log("run", t_s, columns))])
    starts = [c.starts for c in candidates if c.effect == "encoder_dropout"]
    assert len(starts) == 4
    for own in starts:
        speeds = [start[1] for start in own]
        assert min(speeds) > 0.0
        assert max(speeds) == pytest.approx(max(speed_rad_s, 1.0), abs=0.7)  # a count in a row


def test_keys_move_by_two_tolerances_and_exact_ones_not_at_all():
    base = {p.label: p for p in ROBOT.base_parameters()}
    radius = base["robot.wheel_radius_m"]
    assert (radius.low, radius.high) == pytest.approx((0.05 * 0.996, 0.05 * 1.004))
    assert radius.scale == pytest.approx(0.05 * 0.002)
    assert not {"robot.wheel_angles_deg", "motor.gear_ratio", "contact.gravity_m_s2"} & set(base)
    assert "encoder.counts_per_rev" not in base


def test_an_exact_key_moves_where_its_tolerance_is_given():
    tolerance = ROBOT.model.tolerance | {"motor.gear_ratio": 0.01}
    machine = Machine(dataclasses.replace(ROBOT.model, tolerance=tolerance))
    [gear] = [p for p in machine.base_parameters() if p.label == "motor.gear_ratio"]
    assert (gear.low, gear.high) == pytest.approx((12.0 * 0.98, 12.0 * 1.02))


def test_a_key_of_tolerance_zero_is_exact(tmp_path):
    assert make_machine(tmp_path, tolerance=0.0).base_parameters() == []


# ---- axes ----


def rotary(tmp_path):
    path = tmp_path / "rotary.toml"
    path.write_text(ROTARY)
    return Machine(read_model(path))


def test_every_key_of_an_axis_stands_in_its_place(tmp_path):
    machine = rotary(tmp_path)
    names = names_of("axis")
    for key, value in machine.model.values.items():
        place = AXIS_KEYS.get(key.removeprefix("axis."), "axis.input_gain")
        assert machine.believed[names.index(place)] == value


def test_a_translating_axis_speaks_of_newtons(tmp_path):
    machine = make_machine(tmp_path)
    assert machine.linear
    assert machine.file_parameter("torque_nm") == "force_n"
    assert machine.unit("coulomb_friction", "torque_nm") == "N"
    assert machine.unit("asymmetric_friction", "viscous_nm_s") == "N s/m"


def test_a_turning_axis_speaks_of_newton_metres(tmp_path):
    machine = rotary(tmp_path)
    assert not machine.linear
    assert machine.file_parameter("torque_nm") == "torque_nm"
    assert (
        machine.unit("coulomb_friction", "torque_nm")
        == CATALOGUE["coulomb_friction"]["parameters"][0]["unit"]
    )


def test_an_odometry_may_lack_what_its_wheels_and_its_camera_may_do(tmp_path):
    path = tmp_path / "odometry.toml"
    path.write_text(
        '[model]\nkind = "odometry"\n[odometry]\nwheel_radius_m = 0.03\nwheel_distance_m = 0.1\n'
        "wheel_angles_deg = [0.0, 120.0, 240.0]\ncounts_per_rev = 1000\n"
    )
    machine = Machine(read_model(path))
    assert machine.wheels == 3
    names = {candidate.name for candidate in machine.candidates()}
    assert {"lateral_slip", "pose_latency", "wheel_radius_error (wheel 3)"} <= names
    assert not names & {"wheel_radius_error (wheel 4)", "coulomb_friction", "weak_motor (wheel 1)"}
    moving = [parameter.label for parameter in machine.base_parameters()]
    assert moving == ["odometry.wheel_radius_m", "odometry.wheel_distance_m"]


# ---- the amended model ----


def amended(machine, entry, tmp_path):
    """The model with one key 1 % up and the effect at 0.1, 0.11, ..., after a trip to its file."""
    effect = Effect(
        entry["name"],
        {
            machine.file_parameter(p["name"]): 0.1 + 0.01 * k
            for k, p in enumerate(entry["parameters"])
        },
        {"single": 2}.get(entry["scope"]) if machine.kind == "robot" else None,
    )
    key = "robot.mass_kg" if machine.kind == "robot" else next(iter(machine.model.values))
    path = tmp_path / "amended.toml"
    write_model(machine.amended_model({key: 1.01}, [effect]), path)
    return key, effect, Machine(read_model(path))


@pytest.mark.parametrize("entry", ROBOT_EFFECTS, ids=lambda entry: entry["name"])
def test_amended_robot_comes_back_from_its_file(entry, tmp_path):
    key, effect, again = amended(ROBOT, entry, tmp_path)
    assert again.model.effects == [effect]
    assert again.model.tolerance == ROBOT.model.tolerance
    expected = ROBOT.believed.copy()
    expected[ROBOT_KEYS.index(key)] *= 1.01
    for name, value in effect.parameters.items():
        expected[list(ROBOT.place(entry["name"], name, effect.wheel))] = value
    np.testing.assert_allclose(again.believed, expected, rtol=1e-12)


@pytest.mark.parametrize("entry", AXIS_EFFECTS, ids=lambda entry: entry["name"])
@pytest.mark.parametrize("linear", [True, False], ids=["translating", "turning"])
def test_amended_axis_comes_back_from_its_file(entry, linear, tmp_path):
    machine = make_machine(tmp_path) if linear else rotary(tmp_path)
    _, effect, again = amended(machine, entry, tmp_path)
    assert again.model.effects == [effect]
    assert again.model.values == pytest.approx(
        machine.model.values | {next(iter(machine.model.values)): again.believed[0]}
    )
    for parameter in entry["parameters"]:
        places = list(machine.place(entry["name"], parameter["name"], None))
        value = effect.parameters[machine.file_parameter(parameter["name"])]
        np.testing.assert_array_equal(again.believed[places], value)


@pytest.mark.parametrize("order", [(None, 2), (2, None)])
def test_a_wheel_of_its_own_stands_beside_all_wheels_in_any_order(order, tmp_path):
    size = {None: 1.06, 2: 1.2}
    effects = [Effect("wheel_radius_error", {"scale": size[w]}, w) for w in order]
    path = tmp_path / "amended.toml"
    write_model(ROBOT.amended_model({}, effects), path)
    again = Machine(read_model(path))
    places = list(again.place("wheel_radius_error", "scale", None))
    assert again.believed[places].tolist() == [1.06, 1.2, 1.06, 1.06]
    _, simulated = again.model.to_core()
    assert [one["wheel"] for one in simulated] == [None, 2]
    model = believed_hypothesis(ROBOT)
    for wheel in order:
        name = "wheel_radius_error" + (f" (wheel {wheel})" if wheel else "")
        candidate = next(c for c in ROBOT.candidates() if c.name == name)
        model = model.with_effect(candidate, [size[wheel]])
    np.testing.assert_array_equal(model.flat(ROBOT.believed), again.believed)


def test_amended_model_keeps_what_was_there(tmp_path):
    text = model_text(effects="[[effects.coulomb_friction]]\nforce_n = 1.5\n")
    path = tmp_path / "axis.toml"
    path.write_text(text)
    machine = Machine(read_model(path))
    model = machine.amended_model({}, [Effect("dead_zone", {"duty": 0.1})])
    assert [effect.name for effect in model.effects] == ["coulomb_friction", "dead_zone"]
    assert model.values["axis.mass_kg"] == MASS_KG
