"""Tetrahedra of any closed vessel, distributed over ranks by NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import netgen.meshing
import ngsolve as ngs
from netgen.occ import OCCGeometry

from scaleup.api import on_each, on_root

_GRADING = 0.5


def distributed(build: Callable[[], Any], comm: Any, geometry: Any = None) -> Any:
    """The NGSolve mesh of the netgen mesh that ``build`` makes, on all ranks of ``comm``.

    The first rank makes it and, if there are others, keeps none of its elements (NGSolve's rule).
    Each of the others needs the netgen ``geometry`` if the mesh is to be curved: it is not sent.
    """
    ngs.SetNumThreads(1)
    if comm.size == 1:
        return ngs.Mesh(build())
    kept: list[Any] = []
    on_root(comm, lambda: kept.append(build()))
    if comm.rank == 0:
        return ngs.Mesh(kept[0].Distribute(comm))
    part = netgen.meshing.Mesh.Receive(comm)
    if geometry is not None:
        part.SetGeometry(geometry)
    return ngs.Mesh(part)


def vessel_mesh(solid: Callable[[], Any], size: float, comm: Any) -> Any:
    """Tetrahedra of ``size`` (m) in the netgen OCC ``solid()``; curved walls to second order."""
    geometry = on_each(comm, lambda: OCCGeometry(solid()))

    def build() -> Any:
        return geometry.GenerateMesh(maxh=size, grading=_GRADING)

    return distributed(build, comm, geometry).Curve(2)
