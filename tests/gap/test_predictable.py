"""Chance cannot be predicted; a force that no term was made for can."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from omnislip.gap import predictable, truth
from omnislip.gap.machine import Machine
from omnislip.gap.noise import track_all
from omnislip.gap.predictable import EQUATIONS, OWN_PASTS_S, Predictable, predictable_shares
from omnislip.gap.recordings import ELECTRIC_CHANNELS, ROBOT_CHANNELS, make_run
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.split import split_runs
from omnislip.gap.truth import TruthCase
from omnislip.gap.verdict import (
    CURRENT_SHARE,
    LASTING_SHARES,
    PREDICTED_SHARE,
    SENSOR_SHARE,
    no_chance,
)
from omnislip.log_file import POSE_COLUMNS
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario
from scipy.signal import lfilter
from truth_bench import logs_of


def shares_of(effects=(), runs=6, seed=3, bend=None, **changed):
    """Shares of runs of the generator; `bend` changes the logs."""
    case = TruthCase(
        seed,
        effects=effects,
        runs=runs,
        run_duration_s=4.0,
        base_offset_sd=0.0,
        sensors=("gyro", "pose"),
        **changed,
    )
    machine = Machine(read_model(NOMINAL_ROBOT))
    logs = [bend(log) if bend else log for log in logs_of(case)]
    return shares_in(machine, [make_run(machine, log) for log in logs])


def shares_in(machine, logs):
    """Shares beside the believed model, its keys and the noise fitted."""
    data, fitted = settle(machine, logs, believed_hypothesis(machine), tunings=2)
    values = fitted.hypothesis.flat(machine.believed)
    tracks = track_all(machine, logs, values, data.noise, keep_linear=True)
    return predictable_shares(machine, logs, data.noise, values, tracks, values, data.answers)


def test_chance_cannot_be_predicted():
    found = shares_of()
    assert {one.equation for one in found} == {*EQUATIONS, *ROBOT_CHANNELS}
    assert found[0].share < 0.05
    assert max(one.share for one in found if one.from_own_past) < 0.011


@pytest.mark.parametrize("corner_hz", [3.0, 6.0])
def test_chance_that_fades_slowly_is_chance(corner_hz, monkeypatch):
    """Floors may push for longer than the predictor allows: 3 Hz tell a tenth of themselves."""
    slow = partial(truth.coloured_noise, corner_hz=(corner_hz, corner_hz))
    monkeypatch.setattr(truth, "coloured_noise", slow)
    found = shares_of()
    assert max(one.share for one in found if one.from_own_past) < 0.154
    assert max(one.share for one in found if not one.from_own_past) < 0.05


@pytest.mark.parametrize(("more", "told"), [(1.5, False), (5.0, True)])
def test_a_floor_that_is_a_little_uneven_is_chance_as_long_as_that_lasts(monkeypatch, more, told):
    """Accelerations of 0.11 or 0.37 m/s2 that fade within 0.4 s, and of 0.27 or 0.9 rad/s2."""
    chance, body = truth.coloured_noise, np.arange(7) < 3

    def floors(rng, rows):
        lasting = chance(rng, rows, corner_hz=(0.4, 0.4))
        return np.where(body, more * lasting, chance(rng, rows))

    monkeypatch.setattr(truth, "coloured_noise", floors)
    own = [one for one in shares_of() if one.equation.startswith("body/") and one.from_own_past]
    for equation in {one.equation for one in own}:
        assert any(no_chance(one) for one in own if one.equation == equation) == told


def test_friction_is_all_that_moves_a_body_that_does_not_turn():
    model = read_model(NOMINAL_ROBOT)
    without_rollers = replace(model, values=model.values | {"contact.mu_roller": 0.0})
    machine, rng = Machine(without_rollers), np.random.default_rng(0)
    state = rng.normal(size=(20, machine.engine.states))
    state[:, 10] = 0.0
    command = rng.uniform(-1.0, 1.0, (20, 4))
    friction = predictable._friction(machine, machine.believed, state, command)
    rates = machine.engine.derivatives(machine.believed, state, command)
    np.testing.assert_allclose(friction[:, 4:], rates[:, 8:11], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("share", "off"), [(1e-4, True), (1e-2, False)])
def test_what_friction_is_off_its_law_is_no_force_of_its_own(monkeypatch, share, off):
    """A curve that was not fitted is off by more than 1 % of friction in violent driving."""
    monkeypatch.setattr(predictable, "FRICTION_SHARE", share)
    found = shares_of(friction_curve="brush", excitation="rich")
    assert (max(one.share for one in found if not one.from_own_past) > PREDICTED_SHARE) == off


def test_what_swings_is_no_chance(monkeypatch):
    """Forces of 3.7 Hz, a tenth of them gone after half a swing: 60 ms ahead a quarter is told."""

    def swinging(rng, rows):
        turn = np.exp((-0.7 + 2j * np.pi * 3.7) * 1e-3)
        white = rng.standard_normal((rows, truth.PROCESS_NOISE_SD.size))
        level = lfilter([1.0], [1.0, -2.0 * turn.real, abs(turn) ** 2], white, axis=0)
        return level / level.std(axis=0) * truth.PROCESS_NOISE_SD

    monkeypatch.setattr(truth, "coloured_noise", swinging)
    body = [one for one in shares_of() if one.equation.startswith("body/force")]
    found = {one.ahead_s: one for one in body if one.from_own_past}
    last = OWN_PASTS_S[1][0]
    assert found[last].share > LASTING_SHARES[last]
    assert found[last].runs_helped > found[last].runs / 2


def test_what_beats_is_no_chance_though_chance_hides_it(monkeypatch):
    """A wave of 2.6 Hz in every equation beside chance that fades within 50 ms."""
    chance = truth.coloured_noise

    def beating(rng, rows):
        phases = rng.uniform(0.0, 2.0 * np.pi, truth.PROCESS_NOISE_SD.size)
        wave = np.sin(2.0 * np.pi * 2.6e-3 * np.arange(rows)[:, None] + phases)
        return chance(rng, rows) + 1.2 * truth.PROCESS_NOISE_SD * wave

    monkeypatch.setattr(truth, "coloured_noise", beating)
    body = [one for one in shares_of() if one.equation.startswith("body/") and one.from_own_past]
    beat_s = OWN_PASTS_S[2][0]
    for equation in ("body/force_x", "body/force_y"):
        found = {one.ahead_s: one for one in body if one.equation == equation}
        assert found[beat_s].share > LASTING_SHARES[beat_s]
        assert no_chance(found[beat_s])


def test_rounding_that_every_run_repeats_is_nothing_to_be_predicted():
    """Simulated runs of one scenario differ in the noise of their sensors alone."""
    scenario = read_scenario(NOMINAL_ROBOT.parents[1] / "scenarios" / "identification.toml")
    machine = Machine(scenario.model)
    logs = [run_scenario(replace(scenario, seed=seed)).log for seed in range(1, 5)]
    logs = [replace(log, name=f"run_{seed}") for seed, log in enumerate(logs)]
    found = shares_in(machine, [make_run(machine, log) for log in logs])
    assert max(one.share for one in found) < 0.011


def test_chance_that_a_controller_answers_cannot_be_predicted():
    """At three times the usual noise, in smooth driving."""
    found = shares_of(closed_loop=True, noise_level=3.0, excitation="ordinary")
    assert found[0].share < 0.05


def test_filtered_speeds_that_hardly_vary_do_not_predict_the_chance_they_hold():
    """To and fro in open loop: speeds as they are filtered give 9 % of the disturbances away."""
    found = shares_of(seed=5, noise_level=3.0, excitation="poor")
    assert found[0].share < 0.05


@pytest.mark.parametrize("closed_loop", [False, True])
def test_a_force_of_no_catalogue_is_predicted_where_it_acts(closed_loop):
    """8 N s2/m2 at right angles to the velocity act on the body, not on the wheels."""
    force = {"name": "lateral_speed_force", "parameters": {"coefficient_n_s2_m2": 8.0}}
    found = [one for one in shares_of((force,), closed_loop=closed_loop) if not one.from_own_past]
    assert found[0].equation.startswith("body/")
    assert found[0].share > PREDICTED_SHARE
    assert found[0].runs_helped > found[0].runs / 2


@pytest.mark.parametrize("closed_loop", [False, True])
def test_a_driver_with_a_fine_ripple_over_its_command_is_no_chance(closed_loop):
    """Logged is d, applied d + 0.008 sin(2 pi d / 0.06): seventeen waves up to full duty."""
    logged = np.linspace(-1.1, 1.1, 20001)
    applied = logged + 0.008 * np.sin(2.0 * np.pi * logged / 0.06)

    def rippling(log):
        names = [f"wheel/{wheel}/duty" for wheel in range(1, 5)]
        duties = {name: np.interp(log.columns[name], applied, logged) for name in names}
        return replace(log, columns=log.columns | duties)

    found = [one for one in shares_of(bend=rippling, closed_loop=closed_loop) if one.ahead_s == 0.0]
    for wheel in range(1, 5):
        [share] = [
            one.share
            for one in found
            if one.by_own_command and one.equation == f"wheel/{wheel}/torque"
        ]
        assert share > 2.0 * PREDICTED_SHARE


def test_what_lasts_is_no_chance_whatever_it_goes_with():
    """Bumps of a floor on which no place is met twice."""
    bumps = {"name": "bump_map", "parameters": {"force_n": 12.0, "width_m": 0.14}}
    found = [one for one in shares_of((bumps,)) if one.from_own_past]
    assert found[0].equation.startswith("body/")
    for ahead_s, *_ in OWN_PASTS_S[:2]:
        share = max(one.share for one in found if one.ahead_s == ahead_s)
        assert share > 1.5 * LASTING_SHARES[ahead_s]
    assert found[0].runs_helped > found[0].runs / 2


ELECTRIC = ("gyro", "pose", "supply", "current")


def shares_of_sensors(effects=(), bend=None, **changed):
    """Shares of the sensors' innovations; `bend` changes the logs."""
    case = TruthCase(
        3,
        effects=effects,
        runs=5,
        run_duration_s=4.0,
        base_offset_sd=0.0,
        sensors=ELECTRIC,
        **changed,
    )
    logs = [bend(log) if bend else log for log in logs_of(case)]
    machine = Machine(read_model(NOMINAL_ROBOT), electric=True)
    found = shares_in(machine, [make_run(machine, log) for log in logs])
    return {one.equation: one for one in found if one.equation not in EQUATIONS}


