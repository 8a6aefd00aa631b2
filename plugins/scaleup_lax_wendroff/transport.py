"""Lax-Wendroff transport of concentrations on the cells that a rank owns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from scaleup.api import (
    FloatArray,
    InputError,
    IntArray,
    Interval,
    Ledger,
    MixingScene,
    RunError,
    spread_outwards,
)
from scaleup_lax_wendroff import corrected_form, paper_form, stencil
from scaleup_lax_wendroff.stability import stability_number

if TYPE_CHECKING:
    from scaleup.api import GhostedField
    from scaleup_lax_wendroff import LaxWendroff

_CHECK_EVERY = 50  # steps between looks at the bounds
_ABSURD = 10.0  # a concentration that only growth can reach


class Bed:
    """The scheme on one interval of the flow: what it updates on this rank, and with what.

    interval -- the flow; volume -- of the bed, m^3
    known    -- flat grid indices of the cells that carry a value; `mine` flags those that this
                rank owns, at `where` in local arrays
    updates  -- number of cells that the stencil updates, on all ranks
    runs     -- contiguous runs of owned updated cells in flattened local arrays
    fill     -- flattened local array, m^3
    """

    def __init__(self, scene: MixingScene, interval: Interval):
        grid, split = scene.flow.grid, scene.decomposition
        self.interval, self._split = interval, split
        self.volume = float(interval.fill_start.sum())
        self.width = split.local_shape[-1]
        mean_fill = 0.5 * (interval.fill_start + interval.fill_end)
        self.fill = split.to_local(interval.cells, mean_fill).ravel()
        self._choose_cells(scene, mean_fill)
        self.mine, self.where = split.owned_cells(self.known)
        _, owned = split.owned_cells(self._updated)
        self._owned = np.sort(np.ravel_multi_index(owned, split.local_shape))
        self.runs = stencil.runs_of(self._owned)
        self.updates = len(self._updated)
        if self.updates == 0:
            raise InputError("grid.spacing: the bed is too thin for this grid; make it finer")
        self._flow = corrected_form.LocalFlow(
            fill=self.fill.reshape(split.local_shape),
            flux=split.to_local(interval.cells, interval.flux),
            tensor=split.to_local(interval.cells, scene.tensor(interval)),
            spacing=grid.spacing,
            areas=(grid.face_area(0), grid.face_area(1)),
            cell_volume=grid.cell_volume,
        )

    def _choose_cells(self, scene: MixingScene, mean_fill: FloatArray) -> None:
        self._updated = self.known = self.interval.cells

    def _courant_numbers(self, dt: float) -> tuple[FloatArray, FloatArray]:
        nu, mu = self._flow.courant_numbers(dt)
        full = self._flow.full  # cut cells limit no step
        return nu * full, mu * full

    def largest_step(self) -> float:
        """Largest dt (s, at most 1) that meets the sufficient condition on all ranks."""

        def worst(dt: float) -> float:
            number = stability_number(*self._courant_numbers(dt)).ravel()
            return self._split.largest(float(number[self._owned].max(initial=0.0)))

        # The number grows about as dt^2 (advection) or dt (diffusion): start above, come down.
        dt = 1.0
        while (number := worst(dt)) > 1.0:
            dt *= min(0.999, max(number**-0.5, 0.1))
        return dt

    def weights(self, dt: float) -> FloatArray:
        """Stencil weights for a step, (8, local cells)."""
        return corrected_form.weights(self._flow, dt).reshape(8, -1)

    def close_boundary(self, field: FloatArray) -> None:
        """Nothing to do: the faces of the bed's edge carry no flux."""


class PaperBed(Bed):
    """The bed of form "paper": nodes, whose outermost copy the value one node inward."""

    def _choose_cells(self, scene: MixingScene, mean_fill: FloatArray) -> None:
        interval, split = self.interval, self._split
        nodes = paper_form.find_nodes(scene.flow.grid, interval.cells, mean_fill)
        self._updated = nodes.inner
        self.known = np.concatenate([nodes.inner, nodes.outer])
        # an outer node beside an owned cell may copy from a cell two away: that is in the halo
        here = split.local_position(nodes.outer)[0] & split.local_position(nodes.source)[0]
        self._targets = self._local(nodes.outer[here])
        self._sources = self._local(nodes.source[here])
        self._velocity = split.to_local(interval.cells, interval.velocity(scene.flow.grid))

    def _courant_numbers(self, dt: float) -> tuple[FloatArray, FloatArray]:
        flow = self._flow
        return paper_form.courant_numbers(self._velocity, flow.tensor, flow.spacing, dt)

    def weights(self, dt: float) -> FloatArray:
        """Stencil weights for a step, (8, local cells)."""
        return paper_form.weights(*self._courant_numbers(dt)).reshape(8, -1)

    def close_boundary(self, field: FloatArray) -> None:
        """The outermost nodes take the value one node inward."""
        stencil.copy_inward(field, self._targets, self._sources)

    def _local(self, cells: IntArray) -> IntArray:
        """Positions in flattened local arrays of grid cells that all lie in this rank's box."""
        _, where = self._split.local_position(cells)
        flat: IntArray = np.ravel_multi_index(where, self._split.local_shape)
        return flat


