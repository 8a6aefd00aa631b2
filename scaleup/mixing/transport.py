"""What explicit mixing backends share: intervals entered, steps within the limit, values judged.

A backend derives from `ExplicitTransport`, says how a bed is made ready for it and how steps are
done, and gets the rest: concentrations carried from one interval of the flow to the next without
loss of content, equal steps within the stable one, and a look at the values every 50 steps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np

from scaleup.contract import Ledger, Mixing
from scaleup.mixing.conservative_bed import ConservativeBed
from scaleup.mixing.step_guard import LOOK_EVERY, StepGuard
from scaleup.space.flow_field import Interval
from scaleup.space.grid import FloatArray, IntArray
from scaleup.space.spread import spread_outwards

if TYPE_CHECKING:
    from scaleup.contract import MixingScene
    from scaleup.space.decomposition import GhostedField


class StepOptions(Protocol):
    """The options that choose the step."""

    @property
    def courant(self) -> float:
        """Share of the stable step that is used."""

    @property
    def time_step(self) -> float | None:
        """s, in place of a share of the stable step."""


AnyBed = TypeVar("AnyBed", bound=ConservativeBed)


class ExplicitTransport(ABC, Generic[AnyBed]):
    """State and stepping on a rank. All components but the last are moved; it is what remains.

    field -- concentrations now, all components but the last
    bed   -- of the interval that `field` is on
    """

    overshoot: float
    """how far beyond [0, 1] the scheme may go while it is stable"""
    conservative = True
    """whether the content of each component stays what it was, to round-off"""

    def __init__(
        self, scene: MixingScene, options: StepOptions, concentration: FloatArray, index: int
    ):
        self.scene, self.split = scene, scene.decomposition
        self.moved = len(concentration) - 1
        self.field: GhostedField = self.split.field(self.moved)
        self._guard = StepGuard(
            self.split, options.courant, options.time_step, self.overshoot, scene.force
        )
        self._enter(index)
        self.put(scene.flow.intervals[index].cells, concentration[:-1])
        self._begin()

    @abstractmethod
    def make_bed(self, interval: Interval) -> AnyBed:
        """The bed of an interval, its `stable_step` known but not settled yet."""

    @abstractmethod
    def entered(self) -> None:
        """Prepare for the settled `self.bed`, whose concentrations are in `self.field`."""

    @abstractmethod
    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Do `count` steps (at most `LOOK_EVERY`) from `start` (s, in the interval); collective."""

    def equal_steps(self, start: float, end: float) -> tuple[int, float]:
        """(number, length in s) of the steps from start to end (s), within the limit."""
        return self._guard.steps(start, end, self.bed.stable_step, self._longest)

    def bounds(self) -> tuple[float, float]:
        """Least and greatest of any component, before any clipping, on all ranks (collective)."""
        return self.bed.bounds(self.field.flat)

    def worst(self) -> tuple[float, int]:
        """(how far beyond [0, 1], position in local arrays) of this rank's worst value."""
        return self.bed.worst(self.field.flat)

    def stable_time_step(self, interval: Interval) -> float:
        """Largest step within the scheme's limit, s (collective)."""
        if interval.start == self.bed.interval.start:
            return self.bed.stable_step
        return self.make_bed(interval).stable_step

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Equal steps within the limit (collective)."""
        if index != self._index:
            before = self.bed
            self._enter(index)
            self.carry_over(before)
            self._begin()
        stable = self.bed.stable_step
        count, dt = self.equal_steps(start, end)
        updates = count * self.bed.updates * self.moved
        ledger = Ledger(steps=count, cell_updates=updates, step_share=dt / stable)
        done = 0
        while done < count:
            block = min(LOOK_EVERY, count - done)
            self.steps(start + done * dt, dt, block, ledger)
            done += block
            low, high = self.bounds()
            ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
            self._now = start + done * dt
            self._guard.judge(low, high, self._now, dt, stable, self.worst)
        return ledger

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank; sums to 1 (collective).

        Cells that hold nothing, or carry no value, take what is around them.
        """
        cells, values = self._values()
        moved = spread_outwards(self.scene.flow.grid, cells, values, interval.cells)
        return np.concatenate([moved, 1.0 - moved.sum(axis=0, keepdims=True)])

    def carry_over(self, before: AnyBed) -> None:
        """Take the values on another bed over to `self.bed`; collective.

        Nothing to do where all cells carry a value: the field holds them, and a cell that was not
        active holds nothing yet.
        """

    def put(self, cells: IntArray, values: FloatArray) -> None:
        """Set the field from values (m, n) at `cells`, spread to where there are none."""
        active = self.bed.interval.cells
        here = spread_outwards(self.scene.flow.grid, cells, values, active)
        self.field.flat[...] = self.split.placing(active).local(here)

    def _enter(self, index: int) -> None:
        """Settle on the bed of an interval."""
        flow = self.scene.flow
        self._index, interval = index, flow.intervals[index]
        self.bed: AnyBed = self.make_bed(interval)
        self._longest = np.inf
        if not (flow.steady and index == flow.prefix):  # that one lasts for ever
            self._longest = self.equal_steps(interval.start, interval.end)[1]
        self.bed.settle(min(self._longest, self.bed.stable_step))
        self._now = interval.start

    def _begin(self) -> None:
        """Take up the field on the bed that was just entered."""
        self.bed.share_within_groups(self.field.flat, self._now)
        self.field.exchange()
        self.entered()

    def _values(self) -> tuple[IntArray, FloatArray]:
        """Cells that carry a value now, and (m, n) of them, collected on every rank."""
        known = self.bed.known_at(self._now)
        mine, where = self.split.owned_cells(known)
        place = np.ravel_multi_index(where, self.split.local_shape)
        return known, self.split.gather(known, self.field.flat[:, place], mine)


class ExplicitBackend(Mixing):
    """A `Mixing` whose work an `ExplicitTransport` does; `Options` and `halo` are the plugin's."""

    _transport: ExplicitTransport[Any] | None = None

    @abstractmethod
    def transport(
        self, scene: MixingScene, concentration: FloatArray, index: int
    ) -> ExplicitTransport[Any]:
        """A transport on a scene, on interval `index`; where heavy modules are imported."""

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        self._transport = self.transport(scene, concentration, index)
        self.overshoot = self._transport.overshoot
        self.conservative = self._transport.conservative

    @property
    def running(self) -> ExplicitTransport[Any]:
        """What `start` began. Raises RuntimeError before it."""
        if self._transport is None:
            raise RuntimeError("start() comes first")
        return self._transport

    def stable_time_step(self, interval: Interval) -> float:
        """Largest step within the scheme's limit, s (collective)."""
        return self.running.stable_time_step(interval)

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index` in equal steps (collective)."""
        return self.running.advance(index, start, end)

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective)."""
        return self.running.concentration(interval)
