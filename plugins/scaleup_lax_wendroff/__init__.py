"""Mixing `lax-wendroff`: the explicit Taylor-Lax-Wendroff scheme of the source paper."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from scaleup.api import FloatArray, Interval, Ledger, MixingScene, PluginOptions

if TYPE_CHECKING:
    from scaleup_lax_wendroff.transport import Transport


class LaxWendroff:
    """Nodal finite differences on the cell centres, explicit in time. See `stencil`."""

    class Options(PluginOptions):
        """Form of the scheme and its step."""

        form: Literal["corrected", "paper"] = "corrected"
        """"corrected": flux form, conservative, full tensor, no clipping; "paper": Eq. 7-18 of the
        paper exactly as printed, boundary nodes copied, clipped to [0, 1]"""
        courant: Annotated[float, Field(gt=0, le=1)] = 0.95
        """share of the stable step that is used"""

    halo: ClassVar[int] = 2

    def __init__(self, options: Options):
        self.options = options
        self._transport: Transport | None = None

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        from scaleup_lax_wendroff.transport import Transport

        self._transport = Transport(scene, self.options, concentration, index)

    @property
    def _running(self) -> Transport:
        if self._transport is None:
            raise RuntimeError("start() comes first")
        return self._transport

    def stable_time_step(self, interval: Interval) -> float:
        """Largest step within the sufficient condition, s (collective)."""
        return self._running.stable_time_step(interval)

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index` in equal stable steps (collective)."""
        return self._running.advance(index, start, end)

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective)."""
        return self._running.concentration(interval)
