"""Fluxes between neighbours that bring cells from the volume laid down in them to their fill.

Sub-cells of finite size fill the cells to some parts in a hundred. The rest R flows between
neighbours, through the faces that are open: the least psi with div psi = R
(`scaleup.numerics.nearest_fluxes`), its potential solved for loosely. Content goes with it at the
concentration of the cell that it leaves,

    c_i (v_i + inflow_i) = m_i + sum over inflowing faces of psi c_upstream,

swept in the order of the potential: c_i is a mean of values in [0, 1] whatever psi is, and what one
cell loses another gets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray
from scaleup.numerics import Faces, lattice_gradients, nearest_fluxes

_TOLERANCE = 1e-4  # of the residual, in the mean
_SETTLED = 1e-15  # change of a concentration in a sweep
_SWEEPS = 50


@dataclass(frozen=True)
class Settlement:
    """Fluxes over the volume of a cell, through the lower faces (dimension, m), and their order.

    order -- the cells from the highest potential down, (m,)
    """

    flux: FloatArray
    order: IntArray


def settle(
    below: IntArray, above: IntArray, coordinates: IntArray, laid: FloatArray, fill: FloatArray
) -> tuple[Settlement, IntArray]:
    """From the laid volumes to the fills, both (m,) and fractions of a cell's volume.

    coordinates -- (m, dimension) whole numbers of the cells along the axes
    Also returns which connected part of the moving cells each is in, (m,), from 0.
    """
    rows, upper = np.nonzero(below >= 0)
    faces = Faces(below.shape[1], below[rows, upper], upper)
    none, one = np.zeros(len(upper)), np.ones(len(upper))
    solver = lattice_gradients(below, above, coordinates, _TOLERANCE)
    through, potential = nearest_fluxes(faces, none, one, laid - fill, solver, "tree")
    flux = np.zeros(below.shape)
    flux[rows, upper] = through
    order = np.argsort(-potential, kind="stable").astype(np.int32)
    return Settlement(flux, order), faces.tree.part


@numba.njit(cache=True)
def carry(
    c: FloatArray,
    content: FloatArray,
    laid: FloatArray,
    below: IntArray,
    above: IntArray,
    flux: FloatArray,
    order: IntArray,
) -> None:
    """Concentrations c (components, m) from the laid contents and volumes, as stated above.

    A cell without material, and without inflow, keeps its value. After the first sweep only those
    are swept again that something upstream has changed for.
    """
    dimension, m = below.shape
    waits = np.empty(m, dtype=np.bool_)
    for q in range(c.shape[0]):
        for i in range(m):
            if laid[i] > 0.0:
                c[q, i] = content[q, i] / laid[i]
        waits[:] = True
        for _ in range(_SWEEPS):
            settled = True
            for n in range(m):
                i = order[n]
                if not waits[i]:
                    continue
                waits[i] = False
                held, volume, leaves = content[q, i], laid[i], False
                for axis in range(dimension):
                    j, k = below[axis, i], above[axis, i]
                    if j >= 0:
                        through = flux[axis, i]
                        if through > 0.0:
                            held += through * c[q, j]
                            volume += through
                        else:
                            leaves |= through < 0.0
                    if k >= 0:
                        through = flux[axis, k]
                        if through < 0.0:
                            held -= through * c[q, k]
                            volume -= through
                        else:
                            leaves |= through > 0.0
                if volume <= 0.0:
                    continue
                value = held / volume
                changed = abs(value - c[q, i]) > _SETTLED
                c[q, i] = value
                if not (changed and leaves):
                    continue
                for axis in range(dimension):
                    j, k = below[axis, i], above[axis, i]
                    if j >= 0 and flux[axis, i] < 0.0:
                        waits[j] = True
                        settled = False
                    if k >= 0 and flux[axis, k] > 0.0:
                        waits[k] = True
                        settled = False
            if settled:
                break


@numba.njit(cache=True)
def bounds(c: FloatArray, holds: BoolArray) -> tuple[float, float]:
    """Least and greatest of all components, the last included, in the flagged cells."""
    low, high = np.inf, -np.inf
    for i in range(c.shape[1]):
        if not holds[i]:
            continue
        rest = 1.0
        for q in range(c.shape[0]):
            value = c[q, i]
            rest -= value
            low, high = min(low, value), max(high, value)
        low, high = min(low, rest), max(high, rest)
    return low, high
