"""Cases on Dask: the same results whoever computes them, and nothing lost when a worker dies."""

import json
import os
import signal
import sys
from pathlib import Path

import cloudpickle
import distributed
import pytest
from omnislip.compute import JOURNAL, Outcome, run_cases
from omnislip.errors import InputError

# The workers cannot import this file: its functions travel as they are.
cloudpickle.register_pickle_by_value(sys.modules[__name__])


def double(case: dict) -> Outcome:
    """Double a number, and leave a mark of having been computed."""
    with Path(case["seen"]).open("a") as seen:
        seen.write(f"{case['number']}\n")
    if case.get("dies_once") and not Path(case["dies_once"]).exists():
        Path(case["dies_once"]).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if case.get("fails"):
        raise RuntimeError("a defect")
    twice = 2 * case["number"]
    return Outcome({"twice": twice, "third": case["number"] / 3}, {f"{twice}.txt": b"%d" % twice})


def cases(folder: Path, count: int = 6, **last: object) -> dict[str, dict]:
    made = {f"case-{i}": {"number": i, "seen": str(folder / "seen.txt")} for i in range(count)}
    made[f"case-{count - 1}"] |= last
    return made


def computed(folder: Path) -> list[int]:
    """Return the numbers of the cases computed so far, and forget them."""
    seen = folder / "seen.txt"
    numbers = sorted(int(line) for line in seen.read_text().split()) if seen.exists() else []
    seen.unlink(missing_ok=True)
    return numbers


EXPECTED = [{"twice": 2 * number, "third": number / 3} for number in range(6)]


@pytest.mark.parametrize("where", ["local", "cluster"])
def test_a_killed_worker_loses_nothing(where, tmp_path, scheduler):
    address = {"local": None, "cluster": scheduler}[where]
    dying = cases(tmp_path, dies_once=str(tmp_path / "died"))
    steps = []
    out = tmp_path / "out"
    results = run_cases(double, dying, out, address, lambda *step: steps.append(step))
    assert (tmp_path / "died").exists()
    assert results == EXPECTED
    assert [(out / f"{2 * n}.txt").read_bytes() for n in range(6)] == [
        b"%d" % (2 * n) for n in range(6)
    ]
    assert steps == [(done, 6) for done in range(7)]


def test_only_what_is_missing_is_computed(tmp_path, scheduler):
    out = tmp_path / "out"
    run_cases(double, cases(tmp_path, 4), out, scheduler)
    assert computed(tmp_path) == [0, 1, 2, 3]
    # Without a scheduler that answers: nothing is left to do.
    assert run_cases(double, cases(tmp_path, 4), out, "tcp://127.0.0.1:1") == EXPECTED[:4]
    assert run_cases(double, cases(tmp_path, 6), out, scheduler) == EXPECTED
    assert computed(tmp_path) == [4, 5]


def test_a_changed_case_and_a_lost_file_are_computed_again(tmp_path, scheduler):
    out = tmp_path / "out"
    run_cases(double, cases(tmp_path), out, scheduler)
    computed(tmp_path)
    (out / "4.txt").unlink()
    results = run_cases(double, cases(tmp_path, number=9), out, scheduler)
    assert computed(tmp_path) == [2, 9]
    assert results == [*EXPECTED[:5], {"twice": 18, "third": 3.0}]


def test_a_line_cut_off_by_a_crash_is_computed_again(tmp_path, scheduler):
    out = tmp_path / "out"
    run_cases(double, cases(tmp_path), out, scheduler)
    lines = (out / JOURNAL).read_text().splitlines(keepends=True)
    cut = json.loads(lines[-1])["case"]
    (out / JOURNAL).write_text("".join(lines)[:-9])
    computed(tmp_path)
    for _ in range(2):
        assert run_cases(double, cases(tmp_path), out, scheduler) == EXPECTED
    assert computed(tmp_path) == [int(cut.removeprefix("case-"))]


def test_a_defect_ends_the_work_and_keeps_what_was_finished(tmp_path, scheduler):
    out = tmp_path / "out"
    with pytest.raises(RuntimeError, match="a defect"):
        run_cases(double, cases(tmp_path, fails=True), out, scheduler)
    lines = (out / JOURNAL).read_text().splitlines()
    kept = {int(json.loads(line)["case"].removeprefix("case-")) for line in lines}
    computed(tmp_path)
    assert run_cases(double, cases(tmp_path), out, scheduler) == EXPECTED
    assert kept.isdisjoint(computed(tmp_path))


def test_what_cannot_be_used_is_named(tmp_path, locked_folder, monkeypatch):
    monkeypatch.setattr("omnislip.compute.CONNECT_TIMEOUT_S", 0.5)
    monkeypatch.setattr("omnislip.compute.WORKER_TIMEOUT_S", 0.5)
    some = cases(tmp_path)
    with pytest.raises(InputError, match=r"tcp://127.0.0.1:1: no Dask scheduler answers"):
        run_cases(double, some, tmp_path / "out", "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="nonsense: no Dask scheduler"):
        run_cases(double, some, tmp_path / "out", "nonsense")
    with pytest.raises(InputError, match=r"finished\.jsonl: cannot be written"):
        run_cases(double, some, locked_folder)
    idle = distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0")
    with idle, pytest.raises(InputError, match="the scheduler has no workers"):
        run_cases(double, some, tmp_path / "out", idle.scheduler_address)


def test_two_runs_do_not_write_to_one_folder(tmp_path, scheduler):
    out = tmp_path / "out"

    def start_another(done: int, total: int) -> None:
        with pytest.raises(InputError, match="another run is writing there"):
            run_cases(double, cases(tmp_path), out, scheduler)

    run_cases(double, cases(tmp_path), out, scheduler, start_another)


def test_a_worker_with_another_version_is_refused(tmp_path, scheduler, monkeypatch):
    monkeypatch.setattr("omnislip.compute.code_version", lambda: "of another machine")
    with pytest.raises(InputError, match="runs another version of omnislip"):
        run_cases(double, cases(tmp_path), tmp_path / "out", scheduler)
