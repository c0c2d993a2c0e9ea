"""Pictures of the gap report, each an SVG in a data address that an <img> shows without a file.

Colours are those of Okabe and Ito, told apart by colour-blind readers too; where colour carries a
verdict, shape or text carries it as well. Pictures are about 4.6 inch wide, so that their letters
stay readable on a telephone; the page sets several side by side where there is room. They are drawn
inside `matplotlib.rc_context(STYLE)`.
"""

import base64
import io
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Polygon

from omnislip.gap.judge import Trial
from omnislip.gap.machine import KEY_REACH
from omnislip.gap.metrics import GapTable, Replays
from omnislip.gap.unknown import Unknown
from omnislip.gap.where import Map, Place
from omnislip.plots import BLUE, ORANGE, new_figure

Array = npt.NDArray[np.float64]

GREY, DARK = "#8a8f98", "#22262b"
BELIEVED, REFIT, AFTER, FLOOR = GREY, ORANGE, BLUE, "#d9dce1"
COLOURS = (BELIEVED, REFIT, AFTER)
LINES = ("-", "-", "--")
HEAT = LinearSegmentedColormap.from_list("heat", ["#f4f5f7", "#f6c38b", "#d55e00", "#7a2f00"])
WIDTH_INCH = 4.6
STRIP_S = 0.1
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "omnislip",
    "text.parse_math": False,  # a run may be called a$b$c
    "font.size": 9,
    "axes.edgecolor": "#b4b8bf",
    "axes.labelcolor": DARK,
    "text.color": DARK,
    "xtick.color": "#4a4f57",
    "ytick.color": "#4a4f57",
}


