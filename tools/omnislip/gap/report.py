"""The report of `omnislip gap find`: one HTML page that needs no other file and no network.

The numbers are those of gap.json (`to_json`); the page adds pictures, the trials of the search and
what is needed to repeat the work. The words stand in report.html.j2, the drawing in
report_pictures.py.
"""

import math
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from omnislip.gap import (
    answers,
    inference,
    judge,
    leftover,
    metrics,
    refit,
    report_pictures,
    rivals,
    search,
    split,
    verdict,
    words,
)
from omnislip.gap.findings import CANNOT_BE_USED, NOT_ENOUGH, Findings, to_json
from omnislip.gap.judge import Trial
from omnislip.gap.machine import (
    KEY_REACH,
    Candidate,
    Machine,
    effect_and_wheel,
    name_on_wheel,
)
from omnislip.gap.metrics import Replays
from omnislip.gap.recordings import ODOMETRY_CHANNELS, Run
from omnislip.model_file import format_model

Json = dict[str, Any]

HEADLINES = {
    "effect_found": "Missing effect found",
    "no_gap": "No gap found",
    "unknown_effect": "Something unknown is missing",
    "insufficient_data": NOT_ENOUGH,
}
CHANNELS = {
    **{f"wheel/{w}/encoder_counts": (f"encoder {w}", "counts") for w in range(1, 5)},
    "gyro/z_rad_s": ("gyro", "rad/s"),
    "pose/x_m": ("position x", "m"),
    "pose/y_m": ("position y", "m"),
    "pose/theta_rad": ("heading", "rad"),
    "pose/forward_m": ("position along the robot", "m"),
    "pose/lateral_m": ("position across the robot", "m"),
    "supply/voltage_v": ("bus voltage", "V"),
    **{f"wheel/{w}/current_a": (f"current {w}", "A") for w in range(1, 5)},
    "axis/position_m": ("position", "m"),
    "axis/position_rad": ("angle", "rad"),
}
EQUATIONS = {
    **{f"wheel/{w}/torque": f"wheel {w}: torque" for w in range(1, 5)},
    "body/force_x": "body: force along x",
    "body/force_y": "body: force along y",
    "body/moment": "body: turning moment",
    "pose/position": "position or camera",
    "pose/heading": "heading or camera",
    "axis/force": "force balance",
}
MODELS = ("believed", "refitted", "with effect")
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def render(findings: Findings, command_line: str) -> str:
    """Return the report as the text of an HTML file; `command_line` is what the user typed."""
    numbers = to_json(findings)
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = format_number
    environment.filters["with_deviation"] = words.with_deviation
    with mpl.rc_context(report_pictures.STYLE):
        return environment.get_template("report.html.j2").render(
            numbers=numbers,
            headline=_headline(numbers),
            cannot_be_used=CANNOT_BE_USED,
            name=findings.machine.model.name or findings.machine.kind,
            added_text=_added_text(findings),
            effects=_effects(findings, numbers),
            impact_columns=IMPACT_COLUMNS,
            curve=report_pictures.curve_picture(findings.unknown) if findings.unknown else None,
            gap=_gap(findings, numbers),
            ladder=_ladder(findings),
            where=_where(findings),
            overlays=_overlays(findings),
            steps=_steps(findings),
            limits=_limits(findings) if findings.limits else [],
            keys=_keys(numbers["base"]),
            held_out=_held_out_names(findings),
            command_line=command_line,
            versions=_versions(),
            thresholds=_thresholds(),
        )


def format_number(value: float | None, width: float = 0.0) -> str:
    """Return three significant digits, with a power of ten where plain digits would be long.

    More where an interval of this `width` would not show.
    """
    if value is None or not np.isfinite(value):
        return "–"
    digits = 3
    half = 0.5 * width
    if value and 0 < half < abs(value):
        digits = max(digits, math.floor(math.log10(abs(value))) - math.floor(math.log10(half)) + 1)
    if value == 0 or 1e-4 <= abs(value) < 1e5:
        short = digits > 3 or abs(value) < 100
        text = f"{value:#.{digits}g}".rstrip(".") if short else f"{value:.0f}"
        return text.replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa} × 10{str(int(exponent)).translate(SUPERSCRIPTS)}".replace("-", "−")


