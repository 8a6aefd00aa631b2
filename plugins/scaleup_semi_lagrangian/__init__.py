"""Mixing `semi-lagrangian`: content carried along paths over long steps; conservative, bounded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import Field

from scaleup.contract import (
    Diffusion,
    FloatArray,
    Interval,
    Ledger,
    Mixing,
    MixingScene,
    PluginOptions,
    units,
)

if TYPE_CHECKING:
    from scaleup_semi_lagrangian.split_step import Transport


class SemiLagrangian(Mixing):
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

    _transport: Transport | None = None

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        from scaleup_semi_lagrangian.split_step import Transport

        self._transport = Transport(scene, self.options, concentration, index)

    @property
    def _running(self) -> Transport:
        if self._transport is None:
            raise RuntimeError("start() comes first")
        return self._transport

    def stable_time_step(self, interval: Interval) -> float:
        """Infinite: no step is unstable."""
        return np.inf

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index` in equal steps (collective)."""
        return self._running.advance(index, start, end)

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective)."""
        return self._running.concentration(interval)
