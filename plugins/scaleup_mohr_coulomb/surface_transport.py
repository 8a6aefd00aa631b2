"""The free surface moved by the flow, with the area of powder that elements exchange."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numba
import numpy as np
from numpy.typing import NDArray

from .element_shapes import ElementShapes
from .field_system import FieldSystem
from .level_set import LevelSet


class Transport:
    """Least-squares Crank-Nicolson step of d phi/dt + u.grad phi = 0.

    phi^{n+1} minimises the integral of [(phi - phi^n)/dt + u.grad(phi + phi^n)/2]^2: for all s,

        int (phi^{n+1} - phi^n + dt/2 u.grad(phi^{n+1} + phi^n)) (s + dt/2 u.grad s) = 0.

    This is the streamline-upwind Petrov-Galerkin method with the parameter dt/2, its value at small
    Courant numbers, and has a symmetric, positive definite matrix.  u is the mid-step velocity, a
    coefficient function that the caller keeps up to date; the time step is an ngs.Parameter, s.
    """

    def __init__(
        self, level_set: Any, velocity: Any, time_step: Any, shapes: ElementShapes
    ) -> None:
        self._field, self._velocity, self._time_step = level_set.field, velocity, time_step
        self._shapes = shapes
        self._system = FieldSystem(level_set.space)

    def step(self) -> None:
        """Replace phi^n by phi^{n+1}."""
        system, shapes = self._system, self._shapes
        velocity = self._shapes.sampled(self._velocity)
        half = 0.5 * self._time_step.Get()
        field = self._field.vec.FV().NumPy()
        loads = np.empty(system.dofs.shape)
        for some, slopes in shapes.chunks():
            system.blocks[some], loads[some] = _squared(
                shapes.values,
                slopes,
                shapes.weights[some],
                half * velocity[some],
                field[system.dofs[some]],
            )
        system.update()
        field[:] = system.solve(loads, field)


@numba.njit(cache=True)
def _squared(
    values: NDArray[Any],
    slopes: NDArray[Any],
    weights: NDArray[Any],
    shift: NDArray[Any],
    old: NDArray[Any],
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Blocks (m, k, k) and loads (m, k) of a step, ``shift`` (m, q, dimension) being dt/2 u."""
    m, q, k, dim = slopes.shape
    blocks, loads = np.zeros((m, k, k)), np.zeros((m, k))
    test = np.empty(k)
    for e in range(m):
        for p in range(q):
            before = 0.0
            for i in range(k):
                along = 0.0
                for a in range(dim):
                    along += slopes[e, p, i, a] * shift[e, p, a]
                test[i] = values[p, i] + along
                before += (values[p, i] - along) * old[e, i]
            for i in range(k):
                factor = weights[e, p] * test[i]
                loads[e, i] += factor * before
                for j in range(i + 1):
                    blocks[e, i, j] += factor * test[j]
        for i in range(k):
            for j in range(i):
                blocks[e, j, i] = blocks[e, i, j]
    return blocks, loads


class SolenoidalVelocity:
    """The velocity without divergence, and without flux through the wall, nearest to another.

    ``field`` is (d psi/dy, -d psi/dx) of a cubic stream function psi that vanishes at the wall and
    minimises the integral of |(d psi/dy, -d psi/dx) - u|^2.  The momentum's velocity is free of
    divergence against linear pressures only: moved by it, a bed loses some 1e-5 of its area in
    every step.  For simply connected cross-sections.
    """

    def __init__(self, velocity: Any, mesh: Any) -> None:
        space = ngs.H1(mesh, order=3, dirichlet=".*")
        psi, s = space.TnT()
        matrix = ngs.BilinearForm(space, symmetric=True)
        matrix += ngs.grad(psi) * ngs.grad(s) * ngs.dx
        matrix.Assemble()
        self._inverse = matrix.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
        self._load = ngs.LinearForm(space)
        across = velocity[0] * ngs.grad(s)[1] - velocity[1] * ngs.grad(s)[0]
        self._load += across.Compile() * ngs.dx
        self.stream_function = ngs.GridFunction(space)
        slope = ngs.grad(self.stream_function)
        self.field = ngs.CoefficientFunction((slope[1], -slope[0]))

    def update(self) -> None:
        """Follow the other velocity, which its owner has changed."""
        self._load.Assemble()
        self.stream_function.vec.data = self._inverse * self._load.vec


class ConservingTransport:
    """:class:`Transport` by a :class:`SolenoidalVelocity`, and of the area that it carries.

    After the step vertices are shifted until each element holds

        A^{n+1} = A^n - dt int H(phi) u.n ds

    over its sides. What leaves an element enters its neighbour and nothing flows through the wall,
    so that the bed keeps its area.
    """

    def __init__(
        self,
        level_set: LevelSet,
        mover: SolenoidalVelocity,
        time_step: Any,
        shapes: ElementShapes,
    ) -> None:
        """``time_step`` is an ngs.Parameter, s."""
        self._level_set, self._mover, self._time_step = level_set, mover, time_step
        self._transport = Transport(level_set, mover.field, time_step, shapes)

    def step(self) -> None:
        """Replace phi^n by phi^{n+1}."""
        level_set, lattice = self._level_set, self._level_set.lattice
        before = level_set.lattice_values()
        self._transport.step()
        psi = lattice.sampled(self._mover.stream_function)
        outflow = lattice.outflow(before, level_set.lattice_values(), psi)
        level_set.hold(lattice.areas(before) - self._time_step.Get() * outflow)