def _headline(numbers: Json) -> str:
    if any(effect["ambiguous_with"] for effect in numbers["effects"]):
        return "Missing effect found, its name is not certain"
    if numbers["sentence"].startswith(CANNOT_BE_USED):
        return CANNOT_BE_USED
    return HEADLINES[numbers["verdict"]]


def _added_text(findings: Findings) -> str:
    """Return the effect tables of the amended model file that the given one does not have."""
    blocks = format_model(findings.amended).strip().split("\n\n")
    tables = [block for block in blocks if block.startswith("[[effects.")]
    return "\n\n".join(tables[len(findings.machine.model.effects) :])


IMPACT_COLUMNS = {
    "impulse_x_n_s": "along x, N s",
    "impulse_y_n_s": "along y, N s",
    "impulse_theta_n_m_s": "turning, N m s",
}
GATE_TEXTS = {
    "impact": {
        "summary": "Something pushed the robot; the logs are cut there.",
        "equation": "jump of the body's momentum, world frame",
    },
    "wheel_permutation": {
        "summary": "Encoders, motors or both are connected in another order than the columns say.",
        "equation": "column i is of wheel wheels[i]",
    },
    "encoder_sign": {
        "summary": "An encoder counts the wrong way round.",
        "equation": "counts of this wheel times -1",
    },
    "motor_sign": {
        "summary": "A motor turns the wrong way round.",
        "equation": "duty of this wheel times -1",
    },
}


def _effects(findings: Findings, numbers: Json) -> list[Json]:
    """One entry per effect of the amended model: its catalogue text, sizes and rivals.

    All pushes are one entry.
    Where the verdict is unknown these are the nearest known effects.
    """
    machine, pushes = findings.machine, len(findings.impacts)
    named = findings.outcome.selected if findings.outcome else []
    nothing = {"sizes": [], "pushes": [], "rivals": [], "stability": None}
    nothing |= {"manoeuvre": None, "none_tells": False}
    terms = numbers["effects"][len(findings.wiring) :] or numbers["nearest"]
    gates = [
        nothing
        | {
            "name": name_on_wheel(effect.name, effect.wheel),
            "entry": GATE_TEXTS[effect.name],
            "rivals": [
                (words.wiring_words(wiring), "another wiring") for wiring in findings.other_wirings
            ],
        }
        for effect in findings.wiring
    ]
    if pushes:
        rows = [
            {"run": impact.run, **found["parameters"]}
            for impact, found in zip(findings.impacts, terms[:pushes], strict=True)
        ]
        gates.append(nothing | {"name": "impact", "entry": GATE_TEXTS["impact"], "pushes": rows})
    return gates + [
        nothing
        | {
            "name": selected.candidate.name,
            "entry": machine.catalogue[selected.candidate.effect],
            "sizes": [
                {"name": name, "unit": _unit(machine, selected.candidate, name), **size}
                for name, size in (effect["parameters"] | effect["refinement"]).items()
            ],
            "rivals": [(rival, _summary(machine, rival)) for rival in selected.rivals],
            "stability": effect["evidence"]["stability"],
            "manoeuvre": effect["separating_manoeuvre"],
            "none_tells": selected.candidate.name in findings.manoeuvres,
        }
        for selected, effect in zip(named, terms[pushes:], strict=True)
    ]


def _unit(machine: Machine, candidate: Candidate, file_name: str) -> str:
    """Unit of a parameter named as in the model file; nothing for a bare number."""
    label = next(
        p.label for p in candidate.parameters if machine.file_parameter(p.label) == file_name
    )
    unit = machine.unit(candidate.effect, label)
    return "" if unit == "1" else unit


def _summary(machine: Machine, candidate_name: str) -> str:
    return machine.catalogue[effect_and_wheel(candidate_name)[0]]["summary"]


def _has_effect(findings: Findings) -> bool:
    return bool(findings.outcome and findings.outcome.selected)


def _gap(findings: Findings, numbers: Json) -> Json | None:
    """Rows of the gap table and its picture; the last model only where an effect was added."""
    table = findings.table
    if table is None:
        return None
    models = MODELS if _has_effect(findings) else MODELS[:2]
    rows = [
        {"name": CHANNELS[channel][0], "channel": channel, "unit": CHANNELS[channel][1], **figures}
        for channel, figures in numbers["gap"]["channels"].items()
    ]
    names = [row["name"] for row in rows]
    return {
        "rows": rows,
        "with_effect": _has_effect(findings),
        "picture": report_pictures.gap_picture(table, names, models),
        **numbers["gap"],
    }


