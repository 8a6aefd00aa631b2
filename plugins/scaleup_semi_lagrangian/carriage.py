"""A stretch of time as one operation: where content goes, and how it settles there.

A `Carriage` is built once and used each time the flow comes back to it: on every step of a steady
flow, once in a revolution of a periodic one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray
from scaleup_semi_lagrangian import images, paths, settlement, subcells
from scaleup_semi_lagrangian.centring import Centring, centre, find_centring, off_middles
from scaleup_semi_lagrangian.middles import ends_of_subcells
from scaleup_semi_lagrangian.moving_cells import MovingCells, coordinates_of, turned_round

_EMPTY = 1e-13  # fill fraction
_ROUNDS = 3  # of balancing
_MOST_CHANGE = 2.0  # of a factor in a round


class Carriage:
    """Moves the content of all moving cells over a part of an interval; the same on every rank.

    laid -- (m,) what is laid down in each, as a fill fraction, before it settles
    """

    def __init__(
        self,
        grid: Grid,
        split: Any,
        moving: MovingCells,
        material: BoolArray,
        share: tuple[float, float],
        duration: float,
        per_edge: int,
    ):
        """Collective.

        material -- which local cells hold some at the start of the part
        share    -- start and end of the part, as shares of the interval
        duration -- s, of the part
        per_edge -- sub-cells along an edge of a cell
        """
        self._grid, self._split, self._per_edge = grid, split, per_edge
        # as little as will do is held: a revolution of them is kept
        self._below, self._cells = moving.below, moving.cells.astype(_least_integer(grid.cells))
        start, end = (
            (1.0 - s) * moving.start + s * moving.end if s not in (0.0, 1.0)
            else (moving.end if s else moving.start)
            for s in share
        )  # fmt: skip
        start, end = (np.where(fill > _EMPTY, fill, 0.0) for fill in (start, end))
        self._holds = end > 0.0
        placing = split.placing(moving.cells)
        sources = np.flatnonzero(placing.mine & (start > 0.0)).astype(np.int32)
        self._start, self._position = start[sources], placing.place[sources].astype(np.int32)
        points = paths.lattice(per_edge, grid.dimension)
        self._points = points - 0.5
        self._landed, places = ends_of_subcells(
            grid, moving, (start, end), duration, sources, points
        )
        self._places = np.rint(places * images.SCALE).astype(np.uint16)
        self._strides = strides_of(split)
        self._balance(moving.above, end)
        self._settlement, part = settlement.settle(
            moving.below, moving.above, moving.coordinates, self.laid, end
        )
        self._centring = self._find_centring(moving, end, part)
        self._means, self._slopes = subcells.stencils(per_edge)
        self._kinds = subcells.kinds(self._position, material, self._strides)
        self._corners = subcells.corners(self._position, material, self._strides)
        # where values are put: this rank's cells and its ghosts
        here = np.flatnonzero(placing.place >= 0).astype(np.int32)
        self._here, self._there = here, placing.place[here].astype(np.int32)

    def _landing(self, above: IntArray) -> images.Landing:
        """As it is held, with the neighbours above."""
        return images.Landing(
            self._landed, self._places, self._below, above, self._holds, self._factor,
            self._start, self._strides, self._per_edge,
        )  # fmt: skip

    def _balance(self, above: IntArray, fill: FloatArray) -> None:
        """Factors of the cells with which the laid volumes come near to the fills.

        In turns, the parts of a source are scaled to its volume and those in a cell to its fill
        (Sinkhorn 1964); the first comes last.
        """
        self._factor = np.ones(len(fill), dtype=np.float32)
        for number in range(_ROUNDS + 1):
            laid = np.zeros(len(fill))
            images.lay_volumes(laid, self._landing(above))
            self.laid = self._split.totals(laid)
            if number < _ROUNDS:
                ratio = np.divide(fill, self.laid, out=np.ones_like(fill), where=self.laid > 0)
                self._factor *= np.clip(ratio, 1 / _MOST_CHANGE, _MOST_CHANGE)

    def _find_centring(self, moving: MovingCells, fill: FloatArray, part: IntArray) -> Centring:
        """Where what the cells hold lies after a step."""
        moments = np.zeros((self._grid.dimension, len(fill)))
        lattice = moving.lattice(self._grid)
        images.lay_places(moments, self._landing(moving.above), lattice)
        moments = self._split.totals(moments)
        off = off_middles(moments, self.laid, moving.below, moving.above, self._settlement)
        return find_centring(off, moving.below, moving.above, fill, part)

    def apply(self, c: FloatArray) -> tuple[float, float]:
        """Move the concentrations c (components, cells) in flattened local arrays; collective.

        All components but the last. Ghosts are set too. Returns the least and the greatest of all.
        """
        laid = np.zeros((len(c), len(self.laid)))
        above = turned_round(self._below)
        within = images.Reconstruction(
            self._position, self._kinds, self._corners, self._points, self._means, self._slopes
        )
        coordinates = coordinates_of(self._grid, self._cells)
        images.lay_contents(laid, self._landing(above), coordinates, c, within)
        content = self._split.totals(laid)
        new = laid
        new[:, self._here] = c[:, self._there]
        flux, order = self._settlement.flux, self._settlement.order
        settlement.carry(new, content, self.laid, self._below, above, flux, order)
        centring = self._centring
        centre(new, centring.cells, centring.parts, centring.off, self._below, above)
        c[:, self._there] = new[:, self._here]
        return settlement.bounds(new, self._holds)

    @property
    def bytes(self) -> int:
        """Memory held."""
        parts = (self, self._settlement, self._centring)
        held = [value for part in parts for value in vars(part).values()]
        return sum(array.nbytes for array in held if isinstance(array, np.ndarray))


def _least_integer(most: int) -> type:
    return np.int32 if most < 2**31 else np.int64


def strides_of(split: Any) -> tuple[int, ...]:
    """Offset to the next cell along each axis in flattened local arrays, x first."""
    shape = split.local_shape
    return tuple(int(np.prod(shape[n + 1 :])) for n in range(len(shape)))[::-1]
