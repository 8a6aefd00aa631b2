"""Fluxes made to agree with a change of fill, cell by cell and to round-off.

Cells that may carry flux are strung along one grid axis (the one closest to the surface's normal)
into SEGMENTS. The model's lateral fluxes F* are corrected by

    F = F* + W (phi_lower - phi_upper)          phi constant on a segment,

with phi such that each segment gains what its fill does (`scaleup.numerics.nearest_fluxes`, of
segments in place of cells), and the fluxes along the segment follow from continuity, cell by cell.
It is the weighted projection in the limit of no resistance along the segments: a thin layer is
crossed by its surface's normal in a few cells, so that what is left to solve is as small as a
problem on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from scaleup.contract import FloatArray, IntArray
from scaleup.numerics import Faces, multigrid, nearest_fluxes

_SOLVED = 1e-8  # residual of the correction over what is to be corrected


@dataclass(frozen=True)
class Segments:
    """Segments of n cells, and the lateral faces between them.

    segment -- of each cell
    faces   -- between segments, `count` of them
    face_row, face_cell -- which row of the flux and which cell each face belongs to
    lower_cell -- the cell below each face
    """

    segment: IntArray
    faces: Faces
    face_row: IntArray
    face_cell: IntArray
    lower_cell: IntArray


def find_segments(below: IntArray, beside: IntArray) -> Segments:
    """Segments of n cells.

    below  -- number of the cell below along the segment's axis, through an open face; else -1, (n,)
    beside -- the same for each lateral axis, (lateral axes, n)
    """
    segment, count = _string(below)
    face_row, face_cell, lower, upper, lower_cell = _lateral_faces(segment, beside)
    return Segments(segment, Faces(count, lower, upper), face_row, face_cell, lower_cell)


@njit(cache=True)
def _string(below):
    segment = np.empty(len(below), dtype=np.int32)
    count = 0
    for n in range(len(below)):
        if below[n] >= 0:
            segment[n] = segment[below[n]]
            continue
        segment[n] = count
        count += 1
    return segment, count


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
    places = segments.face_row, segments.face_cell
    given, lateral_weight = flux[places], weight[places]
    outflow = -np.bincount(segments.segment, gain, segments.faces.count)
    lateral, _ = nearest_fluxes(
        segments.faces, given, lateral_weight, outflow, multigrid(_SOLVED), "quanta"
    )
    flux[:] = 0.0
    flux[places] = lateral
    return _along(below, _need(segments.face_cell, segments.lower_cell, lateral, gain))


@njit(cache=True)
def _need(face_cell, lower_cell, lateral, gain):
    """What each cell gains beyond what comes from beside, m^3/s."""
    need = gain.copy()
    for f in range(len(lateral)):
        need[face_cell[f]] -= lateral[f]
        need[lower_cell[f]] += lateral[f]
    return need


@njit(cache=True)
def _along(below, need):
    """Flux through each cell's lower face along its segment, from the bottom upwards."""
    lower = np.zeros(len(need))
    for n in range(len(need)):
        m = below[n]
        if m >= 0:
            lower[n] = lower[m] - need[m]
    return lower
