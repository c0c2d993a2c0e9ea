"""One step further than the search: sizes far from none, pairs, the noise beside an effect."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from axis_bench import ROW_S, Bench, make_log, make_machine, make_runs, silent
from omnislip.gap import ahead as ahead_module
from omnislip.gap.ahead import Ahead, Further
from omnislip.gap.inference import Evidence, fit
from omnislip.gap.judge import SURE_GAIN, WITHIN_LAW, Trial
from omnislip.gap.machine import CURVE, Machine
from omnislip.gap.noise import track_all
from omnislip.gap.recordings import machine_for, make_run
from omnislip.gap.refit import refit_each
from omnislip.gap.screen import screen
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario
from truth_bench import logs_of, robot_runs


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    return make_machine(tmp_path_factory.mktemp("axis"))


@pytest.mark.parametrize(("fitted_n", "factor"), [(0.7, 2.0), (1.5, 1.0)])
def test_a_size_that_was_pulled_is_looked_for_further_away(machine, fitted_n, factor):
    """By the likelihood of the model's own filter; the keys have taken 0.5 N of 2.0 N."""
    runs = make_runs(machine, Bench(coulomb_n=2.0), range(2))
    data, current = settle(machine, runs, believed_hypothesis(machine))
    ahead = Ahead(data, current, machine.candidates(), 1, 100, silent)
    [friction] = [c for c in machine.candidates() if c.effect == "coulomb_friction"]
    larger = ahead._larger(friction, current.hypothesis.with_effect(friction, [fitted_n]))
    assert larger.values_of(-1) == pytest.approx([factor * fitted_n])


