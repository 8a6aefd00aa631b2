"""Meshes of a vessel's cross-section, refined about the expected free surface."""

from __future__ import annotations

import math
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.meshing import MeshingParameters
from numpy.typing import NDArray

from scaleup_mohr_coulomb.meshing import meshed, occ_geometry

_GRADING = 0.25
_BISECTIONS = 40
_CHORD_ERROR = 0.02


def farthest_wall(mesh: Any) -> float:
    """Distance from the axis to the farthest wall, m."""
    return float(max(math.hypot(*vertex.point) for vertex in mesh.vertices))


def surface_normal(angle: float) -> tuple[float, float]:
    """Unit normal, out of the powder, of a free surface inclined by ``angle`` (rad)."""
    return -math.sin(angle), math.cos(angle)


def surface_offset(mesh: Any, bed_area: float, angle: float) -> float:
    """Signed distance (m) from the axis to the plane surface that holds ``bed_area`` below it.

    The plane is {x : n.x = offset} with n the :func:`surface_normal` of ``angle``.
    """
    normal = surface_normal(angle)
    height = normal[0] * ngs.x + normal[1] * ngs.y
    high = farthest_wall(mesh)
    low = -high
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        below = ngs.Integrate(ngs.IfPos(middle - height, 1.0, 0.0), mesh, order=10)
        low, high = (middle, high) if below < bed_area else (low, middle)
    return 0.5 * (low + high)


def cross_section_mesh(
    face: Any,
    coarse_size: float,
    fine_size: float,
    bed_area: float,
    band_angle: float,
    band_depth: float,
    band_height: float,
) -> Any:
    """Triangles of a cross-section, small in a band about the expected plane free surface.

    ``face`` is a netgen OCC face in the plane z = 0, in metres, with the axis of rotation at the
    origin, e.g. ``Circle(Pnt(0, 0), R).Face()``.  Elements are ``fine_size`` from
    ``band_depth`` below to ``band_height`` above the plane at ``band_angle`` (rad) that holds
    ``bed_area`` (m^2), and grow to ``coarse_size`` away from it.  Curved walls are followed to
    second order. Raises InputError if there is no such mesh.
    """
    geometry = occ_geometry(lambda: face, dim=2)
    coarse = ngs.Mesh(meshed(geometry, coarse_size, maxh=coarse_size)).Curve(2)
    offset = surface_offset(coarse, bed_area, band_angle)
    parameters = MeshingParameters(maxh=coarse_size, grading=_GRADING)
    reach = farthest_wall(coarse)
    along = np.arange(-reach, reach, fine_size)
    across = offset + np.arange(-band_depth, band_height + 0.5 * fine_size, fine_size)
    normal = np.array(surface_normal(band_angle))
    tangent = np.array([normal[1], -normal[0]])
    for x, y in (along[:, None, None] * tangent + across[None, :, None] * normal).reshape(-1, 2):
        parameters.RestrictH(x=float(x), y=float(y), z=0.0, h=fine_size)
    return ngs.Mesh(meshed(geometry, fine_size, mp=parameters)).Curve(2)


def wall_distance(mesh: Any, origin: NDArray[Any], direction: NDArray[Any]) -> float:
    """Distance (m) from ``origin`` to the farthest wall hit along the unit vector ``direction``.

    The chords of the boundary elements are hit first; bisection then finds the curved wall.
    """
    vertices = np.array([v.point for v in mesh.vertices])
    chords = np.array([[v.nr for v in el.vertices] for el in mesh.Elements(ngs.BND)])
    start, end = vertices[chords[:, 0]] - origin, vertices[chords[:, 1]] - origin
    side = np.array([-direction[1], direction[0]])
    start_side, end_side = start @ side, end @ side
    crossed = start_side * end_side <= 0.0
    start, end = start[crossed], end[crossed]
    weight = start_side[crossed] / (start_side[crossed] - end_side[crossed])
    hits = (start + weight[:, None] * (end - start)) @ direction
    chord = float(hits.max())
    low, high = (1.0 - _CHORD_ERROR) * chord, (1.0 + _CHORD_ERROR) * chord
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        x, y = (float(coordinate) for coordinate in origin + middle * direction)
        low, high = (middle, high) if mesh.Contains(x, y, 0.0) else (low, middle)
    return low
