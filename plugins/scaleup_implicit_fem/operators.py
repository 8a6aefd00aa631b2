"""Finite elements on the face fluxes of a flow: what couples two cells, and how strongly.

Nodes are the centres of the cells; the elements are the squares between the centres of four cells
around a corner that are all full (in 3-D: those in the three coordinate planes), with bilinear
(Q1) shape functions. Galerkin's method with a flow free of divergence has a skew matrix N, whose
rows sum to zero, so that row i of N c is a sum of fluxes between pairs, N_ij (c_i + c_j): finite
elements are finite volumes with fluxes between diagonal neighbours too. Written so, they take the
flow's own face fluxes, keep mass to round-off whatever the solver's error, and can be limited.

Per cell i, with phi the fill fraction and all of it over a cell's volume,

    d(phi_i c_i)/dt = - sum_j [ q_ij (c_i + c_j)/2 + k_ij (c_i - c_j) + m_ij d(c_j - c_i)/dt ].

* q: the flux of the face between i and j. An element, whose two faces along a have the mean flux
  u_a, takes u_a/6 away from each of them and gives (u_a + u_b)/6 and (u_b - u_a)/6 to its two
  diagonals: what leaves each cell stays as it was, so that sum_j q_ij = div(flux)_i and a uniform
  c stays uniform. On a uniform flow this is the Galerkin matrix of Q1. Where the flow turns, a
  twelfth of the difference of the faces' fluxes goes around the element, which is Galerkin's in
  rigid rotation, and half of it in shear (the other half would not keep a uniform c uniform).
* m: the element's consistent mass, 1/18 along its edges and 1/36 along its diagonals; 1/72 and
  1/36 in 3-D, where the product of three second differences is left out (the matrix stays positive
  definite, with a condition number of 4). Mass and flux together leave a phase error of fourth
  order on a uniform flow and in rigid rotation, and second order where the flow strains.
* k: D_nn aperture/h^2 across a face; D_ab/(2 h_a h_b) along one diagonal and its negative along the
  other, the exact form of the mixed derivatives with the element's mean gradient. That one is taken
  wherever four cells hold material.

The low order takes the same fluxes q upwind, those of the diagonals too, and leaves out mass and
mixed derivatives: its implicit matrix is one of positive type (an M-matrix). What the high order
adds to it is then proportional to differences of c. (Upwind through the faces alone, it lacks a
circulation between faces and diagonals, as great in a uniform c as elsewhere: the limiter takes
that for antidiffusion, and runs out of passes before what matters is put back.)

Pairs with a cell that is empty at one end of the interval take the flux upwind in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from scaleup.contract import BoolArray, FloatArray, Grid, IntArray, Interval

EMPTY = 1e-14  # fill fraction at which a cell counts as empty
_AXIS_MASS = {2: 1 / 18, 3: 1 / 72}
_DIAGONAL_MASS = 1 / 36


@dataclass(frozen=True)
class Pairs:
    """Pairs of unknowns; what goes from the first to the second, over a cell's volume.

    first, second -- numbers of the unknowns, (pairs,)
    high, low -- (2, pairs), 1/s: times the first's and the second's concentration, summed
    mass      -- (pairs,): times what the second gains in a step more than the first
    smooth    -- (pairs,) faces between two cells that are full all the time
    """

    first: IntArray
    second: IntArray
    high: FloatArray
    low: FloatArray
    mass: FloatArray
    smooth: BoolArray


def find_pairs(
    grid: Grid,
    interval: Interval,
    tensor: FloatArray,
    number: IntArray,
    whole: BoolArray,
    base: IntArray,
) -> Pairs:
    """The pairs of cells that the lower faces and lower corners of the `base` cells hold.

    tensor -- (dimension, dimension, n), m^2/s
    number -- (n,) unknown of each of the interval's cells, -1 where nothing moves
    whole  -- (n,) cells that are full all the time and an unknown of their own
    base   -- positions in the interval's cells; all corners that touch a face must be among them
              for its pair to be right
    """
    dimension, n, h = grid.dimension, len(number), grid.spacing
    neighbours = _Neighbours(grid, interval.cells)
    start = interval.fill_start / grid.cell_volume
    end = interval.fill_end / grid.cell_volume
    through = interval.flux / grid.cell_volume
    flux, mass = through.copy(), np.zeros((dimension, n))
    diagonals = []
    for a, b in combinations(range(dimension), 2):
        below_a, below_b = neighbours.below(base, a), neighbours.below(base, b)
        there = (below_a >= 0) & (below_b >= 0)
        corner = np.stack([base, below_a, below_b])[:, there]
        corner = np.concatenate([corner, neighbours.below(corner[1], b)[None]])
        corner = corner[:, (corner[3] >= 0) & (number[corner] >= 0).all(axis=0)]
        element = whole[corner].all(axis=0)
        here, behind_a, behind_b, behind_both = corner
        u_a = np.where(element, 0.5 * (through[a, here] + through[a, behind_b]), 0.0) / 6
        u_b = np.where(element, 0.5 * (through[b, here] + through[b, behind_a]), 0.0) / 6
        edge_mass = np.where(element, _AXIS_MASS[dimension], 0.0)
        for axis, gone, cells in ((a, u_a, (here, behind_b)), (b, u_b, (here, behind_a))):
            for face in cells:
                flux[axis, face] -= gone
                mass[axis, face] += edge_mass
        turn = through[a, here] - through[a, behind_b] - through[b, here] + through[b, behind_a]
        turn = np.where(element, turn, 0.0) / 12
        flux[a, behind_b] += turn
        flux[a, here] -= turn
        flux[b, here] += turn
        flux[b, behind_a] -= turn
        mixed = tensor[a, b][corner].mean(axis=0) * start[corner].min(axis=0) / (2 * h[a] * h[b])
        diagonal_mass = np.where(element, _DIAGONAL_MASS, 0.0)
        used = element | (mixed != 0)
        for from_, to, q, k in (
            (behind_both, here, u_a + u_b, mixed),
            (behind_a, behind_b, u_a - u_b, -mixed),
        ):
            none = np.zeros_like(q)
            parts = (from_, to, q, k, none, diagonal_mass, none)
            diagonals.append([part[used] for part in parts])
    faces = []
    for axis in range(dimension):
        below = neighbours.below(base, axis)
        here, behind = base[below >= 0], below[below >= 0]
        mean = 0.5 * (tensor[axis, axis, here] + tensor[axis, axis, behind])
        k = mean * np.minimum(start[here], start[behind]) / h[axis] ** 2
        faces.append(
            [
                behind, here, flux[axis, here], k, k, mass[axis, here],
                whole[here] & whole[behind],
            ]
        )  # fmt: skip
    joined = [np.concatenate(parts) for parts in zip(*faces, *diagonals, strict=True)]
    first, second = joined[:2]
    coupled = (number[first] >= 0) & (number[second] >= 0) & (number[first] != number[second])
    first, second, q, k, k_low, m, smooth = (part[coupled] for part in joined)
    fills = (start <= EMPTY) | (end <= EMPTY)
    blunt = fills[first] | fills[second]
    low = np.stack([np.maximum(q, 0) + k_low, np.minimum(q, 0) - k_low])
    high = np.stack([0.5 * q + k, 0.5 * q - k])
    return Pairs(number[first], number[second], np.where(blunt, low, high), low, m, smooth > 0)


def rows_of(pairs: Pairs, weights: FloatArray, count: int, columns: int) -> csr_matrix:
    """The first `count` rows of the matrix that sums what leaves every unknown through its pairs.

    weights -- (2, pairs), as `Pairs.high`
    """
    rows = np.concatenate([pairs.first, pairs.first, pairs.second, pairs.second])
    cols = np.concatenate([pairs.first, pairs.second, pairs.first, pairs.second])
    values = np.concatenate([weights[0], weights[1], -weights[0], -weights[1]])
    mine = rows < count
    entries = (values[mine], (rows[mine], cols[mine]))
    return coo_matrix(entries, shape=(count, columns)).tocsr()


def times(rows: csr_matrix, c: FloatArray) -> FloatArray:
    """Rows of a matrix times each component of c."""
    return np.stack([rows @ component for component in c])


class _Neighbours:
    """Which of a list of cells lies below which."""

    def __init__(self, grid: Grid, cells: IntArray):
        self._grid, self._cells = grid, cells
        self._where = np.full(grid.cells, -1, dtype=np.int64)
        self._where[cells] = np.arange(len(cells))

    def below(self, positions: IntArray, axis: int) -> IntArray:
        """Positions of the lower neighbours along an axis, or -1."""
        grid = self._grid
        index = list(np.unravel_index(self._cells[positions], grid.shape))
        dim = grid.array_axis(axis)
        lower = index[dim] - 1
        index[dim] = lower % grid.shape[dim]
        result = self._where[np.ravel_multi_index(tuple(index), grid.shape)]
        return result if grid.periodic else np.where(lower >= 0, result, -1)
