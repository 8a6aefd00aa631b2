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
        self._fields = [self.split.field() for _ in range(moved)]
        self._stages = [(self.split.field(), self.split.field()) for _ in range(moved)]
        self._c = [field.array.ravel() for field in self._fields]
        self._fluxes = np.zeros((moved, scene.flow.grid.dimension, self._c[0].size))
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
        updates = steps * self._bed.updates * len(self._c)
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
        for field, stages, start in zip(self._fields, self._stages, local, strict=True):
            for target in (field, *stages):
                target.array[...] = start

    def _step(self, start: float, end: float) -> None:
        dt = end - start
        for c, flux, stages in zip(self._c, self._fluxes, self._stages, strict=True):
            now = c
            for stage, share in zip(stages, (3, 2), strict=True):
                high_order(flux, now, self._bed, self._faces, dt / share)
                now = stage.array.ravel()
                self._correction.update(now, c, flux, start, start + dt / share)
                stage.exchange()
            high_order(flux, now, self._bed, self._faces, dt)
        self._correction.apply(self._c, self._fluxes, start, end)
        for field in self._fields:
            field.exchange()

    def _look(self, ledger: Ledger, time: float, dt: float) -> None:
        low, high = self._correction.bounds(self._c)
        ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
        self._guard.judge(
            low, high, time, dt, self._bed.positive_step, lambda: self._correction.worst(self._c)
        )

    def _values(self) -> FloatArray:
        """(m, n) at the bed's cells, collected on every rank."""
        mine, where = self.split.owned_cells(self._bed.interval.cells)
        owned = np.stack([field.array[where] for field in self._fields])
        return self.split.gather(self._bed.interval.cells, owned, mine)
