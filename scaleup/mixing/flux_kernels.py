"""Loops of the conservative updates, compiled; see `flux_correction` for what they compute.

`s` holds the strides along the axes, 0 for a third that is not there. In runs the loops work on
views made once, with unsigned indices: no index can be negative, so that the inner loops are
vectorised. Groups come as (members, first) of `LocalGroups`; sums over them may need other ranks
and are the caller's.
"""

from __future__ import annotations

import numba
import numpy as np

from scaleup.space.grid import BoolArray, FloatArray, IntArray

EMPTY = 1e-14  # fill fraction at which a group counts as empty
Strides = tuple[int, int, int]


@numba.njit(inline="always")
def loss(flux: FloatArray, k: int, s: Strides) -> float:
    """What leaves cell k through its faces, div(flux)."""
    total = flux[0, k + s[0]] - flux[0, k] + flux[1, k + s[1]] - flux[1, k]
    if s[2] != 0:
        total += flux[2, k + s[2]] - flux[2, k]
    return total


@numba.njit(cache=True)
def update_regular(
    new: FloatArray, c: FloatArray, flux: FloatArray, runs: IntArray, s: Strides
) -> None:
    """New = c - div(flux) in the runs; (cells,), (cells,), (dimension, cells)."""
    x0, x1, y0, y1 = flux[0], flux[0, s[0] :], flux[1], flux[1, s[1] :]
    if s[2] == 0:
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0]), numba.uint64(runs[r, 1])):
                new[k] = c[k] - (x1[k] - x0[k] + y1[k] - y0[k])
    else:
        z0, z1 = flux[2], flux[2, s[2] :]
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0]), numba.uint64(runs[r, 1])):
                new[k] = c[k] - (x1[k] - x0[k] + y1[k] - y0[k] + z1[k] - z0[k])


@numba.njit(cache=True)
def member_losses(flux: FloatArray, members: IntArray, s: Strides) -> FloatArray:
    """div(flux) of each member of a group, for each component; (m, members)."""
    lost = np.empty((flux.shape[0], len(members)))
    for m in range(flux.shape[0]):
        for i in range(len(members)):
            lost[m, i] = loss(flux[m], members[i], s)
    return lost


@numba.njit(cache=True)
def sums_of_runs(values: FloatArray, first: IntArray) -> FloatArray:
    """Sum over each run first[g] .. first[g + 1] of the columns, from left to right."""
    total = np.zeros((values.shape[0], len(first) - 1))
    for row in range(values.shape[0]):
        for g in range(len(first) - 1):
            for i in range(first[g], first[g + 1]):
                total[row, g] += values[row, i]
    return total


@numba.njit(cache=True)
def update_groups(
    new: FloatArray,
    c: FloatArray,
    lost: FloatArray,
    before: FloatArray,
    after: FloatArray,
    members: IntArray,
    first: IntArray,
) -> float:
    """New = (before c - lost)/after, one value for a group; one that ends empty keeps its c.

    Returns the greatest content, in size, that is left in a group that ends empty.
    """
    left = 0.0
    for g in range(len(first) - 1):
        value = c[members[first[g]]]
        content = before[g] * value - lost[g]
        if after[g] > EMPTY:
            value = content / after[g]
        else:
            left = max(left, abs(content))
        for i in range(first[g], first[g + 1]):
            new[members[i]] = value
    return left


@numba.njit(cache=True)
def bounds(values: FloatArray, runs: IntArray, members: IntArray) -> tuple[float, float]:
    """Least and greatest of all components (m, cells) and of 1 - their sum; infinite for NaN."""
    low, high, broken = np.inf, -np.inf, False
    count = values.shape[0]
    for m in range(count):
        for r in range(runs.shape[0]):
            here = values[m, runs[r, 0] : runs[r, 1]]
            for k in range(len(here)):
                low, high = min(low, here[k]), max(high, here[k])
                broken |= here[k] != here[k]
        for i in members:
            low, high = min(low, values[m, i]), max(high, values[m, i])
            broken |= values[m, i] != values[m, i]
    if broken:
        return -np.inf, np.inf
    if count == 1:
        return min(low, 1.0 - high), max(high, 1.0 - low)
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            rest = 1.0 - values[:, k].sum()
            low, high = min(low, rest), max(high, rest)
    for i in members:
        rest = 1.0 - values[:, i].sum()
        low, high = min(low, rest), max(high, rest)
    return low, high


