"""The benchmark scores what it finds against what was hidden, and resumes where it was."""

import json

import pytest
from axis_bench import silent
from omnislip.gap import benchmark
from omnislip.gap.benchmark import TEN, run_benchmark


def answer(*effects, verdict="effect_found"):
    """A stand-in for what to_json returns: named effects with a value for each parameter."""
    named = [
        {"name": n, "wheel": w, "parameters": {k: {"value": v} for k, v in sizes.items()}}
        for n, w, sizes in effects
    ]
    channel = {"believed": 4.0, "refit": 3.0, "after": 1.0, "noise_floor": 1.0}
    return {
        "verdict": verdict,
        "effects": named,
        "gap": {"channels": {"pose/x_m": channel}, "closed_fraction": {"value": 1.0}},
    }


@pytest.fixture
def scored(tmp_path, monkeypatch):
    """Row of the benchmark for a hidden effect and a given answer of the workflow."""

    def score(hidden, found):
        monkeypatch.setattr(benchmark, "find_gap", lambda *_: None)
        monkeypatch.setattr(benchmark, "to_json", lambda _: found)
        monkeypatch.setattr(benchmark, "write_case", write_short)
        [row] = run_benchmark(tmp_path, [hidden], 1, silent)
        return row

    return score


def write_short(case, folder):
    """The truth only; nobody reads the logs."""
    folder.mkdir(parents=True, exist_ok=True)
    return {"effects": [effect.as_dict() for effect in case.hidden()]}


def test_right_name_is_right_and_its_size_is_compared(scored):
    row = scored("payload", answer(("payload", None, {"mass_kg": 3.3})))
    assert row["right"]
    assert row["size_error"] == pytest.approx(0.1, abs=1e-9)
    assert (row["refit_in_floors"], row["after_in_floors"]) == (3.0, 1.0)


def test_wrong_name_is_wrong(scored):
    row = scored("payload", answer(("body_drag", None, {"coefficient_n_s_m": 2.0})))
    assert not row["right"]
    assert row["size_error"] is None


def test_an_extra_effect_is_wrong(scored):
    extra = ("body_drag", None, {"coefficient_n_s_m": 2.0})
    assert not scored("payload", answer(("payload", None, {"mass_kg": 3.0}), extra))["right"]


def test_a_friction_curve_may_be_found_besides(scored):
    """The generator rubs by another curve than the believed one: that is a fair find."""
    curve = ("contact_shape", None, {"blend": 0.4})
    assert scored("payload", answer(("payload", None, {"mass_kg": 3.0}), curve))["right"]


def test_the_right_effect_on_the_wrong_wheel_is_wrong(scored):
    rows = [scored("weak_motor", answer(("weak_motor", w, {"scale": 0.9}))) for w in [None]]
    assert not rows[0]["right"]


@pytest.mark.parametrize(
    "found, right",
    [
        (answer(verdict="no_gap"), True),
        (answer(("payload", None, {"mass_kg": 1.0})), False),
    ],
    ids=["nothing named", "something named"],
)
def test_nothing_hidden_is_right_when_nothing_is_named(found, right, scored):
    assert scored("none", found)["right"] == right


def test_an_unknown_verdict_names_nothing(scored):
    """Something is missing and the workflow does not say what: not right."""
    assert not scored("payload", answer(verdict="unknown_effect"))["right"]


def test_finished_cases_are_read_back(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "find_gap", lambda *_: pytest.fail("was finished"))
    row = {"hidden": "payload", "right": True}
    (tmp_path / "payload_01").mkdir()
    (tmp_path / "payload_01" / "result.json").write_text(json.dumps(row))
    assert run_benchmark(tmp_path, ["payload"], 1, silent) == [row]


def test_the_ten_are_effects_of_the_generator():
    assert len(set(TEN)) == 10
    for name in TEN:
        assert benchmark.typical_effect(name, 2).name == name
