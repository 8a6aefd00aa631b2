"""Face fluxes that change given fills exactly: the nearest to a solved velocity's.

With F0 the given fluxes through faces of wet area w, V0 and V1 the fills at the ends of an interval
dt,

    minimise  sum (F - F0)^2 / w    such that    div F = (V0 - V1)/dt    in every cell,

whose solution is F = F0 + w (lambda_lower - lambda_upper) with a weighted graph Laplacian for
lambda: conjugate gradients with algebraic multigrid, twice, so that the balance holds to round-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scaleup.contract import FloatArray, Grid, RunError
from scaleup.numerics import SymmetricSolver

_PASSES = 3
_EXACT = 1e-15  # of a cell's volume: what is missing beyond it is worth another pass
_BALANCED = 1e-12  # of a cell's volume, at most


@dataclass(frozen=True)
class Faces:
    """Faces between cells of a region: the cells below and above, by number in the region."""

    axis: NDArray[Any]
    lower: NDArray[Any]
    upper: NDArray[Any]
    cells: NDArray[Any]
    """Flat grid indices of the region, ascending."""

    @classmethod
    def between(cls, grid: Grid, region: NDArray[Any], open_faces: list[NDArray[Any]]) -> Faces:
        """Faces with ``open_faces`` (per axis, at each cell's lower face) between ``region`` cells.

        ``region`` and ``open_faces[axis]`` are flags with the grid's shape.
        """
        cells = np.flatnonzero(region)
        number = np.full(grid.cells, -1)
        number[cells] = np.arange(len(cells))
        axes, lowers, uppers = [], [], []
        stride = 1
        for axis in range(grid.dimension):
            upper = cells[open_faces[axis].reshape(-1)[cells]]
            below = number[upper - stride]
            inside = below >= 0
            lowers.append(below[inside])
            uppers.append(number[upper[inside]])
            axes.append(np.full(int(inside.sum()), axis))
            stride *= grid.counts[axis]
        return cls(*(np.concatenate(part) for part in (axes, lowers, uppers)), cells)

    def groups(self) -> tuple[int, NDArray[Any]]:
        """How many groups of cells hang together, and which one each cell is in."""
        n = len(self.cells)
        links = coo_matrix((np.ones(len(self.lower)), (self.lower, self.upper)), shape=(n, n))
        count, labels = connected_components(links, directed=False)
        return int(count), labels

    def outflow(self, flux: FloatArray) -> FloatArray:
        """Net outflow of each cell of the region, m^3/s."""
        n = len(self.cells)
        total: FloatArray = np.bincount(self.lower, flux, n) - np.bincount(self.upper, flux, n)
        return total


def balance(
    faces: Faces, start: FloatArray, end: FloatArray, capacity: FloatArray
) -> tuple[FloatArray, float]:
    """The fills at the end, such that each group of cells holds what it held; what that moved, m^3.

    What a group has gained is taken from its cells that are not full, in proportion to what they
    hold; what it has lost is added in proportion to their room.  All arrays are over the region.
    """
    fixed = end.copy()
    if len(fixed) == 0:
        return fixed, 0.0
    count, group = faces.groups()
    for _ in range(_PASSES):
        gained = np.bincount(group, fixed - start, count)[group]
        partly = (fixed > 0.0) & (fixed < capacity)
        give = np.where(gained > 0.0, fixed, capacity - fixed)
        some = np.where(partly, give, 0.0)
        enough = np.bincount(group, some, count)[group] > 2.0 * np.abs(gained)
        share = np.where(enough, some, give)
        whole = np.bincount(group, share, count)[group]
        fixed -= np.divide(gained * share, whole, out=np.zeros_like(whole), where=whole > 0.0)
        fixed = np.clip(fixed, 0.0, capacity)
    return fixed, float(np.abs(fixed - end).sum())


def closed_fluxes(
    faces: Faces, given: FloatArray, wet: FloatArray, demand: FloatArray, cell_rate: float
) -> FloatArray:
    """The fluxes (m^3/s) nearest to ``given`` whose outflow is ``demand`` (m^3/s) in every cell.

    ``cell_rate`` is a cell's volume over the interval, m^3/s: what the balance is measured against.
    Raises RunError where that cannot be.
    """
    n = len(faces.cells)
    flux = given.copy()
    if n == 0:
        return flux
    count, group = faces.groups()
    rows = np.concatenate([faces.lower, faces.upper, np.arange(n)])
    columns = np.concatenate([faces.upper, faces.lower, np.arange(n)])
    weight = wet / wet.max() if len(wet) else wet
    diagonal = np.bincount(faces.lower, weight, n) + np.bincount(faces.upper, weight, n)
    diagonal[np.unique(group, return_index=True)[1]] += 1e-3 * max(diagonal.max(), 1e-300)
    matrix = coo_matrix((np.concatenate([-weight, -weight, diagonal]), (rows, columns))).tocsr()
    solver = SymmetricSolver(matrix, 1e-9, "hypre")
    for _ in range(_PASSES):
        missing = demand - faces.outflow(flux)
        if np.abs(missing).max(initial=0.0) <= _EXACT * cell_rate:
            break
        missing -= (np.bincount(group, missing, count) / np.bincount(group, None, count))[group]
        potential, _ = solver.solve(missing)
        flux += weight * (potential[faces.lower] - potential[faces.upper])
    solver.close()
    missing = demand - faces.outflow(flux)
    if np.abs(missing).max() > _BALANCED * cell_rate:
        raise RunError(
            "the flow's fluxes could not be closed on the grid: a part of the bed gains or loses "
            f"{np.abs(missing).max() / cell_rate:.2g} cells in an interval; take larger cells"
        )
    return flux
