"""Symmetric, positive definite systems of a scalar field, from sums over elements."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .block_solver import Numbering, PositiveSystem
from .element_matrix import ElementMatrix
from .element_shapes import element_dofs
from .factors import SymmetricFactors


class FieldSystem:
    """Solves for functions of a ``space`` on the mesh's simplices, at most quadratic; collective.

    ``dofs`` (n_elements, k) are the numbers of elements' unknowns, ``blocks`` (n_elements, k, k)
    what elements add to the matrix: to be filled before :meth:`update`.  Factorised in 2-D, by
    conjugate gradients on all ranks in space.
    """

    def __init__(self, space: Any) -> None:
        self._space = space
        self.dofs = element_dofs(space)
        self._matrix = ElementMatrix(self.dofs, space.ndof)
        self.blocks = self._matrix.blocks
        self._system: PositiveSystem | None = None
        self._numbering: Numbering | None = None
        self._factors: SymmetricFactors | None = None
        if space.mesh.dim == 2:
            values, columns, starts = self._matrix.share()
            rows = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
            self._sparse = ngs.la.SparseMatrixd.CreateFromCOO(
                rows.tolist(), columns.tolist(), values.tolist(), space.ndof, space.ndof
            )
            self._factors = SymmetricFactors(self._sparse)
            self._load, self._found = self._sparse.CreateRowVector(), self._sparse.CreateColVector()
        else:
            self._numbering = Numbering(space)

    def update(self) -> None:
        """Follow the blocks as they stand."""
        if self._factors is not None:
            self._sparse.AsVector().FV().NumPy()[:] = self._matrix.share()[0]
            self._factors.update()
        elif self._system is None:
            assert self._numbering is not None
            self._system = PositiveSystem(self._matrix.share, self._numbering)
        else:
            self._system.update()

    def solve(self, loads: NDArray[Any], start: NDArray[Any]) -> NDArray[Any]:
        """Coefficients (n_unknowns,) of the solution; ``loads`` (n_elements, k) of elements.

        Iteration, where there is one, begins at ``start`` (n_unknowns,).
        """
        load = np.bincount(self.dofs.ravel(), loads.ravel(), self._space.ndof)
        if self._factors is not None:
            self._load.FV().NumPy()[:] = load
            self._factors.solve(self._load, self._found)
            found: NDArray[Any] = self._found.FV().NumPy().copy()
            return found
        assert self._system is not None
        assert self._numbering is not None
        return self._system.solve(self._numbering.completed(load), start)
