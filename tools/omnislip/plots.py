"""Figures: labels with units, colours that colour-blind readers can tell apart (Okabe and Ito)."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from omnislip.errors import InputError
from omnislip.files import replace_file

mpl.use("Agg")

Array = npt.NDArray[np.float64]

BLUE, ORANGE, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
WHEEL_COLOURS = (BLUE, ORANGE, GREEN, PINK)
WHEEL_STYLES = ("-", "--", "-.", ":")
# Width over length of the narrowest path that is drawn to scale.
TO_SCALE_FROM = 0.1
SUFFIXES = (".png", ".svg", ".pdf")


def new_figure(
    rows: int, columns: int, size_inch: tuple[float, float]
) -> tuple[Figure, list[Axes]]:
    """Return a figure of rows x columns axes with a light grid, and the axes row by row."""
    figure = Figure(figsize=size_inch, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for axis in axes:
        axis.grid(color="0.9", linewidth=0.6)
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes


def save_figure(figure: Figure, path: Path) -> None:
    """Write `figure` to a .png, .svg or .pdf file, whole or not at all."""
    check_figure_path(path)
    with replace_file(path) as temporary:
        figure.savefig(temporary, dpi=150)


def check_figure_path(path: Path) -> None:
    """Raise InputError unless `path` ends as a figure file does."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: a figure must end in one of {', '.join(SUFFIXES)}")


def draw_paths(axis: Axes, truth: dict[str, Array]) -> None:
    """Draw the path of the robot (n,3 world), the one its odometry believes, start and end.

    To scale, unless the path is so long and narrow that nothing of its width would be seen.
    """
    x_m, y_m, _ = truth["pose"].T
    axis.plot(x_m, y_m, color=BLUE, label="true path")
    axis.plot(*truth["odometry"][:, :2].T, color=ORANGE, linestyle="--", label="odometry")
    axis.plot(x_m[0], y_m[0], "o", color="0.3", markerfacecolor="white", label="start")
    axis.plot(x_m[-1], y_m[-1], "o", color="0.3", label="end")
    both = np.concatenate([truth["pose"], truth["odometry"]])[:, :2]
    narrow, wide = sorted(np.ptp(both, axis=0))
    axis.set(xlabel="x / m", ylabel="y / m")
    if narrow > TO_SCALE_FROM * wide:
        axis.set(aspect="equal", adjustable="datalim")
    else:
        axis.set_title("x and y to different scales", loc="right", fontsize="small", color="0.4")
    axis.margins(0.05, 0.25)
    axis.legend(frameon=False, ncols=2)


def draw_wheels(axis: Axes, t_s: Array, values: Array, label: str) -> None:
    """Draw one line per wheel of `values` (n,4) against time."""
    for wheel in range(4):
        axis.plot(
            t_s,
            values[:, wheel],
            color=WHEEL_COLOURS[wheel],
            linestyle=WHEEL_STYLES[wheel],
            linewidth=1.2,
            label=f"wheel {wheel + 1}",
        )
    axis.set(xlabel="time / s", ylabel=label)


def plot_run(truth: dict[str, Array], path: Path) -> None:
    """Write a figure of one run: path, wheel speeds, slip, drive forces (1 kHz arrays)."""
    figure, (path_axis, speed_axis, slip_axis, force_axis) = new_figure(2, 2, (11, 8))
    figure.get_layout_engine().set(w_pad=0.1, h_pad=0.1)
    draw_paths(path_axis, truth)
    t_s = truth["t_s"]
    draw_wheels(speed_axis, t_s, truth["wheel_speed_rad_s"], "shaft speed / (rad/s)")
    draw_wheels(slip_axis, t_s, truth["slip_m_s"], "slip speed / (m/s)")
    draw_wheels(force_axis, t_s, truth["drive_force_n"], "drive force / N")
    handles, labels = speed_axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=4, frameon=False)
    save_figure(figure, path)
