"""Rigid rotation: bodies that should come back as they were.

The vessel is a disc or a ball of radius 0.5 in the unit box, full of powder, which turns once in
1 s about its middle; its rim cuts cells. A quarter turn of the disc, and a whole one of the ball,
carry cells onto cells.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from scaleup.space.flow_field import FlowField
from scaleup.space.grid import FloatArray
from scaleup.verification.bodies import (
    gaussian,
    slotted_disc,
    sphere,
    spread_gaussian,
    three_bodies,
    turned,
)
from scaleup.verification.closed_flows import ball, plane_flow, space_flow, unit_grid
from scaleup.verification.fields import problem_of_field
from scaleup.verification.problem import Field, Problem, uniform_diffusion

_OMEGA = 2 * math.pi  # rad/s
_RADIUS = 0.5
_DIFFUSIVITY = 2e-4  # m^2/s
_TILTED = np.array([1.0, 2.0, 2.0]) / 3.0  # axis of the ball


def disc_flow(n: int) -> FlowField:
    """Rigid rotation of a disc: psi = omega/2 (R^2 - r^2)."""
    return plane_flow(unit_grid(n, 2), _stream_function, ball((0.5, 0.5), _RADIUS))


def ball_flow(n: int) -> FlowField:
    """Rigid rotation of a ball about a tilted axis: A = (R^2 - r^2) omega/2."""

    def potential(points: FloatArray) -> FloatArray:
        return np.multiply.outer(_stream_function(points), _TILTED)

    return space_flow(unit_grid(n, 3), potential, ball((0.5, 0.5, 0.5), _RADIUS))


def _stream_function(points: FloatArray) -> FloatArray:
    squared: FloatArray = ((points - 0.5) ** 2).sum(axis=-1)
    return 0.5 * _OMEGA * (_RADIUS**2 - squared)


def turned_about_tilted_axis(body: Field, angle: float) -> Field:
    """A body turned about the ball's axis (rad), by Rodrigues' formula."""
    cosine, sine = math.cos(angle), -math.sin(angle)  # the points are turned back

    def result(points: FloatArray) -> FloatArray:
        arm = points - 0.5
        along = (arm @ _TILTED)[..., None] * _TILTED
        back = cosine * arm + sine * np.cross(_TILTED, arm) + (1.0 - cosine) * along
        return body(back + 0.5)

    return result


def _banded(points: FloatArray) -> FloatArray:
    """Smooth up to the rim, without being constant along it or across it."""
    x, y = points[..., 0] - 0.5, points[..., 1] - 0.5
    share: FloatArray = 0.5 + 0.25 * np.sin(5.0 * x) + 0.25 * np.sin(3.0 * y)
    return share


def _spreading(time: float) -> Field:
    spread = spread_gaussian((0.5, 0.7), 0.05, _DIFFUSIVITY * np.eye(2), time)
    return turned(spread, _OMEGA * time)


def rotations() -> list[Problem]:
    """All problems of rigid rotation."""
    plane = partial(problem_of_field, dimension=2, duration=1.0, flow=disc_flow, landings=4)
    space = partial(problem_of_field, dimension=3, duration=1.0, flow=ball_flow, landings=1)
    return [
        plane(
            "zalesak",
            "Zalesak's slotted disc (1979), one turn in a round bed.",
            regime="sharp",
            sizes=(50, 100, 200),
            field=lambda time: turned(slotted_disc, _OMEGA * time),
        ),
        plane(
            "three-bodies",
            "LeVeque's slotted disc, cone and hump (1996), one turn in a round bed.",
            regime="sharp",
            sizes=(64, 128, 256),
            field=lambda time: turned(three_bodies, _OMEGA * time),
        ),
        plane(
            "gaussian",
            "A Gaussian (sigma 0.05), one turn in a round bed, no diffusion.",
            regime="smooth",
            sizes=(64, 128, 256),
            field=lambda time: turned(gaussian((0.5, 0.75), 0.05), _OMEGA * time),
        ),
        plane(
            "gaussian-diffusing",
            "A Gaussian (sigma 0.05), one turn while it spreads with D = 2e-4 m^2/s.",
            regime="smooth",
            sizes=(64, 128, 256),
            field=_spreading,
            laws=(uniform_diffusion(_DIFFUSIVITY * np.eye(2)),),
        ),
        plane(
            "full-drum",
            "Bands that reach the wall, one turn in a full drum: the cut cells at the rim count.",
            regime="boundary",
            sizes=(32, 64, 128),
            field=lambda time: turned(_banded, _OMEGA * time),
            bed=lambda time: ball((0.5, 0.5), _RADIUS),
        ),
        space(
            "gaussian-3d",
            "A Gaussian (sigma 0.08) in a ball, one turn about a tilted axis.",
            regime="smooth",
            sizes=(24, 36, 48),
            field=lambda time: turned_about_tilted_axis(
                gaussian((0.7, 0.5, 0.5), 0.08), _OMEGA * time
            ),
        ),
        space(
            "sphere-3d",
            "A sphere (radius 0.15) in a ball, one turn about a tilted axis.",
            regime="sharp",
            sizes=(24, 36, 48),
            field=lambda time: turned_about_tilted_axis(
                sphere((0.75, 0.5, 0.5), 0.15), _OMEGA * time
            ),
        ),
    ]
