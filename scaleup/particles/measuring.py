"""What is measured on the frames of a particle twin: the curve, the bed, overlaps, fields."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from scaleup.case.case import Case
from scaleup.case.vessel_shape import is_circle
from scaleup.contract import BoolArray, FloatArray, Grid, IntArray
from scaleup.particles.coarse_graining import Fields, coarse_grained
from scaleup.particles.colouring import components_of
from scaleup.particles.computing import Computation, Computed
from scaleup.particles.dumps import read_dump
from scaleup.particles.overlaps import overlaps, turned
from scaleup.particles.pouring import Grains
from scaleup.particles.rolling_bed import RollingBed, rolling_bed
from scaleup.particles.samples import Mixedness, measure
from scaleup.report.grain_figures import StoredGrains, write_grains
from scaleup.report.results import Motion, Results
from scaleup.space.grid import grid_over
from scaleup.system.errors import RunError
from scaleup.system.progress import Reporter

log = logging.getLogger("scaleup")

FINE_EDGE = 3.0  # diameters: samples that stand for the nodes of a continuum
_FLOWS_FROM = 0.3  # revolutions, from which a bed is taken to flow steadily
_OVERLAP_FRAMES = 20
_MEAN_WIDTH = 0.5  # diameters: the kernel of means over time; as wide as a grain itself
_SLAB = 2.0  # diameters along the axis that pictures of a vessel in space show


@dataclass
class Curve:
    """The blend curve; one entry per point. `fine` and `sample` are by component."""

    revolutions: list[float] = field(default_factory=list)
    fine: list[list[Mixedness]] = field(default_factory=list)
    sample: list[list[Mixedness]] = field(default_factory=list)


@dataclass
class Measured:
    """All that a report says of the frames.

    solid_fraction, level -- of the settled bed; level is the height y of its surface, m
    component    -- of every grain, from 0
    edge         -- of samples, m
    centre_angle -- of the centre of mass from straight down, rad, by frame; NaN for odd beds
    bed          -- means over `mean_from` revolutions to the end, or why there are none
    overlap_*    -- in diameters: greatest, mean and 99th percentile of contacts between grains,
                    greatest at the wall
    """

    solid_fraction: float
    level: float
    component: IntArray
    edge: float
    curve: Curve
    revolutions: list[float]
    centre_angle: list[float]
    bed: RollingBed | str
    mean_from: float
    overlap_greatest: float
    overlap_mean: float
    overlap_99: float
    overlap_wall: float
    contacts_per_grain: float
    active_cells: int


def measure_frames(
    case: Case, computation: Computation, computed: Computed, work: Path
) -> tuple[Measured, Results]:
    """Measure all frames, and store the fields and grains of the snapshots in the run folder.

    Raises RunError if grains are lost or a frame is damaged.
    """
    geometry, plan, length = case.geometry, computation.schedule, computation.length
    first = computed.settled.step
    settled = computed.settled.grains
    component = components_of(
        case.operation.loading, settled, geometry.dimension, case.particles.seed
    )
    solid, level = _settled_bed(case, computation, settled)
    diameter = computation.contact.diameter
    edge = max(case.sample_edge, FINE_EDGE * diameter)
    in_lab = is_circle(geometry)
    motion = Motion("lab" if in_lab else "vessel", geometry.axis, case.operation.speed)
    results = Results(work, case.grid, motion)
    results.create()
    inside = _inside(case, case.grid)
    snapshots = _snapshots(case, computation, list(computed.frames), first)
    revolutions = [plan.revolution(step - first) for step in computed.frames]
    mean_from = _FLOWS_FROM if revolutions[-1] >= 2 * _FLOWS_FROM else 0.5 * revolutions[-1]
    looked_at = set(np.linspace(0, len(revolutions) - 1, _OVERLAP_FRAMES).round().astype(int))
    curve, angles, stored = Curve(), [], dict[float, Grains]()
    means, averaged = None, 0
    mean_grid = grid_over(geometry.lower, geometry.upper, 0.5 * diameter, length or 1.0)
    mean_inside = _inside(case, mean_grid) if in_lab else np.empty(0, dtype=bool)
    pressed, at_wall, active = [np.zeros(0)], [np.zeros(0)], 0
    with Reporter("measuring", visible=True) as progress:
        for number, (step, path) in enumerate(computed.frames.items()):
            revolution = revolutions[number]
            progress(number / len(revolutions), f"revolution {revolution:.2f}")
            grains = read_dump(path).grains
            if len(grains.radius) != len(component):
                raise RunError(f"{path}: {len(component) - len(grains.radius)} grains are lost")
            phase = 2 * math.pi * revolution
            angles.append(_centre_angle(geometry.axis.point, grains))
            if number in looked_at:
                found = overlaps(grains, geometry, phase, length)
                pressed.append(found.pairs)
                at_wall.append(found.wall)
            if in_lab and revolution >= mean_from:
                fields = coarse_grained(
                    mean_grid, mean_inside, grains, np.zeros_like(component), _MEAN_WIDTH * diameter
                )
                means = fields if means is None else means + fields
                averaged += 1
            seen = grains if in_lab else _in_vessel(case, grains, phase)
            if plan.at_point(step - first):
                _add_point(curve, case, computation, seen, component, solid, edge, revolution)
            if step in snapshots:
                fields = coarse_grained(case.grid, inside, seen, component, diameter)
                active = _store(results, fields, computation.share, solid, revolution)
                stored[revolution] = grains
    results.finish({"snapshots": list(stored), "pictures": []})
    _store_grains(work / "grains.h5", case, stored, component, _SLAB * diameter, length)
    bed = _bed(case, mean_grid, means, averaged, diameter, solid)
    contacts, wall = np.concatenate(pressed), np.concatenate(at_wall)
    return (
        Measured(
            solid_fraction=solid,
            level=level,
            component=component,
            edge=edge,
            curve=curve,
            revolutions=revolutions,
            centre_angle=angles,
            bed=bed,
            mean_from=mean_from,
            overlap_greatest=float(contacts.max(initial=0.0)),
            overlap_mean=float(contacts.mean()) if len(contacts) else 0.0,
            overlap_99=float(np.quantile(contacts, 0.99)) if len(contacts) else 0.0,
            overlap_wall=float(wall.max(initial=0.0)),
            contacts_per_grain=2 * len(contacts) / (len(looked_at) * len(component)),
            active_cells=active,
        ),
        results,
    )


def _settled_bed(case: Case, computation: Computation, grains: Grains) -> tuple[float, float]:
    """Solid fraction and level (m) of the settled bed.

    Grains are counted in layers of half a diameter; the level is where the share of the vessel that
    they fill passes half of what it is below, and the fraction is that below the level less two
    diameters.
    """
    geometry, share = case.geometry, computation.share
    step = 0.5 * computation.contact.diameter
    levels = np.arange(geometry.lower[1], geometry.upper[1] + step, step)
    held, _ = np.histogram(grains.position[:, 1], levels, weights=grains.volume)
    below = share * np.array([geometry.volume_below(float(y)) for y in levels])
    room = np.diff(below)
    filled = np.divide(held, room, out=np.zeros_like(held), where=room > 0)
    smooth = np.convolve(filled, np.ones(3) / 3, mode="same")
    dense = 0.5 * float(np.average(filled, weights=held))
    top = int(np.flatnonzero(smooth >= dense)[-1])
    after = smooth[top + 1] if top + 1 < len(smooth) else 0.0
    level = levels[top] + step * (0.5 + (smooth[top] - dense) / max(smooth[top] - after, 1e-300))
    deep = max(1, top - 4)
    return float(held[:deep].sum() / (below[deep] - below[0])), float(level)


def _inside(case: Case, grid: Grid) -> BoolArray:
    """Cells that may hold some of the vessel: centres less than half a diagonal outside."""
    reach = 0.5 * float(np.linalg.norm(grid.spacing))
    inside: BoolArray = case.geometry.signed_distance(grid.centre_points()) > -reach
    return inside


def _snapshots(case: Case, computation: Computation, steps: list[int], first: int) -> set[int]:
    """The frames nearest to the revolutions of snapshots, and the last one."""
    at = np.array([computation.schedule.revolution(step - first) for step in steps])
    wanted = np.arange(0, at[-1] + 1e-9, case.output.snapshots_every)
    return {steps[int(np.abs(at - r).argmin())] for r in wanted} | {steps[-1]}


def _centre_angle(axis: tuple[float, float, float], grains: Grains) -> float:
    x, y = np.average(grains.position[:, :2], axis=0, weights=grains.volume) - axis[:2]
    return math.atan2(x, -y)


def _in_vessel(case: Case, grains: Grains, phase: float) -> Grains:
    """Grains in the frame of the vessel: turned back, with velocities relative to it."""
    geometry = case.geometry
    spin = case.operation.speed * np.array(geometry.axis.direction)
    carried = np.cross(spin, grains.position - np.array(geometry.axis.point))
    return replace(
        grains,
        position=turned(grains.position, geometry, -phase),
        velocity=turned(grains.velocity - carried, geometry, -phase, free=True),
    )


def _add_point(
    curve: Curve, case: Case, computation: Computation, grains: Grains, component: IntArray,
    solid: float, edge: float, revolution: float,
) -> None:  # fmt: skip
    dimension, length = case.geometry.dimension, computation.length
    position = grains.position[:, :dimension]
    rows = []
    for size in (FINE_EDGE * computation.contact.diameter, edge):
        box = size**dimension * (length if length is not None else 1.0)
        found = [
            measure(position, grains.volume, (component == k).astype(float),
                    np.array(case.grid.lower), size, 0.5 * solid * box)
            for k in range(int(component.max()) + 1)
        ]  # fmt: skip
        if any(one is None for one in found):
            raise RunError(
                f"accuracy.scrutiny: no two samples of {1e3 * size:.3g} mm are half full of grains"
            )
        rows.append([one for one in found if one is not None])
    curve.revolutions.append(revolution)
    curve.fine.append(rows[0])
    curve.sample.append(rows[1])


def _store(results: Results, fields: Fields, share: float, solid: float, revolution: float) -> int:
    """Store the fields of an instant; returns how many cells hold material."""
    cells = np.flatnonzero(fields.volume > 0)
    volume = fields.volume[cells]
    values: dict[str, FloatArray] = {
        "fill_fraction": volume / (share * solid * results.grid.cell_volume)
    }
    for number, content in enumerate(fields.content, start=1):
        values[f"concentration_{number}"] = content[cells] / volume
    for name, momentum in zip("xyz", fields.momentum, strict=False):
        values[f"velocity_{name}"] = momentum[cells] / volume
    results.store("snapshots", revolution, cells, values, (revolution, revolution))
    return len(cells)


def _store_grains(
    path: Path, case: Case, stored: Mapping[float, Grains], component: IntArray, slab: float,
    length: float | None,
) -> None:  # fmt: skip
    some = next(iter(stored.values()))
    middle = 0.0
    if length is None:
        middle = 0.5 * (case.geometry.lower[2] + case.geometry.upper[2])
    kept = StoredGrains(
        radius=some.radius,
        component=component + 1,
        middle=middle,
        slab=2 * length if length is not None else slab,
        position={revolution: grains.position for revolution, grains in stored.items()},
    )
    write_grains(path, kept, {revolution: g.velocity for revolution, g in stored.items()})


def _bed(
    case: Case, grid: Grid, means: Fields | None, frames: int, diameter: float, solid: float
) -> RollingBed | str:
    if means is None:
        return "measured in drums without end walls and baffles only, whose bed stands still"
    try:
        return rolling_bed(
            grid, means, frames, case.geometry.reach, case.operation.speed, diameter, solid
        )
    except RunError as error:
        return str(error)
