"""What shape a vessel has, asked of its signed distance."""

from __future__ import annotations

from typing import Any

import numpy as np


def is_circle(geometry: Any) -> bool:
    """Whether a geometry is the cross-section of a drum: a circle about an axis at the origin."""
    if geometry.dimension != 2 or geometry.axis.point[:2] != (0.0, 0.0):
        return False
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    ring = geometry.reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return bool(np.abs(geometry.signed_distance(ring)).max() < 1e-6 * geometry.reach)
