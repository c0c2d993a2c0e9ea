"""The workflow on encoders and poses: hidden slip and delays are named, series are held out."""

import dataclasses
import re

import numpy as np
import pytest
from omnislip.errors import InputError
from omnislip.gap.find import find_gap
from omnislip.gap.machine import Machine
from omnislip.gap.recordings import ODOMETRY_CHANNELS, body_errors, make_run
from omnislip.gap.split import split_runs
from omnislip.log_file import Log, write_log
from omnislip.model_file import read_model, write_model

RADIUS_M, DISTANCE_M, COUNTS = 0.05, 0.2, 12000
ANGLES_DEG = [30.0, 150.0, 210.0, 330.0]
ROW_S, FINE = 0.1, 50
MODEL = f"""[model]
kind = "odometry"
[odometry]
wheel_radius_m = {RADIUS_M}
wheel_distance_m = {DISTANCE_M}
wheel_angles_deg = {ANGLES_DEG}
counts_per_rev = {COUNTS}
"""


def make_log(
    seed,
    slip=0.0,
    delay_s=0.0,
    seconds=30.0,
    series="",
    drift=0.0,
    lost=0.0,
    slack_s2_m=0.0,
    uneven=0.0,
    swerve_rad_m=0.0,
):
    """A robot that drives smoothly at random; integrated 50 times a row, in world coordinates.

    `drift` of its speed goes along the world's y; the second encoder shows less by the share `lost`
    above 2.5 rad/s; rims move less by a share of `slack_s2_m` times what they accelerate; the third
    wheel's radius changes by the share `uneven` in a turn; moving sideways turns the robot by
    `swerve_rad_m`.
    """
    rng = np.random.default_rng(seed)
    fine_s = ROW_S / FINE
    t_s = np.arange(0.0, seconds + delay_s, fine_s)
    waves = rng.uniform(0.05, 0.5, (3, 4))[:, :, None] * 2 * np.pi * t_s
    waves = np.sin(waves + rng.uniform(0, 2 * np.pi, (3, 4))[:, :, None]).sum(axis=1)
    claimed = np.array([[0.15], [0.15], [0.3]]) * waves * np.clip(t_s - delay_s - 0.5, 0, 1)
    g = np.deg2rad(ANGLES_DEG)
    jacobian = np.stack([-np.sin(g), np.cos(g), np.full(4, DISTANCE_M)], axis=1)
    rims = jacobian @ claimed
    moved = rims * (1 - slack_s2_m * np.abs(np.gradient(rims, fine_s, axis=1)))
    moved[2] *= 1 + uneven * np.sin(np.cumsum(rims[2]) * fine_s / RADIUS_M + seed)
    true = np.linalg.pinv(jacobian) @ moved if slack_s2_m or uneven else claimed
    true = true + [[0.0], [0.0], [swerve_rad_m]] * true[1]
    rims[1] *= 1 - lost * (np.abs(rims[1]) > 2.5 * RADIUS_M)
    angles = np.cumsum(rims, axis=1) * fine_s / RADIUS_M
    heading = np.cumsum(true[2]) * fine_s
    velocity = (true[0] + 1j * (1 - slip) * true[1]) * np.exp(1j * heading)
    velocity += 1j * drift * np.hypot(claimed[0], claimed[1])
    place = np.cumsum(velocity) * fine_s
    rows = np.arange(0, round(seconds / fine_s), FINE)
    shown = rows  # the camera shows this moment, the encoders one `delay_s` later
    now = rows + round(delay_s / fine_s)
    noise = 3e-4 * rng.standard_normal((3, len(rows)))
    counts = np.round(angles[:, now] * COUNTS / (2 * np.pi))
    columns = {f"wheel/{i + 1}/encoder_counts": counts[i] for i in range(4)}
    columns |= {
        "pose/x_m": place.real[shown] + noise[0],
        "pose/y_m": place.imag[shown] + noise[1],
        "pose/theta_rad": heading[shown] + noise[2],
    }
    return Log(f"run_{seed:02d}", rows * fine_s, columns, series)


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(MODEL)
    return path


def find(folder, model, logs):
    paths = [folder / log.series / f"{log.name}.csv" for log in logs]
    for path, log in zip(paths, logs, strict=True):
        write_log(log, path)
    return find_gap(model, paths, lambda text: None)


def named(findings):
    return [s.candidate.name for s in findings.outcome.selected]


