"""Geometry `v-blender`: two equal cylinders that meet at a plane (a twin-shell blender)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy.interpolate import PchipInterpolator

from scaleup.contract import FloatArray, Geometry, InputError, PluginOptions, units

_LAB_SPEED = 4.0  # rpm
_PANELS = 1000  # of the height, for volumes


class _Size(NamedTuple):
    """Dimensions of a V-blender, m."""

    arm_diameter: float
    arm_length: float
    outlet: float


_SIZES = {
    "lab": _Size(0.15, 0.22, 0.05),
    "pilot": _Size(0.36, 0.5, 0.1),
    "plant": _Size(0.9, 1.2, 0.2),
}


class VBlender(Geometry):
    """A V-blender: arms up and the point with the outlet down at rest.

    With b half the angle between the arms, the arm at z > 0 is the cylinder of radius R about the
    direction u = (0, cos b, sin b) from the point where the arms' axes meet, cut by the plane z = 0
    and by a flat lid square to u; the other arm is its mirror image. The point of the V is cut off
    level where the opening is as long (along z) as the outlet.
    """

    class Options(PluginOptions):
        """Size of the arms and how they are held."""

        size: Literal["lab", "pilot", "plant"] = "lab"
        """sets the dimensions that are not given: about 8, 100 or 1500 litres"""
        arm_diameter: units.Length | None = None
        """m, inside; default 0.15, 0.36 or 0.9 by size"""
        arm_length: units.Length | None = None
        """m along an arm's axis, from where the axes meet to the lid; default 0.22, 0.5 or 1.2"""
        angle: Annotated[units.Angle, Field(ge=math.radians(30), le=math.radians(150))] = (
            math.radians(80)
        )
        """rad, between the arms"""
        outlet: Annotated[units.Coordinate, Field(ge=0)] | None = None
        """m, length of the opening at the point of the V, 0 for a sharp point; default 0.05, 0.1 or
        0.2"""
        axis_height: units.Length | None = None
        """m, of the axis of rotation above the outlet; default: that of the vessel's centre of
        volume, so that the empty vessel is balanced"""

    @staticmethod
    def default_scene(options: Options) -> Mapping[str, Any]:
        """40 % full; larger vessels turn at the same Froude number, about 4e-3."""
        scale = _SIZES[options.size].arm_diameter / _SIZES["lab"].arm_diameter
        return {
            "operation": {
                "speed": f"{_LAB_SPEED / math.sqrt(scale):.4g} rpm",
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
        """Raises InputError if the arms are too short for their angle or the outlet too long."""
        super().__init__(options)
        size = _SIZES[options.size]
        self.radius = 0.5 * (options.arm_diameter or size.arm_diameter)
        self.length = options.arm_length or size.arm_length
        self.cosine, self.sine = math.cos(options.angle / 2), math.sin(options.angle / 2)
        outlet = size.outlet if options.outlet is None else options.outlet
        if self.length * self.sine <= self.radius * self.cosine:
            raise InputError(
                f"geometry.arm_length = {self.length:g} m: must be above "
                f"{self.radius * self.cosine / self.sine:.4g} m, or the lids would meet"
            )
        if outlet >= 2 * self.radius:
            raise InputError(
                f"geometry.outlet = {outlet:g} m: must be below the arm's diameter "
                f"{2 * self.radius:g} m"
            )
        # heights above the point where the arms' axes meet
        self._bottom = -self.radius / self.sine + 0.5 * outlet * self.cosine / self.sine
        self._top = self.length * self.cosine + self.radius * self.sine
        centre, self.volume, self._below = self._volumes()
        self._axis = centre if options.axis_height is None else self._bottom + options.axis_height
        end = self.length * self.sine + self.radius * self.cosine
        self.lower = (-self.radius, self._bottom - self._axis, -end)
        self.upper = (self.radius, self._top - self._axis, end)
        self.reach = self._greatest_distance()

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside; points (..., 3) in m.

        Exact but near the edge where the arms meet, from which the distance is farther than to the
        continued cylinder that is taken.
        """
        y, z = points[..., 1] + self._axis, np.abs(points[..., 2])
        mantle = self.radius - np.hypot(points[..., 0], z * self.cosine - y * self.sine)
        lid = self.length - (y * self.cosine + z * self.sine)
        beyond = -np.hypot(np.minimum(mantle, 0.0), np.minimum(lid, 0.0))
        arm = np.where((mantle < 0) | (lid < 0), beyond, np.minimum(mantle, lid))
        wall: FloatArray = np.minimum(arm, y - self._bottom)
        return wall

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height."""
        level = min(max(height + self._axis, self._bottom), self._top)
        return float(self._below(level))

    def _area(self, y: FloatArray) -> FloatArray:
        """Area of level sections, m^2; y above the meeting point, m.

        In each arm a part of an ellipse with semi-axes R along x and R/cos b along z, bounded by
        the plane z = 0 and by the lid.
        """
        semi = self.radius / self.cosine
        centre = y * self.sine / self.cosine
        ends = [np.zeros_like(y), (self.length - y * self.cosine) / self.sine]
        near, far = (np.clip((z - centre) / semi, -1.0, 1.0) for z in ends)
        both = [t * np.sqrt(1.0 - t**2) + np.arcsin(t) for t in (near, far)]
        area: FloatArray = 2 * self.radius * semi * np.maximum(both[1] - both[0], 0.0)
        return area

    def _volumes(self) -> tuple[float, float, PchipInterpolator]:
        """Height of the centre of volume (m), volume (m^3), and volume below any height."""
        nodes, weights = np.polynomial.legendre.leggauss(4)
        heights = np.linspace(self._bottom, self._top, _PANELS + 1)
        half = 0.5 * (heights[1] - heights[0])
        y = (0.5 * (heights[1:] + heights[:-1]))[:, None] + half * nodes
        area = self._area(y) * weights * half
        below = np.concatenate([[0.0], np.cumsum(area.sum(axis=1))])
        return (
            float((y * area).sum() / below[-1]),
            float(below[-1]),
            PchipInterpolator(heights, below),
        )

    def _greatest_distance(self) -> float:
        """m, from the axis of rotation: found on the lid's rim or where the arms meet."""
        angle = np.linspace(0.0, 2 * math.pi, 7201)
        x = self.radius * np.cos(angle)
        rim = self.length * self.cosine + self.radius * self.sine * np.sin(angle)
        meeting = np.maximum(self.radius / self.sine * np.sin(angle), self._bottom)
        x_there = np.sqrt(np.maximum(self.radius**2 - (meeting * self.sine) ** 2, 0.0))
        return float(
            max(np.hypot(x, rim - self._axis).max(), np.hypot(x_there, meeting - self._axis).max())
        )

    def solid(self) -> Any:
        """The inside as a netgen OCC solid, m; its faces are named `wall`."""
        from netgen.occ import Axes, Box, Cylinder, Pnt, Vec, X, Z  # meshing only

        far = self.radius + self.length + self.radius / self.sine
        along = Vec(0, self.cosine, self.sine)
        foot = Pnt(0, -far * self.cosine, -far * self.sine)
        cylinder = Cylinder(Axes(foot, along, X), r=self.radius, h=far + self.length)
        arm = cylinder * Box(Pnt(-far, self._bottom, 0), Pnt(far, 2 * far, 2 * far))
        shape = arm + arm.Mirror(Axes(Pnt(0, 0, 0), Z, X))
        shape.faces.name = "wall"
        return shape.Move(Vec(0, -self._axis, 0))
