"""Mistakes of recording: each is told, or mended, before any physics is looked for."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from omnislip.gap import find, gates
from omnislip.gap.events import Impact
from omnislip.gap.find import find_gap
from omnislip.gap.findings import to_json
from omnislip.gap.gates import (
    _lag_s,
    _speed_per_duty,
    _turn_rates,
    check,
    logged_set_points,
    too_poor,
)
from omnislip.gap.machine import Machine
from omnislip.gap.noise import RunawayError
from omnislip.gap.truth import TruthCase, write_case
from omnislip.gap.truth_effects import HiddenEffect, typical_effect
from omnislip.log_file import POSE_COLUMNS, ROBOT_OPTIONAL, Log, read_log, write_log
from omnislip.model_file import NOMINAL_ROBOT, read_model, write_model
from omnislip.scenario import Scenario, Sensors, read_scenario
from omnislip.simulate import make_log, simulate_truth

MODEL = read_model(NOMINAL_ROBOT)
MACHINE = Machine(MODEL)
POSE = ["pose/x_m", "pose/y_m", "pose/theta_rad"]
COUNTS = [f"wheel/{w}/encoder_counts" for w in range(1, 5)]
SENSORS = Sensors(gyro_noise_rad_s=0.003, pose_noise_m=0.001, pose_noise_rad=0.002)


def drive(name="run", model=MODEL, seed=0, scale=1.0, ramp_1_s=None):
    """9 s of velocities at random within the grip; or of duty steps, applied with a ramp."""
    generator = np.random.default_rng(seed)
    commands = []
    for k in range(18):
        velocity = scale * generator.uniform(-1, 1, 3) * (0.8, 0.8, 3.0)
        commands.append({"t_s": 0.5 * k, "kind": "velocity", "value": velocity.tolist()})
    if ramp_1_s is not None:
        commands = ramped_duties(seed, ramp_1_s)
    scenario = Scenario(name, 9.0, model, commands, sensors=SENSORS, seed=seed)
    return make_log(scenario, simulate_truth(scenario))


def set_points(seed):
    """Duties (18, 4), one set every half second."""
    return np.random.default_rng(seed).uniform(-0.15, 0.15, (18, 4))


def ramped_duties(seed, ramp_1_s):
    applied, now = [], np.zeros(4)
    for t_ms, target in enumerate(np.repeat(set_points(seed), 500, axis=0)):
        now = now + np.clip(target - now, -1e-3 * ramp_1_s, 1e-3 * ramp_1_s)
        applied.append({"t_s": t_ms * 1e-3, "kind": "duty", "value": now.tolist()})
    return applied


@pytest.fixture(scope="module")
def good():
    return drive()


@pytest.fixture(scope="module")
def two_logs():
    return [drive(f"run_{seed}", seed=seed) for seed in range(2)]


def spoilt(log, **columns):
    return replace(log, columns=log.columns | {k.replace("__", "/"): v for k, v in columns.items()})


def times(log, names, factor):
    return replace(log, columns=log.columns | {n: factor * log.columns[n] for n in names})


def later(log, names, delay_s, skew=0.0):
    """The columns show what was `delay_s` (+ skew times time) ago."""
    columns = dict(log.columns)
    for name in names:
        rows = ~np.isnan(columns[name])
        when = log.t_s[rows] * (1 - skew) - delay_s
        shown = columns[name].copy()
        shown[rows] = np.interp(when, log.t_s[rows], columns[name][rows])
        columns[name] = shown
    return replace(log, columns=columns)


def without(log, names):
    return replace(log, columns={n: v for n, v in log.columns.items() if n not in names})


def frozen(log, names, begin_s, end_s):
    columns = dict(log.columns)
    for name in names:
        values = columns[name].copy()
        inside = (log.t_s >= begin_s) & (log.t_s < end_s) & ~np.isnan(values)
        values[inside] = values[inside][0]
        columns[name] = values
    return replace(log, columns=columns)


def wrapped(log, bits):
    return replace(log, columns=log.columns | {n: log.columns[n] % 2**bits for n in COUNTS})


def clipped(log, limit):
    name = "gyro/z_rad_s"
    return replace(log, columns=log.columns | {name: np.clip(log.columns[name], -limit, limit)})


def in_degrees(log):
    """As a camera writes it: wrapped at half a turn."""
    heading = (log.columns[POSE[2]] + np.pi) % (2 * np.pi) - np.pi
    return replace(log, columns=log.columns | {POSE[2]: np.degrees(heading)})


MISTAKES = {
    "gyro in degrees": (lambda g: times(g, ["gyro/z_rad_s"], 57.29578), "degrees per second"),
    "gyro upside down": (lambda g: times(g, ["gyro/z_rad_s"], -1.0), "sign reversed"),
    "pose in millimetres": (lambda g: times(g, POSE[:2], 1e3), "millimetres"),
    "pose in centimetres": (lambda g: times(g, POSE[:2], 1e2), "centimetres"),
    "heading in degrees": (in_degrees, "degrees"),
    "heading upside down": (lambda g: times(g, POSE[2:], -1.0), "sign reversed"),
    "counts of quadrature": (lambda g: times(g, COUNTS, 4.0), "counts_per_rev"),
    "gyro a little late": (
        lambda g: later(g, ["gyro/z_rad_s"], 0.11),
        "gyro/z_rad_s is 0.1",
    ),
    "gyro late": (lambda g: later(g, ["gyro/z_rad_s"], 0.2), "gyro/z_rad_s is 0.2"),
    "gyro early": (lambda g: later(g, ["gyro/z_rad_s"], -0.2), "early against the encoders"),
    "gyro late, no camera": (
        lambda g: without(later(g, ["gyro/z_rad_s"], 0.3), POSE),
        "gyro/z_rad_s is 0.3",
    ),
    "camera early": (lambda g: later(g, POSE, -0.11), "s early against the gyro"),
    "camera late": (lambda g: later(g, POSE, 0.3), "the pose is 0.3"),
    "camera clock fast": (lambda g: later(g, POSE, 0.0, 0.08), "clocks apart by"),
    "counter of 12 bit": (lambda g: wrapped(g, 12), "wrap at 12 bit"),
    "counter of 10 bit": (lambda g: wrapped(g, 10), "wrap at 10 bit"),
    "gyro clipped": (lambda g: clipped(g, 0.8), "clipped at"),
    "gyro dead": (lambda g: times(g, ["gyro/z_rad_s"], 0.0), "gyro/z_rad_s does not change"),
    "gyro frozen": (lambda g: frozen(g, ["gyro/z_rad_s"], 3.0, 5.0), "from 3.00 to"),
    "camera frozen": (lambda g: frozen(g, POSE, 2.0, 4.0), "the pose does not change"),
    "supply in millivolts": (lambda g: times(g, ["supply/voltage_v"], 1e3), "is it in mV?"),
    "current in milliamperes": (lambda g: times(g, ["wheel/3/current_a"], 1e3), "is it in mA?"),
    "supply the wrong way round": (lambda g: times(g, ["supply/voltage_v"], -1.0), "exchanged?"),
    "position frozen": (
        lambda g: frozen(g, POSE[:2], 2.0, 4.0),
        "the position (pose/x_m, pose/y_m)",
    ),
    "heading frozen": (lambda g: frozen(g, POSE[2:], 2.0, 4.0), "pose/theta_rad does not change"),
    "x dead": (lambda g: times(g, POSE[:1], 0.0), "pose/x_m does not change from 0.00"),
    "y dead": (lambda g: times(g, POSE[1:2], 0.0), "pose/y_m does not change from 0.00"),
    "encoder of another wheel": (
        lambda g: spoilt(g, wheel__4__encoder_counts=g.columns[COUNTS[0]]),
        "wheel/4/encoder_counts is that of wheel 1",
    ),
    "encoder dead": (lambda g: times(g, [COUNTS[1]], 0.0), "wheel/2/encoder_counts stands still"),
}


DOUBTS = {
    "duty dead": (lambda g: times(g, ["wheel/3/duty"], 0.0), "wheel/3/duty is 0 in every row"),
    "duty of another wheel": (
        lambda g: spoilt(g, wheel__4__duty=g.columns["wheel/1/duty"]),
        "wheel/4/duty is that of wheel 1",
    ),
}


@pytest.mark.parametrize("doubt", DOUBTS)
def test_a_duty_in_doubt_costs_its_log_and_only_all_logs_the_answer(good, doubt):
    """A programme may drive two wheels alike, or one not at all; not in every log."""
    spoil, words = DOUBTS[doubt]
    bad = spoil(drive("bad", seed=1))
    some = check(MACHINE, [good, bad])
    assert some.complaint is None
    assert [log.name for log in some.logs] == [good.name]
    [told] = some.told
    assert words in told and "bad" in told and "not used" in told
    assert words in check(MACHINE, [bad]).complaint


@pytest.mark.parametrize("period_s", [0.5, 0.9, 1.3])
@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_a_wave_is_not_late_by_half_its_period(period_s, late_s):
    t_s = np.arange(0.0, 9.0, 0.01)
    noise = 0.02 * np.random.default_rng(3).standard_normal((2, len(t_s)))
    wave, shown = (np.sin(2.0 * np.pi * (t_s - t) / period_s) for t in (0.0, late_s))
    found_s, alike = _lag_s(wave + noise[0], shown + noise[1])
    assert found_s == pytest.approx(late_s, abs=0.02)
    assert alike > 0.99


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told(good, mistake):
    spoil, words = MISTAKES[mistake]
    complaint = check(MACHINE, [good, spoil(drive("bad", seed=1))]).complaint
    assert complaint is not None
    assert words in complaint
    assert "bad" in complaint
    assert "\n" not in complaint


def test_counts_do_not_jump_where_stamps_do(good):
    """Stamps 1 ms off make counts seem to jump by 220; a counter that loses 2,000 is told."""
    off_s = np.clip(np.random.default_rng(0).normal(0.0, 1e-3, len(good.t_s)), -2e-3, 2e-3)
    stamped = replace(good, t_s=good.t_s + off_s - off_s[0])
    assert gates._jumping_counts(MACHINE, stamped) is None
    counts = stamped.columns[COUNTS[1]] - 2000.0 * (np.arange(len(good.t_s)) > 700)
    lost = spoilt(stamped, wheel__2__encoder_counts=counts)
    assert "wheel/2/encoder_counts jumps by about" in gates._jumping_counts(MACHINE, lost)


@pytest.mark.parametrize(
    ("share", "off", "words"),
    [
        (1.0 / 12.0, 0.0, "times the way of the wheels"),
        (1.0 / 12.0, 0.9, None),
        (1e-3, 0.9, "is it in kilometres?"),
    ],
)
def test_wheels_that_spin_on_ice_are_no_wrong_unit(good, share, off, words):
    """A twelfth of the way of the wheels: always or, on ice, more or less. A unit shows in both."""
    windows = np.random.default_rng(0).uniform(-off, off, 100)[(good.t_s / 0.1).astype(int)]
    columns = {}
    for name in POSE[:2]:
        shown = np.interp(
            good.t_s, good.t_s[rows := ~np.isnan(good.columns[name])], good.columns[name][rows]
        )
        gone = np.cumsum(np.diff(shown, prepend=shown[0]) * (1.0 + windows) * share)
        columns[name] = np.where(rows, gone, np.nan)
    complaint = gates._wrong_scale(MACHINE, replace(good, columns=good.columns | columns))
    assert (complaint is not None) == (words is not None)
    assert words is None or words in complaint


@pytest.mark.parametrize("mistake", ["gyro in degrees", "camera late", "counter of 12 bit"])
def test_a_mistake_is_a_verdict_without_a_name(good, mistake, tmp_path):
    write_log(good, tmp_path / "good.csv")
    write_log(MISTAKES[mistake][0](good), tmp_path / "bad.csv")
    write_model(MODEL, tmp_path / "robot.toml")
    findings = find_gap(
        tmp_path / "robot.toml", [tmp_path / "good.csv", tmp_path / "bad.csv"], lambda _: None
    )
    result = to_json(findings)
    assert result["verdict"] == "insufficient_data"
    assert result["effects"] == []
    assert MISTAKES[mistake][1] in result["sentence"]


EFFECTS = [
    ("encoder_scale", 2),
    ("gyro_scale", None),
    ("gyro_bias", None),
    ("pose_latency", None),
    ("clock_skew", None),
    ("current_limit", None),
    ("driver_lag", None),
    ("low_grip", None),
    ("weak_motor", 3),
    ("encoder_dropout", 2),
]


def test_clocks_that_an_effect_can_describe_are_no_mistake(tmp_path):
    """A camera that is 0.14 s late after 12 s: clock_skew has a size for it."""
    hidden = (HiddenEffect("clock_skew", {"fraction": 0.012}).as_dict(),)
    write_case(TruthCase(seed=3, effects=hidden, runs=3, run_duration_s=12.0), tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    logs = [read_log(path, "robot") for path in sorted(tmp_path.glob("run_*.csv"))]
    assert check(machine, logs).complaint is None


@pytest.mark.parametrize("name, wheel", EFFECTS)
def test_what_an_effect_can_say_is_no_mistake(name, wheel, tmp_path):
    """Logs of the independent generator, with slip, noise, jitter and lost rows."""
    hidden = (typical_effect(name, wheel).as_dict(),)
    write_case(TruthCase(seed=3, effects=hidden, runs=3, run_duration_s=5.0), tmp_path)
    machine = Machine(read_model(tmp_path / "robot.toml"))
    logs = [read_log(path, "robot") for path in sorted(tmp_path.glob("run_*.csv"))]
    checked = check(machine, logs)
    assert (checked.complaint, checked.cuts) == (None, [])


def turning(turn_rad_s, against_m_s, body_rad_s):
    """A log of wheels that turn a body at a rate (rows,) and work against each other.

    The body turns at another one.
    """
    log = drive()
    step_s = np.gradient(log.t_s)
    rim_m_s = 0.2 * turn_rad_s[:, None] + np.outer(against_m_s, [1, -1, 1, -1])
    angle = np.cumsum(rim_m_s * step_s[:, None], axis=0) / 0.05
    noise = 0.003 * np.random.default_rng(1).standard_normal(len(log.t_s))
    columns = {
        name: np.floor(12 * 2000 * a / (2 * np.pi)) for name, a in zip(COUNTS, angle.T, strict=True)
    }
    columns |= {f"wheel/{w + 1}/duty": 0.3 * rim_m_s[:, w] for w in range(4)}
    columns |= {name: 0.0 * log.columns[name] for name in POSE}
    columns["pose/theta_rad"] += np.cumsum(body_rad_s * step_s)
    return replace(log, columns=log.columns | columns | {"gyro/z_rad_s": body_rad_s + noise})


def test_wheels_that_work_against_each_other_tell_no_scale():
    """One that grips better turns the body, whatever the wheels' mean says."""
    swing = np.sin(np.pi * drive().t_s)
    assert check(MACHINE, [turning(0.4 * swing, 0.8 * swing, 2.8 * swing)]).complaint is None
    assert check(MACHINE, [turning(0.4 * swing, 0.02 * swing, 2.8 * swing)]).complaint is not None