def test_lateral_slip_is_named_and_sized(tmp_path, model):
    findings = find(tmp_path, model, [make_log(seed, slip=0.05) for seed in range(6)])
    assert findings.verdict == "effect_found"
    assert named(findings) == ["lateral_slip"]
    # The only thing that errs is a believed key within its tolerance of 2 %.
    assert findings.outcome.selected[0].values[0] == pytest.approx(0.05, abs=0.01)
    assert findings.table.closed.low > 0.9
    assert findings.table.channels == ODOMETRY_CHANNELS


def test_latency_is_named_and_sized(tmp_path, model):
    findings = find(tmp_path, model, [make_log(seed, delay_s=0.14) for seed in range(6)])
    assert named(findings) == ["pose_latency"]
    assert findings.outcome.selected[0].values[0] == pytest.approx(0.14, abs=0.01)


def test_an_encoder_that_loses_counts_is_named_with_its_speed(tmp_path, model):
    findings = find(tmp_path, model, [make_log(seed, lost=0.2) for seed in range(6)])
    assert named(findings) == ["encoder_dropout (wheel 2)"]
    fraction, speed_rad_s = findings.outcome.selected[0].values
    assert fraction == pytest.approx(0.2, abs=0.01)
    # A row of 0.1 s is partly above the speed, and what either side may show is parted amid.
    assert speed_rad_s == pytest.approx(2.5, abs=0.15)


@pytest.mark.parametrize(
    "hidden, equation, size",
    [
        (
            {"drift": 0.08},
            "floor/speed_y, depending on speed",
            r"([-+.0-9]+) u, u = speed / \(([.0-9]+)",
        ),
        ({"slack_s2_m": 0.3}, "every wheel/rim speed, depending on speed, as it changes", None),
    ],
)
def test_what_no_effect_of_an_odometry_is_gets_its_law(tmp_path, model, hidden, equation, size):
    """A carpet that carries the robot along, and wheels that slip as they accelerate."""
    findings = find(tmp_path, model, [make_log(seed, **hidden) for seed in range(6)])
    assert findings.verdict == "unknown_effect"
    assert equation in findings.sentence.partition("Nearest")[0]
    if size:
        [(slope, unit)] = re.findall(size, findings.sentence)
        assert float(slope) / float(unit) == pytest.approx(hidden["drift"], rel=0.05)


def test_one_law_stands_for_several_names(tmp_path, model):
    """Moving sideways turns the robot: radii of three wheels and a marker explain it, too."""
    findings = find(tmp_path, model, [make_log(seed, swerve_rad_m=0.3) for seed in range(6)])
    assert findings.verdict == "unknown_effect"
    assert "odometry/turning, depending on speed across" in findings.sentence


def test_a_wheel_out_of_round_is_told_by_its_angle(tmp_path, model):
    """Which the logs count from where each of them begins."""
    logs = [make_log(seed, uneven=0.15) for seed in range(6)]
    findings = find(tmp_path, model, logs)
    assert findings.verdict == "unknown_effect"
    assert "wheel/3/rim speed, depending on the wheel angle" in findings.sentence


def test_a_camera_that_is_turned_is_not_told_from_a_robot_that_is(tmp_path, model):
    logs = [make_log(seed) for seed in range(6)]
    for log in logs:
        log.columns["pose/theta_rad"] += 0.1
    [found] = find(tmp_path, model, logs).outcome.selected
    assert {found.candidate.name, *found.rivals} >= {"pose_rotation", "heading_offset"}
    assert abs(found.values[0]) == pytest.approx(0.1, abs=0.005)


@pytest.mark.parametrize(
    ("turn_rad_s", "lost_s", "counted"), [(1.3, 4.0, 1.01), (-4.0, 4.0, 0.99), (4.0, 0.0, 20.0)]
)
def test_a_robot_turns_on_while_the_camera_is_lost(model, turn_rad_s, lost_s, counted):
    """By half a turn and more, which its wheels tell, or they have no say."""
    t_s = np.arange(0.0, 10.0, ROW_S)
    counts = np.round(counted * turn_rad_s * t_s * DISTANCE_M / RADIUS_M * COUNTS / (2 * np.pi))
    wrapped = (turn_rad_s * t_s + np.pi) % (2 * np.pi) - np.pi
    lost = (t_s > 2.0) & (t_s < 2.0 + lost_s)
    columns = {f"wheel/{i + 1}/encoder_counts": counts for i in range(4)}
    columns |= {"pose/x_m": np.where(lost, np.nan, 0.0), "pose/y_m": np.where(lost, np.nan, 0.0)}
    columns["pose/theta_rad"] = np.where(lost, np.nan, wrapped)
    shown = make_run(Machine(read_model(model)), Log("run", t_s, columns)).outputs[:, 2]
    np.testing.assert_allclose(shown[~lost], turn_rad_s * t_s[~lost], atol=1e-9)


