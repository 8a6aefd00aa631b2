"""Closed flows whose face fluxes are exact and whose divergence vanishes to round-off.

A vessel is a level set, positive inside, of points (..., dimension). In the plane the flux through
a face is the difference of a stream function psi between its two ends (u = dpsi/dy, v = -dpsi/dx);
in space it is the circulation of a vector potential A around it (v = curl A). Both count as 0
where the level set is not positive, which closes the wall, cut faces included; where psi or A
vanish on the wall, the fluxes are those of the flow itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.special import roots_legendre

from scaleup.space.cut_cells import cut_fraction
from scaleup.space.flow_field import Axis, FlowField, Interval, interval_from_dense
from scaleup.space.grid import FloatArray, Grid
from scaleup.verification.problem import Field

_ROUNDING = 1e-12  # of the unit box: corners this near to the wall lie on it


def unit_grid(n: int, dimension: int) -> Grid:
    """n^dimension cells on the unit box and one layer around it."""
    return Grid((-1.0 / n,) * dimension, (1.0 / n,) * dimension, (n + 2,) * dimension)


def box(points: FloatArray) -> FloatArray:
    """Level set of the unit box."""
    return np.asarray(np.minimum(points, 1.0 - points).min(axis=-1))


def ball(centre: tuple[float, ...], radius: float) -> Field:
    """Level set of a disc or a ball."""

    def level(points: FloatArray) -> FloatArray:
        distance: FloatArray = np.linalg.norm(points - np.array(centre), axis=-1)
        return radius - distance

    return level


def plane_flow(grid: Grid, stream_function: Field, vessel: Field) -> FlowField:
    """A steady plane flow; `stream_function` in m^2/s, 0 on the wall."""
    points = grid.corner_points()
    level = _on_corners(vessel, points)
    psi = np.where(level > 0, stream_function(points), 0.0) * grid.depth
    return _steady(grid, level, [np.diff(psi, axis=0), -np.diff(psi, axis=1)])


def space_flow(grid: Grid, potential: Field, vessel: Field) -> FlowField:
    """A steady flow in space; `potential` gives A (..., 3) in m^2/s, 0 on the wall."""
    points = grid.corner_points()
    level = _on_corners(vessel, points)
    along = [_edge_integrals(grid, points, level, potential, axis) for axis in range(3)]
    # array dimensions are (z, y, x): the flux is the circulation around a face
    faces = [
        np.diff(along[2], axis=1) - np.diff(along[1], axis=0),
        np.diff(along[0], axis=0) - np.diff(along[2], axis=2),
        np.diff(along[1], axis=2) - np.diff(along[0], axis=1),
    ]
    return _steady(grid, level, faces)


def pulsating(steady: FlowField, mean_factors: FloatArray, duration: float) -> FlowField:
    """A steady flow times a factor of time: equal intervals with the factor's mean in each."""
    base = steady.intervals[0]
    times = np.linspace(0.0, duration, len(mean_factors) + 1)
    parts = [
        replace(base, start=float(a), end=float(b), flux=base.flux * factor)
        for (a, b), factor in zip(pairwise(times), mean_factors, strict=True)
    ]
    return replace(steady, intervals=parts, prefix=len(parts))


def _on_corners(vessel: Field, points: FloatArray) -> FloatArray:
    level = vessel(points)
    return np.where(np.abs(level) < _ROUNDING, 0.0, level)


def _steady(grid: Grid, level: FloatArray, faces: list[FloatArray]) -> FlowField:
    fill = cut_fraction(level) * grid.cell_volume
    none = np.zeros(grid.shape)
    part: Interval = interval_from_dense(
        0.0, 1.0, grid, fill, fill, faces, none, np.stack([none] * grid.dimension)
    )
    return FlowField(grid, "lab", Axis(), 2 * math.pi, [part])


def _edge_integrals(
    grid: Grid, points: FloatArray, level: FloatArray, potential: Field, axis: int
) -> FloatArray:
    """Line integral of A along all edges parallel to an axis, over their part in the vessel.

    The wall cuts an edge where the level set, taken as linear, vanishes; an edge without an end in
    the vessel counts as 0. Three-point Gauss quadrature: exact to the fifth degree.
    """
    dimension = grid.array_axis(axis)
    count = grid.counts[axis]
    low, high = (
        np.take(level, range(count), dimension),
        np.take(level, range(1, count + 1), dimension),
    )
    start = np.take(points, range(count), dimension)
    crossing = np.divide(low, low - high, out=np.zeros_like(low), where=low != high)
    begin = np.where(low > 0, 0.0, crossing)
    end = np.where(high > 0, 1.0, crossing)
    wet = (low > 0) | (high > 0)
    unit = np.zeros(grid.dimension)
    unit[axis] = grid.spacing[axis]
    total = np.zeros(low.shape)
    for node, weight in zip(*roots_legendre(3), strict=True):
        share = begin + (end - begin) * 0.5 * (1.0 + node)
        total += 0.5 * weight * potential(start + share[..., None] * unit)[..., axis]
    return np.where(wet, total * (end - begin) * grid.spacing[axis], 0.0)
