"""From a log to what the engine replays: units, wraps, blanks, the first state."""

from dataclasses import replace

import numpy as np
import pytest
from axis_bench import Bench, make_log, make_machine
from hypothesis import assume, given
from hypothesis import strategies as st
from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, track_all, track_recordings, tune_noise
from omnislip.gap.recordings import (
    ROBOT_CHANNELS,
    machine_for,
    make_run,
    unused_columns,
    unwrap_counts,
    wheel_jacobian,
)
from omnislip.gap.truth import HiddenEffect, TruthCase
from omnislip.log_file import POSE_COLUMNS, Log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from truth_bench import logs_of

ROBOT = Machine(read_model(NOMINAL_ROBOT))
HOLDING = ROBOT.of(ROBOT.model, holds_commands=True)
RAD_PER_COUNT = 2 * np.pi / 2000
SHAFT_PER_RIM = 12.0 / 0.05
HEADING_RAD = 3.0
STILL = np.zeros(3)


@given(
    start=st.integers(0, 65535),
    steps=st.lists(st.integers(-32768, 32767), min_size=1, max_size=50),
)
def test_unwrapping_finds_every_step_of_less_than_half_a_turn_of_the_counter(start, steps):
    path = np.concatenate([[0], np.cumsum(steps)])
    counter = (start + path) % 65536
    np.testing.assert_array_equal(unwrap_counts(counter.astype(float)), start + path)


@given(st.lists(st.integers(-(2**31), 2**31), min_size=1, max_size=50))
def test_unwrapped_counts_differ_from_the_counter_by_whole_turns(counts):
    unwrapped = unwrap_counts(np.array(counts, float))
    np.testing.assert_array_equal((np.array(counts) - unwrapped) % 65536, 0)


def log_of(velocity, rows=21, row_s=0.005, pose_every=4, by_wheels=None):
    """Log of a robot that goes with constant body velocity along x, y or turning on the spot.

    It rolls, or slides while its wheels turn as if it went as fast as `by_wheels`.
    """
    t_s = 2.0 + np.arange(rows) * row_s
    rolling = velocity if by_wheels is None else by_wheels
    shaft = wheel_jacobian(ROBOT) @ rolling * SHAFT_PER_RIM
    angles = np.outer(t_s - t_s[0], shaft)
    counts = np.floor(angles / RAD_PER_COUNT) % 65536
    columns = {f"wheel/{w + 1}/duty": np.full(rows, 0.1 * w) for w in range(4)}
    columns |= {f"wheel/{w + 1}/encoder_counts": counts[:, w] for w in range(4)}
    along = complex(*velocity[:2]) * np.exp(HEADING_RAD * 1j)
    pose = np.outer(t_s, [along.real, along.imag, velocity[2]])
    pose += np.array([0.5, -0.5, HEADING_RAD])
    pose[:, 2] = np.remainder(pose[:, 2] + np.pi, 2 * np.pi) - np.pi
    pose[np.arange(rows) % pose_every != 0] = np.nan
    columns |= {name: pose[:, k] for k, name in enumerate(POSE_COLUMNS)}
    return Log("run", t_s, columns)


def initial_state(run):
    """State of the filter's first row, before it has corrected anything."""
    certain = Noise(np.zeros(14), np.ones(8), np.zeros(14), 0.0, 0.0, np.zeros(8))
    [track] = track_all(ROBOT, [run], ROBOT.believed, certain)
    return track.state.reshape(-1, track.filter_states)[0, :14]


def test_channels_have_units_of_the_engine_and_scales_back_to_the_log():
    log = log_of(np.array([1.0, 0.0, 0.0]))
    run = make_run(ROBOT, log)
    assert run.channels == ROBOT_CHANNELS
    assert run.duration_s == pytest.approx(0.1)
    # Counts in rad; after 0.1 s at 1 m/s wheel 3 has turned by 0.05 m of rim.
    assert run.outputs[-1, 2] == pytest.approx(0.05 * SHAFT_PER_RIM, abs=RAD_PER_COUNT)
    unwrapped = unwrap_counts(log.columns["wheel/3/encoder_counts"])
    np.testing.assert_allclose(run.outputs[:, 2] * run.scale[2], unwrapped, atol=1e-9)
    np.testing.assert_allclose(run.command, np.tile([0.0, 0.1, 0.2, 0.3], (21, 1)))
    np.testing.assert_array_equal(run.scale[4:], 1.0)


