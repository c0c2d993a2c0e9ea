"""A short film of two runs with the same push, side by side, in slow motion (animated GIF).

The camera goes along x with each robot. Above: robot, its wheels redder the more they slip, the
path behind it and the push; below: what the push does to y. Frames are drawn over a background that
is drawn once, which makes a film of a hundred frames in a second or two.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrow, Polygon
from PIL import Image

from omnislip import plots
from omnislip.files import replace_file
from omnislip.model_file import Model

Array = npt.NDArray[np.float64]

FRAMES_PER_S = 20
SLOWER = 3  # than reality
BEFORE_PUSH_S, AFTER_PUSH_S = 0.4, 1.2
PUSH_SHOWN_S = 0.25
VIEW_M = (0.42, 0.33)  # half width and height of what the camera sees
FLOOR_LINE_EVERY_M = 0.2
FULL_COLOUR_SLIP_M_S = 0.3
SIZE_INCH, DPI = (8.0, 5.2), 90
COLOURS = 64
WHEEL_HALF_LENGTH_M, WHEEL_HALF_WIDTH_M = 0.05, 0.018
PUSH_LENGTH_M = 0.11


@dataclass(frozen=True)
class Take:
    """One run in the film: 1 kHz arrays of omnislip._core.simulate, its title and colour."""

    title: str
    colour: str
    truth: dict[str, Array]


class _Scene:
    """The camera picture of one run."""

    def __init__(self, axis: Axes, take: Take, model: Model, push_tick: int) -> None:
        self._take, self._push_tick = take, push_tick
        self._bearings_rad = np.radians(model.values["robot.wheel_angles_deg"])
        self._radius_m = model.values["robot.wheel_distance_m"]
        axis.set(xlim=(-VIEW_M[0], VIEW_M[0]), ylim=(-VIEW_M[1], VIEW_M[1]), aspect="equal")
        axis.set(xticks=[], yticks=[])
        axis.set_title(take.title, color=take.colour)
        axis.grid(visible=False)
        axis.axhline(0.0, color="0.75", linestyle="--", linewidth=1)
        (self._floor,) = axis.plot([], [], color="0.88", linewidth=1)
        (self._path,) = axis.plot([], [], color=take.colour, linewidth=2)
        self._body = axis.add_patch(Circle((0, 0), self._radius_m, color="0.93", ec="0.4"))
        self._nose = axis.add_patch(Polygon(np.zeros((3, 2)), color=take.colour))
        self._wheels = [axis.add_patch(Polygon(np.zeros((4, 2)), ec="0.2")) for _ in range(4)]
        arrow = {"width": 0.02, "length_includes_head": True, "color": plots.PINK}
        self._push = axis.add_patch(FancyArrow(0, 0, 0, PUSH_LENGTH_M, **arrow))
        self._text = axis.text(0.02, 0.93, "", transform=axis.transAxes, color="0.3")

    def artists(self) -> list[Artist]:
        """Return what changes from frame to frame, from back to front."""
        back = [self._floor, self._body, *self._wheels, self._path, self._nose]
        return [*back, self._push, self._text]

    def show(self, tick: int) -> None:
        """Put everything where it is at `tick`."""
        x_m, y_m, theta_rad = self._take.truth["pose"][tick]
        # One line with gaps: the floor's lines across the way.
        first = np.ceil((x_m - VIEW_M[0]) / FLOOR_LINE_EVERY_M) * FLOOR_LINE_EVERY_M
        across = np.repeat(np.arange(first, x_m + VIEW_M[0], FLOOR_LINE_EVERY_M) - x_m, 3)
        self._floor.set_data(across, np.tile([-VIEW_M[1], VIEW_M[1], np.nan], len(across) // 3))
        behind = self._take.truth["pose"][: tick + 1 : 5, :2]
        self._path.set_data(behind[:, 0] - x_m, behind[:, 1])
        self._body.center = (0.0, y_m)
        self._nose.set_xy(_placed([(0.1, 0.0), (0.05, 0.03), (0.05, -0.03)], theta_rad, y_m))
        for wheel, patch in enumerate(self._wheels):
            patch.set_xy(_placed(self._wheel_corners(wheel), theta_rad, y_m))
            slip = abs(self._take.truth["slip_m_s"][tick, wheel]) / FULL_COLOUR_SLIP_M_S
            share = min(slip, 1.0)
            patch.set_facecolor((0.35 + 0.6 * share, 0.35 * (1 - share), 0.35 * (1 - share)))
        since_s = (tick - self._push_tick) / 1000
        self._push.set_visible(0 <= since_s < PUSH_SHOWN_S)
        self._push.set_data(x=0.0, y=y_m - self._radius_m - PUSH_LENGTH_M)
        self._text.set_text(f"x = {x_m:.2f} m   y = {1000 * y_m:+.0f} mm")

    def _wheel_corners(self, wheel: int) -> list[tuple[float, float]]:
        bearing = self._bearings_rad[wheel]
        outward = np.array([np.cos(bearing), np.sin(bearing)])
        along = np.array([-outward[1], outward[0]])
        signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
        centre = self._radius_m * outward
        return [
            tuple(centre + a * WHEEL_HALF_LENGTH_M * along + o * WHEEL_HALF_WIDTH_M * outward)
            for a, o in signs
        ]


def _placed(corners: list[tuple[float, float]], theta_rad: float, y_m: float) -> Array:
    cos, sin = np.cos(theta_rad), np.sin(theta_rad)
    return np.array(corners) @ [[cos, sin], [-sin, cos]] + [0.0, y_m]


def write_film(
    takes: tuple[Take, Take], model: Model, push_x_m: float, title: str, path: Path
) -> None:
    """Write the film of two runs whose robots are pushed where they pass `push_x_m`."""
    figure = Figure(figsize=SIZE_INCH, dpi=DPI, layout="constrained")
    figure.suptitle(title, fontsize="medium")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic([["left", "right"], ["y", "y"]], height_ratios=[3, 1.4])
    pushes = [int(np.argmax(take.truth["pose"][:, 0] >= push_x_m)) for take in takes]
    scenes = [
        _Scene(axes[name], take, model, push)
        for name, take, push in zip(("left", "right"), takes, pushes, strict=True)
    ]
    dots = _draw_y(axes["y"], takes, pushes)
    moving = [
        (axes[n], a) for n, s in zip(("left", "right"), scenes, strict=True) for a in s.artists()
    ]
    moving += [(axes["y"], dot) for dot in dots]
    for _, artist in moving:
        artist.set_animated(True)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    ticks = np.arange(-BEFORE_PUSH_S, AFTER_PUSH_S, 1 / (FRAMES_PER_S * SLOWER)) * 1000
    frames = []
    for since in ticks.round().astype(int):
        canvas.restore_region(background)
        for scene, dot, take, push in zip(scenes, dots, takes, pushes, strict=True):
            scene.show(push + since)
            dot.set_data([since / 1000], [1000 * take.truth["pose"][push + since, 1]])
        for axis, artist in moving:
            axis.draw_artist(artist)
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
    _write_gif(frames, path)


def _draw_y(axis: Axes, takes: tuple[Take, Take], pushes: list[int]) -> list[Artist]:
    since_s = np.arange(-round(1000 * BEFORE_PUSH_S), round(1000 * AFTER_PUSH_S)) / 1000
    dots = []
    for take, push in zip(takes, pushes, strict=True):
        y_m = take.truth["pose"][push + np.round(1000 * since_s).astype(int), 1]
        axis.plot(since_s, 1000 * y_m, color=take.colour, linewidth=1.5)
        dots += axis.plot([], [], "o", color=take.colour, markersize=8)
    axis.axvline(0.0, color=plots.PINK, linestyle=":")
    axis.grid(color="0.9", linewidth=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set(xlabel=f"time since the push / s (shown {SLOWER} times slower)", ylabel="y / mm")
    return dots


def _write_gif(frames: list[Image.Image], path: Path) -> None:
    """One palette for all frames: what does not move is the same in each, and costs nothing."""
    middle = frames[round(BEFORE_PUSH_S * FRAMES_PER_S * SLOWER) + 1]
    palette = middle.quantize(COLOURS)
    mapped = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    with replace_file(path) as temporary:
        mapped[0].save(
            temporary,
            save_all=True,
            append_images=mapped[1:],
            duration=round(1000 / FRAMES_PER_S),
            loop=0,
        )
