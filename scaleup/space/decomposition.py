"""How cells are shared out among MPI ranks.

A PETSc DMDA splits the box of active cells. Its ownership ranges are chosen so that ranks own
equal numbers of ACTIVE cells: a square cut in half would leave one rank of a drum with 2 % of the
bed. Ghost values travel by a PETSc scatter that moves the ghosts alone.

Importing this module starts MPI; the command line therefore imports it only after launching.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from scaleup.space.grid import BoolArray, FloatArray, Grid, IntArray
from scaleup.system.errors import InputError


class GhostedField:
    """Values on the cells of a rank's local box (ghosts included), in a PETSc vector.

    array -- float64 view, (components, *local_shape); writing to it writes the vector
    flat  -- the same as (components, cells)
    """

    def __init__(self, vector: Any, shape: tuple[int, ...], scatter: Any):
        self._vector = vector
        self._scatter = scatter
        self.array: FloatArray = vector.getArray().reshape(shape)
        self.flat: FloatArray = self.array.reshape(shape[0], -1)

    def exchange(self) -> None:
        """Overwrite the ghosts with their owners' values (collective)."""
        if self._scatter is not None:
            self._scatter.scatter(
                self._vector, self._vector, addv=PETSc.InsertMode.INSERT, mode="forward"
            )


