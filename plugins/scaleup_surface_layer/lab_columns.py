"""Fields over vertical lab columns: the bed's surface and the flux of the layer that runs on it.

All lab coordinates are relative to the axis of rotation: x right, y up, z along the axis. A column
is numbered (i, k) in x and z. Fields that are read at arbitrary (x, z) are bilinear between nodes:
column centres, or the middles of column faces for fluxes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from scaleup.contract import FloatArray


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

    def upper_half(self) -> Columns:
        """Those at greater z; nz must be even."""
        half = self.nz // 2
        return replace(self, z0=self.z0 + half * self.dz, nz=half)


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

    def mirrored(self) -> BedState:
        """The whole of which this is the half at greater z."""
        return BedState(self.phase, *(_both(field) for field in (self.surface, self.depth)))


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

    def mirrored(self) -> BedStep:
        """The whole of which this is the half at greater z; nothing crosses the plane between."""
        flux_z = np.concatenate([-self.flux_z[:, :0:-1], self.flux_z], axis=1)
        return BedStep(self.before.mirrored(), self.after.mirrored(), _both(self.flux_x), flux_z)


def _both(upper: FloatArray) -> FloatArray:
    return np.concatenate([upper[:, ::-1], upper], axis=1)


class Layer(NamedTuple):
    """A flowing layer at one instant, for the kernels.

    table      -- (2 nx + 1, 2 nz + 1, 5) values on a lattice of half the columns' spacing, which
                  holds every node of every field: surface (m), bed depth (m), flux x and z (m^2/s),
                  divergence of the flux (m/s)
    x0, dx, z0, dz -- first point and spacing of the lattice, m
    shear_rate -- 1/s; thinnest, thickest -- bounds of the thickness, m
    """

    table: FloatArray
    x0: float
    dx: float
    z0: float
    dz: float
    shear_rate: float
    thinnest: float
    thickest: float


def layer_of(
    columns: Columns, step: BedStep, share: float, level: float, shear_rate: float, thinnest: float
) -> Layer:
    """The layer at a share (0 to 1) of a step, its surface lifted by `level` (m)."""
    fx, fz = step.flux_x, step.flux_z
    divergence = np.diff(fx, axis=0) / columns.dx + np.diff(fz, axis=1) / columns.dz
    fields = (
        (1 - share) * step.before.surface + share * step.after.surface + level,
        (1 - share) * step.before.depth + share * step.after.depth,
        fx,
        fz,
        divergence,
    )
    table = np.stack([_halved(_halved(f, 0, columns.nx), 1, columns.nz) for f in fields], axis=-1)
    peak = math.hypot(float(np.abs(fx).max()), float(np.abs(fz).max()))
    return Layer(
        np.ascontiguousarray(table),
        columns.x0,
        0.5 * columns.dx,
        columns.z0,
        0.5 * columns.dz,
        shear_rate,
        thinnest,
        max(thinnest, math.sqrt(2 * peak / shear_rate)),
    )


def _halved(values: FloatArray, axis: int, count: int) -> FloatArray:
    """Values at column centres (count) or faces (count + 1) on both along an axis."""
    v = np.moveaxis(values, axis, 0)
    fine = np.empty((2 * count + 1, *v.shape[1:]))
    middle = 0.5 * (v[1:] + v[:-1])
    if len(v) == count + 1:
        fine[::2], fine[1::2] = v, middle
    else:  # held constant from the outermost centres on
        fine[1::2], fine[2:-2:2], fine[0], fine[-1] = v, middle, v[0], v[-1]
    return np.moveaxis(fine, 0, axis)


@njit(cache=True, inline="always")
def depth_below(layer, x, y, z):
    """Vertical depth below the surface at a lab point, m; negative above it."""
    return look_up(layer, x, z, 0) - y


@njit(cache=True, inline="always")
def place_of(layer, x, z):
    """(i, k, a, b): lattice point below lab (x, z) and shares of the way to the next ones.

    Held constant beyond the edge.
    """
    n, m = layer.table.shape[0], layer.table.shape[1]
    s = min(max((x - layer.x0) / layer.dx, 0.0), n - 1.000001)
    t = min(max((z - layer.z0) / layer.dz, 0.0), m - 1.000001)
    i, k = np.uint64(s), np.uint64(t)
    return i, k, s - i, t - k


@njit(cache=True, inline="always")
def field_at(layer, place, field):
    """A field of the table, bilinear."""
    table = layer.table
    i, k, a, b = place
    one = np.uint64(1)
    return (1 - a) * ((1 - b) * table[i, k, field] + b * table[i, k + one, field]) + a * (
        (1 - b) * table[i + one, k, field] + b * table[i + one, k + one, field]
    )


@njit(cache=True, inline="always")
def look_up(layer, x, z, field):
    """A field of the table at lab (x, z)."""
    return field_at(layer, place_of(layer, x, z), field)


@njit(cache=True, inline="always")
def layer_at(layer, place):
    """(flux_x, flux_z, thickness) of the layer at a place, m^2/s and m."""
    qx, qz = field_at(layer, place, 2), field_at(layer, place, 3)
    delta = np.sqrt(2.0 * np.sqrt(qx * qx + qz * qz) / layer.shear_rate)
    return qx, qz, max(min(delta, field_at(layer, place, 1)), layer.thinnest)
