"""The replay engine against an independent model, against itself, and against wrong input."""

import numpy as np
import pytest
import slip_model_reference as reference
from engine_run import parameter_set, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip import _core

DUTY = st.lists(st.lists(st.floats(-0.9, 0.9), min_size=4, max_size=4), min_size=2, max_size=5).map(
    np.array
)
ANGLE = st.floats(-3.0, 3.0)


def random_duty(rows, seed):
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (rows, 4))


# ---- independent model ----

CASES = {
    "nominal": ((), {}),
    "cog_offset": (
        [("cog_offset", "x_m", 0.03), ("cog_offset", "y_m", -0.02)],
        {"cog": np.array([0.03, -0.02])},
    ),
    "load_transfer": (
        [("load_transfer", "cog_height_m", 0.12), ("cog_offset", "x_m", 0.03)],
        {"cog_height": 0.12, "cog": np.array([0.03, 0.0])},
    ),
    "supply_sag and coulomb_friction": (
        [("supply_sag", "source_resistance_ohm", 0.1), ("coulomb_friction", "torque_nm", 0.005)],
        {"source_resistance": 0.1, "dry": 0.005},
    ),
    "wheels": (
        [
            ("wheel_angle_error", "angle_rad", 0.06, 2),
            ("wheel_radius_error", "scale", 1.04, 3),
            ("wheel_distance_error", "scale", 1.05),
        ],
        {
            "turned": np.array([0.0, 0.06, 0.0, 0.0]),
            "radius": np.array([0.05, 0.05, 0.052, 0.05]),
            "distance": 0.21,
        },
    ),
    "supply_sag and current_limit": (
        [("supply_sag", "source_resistance_ohm", 0.1), ("current_limit", "limit_a", 8.0)],
        {"source_resistance": 0.1, "current_limit": 8.0},
    ),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(
    ("method", "duration_s", "of_mass"), [("DOP853", 3.0, 1e-3), ("Radau", 0.6, 1e-4)]
)
def test_replay_agrees_with_the_independent_model(case, method, duration_s, of_mass):
    """To 1e-6 m, rad and rad/s, explicit and implicit solver, where 1 % of mass makes `of_mass`."""
    effects, fields = CASES[case]
    time = np.arange(0.0, duration_s + 0.01, 0.15)
    duty = random_duty(len(time), seed=7)
    expected = reference.run(reference.SlipModel(**fields), time, duty, method)
    sets = [
        parameter_set(effects=effects),
        parameter_set(base={"robot.mass_kg": 20.2}, effects=effects),
    ]
    found, heavier = simulate(sets, time, duty, step_s=1e-4)
    np.testing.assert_allclose(found[:, 4:], expected[:, 4:], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found[:, :4], expected[:, :4], rtol=0, atol=1e-4)
    assert np.abs(heavier - expected)[:, 5:].max() > of_mass


def test_independent_model_does_not_depend_on_its_solver():
    time = np.array([0.0, 0.1, 0.2, 0.3])
    duty = random_duty(4, seed=3)
    implicit = reference.run(reference.SlipModel(), time, duty, "Radau")
    explicit = reference.run(reference.SlipModel(), time, duty, "DOP853")
    np.testing.assert_allclose(implicit, explicit, rtol=0, atol=2e-8)


def test_error_falls_with_the_fourth_power_of_the_step():
    """Gentle commands: hard ones slip, and only far finer steps show the order."""
    time = np.arange(0.0, 1.01, 0.1)
    duty = random_duty(len(time), seed=5) / 3.0
    nominal = [parameter_set()]
    exact = simulate(nominal, time, duty, step_s=5e-6)
    coarse, fine = (
        np.abs(simulate(nominal, time, duty, step_s=step) - exact).max() for step in (1e-4, 5e-5)
    )
    assert 12.0 < coarse / fine < 20.0


# ---- lanes ----


def test_all_lane_widths_agree():
    time = np.cumsum(np.random.default_rng(1).uniform(0.003, 0.008, 300))
    duty = random_duty(300, seed=2)
    masses = np.linspace(16.0, 24.0, 11)
    sets = [
        parameter_set(base={"robot.mass_kg": mass}, effects=[("cogging", "torque_nm", 0.004)])
        for mass in masses
    ]
    narrow, *wider = (simulate(sets, time, duty, lanes=lanes) for lanes in (2, 4, 8))
    assert np.ptp(narrow[:, -1, 5]) > 1e-3
    for wide in wider:
        np.testing.assert_allclose(wide, narrow, rtol=1e-9, atol=1e-9)


def test_result_does_not_depend_on_the_neighbours_in_the_lanes():
    time = np.arange(0.0, 0.5, 0.005)
    duty = random_duty(100, seed=4)
    alone = simulate([parameter_set()], time, duty, step_s=5e-4)[0]
    other = parameter_set(effects=[("coulomb_friction", "torque_nm", 0.01)])
    beside = simulate([other, parameter_set(), other], time, duty, step_s=5e-4)[1]
    np.testing.assert_allclose(beside, alone, rtol=1e-12, atol=1e-12)


# ---- symmetry ----


def held(duty):
    return np.arange(len(duty)) * 0.1, duty


@settings(max_examples=25)
@given(duty=DUTY, heading=ANGLE, x=st.floats(-5, 5), y=st.floats(-5, 5))
def test_world_has_no_preferred_place_or_direction(duty, heading, x, y):
    time, duty = held(duty)
    start = np.zeros(14)
    start[11:] = x, y, heading
    here = simulate([parameter_set()], time, duty)[0]
    there = simulate([parameter_set()], time, duty, start)[0]
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    np.testing.assert_allclose(there[:, :5], here[:, :5], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(there[:, 5:7], here[:, 5:7] @ turn.T + [x, y], rtol=0, atol=1e-9)
    np.testing.assert_allclose(there[:, 7], here[:, 7] + heading, rtol=0, atol=1e-9)


# Index of the wheel that takes each wheel's place, sign of duties and shafts, signs of (turn rate,
# x, y, heading).
SYMMETRIES = {
    "half turn": ([2, 3, 0, 1], 1.0, [1, -1, -1, 1]),
    "left and right exchanged": ([3, 2, 1, 0], -1.0, [-1, 1, -1, -1]),
    "front and rear exchanged": ([1, 0, 3, 2], -1.0, [-1, -1, 1, -1]),
}


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@settings(max_examples=15)
@given(duty=DUTY)
def test_robot_has_the_symmetry_of_its_wheels(symmetry, duty):
    place, sense, signs = SYMMETRIES[symmetry]
    time, duty = held(duty)
    plain = simulate([parameter_set()], time, duty)[0]
    image = simulate([parameter_set()], time, sense * duty[:, place])[0]
    np.testing.assert_allclose(image[:, :4], sense * plain[:, place], rtol=0, atol=1e-8)
    np.testing.assert_allclose(image[:, 4:], plain[:, 4:] * signs, rtol=0, atol=1e-9)


@settings(max_examples=15)
@given(duty=DUTY, scale=st.floats(0.5, 2.0))
def test_equal_scale_of_all_forces_changes_nothing(duty, scale):
    """Masses, loads (through the mass), motor torque per current: same motion if all scale."""
    time, duty = held(duty)
    base = {
        "robot.mass_kg": 20.0 * scale,
        "robot.inertia_kg_m2": 0.55 * scale,
        "motor.inertia_kg_m2": 2.5e-5 * scale,
        "motor.viscous_friction_nm_s": 1.5e-5 * scale,
        "motor.torque_constant_nm_a": 0.0255 * scale,
    }
    plain, scaled = simulate([parameter_set(), parameter_set(base=base)], time, duty)
    np.testing.assert_allclose(scaled, plain, rtol=1e-9, atol=1e-9)


TURNING = {
    "cogging": [("cogging", "torque_nm", 0.03), ("cogging", "phase_rad", 0.4)],
    "wheel_eccentricity": [("wheel_eccentricity", "amplitude", 0.05)],
    "roller_ripple": [("roller_ripple", "amplitude", 0.3)],
    "no effect by angle": [],
}


@pytest.mark.parametrize("by_angle", TURNING)
@settings(max_examples=10)
@given(duty=DUTY, begins=st.lists(ANGLE, min_size=4, max_size=4).map(np.array))
def test_what_encoders_show_moves_no_robot(by_angle, duty, begins):
    """Shafts cog and wheels run out of round by their own angles, whatever is counted of them."""
    time, duty = held(duty)
    shown = np.array([1.07, 0.8, 1.0, 1.0])
    counting = [
        ("encoder_scale", "scale", shown[0], 1),
        ("encoder_scale", "scale", shown[1], 2),
        ("encoder_dropout", "fraction", 0.2, 3),
        ("encoder_dropout", "speed_rad_s", 40.0, 3),
    ]
    starts = np.zeros((2, 14))
    starts[:, 4:8] = begins, shown * begins
    effects = TURNING[by_angle]
    [right] = simulate([parameter_set(effects=effects)], time, duty, starts[0])
    [wrong] = simulate([parameter_set(effects=effects + counting)], time, duty, starts[1])
    np.testing.assert_allclose(wrong[:, 4:], right[:, 4:], rtol=0, atol=1e-9)
    kept = [0, 1, 3]
    np.testing.assert_allclose(wrong[:, kept], (shown * right[:, :4])[:, kept], rtol=0, atol=1e-8)


# ---- commands that rise within a row ----


@pytest.mark.parametrize("delay_s", [0.0, 0.013])
def test_a_command_that_rises_is_as_many_small_steps(delay_s):
    """Its mean stays; also where a row's command is still on its way while the next one begins."""
    parts, rows = 50, 12
    time, duty = np.arange(rows) * 0.02, random_duty(rows, seed=9)
    rise = random_duty(rows, seed=10)
    rise[[0, -1]] = 0.0
    passed = (np.arange(parts) + 0.5) / parts - 0.5
    fine_time = np.append((time[:-1, None] + 0.02 * np.arange(parts) / parts).ravel(), time[-1])
    fine_duty = (duty[:-1, None] + rise[:-1, None] * passed[:, None]).reshape(-1, 4)
    values = parameter_set(effects=[("actuation_delay", "delay_s", delay_s)])
    [expected] = simulate([values], fine_time, np.vstack([fine_duty, duty[-1:]]), step_s=1e-3)
    [found] = simulate([values], time, duty, step_s=1e-4, rise=rise)
    [held] = simulate([values], time, duty, step_s=1e-4)
    missed = np.abs(held - expected[::parts]).max(axis=0)
    assert np.all(missed[:8] > 0)
    assert np.all(np.abs(found - expected[::parts]).max(axis=0) < 2e-3 * missed.max())


@pytest.mark.parametrize("jump", [0.0, 0.2])
def test_a_command_that_rises_is_followed_in_short_steps_whatever_is_wanted(jump):
    """Each step holds its mean: two stairs in a row of 5 ms would be 1e-3 rad of a shaft off."""
    rows = 60
    time = np.arange(rows) * 0.005
    duty = np.cumsum(0.03 * np.sign(np.sin(np.arange(rows) / 4.0)))[:, None] * np.ones(4)
    duty[rows // 2 :] += jump
    rise = np.gradient(duty, axis=0)
    rise[[0, -1]] = 0.0
    slow = parameter_set(base={"contact.slip_stiffness_s_m": 12.0})
    [exact] = simulate([slow], time, duty, step_s=1e-4, rise=rise)
    [coarse] = simulate([slow], time, duty, step_s=5e-3, rise=rise)
    [stairs] = simulate([slow], time, duty, step_s=5e-3)
    off, missed = (np.abs(one - exact)[:, 4:8].max() for one in (coarse, stairs))
    assert off < 1e-3 < missed


def test_a_rise_of_another_shape_or_beyond_the_log_is_refused():
    engine = _core.Engine("robot")
    run = engine.recording(np.arange(5.0), np.zeros((5, 4)), np.zeros((5, 8)), np.zeros(14))
    run.rising(np.zeros((5, 4)))
    for wrong in (np.zeros((4, 4)), np.zeros((5, 3)), np.ones((5, 4))):
        with pytest.raises(ValueError):
            run.rising(wrong)


def test_sets_that_are_hardly_faster_take_the_same_steps():
    """A short secant across a change of steps would show that change instead of a derivative."""
    engine = _core.Engine("robot")
    viscous = [1e-5 * (1.0 + share) for share in (0.0, 1e-3, 2e-3)]
    base = {"motor.viscous_friction_nm_s": viscous[0]}
    slowest_1_s = engine.fastest_rate_1_s(parameter_set(base=base))
    row_s = 6 * 1.4 / slowest_1_s  # six steps for the first, seven for what is faster
    sets = np.array([parameter_set(base={"motor.viscous_friction_nm_s": v}) for v in viscous])
    assert slowest_1_s < engine.fastest_rate_1_s(sets[1])
    rows = 20
    time, duty = np.arange(rows) * row_s, 0.02 * random_duty(rows, seed=3)  # none of it jumps
    shown, start = np.zeros((rows, engine.outputs)), np.zeros(engine.states)
    recording = engine.recording(time, duty, shown, start)
    ones = np.ones(engine.states)
    tracks = engine.track([recording], sets[0], ones, np.ones(engine.outputs), ones)

    def bend(**steps):
        alone = [one[None] for one in sets]  # those in one call share their steps
        found = [engine.innovations([recording], tracks, one, step_s=1.0, **steps) for one in alone]
        by_one, by_two = found[1][0] - found[0][0], found[2][0] - found[0][0]
        return np.abs(by_two - 2.0 * by_one).max() / np.abs(by_two).max()

    assert bend(least_rate_1_s=1.02 * slowest_1_s) < 1e-3
    assert bend() > 0.1


def test_innovations_go_where_they_are_wanted():
    """Of two logs behind each other, from some row on, sets in another order; all else stays."""
    engine = _core.Engine("robot")
    rows, shown = 12, engine.outputs
    sets = np.array([parameter_set(base={"robot.mass_kg": mass}) for mass in (18.0, 19.0, 20.0)])
    recordings = [
        engine.recording(
            0.005 * np.arange(rows),
            random_duty(rows, seed=seed),
            np.zeros((rows, shown)),
            np.zeros(engine.states),
        )
        for seed in (1, 2)
    ]
    ones = np.ones(engine.states)
    tracks = engine.track(recordings, sets[0], ones, np.ones(shown), ones)
    alone = engine.innovations(recordings, tracks, sets)
    begin, first_row, place = [0, (rows - 3) * shown], [3, 0], [4, 0, 2]
    columns = (2 * rows - 3) * shown
    found = np.full((5, columns + 1), np.nan)
    engine.innovations_into(recordings, tracks, sets, found, begin, first_row, place)
    expected = np.full_like(found, np.nan)
    for k, row in enumerate(place):
        expected[row, :-1] = np.concatenate([alone[0][k, 3:].ravel(), alone[1][k].ravel()])
    np.testing.assert_array_equal(found, expected)
    for wrong in (
        (np.empty((5, columns - 1)), begin, first_row, place),
        (np.empty((4, columns)), begin, first_row, place),
        (np.empty((5, columns)), begin, [-1, 0], place),
        (np.empty((5, columns)), begin, [rows + 1, 0], place),
        (np.empty((5, columns)), begin, first_row, place[:2]),
    ):
        with pytest.raises(ValueError):
            engine.innovations_into(recordings, tracks, sets, *wrong)


@pytest.mark.parametrize("settle_s", [0.25, 0.6])
def test_replays_begin_when_the_filter_has_settled(settle_s):
    """A robot that stands is believed to go at 1 m/s at first; so says the replay till then."""
    engine = _core.Engine("robot")
    time, start = np.arange(100) * 0.01, np.zeros(engine.states)
    start[8] = 1.0
    still = np.zeros((len(time), 4)), np.zeros((len(time), engine.outputs))
    run = engine.recording(time, *still, start, settle_s)
    assert run.settle_s == settle_s
    shown, unsure = np.full(engine.outputs, 1e-8), np.full(engine.states, 1e-2)
    values = parameter_set()
    tracks = engine.track([run], values, np.full(engine.states, 1e-6), shown, unsure)
    [[errors]] = engine.replays([run], tracks, values[None])
    off_m = np.abs(errors[:, 5])
    first = int(np.searchsorted(time, settle_s)) + 1  # of the row itself the error is the old one's
    assert off_m[first - 1] > 0.05
    assert off_m[first:].max() < 0.01


# ---- wrong input ----


def test_wrong_shapes_are_refused():
    engine = _core.Engine("robot")
    time, command, output, start = np.arange(5.0), np.zeros((5, 4)), np.zeros((5, 8)), np.zeros(14)
    for wrong in (
        (time[:4], command, output, start),
        (time, command[:4], output, start),
        (time, command, output[:4], start),
        (time[:1], command[:1], output[:1], start),
        (time, command[:, :3].copy(), output, start),
        (time, command, output[:, :7].copy(), start),
        (time, command, output, start[:6]),
    ):
        with pytest.raises(ValueError):
            engine.recording(*wrong)
    with pytest.raises(ValueError):
        engine.recording(time, command, output, start, -0.1)


def test_wrong_parameter_and_noise_lengths_are_refused():
    engine = _core.Engine("robot")
    run = engine.recording(np.arange(5.0), np.zeros((5, 4)), np.zeros((5, 8)), np.zeros(14))
    right = parameter_set(), np.ones(14), np.ones(8), np.ones(14)
    engine.track([run], *right)
    for place, short in enumerate(right):
        wrong = list(right)
        wrong[place] = short[:-1]
        with pytest.raises(ValueError):
            engine.track([run], *wrong)
    with pytest.raises(ValueError):
        engine.replays([run], engine.track([run], *right), right[0][None, :-1].copy())
    with pytest.raises(ValueError):
        engine.replays([run], [], right[0][None])


def test_track_of_another_recording_is_refused():
    """A track has one gain per row; a shorter one would be read past its end."""
    engine = _core.Engine("robot")
    short, long = (
        engine.recording(np.arange(n) * 0.01, np.zeros((n, 4)), np.zeros((n, 8)), np.zeros(14))
        for n in (3, 300)
    )
    values = parameter_set()
    tracks = engine.track([short], values, np.ones(14), np.ones(8), np.ones(14))
    with pytest.raises(ValueError):
        engine.replays([long], tracks, values[None])


def test_times_that_do_not_increase_are_refused():
    engine = _core.Engine("robot")
    for time in ([0.0, 0.1, 0.1], [0.0, 0.2, 0.1], [0.0, np.nan, 0.1]):
        with pytest.raises(ValueError):
            engine.recording(np.array(time), np.zeros((3, 4)), np.zeros((3, 8)), np.zeros(14))


def test_unknown_kind_is_refused():
    with pytest.raises(ValueError):
        _core.Engine("boat")
    with pytest.raises(ValueError):
        _core.base_parameters("boat")
