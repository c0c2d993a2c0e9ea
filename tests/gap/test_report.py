"""The report page: numbers of gap.json, every verdict and kind, names escaped, no network."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html import escape, unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from omnislip.gap.balances import Balance
from omnislip.gap.events import Impact
from omnislip.gap.findings import Findings, Step, to_json
from omnislip.gap.inference import Evidence, Fit, Hypothesis
from omnislip.gap.judge import Trial
from omnislip.gap.leftover import Leftover
from omnislip.gap.machine import Machine
from omnislip.gap.metrics import Closed, GapTable, Left, Replays
from omnislip.gap.plan import Manoeuvre, Separation
from omnislip.gap.recordings import ROBOT_CHANNELS, Run
from omnislip.gap.refit import FULL_REFITS
from omnislip.gap.report import HEADLINES, format_number, render
from omnislip.gap.search import REFITS, Outcome
from omnislip.gap.selected import Selected
from omnislip.gap.split import Split
from omnislip.gap.where import AXIS_EQUATIONS, ROBOT_EQUATIONS, Map, Place
from omnislip.gap.words import one_digit, with_deviation
from omnislip.model_file import NOMINAL_ROBOT, Effect, Model, read_model

COMMAND_LINE = "omnislip gap find --robot robot.toml --out out run_01.csv"
VOID = ("meta", "link", "img", "br")
AXIS = Model(
    kind="axis",
    values={
        "axis.mass_kg": 95.0,
        "axis.input_gain_n_v": 35.0,
        "axis.viscous_friction_n_s_m": 200.0,
    },
    name="bench",
)
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def run_of(name, channels, rows=120):
    """A log of 1.2 s in which every channel is a slow wave, the last sampled every third row."""
    t_s = 0.01 * np.arange(rows)
    outputs = np.sin(3.0 * t_s[:, None] + np.arange(len(channels)))
    outputs[np.arange(rows) % 3 != 0, -1] = np.nan
    command = np.ones((rows, 1))
    return Run(name, t_s, command, outputs, channels, np.ones(len(channels)), None)


def replays_of(run, sizes=(3.0, 2.0, 1.1)):
    """Replay errors of three models with the given root mean squares."""
    rng = np.random.default_rng(1)
    errors = rng.normal(size=(3, *run.outputs.shape)) * np.reshape(sizes, (3, 1, 1))
    errors[:, np.isnan(run.outputs)] = np.nan
    return Replays(run, errors, np.ones(run.outputs.shape), run.t_s >= 0.25)


BALANCE = Balance("wheel 3: torque", "N m", np.array([0.0456, 0.0345, 0.00123]), 1.4e-6)
TWIST = Separation(Manoeuvre("twist", "wheels against each other", 3.8, []), 432.1, 0.0)


def findings_of(machine, verdict, effects=(), rivals=()):
    """Findings as find_gap makes them, without its search; `effects` are taken in steps."""
    robot = machine.kind == "robot"
    channels = ROBOT_CHANNELS if robot else ("axis/position_m",)
    equations = tuple(ROBOT_EQUATIONS if robot else AXIS_EQUATIONS)
    fitting, checking, held = (run_of(n, channels) for n in ("run_01", "run_02", "run_03"))
    base = tuple(machine.base_parameters())
    moved = np.array([machine.believed[p.places[0]] for p in base])
    moved[0] = base[0].high
    hypothesis = Hypothesis(base, tuple(effects), np.concatenate([moved, *map(sizes_of, effects)]))
    fit = Fit(hypothesis, 1.0, np.zeros(1), np.zeros((1, 1)))
    refused = next(c for c in machine.candidates() if c not in effects)
    trials = [
        Trial(step, e, sizes_of(e), evidence_of(e), 1e-9, 12.5, True, "explains more", True)
        for step, e in enumerate(effects, 1)
    ]
    trials.append(
        Trial(
            1, refused, sizes_of(refused), evidence_of(refused), 0.4, -1.0, True, "too weak", False
        )
    )
    selected = tuple(
        Selected(e, sizes_of(e), interval_of(e), evidence_of(e), tuple(rivals), 0.97, 1e4)
        for e in effects
    )
    left = Leftover("every wheel/torque", "speed cubed", 52.5, 1.5, 1e-9, 20.0, 12.0)
    leftover = (left,) if verdict == "unknown_effect" else ()
    outcome = Outcome(
        base=fit,
        final=fit,
        ladder=(fit, fit),
        selected=selected,
        trials=tuple(trials),
        leftover=leftover,
        data=None,
        neighbours={},
    )
    count = len(channels)
    rmse = np.outer([0.0491, 0.0437, 0.00213], np.arange(1, count + 1))
    floor = 0.00152 * np.arange(1, count + 1)
    closed = Closed(0.976, 0.957, 0.989, "3 runs") if effects else Closed(None, None, None)
    left = Left(0.4, 0.1)
    table = GapTable(channels, rmse, floor, "repeated manoeuvres", closed, left, ("run_03",))
    shares = np.arange(len(equations), 0.0, -1.0)
    excess = np.outer(np.ones(120), shares)
    times, states = (fitting.t_s, checking.t_s), (np.zeros((120, 21)),) * 2
    gap_map = Map(equations, times, (excess, excess), shares / shares.sum(), states)
    shape = Leftover(equations[0], "once per turn", 812.5, 1.5, 1e-9, 20.0, 12.0)
    place = Place(equations[0], "at low speed", 0.4, (("run_01", 0.25, 0.5),))
    added = [Effect(e.effect, dict.fromkeys(("size",), 1.0), e.wheel) for e in effects]
    force = {} if robot else {"fitted": 0.0812, "held_out": 0.0905}
    steps = [
        Step(name, dict(zip(channels, row.tolist(), strict=True)), force)
        for name, row in zip(("believed", "refit", "+ effect"), rmse, strict=True)
    ]
    return Findings(
        verdict=verdict,
        sentence=f"A sentence with numbers: 0.115 ± 0.003 for {verdict}.",
        machine=machine,
        split=Split([fitting, checking], [held], "whole runs"),
        outcome=outcome,
        wiring=[],
        impacts=[],
        amended=replace(machine.model, effects=added),
        places=[place] if effects else [],
        gap_map=gap_map,
        table=table,
        steps=steps,
        replays=[replays_of(held)],
        manoeuvres={e.name: TWIST for e in effects} if rivals else {},
        inputs={"robot.toml": "ab" * 32, "run_01.csv": "cd" * 32},
        shapes=[shape] if verdict != "no_gap" else [],
        balances=[BALANCE] if robot else [],
        limits={} if effects else {"viscous_friction_error": {"viscous_friction_nm_s": 1.25e-6}},
    )


def sizes_of(candidate):
    return np.array([1.5 * p.scale for p in candidate.parameters])


def interval_of(candidate):
    return sizes_of(candidate)[:, None] + 0.02 * np.array([-1.0, 1.0])


def evidence_of(candidate):
    count = len(candidate.parameters)
    return Evidence(431.0, 2.5, 1.3e-7, 1e-4 * np.eye(count))


def insufficient(machine):
    return Findings(
        verdict="insufficient_data",
        sentence="Not enough data: the command never changes.",
        machine=machine,
        split=Split([], [], "no run was used"),
        outcome=None,
        wiring=[],
        impacts=[],
        amended=machine.model,
        places=[],
        gap_map=None,
        table=None,
        steps=[],
        replays=[],
        manoeuvres={},
        inputs={"robot.toml": "ab" * 32},
    )


@pytest.fixture(scope="module")
def machines():
    return {"robot": Machine(read_model(NOMINAL_ROBOT)), "axis": Machine(AXIS)}


def make(machines, kind, verdict):
    machine = machines[kind]
    if verdict == "insufficient_data":
        return insufficient(machine)
    effects = machine.candidates()[:1] if verdict == "effect_found" else ()
    return findings_of(machine, verdict, effects)


@pytest.fixture(scope="module", params=["robot", "axis"])
def kind(request):
    return request.param


@pytest.fixture(scope="module", params=sorted(HEADLINES))
def findings(request, kind, machines):
    return make(machines, kind, request.param)


@pytest.fixture(scope="module")
def html(findings):
    return render(findings, COMMAND_LINE)


@pytest.fixture(scope="module")
def found(machines):
    """A robot's findings with one effect."""
    return make(machines, "robot", "effect_found")


