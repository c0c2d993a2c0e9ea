"""What `gap find` found out: gap.json, the amended model and the report are written from it."""

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from omnislip.errors import InputError
from omnislip.files import replace_file
from omnislip.gap.balances import Balance
from omnislip.gap.events import Impact
from omnislip.gap.inference import prior_penalty
from omnislip.gap.leftover import Leftover
from omnislip.gap.machine import EXTENSIONS, Machine, effect_and_wheel
from omnislip.gap.metrics import GapTable, Replays
from omnislip.gap.moments import Moment
from omnislip.gap.noise import Noise
from omnislip.gap.plan import Separation
from omnislip.gap.predictable import Predictable
from omnislip.gap.recordings import Run
from omnislip.gap.search import Outcome
from omnislip.gap.selected import CONFIDENCE, Selected
from omnislip.gap.split import Split
from omnislip.gap.unknown import Unknown
from omnislip.gap.where import Map, Place
from omnislip.model_file import IMPACT_KEYS, Effect, Model, format_model

SCHEMA = "omnislip-gap/1"
MODELS = ("believed", "refit", "after")
NOT_ENOUGH, CANNOT_BE_USED = "Not enough data", "The logs cannot be used"


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
    limits: dict[str, dict[str, float]] = field(default_factory=dict)
    """Of detection, by candidate and parameter, where no effect was found: `detection_limits`."""

    @property
    def amended_words(self) -> str:
        """What the amended model is."""
        if self.wiring or self.impacts or (self.outcome and self.outcome.selected):
            return "amended model"
        return "refitted model" if self.outcome else "unchanged model"


def to_json(findings: Findings) -> dict[str, Any]:
    """Return gap.json as a dict."""
    machine, outcome, table = findings.machine, findings.outcome, findings.table
    passed = [_effect_json(findings, s) for s in outcome.selected] if outcome else []
    unknown = findings.verdict == "unknown_effect"
    found = [_impact_json(impact) for impact in findings.impacts] + passed
    effects, nearest = ([], found) if unknown else (found, [])
    others = [_one_wiring(effect) for wiring in findings.other_wirings for effect in wiring]
    effects = [_wiring_json(effect, others) for effect in findings.wiring] + effects
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
        "detection_limits": _limits_json(machine, findings.limits),
        "detection_limits_by_wheel": _limits_by_wheel(findings.limits),
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
        "closed_fraction": {k: v for k, v in asdict(closed).items() if k != "gap"},
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
