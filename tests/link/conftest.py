"""A virtual robot that runs as long as the tests, and the command line in this process."""

import os
import signal
import sys
from dataclasses import dataclass

import pytest
from omnislip import cli
from served_robot import serve_robot


@pytest.fixture(scope="session")
def port(tmp_path_factory):
    """The port of a virtual robot that runs as long as the tests."""
    folder = tmp_path_factory.mktemp("robot")
    served = serve_robot(folder, "--store", folder / "eeprom")
    assert served.process.poll() is None, served.process.stderr.read()
    yield served.port
    os.kill(served.process.pid, signal.SIGKILL)
    served.process.communicate()


@dataclass(frozen=True)
class Ended:
    """What a run of the command line left behind."""

    status: int
    stdout: str
    stderr: str


@pytest.fixture
def omnislip(monkeypatch, capsys):
    """Run the command line with the given words; returns Ended."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["omnislip", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return Ended(ended.value.code, captured.out, captured.err)

    return run
