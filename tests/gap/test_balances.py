"""Balances in weak form: exact where the sums are exact, and each blind to what it says it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.balances import CENTRES_S, HALF_S, Bumps, find_balances
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import replay_all
from omnislip.gap.noise import first_guess
from omnislip.gap.recordings import rim_m_per_rad, wheel_jacobian
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from truth_bench import runs_of

MACHINE = Machine(read_model(NOMINAL_ROBOT))


def jittered(seed, rows=200, row_s=0.005):
    """Times of rows that are up to a fifth early or late."""
    rng = np.random.default_rng(seed)
    return (np.arange(rows) + 0.2 * rng.uniform(-1.0, 1.0, rows)) * row_s


# ---- the bump ----


@given(
    st.integers(0, 1000),
    st.floats(-1e4, 1e4),
    st.floats(-1e3, 1e3),
    st.floats(0.2, 0.8),
)
def test_steady_motion_has_its_mean_its_rate_and_no_acceleration(seed, offset, rate, centre_s):
    t_s = jittered(seed)
    bumps = Bumps(t_s, np.array([centre_s]))
    signal = offset + rate * (t_s - centre_s)
    size = abs(offset) + abs(rate) + 1e-3
    assert bumps.mean @ signal == pytest.approx(offset, abs=1e-4 * size)
    assert bumps.rate @ signal == pytest.approx(rate, abs=1e-9 * size)
    assert bumps.acceleration @ signal == pytest.approx(0.0, abs=1e-9 * size)


@pytest.mark.parametrize("row_s", [0.005, 0.02])
def test_a_wave_is_weighed_by_the_bump(row_s):
    """Against the integral of phi times the derivatives, on a thousand times as many points."""
    t_s = jittered(3, round(1.0 / row_s), row_s)
    fine_s = np.linspace(0.5 - HALF_S, 0.5 + HALF_S, 20001)
    phi = (1.0 - ((fine_s - 0.5) / HALF_S) ** 2) ** 4
    phi /= np.trapezoid(phi, fine_s)
    turn = 2 * np.pi * 3.0
    bumps = Bumps(t_s, np.array([0.5]))
    wave = np.sin(turn * t_s)
    wanted = {
        "mean": np.sin(turn * fine_s),
        "rate": turn * np.cos(turn * fine_s),
        "acceleration": -(turn**2) * np.sin(turn * fine_s),
    }
    for order, (kind, exact) in enumerate(wanted.items()):
        found = (getattr(bumps, kind) @ wave)[0]
        largest = turn**order
        assert found == pytest.approx(np.trapezoid(phi * exact, fine_s), abs=0.02 * largest)


def test_a_window_of_too_few_samples_or_over_an_end_says_nothing():
    t_s = np.concatenate([np.arange(100) * 0.005, 0.8 + np.arange(100) * 0.005])
    bumps = Bumps(t_s, np.array([0.1, 0.25, 0.65, 1.0, 1.25]))
    assert np.isfinite(bumps.rate).all(axis=1).tolist() == [False, True, False, True, False]


def test_no_window_holds_a_restart_of_the_replays():
    """An error that drifts, and is none again at every restart, has its rate in all of them."""
    t_s = np.arange(0.0, 4.0, 0.005)
    centres_s = (np.arange(3.0)[:, None] + CENTRES_S).ravel()
    assert Bumps(t_s, centres_s).rate @ (t_s % 1.0) == pytest.approx(1.0, abs=1e-9)


def test_one_sample_says_nothing():
    bumps = Bumps(np.array([0.5]), np.array([0.5]))
    assert np.isnan([bumps.mean, bumps.rate, bumps.acceleration]).all()


# ---- what fails where ----


WHEELS = {f"wheel {k}: torque" for k in range(1, 5)}


def left_by(*effects, machine=MACHINE):
    """What the balances of the true keys leave on quiet logs with these effects: {name: rms}.

    The model has none of them, but for those that `machine` has.
    """
    truth = TruthCase(
        seed=5,
        effects=tuple(effect.as_dict() for effect in effects),
        runs=3,
        run_duration_s=4.0,
        base_offset_sd=0.0,
        noise_level=0.2,
    )
    runs = runs_of(machine, truth)
    noise, sets = first_guess(machine, runs), [machine.believed]
    found = find_balances(machine, replay_all(machine, runs, noise, sets), noise, sets)
    return {one.name: float(one.rms[0]) for one in found}


@pytest.fixture(scope="module")
def without():
    return left_by()


def as_forces(left):
    """The balances of torques, forces and moments as forces at the rims, in N."""
    shaft_m, lever_m = rim_m_per_rad(MACHINE), np.abs(wheel_jacobian(MACHINE)[0, 2])
    arms = {"torque": shaft_m, "moment": lever_m, "force": 1.0}
    kinds = {name: name.split(": ")[1].split()[0] for name in left}
    return {name: left[name] / arms[kind] for name, kind in kinds.items() if kind in arms}


@pytest.mark.parametrize(
    ("effect", "fail", "hold"),
    [
        (
            HiddenEffect("one_wheel_drag", {"torque_nm": 0.02}, 2),
            {"wheel 2: torque", "null space of the wheels: force", "body, any contact: moment"},
            WHEELS - {"wheel 2: torque"},
        ),
        (
            HiddenEffect("body_drag", {"coefficient_n_s_m": 40.0}),
            {"body: force along y", "body, any contact: force along y"},
            {*WHEELS, "null space of the wheels: force", "body: moment"},
        ),
    ],
    ids=["wheel", "body"],
)
def test_a_force_fails_its_balances_more_than_those_that_are_blind_to_it(
    effect, fail, hold, without
):
    """Not at all would be too much: a model that is wrong pulls the states astray."""
    left = left_by(effect)
    forces = as_forces(left)
    assert min(forces[name] for name in fail) > 4.0 * max(forces[name] for name in hold)
    sensors = "gyro less camera: turning"
    assert left[sensors] == pytest.approx(without[sensors], rel=0.1)


def test_a_wrong_gyro_fails_what_it_enters(without):
    left = left_by(HiddenEffect("gyro_scale", {"scale": 1.1}))
    worse = {name: left[name] / without[name] for name in left}
    fail = {"gyro less camera: turning", "gyro less wheels: turning", "body: moment"}
    hold = {"camera less wheels: speed along x", "null space of the wheels: speed"}
    assert min(worse[name] for name in fail) > 10.0 * max(worse[name] for name in hold)


@pytest.mark.parametrize(
    "effect",
    [
        HiddenEffect("shaft_compliance", {"stiffness_nm_rad": 40.0, "damping_nm_s_rad": 0.02}),
        HiddenEffect("actuation_delay", {"delay_s": 0.02}),
        HiddenEffect("armature_inductance", {"inductance_h": 0.002}),
    ],
    ids=lambda effect: effect.name,
)
def test_what_drives_remember_leaves_nothing_beside_a_model_that_knows_it(effect, without):
    """Their share of inertia behind a spring is the truth's."""
    left = left_by(effect)
    model = replace(read_model(NOMINAL_ROBOT), effects=[Effect(effect.name, effect.parameters)])
    known = left_by(effect, machine=Machine(model))
    assert all(left[name] > 5.0 * known[name] for name in WHEELS)
    assert all(known[name] < 2.0 * without[name] for name in WHEELS)


