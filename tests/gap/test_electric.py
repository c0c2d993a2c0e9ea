"""Bus voltage and motor currents as outputs: right, of use, and absent where not logged."""

from dataclasses import replace

import numpy as np
import pytest
from omnislip import _core
from omnislip.gap import plan as planning
from omnislip.gap.inference import Hypothesis
from omnislip.gap.machine import Machine
from omnislip.gap.noise import first_guess, track_recordings
from omnislip.gap.plan import Limits, Rehearsal
from omnislip.gap.recordings import ELECTRIC_CHANNELS, ROBOT_CHANNELS, machine_for, make_run
from omnislip.gap.wiring import mend
from omnislip.model_file import NOMINAL_ROBOT, Effect, read_model
from omnislip.scenario import Scenario, Sensors
from omnislip.simulate import make_log, simulate_truth

MODEL = read_model(NOMINAL_ROBOT)
SAG = Effect("supply_sag", {"source_resistance_ohm": 0.1})


def driven(model, rate_hz=1000, sensors=None):
    """1.5 s of duty steps after a rest; at 1 kHz a row holds the very duty of its tick."""
    duties = np.random.default_rng(0).uniform(-0.3, 0.3, (6, 4)).tolist()
    commands = [{"t_s": 0.1 + 0.2 * k, "kind": "duty", "value": d} for k, d in enumerate(duties)]
    scenario = Scenario("run", 1.5, model, commands, rate_hz=rate_hz, sensors=sensors or Sensors())
    return make_log(scenario, simulate_truth(scenario))


def certain(machine, log):
    """Recording of a robot that is known to start from rest in its first row."""
    run, engine = make_run(machine, log), machine.engine
    rest = (np.zeros(engine.states), 0.25, np.zeros(engine.states + engine.pushes))
    return machine.recording(run.t_s, run.command, run.outputs, *rest).rising(run.rise)


def replayed(machine, log):
    """Measured minus replayed outputs from the first row on, nothing corrected."""
    recording, engine = certain(machine, log), machine.engine
    none, one = np.zeros(engine.states), np.ones(engine.outputs)
    tracks = engine.track([recording], machine.believed, none, one, none)
    return engine.replays([recording], tracks, machine.believed[None], 5e-4, 1e9)[0][0]


@pytest.mark.parametrize(
    "effects",
    [[], [SAG], [Effect("armature_inductance", {"inductance_h": 1e-3}), SAG]],
    ids=["plain", "sag", "memory"],
)
def test_the_model_that_made_a_log_shows_its_volts_and_amperes(effects):
    """The same plant in the closed loop: what is left is the step of the integration."""
    model = replace(MODEL, effects=effects)
    log = driven(model)
    errors = replayed(Machine(model, electric=True), log)
    currents = np.stack([log.columns[name] for name in ELECTRIC_CHANNELS[1:]], 1)
    assert np.abs(currents).max() > 3.0
    assert np.abs(errors[:, 9:]).max() < 0.01 * np.abs(currents).max()
    assert np.abs(errors[:, 8]).max() < 0.01


def test_the_other_outputs_keep_every_bit():
    log = driven(replace(MODEL, effects=[SAG]), rate_hz=200)
    plain, electric = (replayed(Machine(MODEL, e), log) for e in (False, True))
    np.testing.assert_array_equal(electric[:, :8], plain)


def test_lanes_of_every_width_agree():
    log = driven(replace(MODEL, effects=[SAG]), rate_hz=200)
    machine = Machine(MODEL, electric=True)
    sets = np.tile(machine.believed, (5, 1))
    sets[:, 0] *= np.linspace(0.9, 1.1, 5)
    found = []
    for lanes in (2, 8):
        engine = _core.Engine("robot", lanes, electric=True)
        recording = certain(machine, log)
        none, one = np.zeros(engine.states), np.ones(engine.outputs)
        tracks = engine.track([recording], sets[0], none, one, none)
        found.append(engine.innovations([recording], tracks, sets)[0])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-9)


# ---- when ----


def test_logs_without_these_columns_cost_nothing():
    log = driven(MODEL, 200)
    kept = {n: v for n, v in log.columns.items() if n not in ELECTRIC_CHANNELS}
    machine = machine_for(MODEL, [replace(log, columns=kept)])
    assert machine.engine.outputs == len(ROBOT_CHANNELS) == 8


def test_one_current_is_enough_and_the_rest_counts_as_not_sampled():
    log = driven(MODEL, 200)
    kept = {n: v for n, v in log.columns.items() if n not in ELECTRIC_CHANNELS[:4]}
    machine = machine_for(MODEL, [replace(log, columns=kept)])
    run = make_run(machine, replace(log, columns=kept))
    assert run.channels == (*ROBOT_CHANNELS, *ELECTRIC_CHANNELS)
    sampled = ~np.isnan(run.outputs).all(axis=0)
    assert sampled[8:].tolist() == [False] * 4 + [True]


