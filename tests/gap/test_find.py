"""`gap find` from files to verdict: on robot logs of the independent generator, and on axis logs.

Robot cases are short (five runs of four seconds): a guard for the whole path. How often the ten
effects are found is measured by `omnislip gap benchmark`, not here.
"""

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import axis_bench
import numpy as np
import pandas as pd
import pytest
from axis_bench import Bench, make_log, model_text, silent
from omnislip.errors import InputError
from omnislip.gap import find, first_models
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json, write_results
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import Closed, Left
from omnislip.gap.noise import RunawayError
from omnislip.gap.search import Found, MistakenError
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import HiddenEffect, typical_effect
from omnislip.gap.words import HELD_COMMANDS, OTHER_STARTS
from omnislip.log_file import Log, write_log
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import robot_log, stretches

AXIS_BENCH = Bench(coulomb_n=2.0)


def robot_case(folder, *effects, drop=(), **case):
    """Model file and logs with hidden effects, without columns that begin with `drop`."""
    hidden = tuple(effect.as_dict() for effect in effects)
    write_case(TruthCase(seed=7, effects=hidden, runs=5, run_duration_s=4.0, **case), folder)
    logs = sorted(folder.glob("run_*.csv"))
    for path in logs:
        frame = pd.read_csv(path)
        frame[[c for c in frame.columns if not c.startswith(tuple(drop))]].to_csv(path, index=False)
    return folder / "robot.toml", logs


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
    ("first", "last", "held"),
    [
        ([20.0], -1e3, [True, False]),
        ([9.0, 1.0], -50.0, [True]),
        ([9.0, -1.0], 1e3, [False, True]),
        ([-20.0, -1.0], 50.0, [False]),
    ],
)
def test_commands_are_asked_again_by_a_better_model(tmp_path, monkeypatch, first, last, held):
    """Searched again, with runs to match, only where the first answer was surely wrong.

    A first model of one tuning is asked, and one of three where that is not sure. Pushes are looked
    for beside what was found.
    """
    answers, searched, beside = first[::-1], [], []
    looked, pushes_beside = find.search, find._pushes_beside

    def search(machine, runs, *rest):
        assert {run.held for run in runs} == {machine.holds_commands}
        searched.append(machine.holds_commands)
        return looked(machine, runs, *rest)

    def pushes(machine, logs, cuts, model, noise):
        beside.append({effect.name for effect in model.effects})
        return pushes_beside(machine, logs, cuts, model, noise)

    monkeypatch.setattr(find, "search", search)
    monkeypatch.setattr(find, "_pushes_beside", pushes)
    monkeypatch.setattr(
        first_models, "likelier_held", lambda *_: answers.pop() if answers else last
    )
    motors = [
        c for c in Machine(read_model(NOMINAL_ROBOT)).candidates() if c.effect == "weak_motor"
    ]
    monkeypatch.setattr(Machine, "candidates_for", lambda *_: motors)  # soon found
    weak = HiddenEffect("weak_motor", {"scale": 0.8}, 2).as_dict()
    write_case(TruthCase(seed=4, effects=(weak,), runs=3, run_duration_s=3.0), tmp_path)
    logs = sorted(tmp_path.glob("run_*.csv"))
    recorded = find._read(tmp_path / "robot.toml", logs, None, silent)
    final = find._search(recorded, silent)
    assert (searched, answers) == (held, [])
    assert beside[0] == {"contact_shape"} and len(beside) == len(held)
    assert all("weak_motor (wheel 2)" in model for model in beside[1:])
    assert final.machine.holds_commands == held[-1]
    assert final.outcome.data.machine.holds_commands == held[-1]
    assert (HELD_COMMANDS in recorded.words) == held[-1]


def test_what_was_found_is_nothing_where_it_loses_the_robot(monkeypatch):
    def lost(*_):
        raise RunawayError

    found = Found(None, None, {}, ())
    monkeypatch.setattr(find, "first_model", lost)
    assert find._anew(None, [], found) is None
    monkeypatch.setattr(find, "first_model", lambda *_: ("noise", "model"))
    assert find._anew(None, [], found) == replace(found, model="model", noise="noise")


