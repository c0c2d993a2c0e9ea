"""The truth generator: physics against closed forms, neutrality, sensors, files, bad input."""

from __future__ import annotations

import ast
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip.errors import InputError
from omnislip.gap import truth_plant as plant_model
from omnislip.gap.truth import (
    COMPOSITIONS,
    NOMINAL,
    PROCESS_NOISE_SD,
    SENSORS,
    TruthCase,
    build_plant,
    coloured_noise,
    encoder_counts,
    generate,
    mean_duty,
    random_case,
    robot_toml,
    row_ticks,
    true_parameters,
    write_case,
)
from omnislip.gap.truth_effects import (
    EFFECTS,
    UNKNOWN_EFFECTS,
    HiddenEffect,
    apply_effect,
    parse_effect,
    typical_effect,
)
from scipy.integrate import solve_ivp

ALL_EFFECTS = EFFECTS | UNKNOWN_EFFECTS
WITH_PARAMETERS = sorted(name for name, effect in ALL_EFFECTS.items() if effect.parameters)
TICK_S = plant_model.STEP_S
STILL = np.zeros((1000, 4))


def simulate(plant, duty):
    """History of an open-loop run without noise from pose 0 and shaft angles 0."""
    noise = np.zeros((len(duty), plant_model.NOISE_CHANNELS))
    history, _ = plant_model.simulate_run(
        plant, duty, np.zeros(3), False, noise, np.zeros(3), np.zeros(4)
    )
    return history


def plant_with(**fields):
    plant = plant_model.neutral_plant()
    for name, value in fields.items():
        plant[name] = value
    return plant


def work_of(plant):
    """Working record of a robot at rest."""
    work = np.zeros(1, plant_model.WORK).view(np.recarray)[0]
    plant_model.start_work(plant[0], work)
    return work


def wiggle(milliseconds=600):
    """Duty that drives all axes, with slip and reversals."""
    t = np.arange(milliseconds)[:, None] * 1e-3
    return 0.25 * np.sin(2.0 * np.pi * t * np.array([1.7, 2.3, 3.1, 4.1]) + np.arange(4.0))


def quick_case(name=None, **changes):
    effects = () if name is None else (typical_effect(name).as_dict(),)
    return replace(TruthCase(11, effects, runs=1, run_duration_s=3.5, sensors=SENSORS), **changes)


# --- friction curves -------------------------------------------------------------------------


@pytest.mark.parametrize("curve", range(3))
def test_curves_start_with_the_same_slope(curve):
    assert plant_model.friction_curve(curve, 1e-5) / 1e-5 == pytest.approx(1.0, rel=1e-8)


@given(st.integers(0, 2), st.floats(-1e3, 1e3))
def test_curves_are_odd_bounded_and_never_steeper_than_at_zero(curve, x):
    share = plant_model.friction_curve(curve, x)
    assert share == -plant_model.friction_curve(curve, -x)
    assert abs(share) <= min(1.0, abs(x) * (1.0 + 1e-12))


def test_curves_differ_where_it_matters():
    shares = [plant_model.friction_curve(curve, 1.5) for curve in range(3)]
    assert np.ptp(shares) > 0.05


# --- motor and supply ------------------------------------------------------------------------


def test_free_motor_follows_the_exponential():
    """J dW/dt = k (V d - k W) / R - b W, without contact."""
    duty = np.tile([0.1, -0.2, 0.3, 0.05], (300, 1))
    history = simulate(plant_with(mu_drive=0.0), duty)
    k, r, b, inertia = 0.0255, 0.6, 1.5e-5, 2.5e-5
    rate = (k * k / r + b) / inertia
    t = np.arange(len(history)) * TICK_S
    final = k * 24.0 * duty[0] / r / (rate * inertia)
    expected = final * (1.0 - np.exp(-rate * t))[:, None]
    assert np.allclose(history[:, plant_model.SHAFT_SPEED], expected, atol=1e-3 * abs(final).max())


