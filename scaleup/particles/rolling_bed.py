"""What the bed of a cross-section does on the average: surface, layer, speed, rotation.

The surface is where the time-mean solid fraction passes half of the settled bed's, outermost; its
angle is that of a line through the central half of the chord. The profile is taken along the normal
of that line through the axis, over 2.5 diameters to each side; s runs down the slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid
from scipy.ndimage import map_coordinates

from scaleup.contract import FloatArray, Grid
from scaleup.particles.coarse_graining import Fields
from scaleup.system.errors import RunError

_HALF_BAND = 2.5  # diameters to each side of the line through the axis
_POINTS = 11
_REPEATS = 5
_BANDS = ((1.0, 0.95), (0.86, 0.64))  # outer and inner radius over the drum's: near the wall, deep
_SECTOR, _BELOW_LAYER = math.radians(25), 1.15


@dataclass(frozen=True)
class RollingBed:
    """Means over time, SI.

    angle         -- of the surface, rad
    depth         -- of the bed along the normal through the axis, m
    layer         -- where the streamwise velocity changes sign there, m below the surface
    surface_speed -- at mid-bed, m/s; speed_max the largest along the surface
    flux          -- of bulk volume down the mid-bed line, m^2/s
    rotation      -- of the bed over the wall's, near the wall (outer 5 %) and at 0.64 to 0.86 R
    solid_fraction -- of the bed at rest relative to the wall
    profile       -- depth (m), streamwise velocity (m/s), solid fraction: three lists
    """

    angle: float
    depth: float
    layer: float
    surface_speed: float
    speed_max: float
    flux: float
    rotation: tuple[float, float]
    solid_fraction: float
    profile: tuple[list[float], list[float], list[float]]


class _Means:
    """Time-mean solid fraction and velocity, read at points (n, 2)."""

    def __init__(self, grid: Grid, fields: Fields, frames: int):
        self._grid = grid
        scale = 1.0 / (grid.cell_volume * frames)
        self._fields = [scale * f for f in (fields.volume, *fields.momentum)]

    def at(self, points: FloatArray) -> FloatArray:
        """Solid fraction and its product with both velocities, (3, n): bilinear."""
        place = (points - np.array(self._grid.lower)) / np.array(self._grid.spacing) - 0.5
        return np.stack(
            [
                map_coordinates(f.reshape(self._grid.shape), place.T[::-1], order=1)
                for f in self._fields
            ]
        )


def rolling_bed(
    grid: Grid, fields: Fields, frames: int, radius: float, speed: float, diameter: float,
    settled: float,
) -> RollingBed:  # fmt: skip
    """Measures of the sum of fields over some frames, in a drum of a radius (m) about the origin.

    speed   -- of the drum, rad/s; settled -- solid fraction of the level bed
    Raises RunError if no surface, or no layer, is found.
    """
    means = _Means(grid, fields, frames)
    centre = grid.centre_points()
    mass = fields.volume
    x, y = (mass @ centre) / mass.sum()
    angle = math.atan2(x, -y)
    s = np.arange(-radius, radius, 0.5 * diameter)
    for _ in range(_REPEATS):
        height = _surface(means, angle, s, radius, 0.5 * settled)
        found = np.isfinite(height)
        if found.sum() < 8:
            raise RunError("the mean bed has no surface that could be measured")
        middle = 0.5 * (s[found].min() + s[found].max())
        quarter = 0.25 * (s[found].max() - s[found].min())
        central = found & (np.abs(s - middle) < quarter)
        # s runs down the slope: a surface that falls along s stands steeper than `angle`
        angle += math.atan(-float(np.polyfit(s[central], height[central], 1)[0]))
    height = _surface(means, angle, s, radius, 0.5 * settled)
    near = np.abs(s) < _HALF_BAND * diameter
    top = float(np.nanmean(height[near]))
    down, normal = _directions(angle)
    across = np.linspace(-1, 1, _POINTS) * _HALF_BAND * diameter
    levels = np.arange(top + diameter, -radius, -0.1 * diameter)
    points = levels[:, None, None] * normal + across[:, None] * down
    solid, *moving = (v.reshape(points.shape[:2]).mean(axis=1) for v in means.at(_flat(points)))
    streamwise = np.divide(
        moving[0] * down[0] + moving[1] * down[1], solid,
        out=np.zeros_like(solid), where=solid > 1e-3 * settled,
    )  # fmt: skip
    below = levels <= top
    depth, streamwise, solid = top - levels[below], streamwise[below], solid[below]
    turning = np.flatnonzero((streamwise[:-1] > 0) & (streamwise[1:] <= 0))
    if not len(turning):
        raise RunError("at mid-bed no powder flows down on what the wall carries up")
    n = turning[0]
    share = streamwise[n] / (streamwise[n] - streamwise[n + 1])
    layer = float(depth[n] + share * (depth[n + 1] - depth[n]))
    at_rest = float(solid[(depth > layer) & (depth < radius + top - diameter)].mean())
    flowing = depth <= layer
    flux = float(trapezoid((solid * streamwise)[flowing], depth[flowing])) / at_rest
    surface = np.stack([s, height], axis=1)[np.isfinite(height)]
    ends = 0.85 * surface[[0, -1], 0]
    surface = surface[(surface[:, 0] > ends[0]) & (surface[:, 0] < ends[1])]
    along = surface[:, :1] * down + surface[:, 1:] * normal
    there, *carried = means.at(along)
    speeds = (carried[0] * down[0] + carried[1] * down[1]) / there
    return RollingBed(
        angle=angle,
        depth=radius + top,
        layer=layer,
        surface_speed=float(streamwise[0]),
        speed_max=float(speeds.max()),
        flux=flux,
        rotation=_rotation(centre, fields, angle, top - _BELOW_LAYER * layer, radius, speed),
        solid_fraction=at_rest,
        profile=(depth.tolist(), streamwise.tolist(), solid.tolist()),
    )


def _directions(angle: float) -> tuple[FloatArray, FloatArray]:
    """Unit vectors down the slope and out of the bed."""
    down = -np.array([math.cos(angle), math.sin(angle)])
    return down, np.array([-math.sin(angle), math.cos(angle)])


def _flat(points: FloatArray) -> FloatArray:
    return points.reshape(-1, points.shape[-1])


def _surface(
    means: _Means, angle: float, s: FloatArray, radius: float, passed: float
) -> FloatArray:
    """Distance of the surface from the axis along the normal at every s, m; NaN without bed."""
    down, normal = _directions(angle)
    levels = np.linspace(radius, -radius, 801)
    points = levels[:, None, None] * normal + s[:, None] * down
    solid = means.at(_flat(points))[0].reshape(len(levels), len(s))
    above = solid >= passed
    first = above.argmax(axis=0)
    number = np.arange(len(s))
    before = np.maximum(first - 1, 0)
    low, high = solid[before, number], solid[first, number]
    share = np.divide(passed - low, high - low, out=np.zeros_like(low), where=high > low)
    height = levels[before] + share * (levels[first] - levels[before])
    return np.where(above.any(axis=0) & (first > 0), height, np.nan)


def _rotation(
    centre: FloatArray, fields: Fields, angle: float, top: float, radius: float, speed: float
) -> tuple[float, float]:
    """Mass-weighted angular speed over the wall's, near mid-bed below the layer, in two bands."""
    _, normal = _directions(angle)
    r = np.hypot(*centre.T)
    depth = centre @ normal
    sector = (depth < top) & (-depth > r * math.cos(_SECTOR))
    spin = centre[:, 0] * fields.momentum[1] - centre[:, 1] * fields.momentum[0]
    found = []
    for outer, inner in _BANDS:
        band = sector & (r < outer * radius) & (r > inner * radius)
        inertia = float((fields.volume * r**2)[band].sum())
        found.append(float(spin[band].sum()) / (inertia * speed) if inertia > 0 else math.nan)
    return found[0], found[1]
