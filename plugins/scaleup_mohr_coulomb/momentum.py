"""One time step of momentum and mass, for two phases of given fraction, in 2-D or 3-D.

    rho (du/dt + u.grad u) = -grad p + div(2 eta E(u)) + (rho - rho_air) g,    div u = 0,
    rho = alpha rho_powder + (1 - alpha) rho_air,
    eta = max(eta_powder, eta_air) where alpha > 0, eta_air elsewhere,
    E(u) = (grad u + grad u^T)/2,

with the weight about the surface as in `surface_weight`.  The air's weight is left to its
hydrostatic pressure, which p leaves out: it vanishes at a free surface.

At the wall u.n = 0 and the powder slides with Coulomb friction against the wall's velocity w,
t = -mu_w p (u_t - w_t)/sqrt(|u_t - w_t|^2 + v_e^2); elsewhere the boundary is free of stress.

Taylor-Hood elements (quadratic velocity, linear pressure), Nitsche's method for u.n = 0, backward
Euler, one linear solve per step: the powder's viscosity, the wall friction and convection are taken
from the step before, so that the matrix stays symmetric.  Explicit convection alone would grow
wherever rho u^2 dt > 2 eta; the next term of its Taylor series, dt/2 u.grad(u.grad u) in the new
velocity (Lax-Wendroff in time), keeps it stable at any step.  A Newton tangent would expose the
growth of short waves that makes constant friction ill-posed, and diverges.
"""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from scaleup.contract import Material

from .block_solver import BlockSolver
from .element_shapes import ElementShapes, element_dofs
from .factors import SymmetricFactors
from .parameters import Discretisation
from .shared_matrix import Numbering
from .surface_weight import SurfaceWeight
from .velocity_terms import BodyForce, VelocityTerms
from .viscosity import Viscosity

# Nitsche's penalty on u.n, in units of eta/h, by dimension, and of rho h/dt.  The velocity's block
# is positive definite above 2 (p + 1)(p + d) h/b, p = 1 being the strain rate's degree and b the
# element's height over the wall: 12 h/b in 2-D and 16 h/b in space, where flat elements occur.
_NITSCHE_VISCOUS = {2: 20.0, 3: 60.0}
_NITSCHE_INERTIAL = 5.0
# Extra quadrature order at walls that the smoothed interface crosses.
_CUT_ORDER = 2
# Compressibility (1/Pa) that fixes the pressure's constant and lets L D L^T do without pivoting.
_COMPRESSIBILITY = 1.0e-9


