"""Distances to a triangulated surface: exact near the wall, interpolated far from it.

A distance changes by no more than the way gone, so an interpolation between exact values at the
nodes of a lattice of edge H errs by at most sqrt(3) H. Of many points, only those whose
interpolated distance is below (1 + sqrt(3)) H, which include all within H of the wall, are searched
for in the tree of triangles.
"""

from __future__ import annotations

import math
from functools import cached_property

import igl
import numpy as np
from scipy.ndimage import map_coordinates

from scaleup.contract import FloatArray, IntArray
from scaleup.numerics import ClosedSurface

_LATTICE = 48  # edges H along the longest side of the box
_MANY = 200_000  # points from which the lattice pays
_MIRRORED = 5000  # vertices at which mirror images are compared


class Surface(ClosedSurface):
    """A closed surface with distances. Vertices (v, 3) in m, faces (n, 3) outwards."""

    def __init__(self, vertices: FloatArray, faces: IntArray):
        super().__init__(vertices, faces)
        self.vertices, self.faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """m, positive inside; points (..., 3) in m."""
        flat = np.ascontiguousarray(points.reshape(-1, 3))
        if len(flat) < _MANY:
            return self._exact(flat).reshape(points.shape[:-1])
        lower, edge, nodes = self._lattice
        position = (flat - lower) / edge
        distance = map_coordinates(nodes, position.T, order=1, mode="nearest")
        near = np.abs(distance) < (1 + math.sqrt(3)) * edge
        distance[near] = self._exact(flat[near])
        return distance.reshape(points.shape[:-1])

    def is_mirrored(self, tolerance: float) -> bool:
        """Whether the vertices' mirror images in z = 0 lie on the surface, to a tolerance in m."""
        some = self.vertices[:: max(1, len(self.vertices) // _MIRRORED)]
        image = np.ascontiguousarray(some * np.array([1.0, 1.0, -1.0]))
        squared = igl.point_mesh_squared_distance(image, self.vertices, self.faces)[0]
        return bool(squared.max() < tolerance**2)

    def _exact(self, points: FloatArray) -> FloatArray:
        kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        outwards = igl.signed_distance(points, self.vertices, self.faces, kind)[0]
        inwards: FloatArray = -outwards
        return inwards

    @cached_property
    def _lattice(self) -> tuple[FloatArray, float, FloatArray]:
        """Lower corner (m), edge H (m) and exact distances at the nodes, [x, y, z]."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        edge = float((high - low).max()) / _LATTICE
        lower = low - 2 * edge
        counts = np.ceil((high - low) / edge).astype(int) + 5
        lines = [corner + edge * np.arange(n) for corner, n in zip(lower, counts, strict=True)]
        points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
        return lower, edge, self._exact(points).reshape(counts)
