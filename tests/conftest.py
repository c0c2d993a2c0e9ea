"""Settings, clusters and the command line in this process, for all Python tests."""

import io
import os
import signal
import sys
from typing import NamedTuple

import psutil
import pytest
from hypothesis import settings
from omnislip import cli

# Threads of the linear algebra would wait for each other where two test programs share the cores,
# and take three times as long. Read when numpy is first imported, which nothing above does.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# No deadline: the machine may be busy. The same examples every time: a result can be repeated.
settings.register_profile("omnislip", deadline=None, derandomize=True)
settings.load_profile("omnislip")


@pytest.fixture(scope="session")
def scheduler():
    """Address of a cluster that somebody else has started."""
    import distributed  # imports numpy

    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    )
    with cluster:
        yield cluster.scheduler_address


@pytest.fixture
def kill_a_worker():
    """Kill one process of the cluster that run_cases has started here."""

    def kill() -> None:
        below = psutil.Process().children(recursive=True)
        workers = [process for process in below if "spawn_main" in " ".join(process.cmdline())]
        os.kill(workers[-1].pid, signal.SIGKILL)

    return kill


class Ended(NamedTuple):
    """What a run of the command line left behind."""

    status: int
    stdout: str
    stderr: str


@pytest.fixture
def omnislip(monkeypatch, capsys):
    """Run the command line with the given words, and what is typed into it; returns Ended."""

    def run(*words, typed=""):
        monkeypatch.setattr(sys, "argv", ["omnislip", *map(str, words)])
        monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
        with pytest.raises(SystemExit) as ended:
            cli.main()
        captured = capsys.readouterr()
        return Ended(ended.value.code, captured.out, captured.err)

    return run
