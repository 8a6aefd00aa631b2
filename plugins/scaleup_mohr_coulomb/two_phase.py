"""Two-phase flow of a powder bed and a light air in a rotating cross-section.

On the whole vessel, with alpha the powder fraction of the level set phi,

    rho (du/dt + u.grad u) = -grad p + div(2 eta E(u)) + rho g,    div u = 0,
    d phi/dt + u.grad phi = 0,    E(u) = (grad u + grad u^T)/2,
    rho = alpha rho_powder + (1 - alpha) rho_air,
    eta = alpha max(eta_powder, eta_air) + (1 - alpha) eta_air,

in the lab frame: the wall moves at w = omega x r.  At the wall u.n = 0 and the powder slides with
Coulomb friction, t = -mu_w p (u_t - w_t)/sqrt(|u_t - w_t|^2 + v_e^2).

Taylor-Hood elements (quadratic velocity, linear pressure), backward Euler, one linear solve per
step: the powder's viscosity, the wall friction and convection are taken from the step before, so
that the matrix stays symmetric.  A Newton tangent would expose the growth of short waves that
makes constant friction ill-posed, and diverges.  Constant friction needs a length: the viscosity
sees shear rate and pressure through a filter of length l (:attr:`Discretisation.filter_length`),

    int (alpha + 1e-3) (g s + l^2 grad g.grad s) = int (alpha + 1e-3) sqrt(2 E:E) s.
"""

from __future__ import annotations

import math
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from scaleup.api import Material

from .factors import SymmetricFactors
from .level_set import LevelSet, Transport
from .mesh import farthest_wall
from .parameters import Discretisation, Drive
from .rheology import Strength, effective_viscosity, predicted_shear_rate

# Extra quadrature order for elements that the smoothed interface crosses.
_CUT_CELL_ORDER = 2
# Nitsche's penalty on u.n, in units of eta/h and of rho h/dt.
_NITSCHE_VISCOUS = 20.0
_NITSCHE_INERTIAL = 5.0
# Compressibility (1/Pa) that fixes the pressure's constant and lets L D L^T do without pivoting.
_COMPRESSIBILITY = 1.0e-9
# Weight of the air in the filter: enough to define it there, too little to dilute the powder.
_FILTER_AIR_WEIGHT = 1.0e-3
# Speed, in units of free fall across the vessel, that no bed reaches.
_ABSURD_SPEED = 3.0


class FlowDiverged(FloatingPointError):  # noqa: N818
    """The time stepping has left the reach of the method; the message says what to change."""


