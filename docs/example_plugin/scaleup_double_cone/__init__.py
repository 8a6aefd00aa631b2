"""Geometry `double-cone`: a double-cone blender."""

from typing import Any, ClassVar

import numpy as np

from scaleup.contract import FloatArray, Geometry, InputError, PluginOptions, units


class DoubleCone(Geometry):
    """A cylinder between two cones, turned about a horizontal axis across its middle.

    At rest the cones point up and down. The axis of rotation is z, gravity points along -y.
    """

    class Options(PluginOptions):
        """Inside dimensions."""

        diameter: units.Length = 0.3
        """m, of the cylinder"""
        cylinder: units.Length = 0.08
        """m, height of the cylinder"""
        cone: units.Length = 0.12
        """m, height of each cone"""
        opening: units.Length = 0.06
        """m, diameter where a cone ends"""

    default_scene: ClassVar[dict[str, Any]] = {
        "operation": {
            "speed": "4 rpm",
            "fill": {"volume_fraction": 0.4},
            "loading": "top-bottom",
            "revolutions": 10,
        },
        "flow": {"name": "surface-layer"},
        "mixing": {"name": "semi-lagrangian"},
        "grid": {"cells": 2e5},
    }

    symmetry = ((0.0, 0.0, 1.0),)

    def __init__(self, options: Options):
        """Raises InputError if the cones do not narrow."""
        if options.opening >= options.diameter:
            raise InputError(
                f"geometry.opening = {options.opening:g} m: must be below the diameter "
                f"{options.diameter:g} m"
            )
        super().__init__(options)
        wide, narrow = 0.5 * options.diameter, 0.5 * options.opening
        middle = 0.5 * options.cylinder
        top = middle + options.cone
        # the profile: radius against height
        self.heights = np.array([-top, -middle, middle, top])
        self.radii = np.array([narrow, wide, wide, narrow])
        slant = np.array([options.cone, wide - narrow])
        self.normal = slant / np.linalg.norm(slant)  # of the cone, (radial, upwards)
        self.reach = float(max(wide, np.hypot(narrow, top), np.hypot(wide, middle)))
        self.lower, self.upper = (-wide, -top, -wide), (wide, top, wide)
        self.volume = self.volume_below(top)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside: that to the nearest of its three kinds."""
        radius = np.hypot(points[..., 0], points[..., 2])
        height = np.abs(points[..., 1])
        mantle, lid = self.radii[1] - radius, self.heights[3] - height
        cone = mantle * self.normal[0] + (self.heights[2] - height) * self.normal[1]
        return np.minimum(np.minimum(mantle, lid), cone)

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height: frusta between the corners of the profile."""
        level = float(np.clip(height, self.heights[0], self.heights[3]))
        y = np.append(self.heights[self.heights < level], level)
        r = np.interp(y, self.heights, self.radii)
        return float(np.pi / 3 * np.sum(np.diff(y) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2)))

    def solid(self) -> Any:
        """The inside as a netgen OCC solid, m: the profile turned about y."""
        from netgen.occ import Axis, Face, Pnt, Segment, Wire, Y  # for meshing only

        radii, heights = [0.0, *self.radii, 0.0], self.heights[[0, 0, 1, 2, 3, 3]]
        corners = [Pnt(r, y, 0) for r, y in zip(radii, heights, strict=True)]
        outline = Wire([Segment(corners[k - 1], corners[k]) for k in range(6)])
        return Face(outline).Revolve(Axis(Pnt(0, 0, 0), Y), 360.0)
