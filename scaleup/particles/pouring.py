"""Grains before they settle: a loose lattice, filled from the bottom, with random velocities."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scaleup.contract import GRAVITY, FloatArray, Geometry
from scaleup.particles.contact import Contact
from scaleup.system.errors import InputError

_LOOSE, _TIGHT = 1.12, 1.01  # lattice spacing in diameters of the largest grain
_DROP = 10.0  # diameters: grains begin with the speed of such a fall, in any direction


@dataclass(frozen=True)
class Grains:
    """Grains at one instant: position, velocity (n, 3) in m and m/s, radius (n,) in m."""

    position: FloatArray
    velocity: FloatArray
    radius: FloatArray

    @property
    def volume(self) -> FloatArray:
        """m^3, (n,)."""
        return 4 / 3 * math.pi * self.radius**3


def poured(geometry: Geometry, contact: Contact, mass: float, length: float, seed: int) -> Grains:
    """Grains of a given mass (kg), to within half a grain, that touch neither wall nor each other.

    length -- m along z of a cross-section, which repeats
    Raises InputError if the vessel has no room for so many before they settle.
    """
    random = np.random.default_rng(seed)
    count = max(1, round(mass / contact.mean_mass))
    places = np.empty((0, 3))
    for spacing in (_LOOSE, 0.5 * (_LOOSE + _TIGHT), _TIGHT):
        places = _lattice(geometry, contact.largest, spacing * contact.largest, length)
        if len(places) >= count:
            break
    if len(places) < count:
        raise InputError(
            f"operation.fill: {count} grains are {mass:.4g} kg, but only {len(places)} fit into "
            "the vessel before they settle; take less powder"
        )
    order = np.lexsort((places[:, 2], places[:, 0], places[:, 1]))[:count]
    deviation = contact.spread * (2 * random.random(count) - 1)
    radius = 0.5 * contact.diameter * (1 + deviation)
    radius *= (mass / (contact.density * (4 / 3) * math.pi * (radius**3).sum())) ** (1 / 3)
    radius = np.minimum(radius, 0.5 * contact.largest)
    speed = math.sqrt(2 * GRAVITY * _DROP * contact.diameter / 3)
    return Grains(places[order], speed * random.standard_normal((count, 3)), radius)


def _lattice(geometry: Geometry, largest: float, spacing: float, length: float) -> FloatArray:
    """Points of a cubic lattice that are a grain's radius and more away from the wall, (n, 3)."""
    low, high = np.array(geometry.lower), np.array(geometry.upper)
    if geometry.dimension == 2:
        layers = max(1, math.floor(length / spacing + 1e-9))
        z = length * ((np.arange(layers) + 0.5) / layers - 0.5)
    else:
        z = np.arange(low[2] + 0.5 * spacing, high[2], spacing)
    x, y = (np.arange(low[a] + 0.5 * spacing, high[a], spacing) for a in (0, 1))
    found = []
    for height in y:
        points = np.stack(np.meshgrid(x, [height], z, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = geometry.signed_distance(points[:, : geometry.dimension]) > 0.505 * largest
        found.append(points[inside])
    return np.concatenate(found)
