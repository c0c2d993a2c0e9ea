"""The manoeuvre that tells two effects apart: it can be driven, and it does what it says."""

import json
from dataclasses import replace

import numpy as np
import pytest
from axis_bench import model_text
from hypothesis import given
from hypothesis import strategies as st
from omnislip.errors import InputError
from omnislip.gap import plan as planning
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.gap.inference import Hypothesis, fit
from omnislip.gap.machine import Machine
from omnislip.gap.plan import Limits, Question, Rehearsal
from omnislip.gap.recordings import ROBOT_CHANNELS
from omnislip.log_file import write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario, simulate_truth

MODEL = read_model(NOMINAL_ROBOT)
MACHINE = Machine(MODEL)
PAIR = ["actuation_delay", "driver_lag"]


def silent(_):
    pass


@pytest.fixture(scope="module")
def ranked():
    return planning.plan(MODEL, Question(PAIR), Limits(), silent)


def by_name(ranked):
    return {one.manoeuvre.name: one for one in ranked}


# ---- the library ----


@pytest.mark.parametrize("limits", [Limits(), Limits(1.2, 0.4)])
def test_every_manoeuvre_keeps_to_room_and_speed(limits):
    rehearsal = Rehearsal(MACHINE, limits)
    driven = rehearsal.manoeuvres(MODEL)
    assert len(driven) == len(planning.library(MACHINE, limits))
    for manoeuvre, reach in driven:
        truth = simulate_truth(rehearsal.scenario(MODEL, manoeuvre))
        assert np.abs(truth["pose"][:, :2]).max() == reach <= limits.room_m / 2
        assert np.hypot(*truth["velocity"][:, :2].T).max() <= 1.1 * limits.speed_m_s


def test_manoeuvres_have_names_of_their_own_and_end_at_rest():
    library = planning.library(MACHINE, Limits())
    assert len({one.name for one in library}) == len(library)
    for one in library:
        assert one.commands[-1]["kind"] == "stop"
        assert one.commands[-1]["t_s"] < one.duration_s
        times = [command["t_s"] for command in one.commands]
        assert times == sorted(times)


def test_the_twist_moves_wheels_and_not_the_body():
    rehearsal = Rehearsal(MACHINE, Limits())
    twist = next(m for m, _ in rehearsal.manoeuvres(MODEL) if m.name == "twist")
    truth = simulate_truth(rehearsal.scenario(MODEL, twist))
    assert np.abs(truth["pose"]).max() < 1e-3
    assert np.abs(truth["slip_m_s"]).max() > 0.5


# ---- the separation ----


def manoeuvre(name):
    return next(one for one in planning.library(MACHINE, Limits()) if one.name == name)


def truth_of(name, sizes):
    base = tuple(MACHINE.base_parameters())
    x = np.array([MACHINE.believed[p.places[0]] for p in base])
    candidate = next(c for c in MACHINE.candidates() if c.name == name)
    return Hypothesis(base, (), x).with_effect(candidate, np.array(sizes)), candidate


def lead(name, sizes, rival, driven="reversals"):
    truth, own = truth_of(name, sizes)
    model = replace(MODEL, effects=[MACHINE.effect_of(own, sizes)])
    run = Rehearsal(MACHINE, Limits()).run(model, manoeuvre(driven))
    noise = planning.typical_noise(MACHINE, noisy(model, driven))
    data = planning.Expected(MACHINE, run, noise, truth)
    other = truth_of(rival, [0.0])[1]
    return planning.fit_rival(data, truth.without(0), other).objective


def noisy(model, driven):
    return Rehearsal(MACHINE, Limits()).run(model, manoeuvre(driven), planning.TYPICAL_SENSORS)


def test_an_effect_cannot_be_told_from_itself():
    assert abs(lead("body_drag", [4.0], "body_drag")) < 0.5