def test_missing_and_blank_columns_are_not_sampled():
    log = log_of(np.array([1.0, 0.0, 0.0]))
    run = make_run(ROBOT, log)
    seen = ~np.isnan(run.outputs)
    assert seen[:, :4].all()
    assert not seen[:, 4].any()
    np.testing.assert_array_equal(np.flatnonzero(seen[:, 5]), np.arange(0, 21, 4))


def test_what_flows_in_the_first_and_last_row_of_a_log_goes_with_no_command():
    """A duty is a mean up to the next row, and that of the last row nobody can check.

    What was read before it acts in the first row goes with one before the log.
    """
    log = log_of(np.array([1.0, 0.0, 0.0]))
    flowing = {"wheel/1/current_a": np.arange(21.0), "supply/voltage_v": 24.0 - np.arange(21.0)}
    log = replace(log, columns=log.columns | flowing)
    robot = machine_for(read_model(NOMINAL_ROBOT), [log])
    seen = ~np.isnan(make_run(robot, log).outputs)
    assert seen[1:-1, 8:10].all() and not seen[[0, -1], 8:10].any() and seen[[0, -1], :4].all()
    assert not np.isnan(make_run(robot, log, 0, 11).outputs[-1, 8:10]).any()


def test_heading_is_unwrapped_over_blank_rows():
    run = make_run(ROBOT, log_of(np.array([0.0, 0.0, 8.0]), rows=401))
    heading = run.outputs[::4, 7]
    np.testing.assert_allclose(np.diff(heading), 8.0 * 0.02, atol=1e-9)
    assert heading[-1] - heading[0] > 2 * np.pi


@pytest.mark.parametrize("velocity", [(1.0, 0.0, 0.0), (0.0, -0.8, 0.0), (0.0, 0.0, 3.0)])
def test_first_state_is_the_motion_of_the_first_rows(velocity):
    """Over three rows the counts tell a shaft speed to a count in 15 ms: 0.21 rad/s."""
    log = log_of(np.array(velocity))
    state = initial_state(make_run(ROBOT, log))
    shaft = wheel_jacobian(ROBOT) @ velocity * SHAFT_PER_RIM
    np.testing.assert_allclose(state[:4], shaft, atol=0.21)
    np.testing.assert_array_equal(state[4:8], 0.0)
    # J+ of an error of 0.21 rad/s on each rim: at most 1.2 mm/s, and / L for the turning.
    np.testing.assert_allclose(state[8:11], velocity, atol=6e-3)
    first = [log.columns[name][0] for name in POSE_COLUMNS]
    np.testing.assert_allclose(state[11:], first, atol=1e-12)


@pytest.mark.parametrize(("acceleration", "jerk"), [(8e3, 0.0), (2e4, 0.0), (0.0, 8e5)])
def test_first_state_of_a_robot_that_starts_is_that_of_rest(acceleration, jerk):
    """In rad/s2, by 0.2 m/s in the first row or where a coil holds the current back more."""
    log = log_of(np.zeros(3))
    passed_s = log.t_s - log.t_s[0]
    turned = acceleration * passed_s**2 / 2.0 + jerk * passed_s**3 / 6.0
    counts = {
        f"wheel/{wheel}/encoder_counts": np.rint(sign * turned * 2000 / (2 * np.pi))
        for wheel, sign in zip(range(1, 5), (-1.0, -0.5, 0.5, 1.0), strict=True)
    }
    run = make_run(ROBOT, replace(log, columns=log.columns | counts))
    assert run.at_rest == (jerk > 0.0)  # then it has gone a count in the first row
    assert run.settled_s == pytest.approx(run.t_s[0] + 0.25)
    state = initial_state(run)
    np.testing.assert_allclose(state[:4], 0.0, atol=1.5 * 2 * np.pi / 2000 / 5e-3)
    np.testing.assert_allclose(state[8:10], 0.0, atol=0.01)


def test_first_state_of_a_robot_whose_wheels_spin_up_is_that_of_rest():
    """A spinning wheel gains less and less, so that a parabola through three rows begins at 0.2."""
    log = log_of(np.zeros(3))
    passed_s = log.t_s - log.t_s[0]
    ways = 2.6 * (passed_s - 0.011 * (1.0 - np.exp(-passed_s / 0.011))) * 12.0 / 0.05
    counts = {
        f"wheel/{wheel}/encoder_counts": np.rint(sign * ways * 2000 / (2 * np.pi))
        for wheel, sign in zip(range(1, 5), (-1.0, -1.0, 1.0, 1.0), strict=True)
    }
    run = make_run(ROBOT, replace(log, columns=log.columns | counts))
    assert not run.at_rest
    assert run.settled_s == pytest.approx(run.t_s[0] + 0.25)
    np.testing.assert_allclose(initial_state(run)[:4] * 0.05 / 12.0, 0.0, atol=0.04)


