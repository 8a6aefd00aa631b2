"""Flows that shear what they carry, in full square or round vessels."""

from __future__ import annotations

import numpy as np

from scaleup.space.flow_field import FlowField
from scaleup.space.grid import FloatArray
from scaleup.verification.bodies import gaussian, three_bodies
from scaleup.verification.closed_flows import (
    ball,
    box,
    plane_flow,
    pulsating,
    unit_grid,
)
from scaleup.verification.fields import problem_of_field
from scaleup.verification.problem import Field, Problem, uniform_diffusion
from scaleup.verification.sheared_disc import ShearedDisc

_SWIRL_PERIOD = 1.5  # s
_SWIRL_INTERVALS = 96
_CHARACTERISTIC_STEPS = 40  # leave an error of 3e-7
_DISC = ShearedDisc(radius=0.5, rate=2 * np.pi, diffusivity=3e-4, centre=(0.2, 0.0), sigma=0.06)


def vortex_flow(n: int) -> FlowField:
    """Stream function sin^2(pi x) sin^2(pi y)/(2 pi) in the unit box: turns once in about 2 s."""
    return plane_flow(unit_grid(n, 2), lambda points: 0.5 * _vortex(points), box)


def swirl_flow(n: int) -> FlowField:
    """LeVeque 1996: psi = sin^2(pi x) sin^2(pi y)/pi cos(pi t/T), back at its start at t = T.

    The mean of the cosine is exact in every interval, so that the flow reverses exactly.
    """
    steady = plane_flow(unit_grid(n, 2), _vortex, box)
    edges = np.linspace(0.0, np.pi, _SWIRL_INTERVALS + 1)
    means = np.diff(np.sin(edges)) / np.diff(edges)
    return pulsating(steady, 0.5 * (means - means[::-1]), _SWIRL_PERIOD)


def sheared_disc_flow(n: int) -> FlowField:
    """Circles turning at omega(r), in a disc of radius 0.5."""

    def psi(points: FloatArray) -> FloatArray:
        return _DISC.stream_function(np.linalg.norm(points - 0.5, axis=-1))

    return plane_flow(unit_grid(n, 2), psi, ball((0.5, 0.5), _DISC.radius))


def carried_by_vortex(body: Field, time: float) -> Field:
    """A body carried by `vortex_flow`: traced back along characteristics by Runge-Kutta steps."""

    def velocity(p: FloatArray) -> FloatArray:
        sine, double = np.sin(np.pi * p), np.sin(2 * np.pi * p)
        result: FloatArray = 0.5 * np.stack(
            [sine[..., 0] ** 2 * double[..., 1], -double[..., 0] * sine[..., 1] ** 2], axis=-1
        )
        return result

    def result(points: FloatArray) -> FloatArray:
        p, h = points, -time / _CHARACTERISTIC_STEPS
        for _ in range(_CHARACTERISTIC_STEPS if time > 0 else 0):
            k1 = velocity(p)
            k2 = velocity(p + h / 2 * k1)
            k3 = velocity(p + h / 2 * k2)
            p = p + h / 6 * (k1 + 2 * k2 + 2 * k3 + velocity(p + h * k3))
        return body(p)

    return result


def _vortex(points: FloatArray) -> FloatArray:
    return np.asarray((np.sin(np.pi * points) ** 2).prod(axis=-1) / np.pi)


def deformations() -> list[Problem]:
    """All problems of deformation."""
    return [
        problem_of_field(
            "vortex",
            "A Gaussian (sigma 0.1) wound up by a vortex, no diffusion, one way.",
            dimension=2,
            regime="smooth",
            sizes=(32, 64, 128),
            duration=1.0,
            flow=vortex_flow,
            field=lambda time: carried_by_vortex(gaussian((0.5, 0.3), 0.1), time),
        ),
        problem_of_field(
            "sheared-disc",
            "A Gaussian (sigma 0.06) sheared by omega(r) while it spreads with D = 3e-4 m^2/s.",
            dimension=2,
            regime="smooth",
            sizes=(32, 64, 128),
            duration=1.0,
            flow=sheared_disc_flow,
            field=_DISC.concentration,
            laws=(uniform_diffusion(_DISC.diffusivity * np.eye(2)),),
        ),
        problem_of_field(
            "swirl-reversed",
            "LeVeque's swirl (1996) of three bodies, there and back; the way back undoes "
            "dispersion, so that this flatters dispersive schemes.",
            dimension=2,
            regime="sharp",
            sizes=(64, 128),
            duration=_SWIRL_PERIOD,
            flow=swirl_flow,
            field=lambda time: three_bodies,
        ),
    ]
