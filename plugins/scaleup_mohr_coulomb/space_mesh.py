"""Tetrahedra of any closed vessel, distributed over ranks by NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import netgen.meshing
import ngsolve as ngs
from netgen.occ import Box, Pnt

from scaleup.numerics import on_each, on_root

from .meshing import WALL, meshed, occ_geometry, occ_shape

_MIRROR = "mirror"
_GRADING = 0.5
_FLAT = 1e-5  # of the vessel's extent: a face no thicker lies in a plane


def vessel_mesh(solid: Callable[[], Any], size: float, comm: Any, mirrored: bool) -> Any:
    """Tetrahedra of ``size`` (m) in the ``solid()`` of a vessel; curved walls to second order.

    Of a ``mirrored`` vessel only the half at z > 0 is meshed, bounded by its WALL and a plane.  On
    several ranks the first makes the mesh and, up to NGSolve 6.2.2608, keeps none of its elements.
    Raises InputError, on every rank, if there is no such mesh.
    """
    ngs.SetNumThreads(1)

    def shape() -> Any:
        whole = occ_shape(solid())
        return _upper_half(whole) if mirrored else whole

    geometry = on_each(comm, lambda: occ_geometry(shape))
    made: list[Any] = []
    on_root(comm, lambda: made.append(meshed(geometry, size, maxh=size, grading=_GRADING)))
    if comm.size == 1:
        part = made[0]
    elif comm.rank == 0:
        part = made[0].Distribute(comm)
    else:
        part = netgen.meshing.Mesh.Receive(comm)
        part.SetGeometry(geometry)  # which is not sent
    return ngs.Mesh(part).Curve(2)


def _upper_half(solid: Any) -> Any:
    low, high = solid.bounding_box
    box = Box(Pnt(low.x - 1.0, low.y - 1.0, 0.0), Pnt(high.x + 1.0, high.y + 1.0, high.z + 1.0))
    half = solid * box
    half.faces.name = WALL
    for face in half.faces:
        if max(abs(corner.z) for corner in face.bounding_box) < _FLAT * (high.z - low.z):
            face.name = _MIRROR
    return half
