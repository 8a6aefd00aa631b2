"""Volume fractions of cells cut by a level set.

A cell is split into simplices around its centre, the level set is taken as linear on each, and
the positive part of a simplex has a closed form. The fraction grows with every corner value, so a
bed clipped by `min(bed, vessel)` never holds more than the vessel does.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from scipy.optimize import brentq

from scaleup.errors import InputError
from scaleup.grid import FloatArray, Grid


def cut_fraction(corner_values: FloatArray) -> FloatArray:
    """Fraction of each cell where the level set is positive, in [0, 1].

    corner_values -- level set at all cell corners, shape (*(shape + 1),), 2-D or 3-D
    Returns an array of the cells' shape. Second order in the spacing for a smooth level set.
    """
    dimension = corner_values.ndim
    shape = tuple(n - 1 for n in corner_values.shape)
    corners = {
        offset: corner_values[tuple(slice(o, o + n) for o, n in zip(offset, shape, strict=True))]
        for offset in product((0, 1), repeat=dimension)
    }
    low = np.minimum.reduce(list(corners.values()))
    high = np.maximum.reduce(list(corners.values()))
    fraction: FloatArray = (low > 0).astype(float)
    cut = (low <= 0) & (high > 0)
    if not cut.any():
        return fraction
    at_corner = {offset: values[cut] for offset, values in corners.items()}
    total = np.zeros(int(cut.sum()))
    simplices = _simplices(dimension)
    for simplex in simplices:
        vertices = [np.mean([at_corner[o] for o in group], axis=0) for group in simplex]
        total += _positive_share(np.stack(vertices))
    fraction[cut] = total / len(simplices)
    return fraction


def fill_to_volume(
    grid: Grid, bed: FloatArray, vessel: FloatArray, volume: float
) -> tuple[FloatArray, float]:
    """Fill of every cell for a bed whose level set is shifted until it holds `volume`.

    bed, vessel -- signed distances at all corners, m, positive inside, shape (*(shape + 1),)
    volume      -- m^3
    Returns (fill in m^3 with `grid.shape`, the shift in m); the total is `volume` to round-off.
    Raises InputError if the vessel cannot hold it.
    """
    capacity = float(cut_fraction(vessel).sum() * grid.cell_volume)
    if not 0 < volume <= capacity:
        raise InputError(f"a fill of {volume:.4g} m^3 does not fit a vessel of {capacity:.4g} m^3")

    def fill(shift: float) -> FloatArray:
        whole: FloatArray = cut_fraction(np.minimum(bed + shift, vessel)) * grid.cell_volume
        return whole

    high = -float(bed.min())
    if fill(high).sum() > volume:
        low = -float(bed.max())
        last_float = 4e-16 * max(abs(low), abs(high))
        high = brentq(
            lambda shift: fill(shift).sum() - volume, low, high, xtol=last_float, rtol=1e-15
        )
    result = fill(high)
    # The root is known to its last digits; what is left is a rounding of the sum.
    return np.minimum(result * (volume / result.sum()), grid.cell_volume), high


def _simplices(dimension: int) -> list[list[list[tuple[int, ...]]]]:
    """Simplices of the unit cube, each vertex the mean of a face of it (a list of corners)."""
    if dimension not in (2, 3):
        raise ValueError(f"cells of dimension {dimension} cannot be cut; use 2 or 3")
    every = list(product((0, 1), repeat=dimension))
    result = []
    for order in permutations(range(dimension)):
        for signs in every:
            # centre of the cell -> of a facet -> ... -> a corner: the barycentric subdivision
            fixed: dict[int, int] = {}
            flag = [every]
            for axis in order:
                fixed[axis] = signs[axis]
                flag.append([c for c in every if all(c[a] == s for a, s in fixed.items())])
            result.append(flag)
    return result


def _positive_share(values: FloatArray) -> FloatArray:
    """Share of a simplex where the linear function with the given vertex values is positive.

    values -- shape (dimension + 1, n). The part cut off at vertex a is the product over the other
    vertices b of a/(a - b); two positive vertices of a tetrahedron use the difference of two such.
    """
    v = np.sort(values, axis=0)[::-1]
    tiny = 1e-300
    n_vertices = len(v)
    positive = (v > 0).sum(axis=0)

    def corner(i: int) -> FloatArray:
        share = np.ones(v.shape[1])
        with np.errstate(over="ignore"):  # where v[i] == v[j] the share is not used
            for j in range(n_vertices):
                if j != i:
                    share *= v[i] / np.where(v[i] == v[j], tiny, v[i] - v[j])
        return share

    share = np.where(positive == n_vertices, 1.0, 0.0)
    one = positive == 1
    share[one] = corner(0)[one]
    last = (positive == n_vertices - 1) & (positive > 1)
    share[last] = 1.0 - corner(n_vertices - 1)[last]
    if n_vertices == 4:
        two = positive == 2
        share[two] = _two_positive(v[:, two])
    clipped: FloatArray = np.clip(share, 0.0, 1.0)
    return clipped


def _two_positive(v: FloatArray) -> FloatArray:
    """Positive share of a tetrahedron with values a >= b > 0 >= c >= d.

    The wedge is cut into three tetrahedra along its edges; written without the difference a - b,
    which may vanish.
    """
    a, b, c, d = v
    ac, ad, bc, bd = a / (a - c), a / (a - d), b / (b - c), b / (b - d)
    # vertices A, B, and the cuts on AC, AD, BC, BD: tets (A,B,bc,bd), (A,ac,ad,bd), (A,ac,bc,bd)
    share: FloatArray = bc * bd + ac * ad * (1 - bd) + ac * bd * (1 - bc)
    return share