def test_the_separation_grows_with_the_square_of_the_size():
    """L is a squared distance; small effects act in proportion to their size."""
    small, large = (lead("body_drag", [c], "quadratic_body_drag") for c in (2.0, 4.0))
    assert small > 0
    assert large / small == pytest.approx(4.0, rel=0.25)


def test_probability_of_the_right_one():
    def one(separation):
        return planning.Separation(manoeuvre("twist"), separation, 0.0).probability

    assert one(0.0) == 0.5
    assert one(4 * 1.6448536**2) == pytest.approx(0.95)
    assert one(planning.CERTAIN) > 1 - 1e-6


def test_delay_and_lag_are_told_apart_by_what_changes_fast(ranked):
    """Not by driving lanes across the room, in all or by the second, which is what ranks them."""
    in_all = {one.manoeuvre.name: one.separation for one in ranked}
    per_second = {one.manoeuvre.name: one.separation / one.manoeuvre.duration_s for one in ranked}
    fast = ("multisine", "chips", "twist", "reversals", "slip_steps")
    assert ranked[0].manoeuvre.name in fast
    assert all(in_all["lanes"] < in_all[name] for name in fast)
    assert min(per_second, key=per_second.__getitem__) == "lanes"
    assert per_second["lanes"] < 0.1 * per_second[ranked[0].manoeuvre.name]


def test_the_best_is_certain_and_fast(ranked):
    per_second = [one.separation / one.manoeuvre.duration_s for one in ranked]
    assert ranked[0].separation > planning.CERTAIN
    assert per_second[0] == max(per_second)


def test_what_the_planned_manoeuvre_separates_gap_find_names(ranked, tmp_path):
    """One of the rivals as truth, driven by the firmware as the scenario file says."""
    write_model(MODEL, tmp_path / "robot.toml")
    path = planning.write_plan(ranked[0], tmp_path, tmp_path / "robot.toml")
    scenario = read_scenario(path)
    robot = replace(MODEL, effects=[Effect("driver_lag", {"time_constant_s": 0.004})])
    write_log(run_scenario(replace(scenario, model=robot)).log, tmp_path / "run.csv")
    findings = find_gap(tmp_path / "robot.toml", [tmp_path / "run.csv"], silent)
    effects = {effect["name"]: effect for effect in to_json(findings)["effects"]}
    assert "driver_lag" in effects
    assert "actuation_delay" not in [*effects, *effects["driver_lag"]["ambiguous_with"]]


# ---- as gap find asks for it ----


def known_of(name, sizes):
    """A log of a robot that has this effect, and the true structure fitted to it."""
    truth, own = truth_of(name, sizes)
    run = noisy(replace(MODEL, effects=[MACHINE.effect_of(own, sizes)]), "headings")
    noise = planning.typical_noise(MACHINE, run)
    data = planning.Data(MACHINE, [run], noise, truth)
    return data, fit(data, truth).hypothesis


def test_what_the_logs_know_already_counts():
    """Beside the log on which the rival was fitted the same manoeuvre tells more than alone."""
    data, truth = known_of("body_drag", [4.0])
    best = planning.separating_manoeuvre(MACHINE, data, truth, "body_drag", ["quadratic_body_drag"])
    assert set(best.as_json()) == {
        "name",
        "duration_s",
        "expected_separation",
        "probability_of_right",
    }
    alone = lead("body_drag", [4.0], "quadratic_body_drag", best.manoeuvre.name)
    assert best.separation > alone > 0


def test_it_is_the_named_effect_that_is_told_from_its_rivals():
    """Wherever it stands in the model."""
    data, truth = known_of("body_drag", [4.0])
    two = truth.with_effect(planning._named(MACHINE, "low_grip"), [0.9])
    first, last = (
        planning.separating_manoeuvre(MACHINE, data, final, "body_drag", ["quadratic_body_drag"])
        for final in (two, two.moved_last(0))
    )
    assert first.manoeuvre.name == last.manoeuvre.name
    assert first.separation == pytest.approx(last.separation, rel=1e-6)


