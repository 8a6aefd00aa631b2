"""The bed's surface under gravity: a flux wherever it is steeper than the friction allows.

In lab columns, h the height of the bed's top, v its volume per area, q the depth-integrated flux
relative to rigid rotation (Prigozhin's sandpile with a steep law in place of the inequality):

    dv/dt + div q = what rotation brings,    q = -K p(|grad h| - mu) grad h/|grad h|,

p(t) = t for t > 0 (smooth at 0, bounded at the top), K = omega R^2/(2 eps mu), so that the slope
exceeds mu by the share eps at the flux omega R^2/2. No flux leaves an empty column, enters a full
one, or passes a closed wall. The gradient lives on column corners, with the mean square of the
differences that meet there, so that no direction is preferred.

A step is rotation (`rotation`), then relaxation over its duration by one Runge-Kutta-Chebyshev step
of first order, damped: explicit, with a number of stages that grows as the square root of the
stiffness. It is written for the flux, of which every stage is a sum, so that volume is kept
whatever the accuracy; what would empty or overfill a column is cut from the flux at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from scaleup.api import FloatArray
from scaleup_surface_layer.lab_columns import Columns
from scaleup_surface_layer.turned_vessel import ColumnShape

_DAMPING = 30.0  # the stiffest modes shrink by 1/cosh(sqrt(2 x 5)) = 0.085 in a step
_FILM = 0.1  # of a column's width: a thinner film flows in proportion to its depth
_FASTEST = 4.0  # of omega R^2/2: greatest flux through a face


@dataclass(frozen=True)
class SlopeLaw:
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
    return SlopeLaw(friction, scale / (excess * friction), 0.5 * excess * friction, _FASTEST * scale)


def relax(
    columns: Columns, shape: ColumnShape, volume: FloatArray, law: SlopeLaw, duration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Volumes after `duration` (s), and the mean fluxes (nx + 1, nz) and (nx, nz + 1), m^2/s."""
    stiffness = 4.0 * law.conductance / columns.dx**2
    if columns.nz > 1:
        stiffness += 4.0 * law.conductance / columns.dz**2
    stages = _stages(stiffness * duration)
    flat = columns.nz == 1
    qx, qz = _chebyshev(
        volume,
        shape.open,
        shape.low,
        shape.high,
        columns.dx,
        columns.dz,
        flat,
        (law.friction, law.conductance, law.smooth, law.greatest),
        _FILM * min(columns.dx, columns.dx if flat else columns.dz),
        duration,
        stages,
    )
    after = _limited(volume, shape.capacity, qx, qz, columns.dx, columns.dz)
    return after, qx / duration, qz / duration


def _stages(stiffness: float) -> int:
    """Smallest number s >= 2 whose damped Chebyshev polynomial is stable up to `stiffness`."""
    root = math.sqrt(2 * _DAMPING)
    return max(2, math.ceil(math.sqrt(stiffness * root / (2 * math.tanh(root)))) + 1)


@njit(cache=True)
def _chebyshev(volume, open_, low, high, dx, dz, flat, law, film, dt, stages):
    """Time integrals of the fluxes over dt."""
    nx, nz = volume.shape
    # coefficients: T_j and T'_j at w0
    w0 = 1.0 + 30.0 / stages**2
    t0, t1, d0, d1 = 1.0, w0, 0.0, 1.0
    values = np.empty(stages + 1)
    values[0], values[1] = 1.0, w0
    for j in range(2, stages + 1):
        t0, t1, d0, d1 = t1, 2 * w0 * t1 - t0, d1, 2 * t1 + 2 * w0 * d1 - d0
        values[j] = t1
    w1 = t1 / d1
    sx, sz = (nx + 1, nz), (nx, nz + 1)
    x0, x1, x2 = np.zeros(sx), np.zeros(sx), np.zeros(sx)
    z0, z1, z2 = np.zeros(sz), np.zeros(sz), np.zeros(sz)
    fx, fz = np.zeros(sx), np.zeros(sz)
    head, body = np.empty((nx, nz)), np.empty((nx, nz))
    for j in range(1, stages + 1):
        # the state that the sums x1, z1 stand for
        for i in range(nx):
            for k in range(nz):
                a = open_[i, k]
                if a <= 0:
                    continue
                v = volume[i, k] - (x1[i + 1, k] - x1[i, k]) / dx
                if not flat:
                    v -= (z1[i, k + 1] - z1[i, k]) / dz
                b = min(max(v / a, 0.0), high[i, k] - low[i, k])
                body[i, k], head[i, k] = b, low[i, k] + b
        _flux(head, body, open_, low, high, dx, dz, flat, law, film, fx, fz)
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


