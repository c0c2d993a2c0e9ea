"""The commands `omnislip link PORT ...`."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.table import Table

from omnislip.errors import InputError, RobotError
from omnislip.link import protocol
from omnislip.link.port import SerialLine
from omnislip.link.session import Session

if TYPE_CHECKING:
    from omnislip.link.monitor import Watched
    from omnislip.link.record import Recorder

app = typer.Typer(
    help="Talk to a robot over its serial port: PORT, then a command. The virtual robot "
    "(omnislip robot) is such a port too.",
    no_args_is_help=True,
)

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Save = Annotated[bool, typer.Option("--save", help="Keep it in the robot's EEPROM.")]
Rate = Annotated[int, typer.Option(help="Rows per second.")]
STORE_TIME_S = 5.0
PIPED_WIDTH = 200


@app.callback()
def port(
    context: typer.Context,
    port: Annotated[str, typer.Argument(metavar="PORT", help="/dev/ttyUSB0, COM3, ...")],
) -> None:
    """Keep the port for the command that follows."""
    context.obj = port


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 info")
def info(context: typer.Context, as_json: Json = False) -> None:
    """Say who is there, in what state, and how the line fares."""
    with _session(context) as session:
        identity = session.connect()
        status = session.watch_status()
    if as_json:
        _print_json({"protocol": protocol.VERSION, **asdict(identity), "status": asdict(status)})
        return
    print(f"protocol {protocol.VERSION}, on for {identity.time_ms / 1000:.1f} s")
    print(f"state {status}: {protocol.STATES[status.state]}")
    print(f"last reset {identity.reset_cause}; parameters: {_store_text(status.store_status)}")
    print(", ".join(f"{name} {count}" for name, count in status.counters.items()))


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 monitor --signal supply_mv --plot run.png")
def monitor(
    context: typer.Context,
    signal: Annotated[
        list[str] | None, typer.Option(help="Signal of telemetry.def; repeat. Default: a choice.")
    ] = None,
    rate: Rate = 20,
    duration: Annotated[float | None, typer.Option(help="Seconds; default: to Ctrl-C.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Picture to write at the end.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object per sample.")] = False,
) -> None:
    """Show signals live: a table of the values, and plots of their last ten seconds beside it."""
    from omnislip import plots
    from omnislip.link.monitor import MONITOR_STREAM, SIGNALS, Watched
    from omnislip.link.monitor import plot as draw

    if plot is not None:
        plots.check_figure_path(plot)
    if rate < 1 or 1000 % rate:
        raise InputError(f"--rate must divide 1000, {rate} does not")
    watched = Watched(signal or SIGNALS)
    with _session(context) as session:
        session.connect()
        layout = session.open_stream(MONITOR_STREAM, 1000 // rate, watched.names, watched.take)
        _check_line(layout.frame_bytes * rate)
        if as_json:
            _until_ctrl_c(session, duration, _print_samples(watched))
        else:
            _watch_table(session, watched, duration)
        session.close_stream(MONITOR_STREAM)
    if plot is not None and len(watched):
        draw(watched, plot)
    _say(f"{len(watched)} samples, {session.counters.samples_missing} missing")


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 record --out run.csv --duration 10")
def record(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Log to write (.csv or .parquet).")],
    rate: Rate = 200,
    duration: Annotated[float | None, typer.Option(help="Seconds; default: to Ctrl-C.")] = None,
    as_json: Json = False,
) -> None:
    """Record telemetry to a log; missing frames are counted and named."""
    from omnislip.link.record import Recorder, period_of
    from omnislip.log_file import check_log_path

    check_log_path(out)
    period_of(rate)
    with _session(context) as session:
        session.connect()
        recorder = Recorder(session, rate)
        recorder.start()
        with _status() as tell:
            _until_ctrl_c(session, duration, lambda: tell(f"{recorder.rows} rows"))
        _finish_recording(session, recorder, out, as_json, {})


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 drive square.toml --out run.csv")
def drive(
    context: typer.Context,
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml): its commands.")],
    out: Annotated[
        Path | None, typer.Option(help="Log to record meanwhile (.csv or .parquet).")
    ] = None,
    rate: Rate = 200,
    as_json: Json = False,
) -> None:
    """Drive through a scenario's commands, then stop and switch the power stage off.

    Of the scenario count duration, controller and commands; blows and sensors belong to simulation.
    Poses are those of the robot's odometry.
    """
    from omnislip.link.drive import drive as drive_programme
    from omnislip.link.record import Recorder, period_of
    from omnislip.log_file import check_log_path
    from omnislip.scenario import read_scenario

    programme = read_scenario(scenario)
    if out is not None:
        check_log_path(out)
        period_of(rate)
    if programme.impulses:
        _say(f"{scenario}: [[impact]] is for simulation; nobody pushes the robot here")
    with _session(context) as session:
        session.connect()
        recorder = Recorder(session, rate) if out is not None else None
        if recorder is not None:
            recorder.start()
        else:
            session.watch_status()
        with _status() as tell:
            driven = drive_programme(session, programme, tell)
        if recorder is not None and out is not None:
            _finish_recording(session, recorder, out, as_json, asdict(driven))
            return
    if as_json:
        _print_json(asdict(driven))
        return
    print(_driven_text(asdict(driven)))


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 get speed_gain command_timeout_ms")
def get(
    context: typer.Context,
    names: Annotated[list[str] | None, typer.Argument(help="Parameters; default: all.")] = None,
    as_json: Json = False,
) -> None:
    """Print parameters: value, unit, limits, default, meaning."""
    found = [protocol.find_parameter(name) for name in names or protocol.PARAMETERS]
    with _session(context) as session:
        session.connect()
        raw = {p.name: session.request("parameter_get", id=p.id)["value"] for p in found}
    _print_parameters(found, raw, as_json)


@app.command("set", epilog="Example: omnislip link /dev/ttyUSB0 set speed_gain=0.15 --save")
def set_parameters(
    context: typer.Context,
    values: Annotated[list[str] | None, typer.Argument(help="NAME=VALUE in the unit.")] = None,
    robot: Annotated[
        Path | None, typer.Option(help="Model file: set all that omnislip gains computes of it.")
    ] = None,
    save: Save = False,
    as_json: Json = False,
) -> None:
    """Set parameters by name, in their units; they are read back."""
    wanted = _wanted_values(values or [], robot)
    with _session(context) as session:
        session.connect()
        for parameter, raw in wanted.items():
            session.request("parameter_set", id=protocol.PARAMETERS[parameter].id, value=raw)
        read = {
            name: session.request("parameter_get", id=protocol.PARAMETERS[name].id)["value"]
            for name in wanted
        }
        if read != wanted:
            wrong = next(name for name in wanted if read[name] != wanted[name])
            raise RobotError(f"parameter {wrong} reads back as {read[wrong]}, not {wanted[wrong]}")
        if save:
            _store(session, "parameters_save")
    _print_parameters([protocol.PARAMETERS[name] for name in wanted], read, as_json)


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 save")
def save(context: typer.Context) -> None:
    """Save the parameters to the robot's EEPROM."""
    with _session(context) as session:
        session.connect()
        print(_store_text(_store(session, "parameters_save")))


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 load")
def load(context: typer.Context) -> None:
    """Load the parameters that were saved in the robot's EEPROM."""
    with _session(context) as session:
        session.connect()
        print(_store_text(_store(session, "parameters_load")))


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 defaults")
def defaults(context: typer.Context) -> None:
    """Set all parameters to their defaults, those of the nominal robot."""
    _simple(context, "parameters_default")


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 stop")
def stop(context: typer.Context) -> None:
    """End the command in force and switch the power stage off."""
    with _session(context) as session:
        session.connect()
        session.request("stop")
        session.request("disarm")
        print(f"state {session.watch_status()}")


