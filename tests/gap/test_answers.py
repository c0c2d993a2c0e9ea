"""Closed loops: what tells them, which part of a change could be foreseen, and what that mends."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip.gap import answers, inference
from omnislip.gap.answers import Foreseen, News, news_of
from omnislip.gap.inference import Data
from omnislip.gap.machine import Machine
from omnislip.gap.noise import RunawayError, track_all, tune_noise
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect, typical_effect
from omnislip.model_file import NOMINAL_ROBOT, read_model
from scipy.stats import chi2
from truth_bench import LAGS, promises, runs_of

MODEL = read_model(NOMINAL_ROBOT)
CHANCE = chi2.isf(0.001, 1)


def runs_and_noise(**case):
    """Runs of a robot whose keys are exact, and noise tuned for them."""
    machine = Machine(MODEL)
    runs = runs_of(machine, TruthCase(base_offset_sd=0.0, **case))
    return machine, runs, tune_noise(machine, runs, machine.believed)


def data_of(**case):
    machine, runs, noise = runs_and_noise(**case)
    return Data(machine, runs, noise, believed_hypothesis(machine))


def news_in(machine, runs, noise):
    tracks = track_all(machine, runs, machine.believed, noise, keep_linear=True)
    return news_of(machine, runs, tracks)


# ---- which loops are closed ----


@pytest.mark.parametrize("bound", [1e200, np.inf, np.nan])
def test_a_robot_that_would_go_on_without_bounds_is_told(monkeypatch, bound):
    """A filter may hold a wrong model to its log that loses it within the time of an answer."""
    machine, runs, noise = runs_and_noise(seed=5, runs=2, run_duration_s=2.0)
    known = answers.foreseen
    monkeypatch.setattr(answers, "foreseen", lambda run, track: known(run, track) * bound)
    with pytest.raises(RunawayError, match="grows without bounds"):
        news_in(machine, runs, noise)


@pytest.mark.parametrize("excitation", ["rich", "ordinary"])
def test_a_log_driven_in_open_loop_is_known_as_such(excitation):
    """Also where a model 10 % off leaves innovations at every change of the command."""
    machine = Machine(MODEL)
    case = TruthCase(seed=8, excitation=excitation, base_offset_sd=0.05, noise_level=0.3)
    runs = runs_of(machine, case)
    assert not news_in(machine, runs, tune_noise(machine, runs, machine.believed)).answers


@pytest.mark.parametrize("rows_held", [50, 700])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_command_that_is_held_is_no_answer(seed, rows_held):
    """What its own past leaves of it is rounding, whatever innovations explain of that."""
    machine, [run], noise = runs_and_noise(seed=5, runs=1, run_duration_s=4.0)
    levels = np.random.default_rng(seed).uniform(-0.4, 0.4, (len(run.t_s) // rows_held + 1, 4))
    held = replace(run, command=np.repeat(levels, rows_held, axis=0)[: len(run.t_s)])
    assert news_in(machine, [held], noise).share == 0.0


def commands_that_answer(runs, tracks, rows_held):
    """Slow waves and what the last innovations of each wheel say, held for some rows."""
    driven = []
    for run, track in zip(runs, tracks, strict=True):
        told = np.nan_to_num(track.innovation.reshape(len(run.t_s), -1)[:, :4])
        waves = 0.1 * np.sin(2 * np.pi * 0.4 * run.t_s[:, None] + np.arange(4))
        now = np.arange(len(run.t_s)) // rows_held * rows_held
        driven.append(replace(run, command=(waves - 1e-3 * told / told.std())[now]))
    return driven


@pytest.mark.parametrize("rows_held", [1, 2, 5])
def test_a_controller_slower_than_the_log_answers_all_the_same(rows_held):
    machine, runs, noise = runs_and_noise(seed=5, runs=2, run_duration_s=4.0)
    tracks = track_all(machine, runs, machine.believed, noise, keep_linear=True)
    assert news_of(machine, commands_that_answer(runs, tracks, rows_held), tracks).answers


def test_a_programme_is_no_answer_beside_a_wrong_model(monkeypatch):
    """Beside too much grip innovations tell how the robot moves, and that how commands go on."""
    grip = HiddenEffect("low_grip", {"scale": 0.6}).as_dict()
    gravity = HiddenEffect("cog_offset", {"x_m": 0.02, "y_m": 0.02}).as_dict()
    machine = Machine(MODEL)
    case = TruthCase(seed=9, friction_curve="brush", effects=(grip, gravity))
    runs = runs_of(machine, case)
    noise = tune_noise(machine, runs, machine.believed)
    assert not news_in(machine, runs, noise).answers
    monkeypatch.setattr(answers, "_motion", lambda states: np.ones((4 * len(states), 1)))
    monkeypatch.setattr(answers, "_behind_jumps", lambda run, _past: np.isin(run.log_rows, []))
    assert news_in(machine, runs, noise).answers


def test_news_are_what_was_added_to_commands_that_go_on():
    """A sum of waves follows linearly from its past, chance does not; a rare jump is no answer."""
    machine, runs, noise = runs_and_noise(seed=5, runs=2, run_duration_s=4.0)
    tracks = track_all(machine, runs, machine.believed, noise, keep_linear=True)
    rng, driven, added = np.random.default_rng(1), [], []
    for run in runs:
        chance = 1e-3 * rng.standard_normal(run.command.shape)
        waves = sum(np.sin(2 * np.pi * f * run.t_s[:, None] + np.arange(4)) for f in (0.4, 1.1))
        programme = 0.1 * waves
        programme[len(run.t_s) // 2 :] += 0.3
        driven.append(replace(run, command=programme + chance))
        added.append(chance)
    found = answers._new(list(zip(driven, tracks, strict=True)))
    for new, chance in zip(found, added, strict=True):
        new, chance = new[50:].ravel(), chance[50:].ravel()
        assert new @ chance / (chance @ chance) == pytest.approx(1.0, abs=0.1)
        assert np.abs(new).max() < 10e-3


def test_a_piece_too_short_to_foresee_anything_holds_no_news():
    machine, runs, noise = runs_and_noise(seed=5, runs=2, run_duration_s=2.0)
    short = replace(runs[1], **{n: getattr(runs[1], n)[:9] for n in ("t_s", "command", "outputs")})
    short = replace(
        short,
        recording=machine.engine.recording(
            short.t_s, short.command, short.outputs, np.zeros(machine.engine.states)
        ),
    )
    tracks = track_all(machine, [runs[0], short], machine.believed, noise, keep_linear=True)
    first, second = answers._new(list(zip([runs[0], short], tracks, strict=True)))
    assert np.any(first)
    assert second.shape == short.command.shape
    assert not np.any(second)


# ---- what could be foreseen of a change ----


def still(count):
    """Commands that do not rise within rows."""
    return np.zeros((2, count))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_change_that_could_be_foreseen_whole_is_taken_whole(seed):
    rng = np.random.default_rng(seed)
    residual, newsless = rng.standard_normal((2, 60))
    part = Foreseen(residual, newsless, rng.standard_normal((60, 3)), *still(60))
    change = rng.standard_normal((2, 60))
    found = part.residuals(residual + change, newsless + 3.0 * change)
    np.testing.assert_allclose(found, residual + change, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_only_what_goes_with_something_foreseen_is_taken(seed):
    """The change lies in the span of the instruments, its rest is orthogonal to them."""
    rng = np.random.default_rng(seed)
    residual, newsless, own, change = rng.standard_normal((4, 60))
    derivatives = rng.standard_normal((60, 3))
    derivatives[:, 1] = 0.0  # by what nothing depends on
    part = Foreseen(residual, newsless, derivatives, *still(60))
    [found] = part.residuals((residual + change)[None], (newsless + own)[None])
    instruments = np.column_stack([derivatives[:, [0, 2]], own])
    sizes = np.linalg.lstsq(instruments, change, rcond=None)[0]
    np.testing.assert_allclose(found, residual + instruments @ sizes, atol=1e-9)
    [same] = part.residuals(residual[None].copy(), newsless[None].copy())
    np.testing.assert_array_equal(same, residual)


def test_two_stages_find_what_least_squares_do_not():
    """A command that takes the very noise away: the size is 1, least squares say 1.5."""
    rng, count = np.random.default_rng(3), 40_000
    foreseen, noise = rng.standard_normal((2, count))
    column = foreseen - noise  # the answer takes the noise away
    residual = noise - 1.0 * column  # of a model that lacks it
    part = Foreseen(residual, np.zeros(count), np.zeros((count, 0)), *still(count))
    [taken] = part.residuals((residual + column)[None], foreseen[None].copy())
    stage = taken - residual
    assert -(column @ residual) / (column @ column) == pytest.approx(1.5, abs=0.02)
    assert -(stage @ residual) / (stage @ stage) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("share", "found"), [(0.0, 0.0), (0.6, 0.6), (1.0, 1.0), (1.4, 1.0)])
def test_a_rise_is_taken_out_so_far_as_it_is_there(share, found):
    """Though it goes with the noise, and beside keys that are off; never more than at its rate."""
    rng, count = np.random.default_rng(4), 40_000
    newsless_rise, noise, key = rng.standard_normal((3, count))
    rise = 3.0 * newsless_rise - noise
    logged = noise - share * rise + 0.1 * key
    part = Foreseen(logged, np.zeros(count), key[:, None], rise, newsless_rise)
    assert part.rise_share == pytest.approx(found, abs=0.01)
    [left] = part.residuals(logged[None].copy(), np.zeros((1, count)))
    np.testing.assert_allclose(left, logged + part.rise_share * rise, atol=1e-12)


# ---- what that mends ----


@pytest.mark.parametrize("seed", [3, 5])
def test_an_answer_to_strong_disturbances_feigns_no_lag(seed, monkeypatch):
    """At three times the usual noise, and only with instruments."""
    case = {"seed": seed, "runs": 3, "run_duration_s": 3.0, "closed_loop": True}
    machine, runs, noise = runs_and_noise(noise_level=3.0, **case)
    data = Data(machine, runs, noise, believed_hypothesis(machine))
    assert max(promises(data).values()) < CHANCE
    monkeypatch.setattr(inference, "news_of", lambda *_: News([], 0.0, True))
    bare = Data(machine, runs, noise, believed_hypothesis(machine))
    assert min(promises(bare).values()) > 5 * CHANCE


@pytest.mark.parametrize("slow_first", [False, True])
def test_no_lag_is_feigned_by_logs_of_different_rows(slow_first):
    """Three at 200 Hz and one at 50 Hz: each is foreseen from 30 ms of its own rows before."""
    machine = Machine(MODEL)
    case = {"closed_loop": True, "noise_level": 3.0, "run_duration_s": 3.0, "base_offset_sd": 0.0}
    fast = runs_of(machine, TruthCase(seed=5, runs=3, **case))
    slow = runs_of(machine, TruthCase(seed=25, runs=1, row_s=0.02, **case))
    slow = [replace(run, name="slow", unit="slow") for run in slow]
    runs = [*slow, *fast] if slow_first else [*fast, *slow]
    noise = tune_noise(machine, runs, machine.believed)
    data = Data(machine, runs, noise, believed_hypothesis(machine))
    assert max(promises(data).values()) < CHANCE


@pytest.mark.parametrize(
    ("closed_loop", "excitation", "sensors", "feigned"),
    [
        (True, "rich", ("gyro", "pose"), 40.0),
        (True, "rich", ("gyro",), 40.0),
        (True, "poor", ("gyro", "pose"), 100.0),
        (False, "ordinary", ("gyro", "pose"), 0.0),
        (False, "poor", ("gyro", "pose"), 0.0),
    ],
)
def test_gains_that_answers_feign_are_asked_of_closed_loops(
    closed_loop, excitation, sensors, feigned
):
    """More where a direction is not driven; and poor logs are of robots that hardly turn."""
    case = {"closed_loop": closed_loop, "excitation": excitation, "sensors": sensors}
    data = data_of(seed=951, noise_level=2.0, runs=3, **case)
    assert data.feigned_gain == feigned
    assert data.driven[2] == (excitation != "poor")


@pytest.mark.parametrize("lag", LAGS)
def test_a_true_lag_still_stands_out(lag):
    """Of a lag, too, something can be foreseen."""
    hidden = (typical_effect(lag, None).as_dict(),)
    data = data_of(seed=5, effects=hidden, runs=2, run_duration_s=2.0, closed_loop=True)
    assert data.feigned_gain > 0.0
    assert promises(data)[lag] > 5 * CHANCE
