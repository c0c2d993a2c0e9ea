"""Many independent cases on Dask: processes of this machine, or a cluster, with the same results.

    outcomes = run_cases(function, {"case_1": {...}, "case_2": {...}}, folder)

`function` is a function of a module that the workers can import; it gets the value of one case,
which JSON can hold, and returns an Outcome; it has one core. What is finished is never lost: the
files of a case are written, then one line to FOLDER/finished.jsonl. A line counts as long as the
case, the function and the program are what they were; the next call computes only what has none.
Workers that die are replaced, or replace themselves, and their cases run elsewhere.
"""

import fcntl
import functools
import hashlib
import itertools
import json
import logging
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import distributed
from distributed.comm import CommClosedError

from omnislip import _core
from omnislip.errors import InputError
from omnislip.files import replace_file

JOURNAL = "finished.jsonl"
# Cases given to the scheduler at a time: enough to keep a large cluster busy, few enough that the
# results waiting to be written fit into memory.
CASES_AHEAD = 1000
CONNECT_TIMEOUT_S = 10
WORKER_TIMEOUT_S = 30


@dataclass(frozen=True)
class Outcome:
    """What a case gave: `result`, which JSON can hold, and contents of files named below `out`."""

    result: dict[str, Any]
    files: dict[str, bytes] = field(default_factory=dict)


def run_cases(
    function: Callable[[Any], Outcome],
    cases: Mapping[str, Any],
    out: Path,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[dict[str, Any]]:
    """Return the result of every case, in the order of `cases`, computing those not yet in `out`.

    `scheduler`: address of a Dask scheduler such as tcp://host:8786; None: one process per core of
    this machine. `progress` gets the number of finished cases and of all, first those found in
    `out`. An exception of `function` ends the work; InputError if the folder, the scheduler or its
    workers cannot be used.
    """
    marks = {name: _fingerprint(function, case) for name, case in cases.items()}
    with _locked_journal(out) as journal:
        results = _read_finished(journal, marks, out)
        progress(len(results), len(cases))
        missing = {name: case for name, case in cases.items() if name not in results}
        for name, outcome in _computed(function, missing, marks, scheduler):
            results[name] = _keep(outcome, name, marks[name], journal, out)
            progress(len(results), len(cases))
    return [results[name] for name in cases]


@functools.cache
def code_version() -> str:
    """Return a hash of this package and of its compiled part: equal hash, equal results."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in [*sorted(package.rglob("*.py")), Path(_core.__file__)]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _fingerprint(function: Callable[[Any], Outcome], case: object) -> str:
    name = f"{function.__module__}.{function.__qualname__}"
    text = json.dumps([name, code_version(), case], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@contextmanager
def _locked_journal(out: Path) -> Iterator[TextIO]:
    """Open the journal for reading and appending; no second run writes to the same folder."""
    path = out / JOURNAL
    try:
        out.mkdir(parents=True, exist_ok=True)
        journal = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
    with journal:
        try:
            fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{out}: another run is writing there; wait for its end") from None
        yield journal


def _read_finished(
    journal: TextIO, marks: Mapping[str, str], out: Path
) -> dict[str, dict[str, Any]]:
    """Return the results that are still those of their cases; the last line of a case counts."""
    journal.seek(0)
    text = journal.read()
    if text and not text.endswith("\n"):
        journal.write("\n")  # the machine stopped in the middle of a line
    finished = {}
    for line in text.splitlines():
        try:
            record = json.loads(line)
        except ValueError:
            continue
        name = record["case"]
        whole = all((out / file).exists() for file in record["files"])
        if marks.get(name) == record["fingerprint"] and whole:
            finished[name] = record["result"]
    return finished


def _keep(outcome: Outcome, name: str, mark: str, journal: TextIO, out: Path) -> dict[str, Any]:
    """Write the files, then the line that says they are whole; return the result as read back."""
    for file, content in outcome.files.items():
        with replace_file(out / file) as temporary:
            temporary.write_bytes(content)
    record = {"case": name, "fingerprint": mark, "files": [*outcome.files]}
    line = json.dumps(record | {"result": outcome.result})
    journal.write(line + "\n")
    journal.flush()
    return json.loads(line)["result"]


def _computed(
    function: Callable[[Any], Outcome],
    cases: Mapping[str, Any],
    marks: Mapping[str, str],
    scheduler: str | None,
) -> Iterator[tuple[str, Outcome]]:
    """Give name and outcome of each case, as they finish."""
    if not cases:
        return
    version = code_version()
    with _client(scheduler, len(cases)) as client:

        def submit(name: str) -> distributed.Future:
            key = f"{name}-{marks[name]}"
            return client.submit(_run_case, function, cases[name], version, key=key)

        waiting = iter(cases)
        running = distributed.as_completed(
            [submit(n) for n in itertools.islice(waiting, CASES_AHEAD)]
        )
        for future in running:
            name = future.key.rpartition("-")[0]
            yield name, _outcome(future, name, scheduler)
            running.update([submit(n) for n in itertools.islice(waiting, 1)])


def _run_case(function: Callable[[Any], Outcome], case: object, version: str) -> Outcome:
    if code_version() != version:
        raise InputError(
            f"worker {distributed.get_worker().address} runs another version of omnislip; "
            "install on all machines the one you start from"
        )
    _core.limit_threads(1)  # the workers already fill the cores
    return function(case)


def _outcome(future: distributed.Future, name: str, scheduler: str | None) -> Outcome:
    again = "what is finished is kept: mend that and repeat the command"
    try:
        return future.result()
    except distributed.KilledWorker:
        raise InputError(f"{name}: every worker that tried it died (memory?); {again}") from None
    except (CommClosedError, distributed.client.FutureCancelledError):
        raise InputError(f"{scheduler}: the scheduler is gone; {again}") from None
    except ImportError as error:
        raise InputError(f"{scheduler}: a worker lacks a package: {error}; {again}") from None


@contextmanager
def _client(scheduler: str | None, case_count: int) -> Iterator[distributed.Client]:
    # Dask logs, with tracebacks, what is reported here in one line or mended by itself.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is None:
        with _local_cluster(case_count) as cluster, distributed.Client(cluster) as client:
            yield client
        return
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError):
        raise InputError(
            f"{scheduler}: no Dask scheduler answers there; 'dask scheduler' starts one and prints "
            "its address, tcp://HOST:8786"
        ) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT_S)
        except TimeoutError:
            raise InputError(
                f"{scheduler}: the scheduler has no workers; 'dask worker {scheduler}' adds one"
            ) from None
        yield client


def _local_cluster(case_count: int) -> distributed.LocalCluster:
    # Ctrl-C goes to every process of the terminal. The workers, which inherit that it is ignored,
    # leave the ending to this one; the price is that it goes unheard in the second they take to
    # start.
    at_interrupt = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return distributed.LocalCluster(
            n_workers=min(len(os.sched_getaffinity(0)), case_count),
            threads_per_worker=1,
            dashboard_address="127.0.0.1:0",
            memory_limit=None,
            silence_logs=logging.CRITICAL,  # of the processes it starts
        )
    finally:
        signal.signal(signal.SIGINT, at_interrupt)
