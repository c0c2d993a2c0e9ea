"""Rows of the benchmark are summed up: shares, groups, effects, methods, tables and the picture."""

import json
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.baselines import METHODS
from omnislip.gap.benchmark import METHOD_COLUMNS
from omnislip.gap.benchmark_summary import (
    CONFUSION,
    SUMMARY,
    _hidden_and_given,
    by_effect,
    by_group,
    by_method,
    sections,
    share,
    summary,
    tables,
    write_summary,
)
from rich.console import Console


def row(kind="single", hidden=("payload",), named=("payload",), **changed):
    """Row of a case in which all was found; the baselines found nothing."""
    right = set(hidden) == set(named)
    found = {
        "name": kind,
        "kind": kind,
        "error": None,
        "hidden": list(hidden),
        "friction_curve": "atan",
        "closed_loop": False,
        "verdict": "effect_found" if named else "no_gap",
        "named": list(named),
        "first": right,
        "exact": right,
        "recall": [h in named for h in hidden],
        "wheel": None,
        "in_set": [h in named for h in hidden],
        "set_size": [1] * len(named),
        "sizes": [],
        "impacts": None,
        "chance": 1.0,
        "time_s": 1.0,
        "lambda": 100.0 if kind in ("single", "double", "triple") else None,
        "gap_closed": 0.9,
        "gap_closed_oracle": 1.0,
    }
    for method in METHODS:
        found |= {f"{method}: named": [], f"{method}: replay_error": 4.0}
        found |= {f"{method}: {key}": not hidden for key in ("first", "exact")}
    found |= {"workflow: replay_error": 1.0, "oracle: replay_error": 1.0, "baselines_time_s": 1.0}
    return found | changed


def failed(**changed):
    """Row of a case that raised an exception."""
    nothing = dict.fromkeys(METHOD_COLUMNS) | {"gap_closed": None, "gap_closed_oracle": None}
    wrong = {"first": False, "exact": False, "chance": None, "lambda": None, "time_s": None}
    return row(named=(), verdict="failed", error="ValueError: x") | nothing | wrong | changed


def hits(figure):
    return figure["hits"], figure["of"]


@given(right=st.integers(0, 50), wrong=st.integers(0, 50))
def test_wilson_interval_holds_the_share_and_stays_in_bounds(right, wrong):
    one = share([True] * right + [False] * wrong)
    if right + wrong == 0:
        assert one["value"] is None
    else:
        edges = [-1e-12, one["low"], one["value"], one["high"], 1 + 1e-12]
        assert all(a <= b + 1e-12 for a, b in pairwise(edges))


def test_wilson_interval_is_that_of_the_textbook():
    one = share([True] * 8 + [False] * 2)
    assert (one["low"], one["high"]) == pytest.approx((0.490, 0.943), abs=5e-4)


def test_singles_count_where_the_oracle_sees_them():
    rows = [row(), row(named=()), row(named=(), **{"lambda": 3.0})]
    assert hits(summary(rows)["single: first name right"]) == (1, 2)
    closed = summary(rows)["gap closed against the oracle, median"]
    assert closed["value"] == pytest.approx(0.9)


def test_a_failed_case_is_not_right_in_any_figure_of_its_class():
    one = summary([row(), failed(wheel=False), failed(kind="null", hidden=(), recall=[])])
    assert hits(one["failed"]) == (2, 3)
    assert hits(one["single: first name right"]) == (1, 2)
    assert hits(one["single: exact set"]) == (1, 2)
    assert hits(one["wheel right"]) == (0, 1)
    assert hits(one["null: false alarm"]) == (1, 1)
    assert one["gap closed against the oracle, median"]["value"] == pytest.approx(0.45)
    one = summary([failed(kind="unknown", hidden=("bump_map",))])
    assert hits(one["unknown: flagged"]) == (0, 1) and hits(one["unknown: misnamed"]) == (1, 1)
    one = summary([failed(kind="impact", impacts={"in_time": 0, "hidden": 2, "found": 0})])
    assert hits(one["impacts in time"]) == (0, 2)


def refused(**changed):
    """Row of a case whose logs the workflow did not take."""
    nothing = dict.fromkeys(METHOD_COLUMNS) | {"gap_closed": None, "gap_closed_oracle": None}
    return row(named=(), verdict="insufficient_data", **changed) | nothing | {"chance": None}


def test_what_could_be_seen_in_refused_logs_was_missed():
    faint = refused(**{"lambda": 3.0})
    one = summary([row(), refused(), faint, refused(kind="double", hidden=("payload", "sag"))])
    assert hits(one["logs refused"]) == (3, 4)
    assert hits(one["single, double or triple, visible: logs refused"]) == (2, 3)
    for name in ("single: first name right", "single: exact set"):
        assert hits(one[name]) == (1, 2)
    assert hits(one["double: both found"]) == (0, 1)
    assert one["gap closed against the oracle, median"] == {"value": 0.0, "of": 3}
    assert hits(by_effect([row(), refused(), faint])["payload"]["found where visible"]) == (1, 2)


