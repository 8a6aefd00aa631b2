"""The solver of nearest fluxes on large lattices whose faces all count the same.

Conjugate gradients, preconditioned by the diagonal and the solution on blocks of cells, so that
their number does not grow with the grid; no matrix of the cells is put together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
import numpy as np
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from scaleup.flow.nearest_fluxes import Faces, Solver
from scaleup.space.grid import FloatArray, IntArray

_BLOCKS = 6000  # at most: one more solve of a sparse system of that size per iteration
_GROUND = 1e-8  # conductance from each block, which makes the blocks' system regular


def lattice_gradients(
    below: IntArray, above: IntArray, coordinates: IntArray, tolerance: float, most: int = 500
) -> Solver:
    """Conjugate gradients for faces of weight 1 between cells of a lattice.

    below, above -- the cells next to each along the axes, (dimension, m); -1 where no face is open
    coordinates  -- (m, dimension) whole numbers of the cells along the axes
    tolerance    -- residual that is left, relative to the outflow, in the mean
    """

    @contextmanager
    def prepared(faces: Faces, weight: FloatArray) -> Iterator[Callable[[FloatArray], FloatArray]]:
        block, blocks = _blocks(below, coordinates)
        coarse = splu(blocks, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        degree = ((below >= 0).sum(axis=0) + (above >= 0).sum(axis=0)).astype(float)
        count = blocks.shape[0]

        def conditioned(residual: FloatArray) -> FloatArray:
            of_blocks = coarse.solve(_sums(residual, block, count))
            return _conditioned(residual, degree, block, of_blocks)

        yield lambda outflow: _solved(below, above, degree, outflow, conditioned, tolerance, most)

    return prepared


def _solved(
    below: IntArray,
    above: IntArray,
    degree: FloatArray,
    excess: FloatArray,
    conditioned: Callable[[FloatArray], FloatArray],
    tolerance: float,
    most: int,
) -> FloatArray:
    """Solve sum over neighbours of (p_i - p_neighbour) = excess_i."""
    x, r = np.zeros(len(excess)), np.where(degree > 0.0, excess, 0.0)
    goal = tolerance**2 * (r @ r)
    z = conditioned(r)
    p, rz, rr = z.copy(), r @ z, r @ r
    for _ in range(most):
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
