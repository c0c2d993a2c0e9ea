"""Effects of the user inside the plant: equal to the catalogue's where both say the same, in lanes,
and equal to Python's own reading of the expression."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip import _core
from omnislip.gap.machine import Machine
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, with_definitions
from omnislip.user_effects import FUNCTIONS, TARGETS

PATH = Path("own.toml")
MODEL = read_model(NOMINAL_ROBOT)
ROWS = 240
TIME_S = np.arange(ROWS) * 0.005


def defined(**expressions):
    """The nominal robot with effects: name = (adds_to, expression, {parameter: neutral})."""
    tables = {
        name: {
            "adds_to": adds_to,
            "expression": expression,
            "parameters": {
                p: {"unit": "1", "typical": 0.3, "neutral": v} for p, v in parameters.items()
            },
        }
        for name, (adds_to, expression, parameters) in expressions.items()
    }
    return with_definitions(MODEL, tables, PATH)


# catalogue effect and its size; the same written by a user
TWINS = {
    "coulomb_friction": (
        {"torque_nm": 0.01},
        {"own": ("shaft_torque_nm", "-a * tanh(W / 2)", {"a": 0.0})},
    ),
    "load_dependent_friction": (
        {"coefficient": 0.1},
        {"own": ("shaft_torque_nm", "-a * abs(tau) * tanh(W / 2)", {"a": 0.0})},
    ),
    "quadratic_wheel_drag": (
        {"coefficient": 1e-7},
        {"own": ("shaft_torque_nm", "-a * W * abs(W)", {"a": 0.0})},
    ),
    "cogging": (
        {"torque_nm": 0.01, "cycles_per_rev": 7.0, "phase_rad": 0.0},
        {"own": ("shaft_torque_nm", "-a * sin(7 * th_m)", {"a": 0.0})},
    ),
    "driver_nonlinearity": (
        {"cubic": 0.2},
        {"own": ("duty", "a * d**3", {"a": 0.0})},
    ),
    "dead_zone": (
        {"duty": 0.05},
        {"own": ("duty", "sign(d) * max(abs(d) - a, 0) - d", {"a": 0.0})},
    ),
    "state_of_charge_drift": (
        {"rate_1_s": 0.03},
        {"own": ("supply_v", "-24 * a * t", {"a": 0.0})},
    ),
    "low_grip": (
        {"scale": 0.7},
        {"own": ("mu_drive", "0.6 * (a - 1)", {"a": 1.0})},
    ),
    "body_drag": (
        {"coefficient_n_s_m": 8.0},
        {
            "own": ("body_force_x_n", "-a * vx", {"a": 0.0}),
            "own_y": ("body_force_y_n", "-a * vy", {"a": 0.0}),
        },
    ),
    "yaw_scrub": (
        {"torque_nm": 0.5},
        {"own": ("body_torque_nm", "-a * tanh(20 * w)", {"a": 0.0})},
    ),
    "gyro_bias": (
        {"rate_rad_s": 0.02},
        {"own": ("gyro_rad_s", "a", {"a": 0.0})},
    ),
    "pose_rotation": (
        {"angle_rad": 0.02},
        {
            "own": ("pose_x_m", "cos(a) * x - sin(a) * y - x", {"a": 0.0}),
            "own_y": ("pose_y_m", "sin(a) * x + cos(a) * y - y", {"a": 0.0}),
        },
    ),
}


def outputs(machine, sets, lanes=8):
    """Replays (sets, rows, outputs) of a duty that moves all three ways."""
    engine = _core.Engine("robot", lanes, machine.model.own_effects)
    wave = [0.25 * np.sin(9 * TIME_S + k) for k in range(4)]
    silent = np.zeros((ROWS, engine.outputs))
    recording = engine.recording(TIME_S, np.stack(wave, 1), silent, np.zeros(engine.states))
    none, one = np.zeros(engine.states), np.ones(engine.outputs)
    tracks = engine.track([recording], sets[0], none, one, none)
    return -engine.replays([recording], tracks, np.asarray(sets), 1e-3, 1e9)[0]


def believed_with(model, effects):
    return Machine(model.__class__(**{**model.__dict__, "effects": effects})).believed


@pytest.mark.parametrize("name", TWINS)
def test_a_user_says_the_same_as_the_catalogue(name):
    parameters, own = TWINS[name]
    model = defined(**own)
    machine = Machine(model)
    [size] = [v for k, v in parameters.items() if k not in ("cycles_per_rev", "phase_rad")]
    theirs = believed_with(model, [Effect(name, parameters)])
    ours = believed_with(model, [Effect(n, {"a": size}) for n in own])
    plain, catalogue, user = outputs(machine, [machine.believed, theirs, ours])
    np.testing.assert_allclose(user, catalogue, rtol=1e-9, atol=1e-9)
    assert np.abs(catalogue - plain).max() > 1e-3


@pytest.mark.parametrize("lanes", [2, 4])
def test_lanes_of_every_width_agree(lanes):
    model = defined(own=("shaft_torque_nm", "-a * W * abs(W) if W > 0.5 else 0", {"a": 0.0}))
    machine = Machine(model)
    sets = [believed_with(model, [Effect("own", {"a": a})]) for a in (0.0, 1e-7, 4e-7)]
    wide, narrow = outputs(machine, sets), outputs(machine, sets, lanes)
    np.testing.assert_allclose(narrow, wide, rtol=1e-9, atol=1e-9)


def test_a_term_at_its_neutral_values_leaves_every_bit():
    model = defined(own=("body_force_x_n", "-a * vx", {"a": 0.0}))
    machine, plain = Machine(model), Machine(MODEL)
    np.testing.assert_array_equal(
        outputs(machine, [machine.believed]), outputs(plain, [plain.believed])
    )


def test_one_wheel_of_four():
    model = defined(own=("shaft_torque_nm", "-a * tanh(W / 2)", {"a": 0.0}))
    theirs = believed_with(model, [Effect("one_wheel_drag", {"torque_nm": 0.02}, 3)])
    ours = believed_with(model, [Effect("own", {"a": 0.02}, 3)])
    first, second = outputs(Machine(model), [theirs, ours])
    np.testing.assert_allclose(second, first, rtol=1e-9, atol=1e-9)


def test_an_axis_takes_a_term_too(tmp_path):
    (tmp_path / "axis.toml").write_text(
        '[model]\nkind = "axis"\n[axis]\nmass_kg = 10.0\ninput_gain_n_v = 20.0\n'
        "viscous_friction_n_s_m = 15.0\n"
        '[define.own]\nadds_to = "shaft_torque_nm"\nexpression = "-a * W * abs(W)"\n'
        'parameters.a = { unit = "N s^2/m^2", typical = 3.0 }\n'
        "[[effects.own]]\na = 3.0\n"
    )
    machine = Machine(read_model(tmp_path / "axis.toml"))
    found = machine.engine.derivatives(machine.believed, np.array([[2.0, 0.0]]), np.array([[1.0]]))
    assert found[0, 0] == pytest.approx((20.0 - 15.0 * 2 - 3.0 * 4) / 10.0, rel=1e-12)


def test_the_closed_loop_drives_the_same_effect():
    own = TWINS["coulomb_friction"][1]
    model = defined(**own)
    runs = []
    for effect in (Effect("coulomb_friction", {"torque_nm": 0.02}), Effect("own", {"a": 0.02})):
        from dataclasses import replace

        from omnislip.scenario import Scenario
        from omnislip.simulate import simulate_truth

        command = [{"t_s": 0.0, "kind": "velocity", "value": [0.5, 0.2, 0.3]}]
        runs.append(simulate_truth(Scenario("x", 0.4, replace(model, effects=[effect]), command)))
    np.testing.assert_allclose(runs[1]["pose"], runs[0]["pose"], rtol=1e-9, atol=1e-12)


# ---- expressions ----

NAMES = TARGETS["body_force_x_n"].inputs
leaves = st.one_of(
    st.sampled_from(NAMES),
    st.floats(0.1, 3.0).map(lambda x: f"{x:.4f}"),
    st.just("pi"),
)


def grown(inner):
    one = st.sampled_from(["abs", "sign", "sin", "cos", "atan", "tanh"])
    return st.one_of(
        st.tuples(one, inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        st.tuples(inner, inner).map(lambda t: f"({t[0]}) / (1 + abs({t[1]}))"),
        st.tuples(inner, st.integers(0, 5)).map(lambda t: f"tanh({t[0]})**{t[1]}"),
        st.tuples(inner, inner).map(lambda t: f"exp(-abs({t[0]}))**abs({t[1]})"),
        inner.map(lambda a: f"sqrt(abs({a}))"),
        inner.map(lambda a: f"log(1 + abs({a}))"),
        inner.map(lambda a: f"-({a})"),
        st.tuples(st.sampled_from(["min", "max"]), inner, inner).map(
            lambda t: f"{t[0]}({t[1]}, {t[2]})"
        ),
        st.tuples(inner, st.sampled_from(["<", ">"]), inner, inner, inner).map(
            lambda t: f"({t[3]} if {t[0]} {t[1]} {t[2]} else {t[4]})"
        ),
    )


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(leaves, grown, max_leaves=8), st.lists(st.floats(-2, 2), min_size=6, max_size=6)
)
def test_the_plant_reads_an_expression_as_python_does(text, numbers):
    """The acceleration that the term adds is its force over the mass; time is 0."""
    model = defined(own=("body_force_x_n", f"a * (1e-3 + abs({text}))", {"a": 0.0}))
    machine = Machine(model)
    state = np.zeros((1, 14))
    state[0, 8:] = numbers
    values = believed_with(model, [Effect("own", {"a": 1.0})])
    found = [
        machine.engine.derivatives(v, state, np.zeros((1, 4)))[0, 8]
        for v in (machine.believed, values)
    ]
    known = dict(zip(NAMES, map(np.float64, [0.0, *numbers]), strict=True))
    expected = eval(text, {**FUNCTIONS, "pi": math.pi}, known)
    force = (found[1] - found[0]) * 20.0
    assert force == pytest.approx(1e-3 + abs(expected), rel=1e-9, abs=1e-9)