@pytest.mark.parametrize(
    ("kind", "count", "all_found"), [("double", 2, "both"), ("triple", 3, "all")]
)
def test_sets_of_effects_are_found_all_and_exactly(kind, count, all_found):
    hidden = ("payload", "body_drag", "cogging")[:count]
    rows = [row(kind, hidden, hidden), row(kind, hidden, hidden[:-1])]
    rows.append(row(kind, hidden, hidden, **{"lambda": 2.0}))  # nobody sees them
    one = summary(rows)
    assert hits(one[f"{kind}: {all_found} found"]) == hits(one[f"{kind}: exact set"]) == (1, 2)


def test_a_null_that_was_refused_is_no_success():
    rows = [row("null", (), ()), refused(kind="null", hidden=())]
    one = summary(rows)
    assert hits(one["null: false alarm"]) == hits(one["null: called unknown"]) == (0, 1)
    assert hits(one["null: logs refused"]) == (1, 2)
    assert hits(by_group(rows)["open loop"]["false alarm"]) == (0, 1)


def test_pushes_count_one_by_one_and_so_do_those_that_are_none():
    pushes = {"kind": "impact", "hidden": ("impact", "impact"), "named": ("impact",)}
    rows = [row(**pushes, impacts={"in_time": 1, "hidden": 2, "found": 3})]
    rows.append(row("null", (), ("impact",), impacts={"in_time": 0, "hidden": 0, "found": 1}))
    assert hits(by_effect(rows)["impact"]["found where visible"]) == (1, 2)
    assert hits(summary(rows)["impacts in time"]) == (1, 2)
    assert hits(summary(rows)["impacts found that are there"]) == (1, 4)


def test_groups_are_by_curve_and_by_loop():
    rows = [row(), row(named=(), friction_curve="tanh", closed_loop=True)]
    rows.append(row("null", (), ("body_drag",), closed_loop=True))
    groups = by_group(rows)
    assert hits(groups["friction curve as believed"]["first name right"]) == (1, 1)
    assert hits(groups["friction curve another"]["first name right"]) == (0, 1)
    assert hits(groups["closed loop"]["exact set"]) == (0, 1)
    assert hits(groups["closed loop"]["false alarm"]) == (1, 1)
    assert hits(groups["open loop"]["false alarm"]) == (0, 0)


def test_an_effect_is_found_alone_and_beside_another_and_on_any_wheel():
    rows = [
        row("single", ("weak_motor (wheel 2)",), ("weak_motor (wheel 2)",)),
        row("double", ("weak_motor (wheel 1)", "payload"), ("payload",)),
        row("single", ("payload",), (), **{"lambda": 2.0}),
        row("unknown", ("bump_map",), (), verdict="unknown_effect"),
    ]
    effects = by_effect(rows)
    assert hits(effects["weak_motor"]["found where visible"]) == (1, 2)
    assert hits(effects["payload"]["found where visible"]) == (1, 1)
    assert effects["payload"]["hidden"]["value"] == 2
    assert hits(effects["bump_map"]["found where visible"]) == (1, 1)


def test_methods_are_compared_on_cases_that_all_were_asked():
    refused = row(named=(), verdict="insufficient_data") | dict.fromkeys(METHOD_COLUMNS)
    methods = by_method([row(), refused, failed()])
    assert hits(methods["workflow"]["first name right"]) == (1, 2)
    assert hits(methods["BIC"]["first name right"]) == (0, 1)
    assert methods["ridge"]["replay error, median"] == {"value": 4.0, "of": 1}
    assert "exact set" not in methods["oracle"]


def test_everything_is_written_drawn_and_printed(tmp_path):
    rows = [row(), row("null", (), ()), failed(), refused(kind="null", hidden=())]
    assert _hidden_and_given(rows[3]) == ("nothing", "insufficient_data")
    figures = write_summary(rows, tmp_path)
    assert json.loads((tmp_path / SUMMARY).read_text()) == figures
    assert (tmp_path / CONFUSION).read_bytes().startswith(b"\x89PNG")
    console = Console(width=120, record=True)
    for table in tables(figures, "3 cases"):
        console.print(table)
    text = console.export_text()
    assert "1 of 2 (0.09 to 0.91)" in text and "SINDy" in text and "payload" in text


def test_a_section_without_rows_is_no_table():
    nulls = [row("null", (), ())]
    assert len(tables(sections(nulls), "1 case")) == 3
