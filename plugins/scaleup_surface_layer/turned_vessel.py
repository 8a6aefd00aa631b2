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

from scaleup.contract import FloatArray, Progress
from scaleup.numerics import on_each
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

    wall    -- m, (nz + 1, ny + 1, nx + 1), a single layer in 2-D; single precision will do
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
def _distance(wall, fx, fy, fz):
    """Signed distance, trilinear, at a place within the samples, in spacings from their corner."""
    nz, ny, nx = wall.shape
    i, j = max(min(int(fx), nx - 2), 0), max(min(int(fy), ny - 2), 0)
    a, b = fx - i, fy - j
    if nz == 1:
        layer = wall[0]
        return (1 - b) * ((1 - a) * layer[j, i] + a * layer[j, i + 1]) + b * (
            (1 - a) * layer[j + 1, i] + a * layer[j + 1, i + 1]
        )
    k = max(min(int(fz), nz - 2), 0)
    e = fz - k
    value = 0.0
    for m in range(2):
        w = e if m else 1 - e
        layer = wall[k + m]
        value += w * (
            (1 - b) * ((1 - a) * layer[j, i] + a * layer[j, i + 1])
            + b * ((1 - a) * layer[j + 1, i] + a * layer[j + 1, i + 1])
        )
    return value


@njit(cache=True)
def _enter(wall, line, start, stop, least):
    """Where a line first meets the inside on the way between two heights, or nan.

    line -- place in spacings at height 0, and its change per m of height, of the three axes
    Steps as far as the distance allows, then interpolates.
    """
    px, py, pz, ux, uy = line
    way = 1.0 if stop > start else -1.0
    y = start
    before, d = y, 0.0
    while (stop - y) * way >= 0:
        last = d
        d = _distance(wall, px + ux * y, py + uy * y, pz)
        if d > 0:
            if last < 0:
                return before + (y - before) * last / (last - d)
            return y
        before = y
        y += way * max(0.9 * -d, least)
    return np.nan


@njit(cache=True)
def _within(place, change, last, low, high):
    """Between which heights a coordinate lies in [0, last]; low > high if nowhere."""
    if abs(change) < 1e-12:
        return (low, high) if 0 <= place <= last else (1.0, -1.0)
    one, other = -place / change, (last - place) / change
    return max(low, min(one, other)), min(high, max(one, other))


@njit(cache=True)
def _trace(wall, corner, spacing, reach, phase, place, floor, roof):
    c, s = np.cos(phase), np.sin(phase)
    x0, dx, z0, dz = place
    nx, nz, sx, sz = floor.shape
    most_z, most_y, most_x = wall.shape[0] - 1, wall.shape[1] - 1, wall.shape[2] - 1
    least = 0.5 * spacing[0]
    ux, uy = s / spacing[0], c / spacing[1]
    total, broken = 0, 0
    for i in range(nx):
        for k in range(nz):
            for p in range(sx):
                x = x0 + (i + (p + 0.5) / sx) * dx
                px, py = (c * x - corner[0]) / spacing[0], (-s * x - corner[1]) / spacing[1]
                start, stop = _within(px, ux, most_x, -reach, reach)
                start, stop = _within(py, uy, most_y, start, stop)
                if start > stop:
                    continue
                for q in range(sz):
                    z = z0 + (k + (q + 0.5) / sz) * dz
                    pz = (z - corner[2]) / spacing[2]
                    if most_z > 0 and not 0 <= pz <= most_z:
                        continue
                    line = px, py, pz, ux, uy
                    low = _enter(wall, line, start, stop, least)
                    if np.isnan(low):
                        continue
                    high = _enter(wall, line, stop, low, least)
                    if not high > low:
                        continue
                    floor[i, k, p, q], roof[i, k, p, q] = low, high
                    if p > 0 or q > 0:
                        continue
                    total += 1  # one line of a column is looked at for gaps
                    y = low
                    while y < high:
                        d = _distance(wall, px + ux * y, py + uy * y, pz)
                        if d < -0.5 * spacing[0]:
                            broken += 1
                            break
                        y += max(0.9 * d, least)
    return total, broken
