"""Requests, answers, events and streams of a session, with a robot that is hard to reach."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_bench import NoisyLine, robot, session
from omnislip.errors import RobotError
from omnislip.link import protocol
from omnislip.link.session import NoAnswer, Refused, Session
from omnislip.virtual_robot import VirtualLine


class Wrapped:
    """A line whose bytes to the robot or back can be changed by the test."""

    def __init__(self, out=lambda data: data, back=lambda data: data):
        self.line = VirtualLine(robot())
        self.out, self.back = out, back

    def write(self, data):
        self.line.write(self.out(data))

    def read(self, timeout_s):
        return self.back(self.line.read(timeout_s))

    def time_s(self):
        return self.line.time_s()


class EveryOther:
    """Loses every other call's bytes."""

    def __init__(self):
        self.calls = 0

    def __call__(self, data):
        self.calls += bool(data)
        return b"" if self.calls % 2 and data else data


def test_identity():
    identity = Session(VirtualLine(robot())).connect()
    assert identity.reset_cause == "POWER_ON"
    assert identity.store_status == "BLANK"


def test_status_and_events():
    talk = session()
    assert talk.watch_status().state == "IDLE"
    talk.request("arm")
    assert talk.fresh_status().state == "ARMED"
    assert [event.name for event in talk.events] == ["boot", "state", "state"]
    assert str(talk.events[-1]).endswith("state ARMED, fault NONE, fault_wheel 0")


def limits_told(acceleration_m_s2, velocity):
    """What a robot tells of its limits in the first four seconds of a velocity."""
    talk = session()
    for name, value in (("acceleration_limit", acceleration_m_s2), ("speed_limit", 3.9)):
        parameter = protocol.find_parameter(name)
        talk.request("parameter_set", id=parameter.id, value=parameter.raw(value))
    talk.request("arm")
    for _ in range(40):
        talk.request("velocity", **velocity)
        talk.listen(0.1)
    return [str(event).split(" s: ")[1] for event in talk.events if event.name == "limit"]


def test_each_limit_is_told_by_its_name():
    """A demand that wheel 3 has to carry beyond the grip; a speed beyond what 24 V turn, and one
    beyond the speed limit."""
    turning = {"x_mm_s": 1000, "y_mm_s": -300, "omega_mrad_s": 1000}
    assert limits_told(30.0, turning)[0] == "limited by: traction, wheel 3"
    straight = {"x_mm_s": 1000, "y_mm_s": 0, "omega_mrad_s": 0}
    assert limits_told(1.0, straight) == ["limited by: acceleration", "not limited"]
    fast = {"x_mm_s": 3000, "y_mm_s": -2500, "omega_mrad_s": 0}
    told = limits_told(2.0, fast)
    assert "limited by: voltage, wheel 3" in told
    assert "limited by: speed" in limits_told(
        2.0, {"x_mm_s": 0, "y_mm_s": 0, "omega_mrad_s": 12000}
    )


def test_a_request_is_repeated_until_it_is_answered():
    talk = session(Wrapped(out=EveryOther()))
    parameter = protocol.find_parameter("position_gain")
    talk.request("parameter_set", id=parameter.id, value=1234)
    assert talk.request("parameter_get", id=parameter.id)["value"] == 1234
    assert talk.counters.repeated > 0
    assert talk.counters.unanswered == 0


def test_a_repeated_request_is_carried_out_once():
    """A save writes some words; repeated for want of an answer it writes no more."""
    clean, deaf = Wrapped(), Wrapped()
    for line in (clean, deaf):
        talk = session(line)
        lose = iter([b""] * 3 if line is deaf else [])
        line.back = lambda data, lose=lose: next(lose, data) if data else data
        talk.request("parameters_save")
        assert (talk.counters.repeated > 0) == (line is deaf)
        talk.listen(2.0)
        assert talk.watch_status().store_status == "SAVED"
    assert clean.line.robot.store_writes == deaf.line.robot.store_writes > 60


def test_refusals_say_why():
    talk = session()
    with pytest.raises(Refused, match="'velocity': the state of the robot does not allow it"):
        talk.request("velocity", x_mm_s=1, y_mm_s=0, omega_mrad_s=0)
    with pytest.raises(Refused, match="a value out of its limits"):
        talk.request("parameter_set", id=0, value=-32768)
    with pytest.raises(Refused, match="no such parameter"):
        talk.request("parameter_get", id=255)


def test_no_robot():
    with pytest.raises(RobotError, match="no answer: is the robot on"):
        session(Wrapped(out=lambda data: b""))


def test_a_robot_that_goes_silent():
    line = Wrapped()
    talk = session(line)
    line.back = lambda data: b""
    with pytest.raises(NoAnswer, match="no answer to 'arm'"):
        talk.request("arm")
    assert not talk.offer("stop", 0.05)
    assert talk.counters.unanswered == 2


class Foreign:
    """A robot of another protocol version answers as link.h says: nothing but the version."""

    def __init__(self):
        self.came = b""

    def write(self, data):
        self.came = protocol.encode_frame(bytes([9, protocol.ANSWER, 1, 1, 1]))

    def read(self, timeout_s):
        came, self.came = self.came, b""
        return came

    def time_s(self):
        return 0.0


def test_another_protocol_version():
    with pytest.raises(RobotError, match=r"protocol version 9, this program 1"):
        session(Foreign())


@pytest.mark.parametrize("table", ["parameter_table", "signal_table"])
def test_another_table(table, monkeypatch):
    monkeypatch.setattr(protocol, table, lambda: 0x1234)
    with pytest.raises(RobotError, match=r"is another one \(.*h, here 1234h\)"):
        session()


def test_streams_of_an_older_host_are_not_taken_for_ours():
    line = VirtualLine(robot())
    older = session(line)
    older.open_stream(0, 5, ["supply_mv", "counts_1"], lambda *_: None)
    newer = Session(line)
    newer.connect()
    taken = []
    newer.open_stream(0, 10, ["counts_2", "mode"], lambda _, raw: taken.append(raw))
    newer.listen(0.2)
    assert len(taken) > 15
    assert all(raw == {"counts_2": 0, "mode": 0} for raw in taken)


def test_missing_samples_are_counted():
    line = Wrapped()
    talk = session(line)
    taken = []
    talk.open_stream(1, 10, ["time_ms"], lambda _, raw: taken.append(raw["time_ms"]))
    talk.listen(0.5)
    line.back = lambda data: b""
    talk.listen(0.305)
    line.back = lambda data: data
    talk.listen(0.5)
    expected = (taken[-1] - taken[0]) // 10 + 1 - len(taken)
    assert 28 <= talk.counters.samples_missing == expected <= 32


@given(st.integers(0, 2**32), st.floats(0.0, 0.05))
def test_whatever_the_damage_parameters_are_read_right(seed, probability):
    line = NoisyLine(VirtualLine(robot()), probability, seed)
    talk = Session(line)
    try:
        talk.connect()
        for id_ in (0, 30, 61):
            found = talk.request("parameter_get", id=id_)["value"]
            assert found == list(protocol.PARAMETERS.values())[id_].default
    except NoAnswer:
        assert probability > 0.02
    except RobotError as error:
        assert "no answer" in str(error)
