"""`omnislip gap find`: from logs to a verdict, an amended model and the proof on unseen runs."""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import binom, norm

from omnislip._core import SETTLE_S
from omnislip.errors import InputError
from omnislip.files import replace_file
from omnislip.gap.answers import likelier_held
from omnislip.gap.balances import Balance, find_balances
from omnislip.gap.events import (
    CUT_S,
    Impact,
    as_effect,
    beside_lost_rows,
    find_impacts,
    known_pushes,
    pieces,
    run_around,
    shows,
    too_often,
)
from omnislip.gap.gates import check, logged_set_points, rows_far_apart, too_poor
from omnislip.gap.inference import Data, Hypothesis, at_bound, fit, prior_penalty
from omnislip.gap.inverse import relative_force_error
from omnislip.gap.judge import (
    ALPHA,
    DELAY,
    FRICTION_OVER_SLIP,
    SURE_GAIN,
    WITHIN_LAW,
    Trial,
    within_row,
)
from omnislip.gap.leftover import UNKNOWN_SHARE, Leftover, find_shapes
from omnislip.gap.machine import CURVE, EXTENSIONS, Machine, effect_and_wheel
from omnislip.gap.metrics import (
    REPEATED,
    Closed,
    GapTable,
    Replays,
    channel_rmse,
    gap_table,
    replay_all,
)
from omnislip.gap.moments import Moment, find_moments
from omnislip.gap.noise import (
    LASTING_RATE_1_S,
    Noise,
    RunawayError,
    judging_noise,
    track_all,
)
from omnislip.gap.plan import Separation, separating_manoeuvre
from omnislip.gap.predictable import (
    EQUATIONS,
    OWN_PASTS_S,
    Predictable,
    predictable_shares,
)
from omnislip.gap.read_before import reading_machine
from omnislip.gap.recordings import (
    ODOMETRY_CHANNELS,
    UNSEEN_SETTLE_S,
    Run,
    first_pose,
    machine_for,
    make_run,
    unused_columns,
)
from omnislip.gap.search import MistakenError, Outcome, search
from omnislip.gap.selected import CONFIDENCE, Selected
from omnislip.gap.settle import FEW_TUNINGS, first_model, settle
from omnislip.gap.unknown import Unknown, describe_unknown
from omnislip.gap.where import Map, Place, describe, map_gap
from omnislip.gap.wiring import find_wirings, mend
from omnislip.log_file import Log, read_logs, without_copies
from omnislip.model_file import (
    BOTH,
    ENCODERS,
    IMPACT_KEYS,
    Effect,
    Model,
    format_model,
    read_model,
    with_definitions,
)
from omnislip.user_effects import read_definitions

Array = npt.NDArray[np.float64]

SCHEMA = "omnislip-gap/1"
MODELS = ("believed", "refit", "after")
RUNS_TO_HOLD_OUT_WHOLE = 5
SERIES_TO_HOLD_OUT_WHOLE = 3
LEAST_UNITS, LEAST_PART_S = 5, 2.0
"""Parts of runs that check each other, where the logs are few, and their least length."""
HELD_OUT_SHARE = 0.25
WHOLE_RUNS = ("whole series (folders) of runs", "whole runs")
"""How runs are held out where there are enough."""
FEW_RUNS = (
    f"With fewer than {RUNS_TO_HOLD_OUT_WHOLE} logs the choice was checked on parts of runs whose "
    "other parts were fitted: a name may change with more."
)
SURELY_HELD = 10.0
"""Log-likelihood after one tuning from which its sign is that after three, with 40 recordings."""
SURELY_MISTAKEN = 100.0
"""Log-likelihood by which a better model has to show that commands are not what the first took
them for, held within rows or not: beside a delay of two rows that is missing they are 7,000 off,
and what smooth commands do within rows tells 10 to 70 and nothing about effects."""
BLIND = "where rows are missing: a push cannot be told from what was commanded there"
HELD_COMMANDS = "duties: taken as held from row to row, as a controller at the rate of the log does"
READ_BEFORE = "currents and voltage: taken as read before the duty of their row began"
STABLE = 0.9
"""Share of resamples of the runs in which a name has to hold."""
WEAK_SHARE = 1e-2
"""Square of how far the other effects may be off what they do before they leave as much as a name
gains, below which it carries a caution; below a tenth of this the search gives none."""
LEAST_REST = 80.0
"""Gain beyond chance that a leftover term must have at least: where nothing is missing, how
commands moved within rows leaves up to 60 in violent driving."""
IN_PLACES, IN_PLACES_SHARE = 300.0, 0.02
"""Gain, inflated as it may be, that chance did not give any refused effect where nothing is missing
(36 nulls: 216 once, of friction near rest, else 76 at most), and share of what is named: the square
of a seventh (beside 34 right names that close the gap 0.006 at most)."""
PREDICTED_SHARE, SENSOR_SHARE, CURRENT_SHARE = 0.15, 0.05, 0.15
LASTING_SHARES = {
    ahead_s: factor * float(np.exp(-2.0 * LASTING_RATE_1_S * ahead_s))
    for factor, (ahead_s, *_) in zip((1.0, 1.5), OWN_PASTS_S, strict=True)
}
"""Share of the filter's disturbances that is predicted from what the robot did, and from their own
past. Where nothing is missing the first is below 0.1, beside right names too. The second is what
the slowest chance tells of itself 60 ms ahead (0.34): what fades within a tenth of a second gave
0.31 at most, of 10 Hz and more below 0.01; unknown effects that pass for chance and that nothing
else tells 0.39 to 0.9. And half as much again as that chance tells 120 ms ahead (0.17): there it
gave 0.11 at most, loads that swing 0.23 to 0.51. Innovations of a sensor are white: of 50 models
with nothing missing they told 0.01 of themselves at most, those of a supply that dips on its own
0.29, of a marker on a mast 0.33. Currents are read at an instant, whose command no log has: just
after a fast controller moved they told 0.07. More than half of the runs that hold disturbances
have to be helped, two or more: some hardly excite what is missing."""
VARIES, VARIES_SURELY, VARIED_REST = 1.0 / 3.0, 3.0, 100.0
"""Change of an effect's size from half second to half second, relative to itself, from which it is
not what is there, even where that leaves little; the inflation, 1 for white residuals, from which
that is no chance; and what is no little any more. (68 right sets: what they left so was 173 and
0.036^2 of them at most.)"""
NAMELESS, NAMELESS_GAIN = 1.1, 50.0
"""How much more a nameless term must explain than a name in its place, and by what gain beyond
chance: beside right names the best such term explains as much at most (1.0)."""
EXPLAINED, PROVEN = 0.9, 0.5
"""Share of the gap on held-out runs that effects must be able to close, where much of it is left to
judge by and where little is: in their intervals the names of 132 models closed 0.95 and more, those
of three robots that lack nothing but the friction curve 0.2 to 0.55."""
OF_ONE_WHEEL = 0.8
"""Share of the squares of sudden jumps from which they are of one wheel."""
LEAST_EXCESS = 0.5
"""Excess of the square error, in noise floors, that counts as something left."""
FAR_EXCESS = 24.0
"""The same from which no floor is an excuse: five floors off in RMSE, where nothing is missing 1.8
at most (150 nulls against repeated manoeuvres; the predictor's noise gives higher floors)."""
SURE = 3.0
"""Standard errors by which an excess has to stand out."""
KEY_AT_END, KEYS_BY_CHANCE = 2.0 * float(norm.sf(2.0)), 1e-3
"""Chance that one believed key is two tolerances off; and that so many are, below which the model
is wrong in something else."""
NOT_ENOUGH, CANNOT_BE_USED = "Not enough data", "The logs cannot be used"
LEAST_TIME_S = 3.0
LEAST_TRAVEL = 20.0
"""Motion, in steps of the position sensor, below which nothing can be learned."""
LEAST_ROWS, LEAST_SETTLED = 50, 2.0
"""Of a piece that is used: rows, and times that the filter takes to settle."""
LONGEST_RUN_S = 60.0
"""Of a robot's log that is filtered at once: its matrices take 1.6 MB per second at 200 Hz."""
STRETCH_S, MOST_FITTED_S, MOST_HELD_OUT_S = 10.0, 120.0, 40.0
"""Of a robot's longer logs the liveliest stretches are fitted and held out, so much together: 40 s
name what shows at all, and time and memory go with what is fitted."""