def test_turns_to_another_machine_cost_no_search_for_pushes(monkeypatch):
    """Two turns, then a push that shows only beside the final model, and one more behind that."""
    outcomes, turns = [], [True, True]
    found = Found(SimpleNamespace(effects=()), None, {}, ())
    machine = SimpleNamespace(holds_commands=True, reads_before=False)
    push = [SimpleNamespace(run="run", time_s=t, near=lambda other: False) for t in (1.0, 2.0)]

    def search(*given):
        if turns.pop() if turns else False:
            raise MistakenError(found, machine)
        outcomes.append(given)
        return SimpleNamespace(found=found)

    first = SimpleNamespace(without_effects=lambda: None)
    split = SimpleNamespace(enough=True, thinned="", fitting=[])
    monkeypatch.setattr(find, "split_runs", lambda *_: split)
    monkeypatch.setattr(find, "first_models", lambda *_: (machine, None, first))
    monkeypatch.setattr(find, "first_model", lambda *_: (None, first))
    monkeypatch.setattr(find, "taken_as", lambda *_: [])
    monkeypatch.setattr(find, "search", search)
    monkeypatch.setattr(find, "_pushes_beside", lambda *_: ([], []))
    monkeypatch.setattr(find, "_pushes_by", lambda *_: push[: len(outcomes)])
    monkeypatch.setattr(find, "_by_lost_rows", lambda logs, impacts: (impacts, []))
    asked = []
    monkeypatch.setattr(find, "find_zeros", lambda *_: asked.append(True) or {})
    monkeypatch.setattr(find, "find_starts", lambda *_: {})
    recorded = find._Recorded(None, machine, [], {}, [])
    find._search(recorded, lambda _: None)
    assert len(outcomes) == 1 + find.MOST_AGAIN and not turns
    find._search(recorded, lambda _: None)
    assert asked == [True]  # once for all logs, whichever are held out


@pytest.mark.parametrize("moved_before", [False, True])
def test_logs_that_begin_elsewhere_by_the_final_model_are_searched_again(monkeypatch, moved_before):
    """Names that stood for a direction that was none are judged anew, if none was known."""
    found = Found(SimpleNamespace(effects=()), None, {}, ())
    machine = SimpleNamespace(holds_commands=False, reads_before=False)
    split = SimpleNamespace(enough=True, thinned="", fitting=[])
    first = SimpleNamespace(without_effects=lambda: None)
    log = Log("run_01", np.arange(3.0), {})
    pose = (0.0, 0.0, 1.0)
    told, befores = [{log.name: pose} if moved_before else {}, {log.name: pose}, {}], []

    def search(*given):
        befores.append(given[-1])
        return SimpleNamespace(found=found)

    monkeypatch.setattr(find, "split_runs", lambda *_: split)
    monkeypatch.setattr(find, "first_models", lambda *_: (machine, None, first))
    monkeypatch.setattr(find, "search", search)
    monkeypatch.setattr(find, "_pushes_beside", lambda *_: ([], []))
    monkeypatch.setattr(find, "_pushes_by", lambda *_: [])
    monkeypatch.setattr(find, "find_zeros", lambda *_: {})
    monkeypatch.setattr(find, "find_starts", lambda *_: told.pop(0))
    recorded = find._Recorded(None, machine, [log], {}, [])
    find._search(recorded, lambda _: None)
    assert befores == [None, replace(found, mistaken=not moved_before)] and told == []
    assert recorded.logs[0].begun_at == pose
    assert recorded.words == [OTHER_STARTS]


@pytest.mark.parametrize(("effects", "again"), [(0, False), (1, False), (2, True), (3, True)])
def test_a_model_that_lacks_more_than_the_last_one_does_not_take_its_answer_back(
    monkeypatch, effects, again
):
    monkeypatch.setattr(first_models, "likelier_held", lambda *_: 1e3)
    machine = Machine(read_model(NOMINAL_ROBOT))
    model = SimpleNamespace(effects=[None] * effects, flat=lambda believed: believed)
    found = first_models.other_machine(machine, [], 2, model, None)
    assert (found is not None) == again
    assert not again or found.holds_commands


