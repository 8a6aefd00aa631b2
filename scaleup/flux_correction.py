"""Conservative updates of concentrations, plain and with the flux correction that keeps bounds.

Fluxes here are what goes through the lower face of each cell in a step, of a component, as a share
of the volume of a cell, (dimension, cells) in flattened local arrays.

Flux correction (Boris & Book 1973; Zalesak 1979, J. Comput. Phys. 31, 335; with the bounds of the
whole problem, 0 and 1, as in Xiong, Qiu & Xu 2013, J. Comput. Phys. 252, 310), for n components
c_k with sum 1:

1. low order: upwind fluxes L and conductances give a solution c_low that keeps 0 <= c <= 1 where no
   more leaves a cell than it holds;
2. A = F - L is what the high-order fluxes F add;
3. for each component and cell R_k = min(1, phi c_low,k / sum of what A_k takes out), the share of
   A_k that the cell can give without falling below 0;
4. every face takes alpha = the least, over all components, of the R_k of the cell that gives;
5. phi c = phi c_low - div(alpha A).

Since sum_k A_k = 0 and alpha is common to all components, they sum to 1 and each is >= 0, hence
<= 1. Where R = 1 everywhere the high-order solution is kept as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numba
import numpy as np

from scaleup.conservative_bed import ConservativeBed, share_sums
from scaleup.grid import FloatArray, IntArray

if TYPE_CHECKING:
    from scaleup.decomposition import Decomposition, GhostedField

_ROUND_OFF = 1e-14  # beyond the bounds that needs no correction
_EMPTY = 1e-14  # fill fraction at which a group counts as empty


class FluxCorrection:
    """Updates of m of the m + 1 components on a rank; the last is what remains."""

    def __init__(self, split: Decomposition, components: int):
        self._split = split
        self._shares = [split.field() for _ in range(components + 1)]  # R_k
        shape = (components + 1, self._shares[0].array.size)
        self._content = np.zeros(shape)
        self._alpha = np.empty((split.grid.dimension, shape[1]))

    def enter(self, bed: ConservativeBed) -> None:
        """Take up another interval's bed."""
        self._bed = bed
        self._strides = (*bed.strides, 0)[:3]
        for share in self._shares:
            share.array[...] = 1.0

    def update(
        self, new: FloatArray, c: FloatArray, fluxes: FloatArray, start: float, end: float
    ) -> None:
        """phi(end) new = phi(start) c - div(fluxes) in the owned cells that move (collective).

        c, new -- (cells,), may be the same array; fluxes -- (dimension, cells);
        start, end -- s, within the interval
        """
        bed, groups = self._bed, self._bed.groups
        gain = np.zeros(len(groups.start))
        _sum_gains(gain, fluxes, groups.members, groups.first, self._strides)
        share_sums(self._split, groups, [gain])
        _update_regular(new, c, fluxes, bed.runs, self._strides)
        before, after = self._fractions(start), self._fractions(end)
        _update_groups(new, c, gain, before, after, groups.members, groups.first)

    def apply(
        self, c: list[FloatArray], fluxes: FloatArray, start: float, end: float
    ) -> None:
        """Overwrite c (m arrays) by their values at `end`; collective. Uses up the fluxes.

        fluxes -- (m, dimension, cells)
        """
        bed, m, strides = self._bed, len(c), self._strides
        content = self._content
        for k in range(m):
            self.update(content[k], c[k], fluxes[k], start, end)
        members = bed.groups.members
        low, high = self.bounds(content[:m])
        if -low <= _ROUND_OFF and high - 1.0 <= _ROUND_OFF:
            for k in range(m):
                _copy(c[k], content[k], bed.runs, members)
            return

        for k in range(m):
            _subtract_low_order(
                fluxes[k], c[k], bed.flux, bed.spread, end - start, bed.face_runs, strides
            )
        after = self._fractions(end)
        gains = [np.zeros(len(after)) for _ in range(m)]
        for k in range(m):
            _sum_gains(gains[k], fluxes[k], members, bed.groups.first, strides)
        share_sums(self._split, bed.groups, gains)
        for k in range(m):
            _to_low_order(content[k], fluxes[k], bed.runs, strides)
            _group_content(content[k], gains[k], after, members, bed.groups.first)
        self._find_shares(fluxes, after)

        self._alpha[...] = 1.0
        for share, flux, sign in self._with_rest(fluxes):
            share.exchange()
            _cap(self._alpha, flux, sign, share.array.ravel(), bed.face_runs, strides)
        for k in range(m):
            _scale(fluxes[k], self._alpha, bed.face_runs)
            gains[k][:] = 0.0
            _sum_gains(gains[k], fluxes[k], members, bed.groups.first, strides)
        share_sums(self._split, bed.groups, gains)
        for k in range(m):
            _update_regular(c[k], content[k], fluxes[k], bed.runs, strides)
            one = np.ones_like(after)
            _update_groups(c[k], content[k], gains[k], one, after, members, bed.groups.first)

    def bounds(self, values: Sequence[FloatArray]) -> tuple[float, float]:
        """Least and greatest of all components, the last one included, where the bed moves.

        Over all ranks (collective); infinite if any value is not a number.
        """
        low, high = _bounds(np.asarray(values), self._bed.runs, self._bed.groups.members)
        both = self._split.largest_of([-low, high])
        return -both[0], both[1]

    def worst(self, values: Sequence[FloatArray]) -> tuple[float, int]:
        """(how far beyond [0, 1], position) of the worst value of any component on this rank."""
        bed = self._bed
        cells = np.concatenate([np.arange(a, b) for a, b in bed.runs] + [bed.groups.members])
        if len(cells) == 0:
            return -np.inf, 0
        here = np.asarray(values)[:, cells]
        all_here = np.concatenate([here, 1.0 - here.sum(axis=0, keepdims=True)])
        excess = np.maximum(-all_here, all_here - 1.0).max(axis=0)
        excess = np.where(np.isnan(excess), np.inf, excess)
        at = int(np.argmax(excess))
        return float(excess[at]), int(cells[at])

    def _fractions(self, time: float) -> FloatArray:
        groups = self._bed.groups
        return np.asarray(groups.start + (time - self._bed.interval.start) * groups.rate)

    def _with_rest(self, fluxes: FloatArray) -> list[tuple[GhostedField, FloatArray, float]]:
        """(share, antidiffusive flux, sign) of every component, the last one included."""
        named = [(self._shares[k], fluxes[k], 1.0) for k in range(len(fluxes))]
        rest = fluxes[0] if len(fluxes) == 1 else fluxes.sum(axis=0)
        return [*named, (self._shares[-1], rest, -1.0)]

    def _find_shares(self, fluxes: FloatArray, after: FloatArray) -> None:
        """Step 3, from the antidiffusive fluxes and the low-order content."""
        bed, strides, groups = self._bed, self._strides, self._bed.groups
        m = len(fluxes)
        _rest(self._content, bed.runs, groups.members, groups.first, after)
        taken = [np.zeros(len(after)) for _ in range(m + 1)]
        for k, (_, flux, sign) in enumerate(self._with_rest(fluxes)):
            _sum_taken(taken[k], flux, sign, groups.members, groups.first, strides)
        share_sums(self._split, groups, taken)
        for k, (share, flux, sign) in enumerate(self._with_rest(fluxes)):
            array = share.array.ravel()
            _share_regular(array, self._content[k], flux, sign, bed.runs, strides)
            _share_groups(array, self._content[k], taken[k], groups.members, groups.first)