def test_innovations_of_sensors_tell_nothing_of_themselves():
    found = shares_of_sensors()
    assert set(found) == {*ROBOT_CHANNELS, *ELECTRIC_CHANNELS}
    assert max(one.share for one in found.values()) < SENSOR_SHARE / 2


def test_a_clock_that_drifts_and_skips_is_no_news_of_a_sensor():
    """By 0.3 ms in 77 rows, in whole tenths: encoders would tell 12 % of themselves."""

    def drifting(log):
        off_s = 3e-4 * (np.arange(len(log.t_s)) * 0.013 % 1.0)
        return replace(log, t_s=np.round(log.t_s + off_s, 4))

    found = shares_of_sensors(bend=drifting, excitation="ordinary")
    assert max(one.share for one in found.values()) < SENSOR_SHARE / 2


def test_a_supply_that_sways_on_its_own_is_no_noise_of_its_sensor():
    """By 4 % at 2.3 Hz: the robot is driven by what was measured, and lacks nothing."""
    ripple = {"name": "supply_ripple", "parameters": {"amplitude": 0.04, "frequency_hz": 2.3}}
    found = shares_of_sensors((ripple,))["supply/voltage_v"]
    assert found.share > SENSOR_SHARE
    assert found.runs_helped > found.runs / 2