@pytest.fixture(scope="module")
def found_html(found):
    return render(found, COMMAND_LINE)


@pytest.fixture(scope="module")
def no_gap_html(machines):
    return render(make(machines, "robot", "no_gap"), COMMAND_LINE)


class Page(HTMLParser):
    """Text, addresses and rows of the tables of a page; fails where tags do not nest."""

    def __init__(self, html):
        super().__init__()
        self.open, self.addresses, self.rows, self.pieces = [], [], [], []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for name, value in attrs if name in ("src", "href", "srcset")]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" in self.open:
            return
        self.pieces.append(data)
        if self.open and {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    @property
    def text(self):
        return " ".join(" ".join(self.pieces).split())


def test_every_verdict_says_its_sentence_and_headline(findings, html):
    page = Page(html)
    assert findings.sentence in page.text
    assert HEADLINES[findings.verdict] in page.text
    assert COMMAND_LINE in page.text


def test_logs_that_cannot_be_used_are_no_lack_of_data(machines):
    sentence = "The logs cannot be used: run_1: is it in mV?"
    page = Page(render(replace(insufficient(machines["robot"]), sentence=sentence), COMMAND_LINE))
    assert "Mend what the sentence above names" in page.text
    assert "Not enough data" not in page.text and "Logs can teach" not in page.text


def test_of_a_log_that_was_fitted_too_the_part_held_out_is_told(machines):
    findings = findings_of(machines["robot"], "no_gap", ())
    [held_out, *_] = findings.split.held_out
    fitted = replace(findings.split.fitting[0], name=held_out.name)
    split = replace(findings.split, fitting=[fitted])
    assert (
        f"{held_out.name} from 0.0 to"
        in Page(render(replace(findings, split=split), COMMAND_LINE)).text
    )


def test_page_loads_nothing(html):
    assert all(a.startswith(("data:", "#")) for a in Page(html).addresses)
    assert "http" not in html
    assert "<script" not in html
    assert "url(" not in html
    assert "@import" not in html


def test_pictures_load_nothing_and_are_whole(html):
    for picture in pictures_of(html):
        assert picture.rstrip().endswith("</svg>")
        references = re.findall(r'(?:href|src)="([^"]*)"', picture)
        assert all(r.startswith(("#", "data:")) for r in references)


def pictures_of(html):
    prefix = "data:image/svg+xml;base64,"
    addresses = [a for a in Page(html).addresses if a.startswith(prefix)]
    return [base64.b64decode(a.removeprefix(prefix)).decode() for a in addresses]


def test_inputs_are_listed_with_their_checksums(findings, html):
    text = Page(html).text
    for name, digest in findings.inputs.items():
        assert f"{name} {digest}" in text


def test_gap_table_holds_the_numbers_of_gap_json(machines, kind):
    findings = make(machines, kind, "effect_found")
    channels = to_json(findings)["gap"]["channels"]
    rows = [r for r in Page(render(findings, COMMAND_LINE)).rows if len(r) == 6]
    for row, figures in zip(rows[1 : len(channels) + 1], channels.values(), strict=True):
        assert [float(cell) for cell in row[2:]] == pytest.approx(
            [figures[n] for n in ("believed", "refit", "after", "noise_floor")], rel=5e-3
        )


def test_closed_share_names_its_interval(found_html):
    closed = "98 % of the gap closed, 90 % interval 96 to 99 % over 3 runs"
    assert closed in Page(found_html).text


def test_force_error_of_an_axis_is_in_percent(machines):
    rows = Page(render(make(machines, "axis", "effect_found"), COMMAND_LINE)).rows
    assert next(r for r in rows if r[0] == "+ effect")[-2:] == ["8.12", "9.05"]


def test_unknown_says_where_to_look_and_does_not_name_an_effect(machines):
    machine = machines["robot"]
    findings = findings_of(machine, "unknown_effect", machine.candidates()[:1])
    text = Page(render(findings, COMMAND_LINE)).text
    assert "acts on every wheel/torque and depends on speed cubed" in text
    assert "Nearest known effects" in text
    assert "What was added" not in text


def test_without_an_effect_the_table_has_no_column_for_it(no_gap_html):
    assert "with effect" not in Page(no_gap_html).text


def test_found_effect_shows_what_to_put_into_the_model(found_html):
    text = Page(found_html).text
    assert "[[effects.supply_sag]] size = 1.0" in text
    assert "95 % interval" in text


def test_effects_that_the_given_model_had_are_not_shown_as_new(found):
    known = Effect("low_grip", {"scale": 0.9})
    machine = Machine(replace(found.machine.model, effects=[known]))
    amended = replace(found.amended, effects=[known, *found.amended.effects])
    findings = replace(found, machine=machine, amended=amended)
    text = Page(render(findings, COMMAND_LINE)).text
    assert "[[effects.supply_sag]]" in text
    assert "[[effects.low_grip]]" not in text


def test_rivals_make_the_name_uncertain(machines):
    machine = machines["robot"]
    rivals = ("weak_motor (wheel 3)",)
    findings = findings_of(machine, "effect_found", machine.candidates()[:1], rivals)
    text = Page(render(findings, COMMAND_LINE)).text
    assert 'drive "twist" (4 s' in text
    assert "expected separation 432" in text
    assert "its name is not certain" in text
    assert "weak_motor (wheel 3) : " + machine.catalogue["weak_motor"]["summary"] in text


@pytest.mark.parametrize("driven", [True, False])
def test_that_no_manoeuvre_would_tell_rivals_apart_is_said_of_those_that_were_driven(
    machines, driven
):
    effects = machines["robot"].candidates()[:1]
    findings = findings_of(machines["robot"], "effect_found", effects, ("weak_motor (wheel 3)",))
    manoeuvres = {effects[0].name: replace(TWIST, separation=1.0)} if driven else {}
    text = Page(render(replace(findings, manoeuvres=manoeuvres), COMMAND_LINE)).text
    assert ("No manoeuvre of the library would separate them." in text) == driven
    assert 'drive "twist"' not in text


def test_balances_stand_with_each_model_and_the_noise_of_the_sensors(found, no_gap_html):
    rows = Page(render(found, COMMAND_LINE)).rows
    own = ["wheel 3: torque / N m", "N m", "0.0456", "0.0345", "0.00123", "1.40 × 10⁻⁶"]
    assert own in rows
    assert "Which balance fails" not in no_gap_html


@pytest.mark.parametrize("gave_way", [False, True])
def test_what_was_taken_and_gave_way_later_is_told(machines, gave_way):
    findings = make(machines, "robot", "effect_found")
    if gave_way:
        selected = findings.outcome.selected[1:]
        findings = replace(findings, outcome=replace(findings.outcome, selected=selected))
    text = Page(render(findings, COMMAND_LINE)).text
    assert ("it is not in the model" in text) == gave_way


@pytest.mark.parametrize("verdict", ["effect_found", "unknown_effect"])
def test_what_the_gap_looks_like_is_shown_for_a_known_and_an_unknown_cause(machines, verdict):
    effects = machines["robot"].candidates()[:1] if verdict == "effect_found" else ()
    page = Page(render(findings_of(machines["robot"], verdict, effects), COMMAND_LINE))
    assert [row for row in page.rows if row[1:2] == ["once per turn"]]


def test_each_trial_says_why(found_html):
    names = ("supply_sag", "state_of_charge_drift")
    trials = [row for row in Page(found_html).rows if row[0] in names]
    assert [row[-1] for row in trials] == ["taken: explains more", "not taken: too weak"]
    assert trials[0][1:4] == ["431", "2.50", "1.30 × 10⁻⁷"]


def test_detection_limit_has_its_unit(no_gap_html):
    row = next(r for r in Page(no_gap_html).rows if "viscous_friction_nm_s" in r[0])
    assert row[1:3] == ["1.25 × 10⁻⁶", "N m s"]


def test_what_is_said_of_the_search_is_so(found_html):
    """Held-out runs do judge: pushes are looked for in them, and their rest makes it unknown."""
    text = Page(found_html).text
    assert "not used for any fit or choice" not in text
    assert "a gap that stays in these can make the verdict unknown" in text
    assert f"{REFITS} candidates of each step that are fitted: all by what they add" in text
    assert f"the best up to {FULL_REFITS} of them fully" in text


def test_every_limit_of_gap_json_is_a_row(machines):
    """Also that of a patch in the floor, which needs places to be looked for."""
    findings = make(machines, "robot", "no_gap")
    limits = {"low_grip": {"scale": 0.01}, "slippery_patch": {"scale": 0.1}}
    findings = replace(findings, limits=limits)
    page = Page(render(findings, COMMAND_LINE))
    rows = [row[0] for row in page.rows if row[0].split(" ")[0] in limits]
    assert rows == [f"{effect} scale" for effect in limits]


def test_limit_beyond_the_bound_of_its_size_is_not_called_a_limit(machines):
    findings = make(machines, "robot", "no_gap")
    limits = {"low_grip": {"scale": 7.0}}
    findings = replace(findings, limits=limits)
    rows = Page(render(findings, COMMAND_LINE)).rows
    assert next(r for r in rows if r[0] == "low_grip scale")[1] == "cannot be seen"


def test_key_at_its_bound_is_marked(machines, no_gap_html):
    marked = [row[0] for row in Page(no_gap_html).rows if row[-1].endswith("at bound")]
    assert marked == [machines["robot"].base_parameters()[0].label]


def test_run_with_the_largest_gap_comes_first(found):
    replays = [
        replays_of(run_of("calm", ROBOT_CHANNELS)),
        replays_of(run_of("wild", ROBOT_CHANNELS), (9.0, 8.0, 1.0)),
    ]
    text = Page(render(replace(found, replays=replays), COMMAND_LINE)).text
    assert text.index("wild, the run with the largest gap") < text.index("calm")


@pytest.mark.parametrize("name", ["<script>alert(1)</script>", 'a"b&c', "a$x^2$b", "läufe/1"])
def test_names_are_text(found, name):
    findings = replace(
        found,
        machine=Machine(replace(found.machine.model, name=name)),
        split=replace(
            found.split, fitting=[run_of(name, ROBOT_CHANNELS), *found.split.fitting[1:]]
        ),
        places=[replace(found.places[0], windows_s=((name, 0.25, 0.5),))],
        replays=[replays_of(run_of(name, ROBOT_CHANNELS))],
        inputs={name: "00"},
    )
    html = render(findings, f"omnislip gap find '{name}'")
    assert "<script" not in html
    assert Page(html).text.count(name) >= 5
    assert any(escaped(name) in picture for picture in pictures_of(html))


def escaped(name):
    return name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def test_same_findings_give_the_same_page(machines):
    findings = make(machines, "axis", "effect_found")
    assert render(findings, COMMAND_LINE) == render(findings, COMMAND_LINE)


@given(st.floats(-1e30, 1e30).filter(lambda x: x == 0 or abs(x) > 1e-30))
def test_numbers_keep_three_digits(value):
    text = format_number(value).replace("−", "-")
    mantissa, _, power = text.partition(" × 10")
    exponent = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or "0")
    assert float(mantissa) * 10.0**exponent == pytest.approx(value, rel=5.001e-3)


