"""robot.toml: what is read is what was written, and every mistake is named."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip import _core
from omnislip.errors import InputError
from omnislip.gap.truth_effects import EFFECTS, draw_effect
from omnislip.model_file import (
    ACUTE,
    ADDED_TO,
    ANGLES,
    COUNT,
    NEVER_FITTED,
    NOMINAL_ROBOT,
    ODOMETRY_KEYS,
    ROBOT_KEYS,
    TRANSLATING_AXIS_KEYS,
    TURNING_AXIS_KEYS,
    WIRING,
    Effect,
    Model,
    axis_names,
    read_model,
    write_model,
)

AXIS = '[model]\nkind = "axis"\n[axis]\nmass_kg = 1.0\ninput_gain_n_v = 2.0\n'
ODOMETRY = """[model]
kind = "odometry"
[odometry]
wheel_radius_m = 0.03
wheel_distance_m = 0.2
wheel_angles_deg = [60.0, 180.0, 300.0]
counts_per_rev = 1024
"""


def test_nominal_robot_is_the_default_of_the_plant():
    parameters, effects = read_model(NOMINAL_ROBOT).to_core()
    assert parameters == {entry["name"]: entry["default"] for entry in _core.base_parameters()}
    assert effects == []


def test_tolerance_of_a_key_falls_back_to_the_default():
    model = read_model(NOMINAL_ROBOT)
    assert model.tolerance_of("robot.wheel_radius_m") == 0.002
    assert model.tolerance_of("robot.mass_kg") == 0.02


def test_a_file_that_an_editor_marked_as_utf_8_is_read(tmp_path, robot_text):
    (tmp_path / "robot.toml").write_text(robot_text, encoding="utf-8-sig")
    assert read_model(tmp_path / "robot.toml").values == read_model(NOMINAL_ROBOT).values


def test_kind_axis_and_odometry(write):
    axis = read_model(write("axis.toml", AXIS))
    assert axis.kind == "axis"
    assert axis.values == {"axis.mass_kg": 1.0, "axis.input_gain_n_v": 2.0}
    odometry = read_model(write("odometry.toml", ODOMETRY))
    assert odometry.values["odometry.wheel_angles_deg"] == [60.0, 180.0, 300.0]


def test_effect_parameters_left_out_are_neutral_in_the_plant(write, robot_text):
    text = robot_text + "[[effects.slippery_patch]]\nx_min_m = 1.0\nscale = 0.5\n"
    _, [effect] = read_model(write("robot.toml", text)).to_core()
    assert effect["parameters"] == {
        "x_min_m": 1.0,
        "x_max_m": math.inf,
        "y_min_m": -math.inf,
        "y_max_m": math.inf,
        "scale": 0.5,
    }


def test_tolerance_keys_may_be_quoted_or_dotted(write, robot_text):
    head, _ = robot_text.split("[tolerance]")
    model = read_model(write("robot.toml", head + "[tolerance]\nrobot.mass_kg = 0.1\n"))
    assert model.tolerance == {"default": 0.02, "robot.mass_kg": 0.1}


def test_a_translating_axis_has_forces_not_torques(write):
    friction = "[[effects.coulomb_friction]]\nforce_n = 20.0\n"
    [effect] = read_model(write("axis.toml", AXIS + friction)).effects
    assert effect.parameters == {"force_n": 20.0}
    torque = friction.replace("force_n", "torque_nm")
    assert "'torque_nm'; did you mean 'force_n'" in error_of(write("axis.toml", AXIS + torque))


def test_impulses_left_out_of_an_impact_are_0(write, robot_text):
    text = robot_text + "[[effects.impact]]\nrun = 'run_1'\ntime_s = 1.5\nimpulse_x_n_s = 2.0\n"
    [effect] = read_model(write("robot.toml", text)).effects
    assert list(effect.parameters.values()) == [1.5, 2.0, 0.0, 0.0]


@pytest.mark.parametrize("name", sorted(EFFECTS.keys() - WIRING))
def test_no_size_that_the_generator_hides_is_a_mistake(name, tmp_path):
    generator = np.random.default_rng(0)
    for _ in range(20):
        hidden = draw_effect(generator, name, "run_01")
        effect = Effect(name, hidden.parameters, hidden.wheel, hidden.run)
        model = replace(read_model(NOMINAL_ROBOT), effects=[effect])
        write_model(model, tmp_path / "robot.toml")
        assert read_model(tmp_path / "robot.toml").effects == [effect]


def test_the_command_of_an_axis_has_its_dead_zone_in_volt(write):
    text = AXIS + "[[effects.dead_zone]]\nduty = 1.5\n"
    assert read_model(write("axis.toml", text)).effects == [Effect("dead_zone", {"duty": 1.5})]


# Text to replace in the nominal robot file, its replacement, words the error line must contain.
MISTAKES = {
    "unknown key": ("mass_kg = 20.0", "mass_kg = 20.0\nheight_m = 1.0", ["robot.height_m"]),
    "wrong unit": ("mass_kg = 20.0", "mass_g = 20000", ["robot.mass_g", "'robot.mass_kg'"]),
    "missing key": ("mass_kg = 20.0\n", "", ["missing", "robot.mass_kg"]),
    "missing table": ("[encoder]\ncounts_per_rev = 2000", "", ["encoder.counts_per_rev"]),
    "unknown table": ("[motor]", "[motors]", ["motors", "'motor'"]),
    "text for number": ("= 20.0", '= "20"', ["robot.mass_kg", "number"]),
    "truth for number": ("= 20.0", "= true", ["robot.mass_kg", "number"]),
    "not finite": ("= 20.0", "= nan", ["robot.mass_kg", "finite"]),
    "huge": ("= 20.0", "= 1" + 400 * "0", ["robot.mass_kg", "finite"]),
    "huge text": ("= 20.0", "= 1" + 5000 * "0", ["not valid TOML"]),
    "zero mass": ("= 20.0", "= 0", ["robot.mass_kg", "greater than 0"]),
    "negative friction": ("= 1.5e-5", "= -1.0", ["motor.viscous_friction_nm_s", "0 or more"]),
    "broken count": ("= 2000", "= 2000.5", ["encoder.counts_per_rev", "whole number"]),
    "three angles": ("[30.0, 150.0, 210.0, 330.0]", "[30, 150, 210]", ["list of 4"]),
    "angles in radians": (
        "[30.0, 150.0, 210.0, 330.0]",
        "[0.524, 2.618, 3.665, 5.760]",
        ["robot.wheel_angles_deg", "degrees are expected, not radians"],
    ),
    "angle as text": ("30.0, 150.0", '"30", 150.0', ["robot.wheel_angles_deg[0]"]),
    "name as number": ('"msl-omni-4"', "4", ["robot.name", "text"]),
    "bad kind": ("[robot]", '[model]\nkind = "car"\n[robot]', ["kind", "odometry"]),
    "bad model key": ("[robot]", "[model]\nkindd = 1\n[robot]", ["kindd", "'kind'"]),
    "unknown tolerance": ("default = 0.02", '"robot.mass" = 0.1', ["tolerance", "robot.mass_kg"]),
    "negative tolerance": ("default = 0.02", "default = -1", ["tolerance.default", "0 or more"]),
    "tolerance of angles": (
        "default = 0.02",
        '"robot.wheel_angles_deg" = 0.01',
        ["tolerance.robot.wheel_angles_deg", "0 or left out"],
    ),
    "bad syntax": ("mass_kg = 20.0", "mass_kg = = 20.0", ["not valid TOML", "line 6"]),
    "key given twice": (
        "mass_kg = 20.0",
        "mass_kg = 1\nmass_kg = 2",
        ["not valid TOML", "given twice", "line 7"],
    ),
    "table as value": ("[robot]", "motor = 1\n[robot]", ["not valid TOML"]),
}
EFFECT_MISTAKES = {
    "[[effects.dead_zon]]\nduty = 0.1": ["dead_zon", "'dead_zone'"],
    "[[effects.dead_zone]]\nduti = 0.1": ["duti", "'duty'"],
    "[effects.dead_zone]\nduty = 0.1": ["[[effects.dead_zone]]"],
    '[[effects.dead_zone]]\nduty = "x"': ["effects.dead_zone.duty", "number"],
    "[[effects.payload]]\nmass_kg = 0.1\nwheel = 1": ["payload", "remove 'wheel'"],
    "[[effects.weak_motor]]\nscale = 0.9": ["weak_motor", "add wheel"],
    "[[effects.weak_motor]]\nscale = 0.9\nwheel = 5": ["effects.weak_motor.wheel", "1 to 4"],
    "[[effects.weak_motor]]\nscale = 0.9\nwheel = true": ["effects.weak_motor.wheel"],
    "[[effects.dead_zone]]\nduty = 0.1\nrun = 'run_1'": ["dead_zone", "remove 'run'"],
    "[[effects.dead_zone]]\nduty = 0.1\n[[effects.dead_zone]]\nduty = 0.2": ["dead_zone", "twice"],
    "[[effects.wheel_permutation]]\nwheels = [2, 1, 3, 4]\nof = 'wheels'": [
        "wheel_permutation.of",
        "'encoders' or 'motors' or 'both'",
    ],
    "[[effects.wheel_permutation]]\nwheels = [1, 2, 3, 3]": [
        "wheel_permutation.wheels",
        "once each",
    ],
    "[[effects.encoder_sign]]\nwheel = 7": ["effects.encoder_sign.wheel", "1 to 4"],
    "[[effects.motor_sign]]\nscale = 1.0": ["scale", "motor_sign"],
    "[[effects.force_offset]]\nforce = 1.0": ["force_offset", "kind 'robot'"],
    "[[effects.dead_zone]]\nduty = -5": [
        "effects.dead_zone.duty",
        "0 or more and less than 1, not",
    ],
    "[[effects.actuation_delay]]\ndelay_s = -0.1": ["actuation_delay.delay_s", "0 or more"],
    "[[effects.actuation_delay]]\ndelay_s = 5.0": ["actuation_delay.delay_s", "less than 1, not 5"],
    "[[effects.current_limit]]\nlimit_a = -3": ["limit_a", "greater than 0, not -3"],
    "[[effects.current_limit]]\nlimit_a = inf": ["limit_a", "finite"],
    "[[effects.encoder_dropout]]\nwheel = 1\nfraction = 1.1": ["fraction", "and 1 or less"],
    "[[effects.low_grip]]\nscale = 0": ["effects.low_grip.scale", "greater than 0"],
    "[[effects.shaft_compliance]]\nstiffness_nm_rad = 0": ["stiffness_nm_rad", "greater than 0"],
    "[[effects.payload]]\nmass_kg = -20": ["effects.payload.mass_kg", "greater than -20"],
    "[[effects.motor_inertia_error]]\ninertia_kg_m2 = -3e-5": ["greater than -2.5e-05"],
    "[[effects.cog_offset]]\nx_m = 0.2": ["cog_offset.x_m", "greater than -0.2 and less than 0.2"],
    "[[effects.slippery_patch]]\nx_min_m = 0.5\nx_max_m = 0.2": ["x_min_m", "less than x_max_m"],
    "[[effects.impact]]\nrun = 'run_1'\nimpulse_x_n_s = 1.0": ["impact", "time_s"],
}
AXIS_MISTAKES = {
    "mass and inertia": ("mass_kg = 1.0", "mass_kg = 1.0\ninertia_kg_m2 = 1", ["axis.mass_kg"]),
    "neither": ("mass_kg = 1.0\n", "", ["axis.mass_kg or axis.inertia_kg_m2"]),
    "no gain": ("input_gain_n_v = 2.0", "", ["exactly one", "axis.input_gain_n_a"]),
    "two gains": ("gain_n_v = 2.0", "gain_n_v = 2\ninput_gain_n = 1", ["exactly one"]),
    "torque on a mass": ("input_gain_n_v", "input_gain_nm_v", ["axis.input_gain_nm_v"]),
    "pendulum on a mass": ("mass_kg = 1.0", "mass_kg = 1\npendulum_mass_kg = 1", ["pendulum"]),
    "half a pendulum": ("mass_kg = 1.0\ninput_gain_n_v", "inertia_kg_m2 = 1\npendulum_mass_kg = 1\n"
                        "input_gain_nm_v", ["axis.pendulum_length_m"]),
    "inertia without the pendulum": (
        "mass_kg = 1.0\ninput_gain_n_v", "inertia_kg_m2 = 0.01\npendulum_mass_kg = 1\n"
        "pendulum_length_m = 0.2\ninput_gain_nm_v",
        ["axis.inertia_kg_m2", "all that turns", "0.04", "not 0.01"]),
}  # fmt: skip


def error_of(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_model(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("case", MISTAKES)
def test_mistake_in_a_robot_file_is_named(case, write, robot_text):
    old, new, words = MISTAKES[case]
    assert old in robot_text
    message = error_of(write("robot.toml", robot_text.replace(old, new, 1)))
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("text", EFFECT_MISTAKES)
def test_mistake_in_an_effect_is_named(text, write, robot_text):
    message = error_of(write("robot.toml", robot_text + text))
    assert [word for word in EFFECT_MISTAKES[text] if word not in message] == []


@pytest.mark.parametrize("case", AXIS_MISTAKES)
def test_mistake_in_an_axis_file_is_named(case, write):
    old, new, words = AXIS_MISTAKES[case]
    message = error_of(write("axis.toml", AXIS.replace(old, new, 1)))
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("angle", ["90.0", "-1.0"])
def test_roller_angle_is_acute(angle, write):
    text = ODOMETRY.rstrip("\n") + f"\nroller_angle_deg = {angle}\n"
    assert "0 or more and less than 90" in error_of(write("odometry.toml", text))


def test_odometry_has_at_most_eight_wheels(write):
    text = ODOMETRY.replace("[60.0, 180.0, 300.0]", str([40.0 * i for i in range(9)]))
    assert "list of 8" in error_of(write("odometry.toml", text))


def test_odometry_needs_two_wheels(write):
    text = ODOMETRY.replace("[60.0, 180.0, 300.0]", "[180.0]")
    assert "list of 2" in error_of(write("odometry.toml", text))


@pytest.mark.parametrize("angles", ["[90.0, 270.0]", "[-90.0, 90.0, 270.0, 450.0]"])
def test_parallel_wheels_are_an_odometry(angles, write):
    assert read_model(write("odometry.toml", ODOMETRY.replace("[60.0, 180.0, 300.0]", angles)))


@pytest.mark.parametrize("angles", ["[0.0, 120.0]", "[0.0, 120.0, 360.0]"])
def test_wheels_that_do_not_say_how_the_robot_moves_are_refused(angles, write):
    text = ODOMETRY.replace("[60.0, 180.0, 300.0]", angles)
    assert "two that differ by 180 degrees" in error_of(write("odometry.toml", text))


def test_missing_folder_and_binary_files_are_named(tmp_path):
    assert "cannot be read" in error_of(tmp_path / "none.toml")
    assert "cannot be read" in error_of(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in error_of(tmp_path / "binary.toml")


POSITIVE_NUMBERS = st.floats(min_value=1e-300, max_value=1e300)


def in_degrees(angles: list[float]) -> bool:
    return max(angles) - min(angles) >= 2 * math.pi if angles else True


def values_of(keys: dict[str, str], wheel_counts: tuple[int, int]) -> st.SearchStrategy:
    low, high = wheel_counts
    angles = st.lists(st.floats(-1e6, 1e6), min_size=low, max_size=high).filter(in_degrees)
    by_rule = {
        ANGLES: angles,
        COUNT: st.integers(1, 10**9).map(float),
        ACUTE: st.floats(0.0, 89.9),
    }
    return st.fixed_dictionaries(
        {key: by_rule.get(rule, POSITIVE_NUMBERS) for key, rule in keys.items()}
    )


def axis_values(keys: dict[str, str]) -> st.SearchStrategy:
    gains = [key for key in keys if key.startswith("axis.input_gain")]
    others = {key: rule for key, rule in keys.items() if key not in gains}
    one_gain = st.sampled_from(gains).flatmap(lambda key: values_of({key: keys[key]}, (0, 0)))
    return st.tuples(values_of(others, (0, 0)), one_gain).map(
        lambda parts: with_its_pendulum(parts[0] | parts[1])
    )


def with_its_pendulum(values: dict[str, float]) -> dict[str, float]:
    """No inertia is less than the pendulum's at its length, here of a metre at most."""
    length, inertia = "axis.pendulum_length_m", "axis.inertia_kg_m2"
    if length in values:
        values = values | {length: min(values[length], 1.0)}
    least = values.get("axis.pendulum_mass_kg", 0.0) * values.get(length, 0.0) ** 2
    return values | ({inertia: max(values[inertia], least)} if inertia in values else {})


