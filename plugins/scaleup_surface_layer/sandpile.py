"""The bed's surface under gravity: a flux wherever it is steeper than the friction allows.

In lab columns, h the height of the bed's top, v its volume per area, q the depth-integrated flux
relative to rigid rotation (Prigozhin's sandpile with a steep law in place of the inequality):

    dv/dt + div q = what rotation brings,    q = -K p(|grad h| - mu) grad h/|grad h|,

p(t) = t for t > 0 (smooth at 0, bounded at the top), K = omega R^2/(2 eps mu), so that the slope
exceeds mu by the share eps at the flux omega R^2/2. No flux leaves an empty column, enters a full
one, or passes a closed wall. The gradient lives on column corners, with the mean square of the
differences that meet there, so that no direction is preferred.

A step is rotation (`rotation`), then relaxation over its duration. Most of that time passes on
columns twice as wide (and of theirs on columns four times as wide, and so on), the last part, in
which a bump a few columns wide dies out, on the columns themselves: the work is then in proportion
to the columns. Each part is one Runge-Kutta-Chebyshev step of first order, damped: explicit, stable
whatever the duration, since the number of stages grows as the square root of the stiffness. It is
written for the flux, of which every stage is a sum, so that volume is kept whatever the accuracy;
what would empty or overfill a column is cut from the flux at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from scaleup.contract import FloatArray
from scaleup_surface_layer.lab_columns import Columns
from scaleup_surface_layer.turned_vessel import ColumnShape

_DAMPING = 3000.0  # the more, the less a step overshoots; stages grow as its fourth root
_STIFF = 5.0  # greatest eigenvalue of the flux' derivative, over conductance / width^2
_FILM = 0.1  # of a column's width: a thinner film flows in proportion to its depth
_SWEEPS = 200  # over all columns, at most, in which a flux is cut to what they hold
_LAST = 512.0  # of width^2 / conductance: the part of a step that passes on the finest columns
FEWEST = 32  # columns across, fewer than which a step passes at once
_FASTEST = 4.0  # of omega R^2/2: greatest flux through a face


class SlopeLaw(NamedTuple):
    """q = conductance p(slope - friction), m^2/s.

    friction -- mu = tan(phi); conductance -- K, m^2/s; smooth -- slope range over which p sets in
    greatest -- bound of the flux, m^2/s
    """

    friction: float
    conductance: float
    smooth: float
    greatest: float


def slope_law(friction: float, omega: float, reach: float, excess: float) -> SlopeLaw:
    """The law for a vessel (reach, m; omega, rad/s); `excess`: eps."""
    scale = 0.5 * omega * reach**2
    return SlopeLaw(
        friction, scale / (excess * friction), 0.5 * excess * friction, _FASTEST * scale
    )


def relax(
    columns: Columns, shape: ColumnShape, volume: FloatArray, law: SlopeLaw, duration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Volumes after `duration` (s), and the mean fluxes (nx + 1, nz) and (nx, nz + 1), m^2/s."""
    level = Level(columns.dx, columns.dz, shape.open, shape.low, shape.high)
    after, qx, qz = _relax_from_coarse(level, volume, law, duration)
    return after, qx / duration, qz / duration


