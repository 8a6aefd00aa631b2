"""Figures of a bed that turns with its vessel: at phases of a revolution, cut open, in motion.

All are in the lab's frame, gravity downward; the vessel's wall is drawn with the bed. Pictures in
3-D are orthographic, so that the scale bar holds everywhere in the picture's plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from scaleup.report.bed_view import Cut, Picture, Wall, colour_map, cut, see
from scaleup.report.figures import save

_MM = 1e3
_PIXELS = 420  # of a picture's edge
_WALL_LINE = {"colors": "0.25", "linewidths": 1.0}
_CONCENTRATION = "concentration of component 1"


def phases(path: Path, pictures: Sequence[Picture], wall: Wall) -> None:
    """The bed at phases of a revolution, side by side, all in one scale and one range."""
    columns = min(4, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(2.8 * columns + 0.8, 3.0 * rows), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for number, axis in enumerate(axes.flat):
        if number < len(pictures):
            _draw(axis, pictures[number], wall)
            axis.set_title(_when(pictures[number]), fontsize=11)
        else:
            axis.axis("off")
    _colour_bar(figure, axes)
    save(figure, path)


def beds(path: Path, shown: Sequence[tuple[str, Picture, Wall]]) -> None:
    """The beds of several runs side by side, each in a scale of its own.

    shown -- (name, picture, wall)
    """
    columns = min(4, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.2 * columns + 0.8, 3.4 * rows), squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axis, (name, picture, wall) in zip(axes.flat, shown, strict=False):
        _draw(axis, picture, wall)
        axis.set_title(f"{name}\n{_when(picture)}", fontsize=11)
    for axis in axes.flat[len(shown) :]:
        axis.axis("off")
    _colour_bar(figure, axes)
    save(figure, path)


def cuts(path: Path, pictures: Sequence[Picture], wall: Wall) -> None:
    """The bed cut across the axis and along it, at several times."""
    planes: tuple[Literal["z", "x"], ...] = (
        ("z", "x") if pictures[0].grid.dimension == 3 else ("z",)
    )
    count = len(pictures)
    heights = [wall.reach / (wall.reach if plane == "z" else wall.half_length) for plane in planes]
    figure, axes = plt.subplots(
        len(planes), count, figsize=(3.1 * count, 2.7 * sum(heights) + 1.2), squeeze=False,
        height_ratios=heights, layout="constrained",
    )  # fmt: skip
    for column, picture in enumerate(pictures):
        for axis, plane in zip(axes[:, column], planes, strict=True):
            _show_cut(axis, cut(picture, wall, plane, _PIXELS), plane, vmin=0, vmax=1)
            if column:
                axis.set_ylabel("")
        where = "\ncut across the axis, in the middle" if len(planes) == 2 else ""
        axes[0, column].set_title(_when(picture) + where, fontsize=11)
        if len(planes) == 2:
            axes[1, column].set_title("cut along the axis (x = 0)", fontsize=11)
    _colour_bar(figure, axes)
    save(figure, path)


def speed_cuts(path: Path, picture: Picture, speed: NDArray[Any], wall: Wall) -> None:
    """Speed relative to the vessel, m/s, cut across the axis and along it."""
    planes: tuple[Literal["z", "x"], ...] = ("z", "x") if picture.grid.dimension == 3 else ("z",)
    views = [cut(picture, wall, plane, _PIXELS, speed) for plane in planes]
    figure, axes = plt.subplots(
        1, len(planes), figsize=(4.6 * len(planes) + 0.9, 4.3), squeeze=False, layout="constrained"
    )
    top = float(np.nanpercentile(speed, 99.9))
    image: Any = None
    for axis, view, plane in zip(axes.flat, views, planes, strict=True):
        image = _show_cut(axis, view, plane, cmap="turbo", vmin=0, vmax=top)
    figure.suptitle(f"{_when(picture)}: speed relative to the vessel", fontsize=11)
    figure.colorbar(image, ax=axes, label="speed, m/s", shrink=0.85)
    save(figure, path)


def animation(
    path: Path,
    pictures: Sequence[Picture],
    wall: Wall,
    progress: Callable[[float, str], None] | None = None,
) -> None:
    """One revolution as an endless GIF, one picture a frame."""
    frames = []
    for number, picture in enumerate(pictures):
        figure, axis = plt.subplots(figsize=(5.2, 4.8), layout="constrained")
        _draw(axis, picture, wall)
        axis.set_title(_when(picture), fontsize=12, family="monospace")
        _colour_bar(figure, np.array([[axis]]))
        figure.set_dpi(90)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
        frames.append(Image.fromarray(pixels.copy()).quantize(256, Image.Quantize.MAXCOVERAGE))
        plt.close(figure)
        if progress is not None:
            progress((number + 1) / len(pictures), "frames")
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=100, loop=0, optimize=True
    )


def _draw(axis: Axes, picture: Picture, wall: Wall) -> None:
    if picture.grid.dimension == 2:
        _show_cut(axis, cut(picture, wall, "z", _PIXELS), "z", vmin=0, vmax=1)
        return
    half = _MM * wall.half_picture
    axis.imshow(see(picture, wall, _PIXELS), extent=(-half, half, -half, half))
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)
    bar = _round(0.5 * half)
    left, low = -0.97 * half, -0.97 * half
    axis.plot([left, left + bar], [low, low], color="0.2", lw=2.5, solid_capstyle="butt")
    axis.text(left, low + 0.03 * half, f"{bar:g} mm", fontsize=9, va="bottom", color="0.2")
    axis.annotate(
        "g", (0.92 * half, -0.97 * half), (0.92 * half, -0.72 * half), fontsize=9, color="0.2",
        ha="center", va="bottom", arrowprops={"arrowstyle": "-|>", "color": "0.2"},
    )  # fmt: skip


def _show_cut(axis: Axes, view: Cut, plane: Literal["x", "z"], **style: Any) -> Any:
    left, right, low, high = (_MM * edge for edge in view.extent)
    extent = (left, right, low, high)
    style.setdefault("cmap", colour_map())
    image = axis.imshow(
        view.values, origin="lower", extent=extent, interpolation="nearest", **style
    )
    axis.contour(view.gap, levels=[0.0], extent=extent, **_WALL_LINE)
    axis.set(xlabel="x, mm" if plane == "z" else "z, mm", ylabel="y, mm")
    axis.set_aspect("equal")
    return image


def _when(picture: Picture) -> str:
    turned = math.degrees(2 * math.pi * picture.revolution) % 360.0
    return f"{picture.revolution:.3f} rev, {turned if turned < 359.95 else 0:3.0f}°"


def _colour_bar(figure: Figure, axes: Any) -> None:
    colours = ScalarMappable(Normalize(0, 1), colour_map())
    figure.colorbar(colours, ax=axes, label=_CONCENTRATION, shrink=0.85)


def _round(length: float) -> float:
    """The greatest of 1, 2, 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= length)
