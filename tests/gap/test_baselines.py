"""The methods that the workflow is compared with find what they can on a case that is easy."""

from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap import baselines
from omnislip.gap.baselines import Accelerations, Library, ask_baselines, replay_errors
from omnislip.gap.inference import DIVERGED, fit
from omnislip.gap.machine import Machine
from omnislip.gap.noise import first_guess
from omnislip.gap.recordings import make_run
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.split import split_runs
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.log_file import read_log
from omnislip.model_file import read_model

pytest.importorskip("pysindy")


def given(folder, *effects):
    """Machine, split, the believed model and a noise: five short runs of a well-known robot."""
    hidden = tuple(effect.as_dict() for effect in effects)
    case = TruthCase(seed=5, effects=hidden, runs=5, run_duration_s=3.0, base_offset_sd=0.001)
    write_case(case, folder)
    machine = Machine(read_model(folder / "robot.toml"))
    logs = [read_log(path, "robot") for path in sorted(folder.glob("run_*.csv"))]
    noise = first_guess(machine, [make_run(machine, log) for log in logs])
    return machine, split_runs(machine, logs), believed_hypothesis(machine), noise


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    return given(tmp_path_factory.mktemp("heavy"), HiddenEffect("payload", {"mass_kg": 4.0}))


@pytest.fixture(scope="module")
def answers(heavy):
    return ask_baselines(*heavy)


def test_every_method_that_names_says_first_that_the_robot_is_heavy(answers):
    assert {name: answer.named[:1] for name, answer in answers.items()} == {
        "base refit": (),
        "BIC": (("payload", None),),
        "SINDy": (("payload", None),),
        "ridge": (("payload", None),),
    }


def test_their_models_replay_runs_that_were_not_fitted_better(heavy, answers):
    machine, split, refit, noise = heavy
    values = [refit.flat(machine.believed), *(a.values for a in answers.values())]
    before, *after = replay_errors(machine, split.held_out, noise, values)
    assert all(error < 0.7 * before for error in after)


def test_a_model_that_diverges_is_as_far_off_as_can_be(heavy):
    machine, split, refit, noise = heavy
    values = refit.flat(machine.believed)
    broken = np.full_like(values, np.nan)
    errors = replay_errors(machine, split.held_out, noise, [values, values, broken])
    assert errors[0] < DIVERGED and errors[2] == DIVERGED


def test_terms_of_accelerations_are_those_of_forces(heavy):
    machine, split, refit, noise = heavy
    data = Accelerations(machine, split.fitting, noise, refit)
    library = Library(data, fit(data, refit, iterations=0))
    np.testing.assert_allclose(np.mean(library.columns**2, axis=0), 1.0)
    named = {library.effects[k].candidate.name for k in library.owner}
    assert {"payload", "coulomb_friction", "weak_motor (wheel 2)"} <= named
    assert not {"gyro_bias", "pose_rotation", "shaft_compliance"} & named


def test_errors_that_last_count_for_fewer(heavy):
    data = SimpleNamespace(machine=heavy[0])
    rows = np.random.default_rng(0).standard_normal((5000, heavy[0].engine.outputs))
    lasting = np.repeat(rows[:500], 10, axis=0)
    white = baselines._independent(data, rows.ravel())
    assert white == pytest.approx(rows.size, rel=0.05)
    # correlation 0.9 from row to row
    assert baselines._independent(data, lasting.ravel()) == pytest.approx(white / 19, rel=0.2)
    lasting[::2, 5:] = 0.0  # a slower sensor, never in two rows that follow
    fewer = baselines._independent(data, lasting.ravel())
    assert fewer == pytest.approx(np.count_nonzero(lasting) / 19, rel=0.2)
