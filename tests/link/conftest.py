"""A virtual robot that runs as long as the tests."""

import os
import signal

import pytest
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
