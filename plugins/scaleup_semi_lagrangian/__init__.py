"""Mixing `semi-lagrangian`: content carried along paths over long steps; conservative, bounded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from scaleup.contract import Diffusion, FloatArray, MixingScene, PluginOptions, units
from scaleup.numerics import TransportBackend

if TYPE_CHECKING:
    from scaleup_semi_lagrangian.split_step import Transport


class SemiLagrangian(TransportBackend):
    """Sub-cells moved along paths through the face fluxes and laid down where they end.

    Mass is kept to round-off and 0 <= c <= 1 without clipping, for any step, on moving fills and
    cut cells, in 2-D and 3-D, for any number of components. See `paths`, `images`, `split_step`.
    """

    class Options(PluginOptions):
        """The step, which only accuracy limits, and the sub-cells."""

        deformation: Annotated[float, Field(ge=1e-3, le=1e3)] | None = None
        """of a cell in a step, at most: the greatest velocity gradient times the step; default 2
        in 2-D, 5 in 3-D"""
        time_step: units.Time | None = None
        """s, in place of the limit on deformation"""
        subcells: Annotated[int, Field(ge=2, le=8)] | None = None
        """along an edge of a cell; default 4 in 2-D, 2 in 3-D"""

        memory: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
        """10^9 bytes on a rank, for what is kept from one revolution to the next; default: half
        of the machine's memory, shared out among the ranks on it"""

    halo: ClassVar[int] = 3
    laws = frozenset({Diffusion})
    order: ClassVar[float] = (
        1.9  # in the cell, at steps that do not shrink with it (sheared-disc: 1.7)
    )

    def transport(self, scene: MixingScene, concentration: FloatArray, index: int) -> Transport:
        """See `split_step.Transport`."""
        from scaleup_semi_lagrangian.split_step import Transport

        return Transport(scene, self.options, concentration, index)
