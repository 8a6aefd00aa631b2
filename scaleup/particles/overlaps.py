"""How far grains are pressed into each other and into the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from scaleup.contract import FloatArray, Geometry
from scaleup.particles.pouring import Grains


@dataclass(frozen=True)
class Overlaps:
    """Of contacts, in mean diameters: between grains `pairs` (n,), at the wall `wall` (m,)."""

    pairs: FloatArray
    wall: FloatArray


def overlaps(grains: Grains, geometry: Geometry, phase: float, length: float | None) -> Overlaps:
    """Overlaps of all contacts at one instant.

    phase  -- rad by which the vessel has turned; length -- period along z, m, or None
    """
    position, radius = grains.position, grains.radius
    box = None
    if length is not None:
        position = position.copy()
        position[:, 2] %= length
        shift = position[:, :2].min(axis=0)
        position[:, :2] -= shift
        box = np.array([0.0, 0.0, length])
    tree = cKDTree(position, boxsize=box)
    pairs = tree.query_pairs(2 * float(radius.max()), output_type="ndarray")
    apart = position[pairs[:, 0]] - position[pairs[:, 1]]
    if length is not None:
        apart[:, 2] -= length * np.round(apart[:, 2] / length)
    pressed = radius[pairs].sum(axis=1) - np.linalg.norm(apart, axis=1)
    at_rest = turned(grains.position, geometry, -phase)[:, : geometry.dimension]
    wall = radius - geometry.signed_distance(at_rest)
    diameter = 2 * float(radius.mean())
    return Overlaps(pressed[pressed > 0] / diameter, wall[wall > 0] / diameter)


def turned(vectors: FloatArray, geometry: Geometry, angle: float, free: bool = False) -> FloatArray:
    """Points (n, 3) turned about the vessel's axis, or free vectors about its direction.

    Rodrigues' formula; angle in rad, counter-clockwise.
    """
    point = np.zeros(3) if free else np.array(geometry.axis.point)
    k = np.array(geometry.axis.direction)
    v = vectors - point
    along = (v @ k)[:, None] * k
    result: FloatArray = (
        point + along + np.cos(angle) * (v - along) + np.sin(angle) * np.cross(k, v)
    )
    return result
