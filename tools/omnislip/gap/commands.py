"""The commands `omnislip gap ...`."""

import json
import os
import shlex
import sys
import time
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from omnislip.errors import InputError

app = typer.Typer(
    help="Find where a model and measured logs disagree, name the missing effect, add it.",
    no_args_is_help=True,
)

Robot = Annotated[Path, typer.Option(help="Model file (robot.toml).")]
Set = Enum("Set", {name: name for name in ("development", "sealed")})
Size = Enum("Size", {name: name for name in ("tiny", "small", "full")})
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.command(epilog="Example: omnislip gap find --robot robot.toml --out gap run_01.csv run_02.csv")
def find(
    logs: Annotated[list[Path], typer.Argument(help="Logs (.csv or .parquet) of one machine.")],
    robot: Robot,
    out: Annotated[Path, typer.Option(help="Folder for report.html, gap.json and robot.toml.")],
    effects: Annotated[
        Path | None, typer.Option(help="File with effects of your own (.toml) to look for too.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Find the gap, name its cause, write the amended model and a report."""
    from omnislip.gap.find import find_gap
    from omnislip.gap.findings import to_json, write_results
    from omnislip.gap.report import render

    check_folder(out)
    if robot.resolve() == (out / "robot.toml").resolve():
        raise InputError(f"{out}: the amended model would replace {robot}; take another folder")
    with progress() as say:
        findings = find_gap(robot, logs, say, effects)
        say("drawing the report")
        report = render(findings, shlex.join(["omnislip", *sys.argv[1:]]))
    write_results(findings, out, report)
    if as_json:
        print(json.dumps(to_json(findings), indent=1, allow_nan=False))
        return
    print(findings.sentence)
    for told in findings.recording:
        print(told)
    if findings.table is not None:
        print_table(findings.table)
    print(f"report: {out / 'report.html'}   {findings.amended_words}: {out / 'robot.toml'}")


@app.command(
    epilog="Example: omnislip gap plan --robot robot.toml --out plan actuation_delay driver_lag"
)
def plan(
    robot: Robot,
    out: Annotated[Path, typer.Option(help="Folder for the best manoeuvre, a scenario file.")],
    effects: Annotated[
        list[str] | None,
        typer.Argument(
            help='Effects to tell apart, named as in a model file: "weak_motor (wheel 3)".'
        ),
    ] = None,
    gap: Annotated[
        Path | None, typer.Option(help="gap.json with an effect that is ambiguous, instead.")
    ] = None,
    room_m: Annotated[float, typer.Option(min=0.5, max=100.0, help="Side of the free room.")] = 3.0,
    speed_m_s: Annotated[float, typer.Option(min=0.05, max=10.0, help="Speed limit.")] = 1.0,
    as_json: Json = False,
) -> None:
    """Find the manoeuvre that would separate effects that logs cannot; write it as a scenario."""
    from omnislip.gap import plan as planning
    from omnislip.model_file import read_model

    check_folder(out)
    model = read_model(robot)
    if (gap is None) == (not effects):
        raise InputError("gap plan needs either the names of effects or --gap FILE")
    question = planning.read_gap(gap) if gap else planning.Question(effects or [])
    with progress() as say:
        ranked = planning.plan(model, question, planning.Limits(room_m, speed_m_s), say)
    written = planning.write_plan(ranked[0], out, robot)
    if as_json:
        rows = [one.as_json() for one in ranked]
        result = {"effects": question.names, "manoeuvres": rows, "scenario": str(written)}
        print(json.dumps(result, indent=1))
        return
    table = Table(title="telling apart " + ", ".join(question.names))
    for heading in ("manoeuvre", "s", "expected separation", "probability of right", "reach m"):
        table.add_column(heading, justify="left" if heading == "manoeuvre" else "right")
    for one in ranked:
        table.add_row(
            one.manoeuvre.name,
            f"{one.manoeuvre.duration_s:.1f}",
            f"{one.separation:.3g}",
            f"{one.probability:.4f}",
            f"{one.reach_m:.2f}",
        )
    Console().print(table)
    best = ranked[0]
    print(f"{best.manoeuvre.name}: {best.manoeuvre.summary}; written to {written}")
    if not best.tells:
        print("Even this one would hardly tell them apart; more room or a higher speed may help.")
    elif best.drives > 1:
        right = f"{100 * planning.ENOUGH:.0f} of 100 cases"
        print(f"Drive it {best.drives:.0f} times: then it is right in {right}.")
    print(f"rehearse it: omnislip simulate {written} --out {written.with_suffix('.csv')}")


@app.command(epilog="Example: omnislip gap evaluate --robot gap/robot.toml run_07.csv run_08.csv")
def evaluate(
    logs: Annotated[list[Path], typer.Argument(help="Logs (.csv or .parquet) of one machine.")],
    robot: Robot,
    as_json: Json = False,
) -> None:
    """Print how wrong a model is on logs: replay errors per channel and the noise floor."""
    from omnislip.gap.evaluate import evaluate_model
    from omnislip.gap.metrics import PREDICTED

    with progress() as say:
        result = evaluate_model(robot, logs, say)
    if as_json:
        print(json.dumps(result, indent=1, allow_nan=False))
        return
    count = len(result["runs"])
    runs = f"{count} run" + ("s" if count > 1 else "")
    table = Table(title=f"one-second replays of {robot} on {runs}")
    for heading in ("channel", "RMSE", "noise floor"):
        table.add_column(heading, justify="left" if heading == "channel" else "right")
    for channel, figures in result["channels"].items():
        table.add_row(channel, f"{figures['rmse']:.4g}", f"{figures['noise_floor']:.4g}")
    Console().print(table)
    if result["noise_floor_source"] == PREDICTED:
        print(
            "The floor is by the noise that suits this model: of one that is far off it is too "
            "high. Compare models by the lowest."
        )
    for told in result["recording"]:
        print(told)


@app.command(epilog="Example: omnislip gap benchmark --out build/benchmark --size small")
def benchmark(
    out: Annotated[Path, typer.Option(help="Folder for the cases and results; resumes there.")],
    which: Annotated[
        Set, typer.Option("--set", help="development: to learn from; sealed: for the figures.")
    ] = Set.development,
    size: Annotated[Size, typer.Option(help="Number of cases: 8, 121 or 497.")] = Size.tiny,
    kinds: Annotated[
        list[str] | None,
        typer.Option("--kind", help="Class of cases, e.g. single or null; repeat. Default: all."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Dask scheduler, tcp://HOST:8786; default: this machine."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Hide effects in logs of an independent simulator and see whether they are found."""
    from omnislip.gap.benchmark import RESULTS, SIZES, run_benchmark, tasks
    from omnislip.gap.benchmark_summary import CONFUSION, SUMMARY, tables, write_summary

    check_folder(out)
    for kind in kinds or ():
        if kind not in SIZES[size.value]:
            raise InputError(f"--kind {kind}: is one of {', '.join(SIZES[size.value])}")
    chosen = tasks(which.value, size.value, kinds or ())
    with progress() as say:
        rows = run_benchmark(
            out, chosen, scheduler, lambda done, total: say(f"{done} of {total} cases solved")
        )
    for row in rows:
        if row["error"]:
            print(f"failed: {row['name']}: {row['error']}", file=sys.stderr)
    figures = write_summary(rows, out)
    if as_json:
        print(json.dumps(figures | {"cases": rows}, indent=1, allow_nan=False))
        return
    _print_cases(rows)
    for table in tables(figures, f"{which.value} set, {len(rows)} cases"):
        Console().print(table)
    print(f"hidden against named: {out / CONFUSION}   figures: {out / SUMMARY}")
    print(f"all rows: {out / RESULTS}   traceback of a failed case: error.txt in its folder")


def _print_cases(rows: list[dict]) -> None:
    from omnislip.gap.benchmark import REFUSED

    table = Table(title="cases that were not solved exactly")
    for heading in ("case", "curve", "lambda", "verdict", "named"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        flagged = row["kind"] == "unknown" and row["verdict"] == "unknown_effect"
        if flagged or (row["exact"] and row["verdict"] != REFUSED):
            continue
        strength = "" if row["lambda"] is None else f"{row['lambda']:.0f}"
        named = ", ".join(row["named"])
        table.add_row(row["name"], row["friction_curve"], strength, row["verdict"], named)
    Console().print(table)


@app.command(epilog="Example: omnislip gap measured --out build/measured")
def measured(
    out: Annotated[Path, typer.Option(help="Folder for MEASURED.md, logs and reports.")],
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of data sets; default $OMNISLIP_DATA, else ../shared/data."),
    ] = None,
) -> None:
    """Run the workflow and other methods on public measured data; several minutes."""
    from omnislip.gap.measured import measure
    from omnislip.importers import data_folder

    check_folder(out)
    with progress() as say:
        page = measure(data or data_folder(), out, say)
    print(f"wrote {page}")


class progress:  # noqa: N801 - used as a statement
    """A status line on stderr: what is being done now; plain lines when stderr is no terminal."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._status = self._console.status("starting")
        self._begin = time.monotonic()
        self._last_line_s = 0.0

    def __enter__(self) -> Callable[[str], None]:
        if self._console.is_terminal:
            self._status.start()
        return self._say

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if self._console.is_terminal:
            self._status.stop()
        if isinstance(error, ValueError) and "too stiff" in str(error):  # the plant's word for it
            raise InputError(str(error)) from None

    def _say(self, text: str) -> None:
        elapsed_s = time.monotonic() - self._begin
        if self._console.is_terminal:
            self._status.update(f"{text} [{elapsed_s:.0f} s]")
        elif elapsed_s - self._last_line_s > 2.0:
            self._last_line_s = elapsed_s
            self._console.print(f"{elapsed_s:4.0f} s  {text}", markup=False, highlight=False)


def check_folder(path: Path) -> None:
    """Fail before the work when the results could not be written; makes nothing."""
    nearest = next(parent for parent in (path, *path.parents) if parent.exists())
    if not nearest.is_dir():
        raise InputError(f"{path}: cannot write there: {nearest} is not a folder")
    if not os.access(nearest, os.W_OK):
        raise InputError(f"{path}: cannot write there: no permission for {nearest}")


def print_table(table: object) -> None:
    """Print the gap table of Findings."""
    shown = Table(title="error of one-second replays on held-out runs (RMSE)")
    for heading in ("channel", "believed", "refit", "with effects", "noise floor"):
        shown.add_column(heading, justify="left" if heading == "channel" else "right")
    for c, channel in enumerate(table.channels):
        cells = [f"{table.rmse[m, c]:.4g}" for m in range(3)]
        shown.add_row(channel, *cells, f"{table.floor[c]:.4g}")
    Console().print(shown)
