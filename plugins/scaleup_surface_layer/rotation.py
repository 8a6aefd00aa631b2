"""Rigid rotation of a bed held as volumes of lab columns: conservative, positive, no step limit."""

from __future__ import annotations

import numpy as np
from numba import njit

from scaleup.contract import FloatArray
from scaleup_surface_layer.lab_columns import Columns
from scaleup_surface_layer.turned_vessel import ColumnShape


def bed_surface(
    shape: ColumnShape, volume: FloatArray, slope_limit: float, columns: Columns
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height at the column's centre (m) and slopes in x and z of a plane top in every column.

    The plane is cut by floor and roof of each sub-line and holds the column's volume (m^3 per m^2);
    its slopes are central differences between columns with material, within +- `slope_limit`.
    """
    height = np.where(shape.open > 0, shape.low + volume / np.maximum(shape.open, 1e-12), 0.0)
    height = np.minimum(height, shape.high)
    return _plane_tops(shape.floor, shape.roof, volume, height, columns.dx, columns.dz, slope_limit)


def turn(
    columns: Columns,
    shape: ColumnShape,
    volume: FloatArray,
    tops: tuple[FloatArray, FloatArray, FloatArray],
    turned: ColumnShape,
    angle: float,
) -> tuple[FloatArray, float]:
    """The volumes after a turn by `angle` (rad), and how much was put elsewhere than it landed.

    Material on every sub-line is a slab; turned, it lies over the columns that its slanted
    footprint covers. What lands beside the vessel, or above its roof, because a column is no finer
    than that, goes to the nearest column with room.
    """
    landed = _deposit(
        columns.x0, columns.dx, columns.dz, shape.floor, shape.roof, volume, *tops, angle
    )
    moved = _rehome(landed, turned.capacity)
    return landed, moved


@njit(cache=True)
def _sub_tops(floor, roof, height, gx, gz, dx, dz, tops):
    """Depth of material on every sub-line below the plane; returns their mean over all lines."""
    sx, sz = floor.shape
    total = 0.0
    for p in range(sx):
        for q in range(sz):
            tops[p, q] = 0.0
            if roof[p, q] <= floor[p, q]:
                continue
            y = height + gx * dx * ((p + 0.5) / sx - 0.5) + gz * dz * ((q + 0.5) / sz - 0.5)
            tops[p, q] = min(max(y, floor[p, q]), roof[p, q]) - floor[p, q]
            total += tops[p, q]
    return total / (sx * sz)


@njit(cache=True)
def _plane_tops(floor, roof, volume, height, dx, dz, limit):
    nx, nz, sx, sz = floor.shape
    top, slope_x, slope_z = height.copy(), np.zeros((nx, nz)), np.zeros((nx, nz))
    work = np.empty((sx, sz))
    for i in range(nx):
        for k in range(nz):
            if volume[i, k] <= 0:
                continue
            gx, gz = 0.0, 0.0
            if 0 < i < nx - 1 and volume[i - 1, k] > 0 and volume[i + 1, k] > 0:
                gx = (height[i + 1, k] - height[i - 1, k]) / (2 * dx)
            if 0 < k < nz - 1 and volume[i, k - 1] > 0 and volume[i, k + 1] > 0:
                gz = (height[i, k + 1] - height[i, k - 1]) / (2 * dz)
            gx, gz = min(max(gx, -limit), limit), min(max(gz, -limit), limit)
            spread = 0.5 * (abs(gx) * dx + abs(gz) * dz)
            low, high = np.inf, -np.inf
            for p in range(sx):
                for q in range(sz):
                    if roof[i, k, p, q] > floor[i, k, p, q]:
                        low = min(low, floor[i, k, p, q] - spread)
                        high = max(high, roof[i, k, p, q] + spread)
            if high <= low:
                continue
            for _ in range(60):
                middle = 0.5 * (low + high)
                if _sub_tops(floor[i, k], roof[i, k], middle, gx, gz, dx, dz, work) < volume[i, k]:
                    low = middle
                else:
                    high = middle
                if high - low < 1e-10 * dx:
                    break
            top[i, k], slope_x[i, k], slope_z[i, k] = high, gx, gz
    return top, slope_x, slope_z


@njit(cache=True)
def _ramp(t):
    return 0.5 * t * t if t > 0 else 0.0


@njit(cache=True)
def _deposit(x0, dx, dz, floor, roof, volume, top, slope_x, slope_z, angle):
    nx, nz, sx, sz = floor.shape
    c, s = np.cos(angle), np.sin(angle)
    half = 0.5 * dx / sx * c
    landed = np.zeros((nx, nz))
    tops = np.empty((sx, sz))
    for i in range(nx):
        for k in range(nz):
            if volume[i, k] <= 0:
                continue
            mean = _sub_tops(
                floor[i, k], roof[i, k], top[i, k], slope_x[i, k], slope_z[i, k], dx, dz, tops
            )
            if mean <= 0:
                landed[i, k] += volume[i, k]
                continue
            scale = volume[i, k] / (mean * sx * sz)
            for p in range(sx):
                x = x0 + (i + (p + 0.5) / sx) * dx
                for q in range(sz):
                    if tops[p, q] <= 0:
                        continue
                    bottom = floor[i, k, p, q]
                    u0, u1 = x * c - (bottom + tops[p, q]) * s, x * c - bottom * s
                    u0, u1 = min(u0, u1), max(u0, u1)
                    if u1 - u0 < 1e-3 * half:
                        u0, u1 = 0.5 * (u0 + u1) - 5e-4 * half, 0.5 * (u0 + u1) + 5e-4 * half
                    # a box of half width `half` smeared evenly from u0 to u1: its share left of X
                    norm = 2 * half * (u1 - u0)
                    first = int(np.floor((u0 - half - x0) / dx))
                    last = int(np.floor((u1 + half - x0) / dx))
                    before = 0.0
                    for j in range(first, last + 1):
                        share = 1.0
                        if j < last:
                            X = x0 + (j + 1) * dx
                            share = (
                                _ramp(X + half - u0)
                                - _ramp(X + half - u1)
                                - _ramp(X - half - u0)
                                + _ramp(X - half - u1)
                            ) / norm
                            share = min(max(share, before), 1.0)
                        landed[min(max(j, 0), nx - 1), k] += (share - before) * tops[p, q] * scale
                        before = share
    return landed


@njit(cache=True)
def _rehome(volume, capacity):
    """Move what is above a column's capacity to the nearest columns with room; returns how much."""
    nx, nz = volume.shape
    moved = 0.0
    for i in range(nx):
        for k in range(nz):
            excess = volume[i, k] - capacity[i, k]
            if excess <= 1e-12 * max(capacity[i, k], 1e-30):
                continue
            moved += excess
            volume[i, k] = capacity[i, k]
            ring, share = 1, 0.0
            while excess > 0 and ring < nx + nz:
                # all columns at this distance along the axes share alike
                room = 0.0
                for step in range(2):
                    for e in range(-ring, ring + 1):
                        left = ring - abs(e)
                        for side in range(2 if left > 0 else 1):
                            a, b = i + e, k + (left if side == 0 else -left)
                            if not (0 <= a < nx and 0 <= b < nz):
                                continue
                            free = capacity[a, b] - volume[a, b]
                            if free <= 0:
                                continue
                            if step == 0:
                                room += free
                            else:
                                volume[a, b] += free * share
                    if room <= 0:
                        break
                    share = min(1.0, excess / room)
                if room > 0:
                    excess -= share * room
                ring += 1
            if excess > 0:
                volume[i, k] += excess
    return moved
