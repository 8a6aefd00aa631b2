"""The powder's free surface in space: a quadratic level set on distributed tetrahedra."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .level_set import powder_fraction
from .space_shifts import SpaceShifts

_NEIGHBOURS = 12
_SHIFTS = 6
# Sweeps that give elements the volume they should hold, each limited to this part of the
# interface's half width, and smoothed over so many half widths.
_SWEEPS = 2
_MOST_SHIFT = 0.2
_SPREAD = 1.0
_LITTLE = 1e-3
EDGES = tuple(combinations(range(4), 2))
# the eight tetrahedra between a tetrahedron's corners 0-3 and the middles 4-9 of its EDGES
_PARTS = np.array(
    [
        (0, 4, 5, 6),
        (1, 4, 7, 8),
        (2, 5, 7, 9),
        (3, 6, 8, 9),
        (4, 9, 5, 6),
        (4, 9, 6, 8),
        (4, 9, 8, 7),
        (4, 9, 7, 5),
    ]
)
# barycentric coordinates of a tetrahedron's corners and middles
_BARYCENTRIC = np.concatenate([np.eye(4), [0.5 * (np.eye(4)[a] + np.eye(4)[b]) for a, b in EDGES]])


class SpaceLevelSet:
    """Level set phi (m), the signed distance to the free surface, positive in powder.

    ``field`` is the finite-element function, ``fraction`` the smoothed powder fraction of
    `level_set.powder_fraction`.  Surface and volume are those of the linear interpolant on the
    eight parts of every tetrahedron.  ``elements`` (n, 10) are the numbers of corners and middles
    of edges, whose places are ``nodes`` (n_nodes, 3), m; both are this rank's.  Most methods are
    collective.
    """

    def __init__(
        self,
        mesh: Any,
        half_width: float,
        wall_distance: Callable[[NDArray[Any]], NDArray[Any]],
        comm: Any,
    ) -> None:
        self.mesh, self._comm = mesh, comm
        self._half_width, self._wall_distance = half_width, wall_distance
        self.space = ngs.H1(mesh, order=2)
        self.field = ngs.GridFunction(self.space)
        self.fraction = powder_fraction(self.field, half_width)
        pairs = [[v.nr for v in edge.vertices] for edge in mesh.edges]
        self._edges = np.array(pairs, dtype=int).reshape(-1, 2)
        self.elements = self._element_nodes()
        coordinate = ngs.GridFunction(self.space)
        columns = []
        for component in (ngs.x, ngs.y, ngs.z):
            coordinate.Set(component)
            columns.append(self.nodal(coordinate.vec.FV().NumPy()))
        self.nodes = np.column_stack(columns)
        self._corners = self.elements[:, _PARTS]
        self._volumes = self._part_volumes()
        self._shifts = SpaceShifts(mesh, self.elements[:, :4], _SPREAD * half_width)

    def _element_nodes(self) -> NDArray[Any]:
        """Node numbers (n_elements, 10): corners, then middles of the EDGES."""
        nodes = []
        for element in self.mesh.Elements(ngs.VOL):
            corners = [v.nr for v in element.vertices]
            middle = {frozenset(self._edges[e.nr]): self.mesh.nv + e.nr for e in element.edges}
            sides = (middle[frozenset((corners[a], corners[b]))] for a, b in EDGES)
            nodes.append([*corners, *sides])
        return np.array(nodes, dtype=int).reshape(-1, 10)

    def _part_volumes(self) -> NDArray[Any]:
        corner = self.nodes[self._corners]
        volumes = np.abs(np.linalg.det(corner[:, :, 1:] - corner[:, :, :1])) / 6.0
        curved = np.array(ngs.Integrate(1.0, self.mesh, element_wise=True))
        scaled: NDArray[Any] = volumes * (curved / volumes.sum(axis=1))[:, None]
        return scaled

    def nodal(self, coefficients: NDArray[Any]) -> NDArray[Any]:
        """Values at corners and edge middles; NGSolve's edge functions are -1/8 in the middle."""
        values: NDArray[Any] = coefficients.copy()
        count = self.mesh.nv
        values[count:] = values[self._edges].mean(axis=1) - values[count:] / 8.0
        return values

    def _set_nodal(self, values: NDArray[Any]) -> None:
        count = self.mesh.nv
        coefficients = values.copy()
        coefficients[count:] = 8.0 * (values[self._edges].mean(axis=1) - values[count:])
        self.field.vec.FV().NumPy()[:] = coefficients

    def set_level(self, height: float, volume: float) -> None:
        """A bed of ``volume`` (m^3) that lies level, y = ``height`` (m) being a first guess."""
        self._set_nodal(height - self.nodes[:, 1])
        for _ in range(_SHIFTS):
            self.restore_volume(volume)

    def _values(self, coefficients: NDArray[Any] | None = None) -> NDArray[Any]:
        """Level set (n_elements, 8, 4) at the corners of all parts; of the field by default."""
        own = self.field.vec.FV().NumPy() if coefficients is None else coefficients
        values: NDArray[Any] = self.nodal(own)[self._corners]
        return values

    def difference(self, coefficients: NDArray[Any]) -> float:
        """Volume (m^3) by which the bed differs from that of another level set: half of what lies
        in one alone.
        """
        here, there = (_inside_fraction(self._values(c)) for c in (None, coefficients))
        return 0.5 * float(self._comm.allreduce(float((self._volumes * abs(here - there)).sum())))

    def element_volumes(self) -> NDArray[Any]:
        """Volume (n_elements,) inside the surface, of this rank's elements, m^3."""
        inside: NDArray[Any] = (self._volumes * _inside_fraction(self._values())).sum(axis=1)
        return inside

    def volume(self) -> float:
        """Volume inside the surface, m^3."""
        return float(self._comm.allreduce(float(self.element_volumes().sum())))

    def hold(self, volumes: NDArray[Any]) -> None:
        """Shift vertices until elements hold these ``volumes`` (n_elements,), m^3.

        Smoothed over the interface's half width: the sum is met to second order in the shifts.
        """
        most = _MOST_SHIFT * self._half_width
        for _ in range(_SWEEPS):
            missing = volumes - self.element_volumes()
            shifts = self._shifts.shifts(missing, self._surface_weights())
            self.field.vec.FV().NumPy()[: self.mesh.nv] += np.clip(shifts, -most, most)

    def _surface_weights(self) -> NDArray[Any]:
        """Integrals (n_elements, 4) of the corners' linear functions over the surface, m^2.

        By differences of the volume, the level set being shifted by a little of each function.
        """
        shift = _LITTLE * self._half_width
        values = self._values()
        found = np.zeros((len(values), 4))
        low, high = values.min(axis=(1, 2)), values.max(axis=(1, 2))
        near = np.flatnonzero((low < shift) & (high > -shift))
        for corner, weight in enumerate(_BARYCENTRIC[_PARTS].transpose(2, 0, 1)):
            more, less = (
                _inside_fraction(values[near] + sign * shift * weight) for sign in (0.5, -0.5)
            )
            found[near, corner] = (self._volumes[near] * (more - less)).sum(axis=1) / shift
        return found

    def restore_volume(self, volume: float) -> float:
        """Shift the surface so that it holds ``volume`` (m^3); the volume that was missing."""
        missing = volume - self.volume()
        area = self._comm.allreduce(float(_areas(self._surface_here()).sum()))
        self.field.vec.FV().NumPy()[: self.mesh.nv] += missing / area
        return missing

    def _surface_here(self) -> NDArray[Any]:
        """Corners (n, 3, 3) in m of the triangles of the surface in this rank's elements."""
        values, corners = self._values().reshape(-1, 4), self._corners.reshape(-1, 4)
        inside = values > 0.0
        count = inside.sum(axis=1)
        found = [np.zeros((0, 3, 3))]

        def crossing(rows: NDArray[Any], a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
            near, far = values[rows, a], values[rows, b]
            weight = (near / (near - far))[:, None]
            first, last = self.nodes[corners[rows, a]], self.nodes[corners[rows, b]]
            point: NDArray[Any] = (1.0 - weight) * first + weight * last
            return point

        for lone in (1, 3):
            rows = np.flatnonzero(count == lone)
            apex = (inside[rows] if lone == 1 else ~inside[rows]).argmax(axis=1)
            sides = [crossing(rows, apex, (apex + turn) % 4) for turn in (1, 2, 3)]
            found.append(np.stack(sides, axis=1))
        rows = np.flatnonzero(count == 2)
        a, b, c, d = np.argsort(~inside[rows], axis=1, kind="stable").T
        quad = [crossing(rows, *ends) for ends in ((a, c), (a, d), (b, d), (b, c))]
        found.append(np.stack([quad[0], quad[1], quad[2]], axis=1))
        found.append(np.stack([quad[0], quad[2], quad[3]], axis=1))
        return np.concatenate(found)

    def surface(self) -> NDArray[Any]:
        """Corners (n, 3, 3) in m of the triangles of the whole surface, on every rank."""
        triangles = np.concatenate(self._comm.allgather(self._surface_here()))
        areas = _areas(triangles)
        kept: NDArray[Any] = triangles[areas > 1e-12 * areas.max(initial=0.0)]
        return kept

    def redistance(self) -> None:
        """Make phi the signed distance to its own zero surface again.

        Then vertices are shifted until the elements about each hold the volume that they held.
        """
        held = self.element_volumes()
        distance, _ = self._distances(self.surface())
        self._set_nodal(np.copysign(distance, self.nodal(self.field.vec.FV().NumPy())))
        self.hold(held)

    def _distances(self, triangles: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Distance (m) of every node from the nearest of triangles, and its number."""
        centres = triangles.mean(axis=1)
        count = min(_NEIGHBOURS, len(centres))
        _, candidates = cKDTree(centres).query(self.nodes, k=count)
        distance = np.full(len(self.nodes), np.inf)
        nearest = np.zeros(len(self.nodes), dtype=int)
        for candidate in candidates.reshape(len(self.nodes), count).T:
            point = _closest_points(self.nodes, triangles[candidate])
            away = np.linalg.norm(self.nodes - point, axis=1)
            nearer = away < distance
            distance[nearer], nearest[nearer] = away[nearer], candidate[nearer]
        return distance, nearest


def _inside_fraction(values: NDArray[Any]) -> NDArray[Any]:
    """Part of each tetrahedron where the linear function of corner ``values`` (..., 4) is positive.

    The sum over positive corners i of f_i^3 / prod_(j != i) (f_i - f_j): with one of them as it
    stands, with three as one less that of the negative corner, with two (p, q) and r, s negative as

        [p^2 q^2 - p q (r + s)(p + q) + r s (p^2 + p q + q^2)] / [(p-r)(p-s)(q-r)(q-s)],

    where all terms have one sign.
    """
    s, r, q, p = np.moveaxis(np.sort(values, axis=-1), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        one = p**3 / ((p - q) * (p - r) * (p - s))
        two = (p * q) ** 2 - p * q * (r + s) * (p + q) + r * s * (p * p + p * q + q * q)
        two /= (p - r) * (p - s) * (q - r) * (q - s)
        three = 1.0 + s**3 / ((r - s) * (q - s) * (p - s))
    cut = np.where(q <= 0.0, one, np.where(r <= 0.0, two, three))
    return np.where(s > 0.0, 1.0, np.where(p <= 0.0, 0.0, cut))


def _areas(triangles: NDArray[Any]) -> NDArray[Any]:
    return 0.5 * np.linalg.norm(_normals(triangles), axis=-1)


def _normals(triangles: NDArray[Any]) -> NDArray[Any]:
    """Normals (n, 3) of twice the area's length, m^2."""
    sides = triangles[:, 1:] - triangles[:, :1]
    return np.cross(sides[:, 0], sides[:, 1])


def _closest_points(points: NDArray[Any], triangles: NDArray[Any]) -> NDArray[Any]:
    """The point of each triangle (n, 3, 3) nearest to each point (n, 3)."""
    normal = _normals(triangles)
    square = np.maximum((normal**2).sum(axis=1), 1e-300)
    height = ((points - triangles[:, 0]) * normal).sum(axis=1) / square
    foot = points - height[:, None] * normal
    inside = np.ones(len(points), dtype=bool)
    best, closest = np.full(len(points), np.inf), triangles[:, 0].copy()
    for k in range(3):
        start, side = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        inside &= (np.cross(side, foot - start) * normal).sum(axis=1) >= 0.0
        length = np.maximum((side**2).sum(axis=1), 1e-300)
        along = np.clip(((points - start) * side).sum(axis=1) / length, 0.0, 1.0)
        point = start + along[:, None] * side
        away = ((points - point) ** 2).sum(axis=1)
        nearer = away < best
        best[nearer], closest[nearer] = away[nearer], point[nearer]
    closest[inside] = foot[inside]
    return closest