def gap_picture(table: GapTable, names: Sequence[str], models: Sequence[str]) -> str:
    """Draw the error of each channel in multiples of its noise floor, one mark per model.

    `names` are the words for the channels, `models` those for believed, refit and, where an effect
    was added, after.
    """
    marks = (("o", BELIEVED, "none"), ("s", REFIT, REFIT), ("o", AFTER, AFTER))[: len(models)]
    ratio = table.rmse[: len(models)] / table.floor
    figure, (axis,) = _figure(1, 0.9 + 0.27 * len(names))
    rows = np.arange(len(names))
    axis.hlines(rows, ratio.min(axis=0), ratio.max(axis=0), color="#c9cdd3", linewidth=2, zorder=1)
    for values, model, (marker, edge, face) in zip(ratio, models, marks, strict=True):
        axis.plot(values, rows, marker, markeredgecolor=edge, markerfacecolor=face, label=model)
    axis.axvline(1.0, color=DARK, linewidth=1, linestyle="--", label="noise floor")
    axis.set_xscale("log")
    axis.set_xlim(min(0.8, 0.85 * ratio.min()), max(2.2, 1.2 * ratio.max()))
    _plain_log_ticks(axis)
    axis.set_yticks(rows, names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlabel("error of a one-second replay / noise floor")
    figure.legend(
        loc="outside upper center",
        ncols=4,
        frameon=False,
        handletextpad=0.2,
        columnspacing=1.0,
        fontsize=8,
    )
    return _address(figure)


def share_picture(names: Sequence[str], shares: Array) -> str:
    """Draw the share of the gap that each equation holds."""
    figure, (axis,) = _figure(1, 0.6 + 0.26 * len(names))
    rows = np.arange(len(names))
    axis.barh(rows, 100 * shares, color=[HEAT(0.15 + 0.6 * s / shares.max()) for s in shares])
    for row, share in zip(rows, shares, strict=True):
        axis.text(100 * share + 1, row, f"{100 * share:.0f} %", va="center", fontsize=8)
    axis.set_yticks(rows, names)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_xlim(0, 100 * shares.max() * 1.18 + 1)
    axis.locator_params(axis="x", nbins=5, steps=[1, 2, 5, 10])
    axis.set_xlabel("share of the gap / %")
    axis.grid(visible=False, axis="y")
    return _address(figure)


def robot_picture(angles_deg: Sequence[float], shares: Array) -> str:
    """Draw the robot from above; `shares` are those of four torques, force x, force y, moment."""
    half = max(1.0, 1.4 * float(np.max(np.abs(np.sin(np.deg2rad(angles_deg)))))) + 0.2
    figure, (axis,) = _figure(1, WIDTH_INCH * half / 1.75)
    axis.set(aspect="equal", xlim=(-1.75, 1.75), ylim=(-half, half))
    axis.axis("off")
    axis.add_patch(Circle((0, 0), 0.86, facecolor="white", edgecolor="#b4b8bf", linewidth=1.2))
    top = max(float(shares.max()), 1e-12)
    for wheel, (angle_deg, share) in enumerate(zip(angles_deg, shares[:4], strict=True), 1):
        _draw_wheel(axis, np.deg2rad(angle_deg), HEAT(share / top))
        at = 1.4 * np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
        axis.text(*at, f"wheel {wheel}\n{100 * share:.0f} %", ha="center", va="center")
    ends = ((0.58, 0.0), (0.0, 0.58))
    for name, end, share in zip("xy", ends, shares[4:6], strict=True):
        _draw_arrow(axis, (0.0, 0.0), end, HEAT(0.2 + 0.8 * share / top), 0.0)
        offset = (0.02, -0.17) if name == "x" else (0.28, 0.0)
        axis.text(
            end[0] + offset[0],
            end[1] + offset[1],
            f"{name}: {100 * share:.0f} %",
            ha="center",
            va="center",
            fontsize=8,
        )
    _draw_arrow(axis, (-0.12, -0.36), (-0.36, 0.12), HEAT(0.2 + 0.8 * shares[6] / top), -0.5)
    axis.text(-0.18, -0.58, f"turning: {100 * shares[6]:.0f} %", ha="center", fontsize=8)
    return _address(figure)


def time_picture(names: Sequence[str], gap_map: Map, places: Sequence[Place]) -> str:
    """Draw the excess over time, one strip per run; the windows of `places` are framed.

    `names` are those of the runs of `gap_map`; pieces of one run share a strip.
    """
    runs = sorted(set(names))
    figure, (axis,) = _figure(1, 0.65 + 0.27 * len(runs))
    strips = [_strip(t_s, excess) for t_s, excess in zip(gap_map.t_s, gap_map.excess, strict=True)]
    top = max(float(np.percentile(np.concatenate([s for _, s in strips]), 99)), 1e-12)
    for name, (edges, sums) in zip(names, strips, strict=True):
        row = runs.index(name)
        axis.pcolormesh(
            edges,
            [row - 0.38, row + 0.38],
            sums[None] / top,
            cmap=HEAT,
            vmin=0,
            vmax=1,
            rasterized=True,
        )
    for name, begin, end in {w for place in places[:1] for w in place.windows_s}:
        row = runs.index(name)
        axis.plot(
            [begin, end, end, begin, begin],
            [row - 0.45, row - 0.45, row + 0.45, row + 0.45, row - 0.45],
            color=DARK,
            linewidth=1.2,
        )
    axis.set_yticks(range(len(runs)), runs)
    axis.set_ylim(len(runs) - 0.45, -0.55)
    axis.set_xlabel("time / s")
    axis.grid(visible=False)
    return _address(figure)


def replay_picture(
    replays: Replays, channel: int, unit: str, cumulative: bool, models: Sequence[tuple[int, str]]
) -> str:
    """Draw measured and simulated signals of one channel, below them the errors.

    `models` are the number and the name of those to draw. Of a `cumulative` channel only the errors
    are drawn: its signal dwarfs every difference.
    """
    rows = replays.counted & ~np.isnan(replays.errors[0][:, channel])
    t_s = replays.run.t_s[rows]
    errors = replays.errors[:, rows, channel]
    figure, axes = _figure(1 if cumulative else 2, 1.9 if cumulative else 3.1)
    if not cumulative:
        measured = (replays.run.outputs[:, channel] * replays.run.scale[channel])[rows]
        axes[0].plot(t_s, measured, color=DARK, linewidth=2.2, label="measured")
        for number, name in models:
            colour, style = COLOURS[number], LINES[number]
            axes[0].plot(
                t_s, measured - errors[number], style, color=colour, linewidth=1, label=name
            )
        axes[0].set_ylabel(unit)
        axes[0].sharex(axes[1])
        axes[0].tick_params(labelbottom=False)
        _legend_above(axes[0])
    floor = np.sqrt(replays.floor_variance[rows, channel])
    below = axes[-1]
    below.fill_between(t_s, -2 * floor, 2 * floor, color=FLOOR, linewidth=0, label="noise (±2 sd)")
    for number, name in models:
        below.plot(t_s, errors[number], color=COLOURS[number], linewidth=0.9, label=name)
    largest = max(*(np.max(np.abs(errors[m])) for m, _ in models), 2 * np.median(floor))
    below.set(xlabel="time / s", ylabel=f"error / {_divisor(unit)}")
    below.set_ylim(-1.1 * largest, 1.1 * largest)
    _legend_above(below)
    return _address(figure)


def curve_picture(unknown: Unknown) -> str:
    """Draw the curve of a missing force with two standard deviations, and the proposed formula."""
    figure, (axis,) = _figure(1, 2.6)
    axis.axhline(0.0, color="#c9cdd3", linewidth=1)
    low, high = unknown.y - 2 * unknown.deviation, unknown.y + 2 * unknown.deviation
    axis.fill_between(unknown.x, low, high, color=FLOOR, label="two standard deviations")
    axis.plot(unknown.x, unknown.y, "o-", color=BLUE, markersize=4, label="from the logs")
    axis.plot(unknown.x, unknown.formula_y, "--", color=ORANGE, label="formula (hypothesis)")
    axis.set(xlabel=unknown.x_label, ylabel=unknown.y_label)
    _legend_above(axis)
    return _address(figure)


def ranking_picture(trials: Sequence[Trial]) -> str:
    """Draw the gain of the candidates of one step, and inside it what remains over inflation."""
    figure, (axis,) = _figure(1, 0.85 + 0.25 * len(trials))
    gain = np.array([max(trial.evidence.gain, 1.0) for trial in trials])
    evidence = np.maximum(gain / [trial.evidence.inflation for trial in trials], 1.0)
    rows = np.arange(len(trials))
    axis.barh(rows, gain, color="#d5d9de", height=0.74, label="gain")
    axis.barh(rows, evidence, color=GREY, height=0.36, label="gain / inflation")
    for row, trial in enumerate(trials):
        if trial.accepted:
            axis.barh(row, gain[row], color="#9fc9e3", height=0.74)
            axis.barh(row, evidence[row], color=AFTER, height=0.36, label="the same, taken")
    axis.set_xscale("log")
    axis.set_xlim(1, 1.5 * max(gain.max(), 10.0))
    _plain_log_ticks(axis)
    axis.set_yticks(rows, [trial.candidate.name for trial in trials])
    axis.set_ylim(len(trials) - 0.5, -0.5)
    axis.grid(visible=False, axis="y")
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=8)
    return _address(figure)


