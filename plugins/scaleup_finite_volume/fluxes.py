"""What goes through the faces: the high-order flux of a component.

Through the lower face of a cell (normal along axis a, cells -3 .. 2 along it, the face between -1
and 0) goes in dt, as a share of the volume of a cell, with nu = flux dt over that volume,

    nu (37 (c_-1 + c_0) - 8 (c_-2 + c_1) + (c_-3 + c_2))/60
    - |nu| (10 (c_0 - c_-1) - 5 (c_1 - c_-2) + (c_2 - c_-3))/60        (upwind-biased, fifth order)
    - kappa dt (15 (c_0 - c_-1) - (c_1 - c_-2))/12                     (diffusion, fourth order)
    + sum over transverse axes b of chi_b dt (c_-1,b+ + c_0,b+ - c_-1,b- - c_0,b-)

with kappa = D_aa/h_a^2 and chi_b = -D_ab/(4 h_a h_b) + [flux(b+) - flux(b-)]/96. The last term is
the difference between the mean over the face of v c and the product of their means, h_b^2/12
(dv/db)(dc/db): without it the scheme would be second order wherever the flow shears.

Faces whose stencil is not all full cells (beside cut cells) take the third-order upwind value
(2 c_down + 5 c_up - c_upup)/6 where those three hold material, else c_up; diffusion by the smaller
fill fraction beside the face; no transverse term unless all its cells hold material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.contract import FloatArray, IntArray
from scaleup.numerics import ConservativeBed


@dataclass(frozen=True)
class Faces:
    """Faces of an interval of the flow that take part in a step, of one rank.

    cross   -- (transverse axes, dimension, cells) chi, 1/s; row t of axis a belongs to the t-th
               other axis
    special -- (2, faces) axis and position of faces that the high-order stencil does not serve
    weights -- (4, faces) weights of c_-2 .. c_1 in the value at a special face
    """

    cross: FloatArray
    special: IntArray
    weights: FloatArray


def find_faces(bed: ConservativeBed) -> Faces:
    """Sort the faces of a settled bed into regular and special ones."""
    dimension = bed.grid.dimension
    cross = np.zeros((dimension - 1, dimension, bed.full.size))
    x, y, *z = bed.strides
    state = bed.full.astype(np.int8) + bed.holds.astype(np.int8)  # 2 full, 1 holds some, 0 nothing
    places, weights = _sort(
        cross, bed.flux, bed.spread, bed.tensor, state, bed.face_runs,
        (x, y, z[0] if z else 0), np.array(bed.grid.spacing),
    )  # fmt: skip
    return Faces(cross, places, weights)


@numba.njit(cache=True)
def _sort(
    cross: FloatArray,
    flux: FloatArray,
    spread: FloatArray,
    tensor: FloatArray,
    state: IntArray,
    runs: IntArray,
    strides: tuple[int, int, int],
    h: FloatArray,
) -> tuple[IntArray, FloatArray]:
    """Fill chi (see `Faces.cross`) and return the special faces and their weights."""
    dimension = flux.shape[0]
    axes, places = [0 for _ in range(0)], [0 for _ in range(0)]
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            for axis in range(dimension):
                if flux[axis, k] == 0.0 and spread[axis, k] == 0.0:
                    continue
                s, row = strides[axis], 0
                both_full = state[k] == 2 and state[k - s] == 2
                for other in range(dimension):
                    if other == axis:
                        continue
                    if both_full:
                        cross[row, axis, k] = _chi(
                            flux, tensor, state, k, s, strides[other], axis, other, h
                        )
                    row += 1
                smooth = both_full and state[k - 3 * s] == 2 and state[k - 2 * s] == 2
                if not (smooth and state[k + s] == 2 and state[k + 2 * s] == 2):
                    axes.append(axis)
                    places.append(k)
    special = np.empty((2, len(axes)), dtype=np.int64)
    weights = np.zeros((4, len(axes)))
    for i in range(len(axes)):
        axis, k = axes[i], places[i]
        s = strides[axis]
        special[0, i], special[1, i] = axis, k
        up, down, beyond = (1, 2, 0) if flux[axis, k] > 0.0 else (2, 1, 3)
        there = state[k + (beyond - 2) * s] > 0 and state[k] > 0 and state[k - s] > 0
        weights[up, i] = 5 / 6 if there else 1.0
        if there:
            weights[down, i], weights[beyond, i] = 2 / 6, -1 / 6
    return special, weights


@numba.njit(inline="always")
def _chi(
    flux: FloatArray,
    tensor: FloatArray,
    state: IntArray,
    k: int,
    s: int,
    t: int,
    axis: int,
    other: int,
    h: FloatArray,
) -> float:
    """Chi of the lower face of cell k normal to `axis`, for the transverse axis `other`, 1/s."""
    around = min(min(state[k + t], state[k - t]), min(state[k - s + t], state[k - s - t]))
    if around == 0:
        return 0.0
    chi = -0.5 * (tensor[axis, other, k] + tensor[axis, other, k - s]) / (4 * h[axis] * h[other])
    if around == 2:
        chi += (flux[axis, k + t] - flux[axis, k - t]) / 96
    return chi


def high_order(
    out: FloatArray, c: FloatArray, bed: ConservativeBed, faces: Faces, dt: float
) -> None:
    """Fluxes of a component through the faces in dt; out (dimension, cells)."""
    x, y, *z = bed.strides
    s = (x, y, z[0] if z else 0)
    _regular(out, c, bed.flux, bed.spread, faces.cross, dt, bed.face_runs, s)
    _special(out, c, bed.flux, bed.spread, faces.cross, dt, faces.special, faces.weights, s)


@numba.njit(cache=True, fastmath={"contract"})
def _regular(
    out: FloatArray,
    c: FloatArray,
    flux: FloatArray,
    spread: FloatArray,
    cross: FloatArray,
    dt: float,
    runs: IntArray,
    strides: tuple[int, int, int],
) -> None:
    # Views made once that start m before a cell, and unsigned indices: no index can be negative, so
    # the inner loops are vectorised, and a short run costs little.
    sixtieth, twelfth = dt / 60, dt / 12
    for axis in range(out.shape[0]):
        s, t = strides[axis], strides[1 if axis == 0 else 0]
        m = 3 * s + t
        f, v, g, x = out[axis, m:], flux[axis, m:], spread[axis, m:], cross[0, axis, m:]
        c0, c1, c2 = c[m - 3 * s :], c[m - 2 * s :], c[m - s :]
        c3, c4, c5 = c[m:], c[m + s :], c[m + 2 * s :]
        up, up_behind, down, down_behind = c[m + t :], c[m + t - s :], c[m - t :], c[m - t - s :]
        for r in range(runs.shape[0]):
            a, b = numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)
            for k in range(a, b):
                near, wide, widest = c3[k] - c2[k], c4[k] - c1[k], c5[k] - c0[k]
                centred = 37 * (c2[k] + c3[k]) - 8 * (c1[k] + c4[k]) + (c0[k] + c5[k])
                across = up_behind[k] + up[k] - down_behind[k] - down[k]
                f[k] = (
                    sixtieth * (v[k] * centred - abs(v[k]) * (10 * near - 5 * wide + widest))
                    - twelfth * g[k] * (15 * near - wide)
                    + dt * x[k] * across
                )
        if strides[2] != 0:
            t = strides[1 if axis == 2 else 2]
            m = s + t
            f, x = out[axis, m:], cross[1, axis, m:]
            up, up_behind, down, down_behind = (
                c[m + t :],
                c[m + t - s :],
                c[m - t :],
                c[m - t - s :],
            )
            for r in range(runs.shape[0]):
                a, b = numba.uint64(runs[r, 0] - m), numba.uint64(runs[r, 1] - m)
                for k in range(a, b):
                    f[k] += dt * x[k] * (up_behind[k] + up[k] - down_behind[k] - down[k])


@numba.njit(cache=True)
def _special(
    out: FloatArray,
    c: FloatArray,
    flux: FloatArray,
    spread: FloatArray,
    cross: FloatArray,
    dt: float,
    faces: IntArray,
    weights: FloatArray,
    strides: tuple[int, int, int],
) -> None:
    for i in range(faces.shape[1]):
        axis, k = faces[0, i], faces[1, i]
        s = strides[axis]
        value = weights[0, i] * c[k - 2 * s] + weights[1, i] * c[k - s]
        value += weights[2, i] * c[k] + weights[3, i] * c[k + s]
        total = flux[axis, k] * value - spread[axis, k] * (c[k] - c[k - s])
        row = 0
        for other in range(out.shape[0]):
            if other != axis:
                t = strides[other]
                across = c[k + t - s] + c[k + t] - c[k - t - s] - c[k - t]
                total += cross[row, axis, k] * across
                row += 1
        out[axis, k] = dt * total
