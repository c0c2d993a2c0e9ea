"""What is missing on an axis: named right, the simplest wins, and nothing is found in nothing."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from axis_bench import Bench, make_log, make_machine, make_runs, silent
from omnislip.gap import ahead as ahead_module
from omnislip.gap import judge
from omnislip.gap import search as search_module
from omnislip.gap.ahead import Ahead
from omnislip.gap.inference import VISIBLE_GAIN, Data, fit
from omnislip.gap.machine import Machine
from omnislip.gap.noise import RunawayError
from omnislip.gap.recordings import make_run
from omnislip.gap.screen import screen
from omnislip.gap.search import Found, search
from omnislip.gap.selected import stability_of
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import Effect, read_model, write_model
from scipy.stats import binom
from truth_bench import lag_named, robot_runs


def find(machine, bench, first_seed=0):
    seeds = [*range(first_seed, first_seed + 4), *range(first_seed + 10, first_seed + 14)]
    return search(machine, make_runs(machine, bench, seeds), None, silent)


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
    eighth_s = outcome.data.runs[0].row_s / 8.0  # no shorter lag is named, whatever it gains
    assert outcome.limits["driver_lag"]["time_constant_s"] == pytest.approx(eighth_s)


@pytest.mark.parametrize("factor, found", [(3.0, True), (0.2, False)])
def test_limit_of_detection_is_where_detection_begins(machine, factor, found):
    """Three times the limit is a gain of 225 and seen; a fifth of it is a gain of 1 and is not."""
    limit = find(machine, Bench()).limits["coulomb_friction"]["force_n"]
    outcome = find(machine, Bench(coulomb_n=factor * limit))
    assert ("coulomb_friction" in names(outcome)) == found


@pytest.mark.parametrize(
    "name, key, none",
    [
        ("coulomb_friction", "coulomb_n", 0.0),
        ("viscous_friction_error", "viscous_n_s_m", 15.0),  # which is a key of its own, in bounds
        ("payload", "mass_kg", 10.0),
    ],
)
def test_the_gain_that_stands_out_begins_at_the_limit(machine, name, key, none):
    """Also where keys take an effect up to their bounds: there only their tolerances tell it."""
    before = find(machine, Bench())
    [limit] = before.limits[name].values()
    [candidate] = [c for c in machine.candidates() if c.name == name]

    def gain(size):
        bench = Bench(**{key: none + size})
        runs = make_runs(machine, bench, [*range(4), *range(10, 14)])
        data = Data(machine, runs, before.data.noise, before.base.hypothesis)
        without = fit(data, before.base.hypothesis)
        return (
            without.objective
            - fit(data, without.hypothesis.with_effect(candidate, [0.0])).objective
        )

    assert gain(0.6 * limit) < VISIBLE_GAIN < gain(1.5 * limit)


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


@pytest.mark.parametrize("mistaken", [True, False])
@pytest.mark.parametrize("rubs", [True, False])
def test_a_search_goes_on_from_one_before_only_if_all_of_that_holds(
    machine, outcomes, rubs, mistaken
):
    """Where nothing rubs, friction that was found before is looked for from the beginning."""
    before, told = outcomes["coulomb_friction"], []
    found = replace(before.found, mistaken=mistaken)
    runs = make_runs(machine, Bench(coulomb_n=2.0 if rubs else 0.0), [*range(20, 28)])
    outcome = search(machine, runs, None, told.append, before=found)
    went_on = "going on from what was found before" in told
    assert went_on == rubs
    assert names(outcome) == (["coulomb_friction"] if rubs else [])
    assert outcome.limits.keys() == before.limits.keys()
    if rubs:
        first, *_ = outcome.trials
        assert first in before.trials
        assert max(trial.step for trial in outcome.trials if trial.accepted) == 1


@pytest.mark.parametrize(
    ("changed", "looks"), [({}, False), ({"mistaken": True}, True), ({"elsewhere": True}, True)]
)
def test_a_search_that_goes_on_looks_ahead_only_where_the_runs_are_others(
    machine, outcomes, monkeypatch, changed, looks
):
    """The one before ended so, with nothing, and few rows were cut out since."""
    looked = []
    monkeypatch.setattr(Ahead, "best", lambda *given: looked.append(given))
    found = replace(outcomes["coulomb_friction"].found, **changed)
    runs = make_runs(machine, Bench(coulomb_n=2.0), [*range(20, 28)])
    assert names(search(machine, runs, None, silent, before=found)) == ["coulomb_friction"]
    assert bool(looked) == looks


def test_a_name_that_mistaken_runs_had_gives_way_to_a_better_one(machine, outcomes):
    """Found where commands were taken to move otherwise: a rival that was near then is compared."""
    friction = outcomes["coulomb_friction"]
    [dead_zone] = [c for c in machine.candidates() if c.effect == "dead_zone"]
    model = friction.base.hypothesis.with_effect(dead_zone, [0.1])
    near = {"dead_zone": [friction.selected[0].candidate]}
    found = Found(model, friction.data.noise, near, friction.trials, mistaken=True)
    runs = make_runs(machine, Bench(coulomb_n=2.0), [*range(20, 28)])
    told = []
    outcome = search(machine, runs, None, told.append, before=found)
    assert "going on from what was found before" in told
    assert names(outcome) == ["coulomb_friction"]


def test_a_better_model_that_shows_another_machine_is_handed_on(machine):
    """Each is asked with its noise; what was found so far comes along with the machine."""
    asked = []

    def other_machine(model, noise):
        asked.append((model, noise))
        return machine

    runs = make_runs(machine, Bench(coulomb_n=2.0), [*range(20, 28)])
    with pytest.raises(search_module.MistakenError) as error:
        search(machine, runs, None, lambda _: None, other_machine=other_machine)
    [(model, noise)], found = asked, error.value.found
    assert error.value.machine is machine
    assert (found.model, found.noise, found.mistaken) == (model, noise, True)
    assert [effect.name for effect in model.effects] == ["coulomb_friction"]
    assert [trial.candidate.name for trial in found.trials if trial.accepted] == [
        "coulomb_friction"
    ]


def test_what_gave_way_to_another_is_looked_for_again(machine, monkeypatch):
    """Where both are there: one explained the other's part as long as that was missing."""
    swap, calls = search_module.swap_effects, []

    def other_first(data, fitted, neighbours, progress, tried):
        calls.append(fitted)
        if len(calls) > 1:
            return swap(data, fitted, neighbours, progress, tried)
        [taken] = fitted.hypothesis.effects
        [other] = {"coulomb_friction", "dead_zone"} - {taken.effect}
        candidate = next(c for c in data.machine.candidates() if c.effect == other)
        sizes = [0.1 * candidate.parameters[0].scale]
        return fit(data, fitted.hypothesis.without(0).with_effect(candidate, sizes)), {}

    monkeypatch.setattr(search_module, "swap_effects", other_first)
    outcome = find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1))
    assert sorted(names(outcome)) == ["coulomb_friction", "dead_zone"]


