"""PETSc matrices whose entries are sums of what ranks' elements add."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray


class Numbering:
    """Which unknowns of a space this rank owns, and their numbers in a PETSc vector.

    ``blocks`` components that follow each other in NGSolve's vector are interlaced in PETSc's,
    whose rows are dealt out rank by rank.  Of the nodes those ``wanted`` (flags, equal on all ranks
    that share one) are numbered, by default all; others have the number -1, which PETSc leaves out.
    """

    def __init__(self, space: Any, blocks: int = 1, wanted: NDArray[Any] | None = None) -> None:
        comm = space.mesh.comm
        self.comm = petsc_communicator(space.mesh)
        self.blocks = blocks
        count = space.ndof
        nodes = count // blocks
        owned = np.ones(count, dtype=bool)
        if comm.size > 1:
            owned = np.fromiter(space.ParallelDofs().MasterDofs(), dtype=bool, count=count)
        here = owned[:nodes] if wanted is None else owned[:nodes] & wanted
        self.owned_nodes = np.flatnonzero(here)
        self.local_size = blocks * len(self.owned_nodes)
        first = 0
        if comm.size > 1:
            sizes = comm.mpi4py.allgather(len(self.owned_nodes))
            first = sum(sizes[: comm.rank])
        ids = np.zeros(count)
        for block in range(blocks):
            mine = block * nodes + self.owned_nodes
            ids[mine] = blocks * (first + np.arange(len(self.owned_nodes))) + block + 1
        self._exchange = ngs.GridFunction(space).vec
        self.ids = self.completed(ids).astype(np.int32) - 1
        # this rank's part of a PETSc vector, as places in NGSolve's
        self.places = (self.owned_nodes[:, None] + nodes * np.arange(blocks)).ravel()

    def completed(self, shares: NDArray[Any]) -> NDArray[Any]:
        """Values of all local unknowns, from what each rank adds to them."""
        self._exchange.FV().NumPy()[:] = shares
        self._exchange.SetParallelStatus(ngs.la.PARALLEL_STATUS.DISTRIBUTED)
        self._exchange.Cumulate()
        values: NDArray[Any] = self._exchange.FV().NumPy().copy()
        return values

    def touched(self, elements: NDArray[Any], flags: NDArray[Any]) -> NDArray[Any]:
        """Flags (n_unknowns,) of what belongs to an element, of whichever rank, with a flag.

        ``elements`` (n_elements, k) holds the numbers of this rank's elements' unknowns.
        """
        here = np.bincount(elements[flags].ravel(), minlength=len(self.ids))
        found: NDArray[Any] = self.completed(here) > 0.0
        return found

    def to_local(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of all local unknowns in NGSolve's order, from this rank's part of PETSc's."""
        owned = np.zeros(len(self.ids))
        owned[self.places] = values
        return self.completed(owned)

    def owned(self, values: NDArray[Any]) -> NDArray[Any]:
        """The part of PETSc's vector that is held here, from values equal on all ranks."""
        part: NDArray[Any] = values[self.places]
        return part


# Values, columns and row starts of the part of a matrix that this rank adds to.
Share = tuple[NDArray[Any], NDArray[Any], NDArray[Any]]


class AssembledBlock:
    """A PETSc matrix that follows some rows and columns of a matrix in ranks' shares.

    Their pattern is that of the first ``share`` for good.
    """

    def __init__(
        self,
        share: Callable[[], Share],
        rows: Numbering,
        columns: Numbering,
        row0: int = 0,
        column0: int = 0,
    ) -> None:
        from petsc4py import PETSc

        self._share = share
        _, column, starts = share()
        row = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) - row0
        column = column - column0
        inside = (row >= 0) & (row < len(rows.ids)) & (column >= 0) & (column < len(columns.ids))
        self._inside = np.flatnonzero(inside)
        in_row = np.bincount(row[inside], minlength=len(rows.ids))
        self._starts = np.concatenate([[0], np.cumsum(in_row)]).astype(np.int32)
        self._columns = columns.ids[column[inside]]
        self._rows = rows.ids
        self.matrix = PETSc.Mat().create(rows.comm)
        self.matrix.setSizes(((rows.local_size, None), (columns.local_size, None)))
        self.matrix.setBlockSizes(rows.blocks, columns.blocks)
        self.matrix.setType("aij")
        most = in_row[rows.places].astype(np.int32)
        here = np.minimum(most, columns.local_size)
        # rows at the border of two ranks' parts get entries from both
        self.matrix.setPreallocationNNZ((here, most) if rows.comm.size > 1 else here)
        self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)

    def update(self, factor: float = 1.0) -> None:
        """Take over the entries as they stand, times a factor; ranks' shares are summed."""
        values, _, _ = self._share()
        self.matrix.zeroEntries()
        self.matrix.setValuesIJV(
            self._starts, self._columns, factor * values[self._inside], addv=True, rowmap=self._rows
        )
        self.matrix.assemble()


def petsc_communicator(mesh: Any) -> Any:
    """The ranks of a mesh, for PETSc."""
    from mpi4py import MPI

    return mesh.comm.mpi4py if mesh.comm.size > 1 else MPI.COMM_SELF