@app.command(epilog="Example: omnislip link /dev/ttyUSB0 clear-fault")
def clear_fault(context: typer.Context) -> None:
    """Leave the state FAULT."""
    _simple(context, "clear_fault")


# ---- inside ----


@contextmanager
def _session(context: typer.Context) -> Iterator[Session]:
    line = SerialLine(context.obj)
    try:
        session = Session(line)
        yield session
        session.close()
    finally:
        line.close()


def _simple(context: typer.Context, request: str) -> None:
    with _session(context) as session:
        session.connect()
        session.request(request)
        print(f"state {session.watch_status()}")


def _store(session: Session, request: str) -> str:
    """Have the store work; return its status at the end. RobotError when it has failed."""
    session.request(request)
    status = session.watch_status()
    until_s = session.line.time_s() + STORE_TIME_S
    while status.store_status in ("SAVING", "LOADING"):
        if session.line.time_s() > until_s:
            raise RobotError(f"the parameter store is still at work after {STORE_TIME_S:g} s")
        status = session.fresh_status()
    if status.store_status not in ("SAVED", "LOADED"):
        raise RobotError(f"parameters: {_store_text(status.store_status)}")
    return status.store_status


def _store_text(status: str) -> str:
    return f"{status}: {protocol.STORE_STATUSES[status]}"


def _wanted_values(given: list[str], robot: Path | None) -> dict[str, int]:
    from omnislip.gains import gains
    from omnislip.model_file import read_model

    wanted = gains(read_model(robot)).raw if robot is not None else {}
    for assignment in given:
        name, equals, text = assignment.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not equals or not abs(value) < float("inf"):
            raise InputError(f"'{assignment}': must be NAME=VALUE with a number")
        parameter = protocol.find_parameter(name)
        wanted[parameter.name] = parameter.raw(value)
    if not wanted:
        raise InputError("nothing to set: give NAME=VALUE or --robot MODEL.toml")
    return wanted


