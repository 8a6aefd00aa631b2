"""The weight of powder about the free surface, and the pressure that carries it.

A linear pressure cannot follow the kink that a surface gives it.  What it leaves unbalanced of the
smoothed weight alpha(phi) rho f, stress takes up in stiff powder: the pressure is then too low by a
quarter of an element over the first element below the surface, too high in the second, and
slopes creep as a film.  With n = grad phi/|grad phi| the direction into the powder and

    P(phi) = int_{-W}^{phi} alpha,          alpha grad phi = grad P,

the part along n of the force per mass f acts here by the gradient of the linear interpolant I P:

    rho [alpha f + (f.grad phi)/|grad phi|^2 (grad I P - alpha grad phi)]

in elements within W of the surface.  That is the same to second order in the element's size, and a
bed at rest balances it exactly with the pressure rho f.n I P.  Since P is convex, I P is more than
P within elements; friction takes the pressure without that excess,

    p - rho (g.grad phi)/|grad phi|^2 (I P - P),

which vanishes at the interface's outer edge as the weight above does.
"""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .element_shapes import ElementShapes, element_dofs
from .level_set import smooth_ramp, smooth_step
from .velocity_terms import BodyForce

# |grad phi|^2 of a signed distance is 1, but for kinks.
_LEAST_SLOPE = 0.25


class SurfaceWeight:
    """Weight about the surface of a quadratic ``level_set`` (m), which :meth:`update` follows.

    ``half_width`` W (m) is that of the interface, ``density`` the powder's beyond the air's
    (kg/m^3), ``gravity`` (m/s^2) a coefficient function.  Attribute: ``excess`` (Pa), by which a
    linear pressure exceeds the one that friction takes, a coefficient function.
    """

    def __init__(
        self,
        level_set: Any,
        half_width: float,
        density: float,
        gravity: Any,
        shapes: ElementShapes,
    ) -> None:
        self._level_set, self._half_width, self._density = level_set, half_width, density
        self._shapes = shapes
        mesh = level_set.space.mesh
        self._dofs = element_dofs(level_set.space)
        self._corners = self._dofs[:, : mesh.dim + 1]
        self._interpolated = ngs.GridFunction(ngs.H1(mesh, order=1))
        self._near = ngs.GridFunction(ngs.L2(mesh, order=0))
        slope = ngs.Grad(level_set)
        square = ngs.InnerProduct(slope, slope) - _LEAST_SLOPE
        inwards = ngs.InnerProduct(gravity, slope) / (_LEAST_SLOPE + ngs.IfPos(square, square, 0.0))
        beyond = self._interpolated - _weighed_depth(level_set, half_width)
        self.excess = density * inwards * self._near * beyond
        self.update()

    def update(self) -> None:
        """Follow the level set."""
        mesh, width = self._level_set.space.mesh, self._half_width
        phi = self._level_set.vec.FV().NumPy()
        z = np.clip(phi[: mesh.nv] / width, -1.0, 1.0)
        deeper = np.maximum(phi[: mesh.nv] - width, 0.0)
        self._interpolated.vec.FV().NumPy()[:] = width * smooth_ramp(z) + deeper
        corners = phi[self._corners]
        near = (corners.min(axis=1) < width) & (corners.max(axis=1) > -width)
        self._near.vec.FV().NumPy()[:] = near

    def add(
        self,
        load: NDArray[Any],
        velocity_dofs: NDArray[Any],
        velocity: NDArray[Any],
        force: BodyForce,
    ) -> None:
        """Add to a ``load`` (n_unknowns,) that has alpha rho f what the weight differs from it by.

        ``velocity_dofs`` are `VelocityTerms.dofs`; ``velocity`` holds the coefficients of U, m/s.
        """
        shapes, dim = self._shapes, self._shapes.dimension
        near = self._near.vec.FV().NumPy() > 0.0
        if not near.any():
            return
        values, count = shapes.values, self._dofs.shape[1]
        phi = self._level_set.vec.FV().NumPy()[self._dofs]
        depth = self._interpolated.vec.FV().NumPy()[self._corners]
        for some, slopes in shapes.chunks(near):
            gradient = _gradient(slopes, phi[some])
            interpolated = _gradient(slopes[:, :, : dim + 1], depth[some])
            z = np.clip(phi[some] @ values.T / self._half_width, -1.0, 1.0)
            fraction = smooth_step(z)
            old = velocity[velocity_dofs[some]].reshape(-1, dim, count)
            pull = force(shapes.points[some], np.matmul(values, old.transpose(0, 2, 1)))
            square = np.maximum((gradient**2).sum(axis=2), _LEAST_SLOPE)
            inwards = self._density * shapes.weights[some] * (pull * gradient).sum(axis=2) / square
            push = inwards[..., None] * (interpolated - fraction[..., None] * gradient)
            loads = np.matmul(push.transpose(0, 2, 1), values)
            np.add.at(load, velocity_dofs[some].ravel(), loads.ravel())


def _gradient(slopes: NDArray[Any], coefficients: NDArray[Any]) -> NDArray[Any]:
    """At points (m, q, dimension), of functions with so many ``coefficients`` (m, k)."""
    return np.matmul(slopes.swapaxes(2, 3), coefficients[:, None, :, None])[..., 0]


def _weighed_depth(level_set: Any, half_width: float) -> Any:
    """P(phi), m: the depth of pure powder that weighs as much as what lies above."""
    z = level_set / half_width
    deeper = ngs.IfPos(z - 1.0, level_set - half_width, 0.0)
    clipped = ngs.IfPos(1.0 - z, ngs.IfPos(1.0 + z, z, -1.0), 1.0)
    return half_width * smooth_ramp(clipped) + deeper
