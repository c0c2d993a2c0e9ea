"""From frames to a log: closed forms, wraps, gaps; and against the robot itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_bench import NoisyLine, robot, session
from omnislip.errors import InputError, RobotError
from omnislip.link.record import SIGNALS, Recorder, make_log, period_of
from omnislip.log_file import read_log, write_log
from omnislip.virtual_robot import VirtualLine

PERIOD_MS = 5


def frames(count, period_ms=PERIOD_MS, start_ms=0, start_sum=0, current_ma=0):
    """Sequences and rows of `count` frames: duty of wheel i is a ramp of i a tick, Q15."""
    k = np.arange(count)
    time_ms = start_ms + k * period_ms
    ticks = k * period_ms
    rows = {"time_ms": time_ms % 2**32}
    for wheel in range(1, 5):
        rows[f"duty_sum_{wheel}_q15"] = (start_sum + wheel * ticks * (ticks - 1) // 2) % 2**32
        rows[f"counts_{wheel}"] = k * 1000 * wheel % 2**16
        rows[f"current_{wheel}_ma"] = np.full(count, current_ma * wheel)
    rows["supply_mv"] = 24000 - k
    return k % 256, np.stack([rows[name] for name in SIGNALS], axis=1)


def test_columns_have_their_units():
    log, gaps = make_log("x", *frames(100, current_ma=150), PERIOD_MS)
    assert gaps == []
    np.testing.assert_allclose(log.t_s, np.arange(99) * 0.005)
    # Mean of the ramp over the five ticks of a row: its value two ticks later.
    expected = 3 * (np.arange(99) * 5 + 2) / 2**15
    np.testing.assert_allclose(log.columns["wheel/3/duty"], expected)
    np.testing.assert_array_equal(
        log.columns["wheel/2/encoder_counts"], np.arange(99) * 2000 % 2**16
    )
    np.testing.assert_allclose(log.columns["supply/voltage_v"], 24 - np.arange(99) / 1000)
    np.testing.assert_allclose(log.columns["wheel/4/current_a"], 0.6)


def test_a_robot_without_current_sensors_has_no_currents_in_its_log():
    log, _ = make_log("x", *frames(10), PERIOD_MS)
    assert not any("current" in name for name in log.columns)


def test_wraps_of_time_and_sums_are_not_seen():
    plain, _ = make_log("x", *frames(1000), PERIOD_MS)
    wrapping, gaps = make_log(
        "x", *frames(1000, start_ms=2**32 - 700, start_sum=2**32 - 5), PERIOD_MS
    )
    assert gaps == []
    np.testing.assert_array_equal(plain.t_s, wrapping.t_s)
    np.testing.assert_array_equal(plain.columns["wheel/1/duty"], wrapping.columns["wheel/1/duty"])


@given(st.sets(st.integers(1, 1998), max_size=600))
def test_lost_frames_are_missing_rows_and_the_rest_is_exact(lost):
    kept = np.array([k for k in range(2000) if k not in lost])
    sequences, rows = frames(2000)
    log, gaps = make_log("x", sequences[kept], rows[kept], PERIOD_MS)
    assert sum(count for _, count in gaps) == len(lost)
    np.testing.assert_allclose(log.t_s, kept[:-1] * 0.005)
    middle = (kept[:-1] + kept[1:]) * 5 / 2 - 0.5  # of the ticks up to the next row
    np.testing.assert_allclose(log.columns["wheel/1/duty"], middle / 2**15)


@given(st.integers(0, 5000), st.integers(-2, 2))
def test_gaps_longer_than_a_round_of_the_sequence_are_counted(length, late_ms):
    sequences, rows = frames(10000)
    kept = np.r_[0:10, 10 + length : 20 + length]
    rows = rows[kept].copy()
    rows[10:, 0] += late_ms  # a frame may have waited for space
    log, gaps = make_log("x", sequences[kept], rows, PERIOD_MS)
    assert gaps == ([(log.t_s[9], length)] if length else [])


def test_rates_that_the_line_cannot_carry_are_refused():
    assert period_of(200) == 5
    for rate in (0, 3, 250, 1000):
        with pytest.raises(InputError, match="must divide 1000 and fit the line"):
            period_of(rate)


# ---- with the robot ----


def drive_and_record(line, rate_hz=200, duration_s=2.0):
    talk = session(line)
    recorder = Recorder(talk, rate_hz)
    recorder.start()
    talk.request("arm")
    begin_s = talk.line.time_s()
    while talk.line.time_s() < begin_s + duration_s:
        talk.offer("duty", 0.05, duty_1_q15=900, duty_2_q15=900, duty_3_q15=-900, duty_4_q15=-900)
        talk.listen(0.05)
    return recorder.finish("run")


def test_a_recording_is_a_log_that_reads_back(tmp_path):
    log, account = drive_and_record(VirtualLine(robot()))
    assert account.missing == 0
    write_log(log, tmp_path / "run.csv")
    read = read_log(tmp_path / "run.csv", "robot")
    assert len(read.t_s) == account.received - 1
    assert np.diff(read.t_s).max() < 0.007
    driven = read.columns["wheel/1/duty"][read.t_s > 0.5]
    np.testing.assert_allclose(driven[:-2], 900 / 2**15, atol=1e-9)
    assert read.columns["supply/voltage_v"].min() > 20


def test_damage_leaves_the_rows_that_came_untouched():
    clean, _ = drive_and_record(VirtualLine(robot()))
    noisy, account = drive_and_record(NoisyLine(VirtualLine(robot()), 0.005, seed=3))
    assert account.missing > 20
    assert account.lost_on_line == account.missing
    counts = noisy.columns["wheel/1/encoder_counts"]
    speed = np.diff((counts[-200:] + 2**15) % 2**16) / np.diff(noisy.t_s[-200:])
    end = np.diff((clean.columns["wheel/1/encoder_counts"][-200:] + 2**15) % 2**16)
    assert abs(np.median(speed) - np.median(end) / 0.005) < 0.02 * abs(np.median(speed))


def test_two_streams_that_overfill_the_line_are_told_apart_from_damage():
    talk = session()
    recorder = Recorder(talk, 200)
    recorder.start()
    names = [f"pose_{axis}_q13" for axis in ("x_mm", "y_mm", "theta_mrad")]
    talk.open_stream(1, 5, [*names, *names], lambda *_: None)
    talk.listen(3.0)
    talk.close_stream(1)
    _, account = recorder.finish("run")
    assert account.missing > 50
    assert account.received + account.missing > 590
    assert talk.broken_frames == 0


def test_too_little_for_a_log():
    recorder = Recorder(session(), 200)
    recorder.start()
    with pytest.raises(RobotError, match="not enough for a log"):
        recorder.finish("run")


def test_a_frame_whose_time_and_sequence_disagree_is_not_taken():
    """Damage passes the CRC once in 2^16 times."""
    recorder = Recorder(session(), 200)
    sequences, rows = frames(20)
    for k, (sequence, row) in enumerate(zip(sequences.tolist(), rows.tolist(), strict=True)):
        spoilt = [row[0] ^ (1 << 20 if k == 7 else 0), *row[1:]]
        recorder._take(sequence + 40 * (k == 12), dict(zip(SIGNALS, spoilt, strict=True)))
    assert recorder.rows == 18


def test_a_robot_that_starts_anew_ends_the_recording():
    line = VirtualLine(robot())
    talk = session(line)
    recorder = Recorder(talk, 200)
    recorder.start()
    talk.listen(1.0)
    fresh = session(VirtualLine(robot()))
    line.robot = fresh.line.robot
    Recorder(fresh, 200).start()
    with pytest.raises(RobotError, match="started anew"):
        talk.listen(1.0)
