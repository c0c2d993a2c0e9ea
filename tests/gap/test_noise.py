"""The filter's noise: likelihoods along a path against filters of their own, and disturbances."""

from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from axis_bench import Bench, make_machine, make_runs
from omnislip.gap import truth
from omnislip.gap.inference import Data
from omnislip.gap.machine import Machine, count_rad
from omnislip.gap.noise import (
    COLOUR_RATE,
    COLOUR_RATES_1_S,
    CONTACT,
    CONVERGED,
    NOISES,
    PULL,
    SENSOR_MARGIN,
    STEP_S,
    Noise,
    RunawayError,
    _Path,
    contact_forces,
    first_guess,
    judging_noise,
    run_free,
    some_runs,
    track_all,
    track_recordings,
    tune_noise,
)
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.log_file import Log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal
from truth_bench import runs_of

MOST_OF_UNSETTLED = 100.0
NAMES = ("process", "output", "initial", "timing_s2", "unresolved", "unresolved_current")
NAMES += ("coloured", "colour_rate_1_s")


class Tracked:
    """A machine with runs, its tuned noise, and the filter of that noise with its matrices."""

    def __init__(self, machine, runs):
        self.machine, self.runs = machine, runs
        self.recordings = [run.recording for run in runs]
        self.noise = tune_noise(machine, runs, machine.believed)
        self.tracks = self.tracked(self.noise, keep_linear=True)

    def tracked(self, noise, keep_linear=False):
        return track_recordings(
            self.machine, self.recordings, self.machine.believed, noise, STEP_S, keep_linear
        )

    def tracked_log_likelihood(self, noise):
        return sum(track.log_likelihood for track in self.tracked(noise))

    def moved(self, index, step):
        """The noise with one of its logarithms moved."""
        make, _ = NOISES[self.machine.kind]
        return make(self.machine, self.noise.logs + step * np.eye(len(self.noise.logs))[index])

    def arguments(self, noises):
        """What `likelihoods` of the engine takes after recordings and tracks, by name."""
        named = {name: np.array([getattr(noise, name) for noise in noises]) for name in NAMES}
        return named | {"coloured": named["coloured"].reshape(len(noises), -1)}

    def likelihoods(self, noises, with_information=False):
        return self.machine.engine.likelihoods(
            self.recordings,
            self.tracks,
            **self.arguments(noises),
            with_information=with_information,
        )


@pytest.fixture(scope="module")
def robot():
    machine = Machine(read_model(NOMINAL_ROBOT))
    return Tracked(machine, runs_of(machine, TruthCase(5, runs=2, run_duration_s=2.0)))


def with_memory(**effects):
    """A robot whose filter corrects memory, too."""
    model = read_model(NOMINAL_ROBOT)
    named = [Effect(name, sizes) for name, sizes in effects.items()]
    machine = Machine(replace(model, effects=named))
    hidden = tuple(HiddenEffect(name, sizes).as_dict() for name, sizes in effects.items())
    return Tracked(machine, runs_of(machine, TruthCase(5, hidden, runs=2, run_duration_s=2.0)))


BRISTLES = {"length_m": 2e-3}
SPRINGS = {"stiffness_nm_rad": 40.0, "damping_nm_s_rad": 0.02}


@pytest.fixture(scope="module")
def bristled():
    return with_memory(bristle_relaxation=BRISTLES)


@pytest.fixture(scope="module")
def sprung():
    return with_memory(shaft_compliance=SPRINGS)


@pytest.fixture(scope="module")
def bristled_and_sprung():
    return with_memory(bristle_relaxation=BRISTLES, shaft_compliance=SPRINGS)


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    machine = make_machine(tmp_path_factory.mktemp("axis"))
    return Tracked(machine, make_runs(machine, Bench(), range(2)))


@pytest.fixture(params=["robot", "bristled", "sprung", "bristled_and_sprung", "axis"])
def bench(request):
    return request.getfixturevalue(request.param)


def test_noise_is_tuned_on_the_calmest_and_the_liveliest_of_many_runs(robot):
    """Twelve of 2 s, of which six are enough. Noise that was tuned on calm ones knows no slip."""
    run = robot.runs[0]
    sizes = [0.5, 0.7, 0.1, *[0.6] * 7, 1.0, 0.4]
    runs = [replace(run, name=str(size), command=size * run.command) for size in sizes]
    chosen = [one.name for one in some_runs(runs)]
    assert 6 <= len(chosen) <= 7
    assert {"0.1", "1.0"} < set(chosen)


