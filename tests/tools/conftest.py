"""Shared fixtures: files to spoil, folders that cannot be made, a cluster."""

from pathlib import Path

import pytest
from omnislip.model_file import NOMINAL_ROBOT


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
