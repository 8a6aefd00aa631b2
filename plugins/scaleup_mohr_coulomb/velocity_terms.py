"""The terms of a step's momentum within elements, see `momentum`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from .element_shapes import ElementShapes, element_dofs

# Force per mass, m/s^2, by places (m) and velocities (m/s) there, all (..., dimension).
BodyForce = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]


_LANES = 32  # elements at a time


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
        for some, slopes in shapes.chunks(self.wanted):
            weight = shapes.weights[some]
            inertia, viscous = weight * density[some], weight * viscosity[some]
            dilated = None if grad_div is None else weight * grad_div[some]
            speed, convected, along = _carried(shapes.values, slopes, old[some])
            pushed = inertia[..., None] * (speed / time_step - convected)
            forced = (weight * forced_density[some])[..., None]
            pushed += forced * force(shapes.points[some], speed)
            _add_loads(load, self.dofs[some], shapes.values, pushed)
            _add_blocks(
                entries,
                self._places[some],
                shapes.values,
                slopes,
                along,
                inertia,
                viscous,
                viscous if dilated is None else dilated,
                dilated is not None,
                time_step,
            )


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _carried(
    values: NDArray[Any], slopes: NDArray[Any], old: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """U and U.grad U (m, q, dimension), and U.grad of the functions (m, q, k), at the points."""
    m, q, k, dim = slopes.shape
    speed, convected = np.zeros((m, q, dim)), np.zeros((m, q, dim))
    along = np.zeros((m, q, k))
    for e in range(m):
        for p in range(q):
            for i in range(k):
                for a in range(dim):
                    speed[e, p, a] += values[p, i] * old[e, a, i]
            for i in range(k):
                for a in range(dim):
                    along[e, p, i] += slopes[e, p, i, a] * speed[e, p, a]
                for a in range(dim):
                    convected[e, p, a] += along[e, p, i] * old[e, a, i]
    return speed, convected, along


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_loads(
    load: NDArray[Any], dofs: NDArray[Any], values: NDArray[Any], pushed: NDArray[Any]
) -> None:
    """Add the integrals of ``pushed`` (m, q, dimension), times the points' weights, and v."""
    m, q, dim = pushed.shape
    k = values.shape[1]
    for e in range(m):
        for a in range(dim):
            for i in range(k):
                total = 0.0
                for p in range(q):
                    total += pushed[e, p, a] * values[p, i]
                load[dofs[e, a * k + i]] += total


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _add_blocks(
    entries: NDArray[Any],
    places: NDArray[Any],
    values: NDArray[Any],
    slopes: NDArray[Any],
    along: NDArray[Any],
    inertia: NDArray[Any],
    viscous: NDArray[Any],
    dilated: NDArray[Any],
    dilates: bool,
    time_step: float,
) -> None:
    """Add elements' matrices to the ``entries`` at their ``places``.

    ``inertia`` rho, ``viscous`` eta and ``dilated`` k (m, q) are times the points' weights; the
    last counts if the matrix ``dilates``.  Some elements at a time, innermost, so that the loops
    over them are vectorised.
    """
    m, q, k, dim = slopes.shape
    g, u = np.empty((q, k, dim, _LANES)), np.empty((q, k, _LANES))
    rho, eta, bulk = (
        np.empty((q, _LANES)),
        np.empty((q, _LANES)),
        np.empty((q, _LANES)),
    )
    for first in range(0, m, _LANES):
        count = min(_LANES, m - first)
        for e in range(count):
            for p in range(q):
                rho[p, e], eta[p, e] = inertia[first + e, p], viscous[first + e, p]
                bulk[p, e] = dilated[first + e, p]
                for i in range(k):
                    u[p, i, e] = along[first + e, p, i]
                    for a in range(dim):
                        g[p, i, a, e] = slopes[first + e, p, i, a]
        for i in range(k):
            for j in range(i + 1):
                same, pairs = np.zeros(_LANES), np.zeros((dim, dim, _LANES))
                for p in range(q):
                    mass = values[p, i] * values[p, j] / time_step
                    weight, one, other = rho[p], u[p, i], u[p, j]
                    for e in range(_LANES):
                        same[e] += weight[e] * (mass + 0.5 * time_step * one[e] * other[e])
                for a in range(dim):
                    for b in range(dim):
                        for p in range(q):
                            weight, one, other, sum_ = eta[p], g[p, i, b], g[p, j, a], pairs[a, b]
                            for e in range(_LANES):
                                sum_[e] += weight[e] * one[e] * other[e]
                for a in range(dim):
                    same += pairs[a, a]
                for a in range(dim):
                    pairs[a, a] += same
                if dilates:
                    for a in range(dim):
                        for b in range(dim):
                            for p in range(q):
                                weight, one, other = bulk[p], g[p, i, a], g[p, j, b]
                                sum_ = pairs[a, b]
                                for e in range(_LANES):
                                    sum_[e] += weight[e] * one[e] * other[e]
                for e in range(count):
                    place = places[first + e]
                    for a in range(dim):
                        for b in range(dim):
                            entries[place[a * k + i, b * k + j]] += pairs[a, b, e]
                            if i != j:
                                entries[place[b * k + j, a * k + i]] += pairs[a, b, e]
