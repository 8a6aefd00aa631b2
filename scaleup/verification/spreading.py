"""Diffusion alone."""

from __future__ import annotations

import numpy as np

from scaleup.space.flow_field import FlowField
from scaleup.verification.bodies import spread_gaussian
from scaleup.verification.closed_flows import box, plane_flow, unit_grid
from scaleup.verification.fields import problem_of_field
from scaleup.verification.problem import Problem, uniform_diffusion

_TENSOR = 1e-3 * np.array([[2.0, 1.2], [1.2, 1.0]])  # m^2/s; ratio of its principal values 12


def still_flow(n: int) -> FlowField:
    """A full unit box at rest."""
    return plane_flow(unit_grid(n, 2), lambda points: 0.0 * points[..., 0], box)


def spreading() -> list[Problem]:
    """All problems without flow."""
    return [
        problem_of_field(
            "anisotropic",
            "A Gaussian (sigma 0.07) at rest, spread by a tensor with D_xy and principal values "
            "12 : 1.",
            dimension=2,
            regime="smooth",
            sizes=(32, 64, 128),
            duration=1.0,
            flow=still_flow,
            field=lambda time: spread_gaussian((0.5, 0.5), 0.07, _TENSOR, time),
            laws=(uniform_diffusion(_TENSOR),),
        )
    ]
