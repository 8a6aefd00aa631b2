"""What shape a vessel has, asked of its signed distance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from scaleup.scene.models import GRAVITY
from scaleup.scene.units import LENGTH, SPEED
from scaleup.space.grid import BoolArray, FloatArray
from scaleup.system.errors import InputError

_REACH = (5e-3, 20.0)  # m, of vessels that powder is blended in
_CELLS_ACROSS = 2.0  # least number of cells across the thinnest part inside a vessel


@dataclass(frozen=True)
class Bed:
    """The level bed in the vessel at rest, on cells of edge `spacing` (m); `volume` in m^3."""

    geometry: Any
    volume: float
    spacing: float

    @cached_property
    def top(self) -> float:
        """Height y of its surface, m."""
        return level_height(self.geometry, self.volume)

    @property
    def depth(self) -> float:
        """From its surface to the vessel's lowest point, m."""
        return bed_depth(self.geometry, self.volume)

    @property
    def cells(self) -> float:
        """How many full cells it holds."""
        cell = self.spacing**self.geometry.dimension * self.geometry.depth
        return float(self.volume / cell)

    @property
    def cells_of_box(self) -> float:
        """How many cells the box around the vessel has."""
        lower, upper = self.geometry.lower, self.geometry.upper
        edges = (max(1.0, (b - a) / self.spacing) for a, b in zip(lower, upper, strict=True))
        return float(math.prod(edges))

    def holds(self, points: FloatArray) -> BoolArray:
        """Which of the points (n, dimension), in m, lie in it."""
        below: BoolArray = points[:, 1] <= self.top
        found = np.zeros(len(points), dtype=bool)
        found[below] = self.geometry.signed_distance(points[below]) > 0
        return found


def require_vessel(name: str, geometry: Any) -> None:
    """Raise InputError for a vessel of no likely size, or one that its axis misses."""
    least, most = _REACH
    if not least <= geometry.reach <= most:
        raise InputError(
            f"geometry.name = {name!r}: the vessel reaches {LENGTH.shown(geometry.reach)} from its "
            f"axis and holds {1e3 * geometry.volume:.3g} litres, but must reach "
            f"{LENGTH.shown(least)} to {LENGTH.shown(most)}; check the unit of its dimensions"
        )
    if not axis_meets(geometry):
        raise InputError(
            f"geometry.name = {name!r}: the axis of rotation misses the vessel; check the axis' "
            "position and direction"
        )


def axis_meets(geometry: Any) -> bool:
    """Whether the axis of rotation passes through the inside."""
    point = np.array(geometry.axis.point[: geometry.dimension])
    direction = np.array(geometry.axis.direction[: geometry.dimension])
    size = float(np.linalg.norm(np.subtract(geometry.upper, geometry.lower)))
    along = np.linspace(-size, size, 4001) if geometry.dimension == 3 else np.zeros(1)
    return bool(geometry.signed_distance(point + along[:, None] * direction).max() > 0)


def require_resolved(geometry: Any, spacing: float) -> None:
    """Raise InputError if cells of edge `spacing` (m) are too large for a part inside."""
    thinnest = geometry.thinnest
    if thinnest < _CELLS_ACROSS * spacing * (1 - 1e-9):
        raise InputError(
            f"grid: cells of {LENGTH.shown(spacing)} do not resolve a part of the vessel that is "
            f"{LENGTH.shown(thinnest)} thick; take cells of "
            f"{LENGTH.shown(thinnest / _CELLS_ACROSS)} or less, or a thicker part"
        )


def is_circle(geometry: Any) -> bool:
    """Whether a geometry is the cross-section of a drum: a circle about an axis at the origin."""
    if geometry.dimension != 2 or geometry.axis.point[:2] != (0.0, 0.0):
        return False
    if abs(geometry.volume / (np.pi * geometry.reach**2 * geometry.depth) - 1) > 1e-6:
        return False  # something stands inside
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    ring = geometry.reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return bool(np.abs(geometry.signed_distance(ring)).max() < 1e-6 * geometry.reach)


def level_height(geometry: Any, volume: float) -> float:
    """Height y (m) of the level bed of a given volume (m^3) in the vessel at rest, by bisection."""
    low, high = geometry.lower[1], geometry.upper[1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if geometry.volume_below(middle) < volume else (low, middle)
    return float(0.5 * (low + high))


def bed_depth(geometry: Any, volume: float) -> float:
    """Depth, m, of the level bed of a given volume (m^3) in the vessel at rest."""
    return level_height(geometry, volume) - float(geometry.lower[1])


def froude_number(geometry: Any, speed: float) -> float:
    """Fr = omega^2 R / g, R the vessel's reach from the axis (m), omega its speed (rad/s)."""
    return speed**2 * float(geometry.reach) / GRAVITY


def require_drum(flow: str, geometry: Any, speed: float, froude_below: float) -> None:
    """Raise InputError unless the vessel is a circular cross-section that does not centrifuge."""
    if not is_circle(geometry):
        raise InputError(
            f"flow.name = {flow!r}: holds for a circular cross-section about the axis (such as "
            "geometry 'drum') only"
        )
    require_rolling(flow, geometry, speed, froude_below)


def require_rolling(flow: str, geometry: Any, speed: float, froude_below: float) -> None:
    """Raise InputError if the vessel turns so fast that its bed would not roll."""
    froude = froude_number(geometry, speed)
    if froude >= froude_below:
        raise InputError(
            f"operation.speed = {SPEED.shown(speed)}: the Froude number {froude:.3g} must be below "
            f"{froude_below:g} for flow {flow!r}; such a bed does not roll"
        )