@njit(cache=True)
def _passage(a, b, head, body, open_, low, high, film, i, k, m, n):
    """Drop (m) from one column to a neighbour and how freely material may follow it, 0 to 1."""
    drop = head[i, k] - head[m, n]
    if drop == 0.0:
        return 0.0, 0.0
    if drop < 0:
        i, k, m, n = m, n, i, k
    gives = min(body[i, k] / film, 1.0)
    takes = min((high[m, n] - low[m, n] - body[m, n]) / film, 1.0)
    return drop, min(a, b) * gives * max(takes, 0.0)


@njit(cache=True)
def _flux(head, body, open_, low, high, dx, dz, flat, law, film, fx, fz):
    """Fluxes through column faces, from the gradient at each corner of the columns."""
    friction, conductance, smooth, greatest = law
    nx, nz = head.shape
    fx[:] = 0.0
    fz[:] = 0.0
    g = np.zeros(4)  # slopes of the faces around a corner: two across x, two across z
    m = np.zeros(4)  # how freely they pass
    for i in range(nx + 1):
        for k in range(nz + 1):
            in_x, in_z = 0, 0
            square = 0.0
            for e in range(4):
                g[e], m[e] = 0.0, 0.0
                if e < 2:
                    a, c = i - 1, k - 1 + e
                    b, d = i, c
                else:
                    a, c = i - 1 + (e - 2), k - 1
                    b, d = a, k
                if a < 0 or c < 0 or b >= nx or d >= nz:
                    continue
                if open_[a, c] <= 0 or open_[b, d] <= 0:
                    continue
                if min(high[a, c], high[b, d]) <= max(low[a, c], low[b, d]):
                    continue
                drop, free = _passage(
                    open_[a, c], open_[b, d], head, body, open_, low, high, film, a, c, b, d
                )
                if e < 2:
                    in_x += 1
                    g[e] = drop / dx
                else:
                    in_z += 1
                    g[e] = drop / dz
                m[e] = free
            if in_x + in_z == 0:
                continue
            for e in range(4):
                if m[e] > 0:
                    square += m[e] * g[e] * g[e] / (in_x if e < 2 else in_z)
            slope = np.sqrt(square)
            excess = slope - friction
            if excess <= 0:
                continue
            if excess < smooth:
                rate = conductance * excess * excess / (2 * smooth)
            else:
                rate = conductance * (excess - 0.5 * smooth)
            rate = min(rate, greatest) / slope * 0.5 * max(in_x, in_z)
            for e in range(4):
                if m[e] <= 0:
                    continue
                q = rate * m[e] * g[e] / (in_x if e < 2 else in_z)
                if e < 2:
                    fx[i, k - 1 + e] += q
                else:
                    fz[i - 1 + (e - 2), k] += q


@njit(cache=True)
def _limited(volume, capacity, qx, qz, dx, dz):
    """The volumes that integrated fluxes lead to; fluxes are cut where they would pass a bound."""
    nx, nz = volume.shape
    after = np.empty((nx, nz))
    for sweep in range(200):
        for i in range(nx):
            for k in range(nz):
                after[i, k] = (
                    volume[i, k]
                    - (qx[i + 1, k] - qx[i, k]) / dx
                    - (qz[i, k + 1] - qz[i, k]) / dz
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
