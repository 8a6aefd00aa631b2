"""Repeated factorisation of a matrix whose pattern stays the same."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs


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
