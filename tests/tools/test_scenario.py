"""Scenario files: commands and impulses as the simulation takes them; every mistake named."""

from pathlib import Path

import pytest
from omnislip import scenario as scenario_module
from omnislip.errors import InputError
from omnislip.scenario import Sensors, read_scenario

SHIPPED = sorted((Path(scenario_module.__file__).parent / "scenarios").glob("*.toml"))
GOOD = """[scenario]
duration_s = 2.0
controller = "plain"
seed = 3
[log]
rate_hz = 100
pose_rate_hz = 20
[sensors]
gyro_bias_rad_s = -0.01
pose_delay_s = 0.05
encoder_start_counts = [0, 0.5, 100, 65535]
[[command]]
t_s = 0.0
velocity = [1.0, 0.0, 0.5]
[[command]]
t_s = 0.5
pose = [1.0, 2.0, 0.1]
arrival_velocity = [0.1, 0.0, 0.0]
[[command]]
t_s = 1.0
duty = [0.1, -0.1, 0.1, -0.1]
[[command]]
t_s = 1.5
stop = true
[[impact]]
x_m = 0.3
impulse_y_n_s = 5.0
"""


def test_a_scenario_becomes_commands_and_impulses(write):
    scenario = read_scenario(write("drive.toml", GOOD))
    assert scenario.name == "drive"
    assert not scenario.slip_compensation
    assert (scenario.rate_hz, scenario.pose_rate_hz, scenario.seed) == (100, 20, 3)
    assert scenario.sensors == Sensors(
        gyro_bias_rad_s=-0.01, pose_delay_s=0.05, encoder_start_counts=(0.0, 0.5, 100.0, 65535.0)
    )
    assert scenario.commands == [
        {"t_s": 0.0, "kind": "velocity", "value": [1.0, 0.0, 0.5]},
        {"t_s": 0.5, "kind": "pose", "value": [1.0, 2.0, 0.1, 0.1, 0.0, 0.0]},
        {"t_s": 1.0, "kind": "duty", "value": [0.1, -0.1, 0.1, -0.1]},
        {"t_s": 1.5, "kind": "stop", "value": []},
    ]
    [impulse] = scenario.impulses
    assert impulse == {
        "x_m": 0.3,
        "impulse_x_n_s": 0.0,
        "impulse_y_n_s": 5.0,
        "impulse_theta_n_m_s": 0.0,
    }


def test_robot_file_is_found_beside_the_scenario(write, robot_text):
    write("heavy.toml", robot_text.replace("mass_kg = 20.0", "mass_kg = 30.0"))
    text = GOOD.replace("[scenario]\n", '[scenario]\nrobot = "heavy.toml"\n')
    assert read_scenario(write("drive.toml", text)).model.values["robot.mass_kg"] == 30.0


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_scenario_reads(path):
    assert read_scenario(path).name == path.stem


MISTAKES = {
    "unknown table": ("[log]", "[logs]", ["logs", "'log'"]),
    "unknown key": ("seed = 3", "sed = 3", ["sed", "'seed'"]),
    "no duration": ("duration_s = 2.0\n", "", ["missing", "scenario.duration_s"]),
    "endless": ("duration_s = 2.0", "duration_s = 1e9", ["scenario.duration_s", "600"]),
    "no time at all": ("duration_s = 2.0", "duration_s = 0", ["scenario.duration_s"]),
    "controller": ('"plain"', '"pid"', ["scenario.controller", "slip, plain"]),
    "seed": ("seed = 3", "seed = -1", ["scenario.seed", "whole number"]),
    "robot": ("seed = 3", 'robot = "none.toml"', ["none.toml", "cannot be read"]),
    "robot as number": ("seed = 3", "robot = 3", ["scenario.robot", "text"]),
    "log rate": ("rate_hz = 100", "rate_hz = 300", ["log.rate_hz", "1000"]),
    "pose rate": ("pose_rate_hz = 20", "pose_rate_hz = 30", ["log.pose_rate_hz", "100"]),
    "sensor": ("gyro_bias_rad_s", "gyro_bias_deg_s", ["gyro_bias_rad_s"]),
    "sensor range": ("pose_delay_s = 0.05", "pose_delay_s = -1", ["sensors.pose_delay_s", "0 to"]),
    "encoder starts": ("[0, 0.5, 100, 65535]", "[0, 0.5]", ["encoder_start_counts", "4 numbers"]),
    "encoder start": ("65535]", "65536]", ["encoder_start_counts", "0 to 65535, not 65536"]),
    "command time": ("t_s = 0.5", "t_s = 1.7", ["[[command]]", "order"]),
    "command without time": ("t_s = 0.0\nvelocity", "velocity", ["command 1: t_s"]),
    "two commands": ("stop = true", "stop = true\nduty = [0, 0, 0, 0]", ["command 4", "one of"]),
    "no command": ("stop = true", "", ["command 4", "velocity, pose, duty, stop"]),
    "false stop": ("stop = true", "stop = false", ["command 4", "true"]),
    "short velocity": ("[1.0, 0.0, 0.5]", "[1.0, 0.0]", ["command 1: velocity", "3 numbers"]),
    "duty range": ("[0.1, -0.1, 0.1, -0.1]", "[2, 0, 0, 0]", ["command 3: duty", "-1 to 1"]),
    "arrival without pose": ("stop = true", "stop = true\narrival_velocity = [0, 0, 0]", ["pose"]),
    "command table": ("[[command]]\nt_s = 0.0", "[command]\nt_s = 0.0", ["not valid TOML"]),
    "impact nowhere": ("x_m = 0.3\n", "", ["impact 1", "t_s, x_m"]),
    "impact twice": ("x_m = 0.3", "x_m = 0.3\nt_s = 1.0", ["impact 1", "exactly one"]),
    "impact without force": ("impulse_y_n_s = 5.0\n", "", ["impact 1", "impulse_x_n_s"]),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_mistake_is_named(case, write):
    old, new, words = MISTAKES[case]
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        read_scenario(write("drive.toml", GOOD.replace(old, new, 1)))
    message = str(caught.value)
    assert [word for word in words if word not in message] == []
    assert "\n" not in message


def test_a_scenario_needs_a_robot(write):
    write("axis.toml", '[model]\nkind = "axis"\n[axis]\nmass_kg = 1.0\ninput_gain_n_v = 2.0\n')
    text = GOOD.replace("seed = 3", 'robot = "axis.toml"')
    with pytest.raises(InputError, match="kind 'robot'"):
        read_scenario(write("drive.toml", text))