def two_wheeled(seed, loss=0.0, radius=1.0):
    """A robot with a wheel on either side, which turns less than its wheels say."""
    rng = np.random.default_rng(seed)
    fine_s = ROW_S / FINE
    t_s = np.arange(0.0, 30.0, fine_s)
    waves = rng.uniform(0.05, 0.5, (2, 4))[:, :, None] * 2 * np.pi * t_s
    waves = np.sin(waves + rng.uniform(0, 2 * np.pi, (2, 4))[:, :, None]).sum(axis=1)
    speed, turning = np.array([[0.15], [0.3]]) * waves * np.clip(t_s - 0.5, 0, 1)
    rims = np.stack([DISTANCE_M * turning - speed, DISTANCE_M * turning + speed])
    rims[0] /= radius
    counts = np.round(np.cumsum(rims, axis=1) * fine_s / RADIUS_M * COUNTS / (2 * np.pi))
    heading = (1 - loss) * np.cumsum(turning) * fine_s
    place = np.cumsum(speed * np.exp(1j * heading)) * fine_s
    rows = np.arange(0, len(t_s), FINE)
    pose = np.stack([place.real, place.imag, heading])[:, rows]
    pose += 3e-4 * rng.standard_normal(pose.shape)
    columns = {f"wheel/{i + 1}/encoder_counts": counts[i, rows] for i in range(2)}
    columns |= dict(zip(("pose/x_m", "pose/y_m", "pose/theta_rad"), pose, strict=True))
    return Log(f"run_{seed:02d}", rows * fine_s, columns)


@pytest.mark.parametrize(
    "name, hidden",
    [
        ("turning_loss", {"loss": 0.08}),
        ("wheel_radius_error (wheel 1)", {"radius": 1.06}),
        (None, {}),
    ],
)
def test_two_wheels_on_an_axle_are_an_odometry_too(tmp_path, model, name, hidden):
    """Facing left (90 degrees) and right; the robot never moves sideways by itself."""
    model.write_text(MODEL.replace(str(ANGLES_DEG), "[90.0, 270.0]"))
    findings = find(tmp_path, model, [two_wheeled(seed, **hidden) for seed in range(6)])
    if name is None:
        assert findings.verdict == "no_gap"
        return
    assert findings.verdict == "effect_found"
    [found] = findings.outcome.selected
    assert name in (found.candidate.name, *found.rivals)
    assert findings.table.closed.low > 0.9


def test_a_right_model_has_no_gap(tmp_path, model):
    findings = find(tmp_path, model, [make_log(seed) for seed in range(6)])
    assert findings.verdict == "no_gap"
    assert findings.limits["lateral_slip"]["fraction"] < 0.02


def test_a_radius_that_is_wrong_beyond_its_tolerance_is_an_effect_with_its_alias(tmp_path, model):
    model.write_text(MODEL.replace(str(RADIUS_M), "0.046"))
    findings = find(tmp_path, model, [make_log(seed) for seed in range(6)])
    (effect,) = findings.outcome.selected
    assert {effect.candidate.name, *effect.rivals} >= {"wheel_radius_error", "encoder_scale"}


def with_radii(log, factors):
    """The same way driven on other wheels."""
    counts = {f"wheel/{i + 1}/encoder_counts": f for i, f in enumerate(factors)}
    turned = {name: np.round(log.columns[name] / f) for name, f in counts.items()}
    return dataclasses.replace(log, columns=log.columns | turned)


@pytest.mark.parametrize("factors", [(1.06, 1.20, 1.06, 1.06), (1.12, 1.25, 1.12, 1.12)])
def test_radii_of_all_wheels_and_of_one_stand_in_the_amended_model(tmp_path, model, factors):
    """Whichever of the two is found first; a wheel's own counts where both are given."""
    findings = find(tmp_path, model, [with_radii(make_log(seed), factors) for seed in range(6)])
    write_model(findings.amended, tmp_path / "amended.toml")
    amended = Machine(read_model(tmp_path / "amended.toml")).believed
    final = findings.outcome.final.hypothesis.flat(findings.machine.believed)
    np.testing.assert_allclose(amended, final, rtol=1e-9)
    assert named(findings)[0].startswith("wheel_radius_error")
    assert findings.table.closed.low > 0.99