def test_covariances_that_are_lost_in_rounding_end_the_climb(robot, monkeypatch):
    """The noise is what it was; nobody sees a trace."""

    def lost(self, many, with_information):
        assert with_information  # nothing is tried from there
        return np.zeros(len(many)), np.full((len(many), len(many)), np.nan)

    monkeypatch.setattr(_Path, "_look", lost)
    tuned = tune_noise(robot.machine, robot.runs, robot.machine.believed, robot.noise)
    np.testing.assert_array_equal(tuned.logs, robot.noise.logs)


# ---- the filter of a track ----


def kicked(machine, places):
    """What a kick of each motor moves (states and memory, 4): its speed, not a wheel on a spring.

    The last 8 of `places` are then slack and twist, wheel by wheel.
    """
    kicks = np.eye(places, 4)
    if any(effect.name == "shaft_compliance" for effect in machine.model.effects):
        kicks[-8::2] = -np.eye(4) / machine.model.values["motor.gear_ratio"]
    return kicks


def told_by_no_row(run, noise, row, pushes, kicks):
    """What the covariance grows by within a row: commands that moved there, or that are missing.

    `pushes` (states, disturbances) is what disturbances of the shafts and the body do meanwhile,
    `kicks` (states, 4) at the end of the row.
    """
    duration_s, grown = run.t_s[row + 1] - run.t_s[row], 0.0
    change = np.diff(run.command, axis=0, prepend=run.command[:1])
    for motor in range(4):
        late = duration_s * kicks[:, motor]
        early = 2.0 * pushes[:, motor] - late  # as of a row's begin, passed on by the transition
        moved = (late - early) / 12.0
        square = np.mean(change[row : row + 2, motor] ** 2)
        lost = run.recording.untold[row] * change[row + 1, motor]
        grown += noise.unresolved * square * np.outer(moved, moved)
        grown += 0.5 * lost**2 * (np.outer(early, early) + np.outer(late, late))
    return grown


def textbook_filter(run, track, noise, machine):
    """Gain, whitening, variance of corrections and log likelihood by dense matrices of numpy.

    Along the track's own transitions, slopes and innovations, disturbances decaying as the noise
    says; without mistimed rows.
    """
    rows, n, m = len(run.t_s), track.filter_states, machine.engine.outputs
    transition = track.transition.reshape(rows, n, n)
    slope = track.slope.reshape(rows, m, n)
    innovation = track.innovation.reshape(rows, m)
    quiet = np.zeros(n - len(noise.process) - len(noise.coloured))  # memory
    initial, coloured = noise.initial, noise.coloured
    if run.recording.begun_variance.size:
        initial, more = np.split(run.recording.begun_variance, [len(initial)])
        coloured = coloured + np.diag(more)
    covariance = block_diag(np.diag(np.concatenate([initial, quiet])), coloured)
    gain, whitening = np.zeros((rows, n, m)), np.zeros((rows, m, m))
    corrected, log_likelihood = np.zeros((rows, n)), 0.0
    for row in range(rows):
        seen = np.flatnonzero(~np.isnan(innovation[row]))
        if seen.size:
            h = slope[row, seen]
            scatter = h @ covariance @ h.T + np.diag(noise.output[seen])
            k = covariance @ h.T @ np.linalg.inv(scatter)
            gain[row][:, seen] = k
            whitening[row][np.ix_(seen, seen)] = np.linalg.inv(np.linalg.cholesky(scatter))
            corrected[row] = np.diag(k @ scatter @ k.T)
            log_likelihood += multivariate_normal.logpdf(innovation[row, seen], cov=scatter)
            if run.t_s[row] < run.settled_s:
                square = float(np.sum((whitening[row][:, seen] @ innovation[row, seen]) ** 2))
                log_likelihood += 0.5 * max(square - MOST_OF_UNSETTLED, 0.0)
            rest = np.eye(n) - k @ h  # Joseph's form
            covariance = rest @ covariance @ rest.T + k @ np.diag(noise.output[seen]) @ k.T
        if row + 1 < rows:
            duration_s = run.t_s[row + 1] - run.t_s[row]
            decay = np.exp(-duration_s * noise.colour_rate_1_s)
            lasting = np.arange(n - len(noise.coloured), n)
            transition[row][lasting, lasting] = decay
            grown = np.diag(np.concatenate([noise.process * duration_s, quiet]))
            if machine.engine.pushes:
                pushes, kicks = (
                    transition[row][: len(grown), len(grown) :],
                    kicked(machine, len(grown)),
                )
                grown[:4, :4] = 0.0
                grown += kicks @ np.diag(noise.process[:4] * duration_s) @ kicks.T
                grown += told_by_no_row(run, noise, row, pushes, kicks)
            covariance = transition[row] @ covariance @ transition[row].T
            covariance += block_diag(grown, (1.0 - decay**2) * noise.coloured)
    return gain, whitening, corrected, log_likelihood