@pytest.mark.parametrize("with_rows", [False, True])
@pytest.mark.parametrize("likelier", [-200.0, -50.0, 50.0, 200.0])
def test_a_better_model_may_say_that_held_commands_jump_otherwise(monkeypatch, with_rows, likelier):
    monkeypatch.setattr(first_models, "likelier_held", lambda *_: 50.0)
    monkeypatch.setattr(first_models, "likelier_with_rows", lambda *_: likelier)
    model = read_model(NOMINAL_ROBOT)
    machine = Machine(model, holds_commands=True, jumps_with_rows=with_rows)
    better = SimpleNamespace(effects=[None], flat=lambda believed: believed)
    found = first_models.other_machine(machine, [], 1, better, None)
    if abs(likelier) < 100.0 or (likelier > 0.0) == with_rows:
        assert found is None
    else:
        assert found.holds_commands
        assert found.jumps_with_rows == (not with_rows)


def test_pushes_where_rows_are_missing_are_parted_from_those_that_can_be_told():
    whole = np.arange(100) * 0.005
    logs = [Log("a", whole, {}), Log("b", np.delete(whole, np.arange(41, 50)), {})]
    pushes = [SimpleNamespace(run=run, time_s=0.21) for run in ("a", "b")]
    told, blind = find._by_lost_rows(logs, pushes)
    assert [one.run for one in told] == ["a"]
    assert [one.run for one in blind] == ["b"]


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


def test_what_only_the_held_out_log_shows_is_named_with_another_one_held_out(tmp_path, monkeypatch):
    """Two slow logs and a fast one, with a drag by the square of the speed."""
    model, logs = axis_case(tmp_path, Bench(quadratic_n=6.0), seeds=[2])
    slow = partial(axis_bench.multisine, volt=0.3)
    monkeypatch.setattr(axis_bench, "multisine", slow)
    _, others = axis_case(tmp_path, Bench(quadratic_n=6.0), seeds=range(2))
    told = []
    findings = find_gap(model, [*others, *logs], told.append)
    assert [one.candidate.name for one in findings.outcome.selected] == ["quadratic_wheel_drag"]
    [size] = findings.outcome.selected[0].values
    assert size == pytest.approx(6.0, rel=0.1)
    assert findings.split.logs_held_out == ["run_01"]
    assert any(line.startswith("again with other logs held out") for line in told)
    [line] = [line for line in findings.recording if "held out first" in line]
    assert line.startswith("run_02: ")


LEFT = {"fits": (0.1, 0.2), "held out": (0.1, 60.0), "both": (0.7, 60.0), "near": (0.1, 20.0)}


@pytest.mark.parametrize(
    ("first", "whole", "then", "taken"),
    [
        ("fits", True, None, 0),
        ("both", True, None, 0),
        ("near", True, None, 0),
        ("held out", False, None, 0),
        ("held out", True, "fits", 1),
        ("held out", True, "held out", 0),
        ("held out", True, "both", 0),
        ("held out", True, RunawayError("lost"), 0),
        ("held out", True, find._InsufficientError("too little"), 0),
    ],
)
def test_other_logs_are_held_out_where_only_those_are_off_and_that_explains_all(
    monkeypatch, first, whole, then, taken
):
    """What the second search tells of the recording is not the first one's."""
    searches, asked = [first, then], []

    def search(recorded, progress, found=None):
        answer = searches[len(asked)]
        asked.append((recorded.logs, found))
        recorded.told.append(f"search {len(asked)}")
        if isinstance(answer, Exception):
            raise answer
        split = SimpleNamespace(logs_held_out=["c"] if whole else [])
        outcome = SimpleNamespace(found=Found(None, None, {}, ()))
        return SimpleNamespace(split=split, outcome=outcome, left=LEFT[answer])

    monkeypatch.setattr(find, "_search", search)
    monkeypatch.setattr(find, "_excess", lambda searched: searched.left)
    recorded = find._Recorded(None, None, ["a", "b", "c"], {}, ["gates"])
    chosen, searched = find._search_by_turns(recorded, silent)
    assert searched.left == LEFT[then if taken else first]
    assert len(asked) == (1 if then is None else 2)
    if then is not None:
        logs, found_before = asked[1]
        assert logs == ["c", "a", "b"] and found_before.elsewhere
    [*told, last] = chosen.told
    assert last == f"search {1 + taken}"
    assert told[0] == "gates" and len(told) == 1 + taken


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
