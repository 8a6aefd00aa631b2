"""The cells of an interval that move, as a list with neighbours: what paths and balances need."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.api import BoolArray, FloatArray, Grid, IntArray, Interval

_FULL = 1.0 - 1e-9


@dataclass(frozen=True)
class MovingCells:
    """Cells with a flux through any face between two of them, m of them, the same on every rank.

    cells -- flat grid indices, ascending, (m,)
    where -- their places in the interval's list of active cells, (m,)
    below, above -- (dimension, m) places in this list of the neighbours along each axis, or -1
             where nothing goes through the face between
    flux  -- (dimension, m) through the lower faces over the volume of a cell, 1/s
    shear -- (dimension, dimension, m): [a, b] is half the difference between the flux through the
             lower face normal to a of the cell above along b and of the cell below, 1/s; 0 unless
             all these cells are full
    start, end -- fill fraction at the interval's start and end, (m,)
    """

    cells: IntArray
    where: IntArray
    below: IntArray
    above: IntArray
    flux: FloatArray
    shear: FloatArray
    start: FloatArray
    end: FloatArray


class Finder:
    """Finds the moving cells of intervals on a grid; holds one number per cell of the grid."""

    def __init__(self, grid: Grid):
        self._grid = grid
        self._place = np.full(grid.cells, -1, dtype=np.int32)

    def find(self, interval: Interval) -> MovingCells:
        """The moving cells of an interval."""
        grid, volume = self._grid, self._grid.cell_volume
        counts = np.array((*grid.counts, 1)[:3])
        every = interval.cells
        below = _neighbours(every, self._place, counts, grid.dimension, grid.periodic)
        touched = _touched(below, interval.flux)
        where = np.flatnonzero(touched)
        cells = every[where]
        below = _neighbours(cells, self._place, counts, grid.dimension, grid.periodic)
        flux = interval.flux[:, where] / volume
        start = interval.fill_start[where] / volume
        end = interval.fill_end[where] / volume
        full = np.minimum(start, end) >= _FULL
        shear = _shear(below, _turned_round(below), flux, full)
        below[flux == 0.0] = -1
        return MovingCells(cells, where, below, _turned_round(below), flux, shear, start, end)


@numba.njit(cache=True)
def _neighbours(
    cells: IntArray, place: IntArray, counts: IntArray, dimension: int, periodic: bool
) -> IntArray:
    """Place of each cell's lower neighbour in the list, or -1, (dimension, n)."""
    for k in range(len(cells)):
        place[cells[k]] = k
    below = np.empty((dimension, len(cells)), dtype=np.int32)
    for k in range(len(cells)):
        cell, stride = cells[k], 1
        for axis in range(dimension):
            index = (cell // stride) % counts[axis]
            if index > 0:
                below[axis, k] = place[cell - stride]
            elif periodic:
                below[axis, k] = place[cell + (counts[axis] - 1) * stride]
            else:
                below[axis, k] = -1
            stride *= counts[axis]
    for k in range(len(cells)):
        place[cells[k]] = -1
    return below


@numba.njit(cache=True)
def _touched(below: IntArray, flux: FloatArray) -> BoolArray:
    moves = np.zeros(flux.shape[1], dtype=np.bool_)
    for axis in range(flux.shape[0]):
        for k in range(flux.shape[1]):
            if flux[axis, k] != 0.0 and below[axis, k] >= 0:
                moves[k] = moves[below[axis, k]] = True
    return moves


@numba.njit(cache=True)
def _turned_round(below: IntArray) -> IntArray:
    above = np.full_like(below, -1)
    for axis in range(below.shape[0]):
        for k in range(below.shape[1]):
            if below[axis, k] >= 0:
                above[axis, below[axis, k]] = k
    return above


@numba.njit(cache=True)
def _shear(below: IntArray, above: IntArray, flux: FloatArray, full: BoolArray) -> FloatArray:
    dimension, m = flux.shape
    shear = np.zeros((dimension, dimension, m))
    for a in range(dimension):
        for b in range(dimension):
            if a == b:
                continue
            for k in range(m):
                low, high, behind = below[b, k], above[b, k], below[a, k]
                if low < 0 or high < 0 or behind < 0 or not (full[k] and full[behind]):
                    continue
                low_behind, high_behind = below[a, low], below[a, high]
                if low_behind < 0 or high_behind < 0:
                    continue
                if full[low] and full[high] and full[low_behind] and full[high_behind]:
                    shear[a, b, k] = 0.5 * (flux[a, high] - flux[a, low])
    return shear
