"""Sweeps: which cases a file means, what each of them simulates, and the same results anywhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from omnislip import sweep as sweep_module
from omnislip.compute import JOURNAL
from omnislip.errors import InputError
from omnislip.log_file import log_frame, read_log
from omnislip.measures import measure
from omnislip.scenario import read_scenario
from omnislip.simulate import run_scenario
from omnislip.sweep import build_scenario, checked_cases, read_sweep, run_sweep

SCENARIO = """[scenario]
duration_s = 0.5
seed = 1
[sensors]
gyro_noise_rad_s = 0.01
supply_noise_v = 0.1
[[command]]
t_s = 0.0
velocity = [1.0, 0.0, 0.5]
[[command]]
t_s = 0.3
pose = [1.0, 2.0, 0.1]
[[impact]]
t_s = 0.2
impulse_y_n_s = 5.0
"""
GRID = """[sweep]
kind = "grid"
[vary]
robot.mass_kg = [15, 20.5]
scenario.controller = ["plain", "slip"]
impact.1.impulse_y_n_s = { linear = [0, 4, 3] }
"""
RANDOM = """[sweep]
kind = "random"
cases = 500
seed = 7
[vary]
"robot.mass_kg" = { uniform = [15.0, 25.0] }
contact.slip_stiffness_s_m = { log_uniform = [10.0, 100.0] }
motor.supply_v = { normal = [24.0, 0.5] }
scenario.seed = { whole = [1, 6] }
scenario.controller = ["plain", "slip"]
"""


@pytest.fixture
def scenario(write):
    return write("drive.toml", SCENARIO)


SHIPPED = sorted((Path(sweep_module.__file__).parent / "sweeps").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_sweep_fits_the_scenario_of_its_name(path):
    scenario = path.parents[1] / "scenarios" / path.name
    assert len(checked_cases(scenario, read_sweep(path))) == 200


def quiet(_done: int, _total: int) -> None:
    pass


def columns(write, text: str) -> pd.DataFrame:
    return pd.DataFrame(read_sweep(write("sweep.toml", text)).cases)


def test_a_grid_is_every_combination_with_the_last_key_fastest(write):
    cases = read_sweep(write("sweep.toml", GRID)).cases
    expected = [
        {"robot.mass_kg": mass, "scenario.controller": name, "impact.1.impulse_y_n_s": impulse}
        for mass in (15, 20.5)
        for name in ("plain", "slip")
        for impulse in (0.0, 2.0, 4.0)
    ]
    assert cases == expected


def test_logarithmic_steps(write):
    frame = columns(write, GRID.replace("linear = [0, 4, 3]", "logarithmic = [1, 100, 3]"))
    np.testing.assert_allclose(frame["impact.1.impulse_y_n_s"][:3], [1, 10, 100])


def test_draws_follow_their_distributions(write):
    frame = columns(write, RANDOM)
    assert len(frame) == 500
    mass, stiffness = frame["robot.mass_kg"], np.log10(frame["contact.slip_stiffness_s_m"])
    supply = frame["motor.supply_v"]
    assert mass.between(15, 25).all()
    assert stiffness.between(1, 2).all()
    # 500 draws: 5 standard errors of means and deviation.
    assert abs(mass.mean() - 20) < 5 * 10 / np.sqrt(12 * 500)
    assert abs(stiffness.mean() - 1.5) < 5 / np.sqrt(12 * 500)
    assert abs(supply.mean() - 24) < 5 * 0.5 / np.sqrt(500)
    assert abs(supply.std() - 0.5) < 5 * 0.5 / np.sqrt(1000)
    assert set(frame["scenario.seed"]) == {1, 2, 3, 4, 5, 6}
    assert set(frame["scenario.controller"]) == {"plain", "slip"}


def test_draws_of_a_key_depend_on_seed_and_key_alone(write):
    frame = columns(write, RANDOM)
    more = columns(write, RANDOM.replace("500", "600"))
    pd.testing.assert_frame_equal(more[:500], frame)
    fewer_keys = RANDOM.replace("motor.supply_v = { normal = [24.0, 0.5] }\n", "")
    pd.testing.assert_frame_equal(columns(write, fewer_keys), frame.drop(columns="motor.supply_v"))
    other = columns(write, RANDOM.replace("seed = 7", "seed = 8"))
    assert not np.array_equal(other["robot.mass_kg"], frame["robot.mass_kg"])


def only_case(scenario: Path, write, key: str, value: object):
    """The scenario of the one case that gives `key` this value."""
    sweep = write("sweep.toml", f'[sweep]\nkind = "grid"\n[vary]\n{key} = [{value}]\n')
    [case] = checked_cases(scenario, read_sweep(sweep)).values()
    return build_scenario(case)


def test_any_key_of_scenario_and_robot_can_be_varied(scenario, write, robot_text):
    def with_(key: str, value: object):
        return only_case(scenario, write, key, value)

    assert with_("scenario.duration_s", 0.7).duration_s == 0.7
    assert with_("log.rate_hz", 100).rate_hz == 100
    assert with_("sensors.gyro_bias_rad_s", -0.5).sensors.gyro_bias_rad_s == -0.5
    assert with_("sensors.encoder_start_counts", [0, 1, 2, 3]).sensors.encoder_start_counts[3] == 3
    assert with_("command.1.velocity.omega_rad_s", 2.0).commands[0]["value"] == [1.0, 0.0, 2.0]
    assert with_("command.2.pose.y_m", 0.3).commands[1]["value"][:3] == [1.0, 0.3, 0.1]
    assert with_("command.2.t_s", 0.4).commands[1]["t_s"] == 0.4
    assert with_("impact.1.impulse_x_n_s", 2.0).impulses[0]["impulse_x_n_s"] == 2.0
    assert with_("robot.mass_kg", 12.0).model.values["robot.mass_kg"] == 12.0
    angles = with_("robot.wheel_angles_deg.2", 140.0).model.values["robot.wheel_angles_deg"]
    assert angles == [30.0, 140.0, 210.0, 330.0]
    [effect] = with_("effects.dead_zone.duty", 0.03).model.effects
    assert (effect.name, effect.wheel, effect.parameters) == ("dead_zone", None, {"duty": 0.03})
    [effect] = with_("effects.weak_motor.wheel_2.scale", 0.8).model.effects
    assert (effect.name, effect.wheel, effect.parameters) == ("weak_motor", 2, {"scale": 0.8})
    write("other.toml", robot_text.replace("mass_kg = 20.0", "mass_kg = 30.0"))
    assert with_("scenario.robot", '"other.toml"').model.values["robot.mass_kg"] == 30.0


def test_an_effect_that_the_model_has_is_changed_in_place(write, robot_text):
    effects = "[[effects.weak_motor]]\nwheel = 1\nscale = 0.9\n"
    effects += "[[effects.weak_motor]]\nwheel = 2\nscale = 0.95\n"
    write("weak.toml", robot_text + effects)
    text = SCENARIO.replace("[scenario]\n", '[scenario]\nrobot = "weak.toml"\n')
    case = only_case(write("drive.toml", text), write, "effects.weak_motor.wheel_2.scale", 0.5)
    found = [(effect.wheel, effect.parameters["scale"]) for effect in case.model.effects]
    assert found == [(1, 0.9), (2, 0.5)]


def test_a_case_is_the_run_of_the_changed_files(scenario, write, tmp_path, scheduler):
    out = tmp_path / "out"
    summary = run_sweep(scenario, read_sweep(write("sweep.toml", GRID)), out, scheduler, quiet)
    changed = read_scenario(scenario)
    values = changed.model.values | {"robot.mass_kg": 20.5}
    changed = replace(
        changed,
        model=replace(changed.model, values=values),
        impulses=[changed.impulses[0] | {"impulse_y_n_s": 2.0}],
        slip_compensation=False,
    )
    run = run_scenario(changed)
    row = summary.iloc[7]
    assert (row["case"], row["robot.mass_kg"], row["scenario.controller"]) == (8, 20.5, "plain")
    expected = measure(changed, run.truth)
    assert {name: row[name] for name in expected} == expected
    pd.testing.assert_frame_equal(pd.read_parquet(out / row["log"]), log_frame(run.log))
    assert len(read_log(out / row["log"], "robot").t_s) == 100
    pd.testing.assert_frame_equal(pd.read_parquet(out / "summary.parquet"), summary)


def contents(out: Path) -> dict[str, bytes]:
    return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*.parquet")}


def test_local_cluster_killed_and_resumed_sweeps_give_the_same_bytes(
    scenario, write, tmp_path, scheduler, kill_a_worker
):
    def kill_in_the_middle(done: int, _total: int) -> None:
        if done == 3:
            kill_a_worker()

    sweep = read_sweep(write("sweep.toml", GRID))
    folders = [tmp_path / name for name in ("local", "cluster", "killed", "resumed")]
    run_sweep(scenario, sweep, folders[0], None, quiet)
    run_sweep(scenario, sweep, folders[1], scheduler, quiet)
    part = replace(sweep, cases=sweep.cases[:5])
    run_sweep(scenario, part, folders[3], scheduler, quiet)
    run_sweep(scenario, sweep, folders[3], scheduler, quiet)
    run_sweep(scenario, sweep, folders[2], None, kill_in_the_middle)
    expected = contents(folders[0])
    assert len(expected) == 13
    for folder in folders[1:]:
        assert contents(folder) == expected
    assert len((folders[3] / JOURNAL).read_text().splitlines()) == 12
    with pytest.raises(InputError, match="logs of a larger sweep"):
        run_sweep(scenario, part, folders[0], None, quiet)


def test_a_case_that_cannot_be_simulated_is_a_row_with_its_reason(
    scenario, write, tmp_path, scheduler
):
    # The firmware holds speeds below 32.8 m/s.
    text = '[sweep]\nkind = "grid"\n[vary]\ncommand.1.velocity.vx_m_s = [1.0, 40.0]\n'
    sweep = read_sweep(write("sweep.toml", text))
    summary = run_sweep(scenario, sweep, tmp_path / "out", scheduler, quiet)
    assert summary["error"][0] == ""
    assert "out of the firmware's range" in summary["error"][1]
    assert pd.isna(summary["log"][1])
    assert np.isnan(summary["energy_j"][1])
    bad = read_sweep(write("sweep.toml", text.replace("[1.0, 40.0]", "[40.0]")))
    with pytest.raises(InputError, match=r"no case can be simulated; the first: .* range"):
        run_sweep(scenario, bad, tmp_path / "bad", scheduler, quiet)


MISTAKES = {
    "table": (GRID, "[vary]", "[varied]", ["unknown table 'varied'", "'vary'"]),
    "kind": (GRID, '"grid"', '"all"', ["sweep.kind", "grid, random", "'all'"]),
    "no kind": (GRID, 'kind = "grid"\n', "", ["sweep.kind", "grid, random"]),
    "key": (RANDOM, "cases = 500", "count = 500", ["unknown key in [sweep] 'count'"]),
    "cases of a grid": (GRID, 'kind = "grid"', 'kind = "grid"\ncases = 3', ["sweep.cases"]),
    "no cases": (RANDOM, "cases = 500\n", "", ["sweep.cases", "1 or more"]),
    "half a case": (RANDOM, "cases = 500", "cases = 0.5", ["sweep.cases", "whole number"]),
    "many cases": (RANDOM, "cases = 500", "cases = 200000", ["100000", "200000"]),
    "large grid": (GRID, "[0, 4, 3]", "[0, 4, 90000]", ["100000", "360000"]),
    "seed": (RANDOM, "seed = 7", "seed = -7", ["sweep.seed", "0 or more"]),
    "empty list": (GRID, "[15, 20.5]", "[]", ["vary.robot.mass_kg", "empty"]),
    "single value": (GRID, "[15, 20.5]", "15", ["vary.robot.mass_kg", "list of values"]),
    "draw in a grid": (GRID, "[15, 20.5]", "{ uniform = [1, 2] }", ["linear", "logarithmic"]),
    "steps at random": (RANDOM, "whole = [1, 6]", "linear = [1, 6, 2]", ["uniform", "normal"]),
    "limits turned": (RANDOM, "[15.0, 25.0]", "[25.0, 15.0]", ["robot.mass_kg", "smaller"]),
    "log of zero": (RANDOM, "[10.0, 100.0]", "[0.0, 100.0]", ["log_uniform", "greater than 0"]),
    "one limit": (RANDOM, "[15.0, 25.0]", "[15.0]", ["vary.robot.mass_kg.uniform", "2 numbers"]),
    "deviation": (RANDOM, "[24.0, 0.5]", "[24.0, -0.5]", ["supply_v", "deviation"]),
    "part of a whole": (RANDOM, "[1, 6]", "[1, 6.5]", ["scenario.seed", "whole numbers"]),
    "one step": (GRID, "[0, 4, 3]", "[0, 4, 1]", ["third number of linear", "2 or more"]),
    "nothing varied": ('[sweep]\nkind = "grid"\n', "", "", ["[vary] needs at least one key"]),
    "robot key": (GRID, "robot.mass_kg", "robot.mas_kg", ["case 1:", "'robot.mass_kg'?"]),
    "robot table": (GRID, "robot.mass_kg", "rob.mass_kg", ["case 1:", "unknown table 'rob'"]),
    "robot value": (GRID, "[15, 20.5]", "[15, -1]", ["case 7:", "greater than 0, not -1"]),
    "scenario value": (GRID, '"slip"]', '"fast"]', ["case 4:", "scenario.controller"]),
    "third impact": (GRID, "impact.1", "impact.3", ["case 1:", "'3' must be one of 1"]),
    "axis": (GRID, "robot.mass_kg", "command.1.velocity.x", ["'x' must be one of vx_m_s, vy_m_s"]),
    "below a number": (GRID, "robot.mass_kg", "robot.mass_kg.x", ["nothing can be below 20.0"]),
    "effect": (GRID, "robot.mass_kg", "effects.deadzone.duty", ["'dead_zone'?"]),
    "effect alone": (GRID, "robot.mass_kg", "effects.payload", ["effects.NAME.PARAMETER"]),
    "wheel": (GRID, "robot.mass_kg", "effects.weak_motor.wheel_5.scale", ["effects.NAME.wheel_1"]),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_named_before_anything_is_simulated(case, scenario, write):
    text, old, new, words = MISTAKES[case]
    assert old in text
    path = write("sweep.toml", text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        checked_cases(scenario, read_sweep(path))
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert [word for word in words if word not in message] == []
    assert "\n" not in message