def test_what_only_one_log_shows_is_said_and_not_judged(tmp_path, model):
    """Not refused as spoiling the others, of which nothing can be told."""
    logs = [make_log(seed, slip=0.05, seconds=120.0 if seed == 0 else 30.0) for seed in range(5)]
    rng = np.random.default_rng(1)
    for log in logs[1:4]:
        still = {name: 0.0 * log.columns[name] for name in log.columns}
        still |= {n: 3e-4 * rng.standard_normal(len(log.t_s)) for n in still if "pose" in n}
        log.columns.update(still)
    findings = find(tmp_path, model, logs)
    assert findings.verdict == "insufficient_data"
    (size,) = re.findall(r"lateral_slip \(fraction ([0-9.]+)\)", findings.sentence)
    assert float(size) == pytest.approx(0.05, abs=0.01)  # for the keys' tolerance, as above
    assert "too few runs show it" in findings.sentence


def test_the_amended_model_has_no_gap(tmp_path, model):
    logs = [make_log(seed, slip=0.05) for seed in range(6)]
    amended = tmp_path / "amended.toml"
    write_model(find(tmp_path, model, logs).amended, amended)
    assert find(tmp_path, amended, logs).verdict == "no_gap"


def test_series_are_held_out_whole(model):
    machine = Machine(read_model(model))
    logs = [make_log(3 * s + k, series=f"day_{s}", seconds=8.0) for s in range(3) for k in range(3)]
    split = split_runs(machine, logs)
    assert [run.name for run in split.fitting] == [f"run_{k:02d}" for k in range(6)]
    assert [run.unit for run in split.fitting] == ["day_0"] * 3 + ["day_1"] * 3
    assert [run.name for run in split.held_out] == ["run_06", "run_07", "run_08"]
    assert "series" in split.how


def test_errors_are_told_along_and_across_the_robot(model):
    run = make_run(Machine(read_model(model)), make_log(0))
    ahead = np.stack([np.cos(run.outputs[:, 2]), np.sin(run.outputs[:, 2]), 0 * run.t_s], axis=1)
    np.testing.assert_allclose(body_errors(run, ahead), [[1.0, 0.0, 0.0]] * len(run.t_s), atol=1e-9)


def test_a_log_with_another_number_of_wheels_is_refused(model):
    log = make_log(0)
    columns = {k: v for k, v in log.columns.items() if k != "wheel/4/encoder_counts"}
    with pytest.raises(InputError, match="4 wheels"):
        make_run(Machine(read_model(model)), dataclasses.replace(log, columns=columns))


def test_logs_too_short_to_be_split_are_said_to_be_too_short(tmp_path, model):
    logs = [make_log(seed, seconds=12.0) for seed in range(2)]  # a quarter is 30 rows
    findings = find(tmp_path, model, logs)
    assert findings.verdict == "insufficient_data"
    assert "50 rows" in findings.sentence


def test_wheels_that_stand_still_teach_nothing(tmp_path, model):
    log = make_log(0)
    columns = {k: 0 * v if k == "wheel/2/encoder_counts" else v for k, v in log.columns.items()}
    findings = find(tmp_path, model, [dataclasses.replace(log, columns=columns)])
    assert findings.verdict == "insufficient_data"
    assert "wheel 2" in findings.sentence


def test_parts_without_a_pose_are_left_out(tmp_path, model):
    """The camera is lost in the whole of the second part, and as the third begins."""
    log = make_log(0, slip=0.05, seconds=60.0)
    lost = (log.t_s > 8.5) & (log.t_s < 20.0)
    columns = {k: np.where(lost & k.startswith("pose/"), np.nan, v) for k, v in log.columns.items()}
    findings = find(tmp_path, model, [dataclasses.replace(log, columns=columns)])
    assert named(findings) == ["lateral_slip"]
    begins_s = [float(run.t_s[0]) for run in findings.split.fitting]
    assert begins_s == pytest.approx([0.0, 20.0, 27.0, 36.0])