# Kernels. `s` holds the strides along the axes, 0 for a third that is not there.


@numba.njit(inline="always")
def _loss(flux: FloatArray, k: int, s: tuple[int, int, int]) -> float:
    """What leaves cell k through its faces, div(flux)."""
    loss = flux[0, k + s[0]] - flux[0, k] + flux[1, k + s[1]] - flux[1, k]
    if s[2] != 0:
        loss += flux[2, k + s[2]] - flux[2, k]
    return loss


@numba.njit(inline="always")
def _outgoing(flux: FloatArray, sign: float, k: int, s: tuple[int, int, int]) -> float:
    """Sum of what goes out through the faces of cell k, what comes in not counted."""
    total = max(sign * flux[0, k + s[0]], 0.0) + max(-sign * flux[0, k], 0.0)
    total += max(sign * flux[1, k + s[1]], 0.0) + max(-sign * flux[1, k], 0.0)
    if s[2] != 0:
        total += max(sign * flux[2, k + s[2]], 0.0) + max(-sign * flux[2, k], 0.0)
    return total


@numba.njit(cache=True)
def _update_regular(
    new: FloatArray, c: FloatArray, flux: FloatArray, runs: IntArray, s: tuple[int, int, int]
) -> None:
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            new[k] = c[k] - _loss(flux, k, s)


@numba.njit(cache=True)
def _sum_gains(
    gain: FloatArray, flux: FloatArray, members: IntArray, first: IntArray, s: tuple[int, int, int]
) -> None:
    for g in range(len(first) - 1):
        for i in range(first[g], first[g + 1]):
            gain[g] -= _loss(flux, members[i], s)


@numba.njit(cache=True)
def _update_groups(
    new: FloatArray,
    c: FloatArray,
    gain: FloatArray,
    before: FloatArray,
    after: FloatArray,
    members: IntArray,
    first: IntArray,
) -> None:
    """All cells of a group hold the same c; a group that ends empty keeps it."""
    for g in range(len(first) - 1):
        value = c[members[first[g]]]
        if after[g] > _EMPTY:
            value = (before[g] * value + gain[g]) / after[g]
        for i in range(first[g], first[g + 1]):
            new[members[i]] = value


