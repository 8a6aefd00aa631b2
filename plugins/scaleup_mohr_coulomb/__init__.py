"""Flow `mohr-coulomb`: finite elements (NGSolve) from rest to the steady flowing bed."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scaleup.api import (
    FlowField,
    Geometry,
    Memory,
    PluginOptions,
    Progress,
    Scene,
    on_root_alone,
    require_drum,
    units,
)


class MohrCoulomb:
    """Two-phase level-set flow of a Mohr-Coulomb powder in a drum's cross-section.

    Unset options follow the rules in `parameters.Discretisation`, none of which has seen
    validation data.
    """

    class Options(PluginOptions):
        """Friction law, resolution and stopping rule."""

        rheology: Literal["mohr-coulomb", "mu-i", "regularised-mu-i"] = "mohr-coulomb"
        """constant friction, mu(I), or mu(I) made well-posed in slow flow"""
        friction_rise: Annotated[float, Field(ge=0, le=2)] | None = None
        """mu of fast minus mu of slow flow; default 0.261 (mu-i), 0.215 (regularised-mu-i)"""
        inertial_number_0: Annotated[float, Field(gt=0)] | None = None
        """inertial number at half the rise; default 0.279 (mu-i), 0.069 (regularised-mu-i)"""
        tensile_strength: units.Pressure | None = None
        """Pa, tension that pulls cohesive powder apart; default (and at most) c cos(phi)/mu"""

        fine_size: units.Length | None = None
        """m, element size about the free surface; default reach/24, or down to reach/36 to see the
        filter length"""
        coarse_size: units.Length | None = None
        """m, element size elsewhere; default reach/9"""
        time_step: units.Time | None = None
        """s; default sqrt(reach/g)/20"""
        filter_length: units.Length | None = None
        """m, non-local length of shear rate and pressure; default d/sqrt(8), or reach/72 where that
        is below reach/108"""
        predictor_length: units.Length | None = None
        """m, over which stress beyond yield accelerates powder; default 0.07 reach"""
        angle_tolerance: Annotated[units.Angle, Field(gt=0)] = 0.004363323129985824
        """rad (0.25 deg), standard error of the mean surface angle at which the run stops"""
        velocity_tolerance: Annotated[float, Field(gt=0)] = 0.02
        """standard error of the mean velocity, relative, at which the run stops"""
        time_limit: units.Time | None = None
        """s of flow after which the run stops anyway; default 140 sqrt(reach/g)"""

        @model_validator(mode="after")
        def _constant_friction_does_not_rise(self) -> Self:
            given = self.friction_rise is not None or self.inertial_number_0 is not None
            if given and self.rheology == "mohr-coulomb":
                raise ValueError(
                    "friction_rise and inertial_number_0 belong to the rheologies mu-i and "
                    "regularised-mu-i: mohr-coulomb has constant friction"
                )
            return self

    def __init__(self, options: Options):
        self.options = options

    def check(self, geometry: Geometry, speed: float) -> None:
        """The wall must look the same at every phase, and the powder must not centrifuge."""
        require_drum("mohr-coulomb", geometry, speed, froude_below=1.0)

    def solve(
        self, scene: Scene, comm: Any, progress: Progress, memory: Memory
    ) -> FlowField | None:
        """Solve for the steady bed (kept without the grid, so that any grid can reuse it)."""

        def work() -> FlowField:
            from scaleup_mohr_coulomb.on_grid import flow_field
            from scaleup_mohr_coulomb.solve import steady_bed

            return flow_field(steady_bed(scene, self.options, progress, memory), scene)

        return on_root_alone(comm, work)
