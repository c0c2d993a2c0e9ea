"""Watch a robot: a live table with a trace of each signal, and a picture of the whole."""

from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.table import Table

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
    "supply_mv",
    "pose_x_mm_q13",
    "pose_y_mm_q13",
    "pose_theta_mrad_q13",
    "observed_x_m_s_q13",
    "observed_y_m_s_q13",
    "observed_omega_rad_s_q11",
    *(f"shaft_{wheel}_rad_s_q5" for wheel in range(1, 5)),
)
TRACE_SAMPLES = 40
_BARS = "▁▂▃▄▅▆▇█"


class Watched:
    """The samples of a monitored stream, raw; all of them are kept for the picture."""

    def __init__(self, signals: Sequence[str]) -> None:
        names = [protocol.find_signal(name).name for name in signals]
        # Time is asked for in any case: it is the axis of the picture.
        self.names = names if "time_ms" in names else ["time_ms", *names]
        self.samples: list[dict[str, int]] = []
        self._recent: deque[dict[str, int]] = deque(maxlen=TRACE_SAMPLES)

    def take(self, _sequence: int, raw: dict[str, int]) -> None:
        """Add a sample."""
        self.samples.append(raw)
        self._recent.append(raw)

    def table(self, title: str) -> Table:
        """Return the latest values with a trace of the recent ones."""
        table = Table(title=title, title_justify="left")
        table.add_column("signal")
        table.add_column("value", justify="right", min_width=12)
        table.add_column("unit")
        table.add_column(f"last {TRACE_SAMPLES} samples", min_width=TRACE_SAMPLES)
        for name in self.names:
            signal = protocol.SIGNALS[name]
            values = [raw[name] for raw in self._recent]
            shown = signal.shown(values[-1]) if values else ""
            unit = "" if signal.unit == "1" else signal.unit
            table.add_row(name, shown, unit, "" if name == "time_ms" else trace(values))
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


def trace(values: Sequence[int]) -> str:
    """Return a line of bars, lowest to highest of `values`; a level line when all are the same."""
    if not values:
        return ""
    low, span = min(values), max(values) - min(values)
    if span == 0:
        return _BARS[0] * len(values)
    return "".join(_BARS[(value - low) * (len(_BARS) - 1) // span] for value in values)


def plot(watched: Watched, path: Path) -> None:
    """Draw all samples over time, one panel per unit, to a .png, .svg or .pdf file."""
    groups = watched.by_unit()
    figure, axes = plots.new_figure(len(groups), 1, (8.0, 1.0 + 1.6 * len(groups)))
    t_s = np.array([raw["time_ms"] for raw in watched.samples]) / 1000
    for axis, (unit, signals) in zip(axes, groups.items(), strict=True):
        for signal in signals:
            values = [signal.value(raw[signal.name]) for raw in watched.samples]
            axis.plot(t_s, values, label=signal.name, linewidth=0.9)
        names = protocol.NAMES_OF.get(unit)
        if names is not None:
            axis.set_yticks(range(len(names)), names, fontsize="x-small")
        axis.set_ylabel(unit)
        axis.legend(fontsize="x-small", loc="upper right")
    axes[-1].set_xlabel("time of the robot / s")
    plots.save_figure(figure, path)
