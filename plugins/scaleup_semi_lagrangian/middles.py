"""Where the sub-cells of a cell end, from the paths of as few points as will do.

The path of each cell's middle tells where its sub-cells end: at X + J o + 1/2 sum over axes a of
X_aa o_a^2, for a sub-cell at o from the middle, with first and second differences of the ends X of
the neighbouring middles. They are one-sided where a neighbour is missing, holds little, or is cut
and the cell is not; a neighbour that does not move ends where it began. What would lie beyond a
closed face is put on it. Where det J is not the ratio of the fills at both ends, the motion is not
smooth, and a path is traced for each sub-cell; in the plane, where they are few, for those of all
cut cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray
from scaleup_semi_lagrangian.moving_cells import STILL, Lattice, MovingCells
from scaleup_semi_lagrangian.paths import follow

_CHANGE = 0.5  # of a volume, at most, by a Jacobian that is believed
_LITTLE = 0.1  # fill fraction, below which a neighbour says nothing
_MIDDLE = np.array([0.5137, 0.4789, 0.5173])  # off symmetry, where paths run into edges of cells


class Subcells(NamedTuple):
    """Whose ends are wanted, and where they are put.

    sources -- (s,) moving cells; candidates -- those places in it that may be known by Jacobians
    points, middle -- (sub-cells, dimension) in the unit cell, and (dimension,) about which they lie
    landed, places, known -- (s, sub-cells), (s, sub-cells, dimension), and (s,) which are filled
    """

    sources: IntArray
    candidates: IntArray
    points: FloatArray
    middle: FloatArray
    landed: IntArray
    places: FloatArray
    known: BoolArray


class Traced(NamedTuple):
    """Middles whose paths were traced.

    number -- (m,) place of each moving cell among them, or -1
    landed, places -- the cells in which they end, and (., dimension) the places there
    """

    number: IntArray
    landed: IntArray
    places: FloatArray


class Surroundings(NamedTuple):
    """Of the moving cells: neighbours as in `MovingCells`, and fill fractions (m,)."""

    below: IntArray
    above: IntArray
    beside: IntArray
    start: FloatArray
    end: FloatArray


def ends_of_subcells(
    grid: Grid,
    moving: MovingCells,
    fills: tuple[FloatArray, FloatArray],
    duration: float,
    sources: IntArray,
    points: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """Moving cells (s, sub-cells) in which they end and places there (s, sub-cells, dimension).

    fills   -- fill fractions of the moving cells at the beginning and the end, each (m,)
    duration -- s
    sources -- the moving cells whose sub-cells are wanted, (s,)
    points  -- (sub-cells, dimension) their middles in the unit cell
    """
    start, end = fills
    axes = tuple(range(grid.dimension))
    motion = (
        moving.below, moving.above, moving.flux, moving.shear, moving.full, start,
        (end - start) / duration,
    )  # fmt: skip
    cut_too = grid.dimension == 3
    usable = _usable(moving.beside, moving.full, start, cut_too)
    smooth = (usable != -1).any(axis=0).all(axis=0) & (moving.full | cut_too)
    candidates = np.flatnonzero(smooth[sources])
    wanted = _with_neighbours(usable, sources[candidates])
    middle = _MIDDLE[: grid.dimension]
    landed_middle, place_middle = follow(*motion, wanted, middle[None], duration, axes)
    number = np.full(len(start), -1, dtype=np.int32)
    number[wanted] = np.arange(len(wanted), dtype=np.int32)

    landed = np.empty((len(sources), len(points)), dtype=np.int32)
    places = np.empty((len(sources), len(points), grid.dimension), dtype=np.float32)
    known = np.zeros(len(sources), dtype=bool)
    _spread(
        Subcells(sources, candidates, points, middle, landed, places, known),
        Traced(number, landed_middle[:, 0], place_middle[:, 0]),
        Surroundings(moving.below, moving.above, usable, start, end),
        moving.lattice(grid),
    )
    rest = np.flatnonzero(~known)
    landed[rest], places[rest] = follow(*motion, sources[rest], points, duration, axes)
    return landed, places


@numba.njit(cache=True)
def _usable(beside: IntArray, full: BoolArray, start: FloatArray, cut_too: bool) -> IntArray:
    """`beside`, but -1 for the neighbours from which no difference is taken."""
    usable = beside.copy()
    for axis in range(beside.shape[1]):
        for i in range(beside.shape[2]):
            low, high = beside[0, axis, i], beside[1, axis, i]
            for side, j, other in ((0, low, high), (1, high, low)):
                if j < 0:
                    continue
                better = other == STILL or (other >= 0 and full[other])
                if not full[j] and (not cut_too or start[j] < _LITTLE or (full[i] and better)):
                    usable[side, axis, i] = -1
    return usable


@numba.njit(cache=True)
def _with_neighbours(beside: IntArray, cells: IntArray) -> IntArray:
    """The cells, and their neighbours that move, ascending."""
    wanted = np.zeros(beside.shape[2], dtype=np.bool_)
    for cell in cells:
        wanted[cell] = True
        for side in range(2):
            for axis in range(beside.shape[1]):
                if beside[side, axis, cell] >= 0:
                    wanted[beside[side, axis, cell]] = True
    return np.flatnonzero(wanted).astype(np.int32)


@numba.njit(cache=True)
def _spread(wanted: Subcells, traced: Traced, around: Surroundings, lattice: Lattice) -> None:
    """Fill in the ends of the candidates whose Jacobian is believed."""
    sources, candidates, points, middle, landed, places, known = wanted
    number, landed_middle, place_middle = traced
    below, above, beside, start, end = around
    coordinates, counts, periodic = lattice
    dimension = points.shape[1]
    jacobian, curve = np.empty((dimension, dimension)), np.empty((dimension, dimension))
    x = np.empty(dimension)
    ends = np.empty((2, dimension))
    low, high = ends[0], ends[1]
    y = np.empty(dimension)
    for n in candidates:
        i = sources[n]
        at = landed_middle[number[i]]
        for a in range(dimension):
            x[a] = coordinates[at, a] + place_middle[number[i], a]
        for b in range(dimension):
            for side in range(2):
                reached = ends[side]
                j = beside[side, b, i]
                if j >= 0:
                    there = landed_middle[number[j]]
                    for a in range(dimension):
                        reached[a] = coordinates[there, a] + place_middle[number[j], a] - x[a]
                        if periodic:
                            reached[a] -= counts[a] * np.rint(reached[a] / counts[a])
                elif j == STILL:
                    for a in range(dimension):
                        reached[a] = coordinates[i, a] + middle[a] - x[a]
                    reached[b] += 2 * side - 1
            none_below, none_above = beside[0, b, i] == -1, beside[1, b, i] == -1
            for a in range(dimension):
                if none_below:
                    jacobian[a, b], curve[a, b] = high[a], 0.0
                elif none_above:
                    jacobian[a, b], curve[a, b] = -low[a], 0.0
                else:
                    jacobian[a, b] = 0.5 * (high[a] - low[a])
                    curve[a, b] = high[a] + low[a]
        if not abs(_determinant(jacobian) * end[at] / start[i] - 1.0) < _CHANGE:
            continue
        known[n] = True
        for p in range(len(points)):
            cell = at
            for a in range(dimension):
                y[a] = place_middle[number[i], a]
                for b in range(dimension):
                    o = points[p, b] - middle[b]
                    y[a] += (jacobian[a, b] + 0.5 * curve[a, b] * o) * o
                while y[a] > 1.0:
                    beyond = above[a, cell]
                    if beyond < 0 or end[beyond] <= 0.0:
                        y[a] = 1.0
                        break
                    cell, y[a] = beyond, y[a] - 1.0
                while y[a] < 0.0:
                    beyond = below[a, cell]
                    if beyond < 0 or end[beyond] <= 0.0:
                        y[a] = 0.0
                        break
                    cell, y[a] = beyond, y[a] + 1.0
            landed[n, p] = cell
            for a in range(dimension):
                places[n, p, a] = y[a]


@numba.njit(inline="always")
def _determinant(m):
    if m.shape[0] == 2:
        return m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    total = 0.0
    for a in range(3):
        b, e = (a + 1) % 3, (a + 2) % 3
        total += m[0, a] * (m[1, b] * m[2, e] - m[1, e] * m[2, b])
    return total
