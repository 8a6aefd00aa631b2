"""Bodies of concentration."""

from __future__ import annotations

import math

import numpy as np

from scaleup.space.grid import BoolArray, FloatArray
from scaleup.verification.problem import Field


def turned(body: Field, angle: float, centre: tuple[float, float] = (0.5, 0.5)) -> Field:
    """A body turned by an angle (rad, counter-clockwise) in the plane."""
    cosine, sine = math.cos(angle), math.sin(angle)

    def result(points: FloatArray) -> FloatArray:
        x, y = points[..., 0] - centre[0], points[..., 1] - centre[1]
        back = np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)
        return body(back + np.array(centre))

    return result


def gaussian(centre: tuple[float, ...], sigma: float) -> Field:
    """exp(-r^2/(2 sigma^2)), in any dimension."""

    def body(points: FloatArray) -> FloatArray:
        squared: FloatArray = ((points - np.array(centre)) ** 2).sum(axis=-1)
        result: FloatArray = np.exp(-squared / (2 * sigma**2))
        return result

    return body


def spread_gaussian(
    centre: tuple[float, ...], sigma: float, tensor: FloatArray, time: float
) -> Field:
    """What diffusion with a uniform tensor (m^2/s) makes of `gaussian` in unbounded space.

    The covariance grows from sigma^2 I to sigma^2 I + 2 D t, the integral stays.
    """
    before = sigma**2 * np.eye(len(centre))
    covariance = before + 2 * tensor * time
    precision = np.linalg.inv(covariance)
    height = math.sqrt(np.linalg.det(before) / np.linalg.det(covariance))

    def body(points: FloatArray) -> FloatArray:
        arm = points - np.array(centre)
        squared: FloatArray = np.einsum("...i,ij,...j->...", arm, precision, arm)
        result: FloatArray = height * np.exp(-0.5 * squared)
        return result

    return body


def slotted_disc(points: FloatArray) -> FloatArray:
    """Zalesak 1979: radius 0.15 about (0.5, 0.75), slot 0.05 wide and 0.25 long, open below."""
    x, y = points[..., 0] - 0.5, points[..., 1] - 0.75
    inside: BoolArray = (np.hypot(x, y) < 0.15) & ((np.abs(x) > 0.025) | (y > 0.1))
    return inside.astype(float)


def cone(points: FloatArray) -> FloatArray:
    """LeVeque 1996: height 1 and radius 0.15 about (0.5, 0.25)."""
    r = np.hypot(points[..., 0] - 0.5, points[..., 1] - 0.25)
    return np.maximum(1.0 - r / 0.15, 0.0)


def hump(points: FloatArray) -> FloatArray:
    """LeVeque 1996: (1 + cos(pi r/0.15))/4 about (0.25, 0.5)."""
    r = np.hypot(points[..., 0] - 0.25, points[..., 1] - 0.5)
    height: FloatArray = 0.25 * (1.0 + np.cos(np.pi * np.minimum(r / 0.15, 1.0)))
    return height


def three_bodies(points: FloatArray) -> FloatArray:
    """LeVeque 1996: slotted disc, cone and hump together."""
    return slotted_disc(points) + cone(points) + hump(points)


def sphere(centre: tuple[float, float, float], radius: float) -> Field:
    """1 inside, 0 outside."""

    def body(points: FloatArray) -> FloatArray:
        distance: FloatArray = np.linalg.norm(points - np.array(centre), axis=-1)
        return (distance < radius).astype(float)

    return body