@pytest.mark.parametrize(
    ("low", "value", "high", "text"),
    [
        (1.02988, 1.03003, 1.03018, "1.0299 1.0300 1.0302"),
        (0.39, 0.42, 0.45, "0.390 0.420 0.450"),
        (303.21, 303.47, 303.73, "303.2 303.5 303.7"),
        (1.4761e-8, 1.4767e-8, 1.4773e-8, "1.4761 × 10⁻⁸ 1.4767 × 10⁻⁸ 1.4773 × 10⁻⁸"),
        (-0.5, -0.1, 0.3, "−0.500 −0.100 0.300"),
    ],
)
def test_an_interval_shows_however_narrow_it_is(low, value, high, text):
    assert " ".join(format_number(one, high - low) for one in (low, value, high)) == text


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [
        (1.03003, 1.0e-4, "1.0300 ± 0.0001"),
        (0.99996, 0.096, "1.0 ± 0.1"),
        (18.94, 6.2, "19 ± 6"),
        (303.4, 21.0, "300 ± 20"),
        (1.4767e-8, 5.6e-10, "1.48e-08 ± 6e-10"),
        (-0.0941, 0.435, "-0.1 ± 0.4"),
        (9.0, 0.0, "9 ± 0"),
        (0.0, 0.2, "0.0 ± 0.2"),
    ],
)
def test_a_size_is_written_to_the_first_digit_of_its_deviation(value, deviation, text):
    assert with_deviation(value, deviation) == text