def test_the_filter_is_that_of_the_textbook(bench):
    """Written with symmetry and zeros in mind, it is as good as Joseph's form to 1e-7 of a gain."""
    noise = replace(bench.noise, timing_s2=0.0)
    assert noise.unresolved > 0.0 or not bench.machine.engine.pushes
    tracks = bench.tracked(noise, keep_linear=True)
    for run, track in zip(bench.runs, tracks, strict=True):
        found = (track.gain, track.whitening, track.correction_variance)
        *expected, log_likelihood = textbook_filter(run, track, noise, bench.machine)
        for own, one in zip(found, expected, strict=True):
            size = np.abs(one).max(axis=0)  # of each state and output
            assert np.all(np.abs(own.reshape(one.shape) - one) <= 1e-7 * size)
        assert track.log_likelihood == pytest.approx(log_likelihood, rel=1e-11)


def whitened_squares(track, rows, outputs):
    """Squares of the whitened innovations (rows,)."""
    whitening = track.whitening.reshape(rows, outputs, outputs)
    innovation = np.nan_to_num(track.innovation.reshape(rows, outputs))
    return np.sum(np.einsum("rij,rj->ri", whitening, innovation) ** 2, axis=1)


def started_otherwise(bench):
    """The bench with first states 50 standard deviations from what it took them for."""
    states, other = len(bench.noise.initial), copy(bench)
    starts = [track.state[:states] + 50.0 * np.sqrt(bench.noise.initial) for track in bench.tracks]
    other.recordings = [
        bench.machine.recording(run.t_s, run.command, run.outputs, start)
        for run, start in zip(bench.runs, starts, strict=True)
    ]
    if bench.machine.kind == "robot":
        other.recordings = [one.missing(np.zeros(one.rows)) for one in other.recordings]
    other.runs = [
        replace(run, recording=recording)
        for run, recording in zip(bench.runs, other.recordings, strict=True)
    ]
    other.tracks = other.tracked(other.noise, keep_linear=True)
    return other


def test_a_beginning_that_nobody_knows_is_no_noise(bench):
    """A row counts little of it in the likelihood: noise is not tuned to cover it."""
    other = started_otherwise(bench)
    noise = replace(other.noise, timing_s2=0.0)
    for run, track in zip(other.runs, other.tracked(noise, keep_linear=True), strict=True):
        *_, log_likelihood = textbook_filter(run, track, noise, other.machine)
        assert track.log_likelihood == pytest.approx(log_likelihood, rel=1e-11)
    totals, _ = other.likelihoods([other.noise])
    assert totals[0] == pytest.approx(other.tracked_log_likelihood(other.noise), rel=1e-12)
    lost = bench.tracked_log_likelihood(bench.noise) - totals[0]
    unsettled = sum(np.sum(run.t_s < run.settled_s) for run in other.runs)
    assert 50.0 < lost < 0.5 * MOST_OF_UNSETTLED * unsettled
    squares = [
        whitened_squares(track, len(run.t_s), other.machine.engine.outputs)
        for run, track in zip(other.runs, other.tracks, strict=True)
    ]
    assert 0.5 * sum(own.sum() for own in squares) > 5.0 * lost


def test_what_rounding_leaves_unsymmetric_does_not_grow(robot):
    """A body that its drag drives on, to and fro and sideways: exp(40) in 2 s."""
    drag = next(c for c in robot.machine.candidates() if c.name == "body_drag").parameters[0]
    values = robot.machine.believed.copy()
    values[list(drag.places)] = -400.0
    noise = replace(robot.noise, timing_s2=0.0)
    tracks = track_all(robot.machine, robot.runs, values, noise, keep_linear=True)
    for run, track in zip(robot.runs, tracks, strict=True):
        gain, *_, log_likelihood = textbook_filter(run, track, noise, robot.machine)
        size = np.abs(gain).max(axis=0)
        assert np.all(np.abs(track.gain.reshape(gain.shape) - gain) <= 1e-6 * size)
        assert track.log_likelihood == pytest.approx(log_likelihood, rel=1e-9)


