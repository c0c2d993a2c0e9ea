"""Run a scenario: firmware and plant in closed loop, then sensors and log as on a real robot.

The log keeps every (1000 / rate_hz)-th control tick. Duty of a row is the mean over its interval,
which is what a model needs that integrates from row to row; everything else is sampled at t_s.
Errors of encoders and supply act in the loop, since the firmware reads these sensors; gyro,
currents and camera are only logged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from omnislip import _core
from omnislip.errors import InputError
from omnislip.firmware_parameters import firmware_parameters
from omnislip.log_file import POSE_COLUMNS, Log
from omnislip.model_file import Model
from omnislip.scenario import CONTROL_RATE_HZ, IMPULSES, Scenario

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Run:
    """A simulated run: `truth` holds the 1 kHz arrays of omnislip._core.simulate, `log` the log."""

    truth: dict[str, Array]
    log: Log


def run_scenario(scenario: Scenario, on_board: bool = False) -> Run:
    """Simulate `scenario`. InputError if the firmware cannot hold its robot or its commands.

    on_board: the firmware reaches the plant through the drivers on the virtual LF2407A.
    """
    truth = simulate_truth(scenario, on_board)
    return Run(truth, make_log(scenario, truth))


def simulate_truth(
    scenario: Scenario,
    on_board: bool = False,
    firmware_robot: Model | None = None,
    step_s: float = 1e-3,
) -> dict[str, Array]:
    """Return the 1 kHz arrays (n rows) of the closed loop, names and units as in _core.simulate.

    The firmware is set up for `firmware_robot`, by default for the robot of the scenario.
    step_s: largest step of the integrator.
    """
    parameters, effects = scenario.model.to_core()
    try:
        believed = (firmware_robot or scenario.model).values
        raw_parameters = dict(_firmware_parameters(_frozen(believed)))
    except ValueError as error:
        raise InputError(f"{scenario.model.path}: {error}") from None
    raw_parameters["slip_compensation"] = int(scenario.slip_compensation)
    sensors = scenario.sensors
    ticks = round(scenario.duration_s * CONTROL_RATE_HZ)
    try:
        return _core.simulate(
            parameters,
            effects,
            raw_parameters,
            scenario.commands,
            [*scenario.impulses, *_impulses_of_model(scenario)],
            scenario.duration_s,
            step_s,
            on_board=on_board,
            encoder_start_counts=sensors.encoder_start_counts,
            supply_error_v=_supply_error_v(scenario, ticks),
            supply_resolution_v=sensors.supply_resolution_v,
            user_effects=scenario.model.own_effects,
        )
    except ValueError as error:
        raise InputError(f"scenario '{scenario.name}': {error}") from None


def _impulses_of_model(scenario: Scenario) -> list[dict[str, float]]:
    """Return the impacts that the model tells of the run with the name of the scenario."""
    impacts = [effect for effect in scenario.model.effects if effect.name == "impact"]
    return [
        {"t_s": impact.parameters["time_s"]} | {key: impact.parameters[key] for key in IMPULSES}
        for impact in impacts
        if impact.run == scenario.name
    ]


Frozen = tuple[tuple[str, float | tuple[float, ...]], ...]


def _frozen(values: Mapping[str, float | Sequence[float]]) -> Frozen:
    return tuple(
        (name, value if isinstance(value, int | float) else tuple(value))
        for name, value in values.items()
    )


@lru_cache
def _firmware_parameters(values: Frozen) -> dict[str, int]:
    """Return them for the values of a model, kept: many runs are of the same robot."""
    return firmware_parameters(dict(values))


def make_log(scenario: Scenario, truth: dict[str, Array]) -> Log:
    """Return the log that the sensors of `scenario` make of the 1 kHz arrays `truth`."""
    ticks_per_row = CONTROL_RATE_HZ // scenario.rate_hz
    row_count = len(truth["t_s"]) // ticks_per_row
    if row_count < 2:
        raise InputError(f"scenario '{scenario.name}': too short for 2 rows of the log")
    tick = np.arange(row_count) * ticks_per_row
    duty = truth["duty"][: row_count * ticks_per_row].reshape(row_count, ticks_per_row, 4)
    columns = _wheel_columns(duty.mean(axis=1), truth["encoder_counts"][tick])
    columns["gyro/z_rad_s"] = _gyro(scenario, truth["gyro_rad_s"][tick])
    columns["supply/voltage_v"] = _supply(scenario, truth["supply_v"])[tick]
    columns |= _current_columns(scenario, truth["current_a"][tick])
    columns |= _pose_columns(scenario, truth, tick)
    return Log(scenario.name, truth["t_s"][tick], columns)


def _noise(scenario: Scenario, sensor: str, *shape: int) -> Array:
    """Return standard normal numbers: a stream of its own for each sensor and seed.

    So a sensor's errors stay the same whatever is asked of the other sensors.
    """
    return _stream(scenario, sensor).standard_normal(shape)


def _stream(scenario: Scenario, sensor: str) -> np.random.Generator:
    return np.random.default_rng([scenario.seed, *sensor.encode()])


def _wheel_columns(duty: Array, counts: Array) -> dict[str, Array]:
    columns = {f"wheel/{wheel + 1}/duty": duty[:, wheel] for wheel in range(4)}
    for wheel in range(4):
        columns[f"wheel/{wheel + 1}/encoder_counts"] = counts[:, wheel].astype(np.float64)
    return columns


def _gyro(scenario: Scenario, rate_rad_s: Array) -> Array:
    noise = _noise(scenario, "gyro", len(rate_rad_s))
    return rate_rad_s + scenario.sensors.gyro_bias_rad_s + scenario.sensors.gyro_noise_rad_s * noise


def _supply_error_v(scenario: Scenario, ticks: int) -> Array:
    return scenario.sensors.supply_noise_v * _noise(scenario, "supply", ticks)


def _supply(scenario: Scenario, supply_v: Array) -> Array:
    """Return what the firmware's converter shows of the voltage, (n,) at 1 kHz."""
    shown_v = supply_v + _supply_error_v(scenario, len(supply_v))
    return _rounded(shown_v, scenario.sensors.supply_resolution_v)


