"""How thick the parts are that a closed surface leaves out or encloses.

A vessel's inside may be far from convex (the arms of a V) or cut up by plates (baffles). A vessel's
wall is both: it fills little of its convex hull and is much thinner than that. The mean thickness
2 V/A over that of the hull is 0.7 for a V whose arms are four diameters long, and below 0.3 for
many deep baffles, which leave most of the hull's volume; the wall of a cup is below both limits.
"""

from __future__ import annotations

import math

import numpy as np
from igl.embree import EmbreeIntersector
from scipy.spatial import ConvexHull, QhullError

from scaleup.contract import FloatArray, IntArray

_SHARE, _SLIM = 0.5, 0.3  # of the hull's volume and mean thickness, below which it is a wall
_PARALLEL = math.cos(math.radians(15.0))  # faces of a plate; a wedge has no thickness
_LEAST = 1e-3  # of the surface: smaller parts are passed over
_RAYS = 100_000
_CLEAR = 1e-6  # of the size, from where rays start


def mean_thickness(vertices: FloatArray, faces: IntArray) -> float:
    """2 V/A: of a large plate its thickness, in the unit of the vertices."""
    normal = _normals(vertices, faces)
    volume = float((vertices[faces].mean(axis=1) * normal).sum() / 3.0)
    return 2.0 * volume / float(np.linalg.norm(normal, axis=1).sum())


def is_wall(vertices: FloatArray, faces: IntArray) -> bool:
    """Whether a surface, its triangles outwards, bounds the wall of a vessel, not its inside."""
    try:
        hull = ConvexHull(vertices[np.unique(faces)])
    except QhullError:  # flat to round-off
        return False
    normal = _normals(vertices, faces)
    volume = float((vertices[faces].mean(axis=1) * normal).sum() / 3.0)
    slim = mean_thickness(vertices, faces) / (2.0 * hull.volume / hull.area)
    return bool(volume < _SHARE * hull.volume and slim < _SLIM)


def thinnest_plate(vertices: FloatArray, faces: IntArray) -> float:
    """Thickness of the thinnest part with powder on both sides, in the unit of the vertices.

    1  Rays start at three places of every triangle (of some, if there are many) and go outwards,
       away from the powder.
    2  Where one meets the surface again there is powder beyond; what it crossed is the part's
       thickness if both faces are parallel within 15 degrees.
    3  The thickness is the least below which parts have at least a thousandth of the surface.
    Infinite if there is no such part.
    """
    low = vertices.min(axis=0)
    size = float((vertices.max(axis=0) - low).max())
    points = (vertices - low) / size
    normal = _normals(points, faces)
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    search = EmbreeIntersector()
    search.init(np.asfortranarray(points, np.float32), np.asfortranarray(faces, np.int32))
    some = np.arange(0, len(faces), max(1, 3 * len(faces) // _RAYS))
    weights = (np.ones((3, 3)) + 3.0 * np.eye(3)) / 6.0
    starts = np.einsum("sc,ncd->nsd", weights, points[faces[some]])
    met = np.full(starts.shape[:2], -1)
    for number, (face, near) in enumerate(zip(some, starts.astype(np.float32), strict=True)):
        away = normal[face].astype(np.float32)
        for place, start in enumerate(near):
            met[number, place] = search.intersectRay_first(start, away, _CLEAR)[0]
    outwards, beyond = normal[some][:, None, :], normal[met]
    facing = (outwards * beyond).sum(axis=-1)
    crossed = ((points[faces[met, 0]] - starts) * beyond).sum(axis=-1)
    is_plate = (met >= 0) & (met != some[:, None]) & (facing < -_PARALLEL)
    found = np.where(is_plate, crossed / np.where(is_plate, facing, 1.0), np.inf)
    order = np.argsort(found, axis=None)
    share = np.cumsum(np.repeat(area[some], len(weights))[order])
    least = np.searchsorted(share, _LEAST * share[-1])
    return float(found.reshape(-1)[order][least]) * size


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Of triangles, as long as their area, (n, 3)."""
    corner = vertices[faces]
    normal: FloatArray = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return normal
