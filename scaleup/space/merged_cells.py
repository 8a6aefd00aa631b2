"""Cut cells merged into groups, so that a cell holding little material limits no time step.

An explicit conservative update keeps bounds where what leaves a cell in a step is no more than
the cell holds. In full cells that sets the step; a cut cell that breaks the rule at that step is
merged with a neighbour. The cells of a group share one concentration, what flows between them
does not count, and the group's content changes by what crosses its outer faces: mass is kept to
round-off and bounds are kept, whatever the cut cells hold (cell merging, Ye et al. 1999,
J. Comput. Phys. 156, 209).
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.space.grid import BoolArray, FloatArray, Grid, IntArray

_SLACK = 1e-9  # of the rule, so that round-off merges no cell
_LITTLE = 1e-3  # fill fraction: content of 1e-17 of a cell is 1e-14 of its concentration


@dataclass(frozen=True)
class Groups:
    """Groups of cells; a cut cell that is merged with no other is a group of its own.

    members -- positions of the cells in the interval's list of active cells, group by group
    first   -- where each group starts in `members`, shape (groups + 1,)
    """

    members: IntArray
    first: IntArray

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def number(self) -> IntArray:
        """Group number of each member."""
        return np.repeat(np.arange(len(self)), np.diff(self.first))


def neighbours_below(grid: Grid, cells: IntArray) -> IntArray:
    """Position in `cells` of each cell's lower neighbour along each axis, or -1; (dimension, n)."""
    place = np.full(grid.cells, -1, dtype=np.int64)
    place[cells] = np.arange(len(cells))
    return _look_below(cells, place, np.array(grid.counts), grid.periodic)


def merge(
    below: IntArray,
    flux: FloatArray,
    spread: FloatArray,
    held: FloatArray,
    always: BoolArray,
    dt: float,
) -> Groups:
    """Groups in which no more leaves in a step than the group holds.

    below  -- (dimension, n) from `neighbours_below`
    flux, spread -- (dimension, n), 1/s: flux and diffusive conductance of the lower faces over
              the volume of a cell
    held   -- (3, n): what the cell holds over the volume of a cell, at the start and the end of
              the interval, and the least when a step of it begins
    always -- (n,) cells that are a group even if nothing is merged with them
    dt     -- s, the step; full cells must obey the rule at it

    Algorithm: while a group breaks the rule, or starts or ends with so little that its
    concentration would be round-off, it takes in the neighbouring group that it exchanges most
    with: what is mixed by merging then mixes by the flow anyway, and cells on both sides of a plane
    that hardly anything crosses are not made one.
    """
    root = _merge(below, flux, spread, held, dt)
    size = np.bincount(root, minlength=len(root))
    grouped = np.flatnonzero(always | (size[root] > 1))
    order = np.argsort(root[grouped], kind="stable")
    members = grouped[order]
    roots = root[members]
    starts = np.flatnonzero(np.concatenate([[True], roots[1:] != roots[:-1]]))
    if len(members) == 0:
        starts = np.zeros(0, dtype=np.int64)
    return Groups(members, np.concatenate([starts, [len(members)]]).astype(np.int64))


@numba.njit(cache=True)
def _look_below(cells: IntArray, place: IntArray, counts: IntArray, periodic: bool) -> IntArray:
    """The above, given the position of every cell of the grid in `cells`, or -1."""
    below = np.full((len(counts), len(cells)), -1, dtype=np.int64)
    for k in range(len(cells)):
        cell, stride = cells[k], 1
        for axis in range(len(counts)):
            if (cell // stride) % counts[axis] > 0:
                below[axis, k] = place[cell - stride]
            elif periodic:
                below[axis, k] = place[cell + (counts[axis] - 1) * stride]
            stride *= counts[axis]
    return below


@numba.njit(cache=True)
def leaving_rate(below: IntArray, flux: FloatArray, spread: FloatArray) -> FloatArray:
    """What leaves each cell per second by flow and exchange, over the volume of a cell, 1/s."""
    dimension, n = flux.shape
    rate = np.zeros(n)
    for axis in range(dimension):
        for i in range(n):
            j = below[axis, i]
            if j < 0:
                continue
            f, g = flux[axis, i], spread[axis, i]
            rate[i] += max(-f, 0.0) + g
            rate[j] += max(f, 0.0) + g
    return rate


@numba.njit(inline="always")
def _breaks(leaves: float, start: float, end: float, held: float) -> bool:
    little = 0.0 < start < _LITTLE or 0.0 < end < _LITTLE
    return little or leaves > held + _SLACK * (1.0 + held)


@numba.njit(cache=True)
def _merge(
    below: IntArray, flux: FloatArray, spread: FloatArray, held_by: FloatArray, dt: float
) -> IntArray:
    """Number of the group of each cell (that of one of its members)."""
    dimension, n = flux.shape
    root = np.arange(n)
    rate = leaving_rate(below, flux, spread)
    start, end, held = held_by[0].copy(), held_by[1].copy(), held_by[2].copy()
    above = np.full((dimension, n), -1)
    for axis in range(dimension):
        for i in range(n):
            if below[axis, i] >= 0:
                above[axis, below[axis, i]] = i
    # members of a group are a ring: each points to the next
    following = np.arange(n)
    queue = [i for i in range(n) if _breaks(rate[i] * dt, start[i], end[i], held[i])]
    while len(queue) > 0:
        group = root[queue.pop()]
        if not _breaks(rate[group] * dt, start[group], end[group], held[group]):
            continue
        best, best_inner, best_rate = -1, 0.0, 0.0
        member = group
        while True:
            for axis in range(dimension):
                for side in range(2):
                    other = below[axis, member] if side == 0 else above[axis, member]
                    if other < 0 or root[other] == group:
                        continue
                    face = member if side == 0 else other
                    if flux[axis, face] == 0.0 and spread[axis, face] == 0.0:
                        continue
                    candidate = root[other]
                    inner = _between(group, candidate, root, following, below, above, flux, spread)
                    if inner > best_inner:
                        best, best_inner = candidate, inner
                        best_rate = max(rate[group] + rate[candidate] - inner, 0.0)
            member = following[member]
            if member == group:
                break
        if best < 0:
            continue  # nothing flows between it and any other: only round-off can leave
        member = best
        while True:
            root[member] = group
            member = following[member]
            if member == best:
                break
        following[group], following[best] = following[best], following[group]
        rate[group], held[group] = best_rate, held[group] + held[best]
        start[group], end[group] = start[group] + start[best], end[group] + end[best]
        queue.append(group)
    return root


@numba.njit(cache=True)
def _between(
    group: int,
    other: int,
    root: IntArray,
    following: IntArray,
    below: IntArray,
    above: IntArray,
    flux: FloatArray,
    spread: FloatArray,
) -> float:
    """What leaves two groups through the faces between them, counted at both, 1/s."""
    total = 0.0
    member = group
    while True:
        for axis in range(below.shape[0]):
            low, high = below[axis, member], above[axis, member]
            if low >= 0 and root[low] == other:
                total += abs(flux[axis, member]) + 2 * spread[axis, member]
            if high >= 0 and root[high] == other:
                total += abs(flux[axis, high]) + 2 * spread[axis, high]
        member = following[member]
        if member == group:
            break
    return total
