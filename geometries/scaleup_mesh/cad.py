"""STEP files through netgen's OCC, which reads them in millimetres."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from netgen.meshing import MeshingStep
from netgen.occ import Axis, Dir, OCCGeometry, Pnt, Vec
from scipy.spatial.transform import Rotation

from scaleup.api import FloatArray, InputError, IntArray

_MM = 1e-3
_EDGES = 75  # triangle edges along the longest side of the box
_PER_RADIUS = 12  # triangle edges along a radius of curvature


def triangulated(file: Path) -> tuple[FloatArray, IntArray]:
    """Vertices (mm) and triangles of the surface of the file's one solid."""
    geometry = OCCGeometry(str(file))
    solids = len(geometry.shape.solids)
    if solids != 1:
        raise InputError(
            f"geometry.file = {str(file)!r}: holds {solids} solids; give the inside of the vessel "
            "as one"
        )
    low, high = (np.array([p.x, p.y, p.z]) for p in geometry.shape.bounding_box)
    mesh = geometry.GenerateMesh(
        maxh=float((high - low).max()) / _EDGES,
        curvaturesafety=_PER_RADIUS,
        perfstepsend=MeshingStep.MESHSURFACE,
    )
    faces = np.array([[v.nr - 1 for v in element.vertices] for element in mesh.Elements2D()])
    return np.asarray(mesh.Coordinates()), faces


def read_solid(file: Path, origin: FloatArray, turn: FloatArray) -> Any:
    """The solid in the vessel's frame, m: moved by -origin (m), then turned (3, 3)."""
    shape = OCCGeometry(str(file)).shape.Scale(Pnt(0, 0, 0), _MM).Move(Vec(*-origin))
    vector = Rotation.from_matrix(turn).as_rotvec()
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return shape
    return shape.Rotate(Axis(Pnt(0, 0, 0), Dir(*vector)), math.degrees(angle))