def started(machine, duty):
    """Log of a robot that stood until the first row, then is driven along x by duties (60,)."""
    t_s, command = 5e-3 * np.arange(60), np.outer(duty, [-1.0, -1.0, 1.0, 1.0])
    still, silent = np.zeros(14), np.zeros((60, 8))
    recording = machine.recording(t_s, command, silent, still, 0.25, np.zeros(21))
    certain = Noise(still, np.ones(8), still, 0.0, 0.0, np.zeros(8))
    tracks = track_recordings(machine, [recording], machine.believed, certain, 1e-3)
    believed = machine.believed[None]
    shown = -machine.engine.replays([recording], tracks, believed, 1e-3, np.inf)[0][0]
    columns = {f"wheel/{w + 1}/duty": command[:, w] for w in range(4)}
    for w in range(4):
        columns[f"wheel/{w + 1}/encoder_counts"] = np.floor(shown[:, w] / RAD_PER_COUNT)
    columns["gyro/z_rad_s"] = shown[:, 4]
    shown[np.arange(60) % 4 != 0, 5:] = np.nan
    columns |= {name: shown[:, 5 + k] for k, name in enumerate(POSE_COLUMNS)}
    return Log("run", t_s, columns)


@pytest.mark.parametrize("duty", [0.2, 0.5, 1.0])
def test_a_start_that_lags_behind_its_command_is_what_the_filter_expects(duty):
    """Coils need 5 ms. If the command were said to have lasted, or the robot to be anywhere."""
    coils = [Effect("armature_inductance", {"inductance_h": 3e-3})]
    machine = HOLDING.of(replace(ROBOT.model, effects=coils))
    run = make_run(machine, started(machine, np.full(60, duty)))
    lasted = machine.recording(run.t_s, run.command, run.outputs, np.zeros(14))
    sampled = np.count_nonzero(~np.isnan(run.outputs[:20]))
    squares = [white_squares(machine, one)[:20].sum() for one in (run.recording, lasted)]
    assert squares[0] < sampled
    assert squares[1] > 20.0 * sampled


@pytest.mark.parametrize("duty", [0.2, 0.5, 1.0])
def test_what_a_missing_row_was_driven_by_nobody_knows(duty):
    """A jump that is taken back in the row that is lost: the mean of the one before is its own.

    To a factor of three: what a wheel passes on to the others beside the body is not left open.
    """
    driven = np.full(60, 0.1)
    driven[20] = duty + 0.1
    log = started(HOLDING, driven)
    kept = np.arange(60) != 21
    log = Log("run", log.t_s[kept], {name: one[kept] for name, one in log.columns.items()})
    run = make_run(HOLDING, log)
    stall_rad_s2 = 24.0 / 0.6 * 0.0255 / 2.5e-5
    untold = np.where(np.arange(59) == 20, 0.5 * stall_rad_s2, 0.0)
    np.testing.assert_allclose(run.recording.untold, untold, rtol=1e-9, atol=1e-4)
    sampled = np.count_nonzero(~np.isnan(run.outputs[21:31]))
    known = run.recording.missing(np.zeros(59))
    squares = [white_squares(HOLDING, one)[21:31].sum() for one in (run.recording, known)]
    assert squares[0] < 3.0 * sampled
    assert squares[1] > 300.0 * squares[0]


def white_squares(machine, recording):
    """Sum of the squares of whitened innovations in each row (rows,), by noise of a quiet floor."""
    output = np.array([RAD_PER_COUNT**2 / 12] * 4 + [1e-6] * 4)
    initial = np.array([25.0] * 4 + [RAD_PER_COUNT**2] * 4 + [0.02, 0.02, 0.05] + [1e-4] * 3)
    lasting = np.diag([1.0] * 4 + [1e-4] * 3)
    noise = Noise(np.zeros(14), output, initial, 0.0, 0.0, np.zeros(8), 0.0, lasting, 40.0)
    [track] = track_recordings(machine, [recording], machine.believed, noise, 5e-3)
    innovation = np.nan_to_num(track.innovation.reshape(-1, 8))
    white = np.einsum("kij,kj->ki", track.whitening.reshape(-1, 8, 8), innovation)
    return np.sum(white**2, axis=1)