def is_no_empty_patch(sizes: dict[str, float]) -> bool:
    return all(
        sizes.get(f"{axis}_min_m", -math.inf) < sizes.get(f"{axis}_max_m", math.inf)
        for axis in "xy"
    )


def effects_of(kind: str, own_names: dict[str, str]) -> st.SearchStrategy:
    def one(entry: dict) -> st.SearchStrategy:
        low = 0.0 if entry["name"] in ADDED_TO else -1e9
        sizes = {
            own_names.get(p["name"], p["name"]): st.floats(max(p["low"], low), min(p["high"], 1e9))
            for p in entry["parameters"]
        }
        wheels = {"single": st.integers(1, 3), "common or single": st.none() | st.integers(1, 3)}
        return st.builds(
            Effect,
            st.just(entry["name"]),
            st.fixed_dictionaries({}, optional=sizes).filter(is_no_empty_patch),
            wheels.get(entry["scope"], st.none()),
        )

    catalogue = [entry for entry in _core.effects() if kind in entry["kinds"]]
    return (
        st.lists(
            st.sampled_from(catalogue).flatmap(one),
            max_size=4,
            unique_by=lambda effect: (effect.name, effect.wheel),
        )
        if catalogue
        else st.just([])
    )


def in_three_directions(values: dict[str, list[float]]) -> bool:
    return len({round(angle % 360.0, 6) for angle in values["odometry.wheel_angles_deg"]}) > 2


