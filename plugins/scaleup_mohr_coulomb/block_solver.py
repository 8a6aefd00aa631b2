"""Iterative solution of one step's momentum and mass on any number of ranks, for meshes in space.

NGSolve assembles on a mesh that it has distributed; PETSc solves.  With A the velocity's block, B
the divergence and C the (tiny) compressibility, the matrix of a step is [[A, B^T], [B, -C]].
Flexible GMRES, preconditioned by the block lower triangle

    y_u = A~^-1 r_u,     y_p = -S~^-1 (r_p - B y_u),

where A~^-1 is one V-cycle of BoomerAMG (hypre) on the velocity, whose components are kept apart,
and S~^-1 = M_p(1/2 eta)^-1 + K_p(dt/rho)^-1 the inverse of Cahouet & Chabard (1988), Int. J. Numer.
Meth. Fluids 8, 869: the pressure's mass matrix weighted by the viscosity (symmetric Gauss-Seidel)
for the viscous part, its Laplacian (BoomerAMG) for the inertial one.  Pressures are solved for in
units of ``pressure_unit`` times velocity, so that one norm weighs forces and divergence alike.  A
grad-div term as large as the air's viscosity would spoil S~: with it the iterations grow with the
mesh.

NGSolve leaves the first rank of a distributed mesh without elements: N ranks share it as N - 1.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

_RELATIVE_RESIDUAL = 1.0e-7
_POSITIVE_RESIDUAL = 1.0e-8
_MOST_ITERATIONS = 400
_RESTART = 100


class NotSolved(FloatingPointError):  # noqa: N818
    """A linear system was not solved, most likely because the flow runs away."""


class Numbering:
    """Which unknowns of a space this rank owns, and their numbers in a PETSc vector.

    ``blocks`` components that follow each other in NGSolve's vector are interlaced in PETSc's,
    whose rows are dealt out rank by rank.
    """

    def __init__(self, space: Any, blocks: int = 1) -> None:
        comm = space.mesh.comm
        self.comm = petsc_communicator(space.mesh)
        self.blocks = blocks
        count = space.ndof
        nodes = count // blocks
        owned = np.ones(count, dtype=bool)
        if comm.size > 1:
            owned = np.fromiter(space.ParallelDofs().MasterDofs(), dtype=bool, count=count)
        self.owned_nodes = np.flatnonzero(owned[:nodes])
        self.local_size = blocks * len(self.owned_nodes)
        first = 0
        if comm.size > 1:
            sizes = comm.mpi4py.allgather(len(self.owned_nodes))
            first = sum(sizes[: comm.rank])
        ids = np.zeros(count)
        for block in range(blocks):
            mine = block * nodes + self.owned_nodes
            ids[mine] = blocks * (first + np.arange(len(self.owned_nodes))) + block
        self._exchange = ngs.GridFunction(space).vec
        self.ids = self.completed(ids).astype(np.int32)
        # this rank's part of a PETSc vector, as places in NGSolve's
        self.places = (self.owned_nodes[:, None] + nodes * np.arange(blocks)).ravel()

    def completed(self, shares: NDArray[Any]) -> NDArray[Any]:
        """Values of all local unknowns, from what each rank adds to them."""
        self._exchange.FV().NumPy()[:] = shares
        self._exchange.SetParallelStatus(ngs.la.PARALLEL_STATUS.DISTRIBUTED)
        self._exchange.Cumulate()
        values: NDArray[Any] = self._exchange.FV().NumPy().copy()
        return values

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


class PositiveSystem:
    """Conjugate gradients for a symmetric, positive definite matrix in ranks' shares.

    The default preconditioner (ILU(0) on each rank) is for matrices near a mass matrix.
    """

    def __init__(
        self, share: Callable[[], Share], numbering: Numbering, preconditioner: str = "bjacobi"
    ) -> None:
        self._numbering = numbering
        self._block = AssembledBlock(share, numbering, numbering)
        self._ksp = _solver(self._block.matrix, preconditioner, "cg")
        # the start may be that of a load many times larger
        self._ksp.setTolerances(rtol=_POSITIVE_RESIDUAL, divtol=1e30, max_it=1000)
        self._ksp.setInitialGuessNonzero(True)
        self._right, self._left = self._block.matrix.createVecs()

    def update(self) -> None:
        """Follow the matrix as it stands; to be called before the first solve."""
        self._block.update()

    def solve(self, load: NDArray[Any], start: NDArray[Any]) -> NDArray[Any]:
        """Values of all local unknowns; ranks' ``load`` is summed, ``start`` begins the iteration."""
        self._left.setArray(self._numbering.owned(self._numbering.completed(load)))
        self._right.setArray(self._numbering.owned(start))
        self._ksp.solve(self._left, self._right)
        _require_converged(self._ksp, "a filter, a projection or the level set")
        return self._numbering.to_local(self._right.getArray())


