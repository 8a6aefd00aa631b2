"""The wall of a vessel as triangles: the zero of its signed distance.

A lattice of signed distances is contoured (VTK), and the corners of the contour are moved onto the
wall. Edges of the vessel are cut off by less than a cell of the lattice. A cross-section is
extruded along z.
"""

from __future__ import annotations

import math
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from scaleup.contract import FloatArray, Geometry, IntArray
from scaleup.system.errors import InputError
from scaleup.system.files import write_text

_SAGITTA = {2: 1e-3, 3: 5e-3}
"""of the smallest grain, by dimension: how far a triangle is from a curved wall"""
_FINEST, _COARSEST = 0.25, 2.0  # edges of triangles in diameters of a grain
_SNAPPED = 0.2  # of a cell: corners of the lattice so near to the wall lie on it (no slivers)
_SLENDEREST = 10.0  # cells: pieces along z of a cross-section's wall
_SMOOTH = 5.0  # deg between triangles up to which their edges are not felt
_MOST_POINTS = 5e7


def triangles_of(geometry: Geometry, diameter: float, length: float) -> FloatArray:
    """The vessel's wall, corners of triangles, m, (n, 3, 3).

    diameter -- of a grain, m; length -- m along z of a cross-section, in the middle of z = 0
    Raises InputError if there would be too many.
    """
    cell = math.sqrt(8 * geometry.reach * _SAGITTA[geometry.dimension] * diameter)
    cell = min(max(cell, _FINEST * diameter), _COARSEST * diameter)
    points, cells = _contour(geometry, cell)
    corners = points[cells]
    if geometry.dimension == 3:
        return corners
    pieces = math.ceil(length / (_SLENDEREST * cell))
    found = []
    for z, beyond in pairwise(length * (np.arange(pieces + 1) / pieces - 0.5)):
        near, far = (
            np.concatenate([corners, np.full((*corners.shape[:2], 1), at)], axis=2)
            for at in (z, beyond)
        )
        found.append(np.stack([near[:, 0], near[:, 1], far[:, 1]], axis=1))
        found.append(np.stack([near[:, 0], far[:, 1], far[:, 0]], axis=1))
    return np.concatenate(found)


def smoothness(triangles: FloatArray) -> float:
    """Deg between triangles up to which a wall counts as smooth: 5, or below the least angle."""
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    edges.sort(axis=1)
    sines = np.linalg.norm(across, axis=1) / (edges[:, 1] * edges[:, 2])
    return min(_SMOOTH, 0.8 * math.degrees(math.asin(min(1.0, float(sines.min())))))


def write_stl(path: Path, triangles: FloatArray) -> None:
    """A text STL file; engines compute the normals themselves."""
    facet = "facet normal 0 0 0\nouter loop\n" + 3 * "vertex %.9g %.9g %.9g\n" + "endloop\nendfacet"
    body = "\n".join(facet % tuple(corners) for corners in triangles.reshape(-1, 9))
    write_text(path, f"solid vessel\n{body}\nendsolid vessel\n")


def _contour(geometry: Geometry, cell: float) -> tuple[FloatArray, IntArray]:
    """Points on the wall (n, dimension), and which of them a line or triangle joins."""
    numpy_support: Any = import_module("vtkmodules.util.numpy_support")
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges2D, vtkFlyingEdges3D

    dimension = geometry.dimension
    lower, upper = np.array(geometry.lower) - 1.5 * cell, np.array(geometry.upper) + 1.5 * cell
    counts = np.ceil((upper - lower) / cell).astype(int) + 1
    if counts.prod() > _MOST_POINTS:
        raise InputError(
            f"particles.diameter: the wall needs a lattice of {counts.prod():.3g} points at grains "
            f"of this size, more than {_MOST_POINTS:g}; take larger grains (particles.coarse)"
        )
    lines = [low + cell * np.arange(n) for low, n in zip(lower, counts, strict=True)]
    mesh = np.stack(np.meshgrid(*reversed(lines), indexing="ij")[::-1], axis=-1)
    distance = np.concatenate([geometry.signed_distance(layer).ravel() for layer in mesh])
    distance[np.abs(distance) < _SNAPPED * cell] = 0.0
    image: Any = vtkImageData()
    image.SetDimensions(*(int(n) for n in counts), *(1,) * (3 - dimension))
    image.SetOrigin(*lower, *(0.0,) * (3 - dimension))
    image.SetSpacing(*(cell,) * 3)
    image.GetPointData().SetScalars(numpy_support.numpy_to_vtk(distance))
    contour: Any = vtkFlyingEdges2D() if dimension == 2 else vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.Update()
    found = contour.GetOutput()
    raw = numpy_support.vtk_to_numpy(found.GetPoints().GetData()).astype(float)[:, :dimension]
    joined = found.GetLines() if dimension == 2 else found.GetPolys()
    cells = (
        numpy_support.vtk_to_numpy(joined.GetConnectivityArray())
        .reshape(-1, dimension)
        .astype(np.int64)
    )
    _, first, merged = np.unique(
        np.round((raw - lower) / cell * 1e4), axis=0, return_index=True, return_inverse=True
    )
    cells = merged.reshape(-1)[cells]
    points = _on_wall(geometry, raw[first], cell)
    distinct = np.ones(len(cells), dtype=bool)
    for a in range(dimension):
        distinct &= cells[:, a] != cells[:, (a + 1) % dimension]
    return points, cells[distinct]


def _on_wall(geometry: Geometry, points: FloatArray, cell: float) -> FloatArray:
    """The points moved to where the signed distance vanishes, by Newton's steps."""
    start, offsets = points, 1e-3 * cell * np.eye(points.shape[1])
    for _ in range(3):
        distance = geometry.signed_distance(points)
        slope = np.stack(
            [
                geometry.signed_distance(points + step) - geometry.signed_distance(points - step)
                for step in offsets
            ],
            axis=-1,
        ) / (2e-3 * cell)
        square = np.maximum((slope**2).sum(axis=-1), 0.25)  # smaller on a vessel's edges
        points = points - (distance / square)[:, None] * slope
    too_far = np.linalg.norm(points - start, axis=-1) > 0.5 * cell
    points[too_far] = start[too_far]
    return points
