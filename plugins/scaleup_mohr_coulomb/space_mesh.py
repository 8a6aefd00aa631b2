"""Tetrahedra of any closed vessel, distributed over ranks by NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import netgen.meshing
import ngsolve as ngs
from netgen.occ import OCCGeometry

from scaleup.api import on_root

_GRADING = 0.5


def distributed(build: Callable[[], Any], comm: Any) -> Any:
    """The NGSolve mesh of the netgen mesh that ``build`` makes, on all ranks of ``comm``.

    The first rank makes it and, if there are others, keeps none of its elements (NGSolve's rule).
    """
    ngs.SetNumThreads(1)
    if comm.size == 1:
        return ngs.Mesh(build())
    kept: list[Any] = []
    on_root(comm, lambda: kept.append(build()))
    if comm.rank == 0:
        return ngs.Mesh(kept[0].Distribute(comm))
    return ngs.Mesh(netgen.meshing.Mesh.Receive(comm))


def vessel_mesh(solid: Any, size: float, comm: Any) -> Any:
    """Tetrahedra of ``size`` (m) in a netgen OCC solid; curved walls to second order."""
    mesh = distributed(lambda: OCCGeometry(solid).GenerateMesh(maxh=size, grading=_GRADING), comm)
    return mesh.Curve(2)
