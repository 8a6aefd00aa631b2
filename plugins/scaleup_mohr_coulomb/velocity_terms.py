"""The terms of a step's momentum within elements, see `momentum`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from .element_shapes import ElementShapes, element_dofs, outer_products

# Force per mass, m/s^2, by places (m) and velocities (m/s) there, all (..., dimension).
BodyForce = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]


class VelocityTerms:
    """Matrix and load of the integrals over elements.

        int rho/dt u.v + dt/2 rho (U.grad u).(U.grad v) + 2 eta E(u):grad v + k div u div v,
        int [rho_f f + rho (U/dt - U.grad U)].v,

    U being the velocity of the step before, f the force per mass on a density rho_f and k a
    grad-div factor.
    ``space`` is that of the velocity, the first in a product space whose form's ``matrix`` (an
    NGSolve sparse matrix) has the entries that elements couple.  Only elements ``wanted`` (flags)
    add to them.  ``dofs`` (n_elements, dimension k) are the numbers of elements' unknowns.
    """

    def __init__(self, space: Any, matrix: Any, shapes: ElementShapes) -> None:
        self._shapes, self._matrix = shapes, matrix
        self.wanted = np.ones(shapes.count, dtype=bool)
        self.dofs = element_dofs(space, shapes.dimension)
        _, columns, starts = (np.asarray(part).astype(np.int64) for part in matrix.CSR())
        width = len(starts)
        keys = np.repeat(np.arange(len(starts) - 1), np.diff(starts)) * width + columns
        dofs = self.dofs
        wanted = dofs[:, :, None] * width + dofs[:, None, :]
        self._places = np.searchsorted(keys, wanted.ravel()).astype(np.int32).reshape(wanted.shape)

    def add(
        self,
        load: NDArray[Any],
        density: NDArray[Any],
        forced_density: NDArray[Any],
        viscosity: NDArray[Any],
        grad_div: NDArray[Any] | None,
        velocity: NDArray[Any],
        time_step: float,
        force: BodyForce,
    ) -> None:
        """Add to the matrix's entries and to the ``load`` (n_unknowns,).

        ``density`` rho, ``forced_density`` rho_f, ``viscosity`` and ``grad_div`` (n_elements, q)
        are at the points; ``velocity`` holds the coefficients of U.
        """
        shapes, dim = self._shapes, self._shapes.dimension
        entries = self._matrix.AsVector().FV().NumPy()
        old = velocity[self.dofs].reshape(shapes.count, dim, shapes.values.shape[1])
        values = shapes.values
        for some, slopes in shapes.chunks(self.wanted):
            weight, rho = shapes.weights[some], density[some]
            speed = np.matmul(values, old[some].transpose(0, 2, 1))
            along = np.matmul(slopes, speed[..., None])[..., 0]
            inertia = np.concatenate(
                [
                    np.sqrt(weight * rho / time_step)[..., None] * values,
                    np.sqrt(0.5 * time_step * weight * rho)[..., None] * along,
                ],
                axis=1,
            )
            blocks = _strained(weight * viscosity[some], slopes)
            if grad_div is not None:
                blocks += _dilated(weight * grad_div[some], slopes)
            same = outer_products(inertia)
            for a in range(dim):
                blocks[:, a, :, a, :] += same
            _add_at(entries, self._places[some].ravel(), blocks.ravel())

            convected = np.matmul(along, old[some].transpose(0, 2, 1))
            push = (weight * rho)[..., None] * (speed / time_step - convected)
            forced = (weight * forced_density[some])[..., None]
            push += forced * force(shapes.points[some], speed)
            loads = np.matmul(push.transpose(0, 2, 1), values)
            _add_at(load, self.dofs[some].ravel(), loads.ravel())


def _strained(factor: NDArray[Any], slopes: NDArray[Any]) -> NDArray[Any]:
    """The integral of 2 f E(u):grad v, (m, dimension, k, dimension, k), by ``factor`` f (m, q)."""
    m, q, k, dim = slopes.shape
    rows = np.sqrt(factor)[..., None] * slopes.reshape(m, q, k * dim)
    pairs = outer_products(rows).reshape(m, k, dim, k, dim)
    blocks = np.ascontiguousarray(pairs.transpose(0, 4, 1, 2, 3))
    same = np.einsum("mikjk->mij", pairs)
    for a in range(dim):
        blocks[:, a, :, a, :] += same
    return blocks


def _dilated(factor: NDArray[Any], slopes: NDArray[Any]) -> NDArray[Any]:
    """The integral of f div u div v, like :func:`_strained`."""
    m, q, k, dim = slopes.shape
    rows = np.sqrt(factor)[..., None] * slopes.transpose(0, 1, 3, 2).reshape(m, q, dim * k)
    return outer_products(rows).reshape(m, dim, k, dim, k)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_at(target: NDArray[Any], places: NDArray[Any], values: NDArray[Any]) -> None:
    for number in range(len(places)):
        target[places[number]] += values[number]
