"""Figures of a run (matplotlib, PNG), after those of Liu, Gonzalez & Wassgren 2018."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import map_coordinates

from scaleup.space.grid import FloatArray, Grid

_MM = 1e3


def snapshots(path: Path, grid: Grid, fields: Sequence[tuple[float, FloatArray]]) -> None:
    """Concentration of the first component of a cross-section, at some revolutions (Fig. 14)."""
    columns = min(3, len(fields))
    rows = math.ceil(len(fields) / columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.6 * columns, 2.9 * rows), squeeze=False, layout="constrained"
    )
    image: Any = None
    for axis, (revolution, values) in zip(axes.flat, fields, strict=False):
        image = _map(axis, grid, values, cmap="viridis", vmin=0, vmax=1)
        axis.set_title(f"{revolution:.2f} revolutions", fontsize=10)
    for axis in axes.flat[len(fields) :]:
        axis.axis("off")
    figure.colorbar(image, ax=axes, label="concentration of component 1", shrink=0.8)
    save(figure, path)


def speed_map(path: Path, grid: Grid, velocity: FloatArray) -> None:
    """Speed of the powder in a cross-section in the lab (the paper's Fig. 11).

    velocity -- m/s, (2, *grid.shape), NaN without bed
    """
    speed = np.linalg.norm(velocity, axis=0)
    figure, axis = plt.subplots(figsize=(6, 4.4), layout="constrained")
    top = float(np.nanpercentile(speed, 99.9))
    image = _map(axis, grid, speed, cmap="turbo", vmin=0, vmax=top)
    axis.set_title("speed in the lab frame", fontsize=10)
    figure.colorbar(image, ax=axis, label="speed, m/s")
    save(figure, path)


def stability(path: Path, name: str, boundaries: Sequence[Any]) -> None:
    """Stated limits against measured ones in the plane of Courant and cell diffusion number.

    boundaries -- of `stability_map.Boundary`
    """
    angles = sorted({b.angle for b in boundaries if b.courant > 0})
    rest = [b for b in boundaries if b.courant == 0]
    figure, axes = plt.subplots(
        1, len(angles), figsize=(3.3 * len(angles), 3.6), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    styles = {
        "stated": {"label": "stated limit", "color": "black", "marker": ""},
        "growth": {"label": "measured: noise grows beyond", "color": "C3", "marker": "o"},
        "bounds": {"label": "measured: [0, 1] broken beyond", "color": "C0", "marker": "s"},
    }
    for axis, angle in zip(axes.flat, angles, strict=True):
        here = [b for b in boundaries if b.angle == angle and b.courant > 0] + rest[:1]
        for which, style in styles.items():
            limits = [(b, getattr(b, which)) for b in here]
            points = [
                (limit * b.courant, limit * b.diffusion_number)
                for b, limit in limits
                if limit is not None and math.isfinite(limit)
            ]
            if points:
                axis.plot(*zip(*points, strict=True), markersize=3.5, **style)
        axis.set_title(f"flow at {angle:g} deg to the grid", fontsize=10)
        axis.set_xlabel("Courant number |v| dt/h")
        axis.set_xlim(left=0)
        axis.set_ylim(bottom=0)
    axes.flat[0].set_ylabel("cell diffusion number D dt/h$^2$")
    axes.flat[0].legend(fontsize=7)
    figure.suptitle(f"stability of {name}", fontsize=11)
    save(figure, path)


def velocity_profiles(path: Path, grid: Grid, velocity: FloatArray, angle: float) -> None:
    """Velocity along the free surface and along the mid-bed normal (the paper's Fig. 12).

    velocity -- m/s in the lab, (2, *grid.shape), NaN without bed; angle -- rad, of the surface
    """
    down = -np.array([math.cos(angle), math.sin(angle)])
    normal = np.array([-math.sin(angle), math.cos(angle)])
    reach = float(np.abs(np.array(grid.lower)).max())
    height = np.arange(reach, -reach, -0.25 * grid.spacing[0])
    centre = _interpolated(grid, velocity, height[:, None] * normal) @ down
    in_bed = np.isfinite(centre)
    surface = float(height[in_bed][0])

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    # at every s the outermost point of the bed within a band about the mean surface
    s = np.arange(-reach, reach, grid.spacing[0])
    best = np.full(len(s), np.nan)
    for offset in np.arange(-0.3, 0.15, 0.001) * reach:
        points = s[:, None] * down + (surface + offset) * normal
        speed = _interpolated(grid, velocity, points) @ down
        best = np.where(np.isfinite(speed), speed, best)
    left.plot(s * _MM, best)
    left.set(xlabel="distance down the surface from mid-bed, mm", ylabel="surface speed, m/s")
    right.plot(centre[in_bed], (surface - height[in_bed]) * _MM)
    right.axvline(0, color="0.7", lw=0.8)
    right.invert_yaxis()
    right.set(xlabel="streamwise velocity at mid-bed, m/s", ylabel="depth, mm")
    right.locator_params(axis="x", nbins=6)
    save(figure, path)


def blend_curve(
    path: Path,
    revolutions: Sequence[float],
    curves: Mapping[str, Sequence[float]],
    band: Sequence[float] | None,
) -> None:
    """Segregation intensity against revolutions (the paper's Fig. 16b).

    band -- error estimate of the first curve, or None
    """
    figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
    for number, (label, values) in enumerate(curves.items()):
        (line,) = axis.plot(revolutions, values, label=label)
        if number == 0 and band is not None:
            low, high = np.array(values) - band, np.array(values) + band
            axis.fill_between(
                revolutions, low, high, color=line.get_color(), alpha=0.25, lw=0,
                label="change on cells twice as large",
            )  # fmt: skip
    axis.set(xlabel="revolutions", ylabel="segregation intensity I")
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    axis.legend()
    save(figure, path)


def blend_curves(path: Path, runs: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
    """Blend curves of several runs: segregation intensity and relative standard deviation.

    runs -- (name, the section `mixing` of report.json)
    """
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for name, mixing in runs:
        axes[0].plot(mixing["revolutions"], mixing["segregation_intensity"], label=name)
        axes[1].plot(mixing["revolutions"], mixing["rsd"], label=name)
    axes[0].set(ylabel="segregation intensity I over nodes", ylim=(0, None))
    axes[1].set(ylabel="relative standard deviation of samples", yscale="log")
    for axis in axes:
        axis.set_xlabel("revolutions")
        axis.grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=9)
    save(figure, path)


def centre_profiles(path: Path, profiles: Mapping[str, Sequence[Sequence[float]]]) -> None:
    """Concentration along the bed's centre line (the paper's Fig. 15)."""
    figure, axis = plt.subplots(figsize=(6, 3.8), layout="constrained")
    colours = plt.get_cmap("plasma")(np.linspace(0, 0.85, len(profiles)))
    for colour, (revolution, (depth, values)) in zip(colours, profiles.items(), strict=True):
        if float(revolution) == 0:  # side by side, the line is the border between the components
            continue
        axis.plot(depth, values, color=colour, label=f"{float(revolution):.2f} rev")
    axis.set(
        xlabel="depth below the surface / bed depth",
        ylabel="concentration of component 1",
        ylim=(-0.1, 1.15),
    )
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save(figure, path)


def _interpolated(grid: Grid, values: FloatArray, points: FloatArray) -> FloatArray:
    """Components (m, cells) at points (n, 2), bilinear between cell centres: (n, m).

    NaN where one of the four cells around a point holds no material.
    """
    position = (points - np.array(grid.lower)) / np.array(grid.spacing) - 0.5
    return np.stack(
        [
            map_coordinates(v.reshape(grid.shape), position.T[::-1], order=1, cval=np.nan)
            for v in values
        ],
        axis=-1,
    )


def _map(axis: Axes, grid: Grid, values: FloatArray, **style: Any) -> Any:
    low, spacing = grid.lower, grid.spacing
    extent = (
        _MM * low[0],
        _MM * (low[0] + grid.counts[0] * spacing[0]),
        _MM * low[1],
        _MM * (low[1] + grid.counts[1] * spacing[1]),
    )
    image = axis.imshow(values, origin="lower", extent=extent, interpolation="nearest", **style)
    rows, columns = np.nonzero(np.isfinite(values))
    x, y = grid.centres(0)[columns] * _MM, grid.centres(1)[rows] * _MM
    axis.set(xlim=(x.min() - 2, x.max() + 2), ylim=(y.min() - 2, y.max() + 2))
    axis.set_aspect("equal")
    axis.set(xlabel="x, mm", ylabel="y, mm")
    return image


def save(figure: Figure, path: Path) -> None:
    """Write a figure to a PNG file and let it go."""
    figure.savefig(path, dpi=110, metadata={"Software": "scaleup"})
    plt.close(figure)
