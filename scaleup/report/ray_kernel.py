"""Compiled kernel of `bed_view`: parallel rays through a bed and its vessel, pixel by pixel.

Along a ray, in steps of at most `step`:

0 the ray is cut to the box of the wall's lattice;
1 where the distance to the vessel's wall changes sign, the wall adds a veil that is denser where it
  is seen edge-on, so that its outline shows;
2 where the share of the cells that is filled rises above one half, the ray ends: that is the bed's
  surface. The place is interpolated, the value is the concentration half a cell below it;
3 outside the vessel the ray leaps by the distance to the wall.

All lattices are trilinear between their points; beyond them there is neither bed nor vessel.
Importing this module loads numba, so `bed_view` does it when first asked.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from scaleup.space.grid import FloatArray

_HALF = 0.5  # share of a cell's volume that the bed's surface is drawn at
_LEAP = 0.8  # share of the distance to the wall by which a ray leaps outside
_VEIL, _EDGE = 0.05, 0.6  # opacity of the wall seen square-on, and what edge-on adds


class Bed(NamedTuple):
    """A bed on its cells.

    share, content -- filled share of each cell, and that times the concentration, (nz, ny, nx)
    smooth         -- `share` smoothed, for the direction of the surface
    low, edge      -- m, first centre and edge of the cells, (x, y, z)
    """

    share: Any
    content: Any
    smooth: Any
    low: FloatArray
    edge: FloatArray


class Vessel(NamedTuple):
    """Distance to the wall (m, positive inside) on a lattice of its own: first point and edge."""

    wall: Any
    low: FloatArray
    edge: FloatArray


class Rays(NamedTuple):
    """Parallel rays, one for each pixel.

    corner         -- m, where the ray of the first pixel starts, bottom left
    right, up      -- m, steps from pixel to pixel
    forward, lamp  -- unit vectors: along the rays, and to the light
    counts         -- rows, columns; length -- m, of the rays; step -- m
    """

    corner: FloatArray
    right: FloatArray
    up: FloatArray
    forward: FloatArray
    lamp: FloatArray
    counts: tuple[int, int]
    length: float
    step: float


@njit(cache=True)
def cast(bed: Bed, vessel: Vessel, rays: Rays) -> Any:
    """What each pixel sees: concentration, light and veil, shape (3, rows, columns).

    The concentration is NaN where no bed is seen.
    """
    share, content, smooth, low, edge = bed
    wall, wall_low, wall_edge = vessel
    corner, right, up, forward, lamp, counts, length, step = rays
    rows, columns = counts
    seen = np.full((3, rows, columns), np.nan)
    normal, ray = np.empty(3), np.empty(3)
    wall_high = wall_low + wall_edge * (np.array(wall.shape)[::-1] - 1.0)
    for row in range(rows):
        for column in range(columns):
            ray[:] = corner + column * right + row * up
            along, end = _within(ray, forward, wall_low, wall_high, length)
            clear, stride, filled_before, gap_before = 1.0, step, 0.0, -1.0
            while along < end:
                x = ray[0] + along * forward[0]
                y = ray[1] + along * forward[1]
                z = ray[2] + along * forward[2]
                gap = _at(wall, wall_low, wall_edge, x, y, z, -wall_edge[0])
                if (gap > 0.0) != (gap_before > 0.0):
                    _slope(wall, wall_low, wall_edge, x, y, z, normal)
                    square = abs(
                        normal[0] * forward[0] + normal[1] * forward[1] + normal[2] * forward[2]
                    )
                    clear *= 1.0 - _VEIL - _EDGE * (1.0 - square) ** 3
                filled = _at(share, low, edge, x, y, z, 0.0)
                if filled >= _HALF and filled_before < _HALF:
                    back = stride * (filled - _HALF) / (filled - filled_before)
                    x -= back * forward[0]
                    y -= back * forward[1]
                    z -= back * forward[2]
                    _slope(smooth, low, edge, x, y, z, normal)
                    bright = normal[0] * lamp[0] + normal[1] * lamp[1] + normal[2] * lamp[2]
                    inner = 0.5 * edge[0]
                    x += inner * normal[0]
                    y += inner * normal[1]
                    z += inner * normal[2]
                    held = max(_at(share, low, edge, x, y, z, 0.0), 1e-9)
                    seen[0, row, column] = _at(content, low, edge, x, y, z, 0.0) / held
                    seen[1, row, column] = max(0.0, -bright)
                    break
                filled_before, gap_before = filled, gap
                stride = max(step, -_LEAP * gap) if gap < 0.0 and filled <= 0.0 else step
                along += stride
            seen[2, row, column] = 1.0 - clear
    return seen


@njit(cache=True)
def _within(
    start: FloatArray, forward: FloatArray, low: FloatArray, high: FloatArray, length: float
) -> tuple[float, float]:
    """From where to where along a ray, m, it is in a box; the first is the greater one if never."""
    first, last = 0.0, length
    for axis in range(3):
        if abs(forward[axis]) < 1e-12:
            if not low[axis] <= start[axis] <= high[axis]:
                return 1.0, 0.0
            continue
        a = (low[axis] - start[axis]) / forward[axis]
        b = (high[axis] - start[axis]) / forward[axis]
        first, last = max(first, min(a, b)), min(last, max(a, b))
    return first, last


@njit(cache=True)
def _at(
    values: Any, low: FloatArray, edge: FloatArray, x: float, y: float, z: float, beyond: float
) -> float:
    """Trilinear value of a lattice (nz, ny, nx) at a point; `beyond` outside of it."""
    nz, ny, nx = values.shape
    a, b, c = (x - low[0]) / edge[0], (y - low[1]) / edge[1], (z - low[2]) / edge[2]
    if a < 0.0 or b < 0.0 or c < 0.0 or a >= nx - 1 or b >= ny - 1 or c >= nz - 1:
        return beyond
    i, j, k = int(a), int(b), int(c)
    a, b, c = a - i, b - j, c - k
    near = (1 - b) * ((1 - a) * values[k, j, i] + a * values[k, j, i + 1]) + b * (
        (1 - a) * values[k, j + 1, i] + a * values[k, j + 1, i + 1]
    )
    k += 1
    far = (1 - b) * ((1 - a) * values[k, j, i] + a * values[k, j, i + 1]) + b * (
        (1 - a) * values[k, j + 1, i] + a * values[k, j + 1, i + 1]
    )
    return (1 - c) * near + c * far


@njit(cache=True)
def _slope(
    values: Any, low: FloatArray, edge: FloatArray, x: float, y: float, z: float, out: FloatArray
) -> None:
    """Unit vector along the gradient of a lattice at a point, over a cell to each side."""
    h = edge[0]
    out[0] = _at(values, low, edge, x + h, y, z, 0.0) - _at(values, low, edge, x - h, y, z, 0.0)
    out[1] = _at(values, low, edge, x, y + h, z, 0.0) - _at(values, low, edge, x, y - h, z, 0.0)
    out[2] = _at(values, low, edge, x, y, z + h, 0.0) - _at(values, low, edge, x, y, z - h, 0.0)
    size = math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    if size > 0.0:
        out /= size
