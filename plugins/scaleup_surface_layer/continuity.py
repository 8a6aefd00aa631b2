"""Fluxes made to agree with a change of fill, cell by cell and to round-off.

Cells that may carry flux are strung along one grid axis (the one closest to the surface's normal)
into SEGMENTS. The model's lateral fluxes F* are corrected by

    F = F* + W (phi_lower - phi_upper)          phi constant on a segment,

with phi such that each segment gains what its fill does, and the fluxes along the segment follow
from continuity, cell by cell. It is the weighted projection in the limit of no resistance along
the segments: a thin layer is crossed by its surface's normal in a few cells, so that what is left
to solve is as small as a problem on the surface. What the solver leaves over is sent down a
spanning tree of segments, from the leaves to the root.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from scaleup.api import BoolArray, FloatArray, IntArray, RunError


@dataclass(frozen=True)
class Segments:
    """Segments of a set of n cells, and the lateral faces between them.

    segment -- of each cell; count -- number of segments
    component -- of each segment: which segments hang together; components -- their number
    face_row, face_cell -- which row of the flux and which cell each lateral face belongs to
    lower, upper -- segments below and above each face; lower_cell -- the cell below it
    """

    segment: IntArray
    count: int
    component: IntArray
    components: int
    face_row: IntArray
    face_cell: IntArray
    lower: IntArray
    upper: IntArray
    lower_cell: IntArray


def find_segments(below: IntArray, beside: tuple[IntArray, ...], used: BoolArray) -> Segments:
    """Segments of the used cells.

    below  -- number of the cell below along the segment's axis, through an open face; else -1
    beside -- the same for each lateral axis
    used   -- which cells count, shape (n,); the others get segment -1
    """
    segment, count = _string(below, used)
    rows, cells = [], []
    for row, other in enumerate(beside):
        here = np.flatnonzero(used & (other >= 0))
        here = here[used[other[here]]]
        rows.append(np.full(len(here), row))
        cells.append(here)
    face_row, face_cell = np.concatenate(rows), np.concatenate(cells)
    neighbour = np.stack(beside)[face_row, face_cell]
    lower, upper = segment[neighbour], segment[face_cell]
    graph = csr_matrix((np.ones(len(lower), dtype=bool), (lower, upper)), shape=(count, count))
    components, component = connected_components(graph, directed=False)
    return Segments(
        segment, count, component, components, face_row, face_cell, lower, upper, neighbour
    )


@njit(cache=True)
def _string(below, used):
    segment = np.full(len(below), -1)
    count = 0
    for n in range(len(below)):
        if not used[n]:
            continue
        if below[n] >= 0 and used[below[n]]:
            segment[n] = segment[below[n]]
        else:
            segment[n] = count
            count += 1
    return segment, count


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
    need = _shortfall(segments, lateral, gain)
    phi = _potential(segments, w, need)
    lateral += w * (phi[segments.lower] - phi[segments.upper])
    _down_the_tree(
        segments.count, segments.lower, segments.upper, lateral, _shortfall(segments, lateral, gain)
    )
    flux[faces] = lateral
    # cell by cell: what is gained beyond what comes from beside
    need = np.where(segments.segment >= 0, gain, 0.0)
    need -= flux.sum(axis=0)
    need += np.bincount(segments.lower_cell, lateral, len(need))
    return _along(segments.segment, below, need)


def _shortfall(segments: Segments, lateral: FloatArray, gain: FloatArray) -> FloatArray:
    """What each segment still has to gain beyond what its lateral fluxes bring, m^3/s."""
    used = segments.segment >= 0
    need = np.bincount(segments.segment[used], gain[used], segments.count)
    need -= np.bincount(segments.upper, lateral, segments.count)
    need += np.bincount(segments.lower, lateral, segments.count)
    return need


def _potential(segments: Segments, w: FloatArray, need: FloatArray) -> FloatArray:
    """Phi with sum over a segment's faces of w (phi_other - phi) = need, one fixed per component.

    Conjugate gradients with algebraic multigrid.
    """
    from petsc4py import PETSc

    n = segments.count
    lower, upper = segments.lower, segments.upper
    diagonal = np.bincount(lower, w, n) + np.bincount(upper, w, n)
    _, roots = np.unique(segments.component, return_index=True)
    diagonal[roots] += np.where(diagonal[roots] > 0, diagonal[roots], 1.0)
    ids = np.arange(n)
    matrix = csr_matrix(
        (
            np.concatenate([diagonal, -w, -w]),
            (np.concatenate([ids, lower, upper]), np.concatenate([ids, upper, lower])),
        ),
        shape=(n, n),
    )
    operator = PETSc.Mat().createAIJ(
        (n, n),
        csr=(
            matrix.indptr.astype(PETSc.IntType),
            matrix.indices.astype(PETSc.IntType),
            matrix.data,
        ),
        comm=PETSc.COMM_SELF,
    )
    solver = PETSc.KSP().create(PETSc.COMM_SELF)
    solver.setOperators(operator)
    solver.setType("cg")
    solver.getPC().setType("gamg")
    solver.setTolerances(rtol=1e-9, max_it=1000)
    solution, load = operator.createVecRight(), operator.createVecLeft()
    # inflow is positive: w (phi_lower - phi_upper) runs from lower to upper
    load.setArray(-need)
    solver.solve(load, solution)
    if solver.getConvergedReason() <= 0:
        raise RunError("surface-layer: the correction of the fluxes did not converge")
    phi: FloatArray = solution.getArray().copy()
    for handle in (solver, operator, solution, load):
        handle.destroy()
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
def _along(segment, below, need):
    """Flux through each cell's lower face along its segment, from the bottom upwards."""
    lower = np.zeros(len(need))
    for n in range(len(need)):
        m = below[n]
        if segment[n] >= 0 and m >= 0 and segment[m] == segment[n]:
            lower[n] = lower[m] - need[m]
    return lower
