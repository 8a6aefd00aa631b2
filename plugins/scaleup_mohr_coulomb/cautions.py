"""Where the finite-element flow may not hold, told from the scene before it is solved.

Against particles of 2 mm (benchmarks/drum_against_particles.py and runs at 15 rpm) constant
friction is right at a Froude number of 0.003 and makes the surface 60 % too fast at 0.018, where
mu(I) is right; that is 28 % too slow at 0.003. Which law to take changes in between.
"""

from __future__ import annotations

import math

from scaleup.contract import Geometry, Material
from scaleup.numerics import froude_number, lifted_lean

_CHANGES = 7e-3  # Froude number, the geometric mean of 0.003 and 0.018
_CASCADES = {2: 0.03, 3: 0.05}  # Froude number beyond which grains begin to leave the surface


def cautions_of(
    rheology: str, geometry: Geometry, material: Material, speed: float, fill_volume: float
) -> tuple[str, ...]:
    """See `scaleup.contract.Flow.cautions`."""
    found = []
    froude, cascades = froude_number(geometry, speed), _CASCADES[geometry.dimension]
    if froude > cascades:
        found.append(
            f"the Froude number is {froude:.2g}: beyond {cascades:g} a bed cascades or "
            "cataracts, which a single free surface does not show; lower operation.speed"
        )
    if rheology == "mohr-coulomb" and froude > _CHANGES:
        found.append(
            f"the Froude number is {froude:.2g}: beyond {_CHANGES:g} constant friction makes the "
            "surface too fast (by 60 % at 0.018, against particles); set flow.rheology = 'mu-i'"
        )
    if rheology != "mohr-coulomb" and froude < _CHANGES:
        found.append(
            f"the Froude number is {froude:.2g}: below {_CHANGES:g} friction that rises with the "
            "inertial number makes the surface too slow (by 28 % at 0.003, against particles); set "
            "flow.rheology = 'mohr-coulomb'"
        )
    lean, rests = lifted_lean(geometry, material, fill_volume), math.atan(material.friction)
    if lean is not None and lean < rests:
        found.append(
            f"material.wall_friction = {material.wall_friction:g} lifts this bed to about "
            f"{math.degrees(lean):.3g} deg only and it yields at {math.degrees(rests):.3g} deg: it "
            "slides on the wall as a block; raise material.wall_friction or the fill"
        )
    return tuple(found)