@pytest.mark.parametrize("velocity", [(0.3, 0.0, 0.0), (0.0, -2.0, 0.0)])
def test_where_wheels_slide_the_camera_tells_the_first_velocity(velocity):
    log = log_of(np.array(velocity), rows=101, by_wheels=STILL)
    state = initial_state(make_run(ROBOT, log, 5))
    np.testing.assert_allclose(state[8:11], velocity, atol=1e-9)


def test_where_wheels_slide_the_gyro_tells_how_fast_the_robot_turns_at_first():
    log = log_of(np.array([0.4, 0.0, 0.0]), rows=101)
    columns = {n: v for n, v in log.columns.items() if n not in POSE_COLUMNS}
    turning = replace(log, columns=columns | {"gyro/z_rad_s": np.full(101, 5.0)})
    state = initial_state(make_run(ROBOT, turning, 5))
    np.testing.assert_allclose(state[8:11], [0.4, 0.0, 5.0], atol=6e-3)


@pytest.mark.parametrize(
    ("velocity", "first_row", "camera", "at_rest", "settle_s"),
    [
        (STILL, 0, False, True, 0.25),
        (STILL, 5, False, False, 1.0),  # what went before may have set it moving
        (np.array([0.5, 0.0, 0.0]), 0, False, False, 1.0),
        (np.array([0.5, 0.0, 0.0]), 5, True, False, 0.25),
    ],
)
def test_a_velocity_that_only_wheels_tell_takes_longer_to_find(
    velocity, first_row, camera, at_rest, settle_s
):
    log = log_of(velocity, rows=401, pose_every=4 if camera else 1000)
    run = make_run(ROBOT, log, first_row)
    assert run.at_rest == at_rest
    assert run.settled_s == pytest.approx(run.t_s[0] + settle_s)


def test_a_piece_of_a_log_is_the_rows_asked_for():
    log = log_of(np.array([1.0, 0.0, 0.0]))
    piece = make_run(ROBOT, log, 8, 16)
    np.testing.assert_array_equal(piece.t_s, log.t_s[8:16])
    np.testing.assert_allclose(piece.time_s, 0.005 * np.arange(8, 16))
    counts = unwrap_counts(log.columns["wheel/1/encoder_counts"])[8:16]
    np.testing.assert_allclose(piece.outputs[:, 0], counts * RAD_PER_COUNT)
    assert piece.recording.rows == 8


def test_columns_that_nothing_uses_are_named():
    """A supply that is always 0, a current that is constant in one log; all others vary."""
    nothing, wave = np.zeros(5), np.arange(5.0)
    logs = [
        Log("run", wave, {"supply/voltage_v": nothing, "wheel/1/current_a": current})
        for current in (wave, nothing)
    ]
    assert unused_columns(ROBOT, logs) == [
        "supply/voltage_v (does not vary in 2 of 2 logs)",
        "wheel/1/current_a (does not vary in 1 of 2 logs)",
    ]


def test_axis_does_not_use_its_speed(tmp_path):
    machine = make_machine(tmp_path)
    log = make_log(Bench(), seed=1, duration_s=1.0)
    assert unused_columns(machine, [log]) == []
    speed = {"axis/speed_m_s": log.t_s, "supply/voltage_v": log.t_s}
    both = replace(log, columns=log.columns | speed)
    assert unused_columns(machine, [both]) == list(speed)


def test_axis_has_one_channel_in_its_own_unit(tmp_path):
    machine = make_machine(tmp_path)
    log = make_log(Bench(), seed=1, duration_s=1.0)
    run = make_run(machine, log)
    assert run.channels == ("axis/position_m",)
    np.testing.assert_array_equal(run.outputs[:, 0], log.columns["axis/position_m"])
    np.testing.assert_array_equal(run.command[:, 0], log.columns["axis/command"])
    np.testing.assert_array_equal(run.scale, [1.0])


# ---- commands that jump within a row ----


LEVELS = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)


def far(least):
    return st.one_of(st.floats(-1.0, -least), st.floats(least, 1.0))


FAR_LEVELS = st.one_of(  # from waves of 0.2, 0.15, 0.1 and 0.2 in sum by more than 2
    st.lists(far(0.7), min_size=4, max_size=4),
    st.tuples(far(0.9), far(0.9), far(0.9), st.floats(-1.0, 1.0)).flatmap(st.permutations),
).map(np.array)


