"""Algebraic flux correction: a bounded solution, and as much of the accurate one as bounds allow.

For n components c_k with sum 1 (Kuzmin, Loehner & Turek 2012, Flux-Corrected Transport, ch. 6;
Zalesak 1979, J. Comput. Phys. 31, 335; with the bounds of the whole problem, 0 and 1):

1. the accurate fluxes G give phi' c = phi c_old - div G; if that keeps 0 <= c <= 1 it is taken;
2. else low order: one backward Euler step with upwind fluxes L(c_low). Its matrix is an M-matrix
   whose rows sum to phi >= 0, so 0 <= c_low <= 1 at any step;
3. A = G - L is what the accurate fluxes add; for each component and unknown R_k = min(1,
   phi' c_low,k / sum of what A_k takes out) is the share that it can give without falling below 0;
4. every pair takes alpha = the least, over all components, of the R_k of the one that gives;
   phi' c_low loses and gains alpha A, and A keeps (1 - alpha) A;
5. 3 and 4 are repeated with what is left of A: what a cell gained, it can give.

Since sum_k A_k = 0 and alpha is common to all components, they sum to 1 and each is >= 0, hence
<= 1. The solver leaves a residual, which is all by which bounds can be missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from scaleup.contract import FloatArray
from scaleup_implicit_fem import kernels
from scaleup_implicit_fem.operators import EMPTY
from scaleup_implicit_fem.unknowns import Unknowns

_ROUND_OFF = 1e-14  # beyond the bounds that needs no correction
_PASSES = 20
_ENOUGH = 1e-7  # content of a full cell: passes that move less are not worth it
_LOOK_EVERY = 4


class Correction:
    """The algorithm above on a rank, for m of the m + 1 components; fields are (m, unknowns)."""

    def __init__(self, unknowns: Unknowns, components: int, largest: Callable[[float], float]):
        """`largest`: the greatest of the ranks' values."""
        self._unknowns, self._largest = unknowns, largest
        pairs = unknowns.pairs
        self._ends = (pairs.first, pairs.second)
        self._shares = np.ones((components + 1, unknowns.size))
        self._allowed = np.zeros((components, len(pairs.first)))

    def apply(
        self,
        c: FloatArray,
        before: FloatArray,
        after: FloatArray,
        fluxes: FloatArray,
        low_order: Callable[[], FloatArray],
        dt: float,
    ) -> FloatArray:
        """Concentrations at the end of a step of dt (s), ghosts not yet exchanged; collective.

        before, after -- phi at the step's start and end
        fluxes    -- G, (m, pairs); used up
        low_order -- solves for c_low, ghosts exchanged
        An unknown that ends empty keeps its c.
        """
        own, filled = self._unknowns.count, after > EMPTY
        content = before * c
        kernels.move(content, fluxes, *self._ends)
        high = np.divide(content, after, out=c.copy(), where=filled)
        low, top = kernels.bounds(high, own)
        left = float(np.abs(content[:, :own][:, ~filled[:own]]).max(initial=0.0))
        if not self._largest(max(-low, top - 1.0, left)) > _ROUND_OFF:
            return high
        content[...] = self._corrected(before * c, after, fluxes, low_order(), dt)
        return np.divide(content, after, out=high, where=filled)

    def _corrected(
        self, old: FloatArray, after: FloatArray, fluxes: FloatArray, c_low: FloatArray, dt: float
    ) -> FloatArray:
        """Steps 2 to 5: phi c at the step's end."""
        pairs, allowed, shares = self._unknowns.pairs, self._allowed, self._shares
        kernels.fluxes(allowed, c_low, pairs.low * dt, *self._ends)
        fluxes -= allowed
        content = old
        kernels.move(content, allowed, *self._ends)
        open_pairs = np.arange(fluxes.shape[1], dtype=np.int32)
        most = 0.0
        for n in range(_PASSES):
            kernels.find_shares(shares, content, after, fluxes, *self._ends, open_pairs)
            self._unknowns.exchange(shares)
            left, moved = kernels.move_share(content, fluxes, shares, *self._ends, open_pairs)
            open_pairs, most = open_pairs[:left], max(most, moved)
            if n % _LOOK_EVERY == _LOOK_EVERY - 1:  # ranks need not agree after every pass
                if not self._largest(most) > _ENOUGH:
                    break
                most = 0.0
        return content