def test_little_turning_tells_no_scale():
    """Where wheels slide for half a second the body may turn the other way."""
    moment = np.abs(drive().t_s - 4.0)
    brief, long = 0.3 * (moment < 0.3), 0.3 * (moment < 2.0)
    nothing = 0.0 * moment
    assert check(MACHINE, [turning(-brief, nothing, brief)]).complaint is None
    assert "sign reversed" in check(MACHINE, [turning(-long, nothing, long)]).complaint


def test_hard_slip_is_no_late_sensor():
    """Duty steps beyond the grip: the body turns a tenth of a second after the wheels."""
    scenario = read_scenario(NOMINAL_ROBOT.parents[1] / "scenarios" / "identification.toml")
    checked = check(MACHINE, [make_log(scenario, simulate_truth(scenario))])
    assert (checked.complaint, checked.cuts) == (None, [])


@pytest.mark.parametrize("grip", [0.25, 0.4])
@pytest.mark.parametrize(
    ("delay_s", "told"), [(0.0, None), (0.2, r"is 0\.(19|20|21) s late against the encoders")]
)
def test_a_body_that_slips_for_long_is_no_late_gyro(grip, delay_s, told):
    """Spun to and fro without a camera: a quarter of a second and more behind the wheels, as the
    believed model is."""
    model = replace(MODEL, values=MODEL.values | {"contact.mu_drive": grip})
    commands = [
        {"t_s": t_s, "kind": "duty", "value": [0.5 * (-1.0) ** k] * 4}
        for k, t_s in enumerate([0.0, 1.2, 2.0, 3.5, 4.2, 6.0, 6.8, 8.4])
    ]
    scenario = Scenario("run", 9.4, model, commands, sensors=SENSORS, seed=1)
    log = without(make_log(scenario, simulate_truth(scenario)), POSE_COLUMNS)
    assert _lag_s(*_turn_rates(Machine(model), log)[1:])[0] > 0.25
    complaint = check(Machine(model), [later(log, ["gyro/z_rad_s"], delay_s)]).complaint
    assert re.search(told, complaint) if told else complaint is None