def _ladder(findings: Findings) -> Json | None:
    """How the errors fall with each effect; None where there is nothing between refit and all."""
    steps = findings.steps
    force = any(step.force_error for step in steps)
    if len(steps) <= 3 and not force:
        return None
    return {
        "channels": [CHANNELS[channel] for channel in steps[0].rmse],
        "rows": [
            {
                "model": "refitted" if step.name == "refit" else step.name,
                "rmse": list(step.rmse.values()),
                "force_error": list(step.force_error.values()),
            }
            for step in steps
        ],
        "force": force,
    }


def _where(findings: Findings) -> Json | None:
    """Places of the gap in words, and pictures of its equations and times."""
    gap_map = findings.gap_map
    if gap_map is None or findings.verdict == "no_gap" or not gap_map.shares.any():
        return None
    robot = None
    if findings.machine.kind == "robot":
        angles = findings.machine.model.values["robot.wheel_angles_deg"]
        robot = report_pictures.robot_picture(angles, gap_map.shares[:7])
    runs = [run.name for run in findings.split.fitting]
    equations = [EQUATIONS[equation] for equation in gap_map.equations]
    return {
        "places": [
            {
                "name": EQUATIONS[p.channel],
                "condition": p.condition,
                "share": p.share,
                "windows": p.windows_s,
            }
            for p in findings.places
        ],
        "robot": robot,
        "shares": report_pictures.share_picture(equations, gap_map.shares),
        "times": report_pictures.time_picture(runs, gap_map, findings.places),
    }


def _overlays(findings: Findings) -> list[Json]:
    """Pictures of every held-out run, the one with the largest gap first."""
    models = list(enumerate(MODELS))
    shown = models[1:] if _has_effect(findings) else models[:2]
    return [
        {"name": _held_out_name(findings, one.run), "pictures": _run_pictures(one, shown)}
        for one in sorted(findings.replays, key=_size_of_gap, reverse=True)
    ]


def _size_of_gap(replays: Replays) -> float:
    """Mean square error of the refitted model in units of the noise."""
    ratio = replays.errors[1][replays.counted] ** 2 / replays.floor_variance[replays.counted]
    return float(np.nanmean(ratio))


def _run_pictures(replays: Replays, models: Sequence[tuple[int, str]]) -> list[Json]:
    pictures = []
    for index, channel in enumerate(replays.run.channels):
        if np.all(np.isnan(replays.errors[0][replays.counted, index])):
            continue
        name, unit = CHANNELS[channel]
        cumulative = unit == "counts" or channel in ODOMETRY_CHANNELS
        picture = report_pictures.replay_picture(replays, index, unit, cumulative, models)
        pictures.append({"name": name, "channel": channel, "source": picture})
    return pictures


def _steps(findings: Findings) -> list[Json]:
    """Trials of the search, step by step, with a ranking picture each."""
    if not findings.outcome:
        return []
    trials = findings.outcome.trials
    final = {one.candidate.name for one in findings.outcome.selected}
    steps = []
    for number in sorted({trial.step for trial in trials}):
        own = [trial for trial in trials if trial.step == number]
        rows = [{"trial": t, "sizes": _trial_sizes(findings.machine, t)} for t in own]
        taken = next((row for row in rows if row["trial"].accepted), None)
        steps.append(
            {
                "number": number,
                "picture": report_pictures.ranking_picture(own) if _gained(own) else None,
                "trials": rows,
                "taken": taken,
                "gave_way": taken is not None and taken["trial"].candidate.name not in final,
            }
        )
    return steps


def _trial_sizes(machine: Machine, trial: Trial) -> list[str]:
    sizes = []
    for parameter, value in zip(trial.candidate.parameters, trial.values, strict=True):
        name = machine.file_parameter(parameter.label)
        unit = _unit(machine, trial.candidate, name)
        sizes.append(f"{name} {format_number(float(value))} {unit}".strip())
    return sizes


