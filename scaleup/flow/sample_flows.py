"""Small flows with known numbers, to try a mixing backend on."""

from __future__ import annotations

import math

import numpy as np

from scaleup.space.flow_field import Axis, FlowField, Interval, interval_from_dense
from scaleup.space.grid import FloatArray, Grid

_EDGE = 0.01  # m, of a cell
_COLUMNS, _ROWS, _LAYERS = 16, 8, 6  # cells of the bed along x, y, z
_STEP = 0.125  # s, an interval; a power of two, so that times join exactly
_RATE = 2.0  # 1/s, shear rate


def circulating_box(dimension: int) -> FlowField:
    """A full box in the lab frame that circulates steadily: psi ~ sin(pi x) sin(pi y), 1 turn/s."""
    grid = _grid(dimension)
    corners = [np.sin(math.pi * np.arange(n + 1) / n) for n in (_ROWS, _COLUMNS)]
    psi = np.zeros((_ROWS + 3, _COLUMNS + 3))
    psi[1:-1, 1:-1] = np.outer(*corners) * _ROWS * _COLUMNS * _EDGE**2 / math.pi
    psi[[1, -2], :] = psi[:, [1, -2]] = 0.0
    fill = np.zeros((_ROWS + 2, _COLUMNS + 2))
    fill[1:-1, 1:-1] = grid.cell_volume
    depth = _EDGE if dimension == 3 else grid.depth
    faces = [np.diff(psi, axis=0) * depth, -np.diff(psi, axis=1) * depth]
    part = _interval(grid, 0.0, fill, fill, faces)
    return FlowField(grid, "lab", Axis(), 1.0, [part])


def rocking_box(dimension: int, intervals: int = 8) -> FlowField:
    """A box in the vessel frame whose half-filled top row rocks from side to side, periodically.

    Column i passes Q_i cos(2 pi k / K) to column i + 1 in interval k, evenly over the full rows;
    the fluxes upwards follow from continuity, and over a period all sum to zero.
    """
    grid = _grid(dimension)
    full, cell = _ROWS - 1, grid.cell_volume
    fill = np.zeros((_ROWS + 2, _COLUMNS + 2))
    fill[1 : full + 1, 1:-1] = cell
    fill[full + 1, 1:-1] = 0.5 * cell
    at_rest, parts = fill, []
    transfer = 0.15 * cell / _STEP * np.sin(math.pi * np.arange(_COLUMNS + 1) / _COLUMNS)
    transfer[[0, -1]] = 0.0
    for k in range(intervals):
        now = transfer * math.cos(2 * math.pi * k / intervals)
        across = np.zeros((_ROWS + 2, _COLUMNS + 3))
        across[1 : full + 1, 1:-1] = now / full
        upward = np.zeros((_ROWS + 3, _COLUMNS + 2))
        for row in range(1, full + 1):
            upward[row + 1, 1:-1] = -np.diff(now) * row / full
        after = fill.copy()
        after[full + 1, 1:-1] -= _STEP * np.diff(now)
        after = at_rest if k == intervals - 1 else after
        parts.append(_interval(grid, k * _STEP, fill, after, [across, upward]))
        fill = after
    return FlowField(grid, "vessel", Axis(), 1.0, parts)


def _grid(dimension: int) -> Grid:
    """The bed's cells with a margin of one on all sides."""
    counts = (_COLUMNS + 2, _ROWS + 2, _LAYERS + 2)[:dimension]
    depth = 0.02 if dimension == 2 else 1.0
    return Grid((0.0,) * dimension, (_EDGE,) * dimension, counts, depth)


def _interval(
    grid: Grid, start: float, before: FloatArray, after: FloatArray, faces: list[FloatArray]
) -> Interval:
    """An interval from plane arrays, repeated along z in 3-D."""
    if grid.dimension == 3:
        before, after, *faces = (
            np.pad(np.repeat(plane[None], _LAYERS, axis=0), ((1, 1), (0, 0), (0, 0)))
            for plane in (before, after, *faces)
        )
        faces.append(np.zeros((grid.shape[0] + 1, *grid.shape[1:])))
    wet = before + after > 0
    direction = np.zeros((grid.dimension, *grid.shape))
    direction[0][wet] = 1.0
    shear_rate = np.where(wet, _RATE, 0.0)
    return interval_from_dense(
        start, start + _STEP, grid, before, after, faces, shear_rate, direction
    )
