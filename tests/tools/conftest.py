"""Shared fixtures: files to spoil, and the command line run in this process."""

import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from omnislip import cli
from omnislip.model_file import NOMINAL_ROBOT


@dataclass(frozen=True)
class Ended:
    """What a run of the command line left behind."""

    status: int
    stdout: str
    stderr: str


@pytest.fixture
def omnislip(monkeypatch, capsys):
    """Run the command line with the given words; returns Ended."""

    def run(*words: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["omnislip", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return Ended(ended.value.code, captured.out, captured.err)

    return run


@pytest.fixture
def robot_text() -> str:
    return NOMINAL_ROBOT.read_text()


@pytest.fixture
def write(tmp_path):
    """Write a text file into the folder of the test; returns its path."""

    def write_file(name: str, text: str) -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_file


@pytest.fixture
def locked_folder(tmp_path):
    """A path below a file, where no folder can be made, whoever the user is."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "folder"
