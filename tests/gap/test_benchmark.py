"""The benchmark scores what it finds against what was hidden, and resumes where it was."""

import json
import math
from dataclasses import asdict

import pandas as pd
import pytest
from omnislip import compute
from omnislip.errors import InputError
from omnislip.gap import baselines, benchmark, find
from omnislip.gap.benchmark import ERROR, RESULTS, SIZES, Task, run_benchmark, score, solve, tasks
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import EFFECTS, UNKNOWN_EFFECTS, HiddenEffect


def truth(*effects, curve="atan"):
    """Truth of a case: effects as (name, wheel, sizes)."""
    return {
        "effects": [HiddenEffect(n, s, w).as_dict() for n, w, s in effects],
        "also_true": [] if curve == "atan" else ["contact_shape"],
        "friction_curve": curve,
        "closed_loop": False,
        "excitation": "rich",
        "sensors": ["gyro", "pose"],
        "expected_verdict": "effect_found" if effects else "no_gap",
    }


def answer(*effects, verdict="effect_found", rivals=()):
    """gap.json of an answer: named effects with a value for each parameter, +-10 %."""
    named = [
        {
            "name": n,
            "wheel": w,
            "parameters": {
                k: {"value": v, "low": v - 0.1 * abs(v), "high": v + 0.1 * abs(v)}
                for k, v in sizes.items()
            },
            "rivals": [{"name": name, "wheel": None} for name in rivals],
        }
        for n, w, sizes in effects
    ]
    return {"verdict": verdict, "effects": named, "unknown": [], "nearest": []}


LOAD, DRAG = ("payload", None, {"mass_kg": 3.0}), ("body_drag", None, {"coefficient_n_s_m": 2.0})
CURVE = ("contact_shape", None, {"blend": 0.4})


def test_right_name_is_right_and_its_size_is_compared():
    row = score(truth(("payload", None, {"mass_kg": 3.3})), answer(LOAD))
    assert row["first"] and row["exact"] and row["in_set"] == [True]
    [size] = row["sizes"]
    assert size["error"] == pytest.approx(0.3 / 3.3) and size["inside"]


def test_the_size_of_a_scale_is_what_it_lacks_to_one():
    row = score(
        truth(("weak_motor", 2, {"scale": 0.9})), answer(("weak_motor", 2, {"scale": 0.91}))
    )
    assert row["sizes"][0]["error"] == pytest.approx(0.1)


def test_a_phase_goes_round():
    def wave(phase_rad):
        return ("cogging", None, {"phase_rad": phase_rad})

    [size] = score(truth(wave(3.1)), answer(wave(-3.1)))["sizes"]
    assert size["error"] == pytest.approx((2 * math.pi - 6.2) / 3.1) and size["inside"]


@pytest.mark.parametrize(
    "named, first, exact",
    [
        ([DRAG], False, False),
        ([LOAD, DRAG], True, False),
        ([DRAG, LOAD], False, False),
        ([LOAD], True, True),
        ([], False, False),
    ],
)
def test_first_name_and_exact_set(named, first, exact):
    row = score(truth(LOAD), answer(*named))
    assert (row["first"], row["exact"]) == (first, exact)


def test_a_friction_curve_may_be_found_besides_where_there_is_one():
    assert score(truth(LOAD, curve="tanh"), answer(CURVE, LOAD))["exact"]
    assert not score(truth(LOAD), answer(LOAD, CURVE))["exact"]


def test_the_right_effect_on_the_wrong_wheel_is_wrong():
    hidden = truth(("weak_motor", 2, {"scale": 0.9}))
    row = score(hidden, answer(("weak_motor", 3, {"scale": 0.9})))
    assert not row["exact"] and row["wheel"] is False


def test_of_two_effects_of_a_wheel_both_must_be_on_theirs():
    two = [("weak_motor", 2, {"scale": 0.9}), ("roller_drag", 1, {"torque_nm": 0.1})]
    moved = [two[0], ("roller_drag", 4, {"torque_nm": 0.1})]
    assert score(truth(*two), answer(*two))["wheel"] is True
    assert score(truth(*two), answer(*moved))["wheel"] is False
    assert score(truth(*two), answer(two[0]))["wheel"] is True


def test_a_rival_is_inside_the_set():
    row = score(truth(LOAD), answer(DRAG, rivals=["payload"]))
    assert row["in_set"] == [True] and row["set_size"] == [2] and not row["exact"]


@pytest.mark.parametrize("found, right", [(answer(verdict="no_gap"), True), (answer(LOAD), False)])
def test_nothing_hidden_is_right_when_nothing_is_named(found, right):
    assert score(truth(), found)["exact"] == right


def test_a_push_counts_when_its_time_is_right():
    push = {"time_s": 2.0, "impulse_x_n_s": 3.0}
    hidden = truth() | {"effects": [HiddenEffect("impact", push, None, "run_02").as_dict()]}
    for late_s, in_time in ((0.01, 1), (0.02, 0)):
        found = answer(("impact", None, push | {"time_s": 2.0 + late_s}))
        found["effects"][0]["run"] = "run_02"
        assert score(hidden, found)["impacts"] == {"in_time": in_time, "hidden": 1, "found": 1}


def test_every_effect_is_hidden_somewhere_in_the_full_set():
    hidden = {e["name"] for task in tasks("sealed", "full") for e in task.case.effects}
    assert hidden >= set(EFFECTS) | set(UNKNOWN_EFFECTS)


