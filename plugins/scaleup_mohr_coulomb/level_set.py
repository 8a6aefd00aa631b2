"""The powder's free surface as the zero contour of a level set."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .element_lattice import ElementLattice
from .mesh import surface_normal, surface_offset
from .surface_kernels import distances
from .vertex_shifts import vertex_shifts

_SHIFTS = 8
# Sweeps that give elements the area they should hold, each limited to this part of the interface's
# half width, and smoothed over so many half widths.
_SWEEPS = 4
_MOST_SHIFT = 1.0
_SPREAD = 1.0
# Elements about those of air alone, in rings of neighbours, in which air is that of the surface.
_RINGS = 2
# Interface half widths by which the contour is carried on beyond the wall in redistancing.
_CARRIED = 4


SignedDistance = Callable[[NDArray[Any]], NDArray[Any]]


class LevelSet:
    """Quadratic level set phi (m), the signed distance to the free surface, positive in powder.

    ``nodes`` (n, 2) are vertices and edge midpoints, m; ``field`` is the finite-element function,
    ``fraction`` the smoothed powder fraction

        alpha = H(phi/W),  H(z) = 1/2 + 3/4 z - 1/4 z^3 on [-1, 1],

    with W = ``half_width`` (m).  Contour and area are those of the linear interpolant on a lattice
    of triangles within each element.
    """

    def __init__(self, mesh: Any, half_width: float) -> None:
        self.mesh = mesh
        self._half_width = half_width
        self.space = ngs.H1(mesh, order=2)
        self.field = ngs.GridFunction(self.space)
        self.fraction = powder_fraction(self.field, half_width)
        self._edges = np.array([[v.nr for v in edge.vertices] for edge in mesh.edges])
        self._elements = self._element_nodes()
        self._corners = np.ascontiguousarray(self._elements[:, :3])
        coordinate = ngs.GridFunction(self.space)
        columns = []
        for component in (ngs.x, ngs.y):
            coordinate.Set(component)
            columns.append(self.nodal(coordinate.vec.FV().NumPy()))
        self.nodes = np.column_stack(columns)
        self.lattice = ElementLattice(mesh, self.nodes, self._elements)

    def _element_nodes(self) -> NDArray[Any]:
        """Node numbers (n_elements, 6): vertices a, b, c, then midpoints of ab, bc, ca."""
        nodes = []
        for element in self.mesh.Elements(ngs.VOL):
            a, b, c = (v.nr for v in element.vertices)
            midpoint = {
                frozenset(self._edges[edge.nr]): self.mesh.nv + edge.nr for edge in element.edges
            }
            nodes.append(
                [a, b, c, *(midpoint[frozenset(side)] for side in ((a, b), (b, c), (c, a)))]
            )
        return np.array(nodes)

    def lattice_values(self) -> NDArray[Any]:
        """Level set (n_elements, n_points) on the lattice of each element."""
        return self.lattice.values(self.nodal(self._coefficients))

    def nodal(self, coefficients: NDArray[Any]) -> NDArray[Any]:
        """Values at vertices and edge midpoints; NGSolve's edge functions are -1/8 at midpoints."""
        values = coefficients.copy()
        n_vertices = self.mesh.nv
        values[n_vertices:] = self._edge_means(values) - values[n_vertices:] / 8.0
        return values

    def _edge_means(self, values: NDArray[Any]) -> NDArray[Any]:
        means: NDArray[Any] = 0.5 * (values[self._edges[:, 0]] + values[self._edges[:, 1]])
        return means

    def coefficients(self, nodal: NDArray[Any]) -> NDArray[Any]:
        """The inverse of :meth:`nodal`."""
        n_vertices = self.mesh.nv
        values = nodal.copy()
        values[n_vertices:] = 8.0 * (self._edge_means(nodal) - nodal[n_vertices:])
        return values

    def _set_nodal(self, values: NDArray[Any]) -> None:
        self._coefficients[:] = self.coefficients(values)

    @property
    def _coefficients(self) -> NDArray[Any]:
        found: NDArray[Any] = self.field.vec.FV().NumPy()
        return found

    def set_plane(self, bed_area: float, angle: float) -> None:
        """Bed of ``bed_area`` (m^2) with a plane surface inclined by ``angle`` (rad)."""
        offset, normal = surface_offset(self.mesh, bed_area, angle), surface_normal(angle)
        self.set_surface(bed_area, lambda points: offset - points @ np.array(normal))

    def set_surface(self, bed_area: float, distance: SignedDistance) -> None:
        """Bed of ``bed_area`` (m^2) whose surface has this signed distance, shifted to hold it."""
        self.set_distances(bed_area, distance(self.nodes))

    def set_distances(self, bed_area: float, distances: NDArray[Any]) -> None:
        """:meth:`set_surface` by the signed distances (n,) of ``nodes``."""
        self._set_nodal(distances)
        for _ in range(_SHIFTS):
            self.restore_area(bed_area)

    def area(self) -> float:
        """Area inside the zero contour, m^2."""
        return float(self.element_areas().sum())

    def element_areas(self) -> NDArray[Any]:
        """Area (n_elements,) inside the contour, m^2."""
        return self.lattice.areas(self.lattice_values())

    def shift(self, distance: float) -> None:
        """Move the surface outwards by ``distance`` (m)."""
        self._coefficients[: self.mesh.nv] += distance

    def restore_area(self, bed_area: float) -> float:
        """Shift the surface so that it holds ``bed_area`` (m^2); the area that was missing."""
        missing = bed_area - self.area()
        self.shift(missing / self.length())
        return missing

    def contour(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """End points, each (n, 2) in m, of the segments of the zero contour."""
        return self.lattice.contour(self.lattice_values())

    def length(self) -> float:
        """Length of the zero contour, m."""
        start, end = self.contour()
        return float(np.linalg.norm(end - start, axis=1).sum())

    def redistance(self) -> None:
        """Make phi the signed distance to its own zero contour again.

        Where the contour meets the wall it is carried straight on: a distance to its end point
        would have a kink there, which costs area. Then vertices are shifted until the elements
        about each hold the area that they held (which straight segments do not keep).
        """
        held = self.element_areas()
        start, end = self._carried_on(*self.contour())
        distance = distances(self.nodes, start, end)
        self._set_nodal(np.copysign(distance, self.nodal(self._coefficients)))
        self.hold(held)

    def drain(self) -> bool:
        """Fill air below the surface with powder, which lets it through its pores; whether any was.

        Where a bed rolls over bare wall it takes a film of air along, thinner than elements, and
        would slide on it.  Filled are nodes in air that are more than two elements away from any
        element of air alone.
        """
        nodal = self.nodal(self._coefficients)
        air = nodal < 0.0
        reached = np.zeros(len(nodal), dtype=bool)
        reached[self._elements[air[self._elements].all(axis=1)]] = True
        for _ in range(_RINGS):
            reached[self._elements[reached[self._elements].any(axis=1)]] = True
        closed = air & ~reached
        if not closed.any():
            return False
        nodal[closed] *= -1.0
        self._set_nodal(nodal)
        return True

    def hold(self, areas: NDArray[Any]) -> None:
        """Shift vertices until elements hold these ``areas`` (n_elements,), m^2.

        Smoothed over the interface's half width: the sum is met to second order in the shifts.
        """
        most = _MOST_SHIFT * self._half_width
        for _ in range(_SWEEPS):
            values = self.lattice_values()
            now = self.lattice.areas(values)
            lengths = self.lattice.contour_weights(values, 1e-3 * self._half_width)
            spread = _SPREAD * self._half_width
            shifts = vertex_shifts(self._corners, areas - now, lengths, spread, self.mesh.nv)
            self._coefficients[: self.mesh.nv] += np.clip(shifts, -most, most)

    def _carried_on(
        self, start: NDArray[Any], end: NDArray[Any]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """The contour's segments and, at each of its two ends, more of them along a straight line.

        A contour with more ends, as where air gets between powder and wall, is left as it is.
        """
        points = np.concatenate([start, end])
        tree = cKDTree(points)
        reach = self._half_width
        alone = [len(near) == 1 for near in tree.query_ball_point(points, 1e-6 * reach)]
        ends = points[np.array(alone, dtype=bool)]
        if len(ends) != 2:
            return start, end
        more = [start], [end]
        for point in ends:
            near = points[tree.query_ball_point(point, 2.0 * reach)]
            outward = point - near.mean(axis=0)
            length = np.linalg.norm(outward)
            if length == 0.0:
                continue
            stations = point + np.arange(_CARRIED + 1)[:, None] * reach * outward / length
            more[0].append(stations[:-1])
            more[1].append(stations[1:])
        return np.concatenate(more[0]), np.concatenate(more[1])

    def surface_fit(self, reach: float) -> tuple[float, NDArray[Any]]:
        """Inclination (rad) and centre (2,) of the surface within ``reach`` (m) of its centroid.

        Total least squares over the contour, weighted by length.
        """
        start, end = self.contour()
        middle, weight = 0.5 * (start + end), np.linalg.norm(end - start, axis=1)
        centre = np.average(middle, axis=0, weights=weight)
        near = np.linalg.norm(middle - centre, axis=1) < reach
        middle, weight = middle[near], weight[near]
        centre = np.average(middle, axis=0, weights=weight)
        deviation = middle - centre
        _, axes = np.linalg.eigh((deviation * weight[:, None]).T @ deviation)
        tangent = axes[:, 1] * np.copysign(1.0, axes[0, 1])
        return float(np.arctan2(tangent[1], tangent[0])), centre


def powder_fraction(level_set: Any, half_width: float) -> Any:
    """The smooth step alpha(phi/W) as a coefficient function."""
    z = level_set / half_width
    return ngs.IfPos(1.0 - z, ngs.IfPos(1.0 + z, smooth_step(z), 0.0), 1.0)


def smooth_step(z: Any) -> Any:
    """H of `LevelSet` at z in [-1, 1]; arrays or coefficient functions."""
    return 0.5 + 0.75 * z - 0.25 * z**3


def smooth_ramp(z: Any) -> Any:
    """The integral of :func:`smooth_step` from -1 to z in [-1, 1]."""
    return 0.1875 + 0.5 * z + 0.375 * z**2 - 0.0625 * z**4
