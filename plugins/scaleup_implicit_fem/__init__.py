"""Mixing `implicit-fem`: implicit finite elements with algebraic flux correction, any step."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field, field_validator

from scaleup.contract import Diffusion, FloatArray, MixingScene, PluginOptions, units
from scaleup.numerics import TransportBackend

if TYPE_CHECKING:
    from scaleup_implicit_fem.implicit_step import Transport


_OPTIONS = ("ksp_", "pc_", "mat_", "sub_", "mg_", "fieldsplit_", "esteig_", "log_", "options_")


def petsc_pairs(text: str) -> list[tuple[str, str | None]]:
    """Names, without their "-", and values of PETSc options. Raises ValueError.

    Which values PETSc knows only PETSc can tell, once the solver is made.
    """
    pairs: list[tuple[str, str | None]] = []
    for word in shlex.split(text):
        if word.startswith("-") and not word[1:2].isdigit():
            if not word[1:].startswith(_OPTIONS):
                raise ValueError(
                    f"{word[:40]!r} is no option of a linear solver; they begin with -"
                    f"{', -'.join(_OPTIONS)}"
                )
            pairs.append((word[1:], None))
        elif not pairs or pairs[-1][1] is not None:
            raise ValueError(f"{word[:40]!r} is no option; write -name value")
        else:
            pairs[-1] = (pairs[-1][0], word)
    return pairs


class ImplicitFem(TransportBackend):
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

        @field_validator("petsc_options")
        @classmethod
        def _are_pairs(cls, text: str) -> str:
            petsc_pairs(text)
            return text

    halo: ClassVar[int] = 1
    laws = frozenset({Diffusion})
    order: ClassVar[float] = 2.0

    def transport(self, scene: MixingScene, concentration: FloatArray, index: int) -> Transport:
        """See `implicit_step.Transport`."""
        from scaleup_implicit_fem.implicit_step import Transport

        return Transport(scene, self.options, concentration, index)