@given(st.floats(-1e12, 1e12).filter(lambda x: abs(x) > 1e-12), st.floats(1e-6, 1e6))
def test_writing_a_size_moves_it_by_half_of_that_digit_at_most(value, ratio):
    deviation = abs(value) * ratio
    written, _, _ = with_deviation(value, deviation).partition(" ± ")
    digit = 10.0 ** np.floor(np.log10(float(one_digit(deviation))))
    assert abs(float(written) - value) <= 0.5001 * digit


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_no_number_is_a_dash(value):
    assert format_number(value) == "–"


PAGES = [*sorted(HEADLINES), "ambiguous"]
WIDTHS_PX = (1280, 400)
PROBE = """<!DOCTYPE html><title></title><script>addEventListener('load', () => {
  const pages = [...document.querySelectorAll('iframe')].map(frame => frame.contentWindow)
  pages.forEach(page => page.document.querySelectorAll('details').forEach(one => one.open = true))
  document.title = JSON.stringify(pages.map(page => ({
    width: page.innerWidth,
    overflow: page.document.documentElement.scrollWidth
      - page.document.documentElement.clientWidth,
    pictures: page.document.images.length,
    broken: [...page.document.images].filter(image => image.naturalWidth == 0).length,
    fetched: page.performance.getEntriesByType('resource').map(one => one.name)
      .filter(name => !name.startsWith('data:'))})))})</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: no page is looked at")
@pytest.mark.parametrize("case", PAGES)
def test_browser_shows_a_page_whole_at_every_width(case, machines, tmp_path):
    """Every picture is there, nothing is fetched or complained of, no page scrolls sideways."""
    machine = machines["robot"]
    rivals = ("weak_motor (wheel 3)",)
    findings = (
        findings_of(machine, "effect_found", machine.candidates()[:1], rivals)
        if case == "ambiguous"
        else make(machines, "robot", case)
    )
    html = render(findings, COMMAND_LINE)
    frames = [
        f'<iframe style="border: 0" width="{px}" height="900" srcdoc="{escape(html)}"></iframe>'
        for px in WIDTHS_PX
    ]
    page = tmp_path / "pages.html"
    page.write_text(PROBE + "".join(frames), encoding="utf-8")
    ended = browse(page, tmp_path / "profile")
    title = re.search(r"<title>(.*?)</title>", ended.stdout)[1]
    shown = {"overflow": 0, "pictures": len(pictures_of(html)), "broken": 0, "fetched": []}
    assert json.loads(unescape(title)) == [{"width": px, **shown} for px in WIDTHS_PX]
    assert "CONSOLE" not in ended.stderr


def browse(page: Path, profile: Path) -> subprocess.CompletedProcess[str]:
    options = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync"
        " --disable-background-networking --disable-component-update --enable-logging=stderr"
        " --virtual-time-budget=5000 --dump-dom"
    )
    return subprocess.run(
        [CHROMIUM, *options.split(), f"--user-data-dir={profile}", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )


@pytest.mark.parametrize("verdict", ["effect_found", "unknown_effect"])
def test_wiring_and_impacts_are_shown_before_the_effects(found, verdict):
    """Where something is unknown, impacts and effects are only the nearest."""
    pushes = [
        Impact(run, 1.25, np.array([1.5, -2.5, 0.1]), np.array([0.1, 0.1, 0.01]))
        for run in ("run_02", "run_05")
    ]
    wiring = [Effect("encoder_sign", {}, 2)]
    mended = replace(found, verdict=verdict, wiring=wiring, impacts=pushes)
    page = render(mended, "omnislip")
    first = found.outcome.selected[0].candidate.name
    places = [page.index(f"<h3>{name}") for name in ("encoder_sign", "impact", first)]
    assert places == sorted(places)
    rows = [page.index(f"<tr><td>{push.run}</td>") for push in pushes]
    assert places[1] < rows[0] < rows[1] < places[2]


def test_what_refines_an_effect_is_among_its_sizes(machines):
    robot = machines["robot"]
    curve = next(c for c in robot.candidates() if c.effect == "contact_shape")
    [roller] = [e for e in robot.extensions("contact_shape") if e.parameters[0].label == "roller"]
    whole = replace(
        curve, parameters=curve.parameters + roller.parameters, amplitudes=(*curve.amplitudes, 1)
    )
    page = Page(render(findings_of(robot, "effect_found", [whole]), COMMAND_LINE))
    assert any(row[0] == "roller" for row in page.rows)
