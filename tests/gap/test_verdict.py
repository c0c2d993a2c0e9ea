"""Verdicts where names explain what is to be explained, and where not; what is said of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap.inference import Evidence, Hypothesis
from omnislip.gap.judge import TOO_SHORT
from omnislip.gap.leftover import Shape
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import Closed, Left
from omnislip.gap.plan import Manoeuvre, Separation
from omnislip.gap.selected import Selected
from omnislip.gap.verdict import closes_nothing, judge_outcome, unchecked_words
from omnislip.gap.words import (
    advice,
    keys_words,
    short_delay_words,
    unsteady_names,
    verdict_words,
    weak_names,
)
from omnislip.model_file import NOMINAL_ROBOT, read_model

ROBOT = Machine(read_model(NOMINAL_ROBOT))

BY_FAR = Evidence(1e6, 60.0, 0.1, np.eye(1), 0.0)


def selected(name, gain, inflation=1.0, variation=0.0, left=0.0):
    candidate = next(c for c in ROBOT.candidates() if c.effect == name)
    evidence = Evidence(gain, inflation, 0.0, np.eye(1), variation)
    return Selected(candidate, np.ones(1), np.ones((1, 2)), evidence, (), 1.0, left)


def verdict_of(
    effects, left=(), jolts=False, feigned_gain=0.0, table=None, trials=(), keys_off=0, law=None
):
    """Verdict where without a table replays are as near as can be.

    `left` is the gain of a leftover term and what of it the shapes of effects cover.
    """
    keys = ROBOT.base_parameters()
    moved = [2.0 if i < keys_off else 1.9 for i in range(len(keys))]
    x = np.array([(p.low + p.high) / 2 + z * p.scale for p, z in zip(keys, moved, strict=True)])
    hypothesis = SimpleNamespace(base=keys, parameters=keys, x=x)
    left = [SimpleNamespace(gain=left[0], inflation=1.0, covered=left[1])] if left else []
    runs = [SimpleNamespace(row_s=0.005)]
    data = SimpleNamespace(
        feigned_gain=feigned_gain, machine=ROBOT, runs=runs, believed=ROBOT.believed
    )
    final = SimpleNamespace(hypothesis=hypothesis)
    outcome = SimpleNamespace(
        selected=effects, leftover=left, trials=trials, data=data, final=final, law=law
    )
    table = table or SimpleNamespace(left=Left(0.0, 1.0), closed=Closed(1.0, 0.9, 1.1))
    return judge_outcome(outcome, table, False, [], jolts)


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


@pytest.mark.parametrize(
    ("excess", "usual", "verdict"),
    [
        (2.0, 1.0, "unknown_effect"),
        (2.0, 1.8, "effect_found"),
        (2.0, 3.0, "effect_found"),
        (50.0, 60.0, "unknown_effect"),
    ],
)
def test_names_may_leave_as_much_as_in_a_run_that_they_explain(excess, usual, verdict):
    table = SimpleNamespace(left=Left(excess, 0.5, usual), closed=Closed(0.3, -0.2, 0.5))
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
    """Not a lag that no log can time: when in a row controllers tick may differ from run to run."""
    evidence = Evidence(gain, 1.0, 0.0, np.eye(1), 0.0)
    refused = SimpleNamespace(
        step=1,
        accepted=False,
        checked=True,
        validation_gain=-1.0,
        evidence=evidence,
        candidate=SimpleNamespace(effect="coulomb_friction"),
        values=np.array([0.01]),
        chance=0.0,
    )
    short = replace_namespace(
        refused,
        evidence=Evidence(1e6, 1.0, 0.0, np.eye(1), 0.0),
        candidate=SimpleNamespace(effect="driver_lag"),
        values=np.array([6e-4]),  # of rows of 5 ms
    )
    effects = [selected("coulomb_friction", named)] if named else []
    assert verdict_of(effects, feigned_gain=feigned_gain, trials=(refused, short)) == verdict


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


@pytest.mark.parametrize(("keys_off", "verdict"), [(4, "no_gap"), (5, "unknown_effect")])
def test_many_believed_keys_far_off_are_no_model_that_explains_the_logs(keys_off, verdict):
    assert verdict_of([], keys_off=keys_off) == verdict


def test_names_of_which_one_law_takes_all_places_are_not_given():
    effects = [selected("coulomb_friction", 1e5), selected("payload", 1e5)]
    assert verdict_of(effects) == "effect_found"
    assert verdict_of(effects, law=Shape("body/moment", "yaw rate", 2e5)) == "unknown_effect"


def test_a_key_at_its_bound_is_told_by_name():
    keys = ROBOT.base_parameters()
    x = np.array([ROBOT.believed[key.places[0]] for key in keys])
    x[0] *= 1.04
    x[1] *= 1.03
    final = SimpleNamespace(hypothesis=Hypothesis(tuple(keys), (), x))
    assert keys_words(final, ROBOT) == [f"Two tolerances off or more: {keys[0].label} (+4 %)."]
    final.hypothesis.x[0] /= 1.04
    assert keys_words(final, ROBOT) == []


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


def test_a_size_that_varies_a_little_carries_a_caution():
    """A fifth of 1e4 leaves 400: more than a hundredth of it, less than that of 1e5."""
    one = selected("supply_sag", 1e4, 20.0, 0.2)
    assert verdict_of([one]) == "effect_found"
    [caution] = unsteady_names([one])
    assert caution.startswith("The size of supply_sag changes by 20 % from half second")
    assert unsteady_names([one, selected("coulomb_friction", 1e5)]) == []
    assert unsteady_names([selected("supply_sag", 2e3, 20.0, 0.2)]) == []  # chance leaves as much
    assert unsteady_names([selected("supply_sag", 1e4, 2.0, 0.2)]) == []


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


@pytest.mark.parametrize(("chance", "told"), [(1e-50, True), (1.0, False)])
def test_only_what_is_no_chance_is_told_to_be_unchecked(chance, told):
    """Nobody has to drive more for what gains much in one row of one run."""
    effect = next(c for c in ROBOT.candidates() if c.effect == "low_grip")
    values = np.array([p.low for p in effect.parameters])
    trial = SimpleNamespace(
        step=1,
        candidate=effect,
        values=values,
        evidence=SimpleNamespace(beyond_chance=278.0),
        chance=chance,
        checked=False,
        reason="is seen in no run that the others could check",
        accepted=False,
    )
    data = SimpleNamespace(feigned_gain=0.0, machine=ROBOT)
    words = unchecked_words(SimpleNamespace(selected=[], trials=[trial], data=data))
    assert (words is not None and "low_grip" in words) == told


def test_commands_that_surely_act_later_than_rows_can_time_are_told():
    delay = next(c for c in ROBOT.candidates() if c.effect == "actuation_delay")

    def told(gain, reason, *effects):
        trial = SimpleNamespace(
            candidate=delay,
            values=np.array([4.5e-4]),
            reason=reason,
            evidence=Evidence(gain, 2.0, 0.0, np.eye(1), 0.0),
        )
        final = SimpleNamespace(hypothesis=SimpleNamespace(effects=effects))
        return short_delay_words(SimpleNamespace(trials=[trial], final=final))

    [caution] = told(1e4, TOO_SHORT)
    assert caution.startswith("Commands act 0.45 ms later than their rows say")
    assert told(1e4, f"by the noise that is left beside it: {TOO_SHORT}") == [caution]
    assert told(100.0, TOO_SHORT) == told(1e4, "could be chance") == []
    assert told(1e4, TOO_SHORT, delay) == []  # which holds it


def test_rivals_come_with_what_to_drive_or_the_word_that_nothing_would_help():
    sure, ambiguous = selected("body_drag", 1e5), selected("payload", 1e5)
    ambiguous = replace(ambiguous, rivals=("low_grip",))
    best = Separation(Manoeuvre("twist", "", 3.8, []), 25.0, 0.0)
    assert advice([sure], {}) == ""
    assert advice([sure, ambiguous], {"payload": best}) == (
        " Driving 'twist' (4 s, omnislip gap plan) would tell payload from low_grip: expected "
        "separation 25, right with probability 0.994."
    )
    assert advice([ambiguous], {"payload": replace(best, separation=1.0)}) == (
        " No manoeuvre of the library would tell payload from low_grip."
    )
    assert advice([ambiguous], {}) == ""  # nothing was driven


@pytest.mark.parametrize(
    ("high", "stability", "proven"),
    [(0.3, [1.0], False), (0.7, [0.5], True), (None, [0.7, 0.8], False), (None, [0.7, 1.0], True)],
)
def test_where_nothing_is_off_on_held_out_runs_a_name_has_to_be_stable(high, stability, proven):
    effects = [replace(selected("coulomb_friction", 100.0), stability=one) for one in stability]
    closed = Closed(None, None, None) if high is None else Closed(0.2, 0.1, high)
    table = SimpleNamespace(left=Left(0.1, 0.1), closed=closed, floor_source="repeated manoeuvres")
    assert closes_nothing(effects, table) != proven


@pytest.mark.parametrize(
    ("gap", "gains", "stability", "named"),
    [
        (0.3, [1e4], 1.0, True),
        (0.3, [1e4, 300.0], 1.0, True),
        (0.6, [1e4], 1.0, False),
        (0.3, [1e4, 100.0], 1.0, False),
        (0.3, [1e4], 0.7, False),
    ],
)
def test_runs_that_hardly_excite_a_sure_effect_do_not_take_its_name(gap, gains, stability, named):
    effects = [replace(selected("coulomb_friction", gain), stability=stability) for gain in gains]
    closed = Closed(-0.2, -0.7, -0.03, gap=gap)
    table = SimpleNamespace(left=Left(0.4, 0.2), closed=closed, floor_source="predicted")
    assert closes_nothing(effects, table) != named


@pytest.mark.parametrize(
    ("high", "usual", "gain", "named"),
    [
        (0.19, 1.3, 1e4, True),
        (0.1, 1.3, 1e4, False),
        (0.19, 1.0, 1e4, False),
        (0.0, 1.6, 1e4, True),
        (0.19, 1.3, 100.0, False),
    ],
)
def test_only_what_is_more_than_a_run_that_is_explained_keeps_is_to_be_closed(
    high, usual, gain, named
):
    """1.95 floors are off, of which chance larger than the predictor's is `usual`."""
    closed = Closed(0.0, -0.3, high, gap=1.95)
    table = SimpleNamespace(left=Left(1.7, 0.9, usual), closed=closed, floor_source="predicted")
    assert closes_nothing([selected("driver_nonlinearity", gain)], table) != named


