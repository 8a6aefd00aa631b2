"""PETSc's solvers of linear systems, and what is said when they fail."""

from __future__ import annotations

from typing import Any


class NotSolved(FloatingPointError):  # noqa: N818
    """A linear system was not solved, most likely because the flow runs away."""


def krylov_solver(matrix: Any, preconditioner: str, method: str = "preonly") -> Any:
    """A PETSc KSP."""
    from petsc4py import PETSc

    ksp = PETSc.KSP().create(matrix.getComm())
    ksp.setOperators(matrix)
    ksp.setType(method)
    ksp.getPC().setType(preconditioner)
    return ksp


def require_converged(ksp: Any, what: str) -> None:
    """Raise NotSolved unless the last solve converged."""
    if ksp.getConvergedReason() <= 0:
        raise NotSolved(
            f"The linear system of {what} was not solved in {ksp.getIterationNumber()} iterations "
            f"(residual {ksp.getResidualNorm():.2g}): halve flow.time_step."
        )
