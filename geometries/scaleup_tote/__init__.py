"""Geometry `tote`: an intermediate bulk container (bin), a box over a hopper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from scaleup.contract import FloatArray, Geometry, InputError, PluginOptions, units
from scaleup_tote.bin_shape import SIZES, Baffle, Size, held_bin

_LAB_SPEED = 5.0  # rpm


class Tote(Geometry):
    """A bin in its tumbler: a rectangular box over a hopper, all edges rounded alike.

    The bin stands upright at rest, its outlet down, and turns about a horizontal axis. `tilt` leans
    the bin's upright along the axis, as a tumbler's skewed cradle does; `turn` turns the bin about
    its own upright first.
    """

    class Options(PluginOptions):
        """Size of the bin, how it is held, and its baffle."""

        size: Literal["lab", "pilot", "plant"] = "lab"
        """sets the dimensions that are not given: about 14, 300 or 2000 litres"""
        length: units.Length | None = None
        """m, of the box along x; default 0.24, 0.72 or 1.2 by size"""
        width: units.Length | None = None
        """m, of the box along z; default 0.24, 0.72 or 1.05"""
        height: units.Length | None = None
        """m, of the box; default 0.19, 0.45 or 1.4"""
        hopper: units.Length | None = None
        """m, height of the hopper; default 0.1, 0.29 or 0.45"""
        outlet: units.Length | None = None
        """m, edge of the square outlet; default 0.09, 0.22 or 0.35"""
        edge_radius: Annotated[units.Coordinate, Field(ge=0)] | None = None
        """m, of all edges, 0 for sharp ones; default 0.02, 0.05 or 0.1"""
        axis_height: units.Length | None = None
        """m, of the axis of rotation above the outlet; default: that of the bin's centre of
        volume, so that the empty bin is balanced"""
        tilt: Annotated[units.Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
        """rad, by which the top leans towards +z, along the axis"""
        turn: units.Angle = 0.0
        """rad, of the bin about its own upright"""
        baffle: bool = False
        """a flat plate that crosses the axis in the middle of the bin"""
        baffle_width: units.Length | None = None
        """m, along the bin's width; default half of it"""
        baffle_height: units.Length | None = None
        """m; default 0.4 of the box' height"""
        baffle_thickness: units.Length | None = None
        """m; default 0.05 of the width. The grid must resolve it with two cells or more"""
        baffle_angle: units.Angle = math.pi / 4
        """rad, between the plate and the bin's upright"""

    @staticmethod
    def default_scene(options: Options) -> Mapping[str, Any]:
        """Half full; larger bins turn at the same Froude number, about 4e-3."""
        scale = SIZES[options.size].length / SIZES["lab"].length
        return {
            "operation": {
                "speed": f"{_LAB_SPEED / math.sqrt(scale):.4g} rpm",
                "fill": {"volume_fraction": 0.5},
                "loading": "top-bottom",
                "revolutions": 10,
            },
            "flow": {"name": "surface-layer"},
            "mixing": {"name": "semi-lagrangian"},
            "grid": {"cells": 2e5},
        }

    def __init__(self, options: Options):
        """Raises InputError if the bin's parts do not go together."""
        super().__init__(options)
        size = SIZES[options.size]._asdict()
        size |= {key: given for key in size if (given := getattr(options, key)) is not None}
        for part in ("length", "width"):
            if size["outlet"] >= size[part]:
                raise InputError(
                    f"geometry.outlet = {size['outlet']:g} m: must be below geometry.{part} = "
                    f"{size[part]:g} m"
                )
        self._bin = held_bin(Size(**size), options.axis_height, options.tilt, options.turn)
        self._baffle: Baffle | None = None
        if options.baffle:
            width, height = size["width"], size["height"]
            self._baffle = Baffle(
                self._bin,
                options.baffle_thickness or 0.05 * width,
                options.baffle_height or 0.4 * height,
                options.baffle_width or 0.5 * width,
                options.baffle_angle,
            )
            self.thinnest = self._baffle.thickness
        self.lower, self.upper, self.reach = self._bin.lower, self._bin.upper, self._bin.reach
        mirrored = self._bin.is_mirrored and (self._baffle is None or self._baffle.is_mirrored)
        self.symmetry = ((0.0, 0.0, 1.0),) if mirrored else ()
        self.volume = self.volume_below(self.upper[1])

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside; points (..., 3) in m. See `bin_shape`."""
        wall = self._bin.signed_distance(points)
        return wall if self._baffle is None else self._baffle.cut_from(wall, points)

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height; exact but for the rounding, of 2e-5 of the volume."""
        volume = self._bin.volume_below(height)
        return volume if self._baffle is None else volume - self._baffle.volume_below(height)

    def solid(self) -> Any:
        """The inside as a netgen OCC solid, m."""
        shape = self._bin.solid()
        shape.faces.name = "wall"
        return shape if self._baffle is None else shape - self._baffle.solid()
