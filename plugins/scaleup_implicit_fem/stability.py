"""Stability of the linear scheme (before flux correction), frozen coefficients: any step.

With nu_i = v_i dt/h_i and mu_ij = D_ij dt/(h_i h_j), a wave with phase angles t_i per cell is
multiplied in a step by g = R(z/m) (1 - b^3): m is the symbol of the mass, z that of fluxes and
diffusion, b that of the filter and R the function of the Runge-Kutta scheme,

    m = 1 - 2/3 sum s_i + 4/9 sum_{i<j} s_i s_j,   s_i = sin^2(t_i/2),
    z = -i sum_i nu_i sin t_i (1 - 2/3 sum_{j != i} s_j)
        - 4 sum_i mu_ii s_i - 2 sum_{i<j} mu_ij sin t_i sin t_j.

m is positive; the real part of z is not, for any positive tensor; R is at most 1 in size on the
left half plane and goes to 0 far out (L-stable). Hence |g| <= 1 at any step.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from scaleup.contract import FloatArray
from scaleup_implicit_fem.time_scheme import STAGES, WEIGHTS


def amplification(nu: FloatArray, mu: FloatArray, theta: FloatArray) -> FloatArray:
    """|g| of waves with phase angles theta (d, ...); nu (d, ...), mu (d, d, ...)."""
    dimension, s, sine = len(nu), np.sin(theta / 2) ** 2, np.sin(theta)
    mass = 1 - 2 / 3 * s.sum(axis=0)
    z = -4 * sum(mu[i, i] * s[i] for i in range(dimension)) + 0j
    for i, j in combinations(range(dimension), 2):
        mass = mass + 4 / 9 * s[i] * s[j]
        z = z - 2 * mu[i, j] * sine[i] * sine[j]
    for i in range(dimension):
        across = s.sum(axis=0) - s[i]
        z = z - 1j * nu[i] * sine[i] * (1 - 2 / 3 * across)
    leaving = np.minimum(1.0, np.abs(nu).sum(axis=0) + 2 * np.trace(mu))
    kept = 1 - leaving * (s.sum(axis=0) / dimension) ** 3
    size: FloatArray = np.abs(runge_kutta(z / mass)) * kept
    return size


def runge_kutta(z: FloatArray) -> FloatArray:
    """R(z) = 1 + z b (1 - z A)^-1 (1, ..., 1)."""
    stages: list[FloatArray] = []
    for row, diagonal in zip(STAGES, np.diag(STAGES), strict=True):
        before = sum(a * stage for a, stage in zip(row, stages, strict=False))
        stages.append((1 + z * before) / (1 - z * diagonal))
    result: FloatArray = 1 + z * sum(b * stage for b, stage in zip(WEIGHTS, stages, strict=True))
    return result