def test_a_manoeuvre_that_would_tell_no_more_than_a_coin_is_not_worth_driving():
    data, truth = known_of("body_drag", [0.2])
    best = planning.separating_manoeuvre(MACHINE, data, truth, "body_drag", ["quadratic_body_drag"])
    assert not best.tells
    assert replace(best, separation=planning.LEAST_SEPARATION).tells


@given(st.floats(planning.LEAST_SEPARATION, 100.0))
def test_so_many_drives_settle_it_and_no_fewer(separation):
    drive = planning.Separation(planning.Manoeuvre("m", "", 1.0, []), separation, 0.0)
    together = [replace(drive, separation=n * separation) for n in (drive.drives, drive.drives - 1)]
    assert together[0].probability >= planning.ENOUGH > together[1].probability


def test_a_patch_among_the_rivals_ends_no_search():
    """Nothing is planned against what may be anywhere."""
    data, truth = known_of("low_grip", [0.8])
    rivals = ["body_drag", "slippery_patch"]
    assert planning.separating_manoeuvre(MACHINE, data, truth, "low_grip", rivals) is None


# ---- files and words ----


def test_the_scenario_of_a_plan_reads_back(ranked, tmp_path):
    write_model(MODEL, tmp_path / "robot.toml")
    poses = by_name(ranked)["lanes"]
    scenario = read_scenario(planning.write_plan(poses, tmp_path / "plan", tmp_path / "robot.toml"))
    assert scenario.commands == poses.manoeuvre.commands
    assert scenario.duration_s == poses.manoeuvre.duration_s
    assert scenario.model.values == MODEL.values


def gap_file(folder, effects):
    path = folder / "gap.json"
    path.write_text(json.dumps({"effects": effects, "gap": {"channels": {"gyro/z_rad_s": {}}}}))
    return path


def test_a_gap_json_asks_for_its_ambiguous_set(tmp_path):
    sure = {"name": "payload", "wheel": None, "parameters": {}, "ambiguous_with": []}
    size = {"scale": {"value": 0.9, "low": 0.8, "high": 1.0}}
    unsure = {"name": "weak_motor", "wheel": 2, "parameters": size, "ambiguous_with": ["dead_zone"]}
    question = planning.read_gap(gap_file(tmp_path, [sure, unsure]))
    assert question.names == ["weak_motor (wheel 2)", "dead_zone"]
    assert question.sizes == {"weak_motor (wheel 2)": {"scale": 0.9}}
    assert question.channels == ("gyro/z_rad_s",)


def test_a_gap_json_asks_for_what_is_ambiguous_of_the_nearest_too(tmp_path):
    near = {"name": "payload", "wheel": None, "parameters": {}, "ambiguous_with": ["cog_offset"]}
    path = gap_file(tmp_path, [])
    path.write_text(json.dumps(json.loads(path.read_text()) | {"nearest": [near]}))
    assert planning.read_gap(path).names == ["payload", "cog_offset"]


def unsure(name, *rivals, **more):
    return {"name": name, "parameters": {}, "ambiguous_with": rivals} | more


def test_a_gap_json_without_wheels_and_channels_means_all(tmp_path):
    path = gap_file(tmp_path, [unsure("driver_lag", "actuation_delay")])
    path.write_text(json.dumps(json.loads(path.read_text()) | {"gap": {"channels": {}}}))
    question = planning.read_gap(path)
    assert question.names == ["driver_lag", "actuation_delay"]
    assert question.channels == ROBOT_CHANNELS


SIGNS = unsure("encoder_sign", "motor_sign (wheel 1); motor_sign (wheel 2)", wheel=1)
PERMUTED = unsure(
    "wheel_permutation", "encoder_sign (wheel 1)", parameters={"wheels": [2, 1, 3, 4]}
)


