"""Effects of the user in files: read, written back, and refused with one line that says why."""

from pathlib import Path

import pytest
from omnislip.errors import InputError
from omnislip.gap.machine import Machine
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, with_definitions, write_model
from omnislip.user_effects import read_definitions, read_entries

EXAMPLE = NOMINAL_ROBOT.parents[1] / "effects" / "cubic_wheel_drag.toml"
PATH = Path("own.toml")


def table(**changed):
    good = {
        "adds_to": "shaft_torque_nm",
        "expression": "-a * exp(-b * W**2)",
        "parameters": {
            "a": {"unit": "N m", "typical": 0.01, "low": 0.0},
            "b": {"unit": "s^2", "start": [0.1, 1.0]},
        },
    }
    return good | changed


def read(kind="robot", **changed):
    [entry] = read_entries({"own": table(**changed)}, kind, PATH)
    return entry


def test_the_example_is_a_candidate_of_the_robot():
    model = with_definitions(read_model(NOMINAL_ROBOT), read_definitions(EXAMPLE), EXAMPLE)
    machine = Machine(model)
    [candidate] = [c for c in machine.candidates() if c.effect == "cubic_wheel_drag"]
    assert candidate.wheel is None
    [parameter] = candidate.parameters
    assert (parameter.label, parameter.scale) == ("c_nm_s3", 5e-10)
    assert machine.unit("cubic_wheel_drag", "c_nm_s3") == "N m s^3"


def test_a_model_with_an_own_effect_reads_back(tmp_path):
    model = with_definitions(read_model(NOMINAL_ROBOT), read_definitions(EXAMPLE), EXAMPLE)
    model.effects.append(Effect("cubic_wheel_drag", {"c_nm_s3": 4e-10}))
    write_model(model, tmp_path / "robot.toml")
    again = read_model(tmp_path / "robot.toml")
    assert again.definitions == model.definitions
    assert again.effects == model.effects
    machine = Machine(again)
    places = machine.place("cubic_wheel_drag", "c_nm_s3", None)
    assert machine.believed[list(places)].tolist() == [4e-10] * 4


def test_shaping_parameters_start_where_the_user_says():
    model = with_definitions(read_model(NOMINAL_ROBOT), {"own": table()}, PATH)
    [candidate] = [c for c in Machine(model).candidates() if c.effect == "own"]
    assert candidate.amplitudes == (0,)
    assert candidate.starts == ({1: 0.1}, {1: 1.0})


@pytest.mark.parametrize(
    ("adds_to", "expression", "goes_with"),
    [
        ("shaft_torque_nm", "-a * W * b", []),
        ("shaft_torque_nm", "-a * sin(b * th_m)", ["angle"]),
        ("mu_drive", "a * th_m * cos(b * theta)", ["angle", "place"]),
        ("body_force_x_n", "a * b * x", ["place"]),
    ],
)
def test_an_effect_goes_with_what_it_names(adds_to, expression, goes_with):
    assert read(adds_to=adds_to, expression=expression)["goes_with"] == goes_with


@pytest.mark.parametrize(
    "wheels, names",
    [
        ("all", ["own"]),
        ("one", [f"own (wheel {w})" for w in range(1, 5)]),
        ("all or one", ["own", *(f"own (wheel {w})" for w in range(1, 5))]),
    ],
)
def test_which_wheels_are_tried(wheels, names):
    model = with_definitions(read_model(NOMINAL_ROBOT), {"own": table(wheels=wheels)}, PATH)
    assert [c.name for c in Machine(model).candidates() if c.effect == "own"] == names


