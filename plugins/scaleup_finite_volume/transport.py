"""Finite-volume transport of concentrations on the cells that a rank owns.

Algorithm of a step of dt from c, with H(c, t) the high-order fluxes of `fluxes` in a time t
(Wicker & Skamarock 2002, Mon. Weather Rev. 130, 2088; third order in time for a steady flow, since
the scheme is linear; second where the fill moves):

1. phi c' = phi c - div H(c, dt/3);  2. phi c'' = phi c - div H(c', dt/2);
3. flux correction of H(c'', dt): conservative, 0 <= c <= 1.

Limit: sum of what leaves a full cell in a step, by flow and twice by diffusion, at most its volume
(positivity of the upwind part); smaller cells are merged. The linear scheme itself is stable
beyond (see `stability`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scaleup.api import (
    LOOK_EVERY,
    ConservativeBed,
    FloatArray,
    FluxCorrection,
    IntArray,
    Interval,
    Ledger,
    MixingScene,
    StepGuard,
    spread_outwards,
)
from scaleup_finite_volume.fluxes import find_faces, high_order

if TYPE_CHECKING:
    from scaleup_finite_volume import FiniteVolume


_OVERSHOOT = 1e-9  # beyond [0, 1]: the scheme keeps its bounds to round-off


class Transport:
    """State and stepping. All components but the last are moved; the last is what remains."""

    def __init__(
        self,
        scene: MixingScene,
        options: FiniteVolume.Options,
        concentration: FloatArray,
        index: int,
    ):
        self.scene, self.split = scene, scene.decomposition
        moved = len(concentration) - 1
        self._guard = StepGuard(
            self.split, options.courant, options.time_step, _OVERSHOOT, scene.force
        )
        self._field = self.split.field(moved)
        self._stages = [self.split.field(moved), self.split.field(moved)]
        cells = self._field.flat.shape[1]
        self._fluxes = np.zeros((moved, scene.flow.grid.dimension, cells))
        self._correction = FluxCorrection(self.split, moved)
        interval = scene.flow.intervals[index]
        self._enter(index, interval.cells, concentration[:-1])

    def stable_time_step(self, interval: Interval) -> float:
        """Largest dt of positivity in full cells, s."""
        if interval.start == self._bed.interval.start:
            return self._bed.positive_step
        return self._bed_of(interval).positive_step

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Equal steps within the limit."""
        if index != self._index:
            self._enter(index, self._bed.interval.cells, self._values())
        stable = self._bed.positive_step
        steps, dt = self._guard.steps(start, end, stable)
        updates = steps * self._bed.updates * len(self._fluxes)
        ledger = Ledger(steps=steps, cell_updates=updates, step_share=dt / stable)
        for n in range(1, steps + 1):
            now = start + (n - 1) * dt
            self._step(now, start + n * dt)
            if n % LOOK_EVERY == 0 or n == steps:
                self._look(ledger, start + n * dt, dt)
        return ledger

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n); cells that were not active take what is around them; sums to 1."""
        grid, known = self.scene.flow.grid, self._bed.interval.cells
        moved = spread_outwards(grid, known, self._values(), interval.cells)
        return np.concatenate([moved, 1.0 - moved.sum(axis=0, keepdims=True)])

    def _bed_of(self, interval: Interval) -> ConservativeBed:
        scene = self.scene
        return ConservativeBed(scene.flow.grid, self.split, interval, scene.tensor(interval))

    def _enter(self, index: int, cells: IntArray, values: FloatArray) -> None:
        """Take up the values (m, n) at `cells` on the bed of interval `index`."""
        self._index, interval = index, self.scene.flow.intervals[index]
        self._bed = bed = self._bed_of(interval)
        bed.settle(max(bed.positive_step, self._guard.time_step or 0.0))
        self._faces = find_faces(bed)
        self._correction.enter(bed)
        here = spread_outwards(self.scene.flow.grid, cells, values, interval.cells)
        local = self.split.to_local(interval.cells, bed.enter(here, interval.start))
        for field in (self._field, *self._stages):
            field.array[...] = local

    def _step(self, start: float, end: float) -> None:
        dt = end - start
        c = now = self._field.flat
        for stage, share in zip(self._stages, (3, 2), strict=True):
            self._find_fluxes(now, dt / share)
            now = stage.flat
            self._correction.update(now, c, self._fluxes, start, start + dt / share)
            stage.exchange()
        self._find_fluxes(now, dt)
        self._correction.apply(c, self._fluxes, start, end)
        self._field.exchange()

    def _find_fluxes(self, c: FloatArray, dt: float) -> None:
        for component, flux in zip(c, self._fluxes, strict=True):
            high_order(flux, component, self._bed, self._faces, dt)

    def _look(self, ledger: Ledger, time: float, dt: float) -> None:
        c = self._field.flat
        low, high = self._correction.bounds(c)
        ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
        self._guard.judge(
            low, high, time, dt, self._bed.positive_step, lambda: self._correction.worst(c)
        )

    def _values(self) -> FloatArray:
        """(m, n) at the bed's cells, collected on every rank."""
        mine, where = self.split.owned_cells(self._bed.interval.cells)
        owned = self._field.array[:, *where]
        return self.split.gather(self._bed.interval.cells, owned, mine)
