"""Replay errors, noise floor and closed fraction, against closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from axis_bench import Bench, make_log, make_machine, make_runs, true_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip._core import SETTLE_S
from omnislip.gap.metrics import (
    Replays,
    closed_fraction,
    gap_table,
    improvement,
    replay_all,
)
from omnislip.gap.recordings import Run, make_run

ROW_S = 0.01


def made_up_run(name, rows=400, channels=("a", "b"), command=None):
    """A run of which only times, channels and command are looked at."""
    t_s = np.arange(rows) * ROW_S
    command = np.sin(7 * t_s)[:, None] if command is None else command
    shape = (rows, len(channels))
    settling = SimpleNamespace(settle_s=SETTLE_S)
    return Run(name, t_s, command, np.zeros(shape), channels, np.ones(len(channels)), settling)


def made_up_replays(name, errors, floor=1.0, command=None):
    """Replays of three models with `errors` (3, rows, channels); noise variance `floor`."""
    channels = ("a", "b")[: errors.shape[2]]
    run = made_up_run(name, errors.shape[1], channels, command)
    return Replays(run, errors, np.full(errors.shape[1:], floor), run.t_s >= 0.25)


def constant_errors(believed, refit, after, rows=400, channels=2):
    """Errors of alternating sign: RMSE is exactly the size asked for."""
    sign = (-1.0) ** np.arange(rows)
    sizes = np.array([believed, refit, after])
    return sizes[:, None, None] * sign[None, :, None] * np.ones(channels)


def three_runs(*sizes, floor=1.0):
    rng = np.random.default_rng(1)
    return [
        made_up_replays(f"r{k}", constant_errors(*sizes), floor, rng.standard_normal((400, 1)))
        for k in range(3)
    ]


# ---- closed fraction ----


@settings(max_examples=15)
@given(refit=st.floats(1.5, 50.0), share=st.floats(0.0, 1.0))
def test_closed_fraction_is_the_share_of_the_excess(refit, share):
    """Mean squares refit^2 and 1 + (1 - share)(refit^2 - 1) in floors of 1."""
    after = np.sqrt(1 + (1 - share) * (refit**2 - 1))
    closed = closed_fraction(three_runs(2 * refit, refit, after), [0, 1], np.ones(2))
    assert closed.value == pytest.approx(share, abs=1e-9)
    assert closed.low == pytest.approx(share, abs=1e-9)
    assert closed.high == pytest.approx(share, abs=1e-9)


def test_a_worse_model_has_a_negative_closed_fraction():
    closed = closed_fraction(three_runs(2.0, 2.0, 3.0), [0, 1], np.ones(2))
    assert closed.value == pytest.approx(-5 / 3)


def test_without_a_gap_nothing_can_be_closed():
    closed = closed_fraction(three_runs(1.0, 1.0, 1.0), [0, 1], np.ones(2))
    assert (closed.value, closed.low, closed.high) == (None, None, None)


def test_channels_count_in_their_own_floors():
    """Channel b in millimetres says the same as in metres."""
    replays = three_runs(3.0, 2.0, 1.5)
    scaled = [
        Replays(r.run, r.errors * [1.0, 1e3], r.floor_variance * [1.0, 1e6], r.counted)
        for r in replays
    ]
    plain = closed_fraction(replays, [0, 1], np.ones(2))
    other = closed_fraction(scaled, [0, 1], np.array([1.0, 1e6]))
    assert other.value == pytest.approx(plain.value)


def test_interval_holds_the_value_and_widens_with_the_scatter_of_the_runs():
    def closed(scatter):
        rng = np.random.default_rng(2)
        replays = [
            made_up_replays(f"r{k}", constant_errors(4.0, 4.0, 2.0 + scatter * rng.uniform(-1, 1)))
            for k in range(6)
        ]
        return closed_fraction(replays, [0, 1], np.ones(2))

    calm, wild = closed(0.1), closed(0.9)
    assert calm.low < calm.value < calm.high
    assert 3 * (calm.high - calm.low) < wild.high - wild.low


@pytest.mark.parametrize("count", [1, 2])
def test_few_runs_are_cut_into_windows(count):
    replays = three_runs(3.0, 3.0, 1.0)[:count]
    closed = closed_fraction(replays, [0, 1], np.ones(2))
    assert closed.value == pytest.approx(1.0)


def cut(replays, row):
    """The two pieces of a run that was cut at a row."""
    rows = (slice(None, row), slice(row, None))
    return [
        Replays(
            replace(replays.run, t_s=replays.run.t_s[part], command=replays.run.command[part]),
            replays.errors[:, part],
            replays.floor_variance[part],
            replays.counted[part],
        )
        for part in rows
    ]


def test_pieces_of_a_run_count_as_the_run():
    """A second piece that is short and bad weighs no more than its rows do."""
    whole = three_runs(3.0, 3.0, 2.0)
    whole[0].errors[:, 350:] *= 4.0
    table, pieces = gap_table(whole), gap_table([*cut(whole[0], 350), *whole[1:]])
    np.testing.assert_allclose(pieces.rmse, table.rmse)
    np.testing.assert_allclose(pieces.floor, table.floor)
    assert pieces.closed == table.closed


@pytest.mark.parametrize(
    ("count", "over"),
    [(1, "4 windows of 1 s of 1 run"), (2, "8 windows of 1 s of 2 runs"), (3, "3 runs")],
)
def test_an_interval_says_what_it_is_over(count, over):
    replays = three_runs(3.0, 3.0, 1.0)[:count]
    assert closed_fraction(replays, [0, 1], np.ones(2)).over == over
    pieces = [piece for one in replays for piece in cut(one, 225)]
    assert closed_fraction(pieces, [0, 1], np.ones(2)).over.endswith(over[-6:])


def test_one_window_tells_neither_a_share_nor_what_is_left():
    replays = [made_up_replays("short", constant_errors(9.0, 9.0, 3.0, rows=120))]
    table = gap_table(replays)
    assert table.closed.value is None
    assert table.left.standard_error == np.inf


def test_a_piece_that_ends_before_its_first_replay_does_not_count():
    replays = three_runs(3.0, 3.0, 2.0)
    short = made_up_replays("short", np.full((3, 20, 2), 100.0))
    table = gap_table([*replays, short])
    np.testing.assert_allclose(table.rmse, gap_table(replays).rmse)
    assert improvement([short]) == (0.0, 0.0)


@pytest.mark.parametrize("count", [1, 2])
def test_windows_in_which_a_channel_is_blank_do_not_count(count):
    """A camera that loses the robot for a second leaves no error there: not an error of zero."""
    replays = three_runs(3.0, 3.0, 2.0)[:count]
    for r in replays:
        r.errors[:, 130:340, 1] = np.nan
    closed = closed_fraction(replays, [0, 1], np.ones(2))
    assert closed.value == pytest.approx(5 / 8)


# ---- table and floor ----


def test_table_holds_rmse_of_the_counted_rows():
    table = gap_table(three_runs(4.0, 3.0, 2.0))
    np.testing.assert_allclose(table.rmse, [[4.0, 4.0], [3.0, 3.0], [2.0, 2.0]])
    assert table.channels == ("a", "b")
    assert table.runs == ("r0", "r1", "r2")


def test_floor_is_the_predictors_when_nothing_is_repeated():
    table = gap_table(three_runs(4.0, 3.0, 2.0, floor=0.25))
    np.testing.assert_allclose(table.floor, 0.5)
    assert table.floor_source == "the predictor's noise"


@pytest.mark.parametrize(("sizes", "usual"), [([0.8, 1.4, 1.0], 0.96), ([0.8, 2.0, 1.6], 0.0)])
def test_what_a_model_usually_leaves_is_that_of_the_worst_run_it_was_fitted_to(sizes, usual):
    """By errors in floors; nothing where they are far off on the whole."""
    rng = np.random.default_rng(1)
    shown, *fitted = (
        made_up_replays(name, constant_errors(9.0, 9.0, size), 1.0, rng.standard_normal((400, 1)))
        for name, size in zip("abcd", [1.5, *sizes], strict=True)
    )
    assert gap_table([shown], fitted).left.usual == pytest.approx(usual)
    assert gap_table([shown]).left.usual == 0.0


def repeated(scatter, bias, seeds):
    """Two runs of one command: a common error `bias` and noise of deviation `scatter` in each."""
    replays = []
    for seed in seeds:
        noise = np.random.default_rng(seed).normal(0.0, scatter, (400, 2))
        errors = bias + np.stack([noise, noise, noise])
        replays.append(made_up_replays(f"r{seed}", errors, floor=100.0))
    return replays


def test_floor_of_repeated_manoeuvres_is_what_differs_between_them():
    """Half the variance of the difference; a common error of any size cancels.

    375 rows: the standard error of a deviation is 3.7 %.
    """
    table = gap_table(repeated(scatter=0.3, bias=5.0, seeds=(1, 2)))
    assert table.floor_source == "repeated manoeuvres"
    np.testing.assert_allclose(table.floor, 0.3, rtol=0.15)


def test_a_floor_of_few_seconds_is_as_uncertain_as_they_are():
    """Errors that last a second: eight of them tell the floor no better than to a third.

    Without a gap an excess is two of its standard errors one time in twenty at most.
    """
    ratios = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        one, other = (
            made_up_replays(name, np.repeat(rng.normal(size=(1, 4, 2)), 100, axis=1).repeat(3, 0))
            for name in ("one", "other")
        )
        left = gap_table([one], [other]).left
        ratios.append(left.excess / left.standard_error)
    assert np.mean(np.array(ratios) > 2.0) < 0.05


def test_different_commands_are_no_repetition():
    one, other = repeated(scatter=0.3, bias=0.0, seeds=(1, 2))
    moved = made_up_run("other", command=np.cos(7 * one.run.t_s)[:, None])
    table = gap_table([one, Replays(moved, other.errors, other.floor_variance, other.counted)])
    assert table.floor_source == "the predictor's noise"


def piece(name, errors, begin, end, command):
    """Rows begin..end of a run: replays from there, with `errors` (rows, channels) of any model."""
    whole = made_up_run(name, len(errors), command=command)
    run = replace(
        whole,
        t_s=whole.t_s[begin:end],
        command=command[begin:end],
        outputs=whole.outputs[begin:end],
    )
    counted = run.t_s >= run.t_s[0] + 0.25
    return Replays(run, np.stack([errors[begin:end]] * 3), np.ones((end - begin, 2)), counted)


HELD = np.tile([0.3, 0.1, -0.3, -0.1], (600, 1))
SINE = np.sin(7 * ROW_S * np.arange(600))[:, None]


@pytest.mark.parametrize(
    ("one", "other", "what"),
    [
        ((0, 495, HELD), (500, 600, HELD), "pieces of one log, of other times"),
        ((0, 600, SINE), (0, 600, 0.5 * SINE), "another size of the command"),
        ((0, 600, SINE), (50, 600, SINE), "replays that restart at other times"),
        ((0, 400, SINE), (300, 480, SINE), "little in common"),
    ],
)
def test_what_is_no_repetition(one, other, what):
    noise = np.random.default_rng(3).normal(0.0, 10.0, (2, 600, 2))
    table = gap_table([piece("one", noise[0], *one), piece("other", noise[1], *other)])
    assert table.floor_source == "the predictor's noise", what
    np.testing.assert_allclose(table.floor, 1.0)


def test_repetitions_are_compared_over_the_times_that_both_have():
    """The second begins a second later; what the first did before it, and errors alone, differ."""
    noise = np.random.default_rng(4).normal(0.0, 0.3, (2, 600, 2))
    noise[0, :125] += 50.0
    one, other = (
        piece(name, errors, begin, 600, SINE)
        for name, errors, begin in (("one", noise[0], 0), ("other", noise[1], 100))
    )
    for order in ([one, other], [other, one]):
        table = gap_table(order)
        assert table.floor_source == "repeated manoeuvres"
        np.testing.assert_allclose(table.floor, 0.3, rtol=0.15)


def test_another_robot_with_the_same_commands_is_no_repetition():
    noise = np.random.default_rng(5).normal(0.0, 0.3, (4, 600, 2))
    noise[3] += 30.0 * np.sin(np.arange(600) / 50.0)[:, None]
    runs = [piece(f"run_{k}", errors, 0, 600, SINE) for k, errors in enumerate(noise)]
    for shown in (runs, runs[1:]):
        table = gap_table(shown)
        assert table.floor_source == "repeated manoeuvres"
        np.testing.assert_allclose(table.floor, 0.3, rtol=0.2)


def test_copies_of_a_run_do_not_say_that_there_is_no_chance():
    replays = three_runs(4.0, 3.0, 2.0, floor=0.25)[:1]
    table = gap_table(replays, replays)
    assert table.floor_source == "the predictor's noise"
    np.testing.assert_allclose(table.floor, 0.5)
    assert table.closed.value == pytest.approx((9.0 - 4.0) / (9.0 - 0.25))


def test_runs_of_few_samples_are_no_repetition():
    """Nine samples of each sensor in common, say of a slow camera, leave no window to compare."""
    replays = repeated(scatter=0.3, bias=5.0, seeds=(1, 2))
    for r in replays:
        r.errors[:, np.arange(400) % 42 > 0] = np.nan
    table = gap_table(replays)
    assert table.floor_source == "the predictor's noise"
    assert np.isfinite(table.left.standard_error)


def test_blank_channels_are_left_out_and_blank_rows_do_no_harm():
    replays = three_runs(4.0, 3.0, 2.0)
    for r in replays:
        r.errors[:, :, 1] = np.nan
        r.errors[:, ::3, 0] = np.nan
    table = gap_table(replays)
    assert table.channels == ("a",)
    np.testing.assert_allclose(table.rmse[:, 0], [4.0, 3.0, 2.0])
    assert np.isfinite(table.floor).all()
    assert np.isfinite([table.closed.value, table.closed.low, table.closed.high]).all()


def test_a_channel_blank_in_one_run_only_is_judged_on_the_others():
    replays = three_runs(4.0, 3.0, 2.0)
    replays[0].errors[:, :, 1] = np.nan
    table = gap_table(replays)
    np.testing.assert_allclose(table.rmse, [[4.0, 4.0], [3.0, 3.0], [2.0, 2.0]])
    assert np.isfinite(table.floor).all()


def test_a_channel_that_nobody_sampled_is_no_reason_to_warn(recwarn):
    replays = three_runs(4.0, 3.0, 2.0)
    for r in replays:
        r.errors[:, :, 1] = np.nan
    gap_table(replays)
    assert len(recwarn) == 0


# ---- on logs ----


def test_replays_of_the_true_model_err_by_the_noise_floor(tmp_path):
    """Mean square over the floor's: 1 within what eight runs of 5 one-second windows can tell."""
    machine = make_machine(tmp_path)
    runs = make_runs(machine, Bench(), range(8))
    table = gap_table(replay_all(machine, runs, true_noise(), [machine.believed] * 3))
    # Free runs of a second: errors of a window hang together, so 40 windows are 40 samples of a
    # squared error whose deviation is about its mean: 1 +- 0.16 each sigma.
    assert (table.rmse[0, 0] / table.floor[0]) ** 2 == pytest.approx(1.0, abs=0.55)


def test_replay_without_noise_and_gap_has_no_error(tmp_path):
    machine = make_machine(tmp_path)
    run = make_run(machine, make_log(Bench(), 1, noise=0.0))
    [replays] = replay_all(machine, [run], true_noise(), [machine.believed] * 3)
    assert np.abs(replays.errors[:, replays.counted]).max() < 2e-6
