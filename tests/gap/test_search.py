"""What is missing on an axis: named right, the simplest wins, and nothing is found in nothing."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from axis_bench import Bench, make_log, make_machine, make_runs, silent
from omnislip.gap import search as search_module
from omnislip.gap.inference import Data, fit, linearise, weigh
from omnislip.gap.machine import Machine
from omnislip.gap.noise import RunawayError, track_all
from omnislip.gap.recordings import make_run
from omnislip.gap.search import believed_hypothesis, screen, search, settle, stability_of
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.log_file import read_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model
from scipy.stats import binom


def find(machine, bench, first_seed=0):
    seeds = [*range(first_seed, first_seed + 4), *range(first_seed + 10, first_seed + 14)]
    return search(machine, make_runs(machine, bench, seeds), None, silent)


def robot_runs(case, folder):
    """The robot of a case's logs, its runs, and its candidates by their effects."""
    write_case(case, folder)
    robot = Machine(read_model(folder / "robot.toml"))
    logs = [read_log(path, "robot") for path in sorted(folder.glob("run_*.csv"))]
    runs = [replace(make_run(robot, log), unit=log.name) for log in logs]
    candidates = robot.candidates_for(runs)
    return robot, runs, {c.effect: c for c in candidates}


def robot_with_magnets(magnets, folder):
    """The same of a robot whose motors cog; the phase is 1 rad."""
    hidden = {"torque_nm": 0.008, "cycles_per_rev": magnets, "phase_rad": 1.0}
    effect = HiddenEffect("cogging", hidden).as_dict()
    case = TruthCase(seed=3, runs=2, run_duration_s=3.0, base_offset_sd=0.0, effects=(effect,))
    return robot_runs(case, folder)


def names(outcome):
    return [selected.candidate.effect for selected in outcome.selected]


HIDDEN = {
    "coulomb_friction": (Bench(coulomb_n=2.0), {"torque_nm": 2.0}),
    "asymmetric_friction": (
        Bench(forward_n=2.0, forward_n_s_m=2.0),
        {"torque_nm": 2.0, "viscous_nm_s": 2.0},
    ),
    "dead_zone": (Bench(dead_zone_v=0.1), {"duty": 0.1}),
    "viscous_friction_error": (Bench(viscous_n_s_m=20.0), {"viscous_friction_nm_s": 5.0}),
}


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    return make_machine(tmp_path_factory.mktemp("axis"))


@pytest.fixture(scope="module")
def outcomes(machine):
    return {name: find(machine, bench) for name, (bench, _) in HIDDEN.items()}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_hidden_effect_is_the_only_one_named(outcomes, name):
    outcome = outcomes[name]
    assert names(outcome) == [name]
    assert outcome.leftover == ()


@pytest.mark.parametrize("name", HIDDEN)
def test_a_clear_name_holds_in_nearly_every_resample_of_the_runs(outcomes, name):
    [selected] = outcomes[name].selected
    assert selected.stability > 0.95


def test_a_name_that_one_run_of_eight_gives_is_lost_where_that_run_is_not_drawn(outcomes):
    """A rival is worse by 100 in the first run and better by 10 in each of the others."""
    data, final = outcomes["coulomb_friction"].data, outcomes["coulomb_friction"].final
    runs = data.per_run(final.residual)
    shift = [100.0] + [-10.0] * 7
    moved = [r * np.sqrt(1.0 + s / np.sum(r**2)) for r, s in zip(runs, shift, strict=True)]
    rival = replace(final, residual=np.concatenate(moved))
    assert stability_of(data, final, [rival]) == pytest.approx(1 - (7 / 8) ** 8, abs=0.05)


def test_units_of_runs_are_drawn_not_runs(outcomes):
    """Eight runs in two units are too few to say anything."""
    outcome = outcomes["coulomb_friction"]
    runs = [replace(r, unit=u) for r, u in zip(outcome.data.runs, "aaaabbbb", strict=True)]
    pooled = Data(outcome.data.machine, runs, outcome.data.noise, outcome.base.hypothesis)
    assert np.isnan(stability_of(pooled, outcome.final, [outcome.base]))


