"""Volumes under a closed triangulated surface, exactly."""

from __future__ import annotations

import numpy as np

from scaleup.space.grid import FloatArray, IntArray


class ClosedSurface:
    """A watertight surface of triangles, its corners in anticlockwise order seen from outside.

    vertices -- m, (v, 3); faces -- vertex numbers, (n, 3)

    Volumes follow from the divergence theorem with F = (0, y - h, 0), which vanishes on the plane
    y = h: the volume below it is the flux of F through the part of the surface below it.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray):
        corner = vertices[faces]
        normal = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        self._upward = normal[:, 1]
        self._heights = np.sort(corner[:, :, 1], axis=1)
        self.volume = self.volume_below(float(vertices[:, 1].max()))
        # x of the centroid is the flux of (x^2/2, 0, 0) over the volume, and so for y and z
        squares = (corner**2).sum(axis=1) + corner.sum(axis=1) ** 2
        self.centroid = (normal * squares).sum(axis=0) / (24 * self.volume)

    def volume_below(self, height: float) -> float:
        """m^3 enclosed below the level y = height (m)."""
        a, b, c = (self._heights - height).T
        mean = np.where(c <= 0, (a + b + c) / 3, 0.0)
        one = (a < 0) & (b >= 0)
        mean[one] = a[one] ** 3 / (3 * (a - b) * (a - c))[one]
        two = (b < 0) & (c > 0)
        mean[two] = ((a + b + c) / 3)[two] - c[two] ** 3 / (3 * (c - a) * (c - b))[two]
        return float(mean @ self._upward)
