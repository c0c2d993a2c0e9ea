"""The verdict and its cautions as sentences with numbers."""

import math
from collections.abc import Sequence

import numpy as np

from omnislip.gap.events import Impact
from omnislip.gap.inference import Fit
from omnislip.gap.judge import DELAY, LAGS, SURE_GAIN, TOO_SHORT
from omnislip.gap.leftover import Leftover
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import LEAST_EXCESS, GapTable, Replays, gap_table
from omnislip.gap.moments import Moment
from omnislip.gap.plan import Separation
from omnislip.gap.predictable import Predictable
from omnislip.gap.search import Outcome
from omnislip.gap.selected import Selected
from omnislip.gap.split import RUNS_TO_HOLD_OUT_WHOLE, Split
from omnislip.gap.unknown import Unknown
from omnislip.gap.verdict import (
    PROVEN,
    better_without_name,
    keys_told,
    missing_terms,
    much_is_left,
    no_chance,
    refused_in_places,
    surely_refused,
    too_many_keys,
    unsteady,
    varying,
)
from omnislip.model_file import BOTH, ENCODERS, Effect

FEW_RUNS = (
    f"With fewer than {RUNS_TO_HOLD_OUT_WHOLE} logs the choice was checked on parts of runs whose "
    "other parts were fitted: a name may change with more."
)
BLIND = "where rows are missing: a push cannot be told from what was commanded there"
HELD_COMMANDS = "duties: taken as held from row to row, as a controller at the rate of the log does"
OTHER_ZEROS = (
    "encoders: count from elsewhere in each log or at each wheel, as what repeats with their angle "
    "tells; taken as if they did not"
)
OTHER_STARTS = (
    "no camera: where and which way a log begins is taken as what is fixed to the world tells; its "
    "directions and places are those of the first log, or of logs that a camera sees"
)
READ_BEFORE = "currents and voltage: taken as read before the duty of their row began"
WEAK_SHARE = 1e-2
"""Square of how far the other effects may be off what they do before they leave as much as a name
gains, below which it carries a caution; below a tenth of this the search gives none."""
OF_ONE_WHEEL = 0.8
"""Share of the squares of sudden jumps from which they are of one wheel."""


def only_held_out_words(split: Split, fitted_replays: Sequence[Replays]) -> str:
    """Say so where whole logs are held out that are far off, and what was fitted is not."""
    held_out = split.logs_held_out
    if not held_out or gap_table(fitted_replays).left.excess >= LEAST_EXCESS:
        return ""
    return (
        f"The model explains the runs that were fitted; what is off is in {', '.join(held_out)}, "
        f"held out. If all are of one robot in one state, more logs like that are needed to tell "
        f"what it is; else look at each alone."
    )


def turned_words(split: Split) -> str:
    """Say which logs were held out first."""
    names = ", ".join(split.logs_held_out)
    return f"{names}: held out first, and far off when the others were explained; fitted therefore"


def unproven_words(selected: Sequence[Selected], table: GapTable) -> str:
    """Return why names are not given that close nothing on held-out runs."""
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


def unstable_words(one: Selected) -> str:
    """Return the caution for a name that resamples of the runs do not confirm."""
    return (
        f"{one.candidate.name} is the best name in only {100 * one.stability:.0f} % of resamples "
        "of the runs: a name may change with more."
    )


def short_delay_words(outcome: Outcome) -> list[str]:
    """Return the caution for commands that surely act later, but less than the rows can time."""
    if any(effect.effect in LAGS for effect in outcome.final.hypothesis.effects):
        return []
    short = [
        trial
        for trial in outcome.trials
        if trial.candidate.effect == DELAY
        and trial.reason.endswith(TOO_SHORT)
        and trial.evidence.beyond_chance > SURE_GAIN
    ]
    return [
        f"Commands act {1e3 * trial.values[0]:.2g} ms later than their rows say, which a "
        "controller that ticks within the rows may do as well: no delay is named."
        for trial in short[-1:]
    ]


def weak_names(selected: Sequence[Selected]) -> list[str]:
    """Return a caution for each name that others would leave if their shapes were a bit wrong."""
    shares = [(one, one.evidence.beyond_chance / one.left) for one in selected if one.left]
    return [
        f"{one.candidate.name} is weak: the other effects would leave as much if they were "
        f"{100 * share**0.5:.0f} % off in what they do."
        for one, share in shares
        if share < WEAK_SHARE
    ]


def unsteady_names(selected: Sequence[Selected]) -> list[str]:
    """Return a caution for each name whose size changes by more than chance."""
    return [
        f"The size of {one.candidate.name} changes by {100 * one.evidence.variation:.0f} % from "
        "half second to half second: its shape is not quite what is there."
        for one in unsteady(selected)
    ]


