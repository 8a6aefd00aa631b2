"""Shifts of a surface at the vertices that give tetrahedra the volume they lack."""

from __future__ import annotations

from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .element_matrix import ElementMatrix
from .positive_system import PositiveSystem
from .shared_matrix import Numbering

# Missing volume, in cubes of the spread, that is none.
_ROUND_OFF = 1e-12
# Part of the square of the spread that ties vertices without surface to a number.
_TIE = 1e-9


class SpaceShifts:
    """Finds shifts s (m), outwards, that give back what elements lack, smoothed over a length.

    The equations of `vertex_shifts` in space: at each vertex v, over the elements T about it and
    their other vertices w,

        sum_T [ A_Tv s_v + spread^2/4 sum_w (s_v - s_w) ] = sum_T missing_T / 4,

    with A_Tv the integral of the vertex' linear function over the surface in the element, m^2.
    ``elements`` (n, 4) are vertices' local numbers.  Collective.
    """

    def __init__(self, mesh: Any, elements: NDArray[Any], spread: float) -> None:
        self._elements, self._spread = elements, spread
        self._numbering = Numbering(ngs.H1(mesh, order=1))
        self._matrix = ElementMatrix(elements, mesh.nv)
        self._system = PositiveSystem(self._matrix.share, self._numbering)

    def shifts(self, missing: NDArray[Any], areas: NDArray[Any]) -> NDArray[Any]:
        """At all vertices (n_vertices,), m; ``missing`` (n,) in m^3, ``areas`` (n, 4) in m^2."""
        tie = 0.25 * self._spread**2
        wanting = (np.abs(missing) > _ROUND_OFF * self._spread**3) | areas.any(axis=1)
        touched = self._numbering.touched
        near = touched(self._elements, wanting)[self._elements].any(axis=1)
        apart = ~touched(self._elements, near)[self._elements]
        blocks, corner = self._matrix.blocks, np.arange(4)
        blocks[:] = np.where(near, -tie, 0.0)[:, None, None]
        blocks[:, corner, corner] = np.where(near[:, None], areas + (3.0 + _TIE) * tie, tie * apart)
        self._system.update()
        shares = np.repeat(np.where(near, 0.25 * missing, 0.0), 4)
        wanted = np.bincount(self._elements.ravel(), shares, len(self._numbering.ids))
        return self._system.solve(wanted, np.zeros(len(wanted)))
