"""The one constant that a thin-layer model takes from a solved drum."""

from __future__ import annotations

import math


def layer_shear_rate(
    flux: float, axis_distance: float, reversal_depth: float, speed: float
) -> float | None:
    """Shear rate 2 q/delta^2 (1/s) of the linear layer that has this bed's flux and reversal depth.

    At mid-bed the lab velocity of such a layer is (2 q/delta)(1 - h/delta) - omega (b + h) at the
    depth h; it changes sign at h0 where 1/delta is the greater root x of

        2 q h0 x^2 - 2 q x + omega (b + h0) = 0.

    flux -- q, of the layer relative to rigid rotation, m^2/s; axis_distance -- b, of the axis from
    the surface, m; reversal_depth -- h0, m; speed -- omega, rad/s
    None if no linear layer reverses as deep as that.
    """
    rigid = speed * (axis_distance + reversal_depth)
    root = flux**2 - 2 * flux * reversal_depth * rigid
    if flux <= 0 or root < 0:
        return None
    thickness = 2 * flux * reversal_depth / (flux + math.sqrt(root))
    return 2 * flux / thickness**2
