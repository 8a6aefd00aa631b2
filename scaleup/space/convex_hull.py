"""Convex hulls of points in space."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from scaleup.space.grid import FloatArray, IntArray


def outward_hull(points: FloatArray) -> tuple[Any, tuple[FloatArray, IntArray]]:
    """The convex hull of points (..., 3) and its triangles, seen anticlockwise from outside.

    As (scipy's ConvexHull, (points (n, 3), numbers of the triangles' corners (m, 3))).
    """
    points = points.reshape(-1, 3)
    hull = ConvexHull(points)
    faces = hull.simplices.astype(np.int64)
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inwards = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return hull, (points, faces)


def mirrored_in_z(corners: FloatArray) -> bool:
    """Whether the set of corners (n, 3) is its own mirror image in z = 0."""
    image = corners * np.array([1.0, 1.0, -1.0])
    gap = np.linalg.norm(corners[:, None, :] - image[None, :, :], axis=-1).min(axis=1)
    return bool(gap.max() < 1e-9 * float(np.abs(corners).max()))
