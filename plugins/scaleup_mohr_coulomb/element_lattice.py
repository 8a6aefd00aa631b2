"""Triangles within elements, on which a quadratic level set is taken as linear."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from . import surface_kernels

_SUBDIVISIONS = 4
# Three Gauss points and weights on [0, 1].
TIMES = 0.5 + np.array([-1.0, 0.0, 1.0]) * np.sqrt(0.15)
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0


class ElementLattice:
    """A lattice of points and triangles in each element (a, b, c, midpoints of ab, bc, ca).

    ``points`` (n_elements, n_points, 2) in m; ``triangles`` (n_triangles, 3) numbers of points.
    """

    def __init__(self, mesh: Any, nodes: NDArray[Any], elements: NDArray[Any]) -> None:
        """``nodes`` (n_nodes, 2) in m, ``elements`` (n_elements, 6) their numbers."""
        self._elements = elements
        barycentric, self._shapes, self.triangles, self._rim = _quadratic_lattice(_SUBDIVISIONS)
        self._corners = np.ascontiguousarray(barycentric.T)
        self.points = np.einsum("ln,end->eld", self._shapes, nodes[elements])
        corners = nodes[elements[:, :3]]
        sides = corners[:, 1:] - corners[:, :1]
        self._turn = np.sign(np.linalg.det(sides))
        rule = ngs.IntegrationRule(
            points=[(float(a), float(b)) for a, b, _ in barycentric],
            weights=[0.0] * len(self._shapes),
        )
        self._mapped = mesh.MapToAllElements(rule, ngs.VOL)
        triangles = self.points[:, self.triangles]
        areas = 0.5 * np.abs(np.linalg.det(triangles[:, :, 1:] - triangles[:, :, :1]))
        curved = np.array(ngs.Integrate(1.0, mesh, element_wise=True))
        self._areas = areas * (curved / areas.sum(axis=1))[:, None]
        self._whole = curved

    def values(self, nodal: NDArray[Any]) -> NDArray[Any]:
        """Of a function with these values (n_nodes,): on the lattice (n_elements, n_points)."""
        found: NDArray[Any] = surface_kernels.lattice_values(nodal, self._elements, self._shapes)
        return found

    def sampled(self, function: Any) -> NDArray[Any]:
        """Of a scalar coefficient function: its values (n_elements, n_points)."""
        return np.asarray(function(self._mapped)).reshape(len(self._elements), -1)

    def areas(self, values: NDArray[Any]) -> NDArray[Any]:
        """Area (n_elements,) in m^2 where the function of lattice ``values`` is positive."""
        found: NDArray[Any] = surface_kernels.positive_areas(
            values, self.triangles, self._areas, self._whole
        )
        return found

    def contour_weights(self, values: NDArray[Any], shift: float) -> NDArray[Any]:
        """Integrals (n_elements, 3) of the vertices' linear functions along the zero contour, m.

        By differences of the area, the function of lattice ``values`` being shifted by ``shift``.
        """
        found: NDArray[Any] = surface_kernels.contour_weights(
            values, shift, self._corners, self.triangles, self._areas, self._whole
        )
        return found

    def outflow(
        self, before: NDArray[Any], after: NDArray[Any], stream_function: NDArray[Any]
    ) -> NDArray[Any]:
        """Area (n_elements,) in m^2/s that flows out through each element's sides.

        The integral of H(phi) d psi along them, psi (m^2/s) and phi linear between the lattice's
        points, phi going from the lattice values ``before`` to ``after`` (three Gauss points in
        time). What leaves an element enters its neighbour, to round-off.
        """
        steps = np.diff(stream_function[:, self._rim], axis=1) * self._turn[:, None]
        found: NDArray[Any] = surface_kernels.outflow(
            before, after, steps, self._rim, TIMES, WEIGHTS
        )
        return found

    def contour(self, values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """End points, each (n, 2) in m, of the zero contour's segments."""
        start, end = surface_kernels.contour(values, self.points, self.triangles)
        return start, end


def _quadratic_lattice(
    divisions: int,
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Barycentric coordinates (n_points, 3), quadratic shape functions (n_points, 6), triangles
    (divisions^2, 3) and the points along the rim a-b-c-a.
    """
    number: dict[tuple[int, int], int] = {}
    for i in range(divisions + 1):
        for j in range(divisions + 1 - i):
            number[i, j] = len(number)
    b, c = np.array(list(number)).T / divisions
    a = 1.0 - b - c
    shapes = np.column_stack(
        (a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a)
    )
    triangles = []
    for i, j in number:
        if i + j < divisions:
            triangles.append((number[i, j], number[i + 1, j], number[i, j + 1]))
        if i + j < divisions - 1:
            triangles.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    along = range(divisions)
    rim = [number[k, 0] for k in along]
    rim += [number[divisions - k, k] for k in along]
    rim += [number[0, divisions - k] for k in along]
    rim.append(number[0, 0])
    return np.column_stack((a, b, c)), shapes, np.array(triangles), np.array(rim)
