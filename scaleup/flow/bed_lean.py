"""How far a bed leans: the slope of the plane bed with the nearest centre of mass.

A bed that is filled up to a plane has, for each direction of that plane, one centre of mass; these
lie on a closed convex curve, the boundary of all that the vessel allows for the bed's volume. The
lean is the angle at which the bed's own centre of mass lies nearest to that curve, positive where
rotation lifts the bed: in a drum that of its centre of mass about the axis, in any other vessel
the mean slope of the surface.

Powder that is not sticky yields beyond its friction angle phi. What is steeper falls, and while it
falls the vessel turns on by about omega sqrt(R/g) = sqrt(Fr) rad. A bed that leans by more than

    phi + 45 deg + 2 sqrt(Fr) rad

hangs in the vessel. (The drum of `mohr-coulomb` has phi + 0.5 to 0.9 sqrt(Fr) from Fr = 0.003 to
0.07; 45 deg are what pockets behind plates may hold.)
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaleup.space.grid import FloatArray, Grid, IntArray
from scaleup.system.errors import RunError

_ACROSS = 64  # blocks of cells across the vessel
_DIRECTIONS = 720  # of planes, in a whole turn
_HELD = math.radians(45.0)
_FALLS = 2.0  # rad, over sqrt(Fr)


class LeanOfBed:
    """The lean of beds of one volume in one vessel.

    grid     -- of the flow; capacity -- m^3 of vessel in each of its cells, flat
    axis     -- of rotation; volume -- m^3 of bed
    """

    def __init__(self, grid: Grid, capacity: FloatArray, axis: Any, volume: float):
        self._grid = grid
        self._x = grid.centres(0) - axis.point[0]
        self._y = grid.centres(1) - axis.point[1]
        self._curve = self._plane_beds(capacity, volume)

    def of(
        self, moving: NDArray[Any], fill: FloatArray, resting: IntArray, held: FloatArray,
        phase: float,
    ) -> float:  # fmt: skip
        """Rad, of a bed that is given as flat cell indices with their fill, m^3.

        moving, resting -- two sets of cells; phase -- rad, by which the grid has turned
        """
        moments = np.zeros(2)
        for cells, volume in ((moving, fill), (resting, held)):
            row = cells // self._grid.counts[0]
            moments += (
                float(volume @ self._x[cells % self._grid.counts[0]]),
                float(volume @ self._y[row % self._grid.counts[1]]),
            )
        centre = moments / (fill.sum() + held.sum())
        nearest = int(((self._curve - centre) ** 2).sum(axis=1).argmin())
        lean = 2 * math.pi * nearest / _DIRECTIONS + phase
        return (lean + math.pi) % (2 * math.pi) - math.pi

    def _plane_beds(self, capacity: FloatArray, volume: float) -> FloatArray:
        """Centres of mass, m, of beds below planes that lean by k turns/_DIRECTIONS in the grid."""
        nx, ny = self._grid.counts[:2]
        flat = capacity.reshape(-1, ny, nx).sum(axis=0)
        block = math.ceil(max(nx, ny) / _ACROSS)
        held, x, y = (
            _blocks(values, block) for values in (flat, flat * self._x, flat * self._y[:, None])
        )
        some = held > 0
        held = held[some]
        x, y = x[some] / held, y[some] / held
        share = min(volume / held.sum(), 1.0)
        centres = np.empty((_DIRECTIONS, 2))
        for k in range(_DIRECTIONS):
            angle = 2 * math.pi * k / _DIRECTIONS
            order = np.argsort(y * math.cos(angle) - x * math.sin(angle))
            filled = np.clip(share * held.sum() - np.cumsum(held[order]) + held[order], 0.0, None)
            filled = np.minimum(filled, held[order])
            centres[k] = filled @ x[order], filled @ y[order]
        centres /= share * held.sum()
        return centres


def _blocks(values: FloatArray, size: int) -> FloatArray:
    """Sums over blocks of a 2-D array, flat."""
    rows, columns = (np.arange(0, n, size) for n in values.shape)
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1).ravel()


def require_held(lowest: float, highest: float, friction_angle: float, froude: float) -> None:
    """Raise RunError for a bed without cohesion that hangs in the vessel; leans in rad."""
    bound = friction_angle + _HELD + _FALLS * math.sqrt(froude)
    worst = max(highest, -lowest)
    if worst > bound:
        raise RunError(
            f"the flow is no result: its bed leans by {math.degrees(worst):.0f} deg, and powder of "
            f"this friction angle hangs at no more than {math.degrees(bound):.0f} deg at a Froude "
            f"number of {froude:.2g}; take another flow model, smaller cells or a simpler vessel"
        )