def test_what_cannot_be_driven_is_passed_over(tmp_path):
    effects = [SIGNS, PERMUTED, unsure("payload", "slippery_patch", "cog_offset")]
    assert planning.read_gap(gap_file(tmp_path, effects)).names == ["payload", "cog_offset"]


def test_wiring_alone_cannot_be_planned_for(tmp_path):
    with pytest.raises(
        InputError, match=r"no manoeuvre.* encoder_sign \(wheel 1\) from motor_sign"
    ):
        planning.read_gap(gap_file(tmp_path, [SIGNS, PERMUTED]))


@pytest.mark.parametrize("name", ["motor_sign (wheel 1)", "wheel_permutation", "impact"])
def test_no_manoeuvre_is_for_wiring_and_pushes(name):
    with pytest.raises(InputError, match=f"no manoeuvre is for {name.split(' ')[0]}"):
        planning.plan(MODEL, planning.Question([name, "payload"]), planning.Limits(), print)


def test_rivals_of_one_wheel_are_asked_for_with_it(tmp_path):
    rivals = [{"name": "weak_motor", "wheel": 3}]
    path = gap_file(tmp_path, [unsure("one_wheel_drag", "weak_motor", wheel=2, rivals=rivals)])
    assert planning.read_gap(path).names == ["one_wheel_drag (wheel 2)", "weak_motor (wheel 3)"]


MALFORMED = {
    "no table": 1,
    "no name": {"ambiguous_with": ["payload"], "parameters": {}},
    "a text for a size": unsure("payload", "cog_offset", parameters={"mass_kg": {"value": "x"}}),
    "a bare size": unsure("payload", "cog_offset", parameters={"mass_kg": 1.0}),
    "a number for a name": unsure(3, "cog_offset"),
    "a number for a rival": unsure("payload", 3),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_effect_is_named_as_such(case, tmp_path):
    with pytest.raises(InputError, match=r"not a gap\.json as gap find writes it"):
        planning.read_gap(gap_file(tmp_path, [MALFORMED[case]]))


def test_logs_of_another_machine_cannot_be_planned_for():
    with pytest.raises(InputError, match="none of the channels of a robot"):
        planning.plan(MODEL, Question(PAIR, {}, ("axis/position_m",)), Limits(), silent)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"effects": 3}', '{"effects": [], "gap": null}'])
def test_a_gap_json_without_a_question_is_refused(text, tmp_path):
    (tmp_path / "gap.json").write_text(text)
    with pytest.raises(InputError, match=r"gap\.json"):
        planning.read_gap(tmp_path / "gap.json")


def test_an_unknown_effect_is_refused_with_the_nearest():
    with pytest.raises(InputError, match=r"driver_lagg.*did you mean 'driver_lag'"):
        planning.plan(MODEL, Question(["driver_lagg", "dead_zone"]), Limits(), silent)


def test_few_of_the_known_effects_are_shown():
    with pytest.raises(InputError) as refused:
        planning.plan(MODEL, Question(["foo", "dead_zone"]), Limits(), silent)
    assert "unknown effect 'foo'; did you mean" in str(refused.value)
    assert len(str(refused.value)) < 200


def test_an_effect_of_one_wheel_needs_the_wheel():
    with pytest.raises(InputError, match=r"'weak_motor \(wheel 1\)' to 'weak_motor \(wheel 4\)'"):
        planning.plan(MODEL, Question(["weak_motor", "dead_zone"]), Limits(), silent)


def test_one_effect_is_no_question():
    with pytest.raises(InputError, match="at least two"):
        planning.plan(MODEL, Question(["dead_zone", "dead_zone"]), Limits(), silent)


def test_an_axis_has_no_firmware_to_plan_for(tmp_path):
    (tmp_path / "axis.toml").write_text(model_text())
    with pytest.raises(InputError, match="robot"):
        planning.plan(read_model(tmp_path / "axis.toml"), Question(PAIR), Limits(), silent)
