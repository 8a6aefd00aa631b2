"""Sloshing: a bed whose surface moves, with an exact map, in the plane and in space.

In the unit box powder of mean height H moves as columns: along each horizontal direction x

    u = a g(t) sin(pi x),   v = -pi a g(t) cos(pi x) y      (summed over x and z in space),

tangent to walls and floor and free of divergence. With G = int g dt and s = exp(pi a G) a column
that began at x0 is at tan(pi x/2) = s tan(pi x0/2), so that everything is known in closed form:

    stretch  X = dx/dx0 = s (1 + T^2)/(1 + s^2 T^2), T = tan(pi x0/2);   y = y0/X,   h = H/X.

A column between x1 and x2 always holds H (x0(x2) - x0(x1)); fills follow from it on sub-columns
eight times narrower than the cells, and the flux through a vertical face is what the columns
behind it gain or lose, shared over its height as it is wet. Horizontal faces pass what remains,
so that fill and flux agree to round-off. A further direction z has G out of phase, so that the
motion does not come back on its own way. The error of the fluxes being constant during an interval
is second order; intervals shorten as cells do.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from itertools import pairwise

import numpy as np

from scaleup.space.flow_field import Axis, FlowField, Interval, interval_from_dense
from scaleup.space.grid import BoolArray, FloatArray, Grid
from scaleup.verification.closed_flows import unit_grid
from scaleup.verification.fields import problem_of_field
from scaleup.verification.problem import Field, Problem

_HEIGHT = 0.5  # m, of the bed at rest
_SWELL = 0.4  # greatest pi a G in the plane: the surface spans 0.34 to 0.75 m
_PARTS = 8  # sub-columns along each edge of a cell
_DURATION = 1.25  # s, of a period of 1 s: ends at the greatest displacement


def stretches(time: float, dimension: int) -> list[float]:
    """The log of s for each horizontal direction at a time, s."""
    share = 1.0 if dimension == 2 else 0.5
    phases = [math.sin(2 * math.pi * time), 0.5 * (1.0 - math.cos(2 * math.pi * time))]
    return [_SWELL * share * phase for phase in phases[: dimension - 1]]


def origin(x: FloatArray, log_s: float) -> FloatArray:
    """x0 of columns now at x."""
    half_angle: FloatArray = np.arctan(math.exp(-log_s) * np.tan(0.5 * math.pi * x))
    return 2 / math.pi * half_angle


def contraction(x: FloatArray, log_s: float) -> FloatArray:
    """dx0/dx = 1/X of columns now at x: what their height is multiplied by."""
    s, t = math.exp(-log_s), np.tan(0.5 * math.pi * x)
    result: FloatArray = s * (1 + t**2) / (1 + s**2 * t**2)
    return result


def surface(points: FloatArray, time: float) -> FloatArray:
    """Height of the bed at the horizontal coordinates of points (..., dimension), m."""
    height = np.full(points.shape[:-1], _HEIGHT)
    for place, log_s in zip((0, 2), stretches(time, points.shape[-1]), strict=False):
        height = height * contraction(points[..., place], log_s)
    return height


def carried(body: Field, time: float) -> Field:
    """A body carried by the flow from time 0."""

    def result(points: FloatArray) -> FloatArray:
        back = np.array(points, dtype=float)
        shrunk = np.ones(points.shape[:-1])
        for place, log_s in zip((0, 2), stretches(time, points.shape[-1]), strict=False):
            x = np.clip(points[..., place], 0.0, 1.0)
            back[..., place] = origin(x, log_s)
            shrunk = shrunk * contraction(x, log_s)
        back[..., 1] = points[..., 1] / shrunk
        return body(back)

    return result


@lru_cache(maxsize=2)
def sloshing_flow(n: int, dimension: int) -> FlowField:
    """The periodic flow on n cells per unit length, in n intervals (a multiple of 4)."""
    grid = unit_grid(n, dimension)
    times = np.linspace(0.0, 1.0, n + 1)
    fills = [_fill(grid, n, float(t)) for t in times[:-1]]
    fills.append(fills[0])
    parts = [
        _interval(grid, n, float(a), float(b), before, after)
        for (a, b), (before, after) in zip(pairwise(times), pairwise(fills), strict=True)
    ]
    return FlowField(grid, "vessel", Axis(), 2 * math.pi, parts)


def _layers(grid: Grid, factors: list[FloatArray], parts: list[int]) -> FloatArray:
    """Wet height in every layer of cells of columns H times a factor of x (and one of z), m.

    factors, parts -- along x (and z): factors at equal steps, and how many in a row are averaged
    Returns (y, x) or (z, y, x).
    """
    levels = grid.corners(1)[:-1, None]
    above_floor = levels > -0.5 * grid.spacing[1]

    def layered(height: FloatArray) -> FloatArray:
        wet = np.clip(np.expand_dims(height, -2) - levels, 0.0, grid.spacing[1]) * above_floor
        return np.asarray(wet.reshape(*wet.shape[:-1], -1, parts[0]).mean(axis=-1))

    if grid.dimension == 2:
        return layered(_HEIGHT * factors[0])
    columns = [np.multiply.outer(factors[1][k :: parts[1]], factors[0]) for k in range(parts[1])]
    return np.asarray(sum(layered(_HEIGHT * part) for part in columns) / parts[1])


def _mean_contraction(n: int, log_s: float) -> FloatArray:
    """1/X, averaged over sub-columns: exactly what each of them holds."""
    began: FloatArray = origin(np.linspace(0.0, 1.0, _PARTS * n + 1), log_s)
    return np.asarray(np.diff(began) * _PARTS * n, dtype=np.float64)


def _fill(grid: Grid, n: int, time: float) -> FloatArray:
    """Fill of every cell, m^3, from sub-columns that hold exactly what is theirs."""
    logs = stretches(time, grid.dimension)
    wet = _layers(grid, [_mean_contraction(n, log_s) for log_s in logs], [_PARTS] * len(logs))
    return _padded(grid, wet) * grid.face_area(1)


def _interval(
    grid: Grid, n: int, start: float, end: float, before: FloatArray, after: FloatArray
) -> Interval:
    logs = [stretches(t, grid.dimension) for t in (start, 0.5 * (start + end), end)]
    holds = before + after > 0
    edges = np.linspace(0.0, 1.0, n + 1)
    faces: list[FloatArray] = [np.zeros(0)] * grid.dimension
    change = (after - before) / (end - start)
    for number, axis in enumerate((0, 2)[: grid.dimension - 1]):
        # what crosses the faces of a column in all their height
        total = -_HEIGHT * (origin(edges, logs[2][number]) - origin(edges, logs[0][number]))
        total[[0, -1]] = 0.0
        if grid.dimension == 3:
            widths = [np.diff(origin(edges, log_s[1 - number])) for log_s in (logs[0], logs[2])]
            total = np.multiply.outer(total, 0.5 * (widths[0] + widths[1]))
            total = total.T if axis == 0 else total
        # is spread over it as it is wet on the average (Simpson's rule)
        wet = sum(
            share * _face_heights(grid, n, number, at)
            for share, at in zip((1 / 6, 4 / 6, 1 / 6), logs, strict=True)
        )
        along = grid.array_axis(axis)
        wet = _padded(grid, np.asarray(wet)) * _both_sides(holds, along)
        column = wet.sum(axis=-2, keepdims=True)
        share = np.divide(wet, column, out=np.zeros_like(wet), where=column > 0)
        total = _padded(grid, np.expand_dims(total, -2)) / (end - start)
        faces[axis] = share * total
        change = change + np.diff(faces[axis], axis=along)
    # horizontal faces pass what is left, counted from the floor up
    upward = -np.insert(np.cumsum(change, axis=-2), 0, 0.0, axis=-2)
    faces[1] = np.where(_both_sides(holds, grid.array_axis(1)), upward, 0.0)
    none = np.zeros(grid.shape)
    return interval_from_dense(
        start, end, grid, before, after, faces, none, np.stack([none] * grid.dimension)
    )


def _face_heights(grid: Grid, n: int, number: int, logs: list[float]) -> FloatArray:
    """Mean wet height of the faces normal to a horizontal direction, in every layer, m."""
    factors = [_mean_contraction(n, log_s) for log_s in logs]
    factors[number] = contraction(np.linspace(0.0, 1.0, n + 1), logs[number])
    parts = [_PARTS] * len(logs)
    parts[number] = 1
    return _layers(grid, factors, parts)


def _padded(grid: Grid, values: FloatArray) -> FloatArray:
    """With zeros for the layer of cells beside the box; along y it is there already."""
    width = [(1, 1)] * grid.dimension
    width[-2] = (0, 0)
    return np.pad(values, width)


def _both_sides(holds: BoolArray, along: int) -> BoolArray:
    """Which faces normal to an array's dimension have a flagged cell on either side."""
    pad = [(0, 0)] * holds.ndim
    pad[along] = (1, 1)
    wide = np.pad(holds, pad)
    count = wide.shape[along]
    both: BoolArray = np.take(wide, range(count - 1), along) & np.take(wide, range(1, count), along)
    return both


def _waves(points: FloatArray) -> FloatArray:
    """Smooth, and not constant along the surface, the floor or the walls."""
    phase = 5.0 * points[..., 0] + 4.0 * points[..., 1]
    if points.shape[-1] == 3:
        phase = phase + 3.0 * points[..., 2]
    return 0.5 + 0.4 * np.sin(phase)


def moving_fills() -> list[Problem]:
    """Sloshing in the plane and in space."""

    def sloshing(dimension: int, sizes: tuple[int, ...]) -> Problem:
        return problem_of_field(
            "sloshing" if dimension == 2 else "sloshing-3d",
            "Waves of concentration up to the surface of a bed that sloshes for 1.25 periods"
            + (", swirling." if dimension == 3 else "."),
            dimension=dimension,
            regime="boundary",
            sizes=sizes,
            duration=_DURATION,
            flow=partial(sloshing_flow, dimension=dimension),
            field=partial(carried, _waves),
            bed=lambda time: lambda points: surface(points, time) - points[..., 1],
        )

    return [sloshing(2, (32, 64, 128)), sloshing(3, (16, 24, 32))]
