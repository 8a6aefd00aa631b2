"""The unknowns of an interval of the flow, numbered and shared out among the ranks.

Every full cell that moves is one; so is every group of merged cells, since cells that hold little
share one concentration (`scaleup/space/merged_cells.py`). Numbers follow the ranks; an unknown
belongs to the rank that owns its (first) cell. Local arrays hold a rank's own unknowns, then its
ghosts: those of other ranks that are coupled to its own, or have cells on it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from scaleup.contract import FloatArray, IntArray
from scaleup.numerics import ConservativeBed
from scaleup_implicit_fem.operators import Pairs, find_pairs


class Unknowns:
    """See above.

    count  -- how many belong to this rank
    total  -- how many there are on all ranks
    first  -- number of this rank's first
    pairs  -- all that involve one of its own, in local numbers
    size   -- of local arrays: own ones and ghosts
    dimension, comm -- of the grid and of the ranks
    number -- (size,) numbers on all ranks of those in local arrays
    """

    def __init__(self, bed: ConservativeBed, tensor: FloatArray):
        split, interval, groups = bed.split, bed.interval, bed.merged
        self.dimension = bed.grid.dimension
        placing = split.placing(interval.cells)
        leader = np.where(bed.moving, np.arange(len(interval.cells)), -1)
        leader[groups.members] = groups.members[groups.first[groups.number]]
        leads = (leader == np.arange(len(leader))) & placing.mine
        self.count = int(leads.sum())
        counts = split.comm.allgather(self.count)
        self.first, self.total = sum(counts[: split.comm.rank]), sum(counts)
        given = np.zeros(len(leader))
        given[leads] = np.arange(self.first, self.first + self.count)
        given = split.totals(given)  # each cell has one owner; exact for whole numbers
        number = np.where(leader >= 0, given[leader], -1).astype(np.int64)

        own = (number >= self.first) & (number < self.first + self.count)
        whole = bed.moving.copy()
        whole[groups.members] = False
        base = _touching(bed, own)
        pairs = find_pairs(bed.grid, interval, tensor, number, whole, base)
        self.pairs, here = self._localised(pairs, number[placing.mine & (leader >= 0)])
        self.number, self.size = here, len(here)

        local = np.full(self.total, -1, dtype=np.int64)
        local[here] = np.arange(self.size)
        mine = placing.mine & (leader >= 0)
        self._place, self._of_cell = placing.place[mine], local[number[mine]]
        self._lead = placing.place[leads]
        inside = np.flatnonzero(number >= 0)
        inside = inside[local[number[inside]] >= 0]
        self._start, self._end = (
            np.bincount(local[number[inside]], fill[inside], self.size) / bed.grid.cell_volume
            for fill in (interval.fill_start, interval.fill_end)
        )
        self._interval = interval
        self.comm = split.comm
        self._ghosted: dict[int, PETSc.Vec] = {}  # by number of rows

    def fraction(self, time: float) -> FloatArray:
        """Fill fractions at a time (s) of the interval, (size,); of a group the members' sum."""
        share = (time - self._interval.start) / self._interval.duration
        return np.asarray((1.0 - share) * self._start + share * self._end)

    @property
    def fills(self) -> bool:
        """Whether any unknown's fill changes on this rank."""
        return bool(np.any(self._start != self._end))

    def read(self, values: FloatArray) -> FloatArray:
        """(m, size) from flattened local arrays (m, cells), ghosts included; collective."""
        here = np.zeros((len(values), self.size))
        here[:, : self.count] = values[:, self._lead]
        self.exchange(here)
        return here

    def write(self, here: FloatArray, values: FloatArray) -> None:
        """Set the owned cells of flattened local arrays (m, cells) from (m, size)."""
        values[:, self._place] = here[:, self._of_cell]

    def exchange(self, here: FloatArray) -> None:
        """Overwrite the ghosts of (m, size) by their owners' values; collective."""
        if self.comm.size == 1:
            return
        rows = len(here)
        if rows not in self._ghosted:
            ghosts = self.number[self.count :].astype(PETSc.IntType)
            size = (rows * self.count, rows * self.total)
            self._ghosted[rows] = PETSc.Vec().createGhost(
                ghosts, size=size, bsize=rows, comm=self.comm
            )
        vector = self._ghosted[rows]
        vector.array[:] = here[:, : self.count].T.ravel()
        vector.ghostUpdate()
        with vector.localForm() as form:
            here[:, self.count :] = form.array.reshape(-1, rows)[self.count :].T

    def destroy(self) -> None:
        """Free PETSc's memory, which on several ranks nobody else does; collective."""
        for vector in self._ghosted.values():
            vector.destroy()
        self._ghosted = {}

    def _localised(self, pairs: Pairs, wanted: IntArray) -> tuple[Pairs, IntArray]:
        """Pairs that involve an own unknown, in local numbers; and the numbers of those, sorted.

        wanted -- numbers of unknowns that are needed here in any case
        """
        low, high = self.first, self.first + self.count
        ends = np.stack([pairs.first, pairs.second])
        kept = ((ends >= low) & (ends < high)).any(axis=0)
        ends = ends[:, kept]
        others = np.unique(np.concatenate([ends.ravel(), wanted]))
        others = others[(others < low) | (others >= high)]
        own = np.arange(low, high)
        local = np.empty(self.total, dtype=np.int32)  # half the memory, which pairs are most of
        local[own], local[others] = own - low, self.count + np.arange(len(others))
        first, second = local[ends]
        here = Pairs(
            first=first,
            second=second,
            high=pairs.high[:, kept],
            low=pairs.low[:, kept],
            mass=pairs.mass[kept],
            smooth=pairs.smooth[kept],
        )
        return here, np.concatenate([own, others])


def _touching(bed: ConservativeBed, own: Any) -> IntArray:
    """Positions of the moving cells whose lower faces or corners touch one of the `own` cells."""
    grid, cells = bed.grid, bed.interval.cells
    near = np.zeros(grid.cells, dtype=bool)
    near[cells[own]] = True
    near = near.reshape(grid.shape)
    for dim in range(grid.dimension):
        near = near | np.roll(near, 1, dim)
    return np.flatnonzero(near.ravel()[cells] & bed.moving)