def test_inductive_motor_follows_both_modes():
    """L di/dt = V d - R i - k W;  J dW/dt = k i - b W."""
    inductance = 1.5e-3
    duty = np.full((100, 4), 0.2)
    history = simulate(plant_with(mu_drive=0.0, inductance_h=inductance), duty)
    system = np.array([[-0.6 / inductance, -0.0255 / inductance], [0.0255 / 2.5e-5, -0.6]])
    final = np.linalg.solve(system, [-24.0 * 0.2 / inductance, 0.0])
    modes, vectors = np.linalg.eig(system)
    t = np.arange(len(history)) * TICK_S
    free = vectors @ (np.exp(np.outer(modes, t)) * np.linalg.solve(vectors, -final)[:, None])
    expected = final[1] + free[1].real
    error = np.abs(history[:, plant_model.SHAFT_SPEED][:, 0] - expected).max()
    assert error < 2e-3 * final[1]


def test_the_current_of_a_warm_winding_is_less_late():
    """L di/dt = V d - R (1 + c Q) i - k W;  Q' = i^2 - Q / T;  J W' = k i - b W."""
    inductance, heating, volt = 3e-3, 0.1, 24.0 * 0.6
    duty = np.full((100, 4), 0.6)
    plant = plant_with(mu_drive=0.0, inductance_h=inductance, heating_1_a2_s=heating)
    history = simulate(plant, duty)

    def motion(_t, state):
        current, speed, heat = state
        resistance = 0.6 * (1.0 + heating * heat)
        return [
            (volt - resistance * current - 0.0255 * speed) / inductance,
            (0.0255 * current - 1.5e-5 * speed) / 2.5e-5,
            current**2 - heat / plant_model.COOLING_TIME_S,
        ]

    t = np.arange(len(history)) * TICK_S
    exact = solve_ivp(motion, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y
    error = np.abs(history[:, plant_model.SHAFT_SPEED][:, 0] - exact[1]).max()
    assert exact[2].max() * heating > 0.2
    assert error < 2e-3 * exact[1].max()


@settings(max_examples=60)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4),
    st.lists(st.floats(-500.0, 500.0), min_size=4, max_size=4),
    st.floats(0.01, 0.5),
    st.floats(1.0, 30.0),
    st.floats(0.0, 1.0),
)
def test_supply_balances_the_currents(duty, speed, resistance, limit, braking):
    plant = plant_with(
        source_resistance_ohm=resistance, current_limit_a=limit, braking_fraction=braking
    )
    work = work_of(plant)
    work.duty[:] = duty
    state = np.zeros(26)
    state[6:10] = speed
    plant_model.solve_supply(plant[0], 0.0, state, work)
    assert np.all(np.abs(work.current_a) <= limit)
    drop_v = resistance * work.current_a @ work.duty
    assert work.bus_v + drop_v == pytest.approx(24.0, abs=1e-6)


def test_driver_delay_shifts_the_response():
    still = np.zeros((20, 4))
    duty = np.vstack([still, wiggle(200), still])
    prompt = simulate(plant_model.neutral_plant(), duty)
    late = simulate(plant_with(delay_s=0.0073), duty)
    assert np.allclose(late[73:, :6], prompt[:-73, :6], atol=1e-12)


def test_driver_lag_and_free_motor_are_two_lags_in_series():
    lag = 0.01
    history = simulate(plant_with(mu_drive=0.0, lag_s=lag), np.full((150, 4), 0.2))
    rate = (0.0255**2 / 0.6 + 1.5e-5) / 2.5e-5
    motor, final = 1.0 / rate, 0.0255 * 24.0 * 0.2 / 0.6 / (rate * 2.5e-5)
    t = np.arange(len(history)) * TICK_S
    free = (motor * np.exp(-t / motor) - lag * np.exp(-t / lag)) / (motor - lag)
    assert np.abs(history[:, 6] - final * (1.0 - free)).max() < 1e-4 * final


