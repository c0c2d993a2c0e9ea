"""The virtual robot whose firmware runs through the drivers on the virtual LF2407A."""

import json
import math
import threading

import pytest
from link_bench import robot, session
from noise import Witness, experiment
from omnislip.link import protocol
from omnislip.link.drive import drive
from omnislip.link.record import Recorder
from omnislip.log_file import read_log
from omnislip.scenario import Scenario
from omnislip.virtual_robot import STORE_WORDS, VirtualLine
from served_robot import serve_robot
from throughput import measure

# The SCI divides 40 MHz by 8 * 43; its peer has 115200 baud.
BOARD_BYTES_PER_S = 40e6 / (8 * 43) / 10
PEER_BYTES_PER_S = 115200 / 10
SEND_BUFFER_BYTES = 128


def board_session(store=None):
    return session(VirtualLine(robot(store, on_board=True)))


def programme(*velocity, duration_s):
    return Scenario(
        "test", duration_s, None, [{"t_s": 0.0, "kind": "velocity", "value": list(velocity)}]
    )


def driven(talk):
    talk.watch_status()
    drive(talk, programme(0.8, 0.3, 1.0, duration_s=1.5))
    return talk.line.robot.truth["pose"]


def test_it_is_the_same_robot():
    """The same drive ends where the stub's does; tests/loop/test_board.py bounds the difference."""
    on_board, on_stub = driven(board_session()), driven(session())
    assert math.dist(on_board[:2], on_stub[:2]) < 2e-3
    assert abs(on_board[2] - on_stub[2]) < 2e-3
    assert on_board != on_stub


@pytest.mark.parametrize("on_board", [False, True])
def test_a_full_line_carries_what_its_bit_time_allows(on_board):
    """The board's carries 0.94 % more than 115200 baud: BRR = 42 makes 116279.

    An answer waits for a full send buffer, its own bytes and those of the request, and two ticks.
    """
    bytes_per_s, longest_s = measure(on_board, 2.0)
    expected = BOARD_BYTES_PER_S if on_board else PEER_BYTES_PER_S
    assert bytes_per_s == pytest.approx(expected, abs=1.0)
    assert longest_s < (SEND_BUFFER_BYTES + 20) / PEER_BYTES_PER_S + 0.002


def test_a_byte_reaches_the_firmware_after_its_ten_bits():
    """A request of n bytes is answered by the first tick after n bytes' time, not before."""
    board = robot(on_board=True)
    talk = session(VirtualLine(board))
    frame = protocol.DELIMITER + protocol.encode_request("identify", 77, {}, b"")
    ticks_of_line = math.ceil(1000 * len(frame) / PEER_BYTES_PER_S)
    assert ticks_of_line >= 1
    answers = [board.advance(1, frame)]
    answers += [board.advance(1, b"") for _ in range(ticks_of_line + 10)]
    first = next(k for k, came in enumerate(answers) if came)
    assert first == ticks_of_line
    assert talk.broken_frames == 0


def test_parameters_outlive_it_in_the_eeprom_and_both_kinds_read_it():
    parameter = protocol.find_parameter("speed_gain")
    talk = board_session()
    talk.request("parameter_set", id=parameter.id, value=6554)
    talk.request("parameters_save")
    talk.listen(4.0)
    kept = talk.line.robot.store
    assert len(kept) == STORE_WORDS and talk.line.robot.store_writes > 0
    for on_board in (False, True):
        again = session(VirtualLine(robot(kept, on_board)))
        assert again.request("parameter_get", id=parameter.id)["value"] == 6554


def test_robots_do_not_disturb_each_other_whatever_thread_they_are_used_from():
    """The drivers' state is that of a thread; each board has one of its own."""
    alone = driven(board_session())
    first, second = board_session(), board_session()
    second.watch_status()
    ends = {}
    threads = [
        threading.Thread(target=lambda name=name, talk=talk: ends.update({name: driven(talk)}))
        for name, talk in (("first", first), ("second", board_session()))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert ends == {"first": alone, "second": alone}
    assert second.fresh_status().state == "IDLE"


def test_one_byte_in_a_hundred_wrong():
    """Framing and CRC meet a real SCI's bytes: nothing wrong is done, nothing is lost unseen."""
    witness = Witness(on_board=True)
    figures = experiment(VirtualLine(witness), witness, 10.0)
    assert figures["damaged_bytes"] > 100 and figures["robot"]["bad_frames"] > 0
    assert figures["commands_held"] > 0.5 * figures["commands_offered"]
    assert figures["commands_held_and_never_offered"] == 0 and figures["commands_in_order"]
    assert figures["parameters_set"] > 0 and figures["parameters_wrong"] == 0
    received, missing = figures["record_frames_received"], figures["record_frames_missing"]
    assert figures["record_frames_sent"] - 20 <= received + missing <= figures["record_frames_sent"]


def test_a_recording_is_complete():
    talk = board_session()
    recorder = Recorder(talk, 200)
    recorder.start()
    drive(talk, programme(0.5, 0.0, 0.0, duration_s=1.0))
    log, account = recorder.finish("run")
    assert account.missing == 0
    assert len(log.t_s) > 180
    assert abs(log.columns["wheel/1/current_a"]).max() > 0.1


def test_in_real_time_on_a_serial_port(omnislip, tmp_path):
    """The commands of the user, by pyserial, and the firmware's own count of late ticks."""
    served = serve_robot(tmp_path, "--on-board")
    scenario = tmp_path / "drive.toml"
    scenario.write_text(
        "[scenario]\nduration_s = 1.5\n[[command]]\nt_s = 0.0\nvelocity = [0.5, 0.0, 0.0]\n"
    )
    out = tmp_path / "run.csv"
    ended = omnislip("link", served.port, "drive", scenario, "--out", out, "--json")
    info = omnislip("link", served.port, "info", "--json")
    status, output, errors = served.end()
    assert ended.status == 0, ended.stderr
    account = json.loads(ended.stdout)
    assert account["frames"]["missing"] == 0 and account["drive"]["timeouts"] == 0
    log = read_log(out, "robot")
    assert log.columns["wheel/1/encoder_counts"].max() > 100
    found = json.loads(info.stdout)["status"]
    assert found["state"] == "IDLE" and found["fault"] == "NONE"
    assert found["counters"]["bytes_lost"] == 0
    assert (status, errors) == (0, "")
    assert "after " in output