@pytest.mark.parametrize("name", ["actuation_delay", "driver_lag"])
def test_a_delay_of_some_rows_is_found_in_a_loop_that_it_sets_swinging(tmp_path, name):
    """No derivative leads there, and none is found where a lag explains more."""
    candidates = {c.effect: c for c in Machine(read_model(NOMINAL_ROBOT)).candidates()}
    size = candidates[name].parameters[0].label
    hidden = HiddenEffect(name, {size: 0.0155}).as_dict()
    case = TruthCase(seed=118, effects=(hidden,), closed_loop=True, excitation="ordinary", runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    accepted = fit(data, current.hypothesis.with_effect(candidates["driver_lag"], [0.0155]))
    ahead = Ahead(data, current, robot.candidates(), 1, 100, silent)
    further = ahead.far(candidates["actuation_delay"], accepted)
    if name == "actuation_delay":
        quarter_row_s = 0.25 * 0.005
        assert further.fitted.hypothesis.values_of(0) == pytest.approx(0.0155, abs=quarter_row_s)
    else:
        assert further is None


@pytest.mark.parametrize("rows", [0, 1])
def test_a_delay_of_a_row_is_found_of_an_axis_whose_noise_takes_it_for_chance(machine, rows):
    """The log holds each command one row before it acts."""
    logs = [make_log(Bench(), seed) for seed in range(3)]
    for log in logs:
        log.columns["axis/command"] = np.roll(log.columns["axis/command"], -rows)
    runs = [make_run(machine, log) for log in logs]
    data, current = settle(machine, runs, believed_hypothesis(machine))
    [delay] = [c for c in machine.candidates() if c.effect == "actuation_delay"]
    further = Ahead(data, current, machine.candidates(), 1, 100, silent).far(delay, None)
    if rows:
        assert further.fitted.hypothesis.values_of(0) == pytest.approx(ROW_S, abs=0.05 * ROW_S)
    else:
        assert further is None


@pytest.mark.parametrize("limit_a", [1.0, None])
def test_a_limit_is_found_where_logged_currents_end(limit_a):
    """By noise that fits it; currents that nothing limits do not end."""
    hidden = (HiddenEffect("current_limit", {"limit_a": limit_a}).as_dict(),) if limit_a else ()
    sensors = ("gyro", "pose", "supply", "current")
    case = TruthCase(
        seed=8,
        effects=hidden,
        sensors=sensors,
        excitation="rich",
        runs=3,
        run_duration_s=3.0,
        base_offset_sd=0.0,
    )
    logs = logs_of(case)
    robot = machine_for(read_model(NOMINAL_ROBOT), logs)
    runs = [replace(make_run(robot, log), unit=log.name) for log in logs]
    data, current = settle(robot, runs, believed_hypothesis(robot))
    ahead = Ahead(data, current, robot.candidates_for(runs), 1, 100, silent)
    further = ahead.clipped(None)
    if limit_a is None:
        assert further is None and robot.clipped_at_a(runs) is None
        return
    [found_a] = further.fitted.hypothesis.values_of(0)
    assert found_a == pytest.approx(limit_a, rel=0.02)
    assert [trial.candidate.effect for trial in ahead.trials] == ["current_limit"]
    others = [c for c in robot.candidates() if c.effect != "current_limit"]
    assert Ahead(data, current, others, 1, 100, silent).clipped(None) is None


@pytest.mark.parametrize("angle_rad", [0.063, 0.0])
def test_play_is_found_where_less_play_explains_less_than_none(tmp_path, angle_rad):
    """No derivative leads there; where there is none, none is found."""
    hidden = (HiddenEffect("gear_backlash", {"angle_rad": angle_rad}),) if angle_rad else ()
    effects = tuple(effect.as_dict() for effect in hidden)
    case = TruthCase(seed=21007, effects=effects, sensors=("gyro", "pose", "supply"), runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    play = candidates["gear_backlash"]
    ahead = Ahead(data, current, robot.candidates(), 1, 100, silent)
    further = ahead.far(play, None)
    if angle_rad:
        half = ahead._likelihood(current.hypothesis.with_effect(play, [0.5 * angle_rad]), runs)
        assert half < ahead._likelihood(current.hypothesis, runs)
        assert further.fitted.hypothesis.values_of(0) == pytest.approx(angle_rad, rel=0.03)
    else:
        assert further is None
        assert ahead.trials == []


@pytest.mark.parametrize("length_m", [1.4e-3, 0.0])
def test_bristles_are_found_beside_another_effect_by_noise_that_fits_both(tmp_path, length_m):
    """Noise that fits the other alone takes what they hold for chance."""
    cogging = {"torque_nm": 0.02, "cycles_per_rev": 2.0, "phase_rad": 0.4}
    hidden = [HiddenEffect("cogging", cogging)]
    if length_m:
        hidden.append(HiddenEffect("bristle_relaxation", {"length_m": length_m}))
    effects = tuple(effect.as_dict() for effect in hidden)
    case = TruthCase(seed=21007, effects=effects, sensors=(), runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    ahead = Ahead(data, current, robot.candidates(), 1, 100, silent)
    start = current.hypothesis.with_effect(candidates["cogging"], list(cogging.values()))
    first = ahead._by_its_noise(candidates["cogging"], start)
    further = ahead._far_beside(first, candidates["bristle_relaxation"])
    if length_m:
        assert further.trial.accepted
        assert further.fitted.hypothesis.values_of(1)[0] == pytest.approx(length_m, rel=0.05)
    else:
        assert further is None


def look_ahead_of_bristles(folder, length_m):
    """Ahead of the believed model of a robot with bristles, or with none; its candidates."""
    hidden = (HiddenEffect("bristle_relaxation", {"length_m": length_m}),) if length_m else ()
    effects = tuple(effect.as_dict() for effect in hidden)
    robot, runs, candidates = robot_runs(TruthCase(seed=21007, effects=effects, runs=2), folder)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    return Ahead(data, current, robot.candidates(), 1, 100, silent), candidates


@pytest.mark.parametrize("length_m", [0.9e-3, 4e-3, 0.0])
def test_bristles_are_found_along_their_own_filter(tmp_path, length_m):
    """That of rigid contact takes what they hold for pushes; where none are, none are found."""
    ahead, candidates = look_ahead_of_bristles(tmp_path, length_m)
    further = ahead.far(candidates["bristle_relaxation"], None)
    if length_m:
        assert further.fitted.hypothesis.values_of(0)[0] == pytest.approx(length_m, rel=0.03)
    else:
        assert further is None
        assert ahead.trials == []


@pytest.mark.parametrize("rolling", [1.0, 2.0])
def test_what_lags_by_the_way_rolled_is_told_force_or_slip(rolling):
    """By logs of the plant itself: the generator has bristles of the other kind."""
    scenario = read_scenario(NOMINAL_ROBOT.parents[1] / "scenarios" / "identification.toml")
    tyres = Effect("bristle_relaxation", {"length_m": 0.02, "rolling": rolling})
    robot = replace(scenario.model, effects=[tyres])
    log = run_scenario(replace(scenario, model=robot)).log
    machine = machine_for(read_model(NOMINAL_ROBOT), [log])
    data, current = settle(machine, [make_run(machine, log)], believed_hypothesis(machine))
    ahead = Ahead(data, current, machine.candidates(), 1, 100, silent)
    [candidate] = [c for c in machine.candidates() if c.effect == tyres.name]
    none = ahead._likelihood(current.hypothesis, data.runs)
    told = {
        way: ahead._likelihood(current.hypothesis.with_effect(candidate, [0.02, way]), data.runs)
        for way in (start[1] for start in candidate.starts)
    }
    assert max(told, key=told.__getitem__) == rolling
    assert told[rolling] > none


@pytest.mark.parametrize("length_m", [0.02, 0.0])
def test_bristles_are_found_each_size_by_noise_that_fits_it(tmp_path, length_m):
    """As a tyre relaxes, in a long way; where none are, none are found."""
    ahead, _ = look_ahead_of_bristles(tmp_path, length_m)
    found = ahead._far_by_noise()
    if length_m:
        further = max(found, key=Further.gain)
        assert further.trial.candidate.name == "bristle_relaxation"
        assert further.trial.accepted
        assert further.fitted.hypothesis.values_of(0)[0] == pytest.approx(length_m, rel=0.03)
    else:
        assert found == []


SPRING = HiddenEffect("shaft_compliance", {"stiffness_nm_rad": 36.0, "damping_nm_s_rad": 0.04})
COGGING = {"torque_nm": 0.02, "cycles_per_rev": 2.0, "phase_rad": 0.4}
WEAK = HiddenEffect("weak_motor", {"scale": 0.4}, 3)
PLAY = HiddenEffect("gear_backlash", {"angle_rad": 0.12})
LOOKED_FOR = "step 1: looking for play and springs"


@pytest.mark.parametrize("hidden", [SPRING, PLAY, HiddenEffect("cogging", COGGING), WEAK, None])
def test_play_and_springs_are_looked_for_where_shafts_are_shaken(tmp_path, hidden):
    """By noise that fits each: by that of stiff shafts a true spring is less likely than these.
    Cogging shakes shafts, too, and a weak motor one of them.

    They may have been in the model before, with the share of the inertia behind them.
    """
    effects = (hidden.as_dict(),) if hidden else ()
    case = TruthCase(seed=21007, effects=effects, runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    dropped = current.hypothesis.with_effect(candidates["shaft_compliance"], [30.0, 0.05])
    for share in robot.refinements(candidates["shaft_compliance"]):
        dropped = dropped.with_effect(share, [0.2]).last_two_joined()
    told = []
    either = [dropped.effects[-1], candidates["gear_backlash"]]
    ahead = Ahead(data, current, either, 1, 100, told.append)
    further = ahead.loose(None)
    assert (LOOKED_FOR in told) == (hidden not in (WEAK, None))
    if hidden is SPRING:
        stiffness, damping, load_share = further.fitted.hypothesis.values_of(0)
        assert (stiffness, damping) == pytest.approx(tuple(SPRING.parameters.values()), rel=0.05)
        assert load_share == pytest.approx(0.2, rel=0.05)
    elif hidden is PLAY:
        angle_rad = PLAY.parameters["angle_rad"]
        assert further.fitted.hypothesis.values_of(0) == pytest.approx(angle_rad, rel=0.03)
    else:
        assert further is None
        assert ahead.trials == []
    assert Ahead(data, current, [], 1, 100, told.append).loose(None) is None


@pytest.mark.parametrize(
    ("hidden", "named", "looked_for"),
    [
        (HiddenEffect("cogging", COGGING), "cogging", False),
        (SPRING, "motor_inertia_error", True),
        (SPRING, "cogging", True),
    ],
)
def test_neither_is_looked_for_beside_what_leaves_no_shaft_shaken(
    tmp_path, hidden, named, looked_for
):
    """What shook the shafts has a name then; a heavier rotor, named for a spring, leaves most."""
    case = TruthCase(seed=21007, effects=(hidden.as_dict(),), runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    [accepted] = refit_each(data, current, screen(data, current, [candidates[named]]))

    def begins(message):
        assert message == LOOKED_FOR
        raise InterruptedError

    ahead = Ahead(data, current, [candidates["shaft_compliance"]], 1, 100, begins)
    if looked_for:
        with pytest.raises(InterruptedError):
            ahead.loose(accepted)
    else:
        assert ahead.loose(accepted) is None


@pytest.mark.parametrize(("likelier", "finer"), [(-600.0, False), (-400.0, True)])
def test_finer_plays_and_springs_are_asked_where_coarse_ones_are_not_far_off(
    tmp_path, monkeypatch, likelier, finer
):
    """Beside magnets, which shake the shafts, too."""
    effects = (HiddenEffect("cogging", COGGING).as_dict(),)
    robot, runs, _ = robot_runs(TruthCase(seed=21007, effects=effects, runs=2), tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    asked = []

    def by_own_noise(data, model, runs):
        asked.append([effect.effect for effect in model.effects])
        return likelier if model.effects else 0.0

    monkeypatch.setattr(ahead_module, "_by_own_noise", by_own_noise)
    assert Ahead(data, current, robot.candidates(), 1, 100, silent).loose(None) is None
    plays, springs = asked.count(["gear_backlash"]), asked.count(["shaft_compliance"])
    assert asked.count([]) == 1 and len(asked) == 1 + plays + springs
    coarse = -(-ahead_module.FAR_SIZES["gear_backlash"][2] // ahead_module.PLAYS_APART)
    assert (plays > coarse) == (springs > len(ahead_module.STIFFNESSES)) == finer
    assert finer or (plays, springs) == (coarse, len(ahead_module.STIFFNESSES))


@pytest.mark.parametrize(
    ("gain", "promise", "much"), [(150.0, 20.0, False), (250.0, 20.0, True), (10.0, 250.0, True)]
)
def test_what_no_chance_gives_is_worth_looking_further(monkeypatch, gain, promise, much):
    """As inflated as it may be: sizes far from none are tried then, and the best is taken."""
    candidate = SimpleNamespace(name="bristle_relaxation", effect="bristle_relaxation")
    hypothesis = SimpleNamespace(effects=[1, 2, 3])
    evidence = SimpleNamespace(gain=gain, inflation=30.0, beyond_chance=gain / 30.0)
    refused = Trial(1, candidate, None, evidence, 1.0, 1.0, True, "could be chance", False)
    taken, other = (replace(refused, accepted=True, reason=of) for of in ("most", "less"))
    far = [
        Further(None, SimpleNamespace(objective=q), SimpleNamespace(objective=0.0), trial)
        for q, trial in ((300.0, taken), (200.0, other))
    ]
    monkeypatch.setattr(Ahead, "_far_by_noise", lambda _: far)
    monkeypatch.setattr(Ahead, "_by_its_noise", lambda *_: None)
    monkeypatch.setattr(Ahead, "_larger", lambda *_: None)
    ahead = Ahead(None, SimpleNamespace(hypothesis=hypothesis), [], 1, 100, silent)
    fitted = SimpleNamespace(objective=0.0, hypothesis=None, jacobian=None)
    screened = [SimpleNamespace(candidate=candidate, promise=promise)]
    assert ahead.best([], []) is None
    assert ahead.best([(refused, fitted)], screened) is (far[0] if much else None)
    assert [trial.accepted for trial in ahead.trials] == ([True, False] if much else [])


@pytest.mark.parametrize(("beyond_chance", "looks"), [(5.0, False), (60.0, True)])
def test_seconds_are_tried_beside_what_gains_by_its_own_noise(monkeypatch, beyond_chance, looks):
    """What gained 80 beyond chance by the noise of the model without it."""
    candidate = SimpleNamespace(name="slippery_patch", effect="slippery_patch")
    evidence = SimpleNamespace(gain=80.0, inflation=1.0, beyond_chance=80.0)
    refused = Trial(1, candidate, None, evidence, 1.0, 1.0, True, "too little", False)
    own = SimpleNamespace(gain=80.0, inflation=1.0, beyond_chance=beyond_chance)
    first = Further(None, None, None, replace(refused, evidence=own))
    seen = []
    monkeypatch.setattr(Ahead, "_by_its_noise", lambda *_: first)
    monkeypatch.setattr(Ahead, "_larger", lambda *_: None)
    monkeypatch.setattr(Ahead, "_pairs", lambda _, one: seen.append(one) or [])
    current = SimpleNamespace(hypothesis=SimpleNamespace(effects=[]))
    fitted = SimpleNamespace(objective=0.0, hypothesis=None, jacobian=None)
    assert Ahead(None, current, [], 1, 100, silent).best([(refused, fitted)], []) is None
    assert seen == ([first] if looks else [])


def test_answers_within_a_row_are_no_delay_of_some_rows(tmp_path):
    """A likelihood that takes the commands as given prefers those of the row before."""
    case = TruthCase(seed=86, closed_loop=True, excitation="ordinary", runs=2, noise_level=3.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    delay = candidates["actuation_delay"]
    data, current = settle(robot, runs, believed_hypothesis(robot))
    delayed = current.hypothesis.with_effect(delay, [1.25 * 0.005])
    here, before = (
        sum(t.log_likelihood for t in track_all(robot, runs, h.flat(data.believed), data.noise))
        for h in (current.hypothesis, delayed)
    )
    assert before > here + SURE_GAIN
    ahead = Ahead(data, current, robot.candidates(), 1, 100, silent)
    assert ahead.far(delay, None) is None
    assert ahead.trials == []


@pytest.mark.parametrize("curve", ["rational", "atan"])
def test_another_law_of_friction_is_found_in_its_own_shape(tmp_path, curve):
    """Asked where an effect surely explains something that friction off its law may do too."""
    case = TruthCase(seed=21007, friction_curve=curve, runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    ahead = Ahead(data, current, robot.candidates(), 1, 100, silent)
    much = Evidence(2.0 * SURE_GAIN, 1.0, 0.0, np.eye(1))
    [falls] = [c for c in robot.candidates() if c.name == "grip_falloff"]
    refused = Trial(1, falls, np.ones(2), much, 0.0, 1.0, True, WITHIN_LAW, False)
    assert ahead.by_another_law([replace(refused, reason="could be chance")]) is None
    little = replace(much, gain=0.5 * SURE_GAIN)
    assert ahead.by_another_law([replace(refused, evidence=little)]) is None
    assert ahead.trials == []
    further = ahead.by_another_law([refused])
    [trial] = ahead.trials
    assert trial.accepted == (further is not None) == (curve == "rational")
    if further is not None:
        [law] = further.fitted.hypothesis.effects
        assert law.effect == CURVE
        assert [parameter.label for parameter in law.parameters] == ["blend", "rational"]
        towards_tanh = fit(data, current.hypothesis.with_effect(candidates[CURVE], [0.1]))
        assert further.fitted.objective < towards_tanh.objective - 0.5 * SURE_GAIN
        curved = Ahead(data, further.fitted, robot.candidates(), 2, 100, silent)
        assert curved.by_another_law([refused]) is None
