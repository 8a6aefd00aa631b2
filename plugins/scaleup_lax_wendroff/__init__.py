"""Mixing `lax-wendroff`: the explicit Taylor-Lax-Wendroff scheme, as printed and mended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field

from scaleup.api import FloatArray, Interval, Ledger, MixingScene, PluginOptions, units

if TYPE_CHECKING:
    from scaleup.api import ExplicitTransport


class LaxWendroff:
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

    def __init__(self, options: Options):
        self.options = options
        self._transport: ExplicitTransport[Any] | None = None

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        from scaleup_lax_wendroff.transport import FORMS

        form = FORMS[self.options.form]
        self._transport = form(scene, self.options, concentration, index)

    @property
    def _running(self) -> ExplicitTransport[Any]:
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
