"""From the 1 kHz truth to the log: what the sensors show, when, and how badly."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.errors import InputError
from omnislip.log_file import read_log, write_log
from omnislip.model_file import NOMINAL_ROBOT, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, run_scenario

TICKS = 2000


def ramp_truth() -> dict[str, np.ndarray]:
    """Signals that are straight lines of time, so that means and delays have closed forms."""
    t_s = np.arange(TICKS) / 1000
    wheels = np.arange(1.0, 5.0)
    return {
        "t_s": t_s,
        "duty": t_s[:, None] * wheels / 100,
        "encoder_counts": (np.arange(TICKS)[:, None] * wheels * 100).astype(np.uint16),
        "camera_pose": t_s[:, None] * [1.0, -2.0, 0.5],
        "gyro_rad_s": np.full(TICKS, 0.5),
        "current_a": t_s[:, None] * wheels,
        "supply_v": 24.0 - t_s,
    }


def scenario(**changes: object) -> Scenario:
    velocity = {"t_s": 0.0, "kind": "velocity", "value": [1.0, 0.0, 0.0]}
    base = Scenario("test", TICKS / 1000, read_model(NOMINAL_ROBOT), [velocity])
    return replace(base, **changes)


def test_duty_is_the_mean_to_the_next_row():
    log = make_log(scenario(rate_hz=200), ramp_truth())
    # Ticks k, k + 1, ... k + 4 of a ramp of 0.01 per second: their mean is 2 ms ahead of t_s.
    np.testing.assert_allclose(log.columns["wheel/1/duty"], 0.01 * (log.t_s + 0.002), atol=1e-12)


def test_other_columns_are_samples_at_the_time_of_the_row():
    truth = ramp_truth()
    log = make_log(scenario(rate_hz=200), truth)
    np.testing.assert_allclose(log.t_s, np.arange(TICKS // 5) * 0.005)
    np.testing.assert_array_equal(
        log.columns["wheel/4/encoder_counts"], truth["encoder_counts"][::5, 3]
    )
    np.testing.assert_array_equal(log.columns["wheel/2/current_a"], truth["current_a"][::5, 1])
    np.testing.assert_array_equal(log.columns["supply/voltage_v"], truth["supply_v"][::5])


def test_counts_wrap_at_16_bits():
    counts = make_log(scenario(), ramp_truth()).columns["wheel/4/encoder_counts"]
    assert counts.max() <= 65535
    assert (np.diff(counts) < 0).any()


def test_pose_is_sampled_at_its_own_rate():
    log = make_log(scenario(rate_hz=200, pose_rate_hz=50), ramp_truth())
    seen = np.isfinite(log.columns["pose/x_m"])
    np.testing.assert_array_equal(np.flatnonzero(seen), np.arange(0, len(seen), 4))
    np.testing.assert_allclose(log.columns["pose/y_m"][seen], -2.0 * log.t_s[seen])


def test_pose_delay_shows_the_past():
    log = make_log(scenario(sensors=Sensors(pose_delay_s=0.1)), ramp_truth())
    late = np.isfinite(log.columns["pose/x_m"]) & (log.t_s >= 0.1)
    np.testing.assert_allclose(log.columns["pose/x_m"][late], log.t_s[late] - 0.1, atol=1e-12)
    assert log.columns["pose/x_m"][0] == 0.0


def test_gyro_bias_and_noise_have_the_stated_size():
    sensors = Sensors(gyro_bias_rad_s=0.1, gyro_noise_rad_s=0.02)
    error = make_log(scenario(sensors=sensors, rate_hz=1000), ramp_truth()).columns["gyro/z_rad_s"]
    error = error - 0.5
    # 2000 samples: standard errors are 0.00045 (mean) and 0.00032 (deviation); 5 of each.
    assert abs(error.mean() - 0.1) < 0.0023
    assert abs(error.std() - 0.02) < 0.0016


def test_dropout_loses_the_stated_share_of_poses():
    sensors = Sensors(pose_dropout_fraction=0.3)
    settings = scenario(sensors=sensors, rate_hz=1000, pose_rate_hz=1000)
    seen = np.isfinite(make_log(settings, ramp_truth()).columns["pose/x_m"])
    # 2000 draws: the standard error of the share is 0.0102; 5 of it.
    assert abs(seen.mean() - 0.7) < 0.052


def test_the_same_seed_gives_the_same_log():
    noisy = scenario(sensors=Sensors(gyro_noise_rad_s=0.1))
    gyro = [
        make_log(replace(noisy, seed=seed), ramp_truth()).columns["gyro/z_rad_s"]
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(gyro[0], gyro[1])
    assert not np.array_equal(gyro[0], gyro[2])


def test_too_short_for_a_log():
    truth = {name: values[:9] for name, values in ramp_truth().items()}
    with pytest.raises(InputError, match="too short"):
        make_log(scenario(), truth)


def test_closed_loop_log_is_a_valid_robot_log(tmp_path):
    run = run_scenario(scenario(duration_s=1.0))
    write_log(run.log, tmp_path / "run.csv")
    assert len(read_log(tmp_path / "run.csv", "robot").t_s) == 200


def test_closed_loop_reaches_the_commanded_speed():
    truth = run_scenario(scenario(duration_s=2.0)).truth
    assert abs(truth["velocity"][-200:, 0].mean() - 1.0) < 0.02


def test_slip_compensation_reaches_the_firmware():
    blow = {"t_s": 1.0, "impulse_x_n_s": 0.0, "impulse_y_n_s": 15.0, "impulse_theta_n_m_s": 0.0}
    believed_y_m = [
        run_scenario(scenario(impulses=[blow], slip_compensation=slip)).truth["odometry"][-1, 1]
        for slip in (False, True)
    ]
    assert believed_y_m[0] != believed_y_m[1]


def test_a_robot_the_firmware_cannot_hold_is_bad_input():
    model = scenario().model
    huge = replace(model, values=model.values | {"robot.wheel_distance_m": 1e6})
    with pytest.raises(InputError, match=r"robot\.wheel_distance_m"):
        run_scenario(scenario(model=huge))
