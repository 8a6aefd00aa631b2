"""Flow `surface-layer`: rigid rotation below a thin flowing layer, in closed form for the drum."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from scaleup.api import (
    FlowField,
    Geometry,
    InputError,
    Memory,
    Operation,
    PluginOptions,
    Progress,
    Scene,
    units,
)


class SurfaceLayer:
    """The drum's steady rolling bed from a stream function.

    The surface angle is an input of this model (the material's friction angle), not a prediction.
    See `closed_form` for the equations.
    """

    class Options(PluginOptions):
        """Closure of the layer's thickness delta(s), s the distance from mid-bed."""

        closure: Literal["shear-rate", "parabolic"] = "shear-rate"
        """"shear-rate": delta = sqrt(2 q / shear rate); "parabolic": delta0 (1 - s^2/L^2)"""
        shear_rate: units.ShearRate | None = None
        """1/s; default: sqrt(g sin(angle_difference) / (1.5 d cos phi))"""
        angle_difference: Annotated[units.Angle, Field(gt=0, lt=0.5)] = 0.05235987755982988
        """rad (3 deg), between the flowing layer's and the static bed's friction angle; Khakhar
        et al. 1997, Orpe & Khakhar 2001 leave it to the material"""
        thickness: units.Length | None = None
        """m at mid-bed, for closure "parabolic"; default: as "shear-rate" gives it there"""

    def __init__(self, options: Options):
        self.options = options

    def check(self, geometry: Geometry, operation: Operation) -> None:
        """The closed form is that of a circular cross-section."""
        if geometry.dimension != 2 or not _is_circle(geometry):
            raise InputError(
                "flow.name = 'surface-layer': the closed form holds for a circular cross-section "
                "(such as geometry 'drum') only"
            )

    def solve(self, scene: Scene, comm: Any, progress: Progress, memory: Memory) -> FlowField:
        """See `closed_form.drum_flow`; takes no time worth storing parts of."""
        from scaleup_surface_layer.closed_form import drum_flow

        field = drum_flow(scene, self.options)
        progress(1.0, "surface layer in closed form")
        return field


def _is_circle(geometry: Geometry) -> bool:
    """Whether the wall is everywhere at the vessel's reach from an axis through the origin."""
    angle = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    ring = geometry.reach * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return bool(np.abs(geometry.signed_distance(ring)).max() < 1e-6 * geometry.reach)
