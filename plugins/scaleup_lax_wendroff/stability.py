"""Stability of the Taylor-Lax-Wendroff stencil, frozen coefficients.

With nu_i = v_i dt/dx_i and mu_ij = D_ij dt/(dx_i dx_j), the amplification g of a wave with phase
angles (t_x, t_y) per cell is, exactly,

    |g|^2 = (1 - A)^2 + B^2,   B = nu_x sin t_x + nu_y sin t_y,
    A = sum_i (nu_i^2 + 2 mu_ii)(1 - cos t_i) + (nu_x nu_y + 2 mu_xy) sin t_x sin t_y.

Sufficient for |g| <= 1 (no false 'stable') is

    (|nu_x|^(2/3) + |nu_y|^(2/3))^3 + 2 (mu_xx + mu_yy) <= 1.
"""

from __future__ import annotations

import numpy as np

from scaleup.api import FloatArray


def stability_number(nu: FloatArray, mu: FloatArray) -> FloatArray:
    """Left side of the sufficient condition; stable where <= 1. nu (2, ...), mu (2, 2, ...)."""
    advective: FloatArray = (np.abs(nu) ** (2 / 3)).sum(axis=0) ** 3
    return advective + 2 * (mu[0, 0] + mu[1, 1])


def amplification(nu: FloatArray, mu: FloatArray, theta: FloatArray) -> FloatArray:
    """|g|^2 for phase angles theta (2, ...)."""
    cosine, sine = np.cos(theta), np.sin(theta)
    real = (nu[0] * nu[1] + 2 * mu[0, 1]) * sine[0] * sine[1]
    for axis in (0, 1):
        real = real + (nu[axis] ** 2 + 2 * mu[axis, axis]) * (1 - cosine[axis])
    imaginary = nu[0] * sine[0] + nu[1] * sine[1]
    squared: FloatArray = (1 - real) ** 2 + imaginary**2
    return squared
