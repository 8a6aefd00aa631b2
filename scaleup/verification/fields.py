"""Problems whose exact solution is a function of place and time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
from scipy.special import roots_legendre

from scaleup.contract import Law
from scaleup.space.flow_field import FlowField
from scaleup.space.grid import FloatArray, Grid, IntArray
from scaleup.verification.problem import (
    Field,
    Problem,
    Regime,
    interval_at,
    two_components,
)


def problem_of_field(
    name: str,
    sentence: str,
    *,
    dimension: int,
    regime: Regime,
    sizes: tuple[int, ...],
    duration: float,
    flow: Callable[[int], FlowField],
    field: Callable[[float], Field],
    bed: Callable[[float], Field] | None = None,
    laws: tuple[Law, ...] = (),
    landings: int = 0,
) -> Problem:
    """A problem of two components, the first being the cell means of `field(time)`.

    bed -- level set of the bed at a time, if the means are to be taken over the wet part of cells
    """

    def at(flow: FlowField, time: float) -> FloatArray:
        cells = interval_at(flow, time)[0].cells
        inside = None if bed is None else bed(time)
        share = cell_means(flow.grid, cells, field(time), sharp=regime == "sharp", inside=inside)
        return two_components(share)

    return Problem(
        name=name,
        sentence=sentence,
        dimension=dimension,
        regime=regime,
        sizes=sizes,
        duration=duration,
        flow=flow,
        initial=lambda flow: at(flow, 0.0),
        exact=at,
        laws=laws,
        landings=landings,
    )


def cell_means(
    grid: Grid, cells: IntArray, body: Field, *, sharp: bool = False, inside: Field | None = None
) -> FloatArray:
    """Means of a body over cells, shape (n,).

    Gauss quadrature with 3 points along each edge; for a `sharp` body, or over the part of the
    cell where the level set `inside` is positive, regular samples: 16 along each edge (6 in 3-D).
    A cell without a sample inside takes the value at its centre.
    """
    regular = sharp or inside is not None
    nodes, weights = roots_legendre(3)
    if regular:
        count = 16 if grid.dimension == 2 else 6
        nodes, weights = (2 * np.arange(count) + 1) / count - 1.0, np.full(count, 2.0 / count)
    centres = grid.centre_points(cells)
    total, weight_sum = np.zeros(len(cells)), np.zeros(len(cells))
    for place in product(range(len(nodes)), repeat=grid.dimension):
        points = centres + 0.5 * nodes[list(place)] * np.array(grid.spacing)
        weight = np.full(len(cells), weights[list(place)].prod())
        if inside is not None:
            weight = np.where(inside(points) > 0, weight, 0.0)
        total += weight * body(points)
        weight_sum += weight
    empty = weight_sum == 0
    if empty.any():
        total[empty], weight_sum[empty] = body(centres[empty]), 1.0
    return total / weight_sum