A = {"a": {"unit": "1", "typical": 1.0}}
BAD = {
    "no expression": (table(expression=""), "expression' must be a text"),
    "not an expression": (table(expression="-a *"), "is no expression"),
    "a statement": (table(expression="a = 3"), "is no expression"),
    "an unknown name": (
        table(expression="-a * v * b"),
        "names 'v'; known where it adds to shaft_torque_nm: t, W, th_m, tau, a, b",
    ),
    "an unknown function": (table(expression="a * b * sinn(W)"), "did you mean 'sin'"),
    "an import": (table(expression="__import__('os')"), "calls '__import__'"),
    "an attribute": (table(expression="a.real * b"), "cannot contain 'a.real'"),
    "a text": (table(expression="a * b * 'x'"), "cannot contain"),
    "a pair of conditions": (
        table(expression="a * b if W > 0 and W < 3 else 0"),
        "cannot contain 'W > 0 and W < 3': a condition compares two values",
    ),
    "a chain": (table(expression="a * b if 0 < W < 3 else 0"), "a condition compares two values"),
    "a negation": (table(expression="a * b if not W < 3 else 0"), "a condition compares two"),
    "named values": (table(expression="a * b * max(W, 1, key=1)"), "give them without names"),
    "an open bracket": (table(expression="a * (b"), "is no expression: '(' was never closed"),
    "a huge power": (table(expression="a * b * 9**9**9**9"), "a number too large?"),
    "a huge number": (table(expression=f"a * b * {'9' * 400}"), "a number that is too large"),
    "too many values": (table(expression="a * b * abs(W, W)"), "gives abs 2 values, it takes 1"),
    "an unused parameter": (table(expression="-a * W"), "does not use the parameter 'b'"),
    "not 0 when neutral": (table(expression="(1 + a) * b"), "must be 0 when every size"),
    "no number": (table(expression="a * sqrt(W - 100) * b"), "is no number at standstill or for"),
    "no number at standstill": (table(expression="a * b / W"), "is no number at standstill"),
    "always 0": (table(expression="a * b * 0"), "stays 0"),
    "no place": (table(adds_to="shaft_torque"), "adds_to' must be one of duty, supply_v"),
    "an unknown key": (table(units="N"), "unknown key in"),
    "a wrong wheel": (table(wheels=3), "must be one of all, one, all or one"),
    "a list of wheels": (table(wheels=["all"]), "must be one of all, one, all or one"),
    "wheels of the body": (
        {"adds_to": "body_torque_nm", "expression": "a", "parameters": A, "wheels": "all"},
        "remove 'wheels'",
    ),
    "no parameters": (table(parameters={}, expression="W"), "needs a parameter with 'typical'"),
    "no unit": (
        table(parameters={"a": {"typical": 1.0}}, expression="a"),
        "parameters.a.unit' must be a text",
    ),
    "neither size nor shape": (
        table(parameters={"a": {"unit": "1"}}, expression="a"),
        "needs either 'typical'",
    ),
    "no size": (
        table(parameters={"a": {"unit": "1", "typical": 0}}, expression="a"),
        "typical' must not be 0",
    ),
    "out of bounds": (
        table(parameters={"a": {"unit": "1", "typical": 1.0, "high": 0.5}}, expression="a"),
        "1 is not within low and high",
    ),
    "a taken name": (
        table(parameters={"W": {"unit": "1", "typical": 1.0}}, expression="W"),
        "'W' cannot be the name of a parameter",
    ),
    "a name of another alphabet": (
        table(parameters={"µ": {"unit": "1", "typical": 1.0}}, expression="µ"),
        "ASCII letters, digits and _ only",
    ),
    "a word of the language": (
        table(parameters={"lambda": {"unit": "1", "typical": 1.0}}, expression="lambda"),
        "'lambda' cannot be the name of a parameter",
    ),
    "too deep": (
        table(expression="a * b * " + "(W + " * 20 + "W" + ")" * 20),
        "nested too deeply",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_definition_is_refused_with_one_line(case):
    given, reason = BAD[case]
    with pytest.raises(InputError) as refused:
        read_entries({"own": given}, "robot", PATH)
    text = str(refused.value)
    assert text.startswith("own.toml: ")
    assert "own" in text
    assert reason in text
    assert "\n" not in text


def test_a_name_of_the_catalogue_is_refused():
    with pytest.raises(InputError, match="catalogue has an effect of that name"):
        read_entries({"payload": table()}, "robot", PATH)


@pytest.mark.parametrize("name", ["impact", "encoder_sign", "motor_sign", "wheel_permutation"])
def test_a_name_that_model_files_know_is_refused(name):
    with pytest.raises(InputError, match=f"define.{name}': there is an effect of that name"):
        with_definitions(read_model(NOMINAL_ROBOT), {name: table()}, PATH)


@pytest.mark.parametrize("name", ["réib", "my-drag", "2nd"])
def test_a_name_that_cannot_be_read_back_is_refused(name):
    with pytest.raises(InputError, match=f"define.{name}': a name has ASCII letters"):
        read_entries({name: table()}, "robot", PATH)


def test_an_axis_has_no_wheels_to_grip():
    with pytest.raises(InputError, match="must be one of duty, shaft_torque_nm"):
        read("axis", adds_to="mu_drive")


def test_a_file_without_effects_is_refused(tmp_path):
    (tmp_path / "own.toml").write_text("[other]\n")
    with pytest.raises(InputError, match="unknown table 'other'"):
        read_definitions(tmp_path / "own.toml")
    (tmp_path / "own.toml").write_text("")
    with pytest.raises(InputError, match="defines no effect"):
        read_definitions(tmp_path / "own.toml")


def test_a_program_is_no_file_of_effects(tmp_path):
    (tmp_path / "own.py").write_text("def drag(W):\n    return W**3\n")
    with pytest.raises(InputError, match="defined in TOML only"):
        read_definitions(tmp_path / "own.py")


def test_a_name_defined_twice_is_refused():
    model = with_definitions(read_model(NOMINAL_ROBOT), {"own": table()}, PATH)
    with pytest.raises(InputError, match="'own' is defined"):
        with_definitions(model, {"own": table()}, PATH)
