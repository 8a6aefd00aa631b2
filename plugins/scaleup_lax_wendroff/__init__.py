"""Mixing `lax-wendroff`: the explicit Taylor-Lax-Wendroff scheme, as printed and mended."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from scaleup.contract import (
    Diffusion,
    FloatArray,
    Geometry,
    InputError,
    MixingScene,
    PluginOptions,
    units,
)
from scaleup.numerics import BedTransport, TransportBackend


class LaxWendroff(TransportBackend):
    """One explicit step over a compact stencil, second order; 2-D and 3-D, moving fills."""

    class Options(PluginOptions):
        """Form of the scheme and its step."""

        form: Literal["corrected", "flux-corrected", "paper"] = "corrected"
        """"corrected": flux form, conservative, full tensor, unlimited; "flux-corrected": the same,
        kept within [0, 1]; "paper": Eq. 7-18 of the paper exactly as printed, boundary nodes
        copied, clipped to [0, 1]"""
        courant: Annotated[float, Field(gt=0, le=1)] = 0.95
        """share of the stable step that is used"""
        time_step: units.Time | None = None
        """s, in place of a share of the stable step; beyond that only with --force"""

    halo: ClassVar[int] = 8  # layers for several steps between two exchanges
    laws = frozenset({Diffusion})

    def check(self, geometry: Geometry, components: int) -> None:
        """The paper's form clips a component and takes the other for its rest."""
        if self.options.form == "paper" and components != 2:
            raise InputError(
                f"mixing.form = 'paper': clips two components, not {components}; use 'corrected'"
            )

    def transport(
        self, scene: MixingScene, concentration: FloatArray, index: int
    ) -> BedTransport[Any]:
        """The transport of the chosen form."""
        from scaleup_lax_wendroff.form_steps import FORMS

        return FORMS[self.options.form](scene, self.options, concentration, index)