class BlockSolver:
    """Solver of a form on velocity x pressure; ``iterations`` is what the last solve took."""

    def __init__(
        self, form: Any, viscosity: Any, density: Any, time_step: Any, pressure_unit: float
    ) -> None:
        space = form.space
        self._form, self._unit = form, pressure_unit
        velocity_space, pressure_space = space.components
        self._n_velocity = velocity_space.ndof
        p, q = pressure_space.TnT()
        mean_viscosity = ngs.GridFunction(ngs.L2(space.mesh, order=0))
        self._follow_viscosity = lambda: mean_viscosity.Set(viscosity)
        self._mass = ngs.BilinearForm(pressure_space, symmetric=True)
        self._mass += (0.5 / mean_viscosity * p * q).Compile() * ngs.dx
        self._laplacian = ngs.BilinearForm(pressure_space, symmetric=True)
        reach = ngs.Integrate(1.0, space.mesh) ** (1.0 / space.mesh.dim)
        inertial = time_step / density
        self._laplacian += (
            inertial * (ngs.grad(p) * ngs.grad(q) + 1e-9 / reach**2 * p * q)
        ).Compile() * ngs.dx
        self._blocks: list[AssembledBlock] = []
        self._ksp: Any = None
        self.iterations = 0

    def _number(self) -> None:
        velocity_space, pressure_space = self._form.space.components
        self._u = u = Numbering(velocity_space, self._form.space.mesh.dim)
        self._p = p = Numbering(pressure_space)
        n = self._n_velocity

        def whole() -> Share:
            return _csr(self._form)

        self._blocks = [
            AssembledBlock(whole, u, u),
            AssembledBlock(whole, u, p, 0, n),
            AssembledBlock(whole, p, u, n, 0),
            AssembledBlock(whole, p, p, n, n),
        ]
        self._schur_blocks = [
            AssembledBlock(lambda: _csr(self._mass), p, p),
            AssembledBlock(lambda: _csr(self._laplacian), p, p),
        ]

    def _prepare(self) -> None:
        from petsc4py import PETSc

        a, bt, b, c = (block.matrix for block in self._blocks)
        mass, laplacian = (block.matrix for block in self._schur_blocks)
        whole = PETSc.Mat().createNest([[a, bt], [b, c]], comm=self._u.comm)
        self._preconditioner = _LowerTriangle(a, b, mass, laplacian, self._unit)
        self._ksp = PETSc.KSP().create(self._u.comm)
        self._ksp.setOperators(whole)
        self._ksp.setType("fgmres")
        self._ksp.setGMRESRestart(_RESTART)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.setTolerances(rtol=_RELATIVE_RESIDUAL, max_it=_MOST_ITERATIONS)
        self._ksp.getPC().setType("python")
        self._ksp.getPC().setPythonContext(self._preconditioner)
        self._right, self._left = whole.createVecs()
        # a solver that calls Python must be gone before PETSc ends, which is after Python's exit
        weakref.finalize(self, self._ksp.destroy)

    def update(self) -> None:
        """Follow the matrix, the viscosity and the time step as they stand."""
        self._follow_viscosity()
        self._mass.Assemble()
        self._laplacian.Assemble()
        if not self._blocks:
            self._number()
        unit = self._unit
        for block, factor in zip(self._blocks, (1.0, unit, unit, unit**2), strict=True):
            block.update(factor)
        for block in self._schur_blocks:
            block.update()
        if self._ksp is None:
            self._prepare()

    def solve(self, load: Any, solution: Any) -> None:
        """Solution of matrix * solution = load (NGSolve vectors); begins at the solution given."""
        load.Cumulate()
        n, unit = self._n_velocity, self._unit
        values, start = load.FV().NumPy(), solution.FV().NumPy()
        u, p = self._u, self._p
        self._left.setArray(np.concatenate([u.owned(values[:n]), unit * p.owned(values[n:])]))
        self._right.setArray(np.concatenate([u.owned(start[:n]), p.owned(start[n:]) / unit]))
        self._ksp.solve(self._left, self._right)
        _require_converged(self._ksp, "velocity and pressure")
        self.iterations = self._ksp.getIterationNumber()
        found = self._right.getArray()
        start[:n] = u.to_local(found[: u.local_size])
        start[n:] = unit * p.to_local(found[u.local_size :])


