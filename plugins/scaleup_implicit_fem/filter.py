"""A filter of grid-scale waves, which centred fluxes carry the wrong way and never damp.

Galerkin's method keeps the energy of every wave; those of two cells' length run against the flow,
three times as fast with a consistent mass, so that what cut cells or a jump make of them spreads
over the bed. With B c = sum over the faces between full cells of a_f (c_j - c_i), a step adds

    B^3 c,   a_f^3 = min(1, nu_f)/(4 d)^3,

nu_f the greater share of its content that leaves the two cells in the step: -B has eigenvalues
between 0 and 1, a wave of four cells or more along each axis loses at most 1/8 of its amplitude,
and a smooth solution an amount of sixth order. It is a sum of fluxes, so mass is kept, and they
are limited like all others.
"""

from __future__ import annotations

import numpy as np

from scaleup.contract import FloatArray
from scaleup_implicit_fem import kernels
from scaleup_implicit_fem.operators import rows_of, times
from scaleup_implicit_fem.unknowns import Unknowns


class Filter:
    """The filter for one length of step on a rank; fields are (m, unknowns)."""

    def __init__(self, unknowns: Unknowns, leaving: FloatArray):
        """`leaving`: share that leaves each own unknown in a step; collective."""
        self._unknowns, pairs = unknowns, unknowns.pairs
        share = np.zeros((1, unknowns.size))
        share[0, : unknowns.count] = leaving
        unknowns.exchange(share)
        nu = np.minimum(1.0, np.maximum(share[0, pairs.first], share[0, pairs.second]))
        weight = np.where(pairs.smooth, np.cbrt(nu) / (4 * unknowns.dimension), 0.0)
        self._weights = np.stack([weight, -weight])
        self._rows = rows_of(pairs, self._weights, unknowns.count, unknowns.size)

    def fluxes(self, c: FloatArray) -> FloatArray:
        """What goes from the first to the second of each pair in a step; collective."""
        unknowns, pairs = self._unknowns, self._unknowns.pairs
        for _ in range(2):
            differences = np.zeros_like(c)
            differences[:, : unknowns.count] = times(self._rows, c)
            unknowns.exchange(differences)
            c = differences
        result = np.empty((len(c), len(pairs.first)))
        kernels.fluxes(result, c, self._weights, pairs.first, pairs.second)
        return result
