"""What rows hide: the columns, their projection, and that commands which rise feign no lag."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.gap import inference, recordings
from omnislip.gap.inference import Data
from omnislip.gap.machine import CURRENT, Machine
from omnislip.gap.noise import STEP_S, track_all, track_recordings, tune_noise
from omnislip.gap.rows import (
    Projection,
    hidden_columns,
    rise_of,
)
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.truth import TruthCase
from omnislip.model_file import NOMINAL_ROBOT, read_model
from scipy.stats import chi2
from truth_bench import LAGS, promises, runs_of

MODEL = read_model(NOMINAL_ROBOT)
SETTLING = ("shaft_compliance", "bristle_relaxation")
CHANCE = chi2.isf(0.01, 1)


def data_of(electric=False, held=False, unresolved=True, **case):
    """Runs of a robot whose keys are exact, along the believed model's filter with tuned noise.

    Or with noise that takes what a mean does not tell of its row for known (`unresolved`).
    """
    machine = Machine(MODEL, electric, held)
    sensors = ("gyro", "pose", "supply", "current") if electric else ("gyro", "pose")
    runs = runs_of(machine, TruthCase(base_offset_sd=0.0, sensors=sensors, **case))
    noise = tune_noise(machine, runs, machine.believed)
    if not unresolved:
        noise = replace(noise, unresolved=0.0)
    return Data(machine, runs, noise, believed_hypothesis(machine))


# ---- the projection ----


@pytest.mark.parametrize("count", [1, 3])
def test_a_projected_square_is_that_of_the_larger_covariance(count):
    """|P r|^2 = r' (I + N N')^-1 r."""
    rng = np.random.default_rng(count)
    columns = rng.standard_normal((40, count)) * 10.0 ** np.arange(-1, count - 1)
    residuals = rng.standard_normal((5, 40))
    expected = [r @ np.linalg.solve(np.eye(40) + columns @ columns.T, r) for r in residuals]
    projected = Projection(columns).apply(residuals.copy())
    np.testing.assert_allclose(np.sum(projected**2, axis=1), expected, rtol=1e-10)


def test_without_columns_residuals_stay_as_they_are():
    residuals = np.random.default_rng(1).standard_normal((2, 30))
    np.testing.assert_array_equal(Projection(np.zeros((30, 0))).apply(residuals.copy()), residuals)


# ---- the columns ----


@pytest.fixture(scope="module")
def electric():
    return data_of(electric=True, held=True, seed=5, runs=2, run_duration_s=2.0)


@pytest.mark.parametrize("output", [0, 4, 9])
def test_what_a_sensor_shows_besides_is_answered_as_the_filter_does(electric, output):
    """The same added to the measurements, through innovations with frozen gains."""
    machine, run, size = electric.machine, electric.runs[0], 1e-6
    engine = machine.engine
    shown = np.zeros((*run.outputs.shape, 1))
    shown[:, output, 0] = np.random.default_rng(2).standard_normal(len(run.t_s))
    shown[np.isnan(run.outputs)] = 0.0
    plain, changed = (
        engine.recording(run.t_s, run.command, outputs, np.zeros(engine.states))
        for outputs in (run.outputs, run.outputs + size * shown[:, :, 0])
    )
    tracks = track_recordings(machine, [plain], machine.believed, electric.noise, STEP_S, True)
    before, after = (
        engine.innovations([recording], tracks, machine.believed[None], step_s=STEP_S)[0][0]
        for recording in (plain, changed)
    )
    expected = (after - before) / size
    push = np.zeros((len(run.t_s), tracks[0].filter_states, 1))
    found = engine.response(run.recording, tracks[0], push, shown)[:, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("state", [0, 10, 14, 19], ids=["shaft", "yaw", "lasting 1", "lasting 6"])
def test_a_push_of_the_model_is_as_outputs_that_it_would_have_moved_the_other_way(electric, state):
    """The way without a filter: s_(k+1) = F (s_k + u dt / 2) + u dt / 2, outputs H s."""
    machine, run, track = electric.machine, electric.runs[0], electric.tracks[0]
    n, rows = track.filter_states, len(run.t_s)
    push = np.zeros((rows, n, 1))
    push[:, state, 0] = np.random.default_rng(3).standard_normal(rows)
    moved = np.zeros((rows, n))
    for k, step_s in enumerate(np.diff(run.t_s)):
        half = 0.5 * step_s * push[k, :, 0]
        moved[k + 1] = track.transition.reshape(rows, n, n)[k] @ (moved[k] + half) + half
    shown = np.einsum("kji,ki->kj", track.slope.reshape(rows, -1, n), moved)[:, :, None]
    shown[np.isnan(run.outputs)] = 0.0
    as_moved = machine.engine.response(run.recording, track, np.zeros_like(push), -shown)
    pushed = machine.engine.response(run.recording, track, push, np.zeros_like(shown))
    assert np.abs(pushed).max() > 0
    np.testing.assert_allclose(pushed, as_moved, atol=1e-9 * np.abs(pushed).max())


@pytest.mark.parametrize("wrong", ["rows", "states", "columns", "outputs", "track"])
def test_pushes_of_another_shape_are_refused(electric, wrong):
    run, track, engine = electric.runs[0], electric.tracks[0], electric.machine.engine
    push = np.zeros((len(run.t_s), track.filter_states, 2))
    shown = np.zeros((*run.outputs.shape, 2))
    match = "wrong shape"
    if wrong == "track":
        track = track_recordings(
            electric.machine, [run.recording], electric.machine.believed, electric.noise, STEP_S
        )[0]
        match = "did not keep its matrices"
    push = {"rows": push[1:], "states": push[:, 1:]}.get(wrong, push)
    shown = {"columns": shown[:, :, 1:], "outputs": shown[:, 1:]}.get(wrong, shown)
    with pytest.raises(ValueError, match=match):
        engine.response(run.recording, track, push, shown)


def driven_finely(machine, run, noise, rise, parts=5):
    """Whitened innovations (rows, outputs) of a log whose every row is `parts` rows of its own."""
    begin_s = run.t_s[:-1, None] + np.diff(run.t_s)[:, None] * np.arange(parts) / parts
    t_s = np.append(begin_s.ravel(), run.t_s[-1])
    outputs = np.full((len(t_s), run.outputs.shape[1]), np.nan)
    outputs[::parts] = run.outputs
    passed = (np.arange(parts) + 0.5) / parts - 0.5

    def recording(command):
        return machine.engine.recording(t_s, command, outputs, np.zeros(machine.engine.states))

    def command(rise):
        within = run.command[:-1, None] + rise[:-1, None] * passed[None, :, None]
        return np.concatenate([within.reshape(-1, 4), run.command[-1:]])

    held, rising = recording(command(0.0 * rise)), recording(command(rise))
    tracks = track_recordings(machine, [held], machine.believed, noise, STEP_S)
    before, after = (
        machine.engine.innovations([one], tracks, machine.believed[None], step_s=STEP_S)[0][0]
        for one in (held, rising)
    )
    return (after - before)[::parts]


def test_a_log_driven_in_open_loop_hides_only_how_its_commands_rise_within_rows():
    """The first column is what a finer log would show, whose filter follows parts of rows."""
    data = data_of(held=True, seed=5, runs=2, run_duration_s=2.0)
    machine, run = data.machine, data.runs[0]
    noise = replace(data.noise, unresolved=0.0)  # a finer log leaves nothing unresolved
    tracks = track_all(machine, [run], machine.believed, noise, keep_linear=True)
    columns = hidden_columns(machine, [run], tracks, machine.believed)
    assert columns.shape[1] == 2
    kept = data.kept_rows(run)
    found = columns[:, 0].reshape(run.outputs.shape)[kept]
    expected = driven_finely(machine, run, noise, rise_of(run, from_before=False))[kept]
    assert np.linalg.norm(found - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("seed", [11, 16])
def test_what_rows_hide_feigns_no_lag(seed, monkeypatch):
    """Smooth driving with steps in open loop: not with the columns and rows parted at jumps."""
    case = {"seed": seed, "excitation": "ordinary", "noise_level": 0.3}
    assert max(promises(data_of(**case)).values()) < CHANCE
    monkeypatch.setattr(recordings, "parted_at_jumps", not_parted)
    monkeypatch.setattr(inference, "hidden_columns", no_columns)
    assert max(promises(data_of(held=True, **case)).values()) > 2 * CHANCE


@pytest.mark.parametrize(("seed", "noise_level"), [(11, 0.03), (16, 0.1)])
def test_what_commands_that_rise_within_rows_feign_is_in_recordings_and_columns(
    seed, noise_level, monkeypatch
):
    """Beside rows parted at jumps, in logs so clean that it shows: in either, not in none."""
    case = {"seed": seed, "excitation": "ordinary", "noise_level": noise_level}
    moving, held = data_of(**case), data_of(held=True, **case)
    for data in (moving, held):
        assert max(promises(data, LAGS + SETTLING).values()) < CHANCE
    monkeypatch.setattr(inference, "hidden_columns", no_columns)
    in_recordings, in_none = (
        data_of(held=held, unresolved=False, **case) for held in (False, True)
    )
    assert max(promises(in_recordings, LAGS + SETTLING).values()) < CHANCE
    assert max(promises(in_none, LAGS + SETTLING).values()) > 2 * CHANCE


@pytest.mark.parametrize(("seed", "open_loop"), [(11, True), (16, False), (17, True)])
def test_jumps_within_rows_feign_no_soft_gear(seed, open_loop, monkeypatch):
    """Where wheels grip, the contact settles within a row: nor a lag of it, in rich driving.

    Nor with rows left whole by noise that knows what may happen in them; by other noise they do,
    but for a log that then passes for that of a closed loop.
    """
    case = {"held": True, "seed": seed, "excitation": "rich", "noise_level": 0.5}
    monkeypatch.setattr(inference, "hidden_columns", no_columns)
    assert max(promises(data_of(**case), SETTLING).values()) < chi2.isf(0.01, 2)
    monkeypatch.setattr(recordings, "parted_at_jumps", not_parted)
    assert max(promises(data_of(**case), SETTLING).values()) < chi2.isf(0.01, 2)
    if open_loop:
        whole = data_of(unresolved=False, **case)
        assert min(promises(whole, SETTLING).values()) > 2 * chi2.isf(0.01, 2)


def test_currents_at_the_begin_of_a_row_are_half_a_rise_off(electric):
    """Where the first command rises: the filter has answered nothing yet."""
    believed = electric.machine.believed
    columns = hidden_columns(electric.machine, electric.runs, electric.tracks, believed)
    run, track = electric.runs[0], electric.tracks[0]
    rows, outputs = run.outputs.shape
    rise = rise_of(run, from_before=False)
    first = int(np.argmax(np.any(rise != 0.0, axis=1)))
    stall_a = 24.0 / MODEL.values["motor.resistance_ohm"]
    shown = np.zeros(outputs)
    shown[CURRENT] = 0.5 * stall_a * rise[first]
    white = track.whitening.reshape(rows, outputs, outputs)[first]
    found = columns[: rows * outputs, -2].reshape(rows, outputs)
    assert not found[:first].any()
    np.testing.assert_allclose(found[first], white @ shown, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("column", "weights"), [(2, (0, 1, 0)), (3, (-1, 0, 1)), (4, (1, -2, 1))])
def test_currents_may_be_read_by_half_of_what_commands_change_around_a_row(column, weights):
    """Where the first command changes: of the changes into the row before, this one, the next."""
    data = data_of(electric=True, seed=5, runs=1, run_duration_s=2.0)
    [run], [track] = data.runs, data.tracks
    columns = hidden_columns(data.machine, data.runs, data.tracks, data.machine.believed)
    rows, outputs = run.outputs.shape
    change = np.vstack([np.zeros(4), np.diff(run.command, axis=0), np.zeros((2, 4))])
    change[rows - 1] = 0.0
    around = sum(w * np.roll(change, 1 - k, axis=0)[:rows] for k, w in enumerate(weights))
    first = int(np.argmax(np.any(around != 0.0, axis=1)))
    stall_a = 24.0 / MODEL.values["motor.resistance_ohm"]
    shown = np.zeros(outputs)
    shown[CURRENT] = 0.5 * stall_a * around[first]
    shown[np.isnan(run.outputs[first])] = 0.0
    white = track.whitening.reshape(rows, outputs, outputs)[first]
    found = columns[:, column].reshape(rows, outputs)
    assert not found[:first].any()
    np.testing.assert_allclose(found[first], white @ shown, rtol=1e-9, atol=1e-12)


def test_held_commands_tell_the_currents_that_are_read():
    """No columns for what is known."""
    data = data_of(electric=True, held=True, seed=5, runs=1, run_duration_s=2.0)
    believed = data.machine.believed
    assert hidden_columns(data.machine, data.runs, data.tracks, believed).shape[1] == 2


@pytest.mark.parametrize("from_before", [False, True])
def test_a_straight_command_rises_by_its_rate_times_the_row(electric, from_before):
    """Whatever the rows' lengths; nothing beyond the last row, nor before the first."""
    run = electric.runs[0]
    middle_s = run.t_s + 0.5 * np.diff(run.t_s, append=run.t_s[-1])
    straight = replace(run, command=np.outer(middle_s, [1.0, -2.0, 0.5, 0.0]))
    rise = rise_of(straight, from_before)
    expected = np.outer(np.diff(run.t_s), [1.0, -2.0, 0.5, 0.0])
    np.testing.assert_allclose(rise[1:-1], expected[1:], atol=1e-12)
    assert not rise[-1].any()


def no_columns(machine, runs, tracks, values):
    return np.zeros((sum(len(run.t_s) for run in runs) * machine.engine.outputs, 0))


def not_parted(t_s, command, outputs):
    return t_s, command, outputs, np.zeros(0, np.intp)
