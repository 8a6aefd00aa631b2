"""What a configuration asks that cannot be: refused before anything is computed.

Each function looks at one thing and raises InputError with one sentence: key, value and rule.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from scaleup.case.case import Case
from scaleup.case.vessel_shape import Bed, require_resolved, require_vessel
from scaleup.scene.loading_file import read_loading
from scaleup.scene.models import Loading
from scaleup.scene.units import LENGTH, MASS
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

_FULLEST = 0.95  # of the vessel: what is fuller has no room to flow
_GRAINS_DEEP, _CELLS_DEEP, _CELLS, _SAMPLES = 4, 3, 30, 4  # least, of a bed
_MOST_POINTS, _MOST_CELLS, _MOST_STEPS = 1e5, 2e9, 1e8
_BYTES_PER_CELL, _BYTES_PER_ACTIVE_CELL = 16, 200  # less than any backend gets along with
_LATTICE = 24  # points along an edge of the box in which a loading is looked at


def require_bed(case: Case) -> None:
    """The vessel has a likely size, its bed room to flow and depth enough for grains."""
    bed = case.bed
    require_vessel(case.name("geometry"), bed.geometry)
    kind, value = next((k, v) for k, v in case.operation.fill if v is not None)
    given = f"operation.fill.{kind} = {value:g}{' kg' if kind == 'mass' else ''}"
    share, grain = bed.volume / bed.geometry.volume, case.material.grain_diameter
    if share > _FULLEST:
        most = _FULLEST * bed.geometry.volume * case.material.bulk_density
        raise InputError(
            f"{given}: {share:.4g} of the vessel leaves no room to flow; at most {_FULLEST:g} of "
            f"it, {MASS.shown(most)}"
        )
    if bed.depth < _GRAINS_DEEP * grain:
        deep = f"the bed is {LENGTH.shown(bed.depth)} deep, less than {_GRAINS_DEEP} grains"
        if bed.geometry.reach < 10 * _GRAINS_DEEP * grain:
            raise InputError(f"material.grain_diameter = {LENGTH.shown(grain)}: {deep}")
        raise InputError(f"{given}: {deep} of {LENGTH.shown(grain)}")


def require_grid(case: Case) -> None:
    """Cells that resolve the vessel and its bed, and that the machine can hold."""
    bed = case.bed
    key = "spacing" if case.config.grid.spacing is not None else "cells"
    value = LENGTH.shown(bed.spacing) if key == "spacing" else f"{case.config.grid.cells:g}"
    given = f"grid.{key} = {value}"
    edge = "" if key == "spacing" else f" of {LENGTH.shown(bed.spacing)}"
    require_resolved(bed.geometry, bed.spacing)
    if bed.depth < _CELLS_DEEP * bed.spacing or bed.cells < _CELLS:
        raise InputError(
            f"{given}: the bed, {LENGTH.shown(bed.depth)} deep, holds {bed.cells:.3g} cells{edge}; "
            f"at least {_CELLS} are needed, {_CELLS_DEEP} in its depth"
        )
    cells = bed.cells_of_box
    if cells > _MOST_CELLS:
        raise InputError(
            f"{given}: cells{edge} are {cells:.3g} in the vessel's box, more than {_MOST_CELLS:g}"
        )
    needed, there = _BYTES_PER_CELL * cells + _BYTES_PER_ACTIVE_CELL * bed.cells, machine_memory()
    if needed > there:
        raise InputError(
            f"{given}: {bed.cells:.3g} cells{edge} in the bed need {1e-9 * needed:.3g} GB of "
            f"memory or more; this machine has {1e-9 * there:.3g} GB"
        )


def require_samples(case: Case) -> None:
    """Samples that fit into the bed, some beside each other."""
    bed = case.bed
    edge, mass = case.sample_edge, case.accuracy.sample_mass
    given = f"accuracy.scrutiny = {case.accuracy.scrutiny:g}"
    if mass is not None:
        given = f"accuracy.sample_mass = {mass:g} kg"
    area = bed.volume / bed.geometry.depth
    count = area / edge**2 if bed.geometry.dimension == 2 else bed.volume / edge**3
    if edge > bed.depth or count < _SAMPLES:
        raise InputError(
            f"{given}: samples of {LENGTH.shown(edge)} do "
            f"not fit a bed that is {LENGTH.shown(bed.depth)} deep and holds {count:.2g} of them"
        )


def require_diffusion(case: Case) -> None:
    """A law of diffusion that holds in the vessel, and sets in."""
    after, turns = case.diffusion.after, case.operation.revolutions
    if case.diffusion.model == "paper" and case.geometry.dimension != 2:
        raise InputError(
            "diffusion.model = 'paper': Eq. 6 holds for a 2-D flow in the lab frame only; use "
            "'objective'"
        )
    if after > turns:
        raise InputError(
            f"diffusion.after = {after:g}: must be at most operation.revolutions = {turns:g}, or "
            "diffusion never sets in; for none at all set diffusion.k1 = 0"
        )


def require_length(case: Case) -> None:
    """A number of points and steps that a run can have an end with."""
    turns, output = case.operation.revolutions, case.output
    curve, fields = turns / output.metrics_every, turns / output.snapshots_every
    if curve + fields > _MOST_POINTS:
        key = "metrics_every" if curve > fields else "snapshots_every"
        raise InputError(
            f"output.{key} = {getattr(output, key):g}: over {turns:g} revolutions the blend curve "
            f"and the snapshots have {curve + fields:.3g} points, more than {_MOST_POINTS:g}"
        )
    steps, given = mixing_steps(case)
    if steps > _MOST_STEPS:
        raise InputError(
            f"{given}: {turns:g} revolutions take {steps:.3g} mixing steps or more, the rim "
            f"crossing cells of {LENGTH.shown(case.spacing)}; at most {_MOST_STEPS:g}"
        )


def mixing_steps(case: Case) -> tuple[float, str]:
    """The least number of mixing steps, and the setting that makes them so many.

    Explicit backends have an option `courant`: their steps are not longer than the rim needs to
    cross as many cells.
    """
    bed = case.bed
    turns, options = case.operation.revolutions, case.options("mixing")
    step, courant = getattr(options, "time_step", None), getattr(options, "courant", None)
    if step is not None:
        return turns * case.operation.period / step, f"mixing.time_step = {step:g} s"
    if courant is None:
        return 0.0, ""
    crossed = turns * 2 * math.pi * bed.geometry.reach / bed.spacing
    given = f"mixing.courant = {courant:g}"
    if crossed > _MOST_STEPS:
        given = f"operation.revolutions = {turns:g}"
    return crossed / courant, given


def require_loading(case: Case) -> None:
    """A loading that leaves something to blend, in the level bed of the vessel at rest."""
    bed = case.bed
    loading, geometry = case.operation.loading, bed.geometry
    name = case.name("geometry")
    if loading.direction == "z" and geometry.dimension == 2:
        raise InputError(
            f"operation.loading.pattern = {loading.pattern!r}: layers along z need a vessel in "
            f"3-D, and the geometry {name!r} is a cross-section as it is set"
        )
    if loading.direction is not None:
        least = min(loading.layers)
        if least * bed.cells < 1:
            raise InputError(
                f"operation.loading.shares = {list(loading.layers)}: a layer of {least:.3g} of the "
                f"bed holds {least * bed.cells:.2g} of a cell; at least one is needed"
            )
    if loading.centre is not None:
        if len(loading.centre) != geometry.dimension:
            raise InputError(
                f"operation.loading.centre = {list(loading.centre)}: the geometry {name!r} needs "
                f"{geometry.dimension} coordinates"
            )
        _require_region(loading, np.array(loading.centre), bed)
    if loading.file is not None:
        _require_of_file(loading.file, bed)


def component_count(loading: Loading, dimension: int) -> int:
    """How many components a loading has."""
    if loading.file is not None:
        return len(read_loading(loading.file, dimension)[1])
    return max(loading.layer_components)


def _require_region(loading: Loading, centre: FloatArray, bed: Bed) -> None:
    """Both the region and what is around it hold a cell of the bed or more."""
    radius = loading.radius or 0.0
    given = (
        f"operation.loading.centre = {[LENGTH.shown(float(x)) for x in centre]}, radius = "
        f"{LENGTH.shown(radius)}"
    )
    lower = np.maximum(centre - radius, bed.geometry.lower)
    upper = np.minimum(centre + radius, bed.geometry.upper)
    around = _lattice(lower, np.maximum(upper, lower))
    here = around[np.linalg.norm(around - centre, axis=1) <= radius]
    box = float(np.prod(np.maximum(upper - lower, 0.0)))
    cells = bed.holds(here).sum() / len(around) * box / bed.spacing**bed.geometry.dimension
    if cells < 1:
        raise InputError(
            f"{given}: the region holds {cells:.2g} cells of the settled bed, which ends at y = "
            f"{LENGTH.shown(bed.top)}; at least one is needed"
        )
    points = _lattice(np.array(bed.geometry.lower), np.array(bed.geometry.upper))
    points = points[bed.holds(points)]
    if len(points) and np.all(np.linalg.norm(points - centre, axis=1) <= radius):
        raise InputError(f"{given}: the region is the whole bed; there is nothing to blend")


def _require_of_file(file: Path, bed: Bed) -> None:
    """The bed holds more than one of the file's components."""
    known, concentration = read_loading(file, bed.geometry.dimension)
    points = _lattice(np.array(bed.geometry.lower), np.array(bed.geometry.upper))
    points = points[bed.holds(points)]
    _, nearest = cKDTree(known).query(points)
    most = concentration[:, nearest].mean(axis=1).max() if len(points) else 0.0
    if most == 1.0:
        raise InputError(
            f"operation.loading.file = {str(file)!r}: one component is the whole bed; there is "
            "nothing to blend"
        )


def _lattice(lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Middles of equal parts of a box, (n, dimension)."""
    middles = (np.arange(_LATTICE) + 0.5) / _LATTICE
    lines = [low + middles * (high - low) for low, high in zip(lower, upper, strict=True)]
    mesh = np.meshgrid(*lines, indexing="ij")
    return np.stack([axis.ravel() for axis in mesh], axis=-1)


def machine_memory() -> float:
    """Bytes that this process may have: the machine's, or less where a batch system says so."""
    memory = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for limit in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            memory = min(memory, float(Path("/sys/fs/cgroup", limit).read_text(encoding="utf-8")))
        except (OSError, ValueError):  # no such limit, or "max"
            continue
    return memory


def require_feasible(case: Case) -> None:
    """All of the above. Raises InputError."""
    rules = (
        require_bed,
        require_grid,
        require_samples,
        require_diffusion,
        require_length,
        require_loading,
    )
    for require in rules:
        require(case)
