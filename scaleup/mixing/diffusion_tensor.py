"""The diffusion tensor of a sheared bed.

objective  D = shear_rate d^2 [k1 I + (k2 - k1) t t], t the direction of v - Omega x r
           (frame-independent; rigid rotation gives none).
paper      Eq. 6 of Liu, Gonzalez & Wassgren 2018: D_xx = d^2 (k1 g_y + k2 g_x),
           D_yy = d^2 (k1 g_x + k2 g_y), g_y = |dv_y/dx|, g_x = |dv_x/dy|, D_xy = 0. Not objective:
           rigid rotation gives D = (k1 + k2) Omega d^2. In 2-D and the lab frame only.
"""

from __future__ import annotations

import numpy as np

from scaleup.scene.models import Diffusion
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError


def diffusion_tensor(
    flow: FlowField, interval: Interval, law: Diffusion, grain_diameter: float
) -> FloatArray:
    """Diffusion tensor of every active cell, m^2/s, shape (dimension, dimension, n).

    Raises InputError if `law.model` is "paper" for a 3-D or vessel-frame flow.
    """
    scale = law.k1 * grain_diameter**2
    ratio = law.k2_ratio
    dimension, n = interval.direction.shape
    tensor = np.zeros((dimension, dimension, n))
    if law.model == "objective":
        sheared = np.flatnonzero(interval.shear_rate)  # in a vessel's frame a small part of the bed
        t, rate = interval.direction[:, sheared], interval.shear_rate[sheared]
        identity = np.eye(dimension)[:, :, None]
        tensor[:, :, sheared] = scale * rate * (identity + (ratio - 1.0) * t[:, None] * t[None, :])
        return tensor
    if dimension != 2 or flow.frame != "lab":
        raise InputError(
            "diffusion.model = 'paper': Eq. 6 holds for a 2-D flow in the lab frame only; "
            "use 'objective'"
        )
    g_y, g_x = _cross_gradients(flow, interval)
    tensor[0, 0] = scale * (g_y + ratio * g_x)
    tensor[1, 1] = scale * (g_x + ratio * g_y)
    return tensor


def _cross_gradients(flow: FlowField, interval: Interval) -> tuple[FloatArray, FloatArray]:
    """|dv_y/dx| and |dv_x/dy| by central differences, one-sided at the bed's edge, 1/s."""
    grid = flow.grid
    velocity = interval.velocity(grid)
    dense = np.full((2, *grid.shape), np.nan)
    dense[:, *np.unravel_index(interval.cells, grid.shape)] = velocity
    gradients = []
    for component, axis in ((1, 0), (0, 1)):
        values = dense[component]
        along = grid.array_axis(axis)
        ahead = np.roll(values, -1, along) - values
        behind = values - np.roll(values, 1, along)
        both = np.stack([ahead, behind])
        known = np.isfinite(both).sum(axis=0)
        total = np.nansum(both, axis=0)
        slope = np.divide(total, known, out=np.zeros_like(total), where=known > 0)
        gradients.append(np.abs(slope.reshape(-1)[interval.cells]) / grid.spacing[axis])
    return gradients[0], gradients[1]
