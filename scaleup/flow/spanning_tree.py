"""Spanning trees of cells that share faces, and what is sent along them."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from scaleup.space.grid import FloatArray, IntArray

Numbers = NDArray[np.int32]


@dataclass(frozen=True)
class SpanningTree:
    """A spanning tree of each part.

    order -- the cells, each after the one that it hangs on
    link  -- by which face each cell hangs; -1 at a root, the first cell of its part
    part  -- which part each cell is in, from 0
    """

    order: Numbers
    link: Numbers
    part: Numbers

    @property
    def roots(self) -> IntArray:
        """The root of each part."""
        return np.flatnonzero(self.link < 0)

    def evened(self, outflow: FloatArray) -> FloatArray:
        """Outflows less the mean over their part."""
        count = len(self.roots)
        means = np.bincount(self.part, outflow, count) / np.bincount(self.part, None, count)
        return outflow - means[self.part]


@numba.njit(cache=True)
def missing_outflow(
    lower: IntArray, upper: IntArray, outflow: FloatArray, flux: FloatArray
) -> FloatArray:
    """What cells still have to give off beyond what the fluxes carry."""
    missing = outflow.copy()
    for f in range(len(flux)):
        missing[upper[f]] += flux[f]
        missing[lower[f]] -= flux[f]
    return missing


@numba.njit(cache=True)
def in_quanta(outflow: FloatArray, part: Numbers, parts: int, quantum: float) -> FloatArray:
    """Outflows as multiples of the quantum that sum to zero in each part, as they should.

    What rounding leaves is carried over to the next cell, by sums without round-off.
    """
    found = np.empty_like(outflow)
    carry = np.zeros(parts)
    for s in range(len(outflow)):
        c = part[s]
        total = outflow[s] + carry[c]
        share = total - outflow[s]
        lost = (outflow[s] - (total - share)) + (carry[c] - share)
        found[s] = quantum * np.rint(total / quantum)
        carry[c] = (total - found[s]) + lost
    return found


@numba.njit(cache=True)
def breadth_first(cells: int, lower: IntArray, upper: IntArray) -> tuple[Numbers, Numbers, Numbers]:
    """Order, links and parts of breadth-first spanning trees; see `SpanningTree`."""
    place = np.zeros(cells + 1, dtype=np.int32)
    for f in range(len(lower)):
        place[lower[f]] += 1
        place[upper[f]] += 1
    end = np.int32(0)
    for i in range(cells + 1):
        end += place[i]
        place[i] = end - place[i]
    beside = np.empty(2 * len(lower), dtype=np.int32)
    through = np.empty(2 * len(lower), dtype=np.int32)
    for f in range(len(lower)):
        a, b = lower[f], upper[f]
        beside[place[a]], through[place[a]] = b, f
        beside[place[b]], through[place[b]] = a, f
        place[a] += 1
        place[b] += 1
    part = np.full(cells, -1, dtype=np.int32)
    order = np.empty(cells, dtype=np.int32)
    link = np.full(cells, -1, dtype=np.int32)
    head, tail, parts = 0, 0, 0
    for root in range(cells):
        if part[root] >= 0:
            continue
        part[root] = parts
        parts += 1
        order[tail] = root
        tail += 1
        while head < tail:
            here = order[head]
            head += 1
            for e in range(place[here - 1] if here else 0, place[here]):
                other = beside[e]
                if part[other] < 0:
                    part[other] = parts - 1
                    link[other] = through[e]
                    order[tail] = other
                    tail += 1
    return order, link, part


@numba.njit(cache=True)
def send_down(
    order: Numbers,
    link: Numbers,
    lower: IntArray,
    upper: IntArray,
    flux: FloatArray,
    missing: FloatArray,
) -> None:
    """Send what each cell still misses along the tree, from the leaves; both arrays change."""
    for e in range(len(order) - 1, -1, -1):
        here = order[e]
        f = link[here]
        if f < 0:
            continue
        if upper[f] == here:
            flux[f] -= missing[here]
            missing[lower[f]] += missing[here]
        else:
            flux[f] += missing[here]
            missing[upper[f]] += missing[here]
