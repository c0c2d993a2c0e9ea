"""`omnislip gap evaluate`: how wrong any model is on any logs, by the figures of `gap find`.

The logs pass the same gates and are cut at the same places: missing rows, a camera that goes on
from another place, the pushes that the model names. Beside the figures in gap.json, for the same
model and the held-out logs, as far as whole logs were held out:

    RMSE         the same but for the states from which replays start: they are filtered with the
                 noise that is tuned here, on these logs and for this model. `gap find` has it from
                 the runs that it fitted and for the final model.
    noise floor  near that of gap.json for a model that lacks nothing. Of one that lacks something
                 it is too high, for its noise takes a part of the gap for chance: the floor to
                 judge by is the lowest of the models that are compared. Repeated manoeuvres give
                 the same floor for all models; `gap find` looks for them in all of its logs.

Of long logs `gap find` judges the stretches that it holds out; here all is replayed.

A push that a model does not name is an error of that model. `gap find` cuts it out for all models.
Whether commands are held within rows is asked by the model that is evaluated, which `gap find` asks
of its final one: of models that are compared, `recording` should say the same.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from omnislip.errors import InputError
from omnislip.gap.answers import likelier_held, likelier_with_rows
from omnislip.gap.events import LEAST_PIECE_S, known_pushes
from omnislip.gap.first_models import acting_late, acts_late, taken_as
from omnislip.gap.gates import check, rows_far_apart
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import gap_table, replay_all
from omnislip.gap.noise import judging_noise, tune_noise
from omnislip.gap.read_before import reading_machine
from omnislip.gap.recordings import Run, machine_for, unused_columns
from omnislip.gap.settle import believed_hypothesis
from omnislip.gap.split import LEAST_ROWS, MOST_FITTED_S, too_still, usable_runs
from omnislip.gap.starts import begun, find_starts
from omnislip.gap.wiring import mend
from omnislip.gap.words import HELD_COMMANDS, OTHER_STARTS, OTHER_ZEROS, READ_BEFORE
from omnislip.gap.zeros import find_zeros, moved
from omnislip.log_file import Log, read_logs, without_copies
from omnislip.model_file import read_model


def evaluate_model(
    model_path: Path, log_paths: Sequence[Path], progress: Callable[[str], None]
) -> dict[str, Any]:
    """Return RMSE of one-second replays and noise floor per channel, in the log's units.

    And what of the logs was mended, cut or not used, in sentences.

    InputError for logs whose recording `gap find` would refuse as well.
    """
    model = read_model(model_path)
    logs, told = without_copies(read_logs(log_paths, model.kind))
    logs = [mend(log, model.effects) for log in logs]
    machine = machine_for(model, logs)
    told += [f"{column}: not used" for column in unused_columns(machine, logs)]
    far_apart = rows_far_apart(logs)
    if far_apart:
        raise InputError(f"the logs cannot be used: {far_apart}")
    checked = check(machine, logs)
    if checked.complaint:
        raise InputError(f"the logs cannot be used: {checked.complaint}")
    machine = reading_machine(machine, checked.logs)
    cuts = checked.cuts + known_pushes(model, checked.logs)
    runs = _all_runs(machine, checked.logs, cuts)
    if not runs:
        raise InputError(
            f"{', '.join(map(str, log_paths))}: too short to be replayed; a log, or what is left "
            f"of it between pushes and gaps, must last more than {LEAST_PIECE_S:g} s and have "
            f"{LEAST_ROWS} rows"
        )
    still = too_still(machine, checked.logs)
    if still:
        raise InputError(f"the logs cannot be used: {still}")
    progress("tuning the noise")
    noise = tune_noise(machine, runs, machine.believed)
    total_s = sum(run.duration_s for run in runs)
    every = max(1, round(total_s / MOST_FITTED_S))
    some = runs[::every]
    if machine.reads_before and acts_late(machine, some, noise, believed_hypothesis(machine)):
        machine, runs = acting_late(machine, runs)
        some = runs[::every]
        noise = tune_noise(machine, runs, machine.believed)
    if machine.reads_before:
        told += [HELD_COMMANDS, READ_BEFORE]
    elif likelier_held(machine, some, machine.believed, noise) > 0.0:
        machine = machine.of(model, holds_commands=True)
        runs = taken_as(machine, runs)
        told.append(HELD_COMMANDS)
        noise = tune_noise(machine, runs, machine.believed)
    if (
        machine.holds_commands
        and likelier_with_rows(machine, runs[::every], machine.believed, noise) > 0.0
    ):
        machine = machine.of(model, jumps_with_rows=True)
        runs = taken_as(machine, runs)
        noise = tune_noise(machine, runs, machine.believed)
    believed, logs = believed_hypothesis(machine), checked.logs
    zeros = find_zeros(machine, logs, cuts, noise, believed)
    if zeros:
        logs = [moved(log, zeros) for log in logs]
        told.append(OTHER_ZEROS)
    starts = find_starts(machine, logs, cuts, noise, believed)
    if starts:
        logs = [begun(log, starts) for log in logs]
        told.append(OTHER_STARTS)
    if zeros or starts:
        runs = _all_runs(machine, logs, cuts)
    noise = judging_noise(machine, runs, machine.believed, noise)
    progress("replaying")
    table = gap_table(replay_all(machine, runs, noise, [machine.believed] * 3))
    return {
        "model": str(model_path),
        "runs": list(dict.fromkeys(table.runs)),
        "channels": {
            channel: {"rmse": float(table.rmse[0, c]), "noise_floor": float(table.floor[c])}
            for c, channel in enumerate(table.channels)
        },
        "noise_floor_source": table.floor_source,
        "recording": [*told, *checked.told],
    }


def _all_runs(
    machine: Machine, logs: Sequence[Log], cuts: Sequence[tuple[str, float]]
) -> list[Run]:
    pairs = [(log, run) for log in logs for run in usable_runs(machine, log, cuts)]
    return [replace(run, unit=log.name) for log, run in pairs]
