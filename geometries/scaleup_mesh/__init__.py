"""Geometry `mesh`: a vessel read from a file, as a closed surface, a volume mesh or a CAD solid."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, FilePath, field_serializer

from scaleup.contract import GRAVITY, FloatArray, Geometry, InputError, PluginOptions, units

if TYPE_CHECKING:
    from scaleup_mesh.sound import Sound
    from scaleup_mesh.surface import Surface

_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
_FROUDE = 4e-3  # of the default speed: in the rolling regime
_STEP = (".step", ".stp")

Vector = tuple[float, float, float]


class Mesh(Geometry):
    """A vessel of your own, the inside of a closed surface.

    The file's coordinates are turned so that the axis of rotation becomes +z and `up` the upright
    at rest, and moved so that the axis passes through the origin.
    """

    class Options(PluginOptions):
        """Which file, in which unit, and how the vessel is held."""

        file: Annotated[FilePath, AfterValidator(Path.resolve)]
        """STL, OBJ, PLY or OFF (a closed surface of triangles), VTK, VTU, VTP, MSH or any other
        file that meshio reads (a closed surface or a volume mesh), STEP (one solid)"""
        unit: Literal["m", "cm", "mm", "in", "ft"]
        """of the file's coordinates; "mm" for STEP, which is converted to that when it is read"""
        axis_point: tuple[units.Coordinate, units.Coordinate, units.Coordinate] | None = None
        """m, a point of the axis of rotation in the file's coordinates; default: the centre of
        volume, so that the empty vessel is balanced"""
        axis_direction: Vector = (0.0, 0.0, 1.0)
        """of the axis of rotation in the file's coordinates, of any length; the vessel turns
        counter-clockwise seen from its tip"""
        up: Vector = (0.0, 1.0, 0.0)
        """what points up in the vessel at rest, in the file's coordinates, of any length; its part
        along the axis does not count"""

        @field_serializer("file")
        def _as_text(self, file: Path) -> str:
            return str(file)

    @staticmethod
    def default_scene(options: Options) -> Mapping[str, Any]:
        """Two fifths full, at the Froude number 4e-3."""
        reach = Mesh(options).reach
        return {
            "operation": {
                "speed": f"{math.sqrt(_FROUDE * GRAVITY / reach) * 30 / math.pi:.4g} rpm",
                "fill": {"volume_fraction": 0.4},
                "loading": "top-bottom",
                "revolutions": 10,
            },
            "flow": {"name": "surface-layer"},
            "mixing": {"name": "semi-lagrangian"},
            "grid": {"cells": 2e5},
        }

    def __init__(self, options: Options):
        """Raises InputError if the file is no vessel's inside, or cannot be held as asked."""
        super().__init__(options)
        scale = _UNITS[options.unit]
        if options.file.suffix.lower() in _STEP and options.unit != "mm":
            raise InputError(
                f"geometry.unit = {options.unit!r}: must be 'mm' for STEP, which carries its own "
                "unit and is converted to mm when it is read"
            )
        self._turn = _turn(options.axis_direction, options.up)
        stamp = options.file.stat().st_mtime_ns
        self.fingerprint = _fingerprint(options.file, stamp)
        self._origin, self._surface = _held(
            options.file, stamp, scale, options.axis_point, tuple(map(tuple, self._turn))
        )
        sound = _sound(options.file, stamp, scale)
        where = f"geometry.file = {str(options.file)!r}"
        self.warnings = tuple(f"{where}: {note}" for note in sound.notes)
        vertices = self._surface.vertices
        self.lower = tuple(float(x) for x in vertices.min(axis=0))
        self.upper = tuple(float(x) for x in vertices.max(axis=0))
        self.reach = float(np.hypot(vertices[:, 0], vertices[:, 1]).max())
        self.volume = self._surface.volume
        self.thinnest = _thinnest(options.file, stamp, scale)

    @cached_property
    def symmetry(self) -> tuple[tuple[float, float, float], ...]:
        """The plane across the axis, if the surface is its own mirror image in it to 1e-6."""
        return ((0.0, 0.0, 1.0),) if self._surface.is_mirrored(1e-6 * self.reach) else ()

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside; points (..., 3) in m. See `surface`."""
        return self._surface.signed_distance(points)

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height, exact."""
        return self._surface.volume_below(height)

    def solid(self) -> Any:
        """The inside as a netgen OCC solid, m. Raises InputError but for STEP."""
        if self.options.file.suffix.lower() not in _STEP:
            raise InputError(
                f"geometry.file = {str(self.options.file)!r}: a mesh has no solid to mesh anew; "
                "give the vessel as STEP"
            )
        from scaleup_mesh.cad import read_solid

        return read_solid(self.options.file, self._origin, self._turn)


def _turn(direction: Vector, up: Vector) -> FloatArray:
    """Rotation (3, 3) from the file's directions to the vessel's. Raises InputError."""
    z, y = np.array(direction, dtype=float), np.array(up, dtype=float)
    if not z.any():
        raise InputError(f"geometry.axis_direction = {list(direction)}: must not be zero")
    z /= np.linalg.norm(z)
    y -= (y @ z) * z
    if np.linalg.norm(y) <= 1e-6 * np.linalg.norm(np.array(up)):
        raise InputError(
            f"geometry.up = {list(up)}: must not be zero nor along geometry.axis_direction = "
            f"{list(direction)}, for the axis of rotation is horizontal"
        )
    y /= np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z])


@lru_cache(maxsize=8)
def _fingerprint(file: Path, stamp: int) -> str:
    """Of the file as it was at its time stamp."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


@lru_cache(maxsize=4)
def _sound(file: Path, stamp: int, scale: float) -> Sound:
    """The file's surface, in its own frame, m; read once."""
    from scaleup_mesh.read import read_triangles
    from scaleup_mesh.sound import sound_surface

    vertices, faces, bound_cells = read_triangles(file)
    return sound_surface(f"geometry.file = {str(file)!r}", vertices, faces, scale, bound_cells)


@lru_cache(maxsize=4)
def _thinnest(file: Path, stamp: int, scale: float) -> float:
    """m, of the thinnest plate in the vessel; infinite if there is none."""
    from scaleup_mesh.thickness import thinnest_plate

    sound = _sound(file, stamp, scale)
    return thinnest_plate(sound.vertices, sound.faces)


@lru_cache(maxsize=4)
def _held(
    file: Path,
    stamp: int,
    scale: float,
    point: Vector | None,
    turn: tuple[tuple[float, ...], ...],
) -> tuple[FloatArray, Surface]:
    """A point of the axis in the file's frame, m, and the surface in the vessel's."""
    from scaleup_mesh.surface import Surface

    sound = _sound(file, stamp, scale)
    vertices, faces = sound.vertices, sound.faces
    origin = Surface(vertices, faces).centroid if point is None else np.array(point)
    return origin, Surface((vertices - origin) @ np.array(turn).T, faces)
