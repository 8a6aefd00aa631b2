"""Loops over pairs of unknowns, compiled. Fields are (m, unknowns), fluxes (m, pairs)."""

from __future__ import annotations

import numba
import numpy as np

from scaleup.contract import FloatArray, IntArray

LITTLE = 1e-14  # a flux that needs no content
NEGLIGIBLE = 1e-13  # a flux not worth moving


@numba.njit(cache=True)
def fluxes(
    out: FloatArray, c: FloatArray, weights: FloatArray, first: IntArray, second: IntArray
) -> None:
    """Out = weights[0] c_first + weights[1] c_second."""
    for m in range(len(c)):
        row, to = c[m], out[m]
        for p in range(len(first)):
            to[p] = weights[0, p] * row[first[p]] + weights[1, p] * row[second[p]]


@numba.njit(cache=True)
def add_mass_fluxes(
    out: FloatArray, gained: FloatArray, mass: FloatArray, first: IntArray, second: IntArray
) -> None:
    """Out += mass (gained_second - gained_first)."""
    for m in range(len(gained)):
        row, to = gained[m], out[m]
        for p in range(len(first)):
            to[p] += mass[p] * (row[second[p]] - row[first[p]])


@numba.njit(cache=True)
def move(content: FloatArray, flux: FloatArray, first: IntArray, second: IntArray) -> None:
    """Take the fluxes from the first and give them to the second of each pair, in place."""
    for m in range(len(content)):
        row, through = content[m], flux[m]
        for p in range(len(first)):
            row[first[p]] -= through[p]
            row[second[p]] += through[p]


@numba.njit(cache=True)
def find_shares(
    share: FloatArray,
    content: FloatArray,
    after: FloatArray,
    flux: FloatArray,
    first: IntArray,
    second: IntArray,
    open_pairs: IntArray,
) -> None:
    """What each unknown can give of what the open pairs take, of all components and the last."""
    count = len(flux)
    share[...] = LITTLE
    for p in open_pairs:
        i, j = first[p], second[p]
        rest = 0.0
        for m in range(count):
            f = flux[m, p]
            rest -= f
            if f > 0.0:
                share[m, i] += f
            else:
                share[m, j] -= f
        if rest > 0.0:
            share[count, i] += rest
        else:
            share[count, j] -= rest
    for i in range(share.shape[1]):
        rest = after[i]
        for m in range(count):
            rest -= content[m, i]
            share[m, i] = min(1.0, max(content[m, i], 0.0) / share[m, i])
        share[count, i] = min(1.0, max(rest, 0.0) / share[count, i])


@numba.njit(cache=True)
def move_share(
    content: FloatArray,
    flux: FloatArray,
    share: FloatArray,
    first: IntArray,
    second: IntArray,
    open_pairs: IntArray,
) -> tuple[int, float]:
    """Move alpha flux and keep the rest, alpha the least share of those that give.

    Pairs that keep next to nothing are closed; returns how many stay open, listed first, and the
    most that was moved.
    """
    count, kept, most = len(flux), 0, 0.0
    for p in open_pairs:
        i, j = first[p], second[p]
        alpha, rest = 1.0, 0.0
        for m in range(count):
            f = flux[m, p]
            rest -= f
            if f != 0.0:
                alpha = min(alpha, share[m, i] if f > 0.0 else share[m, j])
        if rest != 0.0:
            alpha = min(alpha, share[count, i] if rest > 0.0 else share[count, j])
        greatest = 0.0
        for m in range(count):
            moved = alpha * flux[m, p]
            content[m, i] -= moved
            content[m, j] += moved
            flux[m, p] -= moved
            greatest = max(greatest, abs(flux[m, p]))
            most = max(most, abs(moved))
        if greatest > NEGLIGIBLE:
            open_pairs[kept] = p
            kept += 1
    return kept, most


@numba.njit(cache=True)
def bounds(values: FloatArray, count: int) -> tuple[float, float]:
    """Least and greatest of all components, the last included, of the first `count` unknowns."""
    low, high = np.inf, -np.inf
    for i in range(count):
        rest = 1.0
        for m in range(len(values)):
            rest -= values[m, i]
            low, high = min(low, values[m, i]), max(high, values[m, i])
        low, high = min(low, rest), max(high, rest)
    return low, high
