"""Mixing `finite-volume`: conservative, bounded, fifth order where smooth; the default."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

from pydantic import Field

from scaleup.api import FloatArray, Interval, Ledger, MixingScene, PluginOptions, units

if TYPE_CHECKING:
    from scaleup_finite_volume.transport import Transport


class FiniteVolume:
    """Upwind-biased fluxes of fifth order, three Runge-Kutta stages, flux-corrected to [0, 1].

    Mass is kept to round-off and 0 <= c <= 1 without clipping, on moving fills and cut cells, in
    2-D and 3-D, for any number of components. See `fluxes` and `transport`.
    """

    class Options(PluginOptions):
        """The step."""

        courant: Annotated[float, Field(gt=0, le=1)] = 0.95
        """share of the stable step that is used"""
        time_step: units.Time | None = None
        """s, in place of a share of the stable step; beyond that only with --force"""

    halo: ClassVar[int] = 3
    order: ClassVar[float] = 2.0  # with mixed derivatives of a tensor; above 3 without

    def __init__(self, options: Options):
        self.options = options
        self._transport: Transport | None = None

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        from scaleup_finite_volume.transport import Transport

        self._transport = Transport(scene, self.options, concentration, index)

    @property
    def _running(self) -> Transport:
        if self._transport is None:
            raise RuntimeError("start() comes first")
        return self._transport

    def stable_time_step(self, interval: Interval) -> float:
        """Largest step that keeps 0 <= c <= 1, s (collective)."""
        return self._running.stable_time_step(interval)

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index` in equal steps (collective)."""
        return self._running.advance(index, start, end)

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective)."""
        return self._running.concentration(interval)
