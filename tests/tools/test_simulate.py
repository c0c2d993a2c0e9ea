"""From the 1 kHz truth to the log: what the sensors show, when, and how badly."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip.errors import InputError
from omnislip.log_file import read_log, write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, run_scenario, simulate_truth

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
    np.testing.assert_allclose(log.columns["supply/voltage_v"], truth["supply_v"][::5], atol=5e-4)


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


def test_supply_and_currents_are_shown_in_steps():
    sensors = Sensors(supply_resolution_v=0.1, current_resolution_a=0.5)
    truth = ramp_truth()
    log = make_log(scenario(sensors=sensors, rate_hz=1000), truth)
    for column, step, exact in (
        ("supply/voltage_v", 0.1, truth["supply_v"]),
        ("wheel/4/current_a", 0.5, truth["current_a"][:, 3]),
    ):
        shown = log.columns[column]
        assert np.abs(shown - exact).max() <= step / 2 + 1e-9
        np.testing.assert_allclose(shown / step, np.round(shown / step), atol=1e-6)


def test_supply_and_current_noise_have_the_stated_size():
    sensors = Sensors(supply_noise_v=0.2, current_noise_a=0.3)
    truth = ramp_truth()
    log = make_log(scenario(sensors=sensors, rate_hz=1000), truth)
    # 2000 samples: the standard error of the deviation is 1 / 63 of it; 5 of it.
    supply_error = log.columns["supply/voltage_v"] - truth["supply_v"]
    assert abs(supply_error.std() - 0.2) < 0.2 * 5 / 63
    current_error = log.columns["wheel/1/current_a"] - truth["current_a"][:, 0]
    assert abs(current_error.std() - 0.3) < 0.3 * 5 / 63


def open_loop(**sensors: object) -> dict[str, np.ndarray]:
    """The plant under a fixed duty: what the sensors show does not change its motion."""
    duty = {"t_s": 0.0, "kind": "duty", "value": [0.05, 0.1, -0.15, 0.2]}
    settings = scenario(commands=[duty], sensors=Sensors(**sensors), duration_s=1.0)
    return simulate_truth(settings)


def test_encoders_show_whole_counts_from_their_start_and_phase():
    start = (0.0, 0.5, 100.25, 65535.75)
    exact, shown = open_loop(), open_loop(encoder_start_counts=start)
    np.testing.assert_array_equal(shown["pose"], exact["pose"])
    ahead = (shown["encoder_counts"] - exact["encoder_counts"]).astype(int)
    assert (ahead[:, 0] == 0).all()
    assert set(ahead[:, 1]) == {0, 1}
    assert set(ahead[:, 2]) == {100, 101}
    assert set(ahead[:, 3]) == {65535, 0}
    # The counters turn through hundreds of counts: the share of the time ahead is the phase.
    assert abs((ahead[:, 1] == 1).mean() - 0.5) < 0.1
    assert abs((ahead[:, 2] == 101).mean() - 0.25) < 0.1


def test_where_the_counters_start_does_not_move_the_odometry():
    straight = [
        simulate_truth(scenario(sensors=Sensors(encoder_start_counts=start)))["odometry"]
        for start in ((0.0,) * 4, (65535.9, 30000.5, 0.3, 12345.0))
    ]
    assert np.abs(straight[1][0]).max() < 1e-3
    np.testing.assert_allclose(straight[1], straight[0], atol=2e-3)


def test_an_impact_of_the_model_acts_in_the_run_that_it_names():
    blow = {"impulse_x_n_s": 0.0, "impulse_y_n_s": 9.0, "impulse_theta_n_m_s": 0.5}
    impact = Effect("impact", {"time_s": 0.5} | blow, run="test")
    struck = replace(scenario().model, effects=[impact])
    told, asked, other = (
        simulate_truth(scenario(**changes))["pose"]
        for changes in (
            {"model": struck},
            {"impulses": [{"t_s": 0.5} | blow]},
            {"model": struck, "name": "another"},
        )
    )
    np.testing.assert_array_equal(told, asked)
    np.testing.assert_array_equal(other, simulate_truth(scenario())["pose"])
    assert np.abs(told - other)[:, 1].max() > 0.01


def test_camera_noise_has_the_stated_size():
    sensors = Sensors(pose_noise_m=0.02, pose_noise_rad=0.01)
    truth = ramp_truth()
    settings = scenario(sensors=sensors, rate_hz=1000, pose_rate_hz=1000)
    columns = make_log(settings, truth).columns
    # 2000 samples: the standard error of the deviation is 1 / 63 of it; 5 of it.
    for axis, (name, size) in enumerate((("x_m", 0.02), ("y_m", 0.02), ("theta_rad", 0.01))):
        error = columns[f"pose/{name}"] - truth["camera_pose"][:, axis]
        assert abs(error.std() - size) < size * 5 / 63


def test_the_firmware_sees_the_noise_of_the_supply():
    clean, noisy, again = (
        simulate_truth(scenario(sensors=Sensors(supply_noise_v=noise))) for noise in (0, 1, 1)
    )
    assert not np.array_equal(clean["duty"], noisy["duty"])
    np.testing.assert_array_equal(noisy["duty"], again["duty"])


def test_the_errors_of_one_sensor_do_not_depend_on_another():
    quiet = Sensors(gyro_noise_rad_s=0.1)
    loud = Sensors(gyro_noise_rad_s=0.1, pose_noise_m=1.0, pose_dropout_fraction=0.5)
    gyro = [
        make_log(scenario(sensors=sensors, pose_rate_hz=rate), ramp_truth()).columns["gyro/z_rad_s"]
        for sensors, rate in ((quiet, 50), (loud, 100))
    ]
    np.testing.assert_array_equal(gyro[0], gyro[1])


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


def test_a_command_the_firmware_cannot_hold_is_bad_input():
    fast = {"t_s": 0.0, "kind": "velocity", "value": [40.0, 0.0, 0.0]}
    with pytest.raises(InputError, match="scenario 'test': a velocity is out of the firmware's"):
        run_scenario(scenario(commands=[fast]))


def test_a_robot_the_firmware_cannot_hold_is_bad_input():
    model = scenario().model
    huge = replace(model, values=model.values | {"robot.wheel_distance_m": 1e6})
    with pytest.raises(InputError, match=r"robot\.wheel_distance_m"):
        run_scenario(scenario(model=huge))
