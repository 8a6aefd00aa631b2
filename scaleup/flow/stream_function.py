"""Plane flows from a stream function: their divergence vanishes identically.

With psi at the cell corners, u = dpsi/dy and v = -dpsi/dx, the flux through a face is the
difference of psi between its two ends times the depth, so a cell's net flux is a sum in which
every corner appears with both signs. psi = 0 outside the bed closes the wall and the free surface,
cut faces included.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from scaleup.flow.nearest_fluxes import conjugate_gradients, laplacian
from scaleup.space.flow_field import Axis, FlowField, Frame, interval_from_dense
from scaleup.space.grid import BoolArray, FloatArray, Grid

_STILL = 1e-9  # of the greatest relative speed: below it a direction would be rounding


def flow_from_stream_function(
    grid: Grid,
    psi: FloatArray,
    fill: FloatArray,
    shear_rate: FloatArray,
    *,
    axis: Axis,
    angular_velocity: float,
    lift: float,
    summary: Mapping[str, Any],
    frame: Frame = "lab",
    warnings: tuple[str, ...] = (),
) -> FlowField:
    """A steady plane FlowField.

    psi        -- m^2/s at all corners, shape (ny + 1, nx + 1), 0 outside the bed
    fill       -- m^3, shape (ny, nx)
    shear_rate -- 1/s, shape (ny, nx)
    The direction is that of the cell's velocity relative to rigid rotation.

    A box of powder, full, that circulates:

    >>> from scaleup.space.grid import grid_over
    >>> grid = grid_over((0.0, 0.0), (0.08, 0.08), spacing=0.01, depth=0.01)
    >>> x, y = np.moveaxis(grid.corner_points(), -1, 0)
    >>> inside = (x > 1e-9) & (x < 0.08 - 1e-9) & (y > 1e-9) & (y < 0.08 - 1e-9)
    >>> psi = np.where(inside, 1e-4 * np.sin(np.pi * x / 0.08) * np.sin(np.pi * y / 0.08), 0.0)
    >>> fill = np.zeros(grid.shape)
    >>> fill[1:-1, 1:-1] = grid.cell_volume
    >>> flow = flow_from_stream_function(grid, psi, fill, np.zeros(grid.shape), axis=Axis(),
    ...                                  angular_velocity=0.5, lift=0.0, summary={})
    >>> flow.steady, float(abs(flow.intervals[0].outflow(grid)).max()) < 1e-20  # m^3/s
    (True, True)
    """
    faces = [np.diff(psi, axis=0) * grid.depth, -np.diff(psi, axis=1) * grid.depth]
    none = np.zeros((2, *grid.shape))
    interval = interval_from_dense(0.0, 1.0, grid, fill, fill, faces, shear_rate, none)
    relative = interval.velocity(grid)
    if frame == "lab":
        arm = grid.centre_points(interval.cells).T - np.array(axis.point[:2])[:, None]
        relative += angular_velocity * np.stack([arm[1], -arm[0]])
    speed = np.linalg.norm(relative, axis=0)
    moves = speed > _STILL * speed.max(initial=0.0)
    direction = np.divide(relative, speed, out=np.zeros_like(relative), where=moves)
    interval = replace(interval, direction=direction)
    return FlowField(
        grid=grid,
        frame=frame,
        axis=axis,
        angular_velocity=angular_velocity,
        intervals=[interval],
        lift=lift,
        summary=summary,
        warnings=warnings,
    )


def fit_stream_function(
    grid: Grid, inside: BoolArray, wet: list[FloatArray], flux: list[FloatArray]
) -> FloatArray:
    """The stream function whose face fluxes are nearest to given ones (discrete Hodge projection).

    Minimises the sum over wet faces of (F - flux)^2 / wet, with F the difference of psi along the
    face and psi = 0 at corners not `inside`: a weighted discrete Poisson problem, -div(1/wet grad
    psi) = curl(flux / wet), solved by conjugate gradients with algebraic multigrid (PETSc). What is
    removed is the part of the flux with divergence and through the boundary.

    inside -- corners strictly within the bed, shape (ny + 1, nx + 1)
    wet    -- wet length of the faces normal to x, (ny, nx + 1), and to y, (ny + 1, nx), m
    flux   -- given flux per depth through the wet part, the same shapes, m^2/s
    Returns psi, m^2/s, shape (ny + 1, nx + 1). Runs on this process alone.
    Raises RunError if the linear solve does not converge.
    """
    number = np.full(inside.shape, -1, dtype=np.int64)
    n = int(inside.sum())
    number[inside] = np.arange(n)
    weight = [np.divide(1.0, w, out=np.zeros_like(w), where=w > 0) for w in wet]
    # faces normal to x run along y from corner (j, i) to (j + 1, i); F_x = +(end - begin)
    # faces normal to y run along x from corner (j, i) to (j, i + 1); F_y = -(end - begin)
    begin = [number[:-1, :].ravel(), number[:, :-1].ravel()]
    end = [number[1:, :].ravel(), number[:, 1:].ravel()]
    right = np.zeros(n)
    diagonal = np.zeros(n)
    for a, b, k, given, sign in zip(begin, end, weight, flux, (1.0, -1.0), strict=True):
        stiffness, target = k.ravel(), sign * (k * given).ravel()
        for here, direction in ((a, -1.0), (b, 1.0)):
            own = here >= 0
            np.add.at(diagonal, here[own], stiffness[own])
            np.add.at(right, here[own], direction * target[own])
    first, last, stiff = (np.concatenate([p.ravel() for p in c]) for c in (begin, end, weight))
    both = (first >= 0) & (last >= 0) & (stiff > 0)
    matrix = laplacian(diagonal, first[both], last[both], stiff[both])
    with conjugate_gradients(matrix, 1e-10, most=2000) as solve:
        solution = solve(right)
    psi = np.zeros(inside.shape)
    psi[inside] = solution
    return psi
