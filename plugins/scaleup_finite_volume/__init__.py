"""Mixing `finite-volume`: conservative, bounded, fifth order where smooth; the default."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from scaleup.contract import Diffusion, Drift, FloatArray, MixingScene, PluginOptions, units
from scaleup.numerics import TransportBackend

if TYPE_CHECKING:
    from scaleup_finite_volume.three_stages import Transport


class FiniteVolume(TransportBackend):
    """Upwind-biased fluxes of fifth order, three Runge-Kutta stages, flux-corrected to [0, 1].

    Mass is kept to round-off and 0 <= c <= 1 without clipping, on moving fills and cut cells, in
    2-D and 3-D, for any number of components. See `fluxes` and `three_stages`.
    """

    class Options(PluginOptions):
        """The step."""

        courant: Annotated[float, Field(gt=0, le=1)] = 0.95
        """share of the stable step that is used"""
        time_step: units.Time | None = None
        """s, in place of a share of the stable step; beyond that only with --force"""

    halo: ClassVar[int] = 3
    laws = frozenset({Diffusion, Drift})
    order: ClassVar[float] = 2.0  # with mixed derivatives of a tensor; above 3 without

    def transport(self, scene: MixingScene, concentration: FloatArray, index: int) -> Transport:
        """See `three_stages.Transport`."""
        from scaleup_finite_volume.three_stages import Transport

        return Transport(scene, self.options, concentration, index)