@dataclass(frozen=True)
class Split:
    """Which runs are fitted, and check the choice by turns, and which are only looked at last."""

    fitting: list[Run]
    held_out: list[Run]
    how: str
    thinned: str | None = None
    """What is used of long logs, in words."""

    @property
    def enough(self) -> bool:
        """Whether there is a run to fit, another to check it, and one to hold out."""
        return len({run.unit for run in self.fitting}) > 1 and bool(self.held_out)


@dataclass(frozen=True)
class Step:
    """One model of the ladder: RMSE of replays on held-out runs; for an axis the force error."""

    name: str
    rmse: dict[str, float]
    force_error: dict[str, float]


@dataclass(frozen=True)
class Findings:
    """Everything `gap find` found out; the report and gap.json are written from it."""

    verdict: str
    sentence: str
    machine: Machine
    split: Split
    outcome: Outcome | None
    wiring: list[Effect]
    impacts: list[Impact]
    amended: Model
    places: list[Place]
    gap_map: Map | None
    table: GapTable | None
    steps: list[Step]
    replays: list[Replays]
    manoeuvres: dict[str, Separation]
    """The best to tell an effect (by the name of its candidate) from those it is ambiguous with, of
    those that can be driven."""
    inputs: dict[str, str]
    """File name -> SHA-256 of the model and the logs."""
    unknown: Unknown | None = None
    """What an unknown effect looks like, where that can be said."""
    predictable: list[Predictable] = field(default_factory=list)
    """How much of what the filter takes for chance other runs predict, by equation."""
    cautions: list[str] = field(default_factory=list)
    """Why the names are less certain than they look, in sentences."""
    shapes: list[Leftover] = field(default_factory=list)
    """What the gap looks like in the refitted model: nameless terms, each tried alone."""
    other_wirings: list[list[Effect]] = field(default_factory=list)
    """Wirings that these logs cannot tell from the one found."""
    recording: list[str] = field(default_factory=list)
    """What of the logs was mended, cut or not used, in sentences."""
    balances: list[Balance] = field(default_factory=list)
    """What each balance of a robot leaves on the held-out runs, beside the models of the table."""
    noise: Noise | None = None
    """By which the replays of the held-out runs are judged."""
    moments: list[Moment] = field(default_factory=list)
    """When shafts of the runs that were fitted jumped as no command tells."""

    @property
    def amended_words(self) -> str:
        """What the amended model is."""
        if self.wiring or self.impacts or (self.outcome and self.outcome.selected):
            return "amended model"
        return "refitted model" if self.outcome else "unchanged model"


def find_gap(
    model_path: Path,
    log_paths: Sequence[Path],
    progress: Callable[[str], None],
    effects_path: Path | None = None,
) -> Findings:
    """Find the gap between a model file and logs. InputError for files that cannot be used.

    `effects_path` is a file with effects of the user's own (user_effects.py).
    """
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
    reason = _too_little(machine, logs)
    if reason:
        return _insufficient(machine, reason, inputs, told)
    progress("checking the wiring")
    wiring, *other_wirings = wirings = find_wirings(machine, logs)
    progress("checking the recording")
    checked = check(machine, [mend(log, wiring) for log in logs])
    logs, cuts, told = checked.logs, checked.cuts, [*told, *checked.told]
    if checked.complaint:
        return _insufficient(machine, checked.complaint, inputs, told, wirings, CANNOT_BE_USED)
    machine = reading_machine(machine, logs)
    progress("looking for impacts")
    cuts += known_pushes(model, logs)
    known = split_runs(machine, logs, cuts)
    if known.thinned:
        told.append(known.thinned)
    if not known.enough:
        return _insufficient(machine, _too_cut(known), inputs, told, wirings)
    machine, noise, first = _first_models(machine, known.fitting)
    runs, impacts = _pushes_beside(machine, logs, cuts, first, noise)
    least, outcome = 0, None
    for left in reversed(range(3)):  # again where only a better model shows pushes or commands
        pushes = cuts + [(impact.run, impact.time_s) for impact in impacts]
        split = split_runs(machine, logs, pushes)
        if not split.enough:
            return _insufficient(machine, _too_cut(split), inputs, told, wirings)
        mistaken = partial(_takes_commands_wrongly, machine, split.fitting, least) if left else None
        try:
            outcome = search(
                machine, split.fitting, noise, progress, first.without_effects(), mistaken, outcome
            )
        except MistakenError as error:
            least = error.effects
            fitting = _other_commands(machine, split.fitting)
            machine = machine.of(model, holds_commands=not machine.holds_commands)
            progress(f"again with duties {'held' if machine.holds_commands else 'moving'} in rows")
            noise, first = first_model(machine, fitting, (noise, first))
            outcome = None
            runs, impacts = _pushes_beside(machine, logs, cuts, first, noise)
            continue
        progress("looking for impacts with the final model")
        final, tuned = outcome.final.hypothesis, outcome.data.noise
        confirmed = _pushes_in(machine, logs, runs, final, tuned)
        cut_out = [new for new in confirmed if any(new.near(old) for old in impacts)]
        settled = len(cut_out) == len(confirmed)
        impacts = confirmed if left else cut_out  # what was fitted as well is not to be told
        if settled:
            break
    impacts, blind = _by_lost_rows(logs, impacts)
    told += [f"{one.run}: cut at {one.time_s:.3f} s, {BLIND}" for one in blind]
    if machine.holds_commands:
        told.append(HELD_COMMANDS)
    if machine.reads_before:
        told.append(READ_BEFORE)
    if outcome.selected or outcome.leftover:
        reason = logged_set_points(machine, logs, outcome.final.hypothesis.flat(machine.believed))
        if reason:
            return _insufficient(machine, reason, inputs, told, wirings, CANNOT_BE_USED)
    unchecked = _unchecked(outcome)
    if unchecked and not (outcome.selected or _missing_terms(outcome)):
        return _insufficient(machine, unchecked, inputs, told, wirings)
    hopeful = outcome.selected or outcome.leftover or _surely_refused(outcome)
    if not (hopeful or wiring or impacts):
        reason = too_poor(machine, outcome.limits)
        if reason:
            return _insufficient(machine, reason, inputs, told, wirings)
    progress("replaying the held-out runs")
    believed, fitted = machine.believed, split.fitting
    judging, replays, fitted_replays, table = _judged(machine, split, outcome)
    unproven = ""
    if outcome.selected and _closes_nothing(outcome.selected, table):
        unproven = _unproven_words(outcome.selected, table)
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
    moments = find_moments(machine, fitted, tracks)
    jolts = too_often(runs, impacts)
    sudden = jolts or bool(moments)
    verdict = _verdict(outcome, table, bool(wiring or impacts), shares, sudden)
    something = outcome.selected or verdict == "unknown_effect"
    places = describe(fitted, gap_map) if something else []
    shapes = _shapes(machine, split, outcome) if something else []
    cautions = [FEW_RUNS] if outcome.selected and split.how not in WHOLE_RUNS else []
    cautions += [_unstable(one) for one in outcome.selected if one.stability < STABLE]
    cautions += weak_names(outcome.selected)
    cautions += [f"Besides, {unchecked}."] if unchecked else []
    cautions += [unproven] if unproven else []
    if verdict == "unknown_effect" and _much_is_left(table, outcome.selected):
        elsewhere = _only_held_out(split, fitted_replays)
        if elsewhere:
            cautions, places, gap_map = [*cautions, elsewhere], [], None
    unknown = None
    if verdict == "unknown_effect":
        progress("describing what is missing")
        unknown = describe_unknown(outcome)
    mended = [_wiring_words(effect) for effect in wiring]
    mended += _jolt_words(impacts) if jolts else [_impact_words(impact) for impact in impacts]
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
        _sentence(verdict, machine, outcome, table, mended, unknown, shares, shapes, moments)
        + _undecided(other_wirings)
        + _advice(outcome.selected, manoeuvres)
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
        inputs,
        unknown,
        shares,
        cautions,
        shapes,
        other_wirings,
        told,
        find_balances(machine, replays, outcome.data.noise, models),
        judging,
        moments,
    )


