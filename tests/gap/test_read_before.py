"""Are electric sensors read before the command of their row begins, or after?"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from omnislip.gap import answers
from omnislip.gap.answers import likelier_held
from omnislip.gap.evaluate import evaluate_model
from omnislip.gap.first_models import SURELY_MISTAKEN, first_models
from omnislip.gap.machine import Machine
from omnislip.gap.noise import track_all, tune_noise
from omnislip.gap.read_before import reading_machine
from omnislip.gap.recordings import ELECTRIC_CHANNELS, READ_AMID, ROBOT_CHANNELS, make_run
from omnislip.gap.words import READ_BEFORE
from omnislip.log_file import Log, write_log
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model, write_model

MODEL = replace(
    read_model(NOMINAL_ROBOT), effects=[Effect("supply_sag", {"source_resistance_ohm": 0.1})]
)
MACHINE = Machine(MODEL, electric=True)
ROW_S, ROWS = 0.005, 500
NOISE = np.array([0.0] * 4 + [5e-3, 1e-3, 1e-3, 1e-3, 0.02] + [0.05] * 4)


def shown(machine, duty, read_before=None, row_s=ROW_S):
    """What the sensors of a robot show (rows, outputs) that starts from rest."""
    t_s, engine = row_s * np.arange(len(duty)), machine.engine
    run = machine.recording(t_s, duty, np.zeros((len(duty), engine.outputs)), np.zeros(14))
    run = run if read_before is None else run.reading_before(read_before)
    none, one = np.zeros(engine.states), np.ones(engine.outputs)
    tracks = engine.track([run], machine.believed, none, one, none)
    return -engine.replays([run], tracks, machine.believed[None], 5e-4, 1e9)[0][0]


def swaying(rng):
    """Duties that a controller at its rate sets anew in every row."""
    duty = np.cumsum(0.03 * rng.standard_normal((ROWS, 4)), axis=0)
    duty -= np.linspace(0.0, 1.0, ROWS)[:, None] * duty[-1]
    return np.clip(duty, -0.5, 0.5)


def waving(rng):
    t_s = ROW_S * np.arange(ROWS)[:, None]
    return 0.4 * np.sin(2.0 * np.pi * rng.uniform(1.0, 3.0, 4) * t_s + rng.uniform(0.0, 6.0, 4))


def violent(rng):
    return np.repeat(rng.uniform(-0.8, 0.8, (ROWS // 50, 4)), 50, axis=0)


def log_of(seed, before=False, effect=None, driven=swaying, model=MODEL):
    """A log of duties as a controller sets them, with noise."""
    rng = np.random.default_rng(seed)
    duty = driven(rng)
    model = replace(model, effects=[*model.effects, effect] if effect else model.effects)
    outputs = shown(Machine(model, electric=True, holds_commands=True, reads_before=before), duty)
    outputs[:, :4] *= MODEL.values["encoder.counts_per_rev"] / (2.0 * np.pi)
    outputs[:, :4] = np.round(outputs[:, :4])
    outputs += NOISE * rng.standard_normal(outputs.shape)
    outputs[np.arange(ROWS) % 4 > 0, 5:8] = np.nan
    columns = {f"wheel/{w + 1}/duty": duty[:, w] for w in range(4)}
    columns |= dict(zip((*ROBOT_CHANNELS, *ELECTRIC_CHANNELS), outputs.T, strict=True))
    return Log(f"log_{seed}", ROW_S * np.arange(ROWS), columns)


def logs_of(sensors=ELECTRIC_CHANNELS, **how):
    logs = [log_of(seed, **how) for seed in range(3)]
    left_out = set(ELECTRIC_CHANNELS) - set(sensors)
    return [
        replace(log, columns={n: v for n, v in log.columns.items() if n not in left_out})
        for log in logs
    ]


def test_a_current_read_before_is_that_of_the_row_before_at_the_speed_of_now():
    """(8): the command of the row before; another row's makes V / R of the difference."""
    rng = np.random.default_rng(4)
    duty = rng.uniform(-0.3, 0.3, (40, 4))
    plain = read_model(NOMINAL_ROBOT)  # no sag
    after, before = (
        shown(Machine(plain, electric=True, holds_commands=True, reads_before=read), duty)
        for read in (False, True)
    )
    np.testing.assert_array_equal(after[:, :9], before[:, :9])
    np.testing.assert_array_equal(after[0], before[0])
    stall_a = plain.values["motor.supply_v"] / plain.values["motor.resistance_ohm"]
    np.testing.assert_allclose(
        (after - before)[1:, 9:], stall_a * np.diff(duty, axis=0), rtol=1e-9, atol=1e-9
    )