# At 50 rad/s tanh(W / 2 rad/s) is 1 to within 1e-21: the laws read without their smoothing.
@pytest.mark.parametrize(
    ("fields", "forward_nm", "backward_nm"),
    [
        ({"coulomb_nm": 0.01}, 0.01, -0.01),
        ({"forward_coulomb_nm": 0.01, "forward_viscous_nm_s": 1e-4}, 0.015, 0.0),
        ({"stribeck_nm": 0.02, "stribeck_speed_rad_s": 50.0}, 0.02 / np.e, -0.02 / np.e),
        ({"load_friction": 0.1}, 0.03, -0.03),
        ({"quadratic_drag": 1e-6}, 0.0025, -0.0025),
        ({"viscous_nm_s": 1e-4}, 0.005, -0.005),
        ({"fifth_drag_nm": 1.0}, 6.0**-5, -(6.0**-5)),
        ({"cogging_nm": 0.01, "cogging_cycles": 3.0, "cogging_phase_rad": 0.5}, *[0.01] * 2),
    ],
)
def test_shaft_friction_laws(fields, forward_nm, backward_nm):
    p = plant_with(**{"viscous_nm_s": 0.0} | fields)[0]
    angle = (0.5 * np.pi - 0.5) / 3.0
    torque = [plant_model.shaft_friction_nm(p, 0, 0.0, w, angle, 0.3, 0.2) for w in (50.0, -50.0)]
    assert torque == pytest.approx([forward_nm, backward_nm], abs=1e-12)


def test_dead_zone_swallows_small_duty():
    history = simulate(plant_with(dead_zone_duty=0.05), np.full((200, 4), 0.049))
    assert np.all(history[:, plant_model.SHAFT_SPEED] == 0.0)
    history = simulate(plant_with(dead_zone_duty=0.05), np.full((200, 4), 0.06))
    assert np.all(history[-1, plant_model.SHAFT_SPEED] > 1.0)


def test_current_limit_is_reached_and_kept():
    history = simulate(plant_with(current_limit_a=3.0), np.full((200, 4), 0.5))
    assert np.abs(history[:, plant_model.CURRENT]).max() == pytest.approx(3.0)


def test_coulomb_friction_slows_a_free_shaft_by_its_torque():
    plant = plant_with(mu_drive=0.0, viscous_nm_s=0.0, coulomb_nm=0.01, resistance_ohm=1e9)
    plant["supply_v"] = 24e9 * 0.6  # the current of the nominal stall, without back-EMF
    duty = np.vstack([np.full((20, 4), 0.1), np.zeros((60, 4))])
    speed = simulate(plant, duty)[:, 6]
    slope = (speed[600] - speed[400]) / (200 * TICK_S)
    assert slope == pytest.approx(-0.01 / 2.5e-5, rel=1e-3)


# --- body and contact ------------------------------------------------------------------------


def test_rollers_brake_a_sliding_body_by_mu_g_cos_30():
    """Free wheels, saturated rollers: a = mu g cos(30 deg) along x."""
    plant = plant_with(mu_drive=0.0, slip_stiffness_s_m=1e6, impact_time_s=0.0, impulse_x_n_s=20.0)
    speed = simulate(plant, STILL[:500])[:, 3]
    slope = (speed[4000] - speed[1000]) / (3000 * TICK_S)
    assert speed[1] == pytest.approx(1.0, abs=1e-3)
    assert slope == pytest.approx(-0.05 * 9.81 * np.cos(np.pi / 6.0), rel=1e-3)


@pytest.mark.parametrize("curve", range(3))
def test_energy_balance(curve):
    """Motor work = kinetic energy + losses in bearing, slip and rollers."""
    plant = plant_with(curve=float(curve))
    h = simulate(plant, wiggle(800))
    bearing = plant["bearing_rad"][0]
    speed, slip = h[:, plant_model.SHAFT_SPEED], h[:, plant_model.SLIP]
    vx, vy, w = h[:, 3], h[:, 4], h[:, 5]
    across = np.outer(vx, np.cos(bearing)) + np.outer(vy, np.sin(bearing))
    share = np.vectorize(lambda s: plant_model.friction_curve(curve, 2.0 / np.pi * 40.0 * s))
    load = 20.0 * 9.81 / 4.0
    power = 0.0255 * h[:, plant_model.CURRENT] * speed - 1.5e-5 * speed**2
    power -= load * (0.6 * share(slip) * slip + 0.05 * share(across) * across)
    work = power.sum() * TICK_S
    kinetic = 10.0 * (vx**2 + vy**2)[-1] + 0.275 * w[-1] ** 2
    kinetic += 0.5 * 2.5e-5 * (speed[-1] ** 2).sum()
    moved = np.abs(power).sum() * TICK_S
    assert kinetic > 0.01 * moved
    assert work == pytest.approx(kinetic, abs=2e-3 * moved)


