"""Vessels of a few lines, by their signed distance alone."""

from __future__ import annotations

import math

import numpy as np

from scaleup.contract import Geometry
from scaleup.numerics import cut_fraction, grid_over
from scaleup_drum import Drum


class SignedDistanceVessel(Geometry):
    """A 3-D vessel that states its box and its distance; the volumes are counted on a grid."""

    def count(self, cells: int = 60) -> None:
        grid = grid_over(self.lower, self.upper, 2 * self.reach / cells, 1.0)
        corners = grid.corner_points()
        self._cell, self._height = grid.cell_volume, corners[..., 1]
        self._wall = self.signed_distance(corners)
        self.volume = self.volume_below(self.upper[1])

    def volume_below(self, height: float) -> float:
        below = np.minimum(self._wall, height - self._height)
        return float(cut_fraction(below).sum() * self._cell)


def closed_drum() -> Drum:
    """A cylinder with end walls, half as long as wide."""
    return Drum(Drum.Options(diameter=0.14, length=0.07))


class TiltedBox(SignedDistanceVessel):
    """A box turned about z and off its axis of rotation."""

    def __init__(self, edges=(0.1, 0.14, 0.08), angle=0.4, offset=0.02):
        self.edges, self.angle, self.offset = np.array(edges), angle, offset
        corners = np.array([[a, b] for a in (-0.5, 0.5) for b in (-0.5, 0.5)]) * self.edges[:2]
        c, s = math.cos(angle), math.sin(angle)
        places = corners @ np.array([[c, s], [-s, c]]) + (0.0, offset)
        self.reach = float(np.hypot(*places.T).max())
        low, high = places.min(axis=0), places.max(axis=0)
        self.lower = (float(low[0]), float(low[1]), -edges[2] / 2)
        self.upper = (float(high[0]), float(high[1]), edges[2] / 2)
        self.count()

    def signed_distance(self, points):
        x, y = points[..., 0], points[..., 1] - self.offset
        c, s = math.cos(self.angle), math.sin(self.angle)
        inside = np.stack([c * x + s * y, -s * x + c * y, points[..., 2]], axis=-1)
        return (0.5 * self.edges - np.abs(inside)).min(axis=-1)


class Vee(SignedDistanceVessel):
    """Two cylinders that meet at an angle of 80 degrees."""

    def __init__(self, radius=0.05, length=2.3):
        tilt = math.radians(40.0)
        self.radius, self.tilt, self.length = radius, tilt, length * radius
        lowest = -radius / math.sin(tilt)
        highest = self.length * math.cos(tilt) + radius * math.sin(tilt)
        self.shift = -0.5 * (lowest + highest)
        wide = self.length * math.sin(tilt) + radius * math.cos(tilt)
        top = highest + self.shift
        self.reach = max(top, math.hypot(radius, self.length * math.cos(tilt) + self.shift))
        self.lower = (-radius, lowest + self.shift, -wide)
        self.upper = (radius, top, wide)
        self.count()

    def signed_distance(self, points):
        x, y, side = points[..., 0], points[..., 1] - self.shift, np.abs(points[..., 2])
        along = math.cos(self.tilt) * y + math.sin(self.tilt) * side
        across = -math.sin(self.tilt) * y + math.cos(self.tilt) * side
        return np.minimum(self.radius - np.hypot(x, across), self.length - along)