@pytest.mark.parametrize("own_ripple_a", [0.0, 0.3])
def test_where_in_its_row_a_command_that_moves_is_is_no_news_of_a_current(own_ripple_a):
    """As of one read a row early in a loop that swings at 2.5 Hz; a ripple of its own is news."""
    t_s = np.arange(4000) * 0.005
    rng = np.random.default_rng(5)
    command = 0.2 * np.sin(2.0 * np.pi * 2.5 * t_s) + 0.002 * rng.standard_normal(len(t_s))
    innovation = 0.07 * rng.standard_normal(len(t_s)) - 8.0 * np.gradient(command)
    innovation += own_ripple_a * np.sin(2.0 * np.pi * 7.0 * t_s)
    owner, ahead_s = np.arange(len(t_s)) // 1000, OWN_PASTS_S[0]

    def share_of(read_a):
        past = np.stack([np.interp(t_s - past_s, t_s, read_a) for past_s in ahead_s], axis=1)
        line = predictable._by_line
        return predictable._share("current", read_a, owner, past, line, ahead_s[0], 0.0).share

    freed = predictable._without_moves(innovation, command, np.arange(len(t_s)))
    assert share_of(innovation) > CURRENT_SHARE
    assert (share_of(freed) > CURRENT_SHARE) == (own_ripple_a > 0)
    assert own_ripple_a or abs(share_of(freed)) < SENSOR_SHARE


