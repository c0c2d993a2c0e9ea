"""One scenario on two carriers: the stub HAL, and the drivers on the virtual LF2407A.

What differs, and by how much:

    duty      rounded to 1/2000 instead of 1/32768: half a step of the supply is 6 mV
    supply    10 bits of 33 V: 24 V reads as the middle of its step, at most 16 mV off
    time      counters are read 1 us into the tick; the duty acts when the tick has computed (200 us
              in the board's cost model) and the next PWM period begins (up to 50 us), half a period
              later on EVA than on EVB
"""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from loop_run import (
    FIRMWARE,
    JACOBIAN,
    PARAMETERS,
    RIM_PER_SHAFT_M,
    VALUES,
    WHEEL_LOAD_N,
    command,
    effect,
    unwrapped,
)
from omnislip import _core
from omnislip import scenario as scenario_module
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario

SQUARE = Path(scenario_module.__file__).parent / "scenarios" / "square.toml"

DUTY_STEP = 1 / 2000
SUPPLY_STEP_V = 33.0 / 1024
COMPUTE_S, PWM_PERIOD_S = 200e-6, 50e-6
ACCESS_S = 5e-6  # 30 register accesses between counters and duty, at 6 cycles each


def simulate(commands, duration_s, on_board, effects=(), step_s=1e-3):
    return _core.simulate(
        PARAMETERS,
        list(effects),
        FIRMWARE,
        list(commands),
        [],
        duration_s,
        step_s,
        on_board=on_board,
    )


def path_bound_m(truth, duration_s):
    """Largest distance between the two paths, (x or y, heading), that the roundings explain.

    A voltage that is off by e_V lets the slip observer see a force that is off by (n/R) k2/Ra e_V,
    and by eq. (13) a slip that is off by that times pi/2 / (k mu N) (1 + tan^2): the body's speed
    is wrong by J+ times that, its heading turns the path. Besides, all comes a latency late.
    """
    voltage_v = SUPPLY_STEP_V / 2 * np.abs(truth["duty"]).max()
    voltage_v += DUTY_STEP / 2 * VALUES["motor.supply_v"]
    motor = VALUES["motor.torque_constant_nm_a"] / VALUES["motor.resistance_ohm"]
    force_n = voltage_v * motor / RIM_PER_SHAFT_M
    grip_n = VALUES["contact.mu_drive"] * WHEEL_LOAD_N
    share = np.median(np.abs(truth["drive_force_n"])) / grip_n
    per_force = np.pi / 2 / (VALUES["contact.slip_stiffness_s_m"] * grip_n)
    slip_m_s = force_n * per_force * (1 + np.tan(np.pi / 2 * share) ** 2)
    worst = np.abs(np.linalg.pinv(JACOBIAN)).sum(axis=1) * slip_m_s
    latency_s = COMPUTE_S + PWM_PERIOD_S + ACCESS_S
    speed = np.linalg.norm(truth["velocity"][:, :2], axis=1).max()
    turn = np.abs(truth["velocity"][:, 2]).max()
    heading_rad = worst[2] * duration_s + turn * latency_s
    place_m = worst[:2].max() * duration_s + speed * latency_s
    return place_m + speed * duration_s * heading_rad / 2, heading_rad


SCENARIOS = {
    "straight": ([command("velocity", 1.5, 0.0, 0.0)], 3.0),
    "pose": ([command("pose", 1.0, 0.5, 0.5, 0.0, 0.0, 0.0)], 3.0),
    "curves": (
        [command("velocity", 1.0, 0.5, 2.0), command("velocity", -1.0, 0.5, -2.0, t_s=1.0)],
        3.0,
    ),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_same_path_within_the_roundings(name):
    commands, duration_s = SCENARIOS[name]
    stub, board = (simulate(commands, duration_s, on_board) for on_board in (False, True))
    place_m, heading_rad = path_bound_m(stub, duration_s)
    apart = np.abs(stub["pose"] - board["pose"]).max(axis=0)
    print(
        f"{name}: {apart[:2].max() * 1e3:.2f} mm of {place_m * 1e3:.1f}, {apart[2] * 1e3:.2f} mrad"
    )
    assert apart[:2].max() < place_m
    assert apart[2] < heading_rad
    assert apart.max() > 0  # it did run on another carrier
    assert not stub["fault"].any()
    assert not board["fault"].any()
    # Both firmwares believe their robots alike.
    error = [np.abs(run["odometry"] - run["pose"]).max(axis=0) for run in (stub, board)]
    np.testing.assert_allclose(error[0], error[1], atol=place_m)


def test_the_duty_comes_late_by_computing_and_half_a_period():
    """Open loop with duties that both carriers have exactly; the plant's delay effect measures."""
    steps = [(0.1, (0.5, -0.375, 0.25, -0.625)), (0.3, (-0.5, 0.375, -0.25, 0.625))]
    commands = [command("duty", *duty, t_s=t_s) for t_s, duty in steps]
    board = simulate(commands, 0.6, True, step_s=5e-5)["wheel_speed_rad_s"]
    delays_s = np.arange(190, 275, 5) * 1e-6
    apart = []
    for delay_s in delays_s:
        late = effect("actuation_delay", delay_s=delay_s)
        stub = simulate(commands, 0.6, False, [late], step_s=5e-5)
        apart.append(np.abs(stub["wheel_speed_rad_s"] - board).max(axis=0))
    found_s = delays_s[np.argmin(apart, axis=0)]
    assert (found_s >= COMPUTE_S).all()
    assert (found_s <= COMPUTE_S + ACCESS_S + PWM_PERIOD_S).all()
    # EVA drives wheels 1 and 2, EVB 3 and 4, half a period apart.
    assert found_s[0] == found_s[1]
    assert found_s[2] == found_s[3]
    assert found_s[0] - found_s[2] == pytest.approx(PWM_PERIOD_S / 2, abs=5e-6)


def test_counters_agree_with_the_shafts():
    commands, duration_s = SCENARIOS["curves"]
    truth = simulate(commands, duration_s, True)
    rad_per_count = 2 * np.pi / VALUES["encoder.counts_per_rev"]
    speed = truth["wheel_speed_rad_s"]
    angle = np.vstack([np.zeros(4), np.cumsum((speed[1:] + speed[:-1]) / 2e3, axis=0)])
    # One count of rounding, one for the microseconds between tick and LATCH, the rest the
    # trapezoidal rule's.
    np.testing.assert_allclose(
        unwrapped(truth["encoder_counts"]), angle / rad_per_count, atol=2.0 + 2.0
    )


def test_a_scenario_file_drives_either_carrier():
    """The square of the demo: the logs have the same columns and tell of the same path."""
    scenario = read_scenario(SQUARE)
    stub, board = (run_scenario(scenario, on_board) for on_board in (False, True))
    assert list(stub.log.columns) == list(board.log.columns)
    np.testing.assert_array_equal(stub.log.t_s, board.log.t_s)
    place_m, heading_rad = path_bound_m(stub.truth, scenario.duration_s)
    apart = np.abs(stub.truth["pose"] - board.truth["pose"]).max(axis=0)
    assert apart[:2].max() < place_m
    assert apart[2] < heading_rad


def test_boards_on_many_threads_do_not_meet():
    runs = [SCENARIOS[name] for name in SCENARIOS] * 2
    serial = [simulate(*run, True)["pose"].tobytes() for run in runs]
    with ThreadPoolExecutor(4) as pool:
        parallel = list(pool.map(lambda run: simulate(*run, True)["pose"].tobytes(), runs))
    assert parallel == serial
    assert len(set(serial)) == len(SCENARIOS)