def test_a_wrong_contact_law_fails_what_knows_it(without):
    left = left_by(HiddenEffect("low_grip", {"scale": 0.6}))
    assert all(left[name] > 20.0 * without[name] for name in WHEELS)
    share = {
        force: left[f"body, any contact: {force}"] / left[f"body: {force}"]
        for force in ("force along x", "force along y", "moment")
    }
    assert max(share.values()) < 1.0
    assert max(share["force along y"], share["moment"]) < 0.35


def test_nothing_missing_leaves_the_noise_of_camera_and_gyro():
    """The floor's pushes are small beside it in these."""
    truth = TruthCase(seed=6, runs=3, run_duration_s=4.0, base_offset_sd=0.0)
    runs = runs_of(MACHINE, truth)
    noise, sets = first_guess(MACHINE, runs), [MACHINE.believed]
    found = find_balances(MACHINE, replay_all(MACHINE, runs, noise, sets), noise, sets)
    rms = {one.name: float(one.rms[0]) / one.noise for one in found}
    assert 0.7 < rms["gyro less camera: turning"] < 1.4
    assert 0.7 < rms["body: force along x"] < 1.4


def test_runs_without_a_sensor_say_nothing_of_its_noise():
    truth = TruthCase(seed=6, runs=2, run_duration_s=3.0, base_offset_sd=0.0)
    seen, blind = runs_of(MACHINE, truth)
    blind.outputs[:, 5:8] = np.nan
    noise, sets = first_guess(MACHINE, [seen]), [MACHINE.believed]
    alone, both = (
        {one.name: one for one in find_balances(MACHINE, replays, noise, sets)}
        for replays in (
            replay_all(MACHINE, [seen], noise, sets),
            replay_all(MACHINE, [seen, blind], noise, sets),
        )
    )
    name = "gyro less camera: turning"
    assert both[name].noise == alone[name].noise
    assert both[name].rms == alone[name].rms


def test_without_camera_and_gyro_only_the_wheels_are_balanced():
    truth = TruthCase(seed=5, sensors=(), runs=1, run_duration_s=3.0)
    runs = runs_of(MACHINE, truth)
    noise, sets = first_guess(MACHINE, runs), [MACHINE.believed]
    found = find_balances(MACHINE, replay_all(MACHINE, runs, noise, sets), noise, sets)
    assert {one.name for one in found} == {
        *WHEELS,
        "null space of the wheels: force",
        "null space of the wheels: speed",
    }
    assert all(0 < one.noise < one.rms[0] for one in found)
