"""Geometry `drum`: the circular cross-section of a long horizontal cylinder without end walls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from scaleup.api import Axis, FloatArray, PluginOptions, units


class Drum:
    """A rotating drum, modelled as its 2-D cross-section (every plane along the axis is alike).

    The defaults are the drum of Liu, Gonzalez & Wassgren 2018 (Tables 1 and 2).
    """

    class Options(PluginOptions):
        """Size of the drum."""

        diameter: units.Length = 0.14
        """m, inside"""
        width: units.Length = 0.01
        """m along the axis; scales volumes and masses only"""

    default_scene: ClassVar[Mapping[str, Any]] = {
        "operation": {
            "speed": "6 rpm",
            "fill": {"depth_ratio": 0.35},
            "loading": "side-by-side",
            "revolutions": 3,
        },
        "flow": {"name": "mohr-coulomb"},
        "mixing": {"name": "finite-volume"},
        "grid": {"spacing": "0.3 mm"},
    }

    dimension = 2
    axis = Axis()

    def __init__(self, options: Options):
        self.radius = 0.5 * options.diameter
        self.depth = options.width
        self.reach = self.radius
        self.lower = (-self.radius, -self.radius)
        self.upper = (self.radius, self.radius)
        self.volume = math.pi * self.radius**2 * self.depth

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside; points (..., 2) in m."""
        return self.radius - np.hypot(points[..., 0], points[..., 1])

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height: the circular segment R^2 (a - sin a cos a) x width."""
        cosine = min(1.0, max(-1.0, -height / self.radius))
        half_angle = math.acos(cosine)
        segment = half_angle - math.sin(half_angle) * cosine
        return self.radius**2 * segment * self.depth

    def solid(self) -> Any:
        """The cross-section as a netgen OCC face, m; its edge is named `wall`."""
        from netgen.occ import Circle, Pnt  # meshing is the only use of netgen here

        face = Circle(Pnt(0, 0), self.radius).Face()
        face.edges.name = "wall"
        return face