# ---- likelihoods along a path ----


def test_the_noise_of_the_path_has_the_likelihood_of_its_filter(bench):
    totals, _ = bench.likelihoods([bench.noise])
    assert totals[0] == pytest.approx(bench.tracked_log_likelihood(bench.noise), rel=1e-12)


def test_what_changes_of_noise_tell_is_by_the_covariances_of_the_textbook(bench):
    """sum tr(A_i A_j) / 2 with A_i = W S_i W' - 1, by filters of dense matrices for each noise."""
    count, outputs = len(bench.noise.logs), bench.machine.engine.outputs
    noises = [bench.noise, *(bench.moved(k, 0.2) for k in range(count))]
    noises = [replace(noise, timing_s2=0.0) for noise in noises]
    _, found = bench.likelihoods(noises, with_information=True)
    changes = []
    for run, track in zip(bench.runs, bench.tracks, strict=True):
        _, first, *_ = textbook_filter(run, track, noises[0], bench.machine)
        own = []
        for noise in noises:
            _, white, *_ = textbook_filter(run, track, noise, bench.machine)
            silent = np.isnan(run.outputs)[:, :, None] * np.eye(outputs)
            root = first @ np.linalg.inv(white + silent)
            own.append((root @ root.transpose(0, 2, 1) - np.eye(outputs) + silent).ravel())
        changes.append(np.stack(own))
    changes = np.concatenate(changes, axis=1)
    expected = 0.5 * changes @ changes.T
    size = np.sqrt(np.diag(expected))
    assert np.count_nonzero(size > 1e-3) > count / 2
    assert np.all(np.abs(found - expected) <= 1e-6 * np.outer(size, size) + 1e-9)


def changes_by_a_hundredth(bench):
    """What moving each logarithm by 0.01 does, along the path and with filters of their own."""
    count = len(bench.noise.logs)
    noises = [bench.noise, *(bench.moved(k, 0.01) for k in range(count))]
    along, _ = bench.likelihoods(noises)
    own = np.array([bench.tracked_log_likelihood(noise) for noise in noises])
    return along[1:] - along[0], own[1:] - own[0]


def test_other_noises_of_a_linear_machine_have_the_likelihood_of_their_filters(axis):
    """Exact but for rounding of some 1e4, and of the secants that the filter is made of."""
    along, own = changes_by_a_hundredth(axis)
    np.testing.assert_allclose(along, own, atol=1e-6)
    assert np.abs(own).min() > 1e-3


def test_other_noises_of_a_robot_have_the_likelihood_of_their_filters_to_first_order(robot):
    """What is left out is of second order: a step of a hundredth, a hundredth of the change."""
    along, own = changes_by_a_hundredth(robot)
    assert np.linalg.norm(along - own) < 0.01 * np.linalg.norm(own)


def test_many_noises_are_as_one_by_one(robot):
    noises = [robot.moved(k, 0.3) for k in range(9)]
    together, told = robot.likelihoods(noises, with_information=True)
    alone = [robot.likelihoods([noise])[0][0] for noise in noises]
    np.testing.assert_array_equal(together, alone)
    assert told.shape == (9, 9)
    for i, j in ((1, 2), (3, 8), (7, 7)):
        _, own = robot.likelihoods([noises[0], noises[i], noises[j]], with_information=True)
        np.testing.assert_array_equal(told[[i, j]][:, [i, j]], own[1:, 1:])


@pytest.mark.parametrize("name", NAMES)
def test_noises_of_another_shape_are_refused(robot, name):
    engine, right = robot.machine.engine, robot.arguments([robot.noise] * 2)
    for wrong in (right[name][:1], np.repeat(right[name], 2, axis=-1)):
        with pytest.raises(ValueError, match="wrong shape"):
            engine.likelihoods(robot.recordings, robot.tracks, **right | {name: wrong})


