"""Conservative updates of concentrations, plain and with the flux correction that keeps bounds.

Fluxes here are what goes through the lower face of each cell in a step, of a component, as a share
of the volume of a cell, (dimension, cells) in flattened local arrays.

Flux correction (Boris & Book 1973; Zalesak 1979, J. Comput. Phys. 31, 335; with the bounds of the
whole problem, 0 and 1, as in Xiong, Qiu & Xu 2013, J. Comput. Phys. 252, 310), for n components
c_k with sum 1:

1. low order: upwind fluxes L (with conductances and drifts) give a solution c_low that keeps
   0 <= c <= 1 where no more leaves a cell than it holds;
2. A = F - L is what the high-order fluxes F add;
3. for each component and cell R_k = min(1, phi c_low,k / sum of what A_k takes out), the share of
   A_k that the cell can give without falling below 0;
4. every face takes alpha = the least, over all components, of the R_k of the cell that gives;
5. phi c = phi c_low - div(alpha A).

Since sum_k A_k = 0 and alpha is common to all components, they sum to 1 and each is >= 0, hence
<= 1. Where the high-order solution keeps the bounds everywhere it is taken as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from scaleup.mixing import flux_kernels as kernels
from scaleup.mixing.conservative_bed import ConservativeBed, sums_over_groups
from scaleup.space.grid import BoolArray, FloatArray
from scaleup.system.errors import ContractError

if TYPE_CHECKING:
    from scaleup.space.decomposition import Decomposition

_ROUND_OFF = 1e-14  # beyond the bounds that needs no correction


class FluxCorrection:
    """Updates of m of the m + 1 components on a rank; the last is what remains.

    Fields are (m, cells), fluxes (m, dimension, cells); times are s within the bed's interval.
    """

    def __init__(self, split: Decomposition, components: int):
        self._split = split
        self._shares = split.field(components + 1)  # R_k
        self._content = np.zeros_like(self._shares.flat)

    def enter(self, bed: ConservativeBed) -> None:
        """Take up another interval's bed."""
        if len(bed.drift) not in (0, len(self._content)):
            raise ContractError(
                f"a drift of {len(bed.drift)} components in a bed of {len(self._content)}"
            )
        self._bed = bed
        x, y, *z = bed.strides
        self._strides = (x, y, z[0] if z else 0)
        self._shares.array[...] = 1.0
        if len(bed.drift):  # where slopes are taken, along each axis
            ahead, behind = (
                np.array([bed.shifted(bed.full, axis, by) for axis in range(len(bed.strides))])
                for by in (1, -1)
            )
            self._smooth = bed.full & ahead & behind

    def add_drift(self, fluxes: FloatArray, c: FloatArray, dt: float) -> None:
        """Add what the bed's drifts carry in dt (s), of second order where all is full."""
        if len(self._bed.drift):
            self._add_swaps(fluxes, c, dt, self._smooth)

    def _add_swaps(self, fluxes: FloatArray, c: FloatArray, by: float, smooth: BoolArray) -> None:
        bed = self._bed
        kernels.add_swaps(fluxes, c, bed.drift, by, smooth, bed.face_runs, self._strides)

    def update(
        self, new: FloatArray, c: FloatArray, fluxes: FloatArray, start: float, end: float
    ) -> tuple[FloatArray, float]:
        """phi(end) new = phi(start) c - div(fluxes) in the owned cells that move (collective).

        Returns what leaves each group, (m, groups), and the greatest content, in size, left on
        this rank in cells that end empty.
        """
        bed, groups = self._bed, self._bed.groups
        lost = self._lost(fluxes)
        before, after = groups.fraction(start), groups.fraction(end)
        left = 0.0
        for k in range(len(fluxes)):
            kernels.update_regular(new[k], c[k], fluxes[k], bed.sweeps, self._strides)
            left_of_one = kernels.update_groups(
                new[k], c[k], lost[k], before, after, groups.members, groups.first
            )
            left = max(left, left_of_one)
        return lost, left

    def apply(self, c: FloatArray, fluxes: FloatArray, start: float, end: float) -> None:
        """Overwrite c by its values at `end`, bounded; collective. Uses up the fluxes."""
        bed, m, strides = self._bed, len(c), self._strides
        content, groups = self._content, bed.groups
        lost, left = self.update(content, c, fluxes, start, end)
        low, high = kernels.bounds(content[:m], bed.runs, groups.members)
        if not self._split.largest(max(-low, high - 1.0, left)) > _ROUND_OFF:
            for k in range(m):
                kernels.copy(c[k], content[k], bed.runs, groups.members)
            return

        for k in range(m):
            kernels.subtract_low_order(
                fluxes[k], c[k], bed.flux, bed.spread, end - start, bed.face_runs, strides
            )
        if len(bed.drift):
            self._add_swaps(fluxes, c, start - end, np.zeros_like(self._smooth))
        before, after = groups.fraction(start), groups.fraction(end)
        both = np.concatenate(
            [
                kernels.member_losses(fluxes, groups.members, strides),
                kernels.member_outgoing(fluxes, groups.members, strides),
            ]
        )
        sums = sums_over_groups(self._split, groups, both)
        added, outgoing = sums[:m], sums[m:]
        kernels.low_order_content(
            content, c, fluxes, lost - added, before, after, bed.sweeps, groups.members,
            groups.first, strides,
        )  # fmt: skip
        self._find_shares(fluxes, outgoing)
        self._limit(fluxes)
        lost = self._lost(fluxes)
        one = np.ones_like(after)
        for k in range(m):
            kernels.update_regular(c[k], content[k], fluxes[k], bed.sweeps, strides)
            kernels.update_groups(
                c[k], content[k], lost[k], one, after, groups.members, groups.first
            )

    def _lost(self, fluxes: FloatArray) -> FloatArray:
        """What leaves each group, on whichever ranks it lies (collective)."""
        groups = self._bed.groups
        lost = kernels.member_losses(fluxes, groups.members, self._strides)
        return sums_over_groups(self._split, groups, lost)

    def _find_shares(self, fluxes: FloatArray, outgoing: FloatArray) -> None:
        """Step 3, on this rank's own cells, and then in the ghosts."""
        bed, groups = self._bed, self._bed.groups
        for k, (share, flux, sign) in enumerate(self._with_rest(fluxes)):
            kernels.shares_of_one(
                share, self._content[k], flux, sign, outgoing[k], bed.runs,
                groups.members, groups.first, self._strides,
            )  # fmt: skip
        self._shares.exchange()

    def _limit(self, fluxes: FloatArray) -> None:
        """Step 4."""
        runs = self._bed.face_runs
        if len(fluxes) == 1:
            kernels.limit_two(fluxes[0], *self._shares.flat, runs, self._strides)
            return
        alpha = np.ones_like(fluxes[0])
        for share, flux, sign in self._with_rest(fluxes):
            kernels.cap(alpha, flux, sign, share, runs, self._strides)
        fluxes *= alpha

    def _with_rest(self, fluxes: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, float]]:
        """(share, flux, sign) of every component, the last one included."""
        rest = fluxes[0] if len(fluxes) == 1 else fluxes.sum(axis=0)
        yield from ((s, f, 1.0) for s, f in zip(self._shares.flat, fluxes, strict=False))
        yield self._shares.flat[-1], rest, -1.0
