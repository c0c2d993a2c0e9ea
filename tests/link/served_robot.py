"""A virtual robot in real time in a process of its own."""

import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

START_TIME_S = 60.0


@dataclass(frozen=True)
class Served:
    """A running `omnislip robot`: its process, its port, and how it has ended."""

    process: subprocess.Popen
    port: Path
    said: str

    def end(self, how=signal.SIGINT):
        self.process.send_signal(how)
        output, errors = self.process.communicate(timeout=START_TIME_S)
        return self.process.returncode, self.said + output, errors


def serve_robot(folder, *words):
    """Start `omnislip robot`, its port linked to in `folder`; returns when it says where it is."""
    port = folder / "port"
    command = [sys.executable, "-m", "omnislip.cli", "robot", "--port-link", str(port)]
    process = subprocess.Popen(
        [*command, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    until_s = time.monotonic() + START_TIME_S
    while not port.is_symlink() and process.poll() is None:
        assert time.monotonic() < until_s
        time.sleep(0.02)
    return Served(process, port, process.stdout.readline())