def _judged(
    machine: Machine, split: Split, outcome: Outcome
) -> tuple[Noise, list[Replays], list[Replays], GapTable]:
    """Replay the held-out runs, and the fitted ones.

    Return the noise that judges, replays of both and what those of the held-out runs say.
    """
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


def _only_held_out(split: Split, fitted_replays: Sequence[Replays]) -> str:
    """Say so where whole logs are held out that are far off, and what was fitted is not."""
    fitted = {run.name for run in split.fitting}
    held_out = list(dict.fromkeys(run.name for run in split.held_out if run.name not in fitted))
    if not held_out or gap_table(fitted_replays).left.excess >= LEAST_EXCESS:
        return ""
    return (
        f"The model explains the runs that were fitted; what is off is in {', '.join(held_out)}, "
        f"held out. If all are of one robot in one state, more logs like that are needed to tell "
        f"what it is; else look at each alone."
    )


def _closes_nothing(selected: Sequence[Selected], table: GapTable) -> bool:
    """Whether names do not show on held-out runs, where little is left to be named.

    They surely close less than half of what is off there. Or nothing is off, which may be so with a
    weak effect that shows sample by sample; but then its name has to be stable.
    """
    if _much_is_left(table, selected):
        return False
    if table.closed.high is None:
        return all(one.stability < STABLE for one in selected)
    return table.closed.high < PROVEN


def _unproven_words(selected: Sequence[Selected], table: GapTable) -> str:
    names, closed = " and ".join(one.candidate.name for one in selected), table.closed
    shown = "nothing is off by which to judge it"
    if closed.high is not None:
        low, value, high = (
            f"{100 * share:.0f}" for share in (closed.low, closed.value, closed.high)
        )
        shown = f"{value} % of the gap would close ({low} to {high} %)"
    return (
        f"{names} would explain something of the runs that were fitted, but on held-out runs "
        f"{shown}: not named."
    )


def _first_models(machine: Machine, runs: Sequence[Run]) -> tuple[Machine, Noise, Hypothesis]:
    """Return the machine, its commands held within rows if that is likelier, and a first model.

    What is surely likelier shows by one tuning of the noise.
    """
    if machine.reads_before:
        noise, first = first_model(machine, runs)
        if not acts_late(machine, runs, noise, first):
            return machine, noise, first
        machine = machine.of(machine.model, holds_commands=False, reads_before=False)
        runs = [run.moving_in_rows() for run in read_after(runs)]
    noise, first = first_model(machine, runs, tunings=1)
    held = likelier_held(machine, runs, first.flat(machine.believed), noise) > SURELY_HELD
    if not held:
        noise, first = first_model(machine, runs, (noise, first), FEW_TUNINGS - 1)
        held = likelier_held(machine, runs, first.flat(machine.believed), noise) > 0.0
    if held:
        machine, runs = (
            machine.of(machine.model, holds_commands=True),
            _other_commands(machine, runs),
        )
        noise, first = first_model(machine, runs, (noise, first))
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
    after = read_after(runs)
    try:
        data, late = settle(machine, after, first.with_effect(delay, [row_s]), noise, 1)
        there = track_all(machine, after, late.hypothesis.flat(machine.believed), data.noise)
    except RunawayError:
        return False
    here = track_all(machine, runs, first.flat(machine.believed), noise)
    likelihoods = [sum(track.log_likelihood for track in tracks) for tracks in (here, there)]
    delay_s = late.hypothesis.values_of(-1)[0]
    return likelihoods[1] > likelihoods[0] and delay_s > 0.5 * row_s


def read_after(runs: Sequence[Run]) -> list[Run]:
    """Return runs as if electric sensors had been read after their row's command began."""
    return [replace(run, recording=run.recording.reading_before(False)) for run in runs]


def _takes_commands_wrongly(
    machine: Machine, runs: Sequence[Run], least: int, model: Hypothesis, noise: Noise
) -> bool:
    """Whether a model shows that commands within rows are not what a first one took them for.

    One with fewer effects than the `least`, those of the model that spoke last, has no say: what it
    lacks moves commands within rows, too.
    """
    if len(model.effects) < least:
        return False
    values = model.flat(machine.believed)
    if not machine.holds_commands:
        return likelier_held(machine, runs, values, noise) > SURELY_MISTAKEN
    moving = machine.of(machine.model, holds_commands=False)
    likelier = likelier_held(moving, _other_commands(machine, runs), values, noise)
    return -likelier > SURELY_MISTAKEN