class Placing:
    """Where the cells of a list lie in a rank's flattened local arrays; found once, used often.

    place -- (n,) position of each cell, owned or ghost, -1 if it is not in the rank's box
    mine  -- (n,) whether this rank owns it
    owned -- positions of those that it owns, ascending if the cells are
    """

    def __init__(self, split: Decomposition, cells: IntArray):
        self._split, self._cells = split, cells
        self._size = math.prod(split.local_shape)
        inside, where = split.local_position(cells)
        self.place = np.full(len(cells), -1, dtype=np.int64)
        self.place[inside] = np.ravel_multi_index(where, split.local_shape)
        self.mine, owned = split.owned_cells(cells)
        self.owned: IntArray = np.ravel_multi_index(owned, split.local_shape)
        self._inside, self._there = inside, self.place[inside]

    def local(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (..., n) on flattened local arrays (..., cells), ghosts included, else 0."""
        if self._split.grid.periodic:  # a cell may be in several places
            wrapped = self._split.to_local(self._cells, values)
            return wrapped.reshape(*values.shape[:-1], self._size)
        result = np.zeros((*values.shape[:-1], self._size), dtype=values.dtype)
        result[..., self._there] = values[..., self._inside]
        return result


class Decomposition:
    """The active box of a grid, shared out among the ranks of a communicator.

    grid        -- the whole grid
    comm        -- mpi4py communicator
    halo        -- number of ghost layers
    local_shape -- shape of a rank's arrays: owned cells and `halo` ghosts on every side
    owned       -- slices of the owned cells in a local array
    box_lower, box_counts -- the box of active cells, widened by `halo`, in grid cells, x first

    One rank that owns all cells of a bed, with two layers of ghosts around them:

    >>> from scaleup.flow.sample_flows import circulating_box
    >>> flow = circulating_box(dimension=2)
    >>> split = Decomposition(flow.grid, flow.ever_active(), MPI.COMM_SELF, halo=2)
    >>> cells = flow.intervals[0].cells
    >>> field = split.field(components=1)
    >>> field.array[0] = split.to_local(cells, np.arange(len(cells)))  # numbers the cells
    >>> field.exchange()  # ghosts take what their owners hold
    >>> keep, where = split.owned_cells(cells)
    >>> bool(keep.all()), field.array[0][where][:3].tolist()
    (True, [0.0, 1.0, 2.0])
    """

    def __init__(self, grid: Grid, active: IntArray, comm: Any, halo: int = 1):
        """`active`: flat indices of all cells that are ever active (the same on every rank).

        Raises InputError if there are more ranks than the box can be split for.
        """
        self.grid, self.comm, self.halo = grid, comm, halo
        position = np.unravel_index(active, grid.shape)[::-1]
        if grid.periodic:
            self.box_lower, self.box_counts = (0,) * grid.dimension, grid.counts
        else:
            self.box_lower = tuple(int(p.min()) - halo for p in position)
            self.box_counts = tuple(
                int(p.max()) + 1 + halo - low
                for p, low in zip(position, self.box_lower, strict=True)
            )
        histograms = [
            np.bincount(p - low, minlength=count)
            for p, low, count in zip(position, self.box_lower, self.box_counts, strict=True)
        ]
        ranks, ranges = _balanced(histograms, comm.size, halo, position, self.box_lower)
        kinds = PETSc.DM.BoundaryType
        edge = kinds.PERIODIC if grid.periodic else kinds.GHOSTED
        self._dmda = PETSc.DMDA().create(
            dim=grid.dimension,
            dof=1,
            sizes=self.box_counts,
            proc_sizes=ranks,
            boundary_type=(edge,) * grid.dimension,
            stencil_type=PETSc.DMDA.StencilType.BOX,
            stencil_width=halo,
            ownership_ranges=tuple(np.asarray(r, dtype=PETSc.IntType) for r in ranges),
            comm=comm,
        )
        self._starts = [np.concatenate([[0], np.cumsum(r)]) for r in ranges]
        self._rank_counts = ranks
        own = self._dmda.getRanges()
        self._own_lower = tuple(low for low, _ in own)
        self._own_counts = tuple(high - low for low, high in own)
        self.local_shape = tuple(n + 2 * halo for n in self._own_counts[::-1])
        self.owned = tuple(slice(halo, halo + n) for n in self._own_counts[::-1])
        self._layouts: dict[int, tuple[Any, Any]] = {}

    def field(self, components: int = 1) -> GhostedField:
        """A new field of zeros."""
        if components not in self._layouts:
            self._layouts[components] = self._ghost_scatter(components)
        layout, scatter = self._layouts[components]
        vector = layout.duplicate()
        vector.set(0.0)
        return GhostedField(vector, (components, *self.local_shape), scatter)

    def placing(self, cells: IntArray) -> Placing:
        """Where these flat grid indices lie in this rank's local arrays."""
        return Placing(self, cells)

    def to_local(self, cells: IntArray, values: FloatArray, empty: float = 0.0) -> FloatArray:
        """Dense local array (ghosts included) of values given at flat grid indices.

        values -- (n,) or (m, n); the result is `local_shape` or (m, *local_shape), `empty`
        elsewhere. No communication: every rank picks what lies in its box.
        """
        values = np.asarray(values)
        if self.grid.periodic:  # a cell may be here and in the ghosts too
            dense = np.full((*values.shape[:-1], self.grid.cells), empty, dtype=values.dtype)
            dense[..., cells] = values
            wrapped = [
                (np.arange(-self.halo, n + self.halo) + low) % count
                for n, low, count in zip(
                    self._own_counts, self._own_lower, self.grid.counts, strict=True
                )
            ]
            dense = dense.reshape(*values.shape[:-1], *self.grid.shape)
            return np.ascontiguousarray(dense[..., *np.ix_(*wrapped[::-1])])
        inside, where = self.local_position(cells)
        local = np.full((*values.shape[:-1], *self.local_shape), empty, dtype=values.dtype)
        local[(..., *where)] = values[..., inside]
        return local

    def owned_cells(self, cells: IntArray) -> tuple[BoolArray, tuple[IntArray, ...]]:
        """Which of the flat grid indices this rank owns, and their positions in local arrays."""
        inside, where = self.local_position(cells)
        mine = np.ones(len(where[0]), dtype=bool)
        for index, part in zip(where, self.owned, strict=True):
            mine &= (index >= part.start) & (index < part.stop)
        keep = inside.copy()
        keep[inside] = mine
        return keep, tuple(index[mine] for index in where)

    def gather(self, cells: IntArray, owned_values: FloatArray, keep: BoolArray) -> FloatArray:
        """Values at flat grid indices, collected from their owners on every rank.

        owned_values -- (m, k): this rank's values at the k cells flagged by `keep`
        Returns (m, n) in the order of `cells`.
        """
        collected = np.zeros((owned_values.shape[0], len(cells)))
        parts = self.comm.allgather((np.flatnonzero(keep), owned_values))
        for where, values in parts:
            collected[:, where] = values
        return collected

    def largest(self, value: float) -> float:
        """The greatest of the ranks' values (collective)."""
        return float(self.comm.allreduce(value, op=MPI.MAX))

    def totals(self, values: FloatArray) -> FloatArray:
        """The ranks' arrays summed entry by entry (collective)."""
        summed = np.empty_like(values)
        self.comm.Allreduce(np.ascontiguousarray(values), summed, op=MPI.SUM)
        return summed

    def largest_of(self, values: Sequence[float]) -> FloatArray:
        """The greatest of the ranks' values, for several at once (collective)."""
        greatest = np.empty(len(values))
        self.comm.Allreduce(np.array(values, dtype=float), greatest, op=MPI.MAX)
        return greatest

    def total(self, value: float) -> float:
        """The sum of the ranks' values (collective)."""
        return float(self.comm.allreduce(value, op=MPI.SUM))

    def centre(self, position: int) -> tuple[float, ...]:
        """Centre (m) of the cell at a position in flattened local arrays."""
        index = np.unravel_index(position, self.local_shape)
        return tuple(
            self.grid.lower[axis]
            + self.grid.spacing[axis]
            * (index[self.grid.array_axis(axis)] + self.box_lower[axis] + own - self.halo + 0.5)
            for axis, own in enumerate(self._own_lower)
        )

    def local_position(self, cells: IntArray) -> tuple[BoolArray, tuple[IntArray, ...]]:
        """Which of the flat grid indices lie in this rank's box, ghosts included, and where."""
        position = np.unravel_index(cells, self.grid.shape)
        inside = np.ones(len(cells), dtype=bool)
        shifted = []
        for dim, index in enumerate(position):
            axis = self.grid.array_axis(dim)
            local = index - self.box_lower[axis] - self._own_lower[axis] + self.halo
            inside &= (local >= 0) & (local < self.local_shape[dim])
            shifted.append(local)
        return inside, tuple(local[inside] for local in shifted)

    def _ghost_scatter(self, components: int) -> tuple[Any, Any]:
        """A vector laid out as all local boxes in turn, and the scatter owner -> ghost on it.

        A rank's part of the vector holds its whole box for one component after the other.
        """
        size = math.prod(self.local_shape)
        layout = PETSc.Vec().createMPI((components * size, PETSc.DECIDE), comm=self.comm)
        periodic = self.grid.periodic
        if self.comm.size == 1 and not periodic:
            return layout, None
        sizes = np.array(self.comm.allgather(size))
        offsets = np.concatenate([[0], np.cumsum(components * sizes)])
        # positions of all local cells in the box, x first
        index = np.indices(self.local_shape)
        in_box = [
            index[self.grid.array_axis(a)].ravel() + self._own_lower[a] - self.halo
            for a in range(self.grid.dimension)
        ]
        exists = np.ones(size, dtype=bool)
        rank_coordinate = []
        mine = np.ones(size, dtype=bool)
        for axis, place in enumerate(in_box):
            own_low = self._own_lower[axis]
            mine &= (place >= own_low) & (place < own_low + self._own_counts[axis])
            if periodic:
                place %= self.box_counts[axis]
            exists &= (place >= 0) & (place < self.box_counts[axis])
            rank_coordinate.append(
                np.searchsorted(self._starts[axis], np.clip(place, 0, None), side="right") - 1
            )
        owner = np.zeros(size, dtype=np.int64)
        for axis in reversed(range(self.grid.dimension)):
            last = self._rank_counts[axis] - 1
            owner = owner * self._rank_counts[axis] + np.minimum(rank_coordinate[axis], last)
        ghost = np.flatnonzero(exists & ~mine)
        source = np.zeros(len(ghost), dtype=np.int64)
        for axis in reversed(range(self.grid.dimension)):
            cut = np.minimum(rank_coordinate[axis][ghost], self._rank_counts[axis] - 1)
            low = self._starts[axis][cut]
            width = self._starts[axis][cut + 1] - low + 2 * self.halo
            source = source * width + (in_box[axis][ghost] - low + self.halo)
        each = np.arange(components)[:, None]
        to = offsets[self.comm.rank] + each * size + ghost
        origin = offsets[owner[ghost]] + each * sizes[owner[ghost]] + source
        here = PETSc.IS().createGeneral(to.ravel().astype(PETSc.IntType), comm=self.comm)
        there = PETSc.IS().createGeneral(origin.ravel().astype(PETSc.IntType), comm=self.comm)
        return layout, PETSc.Scatter().create(layout, there, layout, here)


def _balanced(
    histograms: list[IntArray],
    size: int,
    halo: int,
    position: tuple[IntArray, ...],
    box_lower: tuple[int, ...],
) -> tuple[tuple[int, ...], list[IntArray]]:
    """Ranks per axis and owned cells per rank and axis with the smallest greatest load.

    Each way to factor `size` over the axes is tried; along each axis the cuts are put at equal
    shares of the active cells in that axis' histogram, and the factorisation whose busiest rank
    has the fewest active cells wins (the first of equals).
    """
    best: tuple[int, tuple[int, ...], list[IntArray]] | None = None
    for ranks in product(range(1, size + 1), repeat=len(histograms)):
        if math.prod(ranks) != size:
            continue
        ranges = [_cuts(h, n, halo) for h, n in zip(histograms, ranks, strict=True)]
        if any(r is None for r in ranges):
            continue
        cuts = [r for r in ranges if r is not None]
        rank = np.zeros(len(position[0]), dtype=np.int64)
        for p, low, r, n in zip(position, box_lower, cuts, ranks, strict=True):
            rank = rank * n + np.searchsorted(np.cumsum(r), p - low, side="right")
        busiest = int(np.bincount(rank, minlength=size).max())
        if best is None or busiest < best[0]:
            best = (busiest, ranks, cuts)
    if best is None:
        counts = " x ".join(str(len(h)) for h in histograms)
        raise InputError(f"--ranks = {size}: too many for a bed of {counts} cells")
    return best[1], best[2]


def _cuts(histogram: IntArray, parts: int, halo: int) -> IntArray | None:
    """Lengths of `parts` runs with equal shares of the histogram, none shorter than the halo."""
    least = max(halo, 1)
    if parts * least > len(histogram):
        return None
    cumulative = np.cumsum(histogram)
    targets = cumulative[-1] * np.arange(1, parts) / parts
    edges = np.searchsorted(cumulative, targets) + 1
    for i in range(parts - 1):
        floor = (edges[i - 1] if i else 0) + least
        edges[i] = min(max(edges[i], floor), len(histogram) - (parts - 1 - i) * least)
    return np.diff(np.concatenate([[0], edges, [len(histogram)]]))
