"""What commands do within rows: rises that the means tell, none that they do not; jumps are in
test_recordings.py."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap import answers
from omnislip.gap import truth as truth_module
from omnislip.gap.answers import likelier_held, likelier_with_rows
from omnislip.gap.first_models import SURELY_MISTAKEN
from omnislip.gap.machine import Machine
from omnislip.gap.noise import first_guess, track_all, tune_noise
from omnislip.gap.truth import TruthCase
from omnislip.gap.within_rows import rises
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import runs_of

NO_JUMP = np.zeros(0, np.intp)
LENGTHS = st.lists(st.floats(0.003, 0.012), min_size=11, max_size=11).map(np.array)


def times(length_s):
    return np.concatenate([[0.0], np.cumsum(length_s)])


def means(way, t_s):
    """Row means (rows, 1) of a command whose integral is `way`; the last row is as long."""
    ends_s = np.append(t_s, 2.0 * t_s[-1] - t_s[-2])
    return (np.diff(way(ends_s)) / np.diff(ends_s))[:, None]


@given(LENGTHS, st.floats(-0.3, 0.3), st.floats(-2.0, 2.0))
def test_a_straight_command_rises_by_its_rate_times_the_row(length_s, offset, rate):
    t_s = times(length_s)
    command = means(lambda t: offset * t + rate * t**2 / 2, t_s)
    found = rises(t_s, command, NO_JUMP)
    np.testing.assert_allclose(found[2:-3, 0], rate * length_s[2:-2], atol=1e-9)
    assert found[-1, 0] == 0.0


@given(LENGTHS)
def test_a_cubic_that_does_not_turn_is_met_exactly_away_from_the_ends(length_s):
    t_s = times(length_s)
    command = means(lambda t: t**2 / 2 + 60.0 * t**4 / 4, t_s)
    at = t_s + 60.0 * t_s**3
    np.testing.assert_allclose(
        rises(t_s, command, NO_JUMP)[2:-3, 0], np.diff(at)[2:-2], atol=1e-9, rtol=1e-6
    )


@given(
    LENGTHS,
    st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12).map(lambda x: np.array(x)[:, None]),
)
def test_a_row_rises_towards_the_next_within_the_means_beside_it_and_full_duty(length_s, command):
    found = rises(times(length_s), command, NO_JUMP)
    beside = np.vstack([command[:1], command, command[-1:]])
    way = beside[2:] - beside[:-2]
    assert np.all(np.abs(found) <= np.abs(way) + 1e-12)
    assert np.all(found * way >= 0.0)
    assert np.all(np.abs(command) + 0.5 * np.abs(found) <= 1.0 + 1e-12)


def test_commands_that_are_held_do_not_rise():
    """Steady, in steps with the rows, and to and fro from row to row."""
    steps = np.repeat([0.3, -0.4, 0.9, 0.9, 0.0], 3)
    command = np.column_stack([np.ones(15), steps, np.arange(15) % 2])
    assert not rises(0.005 * np.arange(15), command, NO_JUMP).any()


def test_nothing_rises_over_a_jump_within_a_row():
    """A slow ramp goes on as before on both sides of it, as if the log began there."""
    t_s = 0.005 * np.arange(16)
    ramp = means(lambda t: t**2 / 2, t_s)
    command = ramp + 0.6 * (np.arange(16) >= 8)[:, None]
    found = rises(t_s, command, np.array([8]))
    np.testing.assert_allclose(found[2:6, 0], 0.005, atol=1e-12)
    np.testing.assert_allclose(found[10:13, 0], 0.005, atol=1e-12)
    assert np.abs(found).max() < 0.006


def test_a_wave_is_ten_times_nearer_than_if_it_were_held():
    """8 Hz at rows of 5 ms."""
    t_s = 0.005 * np.arange(201)
    turn = 2.0 * np.pi * 8.0
    command = means(lambda t: -np.cos(turn * t) / turn, t_s)
    passed = np.linspace(-0.5, 0.5, 21)
    exact = np.sin(turn * (t_s[:-1, None] + 0.005 * (passed + 0.5)))
    within = command[:-1] + rises(t_s, command, NO_JUMP)[:-1] * passed
    held = np.sqrt(np.mean((exact - command[:-1]) ** 2))
    assert np.sqrt(np.mean((exact - within)[3:-3] ** 2)) < 0.1 * held


# ---- whether they move at all ----

ROBOT = Machine(read_model(NOMINAL_ROBOT))
HOLDING = ROBOT.of(ROBOT.model, holds_commands=True)


def asked_of(machine, **case):
    truth = TruthCase(seed=8, runs=3, run_duration_s=4.0, base_offset_sd=0.0, disorder=0.0, **case)
    runs = runs_of(machine, truth)
    noise = tune_noise(machine, runs, machine.believed)
    return likelier_held(machine, runs, machine.believed, noise)


def asked(**case):
    return asked_of(ROBOT, **case) > 0.0


def test_one_run_in_which_wheels_break_loose_a_moment_later_does_not_tell(monkeypatch):
    """By its likelihoods alone: -60, -50, -10, 1400 and -130 if commands were held."""
    moved, held = [0.0] * 5, [-60.0, -50.0, -10.0, 1400.0, -130.0]
    asked = iter([moved, held])
    monkeypatch.setattr(
        answers,
        "track_all",
        lambda *_, **__: [SimpleNamespace(log_likelihood=value) for value in next(asked)],
    )
    monkeypatch.setattr(answers, "news_of", lambda *_: SimpleNamespace(share=0.0))
    unseen = np.full((1, 13), np.nan)
    runs = [SimpleNamespace(held_in_rows=lambda: None, outputs=unseen) for _ in moved]
    assert likelier_held(ROBOT, runs, ROBOT.believed, None) == -60.0 - 50.0 - 10.0 + 120.0 - 120.0


@pytest.mark.parametrize("excitation", ["rich", "ordinary"])
def test_the_motion_tells_whether_a_programme_moves_within_rows(excitation, monkeypatch):
    """The same programme, as it is and held for 5 ms, the rows of the log."""
    assert not asked(excitation=excitation)
    smooth = truth_module.feed_forward_duty

    def held(*given):
        duty = smooth(*given)
        return np.repeat(duty[::5], 5, axis=0)[: len(duty)]

    monkeypatch.setattr(truth_module, "feed_forward_duty", held)
    assert asked(excitation=excitation)


@pytest.mark.parametrize("with_rows", [False, True])
@pytest.mark.parametrize("seed", [8, 9])
def test_the_motion_tells_whether_held_commands_jump_where_rows_begin(seed, with_rows, monkeypatch):
    """Steps of a programme every 0.2 s, and the means of its rows held: the log is the same."""
    smooth = truth_module.feed_forward_duty
    rng = np.random.default_rng(seed)

    def steps(*given):
        ticks = len(smooth(*given))
        begins = np.arange(200, ticks, 200)
        begins += rng.integers(0, 5, len(begins))
        levels = rng.uniform(-0.5, 0.5, (len(begins) + 1, 4))
        duty = levels[np.searchsorted(begins, np.arange(ticks), side="right")]
        if with_rows:
            whole = ticks // 5 * 5
            duty[:whole] = np.repeat(duty[:whole].reshape(-1, 5, 4).mean(axis=1), 5, axis=0)
        return duty

    monkeypatch.setattr(truth_module, "feed_forward_duty", steps)
    case = TruthCase(seed=seed, runs=2, run_duration_s=4.0, base_offset_sd=0.0, disorder=0.0)
    runs = runs_of(HOLDING, case)
    assert all(run.jumped.size > 5 for run in runs)
    noise = tune_noise(HOLDING, runs, HOLDING.believed)
    likelier = likelier_with_rows(HOLDING, runs, HOLDING.believed, noise)
    assert (likelier if with_rows else -likelier) > SURELY_MISTAKEN


def test_where_nothing_jumps_the_motion_tells_nothing_of_it():
    runs = runs_of(HOLDING, TruthCase(seed=8, runs=1, run_duration_s=2.0))
    noise = first_guess(HOLDING, runs)
    assert not runs[0].jumped.size
    assert likelier_with_rows(HOLDING, runs, HOLDING.believed, noise) == 0.0


def test_a_controller_faster_than_the_rows_moves_commands_within_them():
    assert not asked(closed_loop=True)


def test_currents_show_that_a_command_moves_though_it_seems_to_be_set_row_by_row(monkeypatch):
    """A loop at 1 kHz beside disturbances that last answers those of the row before, too."""
    share = 2.0 * answers.ROW_BY_ROW
    monkeypatch.setattr(answers, "news_of", lambda *_: SimpleNamespace(share=share))
    assert asked(closed_loop=True)
    machine = Machine(ROBOT.model, electric=True)
    sensors = ("gyro", "pose", "supply", "current")
    assert asked_of(machine, closed_loop=True, sensors=sensors) < -SURELY_MISTAKEN


def test_a_robot_that_holds_its_commands_is_taken_so():
    [run] = runs_of(HOLDING, TruthCase(seed=8, runs=1, run_duration_s=2.0))
    assert run.held
    assert not run.rise.any()


def test_a_run_taken_as_held_is_that_of_a_robot_that_holds():
    case = TruthCase(seed=8, runs=1, run_duration_s=2.0)
    [moving], [held] = runs_of(ROBOT, case), runs_of(HOLDING, case)
    assert moving.rise.any()
    noise = first_guess(ROBOT, [held])
    tracks = track_all(ROBOT, [held], ROBOT.believed, noise)
    found = [
        ROBOT.engine.innovations([run.recording], tracks, ROBOT.believed[None])[0][0]
        for run in (held, moving.held_in_rows(), moving)
    ]
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[2] - found[0]).max() > 0.01
