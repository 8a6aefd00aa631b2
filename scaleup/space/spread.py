"""Carry values outwards from the cells that have them."""

from __future__ import annotations

import numba
import numpy as np

from scaleup.space.grid import BoolArray, FloatArray, Grid, IntArray


def spread_outwards(
    grid: Grid, known: IntArray, values: FloatArray, wanted: IntArray
) -> FloatArray:
    """Values (m, k) of the `known` cells carried layer by layer to the `wanted` ones: (m, n).

    Each new cell takes the mean of the cells with a value among those that touch it (8 in 2-D, 26
    in 3-D). Wanted cells to which no chain of wanted ones leads take the mean of the cells with a
    value that are nearest (in the greatest of the distances along the axes). Zero if nothing is
    known. Cells are flat grid indices.
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
            dense[:, missing] = _nearest(missing, dense, have, (1, *padded)[-3:])
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


@numba.njit(cache=True)
def _nearest(
    cells: IntArray, dense: FloatArray, have: BoolArray, shape: tuple[int, int, int]
) -> FloatArray:
    """Means (m, cells) over the nearest cells with a value, in shells around each."""
    means = np.zeros((dense.shape[0], len(cells)))
    for n in range(len(cells)):
        i, rest = divmod(cells[n], shape[1] * shape[2])
        j, k = divmod(rest, shape[2])
        count, away = 0, 0
        while count == 0 and away < max(shape):
            away += 1
            for a in range(max(i - away, 0), min(i + away + 1, shape[0])):
                for b in range(max(j - away, 0), min(j + away + 1, shape[1])):
                    on_shell = max(abs(a - i), abs(b - j)) == away
                    for c in range(k - away, k + away + 1, 1 if on_shell else 2 * away):
                        if not 0 <= c < shape[2]:
                            continue
                        place = (a * shape[1] + b) * shape[2] + c
                        if have[place]:
                            count += 1
                            for q in range(dense.shape[0]):
                                means[q, n] += dense[q, place]
        for q in range(dense.shape[0]):
            means[q, n] /= max(count, 1)
    return means
