"""A small drum with end walls for the finite elements in space."""

import dataclasses
import math

from scaleup.case.composing import compose
from scaleup.scene.models import GRAVITY
from scaleup_mohr_coulomb.parameters import Discretisation, Drive, Rheology
from scaleup_mohr_coulomb.space_flow import VesselFlow
from scaleup_mohr_coulomb.space_mesh import vessel_mesh

NOMINAL_SPEED = 2.0


def drum_flow(comm, size=0.02, tilt=20.0, speed=NOMINAL_SPEED, mirrored=False, **changes):
    """A flow in a drum of 140 mm by 50 mm that begins with the level bed tilted (deg)."""
    case = compose(None, ["geometry.length='5 cm'"], {"geometry": {"name": "drum"}})
    geometry, volume = case.geometry, case.fill_volume
    drive = Drive(1.0, NOMINAL_SPEED)
    numerics = Discretisation.by_rule(case.material, drive, geometry.reach, size, size, 0.01)
    numerics = numerics.in_space()
    return VesselFlow(
        geometry,
        vessel_mesh(geometry.solid, size, comm, mirrored),
        case.material,
        Rheology(),
        dataclasses.replace(numerics, **changes),
        speed,
        GRAVITY,
        volume,
        math.radians(tilt),
        comm,
        mirrored,
    )
