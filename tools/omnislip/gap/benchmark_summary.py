"""What the rows of `omnislip gap benchmark` say: figures, tables, and the confusion as a picture.

A figure is a share with its 95 % Wilson interval, a median or a mean. Singles, doubles and triples
count where the oracle sees every hidden effect (`VISIBLE`); a case that failed counts as not right,
and so does one whose logs were refused though something is hidden in them that can be seen. Of
nulls that were refused nobody knows whether they had been right: they count as refused only. The
sections of `sections` are printed as tables and written to summary.json:

    summary   every class of cases
    groups    by friction curve and by open or closed loop
    effects   every hidden effect: how often it was named, in sets of one or two
    methods   the workflow beside the baselines and the oracle, on cases that all of them were asked
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from omnislip.files import replace_file, write_text
from omnislip.gap.baselines import METHODS
from omnislip.gap.benchmark import FAILED, REFUSED, SIZES, VISIBLE
from omnislip.gap.machine import CURVE
from omnislip.gap.truth_effects import UNKNOWN_EFFECTS

Row = dict[str, Any]
Numbers = dict[str, Any]
"""`value`, the number of cases `of`; of a share also `hits`, `low` and `high`."""

DRAWN = ("single", "unknown", "null", "wiring")
NOTHING, UNKNOWN = "nothing", "unknown"
SUMMARY, CONFUSION = "summary.json", "confusion.png"
OF_CATALOGUE = ("single", "double", "triple")
NOT_IN_CATALOGUE = ("impact", "wiring", "unknown")
"""Classes in which the oracle sees nothing; all their cases count."""


def sections(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Return all figures: of the summary by name, of the others by name and column."""
    return {
        "summary": summary(rows),
        "groups": by_group(rows),
        "effects": by_effect(rows),
        "methods": by_method(rows),
    }


def write_summary(rows: Sequence[Row], out: Path) -> dict[str, dict[str, Any]]:
    """Write summary.json and the confusion matrix to `out`; return the sections."""
    figures = sections(rows)
    write_text(out / SUMMARY, json.dumps(figures, indent=1, allow_nan=False) + "\n")
    draw_confusion(rows, out / CONFUSION)
    return figures


def summary(rows: Sequence[Row]) -> dict[str, Numbers]:
    """Return the figures of all classes."""
    of = {kind: [r for r in rows if r["kind"] == kind] for kind in SIZES["full"]}
    seen = {kind: [r for r in of[kind] if _seen(r)] for kind in OF_CATALOGUE}
    named = [r for own in seen.values() for r in own]
    sizes = [s for r in named for s in r["sizes"]]
    pushes = [r["impacts"] for r in of["impact"] if r["impacts"]]
    in_time = [n < p["in_time"] for p in pushes for n in range(p["hidden"])]
    jolts = [r["impacts"] for r in rows if r["impacts"]]
    true_pushes = [n < p["in_time"] for p in jolts for n in range(p["found"])]
    nulls = [r for r in of["null"] if not _refused(r)]
    misnamed = [r["verdict"] in ("effect_found", FAILED) and not r["first"] for r in of["unknown"]]
    complete = [r for r in rows if r["exact"] and r["chance"] is not None]
    return {
        "failed": share([_failed(r) for r in rows]),
        "logs refused": share([_refused(r) for r in rows]),
        "single, double or triple, visible: logs refused": share([_refused(r) for r in named]),
        "null: logs refused": share([_refused(r) for r in of["null"]]),
        "single: first name right": share([r["first"] for r in seen["single"]]),
        "single: exact set": share([r["exact"] for r in seen["single"]]),
        "wheel right": share([r["wheel"] for r in named if r["wheel"] is not None]),
        "size error, median": _median([s["error"] for s in sizes]),
        "interval holds the size": share([s["inside"] for s in sizes]),
        "null: false alarm": share([not r["exact"] for r in nulls]),
        "null: called unknown": share([r["verdict"] == "unknown_effect" for r in nulls]),
        "right set: chance below 0.01 in the last step": share(
            [r["chance"] < 0.01 for r in complete]
        ),
        "double: both found": share([all(r["recall"]) for r in seen["double"]]),
        "double: exact set": share([r["exact"] for r in seen["double"]]),
        "triple: all found": share([all(r["recall"]) for r in seen["triple"]]),
        "triple: exact set": share([r["exact"] for r in seen["triple"]]),
        "unknown: flagged": share([r["verdict"] == "unknown_effect" for r in of["unknown"]]),
        "unknown: misnamed": share(misnamed),
        "truth inside the ambiguity set": share([i for r in named for i in r["in_set"]]),
        "ambiguity set, mean size": _mean([n for r in named for n in r["set_size"]]),
        "gap closed against the oracle, median": _median(_closed(named)),
        "impacts in time": share(in_time),
        "impacts found that are there": share(true_pushes),
        "wiring: right": share([r["exact"] for r in of["wiring"]]),
        "time, median s": _median([r["time_s"] for r in rows if r["time_s"] is not None]),
        "time of all baselines, median s": _median(
            [r["baselines_time_s"] for r in rows if r["baselines_time_s"] is not None]
        ),
    }


