"""What cells hold, moved along paths: sub-cells laid down on the cells where they end.

1. The sub-cells of a cell are boxes of equal volume. Each keeps its size, is laid where the path of
   its middle ends, and is shared out to the cells that it overlaps there; a part over a cell
   without material stays with the path's cell.
2. A part counts with a factor of the cell that it lands in (`balance`), and the parts of a source
   are scaled to add up to what the source held.
3. A part of a component's content has the concentration that the reconstruction in the source cell
   (`subcells`) has at the part's place: its mean over the sub-cell, and its gradient there times
   the distance between the part and the sub-cell's middle. The gradient is turned and stretched as
   the cell is, by the Jacobian of the motion, the least-squares fit to where the sub-cells end.
4. Deviations from the source's mean have mean zero over its parts; one factor for all of them keeps
   every component of every part in [0, 1].

Parts are >= 0, so concentrations stay in [0, 1]; what leaves a source arrives: mass is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray
from scaleup_semi_lagrangian.moving_cells import Lattice, apart

SCALE = 65535.0  # places in a cell are kept as 16-bit shares of its edge
_MOST_STRETCH = 20.0  # of a Jacobian that is believed


class Landing(NamedTuple):
    """Where the sub-cells of s sources end among the m moving cells.

    landed, places -- (s, sub-cells) the cells, and (s, sub-cells, dimension) the places in them
    below, above -- (dimension, m) neighbours; holds -- (m,) which cells hold material at the end
    factor -- (m,) with which parts count in each
    start -- (s,) fill fraction of each source
    strides -- one to the next cell along each axis in flattened local arrays
    per_edge -- sub-cells along an edge of a cell
    """

    landed: IntArray
    places: IntArray
    below: IntArray
    above: IntArray
    holds: BoolArray
    factor: FloatArray
    start: FloatArray
    strides: tuple[int, ...]
    per_edge: int


class Parts(NamedTuple):
    """The parts that the sub-cells of a source fall into.

    cells, weights -- (sub-cells, 2^d); offsets -- (sub-cells, 2^d, d) from the sub-cell's middle
    counts -- (sub-cells,) how many there are
    """

    cells: IntArray
    weights: FloatArray
    offsets: FloatArray
    counts: IntArray


class Reconstruction(NamedTuple):
    """How concentrations vary within the sources.

    position -- (s,) of each source in flattened local arrays
    kinds    -- (s, dimension) which of the stencils each takes
    corners  -- (s, pairs) `subcells.corners` of each
    points   -- (sub-cells, dimension) their middles relative to the cell's
    means, slopes -- `subcells.stencils`
    """

    position: IntArray
    kinds: IntArray
    corners: BoolArray
    points: FloatArray
    means: FloatArray
    slopes: FloatArray


@numba.njit(inline="always")
def _room_for(landing):
    """Parts, to be laid by `_lay_boxes`."""
    subcells, dimension = landing.landed.shape[1], len(landing.strides)
    most = 2**dimension
    return Parts(
        np.empty((subcells, most), dtype=np.int32),
        np.empty((subcells, most)),
        np.empty((subcells, most, dimension)),
        np.empty(subcells, dtype=np.int64),
    )


@numba.njit(inline="always")
def _lay_boxes(n, landing, parts):
    """Lay the parts of the sub-cells of source n; returns the sum of their weights."""
    landed, places, below, above, holds, factor, _, strides, per_edge = landing
    cells, weights, offsets, counts = parts
    whole = 0.0
    dimension = len(strides)
    for p in range(landed.shape[1]):
        cells[p, 0] = landed[n, p]
        weights[p, 0] = 1.0
        count = 1
        for a in range(dimension):
            x = places[n, p, a] * (per_edge / SCALE)
            low, high = 0.5 - x, x + 0.5 - per_edge
            if low <= 0.0 and high <= 0.0:
                for m in range(count):
                    offsets[p, m, a] = 0.0
                continue
            over, sign = (low, -0.5) if low > 0.0 else (high, 0.5)
            for m in range(count):
                cell = cells[p, m]
                beside = below[a, cell] if low > 0.0 else above[a, cell]
                cells[p, count + m] = beside if beside >= 0 and holds[beside] else cell
                weights[p, count + m] = over * weights[p, m]
                weights[p, m] *= 1.0 - over
                for b in range(a):
                    offsets[p, count + m, b] = offsets[p, m, b]
                offsets[p, m, a] = -sign * over / per_edge
                offsets[p, count + m, a] = sign * (1.0 - over) / per_edge
            count *= 2
        counts[p] = count
        for m in range(count):
            weights[p, m] *= factor[cells[p, m]]
            whole += weights[p, m]
    return whole


@numba.njit(cache=True)
def lay_volumes(total: FloatArray, landing: Landing) -> None:
    """Add to `total` (m,) what the sources bring to each cell, as fill fractions."""
    parts = _room_for(landing)
    cells, weights, _, counts = parts
    start = landing.start
    for n in range(len(start)):
        whole = _lay_boxes(n, landing, parts)
        scale = start[n] / whole
        for p in range(len(counts)):
            for m in range(counts[p]):
                total[cells[p, m]] += scale * weights[p, m]


@numba.njit(cache=True)
def lay_places(total: FloatArray, landing: Landing, lattice: Lattice) -> None:
    """Add to `total` (dimension, m) the moments of what the sources bring about the cells' middles.

    Fill fractions times cells. A part counts where its concentration is that of: as `lay_contents`
    takes deviations from their mean over the parts, it is moved by what the mean of the parts'
    places is off that of the sub-cells' middles.
    """
    landed, places, start = landing.landed, landing.places, landing.start
    subcells, dimension = landed.shape[1], len(landing.strides)
    parts = _room_for(landing)
    cells, weights, offsets, counts = parts
    at = np.empty((subcells, dimension))
    for n in range(len(landed)):
        whole = _lay_boxes(n, landing, parts)
        scale, first = start[n] / whole, landed[n, 0]
        for a in range(dimension):
            of_middles, of_parts = 0.0, 0.0
            for p in range(subcells):
                at[p, a] = apart(lattice, landed[n, p], first, a) + places[n, p, a] / SCALE
                of_middles += at[p, a]
                for m in range(counts[p]):
                    of_parts += weights[p, m] * (at[p, a] + offsets[p, m, a])
            moved = of_middles / subcells - of_parts / whole
            for p in range(subcells):
                for m in range(counts[p]):
                    cell = cells[p, m]
                    off = at[p, a] + offsets[p, m, a] + moved
                    off = off - apart(lattice, cell, first, a) - 0.5
                    total[a, cell] += scale * weights[p, m] * off


@numba.njit(cache=True, fastmath={"contract"})
def lay_contents(
    total: FloatArray,
    landing: Landing,
    coordinates: IntArray,
    c: FloatArray,
    reconstruction: Reconstruction,
) -> None:
    """Add to `total` (components, m) what the sources bring to each cell of each component.

    coordinates -- (m, dimension) whole numbers of the moving cells along the axes
    c -- (components, cells) in flattened local arrays, all components but the last
    """
    landed, places, strides = landing.landed, landing.places, landing.strides
    position, kinds, corners, points, means, slopes = reconstruction
    subcells, dimension, start = landed.shape[1], len(strides), landing.start
    components, per_edge = c.shape[0], means.shape[1]
    parts = _room_for(landing)
    cells, weights, offsets, counts = parts
    within = np.empty((components, subcells, cells.shape[1]))
    line = np.empty((dimension, per_edge))
    tilt = np.empty((dimension, per_edge))
    mixed = np.zeros((dimension, dimension))
    jacobian = np.empty((dimension, dimension))
    inverse = np.empty((dimension, dimension))
    gradient = np.empty(dimension)
    moment = 0.0
    for p in range(subcells):
        moment += points[p, 0] ** 2
    for n in range(len(landed)):
        k = position[n]
        whole = _lay_boxes(n, landing, parts)
        scale = start[n] / whole
        believed = -1  # the Jacobian is not known yet
        varies = False
        rest_now = 1.0
        theta = 1.0
        for q in range(components):
            now = c[q, k]
            rest_now -= now
            flat = True
            for a in range(dimension):
                s, kind = strides[a], kinds[n, a]
                d0, d1 = c[q, k - 2 * s] - now, c[q, k - s] - now
                d3, d4 = c[q, k + s] - now, c[q, k + 2 * s] - now
                if kind < 4:
                    d0 = d4 = 0.0
                    if kind == 0 or kind == 2:
                        d1 = 0.0
                    if kind < 2:
                        d3 = 0.0
                if d0 != 0.0 or d1 != 0.0 or d3 != 0.0 or d4 != 0.0:
                    flat = False
                for e in range(per_edge):
                    line[a, e] = (
                        means[kind, e, 0] * d0 + means[kind, e, 1] * d1
                        + means[kind, e, 3] * d3 + means[kind, e, 4] * d4
                    )  # fmt: skip
                    tilt[a, e] = (
                        slopes[kind, e, 0] * d0 + slopes[kind, e, 1] * d1
                        + slopes[kind, e, 3] * d3 + slopes[kind, e, 4] * d4
                    )  # fmt: skip
                for b in range(a):
                    t = strides[b]
                    value = 0.0
                    if corners[n, a * (a - 1) // 2 + b]:
                        value = 0.25 * (
                            c[q, k + s + t] - c[q, k + s - t] - c[q, k - s + t] + c[q, k - s - t]
                        )
                    mixed[a, b] = mixed[b, a] = value
                    if value != 0.0:
                        flat = False
            if flat:
                for p in range(subcells):
                    for m in range(counts[p]):
                        within[q, p, m] = 0.0
                continue
            varies = True
            if believed < 0:
                believed = 0
                for a in range(dimension):
                    for b in range(dimension):
                        value = 0.0
                        for p in range(subcells):
                            x = coordinates[landed[n, p], a] + places[n, p, a] / SCALE
                            value += x * points[p, b]
                        jacobian[a, b] = value / moment
                if _inverted(jacobian, inverse):
                    believed = 1
            mean = 0.0
            for p in range(subcells):
                rest, d = p, 0.0
                for a in range(dimension):
                    e = rest % per_edge
                    rest //= per_edge
                    d += line[a, e]
                    gradient[a] = tilt[a, e]
                for a in range(dimension):
                    for b in range(a):
                        d += mixed[a, b] * points[p, a] * points[p, b]
                        gradient[a] += mixed[a, b] * points[p, b]
                        gradient[b] += mixed[a, b] * points[p, a]
                whole_or_rough = counts[p] == 1 or believed == 0
                for m in range(counts[p]):
                    value = d
                    for a in range(0 if whole_or_rough else dimension):
                        # along the axis where the part is, by the source's gradient
                        back = 0.0
                        for b in range(dimension):
                            back += inverse[a, b] * offsets[p, m, b]
                        value += gradient[a] * back
                    within[q, p, m] = value
                    mean += weights[p, m] * value
            mean /= whole
            for p in range(subcells):
                for m in range(counts[p]):
                    value = within[q, p, m] - mean
                    within[q, p, m] = value
                    if value < 0.0 and now + theta * value < 0.0:
                        theta = max(now, 0.0) / -value
        if not varies:
            for q in range(components):
                value = scale * c[q, k]
                for p in range(subcells):
                    for m in range(counts[p]):
                        total[q, cells[p, m]] += value * weights[p, m]
            continue
        for p in range(subcells):
            for m in range(counts[p]):
                rest = 0.0
                for q in range(components):
                    rest -= within[q, p, m]
                if rest < 0.0 and rest_now + theta * rest < 0.0:
                    theta = max(rest_now, 0.0) / -rest
        for q in range(components):
            now = c[q, k]
            for p in range(subcells):
                for m in range(counts[p]):
                    total[q, cells[p, m]] += scale * weights[p, m] * (now + theta * within[q, p, m])


@numba.njit(inline="always")
def _inverted(matrix, inverse):
    """Put the inverse of a Jacobian into `inverse`; False if it is not that of a smooth motion."""
    dimension = matrix.shape[0]
    for a in range(dimension):
        for b in range(dimension):
            if not abs(matrix[a, b]) < _MOST_STRETCH:
                return False
    if dimension == 2:
        det = matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0]
        if not 0.5 < det < 2.0:
            return False
        inverse[0, 0], inverse[1, 1] = matrix[1, 1] / det, matrix[0, 0] / det
        inverse[0, 1], inverse[1, 0] = -matrix[0, 1] / det, -matrix[1, 0] / det
        return True
    for a in range(3):
        b, e = (a + 1) % 3, (a + 2) % 3
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            inverse[r, a] = matrix[b, s] * matrix[e, t] - matrix[b, t] * matrix[e, s]
    det = matrix[0, 0] * inverse[0, 0] + matrix[0, 1] * inverse[1, 0] + matrix[0, 2] * inverse[2, 0]
    if not 0.5 < det < 2.0:
        return False
    for a in range(3):
        for r in range(3):
            inverse[r, a] /= det
    return True