def test_tracks_without_matrices_or_of_other_recordings_are_refused(robot):
    engine, right = robot.machine.engine, robot.arguments([robot.noise])
    with pytest.raises(ValueError, match="did not keep its matrices"):
        engine.likelihoods(robot.recordings, robot.tracked(robot.noise), **right)
    with pytest.raises(ValueError, match="one track per recording"):
        engine.likelihoods(robot.recordings, robot.tracks[:1], **right)


@pytest.mark.parametrize("length_m", [0.9e-3, 5e-3])
def test_bristles_are_likelier_even_by_noise_that_knows_none(length_m):
    """A filter that corrects speeds alone shakes wheels and body against each other there."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    hidden = HiddenEffect("bristle_relaxation", {"length_m": length_m}).as_dict()
    case = TruthCase(3, (hidden,), runs=2, run_duration_s=3.0, base_offset_sd=0.0)
    runs = runs_of(machine, case)
    noise = tune_noise(machine, runs, machine.believed)
    [bristles] = [c for c in machine.candidates() if c.effect == "bristle_relaxation"]
    none = believed_hypothesis(machine)
    without, true = (
        sum(t.log_likelihood for t in track_all(machine, runs, h.flat(machine.believed), noise))
        for h in (none, none.with_effect(bristles, [length_m, 0.0]))
    )
    assert true > without + 500.0


LIGHT = {
    "robot.mass_kg": 3.0,
    "robot.inertia_kg_m2": 0.013,
    "robot.wheel_radius_m": 0.027,
    "robot.wheel_distance_m": 0.083,
    "motor.resistance_ohm": 1.15,
    "motor.gear_ratio": 3.2,
    "motor.inertia_kg_m2": 1.15e-5,
    "motor.supply_v": 18.5,
    "encoder.counts_per_rev": 4096.0,
}
ROWS, HELD_ROWS = 600, 40


def sprung_log(machine, seed):
    """What the machine's own plant shows of duties that jump and are held, in counts."""
    rng = np.random.default_rng(seed)
    t_s = 0.005 * np.arange(ROWS)
    command = np.repeat(rng.uniform(-0.4, 0.4, (ROWS // HELD_ROWS, 4)), HELD_ROWS, axis=0)
    command[-1] = 0.0
    columns = {f"wheel/{i}/duty": command[:, i - 1] for i in range(1, 5)}
    columns |= {f"wheel/{i}/encoder_counts": np.zeros(ROWS) for i in range(1, 5)}
    run = make_run(machine, Log("still", t_s, columns | {"gyro/z_rad_s": np.zeros(ROWS)}))
    start, noise = np.zeros(machine.engine.states), first_guess(machine, [run])
    free = run_free(machine, t_s, command, start, machine.believed, noise, 1e-4)
    for i in range(4):
        columns[f"wheel/{i + 1}/encoder_counts"] = np.floor(free[:, 4 + i] / count_rad(machine))
    columns["gyro/z_rad_s"] = free[:, 10] + 0.003 * rng.standard_normal(ROWS)
    seen = np.arange(ROWS) % 4 == 0
    for place, name in enumerate(("pose/x_m", "pose/y_m", "pose/theta_rad"), start=11):
        shown = free[:, place] + 1e-3 * rng.standard_normal(ROWS)
        columns[name] = np.where(seen, shown, np.nan)
    return Log(f"run{seed}", t_s, columns)


def test_a_shaft_that_swings_is_followed_to_half_a_count():
    """A light robot on shafts of 25 Hz. A filter that takes what it corrects of a motor for its
    wheel's, too, drives the swing on: 0.93 counts, however the noise is tuned."""
    model = read_model(NOMINAL_ROBOT)
    springs = Effect("shaft_compliance", {"stiffness_nm_rad": 2.1, "damping_nm_s_rad": 1.7e-3})
    machine = Machine(replace(model, values=model.values | LIGHT, effects=[springs]))
    runs = [make_run(machine, sprung_log(machine, seed)) for seed in (1, 2, 3)]
    noise = tune_noise(machine, runs, machine.believed)
    tracks = track_all(machine, runs, machine.believed, noise)
    missed = np.concatenate([t.innovation.reshape(ROWS, -1)[50:, :4] for t in tracks])
    assert np.sqrt(np.mean(missed**2)) < 0.6 * count_rad(machine)


# ---- disturbances that last ----

PUSHED = [0, 1, 2, 3, 8, 9, 10]
"""States of the plant whose rates are disturbed: shafts and body."""


def test_disturbances_without_variance_change_nothing(robot):
    """The gains of the plant's states are those of a filter without disturbances, bit for bit."""
    engine, noise = robot.machine.engine, robot.noise
    common = (noise.process, noise.output, noise.initial, noise.timing_s2, noise.unresolved)
    with_none = engine.track(robot.recordings, robot.machine.believed, *common)
    none = [0.0] * engine.pushes**2
    with_zero = engine.track(
        robot.recordings, robot.machine.believed, *common, coloured=none, colour_rate_1_s=400.0
    )
    for one, other in zip(with_none, with_zero, strict=True):
        np.testing.assert_array_equal(one.gain, other.gain)
        assert one.log_likelihood == other.log_likelihood
        gain = other.gain.reshape(-1, other.filter_states, engine.outputs)
        assert gain[:, : engine.states].any()
        assert not gain[:, engine.states :].any()


def test_disturbances_push_the_rates_of_shafts_and_body(robot):
    """Over a row of length T the trapezoid of the pushed state's own motion, then a decay."""
    engine, run = robot.machine.engine, robot.runs[0]
    n = engine.states
    track = robot.tracks[0]
    transition = track.transition.reshape(len(run.t_s), track.filter_states, -1)[:-1]
    half = 0.5 * np.diff(run.t_s)[:, None, None]
    expected = half * (transition[:, :n, :n] + np.eye(n))[:, :, PUSHED]
    np.testing.assert_allclose(transition[:, :n, n:], expected, rtol=1e-12, atol=1e-18)
    decay = np.exp(-np.diff(run.t_s) * robot.noise.colour_rate_1_s)
    np.testing.assert_allclose(transition[:, n:, n:], decay[:, None, None] * np.eye(len(PUSHED)))
    assert not transition[:, n:, :n].any()


ROWS, ROW_S, RATE_1_S = 2000, 0.005, 100.0
LASTING = np.array([1.0] * 4 + [1e-4, 1e-4, 1e-2])
"""(rad/s2)^2 of the shafts, (m/s2)^2 and (rad/s2)^2 of the body: contacts stay linear."""


def shaken_at_rest(machine, noise):
    """A recording of a robot at rest that is pushed by exactly the noise of the filter."""
    engine, rng = machine.engine, np.random.default_rng(1)
    n, q = engine.states, engine.pushes
    time_s, command = np.arange(ROWS) * ROW_S, np.zeros((ROWS, engine.motors))
    still = engine.recording(time_s, command, np.zeros((ROWS, engine.outputs)), np.zeros(n))
    [track] = track_recordings(machine, [still], machine.believed, noise, STEP_S, True)
    transition = track.transition.reshape(ROWS, n + q, n + q)[0]
    slope = track.slope.reshape(ROWS, engine.outputs, n + q)[0]
    renewed = 1.0 - np.exp(-2.0 * noise.colour_rate_1_s * ROW_S)
    pushes = block_diag(np.diag(noise.process * ROW_S), renewed * noise.coloured)
    state = np.concatenate([np.zeros(n), root_of(noise.coloured) @ rng.standard_normal(q)])
    root = root_of(pushes)
    output = np.sqrt(noise.output) * rng.standard_normal((ROWS, engine.outputs))
    for row in range(ROWS):
        output[row] += slope @ state
        state = transition @ state + root @ rng.standard_normal(n + q)
    return engine.recording(time_s, command, output, np.zeros(n)), output


def root_of(covariance):
    sizes, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(sizes, 0.0))


def whitened(machine, recording, noise):
    engine = machine.engine
    [track] = track_recordings(machine, [recording], machine.believed, noise, STEP_S)
    white = track.whitening.reshape(ROWS, engine.outputs, engine.outputs)
    return np.einsum("kij,kj->ki", white, track.innovation.reshape(ROWS, engine.outputs))


@pytest.mark.parametrize("contact_n", [0.0, 0.02])
def test_disturbances_of_the_filter_are_what_they_are_said_to_be(robot, contact_n):
    """White with unit variance: 5 sd. A filter that takes each push for a new one is not."""
    machine = robot.machine
    output = np.array([1e-12] * 4 + [1e-8] + [1e-12] * 3)
    certain, anew, renewed = np.zeros(14), np.zeros(14), np.zeros(14)
    anew[PUSHED] = 0.1 * LASTING / RATE_1_S
    covariance = np.diag(LASTING) + (contact_n**2 * contact_forces(machine))
    lasting = Noise(anew, output, certain, 0.0, 0.0, np.zeros(0), 0.0, covariance, RATE_1_S)
    recording, _ = shaken_at_rest(machine, lasting)
    white = whitened(machine, recording, lasting)
    bound = 5.0 / np.sqrt(white.size)
    assert abs(np.mean(white**2) - 1.0) < np.sqrt(2.0) * bound
    for lag in (1, 2, 5):
        assert abs(np.mean(white[lag:] * white[:-lag])) < bound
    renewed[PUSHED] = 2.1 * LASTING / RATE_1_S  # what moves a state as far in the long run
    forgetful = Noise(renewed, output, certain, 0.0, 0.0, np.zeros(0))
    coloured = whitened(machine, recording, forgetful)
    assert np.mean(coloured[1:] * coloured[:-1]) > 5.0 * bound * np.mean(coloured**2)


def test_a_force_at_a_contact_turns_the_shaft_back_and_pushes_the_body(robot):
    """1 N each: momentum along its direction and about the centre, the shaft's by its lever."""
    values, covariance = robot.machine.model.values, contact_forces(robot.machine)
    lever_m = values["robot.wheel_radius_m"] / values["motor.gear_ratio"]
    shaft = -lever_m / values["motor.inertia_kg_m2"]
    np.testing.assert_allclose(covariance[:4, :4], shaft**2 * np.eye(4), rtol=1e-12)
    for wheel, degrees in enumerate(values["robot.wheel_angles_deg"]):
        along = np.exp(1j * np.deg2rad(degrees + 90.0)) / values["robot.mass_kg"]
        turned = values["robot.wheel_distance_m"] / values["robot.inertia_kg_m2"]
        np.testing.assert_allclose(
            covariance[wheel, 4:] / shaft, [along.real, along.imag, turned], atol=1e-12
        )
    assert np.linalg.matrix_rank(covariance) == 4


def test_forces_at_the_contacts_are_found_by_likelihood(robot):
    """Their deviation to a tenth; as likely independent ones are not."""
    machine = robot.machine
    make, _ = NOISES["robot"]
    logs = NOISES["robot"][1](robot.runs).low
    logs[3:6] = robot.noise.logs[3:6]
    logs[COLOUR_RATE], logs[CONTACT] = np.log(RATE_1_S), 0.0
    noise = make(machine, logs)
    recording, output = shaken_at_rest(machine, noise)
    run = replace(
        robot.runs[0],
        t_s=np.arange(ROWS) * ROW_S,
        command=np.zeros((ROWS, 4)),
        outputs=output,
        recording=recording,
    )
    tuned = tune_noise(machine, [run], machine.believed)
    assert np.exp(0.5 * tuned.logs[CONTACT]) == pytest.approx(1.0, rel=0.1)
    alone = replace(noise, coloured=np.diag(np.diagonal(noise.coloured)))
    likelihoods = [
        track_all(machine, [run], machine.believed, one)[0].log_likelihood for one in (noise, alone)
    ]
    assert likelihoods[0] > likelihoods[1] + 100.0


@pytest.mark.parametrize(
    ("corner_hz", "rate_1_s", "off"), [(1.6, 10.0, 0.2), (5.0, 31.0, 0.15), (10.0, 50.0, 0.1)]
)
def test_chance_fades_as_fast_as_it_does_where_a_model_is_judged(
    corner_hz, rate_1_s, off, monkeypatch
):
    """As fast as a filter sees that holds a disturbance for a row of 5 ms.

    Of what fades by 63 per s means of neighbouring rows fade by 41, (1 - e)^2 / (2 (x - 1 + e))
    with x = 63 * 5 ms and e = exp(-x), and others by 63. To choose a model the slowest one is taken
    for as fast as chance may be.
    """
    fading = partial(truth.coloured_noise, corner_hz=(corner_hz, corner_hz))
    monkeypatch.setattr(truth, "coloured_noise", fading)
    machine = Machine(read_model(NOMINAL_ROBOT))
    runs = runs_of(machine, TruthCase(3, runs=6, run_duration_s=4.0, base_offset_sd=0.0))
    chosen = tune_noise(machine, runs, machine.believed)
    judged = judging_noise(machine, runs, machine.believed, chosen)
    assert judged.colour_rate_1_s == pytest.approx(rate_1_s, rel=off)
    assert chosen.colour_rate_1_s == pytest.approx(max(rate_1_s, COLOUR_RATES_1_S[0]), rel=off)


def test_a_wrong_model_is_not_blamed_on_the_sensors():
    """A robot of twice the mass: its camera and gyro stay near the noise that they show.

    The generator's camera has 2.5 mm, its gyro 4 mrad/s at noise level 1.
    """
    model = read_model(NOMINAL_ROBOT)
    heavy = Machine(replace(model, values=model.values | {"robot.mass_kg": 40.0}))
    runs = runs_of(heavy, TruthCase(5, runs=2, run_duration_s=4.0, sensors=("gyro", "pose")))
    guess = NOISES["robot"][1](runs)
    found = tune_noise(heavy, runs, heavy.believed)
    sensors = [3, 4, 5]
    assert np.all(found.logs <= guess.high + 1e-12)
    assert np.all(found.logs >= guess.low - 1e-12)
    assert np.all(np.isfinite(guess.high[sensors]))
    # Second differences are those of the sensors, so the margin is one of their own noise.
    assert np.sqrt(found.output[5]) < 2.5e-3 * np.exp(SENSOR_MARGIN / 2) * 2.0


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"robot.mass_kg": 30.0},
        {"contact.mu_drive": 0.3},
        {"contact.slip_stiffness_s_m": 10.0},
    ],
)
def test_no_variance_of_a_fit_could_still_gain_much(wrong):
    """Also beside a wrong model: what rests on a bound does not hold the others back.

    Each logarithm moved by half within its bounds, others kept: the likelihood of the filter. (Not
    so beside every wrong model: with twice the mass the climb leaves the path that it is linear
    along, and ends 70 to 150 short.)
    """
    model = read_model(NOMINAL_ROBOT)
    machine = Machine(replace(model, values=model.values | wrong))
    case = TruthCase(5, runs=3, run_duration_s=4.0, sensors=("gyro", "pose"))
    runs = runs_of(machine, case)
    make, start_of = NOISES["robot"]
    guess = start_of(runs)
    found = tune_noise(machine, runs, machine.believed).logs

    def likelihood(logs):
        noise = make(machine, logs)
        tracks = track_all(machine, runs, machine.believed, noise)
        pull = PULL / 2 * np.sum((logs - guess.logs) ** 2)
        return sum(track.log_likelihood for track in tracks) - pull

    best = likelihood(found)
    for step in np.vstack([0.5 * np.eye(len(found)), -0.5 * np.eye(len(found))]):
        moved = np.clip(found + step, guess.low, guess.high)
        assert likelihood(moved) < best + 2 * CONVERGED