def _other_commands(machine: Machine, runs: Sequence[Run]) -> list[Run]:
    """Return runs with their commands moving within rows where they are held, and held if not."""
    return [r.moving_in_rows() if machine.holds_commands else r.held_in_rows() for r in runs]


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
    machine: Machine, logs: Sequence[Log], runs: Sequence[Run], model: Hypothesis, noise: Noise
) -> list[Impact]:
    """Return the impacts in runs of the logs, but for what comes of one shortly before.

    Where wheels slide a filter that does not know of a push is far from the robot's velocity until
    they grip again, and finds out then. One that begins behind the push is not.
    """
    values = model.flat(machine.believed)
    impacts = find_impacts(machine, runs, values, noise)
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


def _unstable(one: Selected) -> str:
    return (
        f"{one.candidate.name} is the best name in only {100 * one.stability:.0f} % of resamples "
        "of the runs: a name may change with more."
    )


def weak_names(selected: Sequence[Selected]) -> list[str]:
    """Return a caution for each name that others would leave if their shapes were a bit wrong."""
    shares = [(one, one.evidence.beyond_chance / one.left) for one in selected if one.left]
    return [
        f"{one.candidate.name} is weak: the other effects would leave as much if they were "
        f"{100 * share**0.5:.0f} % off in what they do."
        for one, share in shares
        if share < WEAK_SHARE
    ]


def _too_cut(split: Split) -> str:
    return (
        f"between pushes and gaps too little is left to fit, to check and to hold out: each "
        f"takes pieces of {LEAST_ROWS} rows and {LEAST_SETTLED * SETTLE_S:g} s, or "
        f"{LEAST_SETTLED * UNSEEN_SETTLE_S:g} s where no camera sees how a robot goes ({split.how})"
    )


def _verdict(
    outcome: Outcome, table: GapTable, mended: bool, shares: Sequence[Predictable], sudden: bool
) -> str:
    """Name effects only if they explain what is to be explained."""
    if (
        _missing_terms(outcome)
        or _surely_refused(outcome)
        or _much_is_left(table, outcome.selected)
    ):
        return "unknown_effect"
    if _refused_in_places(outcome, table):
        return "unknown_effect"
    if sudden or any(_no_chance(one) for one in shares) or _varying(outcome.selected):
        return "unknown_effect"
    if _keys_at_their_ends(outcome) or _better_without_name(outcome.selected):
        return "unknown_effect"
    return "effect_found" if outcome.selected or mended else "no_gap"


def _keys_at_their_ends(outcome: Outcome) -> list[str]:
    """Return the believed keys at the end of their range: more than chance, where nothing is named.

    That takes five of thirteen; in 214 nulls three at most were there. They were pulled by what
    the model lacks, and the noise holds the rest of it.
    """
    if outcome.selected:
        return []
    names = [p.label for p in outcome.final.hypothesis.base]
    ends = [name for i, name in enumerate(names) if at_bound(outcome.final, i)]
    chance = binom.sf(len(ends) - 1, len(names), KEY_AT_END)
    return ends if chance < KEYS_BY_CHANCE else []


def _missing_terms(outcome: Outcome) -> list[Leftover]:
    """Return the terms that explain more than effects which are a bit off would leave."""
    least = max(LEAST_REST, outcome.data.feigned_gain)
    return [
        one
        for one in outcome.leftover
        if one.gain > one.covered and one.gain / one.inflation > least
    ]


def _varying(selected: Sequence[Selected]) -> list[Selected]:
    """Return the effects whose size is not the same throughout the logs, where that leaves much.

    A size that varies by v leaves v^2 of its gain: what a missing term may not gain, or much of
    what is named. What a weak effect leaves so is nothing beside stronger ones. The friction
    curve, strong as it may be, covers nothing, and varies where nothing is missing; what any law of
    friction is off by is no news.
    """
    named = sum(one.evidence.gain for one in selected if one.candidate.effect != CURVE)

    def least(one: Selected) -> float:
        much = VARIES**2 * max(named, one.evidence.gain)
        if one.candidate.effect != CURVE:
            much = min(much, max(VARIED_REST, UNKNOWN_SHARE * named))
        return max(much, one.law_gain)

    return [
        one
        for one in selected
        if one.evidence.inflation > VARIES_SURELY
        and one.evidence.variation**2 * one.evidence.gain > least(one)
    ]


def _better_without_name(selected: Sequence[Selected]) -> list[Selected]:
    """Return the effects in whose place a nameless term explains surely more: the nearest names.

    A term is linear, an effect is fitted, and shapes of the same meaning gain alike.
    """
    return [
        one
        for one in selected
        if one.instead is not None
        and one.instead.gain > NAMELESS * one.evidence.gain
        and one.instead.gain - one.evidence.gain > NAMELESS_GAIN * one.evidence.inflation
    ]


def _no_chance(found: Predictable) -> bool:
    """Whether what the filter takes for chance is predicted in most of the runs, two or more."""
    if found.equation not in EQUATIONS:
        least = CURRENT_SHARE if found.equation.endswith("current_a") else SENSOR_SHARE
    else:
        least = LASTING_SHARES[found.ahead_s] if found.from_own_past else PREDICTED_SHARE
    enough = found.runs_helped > max(found.runs / 2, 1)
    return found.share > least and enough


def _surely_refused(outcome: Outcome) -> Trial | None:
    """Return what was refused last because it spoilt the other runs, if it is sure."""
    return _surest(outcome, lambda trial: trial.checked and trial.validation_gain <= 0)


def _refused_in_places(outcome: Outcome, table: GapTable) -> Trial | None:
    """Return what was refused last because it explains much, but in few places; None if chance may.

    Something is there, then, that has none of the shapes that are known. What is named covers that
    where it surely closes half of the gap, or gains so much more that its own shape, a seventh off,
    leaves as much. What changes the friction over slip is no news, nor is a lag so short
    that commands which move within rows make it.
    """
    trials = _last_trials(outcome)
    if any(trial.accepted for trial in trials) or (table.closed.low or 0.0) > PROVEN:
        return None
    named = sum(s.evidence.gain for s in outcome.selected)
    trials = [t for t in trials if t.candidate.effect not in FRICTION_OVER_SLIP]
    checked = [
        trial
        for trial in trials
        if trial.checked
        and trial.chance >= ALPHA
        and not within_row(outcome.data, trial.candidate, trial.values)
    ]
    most = max(checked, key=lambda trial: trial.evidence.gain, default=None)
    least = max(IN_PLACES, outcome.data.feigned_gain, IN_PLACES_SHARE * named)
    return most if most and most.evidence.gain > least else None


def _unchecked(outcome: Outcome) -> str | None:
    """Say what is sure, but seen where no other run can check it; None if nothing is."""
    trial = _surest(outcome, lambda trial: not trial.checked and trial.reason != WITHIN_LAW)
    if trial is None:
        return None
    machine, candidate = outcome.data.machine, trial.candidate
    sizes = [
        f"{machine.file_parameter(p.label)} {trial.values[k]:.3g}"
        for k, p in enumerate(candidate.parameters)
        if k in candidate.amplitudes
    ]
    return (
        f"{candidate.name} ({', '.join(sizes)}) would explain what is missing, but too few runs "
        "show it to check that; drive more like those that do"
    )


