"""The inside of a turned vessel along vertical lines, from samples of its signed distance.

A lab column is looked at along a few vertical lines (its sub-lines); on each the vessel reaches
from `floor` to `roof`. Where it leaves the line in between (an overhang, a baffle) it is counted
as inside, and the share of such lines is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from scaleup.api import FloatArray, Progress, on_each
from scaleup_surface_layer.lab_columns import Columns


class Outline(NamedTuple):
    """Mean floor and roof of columns, m, and the share of lines that leave the vessel between."""

    low: FloatArray
    high: FloatArray
    broken: float


@dataclass(frozen=True)
class ColumnShape:
    """The vessel in every column at one phase.

    floor, roof -- m, on the sub-lines, (nx, nz, sx, sz), single precision; roof < floor where
                   there is no vessel
    open        -- share of the column's sub-lines that meet the vessel, (nx, nz)
    low, high   -- mean floor and roof over them, m, (nx, nz)
    broken      -- share of the sub-lines in the vessel that leave it in between
    """

    floor: FloatArray
    roof: FloatArray
    open: FloatArray
    low: FloatArray
    high: FloatArray
    broken: float

    @property
    def capacity(self) -> FloatArray:
        """m^3 per m^2 of footprint, (nx, nz)."""
        return self.open * (self.high - self.low)

    @property
    def outline(self) -> Outline:
        """What is left without the sub-lines."""
        return Outline(self.low, self.high, self.broken)


@dataclass(frozen=True)
class TurnedVessel:
    """Samples of the signed distance on the corners of the vessel's own grid.

    wall    -- m, (nz + 1, ny + 1, nx + 1), a single layer in 2-D
    corner  -- lower corner of the samples relative to the axis; spacing -- between them
    reach   -- m, from the axis
    """

    wall: FloatArray
    corner: FloatArray
    spacing: FloatArray
    reach: float

    def columns(self, columns: Columns, phase: float, sub_lines: tuple[int, int]) -> ColumnShape:
        """What the columns are like when the vessel has turned by `phase`, rad."""
        shape = (columns.nx, columns.nz, *sub_lines)
        floor, roof = np.zeros(shape), np.full(shape, -1.0)
        total, broken = _trace(
            self.wall,
            self.corner,
            self.spacing,
            self.reach,
            phase,
            (columns.x0, columns.dx, columns.z0, columns.dz),
            floor,
            roof,
        )
        floor, roof = floor.astype(np.float32), roof.astype(np.float32)  # many are kept
        inside = roof > floor
        count = inside.sum(axis=(2, 3))
        some = np.maximum(count, 1)
        low = np.where(inside, floor, 0.0).sum(axis=(2, 3), dtype=float) / some
        high = np.where(inside, roof, 0.0).sum(axis=(2, 3), dtype=float) / some
        lines = sub_lines[0] * sub_lines[1]
        return ColumnShape(floor, roof, count / lines, low, high, broken / max(total, 1))


@dataclass(frozen=True)
class PhasedVessel:
    """The vessel in columns at equally spaced phases of one revolution.

    shapes -- at phase 0, 1, ... steps of 2 pi/len(shapes); on the root alone
    """

    columns: Columns
    shapes: list[ColumnShape]

    @staticmethod
    def trace(
        vessel: TurnedVessel,
        columns: Columns,
        steps: int,
        sub_lines: tuple[int, int],
        comm: Any,
        progress: Progress,
    ) -> PhasedVessel:
        """Trace `steps` phases, each by one of the ranks (collective)."""

        def some() -> list[ColumnShape]:
            traced = []
            for number in range(comm.rank, steps, comm.size):
                traced.append(vessel.columns(columns, 2 * math.pi * number / steps, sub_lines))
                progress(0.2 * number / steps, "vertical lines through the vessel")
            return traced

        parts = comm.gather(on_each(comm, some))
        shapes = (
            [] if parts is None else [parts[n % comm.size][n // comm.size] for n in range(steps)]
        )
        return PhasedVessel(columns, shapes)


@njit(cache=True)
def _distance(wall, corner, spacing, x, y, z):
    """Signed distance at a vessel point, trilinear; continued outside the samples."""
    nz, ny, nx = wall.shape
    fx, fy = (x - corner[0]) / spacing[0], (y - corner[1]) / spacing[1]
    gx, gy = min(max(fx, 0.0), nx - 1.0), min(max(fy, 0.0), ny - 1.0)
    i, j = min(int(gx), nx - 2), min(int(gy), ny - 2)
    a, b = gx - i, gy - j
    outside = ((fx - gx) * spacing[0]) ** 2 + ((fy - gy) * spacing[1]) ** 2
    if nz > 1:
        fz = (z - corner[2]) / spacing[2]
        gz = min(max(fz, 0.0), nz - 1.0)
        k = min(int(gz), nz - 2)
        e = gz - k
        outside += ((fz - gz) * spacing[2]) ** 2
        value = 0.0
        for m in range(2):
            w = e if m else 1 - e
            layer = wall[k + m]
            value += w * (
                (1 - b) * ((1 - a) * layer[j, i] + a * layer[j, i + 1])
                + b * ((1 - a) * layer[j + 1, i] + a * layer[j + 1, i + 1])
            )
    else:
        layer = wall[0]
        value = (1 - b) * ((1 - a) * layer[j, i] + a * layer[j, i + 1]) + b * (
            (1 - a) * layer[j + 1, i] + a * layer[j + 1, i + 1]
        )
    return value - np.sqrt(outside)


@njit(cache=True)
def _enter(wall, corner, spacing, c, s, x, z, start, stop, least):
    """Where a vertical line first meets the inside between two heights, or nan.

    Steps as far as the distance allows, then interpolates.
    """
    way = 1.0 if stop > start else -1.0
    y = start
    before, d = y, 0.0
    while (stop - y) * way >= 0:
        last = d
        d = _distance(wall, corner, spacing, c * x + s * y, -s * x + c * y, z)
        if d > 0:
            if last < 0:
                return before + (y - before) * last / (last - d)
            return y
        before = y
        y += way * max(0.9 * -d, least)
    return np.nan


@njit(cache=True)
def _trace(wall, corner, spacing, reach, phase, place, floor, roof):
    c, s = np.cos(phase), np.sin(phase)
    x0, dx, z0, dz = place
    nx, nz, sx, sz = floor.shape
    least = 0.5 * spacing[0]
    total, broken = 0, 0
    for i in range(nx):
        for k in range(nz):
            for p in range(sx):
                x = x0 + (i + (p + 0.5) / sx) * dx
                for q in range(sz):
                    z = z0 + (k + (q + 0.5) / sz) * dz
                    low = _enter(wall, corner, spacing, c, s, x, z, -reach, reach, least)
                    if np.isnan(low):
                        continue
                    high = _enter(wall, corner, spacing, c, s, x, z, reach, low, least)
                    if not high > low:
                        continue
                    floor[i, k, p, q], roof[i, k, p, q] = low, high
                    if p > 0 or q > 0:
                        continue
                    total += 1  # one line of a column is looked at for gaps
                    for e in range(1, 8):
                        y = low + (high - low) * e / 8
                        d = _distance(wall, corner, spacing, c * x + s * y, -s * x + c * y, z)
                        if d < -spacing[0]:
                            broken += 1
                            break
    return total, broken