def test_pull_is_limited_by_grip():
    """Wheels that slip far: acceleration along y is mu g 4 cos(30 deg) / 4, never more."""
    duty = np.tile([1.0, -1.0, -1.0, 1.0], (150, 1))
    speed = simulate(plant_model.neutral_plant(), duty)[:, 4]
    acceleration = np.diff(speed) / TICK_S
    most = 0.6 * 9.81 * np.cos(np.pi / 6.0)
    assert 0.95 * most < acceleration.max() <= most * (1.0 + 1e-9)


def test_free_body_turns_about_its_centre_of_gravity():
    """Without contact the centre of gravity moves straight on, whatever the body turns."""
    plant = plant_with(mu_drive=0.0, mu_roller=0.0, cog_x_m=0.05, cog_y_m=-0.03)
    plant["impact_time_s"] = 0.0
    plant["impulse_x_n_s"], plant["impulse_theta_n_m_s"] = 10.0, 1.5
    h = simulate(plant, STILL)
    cos_t, sin_t = np.cos(h[:, 2]), np.sin(h[:, 2])
    centre = h[:, :2] + np.stack([0.05 * cos_t + 0.03 * sin_t, 0.05 * sin_t - 0.03 * cos_t], axis=1)
    t = np.arange(len(h)) * TICK_S
    straight = centre[0] + np.outer(t, (centre[-1] - centre[0]) / t[-1])
    assert np.ptp(h[:, 2]) > 2.0
    assert np.allclose(centre, straight, atol=1e-5)


def test_pulled_body_obeys_newton_and_euler_about_its_centre_of_gravity():
    """A spring that pulls at the wheel centre: m a_G = F, Iz dw/dt = -c x F."""
    plant = plant_with(mu_drive=0.0, mu_roller=0.0, cog_x_m=0.05, cog_y_m=-0.03)
    plant["tether_n_m"], plant["tether_x_m"], plant["tether_y_m"] = 60.0, 0.4, 0.7
    h = simulate(plant, STILL)[::10]
    lever = (0.05 - 0.03j) * np.exp(1j * h[:, 2])
    centre = h[:, 0] + 1j * h[:, 1]
    force = 60.0 * (0.4 + 0.7j - centre)
    acceleration = np.diff(centre + lever, 2) / 1e-6
    spin_up = np.diff(h[:, 5]) / 1e-3
    moment = -(np.conj(lever) * force).imag
    assert np.allclose(acceleration, force[1:-1] / 20.0, atol=1e-3)
    assert np.allclose(spin_up, 0.5 * (moment[1:] + moment[:-1]) / 0.55, atol=1e-3)
    assert np.ptp(h[:, 5]) > 0.5


@given(
    st.floats(-0.03, 0.03),
    st.floats(-0.03, 0.03),
    st.floats(0.0, 0.2),
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
)
def test_wheel_loads_carry_weight_and_moments(cog_x, cog_y, height, ax, ay):
    plant = plant_with(cog_x_m=cog_x, cog_y_m=cog_y, cog_height_m=height)
    work = work_of(plant)
    work.force_x_m_s2, work.force_y_m_s2 = ax, ay
    plant_model.wheel_loads(plant[0], work)
    load = work.load_n
    x, y = 0.2 * np.cos(plant["bearing_rad"][0]), 0.2 * np.sin(plant["bearing_rad"][0])
    lifted = load.min() == 0.0
    residual = [
        load.sum() - 196.2,
        load @ x - 20.0 * (9.81 * cog_x - height * ax),
        load @ y - 20.0 * (9.81 * cog_y - height * ay),
    ]
    assert lifted or np.allclose(residual, 0.0, atol=1e-9)