class _LowerTriangle:
    """The block lower triangle as a PETSc preconditioner, see the module."""

    def __init__(self, a: Any, b: Any, mass: Any, laplacian: Any, unit: float) -> None:
        self._b, self._unit = b, unit
        self._velocity = _solver(a, "hypre")
        self._viscous = _solver(mass, "sor")
        self._inertial = _solver(laplacian, "hypre")
        self._n = a.getLocalSize()[0]
        self._ru, self._yu = a.createVecs()
        self._rp, self._yp = mass.createVecs()
        self._rest = self._yp.duplicate()

    def apply(self, _: Any, residual: Any, result: Any) -> None:
        """Called by PETSc."""
        values = residual.getArray(readonly=True)
        self._ru.setArray(values[: self._n])
        self._rp.setArray(values[self._n :])
        self._velocity.solve(self._ru, self._yu)
        self._b.mult(self._yu, self._rest)
        self._rp.axpy(-1.0, self._rest)
        self._viscous.solve(self._rp, self._yp)
        self._inertial.solve(self._rp, self._rest)
        self._yp.axpy(1.0, self._rest)
        self._yp.scale(-1.0 / self._unit**2)
        result.setArray(np.concatenate([self._yu.getArray(), self._yp.getArray()]))


def petsc_communicator(mesh: Any) -> Any:
    """The ranks of a mesh, for PETSc."""
    from mpi4py import MPI

    return mesh.comm.mpi4py if mesh.comm.size > 1 else MPI.COMM_SELF


def _csr(form: Any) -> Share:
    """Of a form's matrix."""
    matrix = form.mat.local_mat if form.space.mesh.comm.size > 1 else form.mat
    values, columns, starts = matrix.CSR()
    return np.asarray(values), np.asarray(columns), np.asarray(starts).astype(np.int64)


def _solver(matrix: Any, preconditioner: str, method: str = "preonly") -> Any:
    from petsc4py import PETSc

    ksp = PETSc.KSP().create(matrix.getComm())
    ksp.setOperators(matrix)
    ksp.setType(method)
    ksp.getPC().setType(preconditioner)
    return ksp


def _require_converged(ksp: Any, what: str) -> None:
    if ksp.getConvergedReason() <= 0:
        raise NotSolved(
            f"The linear system of {what} was not solved in {ksp.getIterationNumber()} iterations "
            f"(residual {ksp.getResidualNorm():.2g}): halve flow.time_step."
        )
