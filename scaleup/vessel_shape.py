"""What shape a vessel has, asked of its signed distance."""

from __future__ import annotations

from typing import Any

import numpy as np

from scaleup.errors import InputError
from scaleup.scene import GRAVITY


def is_circle(geometry: Any) -> bool:
    """Whether a geometry is the cross-section of a drum: a circle about an axis at the origin."""
    if geometry.dimension != 2 or geometry.axis.point[:2] != (0.0, 0.0):
        return False
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    ring = geometry.reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return bool(np.abs(geometry.signed_distance(ring)).max() < 1e-6 * geometry.reach)


def level_height(geometry: Any, volume: float) -> float:
    """Height y (m) of the level bed of a given volume (m^3) in the vessel at rest, by bisection."""
    low, high = geometry.lower[1], geometry.upper[1]
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if geometry.volume_below(middle) < volume else (low, middle)
    return float(0.5 * (low + high))


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
            f"operation.speed = {speed:.4g} rad/s: the Froude number {froude:.3g} must be below "
            f"{froude_below:g} for flow {flow!r}; such a bed does not roll"
        )
