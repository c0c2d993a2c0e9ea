"""Where in the floor a patch of other grip lies."""

from dataclasses import replace

import numpy as np
import pytest
from axis_bench import silent
from omnislip.gap import find
from omnislip.gap.events import Impact
from omnislip.gap.inference import fit
from omnislip.gap.judge import LEAST_PROMISE
from omnislip.gap.leftover import responses
from omnislip.gap.machine import Machine
from omnislip.gap.refit import refit_each, settle_placed
from omnislip.gap.rivals import compare_all
from omnislip.gap.screen import screen
from omnislip.gap.search import Outcome
from omnislip.gap.selected import select_effects
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.terms import dictionary
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import HiddenEffect
from omnislip.model_file import Effect
from truth_bench import robot_runs

BAND = {"x_min_m": -0.15, "x_max_m": 0.4, "scale": 0.5}
SPILL = BAND | {"y_min_m": 0.05, "y_max_m": 0.25}


def on_a_floor(patch, tmp_path):
    """Return robot, logs and candidates of one that drove over a patch, as nobody believes."""
    effects = (HiddenEffect("slippery_patch", patch).as_dict(),) if patch else ()
    case = TruthCase(seed=8, effects=effects, excitation="rich", runs=3, run_duration_s=6.0)
    return robot_runs(case, tmp_path)


@pytest.mark.parametrize("patch", [BAND, SPILL])
def test_a_patch_has_the_edges_that_it_has_and_no_others(tmp_path, patch):
    """A spill that ends across x, too, and a strip of other floor that does not."""
    robot, runs, candidates = on_a_floor(patch, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    [fitted] = refit_each(data, current, screen(data, current, [candidates["slippery_patch"]]))
    data, found = settle(robot, runs, fitted.hypothesis, data.noise)
    _, found = settle_placed(data, found)
    [effect] = found.hypothesis.effects
    values = dict(
        zip((p.label for p in effect.parameters), found.hypothesis.values_of(0), strict=True)
    )
    assert set(values) == set(patch)
    assert values.pop("scale") == pytest.approx(0.5, abs=0.02)
    assert values == pytest.approx({k: v for k, v in patch.items() if k != "scale"}, abs=0.004)


def test_edges_across_that_explain_nothing_are_taken_away(tmp_path):
    """A strip of other floor is no spill as wide as anybody drove."""
    robot, runs, candidates = on_a_floor(BAND, tmp_path)
    spill = candidates["slippery_patch"]
    ends_m = [spill.edges_m[2][0], spill.edges_m[2][-1]]
    start = believed_hypothesis(robot).with_effect(spill, [-0.15, 0.4, *ends_m, 0.5])
    data, wide = settle(robot, runs, start)
    _, found = settle_placed(data, wide)
    assert [p.label for p in found.hypothesis.effects[0].parameters] == [
        "x_min_m",
        "x_max_m",
        "scale",
    ]
    assert found.objective == pytest.approx(wide.objective, abs=1.0)


def test_what_little_less_grip_changes_is_the_sum_of_what_its_cells_do(tmp_path):
    """For the body is in one of them at a time: the screen rests on it."""
    robot, runs, candidates = on_a_floor({}, tmp_path)
    data, current = settle(robot, runs, believed_hypothesis(robot))
    assert not data.answers  # what could be foreseen in a closed loop is no sum
    patch = candidates["slippery_patch"]

    def change(edges):
        model = current.hypothesis.with_effect(patch, [*edges, 0.97])
        return data.residuals(model.flat(data.believed)[None])[0] - current.residual

    cells = [list(start.values()) for start in patch.starts]
    low_m, high_m = np.min(cells, axis=0), np.max(cells, axis=0)
    everywhere = change([low_m[0], high_m[1], low_m[2], high_m[3]])
    parts = np.sum([change(cell) for cell in cells], axis=0)
    assert np.linalg.norm(everywhere) > 30.0
    assert np.linalg.norm(parts - everywhere) < 0.1 * np.linalg.norm(everywhere)


def test_a_patch_that_the_file_has_is_not_offered_once_more(tmp_path):
    """Its cells are compared with a floor without it."""
    robot, runs, _ = on_a_floor(SPILL, tmp_path)
    known = Machine(replace(robot.model, effects=[Effect("slippery_patch", SPILL)]))
    data, current = settle(known, runs, believed_hypothesis(known))
    [screened] = screen(data, current, known.floor_candidates(runs))
    assert screened.promise < LEAST_PROMISE
    assert fit(data, current.hypothesis).objective == pytest.approx(current.objective, abs=0.1)


def test_a_push_that_a_wider_patch_does_without_is_none(tmp_path, monkeypatch):
    """What nobody drove over leaves an edge open, and beyond it a patch does what a push would."""
    robot, runs, candidates = on_a_floor(BAND, tmp_path)
    start = believed_hypothesis(robot)
    start = start.with_effect(candidates["slippery_patch"].along_x(), [-0.15, 0.4, 0.5])
    data, final = settle(robot, runs, start)
    free = responses(data, final, dictionary(robot))
    selected = select_effects(data, final, free, compare_all(data, final, {}, silent))
    outcome = Outcome(final, final, (final,), selected, (), (), data, {})
    low_m, high_m, _ = selected[0].interval
    scale = final.hypothesis.values_of(0)[2]
    assert outcome.widest.values_of(0).tolist() == [low_m[0], high_m[1], scale]

    push, feigned = (Impact("run_01", at_s, np.ones(3), np.zeros(3)) for at_s in (1.0, 2.5))
    found = {low_m[0]: [push]}

    def pushes_in(_machine, _logs, _runs, model, _noise, _known):
        return found.get(model.values_of(0)[0], [push, feigned])

    monkeypatch.setattr(find, "_pushes_in", pushes_in)
    assert find._pushes_by(robot, [], runs, outcome, []) == [push]
    bare = replace(outcome, selected=())
    assert find._pushes_by(robot, [], runs, bare, []) == [push, feigned]
