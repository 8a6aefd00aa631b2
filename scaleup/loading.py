"""Initial concentrations: the loading pattern, carried to the first instant of the flow."""

from __future__ import annotations

import numpy as np

from scaleup.errors import InputError
from scaleup.flow_field import FlowField
from scaleup.grid import FloatArray
from scaleup.scene import Loading

_POINTS_PER_EDGE = 4


def initial_concentration(loading: Loading, flow: FlowField) -> FloatArray:
    """Mean concentration in each active cell of the first interval, shape (components, n).

    Cells cut by the boundary between components get the mean over 4^dimension points. The layers
    of side-by-side and top-bottom are cut so that each component has its share of the bed's
    volume. Components sum to 1 in every cell.

    Raises InputError if the bed holds nothing of a component, or nothing else.
    """
    first = flow.intervals[0]
    points = flow.level_coordinates(flow.grid.sample_points(first.cells, _POINTS_PER_EDGE))
    concentration = _pattern(loading, points, first.fill_start)
    shares = concentration @ first.fill_start / first.fill_start.sum()
    for number, share in enumerate(shares, start=1):
        if share <= 0 or share >= 1:
            raise InputError(
                f"operation.loading: component {number} is {share:.0%} of the bed; there is "
                "nothing to blend"
            )
    return concentration


def _pattern(loading: Loading, points: FloatArray, fill: FloatArray) -> FloatArray:
    """Concentrations (components, n) from sample points (n, per cell, dimension) and fill (n,)."""
    if loading.pattern == "region":
        assert loading.radius is not None  # the model's validator has seen to it
        distance = np.linalg.norm(points - np.array(loading.centre), axis=-1)
        inside = (distance <= loading.radius).mean(axis=1)
        return np.stack([inside, 1.0 - inside])
    # left to right, or top to bottom
    along = points[..., 0] if loading.pattern == "side-by-side" else -points[..., 1]
    count = points.shape[1]
    weight = np.repeat(fill / count, count)
    cuts = _volume_cuts(along.ravel(), weight, np.cumsum(loading.layers)[:-1])
    layer = np.searchsorted(cuts, along)
    return np.stack([(layer == k).mean(axis=1) for k in range(loading.components)])


def _volume_cuts(along: FloatArray, weight: FloatArray, shares: FloatArray) -> FloatArray:
    """Coordinates below which the given shares of the total weight lie."""
    order = np.argsort(along, kind="stable")
    cumulative = np.cumsum(weight[order])
    middle = cumulative - 0.5 * weight[order]
    return np.interp(shares * cumulative[-1], middle, along[order])
