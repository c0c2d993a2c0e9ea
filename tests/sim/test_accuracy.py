"""Errors of the default step, the stiffest corner, and the sensitivities that a fit rests on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import omnislip
import pytest
from engine_run import motors, parameter_set, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip import _core
from omnislip.firmware_parameters import firmware_parameters
from omnislip.scenario import read_scenario
from omnislip.simulate import simulate_truth

SCENARIOS = Path(omnislip.__file__).parent / "scenarios"
ROW_TICKS = 5


def recorded(name):
    """Times and duties, in rows of 5 ms, of a scenario's run; at most 10 s."""
    truth = simulate_truth(read_scenario(SCENARIOS / f"{name}.toml"))
    rows = min(len(truth["t_s"]), 10_000) // ROW_TICKS
    duty = truth["duty"][: rows * ROW_TICKS].reshape(rows, ROW_TICKS, 4).mean(axis=1)
    return truth["t_s"][: rows * ROW_TICKS : ROW_TICKS], duty


@pytest.mark.parametrize("name", ["identification", "square", "straight_impact"])
def test_replay_of_a_log_is_within_a_micrometre_of_a_refined_one(name):
    """At the default step; the first log slides hard for half of its 10 s."""
    time, duty = recorded(name)
    nominal = [parameter_set()]
    refined = simulate(nominal, time, duty, step_s=2e-5)[0]
    found = simulate(nominal, time, duty)[0]
    assert np.abs(found[:, 5:7] - refined[:, 5:7]).max() < 1e-6
    assert np.ptp(refined[:, 5:7]) > 0.1


def test_closed_loop_under_given_duty_is_within_10_um_of_a_refined_one():
    """Without feedback through counted encoders, which amplifies one count of difference."""
    scenario = replace(read_scenario(SCENARIOS / "identification.toml"), slip_compensation=False)
    default, refined = (closed_loop(scenario, step) for step in (1e-3, 2.5e-5))
    assert np.abs(default["pose"] - refined["pose"])[:, :2].max() < 1e-5


def default_and_refined(name, slip_compensation):
    """Distance (rows,) in m of the default run from a refined one, and rows with equal counts."""
    scenario = read_scenario(SCENARIOS / f"{name}.toml")
    scenario = replace(scenario, slip_compensation=slip_compensation)
    default, refined = (simulate_truth(scenario, step_s=step) for step in (1e-3, 2.5e-5))
    apart_m = np.abs(default["pose"] - refined["pose"])[:, :2].max(axis=1)
    return apart_m, (default["encoder_counts"] == refined["encoder_counts"]).all(axis=1)


@pytest.mark.parametrize("slip_compensation", [False, True])
@pytest.mark.parametrize("name", ["square", "straight_impact"])
def test_closed_loop_is_within_a_micrometre_while_the_firmware_reads_the_same(
    name, slip_compensation
):
    apart_m, same = default_and_refined(name, slip_compensation)
    assert apart_m[np.logical_and.accumulate(same)].max() < 1e-6


@pytest.mark.parametrize("slip_compensation", [False, True])
@pytest.mark.parametrize("name", ["square", "straight_impact"])
def test_closed_loop_with_firmware_is_within_a_tenth_of_a_millimetre(name, slip_compensation):
    apart_m, _ = default_and_refined(name, slip_compensation)
    assert apart_m.max() < 1e-4


def test_impulse_where_the_robot_passes_does_not_wait_for_the_tick():
    """Places spread over what the robot moves in three ticks: the run changes evenly with them."""
    scenario = replace(read_scenario(SCENARIOS / "identification.toml"), duration_s=1.0)
    x = closed_loop(scenario, 1e-3)["pose"][:, 0]
    blow = {"impulse_x_n_s": 0.0, "impulse_y_n_s": 9.0, "impulse_theta_n_m_s": 0.0}
    places = np.linspace(x[500], x[503], 16)
    ends = [
        closed_loop(replace(scenario, impulses=[blow | {"x_m": place}]), 1e-3)["pose"][-1, 1]
        for place in places
    ]
    steps = np.diff(ends)
    assert np.abs(ends).min() > 1e-3
    np.testing.assert_allclose(steps, steps.mean(), rtol=0.02)


