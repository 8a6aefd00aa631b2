"""Fields on a grid from grains: mass, momentum and content are shared out, none is lost.

A grain's share of a cell is the integral over the cell of the product of quadratic B-splines of
width w (support 3 w, standard deviation w/2) along the axes, about the grain's centre; cells
without any of the vessel get nothing, and the shares of a grain are divided by their sum. So the
sums over all cells are those over the grains, to round-off. w is a grain's diameter, or an edge of
the cell where that is larger.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray
from scaleup.particles.pouring import Grains

_AT_ONCE = 4_000_000  # shares that are held in memory


@dataclass(frozen=True)
class Fields:
    """Sums over grains in cells, dense, (cells,) each.

    volume   -- of grains, m^3
    content  -- of each component, m^3, (components, cells)
    momentum -- volume times velocity, m^4/s, (dimension, cells)
    """

    volume: FloatArray
    content: FloatArray
    momentum: FloatArray

    def __add__(self, other: Fields) -> Fields:
        return Fields(
            self.volume + other.volume,
            self.content + other.content,
            self.momentum + other.momentum,
        )


def coarse_grained(
    grid: Grid, inside: BoolArray, grains: Grains, component: IntArray, width: float
) -> Fields:
    """The fields of grains on a grid.

    inside    -- (cells,), which cells hold some of the vessel
    component -- (n,) number of each grain's, from 0
    width     -- w, m; at least an edge of the cell is taken

    >>> grid = Grid((0.0, 0.0), (0.01, 0.01), (10, 10), depth=0.01)
    >>> at = np.array([[0.05, 0.05, 0.0], [0.0, 0.03, 0.0]])  # the second one at the edge
    >>> grains = Grains(at, np.ones((2, 3)), np.array([0.001, 0.002]))
    >>> fields = coarse_grained(grid, np.ones(100, bool), grains, np.array([0, 1]), width=0.01)
    >>> bool(np.isclose(fields.volume.sum(), grains.volume.sum(), rtol=1e-14))
    True
    """
    count = int(component.max(initial=0)) + 1
    volume = np.zeros(grid.cells)
    content = np.zeros((count, grid.cells))
    momentum = np.zeros((grid.dimension, grid.cells))
    for chosen, cells, shares in _shares(grid, inside, grains.position, width):
        held = shares * grains.volume[chosen][:, None]
        flat = cells.ravel()
        volume += np.bincount(flat, held.ravel(), grid.cells)
        for number in range(count):
            own = component[chosen] == number
            content[number] += np.bincount(cells[own].ravel(), held[own].ravel(), grid.cells)
        for axis in range(grid.dimension):
            moving = held * grains.velocity[chosen, axis][:, None]
            momentum[axis] += np.bincount(flat, moving.ravel(), grid.cells)
    return Fields(volume, content, momentum)


def _shares(
    grid: Grid, inside: BoolArray, position: FloatArray, width: float
) -> Iterator[tuple[slice, IntArray, FloatArray]]:
    """(which grains, cells (n, m), shares (n, m) that sum to 1) in pieces."""
    widths = [max(width, h) for h in grid.spacing]
    reach = [int(np.ceil(3 * w / h)) + 1 for w, h in zip(widths, grid.spacing, strict=True)]
    piece = max(1, _AT_ONCE // int(np.prod(reach)))
    for begin in range(0, len(position), piece):
        chosen = slice(begin, begin + piece)
        at = position[chosen]
        cells = np.zeros((len(at), 1), dtype=np.int64)
        shares = np.ones((len(at), 1))
        stride = 1
        for axis in range(grid.dimension):
            h, w, n = grid.spacing[axis], widths[axis], grid.counts[axis]
            offset = (at[:, axis] - grid.lower[axis]) / h
            first = np.floor(offset - 1.5 * w / h).astype(np.int64)
            index = first[:, None] + np.arange(reach[axis])
            edges = (first[:, None] + np.arange(reach[axis] + 1) - offset[:, None]) * h / w
            along = np.diff(_cumulated(edges), axis=1)
            along[(index < 0) | (index >= n)] = 0.0
            index = np.clip(index, 0, n - 1)
            cells = (index[:, :, None] * stride + cells[:, None, :]).reshape(len(at), -1)
            shares = (along[:, :, None] * shares[:, None, :]).reshape(len(at), -1)
            stride *= n
        shares = shares * inside[cells]
        total = shares.sum(axis=1)
        lost = total <= 0  # a grain whose surroundings hold nothing of the vessel
        if lost.any():
            nearest = shares[lost]
            nearest[:, nearest.shape[1] // 2] = 1.0
            shares[lost], total[lost] = nearest, 1.0
        yield chosen, cells, shares / total[:, None]


def _cumulated(x: FloatArray) -> FloatArray:
    """Integral of the quadratic B-spline of width 1 up to x: 0 below -3/2, 1 above 3/2.

    >>> [round(float(v), 6) for v in _cumulated(np.array([-1.5, -0.5, 0.0, 0.5, 1.5]))]
    [0.0, 0.166667, 0.5, 0.833333, 1.0]
    """
    a = np.abs(np.clip(x, -1.5, 1.5))
    inner = 0.75 * a - a**3 / 3
    outer = 0.5 - (1.5 - a) ** 3 / 6
    result: FloatArray = 0.5 + np.sign(x) * np.where(a <= 0.5, inner, outer)
    return result
