"""Lax-Wendroff transport of concentrations on the cells that a rank owns, one class for each form.

Step of forms "corrected" and "paper": 1 the stencil on the updated cells, merged cells by groups;
2 form "paper": clip to [0, 1], then the boundary copies one node inward. Ghosts are exchanged when
their layers are used up. Step of form "flux-corrected": the same fluxes, corrected to keep [0, 1].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from scaleup.contract import FloatArray, Interval, Ledger, MixingScene, RunError
from scaleup.numerics import BedTransport, FluxCorrection
from scaleup_lax_wendroff import corrected_form, stencil
from scaleup_lax_wendroff.beds import Bed, PaperBed
from scaleup_lax_wendroff.rounds import Round, plan_rounds

if TYPE_CHECKING:
    from scaleup_lax_wendroff import LaxWendroff


_CLIPPED_PER_STEP, _CLIPPED_PER_STEP_OF_FRONT = 2e-3, 0.1  # shares of the bed
_SAME_STEP = 1e-13  # relative; steps that differ by round-off share their weights


class StencilTransport(BedTransport[Bed]):
    """Form "corrected"."""

    overshoot = 1.0  # sharp fronts ring

    def __init__(
        self,
        scene: MixingScene,
        options: LaxWendroff.Options,
        concentration: FloatArray,
        index: int,
    ):
        self._other = scene.decomposition.field(len(concentration) - 1)
        super().__init__(scene, options, concentration, index)

    def make_bed(self, interval: Interval) -> Bed:
        """The bed of this form."""
        return Bed(self.scene, interval)

    def entered(self) -> None:
        """Plan the rounds; cells at rest hold the same in both fields."""
        self._groups = self.bed.groups_in_box()
        self._rounds, self._between = plan_rounds(self.bed, self._groups)
        self._strides = self.bed.stencil_strides
        self._dt = 0.0
        self._done = self._between  # since the last exchange
        self._other.array[...] = self.field.array

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Steps of the stencil."""
        if abs(self._dt - dt) > _SAME_STEP * dt:
            self._dt, self._weights = dt, self.bed.weights(dt)
        for n in range(count):
            if self._done == self._between:
                self.field.exchange()
                self._done = 0
            turn = self._rounds[min(self._done, len(self._rounds) - 1)]
            after = self._groups.fraction(start + (n + 1) * dt)
            for c, new in zip(self.field.flat, self._other.flat, strict=True):
                stencil.step(c, new, self._weights, turn.runs, self._strides)
                stencil.step_groups(
                    c, new, self._weights, self._strides, self._groups.members,
                    self._groups.first, turn.groups, after,
                )  # fmt: skip
                self.finish(new, turn, ledger)
            self.field, self._other = self._other, self.field
            self._done += 1

    def finish(self, c: FloatArray, turn: Round, ledger: Ledger) -> None:
        """What a form does after the stencil; nothing here."""


class PaperTransport(StencilTransport):
    """Form "paper": clipped, its boundary copied; judged by what came before the clipping."""

    conservative = False

    def make_bed(self, interval: Interval) -> PaperBed:
        """The bed of this form."""
        return PaperBed(self.scene, interval)

    def carry_over(self, before: Bed) -> None:
        """Nodes that were none take what is around them."""
        assert isinstance(before, PaperBed)
        place = self.split.placing(before.known)
        owned = self.field.flat[:, place.owned]
        self.put(before.known, self.split.gather(before.known, owned, place.mine))

    def entered(self) -> None:
        """The boundary copies from the start."""
        bed = self._paper_bed
        self.field.exchange()
        stencil.copy_inward(self.field.flat[0], bed.targets, bed.sources)
        super().entered()
        volume = self.split.grid.cell_volume / float(bed.interval.fill_start.sum())
        self._share = np.zeros(bed.full.shape)  # of the bed's volume, of owned cells
        mine = self.split.placing(bed.interval.cells).mine
        self._share[bed.owned] = bed.fraction_at(bed.interval.start)[mine] * volume
        self._before_clipping = (np.inf, -np.inf)
        self._clipped = 0.0

    @property
    def _paper_bed(self) -> PaperBed:
        assert isinstance(self.bed, PaperBed)
        return self.bed

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Steps, and what they clipped on all ranks."""
        self._before_clipping, self._clipped = (np.inf, -np.inf), 0.0
        super().steps(start, dt, count, ledger)
        clipped = self.split.total(self._clipped)
        ledger.clipped += clipped
        # a stable front clips some of the cells along it, growth clips the bed
        stable = count * (_CLIPPED_PER_STEP + _CLIPPED_PER_STEP_OF_FRONT / self.bed.updates**0.5)
        if clipped > stable and not self.scene.force:
            raise RunError(
                f"clipping to [0, 1] moved {clipped:.2g} of the bed in {count} steps up to t = "
                f"{start + count * dt:.4g} s: the scheme grows and clipping hides it; reduce "
                "mixing.courant or mixing.time_step"
            )

    def finish(self, c: FloatArray, turn: Round, ledger: Ledger) -> None:
        """Clip, then copy."""
        bed = self._paper_bed
        low, high, moved = stencil.clip(c, self._share, turn.runs)
        least, greatest = self._before_clipping
        self._before_clipping = (min(least, low), max(greatest, high))
        self._clipped += moved
        stencil.copy_inward(c, bed.targets[turn.copies], bed.sources[turn.copies])

    def bounds(self) -> tuple[float, float]:
        """Before clipping, since the last look."""
        low, high = self._before_clipping
        both = self.split.largest_of([-low, high])
        return -float(both[0]), float(both[1])


class BoundedTransport(BedTransport[Bed]):
    """Form "flux-corrected"."""

    def __init__(
        self,
        scene: MixingScene,
        options: LaxWendroff.Options,
        concentration: FloatArray,
        index: int,
    ):
        split, moved = scene.decomposition, len(concentration) - 1
        self._correction = FluxCorrection(split, moved)
        super().__init__(scene, options, concentration, index)

    def make_bed(self, interval: Interval) -> Bed:
        """The bed of this form."""
        return Bed(self.scene, interval)

    def entered(self) -> None:
        """Coefficients follow with the first step."""
        self._correction.enter(self.bed)
        self._fluxes = np.zeros((self.moved, *self.bed.flux.shape))
        self._dt = 0.0

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Fluxes of the flux form, corrected."""
        if abs(self._dt - dt) > _SAME_STEP * dt:
            self._dt, self._faces = dt, corrected_form.coefficients(self.bed, dt)
        faces, bed = self._faces, self.bed
        for n in range(count):
            for c, flux in zip(self.field.flat, self._fluxes, strict=True):
                corrected_form.face_fluxes(
                    flux, c, faces.behind, faces.here, faces.twist, bed.face_runs, bed.strides
                )
            now = start + n * dt
            self._correction.apply(self.field.flat, self._fluxes, now, now + dt)
            self.field.exchange()


FORMS = {"corrected": StencilTransport, "paper": PaperTransport, "flux-corrected": BoundedTransport}