def test_slope_accelerates_a_loose_body_in_the_world_frame():
    plant = plant_with(mu_drive=0.0, mu_roller=0.0, slope_x_m_s2=0.3, slope_y_m_s2=-0.1)
    noise = np.zeros((1000, plant_model.NOISE_CHANNELS))
    start = np.array([0.0, 0.0, 2.0])
    h, _ = plant_model.simulate_run(plant, STILL, np.zeros(3), False, noise, start, np.zeros(4))
    assert h[-1, :3] == pytest.approx([0.15, -0.05, 2.0], rel=1e-6)


def test_play_in_the_gear_lets_the_shaft_turn_alone():
    plant = plant_with(backlash_rad=0.4)
    h = simulate(plant, np.full((150, 4), 0.05))
    wheel_would_turn = h[:, plant_model.ENCODER_ANGLE][:, 0] / 12.0
    moved = np.flatnonzero(h[:, 5])
    assert 0.2 <= wheel_would_turn[moved[0]] < 0.21
    assert h[-1, 5] > 0.0


def test_clock_of_the_impact():
    plant = plant_with(impact_time_s=0.25, impulse_y_n_s=4.0)
    h = simulate(plant, STILL[:400])
    assert np.all(h[:2500, 3:6] == 0.0)
    assert h[2500, 4] == pytest.approx(0.2, rel=1e-12)


# --- effects ---------------------------------------------------------------------------------


def neutral_of(name):
    """The effect with the values that must change nothing."""
    reference = plant_model.neutral_plant()
    values = {}
    for key, draw in ALL_EFFECTS[name].parameters.items():
        untouched = reference[draw.plant_field][0]
        values[key] = {"add": 0.0, "scale": 1.0, "set": untouched}[draw.operation]
    return HiddenEffect(name, values)


@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_neutral_effect_is_no_effect_bit_for_bit(name):
    plant = plant_model.neutral_plant()
    apply_effect(plant, neutral_of(name))
    assert plant.tobytes() == plant_model.neutral_plant().tobytes()


@pytest.fixture(scope="module")
def clean_log():
    return generate(quick_case())[0][0]


@pytest.mark.parametrize("name", sorted(set(ALL_EFFECTS) - {"wheel_permutation"}))
def test_every_effect_changes_the_log_and_leaves_it_sound(name, clean_log):
    log = generate(quick_case(name))[0][0]
    assert list(log.columns) == list(clean_log.columns)
    assert not log.equals(clean_log)
    assert log.filter(like="duty").equals(clean_log.filter(like="duty"))  # same open-loop command
    assert log.drop(columns=log.filter(like="pose").columns).notna().all(axis=None)
    assert np.abs(log[["pose/x_m", "pose/y_m"]]).max(axis=None) < 5.0


def test_permutation_swaps_encoder_columns(clean_log):
    effect = {"name": "wheel_permutation", "parameters": {"wheels": [2, 1, 3, 4]}}
    log = generate(replace(quick_case(), effects=(effect,)))[0][0]
    swapped = log["wheel/1/encoder_counts"]
    assert swapped.equals(clean_log["wheel/2/encoder_counts"].rename("wheel/1/encoder_counts"))


def test_one_wheel_effect_touches_one_wheel():
    plant = plant_model.neutral_plant()
    apply_effect(plant, HiddenEffect("weak_motor", {"scale": 0.5}, 3))
    assert plant["torque_constant_nm_a"][0] == pytest.approx([0.0255, 0.0255, 0.01275, 0.0255])


def test_effect_of_one_run_stays_in_it():
    effect = typical_effect("impact").as_dict() | {"run": "run_02"}
    logs, truth = generate(replace(quick_case(), effects=(effect,), runs=2))
    clean, _ = generate(replace(quick_case(), runs=2))
    assert logs[0].equals(clean[0])
    assert not logs[1].equals(clean[1])
    assert truth["effects"][0]["run"] == "run_02"


@pytest.mark.parametrize("name", WITH_PARAMETERS)
def test_drawn_sizes_spread_over_at_most_a_decade(name):
    rng = np.random.default_rng(1)
    for draw in ALL_EFFECTS[name].parameters.values():
        values = np.array([draw.sample(rng) for _ in range(200)])
        size = np.abs(values - 1.0) if draw.kind in ("loss", "change") else np.abs(values)
        logarithmic = draw.kind in ("size", "signed", "loss", "change")
        assert not logarithmic or size.max() / size.min() <= 10.0 * (1.0 + 1e-9)
        assert not logarithmic or size.max() / size.min() > 2.0


