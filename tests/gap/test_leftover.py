"""What is left though no effect explains it: a term of the dictionary says where."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from omnislip.gap.inference import Data, fit
from omnislip.gap.leftover import (
    MOVES,
    PLACED,
    _placed,
    find_leftover,
    responses,
    shapes_instead,
)
from omnislip.gap.machine import Machine
from omnislip.gap.noise import first_guess, track_all, tune_noise
from omnislip.gap.recordings import make_run, unwrap_counts
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.terms import BODY_SHAPES, Term, dictionary, nameless, swing_terms
from omnislip.gap.truth import TruthCase
from omnislip.gap.truth_effects import typical_effect
from omnislip.log_file import POSE_COLUMNS
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import logs_of

MACHINE = Machine(read_model(NOMINAL_ROBOT))


@pytest.fixture(scope="module")
def logs():
    return logs_of(TruthCase(seed=8, runs=4, run_duration_s=3.0, base_offset_sd=0.0))


def model_of(logs):
    """Data and the fitted believed model."""
    runs = [make_run(MACHINE, log) for log in logs]
    start = believed_hypothesis(MACHINE)
    data = Data(MACHINE, runs, tune_noise(MACHINE, runs, MACHINE.believed), start)
    return data, fit(data, start)


@pytest.fixture(scope="module")
def model(logs):
    return model_of(logs)


def left_of(data, fitted):
    return find_leftover(data, fitted, responses(data, fitted, dictionary(MACHINE)))


def left_in(logs):
    return left_of(*model_of(logs))


@pytest.mark.parametrize("equation", ["body/force_x", "body/force_y", "body/moment"])
def test_what_pushes_where_nothing_drives_a_robot_is_no_law(logs, equation):
    """One push that lasts, of chance, goes with the motion that it makes."""
    data, fitted = model_of(logs)
    state = {"body/force_x": 8, "body/force_y": 9, "body/moment": 10}[equation]
    term = next(t for t in dictionary(MACHINE) if t.name == (equation, "constant"))
    assert term.states == (state,)
    fitted = replace(fitted, residual=fitted.residual - 5.0 * responses(data, fitted, [term])[:, 0])
    assert (equation, "constant") in [(o.equation, o.dependence) for o in left_of(data, fitted)]
    data.driven = tuple(equation != own for own in MOVES)
    assert equation not in {one.equation for one in left_of(data, fitted)}


def rippling(log, wheel, order, phase_rad=0.0):
    """An encoder that shows a + 0.02 sin(order a + phase) rad."""
    name, per_rad = f"wheel/{wheel}/encoder_counts", 2000 / (2 * np.pi)
    counts = unwrap_counts(log.columns[name])
    shown = np.round(counts + 0.02 * per_rad * np.sin(order * counts / per_rad + phase_rad))
    return replace(log, columns=log.columns | {name: shown})


def test_nothing_is_left_where_nothing_is_missing(logs):
    assert left_in(logs) == []


def test_what_a_sensor_shows_goes_with_a_state_that_does_not_hold_its_noise(logs):
    """A gyro that shows 0.3 rad/s too much in a row moves the state, not the turn it shows."""
    start, told = believed_hypothesis(MACHINE), []
    [row, *_] = np.flatnonzero(np.isfinite(logs[0].columns["gyro/z_rad_s"][300:])) + 300
    for more_rad_s in (0.0, 0.3):
        shown = logs[0].columns["gyro/z_rad_s"].copy()
        shown[row] += more_rad_s
        log = replace(logs[0], columns=logs[0].columns | {"gyro/z_rad_s": shown})
        run = make_run(MACHINE, log)
        noise = first_guess(MACHINE, [run])

        def pushes(_, run, state, seen):
            own = run.log_rows[row]
            told.append((state[own], seen[own]))
            return np.zeros((*state.shape, 1)), np.zeros((*run.outputs.shape, 1))

        tracks = track_all(MACHINE, [run], MACHINE.believed, noise, keep_linear=True)
        Data(MACHINE, [run], noise, start).responses(tracks, pushes)
    (state, seen), (moved, unmoved) = told
    np.testing.assert_allclose(unmoved, seen, rtol=1e-9, atol=1e-12)
    assert moved[10] - state[10] > 0.01


@pytest.mark.parametrize("places", [1, 2])
def test_one_incident_is_no_law_but_two_are(model, places):
    """Half a second in which the term does thirty times as much, and else a gain of 10."""
    data, fitted = model
    terms = dictionary(MACHINE)
    name = ("every wheel/torque", "speed to the fifth")
    own = [term.name for term in terms].index(name)
    free = responses(data, fitted, terms)
    column = free[:, own] * np.sqrt(10.0) / np.linalg.norm(free[:, own])
    for block in (data.blocks.max() // 3, data.blocks.max())[:places]:
        column[data.blocks == block] *= 30.0
    free[:, own] = column
    moved = replace(fitted, residual=fitted.residual + column)
    found = [(one.equation, one.dependence) for one in find_leftover(data, moved, free)]
    assert (name in found) == (places > 1)


@pytest.mark.parametrize(("wheel", "order", "angle"), [(3, 2, "twice the"), (2, 1, "the")])
def test_one_encoder_that_ripples_is_named(logs, wheel, order, angle):
    found = left_in([rippling(log, wheel, order) for log in logs])
    assert found[0].equation == f"encoder/{wheel}/angle"
    assert found[0].dependence == f"sine of {angle} shaft angle"


def test_a_wheel_whose_angle_no_log_begins_at_is_named(logs):
    """Counters start at zero wherever the wheel stands: each log has a phase of its own."""
    phases = np.arange(len(logs)) * 2.0
    shown = [rippling(log, 2, 3 / 12, phase) for log, phase in zip(logs, phases, strict=True)]
    found = left_in(shown)[0]
    assert found.equation == "encoder/2/angle"
    assert found.dependence == "3 times the wheel angle, with a phase of each run's own"
    assert found.validation_gain > 100.0


def test_a_floor_of_waves_is_named_with_their_length():
    waves = {"amplitude_m_s2": 0.3, "length_m": 0.45}
    effect = {"name": "sine_floor", "parameters": waves}
    case = TruthCase(seed=8, runs=4, run_duration_s=4.0, base_offset_sd=0.0, effects=(effect,))
    found = left_in(logs_of(case))
    words = {one.equation: one.dependence.split() for one in found if "a wave" in one.dependence}
    assert float(words["world/force_x"][3]) == pytest.approx(0.45, rel=0.1)
    assert int(words["world/force_x"][-2]) == pytest.approx(0, abs=15)
    assert abs(int(words["world/force_y"][-2])) == pytest.approx(90, abs=15)


@pytest.mark.parametrize(
    ("kind", "swing_hz", "size"),
    [("world/force", 1.2, 0.3), ("world/force", 3.3, 0.3), ("camera", 7.5, 0.5 / 47.0**2)],
)
def test_a_load_or_marker_that_swings_is_named_with_its_frequency(model, kind, swing_hz, size):
    """The residuals are moved by what 0.3 of the robot's mass on a spring would do to them.

    Or by half of what a marker moves on the robot.
    """
    data, fitted = model
    free = responses(data, fitted, swing_terms(kind, swing_hz, 0.05))
    moved = replace(fitted, residual=fitted.residual + size * free.sum(axis=1))
    found = left_of(data, moved)[0]
    assert found.equation == kind
    shown = re.search(r"swings at ([\d.]+) Hz", found.dependence)
    assert float(shown[1]) == pytest.approx(swing_hz, rel=0.1)


def test_rollers_that_turn_badly_at_a_place_of_the_wheel_are_named(model):
    """The residuals are moved by what 0.5 m/s2 at most would do to them."""
    name = ("wheel/3/roller friction", "sine of the wheel angle")
    term = next(one for one in nameless(MACHINE) if one.name == name)
    data, fitted = model
    [column] = responses(data, fitted, [term]).T
    moved = replace(fitted, residual=fitted.residual + 0.5 * column)
    found = left_of(data, moved)[0]
    assert (found.equation, found.dependence) == name


def test_what_sets_in_beyond_a_threshold_is_named_though_that_is_not_known(model):
    """The residuals are moved by what a governor on wheel 2 would do above 85 % of all speeds."""
    data, fitted = model
    speeds = np.concatenate([np.abs(np.diff(r.outputs[:, 1]) / np.diff(r.t_s)) for r in data.runs])
    least = np.nanpercentile(speeds, 85)

    def governed(x, d, t, i):
        return -np.sign(x[:, i]) * np.maximum(np.abs(x[:, i]) - least, 0.0)

    [column] = responses(data, fitted, [Term("wheel/2/torque", "governor", (1,), governed)]).T
    moved = replace(fitted, residual=fitted.residual + 25.0 / np.linalg.norm(column) * column)
    found = left_of(data, moved)[0]
    assert found.equation == "wheel/2/torque"
    assert "speed beyond" in found.dependence


@pytest.mark.parametrize(
    ("equation", "state", "dependence", "of"),
    [
        ("body/moment", 10, "speed along x and y", lambda vx, vy, w: vx * vy),
        ("body/moment", 10, "speed along y squared, against it", lambda vx, vy, w: vy * abs(vy)),
        ("body/moment", 10, "yaw rate and speed along x", lambda vx, vy, w: w * vx),
        ("body/force_x", 8, "speed across squared", lambda vx, vy, w: vy**2),
        ("body/force_y", 9, "yaw rate and own speed", lambda vx, vy, w: w * vy),
    ],
)
def test_forces_by_products_of_the_body_s_speeds_are_named(model, equation, state, dependence, of):
    """The residuals are moved by 25 standard deviations of what each would do to them."""
    data, fitted = model
    hidden = Term(equation, "hidden", (state,), lambda x, d, t, i: of(*x[:, 8:11].T))
    [column] = responses(data, fitted, [hidden]).T
    moved = replace(fitted, residual=fitted.residual + 25.0 / np.linalg.norm(column) * column)
    found = left_of(data, moved)[0]
    assert (found.equation, found.dependence) == (equation, dependence)


@settings(max_examples=20, deadline=None)
@given(
    st.sampled_from(["hill", "pull"]),
    st.floats(-0.6, 0.6),
    st.floats(-0.6, 0.6),
    st.floats(0.12, 0.3),
    st.sampled_from([1.0, -1.0]),
)
@example("hill", -0.4, 0.2, 0.65, -1.0)
@example("hill", 0.1, -0.3, 0.55, 1.0)
def test_a_force_about_a_place_is_found_where_that_is(of, x_m, y_m, width_m, sign):
    """Four runs over 2 m x 2 m; the forces of 1 m/s2 at most have noise of a third."""
    generator = np.random.default_rng(0)
    true = PLACED[of].term(np.array([x_m, y_m]), width_m)
    places, forces = [], []
    for _ in range(4):
        steps = generator.normal(0.0, 0.1, (600, 2))
        place = np.clip(np.cumsum(steps, axis=0), -1.0, 1.0)
        state = np.zeros((600, 14))
        state[:, 11:13] = place
        pushed = np.stack([true.shape(state, None, None, axis) for axis in (8, 9)], axis=1)
        places.append(place)
        forces.append(sign * pushed / np.abs(pushed).max() + generator.normal(0.0, 0.33, (600, 2)))
    [found], tried = _placed(places, [force - force.mean(axis=0) for force in forces], PLACED[of])
    numbers = [float(n) for n in re.findall(r"-?\d+\.\d+", found.dependence)]
    expected = [x_m, y_m, width_m] if of == "hill" else [x_m, y_m]
    np.testing.assert_allclose(numbers, expected, atol=0.1)
    assert tried > 500


def test_a_load_on_a_spring_that_was_struck_rings_down():
    """y'' + 2 z w y' + w^2 y = 0 after a step of 1 m/s: y' = -1 then, in closed form."""
    swing_hz, damping = 2.0, 0.1
    t_s = np.arange(0.0, 2.0, 0.005)
    state = np.zeros((len(t_s), 14))
    state[1:, 10] = 1.0
    place, speed = (
        term.shape(state, None, t_s, 10)[1:]
        for term in swing_terms("body/moment", swing_hz, damping)
    )
    w, since_s = 2 * np.pi * swing_hz, t_s[1:] - 0.0025
    ringing = w * np.sqrt(1.0 - damping**2)
    fading = np.exp(-damping * w * since_s)
    sine, cosine = np.sin(ringing * since_s), np.cos(ringing * since_s)
    np.testing.assert_allclose(place, -(w**2) / ringing * fading * sine, atol=0.03 * w)
    exact = -w * fading * (cosine - damping * w / ringing * sine)
    np.testing.assert_allclose(speed, exact, atol=0.03 * w)


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


def camera_that_errs(log, error):
    """A log whose camera shows x, y and heading besides what it sees there."""
    shown = [log.columns[f"pose/{name}"] for name in ("x_m", "y_m", "theta_rad")]
    moved = [own + off for own, off in zip(shown, error(log.t_s, *shown), strict=True)]
    return replace(log, columns=log.columns | dict(zip(POSE_COLUMNS, moved, strict=True)))


def late_row(t_s, x_m, y_m, heading_rad):
    """A pose 20 ms later for every metre that its row is down: v 0.02 x."""
    seen = ~np.isnan(x_m)
    off = np.full((3, len(t_s)), np.nan)
    for k, own in enumerate((x_m, y_m)):
        off[k, seen] = 0.02 * x_m[seen] * np.gradient(own[seen], t_s[seen])
    return off[0], off[1], 0.0


def other_camera(t_s, x_m, y_m, heading_rad):
    """5 mm to the left beyond the middle of the way."""
    return 0.0, 0.005 * (x_m > np.nanmedian(x_m)), 0.0


@pytest.mark.parametrize(
    ("error", "equation", "dependence"),
    [
        (lambda t, x, y, a: (0.0, 0.0, 0.02 * np.sin(2 * a)), "camera/heading", "2 times the head"),
        (lambda t, x, y, a: (0.0, 0.0, 0.02 * x), "camera/heading", "place x"),
        (late_row, "camera", "velocity at place x"),
        (other_camera, "camera/y", "side of x = "),
        (lambda t, x, y, a: (0.0, 0.03 * t, 0.0), "camera", "time, along y"),
        (lambda t, x, y, a: (0.0, 0.0, 0.03 * t), "camera/heading", "time"),
    ],
)
def test_a_camera_that_errs_is_named_with_what_its_error_depends_on(
    logs, error, equation, dependence
):
    found = left_in([camera_that_errs(log, error) for log in logs])[0]
    assert found.equation == equation
    assert dependence in found.dependence


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


@pytest.mark.parametrize("holds_commands", [False, True])
def test_what_commands_that_move_within_rows_feign_is_asked_of_those_that_do_not(holds_commands):
    machine = MACHINE.of(MACHINE.model, holds_commands=holds_commands)
    dependences = {term.dependence for term in nameless(machine)}
    assert ("change of the command, by its size" in dependences) == holds_commands


def test_terms_have_names_of_their_own():
    terms = [*dictionary(MACHINE), *nameless(MACHINE)]
    names = [(term.equation, term.dependence) for term in terms]
    assert len(set(names)) == len(names)


def test_a_speed_slows_where_its_size_falls_in_either_direction():
    t_s = np.arange(0.0, 6.0, 0.005)
    state = np.zeros((len(t_s), 14))
    state[:, 8] = np.sin(2.0 * t_s)
    found = BODY_SHAPES["own speed while it slows"](state, np.zeros((len(t_s), 4)), t_s, 8)
    before_s = t_s - 0.05  # what chance does since then slows it, too
    slows = np.sin(4.0 * before_s) < 0.0
    turns = np.abs(np.sin(4.0 * before_s)) < 0.15  # the mean over some rows ends it a little late
    turns |= before_s < 0.0
    np.testing.assert_array_equal(found[~turns], (state[:, 8] * slows)[~turns])
