"""`gap find` from files to verdict: on robot logs of the independent generator, and on axis logs.

Robot cases are short (five runs of four seconds): a guard for the whole path. How often the ten
effects are found is measured by `omnislip gap benchmark`, not here.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from axis_bench import Bench, make_log, model_text, silent
from omnislip.errors import InputError
from omnislip.gap import find
from omnislip.gap.find import (
    find_gap,
    split_runs,
    to_json,
    usable_runs,
    weak_names,
    write_results,
)
from omnislip.gap.inference import Evidence
from omnislip.gap.leftover import Shape
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import Closed, Left
from omnislip.gap.plan import Manoeuvre, Separation
from omnislip.gap.selected import Selected
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import HiddenEffect, typical_effect
from omnislip.log_file import POSE_COLUMNS, Log, write_log
from omnislip.model_file import NOMINAL_ROBOT, read_model

AXIS_BENCH = Bench(coulomb_n=2.0)
ROBOT = Machine(read_model(NOMINAL_ROBOT))


def robot_case(folder, *effects, drop=(), **case):
    """Model file and logs with hidden effects, without columns that begin with `drop`."""
    hidden = tuple(effect.as_dict() for effect in effects)
    write_case(TruthCase(seed=7, effects=hidden, runs=5, run_duration_s=4.0, **case), folder)
    logs = sorted(folder.glob("run_*.csv"))
    for path in logs:
        frame = pd.read_csv(path)
        frame[[c for c in frame.columns if not c.startswith(tuple(drop))]].to_csv(path, index=False)
    return folder / "robot.toml", logs


BY_FAR = Evidence(1e6, 60.0, 0.1, np.eye(1), 0.0)


def selected(name, gain, inflation=1.0, variation=0.0, left=0.0):
    candidate = next(c for c in ROBOT.candidates() if c.effect == name)
    evidence = Evidence(gain, inflation, 0.0, np.eye(1), variation)
    return Selected(candidate, np.ones(1), np.ones((1, 2)), evidence, (), 1.0, left)


def verdict_of(
    effects, left=(), jolts=False, feigned_gain=0.0, table=None, trials=(), keys_at_ends=0
):
    """Verdict where without a table replays are as near as can be.

    `left` is the gain of a leftover term and what of it the shapes of effects cover.
    """
    keys = ROBOT.base_parameters()
    x = np.array([p.high if i < keys_at_ends else (p.low + p.high) / 2 for i, p in enumerate(keys)])
    hypothesis = SimpleNamespace(base=keys, parameters=keys, x=x)
    left = [SimpleNamespace(gain=left[0], inflation=1.0, covered=left[1])] if left else []
    runs = [SimpleNamespace(row_s=0.005)]
    data = SimpleNamespace(feigned_gain=feigned_gain, machine=ROBOT, runs=runs)
    final = SimpleNamespace(hypothesis=hypothesis)
    outcome = SimpleNamespace(
        selected=effects, leftover=left, trials=trials, data=data, final=final
    )
    table = table or SimpleNamespace(left=Left(0.0, 1.0), closed=Closed(1.0, 0.9, 1.1))
    return find._verdict(outcome, table, False, [], jolts)


@pytest.mark.parametrize(
    ("covered", "verdict"), [(600.0, "effect_found"), (400.0, "unknown_effect")]
)
def test_names_that_leave_a_part_of_the_gap_are_not_given(covered, verdict):
    assert verdict_of([selected("coulomb_friction", 1e5)], (500.0, covered)) == verdict


@pytest.mark.parametrize(
    ("gain", "nameless", "inflation", "verdict"),
    [
        (1000.0, 1050.0, 1.0, "effect_found"),
        (1000.0, 1200.0, 1.0, "unknown_effect"),
        (1000.0, 1200.0, 5.0, "effect_found"),
        (100.0, 140.0, 1.0, "effect_found"),
        (1000.0, None, 1.0, "effect_found"),
    ],
)
def test_a_name_is_not_given_where_a_nameless_term_explains_more(
    gain, nameless, inflation, verdict
):
    instead = Shape("every wheel/torque", "speed to the fifth", nameless) if nameless else None
    one = replace(selected("quadratic_wheel_drag", gain, inflation), instead=instead)
    assert verdict_of([one]) == verdict


@pytest.mark.parametrize(("gain", "verdict"), [(60.0, "no_gap"), (150.0, "unknown_effect")])
def test_a_small_rest_is_what_rows_hide(gain, verdict):
    assert verdict_of([], (gain, 0.0)) == verdict


def test_a_rest_that_a_controller_may_feign_is_none():
    assert verdict_of([], (150.0, 0.0), feigned_gain=200.0) == "no_gap"


@pytest.mark.parametrize(
    ("source", "excess", "error", "verdict"),
    [
        ("repeated manoeuvres", 0.4, 0.1, "no_gap"),
        ("repeated manoeuvres", 1.0, 0.1, "unknown_effect"),
        ("repeated manoeuvres", 1.0, 0.5, "no_gap"),
        ("the predictor's noise", 20.0, 0.1, "no_gap"),
        ("the predictor's noise", 30.0, 0.1, "unknown_effect"),
        ("the predictor's noise", 30.0, 20.0, "unknown_effect"),
        ("the predictor's noise", 30.0, np.inf, "no_gap"),
    ],
)
def test_held_out_runs_far_off_are_no_gap_to_pass_over(source, excess, error, verdict):
    left, closed = Left(excess, error), Closed(None, None, None)
    assert (
        verdict_of([], table=SimpleNamespace(left=left, closed=closed, floor_source=source))
        == verdict
    )


@pytest.mark.parametrize(
    ("excess", "error", "high", "verdict"),
    [
        (0.4, 0.1, 0.5, "effect_found"),
        (2.0, 0.5, 0.5, "unknown_effect"),
        (2.0, 1.9, 0.5, "unknown_effect"),
        (2.0, 2.1, 0.5, "effect_found"),
        (50.0, 60.0, 0.5, "unknown_effect"),
        (50.0, 40.0, 0.95, "effect_found"),
    ],
)
def test_names_that_do_not_bring_held_out_runs_nearer_are_not_given(excess, error, high, verdict):
    table = SimpleNamespace(left=Left(excess, error), closed=Closed(high - 0.2, -0.2, high))
    assert verdict_of([selected("coulomb_friction", 1e5)], table=table) == verdict


@pytest.mark.parametrize("error, verdict", [(1.9, "effect_found"), (0.5, "unknown_effect")])
def test_a_friction_law_that_leaves_something_is_the_usual_case(error, verdict):
    table = SimpleNamespace(left=Left(2.0, error), closed=Closed(0.3, -0.2, 0.5))
    assert verdict_of([selected("contact_shape", 1e5)], table=table) == verdict


@pytest.mark.parametrize(
    ("gain", "feigned_gain", "named", "verdict"),
    [
        (300.0, 0.0, 0.0, "unknown_effect"),
        (150.0, 0.0, 0.0, "no_gap"),
        (300.0, 400.0, 0.0, "no_gap"),
        (300.0, 0.0, 1e5, "effect_found"),
    ],
)
def test_what_is_refused_is_something_where_it_gains_more_than_anything_feigns(
    gain, feigned_gain, named, verdict
):
    evidence = Evidence(gain, 1.0, 0.0, np.eye(1), 0.0)
    refused = SimpleNamespace(
        step=1,
        accepted=False,
        checked=True,
        validation_gain=-1.0,
        evidence=evidence,
        candidate=SimpleNamespace(effect="coulomb_friction"),
        chance=0.0,
    )
    effects = [selected("coulomb_friction", named)] if named else []
    assert verdict_of(effects, feigned_gain=feigned_gain, trials=(refused,)) == verdict


@pytest.mark.parametrize(
    ("gain", "named", "closed_low", "last", "verdict"),
    [
        (1300.0, 0.0, None, True, "unknown_effect"),
        (150.0, 0.0, None, True, "no_gap"),
        (1300.0, 1800.0, 0.0, True, "unknown_effect"),
        (1300.0, 1800.0, 0.6, True, "effect_found"),
        (1300.0, 1e5, 0.0, True, "effect_found"),
        (1300.0, 1800.0, 0.0, False, "effect_found"),
    ],
)
def test_what_explains_much_in_few_places_is_something_unless_names_cover_it(
    gain, named, closed_low, last, verdict
):
    """So much, though that inflation leaves it to chance; not what gave way to what was taken.

    Nor another law of friction, for no robot has the believed one; nor what is no chance, but
    refused for another reason; nor a lag so short that commands which move within rows make it.
    """
    evidence = Evidence(gain, 60.0, 0.1, np.eye(1), 0.0)
    trials = [
        SimpleNamespace(
            step=1,
            accepted=False,
            checked=True,
            validation_gain=1.0,
            evidence=evidence,
            candidate=SimpleNamespace(effect="coulomb_friction"),
            values=np.array([0.01]),
            chance=0.1,
        )
    ]
    short = {"candidate": SimpleNamespace(effect="driver_lag"), "values": np.array([4e-4])}
    trials.append(replace_namespace(trials[0], evidence=BY_FAR, **short))
    of_friction = SimpleNamespace(effect="contact_shape")
    trials.append(replace_namespace(trials[0], evidence=BY_FAR, candidate=of_friction))
    trials.append(replace_namespace(trials[0], evidence=BY_FAR, chance=1e-4))
    if not last:
        trials.append(replace_namespace(trials[0], accepted=True))
    effects = [selected("coulomb_friction", named)] if named else []
    closed = Closed(None, None, None) if closed_low is None else Closed(0.7, closed_low, 0.9)
    table = SimpleNamespace(left=Left(0.0, 1.0), closed=closed)
    assert verdict_of(effects, table=table, trials=trials) == verdict


def replace_namespace(one, **changed):
    return SimpleNamespace(**{**vars(one), **changed})


@pytest.mark.parametrize(("keys_at_ends", "verdict"), [(4, "no_gap"), (5, "unknown_effect")])
def test_believed_keys_at_their_ends_are_no_model_that_explains_the_logs(keys_at_ends, verdict):
    assert verdict_of([], keys_at_ends=keys_at_ends) == verdict


def test_what_jolts_more_often_than_anybody_pushes_is_unknown():
    assert verdict_of([selected("coulomb_friction", 1e5)], jolts=True) == "unknown_effect"


@pytest.mark.parametrize(
    ("inflation", "variation", "verdict"),
    [
        (20.0, 0.2, "effect_found"),
        (2.0, 0.6, "effect_found"),  # which chance gives
        (20.0, 0.6, "unknown_effect"),
    ],
)
def test_a_size_that_is_not_the_same_throughout_is_no_name(inflation, variation, verdict):
    varying = selected("weak_motor", 2e3, inflation, variation)
    assert verdict_of([varying]) == verdict
    assert verdict_of([varying, selected("contact_shape", 1e5)]) == verdict
    assert verdict_of([varying, selected("coulomb_friction", 1e5)]) == "effect_found"


def test_a_size_that_varies_little_but_leaves_as_much_as_a_missing_term_is_no_name():
    """A fifth of 1e4 leaves 400: more than a hundredth of it, less than that of 1e5."""
    varying = selected("supply_sag", 1e4, 20.0, 0.2)
    assert verdict_of([varying]) == "unknown_effect"
    assert verdict_of([varying, selected("contact_shape", 1e5)]) == "unknown_effect"
    assert verdict_of([varying, selected("coulomb_friction", 1e5)]) == "effect_found"
    assert verdict_of([selected("contact_shape", 1e4, 20.0, 0.2)]) == "effect_found"


@pytest.mark.parametrize(("law", "verdict"), [(700.0, "unknown_effect"), (800.0, "effect_found")])
def test_a_curve_may_change_by_as_much_as_any_law_of_friction_is_off(law, verdict):
    """A size that changes by 0.6 leaves 0.36 of 2,000."""
    curve = replace(selected("contact_shape", 2e3, 20.0, 0.6), law_gain=law)
    assert verdict_of([curve]) == verdict


def test_a_name_that_a_shape_a_little_wrong_would_leave_carries_a_caution():
    """5,000 of a million is the square of 7 %; gain alone makes none weak."""
    known = [("coulomb_friction", 1e6, 0.0), ("payload", 5e3, 2e5), ("gyro_bias", 5e3, 1e6)]
    [caution] = weak_names([selected(name, gain, left=left) for name, gain, left in known])
    assert caution.startswith("gyro_bias is weak: the other effects would leave as much if they")
    assert "7 % off" in caution
    assert weak_names([]) == []


def test_rivals_come_with_what_to_drive_or_the_word_that_nothing_would_help():
    sure, ambiguous = selected("body_drag", 1e5), selected("payload", 1e5)
    ambiguous = replace(ambiguous, rivals=("low_grip",))
    best = Separation(Manoeuvre("twist", "", 3.8, []), 25.0, 0.0)
    assert find._advice([sure], {}) == ""
    assert find._advice([sure, ambiguous], {"payload": best}) == (
        " Driving 'twist' (4 s, omnislip gap plan) would tell payload from low_grip: expected "
        "separation 25, right with probability 0.994."
    )
    assert find._advice([ambiguous], {"payload": replace(best, separation=1.0)}) == (
        " No manoeuvre of the library would tell payload from low_grip."
    )
    assert find._advice([ambiguous], {}) == ""  # nothing was driven


def axis_case(folder, bench=AXIS_BENCH, seeds=range(6), **believed):
    folder.mkdir(parents=True, exist_ok=True)
    model = folder / "axis.toml"
    model.write_text(model_text(**believed))
    logs = [folder / f"run_{seed:02d}.csv" for seed in seeds]
    for seed, path in zip(seeds, logs, strict=True):
        write_log(make_log(bench, seed), path)
    return model, logs


def found(model, logs):
    return find_gap(model, logs, silent)


@pytest.fixture(scope="module")
def weak_motor(tmp_path_factory):
    """A motor of wheel 3 with too little torque; findings, logs and result folder."""
    folder = tmp_path_factory.mktemp("weak_motor")
    model, logs = robot_case(folder, typical_effect("weak_motor", 3))
    findings = found(model, logs)
    write_results(findings, folder / "gap", "report")
    return findings, logs, folder / "gap"


@pytest.fixture(scope="module")
def nothing_hidden(tmp_path_factory):
    return found(*robot_case(tmp_path_factory.mktemp("none")))


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    folder = tmp_path_factory.mktemp("axis")
    findings = found(*axis_case(folder))
    write_results(findings, folder / "gap", "report")
    return findings, folder / "gap"


def test_keys_that_are_exact_leave_nothing_to_fit_but_effects(tmp_path):
    """Tolerance 0 for all of them; dry friction of 2 N or none."""
    hidden = found(*axis_case(tmp_path / "dry", replace(AXIS_BENCH, coulomb_n=2.0), tolerance=0.0))
    assert [s.candidate.name for s in hidden.outcome.selected] == ["coulomb_friction"]
    exact = replace(AXIS_BENCH, coulomb_n=0.0)
    assert found(*axis_case(tmp_path / "none", exact, tolerance=0.0)).verdict == "no_gap"


# ---- robot ----


def test_weak_motor_is_named_with_its_wheel(weak_motor):
    [effect] = to_json(weak_motor[0])["effects"]
    assert (effect["name"], effect["wheel"]) == ("weak_motor", 3)
    assert to_json(weak_motor[0])["verdict"] == "effect_found"


def test_its_size_is_within_the_interval_and_the_interval_says_something(weak_motor):
    """Twice the 95 % interval: the generator integrates and rubs differently from the model."""
    truth = typical_effect("weak_motor", 3).parameters["scale"]
    [effect] = to_json(weak_motor[0])["effects"]
    scale = effect["parameters"]["scale"]
    half = (scale["high"] - scale["low"]) / 2
    assert scale["low"] < scale["value"] < scale["high"]
    assert abs(scale["value"] - truth) < 2 * half
    assert 1e-4 < half < 0.02


def test_the_gap_on_the_held_out_run_closes(weak_motor):
    result = to_json(weak_motor[0])["gap"]
    assert result["held_out_runs"] == ["run_05"]
    assert result["closed_fraction"]["low"] > 0.8
    assert result["closed_fraction"]["over"].endswith("of 1 run")
    # Better than chance would be too good.
    for channel in result["channels"].values():
        assert channel["after"] > 0.4 * channel["noise_floor"]
        assert channel["after"] < 1.1 * channel["refit"]


def test_where_points_to_the_wheel(weak_motor):
    assert to_json(weak_motor[0])["where"][0]["channel"] == "wheel/3/torque"


def test_the_balance_of_the_wheel_fails_without_the_effect_and_holds_with_it(weak_motor):
    balances = {one.name: one.rms for one in weak_motor[0].balances}
    fall = {name: rms[1] / rms[2] for name, rms in balances.items()}
    wheels = {name: fall[name] for name in fall if name.startswith("wheel ")}
    assert max(wheels, key=wheels.__getitem__) == "wheel 3: torque"
    assert wheels["wheel 3: torque"] > 2.0
    assert fall["gyro less camera: turning"] < 1.5


def test_a_second_run_on_the_amended_robot_finds_no_gap(weak_motor):
    _, logs, folder = weak_motor
    again = found(folder / "robot.toml", logs)
    assert again.verdict == "no_gap"
    assert to_json(again)["effects"] == []


def test_an_amended_robot_with_two_effects_has_no_gap_on_logs_it_never_saw(tmp_path):
    effects = [typical_effect("weak_motor", 3), typical_effect("coulomb_friction", None)]
    hidden = tuple(effect.as_dict() for effect in effects)
    write_case(TruthCase(7, hidden, runs=10, run_duration_s=4.0), tmp_path)
    logs = sorted(tmp_path.glob("run_*.csv"))
    first = found(tmp_path / "robot.toml", logs[:5])
    named = {(effect["name"], effect["wheel"]) for effect in to_json(first)["effects"]}
    assert named == {("weak_motor", 3), ("coulomb_friction", None)}
    write_results(first, tmp_path / "gap", "report")
    again = found(tmp_path / "gap" / "robot.toml", logs[5:])
    assert again.verdict == "no_gap", again.sentence


def test_nothing_hidden_nothing_found(nothing_hidden):
    result = to_json(nothing_hidden)
    assert result["verdict"] == "no_gap"
    assert (result["effects"], result["where"], result["unknown"]) == ([], [], [])


def test_no_gap_gives_a_limit_of_detection_for_every_candidate(nothing_hidden):
    result = to_json(nothing_hidden)
    candidates = nothing_hidden.machine.candidates()
    limits = result["detection_limits"]
    assert set(limits) == {c.effect for c in candidates} | {"slippery_patch"}
    assert all(np.isfinite(v) and v > 0 for own in limits.values() for v in own.values())
    # What these logs show of a motor: better than a tenth, no better than a thousandth.
    wheels = [own["scale"] for own in result["detection_limits_by_wheel"]["weak_motor"].values()]
    assert len(wheels) == 4 and limits["weak_motor"]["scale"] == max(wheels)
    assert min(wheels) > 1e-3 and max(wheels) < 0.1


def test_the_limit_of_what_is_infinite_when_absent_is_the_largest_that_shows(nothing_hidden):
    """Currents of this drive clip at a few ampere, and hardly anywhere at 15 A."""
    limits = to_json(nothing_hidden)["detection_limits"]
    assert limits["current_limit"]["limit_a"] in (2.5, 5.0, 9.0, 15.0)
    assert limits["shaft_compliance"].keys() <= {"stiffness_nm_rad"}


def test_friction_of_all_wheels_is_named_for_all(tmp_path):
    """In closed loop, rubbing by another curve than the believed one."""
    hidden = typical_effect("coulomb_friction")
    model, logs = robot_case(tmp_path, hidden, friction_curve="tanh", closed_loop=True)
    effects = {
        (e["name"], e["wheel"]): e["parameters"] for e in to_json(found(model, logs))["effects"]
    }
    assert ("coulomb_friction", None) in effects
    assert set(effects) <= {("coulomb_friction", None), ("contact_shape", None)}
    torque = effects["coulomb_friction", None]["torque_nm"]["value"]
    assert torque == pytest.approx(hidden.parameters["torque_nm"], rel=0.1)


def test_encoders_alone_are_enough_for_a_motor(tmp_path):
    model, logs = robot_case(tmp_path, typical_effect("weak_motor", 3), drop=("gyro", "pose"))
    result = to_json(found(model, logs))
    assert [(e["name"], e["wheel"]) for e in result["effects"]] == [("weak_motor", 3)]
    assert all(channel.startswith("wheel/") for channel in result["gap"]["channels"])


# ---- gap.json ----

NUMBER = (int, float)
OPTIONAL_NUMBER = (int, float, type(None))


def assert_shape(value, shape):
    """`shape`: a type, a tuple of types, [shape of items], {key: shape} or {str: shape of all}."""
    kind = shape if isinstance(shape, (type, tuple)) else type(shape)
    assert isinstance(value, kind), f"{value!r} is no {kind}"
    items = value if isinstance(shape, list) else []
    for item in items:
        assert_shape(item, shape[0])
    keys = shape if isinstance(shape, dict) else {}
    for key, inner in keys.items():
        named = list(value) if key is str else [key]
        for name in named:
            assert_shape(value[name], inner)


EFFECT = {
    "name": str,
    "wheel": (int, type(None)),
    "parameters": {str: {"value": NUMBER, "low": NUMBER, "high": NUMBER}},
    "ambiguous_with": [str],
    "rivals": [{"name": str, "wheel": (int, type(None))}],
    "separating_manoeuvre": (dict, type(None)),
    "evidence": {str: NUMBER},
}
SHAPE = {
    "schema": str,
    "verdict": str,
    "where": [{"channel": str, "condition": str, "share_of_gap": NUMBER, "windows_s": [list]}],
    "effects": [EFFECT],
    "balances": [
        {
            "name": str,
            "unit": str,
            "believed": NUMBER,
            "refit": NUMBER,
            "after": NUMBER,
            "sensor_noise": NUMBER,
        }
    ],
    "gap": {
        "held_out_runs": [str],
        "channels": {
            str: {"believed": NUMBER, "refit": NUMBER, "after": NUMBER, "noise_floor": NUMBER}
        },
        "closed_fraction": {
            "value": OPTIONAL_NUMBER,
            "low": OPTIONAL_NUMBER,
            "high": OPTIONAL_NUMBER,
            "over": (str, type(None)),
        },
    },
    "detection_limits": {str: {str: NUMBER}},
}


def strict(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize("case", ["weak_motor", "axis"])
def test_gap_json_has_the_agreed_keys_and_types(case, request):
    findings, *_, folder = request.getfixturevalue(case)
    result = strict((folder / "gap.json").read_text())
    assert_shape(result, SHAPE)
    assert result["schema"] == "omnislip-gap/1"
    assert result["verdict"] == findings.verdict
    for run, begin, end in result["where"][0]["windows_s"]:
        assert isinstance(run, str)
        assert 0 <= begin < end
    assert 0 < sum(place["share_of_gap"] for place in result["where"]) <= 1 + 1e-9


def test_gap_json_of_no_gap_is_valid_too(nothing_hidden):
    result = strict(json.dumps(to_json(nothing_hidden), allow_nan=False))
    assert_shape(result, SHAPE)


def test_results_are_three_files(weak_motor, axis):
    for folder in (weak_motor[2], axis[1]):
        assert sorted(p.name for p in folder.iterdir()) == ["gap.json", "report.html", "robot.toml"]


def test_amended_file_holds_the_effect_of_the_json(weak_motor):
    findings, _, folder = weak_motor
    [written] = read_model(folder / "robot.toml").effects
    [told] = to_json(findings)["effects"]
    assert (written.name, written.wheel) == (told["name"], told["wheel"])
    assert written.parameters == {k: v["value"] for k, v in told["parameters"].items()}


# ---- axis ----


def test_friction_of_an_axis_in_newtons(axis):
    [effect] = to_json(axis[0])["effects"]
    assert (effect["name"], effect["wheel"]) == ("coulomb_friction", None)
    force = effect["parameters"]["force_n"]
    assert force["low"] < 2.0 < force["high"]


def test_the_place_of_what_has_no_name_is_told(tmp_path, monkeypatch):
    """Bearings that age are in no catalogue; here nothing that is near is taken for them."""
    full_search = find.search
    monkeypatch.setattr(find, "search", lambda *given: replace(full_search(*given), selected=()))
    result = to_json(found(*axis_case(tmp_path, Bench(ageing_n_m=2.0))))
    assert (result["verdict"], result["nearest"]) == ("unknown_effect", [])
    [place] = result["where"]
    assert place["channel"] == "axis/force"
    assert place["windows_s"]


def test_second_run_on_the_amended_axis_finds_no_gap(axis, tmp_path):
    _, logs = axis_case(tmp_path, seeds=range(20, 26))
    assert found(axis[1] / "robot.toml", logs).verdict == "no_gap"


def test_same_logs_same_result(axis, tmp_path):
    model, logs = axis_case(tmp_path)
    again, first = to_json(found(model, logs)), to_json(axis[0])
    assert {k: again[k] for k in SHAPE} == {k: first[k] for k in SHAPE}


# ---- held-out runs ----


def test_what_is_held_out_changes_nothing_of_the_fit(axis, tmp_path):
    """The held-out log is replaced by nonsense: the effect and its interval stay the same.

    But as it does not bring that log nearer it is only the nearest.
    """
    model, logs = axis_case(tmp_path)
    held = next(p for p in logs if p.stem in to_json(axis[0])["gap"]["held_out_runs"])
    write_log(make_log(Bench(coulomb_n=9.0, mass_kg=20.0), 99), held)
    other = found(model, logs)
    [spoilt], [clean] = other.outcome.selected, axis[0].outcome.selected
    assert spoilt.candidate.name == clean.candidate.name
    assert spoilt.values.tolist() == clean.values.tolist()
    assert spoilt.evidence.covariance.tolist() == clean.evidence.covariance.tolist()
    spoilt, clean = to_json(other), to_json(axis[0])
    assert spoilt["base"] == clean["base"]
    assert spoilt["gap"] != clean["gap"]
    assert (spoilt["verdict"], clean["verdict"]) == ("unknown_effect", "effect_found")
    assert [one["name"] for one in spoilt["nearest"]] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("excess", "high", "verdict"),
    [
        (0.1, 0.3, "no_gap"),
        (0.1, 0.7, "effect_found"),
        (0.1, None, "effect_found"),  # the name is stable
        (9.0, 0.3, "unknown_effect"),
    ],
)
def test_names_that_close_nothing_on_held_out_runs_are_not_given(
    tmp_path, monkeypatch, excess, high, verdict
):
    """Where little is off there, nothing is missing that shows."""
    told = find.gap_table

    def table(*replays):
        closed = Closed(None, None, None) if high is None else Closed(-0.5, -1.0, high)
        return replace(told(*replays), left=Left(excess, 0.1), closed=closed)

    monkeypatch.setattr(find, "gap_table", table)
    findings = found(*axis_case(tmp_path))
    answer = to_json(findings)
    assert answer["verdict"] == verdict
    assert ("coulomb_friction would explain" in answer["sentence"]) == (verdict == "no_gap")
    if verdict == "no_gap":
        assert "(-100 to 30 %)" in answer["sentence"]
        assert answer["effects"] == [] == findings.amended.effects
        assert answer["gap"]["closed_fraction"]["value"] is None
        rmse = answer["gap"]["channels"]["axis/position_m"]
        assert rmse["after"] == rmse["refit"]


@pytest.mark.parametrize(
    ("high", "stability", "proven"),
    [(0.3, [1.0], False), (0.7, [0.5], True), (None, [0.7, 0.8], False), (None, [0.7, 1.0], True)],
)
def test_where_nothing_is_off_on_held_out_runs_a_name_has_to_be_stable(high, stability, proven):
    effects = [replace(selected("coulomb_friction", 100.0), stability=one) for one in stability]
    closed = Closed(None, None, None) if high is None else Closed(0.2, 0.1, high)
    table = SimpleNamespace(left=Left(0.1, 0.1), closed=closed, floor_source="repeated manoeuvres")
    assert find._closes_nothing(effects, table) != proven


@pytest.mark.parametrize(
    ("first", "final", "held"),
    [
        ([20.0], -1e3, [True, False]),
        ([9.0, 1.0], -50.0, [True]),
        ([9.0, -1.0], 1e3, [False, True]),
        ([-20.0, -1.0], 50.0, [False]),
    ],
)
def test_commands_are_asked_again_by_a_better_model(tmp_path, monkeypatch, first, final, held):
    """Searched again, with runs to match, only where the first answer was surely wrong.

    A first model of one tuning is asked, and one of three where that is not sure.
    """
    answers, searched = first[::-1], []
    looked = find.search

    def search(machine, runs, *rest):
        assert {run.held for run in runs} == {machine.holds_commands}
        searched.append(machine.holds_commands)
        return looked(machine, runs, *rest)

    monkeypatch.setattr(find, "search", search)
    monkeypatch.setattr(find, "likelier_held", lambda *_: answers.pop() if answers else final)
    weak = HiddenEffect("weak_motor", {"scale": 0.8}, 2).as_dict()
    write_case(TruthCase(seed=4, effects=(weak,), runs=3, run_duration_s=3.0), tmp_path)
    findings = find_gap(tmp_path / "robot.toml", sorted(tmp_path.glob("run_*.csv")), silent)
    assert (searched, answers) == (held, [])
    assert findings.machine.holds_commands == held[-1]
    assert findings.outcome.data.machine.holds_commands == held[-1]
    assert (find.HELD_COMMANDS in findings.recording) == held[-1]


@pytest.mark.parametrize(("effects", "again"), [(0, False), (1, False), (2, True), (3, True)])
def test_a_model_that_lacks_more_than_the_last_one_does_not_take_its_answer_back(
    monkeypatch, effects, again
):
    monkeypatch.setattr(find, "likelier_held", lambda *_: 1e3)
    machine = SimpleNamespace(holds_commands=False, believed=None)
    model = SimpleNamespace(effects=[None] * effects, flat=lambda believed: believed)
    assert find._takes_commands_wrongly(machine, [], 2, model, None) == again


def test_pushes_where_rows_are_missing_are_parted_from_those_that_can_be_told():
    whole = np.arange(100) * 0.005
    logs = [Log("a", whole, {}), Log("b", np.delete(whole, np.arange(41, 50)), {})]
    pushes = [SimpleNamespace(run=run, time_s=0.21) for run in ("a", "b")]
    told, blind = find._by_lost_rows(logs, pushes)
    assert [one.run for one in told] == ["a"]
    assert [one.run for one in blind] == ["b"]


def stretches(runs):
    """(name, row time) of every row."""
    return {(run.name, float(t)) for run in runs for t in run.t_s}


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9, 12, 20])
def test_no_row_is_in_two_parts_of_the_split(count, tmp_path):
    model, _ = axis_case(tmp_path, seeds=())
    logs = [make_log(Bench(), seed) for seed in range(count)]
    split = split_runs(Machine(read_model(model)), logs)
    parts = [stretches(part) for part in (split.fitting, split.held_out)]
    assert all(parts)
    assert sum(map(len, parts)) == len(set.union(*parts)) == sum(len(log.t_s) for log in logs)
    assert len(parts[1]) >= 0.1 * sum(map(len, parts))
    assert len(parts[0]) >= 0.5 * sum(map(len, parts))


def test_what_ends_before_it_can_be_replayed_is_not_held_out(tmp_path):
    """The last quarter begins at 3 s, and a push at 3.3 s leaves less than a second after it."""
    model, _ = axis_case(tmp_path, seeds=())
    log = make_log(Bench(), 1, duration_s=4.0)
    assert not split_runs(Machine(read_model(model)), [log], [(log.name, 3.3)]).held_out
    later = split_runs(Machine(read_model(model)), [log], [(log.name, 3.6)])
    assert [run.duration_s for run in later.held_out] == pytest.approx([0.59])


def long_logs(*rows, **columns):
    """Logs of a robot by their rows."""
    return [replace(robot_log(n, **columns), name=f"run_{k:03d}") for k, n in enumerate(rows)]


@pytest.mark.parametrize(
    "rows",
    [[120_000], [40_000] * 3, [12_000] * 12, [1200] * 200, [8100] * 5, [120_000, 1600, 1600, 1600]],
    ids=lambda rows: f"{len(rows)} of up to {max(rows)}",
)
def test_of_long_logs_stretches_from_all_over_are_used(rows):
    logs = long_logs(*rows)
    split = split_runs(ROBOT, logs)
    for runs, most_s in ((split.fitting, 120.0), (split.held_out, 40.0)):
        assert max(run.duration_s for run in runs) < 15.0
        assert sum(run.duration_s for run in runs) < 1.2 * most_s
    assert sum(run.duration_s for run in split.fitting) > 0.75 * 120.0
    assert not stretches(split.fitting) & stretches(split.held_out)
    if len(rows) < 12:  # a unit at least of each log that is not held out
        assert len({run.name for run in split.fitting}) >= 0.6 * len(rows)
    whole_s = sum(rows) * 0.005
    assert f"of {whole_s:.0f} s" in split.thinned
    names = [log.name for log in logs]
    begins_s = np.cumsum([0, *rows[:-1]]) * 0.005
    used = [*split.fitting, *split.held_out]
    times_s = [begins_s[names.index(run.name)] + run.t_s[0] for run in used]
    gaps_s = np.diff(np.sort([0.0, *times_s, whole_s]))
    assert np.max(gaps_s) < 0.3 * whole_s


@pytest.mark.parametrize("rows", [4000, 12_000])
def test_a_pause_within_a_log_makes_it_no_longer(rows):
    logs = long_logs(*[rows] * 4)
    pause_s = 500.0 * (np.arange(rows) >= rows // 2)
    paused = [replace(log, t_s=log.t_s + pause_s) for log in logs]
    cuts = [(log.name, log.t_s[rows // 2] - 0.02) for log in paused]
    split = split_runs(ROBOT, paused, cuts)
    assert (split.thinned is None) == (split_runs(ROBOT, logs).thinned is None)
    assert sum(run.duration_s for run in split.fitting) > 0.7 * min(3 * rows * 0.005, 120.0)


def test_slow_rows_make_longer_stretches():
    log = replace(robot_log(6000), t_s=np.arange(6000) * 0.25)
    split = split_runs(ROBOT, [log])
    assert sum(run.duration_s for run in split.fitting) > 90.0
    assert min(len(run.t_s) for run in split.fitting) >= 50


def test_manoeuvres_that_are_repeated_stay_so_in_long_logs():
    """Logs of nearly the same length: the same stretches of them, of what is driven alike."""
    twice = 1.0 + (np.arange(16_000) // 2000 % 4 == 1)
    duty = robot_log(16_000).columns["wheel/1/duty"] * twice
    whole = robot_log(16_000, **{f"wheel/{w}/duty": duty for w in range(1, 5)})
    logs = [
        Log(f"run_{k}", whole.t_s[:n], {c: v[:n] for c, v in whole.columns.items()})
        for k, n in enumerate([15_900, 16_000, 15_950, 15_990, 15_930])
    ]
    begins = {round(run.t_s[0], 3) for run in split_runs(ROBOT, logs).fitting}
    assert len(begins) <= 4
    assert all(begin % 10.0 == 0.0 for begin in begins)


def test_of_long_logs_the_liveliest_stretches_are_used():
    """Every third ten seconds the robot drives at twice the duty."""
    twice = 1.0 + (np.arange(120_000) // 2000 % 3 == 1)
    duty = robot_log(120_000).columns["wheel/1/duty"] * twice
    log = robot_log(120_000, **{f"wheel/{w}/duty": duty for w in range(1, 5)})
    split = split_runs(ROBOT, [log])
    assert all(10.0 <= run.t_s[0] % 30.0 < 20.0 for run in split.fitting + split.held_out)


def test_a_minute_is_filtered_at_once_at_most():
    runs = usable_runs(ROBOT, robot_log(26_000), [])
    assert sum(len(run.t_s) for run in runs) == 26_000
    assert max(run.duration_s for run in runs) < 60.0


def test_results_are_written_all_or_none(tmp_path):
    """The last of them cannot be: a folder has its name."""
    model, logs = axis_case(tmp_path, seeds=range(1))
    (tmp_path / "gap" / "gap.json").mkdir(parents=True)
    with pytest.raises(InputError, match=r"gap\.json: cannot be written"):
        write_results(found(model, logs), tmp_path / "gap", "report")
    assert [path.name for path in (tmp_path / "gap").iterdir()] == ["gap.json"]


def test_where_only_what_was_held_out_is_off_that_is_said(tmp_path):
    """Two logs of which the second rubs: nothing that was fitted shows where or what it is."""
    model, logs = axis_case(tmp_path, Bench(coulomb_n=0.0), seeds=range(2))
    write_log(make_log(Bench(coulomb_n=3.0), 1), logs[1])
    findings = found(model, logs)
    assert findings.verdict == "unknown_effect"
    assert "what is off is in run_01, held out" in findings.sentence
    assert findings.places == [] and findings.gap_map is None


def test_runs_of_the_same_name_in_two_folders_are_two(tmp_path):
    model, _ = axis_case(tmp_path, seeds=())
    logs = [replace(make_log(Bench(), k), series=f"day_{d}") for d in range(2) for k in range(3)]
    split = split_runs(Machine(read_model(model)), logs)
    assert len(split.held_out) == 1
    assert len({run.unit for run in split.fitting}) == 5


def test_slivers_beside_a_cut_are_not_used(tmp_path):
    """Parts of 2.25 s, the log cut at 2.05 s: 0.15 s are left, in which the filter settles."""
    t_s = np.arange(0.0, 12.0, 0.001)
    log = Log("run", t_s, {"axis/command": np.sin(t_s), "axis/position_m": np.sin(t_s)})
    model, _ = axis_case(tmp_path, seeds=())
    split = split_runs(Machine(read_model(model)), [log], [("run", 2.05)])
    assert [round(run.duration_s, 2) for run in split.fitting] == [2.04, 2.25, 2.25, 2.25]


@pytest.mark.parametrize("lost", [(-1.0, 1.0), (0.5, 3.5), (-1.0, 4.0)], ids=str)
def test_a_run_of_a_robot_starts_from_a_pose_or_has_none(lost):
    """Where the camera is lost at first, the robot has moved when it comes back."""
    log = robot_log(800)
    blank = (log.t_s > lost[0]) & (log.t_s < lost[1])
    pose = {name: np.where(blank, np.nan, log.t_s) for name in POSE_COLUMNS}
    runs = usable_runs(ROBOT, replace(log, columns=log.columns | pose), [])
    assert sum(len(run.t_s) for run in runs) == len(log.t_s)
    seen = [np.flatnonzero(~np.isnan(run.outputs[:, 5])) for run in runs]
    assert all(rows.size == 0 or rows[0] == 0 for rows in seen)


def test_a_gap_cuts_its_own_log_only(tmp_path):
    """Two folders hold a run_00 each; from that of the first half a second is missing."""
    log = make_log(AXIS_BENCH, 0)
    kept = (log.t_s < 2.5) | (log.t_s > 3.0)
    broken = Log(log.name, log.t_s[kept], {n: v[kept] for n, v in log.columns.items()})
    model, logs = axis_case(tmp_path / "b", seeds=range(5))
    (tmp_path / "a").mkdir()
    write_log(broken, tmp_path / "a" / "run_00.csv")
    findings = found(model, [tmp_path / "a" / "run_00.csv", *logs])
    names = [run.name for run in findings.split.fitting]
    assert names == ["a/run_00", "a/run_00", "b/run_00", "run_01", "run_02", "run_03"]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 9, 12, 20])
def test_every_unit_is_checked_by_four_others(count, tmp_path):
    """And no row is in two of them."""
    model, _ = axis_case(tmp_path, seeds=())
    logs = [make_log(Bench(), seed, duration_s=15.0) for seed in range(count)]
    split = split_runs(Machine(read_model(model)), logs)
    units = {run.unit for run in split.fitting}
    assert len(units) >= min(5, max(4, count - 1))
    rows = [stretches([run for run in split.fitting if run.unit == unit]) for unit in units]
    assert sum(map(len, rows)) == len(set.union(*rows))


@pytest.mark.parametrize("count", [1, 3, 6])
def test_the_search_never_sees_a_held_out_row(count, tmp_path, monkeypatch):
    seen = []

    def spy(machine, runs, *rest):
        seen.append(stretches(runs))
        return search(machine, runs, *rest)

    search = find.search
    monkeypatch.setattr(find, "search", spy)
    findings = found(*axis_case(tmp_path, seeds=range(count)))
    assert len(seen) == 1
    assert not seen[0] & stretches(findings.split.held_out)


# ---- not enough data ----


def robot_log(rows, **columns):
    t_s = np.arange(rows) * 0.005
    wave = 0.3 * np.sin(5 * t_s)
    values = {f"wheel/{w}/duty": wave for w in range(1, 5)}
    turned = np.round(-3000 * np.cos(5 * t_s))
    values |= {f"wheel/{w}/encoder_counts": turned for w in range(1, 5)}
    return Log("run", t_s, values | columns)


TOO_LITTLE = {
    "0.2 s": (lambda: robot_log(40), "0.2 s"),
    "zeros": (
        lambda: robot_log(2000, **{c: np.zeros(2000) for c in robot_log(2).columns}),
        "never changes",
    ),
    "a wheel that never moves": (
        lambda: robot_log(2000, **{"wheel/2/encoder_counts": np.zeros(2000)}),
        "wheel 2",
    ),
    "one step of the clock": (lambda: robot_log(2), "0.005 s"),
}


@pytest.mark.parametrize("case", TOO_LITTLE)
def test_too_little_data_is_a_verdict(case, tmp_path):
    make, reason = TOO_LITTLE[case]
    model, _ = robot_case(tmp_path / "model")
    write_log(make(), tmp_path / "run.csv")
    findings = found(model, [tmp_path / "run.csv"])
    result = strict(json.dumps(to_json(findings), allow_nan=False))
    assert result["verdict"] == "insufficient_data"
    assert reason in result["sentence"]
    assert result["effects"] == []
    assert findings.amended.values == read_model(model).values


def test_what_was_not_used_of_too_few_data_is_told(tmp_path):
    model, _ = robot_case(tmp_path / "model")
    write_log(robot_log(40, **{"supply/voltage_v": np.full(40, 24.0)}), tmp_path / "run.csv")
    result = to_json(found(model, [tmp_path / "run.csv"]))
    assert result["verdict"] == "insufficient_data"
    assert result["recording"] == ["supply/voltage_v (does not vary in 1 of 1 logs): not used"]