@pytest.mark.parametrize("name", HIDDEN)
def test_its_size_is_right_within_four_standard_deviations(outcomes, name):
    """And these are 0.1 to 10 % of the size: an interval that says nothing would pass too."""
    [selected] = outcomes[name].selected
    truth = HIDDEN[name][1]
    labels = [p.label for p in selected.candidate.parameters]
    wanted = np.array([truth[label] for label in labels])
    deviation = np.sqrt(np.diag(selected.evidence.covariance))
    assert np.all(np.abs(selected.values - wanted) < 4 * deviation)
    assert np.all(deviation < 0.1 * wanted) and np.all(deviation > 1e-3 * wanted)


def test_the_simplest_of_equals_wins(machine):
    """With these noises Stribeck friction, which holds Coulomb friction, fits a little better.

    A parameter more has to gain 10.8, what chance gives once in a thousand.
    """
    outcome = find(machine, Bench(coulomb_n=0.5), first_seed=200)
    gains = {t.candidate.effect: t.evidence.gain for t in outcome.trials if t.step == 1}
    assert names(outcome) == ["coulomb_friction"]
    assert 0 < gains["stribeck_friction"] - gains["coulomb_friction"] < 10.8


def test_ladder_goes_down_to_the_final_model(outcomes):
    outcome = outcomes["coulomb_friction"]
    assert len(outcome.ladder) == 2
    assert outcome.ladder[-1] is outcome.final
    assert outcome.final.objective < outcome.base.objective - 1000
    assert outcome.final.objective == pytest.approx(outcome.final.residual.size, rel=0.1)


def test_every_trial_says_why(outcomes):
    trials = outcomes["dead_zone"].trials
    assert [t.candidate.effect for t in trials if t.accepted] == ["dead_zone"]
    assert all(t.reason for t in trials)


def test_nothing_missing_nothing_found(machine):
    """20 data sets with nothing hidden: at the level of 1 % each, more than 3 alarms are wrong.

    Keys are off by half a tolerance, which is no effect.
    """
    alarms = [
        names(find(machine, Bench(mass_kg=10.1, viscous_n_s_m=14.9), first_seed=100 * k))
        for k in range(1, 21)
    ]
    assert sum(bool(found) for found in alarms) <= binom.ppf(0.999, 20, 0.01) + 1


def test_nothing_found_gives_a_limit_for_every_candidate(machine):
    outcome = find(machine, Bench())
    assert outcome.selected == ()
    assert set(outcome.limits) == {c.name for c in machine.candidates()}
    sizes = [size for limits in outcome.limits.values() for size in limits.values()]
    assert all(size > 0 for size in sizes)


@pytest.mark.parametrize("factor, found", [(3.0, True), (0.2, False)])
def test_limit_of_detection_is_where_detection_begins(machine, factor, found):
    """Three times the limit is a gain of 225 and seen; a fifth of it is a gain of 1 and is not."""
    limit = find(machine, Bench()).limits["coulomb_friction"]["force_n"]
    outcome = find(machine, Bench(coulomb_n=factor * limit))
    assert ("coulomb_friction" in names(outcome)) == found


@pytest.mark.parametrize("name", HIDDEN)
def test_the_amended_model_has_no_gap(machine, outcomes, name, tmp_path):
    """New runs of the same bench, after a trip through the model file."""
    outcome = outcomes[name]
    [selected] = outcome.selected
    sizes = {
        machine.file_parameter(p.label): float(value)
        for p, value in zip(selected.candidate.parameters, selected.values, strict=True)
    }
    hypothesis = outcome.final.hypothesis
    factors = {
        p.label: float(x / machine.believed[p.places[0]])
        for p, x in zip(hypothesis.base, hypothesis.x, strict=False)
    }
    path = tmp_path / "amended.toml"
    write_model(machine.amended_model(factors, [Effect(name, sizes)]), path)
    again = find(Machine(read_model(path)), HIDDEN[name][0], first_seed=50)
    assert names(again) == []
    assert again.leftover == ()


def test_two_effects_are_both_named(machine):
    outcome = find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1))
    assert sorted(names(outcome)) == ["coulomb_friction", "dead_zone"]