def test_sets_share_no_seed_and_smaller_sizes_are_parts():
    names = {size: [t.name for t in tasks("development", size)] for size in SIZES}
    assert set(names["tiny"]) < set(names["small"]) < set(names["full"])
    seeds = [{t.case.seed for t in tasks(which, "full")} for which in ("development", "sealed")]
    assert not seeds[0] & seeds[1]


def short(kind, name, seed, effects=()):
    """Return a task of two runs, too short to be answered: cheap."""
    return Task(name, kind, TruthCase(seed=seed, effects=effects, runs=2, run_duration_s=1.0))


def without_times(rows):
    return [row | {"time_s": None} for row in rows]


def test_results_are_the_same_on_a_cluster_and_when_a_worker_dies(
    tmp_path, scheduler, kill_a_worker
):
    def kill_early(done, _total):
        if done == 1:
            kill_a_worker()

    payload = HiddenEffect("payload", {"mass_kg": 5.0}).as_dict()
    chosen = [short("null", f"null_{seed}", seed) for seed in range(3)]
    chosen.append(short("single", "single_payload", 3, (payload,)))
    local, cluster = tmp_path / "local", tmp_path / "cluster"
    rows = run_benchmark(local, chosen, None, kill_early)
    assert without_times(rows) == without_times(
        run_benchmark(cluster, chosen, scheduler, lambda *_: None)
    )
    assert [(row["name"], row["verdict"], row["hidden"]) for row in rows] == [
        *((f"null_{seed}", "insufficient_data", []) for seed in range(3)),
        ("single_payload", "insufficient_data", ["payload"]),
    ]
    assert list(pd.read_parquet(local / RESULTS)["time_s"]) == [row["time_s"] for row in rows]
    for name in ("run_01.csv", "run_02.csv", "robot.toml", "truth.json", "gap.json"):
        path = f"single_payload/{name}"
        assert (local / path).read_bytes() == (cluster / path).read_bytes()
    assert json.loads((local / "single_payload" / "result.json").read_text()) == rows[3]
    # The same rows with the same times, with no scheduler that answers: nothing is computed again.
    assert run_benchmark(local, chosen, "tcp://127.0.0.1:1", lambda *_: None) == rows


@pytest.mark.parametrize(("scale", "visible"), [(0.9, True), (0.9999, False)])
def test_what_refused_logs_show_is_told_by_the_oracle(scale, visible, monkeypatch):
    """A gate that wrongly refuses logs which show a weak motor is no way out."""
    monkeypatch.setattr(find, "too_little", lambda *_: "nobody drives so")
    motor = HiddenEffect("weak_motor", {"scale": scale}, 2).as_dict()
    case = TruthCase(seed=3, effects=(motor,), runs=2, run_duration_s=3.0)
    row = solve(asdict(Task("refused", "single", case))).result
    assert row["verdict"] == "insufficient_data" and row["error"] is None
    assert (row["lambda"] >= benchmark.VISIBLE) == visible
    assert row["gap_closed"] is None and row["workflow: replay_error"] is None


def in_this_process(function, cases, _marks, _scheduler):
    for name, case in cases.items():
        yield name, function(case)


def test_a_case_that_raises_is_a_row_and_is_tried_again(tmp_path, monkeypatch):
    find_gap = benchmark.find_gap

    def broken_by_run_02(model, logs, progress):
        if "run_02" in {log.stem for log in logs}:
            raise ZeroDivisionError("the filter\nhas no gain")
        return find_gap(model, logs, progress)

    monkeypatch.setattr(compute, "_computed", in_this_process)
    monkeypatch.setattr(benchmark, "find_gap", broken_by_run_02)
    motor = HiddenEffect("weak_motor", {"scale": 0.9}, 2).as_dict()
    chosen = [short("single", "bad", 1, (motor,)), short("null", "bad_null", 1)]
    chosen.append(Task("good", "null", TruthCase(seed=1, runs=1, run_duration_s=1.0)))
    rows = run_benchmark(tmp_path, chosen, None, lambda *_: None)
    assert [row["verdict"] for row in rows] == ["failed", "failed", "insufficient_data"]
    assert [row["error"] for row in rows] == ["ZeroDivisionError: has no gain"] * 2 + [None]
    assert all(row.keys() == rows[2].keys() for row in rows)
    for row in rows[:2]:
        assert not row["first"] and not row["exact"]
    assert rows[0]["recall"] == [False] and rows[0]["wheel"] is False
    written = [sorted(path.name for path in (tmp_path / n).iterdir()) for n in ("bad", "good")]
    logs = ["result.json", "robot.toml", "run_01.csv"]
    assert written == [
        [ERROR, *logs, "run_02.csv", "truth.json"],
        ["gap.json", *logs, "truth.json"],
    ]
    assert "Traceback" in (tmp_path / "bad" / ERROR).read_text()

    monkeypatch.setattr(benchmark, "find_gap", find_gap)
    finished = []
    rows = run_benchmark(tmp_path, chosen, None, lambda done, _total: finished.append(done))
    assert finished == [1, 2, 3]
    assert [row["verdict"] for row in rows] == ["insufficient_data"] * 3
    assert not (tmp_path / "bad" / ERROR).exists()


def test_a_missing_package_is_the_fault_of_the_machine(tmp_path, monkeypatch):
    def no_package(*_):
        raise ImportError("pysindy")

    monkeypatch.setattr(benchmark, "find_gap", no_package)
    with pytest.raises(ImportError):
        solve(asdict(short("null", "null", 1)))
    monkeypatch.setattr(baselines, "find_spec", lambda _: None)
    with pytest.raises(InputError, match="pip install pysindy"):
        run_benchmark(tmp_path, [], None, lambda *_: None)
