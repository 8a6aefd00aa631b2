"""Two-phase flow of a powder bed in any closed vessel, in the frame that turns with it.

The equations are those of `momentum`, in coordinates fixed to the vessel.  The wall is then at rest
and so is powder that turns rigidly; gravity turns the other way, and with omega about +z the body
force per mass is

    g (-sin(omega t), -cos(omega t), 0) + omega^2 (x, y, 0) + 2 omega (u_y, -u_x, 0),

Coriolis' part from the velocity of the step before.
"""

from __future__ import annotations

import math
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from scaleup.contract import Geometry, Material
from scaleup.numerics import level_height

from .element_shapes import ElementShapes
from .momentum import Momentum
from .parameters import Discretisation, Rheology
from .rheology import Strength
from .space_exchange import ExchangingTransport
from .space_level_set import SpaceLevelSet
from .space_mesh import WALL
from .surface_weight import SurfaceWeight
from .two_phase import FlowDiverged
from .viscosity import Viscosity

_FIELDS = ("solution", "level_set", "viscosity")
# Air is solved for where it is nearer to the bed than the second, which is found anew once the bed
# has come as near as the first to air that is not; both in element sizes.
_NEAR, _FAR = 2.0, 3.0


class VesselFlow:
    """A powder bed, level and at rest at phase ``start`` (rad), advanced by :meth:`step`.

    ``volume`` (m^3) is that of the whole bed; of a ``mirrored`` vessel ``mesh`` holds the half at
    z > 0.

    Attributes: ``phase`` (rad that the vessel has turned), ``velocity`` (VectorH1, order 2, m/s, in
    the vessel's frame), ``pressure`` (H1, order 1, Pa), ``level_set``, and what steps have cost:
    ``steps``, ``iterations`` of the linear solver and ``volume_moved``, the sum of the absolute
    volumes restored, over the bed's.  ``volume`` is what the mesh holds.  Collective.
    """

    def __init__(
        self,
        geometry: Geometry,
        mesh: Any,
        material: Material,
        rheology: Rheology,
        numerics: Discretisation,
        speed: float,
        gravity: float,
        volume: float,
        start: float,
        comm: Any,
        mirrored: bool,
    ) -> None:
        self.mesh, self.numerics, self._comm = mesh, numerics, comm
        self._gravity = gravity
        self.mirrored = mirrored
        self.speed, self.phase = speed, start
        self.volume = 0.5 * volume if mirrored else volume
        self.steps = self.iterations = 0
        self._active = np.ones(mesh.ne, dtype=bool)
        self.volume_moved = 0.0
        self._fastest = speed * geometry.reach + math.sqrt(4.0 * gravity * geometry.reach)

        def wall_distance(points: NDArray[Any]) -> NDArray[Any]:
            wall: NDArray[Any] = geometry.signed_distance(points)
            return np.minimum(wall, points[..., 2]) if mirrored else wall

        self.level_set = SpaceLevelSet(mesh, numerics.interface_half_width, wall_distance, comm)
        self.level_set.set_level(level_height(geometry, volume), self.volume)
        velocity_space = ngs.VectorH1(mesh, order=2)
        self._solution = ngs.GridFunction(velocity_space * ngs.H1(mesh, order=1))
        self.velocity, self.pressure = self._solution.components
        self._previous = ngs.GridFunction(velocity_space)
        depth = ngs.IfPos(self.level_set.field, self.level_set.field, 0.0)
        self.pressure.Set(material.bulk_density * gravity * depth)
        self._step_length = ngs.Parameter(numerics.time_step)
        alpha = self.level_set.fraction
        shapes = ElementShapes(mesh)
        self._down = [ngs.Parameter(part) for part in self._gravity_now()]
        self._weight = SurfaceWeight(
            self.level_set.field,
            numerics.interface_half_width,
            material.bulk_density - numerics.air_density,
            ngs.CoefficientFunction((*self._down, 0.0)),
            shapes,
        )
        self._viscosity = Viscosity(
            self.velocity,
            self.pressure - self._weight.excess,
            alpha,
            Strength.of(material, rheology),
            material.bulk_density,
            numerics,
            self._step_length,
            self.level_set.space,
            shapes,
        )
        old = self._previous
        self._momentum = Momentum(
            self._solution,
            old,
            self._viscosity,
            alpha,
            material,
            numerics,
            self._step_length,
            force=self._force,
            wall_velocity=ngs.CoefficientFunction((0.0, 0.0, 0.0)),
            shapes=shapes,
            surface_weight=self._weight,
            rough=WALL if mirrored else ".*",
        )
        self._transport = ExchangingTransport(
            self.level_set, 0.5 * (self.velocity + old), self._step_length, shapes
        )
        # beyond the elements that the interface crosses, where linear pressures reach into the air
        beyond = numerics.interface_half_width + numerics.fine_size
        deep = ngs.IfPos(-self.level_set.field - beyond, 1.0, 0.0)
        self._air_pressure = ngs.CoefficientFunction((deep, deep * self.pressure))

    def _force(self, points: NDArray[Any], velocity: NDArray[Any]) -> NDArray[Any]:
        """Gravity, centrifugal and Coriolis force per mass (..., 3), m/s^2."""
        omega = self.speed
        (x, y), (u, v) = (np.moveaxis(field[..., :2], -1, 0) for field in (points, velocity))
        down = self._gravity_now()
        across = down[0] + omega**2 * x + 2.0 * omega * v
        up = down[1] + omega**2 * y - 2.0 * omega * u
        return np.stack([across, up, np.zeros_like(up)], axis=-1)

    def _gravity_now(self) -> tuple[float, float]:
        """Its components along x and y at this phase, m/s^2."""
        return -self._gravity * math.sin(self.phase), -self._gravity * math.cos(self.phase)

    @property
    def unknowns(self) -> int:
        """Of velocity and pressure, on all ranks."""
        return int(self._solution.space.ndofglobal)

    def step(self, length: float) -> None:
        """Advance by ``length`` (s).

        1. Let the air that is solved for follow the bed; 2. turn gravity to the end of the step,
        find the non-local shear rate and the viscosity; 3. solve for velocity and pressure, the
        latter zero on average in the air; 4. move the level set, restore the bed's volume by a
        uniform shift of its surface.
        """
        self._step_length.Set(length)
        self._follow_bed()
        self.phase += self.speed * length
        for parameter, part in zip(self._down, self._gravity_now(), strict=True):
            parameter.Set(part)
        self._weight.update()
        self._viscosity.update()
        self._momentum.step()
        self.iterations += self._momentum.iterations
        self._check_speed()
        air, pressure = ngs.Integrate(self._air_pressure, self.mesh)
        if air > 0.0:
            self.pressure.vec.FV().NumPy()[:] -= pressure / air
        middle = 0.5 * (self.velocity.vec.FV().NumPy() + self._previous.vec.FV().NumPy())
        components = middle.reshape(3, -1)
        self._transport.step(np.stack([self.level_set.nodal(c) for c in components], axis=1))
        if self.steps % self.numerics.redistance_every == 0:
            self.level_set.redistance()
        missing = self.level_set.restore_volume(self.volume)
        self.volume_moved += abs(missing) / self.volume
        self.steps += 1

    def _follow_bed(self) -> None:
        """Let momentum be solved for in the bed and in the air about it alone."""
        level_set, size = self.level_set, self.numerics.fine_size
        depth = level_set.nodal(level_set.field.vec.FV().NumPy())[level_set.elements].max(axis=1)
        left_out = bool((~self._active & (depth > -_NEAR * size)).any())
        if self._comm.allreduce(left_out or not self.steps):
            self._restrict(depth > -_FAR * size)

    def _restrict(self, active: NDArray[Any]) -> None:
        self._active = active
        self._transport.fluxes.balance(self._momentum.restrict(active))

    def surface_angle(self) -> float:
        """Inclination (rad) in the lab of the plane nearest to the surface, which is seen along
        the axis of rotation; positive where it climbs towards +x.
        """
        triangles = self.level_set.surface()
        centre = triangles.mean(axis=1)[:, :2]
        sides = triangles[:, 1:] - triangles[:, :1]
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        deviation = centre - np.average(centre, axis=0, weights=area)
        _, axes = np.linalg.eigh((deviation * area[:, None]).T @ deviation)
        along = math.atan2(axes[1, 1], axes[0, 1]) + self.phase
        return (along + 0.5 * math.pi) % math.pi - 0.5 * math.pi

    def _check_speed(self) -> None:
        from mpi4py import MPI

        corners = self.mesh.nv
        components = self.velocity.vec.FV().NumPy().reshape(3, -1)[:, :corners]
        powder = self.level_set.field.vec.FV().NumPy()[:corners] > 0.0
        values = np.linalg.norm(components[:, powder], axis=0)
        here = float(values.max(initial=0.0)) if np.isfinite(components).all() else math.inf
        speed = self._comm.allreduce(here, MPI.MAX)
        if not speed < self._fastest:
            raise FlowDiverged(
                f"The powder reached {speed:.3g} m/s at phase {self.phase:.4g} rad (step "
                f"{self.steps}), beyond the {self._fastest:.3g} m/s of a free fall across the "
                "vessel: halve flow.time_step."
            )

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs to go on from here; this rank's part."""
        values = {name: data.copy() for name, data in self._arrays().items()}
        values["active"] = self._active.copy()
        values["counters"] = np.array([self.phase, self.steps, self.iterations, self.volume_moved])
        return values

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a :meth:`state`."""
        for name, data in self._arrays().items():
            data[:] = state[name]
        self._restrict(state["active"].astype(bool))
        self.phase, steps, iterations, self.volume_moved = state["counters"].tolist()
        self.steps, self.iterations = int(steps), int(iterations)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        fields = (self._solution, self.level_set.field, self._viscosity.field)
        return {name: field.vec.FV().NumPy() for name, field in zip(_FIELDS, fields, strict=True)}