def driven(duty, t_s=None):
    """Log of a robot at rest that is given duties (rows, 4)."""
    log = log_of(np.zeros(3), rows=len(duty))
    duties = {f"wheel/{w + 1}/duty": duty[:, w] for w in range(4)}
    return replace(log, t_s=log.t_s if t_s is None else t_s, columns=log.columns | duties)


@given(
    before=LEVELS,
    after=LEVELS,
    share=st.floats(0.1, 0.9),
    jitter=st.lists(st.floats(0.003, 0.012), min_size=13, max_size=13),
)
def test_a_row_in_which_commands_jump_is_parted_at_that_instant(before, after, share, jitter):
    """Levels, instant and way of the commands are those before they were logged as means."""
    assume(np.abs(after - before).max() > 0.2)
    t_s = np.concatenate([[0.0], np.cumsum(jitter)])
    mean = share * before + (1.0 - share) * after
    run = make_run(ROBOT, driven(np.vstack([[before] * 6, [mean], [after] * 7]), t_s))
    assert run.jumped.tolist() == [7]
    assert run.t_s[7] == pytest.approx(t_s[6] + share * (t_s[7] - t_s[6]), abs=1e-9)
    np.testing.assert_allclose(run.command, np.vstack([[before] * 7, [after] * 8]), atol=1e-9)
    assert np.isnan(run.outputs[7]).all()
    rest = np.delete(np.arange(15), 7)
    np.testing.assert_array_equal(run.t_s[rest], t_s)
    assert not np.isnan(run.outputs[rest, :4]).any()


@given(before=LEVELS, after=LEVELS, share=st.floats(0.1, 0.9), back=st.floats(0.0, 0.3))
def test_a_jump_that_a_controller_takes_back_keeps_the_mean_of_its_row(before, after, share, back):
    jump = after - before
    assume(np.abs(jump).max() > 0.3 and np.abs(after).max() < 0.8)
    mean = share * before + (1.0 - share) * after
    fading = [before + jump * (1.0 - back) ** k for k in range(7)]
    run = make_run(ROBOT, driven(np.vstack([[before] * 6, [mean], fading])))
    assert run.jumped.tolist() == [7]
    parts_s = np.diff(run.t_s)[6:8]
    np.testing.assert_allclose(parts_s @ run.command[6:8], 0.005 * mean, atol=1e-12)


@given(
    after=FAR_LEVELS,
    share=st.floats(0.1, 0.9),
    phase=st.floats(0.0, 6.28),
    backwards=st.booleans(),
)
def test_a_jump_between_a_wave_and_a_steady_command_is_parted_at_its_instant(
    after, share, phase, backwards
):
    """3 Hz at rows of 5 ms, each wheel in a phase of its own."""
    turn, size = 2.0 * np.pi * 3.0, np.array([0.2, 0.15, 0.1, 0.2])
    phases = phase + np.arange(4.0)
    at_s = (6.0 + share) * 0.005
    ends_s = 0.005 * np.arange(15)[:, None]
    wave = -size * np.cos(turn * np.minimum(ends_s, at_s) + phases) / turn
    way = np.diff(wave + after * np.maximum(ends_s - at_s, 0.0), axis=0)
    duty = way[::-1] / 0.005 if backwards else way / 0.005
    run = make_run(ROBOT, driven(duty))
    [row] = run.jumped
    found_s = run.t_s[row] - run.t_s[0]
    assert found_s == pytest.approx(0.07 - at_s if backwards else at_s, abs=2e-4)
    parts_s = np.diff(run.t_s)[row - 1 : row + 1]
    logged = 7 if backwards else 6
    np.testing.assert_allclose(parts_s @ run.command[row - 1 : row + 1], 0.005 * duty[logged])


