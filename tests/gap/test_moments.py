"""Moments in which shafts do what no command tells; chance and commands that jump make none."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap.events import Jumps
from omnislip.gap.machine import (
    Machine,
    count_rad,
    no_load_speed_rad_s,
    stall_acceleration_rad_s2,
)
from omnislip.gap.moments import (
    HORIZON_S,
    LEAST_LOGS,
    LEAST_MOMENTS,
    LEAST_RATIO,
    Moment,
    _feigned_rad_s,
    _met_rad_s,
    _own_jump_rad_s,
    find_moments,
)
from omnislip.gap.noise import SHAFT, STAMP_S, first_guess, run_free, track_all
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.words import moment_words
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, simulate_truth
from truth_bench import logs_of

MACHINE = Machine(read_model(NOMINAL_ROBOT))


def moments_in(logs):
    """Moments beside the believed model, its keys and the noise fitted."""
    runs = [make_run(MACHINE, log) for log in logs]
    data, fitted = settle(MACHINE, runs, believed_hypothesis(MACHINE))
    values = fitted.hypothesis.flat(MACHINE.believed)
    tracks = track_all(MACHINE, runs, values, data.noise, True)
    return find_moments(MACHINE, runs, tracks, values, data.noise)


def truth_case(effects=(), **changed):
    return TruthCase(
        9,
        effects=effects,
        runs=4,
        run_duration_s=4.0,
        base_offset_sd=0.0,
        sensors=("gyro", "pose"),
        **changed,
    )


@pytest.mark.parametrize("excitation", ["ordinary", "rich"])
def test_where_nothing_is_missing_there_are_none(excitation):
    """Also where duties jump, which a logged mean does not time to better than its row."""
    assert moments_in(logs_of(truth_case(excitation=excitation))) == []


def test_a_driver_that_cuts_out_for_a_moment_is_found_with_its_wheel_and_times():
    outages = {"duration_s": 0.02, "period_s": 0.7}
    effect = {"name": "driver_outage", "parameters": outages, "wheel": 3}
    found = moments_in(logs_of(truth_case((effect,))))
    assert len(found) >= LEAST_MOMENTS
    assert len({one.run for one in found}) >= LEAST_LOGS
    squares = np.mean([one.jump_rad_s**2 for one in found], axis=0)
    assert squares[2] > 0.8 * squares.sum()
    for name in {one.run for one in found}:
        times_s = np.array([one.time_s for one in found if one.run == name])
        off_s = (times_s - times_s[0] + 0.35) % 0.7 - 0.35
        assert np.abs(off_s).max() < 0.03


def test_moments_of_one_log_may_be_anything():
    """One that somebody nudged, say."""
    outages = {"duration_s": 0.02, "period_s": 0.7}
    effect = {"name": "driver_outage", "parameters": outages, "wheel": 3}
    struck, *_ = logs_of(truth_case((effect,)))
    _, *calm = logs_of(truth_case())
    assert moments_in([replace(struck, name="run_0"), *calm]) == []


def stamped(log, kind):
    """The log with stamps that are off by some tenths of a millisecond, but for its first."""
    rng, rows = np.random.default_rng(1), len(log.t_s)
    off_s = {
        "a clock that drifts and skips": 3e-4 * (np.arange(rows) * 0.013 % 1.0),
        "a clock that skips": np.repeat(rng.normal(0.0, 1e-4, rows // 40 + 1), 40)[:rows],
        "rows that are read late": (rng.random(rows) < 0.02) * rng.exponential(6e-4, rows),
    }[kind]
    return replace(log, t_s=np.maximum.accumulate(log.t_s + off_s - off_s[0]))


@pytest.mark.parametrize(
    "kind", ["a clock that drifts and skips", "a clock that skips", "rows that are read late"]
)
def test_stamps_that_are_off_are_no_moments(kind):
    """Each makes every sensor jump as far as it goes in that time: five times and more."""
    case = truth_case()
    assert moments_in([stamped(log, kind) for log in logs_of(case)]) == []


def test_a_command_that_bends_within_a_row_feigns_what_half_of_the_row_gives():
    """A ramp of all duties that ends in row 30 by a jump of 0.06; soft gears ring for 50 ms."""
    rows = np.arange(60)
    command = np.tile(np.where(rows < 30, 0.02 * rows, 0.58 - 0.06)[:, None], (1, 4))
    outputs = np.full((60, 13), np.nan)
    run = SimpleNamespace(command=command, row_s=0.005, outputs=outputs)
    feigned_rad_s = _feigned_rad_s(MACHINE, run)
    bent = np.flatnonzero(feigned_rad_s > 1e-9)
    np.testing.assert_array_equal(bent, np.arange(27, 41))
    most = 0.08 * stall_acceleration_rad_s2(MACHINE) * 0.005 / 2.0
    assert feigned_rad_s.max() == pytest.approx(most)
    outputs[:, 9:] = 0.0  # currents of an instant
    more = 0.08 * 2.0 * no_load_speed_rad_s(MACHINE)
    assert _feigned_rad_s(MACHINE, run).max() == pytest.approx(most + more)


DROPOUT = {"fraction": 0.12, "speed_rad_s": 150.0}


def driven_run(effect):
    """A straight drive whose duties of all wheels fall below what the wheels' speed asks for."""
    model = replace(read_model(NOMINAL_ROBOT), effects=[effect])
    driving = [
        {"t_s": t_s, "kind": "velocity", "value": [speed_m_s, 0.0, 0.0]}
        for t_s, speed_m_s in ((0.0, 1.5), (1.0, 0.1))
    ]
    scenario = Scenario("run", 2.0, model, driving, sensors=Sensors(pose_noise_m=0.001), seed=1)
    machine = Machine(model)
    return machine, make_run(machine, make_log(scenario, simulate_truth(scenario)))


