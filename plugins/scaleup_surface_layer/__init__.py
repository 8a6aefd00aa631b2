"""Flow `surface-layer`: rigid rotation below a thin flowing layer, in closed form for the drum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator

from scaleup.contract import (
    Flow,
    FlowField,
    Geometry,
    InputError,
    Material,
    Memory,
    PluginOptions,
    Progress,
    Scene,
    units,
)
from scaleup.numerics import is_circle, on_root_alone, require_drum, require_rolling

_CENTRIFUGES = 0.5  # Froude number from which a bed does not roll
_COARSEST, _FINEST = 5.0, 500.0  # columns in a vessel's reach


class SurfaceLayer(Flow):
    """The drum's steady rolling bed from a stream function.

    The surface angle is an input of this model (the material's friction angle), not a prediction.
    See `closed_form` for the equations.
    """

    class Options(PluginOptions):
        """Which model, and the layer's shear rate."""

        model: Literal["auto", "closed-form", "general"] = "auto"
        """"closed-form": the drum's steady bed; "general": any vessel, periodic, in its own frame;
        "auto": the closed form where it holds"""
        shear_rate: units.ShearRate | None = None
        """1/s; default: sqrt(g sin(angle_difference) / (1.5 d cos phi))"""
        angle_difference: Annotated[units.Angle, Field(gt=0, lt=0.5)] = 0.05235987755982988
        """rad (3 deg), between the flowing layer's and the static bed's friction angle; Khakhar
        et al. 1997, Orpe & Khakhar 2001 leave it to the material"""

    class ClosedFormOptions(Options):
        """A drum's cross-section, flow.model = "auto" or "closed-form"."""

        closure: Literal["shear-rate", "parabolic"] = "shear-rate"
        """of the layer's thickness delta(s), s the distance from mid-bed: "shear-rate",
        sqrt(2 q / shear rate), or "parabolic", delta0 (1 - s^2/L^2)"""
        thickness: units.Length | None = None
        """m at mid-bed, for closure "parabolic"; default: as "shear-rate" gives it there"""

        @field_validator("thickness")
        @classmethod
        def _of_a_parabola(cls, value: float | None, info: ValidationInfo) -> float | None:
            if value is not None and info.data.get("closure") == "shear-rate":
                raise ValueError("belongs to the closure 'parabolic'; 'shear-rate' gives its own")
            return value

    class GeneralOptions(Options):
        """Any vessel, flow.model = "general"."""

        intervals: Annotated[int, Field(ge=8, le=3600)] | None = None
        """per revolution; default 120, more where the rim turns by over 8 cells in one"""
        steps_per_interval: Annotated[int, Field(ge=1, le=64)] = 2
        """steps of the bed's surface in an interval"""
        column_spacing: units.Length | None = None
        """m, of the lab columns; default 1.5 cells, up to 72 columns across (2-D: 288)"""
        slope_excess: Annotated[float, Field(gt=0, le=0.2)] = 0.01
        """share by which the slope exceeds tan(phi) at a flux of omega R^2/2"""

    forms: ClassVar = {"closed-form": ClosedFormOptions, "general": GeneralOptions}

    @staticmethod
    def form(geometry: Geometry, given: Mapping[str, Any]) -> str:
        """As asked, else the closed form in a circle."""
        model = given.get("model")
        if model in ("closed-form", "general"):
            return str(model)
        return "closed-form" if is_circle(geometry) else "general"

    def check(self, geometry: Geometry, speed: float) -> None:
        """The closed form is that of a rolling bed in a circle; no bed may centrifuge."""
        if isinstance(self.options, self.ClosedFormOptions):
            require_drum("surface-layer", geometry, speed, froude_below=_CENTRIFUGES)
        elif tuple(geometry.axis.direction) != (0.0, 0.0, 1.0):
            raise InputError("flow.name = 'surface-layer': the axis of rotation must run along z")
        require_rolling("surface-layer", geometry, speed, froude_below=_CENTRIFUGES)
        columns = getattr(self.options, "column_spacing", None)
        least, most = geometry.reach / _FINEST, geometry.reach / _COARSEST
        if columns is not None and not least <= columns <= most:
            raise InputError(
                f"flow.column_spacing = {units.LENGTH.shown(columns)}: must be from "
                f"{units.LENGTH.shown(least)} to {units.LENGTH.shown(most)} in a vessel that "
                f"reaches {units.LENGTH.shown(geometry.reach)}"
            )

    def cautions(
        self, geometry: Geometry, material: Material, speed: float, fill_volume: float
    ) -> tuple[str, ...]:
        """On the regime, beds that slide and lumps; the last two are refused if they are sure.

        The closed form knows its layer beforehand, and what its detectors say.
        """
        from scaleup_surface_layer.cautions import cautions_of

        found = cautions_of(geometry, material, speed, fill_volume)
        if isinstance(self.options, self.ClosedFormOptions):
            from scaleup_surface_layer.closed_form import detectors, rolling_bed
            from scaleup_surface_layer.detectors import warnings_of

            bed = rolling_bed(geometry, material, speed, fill_volume, self.options)
            found += warnings_of(detectors(bed), None)
        return found

    def solve(
        self, scene: Scene, comm: Any, progress: Progress, memory: Memory
    ) -> FlowField | None:
        """See `closed_form.drum_flow` and `general.general_flow`."""
        options = self.options
        if isinstance(options, self.ClosedFormOptions):
            from scaleup_surface_layer.closed_form import drum_flow

            return on_root_alone(comm, lambda: drum_flow(scene, options))
        from scaleup_surface_layer.general import general_flow

        return general_flow(scene, options, comm, progress)
