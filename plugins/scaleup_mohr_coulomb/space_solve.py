"""A scene in space, from the vessel's solid to its periodic FlowField."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

from scaleup.contract import GRAVITY, FlowField, Memory, Progress, Scene
from scaleup.numerics import on_each

from .parameters import Discretisation, Drive, Rheology
from .revolutions import level_bed, revolve
from .space_flow import VesselFlow
from .space_grid import periodic_flow
from .space_memory import TurnedMemory
from .space_mesh import vessel_mesh

if TYPE_CHECKING:
    from scaleup_mohr_coulomb import MohrCoulomb

_ELEMENTS = 6.0  # across the reach
_STEPS = 8.0  # in sqrt(reach/g)
_START = 0.75  # of the friction angle, up to which the level bed turns rigidly


def numerics_in_space(scene: Scene, options: MohrCoulomb.SpaceOptions) -> Discretisation:
    """The method's rules (`parameters.Discretisation`), for meshes of one element size.

    Element size h = R/6 and time step sqrt(R/g)/8, for vessels that turn for whole revolutions on a
    mesh that the surface sweeps all of.
    """
    reach = scene.geometry.reach
    size = options.fine_size or reach / _ELEMENTS
    numerics = Discretisation.by_rule(
        scene.material,
        Drive(bed_area=scene.fill_volume / (2.0 * reach), angular_velocity=scene.speed),
        reach,
        size,
        size,
        options.time_step or math.sqrt(reach / GRAVITY) / _STEPS,
        options.nonlocal_length,
        options.predictor_length,
    )
    in_space = numerics.in_space()
    if options.nonlocal_length is None:
        return in_space
    return dataclasses.replace(in_space, nonlocal_length=options.nonlocal_length)


def vessel_flow(
    scene: Scene, options: MohrCoulomb.SpaceOptions, comm: Any, progress: Progress, memory: Memory
) -> FlowField | None:
    """Solve for a periodic flow in the vessel's frame; collective, the FlowField on rank 0.

    What the finite elements find does not depend on the grid, and is kept without it.
    """
    geometry = scene.geometry
    numerics = on_each(comm, lambda: numerics_in_space(scene, options))
    rheology = Rheology.by_literature(
        options.rheology,
        options.friction_rise,
        options.inertial_number_0,
        options.tensile_strength,
    )
    mirrored = (0.0, 0.0, 1.0) in geometry.symmetry
    still = int(_START * scene.material.friction_angle / (2.0 * math.pi) * options.intervals)
    flow = VesselFlow(
        geometry,
        vessel_mesh(geometry.solid, numerics.fine_size, comm, mirrored),
        scene.material,
        rheology,
        numerics,
        scene.speed,
        GRAVITY,
        scene.fill_volume,
        2.0 * math.pi * still / options.intervals,
        comm,
        mirrored,
    )
    inputs = {
        "scene": dict(scene.inputs),
        "numerics": dataclasses.asdict(numerics),
        "rheology": dataclasses.asdict(rheology),
        "intervals": options.intervals,
    }
    kept = TurnedMemory(memory, inputs, flow, comm)
    run = kept.recall() or level_bed(flow, options.intervals, still)
    before = len(run.velocities)
    revolve(flow, run, options.revolutions, progress, lambda so_far: kept.keep(so_far, now=False))
    if len(run.velocities) > before:
        kept.keep(run, now=True)
    return periodic_flow(flow, run, scene, comm, progress)
