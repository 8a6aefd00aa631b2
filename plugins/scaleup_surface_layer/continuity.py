"""Fluxes made to agree with a change of fill, cell by cell and to round-off.

Cells that may carry flux are strung along one grid axis (the one closest to the surface's normal)
into SEGMENTS. The model's lateral fluxes F* are corrected by

    F = F* + W (phi_lower - phi_upper)          phi constant on a segment,

with phi such that each segment gains what its fill does, and the fluxes along the segment follow
from continuity, cell by cell. It is the weighted projection in the limit of no resistance along
the segments: a thin layer is crossed by its surface's normal in a few cells, so that what is left
to solve is as small as a problem on the surface. What the solver leaves over is sent down a
spanning tree of segments, from the leaves to the root: in whole numbers of a quantum of flux, whose
sums are exact, or the root would get the round-off of millions of faces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix

from scaleup.contract import FloatArray, IntArray, RunError
from scaleup.numerics import SymmetricSolver

_SOLVED = 1e-8  # residual of the correction over what is to be corrected
_QUANTUM = 2.0**-48  # over the greatest flux; sums up to 32 times that one are exact


@dataclass(frozen=True)
class Segments:
    """Segments of n cells, and the lateral faces between them.

    segment -- of each cell; count -- number of segments; component -- of each segment
    roots -- the first segment of each component
    face_row, face_cell -- which row of the flux and which cell each lateral face belongs to
    lower, upper -- segments below and above each face; lower_cell -- the cell below it
    """

    segment: IntArray
    count: int
    component: IntArray
    roots: IntArray
    face_row: IntArray
    face_cell: IntArray
    lower: IntArray
    upper: IntArray
    lower_cell: IntArray


def find_segments(
    below: IntArray, beside: IntArray, component: IntArray, components: int
) -> Segments:
    """Segments of n cells.

    below  -- number of the cell below along the segment's axis, through an open face; else -1, (n,)
    beside -- the same for each lateral axis, (lateral axes, n)
    component -- of each cell: which cells hang together through these faces; components -- number
    """
    segment, of_segment, roots = _string(below, component, components)
    return Segments(segment, len(of_segment), of_segment, roots, *_lateral_faces(segment, beside))


@njit(cache=True)
def _string(below, component, components):
    segment = np.empty(len(below), dtype=np.int32)
    of_segment = np.empty(len(below), dtype=np.int32)
    roots = np.full(components, -1)
    count = 0
    for n in range(len(below)):
        if below[n] >= 0:
            segment[n] = segment[below[n]]
            continue
        if roots[component[n]] < 0:
            roots[component[n]] = count
        segment[n] = count
        of_segment[count] = component[n]
        count += 1
    return segment, of_segment[:count].copy(), roots


@njit(cache=True)
def _lateral_faces(segment, beside):
    total = 0
    for row in range(len(beside)):
        for n in range(len(segment)):
            total += beside[row, n] >= 0
    face_row, face_cell = np.empty(total, dtype=np.int8), np.empty(total, dtype=np.int32)
    lower, upper = np.empty(total, dtype=np.int32), np.empty(total, dtype=np.int32)
    lower_cell = np.empty(total, dtype=np.int32)
    f = 0
    for row in range(len(beside)):
        for n in range(len(segment)):
            m = beside[row, n]
            if m >= 0:
                face_row[f], face_cell[f], lower_cell[f] = row, n, m
                lower[f], upper[f] = segment[m], segment[n]
                f += 1
    return face_row, face_cell, lower, upper, lower_cell


def close_balance(
    segments: Segments, below: IntArray, flux: FloatArray, weight: FloatArray, gain: FloatArray
) -> FloatArray:
    """Correct lateral fluxes in place; returns the fluxes along the segments, shape (n,).

    flux   -- F* through each cell's lower lateral faces, m^3/s, (lateral axes, n); what is not
              among the faces of `segments` is set to zero
    weight -- > 0, same shape
    gain   -- m^3/s that each cell's fill gains; must sum to zero over every component
    """
    faces = segments.face_row, segments.face_cell
    lateral, w = flux[faces], weight[faces]
    flux[:] = 0.0
    ends = segments.lower, segments.upper
    demand = np.bincount(segments.segment, gain, segments.count)
    phi = _potential(segments, w, _shortfall(*ends, lateral, demand))
    lateral += w * (phi[segments.lower] - phi[segments.upper])
    greatest = max(np.abs(lateral).max(initial=0.0), np.abs(demand).max(initial=0.0))
    if greatest > 0:
        quantum = _QUANTUM * 2.0 ** np.ceil(np.log2(greatest))
        lateral = quantum * np.rint(lateral / quantum)
        demand = _rounded(demand, segments.component, len(segments.roots), quantum)
        _down_the_tree(segments.count, *ends, lateral, _shortfall(*ends, lateral, demand))
    flux[faces] = lateral
    return _along(below, _need(segments.face_cell, segments.lower_cell, lateral, gain))


@njit(cache=True)
def _rounded(demand, component, components, quantum):
    """Demands as multiples of the quantum that sum to zero in each component, as they should.

    What rounding leaves is carried over to the next segment, by sums without round-off.
    """
    found = np.empty_like(demand)
    carry = np.zeros(components)
    for s in range(len(demand)):
        c = component[s]
        total = demand[s] + carry[c]
        part = total - demand[s]
        lost = (demand[s] - (total - part)) + (carry[c] - part)
        found[s] = quantum * np.rint(total / quantum)
        carry[c] = (total - found[s]) + lost
    return found


@njit(cache=True)
def _shortfall(lower, upper, lateral, demand):
    """What each segment still has to gain beyond what its lateral fluxes bring, m^3/s."""
    need = demand.copy()
    for f in range(len(lateral)):
        need[upper[f]] -= lateral[f]
        need[lower[f]] += lateral[f]
    return need


@njit(cache=True)
def _need(face_cell, lower_cell, lateral, gain):
    """What each cell gains beyond what comes from beside, m^3/s."""
    need = gain.copy()
    for f in range(len(lateral)):
        need[face_cell[f]] -= lateral[f]
        need[lower_cell[f]] += lateral[f]
    return need


def _potential(segments: Segments, w: FloatArray, need: FloatArray) -> FloatArray:
    """Phi with sum over a segment's faces of w (phi_other - phi) = need, one fixed per component.

    Conjugate gradients with algebraic multigrid.
    """
    n = segments.count
    lower, upper = segments.lower, segments.upper
    if len(w) == 0:
        return np.zeros(n)
    diagonal = np.bincount(lower, w, n) + np.bincount(upper, w, n)
    roots = segments.roots
    diagonal[roots] += np.where(diagonal[roots] > 0, diagonal[roots], 1.0)
    ids = np.arange(n)
    matrix = csr_matrix(
        (
            np.concatenate([diagonal, -w, -w]),
            (np.concatenate([ids, lower, upper]), np.concatenate([ids, upper, lower])),
        ),
        shape=(n, n),
    )
    solver = SymmetricSolver(matrix, _SOLVED, most=1000)
    # inflow is positive: w (phi_lower - phi_upper) runs from lower to upper
    phi, converged = solver.solve(-need)
    solver.close()
    if not converged:
        raise RunError("surface-layer: the correction of the fluxes did not converge")
    return phi


@njit(cache=True)
def _down_the_tree(count, lower, upper, lateral, need):
    """Send what each segment still needs along a breadth-first spanning tree, from the leaves."""
    start = np.zeros(count + 1, dtype=np.int64)
    for f in range(len(lower)):
        start[lower[f] + 1] += 1
        start[upper[f] + 1] += 1
    start = np.cumsum(start)
    place = start[:-1].copy()
    faces = np.empty(2 * len(lower), dtype=np.int64)
    for f in range(len(lower)):
        faces[place[lower[f]]] = f
        place[lower[f]] += 1
        faces[place[upper[f]]] = f
        place[upper[f]] += 1
    seen = np.zeros(count, dtype=np.bool_)
    order = np.empty(count, dtype=np.int64)
    to_parent = np.full(count, -1)
    head, tail = 0, 0
    for root in range(count):
        if seen[root]:
            continue
        seen[root] = True
        order[tail] = root
        tail += 1
        while head < tail:
            here = order[head]
            head += 1
            for e in range(start[here], start[here + 1]):
                f = faces[e]
                other = upper[f] if lower[f] == here else lower[f]
                if not seen[other]:
                    seen[other] = True
                    to_parent[other] = f
                    order[tail] = other
                    tail += 1
    for e in range(count - 1, -1, -1):
        here = order[e]
        f = to_parent[here]
        if f < 0:
            continue
        if upper[f] == here:
            lateral[f] += need[here]
            need[lower[f]] += need[here]
        else:
            lateral[f] -= need[here]
            need[upper[f]] += need[here]


@njit(cache=True)
def _along(below, need):
    """Flux through each cell's lower face along its segment, from the bottom upwards."""
    lower = np.zeros(len(need))
    for n in range(len(need)):
        m = below[n]
        if m >= 0:
            lower[n] = lower[m] - need[m]
    return lower
