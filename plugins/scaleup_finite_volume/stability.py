"""Stability of the linear scheme (before flux correction), frozen coefficients.

With nu_i = v_i dt/h_i and mu_ij = D_ij dt/(h_i h_j), a wave with phase angles t_i per cell is
multiplied in a step by g = 1 + z + z^2/2 + z^3/6, with z the sum over the axes of what the fluxes
of `fluxes` give for that wave. Two limits meet: positivity of the upwind part of the
flux correction, sum |nu_i| + 2 sum mu_ii <= 1, and |g| <= 1. For diffusion alone the fourth-order
stencil has z >= -16/3 sum mu_ii, and the three stages need z >= -2.5127: sum mu_ii <= 0.4711, less
than positivity allows. Stated therefore is

    sum_i |nu_i| + 2 f sum_i mu_ii <= 1,   f = DIFFUSION_FACTOR = 1.07,

which has no false 'stable' in random directions and tensors (tests), and beyond which bounds break.
"""

from __future__ import annotations

import numpy as np

from scaleup.contract import FloatArray

DIFFUSION_FACTOR = 1.07


def stability_number(nu: FloatArray, mu: FloatArray) -> FloatArray:
    """Left side of the stated condition, stable where <= 1; nu (d, ...), mu (d, d, ...)."""
    diagonal = np.array([mu[i, i] for i in range(len(nu))])
    total: FloatArray = np.abs(nu).sum(axis=0) + 2 * DIFFUSION_FACTOR * diagonal.sum(axis=0)
    return total


def amplification(nu: FloatArray, mu: FloatArray, theta: FloatArray) -> FloatArray:
    """|g| of waves with phase angles theta (d, ...)."""
    z = sum(_along(nu[i], mu[i, i], theta[i]) for i in range(len(nu)))
    for i in range(len(nu)):
        for j in range(i):
            z = z - 2 * mu[i, j] * np.sin(theta[i]) * np.sin(theta[j])
    size: FloatArray = np.abs(1 + z + z**2 / 2 + z**3 / 6)
    return size


def _along(nu: FloatArray, mu: FloatArray, t: FloatArray) -> FloatArray:
    """What the fluxes along one axis contribute to z: -(flux above - flux below)."""

    def wave(cells: int) -> FloatArray:
        return np.exp(1j * cells * t)

    centred = 37 * (wave(-1) + wave(0)) - 8 * (wave(-2) + wave(1)) + wave(-3) + wave(2)
    near, wide, widest = wave(0) - wave(-1), wave(1) - wave(-2), wave(2) - wave(-3)
    flux = (nu * centred - np.abs(nu) * (10 * near - 5 * wide + widest)) / 60
    flux = flux - mu * (15 * near - wide) / 12
    below_to_above: FloatArray = wave(1) - 1
    return -flux * below_to_above