@settings(max_examples=60)
@given(st.sets(st.sampled_from(ROBOT_OPTIONAL)), st.sets(st.sampled_from(ROBOT_OPTIONAL)))
def test_columns_that_are_not_logged_are_no_mistake(two_logs, missing, blank):
    """Each optional column alone may be missing, or be blank in every row."""
    nothing = dict.fromkeys(blank, np.full(len(two_logs[0].t_s), np.nan))
    logs = [without(replace(g, columns=g.columns | nothing), missing) for g in two_logs]
    checked = check(MACHINE, logs)
    assert (checked.complaint, checked.cuts) == (None, [])


def straight(direction_deg, speed_m_s):
    """4 s along a line by sensors without noise, then half a second of rest."""
    along = np.deg2rad(direction_deg)
    velocity = [speed_m_s * np.cos(along), speed_m_s * np.sin(along), 0.0]
    commands = [
        {"t_s": 0.0, "kind": "velocity", "value": velocity},
        {"t_s": 4.0, "kind": "velocity", "value": [0.0, 0.0, 0.0]},
    ]
    scenario = Scenario("run", 4.5, MODEL, commands)
    return make_log(scenario, simulate_truth(scenario))


STILL = {0.0: POSE[1:2], 90.0: POSE[:1], 30.0: [COUNTS[0], COUNTS[2]]}


