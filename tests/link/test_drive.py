"""Driving a scenario over the link: what is sent, how it ends, and the whole circle."""

import math

import pytest
from link_bench import MODEL, session
from omnislip.errors import InputError, RobotError
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.link import protocol
from omnislip.link.drive import drive, to_request
from omnislip.link.record import Recorder
from omnislip.log_file import write_log
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import Scenario, read_scenario
from omnislip.virtual_robot import VirtualLine, make_robot

IDENTIFICATION = NOMINAL_ROBOT.parents[1] / "scenarios" / "identification.toml"


def scenario(*commands, duration_s=2.0, **more):
    return Scenario("test", duration_s, MODEL, list(commands), **more)


def command(kind, *value, t_s=0.0):
    return {"t_s": t_s, "kind": kind, "value": list(value)}


def watched_session():
    talk = session()
    talk.watch_status()
    return talk


def test_commands_in_the_units_of_the_protocol():
    assert to_request(command("stop")) == ("stop", {})
    assert to_request(command("velocity", 1.5, -0.02, 0.3))[1] == {
        "x_mm_s": 1500,
        "y_mm_s": -20,
        "omega_mrad_s": 300,
    }
    assert list(to_request(command("duty", 1.0, -1.0, 0.5, 0.0))[1].values()) == [
        32767,
        -32768,
        16384,
        0,
    ]
    pose = to_request(command("pose", 1.0, -2.0, 2 * math.pi + 0.5, 0.5, 0.0, -1.0))[1]
    assert list(pose.values()) == [8192000, -16384000, 4096000, 4096, 0, -2048]


@pytest.mark.parametrize(
    "wrong",
    [
        command("velocity", 40.0, 0, 0),
        command("pose", 1, 0, 0, 9, 0, 0),
    ],
)
def test_commands_that_do_not_fit_are_bad_input(wrong):
    with pytest.raises(InputError, match=f"command at 0 s: {wrong['kind']}"):
        to_request(wrong)


def test_a_velocity_is_driven():
    talk = watched_session()
    driven = drive(talk, scenario(command("velocity", 1.0, 0.0, 0.0), command("stop", t_s=1.9)))
    x_m, y_m, _ = talk.line.robot.truth["pose"]
    assert 1.0 < x_m < 1.9 and abs(y_m) < 0.01
    assert driven.commands == driven.answered >= 40
    assert driven.timeouts == 0
    assert talk.fresh_status().state == "IDLE"


def test_a_pose_is_reached():
    talk = watched_session()
    drive(talk, scenario(command("pose", 0.5, 0.5, 0.3, 0.0, 0.0, 0.0), duration_s=4.0))
    x_m, y_m, theta_rad = talk.line.robot.truth["pose"]
    assert math.dist((x_m, y_m), (0.5, 0.5)) < 0.01
    assert abs(theta_rad - 0.3) < 0.02


def test_the_controller_is_that_of_the_scenario_and_as_before_afterwards():
    talk = watched_session()
    id_ = protocol.PARAMETERS["slip_compensation"].id
    seen = set()
    drive(
        talk,
        scenario(command("velocity", 0.1, 0.0, 0.0), slip_compensation=False),
        lambda _: seen.add(talk.line.robot.parameters[id_]),
    )
    assert seen == {0}
    assert talk.line.robot.parameters[id_] == 1


def test_a_robot_in_fault_is_not_driven():
    talk = session(VirtualLine(make_robot(read_model(NOMINAL_ROBOT), [0x1234] * 512)))
    assert talk.watch_status().fault == "STORE"
    with pytest.raises(RobotError, match="in state FAULT, last fault STORE; 'clear-fault'"):
        drive(talk, scenario(command("stop")))


def test_a_fault_ends_the_drive_with_its_name():
    """With a limit of four counts a tick the robot takes itself for faster than it can be."""
    talk = watched_session()
    limit = protocol.find_parameter("encoder_step_limit")
    talk.request("parameter_set", id=limit.id, value=4)
    with pytest.raises(RobotError, match=r"faster than a shaft can.*FAULT, last fault ENC"):
        drive(talk, scenario(command("duty", 0.3, 0.3, 0.3, 0.3)))
    assert talk.fresh_status().state == "FAULT"


def test_an_exception_stops_the_robot():
    talk = watched_session()

    def interrupt(_text):
        if talk.line.time_s() > 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(talk, scenario(command("velocity", 1.0, 0.0, 0.0)), interrupt)
    assert talk.fresh_status().state == "IDLE"


def test_a_robot_that_is_heard_no_more_ends_the_drive():
    talk = watched_session()
    write = talk.line.write

    def write_until(data):
        if talk.line.time_s() < 1.0:
            write(data)

    talk.line.write = write_until
    with pytest.raises(RobotError, match="has not answered for 1 s"):
        drive(talk, scenario(command("velocity", 1.0, 0.0, 0.0), duration_s=5.0))
    talk.line.write = write
    assert talk.fresh_status().fault == "COMMAND_TIMEOUT"  # it has stopped by itself


def test_the_whole_circle(tmp_path):
    """A robot with a weak motor is driven and recorded over its line; the gap names the motor."""
    weak = tmp_path / "weak.toml"
    weak.write_text(
        NOMINAL_ROBOT.read_text() + "\n[[effects.weak_motor]]\nwheel = 3\nscale = 0.8\n"
    )
    line = VirtualLine(make_robot(read_model(weak)))
    talk = session(line)
    logs = []
    for number in range(3):
        recorder = Recorder(talk, 200)
        recorder.start()
        drive(talk, read_scenario(IDENTIFICATION))
        log, account = recorder.finish(f"run_{number}")
        assert account.missing == 0
        logs.append(tmp_path / f"run_{number}.csv")
        write_log(log, logs[-1])
    found = to_json(find_gap(NOMINAL_ROBOT, logs, lambda _: None))
    assert found["verdict"] == "effect_found", found["sentence"]
    (named,) = found["effects"]
    assert (named["name"], named["wheel"]) == ("weak_motor", 3)
    scale = named["parameters"]["scale"]
    assert scale["low"] - 0.005 < 0.8 < scale["high"] + 0.005