@numba.njit(cache=True)
def copy(target: FloatArray, source: FloatArray, runs: IntArray, members: IntArray) -> None:
    """Target = source where the bed moves."""
    for r in range(runs.shape[0]):
        target[runs[r, 0] : runs[r, 1]] = source[runs[r, 0] : runs[r, 1]]
    for i in members:
        target[i] = source[i]


@numba.njit(cache=True)
def subtract_low_order(
    flux: FloatArray,
    c: FloatArray,
    speed: FloatArray,
    spread: FloatArray,
    dt: float,
    runs: IntArray,
    s: Strides,
) -> None:
    """Step 2: A = F - L with L upwind, in place, for one component."""
    for axis in range(flux.shape[0]):
        m = s[axis]
        f, v, g, here, behind = flux[axis, m:], speed[axis, m:], spread[axis, m:], c[m:], c
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)):
                f[k] -= dt * (
                    max(v[k], 0.0) * behind[k]
                    + min(v[k], 0.0) * here[k]
                    - g[k] * (here[k] - behind[k])
                )


@numba.njit(cache=True)
def add_swaps(
    flux: FloatArray,
    c: FloatArray,
    drift: FloatArray,
    factor: float,
    smooth: BoolArray,
    runs: IntArray,
    s: Strides,
) -> None:
    """Add factor times what drifts carry through the faces, for m of the m + 1 components.

    Components k and j change places at the rate (w_k - w_j) c_k c_j, each as it is on the side that
    it comes from: the sum over j is c_k (w_k - sum_j c_j w_j), and all components sum to zero. On a
    `smooth` cell, c runs to its face with the limited slope of `_slope`.
    """
    m, every = c.shape[0], drift.shape[0]
    low, high = np.empty(every), np.empty(every)
    for axis in range(flux.shape[1]):
        t = s[axis]
        for r in range(runs.shape[0]):
            for k in range(runs[r, 0], runs[r, 1]):
                moves = False
                for i in range(1, every):
                    moves |= drift[i, axis, k] != drift[0, axis, k]
                if not moves:
                    continue
                low[m], high[m] = 1.0, 1.0
                for i in range(m):
                    low[i], high[i] = c[i, k - t], c[i, k]
                    if smooth[axis, k - t]:
                        low[i] += 0.5 * _slope(c[i, k - 2 * t], c[i, k - t], c[i, k])
                    if smooth[axis, k]:
                        high[i] -= 0.5 * _slope(c[i, k - t], c[i, k], c[i, k + t])
                    low[m] -= low[i]
                    high[m] -= high[i]
                for i in range(m):
                    for j in range(every):
                        w = drift[i, axis, k] - drift[j, axis, k]
                        pair = low[i] * high[j] if w > 0.0 else high[i] * low[j]
                        flux[i, axis, k] += factor * w * pair


@numba.njit(inline="always")
def _slope(behind: float, here: float, ahead: float) -> float:
    """Monotonised central difference (van Leer 1977), times the spacing; zero at an extremum."""
    back, forth = here - behind, ahead - here
    if back * forth <= 0.0:
        return 0.0
    size = min(2 * abs(back), 2 * abs(forth), 0.5 * abs(back + forth))
    return size if back > 0.0 else -size


@numba.njit(cache=True)
def member_outgoing(flux: FloatArray, members: IntArray, s: Strides) -> FloatArray:
    """What A takes out of each member of a group, (m + 1, members), the last component's too."""
    count = flux.shape[0]
    total = np.zeros((count + 1, len(members)))
    for i in range(len(members)):
        k = members[i]
        for axis in range(flux.shape[1]):
            rest_low, rest_high = 0.0, 0.0
            for m in range(count):
                low, high = flux[m, axis, k], flux[m, axis, k + s[axis]]
                total[m, i] += max(high, 0.0) + max(-low, 0.0)
                rest_low -= low
                rest_high -= high
            total[count, i] += max(rest_high, 0.0) + max(-rest_low, 0.0)
    return total