def keys_picture(keys: Sequence[str], deviations: Sequence[float], at_bound: Sequence[bool]) -> str:
    """Draw how far each believed key moved, in standard deviations, with the bounds."""
    figure, (axis,) = _figure(1, 0.7 + 0.25 * len(keys))
    rows = np.arange(len(keys))
    colours = [ORANGE if hit else BLUE for hit in at_bound]
    axis.axvspan(-1, 1, color="#eef0f3", linewidth=0)
    axis.vlines(
        [-KEY_REACH, KEY_REACH], -0.5, len(keys) - 0.5, color=DARK, linewidth=1, linestyle="--"
    )
    axis.hlines(rows, 0, deviations, color=colours, linewidth=2)
    axis.scatter(deviations, rows, c=colours, s=26, zorder=3, marker="o")
    axis.set_yticks(rows, keys)
    axis.set_ylim(len(keys) - 0.5, -0.5)
    axis.set_xlim(-1.15 * KEY_REACH, 1.15 * KEY_REACH)
    axis.set_xlabel("moved by / standard deviations")
    return _address(figure)


def _figure(rows: int, height_inch: float) -> tuple[Figure, list[Axes]]:
    figure, axes = new_figure(rows, 1, (WIDTH_INCH, height_inch))
    for axis in axes:
        axis.set_axisbelow(True)
    return figure, axes


def _address(figure: Figure) -> str:
    text = io.BytesIO()
    figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True, dpi=150)
    return "data:image/svg+xml;base64," + base64.b64encode(text.getvalue()).decode()


def _legend_above(axis: Axes) -> None:
    axis.legend(
        frameon=False,
        fontsize=7,
        ncols=3,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.98),
        borderaxespad=0,
    )


def _divisor(unit: str) -> str:
    return f"({unit})" if "/" in unit else unit


def _plain_log_ticks(axis: Axes) -> None:
    low, high = axis.get_xlim()
    ticks = [m * 10.0**e for e in range(-3, 10) for m in (1, 2, 5)]
    ticks = [tick for tick in ticks if low <= tick <= high]
    if len(ticks) > 6:
        ticks = [tick for tick in ticks if f"{tick:e}"[0] == "1"]
    axis.set_xticks(ticks, [f"{tick:,.12g}".replace(",", " ") for tick in ticks])
    axis.set_xticks([], minor=True)


def _strip(t_s: Array, excess: Array) -> tuple[Array, Array]:
    """Excess over all equations in bins of STRIP_S: edges (n + 1,), sums (n,) not below 0."""
    bins = max(1, round(float(t_s[-1] - t_s[0]) / STRIP_S))
    edges = np.linspace(t_s[0], t_s[-1], bins + 1)
    sums, _ = np.histogram(t_s, edges, weights=excess.sum(axis=1))
    return edges, np.maximum(sums, 0.0)


def _draw_wheel(axis: Axes, angle_rad: float, colour: tuple[float, ...]) -> None:
    """A wheel stands at its angle on the rim and drives along the tangent."""
    radial = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    tangent = np.array([-radial[1], radial[0]])
    corners = [
        0.97 * radial + a * 0.1 * radial + b * 0.27 * tangent
        for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]
    axis.add_patch(Polygon(corners, facecolor=colour, edgecolor=DARK, linewidth=1))


def _draw_arrow(
    axis: Axes,
    begin: tuple[float, float],
    end: tuple[float, float],
    colour: tuple[float, ...],
    bend: float,
) -> None:
    axis.add_patch(
        FancyArrowPatch(
            begin,
            end,
            connectionstyle=f"arc3,rad={bend}",
            arrowstyle="-|>",
            mutation_scale=15,
            linewidth=3,
            color=colour,
            shrinkA=0,
            shrinkB=0,
        )
    )