@pytest.mark.parametrize("direction_deg", STILL)
def test_what_rightly_does_not_change_is_not_dead(direction_deg):
    """The other coordinate of a way along x or y; two wheels that roll sideways at 30 degrees."""
    calm = times(straight(direction_deg, 0.4), STILL[direction_deg], 0.0)
    assert check(MACHINE, [calm]).complaint is None


def test_a_robot_at_rest_has_no_dead_sensors(good):
    resting = times(good, [n for n in good.columns if not n.startswith("pose/")], 0.0)
    assert check(MACHINE, [good, times(resting, POSE, 0.0)]).complaint is None


def test_an_encoder_that_is_dead_in_gentle_driving_is_told():
    """Duties too small to say at any moment that the wheel has to turn."""
    log = straight(0.0, 0.2)
    assert np.abs(log.columns["wheel/2/duty"]).max() < 0.15
    dead = times(log, [COUNTS[1]], 0.0)
    assert "wheel/2/encoder_counts never changes" in check(MACHINE, [dead]).complaint


def test_a_heading_alone_is_checked_too(good):
    upside_down = without(times(good, POSE[2:], -1.0), [*POSE[:2], "gyro/z_rad_s"])
    assert "sign reversed" in check(MACHINE, [upside_down]).complaint


# ---- gaps and jumps ----