@numba.njit(cache=True)
def _bounds(values: FloatArray, runs: IntArray, members: IntArray) -> tuple[float, float]:
    """Least and greatest of all components; infinite if any value is not a number."""
    low, high = np.inf, -np.inf
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            total = 0.0
            for m in range(values.shape[0]):
                value = values[m, k]
                low, high = min(low, value), max(high, value)
                total += value
            low, high = min(low, 1.0 - total), max(high, 1.0 - total)
            if total != total:
                return -np.inf, np.inf
    for k in members:
        total = 0.0
        for m in range(values.shape[0]):
            value = values[m, k]
            low, high = min(low, value), max(high, value)
            total += value
        low, high = min(low, 1.0 - total), max(high, 1.0 - total)
        if total != total:
            return -np.inf, np.inf
    return low, high


@numba.njit(cache=True)
def _copy(target: FloatArray, source: FloatArray, runs: IntArray, members: IntArray) -> None:
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            target[k] = source[k]
    for k in members:
        target[k] = source[k]


@numba.njit(cache=True)
def _subtract_low_order(
    flux: FloatArray,
    c: FloatArray,
    speed: FloatArray,
    spread: FloatArray,
    dt: float,
    runs: IntArray,
    s: tuple[int, int, int],
) -> None:
    """A = F - L with L upwind."""
    for axis in range(flux.shape[0]):
        for r in range(runs.shape[0]):
            for k in range(runs[r, 0], runs[r, 1]):
                v, behind, here = speed[axis, k], c[k - s[axis]], c[k]
                flux[axis, k] -= dt * (
                    max(v, 0.0) * behind + min(v, 0.0) * here - spread[axis, k] * (here - behind)
                )


@numba.njit(cache=True)
def _to_low_order(
    content: FloatArray, flux: FloatArray, runs: IntArray, s: tuple[int, int, int]
) -> None:
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            content[k] += _loss(flux, k, s)


@numba.njit(cache=True)
def _group_content(
    content: FloatArray, gain: FloatArray, after: FloatArray, members: IntArray, first: IntArray
) -> None:
    """phi c_low of a group at each of its members, from its high-order c."""
    for g in range(len(first) - 1):
        value = after[g] * content[members[first[g]]] - gain[g]
        for i in range(first[g], first[g + 1]):
            content[members[i]] = value


@numba.njit(cache=True)
def _rest(
    content: FloatArray, runs: IntArray, members: IntArray, first: IntArray, after: FloatArray
) -> None:
    """Content of the last component."""
    last = content.shape[0] - 1
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            total = 1.0
            for m in range(last):
                total -= content[m, k]
            content[last, k] = total
    for g in range(len(first) - 1):
        for i in range(first[g], first[g + 1]):
            total = after[g]
            for m in range(last):
                total -= content[m, members[i]]
            content[last, members[i]] = total


@numba.njit(cache=True)
def _share_regular(
    share: FloatArray,
    content: FloatArray,
    flux: FloatArray,
    sign: float,
    runs: IntArray,
    s: tuple[int, int, int],
) -> None:
    for r in range(runs.shape[0]):
        for k in range(runs[r, 0], runs[r, 1]):
            taken = _outgoing(flux, sign, k, s)
            share[k] = min(1.0, max(content[k], 0.0) / max(taken, _EMPTY))


@numba.njit(cache=True)
def _sum_taken(
    taken: FloatArray,
    flux: FloatArray,
    sign: float,
    members: IntArray,
    first: IntArray,
    s: tuple[int, int, int],
) -> None:
    for g in range(len(first) - 1):
        for i in range(first[g], first[g + 1]):
            taken[g] += _outgoing(flux, sign, members[i], s)


@numba.njit(cache=True)
def _share_groups(
    share: FloatArray, content: FloatArray, taken: FloatArray, members: IntArray, first: IntArray
) -> None:
    for g in range(len(first) - 1):
        value = min(1.0, max(content[members[first[g]]], 0.0) / max(taken[g], _EMPTY))
        for i in range(first[g], first[g + 1]):
            share[members[i]] = value


@numba.njit(cache=True)
def _cap(
    alpha: FloatArray,
    flux: FloatArray,
    sign: float,
    share: FloatArray,
    runs: IntArray,
    s: tuple[int, int, int],
) -> None:
    """Step 4 for one component: the cell that gives decides."""
    for axis in range(flux.shape[0]):
        for r in range(runs.shape[0]):
            for k in range(runs[r, 0], runs[r, 1]):
                giver = share[k - s[axis]] if sign * flux[axis, k] > 0.0 else share[k]
                alpha[axis, k] = min(alpha[axis, k], giver)


@numba.njit(cache=True)
def _scale(flux: FloatArray, alpha: FloatArray, runs: IntArray) -> None:
    for axis in range(flux.shape[0]):
        for r in range(runs.shape[0]):
            for k in range(runs[r, 0], runs[r, 1]):
                flux[axis, k] *= alpha[axis, k]
