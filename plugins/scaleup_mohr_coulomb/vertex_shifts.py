"""Shifts of a contour at the vertices that give elements the area they lack."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

# Part of the length that ties vertices far from the contour, which have none, to a number.
_TIE = 1e-12
# Missing area, in squares of the spread, that is none.
_ROUND_OFF = 1e-12


def vertex_shifts(
    triangles: NDArray[Any],
    missing: NDArray[Any],
    lengths: NDArray[Any],
    spread: float,
    count: int,
) -> NDArray[Any]:
    """Shifts s (count,) in m, outwards, that give back what elements lack, smoothed over a length.

    At each vertex v, over the elements T about it and their other vertices w,

        sum_T [ L_Tv s_v + spread/2 sum_w (s_v - s_w) ] = sum_T missing_T / 3,

    so that sum L_Tv s_v = sum_T missing_T: all that is missing is given back, close to where it is
    missing (the correction of Kees et al. 2011, J. Comput. Phys. 230, 4536, on a sharp interface).
    ``triangles`` (n, 3) vertices; ``missing`` (n,) in m^2; ``lengths`` L (n, 3), the integrals of
    the vertices' linear functions along the contour in the elements, m; ``spread`` in m. Vertices
    without contour or want near get nothing.
    """
    at_all = np.zeros(count, dtype=bool)
    wanting = np.abs(missing) > _ROUND_OFF * spread**2
    at_all[triangles[lengths.any(axis=1) | wanting]] = True
    near = at_all[triangles].any(axis=1)
    shifts = np.zeros(count)
    if not near.any():
        return shifts
    vertices, corners = np.unique(triangles[near], return_inverse=True)
    corners = corners.reshape(-1, 3)
    number = len(vertices)
    wanted = np.bincount(corners.ravel(), np.repeat(missing[near] / 3.0, 3), number)
    weight = np.bincount(corners.ravel(), lengths[near].ravel(), number)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    half = csr_matrix((np.full(len(sides), 0.5 * spread), sides.T), shape=(number, number))
    ties = half + half.T
    diagonal = weight + _TIE * spread + np.asarray(ties.sum(axis=1)).ravel()
    shifts[vertices] = spsolve((diags(diagonal) - ties).tocsc(), wanted)
    return shifts