def test_a_log_is_cut_where_rows_are_missing(good):
    kept = (good.t_s < 3.0) | (good.t_s > 3.4)
    broken = Log(good.name, good.t_s[kept], {n: v[kept] for n, v in good.columns.items()})
    [(run, time_s)] = check(MACHINE, [broken]).cuts
    assert run == good.name
    assert time_s == pytest.approx(3.0, abs=0.01)


def test_a_few_missing_rows_are_no_gap(good):
    kept = np.random.default_rng(0).random(len(good.t_s)) > 0.05
    thinned = Log(good.name, good.t_s[kept], {n: v[kept] for n, v in good.columns.items()})
    assert check(MACHINE, [thinned]).cuts == []


@settings(max_examples=15, deadline=None)
@given(st.integers(-10, 440), st.floats(0.15, 3.0), st.floats(0, 2 * np.pi))
@example(0, 0.7, 1.0)
@example(1, 0.7, 1.0)
@example(-2, 0.7, 1.0)
@example(-1, 0.7, 1.0)
def test_a_single_false_pose_is_blanked(number, size_m, bearing):
    """Be it the first or the last (negative numbers count from the end)."""
    log = drive()
    row = np.flatnonzero(~np.isnan(log.columns[POSE[0]]))[number]
    x, y = log.columns[POSE[0]].copy(), log.columns[POSE[1]].copy()
    x[row] += size_m * np.cos(bearing)
    y[row] += size_m * np.sin(bearing)
    checked = check(MACHINE, [spoilt(log, pose__x_m=x, pose__y_m=y)])
    assert (checked.complaint, checked.cuts) == (None, [])
    blank = np.isnan(checked.logs[0].columns[POSE[0]]) & ~np.isnan(log.columns[POSE[0]])
    assert np.flatnonzero(blank).tolist() == [row]


