"""form "corrected": the Taylor-Lax-Wendroff scheme in flux form.

Through the face between cells m and p (normal x; likewise y) the flux F (m^3/s) carries in a step
the mean over the step of c at the face, c + dt/2 c_t with c_t = -v.grad c:

    c_f = (c_m + c_p)/2 - nu/2 (c_p - c_m) - dt v_y/(8 dy) [N - S],  nu = F dt/(area dx),
    [N - S] = c_mN + c_pN - c_mS - c_pS,

and diffusion D_xx area/dx (c_m - c_p) - D_xy area/(4 dy) [N - S]. Each cell gains what its
neighbour loses, so mass is kept to round-off (where the fill moves, to the first order in its
change over an interval of the flow: the mean fill is taken for the cell's volume).

For uniform v and D the stencil is that of Eq. 7 with the sign of Eq. 8 and the 1/dx of Eq. 17
mended and D_xy kept, so its stability limit is the same. Where v varies, the flux form holds the
term -dt/2 (v.grad) v that Eq. 7 lacks, and the scheme is second order in space and time for D = 0.
(With D > 0 terms of order D dt remain.)

Faces of cut cells are treated upwind, c_f = c of the cell that the flux comes from, with D_nn on
the area times the smaller fill fraction. A cut cell into which a step brings more than it holds
is stepped implicitly in its own c; weights stay positive and sum to 1, so that no cell, however
little it holds, limits the step (what such cells hold is the error in mass; it does not add up).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaleup.api import FULL, BoolArray, FloatArray
from scaleup_lax_wendroff.stencil import NE, NW, SE, SW, E, N, S, W


@dataclass(frozen=True)
class LocalFlow:
    """A flow on a rank's local array, at least two ghost layers wide; arrays are (rows, columns).

    fill     -- m^3; flux -- (2, ...) through the lower faces, m^3/s
    tensor   -- (2, 2, ...) m^2/s
    spacing, areas -- of cells (m) and of faces normal to x and y (m^2)
    cell_volume    -- m^3
    """

    fill: FloatArray
    flux: FloatArray
    tensor: FloatArray
    spacing: tuple[float, ...]
    areas: tuple[float, ...]
    cell_volume: float

    @property
    def full(self) -> BoolArray:
        """Cells full of material."""
        result: BoolArray = self.fill >= FULL * self.cell_volume
        return result

    def courant_numbers(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """(nu, shape (2, ...), the greater of a cell's two faces; mu, shape (2, 2, ...))."""
        nu = np.empty_like(self.flux)
        for axis in (0, 1):
            low = np.abs(self.flux[axis])
            speed = np.maximum(low, _ahead(low, axis)) / self.areas[axis]
            nu[axis] = speed * dt / self.spacing[axis]
        h = np.array(self.spacing)
        return nu, self.tensor * dt / (h[:, None] * h[None, :])[:, :, None, None]


def weights(flow: LocalFlow, dt: float) -> FloatArray:
    """Stencil weights for a step, (8, ...); right wherever two layers of neighbours are there."""
    total = np.zeros((8, *flow.fill.shape))
    # positions of the stencil around the lower face of a cell: cell behind, and the transverse
    # neighbours of both cells, (behind, here) on the upper and on the lower side
    _add_faces(total, flow, dt, 0, (W, E), ((NW, N), (SW, S)), ((N, NE), (S, SE)))
    _add_faces(total, flow, dt, 1, (S, N), ((SE, E), (SW, W)), ((E, NE), (W, NW)))
    brought = total.sum(axis=0)
    implicit = ~flow.full & (brought > flow.fill)
    volume = np.where(implicit, flow.fill + brought, flow.fill)
    return np.divide(total, volume, out=np.zeros_like(total), where=volume > 0)


def _add_faces(
    total: FloatArray,
    flow: LocalFlow,
    dt: float,
    axis: int,
    beside: tuple[int, int],
    around_low: tuple[tuple[int, int], tuple[int, int]],
    around_high: tuple[tuple[int, int], tuple[int, int]],
) -> None:
    """Add what the faces normal to `axis` bring to each cell, in volume per step.

    The concentration of the cell itself is the reference: a weight multiplies c_k - c. All arrays
    here belong to the lower face of a cell, between the cell behind and the cell here.
    """
    other = 1 - axis
    here_full, holds = flow.full, flow.fill > 0
    neighbours = holds & _ahead(holds, other) & _behind(holds, other)
    smooth = here_full & _behind(here_full, axis) & neighbours & _behind(neighbours, axis)

    moved = flow.flux[axis] * dt
    nu = moved / (flow.areas[axis] * flow.spacing[axis])
    share_behind = np.where(smooth, 0.5 * (1.0 + nu), (moved > 0).astype(float))

    across = flow.flux[other] + _ahead(flow.flux[other], other)
    across = 0.25 * (across + _behind(across, axis)) / flow.areas[other]
    twist = -moved * across * dt / (8 * flow.spacing[other])
    mixed = 0.5 * (flow.tensor[axis, other] + _behind(flow.tensor[axis, other], axis))
    twist -= mixed * dt * flow.areas[axis] / (4 * flow.spacing[other])
    twist = np.where(smooth, twist, 0.0)

    fraction = flow.fill / flow.cell_volume
    aperture = np.minimum(fraction, _behind(fraction, axis))
    normal = 0.5 * (flow.tensor[axis, axis] + _behind(flow.tensor[axis, axis], axis))
    spread = normal * dt * aperture * flow.areas[axis] / flow.spacing[axis]

    behind, ahead = beside
    # lower face: gains; upper face (the lower face of the cell ahead): losses
    total[behind] += moved * share_behind + spread
    total[ahead] += _ahead(spread - moved * (1.0 - share_behind), axis)
    for sign, (low, high) in zip(
        (1.0, -1.0), zip(around_low, around_high, strict=True), strict=True
    ):
        for place in low:
            total[place] += sign * twist
        for place in high:
            total[place] -= sign * _ahead(twist, axis)


def _ahead(values: FloatArray, axis: int) -> FloatArray:
    """The value of the next cell along an axis (0 = x)."""
    return np.roll(values, -1, values.ndim - 1 - axis)


def _behind(values: FloatArray, axis: int) -> FloatArray:
    """The value of the cell before along an axis (0 = x)."""
    return np.roll(values, 1, values.ndim - 1 - axis)