def models(kind: str, values: st.SearchStrategy) -> st.SearchStrategy:
    return values.flatmap(
        lambda drawn: st.builds(
            Model,
            st.just(kind),
            st.just(drawn),
            st.dictionaries(
                st.sampled_from(sorted(drawn.keys() - NEVER_FITTED)), st.floats(0, 1)
            ).map(lambda tolerance: {"default": 0.02} | tolerance),
            effects_of(kind, axis_names(drawn)),
            st.text(),
        )
    )


ANY_MODEL = st.one_of(
    models("robot", values_of(ROBOT_KEYS, (4, 4))),
    models("axis", axis_values(TRANSLATING_AXIS_KEYS)),
    models("axis", axis_values(TURNING_AXIS_KEYS)),
    models("odometry", values_of(ODOMETRY_KEYS, (3, 6)).filter(in_three_directions)),
)


@given(ANY_MODEL)
def test_a_written_model_reads_back_the_same(tmp_path_factory, model):
    path = tmp_path_factory.getbasetemp() / "round_trip.toml"
    write_model(model, path)
    back = read_model(path)
    by_name = sorted(model.effects, key=lambda effect: effect.name)
    assert (back.kind, back.name, back.values) == (model.kind, model.name, model.values)
    assert back.tolerance == model.tolerance
    assert sorted(back.effects, key=lambda effect: effect.name) == by_name


def test_writing_where_nothing_can_be_written_leaves_nothing(locked_folder):
    with pytest.raises(InputError, match="cannot be written"):
        write_model(read_model(NOMINAL_ROBOT), locked_folder / "robot.toml")
