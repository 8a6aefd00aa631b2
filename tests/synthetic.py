"""Small flows whose every number is known."""

from __future__ import annotations

import math

import numpy as np

from scaleup.contract import Axis, FlowField, Grid, Interval
from scaleup.numerics import fill_to_volume, grid_over, interval_from_dense


def sloshing(intervals: int = 8, columns: int = 16, rows: int = 6, prefix: int = 0) -> FlowField:
    """A vessel-frame flow with a moving fill: a box of powder whose surface sloshes.

    `rows` full rows lie under one row with fill s_i(t) in (0, 1). Column i passes Q_i(t) = A
    sin(pi i/n) cos(2 pi k/K) to column i + 1, spread evenly over the full rows; the vertical
    fluxes follow from continuity. Over the K intervals of a period every Q_i sums to zero.
    """
    grid = Grid((0.0, 0.0), (0.01, 0.01), (columns + 2, rows + 3), depth=0.02)
    dt, cell = 0.1, grid.cell_volume
    fill = np.zeros(grid.shape)
    fill[1 : rows + 1, 1:-1] = cell
    surface = rows + 1
    fill[surface, 1:-1] = 0.5 * cell
    faces = np.arange(columns + 1)
    parts = []
    for k in range(-prefix, intervals):
        transfer = 0.15 * cell / dt * np.sin(math.pi * faces / columns)
        transfer[[0, -1]] = 0.0
        transfer = transfer * math.cos(2 * math.pi * k / intervals)
        if k < 0:
            transfer = 0.0 * transfer
        across = np.zeros((grid.shape[0], grid.shape[1] + 1))
        across[1 : rows + 1, 1 : columns + 2] = transfer / rows
        upward = np.zeros((grid.shape[0] + 1, grid.shape[1]))
        for row in range(1, rows + 1):
            upward[row + 1, 1:-1] = -np.diff(transfer) * row / rows
        after = fill.copy()
        after[surface, 1:-1] -= dt * np.diff(transfer)
        if k == intervals - 1:
            after[surface, 1:-1] = 0.5 * cell
        rate = np.where(fill > 0, 2.0, 0.0)
        direction = np.zeros((2, *grid.shape))
        direction[0][fill > 0] = 1.0
        start = (k + prefix) * dt
        end = (k + prefix + 1) * dt
        parts.append(
            interval_from_dense(start, end, grid, fill, after, [across, upward], rate, direction)
        )
        fill = after
    return FlowField(grid, "vessel", Axis(), 1.0, parts, prefix=prefix)


def settled(geometry, volume: float, spacing: float) -> FlowField:
    """A level bed of a volume (m^3) at rest in a vessel, on cells of the given edge (m)."""
    grid = grid_over(geometry.lower, geometry.upper, spacing, geometry.depth)
    corners = grid.corner_points()
    wall = geometry.signed_distance(corners)
    fill, _ = fill_to_volume(grid, -corners[..., 1], wall, volume)
    still = []
    for axis in range(grid.dimension):
        shape = list(grid.shape)
        shape[grid.array_axis(axis)] += 1
        still.append(np.zeros(shape))
    nowhere = np.zeros((grid.dimension, *grid.shape))
    part = interval_from_dense(0.0, 1.0, grid, fill, fill, still, np.zeros(grid.shape), nowhere)
    return FlowField(grid, "vessel", geometry.axis, 1.0, [part])


def donor_cell(flow: FlowField, interval: Interval, content: np.ndarray) -> np.ndarray:
    """First-order upwind transport of content (m^3 of a component) over one interval."""
    grid = flow.grid
    fill, held = np.zeros(grid.cells), np.zeros(grid.cells)
    fill[interval.cells] = interval.fill_start
    held[interval.cells] = content
    concentration = np.divide(held, fill, out=np.zeros_like(held), where=fill > 0)
    concentration = concentration.reshape(grid.shape)
    change = np.zeros(grid.shape)
    for axis, faces in enumerate(interval.face_fluxes(grid)):
        along = grid.array_axis(axis)
        pad = [(0, 0)] * grid.dimension
        pad[along] = (1, 1)
        padded = np.pad(concentration, pad)
        count = faces.shape[along]
        behind = np.take(padded, range(count), along)
        ahead = np.take(padded, range(1, count + 1), along)
        carried = np.where(faces > 0, behind, ahead) * faces
        change -= np.diff(carried, axis=along)
    return content + interval.duration * change.ravel()[interval.cells]
