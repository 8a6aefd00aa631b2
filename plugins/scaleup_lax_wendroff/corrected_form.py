"""The Taylor-Lax-Wendroff scheme in flux form: form "corrected", and the high-order part of
form "flux-corrected".

Through the face between cells m and p (normal along axis a) the flux (share nu = F dt/V of a cell's
volume in a step) carries the mean over the step of c at the face, c + dt/2 c_t with
c_t = -v.grad c:

    c_f = (c_m + c_p)/2 - nu/2 (c_p - c_m) - sum over the other axes b of nu_b/8 T_b,
    T_b = c_m,b+ + c_p,b+ - c_m,b- - c_p,b-,  nu_b = v_b dt/h_b,

and diffusion takes D_aa dt/h_a^2 (c_m - c_p) - D_ab dt/(4 h_a h_b) T_b. Each cell gains what its
neighbour loses and fills follow the same fluxes, so mass is kept to round-off, on moving fills too.

For uniform v and D the stencil is that of Eq. 7 with the sign of Eq. 8 and the 1/dx of Eq. 17
mended and D_xy kept, so its stability limit is the same. Where v varies, the flux form holds the
term -dt/2 (v.grad) v that Eq. 7 lacks, and the scheme is second order in space and time for D = 0.
(With D > 0 terms of order D dt remain.)

Faces of cut cells are treated upwind, c_f = c of the cell that the flux comes from, with D_aa on
the smaller fill fraction beside the face; cut cells that hold little are merged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from scaleup.contract import FloatArray, IntArray
from scaleup.numerics import ConservativeBed
from scaleup_lax_wendroff.stencil import Offset, neighbours


@dataclass(frozen=True)
class FaceCoefficients:
    """What a step of dt takes through the lower faces, in shares of a cell's volume.

    behind, here -- (dimension, cells): the flux is behind c_m + here c_p + sum_b twist_b T_b
    twist -- (other axes, dimension, cells); row t of axis a belongs to the t-th other axis
    """

    behind: FloatArray
    here: FloatArray
    twist: FloatArray


def courant_numbers(bed: ConservativeBed, dt: float) -> tuple[FloatArray, FloatArray]:
    """(nu of the greater of a cell's two faces, (d, cells); mu, (d, d, cells))."""
    low = np.abs(bed.flux)
    nu = dt * np.stack(
        [np.maximum(low[a], bed.shifted(low[a], a, 1)) for a in range(bed.grid.dimension)]
    )
    h = np.array(bed.grid.spacing)
    return nu, bed.tensor * dt / (h[:, None] * h[None, :])[:, :, None]


def coefficients(bed: ConservativeBed, dt: float) -> FaceCoefficients:
    """Coefficients of a settled bed; right wherever two layers of neighbours are there."""
    dimension, h = bed.grid.dimension, bed.grid.spacing
    behind, here = np.empty_like(bed.flux), np.empty_like(bed.flux)
    twist = np.zeros((dimension - 1, *bed.flux.shape))
    for a in range(dimension):
        others = [b for b in range(dimension) if b != a]
        beside = np.ones_like(bed.holds)
        for b in others:
            around = bed.holds & bed.shifted(bed.holds, b, 1) & bed.shifted(bed.holds, b, -1)
            beside &= around & bed.shifted(around, a, -1)
        smooth = bed.full & bed.shifted(bed.full, a, -1) & beside
        nu, spread = bed.flux[a] * dt, bed.spread[a] * dt
        share = np.where(smooth, 0.5 * (1.0 + nu), (nu > 0).astype(float))
        behind[a] = nu * share + spread
        here[a] = nu * (1.0 - share) - spread
        passes = smooth & ((bed.flux[a] != 0) | (bed.spread[a] != 0))
        for row, b in enumerate(others):
            across = bed.flux[b] + bed.shifted(bed.flux[b], b, 1)
            across = 0.25 * dt * (across + bed.shifted(across, a, -1))
            mixed = 0.5 * (bed.tensor[a, b] + bed.shifted(bed.tensor[a, b], a, -1))
            both = -nu * across / 8 - mixed * dt / (4 * h[a] * h[b])
            twist[row, a] = np.where(passes, both, 0.0)
    return FaceCoefficients(behind, here, twist)


def weights(bed: ConservativeBed, dt: float) -> FloatArray:
    """Stencil weights for a step, (8 or 18, cells), in the order of `neighbours`.

    The cell's own concentration is the reference: a weight multiplies c_k - c. Those of a cut cell
    are shares of a whole cell, still to be divided by what it holds.
    """
    dimension, faces = bed.grid.dimension, coefficients(bed, dt)
    place = {offset: n for n, offset in enumerate(neighbours(dimension))}
    total = np.zeros((len(place), bed.flux.shape[1]))

    def add(values: FloatArray, *steps: tuple[int, int]) -> None:
        total[place[_offset(dimension, *steps)]] += values

    for a in range(dimension):
        # lower face: gains; upper face (the lower face of the cell ahead): losses
        add(faces.behind[a], (a, -1))
        add(-bed.shifted(faces.here[a], a, 1), (a, 1))
        for row, b in enumerate(b for b in range(dimension) if b != a):
            low = faces.twist[row, a]
            high = bed.shifted(low, a, 1)
            for sign in (1, -1):
                add(sign * low, (b, sign))
                add(sign * low, (a, -1), (b, sign))
                add(-sign * high, (b, sign))
                add(-sign * high, (a, 1), (b, sign))
    return total


def _offset(dimension: int, *steps: tuple[int, int]) -> Offset:
    offset = [0] * dimension
    for axis, by in steps:
        offset[axis] += by
    return tuple(offset)


@numba.njit(cache=True)
def face_fluxes(
    out: FloatArray,
    c: FloatArray,
    behind: FloatArray,
    here: FloatArray,
    twist: FloatArray,
    runs: IntArray,
    strides: tuple[int, ...],
) -> None:
    """Fluxes of a component through the faces in the runs; out (dimension, cells)."""
    for r in range(runs.shape[0]):
        a, b = runs[r, 0], runs[r, 1]
        for axis in range(out.shape[0]):
            s = strides[axis]
            f, m, p = out[axis, a:b], behind[axis, a:b], here[axis, a:b]
            c_m, c_p = c[a - s : b - s], c[a:b]
            for k in range(b - a):
                f[k] = m[k] * c_m[k] + p[k] * c_p[k]
            row = 0
            for other in range(out.shape[0]):
                if other == axis:
                    continue
                t = strides[other]
                x = twist[row, axis, a:b]
                up, up_m = c[a + t : b + t], c[a + t - s : b + t - s]
                down, down_m = c[a - t : b - t], c[a - t - s : b - t - s]
                for k in range(b - a):
                    f[k] += x[k] * (up_m[k] + up[k] - down_m[k] - down[k])
                row += 1
