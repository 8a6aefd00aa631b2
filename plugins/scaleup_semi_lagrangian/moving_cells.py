"""The cells of an interval that move, as a list with neighbours: what paths and balances need."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray, Interval
from scaleup.numerics import neighbours_below

_FULL = 1.0 - 1e-9
STILL = -2
"""in `MovingCells.beside`: a full cell that does not move"""


class Lattice(NamedTuple):
    """Where cells lie on the grid, for kernels.

    coordinates -- (m, dimension) whole numbers of the cells along the axes, x first
    counts      -- (dimension,) cells of the grid along the axes; `periodic` in all of them
    """

    coordinates: IntArray
    counts: IntArray
    periodic: bool


@numba.njit(inline="always")
def apart(lattice, cell, other, axis):
    """How many cells one is ahead of another along an axis, the short way round."""
    along = lattice.coordinates[cell, axis] - lattice.coordinates[other, axis]
    if lattice.periodic:
        along -= lattice.counts[axis] * int(np.rint(along / lattice.counts[axis]))
    return along


@dataclass(frozen=True)
class MovingCells:
    """Cells with a flux through any face between two of them, m of them, the same on every rank.

    cells -- flat grid indices, ascending, (m,)
    coordinates -- (m, dimension) whole numbers of the cells along the axes, x first
    where -- their places in the interval's list of active cells, (m,)
    below, above -- (dimension, m) places in this list of the neighbours along each axis, or -1
             where nothing goes through any part of the face between
    beside -- (2, dimension, m) places of the neighbours below and above, whatever passes between;
             `STILL` where one does not move but is full, -1 where there is none
    flux  -- (dimension, m) through the lower faces over the volume of a cell, 1/s
    shear -- (dimension, dimension, m): [a, b] is half the difference between the flux through the
             lower face normal to a of the cell above along b and of the cell below, 1/s; 0 unless
             all these cells are full
    start, end -- fill fraction at the interval's start and end, (m,)
    """

    cells: IntArray
    coordinates: IntArray
    where: IntArray
    below: IntArray
    above: IntArray
    beside: IntArray
    flux: FloatArray
    shear: FloatArray
    start: FloatArray
    end: FloatArray

    @cached_property
    def full(self) -> BoolArray:
        """Which cells are full all the time, (m,)."""
        return _full(self.start, self.end)

    def lattice(self, grid: Grid) -> Lattice:
        """Where they lie on their grid."""
        return Lattice(self.coordinates, np.array(grid.counts), grid.periodic)

    def greatest_gradient(self) -> float:
        """Greatest velocity gradient between the faces of full cells, 1/s."""
        greatest = float(np.abs(self.shear).max(initial=0.0))
        for lower, above in zip(self.flux, self.above, strict=True):
            both = self.full & (above >= 0)
            change = np.abs(lower[above[both]] - lower[both])
            greatest = max(greatest, float(change.max(initial=0.0)))
        return greatest


def find_moving(grid: Grid, interval: Interval) -> MovingCells:
    """The moving cells of an interval."""
    volume = grid.cell_volume
    below_all = neighbours_below(grid, interval.cells)
    where = np.flatnonzero(_touched(below_all, interval.flux))
    flux = interval.flux[:, where] / volume
    start = interval.fill_start[where] / volume
    end = interval.fill_end[where] / volume
    full = _full(interval.fill_start / volume, interval.fill_end / volume)
    below, beside = _neighbours(below_all, where, full)
    shear = _shear(below, turned_round(below), flux, full[where])
    below[(flux == 0.0) & (shear == 0.0).all(axis=1)] = -1
    cells = interval.cells[where]
    return MovingCells(
        cells, coordinates_of(grid, cells), where, below, turned_round(below), beside, flux, shear,
        start, end,
    )  # fmt: skip


def coordinates_of(grid: Grid, cells: IntArray) -> IntArray:
    """Whole numbers of cells along the axes, (m, dimension), x first."""
    return np.stack(np.unravel_index(cells, grid.shape)[::-1], axis=-1).astype(np.int32)


def _full(start: FloatArray, end: FloatArray) -> BoolArray:
    return np.asarray(np.minimum(start, end) >= _FULL)


@numba.njit(cache=True)
def _touched(below: IntArray, flux: FloatArray) -> BoolArray:
    moves = np.zeros(flux.shape[1], dtype=np.bool_)
    for axis in range(flux.shape[0]):
        for k in range(flux.shape[1]):
            if flux[axis, k] != 0.0 and below[axis, k] >= 0:
                moves[k] = moves[below[axis, k]] = True
    return moves


@numba.njit(cache=True)
def _neighbours(below_all: IntArray, where: IntArray, full: BoolArray) -> tuple[IntArray, IntArray]:
    """`below` and `beside`, from the neighbours and `full` of all active cells."""
    dimension, n = below_all.shape
    number = np.full(n, -1, dtype=np.int32)
    for place in range(len(where)):
        number[where[place]] = place
    below = np.full((dimension, len(where)), -1, dtype=np.int32)
    beside = np.full((2, dimension, len(where)), -1, dtype=np.int32)
    for axis in range(dimension):
        for k in range(n):
            j = below_all[axis, k]
            if j < 0:
                continue
            upper, lower = number[k], number[j]
            if upper >= 0:
                below[axis, upper] = lower
                beside[0, axis, upper] = STILL if lower < 0 and full[j] else lower
            if lower >= 0:
                beside[1, axis, lower] = STILL if upper < 0 and full[k] else upper
    return below, beside


@numba.njit(cache=True)
def turned_round(below: IntArray) -> IntArray:
    """The neighbours above, from those below."""
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
