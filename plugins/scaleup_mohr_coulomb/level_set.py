"""The powder's free surface as the zero contour of a level set."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .block_solver import PositiveSolver
from .factors import SymmetricFactors
from .mesh import surface_normal, surface_offset

_NEIGHBOURS = 8
_SHIFTS = 8
_SUBDIVISIONS = 4
# Sweeps that give elements back the area they had before redistancing, each limited to this part of
# the interface's half width.
_SWEEPS = 3
_MOST_SHIFT = 0.1
# Interface half widths by which the contour is carried on beyond the wall in redistancing.
_CARRIED = 4


class LevelSet:
    """Quadratic level set phi (m), the signed distance to the free surface, positive in powder.

    ``field`` is the finite-element function, ``fraction`` the smoothed powder fraction

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
        coordinate = ngs.GridFunction(self.space)
        columns = []
        for component in (ngs.x, ngs.y):
            coordinate.Set(component)
            columns.append(self._nodal(coordinate))
        self._nodes = np.column_stack(columns)
        self._lattice, self._triangles = _quadratic_lattice(_SUBDIVISIONS)
        self._lattice_points = np.einsum("ln,end->eld", self._lattice, self._nodes[self._elements])
        self._areas = self._triangle_areas()

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

    def _triangle_areas(self) -> NDArray[Any]:
        """Areas (n_elements, n_triangles) of the lattice's triangles, summing to the elements'."""
        corners = self._lattice_points[:, self._triangles]
        areas = 0.5 * np.abs(np.linalg.det(corners[:, :, 1:] - corners[:, :, :1]))
        curved = np.array(ngs.Integrate(1.0, self.mesh, element_wise=True))
        scaled: NDArray[Any] = areas * (curved / areas.sum(axis=1))[:, None]
        return scaled

    def _lattice_values(self) -> NDArray[Any]:
        """Level set (n_elements, n_points) on the lattice of each element."""
        values: NDArray[Any] = self._nodal(self.field)[self._elements] @ self._lattice.T
        return values

    def _nodal(self, function: Any) -> NDArray[Any]:
        """Values at vertices and edge midpoints; NGSolve's edge functions are -1/8 at midpoints."""
        values: NDArray[Any] = function.vec.FV().NumPy().copy()
        n_vertices = self.mesh.nv
        values[n_vertices:] = values[self._edges].mean(axis=1) - values[n_vertices:] / 8.0
        return values

    def _set_nodal(self, values: NDArray[Any]) -> None:
        n_vertices = self.mesh.nv
        coefficients = values.copy()
        coefficients[n_vertices:] = 8.0 * (values[self._edges].mean(axis=1) - values[n_vertices:])
        self.field.vec.FV().NumPy()[:] = coefficients

    def set_plane(self, bed_area: float, angle: float) -> None:
        """Bed of ``bed_area`` (m^2) with a plane surface inclined by ``angle`` (rad)."""
        offset = surface_offset(self.mesh, bed_area, angle)
        self._set_nodal(offset - self._nodes @ np.array(surface_normal(angle)))
        for _ in range(_SHIFTS):
            self.restore_area(bed_area)

    def area(self) -> float:
        """Area inside the zero contour, m^2."""
        return float(self._element_areas().sum())

    def _element_areas(self, shift: float = 0.0) -> NDArray[Any]:
        """Area (n_elements,) inside the contour, moved outwards by ``shift`` (m), m^2."""
        values = self._lattice_values() + shift
        inside: NDArray[Any] = self._areas * _inside_fraction(values[:, self._triangles])
        return inside.sum(axis=1)

    def shift(self, distance: float) -> None:
        """Move the surface outwards by ``distance`` (m)."""
        self.field.vec.FV().NumPy()[: self.mesh.nv] += distance

    def restore_area(self, bed_area: float) -> float:
        """Shift the surface so that it holds ``bed_area`` (m^2); the area that was missing."""
        missing = bed_area - self.area()
        self.shift(missing / self.length())
        return missing

    def contour(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """End points, each (n, 2) in m, of the segments of the zero contour."""
        values = self._lattice_values()
        crossed = (values > 0.0).any(axis=1) & (values <= 0.0).any(axis=1)
        values = values[crossed][:, self._triangles].reshape(-1, 3)
        corners = self._lattice_points[crossed][:, self._triangles].reshape(-1, 3, 2)
        inside = values > 0.0
        n_inside = inside.sum(axis=1)
        cut = (n_inside == 1) | (n_inside == 2)
        values, corners, inside, n_inside = values[cut], corners[cut], inside[cut], n_inside[cut]
        alone = np.where(n_inside == 1, inside.argmax(axis=1), (~inside).argmax(axis=1))
        rows = np.arange(len(values))

        def crossing(turn: int) -> NDArray[Any]:
            """Where the contour crosses the side between the lone corner and a neighbour."""
            other = (alone + turn) % 3
            near, far = values[rows, alone], values[rows, other]
            weight = (near / (near - far))[:, None]
            point: NDArray[Any] = (1.0 - weight) * corners[rows, alone]
            point += weight * corners[rows, other]
            return point

        return crossing(1), crossing(2)

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
        held = self._element_areas()
        start, end = self._carried_on(*self.contour())
        side = end - start
        square = (side**2).sum(axis=1)
        start, side, square = start[square > 0], side[square > 0], square[square > 0]
        _, nearest = cKDTree(start + 0.5 * side).query(self._nodes, k=min(_NEIGHBOURS, len(start)))
        nearest = nearest.reshape(len(self._nodes), -1)
        to_node = self._nodes[:, None, :] - start[nearest]
        along = np.clip((to_node * side[nearest]).sum(axis=2) / square[nearest], 0.0, 1.0)
        distance = np.linalg.norm(to_node - along[:, :, None] * side[nearest], axis=2).min(axis=1)
        self._set_nodal(np.copysign(distance, self._nodal(self.field)))
        for _ in range(_SWEEPS):
            self._give_back(held)

    def _give_back(self, held: NDArray[Any]) -> None:
        """Shift vertices by what the elements about them lack over the contour's length there."""
        small = 1e-3 * self._half_width
        missing = held - self._element_areas()
        length = (self._element_areas(small) - self._element_areas(-small)) / (2.0 * small)
        vertices, count = self._elements[:, :3].ravel(), self.mesh.nv
        lacks = np.bincount(vertices, np.repeat(missing, 3), count)
        lengths = np.bincount(vertices, np.repeat(length, 3), count)
        shift = np.divide(lacks, lengths, out=np.zeros(count), where=lengths > small)
        most = _MOST_SHIFT * self._half_width
        self.field.vec.FV().NumPy()[:count] += np.clip(shift, -most, most)

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


def _quadratic_lattice(divisions: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Quadratic shape functions (n_points, 6) on a lattice, and its triangles (divisions^2, 3)."""
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
    return shapes, np.array(triangles)


def _inside_fraction(values: NDArray[Any]) -> NDArray[Any]:
    """Part of each triangle where the linear function of corner ``values`` (..., 3) is positive."""
    low, middle, high = np.moveaxis(np.sort(values, axis=-1), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        top = high**2 / ((high - low) * (high - middle))
        bottom = low**2 / ((high - low) * (middle - low))
    cut = np.where(middle > 0.0, 1.0 - bottom, top)
    return np.where(low > 0.0, 1.0, np.where(high <= 0.0, 0.0, cut))


def powder_fraction(level_set: Any, half_width: float) -> Any:
    """The smooth step alpha(phi/W) as a coefficient function."""
    z = level_set / half_width
    step = 0.5 + 0.75 * z - 0.25 * z**3
    return ngs.IfPos(1.0 - z, ngs.IfPos(1.0 + z, step, 0.0), 1.0)


class Transport:
    """Least-squares Crank-Nicolson step of d phi/dt + u.grad phi = 0.

    phi^{n+1} minimises the integral of [(phi - phi^n)/dt + u.grad(phi + phi^n)/2]^2: for all s,

        int (phi^{n+1} - phi^n + dt/2 u.grad(phi^{n+1} + phi^n)) (s + dt/2 u.grad s) = 0.

    This is the streamline-upwind Petrov-Galerkin method with the parameter dt/2, its value at small
    Courant numbers, and has a symmetric, positive definite matrix.  u is the mid-step velocity, a
    coefficient function that the caller keeps up to date; so is the time step (s) unless a number.
    """

    def __init__(self, level_set: Any, velocity: Any, time_step: Any) -> None:
        self._field = level_set.field
        phi, s = level_set.space.TnT()

        def along(function: Any) -> Any:
            return 0.5 * time_step * ngs.InnerProduct(velocity, ngs.grad(function))

        test = s + along(s)
        self._matrix = ngs.BilinearForm(level_set.space, symmetric=True)
        self._matrix += ((phi + along(phi)) * test).Compile() * ngs.dx
        self._load = ngs.LinearForm(level_set.space)
        self._load += ((self._field - along(self._field)) * test).Compile() * ngs.dx
        self._solver: Any = (
            SymmetricFactors(self._matrix)
            if level_set.mesh.dim == 2
            else PositiveSolver(self._matrix)
        )

    def step(self) -> None:
        """Replace phi^n by phi^{n+1}."""
        self._matrix.Assemble()
        self._load.Assemble()
        self._solver.update()
        self._solver.solve(self._load.vec, self._field.vec)


class SolenoidalVelocity:
    """The velocity without divergence, and without flux through the wall, nearest to another.

    ``field`` is (d psi/dy, -d psi/dx) of a cubic stream function psi that vanishes at the wall and
    minimises the integral of |(d psi/dy, -d psi/dx) - u|^2.  The momentum's velocity is free of
    divergence against linear pressures only: moved by it, a bed loses some 1e-5 of its area in
    every step.  For simply connected cross-sections.
    """

    def __init__(self, velocity: Any, mesh: Any) -> None:
        space = ngs.H1(mesh, order=3, dirichlet=".*")
        psi, s = space.TnT()
        matrix = ngs.BilinearForm(space, symmetric=True)
        matrix += ngs.grad(psi) * ngs.grad(s) * ngs.dx
        matrix.Assemble()
        self._inverse = matrix.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky")
        self._load = ngs.LinearForm(space)
        across = velocity[0] * ngs.grad(s)[1] - velocity[1] * ngs.grad(s)[0]
        self._load += across.Compile() * ngs.dx
        self._psi = ngs.GridFunction(space)
        slope = ngs.grad(self._psi)
        self.field = ngs.CoefficientFunction((slope[1], -slope[0]))

    def update(self) -> None:
        """Follow the other velocity, which its owner has changed."""
        self._load.Assemble()
        self._psi.vec.data = self._inverse * self._load.vec
