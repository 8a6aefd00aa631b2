"""Flow `mohr-coulomb`: finite elements (NGSolve) from rest to the steady flowing bed."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

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
        """Resolution and stopping rule."""

        fine_size: units.Length | None = None
        """m, element size about the free surface; default reach/24"""
        coarse_size: units.Length | None = None
        """m, element size elsewhere; default reach/9"""
        time_step: units.Time | None = None
        """s; default sqrt(reach/g)/20"""
        angle_tolerance: Annotated[units.Angle, Field(gt=0)] = 0.004363323129985824
        """rad (0.25 deg), standard error of the mean surface angle at which the run stops"""
        time_limit: units.Time | None = None
        """s of flow after which the run stops anyway; default 140 sqrt(reach/g)"""

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