# --- sensors ---------------------------------------------------------------------------------


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_rows_rise_start_at_zero_and_lose_up_to_one_percent(seed):
    ticks = row_ticks(np.random.default_rng(seed), 60_000)
    assert ticks[0] == 0 and ticks[-1] < 60_000
    assert np.all(np.diff(ticks) >= 10)
    assert 1199 * 0.97 <= len(ticks) <= 1199


def test_rows_are_lost_and_jitter():
    ticks = row_ticks(np.random.default_rng(0), 6_000_000)
    lost = 1.0 - len(ticks) / 119_999
    assert 0.0005 < lost < 0.0105
    steps = np.diff(ticks)
    assert np.std(steps[steps < 75]) == pytest.approx(3.0 * np.sqrt(2.0), rel=0.05)


@given(st.floats(-1e4, 1e4))
def test_counts_are_whole_edges_in_sixteen_bits(angle):
    plant = plant_model.neutral_plant()
    counts = encoder_counts(plant, np.full((1, 4), angle))
    assert np.all((counts >= 0) & (counts <= 0xFFFF))
    assert counts[0, 0] == int(np.floor(angle * 2000.0 / (2.0 * np.pi))) % 65536


@given(st.integers(0, 1000))
@settings(max_examples=30)
def test_mean_duty_keeps_the_integral(seed):
    rng = np.random.default_rng(seed)
    duty = rng.uniform(-1.0, 1.0, (300, 4))
    ticks = row_ticks(rng, 3000)
    mean = mean_duty(duty, ticks)
    length = np.diff(np.append(ticks, ticks[-1] + 50))
    total = np.repeat(duty, 10, axis=0)[: ticks[-1] + 50].sum(axis=0)
    assert np.allclose(length @ mean, total)


def test_gyro_and_pose_of_a_quiet_log_agree():
    """The integral of the gyro is the heading that the camera sees."""
    log = generate(quick_case(noise_level=0.0))[0][0]
    t_s, rate = log["t_s"].to_numpy(), log["gyro/z_rad_s"].to_numpy()
    turned = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t_s)))
    heading = log["pose/theta_rad"].to_numpy()
    seen = np.isfinite(heading)
    assert np.ptp(heading[seen]) > 0.3
    assert np.allclose(turned[seen], heading[seen] - heading[0], atol=2e-3)


def test_pose_latency_shows_the_past():
    quiet = quick_case(noise_level=0.0)
    effect = {"name": "pose_latency", "parameters": {"delay_s": 0.03}}
    now = generate(quiet)[0][0][["t_s", "pose/x_m"]].dropna()
    late = generate(replace(quiet, effects=(effect,)))[0][0][["t_s", "pose/x_m"]].dropna()
    expected = np.interp(late["t_s"] - 0.03, now["t_s"], now["pose/x_m"])
    assert np.allclose(late["pose/x_m"], expected, atol=1e-3)
    assert np.abs(now["pose/x_m"] - late["pose/x_m"]).max() > 5e-3


def test_pose_rotation_turns_the_path_counter_clockwise():
    quiet = quick_case(noise_level=0.0)
    effect = {"name": "pose_rotation", "parameters": {"angle_rad": 0.4}}
    true = generate(quiet)[0][0].filter(like="pose").dropna().to_numpy()
    seen = generate(replace(quiet, effects=(effect,)))[0][0].filter(like="pose").dropna().to_numpy()
    turned = (true[:, 0] + 1j * true[:, 1]) * np.exp(0.4j)
    assert np.allclose(seen[:, 0] + 1j * seen[:, 1], turned, atol=3e-6)
    assert np.array_equal(seen[:, 2], true[:, 2])