@numba.njit(cache=True)
def low_order_content(
    content: FloatArray,
    c: FloatArray,
    flux: FloatArray,
    lost: FloatArray,
    before: FloatArray,
    after: FloatArray,
    runs: IntArray,
    members: IntArray,
    first: IntArray,
    s: Strides,
) -> None:
    """Phi c_low for m components and for the last.

    In runs from c_high, which `content` holds, by adding div(A); in groups from c and what the
    low-order fluxes take out, `lost`.
    """
    count = flux.shape[0]
    rest = content[count]
    for r in range(runs.shape[0]):
        rest[runs[r, 0] : runs[r, 1]] = 1.0
    for m in range(count):
        here = content[m]
        for axis in range(flux.shape[1]):
            low, high = flux[m, axis], flux[m, axis, s[axis] :]
            for r in range(runs.shape[0]):
                for k in range(numba.uint64(runs[r, 0]), numba.uint64(runs[r, 1])):
                    here[k] += high[k] - low[k]
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0]), numba.uint64(runs[r, 1])):
                rest[k] -= here[k]
    for g in range(len(first) - 1):
        rest_of_group = after[g]
        for m in range(count):
            value = before[g] * c[m, members[first[g]]] - lost[m, g]
            rest_of_group -= value
            for i in range(first[g], first[g + 1]):
                content[m, members[i]] = value
        for i in range(first[g], first[g + 1]):
            content[count, members[i]] = rest_of_group


@numba.njit(cache=True)
def shares_of_one(
    share: FloatArray,
    content: FloatArray,
    flux: FloatArray,
    sign: float,
    outgoing: FloatArray,
    runs: IntArray,
    members: IntArray,
    first: IntArray,
    s: Strides,
) -> None:
    """Step 3 for one component whose antidiffusive flux is sign times `flux`."""
    x0, x1, y0, y1 = flux[0], flux[0, s[0] :], flux[1], flux[1, s[1] :]
    z0, z1 = (flux[2], flux[2, s[2] :]) if s[2] != 0 else (flux[0], flux[0])
    three = s[2] != 0
    for r in range(runs.shape[0]):
        a, b = numba.uint64(runs[r, 0]), numba.uint64(runs[r, 1])
        for k in range(a, b):
            share[k] = (
                (max(sign * x1[k], 0.0) + max(-sign * x0[k], 0.0))
                + (max(sign * y1[k], 0.0) + max(-sign * y0[k], 0.0))
                + EMPTY
            )
        if three:
            for k in range(a, b):
                share[k] += max(sign * z1[k], 0.0) + max(-sign * z0[k], 0.0)
        for k in range(a, b):
            share[k] = min(1.0, max(content[k], 0.0) / share[k])
    for g in range(len(first) - 1):
        value = min(1.0, max(content[members[first[g]]], 0.0) / (outgoing[g] + EMPTY))
        for i in range(first[g], first[g + 1]):
            share[members[i]] = value


@numba.njit(cache=True)
def limit_two(
    flux: FloatArray, share: FloatArray, rest: FloatArray, runs: IntArray, s: Strides
) -> None:
    """Step 4 in place where there are two components: (dimension, cells), (cells,), (cells,)."""
    for axis in range(flux.shape[0]):
        m = s[axis]
        f, here, behind = flux[axis, m:], share[m:], share
        rest_here, rest_behind = rest[m:], rest
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)):
                forward = min(behind[k], rest_here[k])
                backward = min(here[k], rest_behind[k])
                f[k] *= forward if f[k] > 0.0 else backward


@numba.njit(cache=True)
def cap(
    alpha: FloatArray, flux: FloatArray, sign: float, share: FloatArray, runs: IntArray, s: Strides
) -> None:
    """Step 4 for one of many components: alpha = min(alpha, R of the cell that gives)."""
    for axis in range(flux.shape[0]):
        m = s[axis]
        f, least, here, behind = flux[axis, m:], alpha[axis, m:], share[m:], share
        for r in range(runs.shape[0]):
            for k in range(numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)):
                before, after = behind[k], here[k]
                giver = before if sign * f[k] > 0.0 else after
                least[k] = giver if giver < least[k] else least[k]