def _relax_from_coarse(
    level: Level, volume: FloatArray, law: SlopeLaw, duration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Volumes after `duration`, and time integrals of the fluxes, m^2.

    1 all but the last part of the time passes on columns twice as wide, in the same way;
    2 their fluxes are spread over the columns, so that each wide column's gain is shared alike;
    3 the last part passes on the columns themselves.
    """
    last = _LAST * level.width**2 / law.conductance
    if last > 0.5 * duration or min(level.across) < FEWEST or any(n % 2 for n in level.across):
        return _relax_at_once(level, volume, law, duration)
    coarse = level.coarse()
    _, wide_x, wide_z = _relax_from_coarse(
        coarse, _restricted(volume, level.flat), law, duration - last
    )
    passage = level.passage
    first_x, first_z = _prolonged(
        volume, level.capacity, wide_x, wide_z, passage[0], passage[1], level.dx, level.dz
    )
    between = _limited(volume, level.capacity, first_x, first_z, level.dx, level.dz)
    after, qx, qz = _relax_at_once(level, between, law, last)
    return after, first_x + qx, first_z + qz


def _relax_at_once(
    level: Level, volume: FloatArray, law: SlopeLaw, duration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    stages = _stages(_STIFF * law.conductance / level.width**2 * duration)
    qx, qz = _chebyshev(volume, level.ground, law, duration, stages)
    after = _limited(volume, level.capacity, qx, qz, level.dx, level.dz)
    return after, qx, qz


class Ground(NamedTuple):
    """A `Level` for kernels.

    room -- m, height of the vessel over each column; passage -- of `_passage`
    film -- m, depth below which a film flows in proportion to it
    """

    open: FloatArray
    low: FloatArray
    room: FloatArray
    passage: tuple[FloatArray, ...]
    dx: float
    dz: float
    flat: bool
    film: float


@dataclass(frozen=True)
class Level:
    """The vessel in columns of one width.

    dx, dz -- m; open, low, high -- as in `ColumnShape`, (nx, nz)
    """

    dx: float
    dz: float
    open: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def flat(self) -> bool:
        """Whether this is a cross-section."""
        return self.open.shape[1] == 1

    @property
    def across(self) -> tuple[int, ...]:
        """Columns along x and z."""
        return self.open.shape[:1] if self.flat else self.open.shape

    @property
    def width(self) -> float:
        """M, the smaller one."""
        return self.dx if self.flat else min(self.dx, self.dz)

    @cached_property
    def capacity(self) -> FloatArray:
        """m^3 per m^2 of footprint, (nx, nz)."""
        return self.open * (self.high - self.low)

    @cached_property
    def passage(self) -> tuple[FloatArray, ...]:
        """See `_passage`."""
        return _passage(self.open, self.low, self.high, self.flat)  # type: ignore[no-any-return]

    @property
    def ground(self) -> Ground:
        """The same for kernels."""
        room, film = self.high - self.low, _FILM * self.width
        return Ground(self.open, self.low, room, self.passage, self.dx, self.dz, self.flat, film)

    def coarse(self) -> Level:
        """The same in columns twice as wide."""
        share = _restricted(self.open, self.flat)
        some = np.maximum(share, 1e-300)
        return Level(
            2 * self.dx,
            self.dz if self.flat else 2 * self.dz,
            share,
            _restricted(self.open * self.low, self.flat) / some,
            _restricted(self.open * self.high, self.flat) / some,
        )


def _restricted(values: FloatArray, flat: bool) -> FloatArray:
    """Means over columns twice as wide."""
    pairs = 0.5 * (values[::2] + values[1::2])
    return pairs if flat else 0.5 * (pairs[:, ::2] + pairs[:, 1::2])


@njit(cache=True)
def _prolonged(volume, capacity, wide_x, wide_z, open_x, open_z, dx, dz):
    """Fluxes through column faces from those of columns twice as wide, all integrated over time.

    A wide face's flux is shared out among its faces as they are open; within a wide column the
    faces carry what shares its gain alike among the columns that can take it.
    """
    nx, nz = volume.shape
    flat = nz == 1
    parts = 1 if flat else 2
    qx, qz = np.zeros((nx + 1, nz)), np.zeros((nx, nz + 1))
    for i in range(2, nx, 2):  # faces of wide columns
        for k in range(0, nz, parts):
            total = open_x[i, k : k + parts].sum()
            if total > 0:
                for b in range(k, k + parts):
                    qx[i, b] = wide_x[i // 2, k // parts] * parts * open_x[i, b] / total
    if not flat:
        for i in range(0, nx, 2):
            for k in range(2, nz, 2):
                total = open_z[i : i + 2, k].sum()
                if total > 0:
                    for a in range(i, i + 2):
                        qz[a, k] = wide_z[i // 2, k // 2] * 2 * open_z[a, k] / total
    need = np.zeros((2, parts))
    for i in range(0, nx, 2):
        for k in range(0, nz, parts):
            _share_gain(volume, capacity, qx, qz, i, k, dx, dz, need)
            if flat:
                if open_x[i + 1, k] > 0:
                    qx[i + 1, k] = -need[0, 0] * dx
                continue
            # around the four columns, at first with nothing through the face from (0, 0) to (0, 1)
            x0 = -need[0, 0] * dx
            z1 = (x0 / dx - need[1, 0]) * dz
            x1 = (need[1, 1] - z1 / dz) * dx
            if open_z[i, k + 1] <= 0:
                turn = 0.0
            elif open_x[i + 1, k] <= 0:
                turn = -x0 / dx
            elif open_z[i + 1, k + 1] <= 0:
                turn = -z1 / dz
            elif open_x[i + 1, k + 1] <= 0:
                turn = x1 / dx
            else:  # least squares
                turn = -(x0 * dx + z1 * dz - x1 * dx) / (2 * dx * dx + 2 * dz * dz)
            qx[i + 1, k] = (x0 + turn * dx) * (open_x[i + 1, k] > 0)
            qz[i + 1, k + 1] = (z1 + turn * dz) * (open_z[i + 1, k + 1] > 0)
            qx[i + 1, k + 1] = (x1 - turn * dx) * (open_x[i + 1, k + 1] > 0)
            qz[i, k + 1] = -turn * dz * (open_z[i, k + 1] > 0)
    return qx, qz


@njit(cache=True)
def _share_gain(volume, capacity, qx, qz, i, k, dx, dz, need):
    """What each column of the wide one at (i, k) has to gain beyond what its outer faces bring."""
    parts = need.shape[1]
    total, count, taken, share, room = 0.0, 0, 0.0, 0.0, 0.0
    for a in range(2):
        for b in range(parts):
            comes = (qx[i, k + b] if a == 0 else -qx[i + 2, k + b]) / dx
            if parts == 2:
                comes += (qz[i + a, k] if b == 0 else -qz[i + a, k + 2]) / dz
            need[a, b] = -comes
            total += comes
            count += capacity[i + a, k + b] > 0
    gains = np.zeros((2, parts))
    for step in range(2):  # alike, then in proportion to the room that is left
        for a in range(2):
            for b in range(parts):
                limit = capacity[i + a, k + b]
                if limit <= 0:
                    continue
                held = volume[i + a, k + b] + gains[a, b]
                free = max(limit - held if total > 0 else held, 0.0)
                part = min(abs(total) / count, free) if step == 0 else share * free
                gains[a, b] += part if total > 0 else -part
                if step == 0:
                    taken += part
                    room += free - part
        share = min(max(abs(total) - taken, 0.0) / room, 1.0) if room > 0 else 0.0
    need += gains


def _stages(stiffness: float) -> int:
    """Smallest number of stages whose damped Chebyshev polynomial is stable up to `stiffness`."""
    root = math.sqrt(2 * _DAMPING)
    return max(2, math.ceil(math.sqrt(stiffness * root / (2 * math.tanh(root)))) + 1)


@njit(cache=True)
def _passage(open_, low, high, flat):
    """What does not change while the bed relaxes, per face and per corner.

    open_x (nx + 1, nz), open_z (nx, nz + 1) -- open width of faces, 0 to 1
    share_x, share_z, area -- at corners (nx + 1, nz + 1): one over the number of open faces across
    x and z that meet there, and the share of a corner's area that lies in the vessel
    """
    nx, nz = open_.shape
    open_x, open_z = np.zeros((nx + 1, nz)), np.zeros((nx, nz + 1))
    for i in range(1, nx):
        for k in range(nz):
            if min(high[i - 1, k], high[i, k]) > max(low[i - 1, k], low[i, k]):
                open_x[i, k] = min(open_[i - 1, k], open_[i, k])
    for i in range(nx):
        for k in range(1, nz):
            if not flat and min(high[i, k - 1], high[i, k]) > max(low[i, k - 1], low[i, k]):
                open_z[i, k] = min(open_[i, k - 1], open_[i, k])
    shape = (nx + 1, nz + 1)
    share_x, share_z, area = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for i in range(nx + 1):
        for k in range(nz + 1):
            a, b = 0, 0
            for e in range(2):
                if 0 <= k - 1 + e < nz and open_x[i, k - 1 + e] > 0:
                    a += 1
                if 0 <= i - 1 + e < nx and open_z[i - 1 + e, k] > 0:
                    b += 1
            share_x[i, k] = 1.0 / a if a else 0.0
            share_z[i, k] = 1.0 / b if b else 0.0
            area[i, k] = 0.5 * max(a, b)
    return open_x, open_z, share_x, share_z, area


@njit(cache=True, error_model="numpy", fastmath=True)
def _chebyshev(volume, ground, law, dt, stages):
    """Time integrals of the fluxes over dt."""
    open_, low, room, _, dx, dz, flat, _ = ground
    nx, nz = volume.shape
    w0 = 1.0 + _DAMPING / stages**2
    t0, t1, d0, d1 = 1.0, w0, 0.0, 1.0  # T and T' at w0, of two successive degrees
    values = np.empty(stages + 1)
    values[0], values[1] = 1.0, w0
    for j in range(2, stages + 1):
        t0, t1, d0, d1 = t1, 2 * w0 * t1 - t0, d1, 2 * t1 + 2 * w0 * d1 - d0
        values[j] = t1
    w1 = t1 / d1
    sx, sz = (nx + 1, nz), (nx, nz + 1)
    x0, x1, x2 = np.zeros(sx), np.zeros(sx), np.zeros(sx)
    z0, z1, z2 = np.zeros(sz), np.zeros(sz), np.zeros(sz)
    head, body = np.zeros((nx, nz)), np.zeros((nx, nz))
    per_open = np.zeros((nx, nz))
    for i in range(nx):
        for k in range(nz):
            if open_[i, k] > 0:
                per_open[i, k] = 1.0 / open_[i, k]
    work = (np.zeros(sx), np.zeros(sz), np.zeros(sx), np.zeros(sz), np.zeros((nx + 1, nz + 1)))
    fx, fz = np.zeros(sx), np.zeros(sz)
    for j in range(1, stages + 1):
        # the state that the sums x1, z1 stand for
        for i in range(nx):
            for k in range(nz):
                v = volume[i, k] - (x1[i + 1, k] - x1[i, k]) / dx - (z1[i, k + 1] - z1[i, k]) / dz
                b = min(max(v * per_open[i, k], 0.0), room[i, k])
                body[i, k] = b
                head[i, k] = low[i, k] + b
        _flux(head, body, ground, law, work, fx, fz)
        if j == 1:
            one, two, step = 1.0, 0.0, w1 / w0 * dt
        else:
            one = 2 * w0 * values[j - 1] / values[j]
            two = -values[j - 2] / values[j]
            step = 2 * w1 * values[j - 1] / values[j] * dt
        for i in range(1, nx):
            for k in range(nz):
                x2[i, k] = one * x1[i, k] + two * x0[i, k] + step * fx[i, k]
        x0, x1, x2 = x1, x2, x0
        if not flat:
            for i in range(nx):
                for k in range(1, nz):
                    z2[i, k] = one * z1[i, k] + two * z0[i, k] + step * fz[i, k]
            z0, z1, z2 = z1, z2, z0
    return x1, z1


@njit(cache=True, error_model="numpy", fastmath=True)
def _flux(head, body, ground, law, work, fx, fz):
    """Fluxes through column faces.

    At a corner the squared slope is the mean over the faces that meet there, each weighted by how
    freely material follows it (0 from an empty column, into a full one, through a wall).
    """
    friction, conductance, smooth, greatest = law
    _, _, room, passage, dx, dz, flat, film = ground
    open_x, open_z, share_x, share_z, area = passage
    gx, gz, square_x, square_z, rate = work
    nx, nz = head.shape
    for i in range(1, nx):
        for k in range(nz):
            drop = (head[i - 1, k] - head[i, k]) / dx
            down = drop > 0
            gives = body[i - 1, k] if down else body[i, k]
            takes = room[i, k] - body[i, k] if down else room[i - 1, k] - body[i - 1, k]
            free = open_x[i, k] * min(gives / film, 1.0) * min(takes / film, 1.0)
            gx[i, k] = free * drop
            square_x[i, k] = free * drop * drop
    if not flat:
        for i in range(nx):
            for k in range(1, nz):
                drop = (head[i, k - 1] - head[i, k]) / dz
                down = drop > 0
                gives = body[i, k - 1] if down else body[i, k]
                takes = room[i, k] - body[i, k] if down else room[i, k - 1] - body[i, k - 1]
                free = open_z[i, k] * min(gives / film, 1.0) * min(takes / film, 1.0)
                gz[i, k] = free * drop
                square_z[i, k] = free * drop * drop
    for i in range(nx + 1):
        for k in range(nz + 1):
            a = (square_x[i, k - 1] if k > 0 else 0.0) + (square_x[i, k] if k < nz else 0.0)
            b = (square_z[i - 1, k] if i > 0 else 0.0) + (square_z[i, k] if i < nx else 0.0)
            slope = np.sqrt(share_x[i, k] * a + share_z[i, k] * b)
            excess = max(slope - friction, 0.0)
            ramp = min(excess, smooth)
            q = conductance * (0.5 * ramp * ramp / smooth + excess - ramp)
            rate[i, k] = area[i, k] * min(q, greatest) / max(slope, friction)
    for i in range(1, nx):
        for k in range(nz):
            here = share_x[i, k] * rate[i, k] + share_x[i, k + 1] * rate[i, k + 1]
            fx[i, k] = gx[i, k] * here
    if not flat:
        for i in range(nx):
            for k in range(1, nz):
                here = share_z[i, k] * rate[i, k] + share_z[i + 1, k] * rate[i + 1, k]
                fz[i, k] = gz[i, k] * here


@njit(cache=True)
def _limited(volume, capacity, qx, qz, dx, dz):
    """The volumes that integrated fluxes lead to; fluxes are cut where they would pass a bound."""
    nx, nz = volume.shape
    after = np.empty((nx, nz))
    for _ in range(_SWEEPS):
        for i in range(nx):
            for k in range(nz):
                after[i, k] = (
                    volume[i, k] - (qx[i + 1, k] - qx[i, k]) / dx - (qz[i, k + 1] - qz[i, k]) / dz
                )
        worst = 0.0
        for i in range(nx):
            for k in range(nz):
                over = max(-after[i, k], after[i, k] - capacity[i, k])
                if over <= 1e-13 * dx:
                    continue
                worst = max(worst, over)
                # the faces through which too much went, out or in
                sign = 1.0 if after[i, k] < 0 else -1.0
                a = max(-sign * qx[i, k], 0.0)
                b = max(sign * qx[i + 1, k], 0.0)
                c = max(-sign * qz[i, k], 0.0)
                d = max(sign * qz[i, k + 1], 0.0)
                total = (a + b) / dx + (c + d) / dz
                if total <= 0:
                    continue
                cut = min(1.0, over / total)
                qx[i, k] += sign * cut * a
                qx[i + 1, k] -= sign * cut * b
                qz[i, k] += sign * cut * c
                qz[i, k + 1] -= sign * cut * d
        if worst == 0.0:
            break
    return after
