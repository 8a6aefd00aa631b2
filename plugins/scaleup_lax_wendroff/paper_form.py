"""form "paper": Eq. 7-18 of Liu, Gonzalez & Wassgren 2018 exactly as printed.

With nu_x = [v_x + (D_xx,E - D_xx,W)/2] dt/dx and mu_x = D_xx dt/dx^2 (Eq. 8, 10, 17; likewise y),

    c' = c - nu_x D0x c - nu_y D0y c + (nu_x^2/2 + mu_x) d2x c + (nu_y^2/2 + mu_y) d2y c
           + nu_x nu_y D0x D0y c                                                       (Eq. 7)

Eq. 4 would need -dD_xx/dx where Eq. 8 and 17 have plus and no 1/dx; both are too small to see at
the paper's D. D_xy is left out, as there. In 3-D the same with the third direction. First order in
time where v varies; not conservative. The outermost nodes of the bed take the value one node
inward, and c is clipped to [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray
from scaleup.numerics import ConservativeBed
from scaleup_lax_wendroff.stencil import neighbours

_PAD = 1  # cells beyond the grid's edge that neighbours may be looked for in


@dataclass(frozen=True)
class Nodes:
    """Flat grid indices of the nodes, the cells that are at least half full.

    inner -- nodes with nodes all around them (8, in 3-D 26): Eq. 7 holds there
    outer, source -- the other nodes beside an inner one, and the inner node that each copies
    """

    inner: IntArray
    outer: IntArray
    source: IntArray


def find_nodes(grid: Grid, cells: IntArray, fill: FloatArray) -> Nodes:
    """Nodes of a bed given by the fill (m^3, shape (n,)) of its active cells."""
    node = _padded(grid, cells, fill >= 0.5 * grid.cell_volume)
    inner = node.copy()
    for offset in _around(grid.dimension):
        inner &= _shifted(node, offset)
    within = np.pad(np.ones(grid.shape, dtype=bool), _PAD)
    inner &= within
    beside = np.logical_or.reduce([_shifted(inner, offset) for offset in _around(grid.dimension)])
    outer_at = np.stack(np.nonzero(node & ~inner & beside & within))
    step = _step_inward(inner)[:, *outer_at]
    return Nodes(
        inner=_flat(grid, np.stack(np.nonzero(inner))),
        outer=_flat(grid, outer_at),
        source=_flat(grid, outer_at + step),
    )


def courant_numbers(
    velocity: FloatArray, bed: ConservativeBed, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Courant numbers nu (d, cells) of Eq. 8, 9 and mu (d, d, cells) of Eq. 10, 11."""
    nu = np.empty_like(velocity)
    mu = np.zeros_like(bed.tensor)
    for axis, h in enumerate(bed.grid.spacing):
        d = bed.tensor[axis, axis]
        difference = 0.5 * (bed.shifted(d, axis, 1) - bed.shifted(d, axis, -1))
        nu[axis] = (velocity[axis] + difference) * dt / h
        mu[axis, axis] = d * dt / h**2
    return nu, mu


def weights(nu: FloatArray, mu: FloatArray) -> FloatArray:
    """Stencil weights of Eq. 7, (8 or 18, cells), in the order of `neighbours`."""
    offsets = neighbours(len(nu))
    result = np.empty((len(offsets), nu.shape[1]))
    for n, offset in enumerate(offsets):
        axes = [axis for axis, by in enumerate(offset) if by]
        if len(axes) == 1:
            a = axes[0]
            result[n] = 0.5 * nu[a] ** 2 + mu[a, a] - 0.5 * offset[a] * nu[a]
        else:
            a, b = axes
            result[n] = 0.25 * offset[a] * offset[b] * nu[a] * nu[b]
    return result


def _around(dimension: int) -> list[tuple[int, ...]]:
    return [offset for offset in product((-1, 0, 1), repeat=dimension) if any(offset)]


def _step_inward(inner: BoolArray) -> IntArray:
    """Offset (array order) to the inner node best aligned with the sum of offsets to all."""
    around = _around(inner.ndim)
    beside = {offset: _shifted(inner, offset) for offset in around}
    towards = [sum(o[dim] * there for o, there in beside.items()) for dim in range(inner.ndim)]
    best = np.full(inner.shape, -np.inf)
    step = np.zeros((inner.ndim, *inner.shape), dtype=np.int64)
    for offset, there in beside.items():
        along = sum(by * toward for by, toward in zip(offset, towards, strict=True))
        alignment = along / np.linalg.norm(offset)
        better = there & (alignment > best)
        best[better] = alignment[better]
        for dim, by in enumerate(offset):
            step[dim][better] = by
    return step


def _padded(grid: Grid, cells: IntArray, values: NDArray) -> NDArray:
    dense = np.zeros(grid.cells, dtype=values.dtype)
    dense[cells] = values
    mode = "wrap" if grid.periodic else "constant"
    return np.pad(dense.reshape(grid.shape), _PAD, mode=mode)  # type: ignore[call-overload]


def _flat(grid: Grid, at: IntArray) -> IntArray:
    flat: IntArray = np.ravel_multi_index(tuple(at - _PAD), grid.shape)
    return flat


def _shifted(values: NDArray, offset: tuple[int, ...]) -> NDArray:
    """values[position + offset] at every position."""
    return np.roll(values, tuple(-by for by in offset), tuple(range(values.ndim)))
