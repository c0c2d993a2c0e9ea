"""`omnislip gains`: the firmware's parameters from a model file, effects included."""

import dataclasses
import json

import pytest
from omnislip import _core
from omnislip.errors import InputError
from omnislip.gains import EFFECTS, describe, gains
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model

NOMINAL = read_model(NOMINAL_ROBOT)


def with_effects(*effects):
    return dataclasses.replace(NOMINAL, effects=list(effects))


def test_every_parameter_has_value_unit_and_text():
    found = describe(gains(NOMINAL))["parameters"]
    assert set(found) == set(gains(NOMINAL).raw)
    assert found["mass_q8"] == {"value": 20.0, "unit": "kg", "raw": 5120, "description": "m"}
    assert all(row["unit"] and row["description"] for row in found.values())


def test_coulomb_friction_of_the_model_reaches_the_feed_forward():
    model = with_effects(Effect("coulomb_friction", {"torque_nm": 0.01}))
    found = gains(model)
    assert found.raw["coulomb_force_q8"] == round(0.01 * 12 / 0.05 * 256)
    assert found.effects_used == ["coulomb_friction"]
    others = {name for name in found.raw if found.raw[name] != gains(NOMINAL).raw[name]}
    assert others == {"coulomb_force_q8"}


def test_scales_and_sums_change_the_believed_value():
    model = with_effects(Effect("payload", {"mass_kg": 4.0}), Effect("low_grip", {"scale": 0.5}))
    raw = gains(model).raw
    assert raw["mass_q8"] == 24 * 256
    assert raw["grip_inverse_q15"] == round(2**15 / (0.3 * 24 * 9.81 / 4))


def test_what_the_firmware_has_no_term_for_is_named():
    model = with_effects(
        Effect("dead_zone", {"duty": 0.04}),
        Effect("wheel_radius_error", {"scale": 1.1}, wheel=2),
    )
    found = gains(model)
    assert found.effects_not_used == ["dead_zone", "wheel_radius_error"]
    assert found.raw == gains(NOMINAL).raw


def test_every_effect_taken_is_one_of_the_catalogue_with_that_parameter():
    catalogue = {entry["name"]: entry for entry in _core.effects()}
    for name, (parameter, keys, _) in EFFECTS.items():
        assert parameter in [entry["name"] for entry in catalogue[name]["parameters"]]
        assert all(key in NOMINAL.values or key == "motor.coulomb_friction_nm" for key in keys)


def test_a_robot_that_does_not_fit_is_named_by_file_and_key():
    values = NOMINAL.values | {"robot.mass_kg": 500.0}
    with pytest.raises(InputError, match=r"msl_omni_4\.toml: .*robot\.mass_kg"):
        gains(dataclasses.replace(NOMINAL, values=values))


def test_only_robots_have_gains(tmp_path):
    axis = dataclasses.replace(NOMINAL, kind="axis")
    with pytest.raises(InputError, match="gains need a 'robot'"):
        gains(axis)


def test_command_prints_table_and_json(omnislip):
    table = omnislip("gains", NOMINAL_ROBOT)
    assert table.status == 0 and "speed_gain_q15" in table.stdout
    found = json.loads(omnislip("gains", NOMINAL_ROBOT, "--json").stdout)
    assert found["schema"] == "omnislip-gains/1"
    assert found["parameters"]["speed_gain_q15"]["unit"] == "V*s/rad"


def test_command_refuses_a_missing_file_in_one_line(omnislip):
    result = omnislip("gains", "nowhere.toml")
    assert result.status == 2
    assert len(result.stderr.splitlines()) == 1 and "nowhere.toml" in result.stderr