def test_a_sentence_does_not_speak_of_a_gap_that_held_out_runs_do_not_have():
    effects = [selected("low_grip", 1e4)]

    def sentence(closed, usual=0.0):
        outcome = SimpleNamespace(selected=effects)
        table = SimpleNamespace(closed=closed, left=Left(0.4, 0.2, usual=usual))
        return verdict_words("effect_found", ROBOT, outcome, table, [], None, [], [], [])

    told = sentence(Closed(-0.24, -0.74, -0.03, gap=0.33), 0.1)
    assert "only 0.33 noise floors are off there, and" in told
    assert "%" not in told
    told = sentence(Closed(0.1, -0.01, 0.2, gap=1.95), 1.3)
    assert "only 1.9 noise floors are off there (where it explains a run it leaves 1.3)" in told
    assert "95 % of the gap on held-out runs closes (90 to 100 %)" in sentence(
        Closed(0.95, 0.9, 1.0, gap=30.0)
    )


@pytest.mark.parametrize(
    ("gain", "law", "named"),
    [(50.0, 1e4, False), (50.0, 40.0, True), (110.0, 1e4, True), (300.0, 1e4, True)],
)
def test_a_faint_change_of_the_friction_curve_is_no_gap_by_itself(gain, law, named):
    """1 % of the way to another law; a floor is off by three."""
    curve = replace(selected("contact_shape", gain), law_gain=law)
    table = SimpleNamespace(
        left=Left(0.1, 0.1), closed=Closed(None, None, None), floor_source="repeated manoeuvres"
    )
    assert closes_nothing([curve], table) != named
    unstable = replace(selected("gyro_bias", 50.0), stability=0.8)
    assert closes_nothing([curve, unstable], table) != named
    assert not closes_nothing([curve, selected("gyro_bias", 50.0)], table)
