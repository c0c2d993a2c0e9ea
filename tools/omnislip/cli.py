"""The command `omnislip`.

Results go to stdout, progress of work over two seconds to stderr. Exit status: 0 when the work was
done, 2 for bad input, with one line that says what to mend, 3 when a robot does not do what it was
asked.
"""

import json
import math
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
    track,
)
from rich.table import Table
from typer.exceptions import TyperException

from omnislip.errors import InputError, RobotError
from omnislip.gap.commands import app as gap_app
from omnislip.gap.commands import check_folder
from omnislip.importers import data_folder
from omnislip.link.commands import app as link_app

if TYPE_CHECKING:  # the command line starts without pandas
    from omnislip.log_file import Log

SECONDS_PER_LINE = 2.0

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
import_app = typer.Typer(
    help="Turn public measured data sets into logs and model files.", no_args_is_help=True
)
app.add_typer(import_app, name="import")
app.add_typer(gap_app, name="gap")
app.add_typer(link_app, name="link")


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"omnislip {version('omnislip')}")
        raise typer.Exit


@app.callback()
def _omnislip(
    shown: Annotated[
        bool,
        typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True),
    ] = False,
) -> None:
    """Simulate a four-wheeled omnidirectional robot with slip; find what its model lacks."""


Item = TypeVar("Item")
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.command(
    epilog="Example: omnislip simulate square.toml --out square.csv --plot square.png\n\n"
    "Example: omnislip simulate square.toml --sweep sweep.toml --out square_sweep"
)
def simulate(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    out: Annotated[
        Path, typer.Option(help="Log to write (.csv, .parquet, .mcap); folder of a sweep.")
    ],
    plot: Annotated[Path | None, typer.Option(help="Figure to write (.png, .svg, .pdf).")] = None,
    on_board: Annotated[
        bool, typer.Option("--on-board", help="Through the drivers on the virtual LF2407A.")
    ] = False,
    sweep: Annotated[
        Path | None, typer.Option(help="Sweep file (.toml): simulate with these keys varied.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Dask scheduler for the sweep, tcp://HOST:8786; default: this machine."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Drive a simulated robot through a scenario and log what its sensors see.

    With --sweep: many times over, with keys of scenario and robot varied; what was finished is kept
    when the command is repeated.
    """
    if sweep is None:
        if scheduler is not None:
            raise InputError("--scheduler: goes with --sweep")
        _simulate_once(scenario, out, plot, on_board, as_json)
        return
    if plot is not None:
        raise InputError("--plot: goes with a single run, not with --sweep")
    if on_board:
        raise InputError("--on-board: goes with a single run, not with --sweep")
    _simulate_sweep(scenario, sweep, out, scheduler, as_json)


def _simulate_once(
    scenario: Path, out: Path, plot: Path | None, on_board: bool, as_json: bool
) -> None:
    from omnislip import plots
    from omnislip.mcap_export import with_truth
    from omnislip.measures import measure
    from omnislip.scenario import read_scenario
    from omnislip.simulate import run_scenario

    _check_written_log(out)
    if plot is not None:
        plots.check_figure_path(plot)
    settings = read_scenario(scenario)
    run = run_scenario(settings, on_board)
    _write_log(with_truth(run.log, run.truth) if out.suffix == ".mcap" else run.log, out)
    if plot is not None:
        plots.plot_run(run.truth, plot)
    x_m, y_m, theta_rad = run.truth["pose"][-1].tolist()
    result = {
        "log": str(out),
        "plot": str(plot) if plot is not None else None,
        "rows": len(run.log.t_s),
        "final_pose": {"x_m": x_m, "y_m": y_m, "theta_rad": theta_rad},
        "measures": _finite_or_none(measure(settings, run.truth)),
    }
    if as_json:
        _print_json(result)
        return
    print(f"{len(run.log.t_s)} rows in {out}" + (f", figure in {plot}" if plot else ""))
    print(f"final pose: x {x_m:.3f} m, y {y_m:.3f} m, theta {theta_rad:.3f} rad")


def _simulate_sweep(
    scenario: Path, sweep: Path, out: Path, scheduler: str | None, as_json: bool
) -> None:
    from omnislip.sweep import SUMMARY, read_sweep, run_sweep

    check_folder(out)
    with _counting("checking the cases", "simulated") as progress:
        summary = run_sweep(scenario, read_sweep(sweep), out, scheduler, progress)
    failed = int((summary["error"] != "").sum())
    result = {"cases": len(summary), "failed": failed, "summary": str(out / SUMMARY)}
    if as_json:
        _print_json(result)
        return
    print(f"{len(summary)} cases in {out}, summary in {out / SUMMARY}")
    if failed:
        print(f"{failed} could not be simulated: see the column 'error' of the summary")


@app.command(epilog="Example: omnislip export run.csv run.mcap")
def export(
    log: Annotated[Path, typer.Argument(help="Log to read (.csv or .parquet).")],
    out: Annotated[Path, typer.Argument(help="File to write (.mcap, .csv or .parquet).")],
) -> None:
    """Turn a log into another file format, such as MCAP for PlotJuggler and Foxglove."""
    from omnislip.log_file import read_log

    _check_written_log(out)
    read = read_log(log, kind=None)
    _write_log(read, out)
    print(f"{len(read.t_s)} rows in {out}")


@app.command(epilog="Example: omnislip paper --out build/paper")
def paper(
    out: Annotated[Path, typer.Option(help="Folder for figures, logs and paper.json.")],
    as_json: Json = False,
) -> None:
    """Repeat the paper's experiment: a sideways impact, control without and with slip model."""
    from omnislip.paper import all_cases, run_experiment

    _check_folder(out)
    result = run_experiment(_progress(all_cases(), "paper experiment"), out)
    if as_json:
        _print_json(result)
        return
    _print_paper(result)
    print(f"in {out}: figure_6.png, same_impact.png, sweep.png, push.gif, paper.json, four logs")


@app.command(epilog="Example: omnislip gains robot.toml")
def gains(
    robot: Annotated[Path, typer.Argument(help="Model file of the robot (.toml).")],
    as_json: Json = False,
) -> None:
    """Compute the firmware's parameters (gains, limits, model) for a robot."""
    from omnislip.gains import describe
    from omnislip.gains import gains as gains_of
    from omnislip.model_file import read_model

    found = describe(gains_of(read_model(robot)))
    if as_json:
        _print_json(found)
        return
    _print_gains(found)


@app.command(epilog="Example: omnislip figures --out build/figures")
def figures(
    out: Annotated[Path, typer.Option(help="Folder for figures.json.")],
    as_json: Json = False,
) -> None:
    """Measure the firmware: impacts, odometry, gains, step responses, stopping on low grip."""
    from omnislip.firmware_figures import all_cases, run_figures, tables

    _check_folder(out)
    result = run_figures(_progress(all_cases(), "firmware figures"), out)
    if as_json:
        _print_json(result)
        return
    for title, rows in tables(result):
        _print_rows(title, rows)
    print(f"in {out}: figures.json")


@app.command(epilog="Example: omnislip robot --robot robot.toml --port-link build/robot")
def robot(
    robot: Annotated[
        Path | None, typer.Option(help="Model file, with effects; default: the nominal robot.")
    ] = None,
    port_link: Annotated[
        Path | None, typer.Option(help="Link that points to the robot's port while it runs.")
    ] = None,
    store: Annotated[
        Path | None, typer.Option(help="File of the EEPROM; default: blank, kept nowhere.")
    ] = None,
    on_board: Annotated[
        bool, typer.Option("--on-board", help="Through the drivers on the virtual LF2407A.")
    ] = False,
) -> None:
    """Run the virtual robot in real time, its serial port on a pseudo-terminal, to Ctrl-C.

    Its firmware believes what its EEPROM says, or the nominal robot: omnislip link PORT set --robot
    FILE --save gives it another belief.
    """
    from omnislip.model_file import NOMINAL_ROBOT, read_model
    from omnislip.virtual_robot import make_robot, port_link_to, pseudo_terminal, read_store, serve

    words = read_store(store) if store is not None else []
    virtual = make_robot(read_model(robot or NOMINAL_ROBOT), words, on_board)
    with _stop_signals():
        try:
            with pseudo_terminal() as (master, port), port_link_to(port, port_link):
                print(f"robot at {port_link or port}", flush=True)
                serve(virtual, master, store, _say_late)
        except KeyboardInterrupt:
            x_m, y_m, theta_rad = virtual.truth["pose"]
            print(
                f"after {virtual.ticks / 1000:.1f} s at x {x_m:.3f} m, y {y_m:.3f} m, "
                f"theta {theta_rad:.3f} rad"
            )


@app.command(epilog="Example: omnislip flash monitor.out --port /dev/ttyUSB0")
def flash(
    image: Annotated[Path, typer.Argument(help="Program: TI COFF (.out) or Intel HEX (.hex).")],
    port: Annotated[
        str | None, typer.Option(help="Serial port of the chip; without, the image is checked.")
    ] = None,
    reset_by: Annotated[
        str | None, typer.Option(help="rts or dtr: that line resets the chip; else by hand.")
    ] = None,
    kernel: Annotated[
        Path | None,
        typer.Option(help="Folder of TI's serial programmer SPRC074: the steps with it."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check a program for the LF2407A; load one for RAM through the chip's boot ROM, start it.

    The chip must be reset with BOOT_EN low, before the transfer and after one that has failed. For
    a program that goes to flash sectors, the tools that write them are named.
    """
    from omnislip.flash.commands import load_ram, read_image, show_image
    from omnislip.flash.sectors import kernel_steps, ways

    if reset_by not in (None, "rts", "dtr"):
        raise InputError(f"--reset-by must be rts or dtr, not {reset_by}")
    if kernel is not None and port is not None:
        raise InputError(
            "--kernel: cannot be used with --port: the protocol of TI's kernel was never "
            "published; without --port the steps with TI's own program are named"
        )
    program = read_image(image)
    steps = kernel_steps(program, kernel) if kernel is not None else ways(program)
    if as_json:
        _print_json(program.as_dict() | {"steps": steps})
    else:
        show_image(program, steps)
    if port is not None:
        load_ram(program, port, reset_by)


Data = Annotated[
    Path | None,
    typer.Option(help="Folder of data sets; default $OMNISLIP_DATA, else ../shared/data."),
]


@import_app.command(epilog="Example: omnislip import emps --out build/emps")
def emps(
    out: Annotated[Path, typer.Option(help="Folder for train.csv, test.csv and emps.toml.")],
    data: Data = None,
    as_json: Json = False,
) -> None:
    """EMPS: an electro-mechanical positioning axis (Janot, Gautier, Brunot 2019)."""
    from omnislip.importers.emps import import_emps

    _print_files(import_emps(data or data_folder(), out), as_json)


@import_app.command(epilog="Example: omnislip import bam --out build/bam")
def bam(
    out: Annotated[Path, typer.Option(help="Folder for 16 logs and bam_xl330.toml.")],
    data: Data = None,
    as_json: Json = False,
) -> None:
    """BAM: a Dynamixel XL330 servo that swings a pendulum (Rhoban, 2025)."""
    from omnislip.importers.bam import import_bam

    _print_files(import_bam(data or data_folder(), out), as_json)


@import_app.command(epilog="Example: omnislip import optiodom --out build/optiodom")
def optiodom(
    out: Annotated[Path, typer.Option(help="Folder for ROBOT/SERIES/RUN.csv and ROBOT.toml.")],
    data: Data = None,
    as_json: Json = False,
) -> None:
    """Encoders and motion capture of a four- and a three-wheeled robot (OptiOdom, 2022)."""
    from omnislip.importers.optiodom import import_optiodom

    _print_files(import_optiodom(data or data_folder(), out), as_json)


def _print_files(paths: list[Path], as_json: bool) -> None:
    written = [str(path) for path in paths]
    if as_json:
        _print_json({"files": written})
    else:
        print("wrote " + ", ".join(written))


def main() -> None:
    """Run the command line; an error ends with one line on stderr and exit status 2 or 3."""
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except TyperException as error:  # its own words for wrong usage are a box of lines
        what = " ".join(error.format_message().split()).rstrip(".")
        if what:  # nothing where the help was asked for by no argument
            context = getattr(error, "ctx", None)
            command = context.command_path if context else "omnislip"
            print(f"omnislip: error: {what}; see {command} --help", file=sys.stderr)
        sys.exit(error.exit_code)
    except InputError as error:
        print(f"omnislip: error: {_one_line(error)}", file=sys.stderr)
        sys.exit(2)
    except RobotError as error:
        print(f"omnislip: error: {_one_line(error)}", file=sys.stderr)
        sys.exit(3)


def _one_line(error: Exception) -> str:
    """Return its words with what a spoilt file may bring into them escaped: NUL, line ends."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(error))


@contextmanager
def _stop_signals() -> Iterator[None]:
    """Take a request to end for a Ctrl-C, so that what has to be tidied up is."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _say_late(late_s: float) -> None:
    print(f"the machine is too slow: {late_s:.1f} s left out", file=sys.stderr)


def _check_written_log(path: Path) -> None:
    from omnislip.log_file import LOG_SUFFIXES, check_log_path

    check_log_path(path, (*LOG_SUFFIXES, ".mcap"))


def _write_log(log: "Log", path: Path) -> None:
    from omnislip.log_file import write_log
    from omnislip.mcap_export import write_mcap

    if path.suffix == ".mcap":
        write_mcap(log, path, lambda rows: _progress(rows, str(path)))
    else:
        write_log(log, path)


@contextmanager
def _counting(before: str, what: str) -> Iterator[Callable[[int, int], None]]:
    """Show on stderr how much of the work is done; lines every few seconds if it is no terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    bar = Progress(*columns, TimeRemainingColumn(), console=console, transient=True)
    last_line_s = time.monotonic()

    def show(done: int, total: int) -> None:
        nonlocal last_line_s
        bar.update(task, description=what, completed=done, total=total)
        if not console.is_terminal and time.monotonic() - last_line_s > SECONDS_PER_LINE:
            last_line_s = time.monotonic()
            print(f"{done} of {total} {what}", file=sys.stderr)

    task = bar.add_task(before, total=None)
    if console.is_terminal:
        bar.start()
    try:
        yield show
    finally:
        if console.is_terminal:
            bar.stop()


def _finite_or_none(numbers: dict[str, float]) -> dict[str, float | None]:
    """JSON has no NaN."""
    return {name: value if math.isfinite(value) else None for name, value in numbers.items()}


def _progress(items: list[Item], what: str) -> Iterable[Item]:
    return track(items, description=what, console=Console(stderr=True), transient=True)


def _check_folder(path: Path) -> None:
    """Fail before the work, not after it, when the results could not be written."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: folder cannot be made: {error.strerror}") from None


def _print_json(result: dict[str, Any]) -> None:
    print(json.dumps(result, indent=1))


def _print_rows(title: str, rows: list[dict[str, Any]]) -> None:
    """Print rows with the same keys; the first word of a key stands above the others."""
    table = Table(title=title)
    for key in rows[0]:
        table.add_column(key.replace("_", "\n"), justify="right")
    for row in rows:
        cells = (f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in row.values())
        table.add_row(*cells)
    Console().print(table)


def _print_gains(found: dict[str, Any]) -> None:
    print(f"{'name':34} {'value':>11} {'unit':9} {'raw':>6}  is")
    for name, row in found["parameters"].items():
        line = f"{name:34} {row['value']:>11.6g} {row['unit']:9} {row['raw']:>6}"
        print(f"{line}  {row['description']}")
    for key, text in (
        ("effects_used", "effects taken into the values"),
        ("effects_not_used", "effects that the firmware has no term for"),
    ):
        if found[key]:
            print(f"{text}: {', '.join(found[key])}")


def _print_paper(result: dict[str, Any]) -> None:
    table = Table(title=f"sideways impact at {result['speed_m_s']} m/s along x")
    for heading in ("impulse\nN s", "impact x\nmm", "control", "overshoot\n%", "speed error\n%"):
        table.add_column(heading, justify="right")
    for heading in ("peak |y|\nmm", "remaining |y|\nmm"):
        table.add_column(heading, justify="right")
    for run in result["runs"]:
        table.add_row(
            f"{run['impulse_y_n_s']:g}",
            f"{1000 * run['impact_x_m']:.0f}",
            run["controller"],
            f"{run['speed_overshoot_percent']:.2f}",
            f"{run['speed_error_percent']:+.2f}",
            f"{1000 * run['peak_y_m']:.1f}",
            f"{1000 * run['remaining_y_m']:.1f}",
        )
    console = Console()
    console.print(table)
    for row in result["ratios"]:
        if row["impulse_y_n_s"] == result["reference_impulse_n_s"]:
            console.print(
                f"impact at {1000 * row['impact_x_m']:.0f} mm, {row['impulse_y_n_s']:g} N s: "
                f"without / with slip model: peak |y| {row['peak_y_ratio']:.2f}, "
                f"remaining |y| {row['remaining_y_ratio']:.2f}",
                soft_wrap=True,
            )


if __name__ == "__main__":
    main()
