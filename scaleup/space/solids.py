"""Solids in plain numbers: a flow model makes the shapes of its own mesher of them.

Like a netgen OCC solid they state their `mass` (the volume, m^3) and `center` (of volume, m).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from scaleup.space.closed_surface import ClosedSurface
from scaleup.space.grid import FloatArray


class Point(NamedTuple):
    """A point in space, m."""

    x: float
    y: float
    z: float


@dataclass(frozen=True, eq=False)
class FlatSolid:
    """A body within plane walls.

    faces -- polygons (corners, 3), m, anticlockwise seen from outside
    """

    faces: tuple[FloatArray, ...]

    @cached_property
    def surface(self) -> ClosedSurface:
        """Its triangles: each face as a fan."""
        fans = [[face[[0, k, k + 1]] for k in range(1, len(face) - 1)] for face in self.faces]
        corners = np.concatenate(fans)
        return ClosedSurface(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))

    @property
    def mass(self) -> float:
        """m^3."""
        return self.surface.volume

    @property
    def center(self) -> Point:
        """Of volume, m."""
        return Point(*self.surface.centroid)


@dataclass(frozen=True, eq=False)
class TurnedSolid:
    """What a profile sweeps when it is turned about an axis, between two lids square to that.

    heights   -- m along the axis, (n,), not falling
    radii     -- m from it, (n,); straight from one to the next
    origin    -- m, (3,), where the height is 0
    direction -- of the axis, a unit vector (3,)
    """

    heights: FloatArray
    radii: FloatArray
    origin: FloatArray
    direction: FloatArray

    def volume_up_to(self, height: float) -> float:
        """m^3 between the first height and the given one: frusta of cones."""
        level = float(np.clip(height, self.heights[0], self.heights[-1]))
        below = self.heights < level
        y = np.append(self.heights[below], level)
        r = np.append(self.radii[below], np.interp(level, self.heights, self.radii))
        return float(np.pi / 3 * np.sum(np.diff(y) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)))

    @cached_property
    def mass(self) -> float:
        """m^3."""
        return self.volume_up_to(math.inf)

    @property
    def center(self) -> Point:
        """Of volume, m."""
        y, r = self.heights, self.radii
        h, d = np.diff(y), np.diff(r)
        y, r = y[:-1], r[:-1]
        moment = h * (y * (r**2 + r * d + d**2 / 3) + h * (r**2 / 2 + 2 * r * d / 3 + d**2 / 4))
        return Point(*(self.origin + math.pi * moment.sum() / self.mass * self.direction))