def _limits(findings: Findings) -> list[Json]:
    """Detection limits, the best seen effects first (limit over the size worth looking for).

    Of what is infinite when absent what is smaller is seen.
    """
    machine, limits, rows = findings.machine, findings.limits, []
    patches = machine.floor_candidates(findings.split.fitting)
    for candidate in (*machine.candidates(), *patches):
        for index in candidate.amplitudes:
            parameter = candidate.parameters[index]
            name = machine.file_parameter(parameter.label)
            limit = limits.get(candidate.name, {}).get(name)
            if limit is None:
                continue
            neutral = machine.believed[parameter.places[0]]
            room = max(parameter.high - neutral, neutral - parameter.low)
            ratio = limit / parameter.scale
            rows.append(
                {
                    "effect": candidate.name,
                    "summary": machine.catalogue[candidate.effect]["summary"],
                    "parameter": name,
                    "unit": _unit(machine, candidate, name),
                    "limit": limit,
                    "typical": parameter.scale,
                    "ratio": ratio if np.isfinite(neutral) else 1.0 / ratio,
                    "below": not np.isfinite(neutral),
                    "many": len(candidate.amplitudes) > 1,
                    "visible": limit <= room,
                }
            )
    return sorted(rows, key=lambda row: row["ratio"])


def _keys(base: Json) -> Json | None:
    """How the believed keys moved: rows and picture."""
    if not base:
        return None
    rows = [
        {"key": key, "at_bound": abs(moved["standard_deviations"]) > KEY_REACH - 1e-6, **moved}
        for key, moved in base.items()
    ]
    deviations = [row["standard_deviations"] for row in rows]
    names = [row["key"] for row in rows]
    picture = report_pictures.keys_picture(names, deviations, [row["at_bound"] for row in rows])
    return {"rows": rows, "picture": picture, "reach": KEY_REACH}


def _held_out_names(findings: Findings) -> list[str]:
    return list(dict.fromkeys(_held_out_name(findings, run) for run in findings.split.held_out))


def _gained(trials: Sequence[Trial]) -> bool:
    """Whether anything gained more than the axis of the picture begins with."""
    return any(trial.evidence.gain > 1.0 for trial in trials)


def _held_out_name(findings: Findings, run: Run) -> str:
    """Name of a run, with the times of a part whose log was fitted otherwise."""
    if run.name not in {fitted.name for fitted in findings.split.fitting}:
        return run.name
    return f"{run.name} from {run.time_s[0]:.1f} to {run.time_s[-1]:.1f} s"


def _versions() -> dict[str, str]:
    packages = ("omnislip", "numpy", "scipy")
    return {**{p: version(p) for p in packages}, "Python": platform.python_version()}


def _thresholds() -> list[tuple[str, str]]:
    """The numbers that decide, each with what it decides."""
    return [
        (
            f"{judge.ALPHA:g}",
            "largest probability that chance alone gives such a gain, over everything tried",
        ),
        (
            f"{100 * inference.HELPED_SHARE:g} %",
            "least share of the runs that an effect must improve by sizes that fit the others",
        ),
        (
            f"{100 * math.sqrt(judge.SHAPE_SHARE):.0f} %",
            "how far a robot may be off what the effects of the model do: another effect is named "
            "if its gain / inflation is beyond what that can leave",
        ),
        (
            f"{rivals.RIVAL_MARGIN:g}",
            "a rival whose gain is smaller by less than this cannot be told from the effect",
        ),
        (
            f"{100 * math.sqrt(leftover.UNKNOWN_SHARE):.0f} %",
            "how far it may be off them for nameless terms (friction curve: "
            f"{100 * math.sqrt(leftover.CURVE_SHARE):.0f} %): one that gains more than that can "
            "leave makes the verdict unknown",
        ),
        (
            f"{verdict.LEAST_REST:g}",
            "least gain / inflation of such a term",
        ),
        (
            f"{answers.FEIGNED_GAIN:g}",
            "least gain / inflation of anything where a controller answers disturbances "
            f"({answers.UNDRIVEN:g} times as much where a direction is not driven)",
        ),
        (
            f"{100 * verdict.VARIES:.0f} %",
            "change of an effect's size from half second to half second that makes it unknown, or "
            "less of it that leaves as much as such a term gains",
        ),
        (f"{judge.MOST_EFFECTS}", "most effects that are added"),
        (
            f"{search.REFITS}",
            f"candidates of each step that are fitted: all by what they add, the best up to "
            f"{refit.FULL_REFITS} of them fully",
        ),
        (f"{split.LEAST_TIME_S:g} s", "least total length of the logs"),
        (f"{metrics.WINDOW_S:g} s", "length of a replay before it starts again"),
    ]
