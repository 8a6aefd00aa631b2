"""What shape a vessel has, asked of its signed distance."""

from __future__ import annotations

from typing import Any

import numpy as np

from scaleup.errors import InputError
from scaleup.scene import GRAVITY

_REACH = (5e-3, 20.0)  # m, of vessels that powder is blended in
_CELLS_ACROSS = 2.0  # least number of cells across the thinnest part inside a vessel


def symmetry(geometry: Any) -> tuple[tuple[float, ...], ...]:
    """The geometry's `symmetry`; none if it does not say."""
    return tuple(getattr(geometry, "symmetry", ()))


def require_vessel(name: str, geometry: Any) -> None:
    """Raise InputError for a vessel of no likely size, or one that its axis misses."""
    least, most = _REACH
    if not least <= geometry.reach <= most:
        raise InputError(
            f"geometry.name = {name!r}: the vessel reaches {geometry.reach:.4g} m from its axis "
            f"and holds {geometry.volume:.3g} m^3, but must reach {least:g} to {most:g} m; check "
            "the unit of its dimensions"
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
    thinnest = float(getattr(geometry, "thinnest", np.inf))
    if thinnest < _CELLS_ACROSS * spacing * (1 - 1e-9):
        raise InputError(
            f"grid: cells of {spacing:.3g} m do not resolve a part of the vessel that is "
            f"{thinnest:.3g} m thick; take cells of {thinnest / _CELLS_ACROSS:.3g} m or less, or a "
            "thicker part"
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