def closed_loop(scenario, step_s, base=None):
    """Truth at 1 kHz with the firmware of the scenario's robot, the plant with `base` changed."""
    parameters, effects = scenario.model.to_core()
    firmware = firmware_parameters(scenario.model.values)
    firmware["slip_compensation"] = int(scenario.slip_compensation)
    return _core.simulate(
        parameters | (base or {}),
        effects,
        firmware,
        scenario.commands,
        scenario.impulses,
        scenario.duration_s,
        step_s,
    )


# ---- the stiff corner ----


def in_powers(low, high):
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


@settings(max_examples=40)
@given(
    mass=in_powers(0.2, 50.0),
    inertia=in_powers(1e-3, 5.0),
    rotor=in_powers(1e-7, 1e-3),
    mu=in_powers(0.05, 3.0),
    stiffness=in_powers(10.0, 1e4),
    seed=st.integers(0, 1000),
)
def test_any_robot_is_stable_at_the_default_step_or_refused(
    mass, inertia, rotor, mu, stiffness, seed
):
    """Stable: shafts never faster than the motors can drive and the impact of a reversal."""
    values = parameter_set(
        base={
            "robot.mass_kg": mass,
            "robot.inertia_kg_m2": inertia,
            "motor.inertia_kg_m2": rotor,
            "contact.mu_drive": mu,
            "contact.slip_stiffness_s_m": stiffness,
        }
    )
    time = np.arange(0.0, 0.4, 0.05)
    duty = np.random.default_rng(seed).uniform(-1.0, 1.0, (len(time), 4))
    try:
        outputs = simulate([values], time, duty)[0]
    except ValueError as error:
        assert "too stiff to simulate" in str(error)
        assert stiffness * mu * 49.0 / min(mass, inertia / 0.04, rotor * 57600.0) > 1e3
        return
    no_load_rad_s = 24.0 / 0.0255
    assert np.abs(np.diff(outputs[:, :4], axis=0)).max() <= 1.05 * no_load_rad_s * 0.05
    assert np.abs(np.diff(outputs[:, 5:7], axis=0)).max() <= 1.5 * no_load_rad_s * 0.05 / 12 * 0.05


def test_robot_too_stiff_is_refused_by_closed_loop_and_replay():
    base = {"robot.mass_kg": 1e-3, "contact.slip_stiffness_s_m": 1e6}
    with pytest.raises(ValueError, match=r"too stiff to simulate: .* 1/s"):
        simulate([parameter_set(base=base)], np.array([0.0, 0.1]), np.zeros((2, 4)))
    with pytest.raises(ValueError, match="too stiff to simulate"):
        simulate(
            [parameter_set(), parameter_set(base=base)], np.array([0.0, 0.1]), np.zeros((2, 4))
        )
    with pytest.raises(ValueError, match="too stiff to simulate"):
        closed_loop(read_scenario(SCENARIOS / "identification.toml"), 1e-3, base)


# ---- sensitivities ----


def quotients(kind, values, indices, sizes, offsets, weights):
    """Difference quotients (parameters, rows, outputs) of a replay by the numbered parameters,
    each moved by `offsets` times its size, all in one batch as the fits do it."""
    hard = np.random.default_rng(3).uniform(-0.5, 0.5, (4, motors(kind)))
    command = np.repeat(np.stack([hard, 0.3 * hard], axis=1).reshape(8, -1), 5, axis=0)
    time = np.arange(len(command)) * 0.01
    moved = np.repeat(values[None], len(indices) * len(offsets), axis=0)
    for row, (index, offset) in enumerate((i, o) for i in range(len(indices)) for o in offsets):
        moved[row, indices[index]] += offset * sizes[index]
    outputs = simulate(moved, time, command, kind=kind, step_s=2.5e-4)
    outputs = outputs.reshape(len(indices), len(offsets), len(time), -1)
    return np.einsum("poij,o,p->pij", outputs, weights, 1.0 / np.array(sizes))


