"""The stencil of a step: which neighbours it has, and what a step is once its weights are known.

A step is new = c + sum_k weights_k (c_k - c) over the 8 neighbours of a cell in 2-D, and in 3-D
over the 18 that share a face or an edge with it. A uniform c is kept exactly whatever the weights.
"""

from __future__ import annotations

from itertools import product

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray

Offset = tuple[int, ...]  # in cells along x, y (, z)
_EMPTY = 1e-14  # fill fraction at which a group counts as empty


def neighbours(dimension: int) -> list[Offset]:
    """Offsets of the neighbours, in the order of the weights' first axis."""
    offsets = [o[::-1] for o in product((-1, 0, 1), repeat=dimension)]
    return [o for o in offsets if 1 <= sum(abs(i) for i in o) <= 2]


@numba.njit(cache=True)
def step(
    c: FloatArray, new: FloatArray, weights: FloatArray, runs: IntArray, strides: IntArray
) -> None:
    """One step of the cells in the runs (m, 2) of flattened local arrays.

    weights -- (8 or 18, cells); strides -- offset of each neighbour, in the same order
    """
    if len(strides) == 8:
        _step_8(c, new, weights, runs, strides)
    else:
        _step_18(c, new, weights, runs, strides)


# Views made once that start m before a cell, and unsigned indices: no index can be negative, so
# the inner loops are vectorised, and a short run costs little.


@numba.njit
def _step_8(
    c: FloatArray, new: FloatArray, weights: FloatArray, runs: IntArray, s: IntArray
) -> None:
    m = -s.min()
    here, out = c[m:], new[m:]
    c0, c1, c2 = c[m + s[0] :], c[m + s[1] :], c[m + s[2] :]
    c3, c4, c5 = c[m + s[3] :], c[m + s[4] :], c[m + s[5] :]
    c6, c7 = c[m + s[6] :], c[m + s[7] :]
    w0, w1, w2 = weights[0, m:], weights[1, m:], weights[2, m:]
    w3, w4, w5 = weights[3, m:], weights[4, m:], weights[5, m:]
    w6, w7 = weights[6, m:], weights[7, m:]
    for r in range(runs.shape[0]):
        a, b = numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)
        for k in range(a, b):
            p = here[k]
            out[k] = p + (
                w0[k] * (c0[k] - p)
                + w1[k] * (c1[k] - p)
                + w2[k] * (c2[k] - p)
                + w3[k] * (c3[k] - p)
                + w4[k] * (c4[k] - p)
                + w5[k] * (c5[k] - p)
                + w6[k] * (c6[k] - p)
                + w7[k] * (c7[k] - p)
            )


@numba.njit
def _step_18(
    c: FloatArray, new: FloatArray, weights: FloatArray, runs: IntArray, s: IntArray
) -> None:
    m = -s.min()
    here, out = c[m:], new[m:]
    c0, c1, c2 = c[m + s[0] :], c[m + s[1] :], c[m + s[2] :]
    c3, c4, c5 = c[m + s[3] :], c[m + s[4] :], c[m + s[5] :]
    c6, c7, c8 = c[m + s[6] :], c[m + s[7] :], c[m + s[8] :]
    c9, c10, c11 = c[m + s[9] :], c[m + s[10] :], c[m + s[11] :]
    c12, c13, c14 = c[m + s[12] :], c[m + s[13] :], c[m + s[14] :]
    c15, c16, c17 = c[m + s[15] :], c[m + s[16] :], c[m + s[17] :]
    w0, w1, w2 = weights[0, m:], weights[1, m:], weights[2, m:]
    w3, w4, w5 = weights[3, m:], weights[4, m:], weights[5, m:]
    w6, w7, w8 = weights[6, m:], weights[7, m:], weights[8, m:]
    w9, w10, w11 = weights[9, m:], weights[10, m:], weights[11, m:]
    w12, w13, w14 = weights[12, m:], weights[13, m:], weights[14, m:]
    w15, w16, w17 = weights[15, m:], weights[16, m:], weights[17, m:]
    for r in range(runs.shape[0]):
        a, b = numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)
        for k in range(a, b):
            p = here[k]
            out[k] = p + (
                w0[k] * (c0[k] - p)
                + w1[k] * (c1[k] - p)
                + w2[k] * (c2[k] - p)
                + w3[k] * (c3[k] - p)
                + w4[k] * (c4[k] - p)
                + w5[k] * (c5[k] - p)
            )
        # further sweeps over the run, which is in the cache: fewer streams at a time
        for k in range(a, b):
            p = here[k]
            out[k] = out[k] + (
                w6[k] * (c6[k] - p)
                + w7[k] * (c7[k] - p)
                + w8[k] * (c8[k] - p)
                + w9[k] * (c9[k] - p)
                + w10[k] * (c10[k] - p)
                + w11[k] * (c11[k] - p)
            )
        for k in range(a, b):
            p = here[k]
            out[k] = out[k] + (
                w12[k] * (c12[k] - p)
                + w13[k] * (c13[k] - p)
                + w14[k] * (c14[k] - p)
                + w15[k] * (c15[k] - p)
                + w16[k] * (c16[k] - p)
                + w17[k] * (c17[k] - p)
            )


@numba.njit(cache=True)
def step_groups(
    c: FloatArray,
    new: FloatArray,
    weights: FloatArray,
    strides: IntArray,
    members: IntArray,
    first: IntArray,
    usable: BoolArray,
    after: FloatArray,
) -> None:
    """The same for merged cells, whose weights are shares of a whole cell; `after`: their fill."""
    for g in range(len(first) - 1):
        if not usable[g] or after[g] <= _EMPTY:
            continue
        value, gain = c[members[first[g]]], 0.0
        for i in range(first[g], first[g + 1]):
            k = members[i]
            for n in range(len(strides)):
                gain += weights[n, k] * (c[k + strides[n]] - value)
        value += gain / after[g]
        for i in range(first[g], first[g + 1]):
            new[members[i]] = value


@numba.njit(cache=True)
def copy_inward(c: FloatArray, targets: IntArray, sources: IntArray) -> None:
    """c[targets] = c[sources]: the boundary takes the value one node inward."""
    for i in range(targets.shape[0]):
        c[targets[i]] = c[sources[i]]


@numba.njit(cache=True)
def clip(c: FloatArray, fill: FloatArray, runs: IntArray) -> tuple[float, float, float]:
    """Clip to [0, 1]; returns (minimum, maximum before, volume moved = sum |change| fill)."""
    low, high, moved = np.inf, -np.inf, 0.0
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            value = c[k]
            if value != value:
                return -np.inf, np.inf, moved
            low, high = min(low, value), max(high, value)
            if value < 0.0:
                moved -= value * fill[k]
                c[k] = 0.0
            elif value > 1.0:
                moved += (value - 1.0) * fill[k]
                c[k] = 1.0
    return low, high, moved