def test_process_noise_has_its_size_and_colour():
    noise = coloured_noise(np.random.default_rng(2), 60_000)
    assert noise.std(axis=0) == pytest.approx(PROCESS_NOISE_SD, rel=0.1)
    lag_one = np.mean(noise[1:] * noise[:-1], axis=0) / np.mean(noise**2, axis=0)
    corner_hz = -np.log(lag_one) / (2.0 * np.pi * 1e-3)
    assert np.all((corner_hz > 8.0) & (corner_hz < 34.0))


# --- cases, programmes, files ----------------------------------------------------------------


@pytest.mark.parametrize("excitation", ["rich", "ordinary", "poor"])
@pytest.mark.parametrize("closed_loop", [False, True])
def test_programmes_stay_near_and_within_duty(excitation, closed_loop):
    case = TruthCase(4, excitation=excitation, closed_loop=closed_loop, runs=4)
    for log in generate(case)[0]:
        assert np.abs(log[["pose/x_m", "pose/y_m"]]).max(axis=None) < 4.0
        assert np.abs(log.filter(like="duty")).max(axis=None) <= 1.0
        assert np.abs(log.filter(like="duty")).max(axis=None) > 0.08


def test_replicates_repeat_the_command_not_the_noise():
    logs, _ = generate(TruthCase(4, runs=8, run_duration_s=3.0))
    first, last = (
        np.interp(np.arange(0.0, 2.9, 0.02), log["t_s"], log["wheel/1/duty"])
        for log in (logs[0], logs[7])
    )
    assert np.abs(first - last).mean() < 0.1 * np.abs(first).mean()
    assert not logs[0]["gyro/z_rad_s"].head(100).equals(logs[7]["gyro/z_rad_s"].head(100))


def test_feedback_makes_the_duty_answer_the_noise():
    noisy, quiet = (
        generate(quick_case(closed_loop=True, noise_level=level))[0][0] for level in (1.0, 0.0)
    )
    rows = min(len(noisy), len(quiet))
    difference = noisy["wheel/1/duty"][:rows] - quiet["wheel/1/duty"][:rows]
    assert difference.std() > 1e-4


def test_same_case_gives_the_same_bytes(tmp_path):
    case = quick_case("dead_zone", runs=2)
    write_case(case, tmp_path / "a")
    write_case(case, tmp_path / "b")
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["robot.toml", "run_01.csv", "run_02.csv", "truth.json"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_another_seed_gives_another_log(clean_log):
    assert not generate(quick_case(seed=12))[0][0].equals(clean_log)


def test_written_log_reads_back(tmp_path, clean_log):
    write_case(quick_case(), tmp_path)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "run_01.csv"), clean_log)


def test_believed_robot_is_nominal_with_the_true_tolerances():
    believed = tomllib.loads(robot_toml(0.02))
    assert believed["robot"]["mass_kg"] == 20.0
    assert believed["encoder"]["counts_per_rev"] == 2000
    assert believed["tolerance"] == {
        "default": 0.02,
        "robot.wheel_radius_m": 0.002,
        "robot.wheel_distance_m": 0.004,
    }


@given(st.integers(0, 10_000))
@settings(max_examples=50)
def test_true_values_lie_within_two_tolerances(seed):
    values = true_parameters(TruthCase(seed))
    for key, nominal in NOMINAL.items():
        assert abs(values[key] / nominal - 1.0) <= 0.04 + 1e-12
    assert values["motor.torque_constant_nm_a"] == values["motor.back_emf_constant_v_s_rad"]
    assert values["robot.wheel_radius_m"] == pytest.approx(0.05, rel=0.004)


def test_truth_is_json_and_says_what_is_hidden(tmp_path):
    write_case(quick_case("weak_motor", friction_curve="tanh"), tmp_path)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["expected_verdict"] == "effect_found"
    assert truth["effects"][0]["name"] == "weak_motor" and truth["effects"][0]["wheel"] == 3
    assert truth["also_true"] == ["contact_shape"]


@pytest.mark.parametrize(
    ("composition", "count", "verdict"),
    [
        ("null", {0}, "no_gap"),
        ("single", {1}, "effect_found"),
        ("double", {2}, "effect_found"),
        ("triple", {3}, "effect_found"),
        ("unknown", {1}, "unknown_effect"),
        ("impact", {1, 2}, "effect_found"),
    ],
)
def test_random_cases_hold_what_they_promise(composition, count, verdict):
    for seed in range(8):
        case = random_case(seed, composition)
        assert case == random_case(seed, composition)
        assert len(case.effects) in count
    truth = generate(replace(case, runs=8, run_duration_s=1.0))[1]
    assert truth["expected_verdict"] == verdict


