"""Circular shear flow with diffusion, solved mode by mode without any plane grid.

In a disc of radius R powder turns at omega(r) = rate (1 - r^2/R^2), at rest on the wall. With
c = sum_m c_m(r, t) exp(i m theta)

    dc_m/dt = D (c_m'' + c_m'/r - m^2/r^2 c_m) - i m omega(r) c_m,    c_m'(R) = 0,

and c_m has the parity of m in r. Chebyshev collocation on the diameter [-R, R] with that parity
(Trefethen, Spectral Methods in MATLAB, ch. 11) keeps off the middle; the matrix exponential steps
exactly in time. Spectrally accurate: what is left is checked by doubling the resolution.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BarycentricInterpolator, RectBivariateSpline
from scipy.linalg import expm

from scaleup.space.grid import FloatArray
from scaleup.verification.problem import Field

_TABLE = (400, 720)  # radii and angles of the table that points are read from, by quintic splines


@dataclass(frozen=True)
class ShearedDisc:
    """A Gaussian in the sheared disc, centred on the origin of the disc.

    radius (m), rate (rad/s), diffusivity (m^2/s); centre, sigma -- of the Gaussian, m
    collocation -- odd: intervals on the diameter; modes -- angular modes 0..modes
    """

    radius: float
    rate: float
    diffusivity: float
    centre: tuple[float, float]
    sigma: float
    collocation: int = 101
    modes: int = 40

    def stream_function(self, r: FloatArray) -> FloatArray:
        """psi(r) = int_r^R omega r' dr', m^2/s."""
        whole = self.radius**2
        return self.rate * (0.5 * (whole - r**2) - 0.25 * (whole**2 - r**4) / whole)

    def concentration(self, time: float) -> Field:
        """Concentration at a time (s), of points about the middle (0.5, 0.5) of the unit box."""
        table = _table(self, time)

        def field(points: FloatArray) -> FloatArray:
            x, y = points[..., 0] - 0.5, points[..., 1] - 0.5
            r = np.minimum(np.hypot(x, y), self.radius)
            return np.asarray(table(r, np.arctan2(y, x), grid=False))

        return field

    def radial_values(self, time: float) -> tuple[FloatArray, NDArray[np.complex128]]:
        """(collocation radii, descending, m; c_m there, (modes + 1, radii)) at a time, s."""
        x, first = _chebyshev(self.collocation)
        half = (self.collocation + 1) // 2
        r = self.radius * x[:half]
        first = first / self.radius
        second = first @ first
        start = self._initial_modes(r)
        values = np.empty_like(start)
        for m in range(self.modes + 1):
            parity = (-1.0) ** m
            slope = first[:half, :half] + parity * first[:half, half:][:, ::-1]
            curvature = second[:half, :half] + parity * second[:half, half:][:, ::-1]
            laplace = curvature + slope / r[:, None] - np.diag(m**2 / r**2)
            omega = self.rate * (1.0 - (r / self.radius) ** 2)
            right = self.diffusivity * laplace - 1j * m * np.diag(omega)
            # the wall's value follows from the others by c_m'(R) = 0
            wall = -slope[0, 1:] / slope[0, 0]
            inner = right[1:, 1:] + np.outer(right[1:, 0], wall)
            values[m, 1:] = expm(inner * time) @ start[m, 1:]
            values[m, 0] = wall @ values[m, 1:]
        return r, values

    def _initial_modes(self, r: FloatArray) -> NDArray[np.complex128]:
        angles = 2 * np.pi * np.arange(8 * self.modes) / (8 * self.modes)
        x, y = r[:, None] * np.cos(angles), r[:, None] * np.sin(angles)
        distance = (x - self.centre[0]) ** 2 + (y - self.centre[1]) ** 2
        gaussian = np.exp(-distance / (2 * self.sigma**2))
        return (np.fft.fft(gaussian, axis=1) / len(angles))[:, : self.modes + 1].T.copy()


@lru_cache(maxsize=4)
def _table(disc: ShearedDisc, time: float) -> RectBivariateSpline:
    r, values = disc.radial_values(time)
    # polynomials on the whole diameter, by the parity of each mode
    signs = (-1.0) ** np.arange(disc.modes + 1)
    diameter = np.concatenate([values, signs[:, None] * values[:, ::-1]], axis=1)
    nodes = np.concatenate([r, -r[::-1]]) / disc.radius
    radii = np.linspace(0.0, disc.radius, _TABLE[0])
    modes = BarycentricInterpolator(nodes, diameter, axis=1)(radii / disc.radius)
    # a little beyond [-pi, pi], so that the spline's ends lie out of use
    angles = math.pi * np.linspace(-1.1, 1.1, _TABLE[1])
    waves = np.exp(1j * np.arange(disc.modes + 1)[:, None] * angles)
    waves[1:] *= 2.0
    return RectBivariateSpline(radii, angles, (modes.T @ waves).real, kx=5, ky=5)


def _chebyshev(n: int) -> tuple[FloatArray, FloatArray]:
    """Chebyshev points x_j = cos(pi j/n) and the differentiation matrix on them."""
    j = np.arange(n + 1)
    x = np.cos(np.pi * j / n)
    c = np.where((j == 0) | (j == n), 2.0, 1.0) * (-1.0) ** j
    # differences of cosines as products of sines: no cancellation
    difference = (
        -2.0
        * np.sin(0.5 * np.pi / n * (j[:, None] + j))
        * np.sin(0.5 * np.pi / n * (j[:, None] - j))
    )
    np.fill_diagonal(difference, 1.0)
    matrix = np.outer(c, 1.0 / c) / difference
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return x, matrix
