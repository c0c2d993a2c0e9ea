"""The fit and its uncertainty on axes whose answer is known.

Viscous friction under white force noise and white position noise is the linear Gaussian case of the
filter: estimates scatter as their covariance says, and 95 % intervals hold the truth 95 times in
100. Coverage of n seeds is judged by its binomial spread.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from axis_bench import (
    VISCOUS_N_S_M,
    Bench,
    make_log,
    make_machine,
    make_runs,
    multisine,
    true_noise,
)
from hypothesis import assume, given
from hypothesis.extra.numpy import arrays
from hypothesis.strategies import floats
from omnislip.gap.inference import (
    DIVERGED,
    LEAST_OFF,
    LEAST_STAKE,
    Check,
    Data,
    Fit,
    Hypothesis,
    at_bound,
    check_columns,
    check_unseen,
    fit,
    fitted_without_each_unit,
    free_of_fitted,
    left_by_shapes,
    linearise,
    objective,
    prior_penalty,
    weigh,
)
from omnislip.gap.machine import Machine
from omnislip.gap.noise import RunawayError, track_all, tune_noise
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.truth import TruthCase
from omnislip.model_file import NOMINAL_ROBOT, read_model
from scipy.stats import binom, chi2, kstest
from truth_bench import runs_of

SEEDS = 60
CONFIDENCE = 1.959964


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    """An axis whose keys are exact, so that only the effect is fitted."""
    return make_machine(tmp_path_factory.mktemp("exact"), tolerance=0.0)


def candidate(machine, name):
    return next(c for c in machine.candidates() if c.effect == name)


def without_effects(machine):
    base = tuple(machine.base_parameters())
    return Hypothesis(base, (), np.array([machine.believed[p.places[0]] for p in base]))


def estimate(machine, log, effect, start):
    """Fit and evidence of one effect on one log with known noise."""
    data = Data(machine, [make_run(machine, log)], true_noise(), without_effects(machine))
    if machine.base_parameters():
        believed = fit(data, without_effects(machine))
    else:
        residual = data.residuals(machine.believed[None])[0]
        square = float(residual @ residual)
        believed = Fit(without_effects(machine), square, residual, np.zeros((len(residual), 0)))
    with_effect = without_effects(machine).with_effect(candidate(machine, effect), [start])
    fitted = fit(data, with_effect)
    return fitted, weigh(data, believed, fitted, 0)


def test_naming_an_effect_last_turns_nothing_but_the_order(exact):
    runs = [make_run(exact, make_log(Bench(coulomb_n=2.0), seed=1))]
    data = Data(exact, runs, true_noise(), without_effects(exact))
    names = ["coulomb_friction", "asymmetric_friction", "dead_zone"]
    hypothesis = without_effects(exact)
    for name in names:
        effect = candidate(exact, name)
        hypothesis = hypothesis.with_effect(effect, [0.1 * p.scale for p in effect.parameters])
    fitted = fit(data, hypothesis, iterations=1)
    for index in range(len(names)):
        moved = fitted.moved_last(index)
        assert [e.effect for e in moved.hypothesis.effects][-1] == names[index]
        [residual], [jacobian] = linearise(data, [moved.hypothesis], last=[moved.jacobian])
        np.testing.assert_allclose(residual, moved.residual)
        size = np.linalg.norm(jacobian, axis=0)
        assert np.all(np.linalg.norm(moved.jacobian - jacobian, axis=0) < 0.01 * size)


def scores(machine, bench, effect, start, truth):
    """Estimates and their standard deviations over the seeds."""
    found = [estimate(machine, make_log(bench, seed), effect, start) for seed in range(SEEDS)]
    values = np.array([fitted.hypothesis.values_of(0)[0] for fitted, _ in found])
    deviations = np.array([np.sqrt(evidence.covariance[0, 0]) for _, evidence in found])
    return values - truth, deviations


def assert_intervals_are_honest(errors, deviations):
    """Not too narrow (coverage), not too wide (scatter against what is claimed), not off."""
    covered = int(np.sum(np.abs(errors) <= CONFIDENCE * deviations))
    assert covered >= binom.ppf(1e-3, SEEDS, 0.95)
    claimed = np.sqrt(np.mean(deviations**2))
    # The ratio of variances has a chi-squared law; inflation only widens, by up to a half.
    low, high = chi2.ppf([1e-3, 1 - 1e-3], SEEDS) / SEEDS
    assert 0.5 * low < np.mean(errors**2) / claimed**2 < high
    assert abs(errors.mean()) < 3.3 * claimed / np.sqrt(SEEDS)


def test_viscous_friction_is_found_within_its_interval(exact):
    bench = Bench(viscous_n_s_m=VISCOUS_N_S_M + 1.0)
    assert_intervals_are_honest(*scores(exact, bench, "viscous_friction_error", 0.1, 1.0))


def test_coulomb_friction_is_found_within_its_interval(exact):
    assert_intervals_are_honest(*scores(exact, Bench(coulomb_n=1.0), "coulomb_friction", 0.1, 1.0))


def test_a_true_null_gives_small_evidence(exact):
    """Over 20 data sets the p-values of an effect that is not there are spread like chance.

    Inflation only makes them larger, so only small ones would be wrong.
    """
    p_values = [
        estimate(exact, make_log(Bench(), seed), "viscous_friction_error", 0.1)[1].p_value
        for seed in range(100, 120)
    ]
    assert np.min(p_values) > 1e-3 / 20
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 1e-3
    assert np.max(p_values) > 0.3  # a test that never says "chance" would be no test


def test_noise_is_tuned_to_what_it_is(exact):
    """Within 10 % for the position noise and 25 % for the force noise on 24 s."""
    runs = make_runs(exact, Bench(), range(5))
    noise = tune_noise(exact, runs, exact.believed)
    truth = true_noise()
    assert noise.output[0] / truth.output[0] == pytest.approx(1.0, abs=0.1)
    assert noise.process[0] / truth.process[0] == pytest.approx(1.0, abs=0.25)


def test_innovations_of_the_true_model_are_white_with_unit_variance(exact):
    runs = make_runs(exact, Bench(), range(5))
    data = Data(exact, runs, true_noise(), without_effects(exact))
    residual = data.residuals(exact.believed[None])[0]
    sigma = 1 / np.sqrt(residual.size)
    assert data.scale == pytest.approx(1.0, abs=5 * sigma)
    for lag in (1, 2, 5, 20):
        assert abs(np.mean(residual[lag:] * residual[:-lag])) < 5 * sigma


def test_what_is_far_off_is_bounded_in_deviations_of_these_residuals(exact):
    """Not in those of the noise: a first guess may be a thousand times too small."""
    true = true_noise()
    noise = replace(true, process=1e-8 * true.process, output=1e-8 * true.output)
    data = Data(exact, make_runs(exact, Bench(), range(1)), noise, without_effects(exact))
    assert data.scale > 100.0
    drag = candidate(exact, "viscous_friction_error")
    dragged = without_effects(exact).with_effect(drag, [1e3]).flat(exact.believed)
    far = np.abs(data.residuals(dragged[None])).max()
    assert 1.1 * DIVERGED / data.scale < far <= DIVERGED


def test_what_is_too_stiff_to_be_followed_is_far_off():
    """Beside a set that is not; the filter itself refuses it by one line."""
    robot = Machine(read_model(NOMINAL_ROBOT))
    runs = runs_of(robot, TruthCase(seed=3, runs=1, run_duration_s=1.0))
    data = Data(robot, runs, tune_noise(robot, runs, robot.believed), believed_hypothesis(robot))
    stiff = robot.believed.copy()
    [place] = next(p for p in robot.base_parameters() if p.label == "motor.inertia_kg_m2").places
    stiff[place] = 1e-12
    near, far = data.residuals(np.stack([robot.believed, stiff]))
    assert np.abs(near).max() < 10.0
    np.testing.assert_allclose(far, DIVERGED, rtol=1e-3)  # less what rows hide
    with pytest.raises(RunawayError, match="too stiff"):
        track_all(robot, runs, stiff, data.noise)


@pytest.mark.parametrize("share", [1e-4, 0.05, 0.4, 3.0])
def test_residuals_of_a_set_do_not_depend_on_those_beside_it(share):
    """Whose wheels grip so much more that they take shorter steps."""
    robot = Machine(read_model(NOMINAL_ROBOT))
    runs = runs_of(robot, TruthCase(seed=3, runs=1, run_duration_s=1.0))
    data = Data(robot, runs, tune_noise(robot, runs, robot.believed), believed_hypothesis(robot))
    stiffer = robot.believed.copy()
    [place] = next(
        p for p in robot.base_parameters() if p.label == "contact.slip_stiffness_s_m"
    ).places
    stiffer[place] *= 1.0 + share
    both = data.residuals(np.stack([robot.believed, stiffer]))
    alone = [data.residuals(one[None])[0] for one in (robot.believed, stiffer)]
    np.testing.assert_allclose(both, alone, rtol=0.0, atol=1e-10)


def test_track_of_the_true_model_is_the_most_likely(exact):
    runs = make_runs(exact, Bench(), range(2))
    viscous = exact.place("viscous_friction_error", "viscous_friction_nm_s", None)

    def likelihood(extra):
        values = exact.believed.copy()
        values[list(viscous)] = extra
        return sum(t.log_likelihood for t in track_all(exact, runs, values, true_noise()))

    assert likelihood(0.0) > max(likelihood(-2.0), likelihood(2.0)) + 5


# ---- believed keys ----


@pytest.fixture(scope="module")
def believed(tmp_path_factory):
    """An axis whose keys are believed within 2 %."""
    return make_machine(tmp_path_factory.mktemp("believed"))


@pytest.mark.parametrize("mass_kg", [10.1, 11.5, 8.0])
def test_keys_stay_within_two_tolerances(believed, mass_kg):
    data = Data(
        believed,
        make_runs(believed, Bench(mass_kg=mass_kg), range(2)),
        true_noise(),
        without_effects(believed),
    )
    fitted = fit(data, without_effects(believed))
    z = prior_penalty(fitted.hypothesis, believed.believed, fitted.hypothesis.x)
    assert np.abs(z).max() <= 2 + 1e-9
    assert np.sign(z[0]) == np.sign(mass_kg - 10.0)
    assert at_bound(fitted, 0) == (abs(mass_kg / 10.0 - 1) > 0.04)


def test_the_objective_is_chance_plus_what_the_keys_were_moved(believed):
    data = Data(
        believed, make_runs(believed, Bench(), range(1)), true_noise(), without_effects(believed)
    )
    hypothesis = without_effects(believed)
    x = hypothesis.x + np.array([1.0, -0.5, 2.0]) * [p.scale for p in hypothesis.base]
    chance = np.sum(data.residuals(hypothesis.flat(believed.believed, x)[None]) ** 2)
    moved = float(objective(data, hypothesis, x[None])[0]) - chance
    assert moved == pytest.approx(1.0 + 0.25 + 4.0, rel=1e-6)


def test_the_fit_is_where_the_objective_is_least(believed):
    data = Data(
        believed,
        make_runs(believed, Bench(mass_kg=10.1), range(2)),
        true_noise(),
        without_effects(believed),
    )
    fitted = fit(data, without_effects(believed))
    hypothesis, x = fitted.hypothesis, fitted.hypothesis.x
    scale = np.array([p.scale for p in hypothesis.base])
    around = np.vstack([x + sign * np.diag(0.2 * scale) for sign in (-1, 1)])
    assert np.abs(prior_penalty(hypothesis, believed.believed, x)).max() < 1.8
    assert objective(data, hypothesis, around).min() > fitted.objective


def test_what_the_keys_explain_is_taken_out(believed):
    data = Data(
        believed, make_runs(believed, Bench(), range(2)), true_noise(), without_effects(believed)
    )
    fitted = fit(data, without_effects(believed))
    own = fitted.jacobian[:, :1]
    rng = np.random.default_rng(1)
    other = rng.standard_normal((len(own), 1))
    left = np.linalg.norm(free_of_fitted(fitted, own)) / np.linalg.norm(own)
    kept = np.linalg.norm(free_of_fitted(fitted, other)) / np.linalg.norm(other)
    # A key explains itself but for its prior: 1 / (1 + information).
    information = float(own[:, 0] @ own[:, 0])
    assert left < 2 / np.sqrt(information)
    assert kept > 0.99


# ---- hypotheses as values ----


def test_hypotheses_grow_and_shrink(exact):
    dead_zone, coulomb = (candidate(exact, name) for name in ("dead_zone", "coulomb_friction"))
    both = without_effects(exact).with_effect(dead_zone, [0.2]).with_effect(coulomb, [1.5])
    assert both.values_of(1) == pytest.approx([1.5])
    assert both.without(0).values_of(0) == pytest.approx([1.5])
    flat = both.flat(exact.believed)
    assert flat[list(exact.place("dead_zone", "duty", None))] == pytest.approx(0.2)
    changed = np.flatnonzero(flat != exact.believed)
    assert len(changed) == 2
    assert replace(both, effects=()).parameters == ()


def test_commands_of_the_bench_reverse_and_rest():
    command = multisine(np.random.default_rng(1), 1000)
    assert command.min() < -1 < 1 < command.max()


BLOCKS = np.repeat(np.arange(40), 50)


def weighed(machine, explained):
    """Evidence of an effect whose score is far too large in block 0 of 40.

    `explained` says for each block whether the effect explains anything there.
    """
    rng = np.random.default_rng(0)
    column, residual = rng.standard_normal((2, BLOCKS.size))
    residual[BLOCKS == 0] += 5.0 * column[BLOCKS == 0]
    return evidence_of(machine, np.where(explained[BLOCKS], column, 0.0), residual)


def evidence_of(machine, column, residual, edges_m=()):
    """Evidence of an effect that takes a column out of the residuals; with edges, of a patch."""
    effect = replace(candidate(machine, "coulomb_friction"), edges_m=edges_m)
    alone = Hypothesis((), (effect,), np.array([effect.parameters[0].scale]))
    with_effect = Fit(alone, float(residual @ residual), residual, column[:, None])
    left = residual + column
    without = Fit(
        Hypothesis((), (), np.zeros(0)), float(left @ left), left, np.zeros((left.size, 0))
    )
    return weigh(SimpleNamespace(blocks=BLOCKS), without, with_effect, 0)


@pytest.mark.parametrize(
    ("edges_m", "gain", "share", "told"),
    [
        ((), 60.0, 1.0 / 40.0, True),
        ((), 60.0, 0.5, True),
        ((), 60.0, 0.9, False),
        (((0.0,),), 400.0, 0.5, True),
        (((0.0,),), 400.0, 0.99, False),  # a patch where a reading is off
    ],
)
def test_a_gain_that_one_block_makes_by_itself_is_an_accident(exact, edges_m, gain, share, told):
    """In 40 blocks of noise that says nothing of its own, `share` of it in the first."""
    rng = np.random.default_rng(1)
    column, residual = rng.standard_normal((2, BLOCKS.size))
    wanted = np.where(BLOCKS == 0, gain * share, gain * (1.0 - share) / 39.0)
    column *= np.sqrt(wanted / np.bincount(BLOCKS, column**2)[BLOCKS])
    along = np.bincount(BLOCKS, column * residual) / np.bincount(BLOCKS, column**2)
    residual -= along[BLOCKS] * column
    evidence = evidence_of(exact, column, residual, edges_m)
    assert evidence.gain == pytest.approx(gain)
    assert (evidence.p_value < 1e-5) == told


def test_one_bad_block_does_not_hide_what_all_others_show(exact):
    everywhere = weighed(exact, np.ones(40, bool))
    assert everywhere.inflation > 5.0
    assert everywhere.p_value < 1e-10


def test_what_one_block_shows_alone_is_no_evidence(exact):
    assert weighed(exact, np.arange(40) == 0).p_value > 0.1


@pytest.mark.parametrize("deviation", [0.0, 0.5])
def test_how_a_size_changes_from_block_to_block_is_seen(exact, deviation):
    """Sizes 1 + v of 60 blocks that show the effect unevenly; v is known to a tenth from them."""
    rng = np.random.default_rng(1)
    blocks = np.repeat(np.arange(60), 50)
    column, noise = rng.standard_normal((2, blocks.size))
    column *= np.repeat(rng.uniform(0.5, 2.0, 60), 50)
    sizes = 1.0 + deviation * np.repeat(rng.standard_normal(60), 50)
    wanted = noise - column * sizes
    size = -(column @ wanted) / (column @ column)
    left = wanted + size * column
    effect = candidate(exact, "coulomb_friction")
    alone = Hypothesis((), (effect,), np.array([size * effect.parameters[0].scale]))
    with_effect = Fit(alone, float(left @ left), left, column[:, None])
    nothing = Hypothesis((), (), np.zeros(0))
    without = Fit(nothing, float(wanted @ wanted), wanted, np.zeros((wanted.size, 0)))
    found = weigh(SimpleNamespace(blocks=blocks), without, with_effect, 0).variation
    assert found == pytest.approx(deviation, abs=0.1)


# ---- runs left out ----


@pytest.fixture(scope="module")
def dry(tmp_path_factory):
    """Four runs of an axis with dry friction, fitted without and with it."""
    machine = make_machine(tmp_path_factory.mktemp("dry"))
    runs = make_runs(machine, Bench(coulomb_n=1.0), range(4))
    data = Data(machine, runs, true_noise(), without_effects(machine))
    base = fit(data, without_effects(machine))
    start = base.hypothesis.with_effect(candidate(machine, "coulomb_friction"), [0.5])
    return data, base, fit(data, start)


def test_a_fit_without_a_unit_is_that_of_the_other_runs(dry):
    """Two runs are one unit: within a tenth of a deviation of a fit that never saw them."""
    data, _, fitted = dry
    runs = [replace(r, unit=u) for r, u in zip(data.runs, ("a", "b", "a", "c"), strict=True)]
    pooled = Data(data.machine, runs, data.noise, without_effects(data.machine))
    found = fitted_without_each_unit(pooled, fitted)
    assert len(found) == 3
    places = [p.places[0] for p in fitted.hypothesis.parameters]
    for unit, left in enumerate(([1, 3], [0, 2, 3], [0, 1, 2])):
        rest = [runs[k] for k in left]
        start = without_effects(data.machine)
        others = Data(data.machine, rest, data.noise, start, scale=pooled.scale)
        again = fit(others, fitted.hypothesis)
        count = len(fitted.hypothesis.base)
        prior = np.diag([1.0] * count + [0.0] * (len(places) - count))
        deviation = np.sqrt(np.diag(np.linalg.inv(again.jacobian.T @ again.jacobian + prior)))
        scale = np.array([p.scale for p in fitted.hypothesis.parameters])
        off = (found[unit, places] - again.hypothesis.x) / scale
        assert np.all(np.abs(off) < 0.1 * deviation)


def test_a_run_is_judged_by_what_fits_the_others(dry):
    data, base, fitted = dry
    [check] = check_unseen(data, base, [fitted])
    sets = [fitted_without_each_unit(data, one) for one in (base, fitted)]
    for run in range(4):
        unseen = data.residuals(np.stack([one[run] for one in sets]))
        gains = []
        for pair in (unseen, (base.residual, fitted.residual)):
            before, after = (data.per_run(one)[run] for one in pair)
            gains.append(np.sum(before**2) - np.sum(after**2))
        assert check.gains[run] == pytest.approx(min(gains), rel=1e-6)
        assert check.stakes[run] == pytest.approx(np.sum((before - after) ** 2), rel=1e-6)
    assert check.helps and check.helped == 4
    assert np.all(check.unsure > 0) and np.all(check.unsure < LEAST_STAKE)


def test_a_run_of_which_the_others_tell_nothing_does_not_judge(dry):
    """The same axis, friction seen in one run only: the others leave its size open there."""
    data, base, fitted = dry
    jacobian, mute = fitted.jacobian.copy(), fitted.jacobian.copy()
    rows = len(data.per_run(fitted.residual)[0])
    jacobian[rows:, -1] *= 1e-3
    mute[:, -1] = 0.0  # a size that changes nothing anywhere
    fits = [replace(fitted, jacobian=one) for one in (jacobian, mute)]
    check, of_mute = check_unseen(data, base, fits)
    assert of_mute.judges.all()
    assert check.unsure[0] > 100.0 * check.stakes[0]
    assert check.judges.tolist() == [False, True, True, True]
    assert check.gain == pytest.approx(np.sum(check.gains[1:]))


def test_columns_are_judged_by_what_fits_the_other_runs(dry):
    data, base, _ = dry
    columns = np.random.default_rng(4).standard_normal((base.residual.size, 2))
    columns += 0.05 * base.residual[:, None]
    check = check_columns(data, base.residual, columns)
    parts = list(zip(data.per_run(columns), data.per_run(base.residual), strict=True))
    for run, (c, r) in enumerate(parts):
        others = [p for k, p in enumerate(parts) if k != run]
        left, right = (np.concatenate([p[side] for p in others]) for side in (0, 1))
        sizes = -np.linalg.lstsq(left, right, rcond=None)[0]
        gain = np.sum(r**2) - np.sum((r + c @ sizes) ** 2)
        assert check.gains[run] == pytest.approx(gain, rel=1e-6)
        assert check.stakes[run] == pytest.approx(np.sum((c @ sizes) ** 2), rel=1e-6)
        off = np.linalg.inv(left.T @ left)
        assert check.unsure[run] == pytest.approx(np.sum((c @ off) * c), rel=1e-6)


HIGH, LOW = 4.0 * LEAST_STAKE, 0.5 * LEAST_STAKE


@pytest.mark.parametrize(
    "gains, stakes, helps",
    [
        ([9.0, 8.0, 9.0, 8.0], [HIGH] * 4, True),
        ([9.0, 8.0, 9.0, -8.0], [HIGH] * 4, True),
        ([9.0, 8.0, -3.0, -8.0], [HIGH] * 4, False),
        ([9.0, 8.0, -1.0, -1.0], [HIGH, HIGH, LOW, LOW], True),  # these two have no vote
        ([9.0, 8.0, -9.0, -9.0], [HIGH, HIGH, LOW, LOW], False),  # but they count
        ([1.0, 1.0, 1.0, 1.0], [LOW] * 4, False),
        ([900.0, 800.0, -9.0, -9.0], [1e3, 1e3, 9.0, 9.0], True),  # nor where it hardly shows
        ([900.0, 800.0, -9.0, -9.0], [1e3, 1e3, 12.0, 12.0], False),
        ([900.0, 800.0, -900.0, -900.0], [1e3, 1e3, 9.0, 9.0], False),
        ([9.0] * 20 + [-1.0] * 10, [HIGH] * 30, True),  # beyond the scatter
        ([9.0] * 20 + [-15.0] * 10, [HIGH] * 30, False),
        # what is at stake in the gentle runs is a hundredth of the others'
        (
            [1650.0, 965.0, 1290.0, 1470.0, -15.0, -24.0],
            [1700.0, 980.0, 1400.0, 1450.0] + [12.0] * 2,
            True,
        ),
        (
            [600.0, 965.0, -300.0, 900.0, -150.0, -24.0],
            [1700.0, 980.0, 1400.0, 1450.0] + [120.0] * 2,
            False,
        ),
        ([900.0, -10.0, -10.0, -10.0], [1000.0] + [20.0] * 3, False),  # a single run's
    ],
)
def test_most_of_the_runs_in_which_something_is_at_stake_have_to_gain(gains, stakes, helps):
    assert Check(np.array(gains), np.array(stakes), np.zeros(len(gains))).helps == helps


def test_runs_of_a_unit_have_one_vote(dry):
    """What three of four runs gain is one vote of two where these are a unit."""
    data, base, fitted = dry
    runs = [replace(run, unit=u) for run, u in zip(data.runs, "aaab", strict=True)]
    pooled = Data(data.machine, runs, data.noise, without_effects(data.machine))
    [check] = check_unseen(pooled, base, [fitted])
    [alone] = check_unseen(data, base, [fitted])
    assert check.gains.shape == (2,)
    assert check.stakes == pytest.approx([alone.stakes[:3].sum(), alone.stakes[3]])
    columns = fitted.residual[:, None] - base.residual[:, None]
    assert check_columns(pooled, base.residual, columns).gains.shape == (2,)


def test_a_run_that_does_not_judge_has_no_vote():
    gains, stakes = np.array([9.0, 8.0, 9.0, -300.0]), np.array([HIGH] * 4)
    assert not Check(gains, stakes, np.zeros(4)).helps
    check = Check(gains, stakes, np.array([1.0, 1.0, 1.0, 2.0 * HIGH]))
    assert check.helps and check.helped == 3 and check.gain == 26.0


# ---- what shapes of effects leave ----

vectors = arrays(np.float64, 8, elements=floats(-10.0, 10.0, width=32))


MUCH = np.full(8, 1e3)
"""Residuals in which any shape may hide."""


def doing(action):
    """A fit with one effect that does `action` (m,) to the residuals."""
    hypothesis = SimpleNamespace(effects=(None,))
    return SimpleNamespace(hypothesis=hypothesis, actions=lambda data: action[None])


def test_what_an_effect_does_alike_it_may_leave_in_full_and_elsewhere_nothing():
    action = np.array([1.0, -2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    fitted = doing(action)
    alike, elsewhere = 5.0 * np.abs(action), np.array([0.0, 0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    share = 1e-3
    assert left_by_shapes(None, fitted, alike, MUCH, lambda e: share) == pytest.approx(share * 14.0)
    assert left_by_shapes(None, fitted, elsewhere, MUCH, lambda e: share) == 0.0
    assert left_by_shapes(None, fitted, alike, MUCH, lambda e: 0.0) == 0.0
    assert left_by_shapes(None, fitted, 0.0 * alike, MUCH, lambda e: share) == 0.0


def test_what_knows_nothing_of_a_change_leaves_it_by_chance_only():
    """Errors of one sign in each of four blocks add in squares, not with the sign of the change."""
    fitted, change = doing(np.full(8, 10.0)), np.array([1.0, -1.0] * 4)
    data = SimpleNamespace(blocks=np.arange(8) // 2)
    for unrelated, gain in ((False, 8 * 100.0), (True, 4 * 20.0**2 / 8)):
        found = left_by_shapes(data, fitted, change, MUCH, lambda _: 1.0, lambda _, x=unrelated: x)
        assert found == pytest.approx(gain)


def test_no_more_is_left_along_a_change_than_is_seen_at_all():
    """An effect that does 1000 deviations of chance, 3 % of which would be 30, and is half of it
    alike: where two are all that is left, it may leave two in these."""
    action = np.full(8, 1000.0)
    change = np.array([1.0] * 4 + [0.0] * 4)
    for seen, off in ((2.0, 2.0), (15.0, 15.0), (30.0, 30.0), (500.0, 30.0)):
        left = np.full(8, -seen)
        found = left_by_shapes(None, doing(action), change, left, lambda e: LEAST_OFF**2)
        assert found == pytest.approx(4 * off**2)


def test_what_an_effect_does_is_what_goes_with_it(dry):
    """Small drag: its derivative times its size. A limit that nothing reaches: nothing. Play: less
    than its derivative times its size, which would go on for ever."""
    data, base, _ = dry

    def model(name, values):
        return fit(data, base.hypothesis.with_effect(candidate(data.machine, name), values), 0)

    drag = candidate(data.machine, "viscous_friction_error").parameters[0]
    viscous = data.machine.believed[drag.places[0]]
    small = model("viscous_friction_error", [viscous + 0.01 * drag.scale])
    [action] = small.actions(data)
    assert action @ action > 0.0
    assert action == pytest.approx(0.01 * small.jacobian[:, -1], abs=0.01 * np.abs(action).max())
    [nothing] = model("current_limit", [1e6]).actions(data)
    assert not nothing.any()
    limit = candidate(data.machine, "current_limit").parameters[0]
    [clipped] = model("current_limit", [0.01 * limit.scale]).actions(data)
    assert clipped.any()
    play = candidate(data.machine, "gear_backlash").parameters[0]
    loose = model("gear_backlash", [5.0 * play.scale])
    [action] = loose.actions(data)
    assert 0.0 < np.linalg.norm(action) < 5.0 * np.linalg.norm(loose.jacobian[:, -1])


def test_what_several_effects_leave_adds(dry):
    """Each by what goes with it; one whose share is 0 leaves nothing."""
    data, base, _ = dry
    effects = [c for c in data.machine.candidates() if len(c.amplitudes) == 1][:2]
    sizes = [0.5 * c.parameters[c.amplitudes[0]].scale for c in effects]
    hypothesis = base.hypothesis
    for effect, size in zip(effects, sizes, strict=True):
        values = [data.machine.believed[p.places[0]] for p in effect.parameters]
        values[effect.amplitudes[0]] += size
        hypothesis = hypothesis.with_effect(effect, values)
    both = fit(data, hypothesis, iterations=0)
    change = np.random.default_rng(1).standard_normal(len(both.residual))
    seen = np.full(len(change), 1e3)
    alone = [
        left_by_shapes(data, both, change, seen, lambda effect, own=own: float(effect is own))
        for own in effects
    ]
    together = left_by_shapes(data, both, change, seen, lambda effect: 1.0)
    assert min(alone) > 0.0
    assert together == pytest.approx(sum(alone))


@given(vectors, vectors, arrays(np.float64, 8, elements=floats(-1.0, 1.0, width=32)))
def test_no_shape_that_is_off_by_no_more_leaves_more(action, change, off):
    """Whatever share of its action an effect is off in each residual, up to 1; one reaches it."""
    assume(change @ change > 1e-6)
    most = left_by_shapes(None, doing(action), change, MUCH, lambda effect: 1.0)

    def gain(left):
        return (left @ change) ** 2 / (change @ change)

    assert gain(off * action) <= most * (1.0 + 1e-9)
    assert gain(np.sign(action * change) * action) == pytest.approx(most, rel=1e-9)
