"""The nine-point stencil: what a step is once its weights are known."""

from __future__ import annotations

import numba
import numpy as np

from scaleup.api import FloatArray, IntArray

# the neighbours, in the order of the weights' first axis
SW, S, SE, W, E, NW, N, NE = range(8)


@numba.njit(cache=True)
def step(c: FloatArray, new: FloatArray, weights: FloatArray, runs: IntArray, width: int) -> None:
    """One step, new = c + sum_k weights_k (c_k - c), on flattened arrays in runs [start, stop).

    weights -- (8, cells) in the order SW ... NE; width -- length of a row. A uniform c is
    kept exactly whatever the weights are.
    """
    for r in range(runs.shape[0]):
        # views that start at 0: no index can be negative, so the inner loop is vectorised
        a, b = runs[r, 0], runs[r, 1]
        here, out = c[a:b], new[a:b]
        west, east = c[a - 1 : b - 1], c[a + 1 : b + 1]
        south, north = c[a - width : b - width], c[a + width : b + width]
        south_west, south_east = c[a - width - 1 : b - width - 1], c[a - width + 1 : b - width + 1]
        north_west, north_east = c[a + width - 1 : b + width - 1], c[a + width + 1 : b + width + 1]
        w0, w1, w2, w3 = weights[0, a:b], weights[1, a:b], weights[2, a:b], weights[3, a:b]
        w4, w5, w6, w7 = weights[4, a:b], weights[5, a:b], weights[6, a:b], weights[7, a:b]
        for k in range(b - a):
            p = here[k]
            out[k] = p + (
                w3[k] * (west[k] - p)
                + w4[k] * (east[k] - p)
                + w1[k] * (south[k] - p)
                + w6[k] * (north[k] - p)
                + w0[k] * (south_west[k] - p)
                + w2[k] * (south_east[k] - p)
                + w5[k] * (north_west[k] - p)
                + w7[k] * (north_east[k] - p)
            )


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
            low, high = min(low, value), max(high, value)
            if value < 0.0:
                moved -= value * fill[k]
                c[k] = 0.0
            elif value > 1.0:
                moved += (value - 1.0) * fill[k]
                c[k] = 1.0
    return low, high, moved


@numba.njit(cache=True)
def bounds(c: FloatArray, runs: IntArray) -> tuple[float, float]:
    """(minimum, maximum) over the runs; infinite if any value is not a number."""
    low, high = np.inf, -np.inf
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            value = c[k]
            if value != value:
                return -np.inf, np.inf
            low, high = min(low, value), max(high, value)
    return low, high


def runs_of(positions: IntArray) -> IntArray:
    """Contiguous runs [start, stop) of ascending flat positions, shape (m, 2)."""
    if len(positions) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    breaks = np.flatnonzero(np.diff(positions) != 1)
    starts = positions[np.concatenate([[0], breaks + 1])]
    stops = positions[np.concatenate([breaks, [len(positions) - 1]])] + 1
    return np.stack([starts, stops], axis=1)
