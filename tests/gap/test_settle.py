"""Noise and model fitted in turn: where a fit loses the robot by its own filter."""

from dataclasses import replace

import pytest
from axis_bench import Bench, make_machine, make_runs
from omnislip.gap import settle as settle_module
from omnislip.gap.noise import track_all
from omnislip.gap.settle import LOST_PER_ROW, believed_hypothesis, settle

FRICTION_N = 2.0
ASTRAY_N = -20.0
"""A friction that drives: by its filter each row is less likely by 13."""


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    return make_machine(tmp_path_factory.mktemp("axis"))


@pytest.fixture(scope="module")
def runs(machine):
    return make_runs(machine, Bench(coulomb_n=FRICTION_N), range(2))


@pytest.fixture
def start(machine):
    [friction] = [c for c in machine.candidates() if c.effect == "coulomb_friction"]
    return believed_hypothesis(machine).with_effect(friction, [0.1])


def fits_that_end_at(monkeypatch, sizes_n):
    """Let the first fits end at these sizes, the others where they do; return all."""
    fit, ended = settle_module.fit, []

    def astray(data, hypothesis, last=None):
        fitted = fit(data, hypothesis, last=last)
        if len(ended) < len(sizes_n):
            x = fitted.hypothesis.x.copy()
            x[-1] = sizes_n[len(ended)]
            fitted = replace(fitted, hypothesis=replace(fitted.hypothesis, x=x))
        ended.append(fitted)
        return fitted

    monkeypatch.setattr(settle_module, "fit", astray)
    return ended


def likelihood(machine, runs, data, hypothesis):
    values = hypothesis.flat(machine.believed)
    return sum(track.log_likelihood for track in track_all(machine, runs, values, data.noise))


def test_a_fit_whose_own_filter_loses_the_robot_gives_way_to_the_one_before(
    machine, runs, start, monkeypatch
):
    ended = fits_that_end_at(monkeypatch, [1.5, ASTRAY_N])
    data, fitted = settle(machine, runs, start)
    assert len(ended) == 2
    assert fitted is ended[0]
    rows = sum(len(run.t_s) for run in runs)
    here, lost = (likelihood(machine, runs, data, one.hypothesis) for one in ended)
    assert here - lost > LOST_PER_ROW * rows


def test_a_fit_that_is_less_likely_and_follows_goes_on(machine, runs, start, monkeypatch):
    ended = fits_that_end_at(monkeypatch, [1.9, 1.5])
    _, fitted = settle(machine, runs, start)
    assert len(ended) > 2
    assert fitted.hypothesis.values_of(0) == pytest.approx([FRICTION_N], rel=0.02)


def test_a_first_fit_that_is_lost_has_none_to_give_way_to(machine, runs, start, monkeypatch):
    """The next ones lead back from there."""
    ended = fits_that_end_at(monkeypatch, [ASTRAY_N])
    _, fitted = settle(machine, runs, start)
    assert len(ended) > 1
    assert fitted.hypothesis.values_of(0) == pytest.approx([FRICTION_N], rel=0.02)