def worst_slope_error(kind, values, indices, sizes):
    """Per parameter: one-sided quotient against a central one of fourth order over steps a
    thousand times as large, in shares of the largest slope of each output."""
    sizes = np.array(sizes)
    secant = quotients(kind, values, indices, 1e-5 * sizes, [0.0, 1.0], [-1.0, 1.0])
    weights = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
    central = quotients(kind, values, indices, 1e-2 * sizes, [-2.0, -1.0, 1.0, 2.0], weights)
    size = np.abs(central).max(axis=1, keepdims=True)
    return (np.abs(secant - central) / np.maximum(size, 1e-6)).max(axis=(1, 2)), size.max(
        axis=(1, 2)
    )


BASE = {
    "robot": {},
    "axis": {
        "axis.inertia": 2.5e-5,
        "axis.back_emf": 1.1e-3,
        "axis.viscous_friction": 1e-5,
        "axis.pendulum_mass_kg": 1e-4,
        "axis.friction_speed": 2.0,
    },
}


@pytest.mark.parametrize("kind", ["robot", "axis"])
def test_quotients_of_a_batch_are_the_derivatives_by_every_believed_value(kind):
    names = [p["name"] for p in _core.base_parameters(kind)]
    values = parameter_set(kind, BASE[kind])
    error, slope = worst_slope_error(
        kind, values, range(len(names)), np.abs(values[: len(names)]) / 3.0
    )
    silent = {name for name, s in zip(names, slope, strict=True) if s < 1e-9}
    assert silent == ({"encoder.counts_per_rev"} if kind == "robot" else {"axis.friction_speed"})
    assert error.max() < 2e-3, dict(zip(names, error, strict=True))


# No derivative exists where a parameter moves a threshold that a run crosses at an instant, none
# that an interval of one hundredth shows where it moves a corner (limit, teeth that meet, edge of a
# duty within a step, the row at which the way of a late camera bends: the typical delay is a row
# here): of these only that the quotient is not zero.
THRESHOLDS = {
    ("encoder_dropout", "speed_rad_s"),
    ("slippery_patch", "x_min_m"),
    ("slippery_patch", "x_max_m"),
}
CORNERS = {"actuation_delay", "current_limit", "gear_backlash", "pose_latency"}


def effect_parameters(kind):
    """(effect, parameter, its place in a parameter set) of one wheel or the whole robot."""
    place = len(_core.base_parameters(kind))
    for effect in _core.effects():
        columns = motors(kind) if effect["per_wheel"] else 1
        for parameter in effect["parameters"]:
            smooth = (effect["name"], parameter["name"]) not in THRESHOLDS
            if kind in effect["kinds"] and smooth and parameter["typical"] != 0.0:
                yield effect["name"], parameter, place
            place += columns


@pytest.mark.parametrize("kind", ["robot", "axis"])
def test_quotients_of_a_batch_are_the_derivatives_by_every_effect(kind):
    """At the typical size of each effect, by the value of its first wheel."""
    typical = {
        e["name"]: [
            (e["name"], p["name"], p["typical"] + (0.0 if np.isinf(p["neutral"]) else p["neutral"]))
            for p in e["parameters"]
        ]
        for e in _core.effects()
    }
    wrong = {}
    for name, parameter, place in effect_parameters(kind):
        values = parameter_set(kind, BASE[kind], typical[name])
        if (kind, name) == ("axis", "current_limit"):
            values[place] = 0.2  # a torque there, and the command asks for more
        error, slope = worst_slope_error(kind, values, [place], [abs(parameter["typical"]) / 3.0])
        if slope[0] < 1e-9 or (error[0] > 2e-3 and name not in CORNERS):
            wrong[name, parameter["name"]] = error[0], slope[0]
    assert wrong == {}
