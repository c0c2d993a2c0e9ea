"""What friction leaves on any floor, and shapes a little wrong, is no effect."""

from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap import judge
from omnislip.gap.inference import fit, spread_over_runs, weigh
from omnislip.gap.judge import within_law
from omnislip.gap.machine import Machine
from omnislip.gap.refit import extend_effects
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import NOMINAL_ROBOT, read_model
from scipy.stats import chi2
from truth_bench import robot_runs


def settled_on(law, hidden, seed, folder):
    """Data and base fit of an effect on the believed law, or of none on another; candidates."""
    case = TruthCase(
        seed=seed,
        effects=(hidden.as_dict(),) if law == "atan" else (),
        friction_curve=law,
        excitation="rich",
        runs=4,
        run_duration_s=5.0,
    )
    robot, runs, candidates = robot_runs(case, folder)
    return *settle(robot, runs, believed_hypothesis(robot)), candidates


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
    assert within_law(data, curved, falling, 1) == (fraction == 0.0)
    rubbing = fit(data, curved.hypothesis.with_effect(candidates["coulomb_friction"], [1e-3]))
    assert not within_law(data, curved, rubbing, 1)


def test_a_law_that_falls_behind_its_peak_is_no_falling_grip(tmp_path):
    """By 8 %: no share of laws that do not fall takes that, and a grip that falls would."""
    case = TruthCase(
        seed=510, friction_curve="peaked", excitation="rich", runs=4, run_duration_s=4.0
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    start = believed_hypothesis(robot).with_effect(candidates["contact_shape"], [0.1])
    data, bent = settle(robot, runs, start)
    gains = []
    for curved in (bent, extend_effects(robot, data, bent)):
        sizes = [0.05, 0.5]
        falling = fit(data, curved.hypothesis.with_effect(candidates["grip_falloff"], sizes))
        gains.append(curved.objective - falling.objective)
    assert gains[0] > 100.0 > 10.0 > gains[1]
    [law] = curved.hypothesis.effects
    assert "peaked" in [parameter.label for parameter in law.parameters]


@pytest.mark.parametrize(("seed", "law"), [(512, "atan"), (511, "brush"), (512, "brush")])
def test_a_small_fall_of_grip_is_told_where_no_law_takes_its_place(tmp_path, seed, law):
    """6 % of the grip: less than what friction off its law may leave. Or the law is another."""
    sizes = [0.06, 0.3]
    hidden = HiddenEffect("grip_falloff", dict(zip(("fraction", "speed_m_s"), sizes, strict=True)))
    data, base, candidates = settled_on(law, hidden, seed, tmp_path)
    falling = fit(data, base.hypothesis.with_effect(candidates["grip_falloff"], sizes))
    assert within_law(data, base, falling, 0) == (law == "brush")


@pytest.mark.parametrize("law", ["atan", "rational", "brush"])
def test_a_slope_is_told_where_no_law_bends_better(tmp_path, law):
    """A tenth softer: less than friction off its law may leave. Or another law is like it."""
    hidden = HiddenEffect("slip_stiffness_error", {"scale": 0.89})
    data, base, candidates = settled_on(law, hidden, 516, tmp_path)
    softer = fit(data, base.hypothesis.with_effect(candidates["slip_stiffness_error"], [0.89]))
    gain = base.objective - softer.objective
    bent = softer.objective - judge._any_law(data, base).objective
    assert (bent < judge.BEYOND_SHARE * gain) == (law == "atan")
    if law == "atan":
        assert judge.BENT_SHARE < gain / judge.left_by_law(data, base, softer) < 1.0
        assert bent > -judge.SURE_GAIN
        assert not within_law(data, base, softer, 0)


@pytest.mark.parametrize("scale", [0.6, 1.0])
def test_a_slope_that_no_law_has_is_told_beside_another_curve(tmp_path, monkeypatch, scale):
    """However little it explains beside what friction off its law may leave."""
    hidden = HiddenEffect("slip_stiffness_error", {"scale": scale}).as_dict()
    case = TruthCase(
        seed=514,
        effects=(hidden,) if scale != 1.0 else (),
        friction_curve="rational",
        excitation="rich",
        runs=4,
        run_duration_s=5.0,
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    [rational] = [
        e for e in robot.extensions("contact_shape") if e.parameters[0].label == "rational"
    ]
    start = believed_hypothesis(robot).with_effect(candidates["contact_shape"], [0.0])
    start = start.with_effect(rational, [0.95]).last_two_joined()
    start = start.with_effect(candidates["slip_stiffness_error"], [scale])
    data, both = settle(robot, runs, start)
    monkeypatch.setattr(judge, "left_by_law", lambda *_: np.inf)
    assert within_law(data, both.refitted_without(data, 1), both, 1) == (scale == 1.0)


@pytest.mark.parametrize(
    ("name", "other", "unrelated"),
    [
        ("cogging", "current_limit", True),
        ("roller_ripple", "wheel_eccentricity", False),
        ("coulomb_friction", "current_limit", False),
        ("tether_spring", "driver_nonlinearity", True),
        ("floor_slope", "roller_ripple", True),
        ("carpet_anisotropy", "slippery_patch", False),
        ("driver_nonlinearity", "tether_spring", False),
    ],
)
def test_shapes_know_nothing_of_angles_or_places_that_the_effect_does_not_go_with(
    monkeypatch, name, other, unrelated
):
    data = SimpleNamespace(machine=Machine(read_model(NOMINAL_ROBOT)))
    own, beside = SimpleNamespace(effect=name), SimpleNamespace(effect=other)
    fitted = SimpleNamespace(
        hypothesis=SimpleNamespace(effects=(beside, own)), residual=np.zeros(2)
    )
    asked = []
    monkeypatch.setattr(
        judge,
        "left_by_shapes",
        lambda _, __, ___, ____, share_of, known: asked.append(
            [(share_of(effect), known(effect)) for effect in (beside, own)]
        ),
    )
    judge.left_by_others(data, SimpleNamespace(residual=np.ones(2)), fitted, 1)
    assert asked == [[(1.0, unrelated), (0.0, False)]]


@pytest.mark.parametrize(("name", "left"), [("contact_shape", False), ("rolling_resistance", True)])
def test_the_friction_curve_owes_less_to_the_shapes_of_strong_effects(monkeypatch, name, left):
    """27,500, 3,700 beyond chance, where others leave 8,000 if 3 % off: beside a dead zone."""
    monkeypatch.setattr(judge, "left_by_others", lambda *_: 8e6)
    effect = SimpleNamespace(effect=name)
    fitted = SimpleNamespace(hypothesis=SimpleNamespace(effects=(effect,)))
    evidence = SimpleNamespace(gain=27500.0, beyond_chance=3700.0)
    assert judge._left_by_shapes(None, None, fitted, 0, evidence) == left


@pytest.mark.parametrize("common_rad_s", [4e-4, 4e-3])
def test_a_zero_that_wanders_from_run_to_run_is_not_missing(tmp_path, common_rad_s):
    """Unless it is three times what it wanders by."""
    off_rad_s = 3e-4 * np.array([-1.0, 0.0, 1.0])
    case = TruthCase(
        seed=515,
        effects=tuple(
            HiddenEffect(
                "gyro_bias", {"rate_rad_s": common_rad_s + off}, run=f"run_{k + 1:02d}"
            ).as_dict()
            for k, off in enumerate(off_rad_s)
        ),
        excitation="rich",
        runs=3,
        run_duration_s=5.0,
    )
    robot, runs, candidates = robot_runs(case, tmp_path)
    data, base = settle(robot, runs, believed_hypothesis(robot))
    biased = fit(data, base.hypothesis.with_effect(candidates["gyro_bias"], [common_rad_s]))
    assert biased.hypothesis.values_of(0)[0] == pytest.approx(common_rad_s, abs=2e-4)
    spread_rad_s = spread_over_runs(data, biased, 0)
    assert spread_rad_s == pytest.approx(np.std(off_rad_s, ddof=1), rel=0.5)
    assert (
        judge.drifts(data, biased, 0) == (common_rad_s < 3 * spread_rad_s) == (common_rad_s == 4e-4)
    )
    rubbing = fit(data, base.hypothesis.with_effect(candidates["coulomb_friction"], [1e-5]))
    assert not judge.drifts(data, rubbing, 0)


def test_what_a_delay_does_that_no_log_can_time_is_no_effect(tmp_path):
    """0.3 ms, as the mean of two commands in a row leaves it; friction is not what that does."""
    late = HiddenEffect("actuation_delay", {"delay_s": 3e-4}).as_dict()
    rubs = HiddenEffect("coulomb_friction", {"torque_nm": 0.005}).as_dict()
    case = TruthCase(seed=512, effects=(late, rubs), excitation="rich", runs=2, run_duration_s=4.0)
    robot, runs, candidates = robot_runs(case, tmp_path)
    friction = believed_hypothesis(robot).with_effect(candidates["coulomb_friction"], [0.005])
    data, early = settle(robot, runs, friction)
    timed = judge.beside_short_delay(data, early)
    assert early.objective - timed.objective > 100.0
    assert timed.hypothesis.x[-1] == pytest.approx(3e-4, rel=0.1)
    assert judge.beside_short_delay(data, timed) is timed

    def instead(name, size):
        without = early if name != "coulomb_friction" else early.refitted_without(data, 0)
        fitted = fit(data, without.hypothesis.with_effect(candidates[name], [size]))
        evidence = weigh(data, without, fitted, -1)
        return judge._short_delay_does(data, without, fitted, evidence, len(candidates))

    assert instead("armature_inductance", 2e-4)
    assert not instead("coulomb_friction", 0.005)


@pytest.mark.parametrize(
    ("gain", "of_delay", "of_both", "instead"),
    [
        (500.0, 490.0, 500.0, True),
        (500.0, 400.0, 500.0, False),
        (20.0, 5.0, 30.0, False),
        (150.0, 460.0, 625.0, False),
        (150.0, 460.0, 480.0, True),
    ],
)
def test_an_effect_gives_way_to_a_delay_only_if_it_explains_no_more_beside_it(
    monkeypatch, gain, of_delay, of_both, instead
):
    """A delay that does not show explains nothing; one that does may stand beside an effect."""
    model = SimpleNamespace(effects=())
    without, fitted, timed, both = (
        SimpleNamespace(objective=-one, hypothesis=model) for one in (0.0, gain, of_delay, of_both)
    )
    beside = {id(without): timed, id(fitted): both}

    def beside_delay(_, one, least=0.0):
        other = beside[id(one)]
        return other if one.objective - other.objective > least else one

    monkeypatch.setattr(judge, "beside_short_delay", beside_delay)

    def white(data, before, after, index):
        more = before.objective - after.objective
        return SimpleNamespace(p_value=chi2.sf(more, 1), beyond_chance=more)

    monkeypatch.setattr(judge, "weigh", white)
    data, evidence = SimpleNamespace(feigned_gain=0.0), SimpleNamespace(inflation=1.0)
    assert judge._short_delay_does(data, without, fitted, evidence, 80) == instead


@pytest.mark.parametrize(
    ("effect", "turned", "least"),
    [
        ("inertia_error", False, np.inf),
        ("inertia_error", True, 100.0),
        ("coulomb_friction", False, 100.0),
        ("contact_shape", False, 40.0),
    ],
)
def test_what_turns_a_robot_that_only_disturbances_turn_gets_no_name(effect, turned, least):
    """And the friction curve is asked for no more than where all directions are driven."""
    data = SimpleNamespace(feigned_gain=100.0, driven=(True, True, turned))
    assert judge._feigned_gain(data, SimpleNamespace(effect=effect)) == least


def test_any_inertia_stands_beside_what_is_left_where_only_disturbances_turn_a_robot(tmp_path):
    case = TruthCase(seed=512, excitation="rich", runs=2, run_duration_s=3.0)
    robot, runs, _ = robot_runs(case, tmp_path)
    data, fitted = settle(robot, runs, believed_hypothesis(robot))
    assert judge.beside_turning(data, fitted) is fitted
    data.driven = (True, True, False)
    freer = judge.beside_turning(data, fitted)
    assert [effect.effect for effect in freer.hypothesis.effects] == ["inertia_error"]
