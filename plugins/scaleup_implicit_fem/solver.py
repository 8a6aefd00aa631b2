"""Linear systems: matrices in PETSc, Krylov solvers, and an error where one does not converge."""

from __future__ import annotations

import math

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, diags

from scaleup.contract import FloatArray, InputError, RunError
from scaleup_implicit_fem import petsc_pairs
from scaleup_implicit_fem.unknowns import Unknowns

PREFIX = "implicit_fem_"
_MOST_ITERATIONS = 500
_RESTART = 60
_LEAST = 1e-15  # root mean square of a residual that is round-off, concentrations being about 1


class LinearSolver:
    """Solves A x = b on the unknowns of an interval; x and b hold a rank's own.

    Rows are divided by their diagonal, so that cells that hold next to nothing count like others.

    iterations -- done since the start
    """

    def __init__(
        self,
        unknowns: Unknowns,
        rows: csr_matrix,
        near: csr_matrix,
        tolerance: float,
        options: str,
    ):
        """Set up for a matrix of which `rows` (own, local) are this rank's; collective.

        near      -- rows of a matrix like it, whose incomplete factors are the preconditioner
        tolerance -- of the residual, as a share of the right side
        options   -- PETSc's, over the defaults
        """
        self.iterations = 0
        self._scale = 1.0 / rows.diagonal()
        scaling = diags(self._scale)
        self._matrix = distributed(unknowns, csr_matrix(scaling @ rows))
        self._x, self._b = self._matrix.createVecs()
        self._ksp = ksp = PETSc.KSP().create(unknowns.comm)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(_RESTART)
        ksp.getPC().setType(PETSc.PC.Type.BJACOBI)
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        least = _LEAST * math.sqrt(unknowns.total)
        ksp.setTolerances(rtol=tolerance, atol=least, max_it=_MOST_ITERATIONS)
        ksp.setOptionsPrefix(PREFIX)
        given = set_options(options)
        try:
            ksp.setFromOptions()
            self._direct = ksp.getType() == PETSc.KSP.Type.PREONLY
            ksp.setInitialGuessNonzero(not self._direct)
            self._near = self._matrix
            if not self._direct:
                self._near = distributed(unknowns, csr_matrix(scaling @ near))
            ksp.setOperators(self._matrix, self._near)
            ksp.setUp()
        except PETSc.Error as error:
            raise InputError(f"mixing.petsc_options = {options!r}: {_sentence(error)}") from error
        finally:
            for name in given:
                PETSc.Options(PREFIX).delValue(name)

    def destroy(self) -> None:
        """Free PETSc's memory, which on several ranks nobody else does; collective."""
        for each in (self._ksp, self._near, self._matrix, self._x, self._b):
            each.destroy()

    def set_diagonal(self, diagonal: FloatArray) -> None:
        """Replace the diagonal; a Krylov solver keeps its preconditioner. Collective."""
        self._b.array[:] = self._scale * diagonal
        self._matrix.setDiagonal(self._b)

    def solve(self, b: FloatArray, guess: FloatArray, what: str) -> FloatArray:
        """The solution x; collective.

        what -- is solved for, and when: for the error
        Raises RunError if the solver does not converge.
        """
        ksp = self._ksp
        self._b.array[:], self._x.array[:] = self._scale * b, guess
        ksp.solve(self._b, self._x)
        count, reason = ksp.getIterationNumber(), ksp.getConvergedReason()
        self.iterations += count
        if reason < 0:
            raise RunError(
                f"the linear solve for {what} did not converge in {count} iterations (PETSc's "
                f"reason is {reason}, the residual {ksp.getResidualNorm():.2g} of "
                f"{self._b.norm():.2g}); reduce mixing.courant, or choose another solver in "
                "mixing.petsc_options"
            )
        return np.array(self._x.array)


def distributed(unknowns: Unknowns, rows: csr_matrix) -> PETSc.Mat:
    """The AIJ matrix of which `rows`, (own, local), are this rank's; collective."""
    own, total, integer = unknowns.count, unknowns.total, PETSc.IntType
    renumbered = csr_matrix(
        (rows.data, unknowns.number[rows.indices], rows.indptr), shape=(own, total)
    )
    renumbered.sort_indices()
    parts = (renumbered.indptr.astype(integer), renumbered.indices.astype(integer))
    return PETSc.Mat().createAIJ(
        size=((own, total), (own, total)),
        csr=(*parts, renumbered.data),
        comm=unknowns.comm,
    )


def set_options(text: str) -> list[str]:
    """Put options such as "-ksp_type bcgs" under this plugin's prefix; returns their names."""
    options, pairs = PETSc.Options(PREFIX), petsc_pairs(text)
    for name, value in pairs:
        options.setValue(name, value)
    return [name for name, _ in pairs]


def _sentence(error: PETSc.Error) -> str:
    """The last of the lines that PETSc has on an error."""
    lines = [line for line in str(error).splitlines() if line.strip()]
    return f"PETSc says: {lines[-1].strip().removeprefix('[0] ')}" if lines else "PETSc refuses it"