def test_a_constant_that_stands_in_for_a_measurement_is_none():
    log = driven(MODEL, 200)
    for value in (24.0, np.nan):
        flat = {name: np.full(len(log.t_s), value) for name in ELECTRIC_CHANNELS}
        assert not machine_for(MODEL, [replace(log, columns=log.columns | flat)]).electric


def test_a_reversed_motor_turns_its_current_too():
    log = driven(MODEL, 200)
    mended = mend(log, [Effect("motor_sign", {}, 2)])
    for signal in ("duty", "current_a"):
        name = f"wheel/2/{signal}"
        np.testing.assert_array_equal(mended.columns[name], -log.columns[name])


@pytest.mark.parametrize(
    ("changes", "square"),
    [
        ([0.02, 0.02, 0.02], 0.5 * 0.02**2),  # moves evenly
        ([0.0, 0.1, 0.0], 1.5 * 0.1**2),  # steps there
        ([0.1, 0.0, 0.0], 0.5 * 0.1**2),  # a row before
        ([0.02, -0.1, 0.01], 0.5 * (0.1**2 + 0.12**2 + 0.11**2)),
    ],
)
def test_what_a_current_is_read_under_is_open_by_the_step_where_its_row_begins(changes, square):
    machine, rows, read = Machine(MODEL, electric=True), 12, 6
    duty = np.zeros((rows, 4))
    duty[read - 1 : read + 2] = np.cumsum(changes)[:, None]
    duty[read + 2 :] = duty[read + 1]
    outputs = np.full((rows, machine.engine.outputs), np.nan)
    outputs[read, -4:] = 0.0
    recording = machine.recording(5e-3 * np.arange(rows), duty, outputs, np.zeros(14))
    run = make_run(machine, driven(MODEL, rate_hz=200, sensors=Sensors(current_noise_a=0.05)))
    known = replace(first_guess(machine, [run]), unresolved_current=0.0)
    variances = []
    for noise in (known, replace(known, unresolved_current=40.0)):
        [track] = track_recordings(machine, [recording], machine.believed, noise, 1e-3)
        whitening = track.whitening.reshape(rows, *[machine.engine.outputs] * 2)[read, -4:, -4:]
        inverse = np.linalg.inv(whitening)
        variances.append(np.diag(inverse @ inverse.T))
    assert variances[1] - variances[0] == pytest.approx(np.full(4, 0.25 * 40.0 * square))


# ---- of use ----


def test_the_noise_of_the_sensors_is_found():
    """300 rows: the median of second differences is good to 7 %, three of these are allowed."""
    sensors = Sensors(0.003, 0.0, 0.001, 0.002, supply_noise_v=0.05, current_noise_a=0.2)
    machine = Machine(MODEL, electric=True)
    noise = first_guess(machine, [make_run(machine, driven(MODEL, 200, sensors))])
    assert np.sqrt(noise.output[8]) == pytest.approx(0.05, rel=0.21)
    assert np.sqrt(noise.output[9:]) == pytest.approx(0.2, rel=0.21)


PAIRS = [
    ("supply_sag", 0.1, "torque_constant_error"),
    ("state_of_charge_drift", 0.01, "grip_drift"),
    ("winding_heating", 0.002, "state_of_charge_drift"),
    ("winding_heating", 0.002, "supply_sag"),
]


@pytest.mark.parametrize("name, size, rival", PAIRS)
def test_volts_and_amperes_tell_apart_what_motion_hardly_can(name, size, rival):
    """Expected separation of the same drive, without and with the five columns."""
    leads = []
    for electric in (False, True):
        machine = Machine(MODEL, electric)
        base = tuple(machine.base_parameters())
        x = np.array([machine.believed[p.places[0]] for p in base])
        candidates = {c.name: c for c in machine.candidates()}
        truth = Hypothesis(base, (), x).with_effect(candidates[name], np.array([size]))
        model = replace(MODEL, effects=[machine.effect_of(candidates[name], [size])])
        rehearsal = Rehearsal(machine, Limits())
        one = next(m for m in planning.library(machine, Limits()) if m.name == "reversals")
        noise = first_guess(machine, [rehearsal.run(model, one, planning.TYPICAL_SENSORS)])
        data = planning.Expected(machine, rehearsal.run(model, one), noise, truth)
        fitted = planning.fit_rival(data, truth.without(0), candidates[rival])
        leads.append(fitted.objective)
    without, with_electric = leads
    assert with_electric > 2 * without
    assert with_electric > planning.CERTAIN
