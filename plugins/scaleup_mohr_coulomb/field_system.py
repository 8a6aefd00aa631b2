"""Symmetric, positive definite systems of a scalar field, from sums over elements."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .conjugate_gradients import ConjugateGradients
from .element_matrix import ElementMatrix
from .element_shapes import element_dofs
from .positive_system import PositiveSystem
from .shared_matrix import Numbering


class FieldSystem:
    """Solves for functions of a ``space`` on the mesh's simplices, at most quadratic; collective.

    ``dofs`` (n_elements, k) are the numbers of elements' unknowns, ``blocks`` (n_elements, k, k)
    what elements add to the matrix: to be filled before :meth:`update`.  By conjugate gradients, in
    space on all ranks.
    """

    def __init__(self, space: Any) -> None:
        self._count = space.ndof
        self.dofs = element_dofs(space)
        matrix = ElementMatrix(self.dofs, self._count)
        self.blocks = matrix.blocks
        self._system: ConjugateGradients | PositiveSystem = (
            ConjugateGradients(matrix.share)
            if space.mesh.dim == 2
            else PositiveSystem(matrix.share, Numbering(space))
        )

    def update(self) -> None:
        """Follow the blocks as they stand."""
        self._system.update()

    def solve(self, loads: NDArray[Any], start: NDArray[Any]) -> NDArray[Any]:
        """Coefficients (n_unknowns,) of the solution; ``loads`` (n_elements, k) of elements.

        Iteration begins at ``start`` (n_unknowns,).
        """
        load = np.bincount(self.dofs.ravel(), loads.ravel(), self._count)
        return self._system.solve(load, start)
