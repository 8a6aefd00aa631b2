"""What holds a bed up: the friction of a round vessel's wall, and the powder's own cohesion.

**Wall.** A bed whose surface leans at beta slides on the wall of a vessel of revolution unless the
wall's friction carries the moment of its weight about the axis. With the stress of a fluid at rest
under the leaning surface, p = rho g cos(beta) d (d the distance below it), on walls across the
radius, and K p, K = (1 - sin phi)/(1 + sin phi), on walls across the axis,

    tan(beta) = mu_wall L,   L = (integral of r d dA over the wall) / (integral of s dV),

r the distance from the axis, s that along the surface's normal. In a drum's cross-section
L = 3 (sin a - a cos a)/sin^3 a, a half the angle of the chord: 1 for a thin bed, 2.4 for a half
full drum. The finite elements of flow `mohr-coulomb` find 5.6 and 17.2 deg where this gives 5.7 and
16.6 (docs/plugins/mohr-coulomb-study.md, wall friction 0.05 and 0.15).

**Cohesion.** A wall of cohesive powder stands by itself up to 4 c/(rho g) tan(45 deg + phi/2)
(Terzaghi, Theoretical Soil Mechanics): a bed less deep than that turns as a lump.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from scaleup.case.vessel_shape import level_height
from scaleup.scene.models import GRAVITY, Material
from scaleup.space.grid import FloatArray

_ROUND = 5e-3  # of the reach: how far a round vessel's wall may be from a circle
_ANGLES, _SLICES, _ALONG_RADIUS, _WITHIN = 72, 64, 400, 16


def critical_height(material: Material) -> float:
    """Height, m, up to which a wall of the powder stands by itself."""
    weight = material.bulk_density * GRAVITY
    return 4 * material.cohesion / weight * math.tan(0.25 * math.pi + 0.5 * material.friction_angle)


def lifted_lean(geometry: Any, material: Material, fill_volume: float) -> float | None:
    """Greatest lean, rad, at which the wall's friction carries the bed; None but for round vessels.

    Other vessels carry it by their shape.
    """
    if not is_round(geometry):
        return None
    sine = math.sin(material.friction_angle)
    lever = wall_lever(geometry, fill_volume, (1 - sine) / (1 + sine))
    return math.atan(material.wall_friction * lever)


def wall_lever(geometry: Any, fill_volume: float, sideways: float) -> float:
    """L of a vessel of revolution; `sideways`: K of the walls across the axis."""
    b = geometry.axis.point[1] - level_height(geometry, fill_volume)
    if geometry.dimension == 2:
        on_wall, in_slice = _moments(np.array([geometry.reach]), b)
        return float(on_wall[0] / in_slice[0])
    z, radius = _profile(geometry)
    lift, weight = 0.0, 0.0
    share = (np.arange(_WITHIN) + 0.5) / _WITHIN
    for n in range(len(z) - 1):
        dz, dr = z[n + 1] - z[n], radius[n + 1] - radius[n]
        length = math.hypot(dz, dr)
        if length == 0.0:
            continue
        on_wall, in_slice = _moments(radius[n] + share * dr, b)
        lift += float(on_wall.mean() * (dz**2 + sideways * dr**2) / length)
        weight += float(in_slice.mean() * dz)
    return lift / weight


def _moments(radius: FloatArray, b: float) -> tuple[FloatArray, FloatArray]:
    """Integrals of r d along the arc below the surface, and of s over the segment, m^3."""
    cosine = np.clip(b / np.maximum(radius, 1e-300), -1.0, 1.0)
    half = np.arccos(cosine)
    lift = 2 * radius**3 * (np.sin(half) - half * cosine)
    return lift, 2 / 3 * (radius * np.sin(half)) ** 3


def _profile(geometry: Any) -> tuple[FloatArray, FloatArray]:
    """Radius of the wall, m, at heights z along the axis; it begins and ends on the axis."""
    step = (geometry.upper[2] - geometry.lower[2]) / _SLICES
    z = geometry.lower[2] + step * (np.arange(_SLICES) + 0.5)
    r = np.linspace(0.0, geometry.reach, _ALONG_RADIUS)
    x, y = geometry.axis.point[:2]
    places = np.stack(np.broadcast_arrays(x + r, y, z[:, None]), axis=-1)
    inside = np.asarray(geometry.signed_distance(places)) > 0
    radius = np.where(inside, r, 0.0).max(axis=1)
    ends = [z[0] - 0.5 * step, z[-1] + 0.5 * step]
    return (
        np.array([ends[0], ends[0], *z, ends[1], ends[1]]),
        np.array([0.0, radius[0], *radius, radius[-1], 0.0]),
    )


def is_round(geometry: Any) -> bool:
    """Whether a vessel is a body of revolution about its axis, which runs along z."""
    if geometry.dimension == 3 and tuple(geometry.axis.direction) != (0.0, 0.0, 1.0):
        return False
    angle = 2 * math.pi * np.arange(_ANGLES) / _ANGLES
    radius = geometry.reach * np.array([0.5, 0.8, 0.95, 1.0])
    x = geometry.axis.point[0] + radius[:, None] * np.cos(angle)
    y = geometry.axis.point[1] + radius[:, None] * np.sin(angle)
    places = np.stack([x, y], axis=-1)[None]
    if geometry.dimension == 3:
        z = np.linspace(geometry.lower[2], geometry.upper[2], 7)[1:-1, None, None, None]
        flat = np.broadcast_to(places, (5, *places.shape[1:]))
        places = np.concatenate([flat, np.broadcast_to(z, (*flat.shape[:-1], 1))], axis=-1)
    distance = np.asarray(geometry.signed_distance(places))
    return bool(np.ptp(distance, axis=-1).max() < _ROUND * geometry.reach)
