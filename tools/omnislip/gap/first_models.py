"""When commands act and sensors are read, as the motion tells, and a first model beside that."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from omnislip.gap.answers import likelier_held, likelier_with_rows
from omnislip.gap.inference import Hypothesis
from omnislip.gap.judge import DELAY
from omnislip.gap.machine import Machine
from omnislip.gap.noise import Noise, RunawayError, track_all
from omnislip.gap.recordings import Run
from omnislip.gap.settle import FEW_TUNINGS, first_model, settle

SURELY_HELD = 10.0
"""Log-likelihood after one tuning from which its sign is that after three, with 40 recordings."""
SURELY_MISTAKEN = 100.0
"""Log-likelihood by which a better model has to show that commands are not what the first took
them for, held within rows or not: beside a delay of two rows that is missing they are 7,000 off,
and what smooth commands do within rows tells 10 to 70 and nothing about effects."""


def first_models(machine: Machine, runs: Sequence[Run]) -> tuple[Machine, Noise, Hypothesis]:
    """Return the machine, its commands held within rows if that is likelier, and a first model.

    What is surely likelier shows by one tuning of the noise.
    """
    machine, noise, first = _held_or_moving(machine, runs)
    if machine.holds_commands:
        values = first.flat(machine.believed)
        if likelier_with_rows(machine, runs, values, noise) > 0.0:
            machine = machine.of(machine.model, jumps_with_rows=True)
            noise, first = first_model(machine, taken_as(machine, runs), (noise, first))
    return machine, noise, first


def _held_or_moving(machine: Machine, runs: Sequence[Run]) -> tuple[Machine, Noise, Hypothesis]:
    if machine.reads_before:
        noise, first = first_model(machine, runs)
        if not acts_late(machine, runs, noise, first):
            return machine, noise, first
        machine, runs = acting_late(machine, runs)
    noise, first = first_model(machine, runs, tunings=1)
    held = likelier_held(machine, runs, first.flat(machine.believed), noise) > SURELY_HELD
    if not held:
        noise, first = first_model(machine, runs, (noise, first), FEW_TUNINGS - 1)
        held = likelier_held(machine, runs, first.flat(machine.believed), noise) > 0.0
    if held:
        machine = machine.of(machine.model, holds_commands=True)
        noise, first = first_model(machine, taken_as(machine, runs), (noise, first))
    return machine, noise, first


def acts_late(machine: Machine, runs: Sequence[Run], noise: Noise, first: Hypothesis) -> bool:
    """Whether the motion is a row late, too, not only what the electric sensors read.

    A delay of a row shows the same currents, read after it acts: each by noise that fits it. (A fit
    that ends at a short delay says nothing of when sensors are read.)
    """
    delay = next(c for c in machine.candidates() if c.effect == DELAY)
    row_s = float(np.median([run.row_s for run in runs]))
    if first.flat(machine.believed)[delay.parameters[0].places[0]] > 0.5 * row_s:
        return True  # the model says so
    after = _read_after(runs)
    try:
        data, late = settle(machine, after, first.with_effect(delay, [row_s]), noise, 1)
        there = track_all(machine, after, late.hypothesis.flat(machine.believed), data.noise)
    except RunawayError:
        return False
    here = track_all(machine, runs, first.flat(machine.believed), noise)
    likelihoods = [sum(track.log_likelihood for track in tracks) for tracks in (here, there)]
    delay_s = late.hypothesis.values_of(-1)[0]
    return likelihoods[1] > likelihoods[0] and delay_s > 0.5 * row_s


def acting_late(machine: Machine, runs: Sequence[Run]) -> tuple[Machine, list[Run]]:
    """Return machine and runs of a robot that was taken for one that reads before it acts."""
    machine = machine.of(machine.model, holds_commands=False)
    return machine, [run.moving_in_rows() for run in _read_after(runs)]


def _read_after(runs: Sequence[Run]) -> list[Run]:
    """Return runs as if electric sensors had been read after their row's command began."""
    return [
        replace(run, reads_before=False, recording=run.recording.reading_before(0.0))
        for run in runs
    ]


def other_machine(
    machine: Machine, runs: Sequence[Run], least: int, model: Hypothesis, noise: Noise
) -> Machine | None:
    """Return the robot whose commands move as a model surely shows, if not as a first one did.

    One with fewer effects than the `least`, those of the model that spoke last, has no say: what it
    lacks moves commands within rows, too.
    """
    if machine.kind != "robot" or len(model.effects) < least:
        return None
    values = model.flat(machine.believed)
    moving = machine.of(machine.model, holds_commands=False)
    held = likelier_held(moving, taken_as(moving, runs), values, noise)
    if machine.holds_commands:
        if -held > SURELY_MISTAKEN:
            return moving
        with_rows = likelier_with_rows(machine, runs, values, noise)
        if (-with_rows if machine.jumps_with_rows else with_rows) > SURELY_MISTAKEN:
            return machine.of(machine.model, jumps_with_rows=not machine.jumps_with_rows)
    elif held > SURELY_MISTAKEN:
        return machine.of(machine.model, holds_commands=True)
    return None


def taken_as(machine: Machine, runs: Sequence[Run]) -> list[Run]:
    """Return runs with commands that move as those of this robot do."""
    return [run.taken_as(machine) for run in runs]