@pytest.mark.parametrize(
    ("equation", "share", "helped", "chance"),
    [
        ("supply/voltage_v", 0.06, 3, False),
        ("supply/voltage_v", 0.04, 3, True),
        ("supply/voltage_v", 0.06, 2, True),
        ("wheel/2/current_a", 0.12, 3, True),  # of an instant, whose command no log has
        ("wheel/2/current_a", 0.2, 3, False),
        ("body/force_x", 0.06, 3, True),  # a disturbance lasts, an innovation does not
    ],
)
def test_a_sensor_has_a_threshold_of_its_own(equation, share, helped, chance):
    assert no_chance(Predictable(equation, True, OWN_PASTS_S[0][0], share, helped, 4)) != chance


def test_a_slow_camera_that_sways_is_asked_by_its_readings():
    """At 10 Hz: what is read between two poses must not hold the later one."""

    def slow(log, sway_m=0.0):
        rows = np.flatnonzero(~np.isnan(log.columns["pose/x_m"]))
        left = np.delete(np.arange(len(log.t_s)), rows[::5])
        columns = {name: log.columns[name].copy() for name in POSE_COLUMNS}
        columns["pose/x_m"] += sway_m * np.sin(2.0 * np.pi * 0.7 * log.t_s)
        for column in columns.values():
            column[left] = np.nan
        return replace(log, columns=log.columns | columns)

    assert shares_of_sensors(bend=slow)["pose/x_m"].share < SENSOR_SHARE / 2
    swaying = partial(slow, sway_m=0.01)
    assert shares_of_sensors(bend=swaying)["pose/x_m"].share > SENSOR_SHARE


def test_where_in_its_play_a_gear_is_is_no_news_of_a_camera():
    """At either end of 0.1 rad: 2.5 mm of each rim, by J+ of wheels at 30 degrees."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    values = machine.believed.copy()
    assert not any(predictable._within_play(machine, values).values())
    values[list(machine.place("gear_backlash", "angle_rad", None))] = 0.1
    found = predictable._within_play(machine, values)
    body = (1.0 + 1.0 / 3.0) / 2.0
    assert list(found) == POSE_COLUMNS
    shares = np.array([body, body, 1.0 / (4 * 0.2**2)])
    np.testing.assert_allclose(list(found.values()), 2.5e-3**2 * shares)


def test_what_a_sensor_tells_of_itself_counts_beyond_what_is_no_news():
    lasting = lfilter([1.0], [1.0, -0.9], np.random.default_rng(0).standard_normal(4000))
    owner, target, past = np.repeat(np.arange(4), 1000)[1:], lasting[1:], lasting[:-1, None]
    shares = [
        predictable._share("pose/x_m", target, owner, past, predictable._by_line, 0.06, 0.0, own)
        for own in (0.0, 0.5 * float(np.mean(target**2)))
    ]
    assert shares[0].share - shares[1].share == pytest.approx(0.5)


@pytest.mark.parametrize("runs", [1, 2])
def test_too_few_parts_to_learn_from_others(runs):
    assert shares_of(runs=runs) == []


@pytest.mark.parametrize("logs", [1, 3])
def test_parts_of_few_logs_learn_from_each_other(logs):
    """As three logs or fewer are split: a force that acts is predicted, chance is not."""
    force = {"name": "lateral_speed_force", "parameters": {"coefficient_n_s2_m2": 8.0}}
    machine = Machine(read_model(NOMINAL_ROBOT))
    found = []
    for effects in ((), (force,)):
        case = TruthCase(
            3, effects=effects, runs=logs, run_duration_s=24.0 / logs, base_offset_sd=0.0
        )
        parts = split_runs(machine, logs_of(case)).fitting
        own = [one for one in shares_in(machine, parts) if one.equation in EQUATIONS]
        found.append([one for one in own if not one.from_own_past])
    chance, acts = (max(own, key=lambda one: one.share) for own in found)
    assert chance.share < 0.05
    assert no_chance(acts)
