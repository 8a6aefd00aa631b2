"""Netgen at work: shapes of solids, and one sentence on what it fails at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from netgen.occ import Axis, Dir, Face, OCCGeometry, Pnt, Segment, Sew, Solid, Wire

from scaleup.contract import FlatSolid, InputError, TurnedSolid

WALL = "wall"


def occ_shape(solid: Any) -> Any:
    """The netgen OCC shape of what `Geometry.solid` gives."""
    if isinstance(solid, FlatSolid):
        shape = Solid(Sew([_face(corners) for corners in solid.faces]))
    elif isinstance(solid, TurnedSolid):
        shape = _turned(solid)
    else:
        return solid
    shape.faces.name = WALL
    return shape


def _turned(solid: TurnedSolid) -> Any:
    """The half-plane between the axis and the profile, turned once."""
    outwards = np.linalg.svd(solid.direction[None, :])[2][1]
    heights, radii = np.pad(solid.heights, 1, mode="edge"), np.pad(solid.radii, 1)
    outline = heights[:, None] * solid.direction + radii[:, None] * outwards
    axis = Axis(Pnt(*solid.origin), Dir(*solid.direction))
    return _face(solid.origin + outline).Revolve(axis, 360.0)


def _face(corners: Any) -> Any:
    """The plane face within a polygon (n, 3); corners that repeat count once."""
    kept = [corner for k, corner in enumerate(corners) if np.any(corner != corners[k - 1])]
    points = [Pnt(*corner) for corner in kept]
    return Face(Wire([Segment(points[k - 1], points[k]) for k in range(len(points))]))


def occ_geometry(shape: Callable[[], Any], **settings: Any) -> Any:
    """The netgen geometry of an OCC shape. Raises InputError if there is none."""
    try:
        return OCCGeometry(shape(), **settings)
    except InputError:
        raise
    except Exception as error:  # OCC's own classes
        raise InputError(
            f"geometry: OCC cannot make a solid of the vessel ({error}); change its dimensions"
        ) from error


def meshed(geometry: Any, size: float, **settings: Any) -> Any:
    """The netgen mesh of a geometry with elements of `size` (m). Raises InputError if it fails."""
    try:
        return geometry.GenerateMesh(**settings)
    except Exception as error:  # netgen's own class
        raise InputError(
            f"flow.fine_size = {size:.4g} m: netgen cannot fill the vessel with elements of that "
            f"size ({error}); take smaller ones, or leave out of the geometry what is much smaller "
            "than they are"
        ) from error
