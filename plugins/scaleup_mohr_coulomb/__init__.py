"""Flow `mohr-coulomb`: finite elements (NGSolve) from rest to the steady flowing bed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, ValidationInfo, field_validator

from scaleup.contract import (
    GRAVITY,
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
from scaleup.numerics import on_root_alone, require_drum, require_rolling

_COARSEST, _FINEST = 3.0, {2: 500.0, 3: 60.0}  # elements in a vessel's reach
_MOST_STEPS = 2000.0  # in the time of free fall over the reach


class MohrCoulomb(Flow):
    """Two-phase level-set flow of a Mohr-Coulomb powder in a drum's cross-section or a vessel.

    Unset options follow the rules in `parameters.Discretisation`, none of which has seen
    validation data.
    """

    class Options(PluginOptions):
        """Friction law and resolution."""

        rheology: Literal["mohr-coulomb", "mu-i", "regularised-mu-i"] = "mohr-coulomb"
        """constant friction, mu(I), or mu(I) made well-posed in slow flow"""
        friction_rise: Annotated[float, Field(ge=0, le=2)] | None = None
        """mu of fast minus mu of slow flow; default 0.261 (mu-i), 0.215 (regularised-mu-i)"""
        inertial_number_0: Annotated[float, Field(gt=0)] | None = None
        """inertial number at half the rise; default 0.279 (mu-i), 0.069 (regularised-mu-i)"""
        tensile_strength: units.Pressure | None = None
        """Pa, tension that pulls cohesive powder apart; default (and at most) c cos(phi)/mu"""

        fine_size: units.Length | None = None
        """m, element size about the free surface; default 4 nonlocal_length, from reach/27 to
        reach/24; in space that of all elements, default reach/6"""
        time_step: units.Time | None = None
        """s; default sqrt(reach/g)/10, at most 1/(150 omega); in space sqrt(reach/g)/8"""
        nonlocal_length: units.Length | None = None
        """m, over which flowing grains loosen their neighbours; default 0.48 d/sqrt(mu), or
        reach/108 if that is more; in space at least fine_size/4"""
        predictor_length: units.Length | None = None
        """m, over which stress beyond yield accelerates powder; default reach/10"""

        @field_validator("friction_rise", "inertial_number_0")
        @classmethod
        def _constant_friction_does_not_rise(
            cls, value: float | None, info: ValidationInfo
        ) -> float | None:
            if value is not None and info.data.get("rheology") == "mohr-coulomb":
                raise ValueError(
                    "belongs to the rheologies mu-i and regularised-mu-i; mohr-coulomb has "
                    "constant friction"
                )
            return value

    class PlaneOptions(Options):
        """2-D, a drum's cross-section, to its steady mean flow."""

        coarse_size: units.Length | None = None
        """m, element size away from the free surface; default reach/9"""
        angle_tolerance: Annotated[units.Angle, Field(gt=0)] = 0.004363323129985824
        """rad (0.25 deg), standard error of the mean surface angle at which the run stops"""
        velocity_tolerance: Annotated[float, Field(gt=0)] = 0.02
        """standard error of the mean velocity, relative, at which the run stops"""
        time_limit: units.Time | None = None
        """s of flow after which the run stops anyway; default 140 sqrt(reach/g)"""
        start_up: bool = False
        """begin with the solved first avalanche and swings, not with the mean flow"""
        solve_from: Literal["rest", "nearest"] = "rest"
        """solve from a bed at rest, or from the nearest mean flow of the same drum in the store"""

        @field_validator("solve_from")
        @classmethod
        def _a_start_up_begins_at_rest(cls, value: str, info: ValidationInfo) -> str:
            if value != "rest" and info.data.get("start_up"):
                raise ValueError("must be rest where flow.start_up = true, which begins there")
            return value

    class SpaceOptions(Options):
        """3-D, a vessel in space, with elements of one size, revolution by revolution."""

        intervals: Annotated[int, Field(ge=24, le=720)] = 60
        """of a revolution, in each of which the fluxes are constant"""
        revolutions: Annotated[int, Field(ge=2, le=20)] = 2
        """solved for at most, unless the last two agree before; the last one is the flow that
        repeats"""

    forms: ClassVar = {"plane": PlaneOptions, "space": SpaceOptions}

    @staticmethod
    def form(geometry: Geometry, given: Mapping[str, Any]) -> str:
        """By the vessel's dimension."""
        return "plane" if geometry.dimension == 2 else "space"

    def check(self, geometry: Geometry, speed: float) -> None:
        """A plane scene must look the same at every phase; no powder may centrifuge."""
        self._check_resolution(geometry)
        if isinstance(self.options, self.PlaneOptions):
            require_drum("mohr-coulomb", geometry, speed, froude_below=1.0)
            return
        if tuple(geometry.axis.direction) != (0.0, 0.0, 1.0):
            raise InputError("flow.name = 'mohr-coulomb': the axis of rotation must run along z")
        if tuple(geometry.axis.point[:2]) != (0.0, 0.0):
            raise InputError(
                "flow.name = 'mohr-coulomb': the axis of rotation must pass through x = y = 0"
            )
        require_rolling("mohr-coulomb", geometry, speed, froude_below=1.0)

    def _check_resolution(self, geometry: Geometry) -> None:
        """Sizes and steps with which a solution has an end. Raises InputError."""
        reach, finest = geometry.reach, _FINEST[geometry.dimension]
        for key in ("fine_size", "coarse_size", "nonlocal_length", "predictor_length"):
            size = getattr(self.options, key, None)
            least = 0.0 if key == "nonlocal_length" else reach / finest
            if size is not None and not least <= size <= reach / _COARSEST:
                raise InputError(
                    f"flow.{key} = {units.LENGTH.shown(size)}: must be from "
                    f"{units.LENGTH.shown(least)} to {units.LENGTH.shown(reach / _COARSEST)} in a "
                    f"vessel that reaches {units.LENGTH.shown(reach)}"
                )
        fall, step = math.sqrt(reach / GRAVITY), self.options.time_step
        limit = getattr(self.options, "time_limit", None)
        if step is not None and not fall / _MOST_STEPS <= step <= fall:
            raise InputError(
                f"flow.time_step = {step:g} s: must be from {fall / _MOST_STEPS:.2g} s to the time "
                f"of free fall over the vessel's reach, {fall:.2g} s"
            )
        if limit is not None and limit < fall:
            raise InputError(
                f"flow.time_limit = {limit:g} s: must be at least the time of free fall over the "
                f"vessel's reach, {fall:.2g} s"
            )

    def cautions(
        self, geometry: Geometry, material: Material, speed: float, fill_volume: float
    ) -> tuple[str, ...]:
        """On the regime of the rheology, and beds that slide."""
        from scaleup_mohr_coulomb.cautions import cautions_of

        return cautions_of(self.options.rheology, geometry, material, speed, fill_volume)

    def solve(
        self, scene: Scene, comm: Any, progress: Progress, memory: Memory
    ) -> FlowField | None:
        """The steady bed of a drum's cross-section (kept without the grid, so that any grid can
        reuse it), or the periodic flow of a vessel in space, on all ranks.
        """
        options = self.options
        if isinstance(options, self.SpaceOptions):
            from scaleup_mohr_coulomb.space_solve import vessel_flow

            return vessel_flow(scene, options, comm, progress, memory)

        def work() -> FlowField:
            from scaleup_mohr_coulomb.on_grid import flow_field
            from scaleup_mohr_coulomb.solve import steady_bed
            from scaleup_mohr_coulomb.start_up import with_start_up

            bed = steady_bed(scene, options, progress, memory)
            flow = flow_field(bed, scene)
            if bed.start_up is None:
                return flow
            return with_start_up(flow, bed, bed.start_up, scene, progress)

        return on_root_alone(comm, work)
