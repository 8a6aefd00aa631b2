"""Vessels with flat walls and without re-entrant edges."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import igl
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, QhullError

from scaleup.contract import Geometry
from scaleup.space.convex_hull import mirrored_in_z, outward_hull
from scaleup.space.grid import FloatArray
from scaleup.space.solids import FlatSolid
from scaleup.system.errors import InputError

_ROUND_OFF = 1e-9  # of the size: a corner no further from a plane lies in it


class ConvexPolyhedron(Geometry):
    """A convex vessel with flat walls, by its corners; the axis of rotation is z.

    faces -- polygons (corners, 3), m, anticlockwise seen from outside
    All but the options and the default scene follows; a plugin hands over its corners:

        def __init__(self, options):
            super().__init__(options, corners)    # or corners_within(planes)
    """

    def __init__(self, options: Any, corners: ArrayLike):
        """`corners`: m, (n, 3). Raises InputError if they are no convex body's."""
        super().__init__(options)
        points = np.asarray(corners, dtype=float)
        try:
            hull, (_, self._triangles) = outward_hull(points)
        except (QhullError, ValueError) as error:
            raise InputError("geometry: the corners of the vessel span no body") from error
        self._points = points
        self._planes, self.faces = _faces(points, hull)
        within = -(points @ self._planes[:, :3].T + self._planes[:, 3]).max(axis=1)
        if within.max() > _ROUND_OFF * np.ptp(points, axis=0).max():
            where = ", ".join(f"{x:.4g}" for x in points[within.argmax()])
            raise InputError(
                f"geometry: the corner ({where}) m lies within the body that the others span; a "
                "convex vessel has no such corner"
            )
        self.lower = tuple(float(x) for x in points.min(axis=0))
        self.upper = tuple(float(x) for x in points.max(axis=0))
        self.reach = float(np.linalg.norm(points[:, :2] - self.axis.point[:2], axis=1).max())
        self.volume = self._solid.mass
        self.symmetry = ((0.0, 0.0, 1.0),) if mirrored_in_z(points) else ()

    @cached_property
    def _solid(self) -> FlatSolid:
        return FlatSolid(self.faces)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside, exact; points (..., 3) in m.

        Inside that to the nearest plane, outside that to the nearest triangle.
        """
        flat = points.reshape(-1, 3)
        depth = np.full(len(flat), np.inf)
        for plane in self._planes:
            np.minimum(depth, -(flat @ plane[:3] + plane[3]), out=depth)
        out = depth < 0
        if out.any():
            squared = igl.point_mesh_squared_distance(flat[out], self._points, self._triangles)[0]
            depth[out] = -np.sqrt(squared)
        return depth.reshape(points.shape[:-1])

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height, exact."""
        return self._solid.surface.volume_below(height)

    def solid(self) -> FlatSolid:
        """The inside, by its faces."""
        return self._solid


def corners_within(planes: ArrayLike) -> FloatArray:
    """Corners (n, 3), m, of the body n.x + d <= 0 within planes (m, 4), rows (n, d); n outwards.

    Raises InputError if there is nothing within them, or no end to it.

    >>> cube = [(*n, -1.0) for n in np.vstack([np.eye(3), -np.eye(3)])]
    >>> sorted(corners_within(cube).tolist())[0]
    [-1.0, -1.0, -1.0]
    """
    rows = np.asarray(planes, dtype=float)
    rows = rows / np.linalg.norm(rows[:, :3], axis=1)[:, None]
    # the middle of the largest ball within: n.x + radius <= -d
    bounds = [(None, None)] * 3 + [(0.0, None)]
    lengths = np.ones((len(rows), 1))
    largest = linprog(
        (0, 0, 0, -1.0), A_ub=np.hstack([rows[:, :3], lengths]), b_ub=-rows[:, 3], bounds=bounds
    )
    if largest.status == 0 and largest.x[3] > 0:
        middle = largest.x[:3]
        try:  # corners are the faces of the dual body, which holds the middle if they are all
            dual = ConvexHull(rows[:, :3] / -(rows[:, :3] @ middle + rows[:, 3])[:, None]).equations
        except QhullError:  # nor do they span space
            dual = np.zeros((1, 4))
        if dual[:, 3].max() < 0:
            normals = np.unique(dual, axis=0)
            corners: FloatArray = middle - normals[:, :3] / normals[:, 3:]
            return corners
    raise InputError("geometry: the planes of the vessel's walls enclose no body")


def _faces(points: FloatArray, hull: Any) -> tuple[FloatArray, tuple[FloatArray, ...]]:
    """Planes (m, 4) and polygons of a hull, its triangles in one plane put together."""
    near = _ROUND_OFF * np.ptp(points, axis=0).max()
    planes: list[FloatArray] = []
    faces = []
    for plane, triangle in zip(hull.equations, hull.simplices, strict=True):
        known = np.array(planes).reshape(-1, 4)
        same = np.abs(points[triangle] @ known[:, :3].T + known[:, 3]).max(axis=0) < near
        if np.any(same & (known[:, :3] @ plane[:3] > 0)):
            continue
        planes.append(plane)
        corners = points[hull.vertices]
        corners = corners[np.abs(corners @ plane[:3] + plane[3]) < near]
        spoke = corners - corners.mean(axis=0)
        right = spoke[0] / np.linalg.norm(spoke[0])
        up = np.cross(plane[:3], right)
        faces.append(corners[np.argsort(np.arctan2(spoke @ up, spoke @ right))])
    return np.array(planes), tuple(faces)
