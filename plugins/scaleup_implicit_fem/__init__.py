"""Mixing `implicit-fem`: implicit finite elements with algebraic flux correction, any step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from scaleup.api import ExplicitBackend, FloatArray, MixingScene, PluginOptions, units

if TYPE_CHECKING:
    from scaleup_implicit_fem.transport import Transport


class ImplicitFem(ExplicitBackend):
    """Galerkin fluxes, five implicit Runge-Kutta stages, flux-corrected to [0, 1]; any step."""

    class Options(PluginOptions):
        """The step and the solver."""

        courant: Annotated[float, Field(gt=0, le=1e4)] = 5.0
        """step, as a multiple of the largest at which the explicit upwind scheme is positive"""
        time_step: units.Time | None = None
        """s, in place of such a multiple"""
        tolerance: Annotated[float, Field(ge=1e-14, le=1e-2)] = 1e-10
        """residual that the solver leaves, as a share of the right side"""
        petsc_options: str = ""
        """PETSc options of the linear solver, such as "-ksp_type gmres -pc_type hypre" """

    halo: ClassVar[int] = 1
    order: ClassVar[float] = 2.0

    def transport(self, scene: MixingScene, concentration: FloatArray, index: int) -> Transport:
        """See `transport.Transport`."""
        from scaleup_implicit_fem.transport import Transport

        return Transport(scene, self.options, concentration, index)