def _surest(outcome: Outcome, refused: Callable[[Trial], bool]) -> Trial | None:
    """Return what gains most of what was refused so in the last step, if it is sure.

    It gains more, beyond chance, than a controller feigns and than all that is named.
    """
    named = sum(s.evidence.beyond_chance for s in outcome.selected)
    trials = [t for t in _last_trials(outcome) if not t.accepted and refused(t)]
    surest = max(trials, key=lambda trial: trial.evidence.beyond_chance, default=None)
    least = max(SURE_GAIN, outcome.data.feigned_gain, named)
    return surest if surest and surest.evidence.beyond_chance > least else None


def _last_trials(outcome: Outcome) -> list[Trial]:
    last = max((trial.step for trial in outcome.trials), default=0)
    return [trial for trial in outcome.trials if trial.step == last]


def _much_is_left(table: GapTable, selected: Sequence[Selected]) -> bool:
    """Whether replays of held-out runs stay clearly above the floor.

    With effects: they surely close less than `EXPLAINED` of the gap, and what is left is more than
    its own error (surely more, where only the friction over slip is named, which is never quite
    right). Without: against repeated manoeuvres, for the predictor's own noise takes a gap
    that nothing explains for chance. Far above in any case, if more than one window says so: a
    held-out run may hold what no fitted one does, and of what comes and goes the mean is as
    uncertain as it is large.
    """
    left, closed = table.left, table.closed
    if left.excess < LEAST_EXCESS:
        return False
    far, error = left.excess > FAR_EXCESS, left.standard_error
    if closed.high is not None:
        errors = (
            1.0 if any(s.candidate.effect not in FRICTION_OVER_SLIP for s in selected) else SURE
        )
        return (far or left.excess >= errors * error) and closed.high < EXPLAINED
    if left.excess >= SURE * error and table.floor_source == REPEATED:
        return True
    return far and error < np.inf


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


@dataclass(frozen=True)
class Part:
    """Rows first..end of a log, its unit, and whether it is held out."""

    unit: str
    held_out: bool
    log: Log
    first: int
    end: int

    @property
    def rows(self) -> int:
        """How many."""
        return self.end - self.first

    @property
    def row_s(self) -> float:
        """Time from row to row."""
        return _row_s(self.log, self.first, self.end)

    @property
    def duration_s(self) -> float:
        """Time that its rows take, without gaps between them."""
        return self.rows * self.row_s

    @property
    def liveliness(self) -> float:
        """Variance of a robot's commands."""
        names = [f"wheel/{wheel}/duty" for wheel in range(1, 5)]
        duties = [self.log.columns[name][self.first : self.end] for name in names]
        return float(np.sum(np.var(np.nan_to_num(duties), axis=1)))


def _row_s(log: Log, first: int, end: int) -> float:
    """Return the median time from row to row of rows first..end of a log."""
    return float(np.median(np.diff(log.t_s[first:end]))) if end - first > 1 else 0.0


def _evenly(first: int, end: int, count: int) -> list[tuple[int, int]]:
    """Cut rows first..end into `count` even parts: (begin, end)."""
    return list(pairwise(np.linspace(first, end, count + 1).round().astype(int).tolist()))


def split_runs(
    machine: Machine, logs: Sequence[Log], pushes: Sequence[tuple[str, float]] = ()
) -> Split:
    """Hold out whole series where there are three, else whole runs where there are five.

    Else the last run, or the end of the one; the others are then cut into parts. A series is a
    folder of logs: what its runs have in common (day, floor, clocks) must not help the model on the
    runs that judge it. A series, run or part is a unit of the runs that are fitted: a choice is
    checked on each by what fits the others.

    A log is cut at its pushes (run, time). Of a long log the liveliest stretches are used.
    """
    series = list(dict.fromkeys(log.series for log in logs))
    if len(series) >= SERIES_TO_HOLD_OUT_WHOLE:
        held = [series[k] for k in _every_fifth(len(series))]
        parts = [Part(log.series, log.series in held, log, 0, len(log.t_s)) for log in logs]
        how = WHOLE_RUNS[0]
    elif len(logs) >= RUNS_TO_HOLD_OUT_WHOLE:
        held = _every_fifth(len(logs))
        parts = [Part(f"run {k}", k in held, log, 0, len(log.t_s)) for k, log in enumerate(logs)]
        how = WHOLE_RUNS[1]
    elif len(logs) > 1:
        parts = [Part(logs[-1].name, True, logs[-1], 0, len(logs[-1].t_s))]
        for log in logs[:-1]:
            parts += _cut(log, len(log.t_s), math.ceil(LEAST_UNITS / (len(logs) - 1)))
        how = "the last run held out; parts of the others check each other"
    else:
        [log] = logs
        end = round((1.0 - HELD_OUT_SHARE) * len(log.t_s))
        parts = [*_cut(log, end, LEAST_UNITS), Part(log.name, True, log, end, len(log.t_s))]
        how = "one run only: its last quarter held out, parts of the rest check each other"
    used = parts
    if machine.kind == "robot":
        used = _liveliest([part for part in parts if not part.held_out], MOST_FITTED_S)
        used += _liveliest([part for part in parts if part.held_out], MOST_HELD_OUT_S)
    fitting, held_out = [], []
    for part in used:
        runs = usable_runs(machine, part.log, pushes, part.first, part.end)
        (held_out if part.held_out else fitting).extend(replace(r, unit=part.unit) for r in runs)
    thinned = None
    if sum(part.rows for part in used) < sum(part.rows for part in parts):
        whole_s = sum(part.duration_s for part in parts)
        fitted_s, held_s = (sum(run.duration_s for run in runs) for runs in (fitting, held_out))
        thinned = (
            f"of {whole_s:.0f} s the liveliest stretches are used: {fitted_s:.0f} s are fitted, "
            f"{held_s:.0f} s held out"
        )
    return Split(fitting, held_out, how, thinned)


def _liveliest(parts: Sequence[Part], most_s: float) -> list[Part]:
    """Return the parts, or stretches of them of some `most_s` together.

    From each stratum of a unit, so that what drifts and what is met in one place only is seen, that
    in which the commands vary most; where there are more units than stretches, from each stratum of
    all. Stretches begin at the same times of all logs: manoeuvres that are repeated stay so.
    """
    if sum(part.duration_s for part in parts) <= most_s:
        return list(parts)
    units: dict[str, list[Part]] = {}
    for part in parts:
        units.setdefault(part.unit, []).extend(_stretches(part))
    stretches = [one for own in units.values() for one in own]
    mean_s = sum(one.duration_s for one in stretches) / len(stretches)
    share = min(most_s / mean_s / len(stretches), 1.0)
    groups = list(units.values()) if share * len(stretches) >= len(units) else [stretches]
    chosen = []
    for own in groups:
        strata = np.array_split(np.arange(len(own)), max(round(share * len(own)), 1))
        chosen += [max((own[k] for k in some), key=lambda one: one.liveliness) for some in strata]
    return chosen


