"""The command line: what it prints where, and how it ends."""

import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pandas as pd
import pytest
from mcap.reader import make_reader

REPOSITORY = Path(__file__).resolve().parents[2]
SHORT = "[scenario]\nduration_s = 0.5\n[[command]]\nt_s = 0.0\nvelocity = [0.5, 0.0, 0.0]\n"


def files_below(path: Path) -> list[str]:
    return sorted(str(item.relative_to(path)) for item in path.rglob("*"))


@pytest.fixture
def short(write):
    return write("short.toml", SHORT)


def test_simulate_writes_log_and_figure(omnislip, short, tmp_path):
    log, figure = tmp_path / "out" / "run.csv", tmp_path / "out" / "run.png"
    ended = omnislip("simulate", short, "--out", log, "--plot", figure)
    assert ended.status == 0
    assert f"100 rows in {log}" in ended.stdout
    assert log.read_text().startswith("t_s,wheel/1/duty,")
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_simulate_json(omnislip, short, tmp_path):
    ended = omnislip("simulate", short, "--out", tmp_path / "run.parquet", "--json")
    result = json.loads(ended.stdout)
    assert result["rows"] == 100
    assert result["log"] == str(tmp_path / "run.parquet")
    assert 0 < result["final_pose"]["x_m"] < 0.25


def test_simulate_writes_mcap_with_the_truth(omnislip, short, tmp_path):
    assert omnislip("simulate", short, "--out", tmp_path / "run.mcap").status == 0
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    topics = {channel.topic for channel in summary.channels.values()}
    assert {"/wheel/1", "/gyro", "/tf", "/truth/pose", "/truth/wheel/4"} <= topics
    # 100 rows of 5 ms; the camera shows every fourth.
    counts = {
        channel.topic: summary.statistics.channel_message_counts[channel.id]
        for channel in summary.channels.values()
    }
    assert (counts["/wheel/1"], counts["/pose"]) == (100, 25)


@pytest.mark.parametrize("suffix", [".mcap", ".parquet"])
def test_export(suffix, omnislip, short, tmp_path):
    log, out = tmp_path / "run.csv", tmp_path / f"out{suffix}"
    omnislip("simulate", short, "--out", log)
    ended = omnislip("export", log, out)
    assert (ended.status, ended.stdout) == (0, f"100 rows in {out}\n")
    assert out.stat().st_size > 1000


SWEEP = '[sweep]\nkind = "grid"\n[vary]\nrobot.mass_kg = [18.0, 22.0]\n'


def test_sweep(omnislip, short, write, tmp_path):
    sweep, out = write("sweep.toml", SWEEP), tmp_path / "out"
    ended = omnislip("simulate", short, "--sweep", sweep, "--out", out)
    assert ended.status == 0
    assert f"2 cases in {out}" in ended.stdout
    assert pd.read_parquet(out / "summary.parquet")["robot.mass_kg"].tolist() == [18.0, 22.0]
    result = json.loads(
        omnislip("simulate", short, "--sweep", sweep, "--out", out, "--json").stdout
    )
    assert result == {"cases": 2, "failed": 0, "summary": str(out / "summary.parquet")}


def test_import_emps_without_data(omnislip, tmp_path):
    out = tmp_path / "out"
    ended = omnislip("import", "emps", "--data", tmp_path, "--out", out)
    assert ended.status == 2
    assert ended.stderr.count("\n") == 1
    assert "tools/fetch-data" in ended.stderr
    assert not out.exists()