def _current_columns(scenario: Scenario, current_a: Array) -> dict[str, Array]:
    sensors = scenario.sensors
    shown = current_a + sensors.current_noise_a * _noise(scenario, "current", *current_a.shape)
    shown = _rounded(shown, sensors.current_resolution_a)
    return {f"wheel/{wheel + 1}/current_a": shown[:, wheel] for wheel in range(4)}


def _rounded(values: Array, resolution: float) -> Array:
    if resolution == 0:
        return values
    # The second rounding is for the reader of the file: 23.99, not 23.990000000000002.
    return np.round(np.round(values / resolution) * resolution, 9)


def _pose_columns(scenario: Scenario, truth: dict[str, Array], tick: Indices) -> dict[str, Array]:
    sensors = scenario.sensors
    rows_per_pose = scenario.rate_hz // scenario.pose_rate_hz
    seen = np.arange(len(tick)) % rows_per_pose == 0
    seen &= _stream(scenario, "dropout").random(len(tick)) >= sensors.pose_dropout_fraction
    shown_s = truth["t_s"][tick] - sensors.pose_delay_s
    noise = _noise(scenario, "pose", len(tick), 3)
    deviations = (sensors.pose_noise_m, sensors.pose_noise_m, sensors.pose_noise_rad)
    columns = {}
    for axis, (name, deviation) in enumerate(zip(POSE_COLUMNS, deviations, strict=True)):
        pose = np.interp(shown_s, truth["t_s"], truth["camera_pose"][:, axis])
        columns[name] = np.where(seen, pose + deviation * noise[:, axis], np.nan)
    return columns
