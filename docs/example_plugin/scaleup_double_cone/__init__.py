"""Geometry `double-cone`: a double-cone blender."""

from typing import Any, ClassVar

from scaleup.contract import InputError, PluginOptions, units
from scaleup.numerics import Revolved


class DoubleCone(Revolved):
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

    def __init__(self, options: Options):
        """Raises InputError if the cones do not narrow."""
        if options.opening >= options.diameter:
            raise InputError(
                f"geometry.opening = {options.opening:g} m: must be below the diameter "
                f"{options.diameter:g} m"
            )
        wide, narrow = 0.5 * options.diameter, 0.5 * options.opening
        middle = 0.5 * options.cylinder
        top = middle + options.cone
        profile = [(-top, narrow), (-middle, wide), (middle, wide), (top, narrow)]
        super().__init__(options, profile)  # height and radius of its corners, m
