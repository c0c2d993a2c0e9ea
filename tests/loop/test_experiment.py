"""The paper's experiment in closed loop: a sideways blow at 1.5 m/s, without and with slip model.

A blow of J gives the robot J / m. No controller stops it sooner than its friction allows: four
drives at most 4 mu N cos 30, four rollers at most 4 mu_r N sin 30, so

    peak |y| >= (J / m)^2 / (2 a),   a = g (mu cos 30 + mu_r sin 30)
"""

import numpy as np
import pytest
from loop_run import MODEL, VALUES
from omnislip.paper import Case, case_scenario, measure
from omnislip.simulate import run_scenario, simulate_truth

PLACES_X_M = {"a": 2.35, "b": 1.85}
REFERENCE_N_S = 10.0
SLIDING_M_S2 = VALUES["contact.gravity_m_s2"] * (
    VALUES["contact.mu_drive"] * np.cos(np.pi / 6) + VALUES["contact.mu_roller"] * 0.5
)


def outcome(controller, x_m, impulse_n_s=REFERENCE_N_S):
    case = Case(controller, x_m, impulse_n_s)
    return measure(case, simulate_truth(case_scenario(case, MODEL)))


def least_peak_m(impulse_n_s):
    return (impulse_n_s / VALUES["robot.mass_kg"]) ** 2 / (2 * SLIDING_M_S2)


def test_the_papers_two_runs():
    """(a) without slip, hit at 2350 mm; (b) with slip model, hit at 1850 mm.

    The paper gives no figures. Ours is a factor of four; one of 50 would mean that the firmware
    knows to under half a millimetre how far wheels slid whose slip it cannot see.
    """
    a, b = outcome("plain", PLACES_X_M["a"]), outcome("slip", PLACES_X_M["b"])
    assert 3 < a.remaining_y_m / b.remaining_y_m < 50
    assert 1 < a.peak_y_m / b.peak_y_m < 1.2


@pytest.mark.parametrize("place", PLACES_X_M)
@pytest.mark.parametrize("impulse_n_s", [2.0, 4.0, 6.0])
def test_a_blow_that_does_not_saturate_the_wheels_leaves_a_third(place, impulse_n_s):
    plain, slip = (outcome(name, PLACES_X_M[place], impulse_n_s) for name in ("plain", "slip"))
    assert 3 < plain.remaining_y_m / slip.remaining_y_m < 50


@pytest.mark.parametrize("place", PLACES_X_M)
@pytest.mark.parametrize("impulse_n_s", [4.0, 6.0, 10.0, 14.0, 18.0])
def test_same_blow_leaves_less_with_the_slip_model(place, impulse_n_s):
    plain, slip = (outcome(name, PLACES_X_M[place], impulse_n_s) for name in ("plain", "slip"))
    least = least_peak_m(impulse_n_s)
    assert 1.5 < plain.remaining_y_m / slip.remaining_y_m < 50
    assert least < slip.peak_y_m < 2 * least + 2e-3
    assert least < plain.peak_y_m < 2 * least + 2e-3
    # What the wheels did not turn, the rolling odometry never gets back.
    assert 0.6 * plain.peak_y_m < plain.remaining_y_m < plain.peak_y_m


def test_displacement_grows_with_the_blow():
    for controller in ("plain", "slip"):
        peaks = [outcome(controller, 2.35, j).peak_y_m for j in (4.0, 8.0, 12.0, 16.0)]
        assert peaks == sorted(peaks)


@pytest.mark.parametrize("controller", ["plain", "slip"])
def test_no_blow_no_displacement(controller):
    quiet = outcome(controller, 2.35, 0.0)
    assert quiet.peak_y_m < 5e-4


@pytest.mark.parametrize("controller", ["plain", "slip"])
def test_what_odometry_misses_is_what_remains(controller):
    """Both controllers bring their belief back to the line within 3 mm, 2.5 ms of their speed."""
    truth = simulate_truth(case_scenario(Case(controller, 2.35, REFERENCE_N_S), MODEL))
    believed, done = truth["odometry"][-200:, 1].mean(), truth["pose"][-200:, 1].mean()
    assert abs(believed) < 3e-3
    assert done > 1e-3


def test_log_of_the_experiment_shows_what_the_plant_did():
    case = Case("slip", 2.35, REFERENCE_N_S)
    run = run_scenario(case_scenario(case, MODEL))
    seen = np.isfinite(run.log.columns["pose/y_m"])
    ticks = np.round(run.log.t_s[seen] * 1000).astype(int)
    np.testing.assert_array_equal(run.log.columns["pose/y_m"][seen], run.truth["pose"][ticks, 1])
    np.testing.assert_array_equal(run.truth["camera_pose"], run.truth["pose"])
