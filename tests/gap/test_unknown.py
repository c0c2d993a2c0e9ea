"""What an unknown effect looks like: curves of known shape, and hidden terms of the generator."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from omnislip.gap import truth
from omnislip.gap.leftover import find_leftover, responses
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import make_run, unwrap_counts
from omnislip.gap.settle import believed_hypothesis, settle
from omnislip.gap.terms import Quantity, dictionary, swing_terms
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.unknown import Curve, describe_unknown, equations, propose
from omnislip.log_file import Log, read_log
from omnislip.model_file import NOMINAL_ROBOT, read_model
from truth_bench import logs_of


def hidden(tmp_path, name, parameters, wheel=None):
    """Believed model and eight short runs in which a term of no catalogue was hidden."""
    effect = {"name": name, "parameters": parameters}
    if wheel is not None:
        effect["wheel"] = wheel
    case = TruthCase(
        seed=77, effects=(effect,), run_duration_s=4.0, base_offset_sd=0.0, sensors=("gyro", "pose")
    )
    write_case(case, tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    runs = [
        make_run(machine, read_log(path, "robot")) for path in sorted(tmp_path.glob("run_*.csv"))
    ]
    return machine, runs


def begun_later(log, rows):
    """A log as if the recorder had been switched on some rows later."""
    later = {name: column[rows:] for name, column in log.columns.items()}
    return Log(log.name, log.t_s[rows:] - log.t_s[rows], later)


def described(machine, runs, terms=False):
    """What the description says beside the believed model, its keys refitted; by `terms`, too."""
    data, fitted = settle(machine, runs, believed_hypothesis(machine))
    leftover = []
    if terms:
        leftover = find_leftover(data, fitted, responses(data, fitted, dictionary(machine)))
    return describe_unknown(SimpleNamespace(data=data, final=fitted, leftover=leftover))


@pytest.mark.parametrize("shift_rows", [0, 31])
def test_beat_in_time_is_found_with_its_frequency_and_size(tmp_path, shift_rows):
    """0.2 N m |duty| sin(2 pi 7.3 Hz t) on every shaft; its phase is another in every log, or not.

    31 rows of 5 ms are 1.13 periods.
    """
    machine, _ = hidden(tmp_path, "pwm_beat", {"torque_nm": 0.2, "frequency_hz": 7.3})
    logs = [read_log(path, "robot") for path in sorted(tmp_path.glob("run_*.csv"))]
    runs = [make_run(machine, begun_later(log, k * shift_rows)) for k, log in enumerate(logs)]
    found = described(machine, runs)
    assert found.equation == "every wheel/torque"
    assert "7.3 Hz" in found.dependence
    assert "times the size of the command" in found.dependence
    assert np.max(found.y) == pytest.approx(0.2, rel=0.2)


def bumps_met(log):
    """Share of its process noise that the generator gives a robot in the mean of a log.

    v / (v + 0.1 m/s), of the speed of its wheels' places: at rest it meets no bumps.
    """
    shown = np.flatnonzero(~np.isnan(log.columns["pose/x_m"]))
    pose = np.stack([log.columns[f"pose/{name}"][shown] for name in ("x_m", "y_m", "theta_rad")])
    rate = (pose[:, 5:] - pose[:, :-5]) / (log.t_s[shown][5:] - log.t_s[shown][:-5])
    speed = np.hypot(rate[0], rate[1]) + 0.2 * np.abs(rate[2])
    return np.mean(speed / (speed + 0.1))


def test_a_load_that_beats_is_found_with_its_frequency_and_force(tmp_path, monkeypatch):
    """3 N sin(2 pi 2.6 Hz t) along the world's x; its phase is another in every log."""
    chance = truth.coloured_noise

    def beating(rng, rows):
        pushed = chance(rng, rows)
        phase = 2.0 * np.pi * (2.6e-3 * np.arange(rows) + rng.uniform())
        pushed[:, 0] += 3.0 * np.sin(phase)
        return pushed

    monkeypatch.setattr(truth, "coloured_noise", beating)
    machine, runs = hidden(tmp_path, "pwm_beat", {"torque_nm": 0.0, "frequency_hz": 7.3})
    logs = [read_log(path, "robot") for path in sorted(tmp_path.glob("run_*.csv"))]
    found = described(machine, runs)
    assert found.equation == "world/force_x"
    assert float(re.search(r"wave of ([0-9.]+) Hz", found.dependence)[1]) == pytest.approx(
        2.6, 0.01
    )
    force_n = 3.0 * np.mean([bumps_met(log) for log in logs])
    assert np.max(found.y) == pytest.approx(force_n, rel=0.2)


