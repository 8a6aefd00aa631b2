"""The steady bed of a scene: recalled, resumed from a checkpoint, or solved."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any

import ngsolve as ngs
import numpy as np

from scaleup.contract import Memory, Progress, RunError, Scene
from scaleup_mohr_coulomb.krylov import NotSolved
from scaleup_mohr_coulomb.level_set import LevelSet
from scaleup_mohr_coulomb.mesh import cross_section_mesh
from scaleup_mohr_coulomb.nearest_start import Starts, described
from scaleup_mohr_coulomb.parameters import Discretisation, Drive, Rheology, SteadyOptions
from scaleup_mohr_coulomb.start_up import StartUp
from scaleup_mohr_coulomb.steady import NotSteady, SteadyBed, run_to_steady
from scaleup_mohr_coulomb.stepping import CarefulSteps
from scaleup_mohr_coulomb.swings import SwingAverage
from scaleup_mohr_coulomb.two_phase import FlowDiverged, TwoPhaseFlow

if TYPE_CHECKING:
    from scaleup_mohr_coulomb import MohrCoulomb

_SECONDS_BETWEEN_CHECKPOINTS = 20.0
_TIME_LIMIT = 140.0  # sqrt(reach/g); the bed's swings last about 9
_NEAREST = {"solve_from": "nearest"}  # what depends on the store is kept apart from the rest
_FIELDS = ("velocity", "level_set", "mesh", "start_up")  # of a bed, kept apart from its numbers


def steady_bed(
    scene: Scene, options: MohrCoulomb.PlaneOptions, progress: Progress, memory: Memory
) -> SteadyBed:
    """The time-mean bed of the scene, whatever its grid.

    Raises RunError with one sentence if the flow diverges or never becomes steady.
    """
    area = scene.fill_volume / scene.geometry.depth
    drive = Drive(bed_area=area, angular_velocity=scene.speed)
    numerics = Discretisation.by_rule(
        scene.material,
        drive,
        scene.geometry.reach,
        options.fine_size,
        options.coarse_size,
        options.time_step,
        options.nonlocal_length,
        options.predictor_length,
    )
    asked = {"fine_size", "coarse_size", "time_step", "nonlocal_length", "predictor_length"}
    sizes = options.model_dump(mode="json", include=asked)
    rheology = Rheology.by_literature(
        options.rheology,
        options.friction_rise,
        options.inertial_number_0,
        options.tensile_strength,
    )
    inputs = {
        "scene": dict(scene.inputs),
        "sizes": sizes,
        "rheology": dataclasses.asdict(rheology),
    }
    mesh = cross_section_mesh(
        scene.geometry.solid(),
        numerics.coarse_size,
        numerics.fine_size,
        area,
        numerics.band_angle,
        numerics.band_depth,
        numerics.band_height,
    )
    vertices = np.array([vertex.point for vertex in mesh.vertices])
    # what the run goes through does not depend on when it stops: a checkpoint outlives the limit
    unfinished = inputs | {"stage": "checkpoint"}
    finished = inputs | {
        "stage": "steady",
        "angle_tolerance": options.angle_tolerance,
        "velocity_tolerance": options.velocity_tolerance,
    }
    if options.start_up:
        finished["start_up"] = True
    starts = Starts(memory, scene, {"sizes": sizes, "rheology": inputs["rheology"]})
    nearest = options.solve_from == "nearest"
    for recalled in (finished, finished | _NEAREST) if nearest else (finished,):
        known = memory.recall(recalled)
        if known is not None and np.array_equal(known["vertices"], vertices):
            progress(1.0, "steady bed reused from the store")
            return _from_arrays(known, mesh, numerics)
    if nearest:
        finished, unfinished = finished | _NEAREST, unfinished | _NEAREST

    def solved_from_rest(why: str) -> SteadyBed:
        progress(0.0, why)
        at_rest = options.model_copy(update={"solve_from": "rest"})
        return steady_bed(scene, at_rest, progress, memory)

    checkpoint = memory.recall(unfinished)
    if checkpoint is not None and not np.array_equal(checkpoint["vertices"], vertices):
        checkpoint = None
    start = starts.nearest() if nearest and checkpoint is None else None
    if nearest and checkpoint is None and start is None:
        return solved_from_rest("no mean flow of this drum is near enough to begin with")
    flow = TwoPhaseFlow(mesh, scene.material, drive, numerics, rheology)
    began = np.full(3, math.nan)
    if start is not None:
        start.begin(flow)
        began = start.place
        progress(0.0, f"from {described(began)}")
    steps = CarefulSteps(flow, SwingAverage(flow, flowing=start is not None))
    if checkpoint is not None:
        flow.restore(_part(checkpoint, "flow"))
        steps.average.restore(_part(checkpoint, "average"))
        steps.restore(_part(checkpoint, "steps"))
        began = checkpoint["began"]
        progress(0.0, f"resumed at t = {flow.time:.2f} s")
    last_kept = time.monotonic()

    def keep() -> None:
        arrays = {"vertices": vertices, "began": began}
        arrays |= {f"flow.{name}": data for name, data in flow.state().items()}
        arrays |= {f"average.{name}": data for name, data in steps.average.state().items()}
        arrays |= {f"steps.{name}": data for name, data in steps.state().items()}
        memory.keep(unfinished, arrays)

    def keep_and_report(fraction: float, message: str) -> None:
        nonlocal last_kept
        if time.monotonic() - last_kept > _SECONDS_BETWEEN_CHECKPOINTS:
            last_kept = time.monotonic()
            keep()
        progress(fraction, message)

    limit = options.time_limit or _TIME_LIMIT * math.sqrt(scene.geometry.reach / drive.gravity)
    steady = SteadyOptions(
        angle_tolerance=options.angle_tolerance,
        velocity_tolerance=options.velocity_tolerance,
        time_limit=limit,
        start_up=options.start_up,
    )
    try:
        bed = dataclasses.replace(run_to_steady(steps, steady, keep_and_report), began=began)
    except (FlowDiverged, NotSolved) as error:
        memory.forget(unfinished)
        if nearest:
            return solved_from_rest("that start led to no flow")
        halved = steps.recovery.most_halvings
        raise RunError(f"{error} (It had been halved {halved} times already.)") from error
    except NotSteady as error:
        keep()
        raise RunError(str(error)) from error
    if bed.converged:
        memory.keep(finished, {"vertices": vertices} | _to_arrays(bed))
        starts.keep(bed)
        memory.forget(unfinished)
    else:
        keep()
    return bed


def _to_arrays(bed: SteadyBed) -> dict[str, Any]:
    """All of a bed but its mesh: coefficient vectors and numbers."""
    arrays: dict[str, Any] = {
        "velocity": bed.velocity.vec.FV().NumPy().copy(),
        "level_set": bed.level_set.field.vec.FV().NumPy().copy(),
    }
    for entry in dataclasses.fields(bed):
        if entry.name not in _FIELDS:
            arrays[entry.name] = np.asarray(getattr(bed, entry.name))
    if bed.start_up is not None:
        for name, value in vars(bed.start_up).items():
            arrays[f"start_up.{name}"] = np.asarray(value)
    return arrays


def _from_arrays(arrays: dict[str, Any], mesh: Any, numerics: Discretisation) -> SteadyBed:
    velocity = ngs.GridFunction(ngs.VectorH1(mesh, order=2))
    velocity.vec.FV().NumPy()[:] = arrays["velocity"]
    level_set = LevelSet(mesh, numerics.interface_half_width)
    level_set.field.vec.FV().NumPy()[:] = arrays["level_set"]
    numbers = {
        entry.name: arrays[entry.name] if arrays[entry.name].ndim else arrays[entry.name].item()
        for entry in dataclasses.fields(SteadyBed)
        if entry.name not in _FIELDS
    }
    begun = _part(arrays, "start_up")
    start_up = None
    if begun:
        block, angle = begun["block"].item(), begun["angle"].item()
        start_up = StartUp(begun["velocities"], begun["levels"], block, angle)
    return SteadyBed(
        mesh=mesh, velocity=velocity, level_set=level_set, start_up=start_up, **numbers
    )


def _part(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    return {
        name.partition(".")[2]: data
        for name, data in arrays.items()
        if name.startswith(f"{prefix}.")
    }