def test_a_search_ends_where_steps_leave_the_model_as_it_was(machine, monkeypatch):
    """Each takes an effect that is needless when all has settled."""
    monkeypatch.setattr(
        search_module, "drop_needless", lambda data, fitted, tried: fit(data, bare(fitted))
    )

    def bare(fitted):
        return fitted.hypothesis.without_effects()

    outcome = find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1, viscous_n_s_m=25.0))
    steps = {trial.step for trial in outcome.trials if trial.accepted}
    assert names(outcome) == []
    assert steps == set(range(1, search_module.MOST_VAIN_STEPS + 1))


@pytest.mark.parametrize("ahead_gain", [ahead_module.AHEAD_GAIN, np.inf])
def test_what_is_refused_is_judged_again_by_the_noise_that_is_left_beside_it(
    machine, monkeypatch, ahead_gain
):
    """Noise that was tuned without an effect covers it; by that noise it is refused here.

    Also where its fit gains too little to be worth looking, and only the linear model promised.
    """
    monkeypatch.setattr(ahead_module, "AHEAD_GAIN", ahead_gain)
    better, noises = judge._replays_better, []

    def refused_by_the_first(data, *models):
        noises.append(data.noise)
        return data.noise is not noises[0] and better(data, *models)

    monkeypatch.setattr(judge, "_replays_better", refused_by_the_first)
    outcome = find(machine, Bench(coulomb_n=2.0))
    assert names(outcome) == ["coulomb_friction"]
    [taken] = [trial for trial in outcome.trials if trial.accepted]
    assert taken.reason.startswith("by the noise that is left beside it: ")


def test_a_candidate_whose_own_filter_loses_the_robot_gets_no_name(machine, monkeypatch):
    def lose_what_has_effects(machine, runs, start, *args, **options):
        if start.effects:
            raise RunawayError("run_00: its motion grows without bounds")
        return settle(machine, runs, start, *args, **options)

    for module in (search_module, ahead_module):
        monkeypatch.setattr(module, "settle", lose_what_has_effects)
    outcome = find(machine, Bench(coulomb_n=2.0))
    assert outcome.selected == ()
    assert [trial for trial in outcome.trials if trial.accepted] == []
    assert "does not follow" in " ".join(trial.reason for trial in outcome.trials)
    data, current = settle(machine, outcome.data.runs, outcome.base.hypothesis)
    ahead = Ahead(data, current, machine.candidates(), 1, 100, silent)
    start = current.hypothesis.with_effect(outcome.trials[0].candidate, outcome.trials[0].values)
    assert ahead.best([(outcome.trials[0], replace(current, hypothesis=start))], []) is None
    assert ahead.trials == []


def test_what_shows_beside_the_newest_effect_is_a_rival_of_the_older_one(machine, monkeypatch):
    """With one rival each the older effect has two: its own and that of the newest."""
    swap, offered = search_module.swap_effects, []

    def recorded(data, fitted, neighbours, progress, tried):
        offered.append({name: [c.name for c in own] for name, own in neighbours.items()})
        return swap(data, fitted, neighbours, progress, tried)

    monkeypatch.setattr(search_module, "NEIGHBOURS", 1)
    monkeypatch.setattr(search_module, "swap_effects", recorded)
    find(machine, Bench(coulomb_n=2.0, dead_zone_v=0.1))
    first, second = offered[:2]
    [older] = first
    [newest] = second.keys() - {older}
    assert second[older] == first[older] + second[newest]
    assert second[newest] != first[older]


@pytest.mark.parametrize(
    ("nats", "settings", "named"),
    [
        ({"driver_lag": 0.0}, {}, "actuation_delay"),  # explains more, and as likely
        ({"driver_lag": 1e3}, {}, "driver_lag"),
        ({"driver_lag": 1e3}, {"NEARLY_AT_FIRST": 0.0, "RIVAL_MARGIN": 0.0}, "actuation_delay"),
        ({"driver_lag": 1e3}, {"likelihood_judges": lambda _: False}, "actuation_delay"),
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