class Transport:
    """State and stepping. All components but the last are moved; the last is what remains.

    Algorithm of a step: 1 the stencil on the owned updated cells; 2 form "paper": clip to [0, 1];
    3 exchange ghosts; 4 form "paper": the boundary copies one node inward.
    """

    def __init__(
        self,
        scene: MixingScene,
        options: LaxWendroff.Options,
        concentration: FloatArray,
        index: int,
    ):
        grid = scene.flow.grid
        if grid.dimension != 2:
            raise InputError("mixing.name = 'lax-wendroff': this backend works in 2-D only")
        if options.form == "paper" and len(concentration) != 2:
            raise InputError(
                f"mixing.form = 'paper': clips two components, not {len(concentration)}; "
                "use 'corrected'"
            )
        self.scene, self.options, self.split = scene, options, scene.decomposition
        self._fields = [
            (self.split.field(), self.split.field()) for _ in range(len(concentration) - 1)
        ]
        self._enter(index, scene.flow.intervals[index].cells, concentration[:-1])

    def stable_time_step(self, interval: Interval) -> float:
        """Largest dt with the sufficient condition met at every updated cell, s."""
        if interval.start == self._bed.interval.start:
            return self._stable_dt
        return self._bed_of(interval).largest_step()

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Equal steps, each at most `courant` times the stable one."""
        if index != self._index:
            self._enter(index, self._bed.known, self._known_values())
        steps = max(1, math.ceil((end - start) / (self.options.courant * self._stable_dt) - 1e-9))
        dt = (end - start) / steps
        weights = self._bed.weights(dt)
        ledger = Ledger(steps=steps, cell_updates=steps * self._bed.updates * len(self._fields))
        for n in range(1, steps + 1):
            for pair in range(len(self._fields)):
                self._step(pair, weights, ledger)
            if n % _CHECK_EVERY == 0 or n == steps:
                self._look(ledger, start + n * dt, dt)
        ledger.clipped = self.split.total(ledger.clipped)
        return ledger

    def concentration(self, interval: Interval) -> FloatArray:
        """Node values, carried to the bed's cells that are not nodes; sums to 1 in each."""
        moved = spread_outwards(
            self.scene.flow.grid, self._bed.known, self._known_values(), interval.cells
        )
        return np.concatenate([moved, 1.0 - moved.sum(axis=0, keepdims=True)])

    def _enter(self, index: int, cells: IntArray, values: FloatArray) -> None:
        """Take up the given values (m, n) at `cells` on the bed of interval `index`."""
        self._index = index
        interval = self.scene.flow.intervals[index]
        self._bed = self._bed_of(interval)
        self._stable_dt = self._bed.largest_step()
        spread = spread_outwards(self.scene.flow.grid, cells, values, interval.cells)
        local = self.split.to_local(interval.cells, spread)
        for (now, _), start in zip(self._fields, local, strict=True):
            now.array[...] = start
            self._close_boundary(now)

    def _bed_of(self, interval: Interval) -> Bed:
        kind = PaperBed if self.options.form == "paper" else Bed
        return kind(self.scene, interval)

    def _close_boundary(self, field: GhostedField) -> None:
        field.exchange()
        self._bed.close_boundary(field.array.ravel())

    def _step(self, pair: int, weights: FloatArray, ledger: Ledger) -> None:
        now, new = self._fields[pair]
        bed = self._bed
        stencil.step(now.array.ravel(), new.array.ravel(), weights, bed.runs, bed.width)
        if self.options.form == "paper":
            low, high, moved = stencil.clip(new.array.ravel(), bed.fill, bed.runs)
            ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
            ledger.clipped += moved / bed.volume
        self._close_boundary(new)
        self._fields[pair] = (new, now)

    def _look(self, ledger: Ledger, time: float, dt: float) -> None:
        """Bounds so far; stops a run whose values only growth can explain (collective)."""
        moved = [now.array.ravel() for now, _ in self._fields]
        for values in (*moved, 1.0 - np.sum(moved, axis=0)):
            low, high = stencil.bounds(values, self._bed.runs)
            ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
        ledger.minimum = -self.split.largest(-ledger.minimum)
        ledger.maximum = self.split.largest(ledger.maximum)
        worst = max(abs(ledger.minimum), abs(ledger.maximum))
        if not worst < _ABSURD:
            raise RunError(
                f"the concentration grew to {worst:.3g} at t = {time:.4g} s with a step of "
                f"{dt:.3g} s; reduce mixing.courant (now {self.options.courant:g})"
            )

    def _known_values(self) -> FloatArray:
        """(m, n) at the bed's known cells, collected on every rank."""
        bed = self._bed
        owned = np.stack([now.array[bed.where] for now, _ in self._fields])
        return self.split.gather(bed.known, owned, bed.mine)
