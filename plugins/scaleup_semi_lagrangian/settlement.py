"""Fluxes between neighbours that bring cells from the volume laid down in them to their fill.

Sub-cells of finite size fill the cells to some parts in a hundred. The rest R flows between
neighbours, through the faces that are open: psi = difference of a potential, div psi = R, by
conjugate gradients (preconditioned by the diagonal and the solution on blocks of cells, so that
their number does not grow with the grid), and what these leave along a spanning tree, to round-off.
Content goes with it at the concentration of the cell that it leaves,

    c_i (v_i + inflow_i) = m_i + sum over inflowing faces of psi c_upstream,

swept in the order of the potential: c_i is a mean of values in [0, 1] whatever psi is, and what one
cell loses another gets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from scaleup.contract import BoolArray, FloatArray, IntArray

_TOLERANCE = 1e-4  # of the residual, in the mean; the tree takes the rest
_BLOCKS = 6000  # at most: one more solve of a sparse system of that size per iteration
_GROUND = 1e-8  # conductance from each block, which makes the blocks' system regular
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


def settle(
    below: IntArray, above: IntArray, coordinates: IntArray, laid: FloatArray, fill: FloatArray
) -> tuple[Settlement, IntArray]:
    """From the laid volumes to the fills, both (m,) and fractions of a cell's volume.

    coordinates -- (m, dimension) whole numbers of the cells along the axes
    Also returns which connected part of the moving cells each is in, (m,), from 0.
    """
    excess = laid - fill
    potential = _potential(below, above, coordinates, excess)
    flux = _fluxes(below, potential)
    part = _along_tree(below, above, excess, flux)
    return Settlement(flux, np.argsort(-potential, kind="stable").astype(np.int32)), part


def _potential(
    below: IntArray, above: IntArray, coordinates: IntArray, excess: FloatArray
) -> FloatArray:
    """Solve sum over neighbours of (p_i - p_neighbour) = excess_i."""
    block, blocks = _blocks(below, coordinates)
    coarse = splu(blocks, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    degree = ((below >= 0).sum(axis=0) + (above >= 0).sum(axis=0)).astype(float)
    count = blocks.shape[0]

    def conditioned(residual: FloatArray) -> FloatArray:
        return _conditioned(residual, degree, block, coarse.solve(_sums(residual, block, count)))

    x, r = np.zeros(len(excess)), np.where(degree > 0.0, excess, 0.0)
    goal = _TOLERANCE**2 * (r @ r)
    z = conditioned(r)
    p, rz, rr = z.copy(), r @ z, r @ r
    for _ in range(_MOST):
        if rr <= goal or rz == 0.0:
            break
        q, pq = _differences(below, above, degree, p)
        rr = _advance(x, r, p, q, rz / pq)
        z = conditioned(r)
        before, rz = rz, r @ z
        p *= rz / before
        p += z
    return x


def _blocks(below: IntArray, coordinates: IntArray) -> tuple[IntArray, Any]:
    """The block of each cell (m,), and the matrix of the above for the sums over blocks."""
    local = coordinates - coordinates.min(axis=0)
    edge = 4
    while True:
        shape = tuple(local.max(axis=0) // edge + 1)
        flat = np.ravel_multi_index(tuple((local // edge).T), shape)
        used = np.zeros(int(np.prod(shape)), dtype=bool)
        used[flat] = True
        count = int(used.sum())
        if count <= _BLOCKS:
            break
        edge += 1
    block = (np.cumsum(used) - 1).astype(np.int32)[flat]
    upper = np.nonzero(below >= 0)
    first, second = block[upper[1]], block[below[upper]]
    apart = first != second
    faces = csc_matrix((np.ones(apart.sum()), (first[apart], second[apart])), shape=(count, count))
    faces = faces + faces.T
    return block, (diags(np.asarray(faces.sum(axis=0))[0] + _GROUND) - faces).tocsc()


@numba.njit(cache=True)
def _sums(values: FloatArray, block: IntArray, count: int) -> FloatArray:
    sums = np.zeros(count)
    for i in range(len(values)):
        sums[block[i]] += values[i]
    return sums


@numba.njit(cache=True)
def _conditioned(
    r: FloatArray, degree: FloatArray, block: IntArray, of_blocks: FloatArray
) -> FloatArray:
    z = np.empty(len(r))
    for i in range(len(r)):
        z[i] = of_blocks[block[i]] + r[i] / max(degree[i], 1.0)
    return z


@numba.njit(cache=True)
def _advance(x: FloatArray, r: FloatArray, p: FloatArray, q: FloatArray, step: float) -> float:
    """A step along p: x and r are changed; returns r.r."""
    rr = 0.0
    for i in range(len(x)):
        x[i] += step * p[i]
        r[i] -= step * q[i]
        rr += r[i] * r[i]
    return rr


@numba.njit(cache=True)
def _differences(
    below: IntArray, above: IntArray, degree: FloatArray, p: FloatArray
) -> tuple[FloatArray, float]:
    """Sum over neighbours of (p_i - p_neighbour), and its product with p."""
    dimension, m = below.shape
    q, pq = np.empty(m), 0.0
    for i in range(m):
        total = degree[i] * p[i]
        for axis in range(dimension):
            j, k = below[axis, i], above[axis, i]
            if j >= 0:
                total -= p[j]
            if k >= 0:
                total -= p[k]
        q[i] = total
        pq += total * p[i]
    return q, pq


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
def _along_tree(below: IntArray, above: IntArray, excess: FloatArray, flux: FloatArray) -> IntArray:
    """Add what is missing along a spanning tree of each connected part, from its leaves inwards.

    Returns which part each cell is in, (m,).
    """
    dimension, m = below.shape
    left = excess.copy()
    for axis in range(dimension):
        for i in range(m):
            j = below[axis, i]
            if j >= 0:
                left[j] -= flux[axis, i]
                left[i] += flux[axis, i]
    parent = np.full(m, -1, dtype=np.int32)
    part = np.full(m, -1, dtype=np.int32)
    line = np.empty(m, dtype=np.int32)
    end, parts = 0, 0
    for root in range(m):
        if part[root] >= 0:
            continue
        part[root] = parts
        parts += 1
        line[end] = root
        now, end = end, end + 1
        while now < end:
            i = line[now]
            now += 1
            for axis in range(dimension):
                for side in range(2):
                    j = below[axis, i] if side == 0 else above[axis, i]
                    if j >= 0 and part[j] < 0:
                        part[j] = part[i]
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
    return part


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

    A cell without material, and without inflow, keeps its value. After the first sweep only those
    are swept again that something upstream has changed for.
    """
    dimension, m = below.shape
    waits = np.empty(m, dtype=np.bool_)
    for q in range(c.shape[0]):
        for i in range(m):
            if laid[i] > 0.0:
                c[q, i] = content[q, i] / laid[i]
        waits[:] = True
        for _ in range(_SWEEPS):
            settled = True
            for n in range(m):
                i = order[n]
                if not waits[i]:
                    continue
                waits[i] = False
                held, volume, leaves = content[q, i], laid[i], False
                for axis in range(dimension):
                    j, k = below[axis, i], above[axis, i]
                    if j >= 0:
                        through = flux[axis, i]
                        if through > 0.0:
                            held += through * c[q, j]
                            volume += through
                        else:
                            leaves |= through < 0.0
                    if k >= 0:
                        through = flux[axis, k]
                        if through < 0.0:
                            held -= through * c[q, k]
                            volume -= through
                        else:
                            leaves |= through > 0.0
                if volume <= 0.0:
                    continue
                value = held / volume
                changed = abs(value - c[q, i]) > _SETTLED
                c[q, i] = value
                if not (changed and leaves):
                    continue
                for axis in range(dimension):
                    j, k = below[axis, i], above[axis, i]
                    if j >= 0 and flux[axis, i] < 0.0:
                        waits[j] = True
                        settled = False
                    if k >= 0 and flux[axis, k] > 0.0:
                        waits[k] = True
                        settled = False
            if settled:
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
