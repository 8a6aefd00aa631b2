"""The surface-layer model for any vessel: a periodic FlowField on the grid that turns with it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from scaleup.contract import FlowField, Progress, Scene
from scaleup.numerics import (
    CompactInterval,
    CompactIntervals,
    MirroredParts,
    level_height,
    on_each,
    on_root,
)
from scaleup_surface_layer.closed_form import layer_shear_rate
from scaleup_surface_layer.detectors import Findings, require_result
from scaleup_surface_layer.lab_columns import Columns
from scaleup_surface_layer.layer_closing import Quality, close_interval
from scaleup_surface_layer.revolution import Revolution, revolve
from scaleup_surface_layer.sandpile import FEWEST, slope_law
from scaleup_surface_layer.turned_vessel import PhasedVessel, TurnedVessel
from scaleup_surface_layer.vessel_frame import VesselFrame, upper_half

if TYPE_CHECKING:
    from scaleup_surface_layer import SurfaceLayer

_RIM_CELLS = 8  # by how many cells the rim may turn in an interval
_LONGEST = 120  # intervals in a revolution, at least: 3 degrees
_MOVE = 0.5  # cost of going through an interval over that of closing it
_ACROSS = 72  # columns across the vessel, at most, unless asked for


def general_flow(
    scene: Scene, options: SurfaceLayer.GeneralOptions, comm: Any, progress: Progress
) -> FlowField:
    """The flow from the settled level bed on, then one revolution that repeats (collective).

    1 the bed in lab columns, step by step, until it repeats itself (`revolution`); of a vessel that
      is its own mirror image in z, the upper half, and nothing crosses the plane between them;
    2 interval by interval, which cells move and what they hold (`vessel_frame`);
    3 the fluxes of each interval (`layer_closing`), every rank for some consecutive ones.
    """
    geometry, omega = scene.geometry, scene.speed
    per_revolution = options.intervals or _intervals(scene)
    frame = on_each(comm, lambda: _frame(scene, options))
    revolution = _bed(scene, options, frame, per_revolution, comm, progress)
    multiple = revolution.multiple
    count, prefix = len(revolution.steps) // multiple, revolution.prefix // multiple
    times = np.arange(count + 1) * (2 * math.pi / omega / per_revolution)
    mine = _share(count, comm.rank, comm.size)

    def fluxes() -> tuple[list[CompactInterval], Quality]:
        quality, parts = Quality(), []
        frame.begin(revolution.steps[0])
        goal = frame.fill
        for number in range(mine.stop):
            if number == prefix:
                goal = frame.fill.copy()
            steps = revolution.steps[number * multiple : (number + 1) * multiple]
            draft = frame.move(steps, goal if number == count - 1 else None)
            if number in mine:
                start, end = float(times[number]), float(times[number + 1])
                parts.append(close_interval(frame, draft, steps, start, end, quality))
            progress(0.5 + 0.5 * (number + 1) / mine.stop, "fills and fluxes of the turning vessel")
        return parts, quality

    parts, quality = on_each(comm, fluxes)
    quality = Quality.over_ranks(comm.allgather(quality))
    capacity, held = frame.capacity, parts
    if frame.grid.counts != scene.grid.counts:
        layers = capacity.reshape(frame.grid.shape)
        capacity = np.concatenate([layers[::-1], layers]).ravel()
        held = MirroredParts(parts, scene.grid.counts)
    tally = comm.bcast(frame.tally, root=comm.size - 1)  # the last rank has been through all
    findings = Findings(scene, frame, revolution, quality, tally)
    summary = findings.summary()
    require_result(summary)
    return FlowField(
        grid=scene.grid,
        frame="vessel",
        axis=geometry.axis,
        angular_velocity=omega,
        intervals=CompactIntervals(held, times, capacity, first=mine.start),
        prefix=prefix,
        summary=summary,
        warnings=findings.warnings(),
    )


def _frame(scene: Scene, options: SurfaceLayer.GeneralOptions) -> VesselFrame:
    """The vessel on its grid, or the upper half of one that is its own mirror image."""
    grid, columns = scene.grid, lab_columns(scene, options)
    volume, half = scene.fill_volume, upper_half(scene.geometry, grid)
    if half is not None:
        grid, columns, volume = half, columns.upper_half(), 0.5 * volume
    shear_rate = layer_shear_rate(scene.material, options)
    return VesselFrame(scene.geometry, grid, columns, scene.speed, volume, shear_rate)


def _bed(
    scene: Scene,
    options: SurfaceLayer.GeneralOptions,
    frame: VesselFrame,
    per_revolution: int,
    comm: Any,
    progress: Progress,
) -> Revolution:
    """The bed's surface, on every rank: the vessel's lines traced by all, the bed by the root."""
    geometry, multiple = scene.geometry, options.steps_per_interval
    wall = frame.wall.astype(np.float32)  # read at random: the less of it the better
    vessel = TurnedVessel(wall, frame.corner, frame.spacing, geometry.reach)
    sub_lines = (8, 1) if scene.grid.dimension == 2 else (6, 3)
    turn = PhasedVessel.trace(
        vessel, frame.columns, per_revolution * multiple, sub_lines, comm, progress
    )
    law = slope_law(scene.material.friction, scene.speed, geometry.reach, options.slope_excess)
    level = level_height(geometry, scene.fill_volume) - geometry.axis.point[1]
    return on_root(
        comm,
        lambda: revolve(
            turn,
            law,
            scene.speed,
            level,
            frame.volume,
            multiple,
            lambda share: progress(0.2 + 0.3 * share, "bed surface"),
        ),
    )


def _share(count: int, rank: int, size: int) -> range:
    """Which of `count` intervals a rank closes.

    Every rank goes through all moves up to its last interval, so the first ones close more:
    with E_r the end of rank r's share, _MOVE E_r + (E_r - E_(r-1)) is the same for all.
    """
    ends = [0.0]
    for _ in range(size):
        ends.append((1.0 + ends[-1]) / (1.0 + _MOVE))
    edges = [round(count * end / ends[-1]) for end in ends]
    return range(edges[rank], edges[rank + 1])


def lab_columns(scene: Scene, options: SurfaceLayer.GeneralOptions) -> Columns:
    """Columns over everything that the vessel sweeps, of the asked or a suitable spacing."""
    geometry, grid = scene.geometry, scene.grid
    reach = geometry.reach
    spacing = options.column_spacing or max(1.5 * grid.spacing[0], 2 * reach / _ACROSS)
    if grid.dimension == 2:
        spacing = options.column_spacing or max(grid.spacing[0], 2 * reach / (4 * _ACROSS))
    across = _divisible(2 * max(8, math.ceil(reach / spacing - 1e-9)))
    dx = 2 * reach / across
    if grid.dimension == 2:
        return Columns(-reach, dx, across, -0.5 * grid.depth, grid.depth, 1)
    width = geometry.upper[2] - geometry.lower[2]
    along = 2 * _divisible(max(1, round(0.5 * width / dx)))
    return Columns(-reach, dx, across, geometry.lower[2], width / along, along)


def _divisible(count: int) -> int:
    """The count, or a little more, so that columns can be halved until there are few across."""
    multiple = 1
    while count >= FEWEST * multiple:
        multiple *= 2
    return multiple * math.ceil(count / multiple)


def _intervals(scene: Scene) -> int:
    """Per revolution: 3 degrees, or less where the rim would turn by more than a few cells.

    Usual points of a blend curve (twentieths of a revolution) and of pictures (eighths) fall on
    their boundaries, so that no step is cut in two there.
    """
    rim = 2 * math.pi * scene.geometry.reach / scene.grid.spacing[0]
    return 40 * math.ceil(max(_LONGEST, rim / _RIM_CELLS) / 40)