class Momentum:
    """Solver for velocity and pressure at the end of a step.

    ``solution`` is a function on velocity x pressure, ``previous`` on the velocity's space;
    ``time_step`` an ngs.Parameter, s; ``wall`` the name of the boundary that is one, ``rough`` of
    the part of it with friction (a mirror plane has none).
    """

    def __init__(
        self,
        solution: Any,
        previous: Any,
        viscosity: Viscosity,
        fraction: Any,
        material: Material,
        numerics: Discretisation,
        time_step: Any,
        force: BodyForce,
        wall_velocity: Any,
        shapes: ElementShapes,
        surface_weight: SurfaceWeight | None = None,
        wall: str = ".*",
        rough: str = ".*",
    ) -> None:
        self._solution, self._previous, self._time_step = solution, previous, time_step
        self._force, self._shapes = force, shapes
        space, alpha, dt = solution.space, fraction, time_step
        mesh = space.mesh
        velocity = solution.components[0]
        (u, p), (v, q) = space.TnT()
        n, h = ngs.specialcf.normal(mesh.dim), ngs.specialcf.mesh_size
        rho = numerics.air_density + (material.bulk_density - numerics.air_density) * alpha
        bounded = ngs.IfPos(
            viscosity.field - numerics.air_viscosity, viscosity.field, numerics.air_viscosity
        )
        # not weighted by alpha: the powder's viscosity vanishes with its pressure, as alpha does
        eta = ngs.IfPos(alpha, bounded, numerics.air_viscosity)

        def strain_rate(w: Any) -> Any:
            return ngs.Sym(ngs.Grad(w))

        def tangential(w: Any) -> Any:
            return w - (w * n) * n

        slip = tangential(velocity - wall_velocity)
        slip_speed = ngs.sqrt(ngs.InnerProduct(slip, slip) + numerics.slip_speed**2)
        compression = ngs.IfPos(viscosity.pressure, viscosity.pressure, 0.0)
        wall_drag = (
            material.wall_friction * compression * alpha / slip_speed + numerics.air_viscosity / h
        )
        normal_penalty = _NITSCHE_VISCOUS[mesh.dim] * eta / h + _NITSCHE_INERTIAL * rho * h / dt

        self._constant = ngs.BilinearForm(space, symmetric=True)
        self._constant += (
            (0.0 if mesh.dim == 3 else numerics.grad_div) * ngs.div(u) * ngs.div(v)
            - p * ngs.div(v)
            - q * ngs.div(u)
            - _COMPRESSIBILITY * p * q
        ).Compile() * ngs.dx
        on_wall = ngs.ds(skeleton=True, definedon=mesh.Boundaries(wall), bonus_intorder=_CUT_ORDER)
        self._constant += (p * (v * n) + q * (u * n)).Compile() * on_wall
        self._constant.Assemble()

        self._matrix = ngs.BilinearForm(space, symmetric=True)
        self._matrix += (
            normal_penalty * (u * n) * (v * n)
            - 2.0 * eta * ((strain_rate(u) * n) * n) * (v * n)
            - 2.0 * eta * ((strain_rate(v) * n) * n) * (u * n)
        ).Compile() * on_wall
        on_rough = ngs.ds(
            skeleton=True,
            definedon=mesh.Boundaries(wall) * mesh.Boundaries(rough),
            bonus_intorder=_CUT_ORDER,
        )
        self._matrix += (
            wall_drag * ngs.InnerProduct(tangential(u), tangential(v))
        ).Compile() * on_rough
        self._load = ngs.LinearForm(space)
        self._load += (
            wall_drag * ngs.InnerProduct(wall_velocity, tangential(v))
        ).Compile() * on_rough
        self._matrix.Assemble()
        own = self._matrix.mat if mesh.comm.size == 1 else self._matrix.mat.local_mat
        self._within = VelocityTerms(space.components[0], own, shapes)
        self._surface_weight = surface_weight
        self._materials = ngs.CoefficientFunction((rho, eta)).Compile()
        self._air_density = numerics.air_density
        self._fraction = alpha
        self._grad_div = numerics.grad_div
        self._solver: Any
        if mesh.dim == 2:
            self._solver = SymmetricFactors(self._matrix.mat)
        else:
            unit = material.bulk_density * numerics.fine_size / numerics.time_step
            self._solver = BlockSolver(self._matrix, eta, rho, dt, unit)
            self._nodes = self._within.dofs[:, : shapes.values.shape[1]]
            self._vertices = element_dofs(space.components[1])
            self._numberings = tuple(Numbering(ngs.H1(mesh, order=order)) for order in (2, 1))

    @property
    def iterations(self) -> int:
        """Of the linear solver in the last step; 0 of a direct one."""
        return int(self._solver.iterations)

    def restrict(self, active: NDArray[Any]) -> NDArray[Any]:
        """Solve from now on in the elements ``active`` (flags) alone, in space; collective.

        Velocity is zero at all nodes that none of them has, pressure at all vertices that others
        have too.  Returns flags of the elements without such vertices, where nothing is lost.
        """
        quadratic, linear = self._numberings
        moving = quadratic.touched(self._nodes, active)
        pressed = ~linear.touched(self._vertices, ~active)
        self._solver.restrict(moving, pressed)
        self._within.wanted = moving[self._nodes].any(axis=1)
        conserving: NDArray[Any] = pressed[self._vertices].all(axis=1)
        return conserving

    def step(self) -> None:
        """Keep the velocity as the previous one and solve for the next, with its pressure."""
        self._previous.vec.data = self._solution.components[0].vec
        self._matrix.Assemble()
        self._matrix.mat.AsVector().data += self._constant.mat.AsVector()
        self._load.Assemble()
        shapes = self._shapes
        density, viscosity = np.moveaxis(shapes.sampled(self._materials), -1, 0)
        # in the plane grad-div acts in the air as well, which never changes
        dilated = self._grad_div * shapes.sampled(self._fraction) if shapes.dimension == 3 else None
        self._within.add(
            self._load.vec.FV().NumPy(),
            density,
            density - self._air_density,
            viscosity,
            dilated,
            self._previous.vec.FV().NumPy(),
            self._time_step.Get(),
            self._force,
        )
        if self._surface_weight is not None:
            self._surface_weight.add(
                self._load.vec.FV().NumPy(),
                self._within.dofs,
                self._previous.vec.FV().NumPy(),
                self._force,
            )
        self._solver.update()
        self._solver.solve(self._load.vec, self._solution.vec)