@pytest.mark.parametrize("rubs", [True, False])
def test_a_search_goes_on_from_one_before_only_if_all_of_that_holds(machine, outcomes, rubs):
    """Where nothing rubs, friction that was found before is looked for from the beginning."""
    before = outcomes["coulomb_friction"]
    told = []
    runs = make_runs(machine, Bench(coulomb_n=2.0 if rubs else 0.0), [*range(20, 28)])
    outcome = search(machine, runs, None, told.append, before=before)
    went_on = "going on from what was found before" in told
    assert went_on == rubs
    assert names(outcome) == (["coulomb_friction"] if rubs else [])
    assert outcome.limits.keys() == before.limits.keys()
    if rubs:
        first, *_ = outcome.trials
        assert first in before.trials
        assert max(trial.step for trial in outcome.trials if trial.accepted) == 1


def test_what_gave_way_to_another_is_looked_for_again(machine, monkeypatch):
    """Where both are there: one explained the other's part as long as that was missing."""
    swap, calls = search_module._swap, []

    def other_first(data, fitted, neighbours, progress):
        calls.append(fitted)
        if len(calls) > 1:
            return swap(data, fitted, neighbours, progress)
        [taken] = fitted.hypothesis.effects
        [other] = {"coulomb_friction", "dead_zone"} - {taken.effect}
        candidate = next(c for c in data.machine.candidates() if c.effect == other)
        sizes = [0.1 * candidate.parameters[0].scale]
        return fit(data, fitted.hypothesis.without(0).with_effect(candidate, sizes)), {}

    monkeypatch.setattr(search_module, "_swap", other_first)
    outcome = find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1))
    assert sorted(names(outcome)) == ["coulomb_friction", "dead_zone"]


def test_a_search_ends_where_steps_leave_the_model_as_it_was(machine, monkeypatch):
    """Each takes an effect that is needless when all has settled."""
    monkeypatch.setattr(
        search_module, "_drop_needless", lambda data, fitted, tried: fit(data, bare(fitted))
    )

    def bare(fitted):
        return fitted.hypothesis.without_effects()

    outcome = find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1, viscous_n_s_m=25.0))
    steps = {trial.step for trial in outcome.trials if trial.accepted}
    assert names(outcome) == []
    assert steps == set(range(1, search_module.MOST_VAIN_STEPS + 1))


@pytest.mark.parametrize("ahead_gain", [search_module.AHEAD_GAIN, np.inf])
def test_what_is_refused_is_judged_again_by_the_noise_that_is_left_beside_it(
    machine, monkeypatch, ahead_gain
):
    """Noise that was tuned without an effect covers it; by that noise it is refused here.

    Also where its fit gains too little to be worth looking, and only the linear model promised.
    """
    monkeypatch.setattr(search_module, "AHEAD_GAIN", ahead_gain)
    better, noises = search_module._replays_better, []

    def refused_by_the_first(data, *models):
        noises.append(data.noise)
        return data.noise is not noises[0] and better(data, *models)

    monkeypatch.setattr(search_module, "_replays_better", refused_by_the_first)
    outcome = find(machine, Bench(coulomb_n=2.0))
    assert names(outcome) == ["coulomb_friction"]
    [taken] = [trial for trial in outcome.trials if trial.accepted]
    assert taken.reason.startswith("by the noise that is left beside it: ")


@pytest.mark.parametrize(("fitted_n", "factor"), [(0.7, 2.0), (1.5, 1.0)])
def test_a_size_that_was_pulled_is_looked_for_further_away(machine, fitted_n, factor):
    """By the likelihood of the model's own filter; the keys have taken 0.5 N of 2.0 N."""
    runs = make_runs(machine, Bench(coulomb_n=2.0), range(2))
    data, current = settle(machine, runs, believed_hypothesis(machine))
    ahead = search_module._Ahead(data, current, machine.candidates(), 1, 100, silent)
    [friction] = [c for c in machine.candidates() if c.effect == "coulomb_friction"]
    larger = ahead._larger(friction, current.hypothesis.with_effect(friction, [fitted_n]))
    assert larger.values_of(-1) == pytest.approx([factor * fitted_n])


