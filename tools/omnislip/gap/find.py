"""`omnislip gap find`: from logs to a verdict, an amended model and the proof on unseen runs."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from omnislip.gap.balances import find_balances
from omnislip.gap.events import (
    CUT_S,
    Impact,
    as_effect,
    beside_lost_rows,
    find_impacts,
    known_pushes,
    run_around,
    shows,
    too_often,
)
from omnislip.gap.findings import CANNOT_BE_USED, NOT_ENOUGH, Findings, Step
from omnislip.gap.first_models import first_models, other_machine, taken_as
from omnislip.gap.gates import check, logged_set_points, too_poor
from omnislip.gap.inference import Data, Hypothesis, fit
from omnislip.gap.inverse import relative_force_error
from omnislip.gap.leftover import Leftover, find_shapes
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import (
    LEAST_EXCESS,
    Closed,
    GapTable,
    Replays,
    channel_rmse,
    gap_table,
    replay_all,
)
from omnislip.gap.moments import find_moments
from omnislip.gap.noise import Noise, RunawayError, judging_noise, track_all
from omnislip.gap.plan import separating_manoeuvre
from omnislip.gap.predictable import predictable_shares
from omnislip.gap.read_before import reading_machine
from omnislip.gap.recordings import Run, machine_for, make_run, unused_columns
from omnislip.gap.search import Found, MistakenError, Outcome, search
from omnislip.gap.settle import Progress, first_model
from omnislip.gap.split import (
    WHOLE_RUNS,
    Split,
    split_runs,
    too_cut,
    too_little,
    usable_runs,
)
from omnislip.gap.starts import Pose, begun, find_starts
from omnislip.gap.unknown import describe_unknown
from omnislip.gap.verdict import (
    FAR_EXCESS,
    STABLE,
    closes_nothing,
    judge_outcome,
    missing_terms,
    much_is_left,
    surely_refused,
    unchecked_words,
)
from omnislip.gap.where import describe, map_gap
from omnislip.gap.wiring import find_wirings, mend
from omnislip.gap.words import (
    BLIND,
    FEW_RUNS,
    HELD_COMMANDS,
    OTHER_STARTS,
    OTHER_ZEROS,
    READ_BEFORE,
    advice,
    impact_words,
    jolt_words,
    keys_words,
    one_wiring_words,
    only_held_out_words,
    short_delay_words,
    turned_words,
    undecided_words,
    unproven_words,
    unstable_words,
    unsteady_names,
    verdict_words,
    weak_names,
    wiring_words,
)
from omnislip.gap.zeros import Counts, find_zeros, moved
from omnislip.log_file import Log, read_logs, without_copies
from omnislip.model_file import Effect, Model, read_model, with_definitions
from omnislip.user_effects import read_definitions

Array = npt.NDArray[np.float64]

MOST_AGAIN, MOST_TURNS = 2, 2
"""Searches more, where a model shows pushes that were not cut out, and where one shows that
commands move otherwise."""


_Judged = tuple[Noise, list[Replays], list[Replays], GapTable]
"""The noise that judges, replays of held-out and of fitted runs, and what the first say."""


@dataclass
class _Recorded:
    """Logs as the gates leave them, and what they told."""

    model: Model
    machine: Machine
    logs: list[Log]
    inputs: dict[str, str]
    """File name -> SHA-256."""
    told: list[str]
    cuts: list[tuple[str, float]] = field(default_factory=list)
    wirings: list[list[Effect]] = field(default_factory=lambda: [[]])
    """The one that is mended, and others that these logs cannot tell from it."""
    zeros: dict[str, Counts] | None = None
    """By how much counts were moved, for encoders count from elsewhere; None before that is asked.
    """
    starts: dict[str, Pose] = field(default_factory=dict)
    """Where logs begin that no camera sees, as what is fixed to the world tells."""

    @property
    def words(self) -> list[str]:
        """What they told, in sentences."""
        zeros, starts = [OTHER_ZEROS] * bool(self.zeros), [OTHER_STARTS] * bool(self.starts)
        return [*self.told, *zeros, *starts]

    def begin(self, starts: dict[str, Pose]) -> bool:
        """Take the logs as beginning where they were found to; return whether any were."""
        self.starts |= starts
        self.logs = [begun(log, starts) for log in self.logs]
        return bool(starts)


@dataclass(frozen=True)
class _Searched:
    """The final model, the machine and the runs it was found with, and the pushes in these."""

    machine: Machine
    split: Split
    outcome: Outcome
    runs: list[Run]
    impacts: list[Impact]

    @cached_property
    def judged(self) -> _Judged:
        """How its replays compare."""
        return _judged(self.machine, self.split, self.outcome)


class _InsufficientError(Exception):
    """These logs deserve no other verdict."""

    def __init__(self, reason: str, headline: str = NOT_ENOUGH) -> None:
        super().__init__(reason)
        self.headline = headline


def find_gap(
    model_path: Path,
    log_paths: Sequence[Path],
    progress: Progress,
    effects_path: Path | None = None,
) -> Findings:
    """Find the gap between a model file and logs. InputError for files that cannot be used.

    `effects_path` is a file with effects of the user's own (user_effects.py).
    """
    recorded = _read(model_path, log_paths, effects_path, progress)
    try:
        _pass_gates(recorded, progress)
        recorded, searched = _search_by_turns(recorded, progress)
        unchecked = _judge_logs(recorded, searched)
    except _InsufficientError as error:
        return _insufficient(recorded, error)
    return _findings(recorded, searched, unchecked, progress)


def _read(
    model_path: Path,
    log_paths: Sequence[Path],
    effects_path: Path | None,
    progress: Progress,
) -> _Recorded:
    model = read_model(model_path)
    if effects_path is not None:
        model = with_definitions(model, read_definitions(effects_path), effects_path)
    progress(f"reading {len(log_paths)} logs")
    logs, told = without_copies(read_logs(log_paths, model.kind))
    logs = [mend(log, model.effects) for log in logs]
    machine = machine_for(model, logs)
    told += [f"{column}: not used" for column in unused_columns(machine, logs)]
    files = [path for path in (model_path, effects_path, *log_paths) if path is not None]
    inputs = {str(path): _sha256(path) for path in files}
    return _Recorded(model, machine, logs, inputs, told)


def _pass_gates(recorded: _Recorded, progress: Progress) -> None:
    """Mend what can be mended of the logs; tell what was, and where they have to be cut."""
    reason = too_little(recorded.machine, recorded.logs)
    if reason:
        raise _InsufficientError(reason)
    progress("checking the wiring")
    recorded.wirings = find_wirings(recorded.machine, recorded.logs)
    progress("checking the recording")
    wiring = recorded.wirings[0]
    checked = check(recorded.machine, [mend(log, wiring) for log in recorded.logs])
    recorded.logs = checked.logs
    recorded.told += checked.told
    if checked.complaint:
        raise _InsufficientError(checked.complaint, CANNOT_BE_USED)
    recorded.machine = reading_machine(recorded.machine, recorded.logs)
    recorded.cuts = checked.cuts + known_pushes(recorded.model, recorded.logs)


def _search_by_turns(recorded: _Recorded, progress: Progress) -> tuple[_Recorded, _Searched]:
    """Search, and again with other logs held out where these hold what no fitted one does.

    A patch in the floor, say, that only the last log comes by: what is not fitted gets no name.
    Where that does not explain all logs, either, they may be of several robots.
    """
    told = list(recorded.told)
    searched = _search(recorded, progress)
    progress("replaying the held-out runs")
    if not _off_only_held_out(searched):
        return recorded, searched
    progress("again with other logs held out: what is off is in these only")
    told.append(turned_words(searched.split))
    turned = replace(recorded, logs=[recorded.logs[-1], *recorded.logs[:-1]], told=told)
    found = replace(searched.outcome.found, elsewhere=True)
    try:
        again = _search(turned, progress, found)
    except (_InsufficientError, RunawayError):
        return recorded, searched
    fitted, held_out = _excess(again)
    explained = fitted < LEAST_EXCESS and held_out < FAR_EXCESS
    return (turned, again) if explained else (recorded, searched)


def _off_only_held_out(searched: _Searched) -> bool:
    """Whether the model is far off in logs that are held out, and explains what was fitted."""
    if not searched.split.logs_held_out:
        return False
    fitted, held_out = _excess(searched)
    return fitted < LEAST_EXCESS and held_out > FAR_EXCESS


def _excess(searched: _Searched) -> tuple[float, float]:
    """Return what the final model leaves of the square errors of fitted and held-out runs."""
    _, _, fitted, table = searched.judged
    return gap_table(fitted).left.excess, table.left.excess


def _search(recorded: _Recorded, progress: Progress, found: Found | None = None) -> _Searched:
    """Search for what is missing, again where only a better model shows pushes or commands.

    `found`: what was found when other logs were held out, to go on from.
    """
    progress("looking for impacts")
    logs, cuts = recorded.logs, recorded.cuts
    known = split_runs(recorded.machine, logs, cuts)
    if known.thinned:
        recorded.told.append(known.thinned)
    if not known.enough:
        raise _InsufficientError(too_cut(known))
    machine, noise, first = first_models(recorded.machine, known.fitting)
    if recorded.zeros is None:
        recorded.zeros = find_zeros(machine, logs, cuts, noise, first)
        recorded.logs = logs = [moved(log, recorded.zeros) for log in logs]
    if recorded.begin(find_starts(machine, logs, cuts, noise, first)):
        logs = recorded.logs
    runs, impacts = _pushes_beside(machine, logs, cuts, first, noise)
    least = 0
    left, turns = MOST_AGAIN, MOST_TURNS
    while True:
        pushes = cuts + [(impact.run, impact.time_s) for impact in impacts]
        split = split_runs(machine, logs, pushes)
        if not split.enough:
            raise _InsufficientError(too_cut(split))
        other = partial(other_machine, machine, split.fitting, least) if turns else None
        try:
            outcome = search(
                machine, split.fitting, noise, progress, first.without_effects(), other, found
            )
        except MistakenError as error:
            found, machine, turns = error.found, error.machine, turns - 1
            least = len(found.model.effects)
            progress(f"again with duties {'held' if machine.holds_commands else 'moving'} in rows")
            fitting = taken_as(machine, split.fitting)
            noise, first = first_model(machine, fitting, (noise, first))
            found = _anew(machine, fitting, found)
            beside = (found.model, found.noise) if found else (first, noise)
            runs, impacts = _pushes_beside(machine, logs, cuts, *beside)
            continue
        found = outcome.found
        moved_on = bool(recorded.starts)
        if left and recorded.begin(find_starts(machine, logs, pushes, found.noise, found.model)):
            progress("again with logs that begin elsewhere")
            logs, left = recorded.logs, left - 1
            runs, impacts = _pushes_beside(machine, logs, cuts, found.model, found.noise)
            if not moved_on:  # what was named may stand for a direction that was none of all logs
                found = replace(found, mistaken=True)
            continue
        progress("looking for impacts with the final model")
        confirmed = _pushes_by(machine, logs, runs, outcome, impacts)
        cut_out = [new for new in confirmed if any(new.near(old) for old in impacts)]
        settled = len(cut_out) == len(confirmed)
        impacts = confirmed if left else cut_out  # what was fitted as well is not to be told
        if settled or not left:
            break
        left -= 1
    impacts, blind = _by_lost_rows(logs, impacts)
    recorded.told += [f"{one.run}: cut at {one.time_s:.3f} s, {BLIND}" for one in blind]
    if machine.holds_commands:
        recorded.told.append(HELD_COMMANDS)
    if machine.reads_before:
        recorded.told.append(READ_BEFORE)
    return _Searched(machine, split, outcome, runs, impacts)


def _judge_logs(recorded: _Recorded, searched: _Searched) -> str | None:
    """Say what is sure but cannot be checked; _InsufficientError where logs tell too little."""
    machine, outcome = searched.machine, searched.outcome
    if outcome.selected or outcome.leftover:
        final = outcome.final.hypothesis.flat(machine.believed)
        reason = logged_set_points(machine, recorded.logs, final)
        if reason:
            raise _InsufficientError(reason, CANNOT_BE_USED)
    unchecked = unchecked_words(outcome)
    if unchecked and not (outcome.selected or missing_terms(outcome)):
        raise _InsufficientError(unchecked)
    hopeful = outcome.selected or outcome.leftover or surely_refused(outcome)
    if not (hopeful or recorded.wirings[0] or searched.impacts):
        reason = too_poor(machine, outcome.limits)
        if reason:
            raise _InsufficientError(reason)
    return unchecked


def _findings(
    recorded: _Recorded,
    searched: _Searched,
    unchecked: str | None,
    progress: Progress,
) -> Findings:
    """Compare the replays, ask whether what is left is chance, and judge it all."""
    machine, split, outcome = searched.machine, searched.split, searched.outcome
    impacts, (wiring, *other_wirings) = searched.impacts, recorded.wirings
    believed, fitted = machine.believed, split.fitting
    judging, replays, fitted_replays, table = searched.judged
    unproven = ""
    if outcome.selected and closes_nothing(outcome.selected, table):
        unproven = unproven_words(outcome.selected, table)
        outcome = outcome.without_effects()
        judging, replays, fitted_replays, table = _judged(machine, split, outcome)
    rungs = [rung.hypothesis.flat(believed) for rung in outcome.ladder]
    refit, after = rungs[0], rungs[-1]
    models = [believed, refit, after]
    steps = _steps(machine, outcome, judging, split, [believed, *rungs])
    gap_map = map_gap(
        machine, fitted, outcome.data.noise, refit, after if outcome.selected else None
    )
    progress("asking whether what is left is chance")
    tuned, tracks = outcome.data.noise, []
    if machine.kind == "robot":
        tracks = track_all(machine, fitted, after, tuned, keep_linear=True)
    shares = predictable_shares(machine, fitted, tuned, after, tracks, refit, outcome.data.answers)
    moments = find_moments(machine, fitted, tracks, after, tuned)
    jolts = too_often(searched.runs, impacts)
    sudden = jolts or bool(moments)
    verdict = judge_outcome(outcome, table, bool(wiring or impacts), shares, sudden)
    something = outcome.selected or verdict == "unknown_effect"
    places = describe(fitted, gap_map) if something else []
    shapes = _shapes(machine, split, outcome) if something else []
    cautions = [FEW_RUNS] if outcome.selected and split.how not in WHOLE_RUNS else []
    cautions += [unstable_words(one) for one in outcome.selected if one.stability < STABLE]
    cautions += weak_names(outcome.selected)
    if verdict != "unknown_effect":  # else the verdict says so
        cautions += unsteady_names(outcome.selected)
    cautions += short_delay_words(outcome)
    cautions += [f"Besides, {unchecked}."] if unchecked else []
    cautions += [unproven] if unproven else []
    cautions += keys_words(outcome.final, machine) if verdict != "unknown_effect" else []
    if verdict == "unknown_effect" and much_is_left(table, outcome.selected):
        elsewhere = only_held_out_words(split, fitted_replays)
        if elsewhere:
            cautions, places, gap_map = [*cautions, elsewhere], [], None
    unknown = None
    if verdict == "unknown_effect":
        progress("describing what is missing")
        unknown = describe_unknown(outcome)
    mended = [one_wiring_words(effect) for effect in wiring]
    mended += jolt_words(impacts) if jolts else [impact_words(impact) for impact in impacts]
    manoeuvres = {}
    final = outcome.final.hypothesis
    for one in outcome.selected:
        if one.rivals and verdict != "unknown_effect":  # of an unknown one no name is right
            progress(f"looking for a manoeuvre that separates {one.candidate.name} from its rivals")
            best = separating_manoeuvre(
                machine, outcome.data, final, one.candidate.name, one.rivals
            )
            manoeuvres |= {one.candidate.name: best} if best else {}
    return Findings(
        verdict,
        verdict_words(verdict, machine, outcome, table, mended, unknown, shares, shapes, moments)
        + undecided_words(other_wirings)
        + advice(outcome.selected, manoeuvres)
        + "".join(f" {caution}" for caution in cautions),
        machine,
        split,
        outcome,
        wiring,
        impacts,
        _amend(machine, outcome, [*wiring, *(as_effect(impact) for impact in impacts)]),
        places,
        gap_map,
        table,
        steps,
        replays,
        manoeuvres,
        recorded.inputs,
        unknown,
        shares,
        cautions,
        shapes,
        other_wirings,
        recorded.words,
        find_balances(machine, replays, outcome.data.noise, models),
        judging,
        moments,
        {} if outcome.selected else outcome.limits,
    )


def _judged(machine: Machine, split: Split, outcome: Outcome) -> _Judged:
    """Replay the held-out runs, and the fitted ones."""
    rungs = [outcome.ladder[0], outcome.ladder[-1]]
    refit, after = (rung.hypothesis.flat(machine.believed) for rung in rungs)
    models = [machine.believed, refit, after]
    judging = judging_noise(machine, split.fitting, after, outcome.data.noise)
    replays = replay_all(machine, split.held_out, judging, models)
    fitted = replay_all(machine, split.fitting, judging, models)
    table = gap_table(replays, fitted)
    if not outcome.selected:
        table = replace(table, closed=Closed(None, None, None))
    return judging, replays, fitted, table


def _anew(machine: Machine, runs: Sequence[Run], found: Found) -> Found | None:
    """Return what was found with runs of another machine, its sizes and noise fitted to these.

    None if it loses the robot there.

    Pushes show beside it that do not beside the believed model: g of one of 0.1 m/s was 32 where a
    delay of two rows was missing, and 10,900 with it.
    """
    try:
        noise, model = first_model(machine, runs, (found.noise, found.model))
    except RunawayError:
        return None
    return replace(found, model=model, noise=noise)


def _pushes_beside(
    machine: Machine,
    logs: Sequence[Log],
    cuts: Sequence[tuple[str, float]],
    model: Hypothesis,
    noise: Noise,
) -> tuple[list[Run], list[Impact]]:
    """Return the runs of all logs and the impacts in them beside a model."""
    runs = [run for log in logs for run in usable_runs(machine, log, cuts)]
    return runs, _pushes_in(machine, logs, runs, model, noise)


def _pushes_in(
    machine: Machine,
    logs: Sequence[Log],
    runs: Sequence[Run],
    model: Hypothesis,
    noise: Noise,
    known: Sequence[Impact] = (),
) -> list[Impact]:
    """Return the impacts in runs of the logs, but for what comes of one shortly before.

    Where wheels slide a filter that does not know of a push is far from the robot's velocity until
    they grip again, and finds out then. One that begins behind the push is not.
    """
    values = model.flat(machine.believed)
    impacts = find_impacts(machine, runs, values, noise, known)
    named, told = {log.name: log for log in logs}, []
    for one in impacts:
        before_s = [other.time_s for other in impacts if one.just_after(other)]
        if before_s:
            log, around = named[one.run], run_around(runs, one)
            begin_s = max(max(before_s) + CUT_S, around.t_s[0])
            begin, end = np.searchsorted(log.t_s, [begin_s, around.t_s[-1]])
            behind = make_run(machine, log, int(begin), int(end) + 1)
            if not shows(machine, behind, one, values, noise):
                continue
        told.append(one)
    return told


def _pushes_by(
    machine: Machine,
    logs: Sequence[Log],
    runs: Sequence[Run],
    outcome: Outcome,
    known: Sequence[Impact],
) -> list[Impact]:
    """Return the impacts beside what was found, a patch in the floor as wide as it may be, too.

    `known` are those that were cut out of the logs.

    Where its edge may be as well, a patch does what a push would: one that leaves it, say.
    """
    noise = outcome.data.noise
    impacts = _pushes_in(machine, logs, runs, outcome.final.hypothesis, noise, known)
    if impacts and any(one.candidate.edges_m for one in outcome.selected):
        wider = _pushes_in(machine, logs, runs, outcome.widest, noise, known)
        impacts = [one for one in impacts if any(one.near(other) for other in wider)]
    return impacts


def _by_lost_rows(
    logs: Sequence[Log], impacts: Sequence[Impact]
) -> tuple[list[Impact], list[Impact]]:
    """Part impacts into those that can be told, and those where rows are missing."""
    named = {log.name: log for log in logs}
    blind = [beside_lost_rows(named[one.run], one.time_s) for one in impacts]
    pairs = list(zip(impacts, blind, strict=True))
    return [one for one, lost in pairs if not lost], [one for one, lost in pairs if lost]


def _shapes(machine: Machine, split: Split, outcome: Outcome) -> list[Leftover]:
    """Describe the gap of the refitted model, by the noise of the final one."""
    start = outcome.ladder[0].hypothesis
    data = Data(machine, split.fitting, outcome.data.noise, start)
    return find_shapes(data, fit(data, start))


def _steps(
    machine: Machine,
    outcome: Outcome,
    noise: Noise,
    split: Split,
    sets: Sequence[Array],
) -> list[Step]:
    """Judge the believed model, the refitted one and each with one more effect."""
    names = ["believed", "refit", *(f"+ {e.name}" for e in outcome.final.hypothesis.effects)]
    rmse = channel_rmse(replay_all(machine, split.held_out, noise, sets))
    steps = []
    for index, name in enumerate(names):
        errors = {}
        if machine.kind == "axis":
            errors = {
                "fitted": _mean_force_error(machine, split.fitting, sets[index]),
                "held_out": _mean_force_error(machine, split.held_out, sets[index]),
            }
        own = {channel: float(values[index]) for channel, values in rmse.items()}
        steps.append(Step(name, own, errors))
    return steps


def _mean_force_error(machine: Machine, runs: Sequence[Run], values: Array) -> float:
    weights = [run.duration_s for run in runs]
    errors = [relative_force_error(machine, run, values) for run in runs]
    return float(np.average(errors, weights=weights))


def _insufficient(recorded: _Recorded, error: _InsufficientError) -> Findings:
    machine, (wiring, *other_wirings) = recorded.machine, recorded.wirings
    reason = str(error)
    split = Split([], [], "no run was used")
    sentence = f"{error.headline}: {reason}" + ("" if reason.endswith("?") else ".")
    if wiring:
        sentence += f" The wiring is wrong: {wiring_words(wiring)}."
        sentence += undecided_words(other_wirings)
    return Findings(
        "insufficient_data",
        sentence,
        machine,
        split,
        None,
        wiring,
        [],
        machine.amended_model({}, wiring),
        [],
        None,
        None,
        [],
        [],
        {},
        recorded.inputs,
        other_wirings=other_wirings,
        recording=recorded.words,
    )


def _amend(machine: Machine, outcome: Outcome, mended: Sequence[Effect]) -> Model:
    """Return the model with the refitted keys and the found effects."""
    hypothesis = outcome.final.hypothesis
    base = {
        p.label: float(x) / float(machine.believed[p.places[0]])
        for p, x in zip(hypothesis.base, hypothesis.x, strict=False)
    }
    effects = [machine.effect_of(s.candidate, s.values) for s in outcome.selected]
    return machine.amended_model(base, [*mended, *effects])


def _sha256(path: Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