def by_group(rows: Sequence[Row]) -> dict[str, dict[str, Numbers]]:
    """Return first name and exact set of singles, and false alarms, by curve and by loop."""
    groups: dict[str, Callable[[Row], bool]] = {
        "friction curve as believed": lambda r: r["friction_curve"] == "atan",
        "friction curve another": lambda r: r["friction_curve"] != "atan",
        "open loop": lambda r: not r["closed_loop"],
        "closed loop": lambda r: r["closed_loop"],
    }
    return {name: _names([r for r in rows if inside(r)]) for name, inside in groups.items()}


def by_method(rows: Sequence[Row]) -> dict[str, dict[str, Numbers]]:
    """Return the same for every method, and the replay error on held-out runs."""
    asked = [r for r in rows if _failed(r) or r["workflow: replay_error"] is not None]
    result = {}
    for method in ("workflow", *METHODS, "oracle"):
        errors = [r[f"{method}: replay_error"] for r in asked]
        figures = {"replay error, median": _median([e for e in errors if e is not None])}
        if method == "workflow":
            figures = _names(asked) | figures
        elif method in METHODS:
            answered = [r for r in asked if not _failed(r)]
            figures = _names(answered, f"{method}: ") | figures
        result[method] = figures
    return result


def _names(rows: Sequence[Row], of: str = "") -> dict[str, Numbers]:
    """Return how good the names are; `of` stands before the columns of a method."""
    single = [r for r in rows if r["kind"] == "single" and _seen(r)]
    null = [r for r in rows if r["kind"] == "null" and not _refused(r)]
    return {
        "first name right": share([r[f"{of}first"] for r in single]),
        "exact set": share([r[f"{of}exact"] for r in single]),
        "false alarm": share([not r[f"{of}exact"] for r in null]),
    }


def by_effect(rows: Sequence[Row]) -> dict[str, dict[str, Numbers]]:
    """Return for every hidden effect how often it was named, or flagged where it is unknown."""
    hits: dict[str, list[bool]] = {}
    counts: dict[str, int] = {}
    for row in rows:
        flagged = row["verdict"] == "unknown_effect"
        recall = row["recall"]
        if row["kind"] == "impact":
            recall = [n < row["impacts"]["in_time"] for n in range(len(recall))]
        for label, named in zip(row["hidden"], recall, strict=True):
            effect = _bare(label)
            counts[effect] = counts.get(effect, 0) + 1
            own = hits.setdefault(effect, [])
            if _seen(row):
                own.append(flagged if row["kind"] == "unknown" else named)
    return {
        effect: {"found where visible": share(hits[effect]), "hidden": {"value": counts[effect]}}
        for effect in sorted(hits)
    }


def _failed(row: Row) -> bool:
    return row["verdict"] == FAILED


def _refused(row: Row) -> bool:
    return row["verdict"] == REFUSED


def _seen(row: Row) -> bool:
    """Whether the oracle sees all that is hidden; a case that failed counts as seen."""
    if not row["hidden"] or row["kind"] in NOT_IN_CATALOGUE or _failed(row):
        return True
    return (row["lambda"] or 0) >= VISIBLE


def _closed(rows: Sequence[Row]) -> list[float]:
    """Return shares of the oracle's closed gap; a case without an answer closes nothing."""
    closed = [
        r["gap_closed"] / r["gap_closed_oracle"]
        for r in rows
        if r["gap_closed"] is not None and (r["gap_closed_oracle"] or 0) > 0.05
    ]
    return closed + [0.0 for r in rows if _failed(r) or _refused(r)]


