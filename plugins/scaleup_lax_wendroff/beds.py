"""What each form of the scheme updates on an interval of the flow, and with what."""

from __future__ import annotations

import numpy as np

from scaleup.contract import BoolArray, FloatArray, InputError, IntArray, Interval, MixingScene
from scaleup.numerics import ConservativeBed
from scaleup_lax_wendroff import corrected_form, paper_form
from scaleup_lax_wendroff.stability import largest_step
from scaleup_lax_wendroff.stencil import neighbours


class Bed(ConservativeBed):
    """The bed of the conservative forms: full cells limit the step, cut cells are merged.

    The step keeps the stencil of full cells stable and the upwind fluxes of cut cells positive.
    """

    def __init__(self, scene: MixingScene, interval: Interval):
        super().__init__(scene.flow.grid, scene.decomposition, interval, scene.tensor(interval))
        numbers = corrected_form.courant_numbers(self, 1.0)
        self.stable_step = min(self._stable_step(*numbers, self.full), self.positive_step())

    def _stable_step(self, nu: FloatArray, mu: FloatArray, where: BoolArray) -> float:
        """Largest dt (s) that meets the sufficient condition in owned cells on all ranks."""
        limiting = self.owned[where[self.owned]]
        step = largest_step(nu[:, limiting], mu[..., limiting])
        return -self.split.largest(-step)

    @property
    def stencil_strides(self) -> IntArray:
        """Offsets of the stencil's neighbours in flattened local arrays."""
        offsets = np.array(neighbours(self.grid.dimension))
        return np.asarray(offsets @ np.array(self.strides))

    @property
    def updated(self) -> IntArray:
        """Positions in `interval.cells` of regular cells that the stencil updates, on all ranks."""
        regular = self.moving.copy()
        regular[self.merged.members] = False
        return np.flatnonzero(regular)

    def weights(self, dt: float) -> FloatArray:
        """Stencil weights for a step, (8 or 18, cells)."""
        return corrected_form.weights(self, dt)


class PaperBed(Bed):
    """The bed of form "paper": nodes, whose outermost copy the value one node inward."""

    def __init__(self, scene: MixingScene, interval: Interval):
        super().__init__(scene, interval)
        grid, split = self.grid, self.split
        mean_fill = 0.5 * (interval.fill_start + interval.fill_end)
        nodes = paper_form.find_nodes(grid, interval.cells, mean_fill)
        if len(nodes.inner) == 0:
            raise InputError("grid.spacing: the bed is too thin for this grid; make it finer")
        self.known = np.concatenate([nodes.inner, nodes.outer])
        self.updates = len(nodes.inner)
        self._inner = np.searchsorted(interval.cells, nodes.inner)
        _, outer = split.local_position(nodes.outer)
        self.outer = np.ravel_multi_index(outer, split.local_shape)
        here = split.local_position(nodes.outer)[0] & split.local_position(nodes.source)[0]
        self.targets, self.sources = (
            np.ravel_multi_index(split.local_position(cells[here])[1], split.local_shape)
            for cells in (nodes.outer, nodes.source)
        )
        self._velocity = split.to_local(interval.cells, interval.velocity(grid))
        self._velocity = self._velocity.reshape(grid.dimension, -1)
        inner = np.zeros(len(interval.cells), dtype=bool)
        inner[self._inner] = True
        everywhere = split.to_local(interval.cells, inner).ravel()
        self.stable_step = self._stable_step(*self._courant_numbers(1.0), everywhere)

    def settle(self, dt: float) -> None:
        """Nothing is merged."""

    def share_within_groups(self, values: FloatArray, time: float) -> None:
        """Nothing is merged."""

    def known_at(self, time: float) -> IntArray:
        """The nodes."""
        return self.known

    @property
    def updated(self) -> IntArray:
        """Positions in `interval.cells` of the inner nodes, on all ranks."""
        return self._inner

    def weights(self, dt: float) -> FloatArray:
        """Stencil weights for a step, (8 or 18, cells)."""
        return paper_form.weights(*self._courant_numbers(dt))

    def _courant_numbers(self, dt: float) -> tuple[FloatArray, FloatArray]:
        return paper_form.courant_numbers(self._velocity, self, dt)
