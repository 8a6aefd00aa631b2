"""Initial concentrations: the loading pattern, carried to the first instant of the flow."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from scaleup.scene.loading_file import read_loading
from scaleup.scene.models import Loading
from scaleup.space.flow_field import FlowField
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

_POINTS_PER_EDGE = 4
DOWN_THE_LAYERS = {"x": (0, 1.0), "y": (1, -1.0), "z": (2, -1.0)}  # left, top and front come first


def initial_concentration(loading: Loading, flow: FlowField) -> FloatArray:
    """Mean concentration in each active cell of the first interval, shape (components, n).

    Layers are cut so that each has its share of the bed's volume, to round-off; the material of a
    cell counts as spread evenly over its extent across the layers. Cells cut by a region's edge get
    the mean over 4^dimension points. A file gives each cell the nearest point's concentrations.
    Components sum to 1 in every cell.

    Raises InputError if the bed holds nothing of a component, or nothing else.
    """
    fill = flow.intervals[0].fill_start
    if loading.pattern == "region":
        concentration = _region(loading, flow)
    elif loading.pattern == "file":
        concentration = _from_file(loading, flow)
    else:
        concentration = _layers(loading, flow)
    shares = concentration @ fill / fill.sum()
    for number, share in enumerate(shares, start=1):
        if share <= 0 or share >= 1:
            raise InputError(
                f"operation.loading: component {number} is {share:.0%} of the bed; there is "
                "nothing to blend"
            )
    return concentration


def _layers(loading: Loading, flow: FlowField) -> FloatArray:
    """Layers across a direction, each of one component."""
    first, grid = flow.intervals[0], flow.grid
    axis, sign = DOWN_THE_LAYERS[loading.direction or "x"]
    along = sign * flow.level_coordinates(grid.centre_points(first.cells))[:, axis]
    # how far a cell reaches on both sides of its centre; turned cells reach further
    edges = flow.level_coordinates(np.vstack([np.diag(grid.spacing), np.zeros(grid.dimension)]))
    reach = 0.5 * float(np.abs(edges[:-1, axis] - edges[-1, axis]).sum())
    shares = np.cumsum(loading.layers)[:-1]
    cuts = _volume_cuts(along, reach, first.fill_start, shares)
    below = np.clip((cuts[:, None] - along + reach) / (2 * reach), 0.0, 1.0)
    bounds = np.vstack([np.zeros_like(along), below, np.ones_like(along)])
    concentration = np.zeros((max(loading.layer_components), len(along)))
    for component, layer in zip(loading.layer_components, np.diff(bounds, axis=0), strict=True):
        concentration[component - 1] += layer
    return concentration


def _volume_cuts(
    along: FloatArray, reach: float, fill: FloatArray, shares: FloatArray
) -> FloatArray:
    """Coordinates below which the given shares of the total fill lie.

    along -- of the cells' centres, (n,); their fill is spread over +-reach. The volume below a
    coordinate is then piecewise linear, and its inverse exact.
    """
    ends = np.concatenate([along - reach, along + reach])
    order = np.argsort(ends, kind="stable")
    slope = np.cumsum(np.concatenate([fill, -fill])[order]) / (2 * reach)
    ends = ends[order]
    volume = np.concatenate([[0.0], np.cumsum(slope[:-1] * np.diff(ends))])
    return np.interp(shares * volume[-1], volume, ends)


def _region(loading: Loading, flow: FlowField) -> FloatArray:
    """Component 1 in a disc or ball, component 2 around it."""
    assert loading.radius is not None  # the model's validator has seen to it
    cells, grid, centre = flow.intervals[0].cells, flow.grid, np.array(loading.centre)

    def beyond(points: FloatArray) -> FloatArray:
        offset = flow.level_coordinates(points) - centre
        return np.asarray(np.linalg.norm(offset, axis=-1) - loading.radius)

    distance = beyond(grid.centre_points(cells))
    inside = (distance <= 0).astype(float)
    cut = np.abs(distance) <= 0.5 * float(np.linalg.norm(grid.spacing))
    inside[cut] = (beyond(grid.sample_points(cells[cut], _POINTS_PER_EDGE)) <= 0).mean(axis=1)
    return np.stack([inside, 1.0 - inside])


def _from_file(loading: Loading, flow: FlowField) -> FloatArray:
    """The concentrations of the nearest point in the file."""
    assert loading.file is not None  # the model's validator has seen to it
    points, concentration = read_loading(loading.file, flow.grid.dimension)
    here = flow.level_coordinates(flow.grid.centre_points(flow.intervals[0].cells))
    _, nearest = cKDTree(points).query(here)
    found: FloatArray = concentration[:, nearest]
    return found
