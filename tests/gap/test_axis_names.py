"""What single axes lack: waves along a way, weights at a pendulum.

Made here, step by step (Heun, 0.1 ms), without the code of the plant:

    M q'' = g u - e q' - m g l sin q - T sin(n q)
"""

from dataclasses import dataclass

import numba
import numpy as np
import pytest
from axis_bench import silent
from omnislip.gap import waves
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import make_run
from omnislip.log_file import Log, write_log
from omnislip.model_file import read_model

FINE_S, ROW_S, GRAVITY_M_S2 = 1e-4, 5e-3, 9.81
SLIDE = {"mass_kg": 20.0, "input_gain_n_v": 30.0, "back_emf_n_s_m": 60.0}
SERVO = {
    "inertia_kg_m2": 0.006,
    "input_gain_nm_v": 0.1,
    "back_emf_nm_s_rad": 0.05,
    "pendulum_mass_kg": 0.5,
    "pendulum_length_m": 0.1,
}


@dataclass(frozen=True)
class Missing:
    """Of the machine, what its model does not have."""

    wave: float = 0.0
    waves_per_unit: float = 0.0
    payload_kg: float = 0.0


@numba.njit(cache=False)
def _acceleration(q, v, u, c):
    inertia, gain, emf, weight, wave, n = c
    return (gain * u - emf * v - weight * np.sin(q) - wave * np.sin(n * q)) / inertia


@numba.njit(cache=False)
def _integrate(command, c, fine):
    place = np.empty(command.size)
    q, v = 0.0, 0.0
    for row in range(command.size):
        place[row] = q
        for _ in range(fine):
            first = _acceleration(q, v, command[row], c)
            second = _acceleration(q + FINE_S * v, v + FINE_S * first, command[row], c)
            q += FINE_S * (v + FINE_S * first / 2.0)
            v += FINE_S * (first + second) / 2.0
    return place


def make_log(axis: dict[str, float], missing: Missing, seed: int, volt: float) -> Log:
    """Six seconds of slow waves and steps, the place with noise."""
    rng = np.random.default_rng(seed)
    turns = "inertia_kg_m2" in axis
    t_s = np.arange(0.0, 6.0, ROW_S)
    rates_hz = np.array([0.25, 0.45, 0.8, 1.3]) * rng.uniform(0.9, 1.1, 4)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    command = volt * np.sin(2.0 * np.pi * np.outer(t_s, rates_hz) + phases).mean(axis=1)
    command += 0.3 * volt * np.repeat(rng.choice([-1.0, 0.0, 1.0], 12), len(t_s) // 12)
    inertia, gain, emf = list(axis.values())[:3]
    length_m = axis.get("pendulum_length_m", 0.0)
    hanging_kg = axis.get("pendulum_mass_kg", 0.0) + missing.payload_kg
    constants = (
        inertia + missing.payload_kg * length_m**2,
        gain,
        emf,
        hanging_kg * length_m * GRAVITY_M_S2,
        missing.wave,
        missing.waves_per_unit,
    )
    place = _integrate(command, constants, round(ROW_S / FINE_S))
    place += (3e-4 if turns else 2e-5) * rng.standard_normal(len(place))
    column = "axis/position_rad" if turns else "axis/position_m"
    return Log(f"run_{seed}", t_s, {"axis/command": command, column: place})


def files(folder, axis, missing, volt, runs=5):
    keys = "".join(f"{key} = {value}\n" for key, value in axis.items())
    model = folder / "axis.toml"
    model.write_text(f'[model]\nkind = "axis"\n\n[axis]\n{keys}')
    paths = [folder / f"run_{seed}.csv" for seed in range(runs)]
    for seed, path in enumerate(paths):
        write_log(make_log(axis, missing, seed, volt), path)
    return model, paths


def names(folder, axis, missing, volt):
    found = to_json(find_gap(*files(folder, axis, missing, volt), silent))
    return {effect["name"]: effect["parameters"] for effect in found["effects"]}


@pytest.mark.parametrize("waves_per_m", [37.0, 150.0, 400.0])
def test_waves_along_a_way_show_in_accelerations(tmp_path, waves_per_m):
    missing = Missing(wave=6.0, waves_per_unit=waves_per_m)
    model, _ = files(tmp_path, SLIDE, missing, 3.0, runs=0)
    machine = Machine(read_model(model))
    runs = [make_run(machine, make_log(SLIDE, missing, seed, 3.0)) for seed in range(4)]
    way_m = np.ptp(np.concatenate([run.outputs[:, 0] for run in runs]))
    off = waves.waves_along(runs, turns=False)[0] - waves_per_m
    assert abs(off) * way_m < np.pi  # half a wave over all of it: from there a fit finds the rest


def test_an_axis_that_does_not_move_shows_no_waves(tmp_path):
    """Then nothing says where to look for any."""
    model, _ = files(tmp_path, SLIDE, Missing(), 3.0, runs=0)
    machine = Machine(read_model(model))
    still = make_run(machine, make_log(SLIDE, Missing(), 0, 3.0))
    assert "cogging" in {c.effect for c in machine.candidates_for([still])}
    still.outputs[:] = 0.0
    assert waves.waves_along([still], turns=False) == []
    assert "cogging" not in {c.effect for c in machine.candidates_for([still])}


def test_the_waves_of_a_slide_are_named_with_their_length(tmp_path):
    found = names(tmp_path, SLIDE, Missing(wave=6.0, waves_per_unit=150.0), 3.0)
    assert set(found) == {"cogging"}
    assert found["cogging"]["cycles_per_m_2pi"]["value"] == pytest.approx(150.0, rel=1e-3)
    assert found["cogging"]["force_n"]["value"] == pytest.approx(6.0, rel=0.05)


def test_a_weight_at_the_end_of_a_pendulum_is_a_payload(tmp_path):
    found = names(tmp_path, SERVO, Missing(payload_kg=0.1), 7.0)
    assert set(found) == {"payload"}
    assert found["payload"]["mass_kg"]["value"] == pytest.approx(0.1, rel=0.1)
