"""Fluxes between neighbours that bring cells from the volume laid down in them to their fill.

Sub-cells of finite size fill the cells to a few parts in a thousand. The rest R flows between
neighbours, through the faces that are open: psi = difference of a potential, div psi = R, by
conjugate gradients, and what these leave along a spanning tree, to round-off. Content goes with it
at the concentration of the cell that it leaves,

    c_i (v_i + inflow_i) = m_i + sum over inflowing faces of psi c_upstream,

swept in the order of the potential: c_i is a mean of values in [0, 1] whatever psi is, and what one
cell loses another gets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.api import BoolArray, FloatArray, IntArray

_TOLERANCE = 1e-7  # of the residual, in the mean; the tree takes the rest
_MOST = 500  # iterations
_SETTLED = 1e-15  # change of a concentration in a sweep
_SWEEPS = 50


@dataclass(frozen=True)
class Settlement:
    """Fluxes over the volume of a cell, through the lower faces (dimension, m), and their order.

    order -- the cells from the highest potential down, (m,)
    """

    flux: FloatArray
    order: IntArray


def settle(below: IntArray, above: IntArray, laid: FloatArray, fill: FloatArray) -> Settlement:
    """From the laid volumes to the fills, both (m,) and fractions of a cell's volume."""
    excess = laid - fill
    potential = _potential(below, above, excess)
    flux = _fluxes(below, potential)
    _along_tree(below, above, excess, flux)
    return Settlement(flux, np.argsort(-potential, kind="stable").astype(np.int32))


@numba.njit(cache=True)
def _potential(below: IntArray, above: IntArray, excess: FloatArray) -> FloatArray:
    """Solve sum over neighbours of (p_i - p_neighbour) = excess_i; Jacobi-preconditioned."""
    dimension, m = below.shape
    degree = np.zeros(m)
    for axis in range(dimension):
        for i in range(m):
            degree[i] += (below[axis, i] >= 0) + (above[axis, i] >= 0)
    x, r = np.zeros(m), excess.copy()
    z = np.where(degree > 0, r / np.maximum(degree, 1.0), 0.0)
    p, q = z.copy(), np.empty(m)
    rz = (r * z).sum()
    goal = _TOLERANCE**2 * rz
    for _ in range(_MOST):
        if rz <= goal or rz == 0.0:
            break
        for i in range(m):
            total = degree[i] * p[i]
            for axis in range(dimension):
                j, k = below[axis, i], above[axis, i]
                if j >= 0:
                    total -= p[j]
                if k >= 0:
                    total -= p[k]
            q[i] = total
        step = rz / (p * q).sum()
        x += step * p
        r -= step * q
        before, rz = rz, 0.0
        for i in range(m):
            z[i] = r[i] / degree[i] if degree[i] > 0 else 0.0
            rz += r[i] * z[i]
        p *= rz / before
        p += z
    return x


@numba.njit(cache=True)
def _fluxes(below: IntArray, potential: FloatArray) -> FloatArray:
    flux = np.zeros(below.shape)
    for axis in range(below.shape[0]):
        for i in range(below.shape[1]):
            j = below[axis, i]
            if j >= 0:
                flux[axis, i] = potential[j] - potential[i]
    return flux


@numba.njit(cache=True)
def _along_tree(below: IntArray, above: IntArray, excess: FloatArray, flux: FloatArray) -> None:
    """Add what is missing along a spanning tree of each connected part, from its leaves inwards."""
    dimension, m = below.shape
    left = excess.copy()
    for axis in range(dimension):
        for i in range(m):
            j = below[axis, i]
            if j >= 0:
                left[j] -= flux[axis, i]
                left[i] += flux[axis, i]
    parent = np.full(m, -1, dtype=np.int32)
    seen = np.zeros(m, dtype=np.bool_)
    line = np.empty(m, dtype=np.int32)
    end = 0
    for root in range(m):
        if seen[root]:
            continue
        seen[root] = True
        line[end] = root
        now, end = end, end + 1
        while now < end:
            i = line[now]
            now += 1
            for axis in range(dimension):
                for side in range(2):
                    j = below[axis, i] if side == 0 else above[axis, i]
                    if j >= 0 and not seen[j]:
                        seen[j] = True
                        parent[j] = i
                        line[end] = j
                        end += 1
    for n in range(m - 1, -1, -1):
        i = line[n]
        j = parent[i]
        if j < 0:
            continue
        for axis in range(dimension):
            if below[axis, i] == j:
                flux[axis, i] -= left[i]
                break
            if above[axis, i] == j:
                flux[axis, j] += left[i]
                break
        left[j] += left[i]


@numba.njit(cache=True)
def carry(
    c: FloatArray,
    content: FloatArray,
    laid: FloatArray,
    below: IntArray,
    above: IntArray,
    flux: FloatArray,
    order: IntArray,
) -> None:
    """Concentrations c (components, m) from the laid contents and volumes, as stated above.

    A cell without material, and without inflow, keeps its value.
    """
    dimension, m = below.shape
    for q in range(c.shape[0]):
        for i in range(m):
            if laid[i] > 0.0:
                c[q, i] = content[q, i] / laid[i]
        for _ in range(_SWEEPS):
            change = 0.0
            for n in range(m):
                i = order[n]
                held, volume = content[q, i], laid[i]
                for axis in range(dimension):
                    j, k = below[axis, i], above[axis, i]
                    if j >= 0 and flux[axis, i] > 0.0:
                        held += flux[axis, i] * c[q, j]
                        volume += flux[axis, i]
                    if k >= 0 and flux[axis, k] < 0.0:
                        held -= flux[axis, k] * c[q, k]
                        volume -= flux[axis, k]
                if volume > 0.0:
                    value = held / volume
                    change = max(change, abs(value - c[q, i]))
                    c[q, i] = value
            if change <= _SETTLED:
                break


@numba.njit(cache=True)
def bounds(c: FloatArray, holds: BoolArray) -> tuple[float, float]:
    """Least and greatest of all components, the last included, in the flagged cells."""
    low, high = np.inf, -np.inf
    for i in range(c.shape[1]):
        if not holds[i]:
            continue
        rest = 1.0
        for q in range(c.shape[0]):
            value = c[q, i]
            rest -= value
            low, high = min(low, value), max(high, value)
        low, high = min(low, rest), max(high, rest)
    return low, high
