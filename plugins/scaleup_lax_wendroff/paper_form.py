"""form "paper": Eq. 7-18 of Liu, Gonzalez & Wassgren 2018 exactly as printed.

With nu_x = [v_x + (D_xx,E - D_xx,W)/2] dt/dx and mu_x = D_xx dt/dx^2 (Eq. 8, 10, 17; likewise y),

    c' = c - nu_x D0x c - nu_y D0y c + (nu_x^2/2 + mu_x) d2x c + (nu_y^2/2 + mu_y) d2y c
           + nu_x nu_y D0x D0y c                                                       (Eq. 7)

Eq. 4 would need -dD_xx/dx where Eq. 8 and 17 have plus and no 1/dx; both are too small to see at
the paper's D. D_xy is left out, as there. First order in time where v varies; not conservative.
The outermost nodes of the bed take the value one node inward, and c is clipped to [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scaleup.api import BoolArray, FloatArray, Grid, IntArray
from scaleup_lax_wendroff.stencil import NE, NW, SE, SW, E, N, S, W

_PAD = 1  # cells beyond the grid's edge that neighbours may be looked for in
_INNER = (slice(_PAD, -_PAD), slice(_PAD, -_PAD))
_AROUND = [offset for offset in product((-1, 0, 1), repeat=2) if offset != (0, 0)]


@dataclass(frozen=True)
class Nodes:
    """Flat grid indices of the nodes, the cells that are at least half full.

    inner -- nodes with eight nodes around them: Eq. 7 holds there
    outer, source -- the other nodes beside an inner one, and the inner node that each copies
    """

    inner: IntArray
    outer: IntArray
    source: IntArray


def find_nodes(grid: Grid, cells: IntArray, fill: FloatArray) -> Nodes:
    """Nodes of a bed given by the fill (m^3, shape (n,)) of its active cells."""
    node = _padded(grid, cells, fill >= 0.5 * grid.cell_volume)
    inner = node.copy()
    for offset in _AROUND:
        inner &= _shifted(node, offset)
    beside = np.logical_or.reduce([_shifted(inner, offset) for offset in _AROUND])
    outer_at = np.stack(np.nonzero(node & ~inner & beside))
    step = _step_inward(inner)[:, outer_at[0], outer_at[1]]
    return Nodes(
        inner=np.flatnonzero(inner[_INNER]),
        outer=_flat(grid, outer_at),
        source=_flat(grid, outer_at + step),
    )


def courant_numbers(
    velocity: FloatArray, tensor: FloatArray, spacing: tuple[float, ...], dt: float
) -> tuple[FloatArray, FloatArray]:
    """Courant numbers nu (2, ...) of Eq. 8, 9 and mu (2, 2, ...) of Eq. 10, 11 on a local array."""
    nu = np.empty_like(velocity)
    mu = np.zeros_like(tensor)
    for axis in (0, 1):
        along = velocity.ndim - 2 - axis
        d = tensor[axis, axis]
        difference = 0.5 * (np.roll(d, -1, along) - np.roll(d, 1, along))
        nu[axis] = (velocity[axis] + difference) * dt / spacing[axis]
        mu[axis, axis] = d * dt / spacing[axis] ** 2
    return nu, mu


def weights(nu: FloatArray, mu: FloatArray) -> FloatArray:
    """Stencil weights of Eq. 7, (8, ...)."""
    result = np.empty((8, *nu.shape[1:]))
    for axis, (behind, ahead) in enumerate(((W, E), (S, N))):
        spread = 0.5 * nu[axis] ** 2 + mu[axis, axis]
        result[behind] = spread + 0.5 * nu[axis]
        result[ahead] = spread - 0.5 * nu[axis]
    cross = 0.25 * nu[0] * nu[1]
    result[NE] = result[SW] = cross
    result[NW] = result[SE] = -cross
    return result


def _step_inward(inner: BoolArray) -> IntArray:
    """Offset (rows y and x) to the inner node best aligned with the sum of offsets to all."""
    beside = {offset: _shifted(inner, offset) for offset in _AROUND}
    towards = [sum(offset[dim] * there for offset, there in beside.items()) for dim in (0, 1)]
    best = np.full(inner.shape, -np.inf)
    step = np.zeros((2, *inner.shape), dtype=np.int64)
    for offset, there in beside.items():
        alignment = (offset[0] * towards[0] + offset[1] * towards[1]) / np.hypot(*offset)
        better = there & (alignment > best)
        best[better] = alignment[better]
        for dim in (0, 1):
            step[dim][better] = offset[dim]
    return step


def _padded(grid: Grid, cells: IntArray, values: NDArray) -> NDArray:
    dense = np.zeros(grid.cells, dtype=values.dtype)
    dense[cells] = values
    return np.pad(dense.reshape(grid.shape), _PAD)


def _flat(grid: Grid, at: IntArray) -> IntArray:
    flat: IntArray = np.ravel_multi_index(tuple(at - _PAD), grid.shape)
    return flat


def _shifted(values: NDArray, offset: tuple[int, ...]) -> NDArray:
    """values[position + offset] at every position."""
    return np.roll(values, (-offset[0], -offset[1]), (0, 1))