def test_where_nothing_tells_currents_flow_under_half_of_both_commands():
    rng = np.random.default_rng(5)
    duty = rng.uniform(-0.3, 0.3, (40, 4))
    machine = Machine(read_model(NOMINAL_ROBOT), electric=True)
    after, amid, before = (shown(machine, duty, share) for share in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(amid, 0.5 * (after + before), rtol=1e-9, atol=1e-9)
    with pytest.raises(ValueError, match=r"share must be within 0\.\.1"):
        shown(machine, duty, 1.5)


def test_of_commands_that_move_either_is_read_of_held_ones_what_the_machine_reads():
    for before in (False, True):
        machine = Machine(MODEL, electric=True, holds_commands=True, reads_before=before)
        run = make_run(machine, log_of(2, before=before))
        moving = run.moving_in_rows()
        assert moving.recording.read_before == READ_AMID
        for held in (run, moving.held_in_rows(), moving.set_with_rows()):
            assert held.recording.read_before == before
        assert make_run(machine.of(MODEL, holds_commands=False), log_of(2)).recording.read_before
    assert make_run(MACHINE, log_of(2)).recording.read_before == READ_AMID


def test_steps_of_a_loop_at_the_rate_of_a_camera_pull_no_current_one_way():
    """A set point runs away from what a camera shows, until it shows the next: commands step back
    every 20 ms, at a tick that as often is before the row's begin as behind it."""
    rng = np.random.default_rng(6)
    ticks = np.arange(4000)
    way = np.sin(2e-3 * np.pi * np.outer(ticks, [0.5, 0.7, 0.9, 1.1]))
    duty = 0.25 * way + 0.1 * np.sign(way) * ((ticks % 20) / 20.0 - 0.5)[:, None]
    plain = read_model(NOMINAL_ROBOT)
    outputs = shown(Machine(plain, electric=True), duty, 1.0, row_s=1e-3)
    rows = np.arange(0, len(ticks), 5) + rng.integers(-1, 2, len(ticks) // 5)
    rows[0] = 0
    mean = np.add.reduceat(duty, rows) / np.diff(rows, append=len(ticks))[:, None]
    machine = Machine(plain, electric=True)
    columns = {f"wheel/{w + 1}/duty": mean[:, w] for w in range(4)}
    columns |= dict(zip((*ROBOT_CHANNELS, *ELECTRIC_CHANNELS), outputs[rows].T, strict=True))
    for wheel in range(4):
        columns[ROBOT_CHANNELS[wheel]] *= plain.values["encoder.counts_per_rev"] / (2.0 * np.pi)
    columns["supply/voltage_v"] += 0.01 * rng.standard_normal(len(rows))
    run = make_run(machine, Log("loop", 1e-3 * rows, columns))
    noise = tune_noise(machine, [run], machine.believed)
    along = np.sign(mean)
    pulled = []
    for share in (READ_AMID, 0.0):
        recording = run.recording.reading_before(share)
        [track] = track_all(machine, [replace(run, recording=recording)], machine.believed, noise)
        off_a = track.innovation.reshape(run.outputs.shape)[:, -4:]
        pulled.append(np.nanmean(off_a * along))
    assert abs(pulled[0]) < 0.25 * abs(pulled[1])


@pytest.mark.parametrize(
    "sensors", [ELECTRIC_CHANNELS[:1], ELECTRIC_CHANNELS[1:], ELECTRIC_CHANNELS]
)
def test_what_electric_sensors_show_tells_when_they_are_read(sensors):
    before = reading_machine(MACHINE, logs_of(sensors, before=True))
    assert before.reads_before
    assert before.holds_commands
    assert reading_machine(MACHINE, logs_of(sensors)) is MACHINE


@pytest.mark.parametrize("share", [0.0, 2.0 * answers.ROW_BY_ROW])
def test_currents_show_that_commands_are_held_whatever_they_answer(share, monkeypatch):
    monkeypatch.setattr(answers, "news_of", lambda *_: SimpleNamespace(share=share))
    runs = [make_run(MACHINE, log) for log in logs_of()]
    noise = tune_noise(MACHINE, runs, MACHINE.believed)
    assert SURELY_MISTAKEN < likelier_held(MACHINE, runs, MACHINE.believed, noise) < np.inf


@pytest.mark.parametrize("before", [False, True])
def test_behind_a_missing_row_nobody_knows_under_what_an_early_reading_was(before):
    """Nor in the first one; the last row's own command is never known."""
    lost, log = 40, log_of(1, before=before)
    kept = np.arange(ROWS) != lost
    short = Log(log.name, log.t_s[kept], {n: v[kept] for n, v in log.columns.items()})
    machine = Machine(MODEL, electric=True, holds_commands=True, reads_before=before)
    blank = np.isnan(make_run(machine, short).outputs[:, len(ROBOT_CHANNELS) :]).all(axis=1)
    assert np.flatnonzero(blank).tolist() == [0, *([lost] if before else []), ROWS - 2]


def test_an_inductance_that_makes_currents_late_is_no_early_reading():
    coil = Effect("armature_inductance", {"inductance_h": 4e-3})
    assert reading_machine(MACHINE, logs_of(effect=coil)) is MACHINE


@pytest.mark.parametrize("before", [False, True])
def test_where_shafts_race_most_logs_tell_when_sensors_are_read(before):
    """Light shafts, driven violently: the mean of two rows is no speed at the row between them."""
    model = replace(MODEL, values=MODEL.values | {"motor.inertia_kg_m2": 2.5e-6})
    machine = Machine(model, electric=True)
    calm, jerked = (
        [log_of(seed, before, driven=driven, model=model) for seed in range(2)]
        for driven in (waving, violent)
    )
    assert reading_machine(machine, [*calm, jerked[0]]).reads_before is before
    assert reading_machine(machine, [calm[0], *jerked]) is machine


def test_robots_without_these_sensors_read_as_they_did():
    machine = Machine(MODEL)
    assert reading_machine(machine, logs_of(sensors=())) is machine


@pytest.mark.parametrize("late", [False, True], ids=["read before", "all a row late"])
def test_a_command_that_acts_a_row_late_is_no_early_reading_either(late):
    """Both show the same currents; only where it acts late does the motion come late, too."""
    delay = Effect("actuation_delay", {"delay_s": ROW_S})
    logs = logs_of(effect=delay) if late else logs_of(before=True)
    machine = reading_machine(MACHINE, logs)
    assert machine.reads_before
    found, _, _ = first_models(machine, [make_run(machine, log) for log in logs])
    assert found.reads_before is not late


@pytest.mark.parametrize("late", [False, True], ids=["read before", "all a row late"])
@pytest.mark.parametrize("known", [False, True], ids=["believed", "amended"])
def test_evaluating_a_model_takes_the_readings_as_a_search_does(late, known, tmp_path):
    """Of a model that lacks nothing currents miss by their noise, of 0.05 A, and little more."""
    delay = Effect("actuation_delay", {"delay_s": ROW_S})
    logs = logs_of(effect=delay) if late else logs_of(before=True)
    model = replace(MODEL, effects=[*MODEL.effects, delay]) if late and known else MODEL
    write_model(model, tmp_path / "robot.toml")
    paths = [tmp_path / f"{log.name}.csv" for log in logs]
    for log, path in zip(logs, paths, strict=True):
        write_log(log, path)
    figures = evaluate_model(tmp_path / "robot.toml", paths, lambda _: None)
    assert (READ_BEFORE in figures["recording"]) is not late
    for channel in ELECTRIC_CHANNELS[1:]:
        assert (figures["channels"][channel]["rmse"] < 0.1) == (known or not late)