def test_what_shows_beside_the_newest_effect_is_a_rival_of_the_older_one(machine, monkeypatch):
    """With one rival each the older effect has two: its own and that of the newest."""
    swap, offered = search_module._swap, []

    def recorded(data, fitted, neighbours, progress):
        offered.append({name: [c.name for c in own] for name, own in neighbours.items()})
        return swap(data, fitted, neighbours, progress)

    monkeypatch.setattr(search_module, "NEIGHBOURS", 1)
    monkeypatch.setattr(search_module, "_swap", recorded)
    find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1))
    first, second = offered[:2]
    [older] = first
    [newest] = second.keys() - {older}
    assert second[older] == first[older] + second[newest]
    assert second[newest] != first[older]


def test_a_candidate_whose_own_filter_loses_the_robot_gets_no_name(machine, monkeypatch):
    def lose_what_has_effects(machine, runs, start, *args, **options):
        if start.effects:
            raise RunawayError("run_00: its motion grows without bounds")
        return settle(machine, runs, start, *args, **options)

    monkeypatch.setattr(search_module, "settle", lose_what_has_effects)
    outcome = find(machine, Bench(coulomb_n=2.0))
    assert outcome.selected == ()
    assert [trial for trial in outcome.trials if trial.accepted] == []
    assert "does not follow" in " ".join(trial.reason for trial in outcome.trials)
    data, current = settle(machine, outcome.data.runs, outcome.base.hypothesis)
    ahead = search_module._Ahead(data, current, machine.candidates(), 1, 100, silent)
    start = current.hypothesis.with_effect(outcome.trials[0].candidate, outcome.trials[0].values)
    assert ahead.best([(outcome.trials[0], replace(current, hypothesis=start))], []) is None
    assert ahead.trials == []


@pytest.mark.parametrize("share", [0.244, 0.4, 0.78, 0.97])
def test_a_threshold_between_two_starts_is_found(tmp_path, share):
    """An encoder loses counts beyond a share of the fastest speed; starts are at 0.5, 0.7, ..."""
    lost = {"fraction": 0.03, "speed_rad_s": share * 320.0}
    hidden = HiddenEffect("encoder_dropout", lost, 2).as_dict()
    case = TruthCase(seed=5, effects=(hidden,), runs=3, run_duration_s=4.0)
    robot, runs, _ = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    dropout = [c for c in robot.candidates_for(runs) if c.name == "encoder_dropout (wheel 2)"]
    [fitted] = search_module._refit(data, current, screen(data, current, dropout))
    fraction, speed_rad_s = fitted.hypothesis.values_of(0)
    deviation = np.sqrt(weigh(data, current, fitted, 0).covariance[0, 0])
    assert speed_rad_s == pytest.approx(lost["speed_rad_s"], rel=0.003)
    assert fraction == pytest.approx(lost["fraction"], abs=max(0.03 * fraction, 3.0 * deviation))
    assert deviation < 0.05 * fraction  # few rows are so fast


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
    ahead = search_module._Ahead(data, current, robot.candidates(), 1, 100, silent)
    further = ahead.far(candidates["actuation_delay"], accepted)
    if name == "actuation_delay":
        quarter_row_s = 0.25 * 0.005
        assert further.fitted.hypothesis.values_of(0) == pytest.approx(0.0155, abs=quarter_row_s)
    else:
        assert further is None