@settings(max_examples=15, deadline=None)
@given(st.integers(-10, 1700), st.sampled_from([-1e30, -20.0, 6.0, 1e3]))
@example(0, 6.0)
@example(1, 6.0)
@example(-2, 6.0)
@example(-1, 6.0)
def test_a_single_false_turn_rate_is_blanked_and_told(number, rate_rad_s):
    """Be it the first or the last (negative numbers count from the end)."""
    log = drive()
    row = number % len(log.t_s)
    shown = log.columns["gyro/z_rad_s"].copy()
    shown[row] += rate_rad_s
    checked = check(MACHINE, [spoilt(log, gyro__z_rad_s=shown)])
    assert (checked.complaint, checked.cuts) == (None, [])
    assert np.flatnonzero(np.isnan(checked.logs[0].columns["gyro/z_rad_s"])).tolist() == [row]
    assert checked.told == [f"run: false gyro/z_rad_s, not used: {log.t_s[row]:.3f} s"]


@settings(max_examples=15, deadline=None)
@given(st.floats(1.0, 8.0), st.sampled_from([(0.3, 0.0), (-1.0, 0.0), (0.0, 0.5)]))
def test_a_camera_that_starts_anew_cuts_the_log(time_s, jump):
    log = drive()
    after = log.t_s >= time_s
    x = log.columns[POSE[0]] + jump[0] * after
    theta = log.columns[POSE[2]] + jump[1] * after
    checked = check(MACHINE, [spoilt(log, pose__x_m=x, pose__theta_rad=theta)])
    assert checked.complaint is None
    [(run, cut_s)] = checked.cuts
    assert run == log.name
    assert time_s <= cut_s < time_s + 0.03
    before = np.isnan(log.columns[POSE[0]])
    np.testing.assert_array_equal(np.isnan(checked.logs[0].columns[POSE[0]]), before)


def test_a_pose_that_is_shown_again_in_motion_is_blanked(good):
    """Five pictures on end show the pose of the first; the pictures before and after stay."""
    rows = np.flatnonzero(~np.isnan(good.columns["pose/x_m"]))
    speed = np.hypot(*np.gradient([good.columns[name][rows] for name in POSE[:2]], axis=1))
    first = int(np.argmax(speed[:-10]))
    held = {name: good.columns[name].copy() for name in POSE}
    for name in POSE:
        held[name][rows[first : first + 6]] = held[name][rows[first]]
    checked = check(MACHINE, [replace(good, columns=good.columns | held)])
    kept = ~np.isnan(checked.logs[0].columns["pose/x_m"][rows])
    assert np.flatnonzero(~kept).tolist() == list(range(first + 1, first + 6))
    assert any("the camera shows the last pose again" in one for one in checked.told)


