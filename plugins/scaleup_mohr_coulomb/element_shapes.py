"""Quadratic shape functions at the quadrature points of all simplices of a mesh, found once.

Integrals over elements are then products of small matrices, many at a time, instead of a loop over
elements that finds the same geometry anew in every step.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import ngsolve as ngs
import numba
import numpy as np
from numpy.typing import NDArray

# Exact for polynomials up to it: two quadratic functions and a smooth step between them.
_ORDER = 6
_CHUNK = 1024
# Numbers, of all gradients together, up to which they are kept and not found anew for each use.
_KEPT = 20_000_000


class ElementShapes:
    """Values and gradients of NGSolve's quadratic functions in each element of this rank.

    In an element with barycentric coordinates b_i they are b_i at its corners and -1/2 b_i b_j at
    its edges, in the order of the dofs of ``ngs.H1(mesh, order=2)``; the first are the linear ones.

    ``values`` (q, k) are those of the k functions at the q points; ``weights`` (n_elements, q), in
    m^2 or m^3, are the points' shares of the element, ``points`` (n_elements, q, dimension) where
    they lie, m.
    """

    def __init__(self, mesh: Any) -> None:
        dim = mesh.dim
        self.dimension, self.count = dim, mesh.ne
        rule = ngs.IntegrationRule(ngs.TRIG if dim == 2 else ngs.TET, _ORDER)
        points = np.array(rule.points)[:, :dim]
        corners = np.concatenate([points, 1.0 - points.sum(axis=1, keepdims=True)], axis=1)
        slopes = np.concatenate([np.eye(dim), -np.ones((1, dim))])
        a, b = np.array(_edges(mesh)).T
        self.values = np.concatenate([corners, -0.5 * corners[:, a] * corners[:, b]], axis=1)
        products = corners[:, a, None] * slopes[b] + corners[:, b, None] * slopes[a]
        linear = np.broadcast_to(slopes, (len(points), *slopes.shape))
        self._slopes = np.concatenate([linear, -0.5 * products], axis=1)
        self._mapped = mesh.MapToAllElements(rule, ngs.VOL) if self.count else None
        place = (ngs.x, ngs.y, ngs.z)[:dim]
        self.points = self.sampled(ngs.CoefficientFunction(place))
        jacobian = self.sampled(ngs.specialcf.JacobianMatrix(dim))
        jacobian = jacobian.reshape(self.count, len(points), dim, dim)
        self.weights = np.abs(np.linalg.det(jacobian)) * np.array(rule.weights)
        self._inverse = np.linalg.inv(jacobian)
        self._gradients: NDArray[Any] | None = None
        if self.count * self._slopes.size <= _KEPT:
            self._gradients = np.matmul(self._slopes, self._inverse)

    def sampled(self, function: Any) -> NDArray[Any]:
        """A coefficient function (n_elements, q) or (n_elements, q, components)."""
        shape = (self.count, len(self.values)) + ((function.dim,) if function.dim > 1 else ())
        if self._mapped is None:
            return np.zeros(shape)
        return np.asarray(function(self._mapped)).reshape(shape)

    def chunks(
        self, wanted: NDArray[Any] | None = None
    ) -> Iterator[tuple[slice | NDArray[Any], NDArray[Any]]]:
        """Elements (or those ``wanted``, by flags), some at a time: which they are, and the
        gradients (m, q, k, dimension) of their functions.
        """
        everything = wanted is None or bool(wanted.all())
        numbers = None if everything else np.flatnonzero(wanted)
        count, kept = self.count if numbers is None else len(numbers), self._gradients
        for first in range(0, count, _CHUNK):
            chunk = slice(first, min(first + _CHUNK, count))
            some = chunk if numbers is None else numbers[chunk]
            yield some, np.matmul(self._slopes, self._inverse[some]) if kept is None else kept[some]


def _edges(mesh: Any) -> list[tuple[int, int]]:
    """Local numbers of the corners of an element's edges, in NGSolve's order."""
    if mesh.dim == 2:
        return [(0, 2), (1, 2), (0, 1)]
    return [(0, 3), (1, 3), (2, 3), (0, 1), (0, 2), (1, 2)]


def element_dofs(space: Any, components: int = 1) -> NDArray[Any]:
    """Numbers (n_elements, k) of the unknowns of a space of so many ``components`` in elements."""
    dofs = [list(element.dofs) for element in space.Elements(ngs.VOL)]
    dimension = space.mesh.dim
    functions = math.comb(dimension + space.globalorder, dimension)
    return np.array(dofs, dtype=int).reshape(space.mesh.ne, components * functions)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def outer_products(rows: NDArray[Any]) -> NDArray[Any]:
    """Sum over q of rows_qi rows_qj: (m, k, k), of rows (m, q, k).

    Half to a third of the time of a BLAS call for each of so small matrices.
    """
    m, q, k = rows.shape
    found = np.zeros((m, k, k))
    for e in range(m):
        for p in range(q):
            for i in range(k):
                factor = rows[e, p, i]
                for j in range(i + 1):
                    found[e, i, j] += factor * rows[e, p, j]
        for i in range(k):
            for j in range(i):
                found[e, j, i] = found[e, i, j]
    return found