@pytest.mark.parametrize("angle_rad", [0.063, 0.0])
def test_play_is_found_where_less_play_explains_less_than_none(tmp_path, angle_rad):
    """No derivative leads there; where there is none, none is found."""
    hidden = (HiddenEffect("gear_backlash", {"angle_rad": angle_rad}),) if angle_rad else ()
    effects = tuple(effect.as_dict() for effect in hidden)
    case = TruthCase(seed=21007, effects=effects, sensors=("gyro", "pose", "supply"), runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    play = candidates["gear_backlash"]
    ahead = search_module._Ahead(data, current, robot.candidates(), 1, 100, silent)
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
    ahead = search_module._Ahead(data, current, robot.candidates(), 1, 100, silent)
    start = current.hypothesis.with_effect(candidates["cogging"], list(cogging.values()))
    first = ahead._by_its_noise(candidates["cogging"], start)
    further = ahead._far_beside(first, candidates["bristle_relaxation"])
    if length_m:
        assert further.trial.accepted
        assert further.fitted.hypothesis.values_of(1)[0] == pytest.approx(length_m, rel=0.05)
    else:
        assert further is None


@pytest.mark.parametrize("length_m", [0.9e-3, 4e-3, 0.0])
def test_bristles_are_found_along_their_own_filter(tmp_path, length_m):
    """That of rigid contact takes what they hold for pushes; where none are, none are found."""
    hidden = (HiddenEffect("bristle_relaxation", {"length_m": length_m}),) if length_m else ()
    effects = tuple(effect.as_dict() for effect in hidden)
    robot, runs, candidates = robot_runs(TruthCase(seed=21007, effects=effects, runs=2), tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    ahead = search_module._Ahead(data, current, robot.candidates(), 1, 100, silent)
    further = ahead.far(candidates["bristle_relaxation"], None)
    if length_m:
        assert further.fitted.hypothesis.values_of(0)[0] == pytest.approx(length_m, rel=0.03)
    else:
        assert further is None
        assert ahead.trials == []


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
    assert before > here + search_module.SURE_GAIN
    ahead = search_module._Ahead(data, current, robot.candidates(), 1, 100, silent)
    assert ahead.far(delay, None) is None
    assert ahead.trials == []


LAGS = ("driver_lag", "actuation_delay", "armature_inductance")


def lag_named(folder, hidden, named):
    """Data with 1.5 ms of lag or delay, their fit under a name, and what may stand in its place."""
    robot = Machine(read_model(NOMINAL_ROBOT))
    labels = {c.effect: c.parameters[0].label for c in robot.candidates()}
    effect = HiddenEffect(hidden, {labels[hidden]: 0.0015}).as_dict()
    case = TruthCase(seed=77, effects=(effect,), excitation="rich", runs=2)
    robot, runs, candidates = robot_runs(case, folder)
    start = believed_hypothesis(robot).with_effect(candidates[named], [0.001])
    rivals = {named: [candidates[name] for name in LAGS if name != named]}
    return *settle(robot, runs, start), rivals


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
    data, found, compared = search_module._likeliest(data, fitted, rivals, 100, silent)
    assert [effect.effect for effect in found.hypothesis.effects] == [hidden]
    assert found.hypothesis.values_of(0) == pytest.approx([0.0015], rel=0.15)
    assert len(compared) == 1
    assert named == hidden or named in {
        one.hypothesis.effects[-1].name for one in compared[0].rivals
    }


@pytest.mark.parametrize(("nats", "named"), [(1.0, "driver_lag"), (1e3, "actuation_delay")])
def test_what_loses_by_the_noise_of_another_takes_its_place_if_likelier_by_its_own(
    tmp_path, monkeypatch, nats, named
):
    """Every rival is near enough to be asked here; likelihoods are given."""
    data, fitted, rivals = lag_named(tmp_path, "driver_lag", "driver_lag")
    of = {"driver_lag": 0.0, "actuation_delay": nats, "armature_inductance": -1.0}

    def given(_data, one):
        return of[one.hypothesis.effects[-1].effect]

    monkeypatch.setattr(search_module, "NEARLY", 1.0)
    monkeypatch.setattr(search_module, "_log_posterior", given)
    before = search_module._compare_all(data, fitted, rivals, silent)[0]
    rival_names = [one.hypothesis.effects[-1].effect for one in before.rivals]
    lost = dict(zip(rival_names, before.lost(fitted), strict=True))
    assert lost["actuation_delay"] > 0
    _, found, _ = search_module._likeliest(data, fitted, rivals, 100, silent)
    assert [effect.effect for effect in found.hypothesis.effects] == [named]


@pytest.mark.parametrize(
    ("nats", "settings", "named"),
    [
        ({"driver_lag": 0.0}, {}, "actuation_delay"),  # explains more, and as likely
        ({"driver_lag": 1e3}, {}, "driver_lag"),
        ({"driver_lag": 1e3}, {"NEARLY_AT_FIRST": 0.0, "RIVAL_MARGIN": 0.0}, "actuation_delay"),
        ({"driver_lag": 1e3}, {"_likelihood_judges": lambda _: False}, "actuation_delay"),
        ({"actuation_delay": -np.inf, "driver_lag": 1e3}, {}, "driver_lag"),
        ({"driver_lag": -np.inf}, {}, "actuation_delay"),
    ],
    ids=["as likely", "likelier", "far from as much", "answered within rows", "lost", "lost rival"],
)
def test_what_explains_nearly_as_much_is_taken_if_likelier(
    tmp_path, monkeypatch, nats, settings, named
):
    """A delay of 1.5 ms is hidden, which a lag nearly explains; likelihoods are given."""
    hidden = HiddenEffect("actuation_delay", {"delay_s": 0.0015}).as_dict()
    case = TruthCase(seed=77, effects=(hidden,), excitation="rich", runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, base = settle(robot, runs, believed_hypothesis(robot))
    of = {"actuation_delay": 0.0} | nats
    given = {"_own_likelihood": lambda _, one: of[one.hypothesis.effects[-1].effect]}
    for name, value in ({"NEARLY_AT_FIRST": 1.0} | given | settings).items():
        monkeypatch.setattr(search_module, name, value)
    screened = screen(data, base, [candidates[name] for name in ("actuation_delay", "driver_lag")])
    found = search_module._try(data, base, screened, 1, 2, silent)
    assert found[0][0].candidate.effect == "actuation_delay"
    [(taken, fitted)] = [(trial, one) for trial, one in found if trial.accepted]
    [(other, _)] = [(trial, one) for trial, one in found if not trial.accepted]
    assert taken.candidate.effect == named == fitted.hypothesis.effects[-1].effect
    assert ("likelier" if named == "driver_lag" else "explains more") in taken.reason
    assert named in other.reason


def test_a_model_that_loses_the_robot_by_its_own_noise_is_not_likely(tmp_path, monkeypatch):
    def lost(*_, **__):
        raise RunawayError("lost")

    data, fitted, _ = lag_named(tmp_path, "driver_lag", "driver_lag")
    monkeypatch.setattr(search_module, "settle", lost)
    assert search_module._own_likelihood(data, fitted) == -np.inf


def test_edges_of_a_patch_that_were_drawn_to_a_wrong_place_are_found_again(tmp_path):
    """Beside the other effects as they are; some centimetres away there is nothing to descend."""
    floor = {"x_min_m": -0.1, "x_max_m": 0.4, "scale": 0.5}
    hidden = HiddenEffect("slippery_patch", floor).as_dict()
    case = TruthCase(seed=8, effects=(hidden,), excitation="rich", runs=2, run_duration_s=4.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(
        candidates["slippery_patch"], [floor["x_min_m"] + 0.04, 0.4, 0.52]
    )
    data, stuck = settle(robot, runs, start)
    assert abs(stuck.hypothesis.values_of(0)[0] - floor["x_min_m"]) > 0.015
    data, found = search_module._patch_settled(data, stuck)
    edges_m = found.hypothesis.values_of(0)[:2]
    assert edges_m == pytest.approx([floor["x_min_m"], floor["x_max_m"]], abs=0.002)


def test_an_edge_that_nobody_drove_over_is_open_as_far_as_anybody_drove(tmp_path):
    """And one that was is known to millimetres."""
    hidden = {"x_min_m": -0.15, "x_max_m": 9.0, "scale": 0.5}
    effect = HiddenEffect("slippery_patch", hidden).as_dict()
    case = TruthCase(seed=8, effects=(effect,), runs=2, run_duration_s=4.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    patch = candidates["slippery_patch"]
    end_m = patch.edges_m[-1]
    start = believed_hypothesis(robot).with_effect(patch, [-0.15, end_m - 0.02, 0.5])
    data, found = settle(robot, runs, start)
    evidence = weigh(data, fit(data, found.hypothesis.without(0)), found, 0)
    values = found.hypothesis.values_of(0)
    low, high = search_module._interval(data, found, 0, values, evidence).T
    assert (low < values).all()
    assert (values < high).all()
    assert low[0] < -0.15 < high[0] < low[0] + 0.005
    assert high[1] == end_m


def test_a_current_limit_is_no_better_known_than_what_an_ampere_is(tmp_path):
    """Half the current through twice the resistance and torque constant moves a robot alike.

    Each is believed to 2 % and nothing else tells: 2 % / sqrt(2) is the least deviation.
    """
    effect = HiddenEffect("current_limit", {"limit_a": 4.0}).as_dict()
    case = TruthCase(seed=8, effects=(effect,), excitation="rich", runs=2, run_duration_s=3.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["current_limit"], [5.0])
    data, found = settle(robot, runs, start)
    evidence = weigh(data, fit(data, found.hypothesis.without(0)), found, 0)
    [limit_a] = values = found.hypothesis.values_of(0)
    [[low_a, high_a]] = search_module._interval(data, found, 0, values, evidence)
    assert low_a < 4.0 < high_a
    assert evidence.gain > 1e5
    assert 1.9 * 0.02 / np.sqrt(2.0) < (high_a - limit_a) / limit_a < 0.06


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
    _, found = search_module._one_of_curve(*settle(robot, runs, start), {}, silent)
    expected = set(hidden) if both else {"contact_shape", *hidden}
    assert {effect.effect for effect in found.hypothesis.effects} == expected


def test_a_grip_that_falls_at_once_beside_a_curve_may_be_a_low_grip_beside_another(tmp_path):
    """And a low grip that is right stays."""
    low = HiddenEffect("low_grip", {"scale": 0.75}).as_dict()
    case = TruthCase(seed=509, effects=(low,), friction_curve="brush", excitation="rich", runs=2)
    robot, runs, candidates = robot_runs(case, tmp_path)
    base = believed_hypothesis(robot)
    for name, sizes in (("grip_falloff", [0.23, 0.05]), ("low_grip", [0.75])):
        start = base.with_effect(candidates[name], sizes)
        start = start.with_effect(candidates["contact_shape"], [1.0])
        _, found = search_module._one_of_curve(*settle(robot, runs, start), {}, silent)
        assert {effect.effect for effect in found.hypothesis.effects} == {
            "contact_shape",
            "low_grip",
        }


@pytest.mark.parametrize("magnets", [9.0, 36.0])
def test_every_number_of_magnets_is_looked_for(tmp_path, magnets):
    """One next to it is out of step after some turns, so that no fit leads from there."""
    robot, runs, candidates = robot_with_magnets(magnets, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    [screened] = screen(data, current, [candidates["cogging"]])
    assert screened.promise > search_module.SURE_GAIN
    assert screened.start[1] == magnets


@pytest.mark.parametrize("magnets", [7.0, 7.4])
def test_magnets_are_counted_in_whole_numbers_where_the_log_allows(tmp_path, magnets):
    """The phase, which a count off by a hundredth turns within some revolutions, comes right."""
    robot, runs, candidates = robot_with_magnets(magnets, tmp_path)
    start = believed_hypothesis(robot).with_effect(
        candidates["cogging"], [0.008, magnets + 2e-3, 0.9]
    )
    data, fitted = settle(robot, runs, start)
    final = search_module._whole_numbers(data, fitted)
    counted = final.hypothesis.values_of(0)
    if magnets == round(magnets):
        assert counted[1] == magnets
        assert counted[2] == pytest.approx(1.0, abs=0.02)
        without = fit(data, final.hypothesis.without(0))
        free, held = (weigh(data, without, one, 0).covariance for one in (fitted, final))
        assert held[1, 1] == 0.0
        assert 0.0 < held[2, 2] < free[2, 2]
    else:
        assert counted[1] == pytest.approx(magnets, abs=0.01)
        assert counted[1] != round(counted[1])


def test_the_derivative_by_a_number_of_cycles_is_that_at_the_place(tmp_path):
    """The first secant turns the phase around; what it gives may be many times too small."""
    robot, runs, candidates = robot_with_magnets(7.0, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["cogging"], [0.008, 7.0, 1.0])
    data, fitted = settle(robot, runs, start)
    number = len(fitted.hypothesis.x) - 2
    _, [around] = linearise(data, [fitted.hypothesis])
    _, [found] = linearise(data, [fitted.hypothesis], last=[0.1 * around])
    size = np.linalg.norm(found[:, number])
    ends = []
    for sign in (1.0, -1.0):
        x = fitted.hypothesis.x.copy()
        x[number] += sign * 1e-2 / size * fitted.hypothesis.parameters[number].scale
        ends.append(data.residuals(fitted.hypothesis.flat(data.believed, x)[None])[0])
    right = (ends[0] - ends[1]) / (2e-2 / size)
    assert np.linalg.norm(found[:, number] - right) < 0.01 * size
    assert np.linalg.norm(around[:, number] - right) > 0.3 * size


@pytest.mark.parametrize("fraction", [0.0, 0.3])
def test_what_any_friction_law_leaves_is_no_falling_grip(tmp_path, fraction):
    """Keys and blend take most of a brush of bristles; a grip that falls by a third they do not."""
    hidden = (HiddenEffect("grip_falloff", {"fraction": fraction, "speed_m_s": 0.3}),)
    case = TruthCase(
        seed=510,
        effects=tuple(one.as_dict() for one in hidden if fraction),
        friction_curve="atan" if fraction else "brush",
        excitation="rich",
        runs=2,
        run_duration_s=4.0,
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["contact_shape"], [0.1])
    data, curved = settle(robot, runs, start)
    sizes = [max(fraction, 0.03), 0.3]
    falling = fit(data, curved.hypothesis.with_effect(candidates["grip_falloff"], sizes))
    assert curved.objective - falling.objective > 10.0
    assert search_module._within_law(data, curved, falling, 1) == (fraction == 0.0)
    rubbing = fit(data, curved.hypothesis.with_effect(candidates["coulomb_friction"], [1e-3]))
    assert not search_module._within_law(data, curved, rubbing, 1)


def test_mass_and_inertia_of_an_axis_cannot_be_told_apart(machine):
    """One number, two names: one is named, the other is said to do as well."""
    [selected] = find(machine, Bench(mass_kg=11.0)).selected
    either = {selected.candidate.effect, *selected.rivals}
    assert either == {"payload", "inertia_error"}
    assert selected.values[0] == pytest.approx(1.0, abs=0.1)


def test_an_effect_of_the_model_with_the_wrong_size_is_named_again(tmp_path):
    """The model rubs with 1 N, the axis with 2 N: it is the friction that is wrong."""
    believed = make_machine(tmp_path, effects="[[effects.coulomb_friction]]\nforce_n = 1.0\n")
    assert names(find(believed, Bench(coulomb_n=2.0))) == ["coulomb_friction"]


def test_quadratic_drag_is_named(machine):
    assert names(find(machine, Bench(quadratic_n=5.0))) == ["quadratic_wheel_drag"]


def test_what_no_effect_explains_is_said_to_be_left(machine):
    """Bearings that age are in no catalogue; viscous friction takes only their mean."""
    outcome = find(machine, Bench(ageing_n_m=2.0))
    assert [term.dependence for term in outcome.leftover[:1]] == ["time and speed"]
    assert outcome.leftover[0].equation == "axis/force"


@pytest.mark.parametrize("parts", [1, 4])
def test_what_ages_goes_on_from_part_to_part_of_a_log(machine, parts):
    """Logs of 12 s, whole or in parts that are runs of their own."""
    edges = np.linspace(0, 2400, parts + 1).astype(int)
    runs = [
        replace(make_run(machine, log, *rows), unit=f"{log.name} {rows[0]}")
        for log in (make_log(Bench(ageing_n_m=1.0), seed, duration_s=12.0) for seed in range(2))
        for rows in pairwise(edges)
    ]
    outcome = search(machine, runs, None, silent)
    assert [term.dependence for term in outcome.leftover[:1]] == ["time and speed"]


@pytest.mark.parametrize(("name", "left"), [("contact_shape", False), ("rolling_resistance", True)])
def test_the_friction_curve_owes_less_to_the_shapes_of_strong_effects(monkeypatch, name, left):
    """27,500, 3,700 beyond chance, where others leave 8,000 if 3 % off: beside a dead zone."""
    monkeypatch.setattr(search_module, "_left_by_others", lambda *_: 8e6)
    effect = SimpleNamespace(effect=name)
    fitted = SimpleNamespace(hypothesis=SimpleNamespace(effects=(effect,)))
    evidence = SimpleNamespace(gain=27500.0, beyond_chance=3700.0)
    assert search_module._left_by_shapes(None, None, fitted, 0, evidence) == left