def test_poses_that_a_recorder_fills_in_are_blanked(good):
    """A recorder that writes the last picture into every row: the pictures themselves stay."""
    rows = np.flatnonzero(~np.isnan(good.columns["pose/x_m"]))
    filled = {}
    for name in POSE:
        last = np.maximum.accumulate(
            np.where(np.isnan(good.columns[name]), -1, np.arange(len(good.t_s)))
        )
        filled[name] = good.columns[name][np.maximum(last, rows[0])]
    checked = check(MACHINE, [replace(good, columns=good.columns | filled)])
    for name in POSE:
        shown = checked.logs[0].columns[name]
        np.testing.assert_array_equal(shown[rows[1:]], good.columns[name][rows[1:]])
        assert np.sum(~np.isnan(shown)) <= len(rows) + 1


def test_a_pose_that_rests_with_the_robot_stays(good):
    still = {name: np.round(good.columns[name], 2) for name in POSE}  # steps of 10 mm, 10 mrad
    checked = check(MACHINE, [replace(good, columns=good.columns | still)])
    assert not any("again" in one for one in checked.told)


def test_a_pose_that_jumps_all_the_time_is_told(good):
    x = good.columns[POSE[0]].copy()
    rows = np.flatnonzero(~np.isnan(x))[::5]
    x[rows] += 1.0
    assert "jumps again and again" in check(MACHINE, [spoilt(good, pose__x_m=x)]).complaint


# ---- several logs ----

OTHER = {
    "robot.wheel_radius_m": (1.15, "goes 1.1"),
    "robot.wheel_distance_m": (1.25, "times as far per turn"),
    "motor.gear_ratio": (1.3, "times as far per turn"),
}


@pytest.mark.parametrize("key", OTHER)
def test_a_log_of_another_robot_is_told(key):
    factor, words = OTHER[key]
    other = replace(MODEL, values=MODEL.values | {key: factor * MODEL.values[key]})
    logs = [drive(f"run_{k}", seed=k) for k in range(2)] + [drive("strange", other, seed=2)]
    complaint = check(MACHINE, logs).complaint
    assert complaint is not None
    assert "strange looks like another robot" in complaint
    assert words in complaint


def test_of_two_logs_of_two_robots_none_is_blamed():
    factor, _ = OTHER["robot.wheel_radius_m"]
    name = "robot.wheel_radius_m"
    other = replace(MODEL, values=MODEL.values | {name: factor * MODEL.values[name]})
    complaint = check(MACHINE, [drive("a", seed=0), drive("b", other, seed=1)]).complaint
    assert complaint is not None
    assert re.match(r"a and b look like two robots: a goes 0\.8\d times as far .* as b", complaint)


def test_logs_of_one_robot_are_of_one_robot():
    logs = [drive(f"run_{k}", seed=k, scale=0.3 + 0.2 * k) for k in range(4)]
    assert check(MACHINE, logs).complaint is None


