"""Shifts of a contour at the vertices that give elements the area they lack."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

# Part of the length that ties vertices far from the contour, which have none, to a number.
_TIE = 1e-12
# Missing area, in squares of the spread, that is none.
_ROUND_OFF = 1e-12


@numba.njit(cache=True)
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
    near = _near(triangles, (np.abs(missing) > _ROUND_OFF * spread**2) | _any(lengths), count)
    corners, chosen = triangles[near], np.flatnonzero(near)
    vertices, place = _ordered(corners, count)
    number = len(vertices)
    first = np.arange(number)
    for a, b, c in corners:
        least = min(place[a], place[b], place[c])
        for vertex in (a, b, c):
            first[place[vertex]] = min(first[place[vertex]], least)
    starts = np.zeros(number + 1, dtype=np.int64)
    starts[1:] = np.cumsum(np.arange(number) - first + 1)
    rows, wanted = np.zeros(starts[-1]), np.zeros(number)
    for row in range(number):
        rows[starts[row + 1] - 1] = _TIE * spread
    for k in range(len(chosen)):
        for vertex in range(3):
            row = place[corners[k, vertex]]
            wanted[row] += missing[chosen[k]] / 3.0
            rows[starts[row + 1] - 1] += lengths[chosen[k], vertex] + spread
            for other in range(3):
                column = place[corners[k, other]]
                if column < row:
                    rows[starts[row] + column - first[row]] -= 0.5 * spread
    _solve(rows, starts, first, wanted)
    shifts = np.zeros(count)
    shifts[vertices] = wanted
    return shifts


@numba.njit(cache=True)
def _any(lengths: NDArray[Any]) -> NDArray[Any]:
    found = np.zeros(len(lengths), dtype=np.bool_)
    for number in range(len(lengths)):
        found[number] = lengths[number].any()
    return found


@numba.njit(cache=True)
def _near(triangles: NDArray[Any], wanting: NDArray[Any], count: int) -> NDArray[Any]:
    """Flags of the elements that have a vertex of a wanting one."""
    at_all = np.zeros(count, dtype=np.bool_)
    for number in range(len(triangles)):
        if wanting[number]:
            at_all[triangles[number]] = True
    found = np.zeros(len(triangles), dtype=np.bool_)
    for number in range(len(triangles)):
        found[number] = at_all[triangles[number]].any()
    return found


@numba.njit(cache=True)
def _ordered(corners: NDArray[Any], count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices of elements in an order of narrow bands (Cuthill & McKee's, backwards), and places.

    Each part begins at the vertex that is met last from another.
    """
    degree = np.zeros(count + 1, dtype=np.int64)
    for triangle in corners:
        degree[triangle + 1] += 2
    starts, filled = np.cumsum(degree), np.cumsum(degree)
    neighbours = np.empty(starts[-1], dtype=np.int64)
    for triangle in corners:
        for vertex in range(3):
            for turn in (1, 2):
                neighbours[filled[triangle[vertex]]] = triangle[(vertex + turn) % 3]
                filled[triangle[vertex]] += 1
    order = np.empty(int((degree > 0).sum()), dtype=np.int64)
    place = np.full(count, -1, dtype=np.int64)
    done = 0
    for vertex in range(count):
        if degree[vertex + 1] and place[vertex] < 0:
            begin, root, end = done, vertex, done
            for _ in range(3):
                for k in range(begin, end):
                    place[order[k]] = -1
                order[begin], place[root], end = root, begin, begin + 1
                at = begin
                while at < end:
                    here = order[at]
                    for other in neighbours[starts[here] : starts[here + 1]]:
                        if place[other] < 0:
                            order[end], place[other] = other, end
                            end += 1
                    at += 1
                root = order[end - 1]
            done = end
    order = order[::-1].copy()
    for k in range(len(order)):
        place[order[k]] = k
    return order, place


@numba.njit(cache=True)
def _solve(
    rows: NDArray[Any], starts: NDArray[Any], first: NDArray[Any], wanted: NDArray[Any]
) -> None:
    """Replace ``wanted`` by the solution of a symmetric, positive definite system; Cholesky.

    Of each row the entries from column ``first`` to the diagonal are given, one row after the
    other; they are replaced by the factor's.
    """
    for i in range(len(first)):
        for j in range(first[i], i + 1):
            begin = max(first[i], first[j])
            entry = rows[starts[i] + j - first[i]]
            for k in range(begin, j):
                entry -= rows[starts[i] + k - first[i]] * rows[starts[j] + k - first[j]]
            if j < i:
                entry /= rows[starts[j + 1] - 1]
                wanted[i] -= entry * wanted[j]
            else:
                entry = np.sqrt(entry)
                wanted[i] /= entry
            rows[starts[i] + j - first[i]] = entry
    for i in range(len(first) - 1, -1, -1):
        wanted[i] /= rows[starts[i + 1] - 1]
        for j in range(first[i], i):
            wanted[j] -= rows[starts[i] + j - first[i]] * wanted[i]
