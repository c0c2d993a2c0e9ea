"""What is left though no effect explains it: a term of the dictionary says where."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.gap.inference import Data, fit
from omnislip.gap.leftover import (
    BODY_SHAPES,
    dictionary,
    find_leftover,
    responses,
    shapes_instead,
)
from omnislip.gap.machine import Machine
from omnislip.gap.noise import tune_noise
from omnislip.gap.recordings import make_run, unwrap_counts
from omnislip.gap.search import believed_hypothesis, settle
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import typical_effect
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import logs_of

MACHINE = Machine(read_model(NOMINAL_ROBOT))


@pytest.fixture(scope="module")
def logs():
    return logs_of(TruthCase(seed=8, runs=4, run_duration_s=3.0, base_offset_sd=0.0))


def left_in(logs):
    runs = [make_run(MACHINE, log) for log in logs]
    start = believed_hypothesis(MACHINE)
    data = Data(MACHINE, runs, tune_noise(MACHINE, runs, MACHINE.believed), start)
    fitted = fit(data, start)
    return find_leftover(data, fitted, responses(data, fitted, dictionary(MACHINE)))


def rippling(log, wheel, order):
    """An encoder that shows a + 0.02 sin(order a) rad."""
    name, per_rad = f"wheel/{wheel}/encoder_counts", 2000 / (2 * np.pi)
    counts = unwrap_counts(log.columns[name])
    shown = np.round(counts + 0.02 * per_rad * np.sin(order * counts / per_rad))
    return replace(log, columns=log.columns | {name: shown})


def test_nothing_is_left_where_nothing_is_missing(logs):
    assert left_in(logs) == []


@pytest.mark.parametrize(("wheel", "order", "angle"), [(3, 2, "twice the"), (2, 1, "the")])
def test_one_encoder_that_ripples_is_named(logs, wheel, order, angle):
    found = left_in([rippling(log, wheel, order) for log in logs])
    assert found[0].equation == f"encoder/{wheel}/angle"
    assert found[0].dependence == f"sine of {angle} shaft angle"


@pytest.mark.parametrize(
    ("dependence", "bend"),
    [
        ("distance from the middle", lambda x, y: 1.0 + 0.2 * (x**2 + y**2)),
        ("place y", lambda x, y: 1.0 + 0.1 * y),
    ],
)
def test_a_camera_that_bends_the_place_is_named(logs, dependence, bend):
    def shown(log):
        x, y = log.columns["pose/x_m"], log.columns["pose/y_m"]
        bent = {"pose/x_m": x * bend(x, y), "pose/y_m": y * bend(x, y)}
        return replace(log, columns=log.columns | bent)

    found = left_in([shown(log) for log in logs])
    assert (found[0].equation, found[0].dependence) == ("camera", dependence)


@pytest.mark.parametrize(
    ("ahead_m", "left_m", "side"), [(0.02, 0, "ahead of"), (0, 0.02, "beside")]
)
def test_a_marker_off_the_centre_is_named(logs, ahead_m, left_m, side):
    def shown(log):
        x, y, heading = (log.columns[f"pose/{name}"] for name in ("x_m", "y_m", "theta_rad"))
        cos, sin = np.cos(heading), np.sin(heading)
        moved = {
            "pose/x_m": x + ahead_m * cos - left_m * sin,
            "pose/y_m": y + ahead_m * sin + left_m * cos,
        }
        return replace(log, columns=log.columns | moved)

    found = left_in([shown(log) for log in logs])
    dependence = f"heading, as of a marker {side} the centre"
    assert (found[0].equation, found[0].dependence) == ("camera", dependence)


@pytest.mark.parametrize("hidden", ["quadratic_wheel_drag", "fifth_order_drag"])
def test_a_nameless_term_explains_more_than_a_name_of_another_shape(hidden):
    """Two drags that both grow with speed; only one of them is quadratic."""
    effect = typical_effect(hidden).as_dict()
    case = TruthCase(seed=8, runs=4, run_duration_s=4.0, base_offset_sd=0.0, effects=(effect,))
    runs = [make_run(MACHINE, log) for log in logs_of(case)]
    [drag] = [c for c in MACHINE.candidates() if c.effect == "quadratic_wheel_drag"]
    start = believed_hypothesis(MACHINE).with_effect(drag, [drag.parameters[0].scale])
    data, final = settle(MACHINE, runs, start)
    without = final.refitted_without(data, 0)
    free = responses(data, final, dictionary(MACHINE))
    [shape] = shapes_instead(data, final, free, [without])
    share = shape.gain / (without.objective - final.objective)
    if hidden == "fifth_order_drag":
        assert (shape.equation, shape.dependence) == ("every wheel/torque", "speed to the fifth")
        assert share > 1.1
    else:
        assert shape.dependence == "speed squared, against it"
        assert share == pytest.approx(1.0, abs=0.05)


def test_terms_have_names_of_their_own():
    names = [(term.equation, term.dependence) for term in dictionary(MACHINE)]
    assert len(set(names)) == len(names)


def test_a_speed_slows_where_its_size_falls_in_either_direction():
    t_s = np.arange(0.0, 6.0, 0.005)
    state = np.zeros((len(t_s), 14))
    state[:, 8] = np.sin(2.0 * t_s)
    found = BODY_SHAPES["own speed while it slows"](state, np.zeros((len(t_s), 4)), t_s, 8)
    slows = state[:, 8] * np.cos(2.0 * t_s) < 0.0
    turns = np.abs(np.sin(4.0 * t_s)) < 0.15  # the mean over some rows ends it a little late
    np.testing.assert_array_equal(found[~turns], (state[:, 8] * slows)[~turns])