def test_what_the_model_does_of_a_sudden_is_known_beside_each_row():
    """Where a driver begins to coast the motor brakes no more; what was measured does not tell."""
    (machine, run), (braking, _) = (
        driven_run(Effect("driver_freewheel", {"braking_fraction": share})) for share in (0.0, 1.0)
    )
    data, fitted = settle(machine, [run], believed_hypothesis(machine))
    values = fitted.hypothesis.flat(machine.believed)
    [track] = track_all(machine, [run], values, data.noise, True)
    filtered = track.state.reshape(len(run.t_s), -1)

    def own(which, row, states):
        return _own_jump_rad_s(which, run, row, states, which.believed, data.noise)

    rows = range(205, 260)
    coasts = np.array([own(machine, row, filtered) for row in rows])
    brakes = np.array([own(braking, row, filtered) for row in rows])
    assert coasts.max() > 5.0
    assert coasts.max() > 2.0 * brakes.max()
    struck = filtered.copy()
    struck[230:, 0] += 30.0
    np.testing.assert_array_equal(own(machine, 230, struck), own(machine, 230, filtered))


def test_where_an_encoder_begins_to_lose_counts_is_known_beside_each_row():
    """What it shows falls by the share of the speed that it loses, beside what a shaft does."""
    machine, run = driven_run(Effect("encoder_dropout", DROPOUT, wheel=2))
    data, fitted = settle(machine, [run], believed_hypothesis(machine))
    values = fitted.hypothesis.flat(machine.believed)
    [track] = track_all(machine, [run], values, data.noise, True)
    filtered = track.state.reshape(len(run.t_s), -1)
    begins = 1 + int(np.argmax(np.abs(filtered[:, SHAFT][:, 1]) > DROPOUT["speed_rad_s"]))

    def own(which, row, values):
        return _own_jump_rad_s(which, run, row, filtered, values, data.noise)

    lost_rad_s = DROPOUT["fraction"] * DROPOUT["speed_rad_s"]
    shows, turns = own(machine, begins, values), own(MACHINE, begins, MACHINE.believed)
    assert 0.5 * lost_rad_s < shows[1] < lost_rad_s + turns[1]
    assert max(shows[0], own(machine, 150, values).max()) < 0.1 * lost_rad_s


