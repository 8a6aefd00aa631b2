"""Fields over vertical lab columns: the bed's surface and the flux of the layer that runs on it.

All lab coordinates are relative to the axis of rotation: x right, y up, z along the axis. A column
is numbered (i, k) in x and z. Fields that are read at arbitrary (x, z) are bilinear between nodes:
column centres, or the middles of column faces for fluxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from scaleup.api import FloatArray


@dataclass(frozen=True)
class Columns:
    """A uniform grid of columns.

    x0, z0 -- m, lower edges; dx, dz -- m, widths; nx, nz -- counts (nz = 1 in 2-D)
    """

    x0: float
    dx: float
    nx: int
    z0: float
    dz: float
    nz: int

    def centres_x(self) -> FloatArray:
        """M, shape (nx,)."""
        return self.x0 + self.dx * (np.arange(self.nx) + 0.5)

    def centres_z(self) -> FloatArray:
        """M, shape (nz,)."""
        return self.z0 + self.dz * (np.arange(self.nz) + 0.5)


@dataclass(frozen=True)
class BedState:
    """The bed at one phase of the vessel; every array (nx, nz), defined on all columns.

    phase   -- rad, that the vessel has turned
    surface -- m, height of the bed's top; continued beyond the vessel's wall
    depth   -- m of bed below it; 0 where there is none
    """

    phase: float
    surface: FloatArray
    depth: FloatArray


@dataclass(frozen=True)
class BedStep:
    """What happens between two states.

    flux_x, flux_z -- m^2/s through column faces, per width, relative to rigid rotation: the mean
                      of the step; shapes (nx + 1, nz) and (nx, nz + 1)
    """

    before: BedState
    after: BedState
    flux_x: FloatArray
    flux_z: FloatArray


class Layer(NamedTuple):
    """A flowing layer at one instant, for the kernels; see `BedState` and `BedStep`.

    divergence -- of the flux, m/s, (nx, nz); shear_rate -- 1/s; thinnest -- m, least thickness
    """

    x0: float
    dx: float
    z0: float
    dz: float
    surface: FloatArray
    depth: FloatArray
    flux_x: FloatArray
    flux_z: FloatArray
    divergence: FloatArray
    shear_rate: float
    thinnest: float


def layer_of(columns: Columns, step: BedStep, share: float, shear_rate: float, thinnest: float):
    """The layer at a share (0 to 1) of a step."""
    fx, fz = step.flux_x, step.flux_z
    return Layer(
        columns.x0,
        columns.dx,
        columns.z0,
        columns.dz,
        (1 - share) * step.before.surface + share * step.after.surface,
        (1 - share) * step.before.depth + share * step.after.depth,
        fx,
        fz,
        np.diff(fx, axis=0) / columns.dx + np.diff(fz, axis=1) / columns.dz,
        shear_rate,
        thinnest,
    )


@njit(cache=True)
def bilinear(values, s, t):
    """Value at node coordinates (s, t), held constant beyond the outermost nodes."""
    n, m = values.shape
    s = min(max(s, 0.0), n - 1.0)
    t = min(max(t, 0.0), m - 1.0)
    i = min(int(s), n - 2) if n > 1 else 0
    k = min(int(t), m - 2) if m > 1 else 0
    a, b = s - i, t - k
    i1 = i + 1 if n > 1 else 0
    k1 = k + 1 if m > 1 else 0
    return (1 - a) * ((1 - b) * values[i, k] + b * values[i, k1]) + a * (
        (1 - b) * values[i1, k] + b * values[i1, k1]
    )


@njit(cache=True)
def depth_below(layer, x, y, z):
    """Vertical depth below the surface at a lab point, m; negative above it."""
    s = (x - layer.x0) / layer.dx - 0.5
    t = (z - layer.z0) / layer.dz - 0.5
    return bilinear(layer.surface, s, t) - y


@njit(cache=True)
def layer_at(layer, x, z):
    """(flux_x, flux_z, thickness) of the layer at lab (x, z), m^2/s and m."""
    s = (x - layer.x0) / layer.dx
    t = (z - layer.z0) / layer.dz
    qx = bilinear(layer.flux_x, s, t - 0.5)
    qz = bilinear(layer.flux_z, s - 0.5, t)
    bed = bilinear(layer.depth, s - 0.5, t - 0.5)
    delta = np.sqrt(2.0 * np.sqrt(qx * qx + qz * qz) / layer.shear_rate)
    return qx, qz, max(min(delta, bed), layer.thinnest)
