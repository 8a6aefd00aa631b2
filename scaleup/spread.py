"""Carry values outwards from the cells that have them."""

from __future__ import annotations

import numba
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
    padded = tuple(n + 2 for n in grid.shape)
    around = _offsets(padded)
    have = np.zeros(int(np.prod(padded)), dtype=bool)
    dense = np.zeros((len(values), len(have)))
    inside, place = _inside(grid, known), _inside(grid, wanted)
    have[inside] = True
    dense[:, inside] = values
    missing = place[~have[place]]
    while have.any() and len(missing):
        new = _beside(missing, have, around)
        if not len(new):
            everywhere = _inside(grid, np.arange(grid.cells))
            new = _beside(everywhere[~have[everywhere]], have, around)
            if not len(new):
                break
        dense[:, new] = _means(new, dense, have, around)
        have[new] = True
        missing = missing[~have[missing]]
    return dense[:, place]


def _inside(grid: Grid, cells: IntArray) -> IntArray:
    """Places of cells in the flattened grid with a rim of one cell."""
    index = np.unravel_index(cells, grid.shape)
    return np.ravel_multi_index(tuple(i + 1 for i in index), tuple(n + 2 for n in grid.shape))


def _offsets(shape: tuple[int, ...]) -> IntArray:
    """From a cell to those that touch it, in a flattened array."""
    steps = np.indices((3,) * len(shape)).reshape(len(shape), -1) - 1
    strides = np.array([int(np.prod(shape[n + 1 :])) for n in range(len(shape))])
    return np.array(strides @ steps[:, steps.any(axis=0)])


@numba.njit(cache=True)
def _beside(cells: IntArray, have: BoolArray, around: IntArray) -> IntArray:
    """Those that touch a cell with a value."""
    chosen = np.zeros(len(cells), dtype=np.bool_)
    for n in range(len(cells)):
        for offset in around:
            if have[cells[n] + offset]:
                chosen[n] = True
                break
    return cells[chosen]


@numba.njit(cache=True)
def _means(cells: IntArray, dense: FloatArray, have: BoolArray, around: IntArray) -> FloatArray:
    """Means (m, cells) over the cells with a value that touch each."""
    means = np.zeros((dense.shape[0], len(cells)))
    for n in range(len(cells)):
        count = 0
        for offset in around:
            if have[cells[n] + offset]:
                count += 1
                for q in range(dense.shape[0]):
                    means[q, n] += dense[q, cells[n] + offset]
        for q in range(dense.shape[0]):
            means[q, n] /= count
    return means
