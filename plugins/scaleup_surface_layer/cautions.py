"""Where the surface-layer model may not hold, told from the scene before it is solved.

The model lets the bed turn with the vessel, below a thin layer whose slope is the friction angle.
That takes a vessel that is neither too fast nor too slow (rolling, 1e-4 < Fr < 1e-2: Oba & Otsuki,
arXiv 2407.19466), a wall that carries the bed, and a powder that flows
(`scaleup.flow.bed_support`).
"""

from __future__ import annotations

import math

from scaleup.contract import Geometry, InputError, Material
from scaleup.numerics import bed_depth, critical_height, froude_number, lifted_lean

_ROLLING = (1e-4, 1e-2)  # Froude number
_SLIDES, _ROLLS = 1.0, 1.1
"""tan of the lean that the wall can hold, over tan(phi); the finite elements of `mohr-coulomb`
slide at 0.91 (their bed turns at 0.02 of the drum's speed) and roll at 1.09 (0.98)"""
_SMOOTH = 0.5  # wall friction over tan(phi), below which flat walls do not hold powder either
_STICKY = 0.1  # critical height over the bed's depth, from which cohesion steepens the surface


def cautions_of(
    geometry: Geometry, material: Material, speed: float, fill_volume: float
) -> tuple[str, ...]:
    """See `scaleup.contract.Flow.cautions`."""
    return (
        *_regime(froude_number(geometry, speed)),
        *_slip(geometry, material, fill_volume),
        *_lump(geometry, material, fill_volume),
    )


def _regime(froude: float) -> tuple[str, ...]:
    slowest, fastest = _ROLLING
    if froude > fastest:
        return (
            f"the Froude number is {froude:.2g}: beyond {fastest:g} inertia bends and steepens the "
            "surface, which flow 'surface-layer' leaves out; set flow.name = 'mohr-coulomb' or "
            "lower operation.speed",
        )
    if froude < slowest:
        return (
            f"the Froude number is {froude:.2g}: below {slowest:g} a bed does not roll but comes "
            "down in one avalanche after another; flow 'surface-layer' gives their mean over time, "
            "not their speed, thickness and mixing: raise operation.speed, or take times in "
            "revolutions only",
        )
    return ()


def _slip(geometry: Geometry, material: Material, fill_volume: float) -> tuple[str, ...]:
    """Whether the wall carries the bed."""
    friction = material.friction
    lean = lifted_lean(geometry, material, fill_volume)
    if lean is None:
        if material.wall_friction >= _SMOOTH * friction:
            return ()
        return (
            f"material.wall_friction = {material.wall_friction:g} is below {_SMOOTH:g} of the "
            f"powder's own friction {friction:.3g}: parts of the bed slide on the vessel's walls, "
            "which flow 'surface-layer' leaves out; set flow.name = 'mohr-coulomb' or raise "
            "material.wall_friction",
        )
    share = math.tan(lean) / friction
    lifts = (
        f"material.wall_friction = {material.wall_friction:g} lifts a bed of this fill to about "
        f"{math.degrees(lean):.3g} deg, and it yields at {math.degrees(math.atan(friction)):.3g} "
        "deg: it "
    )
    remedy = (
        "; raise material.wall_friction or the fill, or set flow.name = 'mohr-coulomb', in which "
        "beds may slide"
    )
    if share < _SLIDES:
        raise InputError(
            f"{lifts}slides on the wall as a block, which flow 'surface-layer' cannot hold{remedy}"
        )
    if share < _ROLLS:
        return (f"{lifts}may slide on the wall, which flow 'surface-layer' leaves out{remedy}",)
    return ()


def _lump(geometry: Geometry, material: Material, fill_volume: float) -> tuple[str, ...]:
    """Whether the powder comes down as a layer."""
    height, depth = critical_height(material), bed_depth(geometry, fill_volume)
    stands = (
        f"material.cohesion = {material.cohesion:g} Pa lets a wall of the powder stand "
        f"{1e3 * height:.3g} mm high, and the bed is {1e3 * depth:.3g} mm deep: "
    )
    if height > depth:
        raise InputError(
            f"{stands}it turns as a lump, which flow 'surface-layer' cannot hold; set flow.name = "
            "'mohr-coulomb' or lower material.cohesion"
        )
    if height > _STICKY * depth:
        return (
            f"{stands}its surface is steeper than the friction angle and comes down in pieces, "
            "which flow 'surface-layer' leaves out; set flow.name = 'mohr-coulomb'",
        )
    return ()