def _stretches(part: Part) -> list[Part]:
    """Cut a part at multiples of some seconds since its log began, slivers left to neighbours."""
    length_s = max(STRETCH_S, 2 * LEAST_ROWS * part.row_s)
    number = ((part.log.t_s[part.first : part.end] - part.log.t_s[0]) / length_s).astype(int)
    edges = part.first + np.flatnonzero(np.diff(number)) + 1
    least = 0.5 * length_s / part.row_s
    inner, begin = [], part.first
    for edge in edges:
        if edge - begin >= least and part.end - edge >= least:
            inner.append(int(edge))
            begin = edge
    return [replace(part, first=a, end=b) for a, b in pairwise([part.first, *inner, part.end])]


def usable_runs(
    machine: Machine,
    log: Log,
    pushes: Sequence[tuple[str, float]],
    first: int = 0,
    last: int | None = None,
) -> list[Run]:
    """Return what is long enough to be used of rows first..last between the pushes (run, time).

    A robot's in runs of a minute at most.
    """
    runs = []
    for begin, end in pieces(log, pushes):
        begin, end = max(begin, first), min(end, len(log.t_s) if last is None else last)
        pose = first_pose(log, begin, end)
        # Without a pose an odometry has nothing to be judged by.
        before = [] if machine.kind == "odometry" else [(begin, pose)]
        for rows in (*before, (pose, end)):
            if rows[1] - rows[0] >= LEAST_ROWS:
                count = 1
                if machine.kind == "robot":
                    duration_s = (rows[1] - rows[0]) * _row_s(log, *rows)
                    count = math.ceil(duration_s / LONGEST_RUN_S)
                runs += [make_run(machine, log, *part) for part in _evenly(*rows, count)]
    return [run for run in runs if run.duration_s >= LEAST_SETTLED * run.recording.settle_s]


def _every_fifth(count: int) -> list[int]:
    """Numbers of those that are held out."""
    share = max(1, round(0.2 * count))
    return [round((k + 1) * count / share) - 1 for k in range(share)]


def _cut(log: Log, end: int, count: int) -> list[Part]:
    """Cut the rows of a log before `end` into some parts."""
    count = max(2, min(count, int((log.t_s[end - 1] - log.t_s[0]) / LEAST_PART_S)))
    return [
        Part(f"{log.name}, part {k + 1}", False, log, *rows)
        for k, rows in enumerate(_evenly(0, end, count))
    ]


def _too_little(machine: Machine, logs: Sequence[Log]) -> str | None:
    """Return why these logs cannot teach anything, or None."""
    far_apart = rows_far_apart(logs)
    if far_apart:
        return far_apart
    total = sum(float(log.t_s[-1] - log.t_s[0]) for log in logs)
    if total < LEAST_TIME_S:
        return f"the logs hold {total:.2g} s, at least {LEAST_TIME_S:g} s are needed"
    return too_still(machine, logs)


def too_still(machine: Machine, logs: Sequence[Log]) -> str | None:
    """Return what does not move in any of the logs, or None."""
    runs = [make_run(machine, log) for log in logs]
    if all(np.ptp(run.command) == 0 for run in runs):
        return "the command never changes"
    for motor in range(machine.wheels):
        travel = max(_travel(run, motor) for run in runs)
        if travel < LEAST_TRAVEL:
            what = f"wheel {motor + 1}" if machine.wheels > 1 else "the axis"
            return f"{what} hardly moves in any log"
    return None


def _travel(run: Run, motor: int) -> float:
    """Way of a motor in steps of its sensor; an odometry is driven by its encoders."""
    driven = run.channels == ODOMETRY_CHANNELS
    way = np.cumsum(run.command[:, motor]) if driven else run.outputs[:, motor]
    way = way[~np.isnan(way)]
    return float(np.ptp(way)) / _resolution(way)


def _resolution(values: Array) -> float:
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0]
    return float(moved.min()) if moved.size else float("inf")


def _insufficient(
    machine: Machine,
    reason: str,
    inputs: dict[str, str],
    told: list[str],
    wirings: Sequence[list[Effect]] = ([],),
    headline: str = NOT_ENOUGH,
) -> Findings:
    wiring, *other_wirings = wirings
    split = Split([], [], "no run was used")
    sentence = f"{headline}: {reason}" + ("" if reason.endswith("?") else ".")
    if wiring:
        sentence += f" The wiring is wrong: {wiring_words(wiring)}."
        sentence += _undecided(other_wirings)
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
        inputs,
        other_wirings=other_wirings,
        recording=told,
    )


def _sentence(
    verdict: str,
    machine: Machine,
    outcome: Outcome,
    table: GapTable,
    mended: Sequence[str],
    unknown: Unknown | None,
    shares: Sequence[Predictable],
    shapes: Sequence[Leftover],
    moments: Sequence[Moment],
) -> str:
    """Return the verdict as one sentence with numbers; `mended` is what is not a term."""
    if verdict == "no_gap":
        return "No missing effect: the believed model explains these logs within its tolerances."
    parts = [*mended, *(_effect_words(machine, s) for s in outcome.selected)]
    if verdict == "unknown_effect":
        text = nothing_told = "Something is missing that is none of the known effects"
        if unknown:
            text += f": {unknown.equation}, depending on {unknown.dependence}"
            text += f" (hypothesis: {unknown.formula})"
        elif terms := _missing_terms(outcome):
            term = terms[0]
            text += f": {term.equation}, depending on {term.dependence}"
        elif sure := [one for one in shares if _no_chance(one)]:
            source = "their own past" if sure[0].from_own_past else "commands, speeds and place"
            source = "a curve over its own command" if sure[0].by_own_command else source
            text += (
                f": {100 * sure[0].share:.0f} % of what passes for chance in "
                f"{sure[0].equation} can be predicted from {source}"
            )
        if moments:
            text += f"{':' if text == nothing_told else ';'} {moment_words(moments)}"
        text += "".join(
            f"; the size of {one.candidate.name}, which is nearest, changes by"
            f" {100 * one.evidence.variation:.0f} % from half second to half second"
            for one in _varying(outcome.selected)
        )
        nameless = _better_without_name(outcome.selected)
        text += "".join(
            f"; {one.instead.equation}, depending on {one.instead.dependence}, explains "
            f"{100 * (one.instead.gain / one.evidence.gain - 1):.0f} % more than "
            f"{one.candidate.name}, which is nearest"
            for one in nameless
            if one.instead
        )
        if refused := _surely_refused(outcome):
            text += f"; {refused.candidate.name} explains much of it in some runs and spoils others"
        elif refused := _refused_in_places(outcome, table):
            text += f"; {refused.candidate.name} explains much of it, but in few places only"
        if _much_is_left(table, outcome.selected):
            off = (1.0 + table.left.excess) ** 0.5
            text += f"; replays of held-out runs are {off:.2g} noise floors off"
        if ends := _keys_at_their_ends(outcome):
            text += (
                f"; {len(ends)} of {len(outcome.final.hypothesis.base)} believed values would be "
                f"more than two tolerances off ({', '.join(ends)})"
            )
        if not (unknown or nameless or moments or _missing_terms(outcome)) and shapes:
            like = shapes[0]
            text += f"; most of it looks like {like.equation}, depending on {like.dependence}"
        text += "."
        return text + (f" Nearest known: {'; '.join(parts)}." if parts else "")
    text = "Missing: " + "; ".join(parts) + "."
    closed = table.closed
    if closed.value is not None:
        text += (
            f" Added to the model, {100 * closed.value:.0f} % of the gap on held-out runs closes"
            f" ({100 * closed.low:.0f} to {100 * closed.high:.0f} %)."
        )
    rivals = [s for s in outcome.selected if s.rivals]
    for one in rivals:
        text += f" These logs cannot tell {one.candidate.name} from {', '.join(one.rivals)}."
    return text