JUMP_OF_TWO = np.array([0.6, -0.6, 0.0, 0.0])
NO_JUMPS = {
    "held": np.zeros((14, 4)),
    "with the row": np.outer(np.arange(14) >= 7, JUMP_OF_TWO),
    "a ramp": np.outer(np.arange(14), 0.07 * np.ones(4)),
    "a ramp that begins": np.outer(np.maximum(np.arange(14) - 6.5, 0.0), 0.13 * np.ones(4)),
    "a small one": np.outer([0.0] * 6 + [0.03] + [0.06] * 7, np.ones(4)),
    "each wheel at another time": np.vstack(
        [np.zeros((6, 4)), [[0.1, 0.5, 0.3, 0.6]], np.full((7, 4), 0.7)]
    ),
    "out of saturation": np.outer([1.0] * 7 + [0.9 * 0.6**k for k in range(7)], np.ones(4)),
    "with the row, taken back": np.outer(
        [0.0] * 7 + [1.0, 0.94, 0.39, 0.13, 0.07, 0.09, 0.12], np.ones(4)
    ),
    "a controller's, between commands that move": np.array(
        [[0.104, -0.286, -0.104, 0.286]] * 3
        + [[0.103, -0.286, -0.102, 0.287], [0.102, -0.286, -0.102, 0.288]]
        + [[0.168, -0.191, -0.036, 0.325], [0.294, -0.009, 0.091, 0.395]]
        + [[0.305, 0.009, 0.103, 0.401], [0.311, 0.018, 0.108, 0.397]]
        + [[0.314, 0.029, 0.111, 0.394]] * 5
    ),
    "at the log's end": np.outer([0.0] * 12 + [0.3, 0.6], np.ones(4)),
}


@pytest.mark.parametrize("duty", NO_JUMPS.values(), ids=NO_JUMPS.keys())
def test_no_other_row_is_parted(duty):
    run = make_run(ROBOT, driven(duty))
    assert run.jumped.size == 0
    np.testing.assert_array_equal(run.command, duty)


@pytest.mark.parametrize("lost", [False, True])
def test_a_controller_that_acts_where_rows_begin_jumps_nowhere_else(lost):
    """But in a row beside a lost one, which holds the mean of two commands. And all the way back.

    Jumps in rows 6 and 12; where a row is lost, behind the second.
    """
    before, after = np.array([0.1, 0.4, -0.2, 0.0]), np.array([-0.6, 0.5, 0.8, 0.3])
    mean = 0.3 * before + 0.7 * after
    duty = np.vstack([[before] * 6, [mean], [after] * 5, [mean], [before] * 7])
    t_s = 0.005 * (np.arange(20) + (lost & (np.arange(20) > 12)))
    log = driven(duty, t_s)
    run = make_run(HOLDING, log)
    whole = make_run(HOLDING.of(HOLDING.model, jumps_with_rows=True), log)
    assert run.jumped.tolist() == whole.jumped.tolist() == [7, 14]
    np.testing.assert_allclose(
        run.command[[6, 7, 13, 14]], [before, after, after, before], atol=1e-12
    )
    np.testing.assert_allclose(whole.command[[6, 7]], [mean, mean])
    np.testing.assert_allclose(
        whole.command[[13, 14]], [after, before] if lost else [mean, mean], atol=1e-12
    )
    np.testing.assert_allclose(whole.logged_command, duty, atol=1e-12)
    assert not whole.rise.any()
    for back in (whole.held_in_rows(), whole.set_with_rows().held_in_rows()):
        np.testing.assert_array_equal(back.command, run.command)
    moving = make_run(ROBOT, log)
    np.testing.assert_array_equal(whole.moving_in_rows().command, moving.command)
    np.testing.assert_array_equal(whole.moving_in_rows().rise, moving.rise)
    assert not whole.moving_in_rows().held


def test_a_log_of_three_rows_has_no_jump():
    assert make_run(ROBOT, driven(np.zeros((3, 4)))).jumped.size == 0


def test_windings_are_as_warm_where_a_piece_begins_as_the_log_made_them():
    """The second half of a log that heats its windings, with what was before it and without."""
    coefficient = 0.004
    effect = HiddenEffect("winding_heating", {"coefficient": coefficient}).as_dict()
    case = TruthCase(seed=6, runs=1, run_duration_s=10.0, base_offset_sd=0.0, effects=(effect,))
    [log] = logs_of(case)
    half = len(log.t_s) // 2
    values = ROBOT.believed.copy()
    values[list(ROBOT.place("winding_heating", "coefficient", None))] = coefficient
    noise = tune_noise(ROBOT, [make_run(ROBOT, log)], values)

    def heat(run):
        [track] = track_all(ROBOT, [run], values, noise)
        return track.log_likelihood

    later = {name: column[half:] for name, column in log.columns.items()}
    warm, cold = make_run(ROBOT, log, half), make_run(ROBOT, Log("run", log.t_s[half:], later))
    assert heat(warm) > heat(cold) + 100.0