def share(hits: Sequence[bool]) -> Numbers:
    """Return a share with its 95 % interval (Wilson 1927)."""
    counted = {"hits": sum(hits), "of": len(hits)}
    if not hits:
        return counted | {"value": None, "low": None, "high": None}
    z, value, count = 1.959964, sum(hits) / len(hits), len(hits)
    middle = (value + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(value * (1 - value) / count + z**2 / (4 * count**2))
    return counted | {"value": value, "low": float(middle - half), "high": float(middle + half)}


def _median(values: Sequence[float]) -> Numbers:
    return {"value": float(np.median(values)) if len(values) else None, "of": len(values)}


def _mean(values: Sequence[float]) -> Numbers:
    return {"value": float(np.mean(values)) if len(values) else None, "of": len(values)}


def tables(figures: dict[str, dict[str, Any]], title: str) -> list[Table]:
    """Return one table per section that holds anything."""
    first = Table("figure", "reached", "interval", "cases", title=f"{title}, 95 % intervals")
    for name, one in figures["summary"].items():
        if one["value"] is not None:
            cases = f"{one['hits']} of {one['of']}" if "hits" in one else str(one["of"])
            first.add_row(name, f"{one['value']:.3f}", _interval(one), cases)
    headings = {
        "groups": "singles that are visible, and nulls",
        "effects": "found, by hidden effect (unknown ones: flagged)",
        "methods": "methods on the same logs; replay error in noise floors, held-out runs",
    }
    rest = [_table(figures[key], text) for key, text in headings.items() if figures[key]]
    return [first, *rest]


def _table(section: dict[str, dict[str, Numbers]], title: str) -> Table:
    columns = list(dict.fromkeys(column for one in section.values() for column in one))
    table = Table("", *columns, title=title)
    for name, one in section.items():
        table.add_row(name, *(_cell(one[column]) if column in one else "" for column in columns))
    return table


def _cell(one: Numbers) -> str:
    if one["value"] is None:
        return ""
    if "hits" in one:
        return f"{one['hits']} of {one['of']} ({_interval(one)})"
    return f"{one['value']:.2f}" if isinstance(one["value"], float) else str(one["value"])


def _interval(one: Numbers) -> str:
    return f"{one['low']:.2f} to {one['high']:.2f}" if "low" in one else ""


def draw_confusion(rows: Sequence[Row], path: Path) -> None:
    """Draw hidden effect against the first name given (png), of singles that are visible."""
    pairs = [_hidden_and_given(row) for row in rows if row["kind"] in DRAWN and _seen(row)]
    truth = sorted({hidden for hidden, _ in pairs}, key=_catalogue_first)
    names = sorted({given for _, given in pairs}, key=_catalogue_first)
    table = np.zeros((len(truth), len(names)))
    for hidden, given in pairs:
        table[truth.index(hidden), names.index(given)] += 1
    figure = Figure(figsize=(4 + 0.2 * len(names), 3 + 0.2 * len(truth)), layout="constrained")
    axes = figure.subplots()
    shares = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    right = np.array([[given == _right_answer(hidden) for given in names] for hidden in truth])
    for inside, colours in ((right, "Blues"), (~right, "Reds")):
        shown = np.where(inside & (table > 0), shares, np.nan)
        axes.imshow(shown, cmap=colours, vmin=-0.2, vmax=1.0, aspect="auto", zorder=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(truth)), truth, fontsize=7)
    axes.grid(color="0.9", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set(xlabel="first name given", ylabel="hidden")
    axes.set_title("cases: blue is right, red is wrong; darker is a larger share of the row")
    for (i, j), count in np.ndenumerate(table):
        if count:
            ink = "white" if shares[i, j] > 0.5 else "black"
            axes.text(j, i, f"{count:.0f}", ha="center", va="center", fontsize=6, color=ink)
    with replace_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=150)


def _hidden_and_given(row: Row) -> tuple[str, str]:
    hidden = _bare(row["hidden"][0]) if row["hidden"] else NOTHING
    given = [n for n in map(_bare, row["named"]) if n != CURVE or hidden == n]
    silent = {"unknown_effect": UNKNOWN, FAILED: FAILED, REFUSED: REFUSED}
    return hidden, given[0] if given else silent.get(row["verdict"], NOTHING)


def _right_answer(hidden: str) -> str:
    return UNKNOWN if hidden in UNKNOWN_EFFECTS else hidden


def _catalogue_first(name: str) -> tuple[int, str]:
    """Sort names of the catalogue before what is not in it, and before answers without a name."""
    last = (*UNKNOWN_EFFECTS, NOTHING, UNKNOWN, REFUSED, FAILED)
    return (last.index(name) + 1 if name in last else 0, name)


def _bare(label: str) -> str:
    return label.split(" (")[0]
