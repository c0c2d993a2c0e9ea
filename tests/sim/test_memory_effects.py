"""Effects with memory in the replay engine and in closed loop: carried, restarted, not mixed up."""

import numpy as np
import pytest
from engine_run import parameter_set, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from omnislip import _core
from omnislip.firmware_parameters import firmware_parameters

TYPICAL = {
    "actuation_delay": ("delay_s", 0.0043),
    "driver_lag": ("time_constant_s", 0.004),
    "armature_inductance": ("inductance_h", 8e-4),
    "winding_heating": ("coefficient", 0.002),
    "bristle_relaxation": ("length_m", 1e-3),
    "gear_backlash": ("angle_rad", 0.01),
    "shaft_compliance": ("stiffness_nm_rad", 100.0),
    "pose_latency": ("delay_s", 0.0637),
    "clock_skew": ("fraction", 0.03),
}
CAMERA = ("pose_latency", "clock_skew")
ROW_S = 0.005
NOISE = {
    "process": np.full(14, 1e-2),
    "output": np.full(8, 1e-4),
    "initial": np.full(14, 1e-2),
}


def model(name):
    return parameter_set(effects=[(name, *TYPICAL[name])] if name else [])


def swaying_duty(rows, seed=3):
    rng = np.random.default_rng(seed)
    return 0.5 * np.repeat(rng.uniform(-1.0, 1.0, (-(-rows // 20), 4)), 20, axis=0)[:rows]


@pytest.fixture(scope="module")
def run():
    time = np.arange(300) * ROW_S
    duty = swaying_duty(len(time))
    duty[:10] = 0.0
    return time, duty


@pytest.mark.parametrize("name", TYPICAL)
def test_filter_and_restarted_replays_of_the_true_model_find_nothing(name, run):
    """Each row and each restart goes on with the memory that the robot had there."""
    time, duty = run
    shown = simulate([model(name)], time, duty)[0]
    engine = _core.Engine("robot")
    recording = engine.recording(time, duty, shown, np.zeros(14))
    track = engine.track([recording], model(name), **NOISE)
    sets = np.stack([model(name), model(None)])
    true, believed = engine.innovations([recording], track, sets)[0]
    assert np.abs(true).max() < 1e-8
    assert np.abs(believed).max() > 1e-2
    true, believed = engine.replays([recording], track, sets, window_s=0.2)[0]
    assert np.abs(true).max() < 1e-8
    assert np.abs(believed).max() > 1e-2
    assert np.abs(track[0].innovation).max() < 1e-8


@pytest.mark.parametrize("name", ["driver_lag", "armature_inductance"])
def test_behind_a_command_that_begins_with_the_log_nothing_lags_yet(name, run):
    """The robot stood in the rows that are left out; else that command is said to have lasted."""
    time, duty = run
    shown = simulate([model(name)], time, duty)[0]
    engine = _core.Engine("robot")
    log = (time[10:], duty[10:], shown[10:], np.zeros(14))
    off = []
    for begun_variance in (np.full(21, 1e-2), None):
        recording = engine.recording(*log, begun_variance=begun_variance)
        track = engine.track([recording], model(name), **NOISE)
        off.append(np.abs(engine.innovations([recording], track, model(name)[None])[0]).max())
    assert off[0] < 1e-8
    assert off[1] > 1e-2


def test_variances_of_a_begin_have_one_for_each_state_and_disturbance(run):
    time, duty = run
    rest = (time, duty, np.zeros((len(time), 8)), np.zeros(14))
    with pytest.raises(ValueError, match="one value for each state and push"):
        _core.Engine("robot").recording(*rest, begun_variance=np.ones(14))


def test_filter_with_neutral_effects_is_the_filter_without(run):
    time, duty = run
    shown = simulate([model("driver_lag")], time, duty)[0]
    engine = _core.Engine("robot")
    recording = engine.recording(time, duty, shown, np.zeros(14))
    sets = np.stack([parameter_set(), model("bristle_relaxation")])
    track = engine.track([recording], sets[0], **NOISE)
    alone = engine.innovations([recording], track, sets[:1])[0][0]
    beside = engine.innovations([recording], track, sets)[0][0]
    np.testing.assert_allclose(beside, alone, rtol=0, atol=1e-9)


@given(rows=st.integers(0, 8), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_delay_of_whole_rows_shifts_the_outputs(rows, seed):
    time = np.arange(60) * ROW_S
    duty = swaying_duty(len(time), seed)
    duty[0] = 0.0
    late = parameter_set(effects=[("actuation_delay", "delay_s", rows * ROW_S)])
    plain, shifted = simulate([parameter_set(), late], time, duty, step_s=1e-4)
    np.testing.assert_allclose(shifted[rows:], plain[: len(time) - rows], rtol=0, atol=1e-8)


@given(rows=st.integers(1, 20), part=st.floats(0.0, 1.0), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_late_camera_shows_the_pose_of_that_moment(rows, part, seed):
    """Also while the motion changes; before the log begins the robot rests."""
    time = np.arange(60) * ROW_S
    delays = [(rows - part) * ROW_S, rows * ROW_S, 0.0]
    sets = [parameter_set(effects=[("pose_latency", "delay_s", delay)]) for delay in delays]
    between, late, plain = simulate(sets, time, swaying_duty(len(time), seed))
    np.testing.assert_allclose(late[rows:, 5:], plain[:-rows, 5:], rtol=0, atol=1e-12)
    np.testing.assert_allclose(late[:rows, 5:], 0.0, atol=1e-12)
    mixed = (1.0 - part) * late[rows:, 5:] + part * plain[1 : len(time) - rows + 1, 5:]
    np.testing.assert_allclose(between[rows:, 5:], mixed, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(late[:, :5], plain[:, :5])


def test_memory_does_not_leak_into_other_lanes(run):
    time, duty = run
    sets = [model(name) for name in (*TYPICAL, None)]
    together = simulate(sets, time, duty, step_s=1e-4)
    for values, beside in zip(sets, together, strict=True):
        alone = simulate([values], time, duty, step_s=1e-4)[0]
        np.testing.assert_allclose(beside, alone, rtol=1e-9, atol=1e-9)


def closed_loop(name, value=None, step_s=5e-4):
    effects = []
    if name:
        parameter, typical = TYPICAL[name]
        number = typical if value is None else value
        effects = [{"name": name, "wheel": None, "parameters": {parameter: number}}]
    values = {p["name"]: p["default"] for p in _core.base_parameters("robot")}
    angles = [values[f"robot.wheel_angles_deg[{i}]"] for i in range(4)]
    firmware = firmware_parameters({**values, "robot.wheel_angles_deg": angles})
    commands = [
        {"t_s": 0.05, "kind": "duty", "value": [0.4, -0.2, 0.3, 0.1]},
        {"t_s": 0.25, "kind": "duty", "value": [-0.4, 0.1, 0.3, 0.2]},
    ]
    return _core.simulate(values, effects, firmware, commands, [], 0.4, step_s)


def test_late_driver_shifts_the_closed_loop_by_its_ticks():
    """With steps as fine as those after a jump: these follow the command, not what acts."""
    plain, late = closed_loop(None, None, 1e-4), closed_loop("actuation_delay", 0.007, 1e-4)
    np.testing.assert_array_equal(plain["duty"], late["duty"])
    for column in ("wheel_speed_rad_s", "pose", "current_a"):
        np.testing.assert_allclose(late[column][7:], plain[column][:-7], rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", TYPICAL)
def test_closed_loop_is_the_replay_of_its_duties(name):
    """In steps so fine that it does not matter that each has its own rule."""
    run = closed_loop(name, step_s=1e-4)
    replayed = simulate([model(name)], run["t_s"], run["duty"], step_s=1e-4)[0]
    np.testing.assert_allclose(replayed[:, 5:], run["camera_pose"], rtol=0, atol=1e-9)
    late = np.abs(run["camera_pose"] - run["pose"]).max()
    assert late > 1e-3 if name in CAMERA else late == 0.0
