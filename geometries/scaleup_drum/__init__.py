"""Geometry `drum`: a horizontal cylinder, as its 2-D cross-section or closed by end walls."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from scaleup.contract import FloatArray, Geometry, InputError, PluginOptions, units

_SIZES = {"lab": (0.14, 0.2), "pilot": (0.572, 0.851), "plant": (1.5, 2.25)}
"""m, diameter and length: the drum of Liu, Gonzalez & Wassgren 2018 (the length is ours), the
inside of a 55-gallon drum (22.5 in by 33.5 in), and a typical rotary batch mixer of 4 m^3"""
_WIDTH = 0.01  # m, of the cross-section
_LAB_SPEED, _CELLS_ACROSS = 6.0, 467  # rpm; nodes across the diameter, as in the paper
_STRIPS = np.polynomial.legendre.leggauss(64)  # of a baffle's thickness, for volumes


class Drum(Geometry):
    """A rotating drum.

    Without end walls every cross-section is alike and the scene is 2-D; its defaults are the drum
    of Liu, Gonzalez & Wassgren 2018 (Tables 1 and 2). With end walls it is 3-D. Baffles are flat
    plates that stand radially on the mantle, along the whole length.
    """

    class Options(PluginOptions):
        """Size of the drum and what stands inside."""

        size: Literal["lab", "pilot", "plant"] = "lab"
        """sets the dimensions that are not given: 140 mm, 572 mm or 1.5 m across"""
        diameter: units.Length | None = None
        """m, inside"""
        end_walls: bool | None = None
        """a 3-D drum with flat end walls; default: if a length is given"""
        length: units.Length | None = None
        """m between the end walls; default 0.2, 0.851 or 2.25 by size"""
        width: units.Length | None = None
        """m along the axis that the 2-D cross-section stands for (default 10 mm); scales volumes
        and masses only"""
        baffles: Annotated[int, Field(ge=0, le=24)] = 0
        """number of baffles on the mantle, the first at +x in the drum at rest"""
        baffle_height: units.Length | None = None
        """m, from the mantle inwards; default a tenth of the diameter"""
        baffle_thickness: units.Length | None = None
        """m; default 0.03 diameters. The grid must resolve it with two cells or more"""

        @model_validator(mode="after")
        def _two_or_three_dimensions(self) -> Self:
            if self.end_walls is False and self.length is not None:
                raise ValueError("a drum without end walls takes a width, not a length")
            if self.is_closed and self.width is not None:
                raise ValueError("a drum with end walls takes a length, not a width")
            return self

        @property
        def is_closed(self) -> bool:
            """Whether there are end walls."""
            return self.length is not None if self.end_walls is None else self.end_walls

    @staticmethod
    def default_scene(options: Options) -> Mapping[str, Any]:
        """The paper's scene; larger drums turn at the same Froude number."""
        diameter = _SIZES[options.size][0]
        operation = {
            "speed": f"{_LAB_SPEED * math.sqrt(_SIZES['lab'][0] / diameter):.4g} rpm",
            "fill": {"depth_ratio": 0.35},
            "loading": "side-by-side",
        }
        if options.is_closed:
            return {
                "operation": operation | {"revolutions": 10},
                "flow": {"name": "surface-layer"},
                "mixing": {"name": "semi-lagrangian"},
                "grid": {"cells": 2e5},
            }
        return {
            "operation": operation | {"revolutions": 3},
            "flow": {"name": "mohr-coulomb"},
            "mixing": {"name": "finite-volume"},
            "grid": {"spacing": f"{1e3 * diameter / _CELLS_ACROSS:.2g} mm"},
        }

    def __init__(self, options: Options):
        """Raises InputError if the baffles do not fit."""
        super().__init__(options)
        diameter, length = _SIZES[options.size]
        self.radius = 0.5 * (options.diameter or diameter)
        self.closed = options.is_closed
        self.extent = (options.length or length) if self.closed else (options.width or _WIDTH)
        self.dimension = 3 if self.closed else 2
        self.depth = 1.0 if self.closed else self.extent
        self.reach = self.radius
        half = (self.radius, self.radius, 0.5 * self.extent)[: self.dimension]
        self.lower, self.upper = tuple(-h for h in half), half
        self.baffle_angles = 2 * math.pi * np.arange(options.baffles) / max(options.baffles, 1)
        self.baffle_height = options.baffle_height or 0.2 * self.radius
        self.baffle_thickness = options.baffle_thickness or 0.06 * self.radius
        self._check_baffles()
        self.symmetry = ((0.0, 0.0, 1.0),) if self.closed else ()
        self.thinnest = self.baffle_thickness if options.baffles else math.inf
        self.volume = self.volume_below(self.radius)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside, exact; points (..., dimension) in m."""
        x, y = points[..., 0], points[..., 1]
        wall = self.radius - np.hypot(x, y)
        if self.closed:
            end = 0.5 * self.extent - np.abs(points[..., 2])
            beyond = -np.hypot(np.minimum(wall, 0.0), np.minimum(end, 0.0))
            wall = np.where((wall < 0) | (end < 0), beyond, np.minimum(wall, end))
        for angle in self.baffle_angles:
            inwards = self.radius - self.baffle_height - (x * np.cos(angle) + y * np.sin(angle))
            across = np.abs(y * np.cos(angle) - x * np.sin(angle)) - 0.5 * self.baffle_thickness
            outside = np.hypot(np.maximum(inwards, 0.0), np.maximum(across, 0.0))
            wall = np.minimum(wall, outside + np.minimum(np.maximum(inwards, across), 0.0))
        return wall

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height: the circular segment R^2 (a - sin a cos a), less baffles.

        A baffle is cut into strips along the radius; the part of a strip below the level is exact.
        """
        cosine = min(1.0, max(-1.0, -height / self.radius))
        half_angle = math.acos(cosine)
        segment = half_angle - math.sin(half_angle) * cosine
        return (self.radius**2 * segment - self._baffles_below(height)) * self.extent

    def _baffles_below(self, height: float) -> float:
        """Area of the baffles' cross-sections below y = height, m^2."""
        nodes, weights = _STRIPS
        across = 0.5 * self.baffle_thickness * nodes
        foot = np.sqrt(np.maximum(self.radius**2 - across**2, 0.0))
        tip = np.full_like(foot, self.radius - self.baffle_height)
        area = 0.0
        for angle in self.baffle_angles:
            ends = [r * np.sin(angle) + across * np.cos(angle) for r in (tip, foot)]
            low, high = np.minimum(*ends), np.maximum(*ends)
            share = np.where(
                high - low > 1e-12 * self.radius,
                np.clip((height - low) / np.maximum(high - low, 1e-300), 0.0, 1.0),
                height >= low,
            )
            area += 0.5 * self.baffle_thickness * float(weights @ (share * (foot - tip)))
        return area

    def _check_baffles(self) -> None:
        count = len(self.baffle_angles)
        if count == 0:
            return
        tip = self.radius - self.baffle_height
        if self.baffle_height >= self.radius or self.baffle_thickness >= self.radius:
            raise InputError(
                f"geometry.baffle_height = {self.baffle_height:g}, geometry.baffle_thickness = "
                f"{self.baffle_thickness:g}: both must be below the radius {self.radius:g} m"
            )
        if count > 1 and self.baffle_thickness >= 2 * tip * math.tan(math.pi / count):
            raise InputError(
                f"geometry.baffles = {count}: so many of {self.baffle_thickness:g} m meet at their "
                f"tips, {tip:g} m from the axis"
            )

    def solid(self) -> Any:
        """The inside as a netgen OCC shape, m; its outer edge or face is named `wall`."""
        from netgen.occ import (  # meshing is the only use of netgen here
            Axes,
            Axis,
            Box,
            Circle,
            Cylinder,
            MoveTo,
            Pnt,
            X,
            Z,
        )

        if not self.closed:
            shape = Circle(Pnt(0, 0), self.radius).Face()
            shape.edges.name = "wall"
        else:
            foot = Pnt(0, 0, -0.5 * self.extent)
            shape = Cylinder(Axes(foot, Z, X), r=self.radius, h=self.extent)
            shape.faces.name = "wall"
        for angle in self.baffle_angles:
            tip, half = self.radius - self.baffle_height, 0.5 * self.baffle_thickness
            beyond = 2 * self.radius
            if self.closed:
                plate = Box(Pnt(tip, -half, -self.extent), Pnt(beyond, half, self.extent))
            else:
                plate = MoveTo(tip, -half).Rectangle(beyond - tip, 2 * half).Face()
            shape = shape - plate.Rotate(Axis(Pnt(0, 0, 0), Z), math.degrees(angle))
            if not self.closed:
                shape = shape.faces[0]  # OCC returns a compound
        return shape
