"""Volume fractions of cells cut by a level set.

A cell is split into simplices around its centre, the level set is taken as linear on each, and
the positive part of a simplex has a closed form. The fraction grows with every corner value, so a
bed clipped by `min(bed, vessel)` never holds more than the vessel does.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np
from scipy.optimize import brentq

from scaleup.space.grid import FloatArray, Grid, IntArray
from scaleup.system.errors import InputError


def cut_fraction(corner_values: FloatArray) -> FloatArray:
    """Fraction of each cell where the level set is positive, in [0, 1].

    corner_values -- level set at all cell corners, shape (*(shape + 1),), 2-D or 3-D
    Returns an array of the cells' shape. Second order in the spacing for a smooth level set.

    A disc of 100 mm on cells of 5 mm:

    >>> from scaleup.space.grid import grid_over
    >>> grid = grid_over((-0.05, -0.05), (0.05, 0.05), spacing=0.005, depth=0.01)
    >>> x, y = np.moveaxis(grid.corner_points(), -1, 0)
    >>> fraction = cut_fraction(0.05 - np.hypot(x, y))
    >>> fraction.shape == grid.shape, float(fraction.max())
    (True, 1.0)
    >>> round(fraction.sum() * grid.cell_volume / (np.pi * 0.05**2 * 0.01), 3)
    0.998
    """
    dimension = corner_values.ndim
    shape = tuple(n - 1 for n in corner_values.shape)
    corners = [
        corner_values[tuple(slice(o, o + n) for o, n in zip(offset, shape, strict=True))]
        for offset in product((0, 1), repeat=dimension)  # the last array axis, x, is fastest
    ]
    low = np.minimum.reduce(corners)
    high = np.maximum.reduce(corners)
    fraction: FloatArray = (low > 0).astype(float)
    cut = (low <= 0) & (high > 0)
    if cut.any():
        fraction[cut] = cut_fraction_of_cells(np.stack([v[cut] for v in corners], axis=-1))
    return fraction


def cut_fraction_of_cells(corners: FloatArray) -> FloatArray:
    """`cut_fraction` of single cells, shape (n,), from their corner values (n, 2^dimension).

    Corners are numbered with x fastest: corner 1 is that at greater x, corner 2 at greater y.
    """
    from scaleup.space.cut_kernel import fractions  # loads numba

    corners = np.ascontiguousarray(corners, dtype=float)
    cut: FloatArray = fractions(corners, *_tables(corners.shape[1].bit_length() - 1))
    return cut


@lru_cache(maxsize=2)
def _tables(dimension: int) -> tuple[IntArray, IntArray]:
    from scaleup.space.cut_kernel import lattice_corners, simplices

    if dimension not in (2, 3):
        raise ValueError(f"cells of dimension {dimension} cannot be cut; use 2 or 3")
    return lattice_corners(dimension), simplices(dimension)


def fill_to_volume(
    grid: Grid, bed: FloatArray, vessel: FloatArray, volume: float
) -> tuple[FloatArray, float]:
    """Fill of every cell for a bed whose level set is shifted until it holds `volume`.

    bed, vessel -- signed distances at all corners, m, positive inside, shape (*(shape + 1),)
    volume      -- m^3
    Returns (fill in m^3 with `grid.shape`, the shift in m); the total is `volume` to round-off.
    Raises InputError if the vessel cannot hold it.

    A level bed of 20 cm^3 in a drum's cross-section that holds 78:

    >>> from scaleup.space.grid import grid_over
    >>> grid = grid_over((-0.05, -0.05), (0.05, 0.05), spacing=0.005, depth=0.01)
    >>> x, y = np.moveaxis(grid.corner_points(), -1, 0)
    >>> fill, shift = fill_to_volume(grid, bed=-y, vessel=0.05 - np.hypot(x, y), volume=2e-5)
    >>> round(fill.sum() * 1e6, 9), round(shift, 4)  # cm^3; its surface is at y = shift
    (20.0, -0.0197)
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
