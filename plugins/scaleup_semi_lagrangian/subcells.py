"""Concentrations inside a cell, from the means of the cells around.

Along an axis, the polynomial that has the means of the five (quartic), three (parabola) or two
(line) cells around; over the axes its deviations from the cell's mean are added, with c_ab x_a x_b
for each pair of axes. Exact for polynomials of fourth degree along each axis, and of second degree
altogether.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray

NONE, LOWER, UPPER, THREE, FIVE = 0, 1, 2, 3, 4
"""which cells along an axis take part"""


@cache
def stencils(per_edge: int) -> tuple[FloatArray, FloatArray]:
    """Weights of the cells from -2 to 2 along an axis, both (5 kinds, per_edge, 5 cells).

    In the deviation of each sub-cell's mean from the cell's, and in the mean slope over each
    sub-cell, per edge of a cell. Over the cells they sum to 0.
    """
    means, slopes = np.zeros((5, per_edge, 5)), np.zeros((5, per_edge, 5))
    edges = np.linspace(-0.5, 0.5, per_edge + 1)
    reach = {LOWER: (-1, 0), UPPER: (0, 1), THREE: (-1, 1), FIVE: (-2, 2)}
    for kind, (low, high) in reach.items():
        cells = slice(low + 2, high + 3)
        powers = np.arange(1, high - low + 2)  # of the primitive
        of_cells = np.diff(np.arange(low - 0.5, high + 1)[:, None] ** powers, axis=0)
        coefficients = np.linalg.inv(of_cells)  # of the primitive, by cell
        means[kind, :, cells] = per_edge * np.diff(edges[:, None] ** powers, axis=0) @ coefficients
        means[kind, :, 2] -= 1.0
        at_edges = powers * edges[:, None] ** (powers - 1)
        slopes[kind, :, cells] = per_edge * np.diff(at_edges, axis=0) @ coefficients
    return means, slopes


def kinds(position: IntArray, material: BoolArray, strides: tuple[int, ...]) -> IntArray:
    """Which stencil the cells at `position` in flattened local arrays take, (n, dimension).

    material -- (cells,) which cells hold material
    """
    found = np.zeros((len(position), len(strides)), dtype=np.int8)
    for axis, s in enumerate(strides):
        below, above = material[position - s], material[position + s]
        five = below & above & material[position - 2 * s] & material[position + 2 * s]
        found[below, axis] = LOWER
        found[above, axis] = UPPER
        found[below & above, axis] = THREE
        found[five, axis] = FIVE
    return found


def corners(position: IntArray, material: BoolArray, strides: tuple[int, ...]) -> BoolArray:
    """Whether the four cells diagonal to each hold material, for each pair of axes, (n, pairs).

    Pairs of axes a > b in the order (1, 0), (2, 0), (2, 1).
    """
    found = []
    for a, s in enumerate(strides):
        for t in strides[:a]:
            around = [material[position + i * s + j * t] for i in (-1, 1) for j in (-1, 1)]
            found.append(np.logical_and.reduce(around))
    return np.stack(found, axis=-1)
