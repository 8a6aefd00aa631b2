"""Flow `surface-layer`: rigid rotation below a thin flowing layer, in closed form for the drum."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from scaleup.api import (
    FlowField,
    Geometry,
    Memory,
    PluginOptions,
    Progress,
    Scene,
    require_drum,
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

    def check(self, geometry: Geometry, speed: float) -> None:
        """The closed form is that of a rolling bed in a circular cross-section."""
        require_drum("surface-layer", geometry, speed, froude_below=0.5)

    def solve(self, scene: Scene, comm: Any, progress: Progress, memory: Memory) -> FlowField:
        """See `closed_form.drum_flow`; takes no time worth storing parts of."""
        from scaleup_surface_layer.closed_form import drum_flow

        field = drum_flow(scene, self.options)
        progress(1.0, "surface layer in closed form")
        return field
