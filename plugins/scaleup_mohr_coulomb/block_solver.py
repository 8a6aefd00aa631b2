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

Air far from the bed does not matter: what :meth:`BlockSolver.restrict` leaves out has no velocity
and no pressure.  That is Galerkin's method on subspaces: air flows freely in and out at their
border, where no pressure demands that it keeps its volume.
"""

from __future__ import annotations

import weakref
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .krylov import krylov_solver, require_converged
from .shared_matrix import AssembledBlock, Numbering, Share

_RELATIVE_RESIDUAL = 1.0e-7
_MOST_ITERATIONS = 400
_RESTART = 100


class BlockSolver:
    """Solver of a form on velocity x pressure; ``iterations`` is what the last solve took."""

    def __init__(
        self, form: Any, viscosity: Any, density: Any, time_step: Any, pressure_unit: float
    ) -> None:
        """``form``'s matrix has its pattern already."""
        space = form.space
        self._form, self._unit = form, pressure_unit
        pressure_space = space.components[1]
        p, q = pressure_space.TnT()
        mean_viscosity = ngs.GridFunction(ngs.L2(space.mesh, order=0))
        mean_viscosity.Set(1.0)
        self._follow_viscosity = lambda: mean_viscosity.Set(viscosity)
        self._mass = ngs.BilinearForm(pressure_space, symmetric=True)
        self._mass += (0.5 / mean_viscosity * p * q).Compile() * ngs.dx
        self._laplacian = ngs.BilinearForm(pressure_space, symmetric=True)
        reach = ngs.Integrate(1.0, space.mesh) ** (1.0 / space.mesh.dim)
        inertial = time_step / density
        self._laplacian += (
            inertial * (ngs.grad(p) * ngs.grad(q) + 1e-9 / reach**2 * p * q)
        ).Compile() * ngs.dx
        self._mass.Assemble()
        self._laplacian.Assemble()
        self._set_up()
        self.iterations = 0

    def _set_up(self, *nodes: NDArray[Any]) -> None:
        self._system = _BlockSystem(self._form, self._mass, self._laplacian, self._unit, *nodes)
        # a solver that calls Python must be gone before PETSc ends, which is after Python's exit
        self._end = weakref.finalize(self, self._system.destroy)

    def restrict(self, velocity_nodes: NDArray[Any], pressure_nodes: NDArray[Any]) -> None:
        """Solve from now on for these nodes (flags) alone, equal on all ranks that share one."""
        self._end()
        self._set_up(velocity_nodes, pressure_nodes)

    def update(self) -> None:
        """Follow the matrix, the viscosity and the time step as they stand."""
        self._follow_viscosity()
        self._mass.Assemble()
        self._laplacian.Assemble()
        self._system.update()

    def solve(self, load: Any, solution: Any) -> None:
        """Solution of matrix * solution = load (NGSolve vectors); begins at the solution given."""
        load.Cumulate()
        self.iterations = self._system.solve(load.FV().NumPy(), solution.FV().NumPy())


class _BlockSystem:
    """The blocks, and all that solves for them, of some nodes."""

    def __init__(
        self,
        form: Any,
        mass: Any,
        laplacian: Any,
        unit: float,
        velocity_nodes: NDArray[Any] | None = None,
        pressure_nodes: NDArray[Any] | None = None,
    ) -> None:
        from petsc4py import PETSc

        velocity_space, pressure_space = form.space.components
        self._n_velocity = n = velocity_space.ndof
        self._unit = unit
        self._u = u = Numbering(velocity_space, form.space.mesh.dim, velocity_nodes)
        self._p = p = Numbering(pressure_space, wanted=pressure_nodes)

        def whole() -> Share:
            return _csr(form)

        self._blocks = {
            AssembledBlock(whole, u, u): 1.0,
            AssembledBlock(whole, u, p, 0, n): unit,
            AssembledBlock(whole, p, u, n, 0): unit,
            AssembledBlock(whole, p, p, n, n): unit**2,
            AssembledBlock(lambda: _csr(mass), p, p): 1.0,
            AssembledBlock(lambda: _csr(laplacian), p, p): 1.0,
        }
        a, bt, b, c, *schur = (block.matrix for block in self._blocks)
        self._whole = PETSc.Mat().createNest([[a, bt], [b, c]], comm=u.comm)
        preconditioner = _LowerTriangle(a, b, *schur, unit)
        self._ksp = PETSc.KSP().create(u.comm)
        self._ksp.setOperators(self._whole)
        self._ksp.setType("fgmres")
        self._ksp.setGMRESRestart(_RESTART)
        self._ksp.setInitialGuessNonzero(True)
        self._ksp.setTolerances(rtol=_RELATIVE_RESIDUAL, max_it=_MOST_ITERATIONS)
        self._ksp.getPC().setType("python")
        self._ksp.getPC().setPythonContext(preconditioner)
        self._right, self._left = self._whole.createVecs()

    def destroy(self) -> None:
        for thing in (self._ksp, self._right, self._left, self._whole):
            thing.destroy()
        for block in self._blocks:
            block.matrix.destroy()

    def update(self) -> None:
        for block, factor in self._blocks.items():
            block.update(factor)
        self._whole.assemble()

    def solve(self, load: NDArray[Any], solution: NDArray[Any]) -> int:
        """Puts the solution in place of the guess; the number of iterations."""
        n, unit, u, p = self._n_velocity, self._unit, self._u, self._p
        self._left.setArray(np.concatenate([u.owned(load[:n]), unit * p.owned(load[n:])]))
        guess = np.concatenate([u.owned(solution[:n]), p.owned(solution[n:]) / unit])
        self._right.setArray(guess)
        self._ksp.solve(self._left, self._right)
        require_converged(self._ksp, "velocity and pressure")
        found = self._right.getArray()
        solution[:n] = u.to_local(found[: u.local_size])
        solution[n:] = unit * p.to_local(found[u.local_size :])
        return int(self._ksp.getIterationNumber())


class _LowerTriangle:
    """The block lower triangle as a PETSc preconditioner, see the module."""

    def __init__(self, a: Any, b: Any, mass: Any, laplacian: Any, unit: float) -> None:
        self._b, self._unit = b, unit
        self._velocity = krylov_solver(a, "hypre")
        self._viscous = krylov_solver(mass, "sor")
        self._inertial = krylov_solver(laplacian, "hypre")
        self._n = a.getLocalSize()[0]
        self._ru, self._yu = a.createVecs()
        self._rp, self._yp = mass.createVecs()
        self._rest = self._yp.duplicate()

    def destroy(self, _: Any = None) -> None:
        """Called by PETSc when the solver is destroyed."""
        for ksp in (self._velocity, self._viscous, self._inertial):
            ksp.destroy()

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


def _csr(form: Any) -> Share:
    """Of a form's matrix."""
    matrix = form.mat.local_mat if form.space.mesh.comm.size > 1 else form.mat
    values, columns, starts = matrix.CSR()
    return np.asarray(values), np.asarray(columns), np.asarray(starts).astype(np.int64)
