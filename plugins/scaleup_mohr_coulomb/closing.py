"""Face fluxes that change given fills exactly: the nearest to a solved velocity's.

Through faces of wet area w the change of a flux counts as 1/w (`scaleup.numerics.nearest_fluxes`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaleup.contract import FloatArray, Grid, RunError
from scaleup.numerics import Faces, multigrid, nearest_fluxes

_PASSES = 3
_SOLVED = 1e-9  # residual of the correction over what is to be corrected
_BALANCED = 1e-12  # of a cell's volume, at most


@dataclass(frozen=True)
class GridFaces(Faces):
    """Faces between cells of a region of a grid."""

    axis: NDArray[Any]
    """Normal to each face."""
    cells: NDArray[Any]
    """Flat grid indices of the region, ascending."""

    @classmethod
    def between(cls, grid: Grid, region: NDArray[Any], open_faces: list[NDArray[Any]]) -> GridFaces:
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
        lower, upper, normal = (np.concatenate(part) for part in (lowers, uppers, axes))
        return cls(len(cells), lower, upper, normal, cells)

    def groups(self) -> tuple[int, NDArray[Any]]:
        """How many groups of cells hang together, and which one each cell is in."""
        return len(self.tree.roots), self.tree.part


def balance(
    faces: GridFaces, start: FloatArray, end: FloatArray, capacity: FloatArray
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
    faces: GridFaces, given: FloatArray, wet: FloatArray, demand: FloatArray, cell_rate: float
) -> FloatArray:
    """The fluxes (m^3/s) nearest to ``given`` whose outflow is ``demand`` (m^3/s) in every cell.

    ``cell_rate`` is a cell's volume over the interval, m^3/s: what the balance is measured against.
    Raises RunError where that cannot be.
    """
    if faces.count == 0:
        return given.copy()
    weight, solver = wet / wet.max(initial=1e-300), multigrid(_SOLVED, "hypre")
    flux, _ = nearest_fluxes(faces, given, weight, demand, solver, "again")
    missing = np.abs(faces.missing(demand, flux)).max()
    if missing > _BALANCED * cell_rate:
        raise RunError(
            "the flow's fluxes could not be closed on the grid: a part of the bed gains or loses "
            f"{missing / cell_rate:.2g} cells in an interval; take larger cells"
        )
    return flux
