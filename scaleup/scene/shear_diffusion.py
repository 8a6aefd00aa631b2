"""Diffusion in a sheared bed: the tensor that a configuration's [diffusion] asks for.

objective  D = shear_rate d^2 [k1 I + (k2 - k1) t t], t the direction of v - Omega x r
           (frame-independent; rigid rotation gives none).
paper      Eq. 6 of Liu, Gonzalez & Wassgren 2018: D_xx = d^2 (k1 g_y + k2 g_x),
           D_yy = d^2 (k1 g_x + k2 g_y), g_y = |dv_y/dx|, g_x = |dv_x/dy|, D_xy = 0. Not objective:
           rigid rotation gives D = (k1 + k2) Omega d^2. In 2-D and the lab frame only.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from scaleup.scene.laws import Diffusion
from scaleup.scene.models import Diffusion as Constants
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.gradient import slope
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError


def shear_diffusion(constants: Constants, grain_diameter: float) -> Diffusion:
    """The law of diffusion of these constants and grains (m)."""
    return Diffusion(partial(diffusion_tensor, constants=constants, grain_diameter=grain_diameter))


def diffusion_tensor(
    flow: FlowField, interval: Interval, constants: Constants, grain_diameter: float
) -> FloatArray:
    """Diffusion tensor of every active cell, m^2/s, shape (dimension, dimension, n).

    Raises InputError if `constants.model` is "paper" for a 3-D or vessel-frame flow.
    """
    scale = constants.k1 * grain_diameter**2
    ratio = constants.k2_ratio
    dimension, n = interval.direction.shape
    tensor = np.zeros((dimension, dimension, n))
    if constants.model == "objective":
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
    velocity = interval.velocity(flow.grid)
    g_y, g_x = (
        np.abs(slope(flow.grid, interval.cells, velocity[component], axis))
        for component, axis in ((1, 0), (0, 1))
    )
    tensor[0, 0] = scale * (g_y + ratio * g_x)
    tensor[1, 1] = scale * (g_x + ratio * g_y)
    return tensor
