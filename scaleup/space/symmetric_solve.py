"""Symmetric positive definite systems on one rank: conjugate gradients with algebraic multigrid."""

from __future__ import annotations

from typing import Any

from scaleup.space.grid import FloatArray


class SymmetricSolver:
    """Solves one sparse system for several right sides, with PETSc, on the calling rank alone.

    matrix    -- symmetric positive definite, scipy's CSR format
    tolerance -- residual that is left, relative to the right side
    multigrid -- PETSc's preconditioner: "gamg" or "hypre"
    """

    def __init__(self, matrix: Any, tolerance: float, multigrid: str = "gamg", most: int = 2000):
        from petsc4py import PETSc

        index = PETSc.IntType
        csr = (matrix.indptr.astype(index), matrix.indices.astype(index), matrix.data)
        self._operator = PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)
        self._solver = PETSc.KSP().create(PETSc.COMM_SELF)
        self._solver.setOperators(self._operator)
        self._solver.setType("cg")
        self._solver.getPC().setType(multigrid)
        self._solver.setTolerances(rtol=tolerance, max_it=most)
        self._solution, self._load = self._operator.createVecs()

    def solve(self, right: FloatArray) -> tuple[FloatArray, bool]:
        """The solution, and whether the tolerance was met."""
        self._load.setArray(right)
        self._solver.solve(self._load, self._solution)
        return self._solution.getArray().copy(), self._solver.getConvergedReason() > 0

    def close(self) -> None:
        """Give the memory back at once: PETSc's objects outlive their last use otherwise."""
        for handle in (self._solver, self._operator, self._solution, self._load):
            handle.destroy()
