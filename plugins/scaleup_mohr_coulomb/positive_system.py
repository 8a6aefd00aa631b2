"""Conjugate gradients of PETSc, on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

from .krylov import krylov_solver, require_converged
from .shared_matrix import AssembledBlock, Numbering, Share

_RESIDUAL = 1.0e-8


class PositiveSystem:
    """Conjugate gradients for a symmetric, positive definite matrix in ranks' shares.

    The default preconditioner (ILU(0) on each rank) is for matrices near a mass matrix.
    """

    def __init__(
        self, share: Callable[[], Share], numbering: Numbering, preconditioner: str = "bjacobi"
    ) -> None:
        self._numbering = numbering
        self._block = AssembledBlock(share, numbering, numbering)
        self._ksp = krylov_solver(self._block.matrix, preconditioner, "cg")
        # the start may be that of a load many times larger
        self._ksp.setTolerances(rtol=_RESIDUAL, divtol=1e30, max_it=1000)
        self._ksp.setInitialGuessNonzero(True)
        self._right, self._left = self._block.matrix.createVecs()

    def update(self) -> None:
        """Follow the matrix as it stands; to be called before the first solve."""
        self._block.update()

    def solve(self, load: NDArray[Any], start: NDArray[Any]) -> NDArray[Any]:
        """Values of all local unknowns; ``load`` in ranks' shares, ``start`` as a first guess."""
        self._left.setArray(self._numbering.owned(self._numbering.completed(load)))
        self._right.setArray(self._numbering.owned(start))
        self._ksp.solve(self._left, self._right)
        require_converged(self._ksp, "the fluidity, a projection or the level set")
        return self._numbering.to_local(self._right.getArray())