def test_teeth_that_cross_their_play_stop_a_shaft_by_no_more_than_its_motor_gained():
    """A duty that reverses: the plant's shafts fall back where their teeth meet."""
    machine, run = driven_run(Effect("gear_backlash", {"angle_rad": 0.03}))
    t_s = 2e-4 * np.arange(2000)
    command = np.where(t_s < 0.2, -0.1, 0.5)[:, None] * np.array([1.0, -1.0, 1.0, -1.0])
    start = np.zeros(machine.engine.states)
    noise = first_guess(machine, [run])
    free = run_free(machine, t_s, command, start, machine.believed, noise, 1e-4)
    ahead = np.sign(command[-1]) * free[1000:, SHAFT]
    fell_rad_s = np.max(np.maximum.accumulate(ahead, axis=0) - ahead, axis=0)
    play = SimpleNamespace(command=command, row_s=2e-4)
    met_rad_s = _met_rad_s(machine, play, free, machine.believed)[1000]
    assert np.all((fell_rad_s < met_rad_s) & (fell_rad_s > 0.1 * met_rad_s))
    assert not _met_rad_s(MACHINE, play, free, MACHINE.believed).any()


def test_a_cut_out_shows_beside_stamps_that_are_off():
    outages = {"duration_s": 0.02, "period_s": 0.7}
    effect = {"name": "driver_outage", "parameters": outages, "wheel": 3}
    logs = [stamped(log, "a clock that skips") for log in logs_of(truth_case((effect,)))]
    found = moments_in(logs)
    assert len(found) >= LEAST_MOMENTS
    squares = np.mean([one.jump_rad_s**2 for one in found], axis=0)
    assert squares[2] > 0.8 * squares.sum()


def test_counts_that_are_rounded_the_other_way_are_no_jump():
    """Three shafts that rest show a count of 64 a turn more or less from one row on.

    By the sensors' own noise that is a jump of speeds beyond chance, beside rounding it is none.
    One that spins up instead, by two counts a row, is.
    """
    values = MACHINE.model.values | {"encoder.counts_per_rev": 64.0}
    coarse = Machine(replace(MACHINE.model, values=values))
    [log, *_] = logs_of(truth_case())
    still = {name: np.zeros(len(log.t_s)) for name in log.columns}
    noise = first_guess(coarse, [make_run(coarse, replace(log, columns=still))])
    row, since = 300, np.arange(len(log.t_s)) - 300

    def ratios(*shown):
        counts = {f"wheel/{i}/encoder_counts": own for i, own in enumerate(shown, start=1)}
        run = make_run(coarse, replace(log, columns=still | counts))
        [track] = track_all(coarse, [run], coarse.believed, noise, keep_linear=True)
        jumps = Jumps(coarse, run, track, SHAFT, HORIZON_S, outputs=slice(None))
        rate = np.gradient(track.state.reshape(len(run.t_s), -1), run.t_s, axis=0)
        roundings_rad = (1e-6, count_rad(coarse) / np.sqrt(6.0))
        return [jumps.ratio_beside_misreadings(row, rate, STAMP_S, one) for one in roundings_rad]

    count = np.where(since >= 0, 1.0, 0.0)
    exact, beside = ratios(count, -count, count)
    assert exact > LEAST_RATIO > 2.0 * beside
    assert ratios(2.0 * np.maximum(since + 1, 0))[1] > LEAST_RATIO


def test_words_tell_how_often_which_wheel_and_when_most():
    jumps = [np.array([0.5, 0.0, size, -0.4]) for size in (19.0, -21.0, 20.0, 18.0)]
    moments = [Moment("log_1", 1.0 + k, 50.0 + k, jump) for k, jump in enumerate(jumps)]
    words = moment_words(moments)
    assert words.startswith("4 times wheel 3 suddenly turned slower or faster, by some 20 rad/s")
    assert words.endswith("(log_1 at 4.000 s, log_1 at 3.000 s, log_1 at 2.000 s)")
    assert "several wheels" in moment_words(
        [*moments, Moment("log_2", 1.0, 40.0, 40.0 * np.eye(4)[0])]
    )