def _advice(selected: Sequence[Selected], manoeuvres: dict[str, Separation]) -> str:
    """Return what to drive next for each name that is ambiguous, or that nothing would tell."""
    text = ""
    for one in selected:
        name, rivals = one.candidate.name, ", ".join(one.rivals)
        best = manoeuvres.get(name)
        if best and best.tells:
            text += (
                f" Driving '{best.manoeuvre.name}' ({best.manoeuvre.duration_s:.0f} s, omnislip "
                f"gap plan) would tell {name} from {rivals}: expected separation "
                f"{best.separation:.0f}, right with probability {best.probability:.3g}."
            )
        elif best:
            text += f" No manoeuvre of the library would tell {name} from {rivals}."
    return text


def _wiring_words(effect: Effect) -> str:
    if effect.name == "wheel_permutation":
        order = ", ".join(str(wheel) for wheel in effect.parameters["wheels"])
        of = effect.parameters.get("of", ENCODERS)
        columns = "columns" if of == BOTH else f"columns of the {of}"
        return f"wheel_permutation (the {columns} are those of wheels {order})"
    return f"{effect.name} (wheel {effect.wheel})"


def wiring_words(wiring: Sequence[Effect]) -> str:
    """Return a wiring for people."""
    return "; ".join(_wiring_words(effect) for effect in wiring)


def _undecided(other_wirings: Sequence[list[Effect]]) -> str:
    others = " or ".join(wiring_words(wiring) for wiring in other_wirings)
    return f" These logs cannot tell this wiring from: {others}." if others else ""


def _impact_words(impact: Impact) -> str:
    size = float(np.hypot(*impact.impulse[:2]))
    bearing = float(np.degrees(np.arctan2(impact.impulse[1], impact.impulse[0])))
    when = f"{impact.run} at {impact.time_s:.3f} s"
    return f"impact ({when}, {size:.2g} N s towards {bearing:.0f}° in the world)"


def _jolt_words(impacts: Sequence[Impact]) -> list[str]:
    return [f"{len(impacts)} sudden jumps of velocity, more than anybody pushes"]


def moment_words(moments: Sequence[Moment]) -> str:
    """Return how often shafts jump as no command tells, which ones, and when most."""
    squares = np.mean([one.jump_rad_s**2 for one in moments], axis=0)
    alone = squares > OF_ONE_WHEEL * squares.sum()
    where = f"wheel {np.argmax(squares) + 1}" if alone.any() else "several wheels"
    first = sorted(moments, key=lambda one: -one.ratio)[:3]
    when = ", ".join(f"{one.run} at {one.time_s:.3f} s" for one in first)
    return (
        f"{len(moments)} times {where} suddenly turned slower or faster, by some "
        f"{one_digit(float(squares.max()) ** 0.5)} rad/s of the shaft, as no command tells ({when})"
    )


def one_digit(value: float) -> str:
    """Return a number rounded to its first digit: 20, not 2e+01."""
    return f"{float(f'{value:.1g}'):g}"


def with_deviation(value: float, deviation: float) -> str:
    """Return 'value ± deviation', to the first digit of the deviation: 1.0300 ± 0.0001, 19 ± 6."""
    if not 0 < deviation < np.inf:
        return f"{value:.3g} ± {one_digit(deviation)}"
    last = math.floor(math.log10(float(one_digit(deviation))))
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        text = f"{round(value, -last):.{max(-last, 0)}f}"
    else:
        text = f"{value:.{max(math.floor(math.log10(abs(value))) - last, 0)}e}"
    return f"{text} ± {one_digit(deviation)}"


def _effect_words(machine: Machine, selected: Selected) -> str:
    candidate = selected.candidate
    sizes = []
    for k in candidate.amplitudes:
        name = candidate.parameters[k].label
        unit = machine.unit(candidate.effect, name)
        half = 0.5 * float(np.ptp(selected.interval[k]))
        value = with_deviation(float(selected.values[k]), half)
        sizes.append(
            f"{machine.file_parameter(name)} {value}" + (f" {unit}" if unit != "1" else "")
        )
    return f"{candidate.name} ({', '.join(sizes)})"


def _amend(machine: Machine, outcome: Outcome, mended: Sequence[Effect]) -> Model:
    """Return the model with the refitted keys and the found effects."""
    hypothesis = outcome.final.hypothesis
    base = {
        p.label: float(x) / float(machine.believed[p.places[0]])
        for p, x in zip(hypothesis.base, hypothesis.x, strict=False)
    }
    effects = [machine.effect_of(s.candidate, s.values) for s in outcome.selected]
    return machine.amended_model(base, [*mended, *effects])


def to_json(findings: Findings) -> dict[str, Any]:
    """Return gap.json as a dict."""
    machine, outcome, table = findings.machine, findings.outcome, findings.table
    passed = [_effect_json(findings, s) for s in outcome.selected] if outcome else []
    unknown = findings.verdict == "unknown_effect"
    found = [_impact_json(impact) for impact in findings.impacts] + passed
    effects, nearest = ([], found) if unknown else (found, [])
    others = [_one_wiring(effect) for wiring in findings.other_wirings for effect in wiring]
    effects = [_wiring_json(effect, others) for effect in findings.wiring] + effects
    limited = outcome is not None and not outcome.selected
    return {
        "schema": SCHEMA,
        "verdict": findings.verdict,
        "sentence": findings.sentence,
        "where": [
            {
                "channel": p.channel,
                "condition": p.condition,
                "share_of_gap": p.share,
                "windows_s": [list(w) for w in p.windows_s],
            }
            for p in findings.places
        ],
        "effects": effects,
        "nearest": nearest,
        "unknown": [
            {
                "equation": u.equation,
                "dependence": u.dependence,
                "gain": u.gain,
                "p_value": u.p_value,
                "validation_gain": u.validation_gain,
            }
            for u in (outcome.leftover if outcome else ())
        ],
        "looks_like": [
            {"equation": s.equation, "dependence": s.dependence, "gain": s.gain}
            for s in findings.shapes
        ],
        "cautions": findings.cautions,
        "recording": findings.recording,
        "predictable": [asdict(one) for one in findings.predictable],
        "moments": [
            {
                "run": one.run,
                "time_s": one.time_s,
                "ratio": one.ratio,
                "jump_rad_s": one.jump_rad_s.tolist(),
            }
            for one in findings.moments
        ],
        "unknown_curve": _curve_json(findings.unknown) if findings.unknown else None,
        "balances": [
            {
                "name": b.name,
                "unit": b.unit,
                **{n: float(rms) for n, rms in zip(MODELS, b.rms, strict=True)},
                "sensor_noise": b.noise,
            }
            for b in findings.balances
        ],
        "gap": _table_json(table) if table else None,
        "steps": [
            {"model": s.name, "held_out": s.rmse, "relative_force_error": s.force_error}
            for s in findings.steps
        ],
        "detection_limits": _limits_json(machine, outcome.limits) if limited else {},
        "detection_limits_by_wheel": _limits_by_wheel(outcome.limits) if limited else {},
        "base": _base_json(machine, outcome) if outcome else {},
        "split": {
            "how": findings.split.how,
            "fitting": _names(findings.split.fitting),
        },
        "inputs_sha256": findings.inputs,
    }


