"""The surface-layer model for any vessel: a periodic FlowField on the grid that turns with it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from scaleup.api import (
    CompactIntervals,
    FlowField,
    InputError,
    Progress,
    Scene,
    level_height,
)
from scaleup_surface_layer.closed_form import layer_shear_rate
from scaleup_surface_layer.detectors import Findings
from scaleup_surface_layer.lab_columns import Columns
from scaleup_surface_layer.revolution import revolve
from scaleup_surface_layer.sandpile import slope_law
from scaleup_surface_layer.turned_vessel import TurnedVessel
from scaleup_surface_layer.vessel_frame import VesselFrame

if TYPE_CHECKING:
    from scaleup_surface_layer import SurfaceLayer

_RIM_CELLS = 4  # by how many cells the rim may turn in an interval
_LONGEST = 120  # intervals in a revolution, at least: 3 degrees
_ACROSS = 72  # columns across the vessel, at most, unless asked for


def general_flow(scene: Scene, options: SurfaceLayer.Options, progress: Progress) -> FlowField:
    """The flow from the settled level bed on, then one revolution that repeats.

    1 the bed in lab columns, step by step, until it repeats itself (`revolution`); of a vessel that
      is its own mirror image in z, one half, and nothing crosses the plane between them;
    2 interval by interval, fills and fluxes on the vessel's grid (`vessel_frame`).
    """
    geometry, grid, omega = scene.geometry, scene.grid, scene.speed
    if np.abs(np.array(geometry.axis.direction) - (0.0, 0.0, 1.0)).max() > 1e-12:
        raise InputError("flow.name = 'surface-layer': the axis of rotation must run along z")
    columns = lab_columns(scene, options)
    per_revolution = options.intervals or _intervals(scene)
    multiple = options.steps_per_interval
    shear_rate = layer_shear_rate(scene.material, options)
    frame = VesselFrame(geometry, grid, columns, omega, scene.fill_volume, shear_rate)
    vessel = TurnedVessel(frame.wall, frame.corner, frame.spacing, geometry.reach)
    halves = 2 if frame.close_mirror_plane() else 1
    solved = columns.upper_half() if halves == 2 else columns
    law = slope_law(scene.material.friction, omega, geometry.reach, options.slope_excess)
    level = level_height(geometry, scene.fill_volume) - geometry.axis.point[1]
    flat = grid.dimension == 2
    revolution = revolve(
        vessel,
        solved,
        law,
        omega,
        level,
        scene.fill_volume / halves,
        per_revolution * multiple,
        multiple,
        (8, 1) if flat else (6, 3),
        lambda share: progress(0.5 * share, "bed surface"),
    )
    steps = revolution.steps
    if halves == 2:
        steps = [step.mirrored() for step in steps]
    count, prefix = len(steps) // multiple, revolution.prefix // multiple
    times = np.arange(count + 1) * (2 * math.pi / omega / per_revolution)
    frame.begin(steps[0])
    parts = []
    goal = frame.fill.copy()
    for number in range(count):
        if number == prefix:
            goal = frame.fill.copy()
        parts.append(
            frame.advance(
                steps[number * multiple : (number + 1) * multiple],
                float(times[number]),
                float(times[number + 1]),
                goal if number == count - 1 else None,
            )
        )
        progress(0.5 + 0.5 * (number + 1) / count, "fills and fluxes of the turning vessel")
    findings = Findings(scene, solved, revolution, frame)
    return FlowField(
        grid=grid,
        frame="vessel",
        axis=geometry.axis,
        angular_velocity=omega,
        intervals=CompactIntervals(parts, times, frame.capacity),
        prefix=prefix,
        summary=findings.summary(),
        warnings=findings.warnings(),
    )


def lab_columns(scene: Scene, options: SurfaceLayer.Options) -> Columns:
    """Columns over everything that the vessel sweeps, of the asked or a suitable spacing."""
    geometry, grid = scene.geometry, scene.grid
    reach = geometry.reach
    spacing = options.column_spacing or max(1.5 * grid.spacing[0], 2 * reach / _ACROSS)
    if grid.dimension == 2:
        spacing = options.column_spacing or max(grid.spacing[0], 2 * reach / (4 * _ACROSS))
    across = 2 * max(8, math.ceil(reach / spacing - 1e-9))
    dx = 2 * reach / across
    if grid.dimension == 2:
        return Columns(-reach, dx, across, -0.5 * grid.depth, grid.depth, 1)
    width = geometry.upper[2] - geometry.lower[2]
    along = 2 * max(1, round(0.5 * width / dx))
    return Columns(-reach, dx, across, geometry.lower[2], width / along, along)


def _intervals(scene: Scene) -> int:
    """Per revolution: 3 degrees, or less where the rim would turn by more than a few cells."""
    rim = 2 * math.pi * scene.geometry.reach / scene.grid.spacing[0]
    return 4 * math.ceil(max(_LONGEST, rim / _RIM_CELLS) / 4)
