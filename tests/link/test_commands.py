"""The commands of the link, on the pseudo-terminal of a virtual robot in real time."""

import json
import os
import signal

import pytest
from omnislip.link import protocol
from omnislip.log_file import read_log
from omnislip.model_file import NOMINAL_ROBOT
from served_robot import serve_robot

DRIVE = """
[scenario]
duration_s = 1.5
controller = "plain"
[[command]]
t_s = 0.0
velocity = [0.5, 0.0, 0.0]
[[command]]
t_s = 1.0
stop = true
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(DRIVE)
    return path


def test_info(omnislip, port):
    ended = omnislip("link", port, "info")
    assert ended.status == 0
    assert ended.stdout.startswith("protocol 1, on for ")
    assert json.loads(omnislip("link", port, "info", "--json").stdout)["status"]["state"] == "IDLE"


def test_drive_and_record(omnislip, port, scenario, tmp_path):
    out = tmp_path / "run.csv"
    ended = omnislip("link", port, "drive", scenario, "--out", out, "--rate", 100, "--json")
    assert ended.status == 0, ended.stderr
    told = json.loads(ended.stdout)
    log = read_log(out, "robot")
    assert told["rows"] == len(log.t_s) == told["frames"]["received"] - 1
    assert told["frames"]["missing"] == sum(count for _, count in told["frames"]["gaps"])
    assert told["drive"]["answered"] > 10
    assert max(abs(log.columns["wheel/1/duty"])) > 0.01
    info = json.loads(omnislip("link", port, "info", "--json").stdout)
    assert info["status"]["state"] == "IDLE"
    value = json.loads(omnislip("link", port, "get", "slip_compensation", "--json").stdout)
    assert value["parameters"]["slip_compensation"]["raw"] == 1  # as before the drive


def test_record_for_a_time(omnislip, port, tmp_path):
    out = tmp_path / "rest.parquet"
    ended = omnislip("link", port, "record", "--out", out, "--duration", 0.5)
    assert ended.status == 0, ended.stderr
    assert f" rows in {out}: " in ended.stdout
    assert len(read_log(out, "robot").t_s) > 50


def test_set_get_save_load_and_defaults(omnislip, port):
    name = "heading_gain_q20"

    def value():
        return json.loads(omnislip("link", port, "get", name, "--json").stdout)["parameters"][name]

    assert omnislip("link", port, "set", "heading_gain=0.004", "--save").status == 0
    assert value()["value"] == pytest.approx(0.004, abs=1e-6)
    assert omnislip("link", port, "defaults").status == 0
    assert value()["raw"] == 5243
    assert "LOADED" in omnislip("link", port, "load").stdout
    assert value()["value"] == pytest.approx(0.004, abs=1e-6)
    omnislip("link", port, "defaults")
    assert "SAVED" in omnislip("link", port, "save").stdout


def test_set_from_a_model_file(omnislip, port, tmp_path):
    model = tmp_path / "heavy.toml"
    model.write_text(NOMINAL_ROBOT.read_text().replace("mass_kg = 20.0", "mass_kg = 24.0"))
    ended = omnislip("link", port, "set", "--robot", model, "--json")
    assert ended.status == 0, ended.stderr
    assert json.loads(ended.stdout)["parameters"]["mass_q8"]["value"] == 24.0
    omnislip("link", port, "defaults")


def test_get_prints_all_parameters(omnislip, port):
    ended = omnislip("link", port, "get")
    assert ended.status == 0
    heading, *rows = ended.stdout.splitlines()
    assert heading.split() == ["name", "value", "unit", "limits", "default", "is"]
    assert [row.split()[0] for row in rows] == list(protocol.PARAMETERS)


def test_monitor(omnislip, port, tmp_path):
    picture = tmp_path / "run.png"
    ended = omnislip(
        "link", port, "monitor", "--signal", "supply_mv", "--signal", "state", "--duration", 0.6,
        "--plot", picture,
    )  # fmt: skip
    assert ended.status == 0, ended.stderr
    assert "supply_mv" in ended.stdout and "IDLE" in ended.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_monitor_for_machines(omnislip, port):
    ended = omnislip("link", port, "monitor", "--signal", "supply_mv", "--duration", 0.5, "--json")
    rows = [json.loads(line) for line in ended.stdout.splitlines()]
    assert rows and all(set(row) == {"time_ms", "supply_mv"} for row in rows)
    assert rows[0]["supply_mv"] > 20000


def test_stop_and_clear_fault(omnislip, port):
    assert omnislip("link", port, "stop").stdout.startswith("state IDLE")
    assert omnislip("link", port, "clear-fault").stdout.startswith("state IDLE")


BAD_CALLS = {
    "no port": (["{tmp}/none", "info"], "none: cannot be opened as a serial port: No such file"),
    "unknown parameter": (["{port}", "get", "speed_gian_q15"], "did you mean 'speed_gain_q15'"),
    "out of limits": (["{port}", "set", "speed_gain=3"], "speed_gain_q15: must be 0 to 0.99"),
    "no number": (["{port}", "set", "speed_gain=fast"], "must be NAME=VALUE with a number"),
    "nothing to set": (["{port}", "set"], "nothing to set"),
    "unknown signal": (["{port}", "monitor", "--signal", "supply"], "unknown signal 'supply'"),
    "bad rate": (["{port}", "record", "--out", "{tmp}/a.csv", "--rate", "7"], "must divide 1000"),
    "bad log": (["{port}", "record", "--out", "{tmp}/a.txt"], "must end in"),
    "no scenario": (["{port}", "drive", "{tmp}/none.toml"], "none.toml: cannot be read"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_bad_input_is_one_line_and_2(case, omnislip, port, tmp_path):
    words, expected = BAD_CALLS[case]
    ended = omnislip("link", *[word.format(port=port, tmp=tmp_path) for word in words])
    assert ended.status == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("omnislip: error: ") and ended.stderr.count("\n") == 1
    assert expected in ended.stderr


def test_a_port_where_nobody_answers_is_one_line_and_3(omnislip):
    master, slave = os.openpty()
    ended = omnislip("link", os.ttyname(slave), "info")
    os.close(master)
    os.close(slave)
    assert ended.status == 3
    assert ended.stderr.startswith("omnislip: error: no answer: is the robot on")
    assert ended.stderr.count("\n") == 1


COMMANDS = ["info", "monitor", "record", "drive", "get", "set", "save", "load", "defaults", "stop"]


@pytest.mark.parametrize("command", [*COMMANDS, "clear-fault"])
def test_help_has_an_example(command, omnislip):
    ended = omnislip("link", "PORT", command, "--help")
    assert ended.status == 0
    assert f"Example: omnislip link /dev/ttyUSB0 {command}" in ended.stdout


# ---- the process ----


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_the_robot_ends_cleanly(how, tmp_path):
    served = serve_robot(tmp_path)
    status, output, errors = served.end(how)
    assert status == 0
    assert output.startswith(f"robot at {served.port}\nafter ")
    assert errors == ""
    assert not served.port.is_symlink()


def test_the_eeprom_outlives_the_robot(omnislip, tmp_path):
    eeprom = tmp_path / "eeprom"
    served = serve_robot(tmp_path, "--store", eeprom)
    assert omnislip("link", served.port, "set", "speed_gain=0.2", "--save").status == 0
    served.end(signal.SIGKILL)
    served.port.unlink()  # left by a process that could not tidy up
    served = serve_robot(tmp_path, "--store", eeprom)
    ended = omnislip("link", served.port, "get", "speed_gain", "--json")
    info = omnislip("link", served.port, "info", "--json")
    served.end()
    raw = json.loads(ended.stdout)["parameters"]["speed_gain_q15"]["raw"]
    assert raw == round(0.2 * 2**15)
    assert json.loads(info.stdout)["store_status"] == "LOADED"


def test_bad_input_of_the_robot(omnislip, tmp_path):
    short = tmp_path / "short"
    short.write_bytes(b"123")
    ended = omnislip("robot", "--store", short)
    assert ended.status == 2 and "an EEPROM file has 1024 bytes, not 3" in ended.stderr
    there = tmp_path / "there"
    there.write_text("")
    ended = omnislip("robot", "--port-link", there)
    assert ended.status == 2 and "there: no link can be made there" in ended.stderr
    axis = tmp_path / "axis.toml"
    axis.write_text('[model]\nkind = "axis"\ninertia_kg_m2 = 1.0\ninput_gain_nm_v = 1.0\n')
    assert omnislip("robot", "--robot", axis).status == 2