def _as_usual(table: GapTable) -> str:
    usual = table.left.usual
    return f" (where it explains a run it leaves {usual:.2g})" if usual >= LEAST_EXCESS else ""


def verdict_words(
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
        elif terms := missing_terms(outcome):
            term = terms[0]
            text += f": {term.equation}, depending on {term.dependence}"
        elif sure := [one for one in shares if no_chance(one)]:
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
            for one in varying(outcome.selected)
        )
        nameless = better_without_name(outcome.selected)
        text += "".join(
            f"; {one.instead.equation}, depending on {one.instead.dependence}, explains "
            f"{100 * (one.instead.gain / one.evidence.gain - 1):.0f} % more than "
            f"{one.candidate.name}, which is nearest"
            for one in nameless
            if one.instead
        )
        if outcome.law:
            text += (
                f"; {outcome.law.equation}, depending on {outcome.law.dependence}, explains by "
                "itself what takes all the names"
            )
        if refused := surely_refused(outcome):
            text += f"; {refused.candidate.name} explains much of it in some runs and spoils others"
        elif refused := refused_in_places(outcome, table):
            text += f"; {refused.candidate.name} explains much of it, but in few places only"
        if much_is_left(table, outcome.selected):
            off = (1.0 + table.left.excess) ** 0.5
            text += f"; replays of held-out runs are {off:.2g} noise floors off"
        if ends := too_many_keys(outcome):
            text += (
                f"; {len(ends)} of {len(outcome.final.hypothesis.base)} believed values would be "
                f"more than two tolerances off ({', '.join(ends)})"
            )
        if not (unknown or nameless or moments or missing_terms(outcome)) and shapes:
            like = shapes[0]
            text += f"; most of it looks like {like.equation}, depending on {like.dependence}"
        text += "."
        return text + (f" Nearest known: {'; '.join(parts)}." if parts else "")
    text = "Missing: " + "; ".join(parts) + "."
    closed = table.closed
    if closed.value is not None and closed.high < PROVEN:  # so it is sure elsewhere
        text += (
            f" Held-out runs hardly show it: only {closed.gap:.2g} noise floors are off there"
            f"{_as_usual(table)}, and the model with it hardly comes nearer. Drive what was fitted"
            " again to see a gap close."
        )
    elif closed.value is not None:
        text += (
            f" Added to the model, {100 * closed.value:.0f} % of the gap on held-out runs closes"
            f" ({100 * closed.low:.0f} to {100 * closed.high:.0f} %)."
        )
    rivals = [s for s in outcome.selected if s.rivals]
    for one in rivals:
        text += f" These logs cannot tell {one.candidate.name} from {', '.join(one.rivals)}."
    return text


def keys_words(fitted: Fit, machine: Machine) -> list[str]:
    """Return a caution with the believed keys that would go beyond two tolerances, if any."""
    told = [
        f"{key} ({100 * z * machine.model.tolerance_of(key):+.2g} %)"
        for key, z in keys_told(fitted, machine.believed).items()
    ]
    return [f"Two tolerances off or more: {', '.join(told)}."] if told else []


def advice(selected: Sequence[Selected], manoeuvres: dict[str, Separation]) -> str:
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


def one_wiring_words(effect: Effect) -> str:
    """Return a wrong wire, or order of wires, for people."""
    if effect.name == "wheel_permutation":
        order = ", ".join(str(wheel) for wheel in effect.parameters["wheels"])
        of = effect.parameters.get("of", ENCODERS)
        columns = "columns" if of == BOTH else f"columns of the {of}"
        return f"wheel_permutation (the {columns} are those of wheels {order})"
    return f"{effect.name} (wheel {effect.wheel})"


def wiring_words(wiring: Sequence[Effect]) -> str:
    """Return a wiring for people."""
    return "; ".join(one_wiring_words(effect) for effect in wiring)


def undecided_words(other_wirings: Sequence[list[Effect]]) -> str:
    """Return a sentence with the wirings that logs cannot tell from the one found; or nothing."""
    others = " or ".join(wiring_words(wiring) for wiring in other_wirings)
    return f" These logs cannot tell this wiring from: {others}." if others else ""


def impact_words(impact: Impact) -> str:
    """Return a push with its time, size and bearing."""
    size = float(np.hypot(*impact.impulse[:2]))
    bearing = float(np.degrees(np.arctan2(impact.impulse[1], impact.impulse[0])))
    when = f"{impact.run} at {impact.time_s:.3f} s"
    return f"impact ({when}, {size:.2g} N s towards {bearing:.0f}° in the world)"


def jolt_words(impacts: Sequence[Impact]) -> list[str]:
    """Return what too many pushes are told as."""
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
