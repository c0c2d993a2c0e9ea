"""Watch a robot: a live table with plots beside it, and a picture of the whole."""

import itertools
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import plotext
from rich.console import Console, ConsoleOptions, RenderResult
from rich.layout import Layout
from rich.table import Table
from rich.text import Text

from omnislip import plots
from omnislip.link import protocol
from omnislip.link.protocol import Signal

MONITOR_STREAM = 1
SIGNALS = (
    "time_ms",
    "state",
    "fault",
    "fault_wheel",
    "mode",
    "limit",
    "limit_wheel",
    "supply_mv",
    "pose_x_mm_q13",
    "pose_y_mm_q13",
    "pose_theta_mrad_q13",
    "observed_x_m_s_q13",
    "observed_y_m_s_q13",
    "observed_omega_rad_s_q11",
    *(f"shaft_{wheel}_rad_s_q5" for wheel in range(1, 5)),
)
# Of the live plots; the picture shows all.
WINDOW_S = 10.0
# Smallest panel in which a course can be read, in characters.
PANEL_COLUMNS, PANEL_ROWS = 30, 8
COLORS = ("blue+", "red+", "green+", "magenta+", "cyan+", "yellow")  # of plotext, readable on both

Floats = npt.NDArray[np.float64]


class Watched:
    """The samples of a monitored stream, raw; all of them are kept for the picture."""

    def __init__(self, signals: Sequence[str]) -> None:
        names = [protocol.find_signal(name).name for name in signals]
        # Time is asked for in any case: it is the axis of the plots.
        self.names = names if "time_ms" in names else ["time_ms", *names]
        self._columns = {name: array("q") for name in self.names}

    def __len__(self) -> int:
        """How many samples there are."""
        return len(self._columns["time_ms"])

    def take(self, _sequence: int, raw: dict[str, int]) -> None:
        """Add a sample."""
        for name, column in self._columns.items():
            column.append(raw[name])

    def rows(self, begin: int) -> Iterator[dict[str, float]]:
        """Yield the samples from number `begin` on, in their units."""
        for row in range(begin, len(self)):
            yield {n: protocol.SIGNALS[n].value(c[row]) for n, c in self._columns.items()}

    def time_s(self) -> Floats:
        """Return the robot's time of each sample."""
        return np.array(self._columns["time_ms"]) / 1000

    def values(self, signal: Signal, begin: int = 0) -> Floats:
        """Return a signal in its unit, from sample `begin` on."""
        return np.array(self._columns[signal.name][begin:]) / 2**signal.q_bits

    def table(self, title: str) -> Table:
        """Return the latest values."""
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        table.add_column("signal")
        table.add_column("value", justify="right", min_width=15)
        table.add_column("unit")
        for name in self.names:
            signal = protocol.SIGNALS[name]
            shown = signal.shown(self._columns[name][-1]) if len(self) else ""
            table.add_row(name, shown, "" if signal.unit == "1" else signal.unit)
        return table

    def by_unit(self) -> dict[str, list[Signal]]:
        """Return the signals, without time, grouped by unit in the order asked for."""
        groups: dict[str, list[Signal]] = {}
        for name in self.names:
            if name != "time_ms":
                signal = protocol.SIGNALS[name]
                unit = name if name in protocol.NAMES_OF else signal.unit
                groups.setdefault(unit, []).append(signal)
        return groups


class LivePlots:
    """The last WINDOW_S of the numbers, one panel per unit, as many as the place has room for.

    What has names instead of numbers, such as the state, is told by the table.
    """

    def __init__(self, watched: Watched) -> None:
        self._watched = watched
        groups = watched.by_unit()
        numbers = [unit for unit in groups if unit not in protocol.NAMES_OF]
        # Numbers without a unit last: they are mostly of interest in the table.
        self._panels = {unit: groups[unit] for unit in sorted(numbers, key=lambda u: u == "1")}

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw for the place that is given."""
        width, height = options.max_width, options.height or console.height
        if len(self._watched) == 0:
            return
        t_s = self._watched.time_s()
        begin = int(np.searchsorted(t_s, t_s[-1] - WINDOW_S))
        rows = grid(len(self._panels), width, height)
        plotext.main()
        plotext.clear_figure()
        plotext.limit_size(False, False)
        plotext.plot_size(width, height)
        plotext.subplots(len(rows), 1)
        units = iter(self._panels.items())
        for row, columns in enumerate(rows, start=1):
            strip = plotext.main().subplot(row, 1)
            strip.subplots(1, columns)
            for column in range(1, columns + 1):
                strip.subplot(1, column)
                self._draw(*next(units), t_s[begin:] - t_s[-1], begin)
        if rows:
            yield Text.from_ansi(plotext.main().build())

    def _draw(self, unit: str, signals: list[Signal], t_s: Floats, begin: int) -> None:
        """Draw signals, from sample `begin` on, into the panel that plotext has chosen."""
        plotext.theme("clear")
        plotext.title(unit)
        plotext.xlim(-WINDOW_S, 0.0)
        for signal, color in zip(signals, itertools.cycle(COLORS), strict=False):
            values = self._watched.values(signal, begin)
            plotext.plot(t_s, values, label=signal.name, marker="braille", color=color)


def grid(panels: int, width: int, height: int) -> list[int]:
    """Return the number of panels in each row: as many as have room, in as few columns as do."""
    rows, columns = height // PANEL_ROWS, width // PANEL_COLUMNS
    shown = min(panels, rows * columns)
    if shown == 0:
        return []
    rows = -(-shown // -(-shown // rows))
    return [shown // rows + (row < shown % rows) for row in range(rows)]


def live_view(watched: Watched, title: str, console: Console) -> Layout:
    """Return table and plots side by side for the whole of a terminal."""
    table = watched.table(title)
    view = Layout()
    view.split_row(
        Layout(table, size=console.measure(table).maximum + 1), Layout(LivePlots(watched))
    )
    return view


def plot(watched: Watched, path: Path) -> None:
    """Draw all samples over time, one panel per unit, to a .png, .svg or .pdf file."""
    groups = watched.by_unit()
    figure, axes = plots.new_figure(len(groups), 1, (8.0, 1.0 + 1.6 * len(groups)))
    t_s = watched.time_s()
    for axis, (unit, signals) in zip(axes, groups.items(), strict=True):
        for signal in signals:
            axis.plot(t_s, watched.values(signal), label=signal.name, linewidth=0.9)
        names = protocol.NAMES_OF.get(unit)
        if names is not None:
            axis.set_yticks(range(len(names)), names, fontsize="x-small")
        axis.set_ylabel(unit)
        axis.legend(fontsize="x-small", loc="upper right")
    axes[-1].set_xlabel("time of the robot / s")
    plots.save_figure(figure, path)
