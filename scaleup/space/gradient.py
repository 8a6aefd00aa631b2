"""Gradients of what is known on the active cells of a grid."""

from __future__ import annotations

import numpy as np

from scaleup.space.grid import FloatArray, Grid, IntArray


def slope(grid: Grid, cells: IntArray, values: FloatArray, axis: int) -> FloatArray:
    """d/d(axis) of values (n,) at `cells`: central differences, one-sided at the bed's edge.

    Zero where neither neighbour along the axis is one of the cells.
    """
    dense = np.full(grid.shape, np.nan)
    dense[np.unravel_index(cells, grid.shape)] = values
    along = grid.array_axis(axis)
    both = np.stack([np.roll(dense, -1, along) - dense, dense - np.roll(dense, 1, along)])
    known = np.isfinite(both).sum(axis=0)
    total = np.nansum(both, axis=0)
    mean = np.divide(total, known, out=np.zeros_like(total), where=known > 0)
    return np.asarray(mean.reshape(-1)[cells] / grid.spacing[axis])