@pytest.mark.parametrize(("sensor", "output"), [("gyro", 4), ("pose", 5)])
def test_logs_without_a_sensor_do_not_say_how_noisy_it_is(sensor, output):
    """First and last of five: of those that are tuned by, most lack the sensor.

    One run of 5 s says less of it than three do.
    """
    machine = Machine(read_model(NOMINAL_ROBOT))
    case = TruthCase(5, runs=5, run_duration_s=5.0, sensors=("gyro", "pose"))
    both = runs_of(machine, case)
    fewer = runs_of(machine, replace(case, sensors=tuple({"gyro", "pose"} - {sensor})))
    mixed = [fewer[0], *both[1:4], fewer[4]]
    found = [tune_noise(machine, runs, machine.believed).output[output] for runs in (both, mixed)]
    assert 1 / 1.5 < np.sqrt(found[1] / found[0]) < 1.5


def test_a_model_that_runs_away_is_named_with_its_log(robot):
    """Friction that drives: its filter leaves the numbers within some rows."""
    known = {c.effect: c for c in robot.machine.candidates()}
    start = believed_hypothesis(robot.machine)
    runaway = start.with_effect(known["viscous_friction_error"], [-0.5])
    values = runaway.flat(robot.machine.believed)
    for follow in (
        lambda: Data(robot.machine, robot.runs, robot.noise, runaway),
        lambda: tune_noise(robot.machine, robot.runs, values),
    ):
        with pytest.raises(RunawayError, match=f"{robot.runs[0].name}: .* grows without bounds"):
            follow()
