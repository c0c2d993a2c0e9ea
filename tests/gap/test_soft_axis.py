"""A drive of two masses, integrated exactly: the workflow names its spring."""

import numpy as np
import pytest
from axis_bench import GAIN_N_V, MASS_KG, VISCOUS_N_S_M, model_text, silent
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.log_file import Log, write_log
from scipy.signal import cont2discrete

STIFFNESS_N_M, DAMPING_N_S_M, LOAD_SHARE = 1.2e5, 60.0, 0.35
ROW_S, ROWS, RUNS = 2e-3, 2000, 6
PLACE_SD_M = 2e-6


def two_masses() -> tuple[np.ndarray, np.ndarray]:
    """Rates and drive of the state: motor speed and position, load speed and position."""
    motor, load = (1.0 - LOAD_SHARE) * MASS_KG, LOAD_SHARE * MASS_KG
    k, c = STIFFNESS_N_M, DAMPING_N_S_M
    rates = [
        [-(c + VISCOUS_N_S_M) / motor, -k / motor, c / motor, k / motor],
        [1.0, 0.0, 0.0, 0.0],
        [c / load, k / load, -c / load, -k / load],
        [0.0, 0.0, 1.0, 0.0],
    ]
    return np.array(rates), np.array([[GAIN_N_V / motor], [0.0], [0.0], [0.0]])


def one_mass() -> tuple[np.ndarray, np.ndarray]:
    """Rates and drive of the state: speed and position."""
    rates = [[-VISCOUS_N_S_M / MASS_KG, 0.0], [1.0, 0.0]]
    return np.array(rates), np.array([[GAIN_N_V / MASS_KG], [0.0]])


def make_log(seed: int, drive: tuple[np.ndarray, np.ndarray]) -> Log:
    """One log of a multisine up to 60 Hz; the command stays from row to row, noise on the place."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(ROWS) * ROW_S
    lines_hz = np.array([0.6, 1.4, 3.1, 7.3, 15.0, 27.0, 41.0, 60.0])
    phases = rng.uniform(0, 2 * np.pi, lines_hz.size)
    command = 2.0 * np.sin(2 * np.pi * np.outer(t_s, lines_hz) + phases).mean(axis=1)
    rates, driven = drive
    step, push, *_ = cont2discrete((rates, driven, np.eye(len(rates)), 0 * driven), ROW_S)
    state, place = np.zeros(len(rates)), np.empty(ROWS)
    for row in range(ROWS):
        place[row] = state[1]
        state = step @ state + push[:, 0] * command[row]
    place += PLACE_SD_M * rng.standard_normal(ROWS)
    return Log(f"run{seed}", t_s, {"axis/command": command, "axis/position_m": place})


def find(folder, drive):
    (folder / "axis.toml").write_text(model_text(tolerance=0.05))
    paths = [folder / f"run{seed}.csv" for seed in range(RUNS)]
    for seed, path in enumerate(paths):
        write_log(make_log(seed, drive), path)
    return to_json(find_gap(folder / "axis.toml", paths, silent))


def test_the_spring_of_a_two_mass_drive_is_named_with_its_sizes(tmp_path):
    found = find(tmp_path, two_masses())
    assert found["verdict"] == "effect_found"
    [effect] = found["effects"]
    assert effect["name"] == "shaft_compliance"
    # Forces and masses have a common factor that positions cannot show.
    factor = found["base"]["axis.mass_kg"]["fitted"] / MASS_KG
    sizes = {**effect["parameters"], **effect["refinement"]}
    assert sizes["stiffness_n_m"]["value"] / factor == pytest.approx(STIFFNESS_N_M, rel=0.01)
    assert sizes["damping_n_s_m"]["value"] / factor == pytest.approx(DAMPING_N_S_M, rel=0.05)
    assert sizes["load_share"]["value"] == pytest.approx(LOAD_SHARE, abs=0.01)


def test_a_drive_that_moves_as_one_gets_no_spring(tmp_path):
    found = find(tmp_path, one_mass())
    assert "shaft_compliance" not in [e["name"] for e in (*found["effects"], *found["nearest"])]
    assert found["verdict"] != "effect_found"
