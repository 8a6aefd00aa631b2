"""Carry values outwards from the cells that have them."""

from __future__ import annotations

import numpy as np

from scaleup.grid import BoolArray, FloatArray, Grid, IntArray


def spread_outwards(
    grid: Grid, known: IntArray, values: FloatArray, wanted: IntArray
) -> FloatArray:
    """Values (m, k) of the `known` cells carried layer by layer to the `wanted` ones: (m, n).

    Each new cell takes the mean of the cells with a value among those that touch it (8 in 2-D, 26
    in 3-D). Wanted cells are filled first; cells between them and the known ones only if there is
    no other way. Zero if nothing is known. Cells are flat grid indices.
    """
    have = _padded(grid, known, np.ones(len(known))) > 0
    want = _padded(grid, wanted, np.ones(len(wanted))) > 0
    dense = [_padded(grid, known, component) for component in values]
    while have.any() and np.any(want & ~have):
        beside = _sum_around(have.astype(float))
        new: BoolArray = want & ~have & (beside > 0)
        if not new.any():
            new = ~have & (beside > 0)
        for component in dense:
            component[new] = _sum_around(component * have)[new] / beside[new]
        have = have | new
    inner = (slice(1, -1),) * grid.dimension
    return np.stack([component[inner].reshape(-1)[wanted] for component in dense])


def _padded(grid: Grid, cells: IntArray, values: FloatArray) -> FloatArray:
    dense = np.zeros(grid.cells)
    dense[cells] = values
    return np.pad(dense.reshape(grid.shape), 1)


def _sum_around(values: FloatArray) -> FloatArray:
    """Sum over a cell and all cells that touch it; the rim of the array is not meant to be used."""
    total = values
    for dim in range(values.ndim):
        total = total + np.roll(total, 1, dim) + np.roll(total, -1, dim)
    return total
