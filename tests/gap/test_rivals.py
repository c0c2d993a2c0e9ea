"""What stands in the place of an effect where that is likelier."""

from types import SimpleNamespace

import pytest
from axis_bench import silent
from omnislip.gap import rivals as rivals_module
from omnislip.gap.rivals import (
    compare_all,
    drop_wandering,
    swap_effects,
    take_likeliest,
    take_one_of_curve,
)
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from truth_bench import lag_named, robot_runs


@pytest.mark.parametrize(
    ("hidden", "named"),
    [
        ("actuation_delay", "driver_lag"),
        ("driver_lag", "armature_inductance"),
        ("driver_lag", "driver_lag"),
    ],
)
def test_the_right_name_has_its_place_at_the_end(tmp_path, hidden, named):
    data, fitted, rivals = lag_named(tmp_path, hidden, named)
    data, found, compared = take_likeliest(data, fitted, rivals, 100, silent)
    assert [effect.effect for effect in found.hypothesis.effects] == [hidden]
    assert found.hypothesis.values_of(0) == pytest.approx([0.0015], rel=0.15)
    assert len(compared) == 1
    assert named == hidden or named in {
        one.hypothesis.effects[-1].name for one in compared[0].rivals
    }


@pytest.mark.parametrize(
    ("tried", "alpha", "named"),
    [(0, 0.01, "driver_lag"), (100, 0.01, "actuation_delay"), (100, 0.0, "driver_lag")],
)
def test_the_newest_effect_gives_way_where_its_choice_compared_it_with_too_few(
    tmp_path, monkeypatch, tried, alpha, named
):
    """Unless what would take its place could be chance among all that was tried."""
    monkeypatch.setattr(rivals_module, "ALPHA", alpha)
    data, fitted, rivals = lag_named(tmp_path, "actuation_delay", "driver_lag")
    found, _ = swap_effects(data, fitted, rivals, silent, tried)
    assert [effect.effect for effect in found.hypothesis.effects] == [named]


@pytest.mark.parametrize(("nats", "named"), [(1.0, "driver_lag"), (1e3, "actuation_delay")])
def test_what_loses_by_the_noise_of_another_takes_its_place_if_likelier_by_its_own(
    tmp_path, monkeypatch, nats, named
):
    """Every rival is near enough to be asked here; likelihoods are given."""
    data, fitted, rivals = lag_named(tmp_path, "driver_lag", "driver_lag")
    of = {"driver_lag": 0.0, "actuation_delay": nats, "armature_inductance": -1.0}

    def given(_data, one):
        return of[one.hypothesis.effects[-1].effect]

    monkeypatch.setattr(rivals_module, "NEARLY", 1.0)
    monkeypatch.setattr(rivals_module, "log_posterior", given)
    before = compare_all(data, fitted, rivals, silent)[0]
    rival_names = [one.hypothesis.effects[-1].effect for one in before.rivals]
    lost = dict(zip(rival_names, before.lost(fitted), strict=True))
    assert lost["actuation_delay"] > 0
    _, found, _ = take_likeliest(data, fitted, rivals, 100, silent)
    assert [effect.effect for effect in found.hypothesis.effects] == [named]


@pytest.mark.parametrize("both", [False, True])
def test_two_that_change_the_curve_stand_for_one_beside_another_curve(tmp_path, both):
    """Unless both are there."""
    curve, hidden = (
        ("atan", ("low_grip", "slip_stiffness_error"))
        if both
        else ("tanh", ("slip_stiffness_error",))
    )
    case = TruthCase(
        seed=508,
        effects=tuple(HiddenEffect(name, {"scale": 1.45}).as_dict() for name in hidden),
        friction_curve=curve,
        excitation="rich",
        runs=2,
        run_duration_s=3.0,
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot)
    start = start.with_effect(candidates["low_grip"], [1.3])
    if both:
        start = start.with_effect(candidates["slip_stiffness_error"], [1.3])
    else:
        start = start.with_effect(candidates["grip_falloff"], [0.3, 0.1])
    _, found = take_one_of_curve(*settle(robot, runs, start), {}, silent)
    expected = set(hidden) if both else {"contact_shape", *hidden}
    assert {effect.effect for effect in found.hypothesis.effects} == expected


@pytest.mark.parametrize(
    ("curve", "hidden", "named"),
    [("rational", None, "contact_shape"), ("atan", {"scale": 0.79}, "low_grip")],
)
def test_grip_alone_gives_way_to_another_law_of_friction(tmp_path, curve, hidden, named):
    """Whose first shape alone explains less; and where grip is lower it stays."""
    effects = (HiddenEffect("low_grip", hidden).as_dict(),) if hidden else ()
    case = TruthCase(
        seed=510,
        effects=effects,
        friction_curve=curve,
        excitation="rich",
        runs=2,
        run_duration_s=3.0,
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["low_grip"], [0.8])
    _, found = take_one_of_curve(*settle(robot, runs, start), {}, silent)
    assert [effect.effect for effect in found.hypothesis.effects] == [named]


def test_a_grip_that_falls_at_once_beside_a_curve_may_be_a_low_grip_beside_another(tmp_path):
    """And a low grip that is right stays."""
    low = HiddenEffect("low_grip", {"scale": 0.75}).as_dict()
    case = TruthCase(seed=509, effects=(low,), friction_curve="brush", excitation="rich", runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    base = believed_hypothesis(robot)
    for name, sizes in (("grip_falloff", [0.23, 0.05]), ("low_grip", [0.75])):
        start = base.with_effect(candidates[name], sizes)
        start = start.with_effect(candidates["contact_shape"], [1.0])
        _, found = take_one_of_curve(*settle(robot, runs, start), {}, silent)
        assert {effect.effect for effect in found.hypothesis.effects} == {
            "contact_shape",
            "low_grip",
        }


@pytest.mark.parametrize(
    ("gain", "inflation", "variation", "stays"),
    [
        (50.0, 5.0, 0.8, False),
        (50.0, 5.0, 0.3, True),
        (50.0, 2.0, 0.8, True),
        (500.0, 5.0, 0.8, True),
    ],
)
def test_a_weak_effect_that_wanders_is_dropped(monkeypatch, gain, inflation, variation, stays):
    """Not one that is a part of what is named, nor one whose change chance makes."""

    def model(*names):
        effects = tuple(SimpleNamespace(effect=name) for name in names)
        return SimpleNamespace(hypothesis=SimpleNamespace(effects=effects))

    def told(gain, inflation=1.0, variation=0.0):
        evidence = SimpleNamespace(gain=gain, inflation=inflation, variation=variation)
        return SimpleNamespace(evidence=evidence, without=model("dead_zone"))

    strong, weak = told(1e4), told(gain, inflation, variation)
    monkeypatch.setattr(rivals_module, "compare_all", lambda *_: [strong])
    both = model("dead_zone", "body_drag")
    final, compared = drop_wandering(None, both, {}, silent, [strong, weak])
    assert (final is both) == stays
    assert len(compared) == 1 + stays
