"""Finite-volume transport of concentrations on the cells that a rank owns.

Algorithm of a step of dt from c, with H(c, t) the high-order fluxes of `fluxes` in a time t
(Wicker & Skamarock 2002, Mon. Weather Rev. 130, 2088; third order in time for a steady flow, since
the scheme is linear; second where the fill moves):

1. phi c' = phi c - div H(c, dt/3);  2. phi c'' = phi c - div H(c', dt/2);
3. flux correction of H(c'', dt): conservative, 0 <= c <= 1.

Limit: what leaves a full cell in a step by flow, 2 x 1.07 times the cell diffusion numbers, and the
greatest difference of two drifts times dt/h at every face, add up to at most 1 (see `stability`);
cells that hold less are merged. Drifts are second order, with limited slopes (`add_drift`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scaleup.contract import FloatArray, Interval, Ledger, MixingScene
from scaleup.numerics import BedTransport, ConservativeBed, FluxCorrection
from scaleup_finite_volume.fluxes import find_faces, high_order
from scaleup_finite_volume.stability import DIFFUSION_FACTOR

if TYPE_CHECKING:
    from scaleup_finite_volume import FiniteVolume


class Transport(BedTransport[ConservativeBed]):
    """The algorithm above on the cells that a rank owns."""

    def __init__(
        self,
        scene: MixingScene,
        options: FiniteVolume.Options,
        concentration: FloatArray,
        index: int,
    ):
        split, moved = scene.decomposition, len(concentration) - 1
        self._stages = [split.field(moved), split.field(moved)]
        cells = self._stages[0].flat.shape[1]
        self._fluxes = np.zeros((moved, scene.flow.grid.dimension, cells))
        self._correction = FluxCorrection(split, moved)
        super().__init__(scene, options, concentration, index)

    def make_bed(self, interval: Interval) -> ConservativeBed:
        """The bed with the limit stated above."""
        scene = self.scene
        bed = ConservativeBed(
            scene.flow.grid, self.split, interval, scene.tensor(interval), scene.drift(interval)
        )
        bed.stable_step = bed.positive_step(DIFFUSION_FACTOR)
        return bed

    def entered(self) -> None:
        """Sort the faces; cells at rest hold the same in every stage."""
        self._faces = find_faces(self.bed)
        self._correction.enter(self.bed)
        for stage in self._stages:
            stage.array[...] = self.field.array

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Steps of the algorithm above."""
        for n in range(count):
            self._step(start + n * dt, start + (n + 1) * dt)

    def _step(self, start: float, end: float) -> None:
        dt = end - start
        c = now = self.field.flat
        for stage, share in zip(self._stages, (3, 2), strict=True):
            self._find_fluxes(now, dt / share)
            now = stage.flat
            self._correction.update(now, c, self._fluxes, start, start + dt / share)
            stage.exchange()
        self._find_fluxes(now, dt)
        self._correction.apply(c, self._fluxes, start, end)
        self.field.exchange()

    def _find_fluxes(self, c: FloatArray, dt: float) -> None:
        for component, flux in zip(c, self._fluxes, strict=True):
            high_order(flux, component, self.bed, self._faces, dt)
        self._correction.add_drift(self._fluxes, c, dt)
