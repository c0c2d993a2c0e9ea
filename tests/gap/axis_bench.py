"""Logs of a translating axis made here, step by step, for the tests of the gap workflow.

    m v' = g u - b v - force(v) + white noise,   x' = v,   u held from row to row

integrated with 0.1 ms (Heun), far finer than the rows of 5 ms. Position is read with white noise.
The noise has the form that the predictor assumes, so its variances are known.
"""

from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise
from omnislip.gap.recordings import make_run
from omnislip.log_file import Log
from omnislip.model_file import read_model

MASS_KG, GAIN_N_V, VISCOUS_N_S_M = 10.0, 20.0, 15.0
ROW_S, FINE_S = 5e-3, 1e-4
PUSH_M2_S3 = 2e-5  # (m/s)^2 per second
PLACE_SD_M = 2e-5
SLOW_M_S = 1e-3  # dry friction is smoothed as in the believed model


@dataclass(frozen=True)
class Bench:
    """What is true: dry friction (N), extra of the forward direction (N), dead zone (V)."""

    coulomb_n: float = 0.0
    forward_n: float = 0.0
    forward_n_s_m: float = 0.0
    dead_zone_v: float = 0.0
    viscous_n_s_m: float = VISCOUS_N_S_M
    mass_kg: float = MASS_KG
    quadratic_n: float = 0.0
    """Force at 1 m/s of a drag that grows with the square of the speed."""
    ageing_n_m: float = 0.0
    """Viscous friction per second of running: an effect of no catalogue."""


@numba.njit(cache=False)
def _acceleration(t_s, v, u, c):
    forward = c[1] + c[2] * v
    smooth = np.tanh(v / SLOW_M_S)
    driven = np.sign(u) * max(abs(u) - c[3], 0.0)
    dry = c[0] * smooth + forward * smooth * (1.0 + smooth) / 2.0
    return (GAIN_N_V * driven - c[4] * v - dry - c[6] * t_s * v - c[7] * v * abs(v)) / c[5]


@numba.njit(cache=False)
def _integrate(command, pushes, constants):
    fine = pushes.shape[1]
    place = np.empty(command.size)
    x, v = 0.0, 0.0
    for row in range(command.size):
        place[row] = x
        for k in range(fine):
            v += pushes[row, k]
            first = _acceleration(row * ROW_S, v, command[row], constants)
            second = _acceleration(row * ROW_S, v + FINE_S * first, command[row], constants)
            x += FINE_S * (v + FINE_S * first / 2.0)
            v += FINE_S * (first + second) / 2.0
    return place


def multisine(rng: np.random.Generator, rows: int, volt: float = 3.0) -> np.ndarray:
    """Command (rows,): eight lines of random phase up to 4 Hz, with rests and reversals."""
    t_s = np.arange(rows) * ROW_S
    lines = np.array([1, 2, 3, 5, 8, 11, 14, 17]) / (rows * ROW_S) + 0.1
    phases = rng.uniform(0, 2 * np.pi, lines.size)
    return volt * np.sin(2 * np.pi * np.outer(t_s, lines) + phases).mean(axis=1) * 2


def make_log(bench: Bench, seed: int, duration_s: float = 5.0, noise: float = 1.0) -> Log:
    """One log of the bench; `noise` scales both noises."""
    rng = np.random.default_rng(seed)
    rows, fine = round(duration_s / ROW_S), round(ROW_S / FINE_S)
    command = multisine(rng, rows)
    pushes = noise * np.sqrt(PUSH_M2_S3 * FINE_S) * rng.standard_normal((rows, fine))
    constants = np.array(
        [
            bench.coulomb_n,
            bench.forward_n,
            bench.forward_n_s_m,
            bench.dead_zone_v,
            bench.viscous_n_s_m,
            bench.mass_kg,
            bench.ageing_n_m,
            bench.quadratic_n,
        ]
    )
    place = _integrate(command, pushes, constants)
    place += noise * PLACE_SD_M * rng.standard_normal(rows)
    columns = {"axis/command": command, "axis/position_m": place}
    return Log(f"run_{seed:02d}", np.arange(rows) * ROW_S, columns)


def model_text(tolerance: float = 0.02, effects: str = "") -> str:
    return f"""[model]
kind = "axis"

[axis]
mass_kg = {MASS_KG}
input_gain_n_v = {GAIN_N_V}
viscous_friction_n_s_m = {VISCOUS_N_S_M}

[tolerance]
default = {tolerance}

{effects}
"""


def make_machine(folder: Path, tolerance: float = 0.02, effects: str = "") -> Machine:
    """The believed axis."""
    path = folder / "axis.toml"
    path.write_text(model_text(tolerance, effects))
    return Machine(read_model(path))


def make_runs(machine: Machine, bench: Bench, seeds: range) -> list:
    return [make_run(machine, make_log(bench, seed)) for seed in seeds]


def true_noise() -> Noise:
    """The variances that make_log uses."""
    return Noise(
        np.array([PUSH_M2_S3, 0.0]),
        np.array([PLACE_SD_M**2]),
        np.array([1e-2, PLACE_SD_M**2]),
        0.0,
        0.0,
        np.log([PUSH_M2_S3, PLACE_SD_M**2]),
    )


def silent(text: str) -> None:
    """Progress that nobody reads."""
