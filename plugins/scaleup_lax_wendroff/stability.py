"""Stability of the Taylor-Lax-Wendroff stencil, frozen coefficients.

With nu_i = v_i dt/h_i and mu_ij = D_ij dt/(h_i h_j), the amplification g of a wave with phase
angles t_i per cell is, exactly,

    |g|^2 = (1 - A)^2 + B^2,   B = sum_i nu_i sin t_i,
    A = sum_i (nu_i^2 + 2 mu_ii)(1 - cos t_i) + sum_{i<j} (nu_i nu_j + 2 mu_ij) sin t_i sin t_j.

Sufficient for |g| <= 1 (no false 'stable') is

    (sum_i |nu_i|^(2/3))^3 + 2 f sum_i mu_ii <= 1,

with f = 1 in 2-D. In 3-D f = 9/8: a tensor along (1, 1, 1) with mu_ij = m has A = 6 m (1 - cos t +
sin^2 t) for the wave t = t_x = t_y = t_z, 13.5 m at most, and A must not exceed 2.
"""

from __future__ import annotations

import numpy as np

from scaleup.contract import FloatArray


def stability_number(nu: FloatArray, mu: FloatArray) -> FloatArray:
    """Left side of the sufficient condition, stable where <= 1; nu (d, ...), mu (d, d, ...)."""
    advective: FloatArray = (np.abs(nu) ** (2 / 3)).sum(axis=0) ** 3
    return advective + _spreading(mu)


def amplification(nu: FloatArray, mu: FloatArray, theta: FloatArray) -> FloatArray:
    """|g| of waves with phase angles theta (d, ...)."""
    cosine, sine = np.cos(theta), np.sin(theta)
    real = sum((nu[i] ** 2 + 2 * mu[i, i]) * (1 - cosine[i]) for i in range(len(nu)))
    for i in range(len(nu)):
        for j in range(i):
            real = real + (nu[i] * nu[j] + 2 * mu[i, j]) * sine[i] * sine[j]
    imaginary = sum(nu[i] * sine[i] for i in range(len(nu)))
    size: FloatArray = np.sqrt((1 - real) ** 2 + imaginary**2)
    return size


def largest_step(nu: FloatArray, mu: FloatArray) -> float:
    """Largest dt (s) within the sufficient condition; nu (d, n) and mu (d, d, n) are those of 1 s.

    The condition is a dt^2 + b dt <= 1 with a = (sum |nu|^(2/3))^3, b = 2 f sum mu_ii. Infinite if
    nothing moves.
    """
    b = _spreading(mu)
    a = stability_number(nu, mu) - b
    slowest = (b + np.sqrt(b**2 + 4 * a)).max(initial=0.0)
    return float(2.0 / slowest) if slowest > 0 else np.inf


def _spreading(mu: FloatArray) -> FloatArray:
    """2 f sum mu_ii."""
    dimension = len(mu)
    trace: FloatArray = np.array([mu[i, i] for i in range(dimension)]).sum(axis=0)
    return 2 * (9 / 8 if dimension == 3 else 1.0) * trace