BAD_CALLS = {
    "no scenario": (["simulate", "none.toml", "--out", "run.csv"], "none.toml: cannot be read"),
    "bad log name": (["simulate", "short.toml", "--out", "run.txt"], ".csv, .parquet or .mcap"),
    "bad figure name": (
        ["simulate", "short.toml", "--out", "run.csv", "--plot", "run.gif"],
        "run.gif: a figure must end in",
    ),
    "bad scenario": (["simulate", "bad.toml", "--out", "run.csv"], "bad.toml: unknown table"),
    "bad sweep": (
        ["simulate", "short.toml", "--sweep", "bad.toml", "--out", "out"],
        "bad.toml: unknown table 'scene'",
    ),
    "scheduler alone": (
        ["simulate", "short.toml", "--scheduler", "tcp://127.0.0.1:1", "--out", "run.csv"],
        "--scheduler: goes with --sweep",
    ),
    "figure of a sweep": (
        ["simulate", "short.toml", "--sweep", "bad.toml", "--plot", "run.png", "--out", "out"],
        "--plot: goes with a single run",
    ),
    "sweep into a file": (
        ["simulate", "short.toml", "--sweep", "bad.toml", "--out", "file/out"],
        "file/out: cannot write there",
    ),
    "export of no log": (["export", "short.toml", "run.mcap"], "short.toml: a log file must end"),
    "export to no log": (["export", "run.csv", "run.txt"], ".csv, .parquet or .mcap"),
    "spoilt log": (["export", "spoilt.csv", "run.mcap"], r"column 'wheel\x00\x1b[2J'"),
    "locked log": (["simulate", "short.toml", "--out", "file/run.csv"], "file/run.csv: cannot"),
    "locked folder": (["paper", "--out", "file/folder"], "file/folder: folder cannot be made"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_bad_input_is_one_line_and_leaves_nothing(case, omnislip, short, write, monkeypatch):
    words, expected = BAD_CALLS[case]
    write("bad.toml", SHORT.replace("[scenario]", "[scene]"))
    write("file", "")
    write("spoilt.csv", "t_s,wheel\0\x1b[2J\n0.0,1.0\n")
    monkeypatch.chdir(short.parent)
    before = files_below(short.parent)
    ended = omnislip(*words)
    assert ended.status == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("omnislip: error: ")
    assert ended.stderr.count("\n") == 1
    assert expected in ended.stderr
    assert files_below(short.parent) == before


COMMANDS = [[], ["simulate"], ["export"], ["paper"], ["import"], ["import", "emps"], ["gap"]]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_is_there_and_leaf_commands_give_an_example(command, omnislip):
    ended = omnislip(*command, "--help")
    assert ended.status == 0
    leaf = command in (["simulate"], ["export"], ["paper"], ["import", "emps"])
    assert ("Example: omnislip " + " ".join(command) in ended.stdout) == leaf


WRONG_USAGE = {
    ("fly",): "No such command 'fly'; see ",
    ("simulate", "square.toml"): "Missing option '--out'; see ",
    ("gap", "find", "--robto", "robot.toml"): "No such option: --robto",
    ("gap", "find", "--robot", "robot.toml", "--out", "gap"): "Missing argument 'logs'; see ",
    ("gap", "plan", "--robot", "x", "--out", "y", "--room-m", "0.1"): "'--room-m'",
    ("gap", "benchmark", "--out", "x", "--size", "huge"): "'--size'",
}


@pytest.mark.parametrize("command", WRONG_USAGE, ids=" ".join)
def test_wrong_usage_is_one_line_that_says_what_and_where_to_look(command, omnislip):
    ended = omnislip(*command)
    assert ended.status == 2
    [line] = ended.stderr.splitlines()
    assert line.startswith("omnislip: error: ")
    assert WRONG_USAGE[command] in line and line.endswith(" --help")


def test_version_is_that_of_the_package(omnislip):
    ended = omnislip("--version")
    assert (ended.status, ended.stdout) == (0, f"omnislip {metadata.version('omnislip')}\n")


def test_a_command_without_arguments_shows_its_help(omnislip):
    ended = omnislip("gap")
    assert ended.status == 2
    assert "evaluate" in ended.stdout + ended.stderr


def test_no_color_is_honoured():
    command = [sys.executable, "-m", "omnislip.cli", "--help"]
    colour = {"FORCE_COLOR": "1", "PATH": "/usr/bin:/bin"}
    plain = subprocess.run(command, env=colour | {"NO_COLOR": "1"}, capture_output=True, check=True)
    assert b"\x1b[3" not in plain.stdout
    assert b"Usage" in plain.stdout


def test_fetch_data_says_when_it_cannot_fetch(tmp_path):
    # A proxy that is not there stands for a missing network.
    command = [sys.executable, REPOSITORY / "tools" / "fetch-data", tmp_path]
    ended = subprocess.run(
        command, env={"https_proxy": "http://127.0.0.1:9"}, capture_output=True, text=True
    )
    assert ended.returncode == 1
    assert "fetch-data: error: cannot fetch https://" in ended.stderr.splitlines()[-1]
    assert files_below(tmp_path) == []
