"""A mixing backend as a run sees it: what it returns is checked, and its errors name it."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from scaleup.contract import Ledger, Mixing
from scaleup.space.flow_field import Interval
from scaleup.space.grid import FloatArray
from scaleup.system.blame import blamed_on
from scaleup.system.errors import ContractError

if TYPE_CHECKING:
    from scaleup.contract import MixingScene

_ROUND_OFF = 1e-9  # of sums and contents, after any number of steps


class CheckedMixing:
    """Passes calls on to a backend; raises ContractError for what it must not return.

    1 concentrations are (components, n) finite floating-point numbers; 2 they sum to 1; 3 they stay
    within [0, 1] but for the backend's `overshoot`, and so do the bounds in its ledgers; 4 the
    content of each component stays what it was, if the backend is `conservative`; 5 a ledger holds
    numbers, and shares that are not negative. A forced run is held to 1, 2 and 5 alone.
    """

    def __init__(self, backend: Mixing, name: str | None = None):
        """`name`: what the backend is registered under, for errors; None for none."""
        self._backend, self._name = backend, name
        with self._within():
            self.halo, self.laws = int(backend.halo), backend.laws
        self._scene: MixingScene | None = None
        self._components = 0
        self._content: FloatArray = np.zeros(0)  # m^3 of each component

    def start(
        self, scene: MixingScene, concentration: FloatArray, index: int = 0, time: float = 0.0
    ) -> None:
        """As `Mixing.start`; `time`: s, when in the interval the concentrations are those given."""
        self._scene, self._components = scene, len(concentration)
        self._content = _content(concentration, scene.flow.intervals[index], time)
        with self._within():
            self._backend.start(scene, concentration, index)

    def stable_time_step(self, interval: Interval) -> float:
        """As `Mixing.stable_time_step`."""
        with self._within():
            step = float(self._backend.stable_time_step(interval))
            if not step > 0:
                raise ContractError(f"stable_time_step = {step}: must be positive")
        return step

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """As `Mixing.advance`."""
        with self._within():
            ledger = self._backend.advance(index, start, end)
            self._check_ledger(ledger)
        return ledger

    def concentration(self, interval: Interval, time: float) -> FloatArray:
        """As `Mixing.concentration`, at a time (s) of the interval."""
        with self._within():
            concentration = self._backend.concentration(interval)
            self._check(concentration, interval, time)
        return np.asarray(concentration)

    def _within(self) -> AbstractContextManager[None]:
        return nullcontext() if self._name is None else blamed_on("mixing", self._name)

    def _check(self, concentration: Any, interval: Interval, time: float) -> None:
        wanted = (self._components, len(interval.cells))
        if not isinstance(concentration, np.ndarray) or concentration.shape != wanted:
            shape = getattr(concentration, "shape", type(concentration).__name__)
            raise ContractError(f"the concentration is {shape}, and must be an array {wanted}")
        if not np.issubdtype(concentration.dtype, np.floating):
            raise ContractError(f"the concentration holds {concentration.dtype}, not real numbers")
        if not np.all(np.isfinite(concentration)):
            raise ContractError("the concentration has values that are not finite")
        sums = concentration.sum(axis=0)
        worst = float(sums[np.abs(sums - 1.0).argmax()])
        if abs(worst - 1.0) > _ROUND_OFF:
            raise ContractError(f"the components sum to {worst:.6g} in a cell, and must to 1")
        self._check_bounds(float(concentration.min()), float(concentration.max()))
        content = _content(concentration, interval, time)
        drift = np.abs(content - self._content) / self._content.sum()
        if self._conserves and drift.max() > _ROUND_OFF:
            k = int(drift.argmax())
            raise ContractError(
                f"component {k + 1} went from {self._content[k]:.6g} to {content[k]:.6g} m^3, and "
                "must be conserved; a backend that is not conservative states conservative = False"
            )

    def _check_ledger(self, ledger: Any) -> None:
        if not isinstance(ledger, Ledger):
            raise ContractError(f"advance returned {type(ledger).__name__}, and must a Ledger")
        for each in fields(ledger):
            value = getattr(ledger, each.name)
            bound = each.name in ("minimum", "maximum")
            if not isinstance(value, (int, float, np.number)) or math.isnan(value):
                raise ContractError(f"ledger.{each.name} = {value!r}: must be a number")
            if not bound and not 0 <= value < math.inf:
                raise ContractError(f"ledger.{each.name} = {value!r}: must be finite, not negative")
        if ledger.minimum <= ledger.maximum:  # else nothing was looked at
            self._check_bounds(float(ledger.minimum), float(ledger.maximum))

    def _check_bounds(self, low: float, high: float) -> None:
        overshoot = float(self._backend.overshoot)
        if not self._forced and max(-low, high - 1.0) > overshoot:
            raise ContractError(
                f"the concentration runs from {low:.6g} to {high:.6g}, and may leave [0, 1] by "
                f"{overshoot:g}; a backend that goes further states its overshoot"
            )

    @property
    def _forced(self) -> bool:
        return self._scene is not None and self._scene.force

    @property
    def _conserves(self) -> bool:
        return not self._forced and bool(self._backend.conservative)


def _content(concentration: FloatArray, interval: Interval, time: float) -> FloatArray:
    """Volume of each component, m^3."""
    return np.asarray((concentration * interval.fill(time)).sum(axis=1))