def test_random_cases_are_mixed():
    cases = [random_case(seed, COMPOSITIONS[seed % len(COMPOSITIONS)]) for seed in range(300)]
    assert np.mean([case.friction_curve != "atan" for case in cases]) > 0.5
    assert 0.4 < np.mean([case.closed_loop for case in cases]) < 0.6
    assert len({case.sensors for case in cases}) == 3
    assert len({effect["name"] for case in cases for effect in case.effects}) > 50


def test_named_random_case_can_see_its_effect():
    for seed in range(10):
        assert "pose" in random_case(seed, names=("pose_latency",)).sensors


@pytest.mark.parametrize(
    ("effect", "says"),
    [
        ({"name": "dead_zon", "parameters": {}}, "unknown effect 'dead_zon'; known are"),
        ({"name": "dead_zone", "parameters": {"z": 0.1}}, "parameters are duty"),
        ({"name": "dead_zone", "parameters": {}}, "parameters are duty"),
        ({"name": "dead_zone", "parameters": {"duty": float("nan")}}, "duty must be finite"),
        ({"name": "weak_motor", "parameters": {"scale": 0.9}}, "needs wheel 1, 2, 3 or 4"),
        ({"name": "weak_motor", "parameters": {"scale": 0.9}, "wheel": 5}, "not 5"),
        ({"name": "payload", "parameters": {"mass_kg": 1.0}, "wheel": 1}, "leave wheel out"),
        ({"name": "payload", "mass_kg": 1.0}, "keys are name, parameters, wheel, run"),
        ({"name": "payload", "parameters": {"mass_kg": 1.0}, "run": "run_09"}, "not one of"),
    ],
)
def test_bad_effect_is_one_clear_line(effect, says):
    with pytest.raises(InputError, match=says) as error:
        TruthCase(1, (effect,))
    assert "\n" not in str(error.value)


def test_two_pushes_are_never_in_one_run():
    """The plant of the generator knows one push of each run."""
    for seed in range(200):
        runs = [e["run"] for e in random_case(seed, "impact").effects]
        assert len(set(runs)) == len(runs)


def test_impact_needs_its_run():
    impact = {**typical_effect("impact").as_dict(), "run": None}
    with pytest.raises(InputError, match="needs run"):
        parse_effect(impact)


@pytest.mark.parametrize(
    "change",
    [
        {"friction_curve": "sqrt"},
        {"excitation": "wild"},
        {"sensors": ("lidar",)},
        {"runs": 0},
        {"run_duration_s": 0.5},
        {"noise_level": -1.0},
        {"base_offset_sd": float("nan")},
    ],
)
def test_bad_case_names_its_key(change):
    with pytest.raises(InputError, match=next(iter(change))):
        TruthCase(1, **change)


def test_unwritable_directory_is_an_input_error(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_case(quick_case(), blocker)
    assert blocker.read_text() == ""


def test_generator_shares_nothing_with_the_plant_under_test():
    folder = Path(plant_model.__file__).parent
    imported = set()
    for file in folder.glob("truth*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module)
    ours = {name for name in imported if name and name.startswith("omnislip")}
    allowed = {"omnislip.errors", "omnislip.files"}
    assert {name for name in ours if not name.startswith("omnislip.gap")} <= allowed
    assert {name for name in ours if name.startswith("omnislip.gap.")} <= {
        "omnislip.gap.truth_effects",
        "omnislip.gap.truth_excitation",
        "omnislip.gap.truth_plant",
    }


def test_wheel_angles_of_the_plant_are_those_of_the_file():
    plant = build_plant(NOMINAL, [], "atan", "run_01")
    angles = tomllib.loads(robot_toml(0.02))["robot"]["wheel_angles_deg"]
    assert np.degrees(plant["bearing_rad"][0]) == pytest.approx(angles)
