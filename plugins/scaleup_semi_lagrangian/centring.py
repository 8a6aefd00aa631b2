"""Concentrations moved to the middles of the cells from where their material lies.

What lies in a cell after a step does not lie evenly: sub-cells are laid down as boxes, weighed and
moved on by what settles. If x_j is the mean place of what cell j holds, off its middle, the cell
gets c(x_j): an error of first order in the cell, however smooth c is. The conservative map itself,
given places for concentrations, tells x_j (`off_middles`), and

    c_j - x_j . grad c

is second order and more. Of these changes, in full cells among full ones, one factor per cell keeps
every component in [0, 1], and another makes them sum to nothing in each connected part of the bed,
for every component:

    1 - min(1, max(0, y . d_j/|d_j|)),   d_j the changes of the components,

with y by Newton's method; it only takes from the changes that have the sign of the sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.contract import FloatArray, IntArray
from scaleup_semi_lagrangian import settlement
from scaleup_semi_lagrangian.settlement import Settlement

_FULL = 1.0 - 1e-12  # a cell's change counts by its whole volume
_FARTHEST = 0.25  # cells off the middle; what lies farther is left as it is
_MOST = 20  # iterations
_ROUND_OFF = 1e-15  # of the changes, that they may sum to


@dataclass(frozen=True)
class Centring:
    """The cells that are corrected, and where their material lies.

    cells -- places among the moving cells, connected part by connected part, (k,)
    parts -- where each of these begins, and the end
    off   -- mean place of what they hold, in cells from the middle, (dimension, k)
    """

    cells: IntArray
    parts: IntArray
    off: FloatArray


def find_centring(
    off: FloatArray, below: IntArray, above: IntArray, fill: FloatArray, part: IntArray
) -> Centring:
    """From `off_middles` (dimension, m), the fill fractions and the connected parts, both (m,)."""
    full = fill >= _FULL
    inner = full & (np.abs(off).max(axis=0) < _FARTHEST)
    for beside in (*below, *above):
        inner &= (beside >= 0) & full[beside]
    cells = np.flatnonzero(inner)
    cells = cells[np.argsort(part[cells], kind="stable")]
    parts = np.append(np.flatnonzero(np.diff(part[cells], prepend=-1)), len(cells))
    return Centring(
        cells.astype(np.int32), parts.astype(np.int32), off[:, cells].astype(np.float32)
    )


def off_middles(
    moments: FloatArray,
    laid: FloatArray,
    below: IntArray,
    above: IntArray,
    settled: Settlement,
) -> FloatArray:
    """Mean places of what cells hold once it has settled, in cells from the middle, (dimension, m).

    moments -- of what is laid down in them, about their middles (`images.lay_places`)
    """
    off, moments = np.zeros_like(moments), moments.copy()
    for axis in range(len(below)):
        # what flows in comes from a cell whose middle is that of this one less or plus a cell
        upper = np.flatnonzero(below[axis] >= 0)
        through = settled.flux[axis, upper]
        moments[axis, upper] -= np.maximum(through, 0.0)
        moments[axis, below[axis, upper]] += np.maximum(-through, 0.0)
    settlement.carry(off, moments, laid, below, above, settled.flux, settled.order)
    return off


@numba.njit(cache=True)
def centre(
    c: FloatArray, cells: IntArray, parts: IntArray, off: FloatArray, below: IntArray,
    above: IntArray,
) -> None:  # fmt: skip
    """Move concentrations c (components, m), all but the last, to the middles; see `Centring`."""
    components, dimension = c.shape[0], len(off)
    change = np.empty((components, len(cells)))
    for n in range(len(cells)):
        i, rest, rest_change, share = cells[n], 1.0, 0.0, 1.0
        for q in range(components):
            value = 0.0
            for a in range(dimension):
                value -= off[a, n] * 0.5 * (c[q, above[a, i]] - c[q, below[a, i]])
            change[q, n] = value
            rest -= c[q, i]
            rest_change -= value
            if value < 0.0 and c[q, i] + share * value < 0.0:
                share = max(c[q, i], 0.0) / -value
        if rest_change < 0.0 and rest + share * rest_change < 0.0:
            share = max(rest, 0.0) / -rest_change
        for q in range(components):
            change[q, n] *= share
    for number in range(len(parts) - 1):
        begin, end = parts[number], parts[number + 1]
        balance(change[:, begin:end])
        for n in range(begin, end):
            for q in range(components):
                c[q, cells[n]] += change[q, n]


@numba.njit(cache=True)
def balance(change: FloatArray) -> None:
    """Take from changes (components, n) until those of every component sum to 0.

    Those of a cell keep their ratios. If that is not reached, all become 0.
    """
    components, n = change.shape
    size = np.sqrt((change**2).sum(axis=0))
    total = size.sum()
    # so little of their sum that next to nothing is taken, but it is known from what
    y = 1e-30 * change.sum(axis=1)
    left, slope = np.empty(components), np.empty((components, components))
    for _ in range(_MOST):
        left[:] = 0.0
        slope[:] = 0.0
        for i in range(n):
            taken = _taken(y, change, size, i)
            for q in range(components):
                left[q] += (1.0 - taken) * change[q, i]
                if 0.0 < taken < 1.0:
                    for r in range(components):
                        slope[q, r] += change[q, i] * change[r, i] / size[i]
        if np.abs(left).max() <= _ROUND_OFF * total:
            break
        for q in range(components):
            slope[q, q] += 1e-12 * total
        y += np.linalg.solve(slope, left)
    else:
        change[:] = 0.0
    for i in range(n):
        change[:, i] *= 1.0 - _taken(y, change, size, i)


@numba.njit(inline="always")
def _taken(y, change, size, i):
    """Share that is taken from the changes of cell i."""
    if size[i] == 0.0:
        return 0.0
    along = 0.0
    for q in range(len(y)):
        along += y[q] * change[q, i]
    return min(max(along / size[i], 0.0), 1.0)