def _check_line(bytes_per_second: int) -> None:
    if bytes_per_second > protocol.BYTES_PER_SECOND:
        _say(
            f"{bytes_per_second} bytes/s are more than the line carries "
            f"({protocol.BYTES_PER_SECOND}): samples will be missing"
        )


def _until_ctrl_c(session: Session, duration_s: float | None, show: Callable[[], None]) -> None:
    """Listen for `duration_s`, or to Ctrl-C; `show` five times a second."""
    begin_s = session.line.time_s()
    try:
        while duration_s is None or session.line.time_s() - begin_s < duration_s:
            session.listen(0.2)
            show()
    except KeyboardInterrupt:
        return


def _watch_table(session: Session, watched: "Watched", duration_s: float | None) -> None:
    """Fill a terminal with table and plots; the table of the end is printed, elsewhere only it."""
    from omnislip.link.monitor import live_view

    console = Console()

    def title() -> str:
        counters = session.counters
        counted = f"{counters.samples} samples, {counters.samples_missing} missing"
        return f"{counted}\n{session.events[-1]}" if session.events else counted

    if console.is_terminal:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            _until_ctrl_c(
                session,
                duration_s,
                lambda: live.update(live_view(watched, title(), console), refresh=True),
            )
    else:
        _until_ctrl_c(session, duration_s, lambda: None)
    console.print(watched.table(title()))


def _print_samples(watched: "Watched") -> Callable[[], None]:
    printed = 0

    def show() -> None:
        nonlocal printed
        for row in watched.rows(printed):
            print(json.dumps(row), flush=True)
        printed = len(watched)

    return show


def _finish_recording(
    session: Session,
    recorder: "Recorder",
    out: Path,
    as_json: bool,
    driven: dict[str, int],
) -> None:
    from omnislip.log_file import write_log

    log, account = recorder.finish(out.stem)
    write_log(log, out)
    counters = asdict(session.counters) | {"broken_frames": session.broken_frames}
    if as_json:
        account_dict = asdict(account) | {"lost_on_line": account.lost_on_line}
        _print_json(
            {"log": str(out), "rows": len(log.t_s), "frames": account_dict, "line": counters}
            | ({"drive": driven} if driven else {})
        )
        return
    if driven:
        print(_driven_text(driven))
    print(
        f"{len(log.t_s)} rows in {out}: {account.received} frames received, "
        f"{account.missing} missing ({account.skipped_by_robot} for want of space, "
        f"{account.lost_on_line} on the line)"
    )
    for t_s, count in account.gaps[:10]:
        print(f"  after {t_s:.3f} s: {count} missing")
    if len(account.gaps) > 10:
        print(f"  and {len(account.gaps) - 10} more gaps (--json gives all)")


def _driven_text(driven: dict[str, int]) -> str:
    return (
        f"{driven['commands']} commands sent, {driven['answered']} answered, "
        f"{driven['timeouts']} times too late for the robot"
    )


def _print_parameters(
    parameters: list[protocol.Parameter], raw: dict[str, int], as_json: bool
) -> None:
    rows = {
        p.name: {
            "value": p.value(raw[p.name]),
            "unit": p.unit,
            "raw": raw[p.name],
            "minimum": p.value(p.minimum),
            "maximum": p.value(p.maximum),
            "default": p.value(p.default),
            "while_driving": p.tunable,
            "description": p.description,
        }
        for p in parameters
    }
    if as_json:
        _print_json({"parameters": rows})
        return
    table = Table(box=None)
    for heading in ("name", "value", "unit", "limits", "default", "is"):
        justify = "right" if heading in ("value", "default") else "left"
        table.add_column(heading, justify=justify, no_wrap=heading not in ("limits", "is"))
    for name, row in rows.items():
        limits = f"{row['minimum']:.5g} to {row['maximum']:.5g}"
        table.add_row(
            name,
            f"{row['value']:.6g}",
            row["unit"],
            limits,
            f"{row['default']:.6g}",
            row["description"],
        )
    # Behind a pipe each parameter is one line.
    (Console() if sys.stdout.isatty() else Console(width=PIPED_WIDTH)).print(table)


@contextmanager
def _status() -> Iterator[Callable[[str], None]]:
    """A status line on stderr, on a terminal only."""
    console = Console(stderr=True)
    with console.status("starting") as status:
        last_s = 0.0

        def tell(text: str) -> None:
            nonlocal last_s
            if time.monotonic() - last_s > 0.2:
                last_s = time.monotonic()
                status.update(text)

        yield tell


def _print_json(result: dict[str, Any]) -> None:
    print(json.dumps(result, indent=1))


def _say(text: str) -> None:
    print(text, file=sys.stderr)