@pytest.mark.parametrize("mu_drive", [0.15, 0.2, 0.25])
def test_a_robot_that_slides_in_one_log_is_the_same_robot(mu_drive):
    """Steady wheels under a body that follows slowly: 0.1 to 0.3 of the way that they turn."""
    model = replace(MODEL, values=MODEL.values | {"contact.mu_drive": mu_drive})
    pulls = [(1, 1, -1, -1), (-1, 1, 1, -1)]
    commands = [
        {
            "t_s": 1.5 * k,
            "kind": "duty",
            "value": [0.5 * (-1) ** k * way for way in pulls[k // 2 % 2]],
        }
        for k in range(6)
    ]
    scenario = Scenario("slides", 9.0, model, commands, sensors=SENSORS, seed=5)
    logs = [drive(f"run_{k}", model, seed=k, scale=0.4) for k in range(2)]
    checked = check(Machine(model), [*logs, make_log(scenario, simulate_truth(scenario))])
    assert checked.complaint is None


def test_wheels_that_turn_faster_in_other_manoeuvres_are_of_the_same_robot():
    """Weak motors that push over rollers which brake: those that spin the robot have less to do."""
    weak = {"motor.resistance_ohm": 6.0, "contact.mu_roller": 0.1}
    model = replace(MODEL, values=MODEL.values | weak)
    logs = []
    for k, ways in enumerate(([1, 1, -1, -1], [-1, 1, 1, -1], [1, 1, 1, 1])):
        commands = [
            {"t_s": 1.5 * n, "kind": "duty", "value": [0.4 * (-1) ** n * way for way in ways]}
            for n in range(6)
        ]
        scenario = Scenario(f"run_{k}", 9.0, model, commands, sensors=SENSORS, seed=k)
        logs.append(make_log(scenario, simulate_truth(scenario)))
    machine = Machine(model)
    per_duty = [np.median(_speed_per_duty(machine, log)) for log in logs]
    assert per_duty[2] > 1.2 * max(per_duty[:2])
    assert check(machine, logs).complaint is None


# ---- set-points ----


def with_set_points(log, seed):
    """The duty columns as they were wanted, not as the ramp let them through."""
    wanted = set_points(seed)
    steps = np.minimum((log.t_s + 1e-9) / 0.5, 17).astype(int)
    return replace(
        log, columns=log.columns | {f"wheel/{w + 1}/duty": wanted[steps, w] for w in range(4)}
    )


@pytest.mark.parametrize("ramp_1_s", [1.0, 4.0])
def test_set_points_in_place_of_duties_are_told(ramp_1_s):
    log = drive(seed=5, ramp_1_s=ramp_1_s)
    assert logged_set_points(MACHINE, [log], MACHINE.believed) is None
    words = logged_set_points(MACHINE, [with_set_points(log, 5)], MACHINE.believed)
    assert words is not None
    assert f"about {ramp_1_s:g} per second" in words


def test_a_model_that_loses_the_robot_tells_no_set_points(monkeypatch):
    """Where the noise of no model can be tuned, nothing is said and nothing is refused."""
    tuned = []

    def lost(*args, **options):
        tuned.append(args)
        raise RunawayError("run: its motion grows without bounds")

    monkeypatch.setattr(gates, "tune_noise", lost)
    log = with_set_points(drive(seed=5, ramp_1_s=4.0), 5)
    assert logged_set_points(MACHINE, [log], MACHINE.believed) is None
    assert tuned


# ---- poor excitation ----


def test_logs_that_show_hardly_anything_are_too_poor():
    far = {
        c.name: {
            MACHINE.file_parameter(c.parameters[k].label): 50 * c.parameters[k].scale
            for k in c.amplitudes
        }
        for c in MACHINE.candidates()
        if c.effect not in ("current_limit", "shaft_compliance")  # infinite without the effect
    }
    near = {n: {k: v / 100 for k, v in own.items()} for n, own in far.items()}
    assert too_poor(MACHINE, far) == (
        f"only 0 of {len(far)} effects would have been seen by these sensors and motions "
        "at a size worth looking for"
    )
    assert too_poor(MACHINE, near) is None


def test_pushes_that_leave_no_run_to_hold_out_are_a_verdict(tmp_path, monkeypatch):
    """A push every half second leaves no piece of a second."""
    logs = [tmp_path / f"run_{k}.csv" for k in range(2)]
    for k, path in enumerate(logs):
        write_log(drive(path.stem, seed=k), path)
    write_model(MODEL, tmp_path / "robot.toml")
    pushes = [Impact("run_1", 0.5 * k, np.zeros(3), np.zeros(3)) for k in range(1, 18)]
    monkeypatch.setattr(find, "find_impacts", lambda *_: pushes)
    findings = find_gap(tmp_path / "robot.toml", logs, lambda _: None)
    assert findings.verdict == "insufficient_data"
    assert "too little is left" in findings.sentence
