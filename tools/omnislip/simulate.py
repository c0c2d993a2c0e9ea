"""Run a scenario: firmware and plant in closed loop, then sensors and log as on a real robot.

The log keeps every (1000 / rate_hz)-th control tick. Duty of a row is the mean over its interval,
which is what a model needs that integrates from row to row; everything else is sampled at t_s.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.errors import InputError
from omnislip.firmware_parameters import firmware_parameters
from omnislip.log_file import POSE_COLUMNS, Log
from omnislip.scenario import CONTROL_RATE_HZ, Scenario, Sensors

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Run:
    """A simulated run: `truth` holds the 1 kHz arrays of omnislip._core.simulate, `log` the log."""

    truth: dict[str, Array]
    log: Log


def run_scenario(scenario: Scenario, on_board: bool = False) -> Run:
    """Simulate `scenario`. InputError if its robot cannot be given to the firmware.

    on_board: the firmware reaches the plant through the drivers on the virtual LF2407A.
    """
    truth = simulate_truth(scenario, on_board)
    return Run(truth, make_log(scenario, truth))


def simulate_truth(scenario: Scenario, on_board: bool = False) -> dict[str, Array]:
    """Return the 1 kHz arrays (n rows) of the closed loop, names and units as in _core.simulate."""
    parameters, effects = scenario.model.to_core()
    try:
        raw_parameters = firmware_parameters(scenario.model.values)
    except ValueError as error:
        raise InputError(f"{scenario.model.path}: {error}") from None
    raw_parameters["slip_compensation"] = int(scenario.slip_compensation)
    return _core.simulate(
        parameters,
        effects,
        raw_parameters,
        scenario.commands,
        scenario.impulses,
        scenario.duration_s,
        on_board=on_board,
    )


def make_log(scenario: Scenario, truth: dict[str, Array]) -> Log:
    """Return the log that the sensors of `scenario` make of the 1 kHz arrays `truth`."""
    ticks_per_row = CONTROL_RATE_HZ // scenario.rate_hz
    row_count = len(truth["t_s"]) // ticks_per_row
    if row_count < 2:
        raise InputError(f"scenario '{scenario.name}': too short for 2 rows of the log")
    tick = np.arange(row_count) * ticks_per_row
    generator = np.random.default_rng(scenario.seed)
    duty = truth["duty"][: row_count * ticks_per_row].reshape(row_count, ticks_per_row, 4)
    columns = _wheel_columns(duty.mean(axis=1), truth["encoder_counts"][tick])
    columns |= _analogue_columns(truth, tick, scenario.sensors, generator)
    rows_per_pose = scenario.rate_hz // scenario.pose_rate_hz
    columns |= _pose_columns(truth, tick, rows_per_pose, scenario.sensors, generator)
    return Log(scenario.name, truth["t_s"][tick], columns)


def _wheel_columns(duty: Array, counts: Array) -> dict[str, Array]:
    columns = {f"wheel/{wheel + 1}/duty": duty[:, wheel] for wheel in range(4)}
    for wheel in range(4):
        columns[f"wheel/{wheel + 1}/encoder_counts"] = counts[:, wheel].astype(np.float64)
    return columns


def _analogue_columns(
    truth: dict[str, Array], tick: Indices, sensors: Sensors, generator: np.random.Generator
) -> dict[str, Array]:
    def noisy(values: Array, deviation: float) -> Array:
        return values + deviation * generator.standard_normal(len(values))

    yaw_rate = truth["gyro_rad_s"][tick] + sensors.gyro_bias_rad_s
    columns = {
        "gyro/z_rad_s": noisy(yaw_rate, sensors.gyro_noise_rad_s),
        "supply/voltage_v": noisy(truth["supply_v"][tick], sensors.supply_noise_v),
    }
    for wheel in range(4):
        current = truth["current_a"][tick, wheel]
        columns[f"wheel/{wheel + 1}/current_a"] = noisy(current, sensors.current_noise_a)
    return columns


def _pose_columns(
    truth: dict[str, Array],
    tick: Indices,
    rows_per_pose: int,
    sensors: Sensors,
    generator: np.random.Generator,
) -> dict[str, Array]:
    shown_s = truth["t_s"][tick] - sensors.pose_delay_s
    seen = np.arange(len(tick)) % rows_per_pose == 0
    seen &= generator.random(len(tick)) >= sensors.pose_dropout_fraction
    deviations = [sensors.pose_noise_m, sensors.pose_noise_m, sensors.pose_noise_rad]
    columns = {}
    for axis, (name, deviation) in enumerate(zip(POSE_COLUMNS, deviations, strict=True)):
        pose = np.interp(shown_s, truth["t_s"], truth["camera_pose"][:, axis])
        pose += deviation * generator.standard_normal(len(pose))
        columns[name] = np.where(seen, pose, np.nan)
    return columns
