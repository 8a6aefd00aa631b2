"""Two-phase flow of a powder bed and a light air in a rotating cross-section.

On the whole vessel, with alpha the powder fraction of the level set phi, velocity and pressure obey
the equations of `momentum` in the lab frame, where the wall moves at w = omega x r, and

    d phi/dt + u.grad phi = 0.
"""

from __future__ import annotations

import math
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from scaleup.contract import Material

from .element_shapes import ElementShapes, element_dofs
from .level_set import LevelSet, SignedDistance
from .mesh import farthest_wall
from .momentum import Momentum
from .parameters import Discretisation, Drive, Rheology
from .rheology import Strength
from .surface_transport import ConservingTransport, SolenoidalVelocity
from .surface_weight import SurfaceWeight
from .viscosity import Viscosity

# Creep's stress at four fifths of the friction converges by a factor of two thirds in each.
_SETTLING_STEPS = 20


class FlowDiverged(FloatingPointError):  # noqa: N818
    """The time stepping has left the reach of the method; the message says what to change."""


class TwoPhaseFlow:
    """A powder bed that at first turns rigidly with the vessel, advanced by :meth:`step`.

    Attributes: ``time`` (s since the bed was level and the vessel started, or since it had the
    surface given), ``steps``, ``velocity`` (VectorH1, order 2, m/s), ``pressure`` (H1, order 1,
    Pa, zero in the air) and ``level_set`` (:class:`LevelSet`, m).
    """

    def __init__(
        self,
        mesh: Any,
        material: Material,
        drive: Drive,
        discretisation: Discretisation,
        rheology: Rheology | None = None,
        surface: SignedDistance | None = None,
        rough: str = ".*",
    ) -> None:
        """``surface`` (m, positive in powder) is the bed's at first, None for the drum's plane;
        ``rough`` names the part of the wall with friction.
        """
        self.mesh = mesh
        self.material = material
        self.drive = drive
        self.discretisation = discretisation
        self.radius = farthest_wall(mesh)
        self.time = 0.0
        self.steps = 0
        self._area_moved = self._area_drained = 0.0

        self.level_set = LevelSet(mesh, discretisation.interface_half_width)
        if surface is None:
            self.time = discretisation.start_angle / drive.angular_velocity
            self.level_set.set_plane(drive.bed_area, discretisation.start_angle)
        else:
            self.level_set.set_surface(drive.bed_area, surface)
        velocity_space = ngs.VectorH1(mesh, order=2)
        self._solution = ngs.GridFunction(velocity_space * ngs.H1(mesh, order=1))
        self.velocity, self.pressure = self._solution.components
        previous = ngs.GridFunction(velocity_space)
        omega = drive.angular_velocity
        wall_velocity = ngs.CoefficientFunction((-omega * ngs.y, omega * ngs.x))
        self.velocity.Set(wall_velocity)
        self._rest_under_weight()

        alpha = self.level_set.fraction
        self._strength = Strength.of(material, rheology or Rheology())
        self._step_length = ngs.Parameter(discretisation.time_step)
        shapes = self._shapes = ElementShapes(mesh)
        self._nodes = element_dofs(self.level_set.space)
        self._weight = SurfaceWeight(
            self.level_set.field,
            discretisation.interface_half_width,
            material.bulk_density - discretisation.air_density,
            ngs.CoefficientFunction((0.0, -drive.gravity)),
            shapes,
        )
        self._viscosity = Viscosity(
            self.velocity,
            self.pressure - self._weight.excess,
            alpha,
            self._strength,
            material.bulk_density,
            discretisation,
            self._step_length,
            self.level_set.space,
            shapes,
        )
        self._momentum = Momentum(
            self._solution,
            previous,
            self._viscosity,
            alpha,
            material,
            discretisation,
            self._step_length,
            force=lambda points, velocity: np.array((0.0, -drive.gravity)),
            wall_velocity=wall_velocity,
            shapes=shapes,
            surface_weight=self._weight,
            rough=rough,
        )
        self._mover = SolenoidalVelocity(0.5 * (self.velocity + previous), mesh)
        self._transport = ConservingTransport(
            self.level_set, self._mover, self._step_length, shapes
        )
        # beyond the elements that the interface crosses, where linear pressures reach into the air
        beyond = discretisation.interface_half_width + discretisation.fine_size
        deep_air = ngs.IfPos(-self.level_set.field - beyond, 1.0, 0.0)
        self._air_pressure = ngs.CoefficientFunction((deep_air, deep_air * self.pressure))
        self._rests_in_drum = surface is None

    def begin(self, distances: NDArray[Any], velocities: NDArray[Any]) -> None:
        """Begin in a drum with a bed that flows, instead of with one that turns rigidly.

        ``distances`` (n,) from the surface, m, positive in powder, and ``velocities`` (n, 2), m/s,
        are those of the level set's nodes. Both stand still until the stress is found.
        """
        self.level_set.set_distances(self.drive.bed_area, distances)
        self.level_set.redistance()
        self.level_set.restore_area(self.drive.bed_area)
        coefficients = [self.level_set.coefficients(part) for part in velocities.T]
        self.velocity.vec.FV().NumPy()[:] = np.concatenate(coefficients)
        self._rest_under_weight()
        self._weight.update()
        self._viscosity.settle()

    def _rest_under_weight(self) -> None:
        depth = ngs.IfPos(self.level_set.field, self.level_set.field, 0.0)
        self.pressure.Set(self.material.bulk_density * self.drive.gravity * depth)

    @property
    def time_step(self) -> float:
        """Length of the next step, s; the method's nominal step unless it has been changed."""
        return float(self._step_length.Get())

    @time_step.setter
    def time_step(self, length: float) -> None:
        self._step_length.Set(length)

    def _settle(self) -> None:
        """Find the stress that carries the bed in the drum at first, with the clock stopped.

        Stress in powder below yield is that of creep, which takes some steps to find: the first
        ones would take what it lacks for yielding, and the bed would slip by 0.3 to 0.6 deg.
        """
        start = self.velocity.vec.FV().NumPy().copy()
        for _ in range(_SETTLING_STEPS):
            self._viscosity.settle()
            self.velocity.vec.FV().NumPy()[:] = start
            self._momentum.step()
            self._level_pressure()

    def step(self) -> None:
        """Advance by one time step; the first of a drum from the stress that carries it at rest.

        1. Find the non-local shear rate; 2. update the powder's viscosity; 3. solve for velocity
        and pressure, the pressure being zero on average in the air; 4. move the level set
        by the nearest velocity without divergence, and restore what little the bed's area has
        changed by a uniform shift of its surface.  Every few steps, 5. let air below the surface
        drain, and redistance.
        """
        if self._rests_in_drum and not self.steps:
            self._settle()
        self._weight.update()
        self._viscosity.update()
        self._momentum.step()
        self._check_speed()
        self._level_pressure()
        self._mover.update()
        self._transport.step()
        self._restore_area()
        if self.steps % self.discretisation.redistance_every == 0:
            self._drain()
            self.level_set.redistance()
            self._restore_area()
        self.time += self.time_step
        self.steps += 1

    def _level_pressure(self) -> None:
        air_area, air_pressure = ngs.Integrate(self._air_pressure, self.mesh)
        if air_area > 0.0:
            self.pressure.vec.FV().NumPy()[:] -= air_pressure / air_area

    def _drain(self) -> None:
        if self.level_set.drain():
            self._area_drained -= self.level_set.restore_area(self.drive.bed_area)

    def _restore_area(self) -> None:
        self._area_moved += abs(self.level_set.restore_area(self.drive.bed_area))

    def _check_speed(self) -> None:
        # edges' coefficients, eight times what they add to the velocity, tell first of a runaway
        values = self.velocity.vec.FV().NumPy()
        speed = float(np.abs(values).max()) if np.isfinite(values).all() else math.inf
        wall_speed = self.drive.angular_velocity * self.radius
        limit = wall_speed + math.sqrt(4.0 * self.drive.gravity * self.radius)
        if not speed < limit:
            raise FlowDiverged(
                f"The flow reached {speed:.3g} m/s at t = {self.time:.4g} s (step {self.steps}), "
                f"beyond the {limit:.3g} m/s of a free fall across the vessel: halve the time step "
                f"({self.time_step:.3g} s)."
            )

    @property
    def area_correction(self) -> float:
        """Sum over the run of |area restored per step|, relative to the bed."""
        return self._area_moved / self.drive.bed_area

    @property
    def air_drained(self) -> float:
        """Sum over the run of the area of air below the surface that drained, over the bed's."""
        return self._area_drained / self.drive.bed_area

    def powder_norm(self, velocity: NDArray[Any]) -> float:
        """Root of the integral of alpha u.u, u having the coefficients ``velocity``, m^2/s."""
        shapes = self._shapes
        parts = velocity.reshape(2, -1)[:, self._nodes] @ shapes.values.T
        weight = shapes.weights * shapes.sampled(self.level_set.fraction)
        return math.sqrt(float((weight * (parts**2).sum(axis=0)).sum()))

    def ill_posed_share(self) -> float:
        """Share of the flowing layer in which the friction law is ill-posed, 0 to 1.

        The layer is where powder is sheared faster than the vessel turns.
        """
        shear_rate, pressure = self._viscosity.shear_rate, self._viscosity.pressure
        flows = ngs.IfPos(shear_rate - self.drive.angular_velocity, self.level_set.fraction, 0.0)
        ill_posed = flows * self._strength.ill_posed(shear_rate, pressure)
        share, whole = ngs.Integrate(ngs.CoefficientFunction((ill_posed, flows)), self.mesh)
        return float(share / whole) if whole > 0.0 else 0.0

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs to go on from here, as arrays of their own."""
        counters = (self.time, self.steps, self._area_moved, self._area_drained)
        return {
            "solution": self._solution.vec.FV().NumPy().copy(),
            "level_set": self.level_set.field.vec.FV().NumPy().copy(),
            "viscosity": self._viscosity.field.vec.FV().NumPy().copy(),
            "counters": np.array(counters, dtype=float),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a :meth:`state` of a flow on the same mesh with the same parameters."""
        fields = {
            "solution": self._solution,
            "level_set": self.level_set.field,
            "viscosity": self._viscosity.field,
        }
        for name, field in fields.items():
            values = field.vec.FV().NumPy()
            if state[name].shape != values.shape:
                raise ValueError(
                    f"state[{name!r}] has {state[name].size} values: this mesh needs {values.size}"
                )
            values[:] = state[name]
        self.time, steps, self._area_moved, self._area_drained = state["counters"].tolist()
        self.steps = int(steps)
