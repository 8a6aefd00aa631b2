"""Loops over a level set that is linear on triangles within elements, compiled.

``values`` (n_elements, n_points) are those on the points of an `ElementLattice`, ``triangles``
(n_triangles, 3) the numbers of points that span its triangles, in every element alike.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True)
def lattice_values(
    nodal: NDArray[Any], elements: NDArray[Any], shapes: NDArray[Any]
) -> NDArray[Any]:
    """From values (n_nodes,), by ``elements`` (n, k) and ``shapes`` (n_points, k): (n, n_points).

    Without BLAS, whose threads wait for each other by spinning.
    """
    found = np.zeros((len(elements), len(shapes)))
    for number in range(len(elements)):
        for point in range(len(shapes)):
            for k in range(elements.shape[1]):
                found[number, point] += shapes[point, k] * nodal[elements[number, k]]
    return found


@numba.njit(cache=True)
def positive_share(a: float, b: float, c: float) -> float:
    """Part of a triangle where the linear function of these corner values is positive."""
    low, high = min(a, b, c), max(a, b, c)
    if low > 0.0:
        return 1.0
    if high <= 0.0:
        return 0.0
    middle = max(min(a, b), min(max(a, b), c))
    if middle > 0.0:
        return 1.0 - low**2 / ((high - low) * (middle - low))
    return high**2 / ((high - low) * (high - middle))


@numba.njit(cache=True)
def _segment_share(one: float, other: float) -> float:
    """Part of a segment where the linear function of these end values is positive."""
    low, high = min(one, other), max(one, other)
    if low > 0.0:
        return 1.0
    return high / (high - low) if high > 0.0 else 0.0


@numba.njit(cache=True)
def positive_shares(values: NDArray[Any]) -> NDArray[Any]:
    """:func:`positive_share` of triangles (n,) with these corner ``values`` (n, 3)."""
    found = np.empty(len(values))
    for number in range(len(values)):
        found[number] = positive_share(values[number, 0], values[number, 1], values[number, 2])
    return found


@numba.njit(cache=True)
def _element_area(
    values: NDArray[Any], triangles: NDArray[Any], areas: NDArray[Any], whole: float
) -> float:
    if values.min() > 0.0:
        return whole
    found = 0.0
    if values.max() > 0.0:
        for number in range(len(triangles)):
            a, b, c = triangles[number]
            found += areas[number] * positive_share(values[a], values[b], values[c])
    return found


@numba.njit(cache=True)
def positive_areas(
    values: NDArray[Any], triangles: NDArray[Any], areas: NDArray[Any], whole: NDArray[Any]
) -> NDArray[Any]:
    """Area (n_elements,) where the level set is positive.

    ``areas`` (n_elements, n_triangles) are those of the triangles, ``whole`` (n_elements,) of the
    elements.
    """
    found = np.empty(len(values))
    for number in range(len(values)):
        found[number] = _element_area(values[number], triangles, areas[number], whole[number])
    return found


@numba.njit(cache=True)
def contour_weights(
    values: NDArray[Any],
    shift: float,
    corners: NDArray[Any],
    triangles: NDArray[Any],
    areas: NDArray[Any],
    whole: NDArray[Any],
) -> NDArray[Any]:
    """Change of :func:`positive_areas` per ``shift`` at each vertex (n_elements, 3).

    ``corners`` (3, n_points) are the vertices' linear functions.
    """
    found = np.zeros((len(values), 3))
    for number in range(len(values)):
        here = values[number]
        if here.min() >= shift or here.max() <= -shift:
            continue
        for vertex in range(3):
            step = 0.5 * shift * corners[vertex]
            more = _element_area(here + step, triangles, areas[number], whole[number])
            less = _element_area(here - step, triangles, areas[number], whole[number])
            found[number, vertex] = (more - less) / shift
    return found


@numba.njit(cache=True)
def outflow(
    before: NDArray[Any],
    after: NDArray[Any],
    steps: NDArray[Any],
    rim: NDArray[Any],
    times: NDArray[Any],
    weights: NDArray[Any],
) -> NDArray[Any]:
    """Sum (n_elements,) over the ``rim``'s segments of ``steps`` times their positive part.

    ``steps`` (n_elements, n_segments); the values go from ``before`` to ``after`` between the
    ``times`` 0 and 1, over which the ``weights`` are.
    """
    found = np.zeros(len(before))
    for number in range(len(before)):
        for segment in range(len(rim) - 1):
            a, b = rim[segment], rim[segment + 1]
            share = 0.0
            for k in range(len(times)):
                t = times[k]
                one = (1.0 - t) * before[number, a] + t * after[number, a]
                other = (1.0 - t) * before[number, b] + t * after[number, b]
                share += weights[k] * _segment_share(one, other)
            found[number] += share * steps[number, segment]
    return found


@numba.njit(cache=True)
def contour(
    values: NDArray[Any], points: NDArray[Any], triangles: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """End points, each (n, 2), of the zero contour's segments.

    ``points`` (n_elements, n_points, 2) are where the values are, in m.  Segments begin on the side
    that follows the corner which is alone on its side of the contour, and end on the next.
    """
    most = 0
    for number in range(len(values)):
        if values[number].min() <= 0.0 < values[number].max():
            most += len(triangles)
    ends = np.empty((2, most, 2))
    count = 0
    for number in range(len(values)):
        if not values[number].min() <= 0.0 < values[number].max():
            continue
        here, place = values[number], points[number]
        for triangle in triangles:
            inside = 0
            for point in triangle:
                inside += here[point] > 0.0
            if inside in (0, 3):
                continue
            alone = 0
            while (here[triangle[alone]] > 0.0) != (inside == 1):
                alone += 1
            near = triangle[alone]
            for end in range(2):
                far = triangle[(alone + 1 + end) % 3]
                weight = here[near] / (here[near] - here[far])
                for axis in range(2):
                    ends[end, count, axis] = (1.0 - weight) * place[near, axis]
                    ends[end, count, axis] += weight * place[far, axis]
            count += 1
    return ends[0, :count].copy(), ends[1, :count].copy()


# the least of numbers that are none of them NaN is the same in any order
@numba.njit(cache=True, fastmath={"nnan", "nsz"})
def distances(points: NDArray[Any], start: NDArray[Any], end: NDArray[Any]) -> NDArray[Any]:
    """Of ``points`` (n, 2) to the nearest of the segments between ``start`` and ``end`` (m, 2)."""
    ax, ay = start[:, 0].copy(), start[:, 1].copy()
    sx, sy = end[:, 0] - ax, end[:, 1] - ay
    square = sx**2 + sy**2
    over = np.where(square > 0.0, 1.0 / np.where(square > 0.0, square, 1.0), 0.0)
    found = np.empty(len(points))
    for number in range(len(points)):
        px, py = points[number]
        least = np.inf
        for k in range(len(ax)):
            x, y = px - ax[k], py - ay[k]
            along = min(max((x * sx[k] + y * sy[k]) * over[k], 0.0), 1.0)
            x, y = x - along * sx[k], y - along * sy[k]
            least = min(least, x * x + y * y)
        found[number] = np.sqrt(least)
    return found