def _limits_json(machine: Machine, limits: dict[str, dict[str, float]]) -> dict[str, Any]:
    """Return the limit of each effect on whichever wheel shows it least."""
    worst: dict[str, dict[str, float]] = {}
    for name, own in limits.items():
        effect, _ = effect_and_wheel(name)
        known = worst.setdefault(effect, dict(own))
        for parameter in list(known):
            if parameter not in own:  # shown by no size on this wheel
                del known[parameter]
            elif machine.infinite_when_absent(effect, parameter):
                known[parameter] = min(known[parameter], own[parameter])
            else:
                known[parameter] = max(known[parameter], own[parameter])
    return worst


def _limits_by_wheel(limits: dict[str, dict[str, float]]) -> dict[str, Any]:
    by_wheel: dict[str, dict[str, Any]] = {}
    for name, own in limits.items():
        effect, wheel = effect_and_wheel(name)
        if wheel is not None:
            by_wheel.setdefault(effect, {})[str(wheel)] = own
    return by_wheel


def _curve_json(unknown: Unknown) -> dict[str, Any]:
    return {
        "equation": unknown.equation,
        "dependence": unknown.dependence,
        "x": {"label": unknown.x_label, "values": unknown.x.tolist()},
        "y": {"label": unknown.y_label, "values": unknown.y.tolist()},
        "deviation": unknown.deviation.tolist(),
        "gain": unknown.gain,
        "validation_gain": unknown.validation_gain,
        "hypothesis": {"formula": unknown.formula, "share_of_curve": unknown.formula_share},
    }


def _names(runs: Sequence[Run]) -> list[str]:
    return list(dict.fromkeys(run.name for run in runs))


def _one_wiring(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "wheel": effect.wheel,
        "parameters": {
            name: {"value": value, "low": value, "high": value}
            for name, value in effect.parameters.items()
        },
    }


def _wiring_json(effect: Effect, others: list[dict[str, Any]]) -> dict[str, Any]:
    return _one_wiring(effect) | {
        "ambiguous_with": _names_of(others),
        "rivals": others,
        "separating_manoeuvre": None,
        "evidence": {},
    }


def _impact_json(impact: Impact) -> dict[str, Any]:
    half_s = CONFIDENCE * impact.time_deviation_s
    time_s = {
        "value": impact.time_s,
        "low": impact.time_s - half_s,
        "high": impact.time_s + half_s,
    }
    sizes = {
        key: {"value": v, "low": v - CONFIDENCE * d, "high": v + CONFIDENCE * d}
        for key, v, d in zip(
            IMPACT_KEYS[1:], impact.impulse.tolist(), impact.deviation.tolist(), strict=True
        )
    }
    return {
        "name": "impact",
        "wheel": None,
        "run": impact.run,
        "parameters": {IMPACT_KEYS[0]: time_s, **sizes},
        "ambiguous_with": [],
        "rivals": [],
        "separating_manoeuvre": None,
        "evidence": {},
    }


def _effect_json(findings: Findings, selected: Selected) -> dict[str, Any]:
    machine = findings.machine
    candidate, evidence = selected.candidate, selected.evidence
    manoeuvre = findings.manoeuvres.get(candidate.name)
    sizes = [
        (p.label, {"value": float(v), "low": float(low), "high": float(high)})
        for p, v, (low, high) in zip(
            candidate.parameters, selected.values, selected.interval, strict=True
        )
        if np.isfinite(v)
    ]
    refines = {label for effect, label in EXTENSIONS if effect == candidate.effect}
    parameters = {machine.file_parameter(n): size for n, size in sizes if n not in refines}
    rivals = [
        {"name": name, "wheel": wheel} for name, wheel in map(effect_and_wheel, selected.rivals)
    ]
    return {
        "name": candidate.effect,
        "wheel": candidate.wheel,
        "parameters": parameters,
        "refinement": {n: size for n, size in sizes if n in refines},
        "ambiguous_with": _names_of(rivals),
        "rivals": rivals,
        "separating_manoeuvre": manoeuvre.as_json() if manoeuvre and manoeuvre.tells else None,
        "evidence": {
            "gain": evidence.gain,
            "inflation": evidence.inflation,
            "p_value": evidence.p_value,
            "variation": evidence.variation,
            "stability": selected.stability if np.isfinite(selected.stability) else None,
        },
    }


def _names_of(rivals: Sequence[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(rival["name"] for rival in rivals))


def _table_json(table: GapTable) -> dict[str, Any]:
    channels = {
        channel: {
            **{n: float(table.rmse[m, c]) for m, n in enumerate(MODELS)},
            "noise_floor": float(table.floor[c]),
        }
        for c, channel in enumerate(table.channels)
    }
    closed = table.closed
    return {
        "held_out_runs": list(dict.fromkeys(table.runs)),
        "channels": channels,
        "closed_fraction": asdict(closed),
        "noise_floor_source": table.floor_source,
    }


def _base_json(machine: Machine, outcome: Outcome) -> dict[str, Any]:
    hypothesis = outcome.final.hypothesis
    deviations = prior_penalty(hypothesis, machine.believed, hypothesis.x)
    return {
        p.label: {
            "believed": float(machine.believed[p.places[0]]),
            "fitted": float(x),
            "standard_deviations": float(z),
        }
        for p, x, z in zip(hypothesis.base, hypothesis.x, deviations, strict=False)
    }


def write_results(findings: Findings, directory: Path, report: str) -> None:
    """Write gap.json, robot.toml and report.html; all of them whole or none."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: is a file; --out needs a folder")
    texts = {
        "robot.toml": format_model(findings.amended),
        "report.html": report,
        "gap.json": json.dumps(to_json(findings), indent=2, allow_nan=False) + "\n",
    }
    with ExitStack() as files:
        for name, text in texts.items():
            temporary = files.enter_context(replace_file(directory / name))
            temporary.write_text(text, encoding="utf-8")


def _sha256(path: Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
