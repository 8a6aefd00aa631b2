"""A blender written against scaleup.contract alone, as a third party would."""

import math
from typing import Any, ClassVar

import numpy as np

from scaleup.contract import FloatArray, Geometry, PluginOptions, units


class Tin(Geometry):
    """A tin on rollers."""

    class Options(PluginOptions):
        """Size of the tin."""

        radius: units.Length = 0.05
        """m, inside"""

    default_scene: ClassVar[dict[str, Any]] = {
        "operation": {"speed": "8 rpm", "fill": {"volume_fraction": 0.4}, "revolutions": 0.5},
        "flow": {"name": "surface-layer"},
        "mixing": {"name": "lax-wendroff"},
        "grid": {"spacing": "1 mm"},
    }
    dimension = 2
    depth = 0.1

    def __init__(self, options: Options):
        super().__init__(options)
        r = self.reach = options.radius
        self.lower, self.upper = (-r, -r), (r, r)
        self.volume = math.pi * r**2 * self.depth

    def signed_distance(self, points: FloatArray) -> FloatArray:
        return self.reach - np.hypot(points[..., 0], points[..., 1])

    def volume_below(self, height: float) -> float:
        half = math.acos(min(1.0, max(-1.0, -height / self.reach)))
        return self.reach**2 * (half - math.sin(half) * math.cos(half)) * self.depth

    def solid(self) -> Any:
        from netgen.occ import Circle, Pnt

        return Circle(Pnt(0, 0), self.reach).Face()