class TwoPhaseFlow:
    """A powder bed that starts as a plane, rigidly rotating bed and is advanced by :meth:`step`.

    Attributes: ``time`` (s since the bed was level and the vessel started), ``steps``,
    ``velocity`` (VectorH1, order 2, m/s), ``pressure`` (H1, order 1, Pa, zero in the air) and
    ``level_set`` (:class:`LevelSet`, m).
    """

    def __init__(
        self,
        mesh: Any,
        material: Material,
        drive: Drive,
        discretisation: Discretisation,
    ) -> None:
        self.mesh = mesh
        self.material = material
        self.drive = drive
        self.discretisation = discretisation
        self.radius = farthest_wall(mesh)
        self.time = discretisation.start_angle / drive.angular_velocity
        self.steps = 0
        self._area_gained = self._area_moved = 0.0

        self.level_set = LevelSet(mesh, discretisation.interface_half_width)
        self.level_set.set_plane(drive.bed_area, discretisation.start_angle)
        self._velocity_space = ngs.VectorH1(mesh, order=2)
        self._space = self._velocity_space * ngs.H1(mesh, order=1)
        self._solution = ngs.GridFunction(self._space)
        self.velocity, self.pressure = self._solution.components
        self._previous = ngs.GridFunction(self._velocity_space)
        omega = drive.angular_velocity
        self._wall_velocity = ngs.CoefficientFunction((-omega * ngs.y, omega * ngs.x))
        self.velocity.Set(self._wall_velocity)
        depth = ngs.IfPos(self.level_set.field, self.level_set.field, 0.0)
        self.pressure.Set(material.bulk_density * drive.gravity * depth)

        self._build_viscosity()
        self._build_momentum()
        self._transport = Transport(
            self.level_set, 0.5 * (self.velocity + self._previous), discretisation.time_step
        )

    def _build_viscosity(self) -> None:
        """Filter of shear rate and pressure, and the powder's viscosity on its fixed point."""
        mesh, numerics, alpha = self.mesh, self.discretisation, self.level_set.fraction
        space = ngs.H1(mesh, order=1)
        g, s = space.TnT()
        self._shear_rate, self._filtered_pressure = ngs.GridFunction(space), ngs.GridFunction(space)
        strain_rate = ngs.Sym(ngs.Grad(self.velocity))
        shear_rate = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
        weight = alpha + _FILTER_AIR_WEIGHT
        self._filter = ngs.BilinearForm(space, symmetric=True)
        self._filter += (
            weight * (g * s + numerics.filter_length**2 * ngs.grad(g) * ngs.grad(s))
        ).Compile() * ngs.dx
        self._filter_factors = SymmetricFactors(self._filter)
        self._shear_rate_load, self._pressure_load = ngs.LinearForm(space), ngs.LinearForm(space)
        cut_cells = ngs.dx(bonus_intorder=_CUT_CELL_ORDER)
        self._shear_rate_load += (weight * shear_rate * s).Compile() * cut_cells
        self._pressure_load += (weight * self.pressure * s).Compile() * ngs.dx

        strength = Strength.of(self.material)
        tau_y = strength(self._shear_rate, self._filtered_pressure)
        self._viscosity = ngs.GridFunction(ngs.L2(mesh, order=1))
        expected = predicted_shear_rate(
            self._shear_rate,
            self._viscosity * self._shear_rate,
            tau_y,
            numerics.time_step / (self.material.bulk_density * numerics.predictor_length**2),
            numerics.predictor_threshold,
        )
        self._next_viscosity = effective_viscosity(
            strength(expected, self._filtered_pressure), expected, numerics.creep_rate
        ).Compile()
        self._projected_viscosity = ngs.GridFunction(self._viscosity.space)
        self._apply_filter()
        self._viscosity.Set(effective_viscosity(tau_y, self._shear_rate, numerics.creep_rate))

    def _build_momentum(self) -> None:
        """The weak form of momentum and mass, with Nitsche's method at the wall."""
        numerics, material = self.discretisation, self.material
        alpha, dt = self.level_set.fraction, numerics.time_step
        (u, p), (v, q) = self._space.TnT()
        old = self._previous
        n, h = ngs.specialcf.normal(2), ngs.specialcf.mesh_size
        rho = numerics.air_density + (material.bulk_density - numerics.air_density) * alpha
        bounded = ngs.IfPos(
            self._viscosity - numerics.air_viscosity, self._viscosity, numerics.air_viscosity
        )
        eta = alpha * bounded + (1.0 - alpha) * numerics.air_viscosity
        gravity = ngs.CoefficientFunction((0.0, -self.drive.gravity))

        def strain_rate(w: Any) -> Any:
            return ngs.Sym(ngs.Grad(w))

        def tangential(w: Any) -> Any:
            return w - (w * n) * n

        slip = tangential(self.velocity - self._wall_velocity)
        slip_speed = ngs.sqrt(ngs.InnerProduct(slip, slip) + numerics.slip_speed**2)
        pressure = self._filtered_pressure
        compression = ngs.IfPos(pressure, pressure, 0.0)
        wall_drag = (
            material.wall_friction * compression * alpha / slip_speed + numerics.air_viscosity / h
        )
        normal_penalty = _NITSCHE_VISCOUS * eta / h + _NITSCHE_INERTIAL * rho * h / dt

        self._constant = ngs.BilinearForm(self._space, symmetric=True)
        self._constant += (
            numerics.grad_div * ngs.div(u) * ngs.div(v)
            - p * ngs.div(v)
            - q * ngs.div(u)
            - _COMPRESSIBILITY * p * q
        ).Compile() * ngs.dx
        wall = ngs.ds(skeleton=True, bonus_intorder=_CUT_CELL_ORDER)
        self._constant += (p * (v * n) + q * (u * n)).Compile() * wall
        self._constant.Assemble()

        interior = ngs.dx(bonus_intorder=_CUT_CELL_ORDER)
        self._matrix = ngs.BilinearForm(self._space, symmetric=True)
        self._matrix += (
            rho / dt * ngs.InnerProduct(u, v)
            + 2.0 * eta * ngs.InnerProduct(strain_rate(u), ngs.Grad(v))
        ).Compile() * interior
        self._matrix += (
            normal_penalty * (u * n) * (v * n)
            - 2.0 * eta * ((strain_rate(u) * n) * n) * (v * n)
            - 2.0 * eta * ((strain_rate(v) * n) * n) * (u * n)
            + wall_drag * ngs.InnerProduct(tangential(u), tangential(v))
        ).Compile() * wall
        self._load = ngs.LinearForm(self._space)
        self._load += (
            rho * ngs.InnerProduct(gravity + old / dt - ngs.Grad(old) * old, v)
        ).Compile() * interior
        self._load += (
            wall_drag * ngs.InnerProduct(self._wall_velocity, tangential(v))
        ).Compile() * wall
        self._factors = SymmetricFactors(self._matrix)
        deep_air = ngs.IfPos(-self.level_set.field - numerics.interface_half_width, 1.0, 0.0)
        self._air_pressure = ngs.CoefficientFunction((deep_air, deep_air * self.pressure))

    def step(self) -> None:
        """Advance by one time step.

        1. Filter shear rate and pressure; 2. update the powder's viscosity; 3. solve for velocity
        and pressure, the pressure being zero on average in the air; 4. move the level set and
        restore the bed's area by a uniform shift of its surface.
        """
        numerics = self.discretisation
        self._previous.vec.data = self.velocity.vec
        self._apply_filter()
        self._projected_viscosity.Set(self._next_viscosity)
        self._viscosity.vec.data = self._projected_viscosity.vec
        self._matrix.Assemble()
        self._matrix.mat.AsVector().data += self._constant.mat.AsVector()
        self._load.Assemble()
        self._factors.update()
        self._solution.vec.data = self._factors.inverse * self._load.vec
        self._check_speed()
        air_area, air_pressure = ngs.Integrate(self._air_pressure, self.mesh)
        self.pressure.vec.FV().NumPy()[:] -= air_pressure / air_area

        self._transport.step()
        if self.steps % numerics.redistance_every == 0:
            self.level_set.redistance()
        self._restore_area()
        self.time += numerics.time_step
        self.steps += 1

    def _apply_filter(self) -> None:
        self._filter.Assemble()
        self._shear_rate_load.Assemble()
        self._pressure_load.Assemble()
        self._filter_factors.update()
        inverse = self._filter_factors.inverse
        self._shear_rate.vec.data = inverse * self._shear_rate_load.vec
        self._filtered_pressure.vec.data = inverse * self._pressure_load.vec
        shear_rate = self._shear_rate.vec.FV().NumPy()
        np.maximum(shear_rate, 0.0, out=shear_rate)

    def _restore_area(self) -> None:
        lost = self.level_set.restore_area(self.drive.bed_area)
        self._area_gained += lost
        self._area_moved += abs(lost)

    def _check_speed(self) -> None:
        speed = float(np.abs(self.velocity.vec.FV().NumPy()).max())
        limit = _ABSURD_SPEED * math.sqrt(4.0 * self.drive.gravity * self.radius)
        if not speed < limit:
            raise FlowDiverged(
                f"The powder reached {speed:.3g} m/s at t = {self.time:.4g} s (step {self.steps}), "
                f"beyond {limit:.3g} m/s, thrice the speed of free fall across the vessel: halve "
                f"the time step ({self.discretisation.time_step:.3g} s) or the filter length "
                f"({self.discretisation.filter_length:.3g} m)."
            )

    @property
    def area_correction(self) -> float:
        """Sum over the run of |area restored per step|, relative to the bed."""
        return self._area_moved / self.drive.bed_area

    @property
    def net_area_correction(self) -> float:
        """Sum over the run of the area restored per step, relative to the bed."""
        return self._area_gained / self.drive.bed_area

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs to go on from here, as arrays of their own."""
        counters = (self.time, self.steps, self._area_gained, self._area_moved)
        return {
            "solution": self._solution.vec.FV().NumPy().copy(),
            "level_set": self.level_set.field.vec.FV().NumPy().copy(),
            "viscosity": self._viscosity.vec.FV().NumPy().copy(),
            "counters": np.array(counters, dtype=float),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a :meth:`state` of a flow on the same mesh with the same parameters."""
        fields = {
            "solution": self._solution,
            "level_set": self.level_set.field,
            "viscosity": self._viscosity,
        }
        for name, field in fields.items():
            values = field.vec.FV().NumPy()
            if state[name].shape != values.shape:
                raise ValueError(
                    f"state[{name!r}] has {state[name].size} values: this mesh needs {values.size}"
                )
            values[:] = state[name]
        self.time, steps, self._area_gained, self._area_moved = state["counters"].tolist()
        self.steps = int(steps)