def test_drag_of_fast_wheels_is_a_curve_over_their_speed(tmp_path):
    """-0.2 N m (W / 300 rad/s)^5: the curve and the formula agree with it within the deviation."""
    machine, runs = hidden(tmp_path, "fifth_order_drag", {"torque_nm": 0.2})
    found = described(machine, runs)
    assert (found.equation, found.dependence) == ("every wheel/torque", "shaft speed")
    true = -0.2 * (found.x / 300.0) ** 5
    # What is linear in the speed belongs to the friction and back-EMF of the believed model.
    slope = np.linalg.lstsq(found.x[:, None], found.y - true, rcond=None)[0]
    assert np.all(np.abs(found.y - true - slope * found.x) < 4.0 * found.deviation)
    assert found.formula_share > 0.9


def test_a_tight_spot_names_its_wheel_and_the_wheel_angle(tmp_path):
    machine, runs = hidden(tmp_path, "tight_spot", {"torque_nm": 0.08}, wheel=3)
    found = described(machine, runs)
    assert (found.equation, found.dependence) == ("wheel/3/friction", "wheel angle")
    assert found.x[np.argmax(found.y)] == pytest.approx(np.pi / 2, abs=np.pi / 4)


def test_a_wheel_angle_of_each_log_is_described_with_its_size(tmp_path):
    """An encoder shows a + 0.02 sin(3 a / gear + phase) rad; counters start where they like."""
    case = TruthCase(seed=8, runs=4, run_duration_s=3.0, base_offset_sd=0.0)
    write_case(case, tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    name, per_rad = "wheel/2/encoder_counts", 2000 / (2 * np.pi)
    runs = []
    for k, path in enumerate(sorted(tmp_path.glob("run_*.csv"))):
        log = read_log(path, "robot")
        angle = unwrap_counts(log.columns[name]) / per_rad
        shown = angle + 0.02 * np.sin(3 * angle / 12 + 2.0 * k)
        counts = {name: np.round(per_rad * shown)}
        runs.append(make_run(machine, replace(log, columns=log.columns | counts)))
    found = described(machine, runs, terms=True)
    assert found.equation == "encoder/2/angle"
    assert found.dependence == "3 times the wheel angle"
    assert "phase of the run" in found.formula
    assert np.max(np.abs(found.y)) == pytest.approx(0.02, rel=0.1)


def test_a_load_that_swings_is_described_by_what_a_stop_sets_going():
    """6 kg on a spring at 1.2 Hz: a stop from 1 m/s pulls at the robot with up to m w."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    case = TruthCase(seed=8, runs=4, run_duration_s=3.0, base_offset_sd=0.0)
    runs = [make_run(machine, log) for log in logs_of(case)]
    data, fitted = settle(machine, runs, believed_hypothesis(machine))
    place, _ = responses(data, fitted, swing_terms("world/force", 1.2, 0.1)).T
    mass, *_ = machine.inertias(machine.believed)
    moved = replace(fitted, residual=fitted.residual + 6.0 / mass * place)
    leftover = find_leftover(data, moved, responses(data, moved, dictionary(machine)))
    found = describe_unknown(SimpleNamespace(data=data, final=moved, leftover=leftover))
    assert found.equation == "world/force"
    w, fades = 2 * np.pi * 1.2, np.exp(-0.1 * np.pi / 2)
    assert np.max(np.abs(found.y)) == pytest.approx(6.0 * w * fades, rel=0.15)
    spring = re.search(r"([\d.]+) y = -acceleration", found.formula)
    assert float(spring[1]) == pytest.approx(w**2, rel=0.15)


def test_a_lens_that_bends_is_described_with_its_size():
    """Places shown are (1 + 0.1 r^2) times as far; wheels within their tolerance take a part."""

    def bent(log):
        x, y = log.columns["pose/x_m"], log.columns["pose/y_m"]
        grown = 1.0 + 0.1 * (x**2 + y**2)
        return replace(log, columns=log.columns | {"pose/x_m": x * grown, "pose/y_m": y * grown})

    machine = Machine(read_model(NOMINAL_ROBOT))
    case = TruthCase(seed=8, runs=4, run_duration_s=3.0, base_offset_sd=0.0)
    runs = [make_run(machine, bent(log)) for log in logs_of(case)]
    found = described(machine, runs, terms=True)
    assert (found.equation, found.dependence) == ("camera", "distance from the middle")
    assert float(found.formula.split()[5]) == pytest.approx(0.1, rel=0.2)
    np.testing.assert_allclose(found.y, found.formula_y)


def test_nothing_is_described_where_nothing_is_missing(tmp_path):
    case = TruthCase(seed=5, run_duration_s=4.0, base_offset_sd=0.0, sensors=("gyro", "pose"))
    write_case(case, tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    runs = [
        make_run(machine, read_log(path, "robot")) for path in sorted(tmp_path.glob("run_*.csv"))
    ]
    assert described(machine, runs) is None


def tried_of(knots, sizes, deviation):
    quantity = Quantity("shaft speed", "rad/s", lambda x, d, t, i: x[:, i])
    equation = SimpleNamespace(symbol="torque", unit="N m")
    covariance = deviation**2 * np.eye(len(knots))
    return Curve("", equation, quantity, knots, sizes, covariance, 0.0, 0.0, 0.0, True)


@settings(deadline=None, max_examples=60)
@given(
    power=st.sampled_from([1, 3, 5]),
    size=st.floats(0.01, 10.0),
    sign=st.sampled_from([-1.0, 1.0]),
)
@example(power=1, size=2.125, sign=-1.0)
def test_formula_of_a_power_is_that_power(power, size, sign):
    """A curve that is one power of the quantity, sampled without error.

    Half of a last digit is rounded either way.
    """
    knots = np.linspace(-200.0, 200.0, 9)
    formula, share, values = propose(
        tried_of(knots, sign * size * (knots / 200.0) ** power, 1e-3 * size), "torque / (N m)"
    )
    shape = "u" if power == 1 else f"u^{power}"
    assert formula in {
        f"torque / (N m) = {sign * about:+.3g} {shape}, u = shaft speed / (200 rad/s)"
        for about in (size * (1.0 - 1e-9), size * (1.0 + 1e-9))
    }
    assert share == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(values, sign * size * (knots / 200.0) ** power, atol=1e-6 * size)


@settings(deadline=None, max_examples=20)
@given(place=st.floats(0.4, 0.8), width=st.floats(0.12, 0.2), size=st.sampled_from([-2.0, 0.1]))
def test_formula_of_what_acts_about_one_speed_is_a_bump_there(place, width, size):
    """The curve of a drag that a shaft has in one band of speeds, known to a 20th of its top."""
    knots = np.linspace(-300.0, 300.0, 9)
    speed = knots / 300.0
    curve = size * np.sign(speed) * np.exp(-(((np.abs(speed) - place) / width) ** 2))
    formula, share, _ = propose(tried_of(knots, curve, 0.05 * abs(size)), "torque / (N m)")
    found = re.search(r"sign\(u\) exp\(-\(\(\|u\| - ([\d.]+)\) / ([\d.]+)\)\^2\)", formula)
    assert found and float(found[1]) == pytest.approx(place, abs=0.15)
    assert share > 0.9


def test_forces_are_those_on_the_mass_and_inertias_of_the_model():
    """Believed 20 kg, 0.55 and 2.5e-5 kg m2; the model adds to each, to the third shaft alone."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    values = machine.believed.copy()
    values[machine.place("payload", "mass_kg", None)[0]] = 5.0
    values[machine.place("inertia_error", "inertia_kg_m2", None)[0]] = 0.2
    values[machine.place("motor_inertia_error", "inertia_kg_m2", 3)[0]] = 1.5e-5
    sizes = {one.name: one.size for one in equations(machine, values)}
    assert sizes["body/force_x"] == pytest.approx(25.0)
    assert sizes["body/moment"] == pytest.approx(0.75)
    assert sizes["wheel/3/torque"] == pytest.approx(4e-5)
    assert sizes["wheel/1/friction"] == pytest.approx(2.5e-5)


def test_every_equation_pushes_what_it_says():
    """A unit of a world force along y at heading 90 degrees pushes the body along its x."""
    machine = Machine(read_model(NOMINAL_ROBOT))
    state = np.zeros((1, 21))
    state[0, 13] = np.pi / 2
    world_y = next(e for e in equations(machine, machine.believed) if e.name == "world/force_y")
    push = world_y.push(state)
    np.testing.assert_allclose([push[8][0], push[9][0]], [1.0, 0.0], atol=1e-12)
