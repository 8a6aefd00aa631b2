"""Repeated factorisation of a matrix whose pattern stays the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .element_matrix import Share


class SymmetricFactors:
    """L D L^T of a symmetric NGSolve matrix; the order of elimination is found once.

    On one thread: NGSolve's factorisation starts as many as there are cores and lets them wait by
    spinning, which on matrices of a few thousand rows costs more than it gains (on two busy cores
    three quarters of a run), and sums in an order that differs from run to run.
    """

    iterations = 0

    def __init__(self, matrix: Any) -> None:
        ngs.SetNumThreads(1)
        self._matrix = matrix
        self.inverse: Any = None

    def update(self) -> None:
        """Factorise the matrix as it stands."""
        if self.inverse is None:
            self.inverse = self._matrix.Inverse(inverse="sparsecholesky")
        else:
            self.inverse.Update()

    def solve(self, load: Any, solution: Any) -> None:
        """Solution of matrix * solution = load (NGSolve vectors)."""
        solution.data = self.inverse * load


class FactoredSystem:
    """:class:`SymmetricFactors` of a matrix that one rank shares out alone, for arrays."""

    def __init__(self, share: Callable[[], Share]) -> None:
        self._share = share
        values, columns, starts = share()
        count = len(starts) - 1
        rows = np.repeat(np.arange(count), np.diff(starts))
        self._matrix = ngs.la.SparseMatrixd.CreateFromCOO(
            rows.tolist(), columns.tolist(), values.tolist(), count, count
        )
        self._factors = SymmetricFactors(self._matrix)
        self._load, self._found = self._matrix.CreateRowVector(), self._matrix.CreateColVector()

    def update(self) -> None:
        """Follow the matrix as it stands; to be called before the first solve."""
        values, _, _ = self._share()
        self._matrix.AsVector().FV().NumPy()[:] = values
        self._factors.update()

    def solve(self, load: NDArray[Any], _: NDArray[Any]) -> NDArray[Any]:
        """Solution (n_unknowns,) for a ``load``, without a guess."""
        self._load.FV().NumPy()[:] = load
        self._factors.solve(self._load, self._found)
        found: NDArray[Any] = self._found.FV().NumPy().copy()
        return found
