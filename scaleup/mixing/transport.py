"""What mixing backends share: intervals entered, equal steps, values judged and gathered.

A backend derives from `TransportBackend` and names its transport: a `Transport` says how it takes
up an interval and does steps, and gets the rest. A `BedTransport` does both on a `ConservativeBed`,
whose cells are merged so that none of them limits the step.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from scaleup.contract import Ledger, Mixing
from scaleup.mixing.conservative_bed import ConservativeBed
from scaleup.mixing.steps import LOOK_EVERY, Steps
from scaleup.space.flow_field import Interval
from scaleup.space.grid import FloatArray, IntArray
from scaleup.space.spread import spread_outwards

if TYPE_CHECKING:
    from scaleup.contract import MixingScene
    from scaleup.space.decomposition import GhostedField


class Transport(ABC):
    """State and stepping on a rank. All components but the last are moved; it is what remains.

    field   -- concentrations now, all components but the last
    now     -- s, in the interval that `field` is on, whose number is `index`
    updates -- how many cells a step in it updates, on all ranks; set by `enter`
    longest -- s, no step in it may be longer
    """

    overshoot = 1e-9
    """how far beyond [0, 1] the scheme may go while it is stable"""
    conservative = True
    """whether the content of each component stays what it was, to round-off"""
    updates: int
    longest = math.inf

    def __init__(self, scene: MixingScene, concentration: FloatArray, steps: Steps):
        """The derived class enters an interval and lays the concentrations there."""
        self.scene, self.split = scene, scene.decomposition
        self.moved = len(concentration) - 1
        self.field: GhostedField = self.split.field(self.moved)
        self._steps = steps
        self.index, self.now = -1, 0.0

    @abstractmethod
    def enter(self, index: int) -> None:
        """Take up interval `index`, and the field on it, which may hold none yet; collective."""

    @abstractmethod
    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Do `count` steps (at most `LOOK_EVERY`) from `start` (s, in the interval); collective."""

    @property
    @abstractmethod
    def own_step(self) -> float:
        """The step on this interval that `steps` takes a share of, s."""

    @abstractmethod
    def known(self) -> IntArray:
        """Flat grid indices of the cells that carry a concentration now."""

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Least and greatest of any component, before any clipping, on all ranks (collective)."""

    def worst(self) -> tuple[float, int]:
        """(how far beyond [0, 1], position in local arrays) of this rank's worst value."""
        _, where = self.split.owned_cells(self.known())
        place = np.ravel_multi_index(where, self.split.local_shape)
        here = self.field.flat[:, place]
        every = np.concatenate([here, 1.0 - here.sum(axis=0, keepdims=True)])
        excess = np.nan_to_num(np.maximum(-every, every - 1.0).max(axis=0), nan=math.inf)
        if len(excess) == 0:
            return -math.inf, 0
        at = int(excess.argmax())
        return float(excess[at]), int(place[at])

    def stable_step(self, interval: Interval | None = None) -> float:
        """Largest stable step on an interval, by default the present one, s (collective)."""
        return math.inf

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Equal steps (collective)."""
        if index != self.index:
            self.enter(index)
        stable = self.stable_step()
        count, dt = self._steps.equal(start, end, self.own_step, self.longest, stable)
        updates = count * self.updates * self.moved
        ledger = Ledger(steps=count, cell_updates=updates, step_share=dt / stable)
        done = 0
        while done < count:
            block = min(LOOK_EVERY, count - done)
            self.steps(start + done * dt, dt, block, ledger)
            done += block
            low, high = self.bounds()
            ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
            self.now = start + done * dt
            self._steps.judge(low, high, self.now, dt, stable, self.worst)
        return ledger

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank; sums to 1 (collective).

        Cells that hold nothing, or carry no value, take what is around them.
        """
        known = self.known()
        mine, where = self.split.owned_cells(known)
        place = np.ravel_multi_index(where, self.split.local_shape)
        values = self.split.gather(known, self.field.flat[:, place], mine)
        moved = spread_outwards(self.scene.flow.grid, known, values, interval.cells)
        return np.concatenate([moved, 1.0 - moved.sum(axis=0, keepdims=True)])


AnyBed = TypeVar("AnyBed", bound=ConservativeBed)


class BedTransport(Transport, Generic[AnyBed]):
    """A transport on a bed that is settled for each interval.

    bed -- of the interval that `field` is on
    """

    def __init__(self, scene: MixingScene, options: Any, concentration: FloatArray, index: int):
        """`options`: of the plugin, with a `courant` and a `time_step` (s, or None)."""
        choice = options.courant, options.time_step, self.overshoot, scene.force
        super().__init__(scene, concentration, Steps(scene.decomposition, *choice))
        self._settle(index)
        self.put(scene.flow.intervals[index].cells, concentration[:-1])
        self._begin()

    @abstractmethod
    def make_bed(self, interval: Interval) -> AnyBed:
        """The bed of an interval, its `stable_step` known but not settled yet."""

    @abstractmethod
    def entered(self) -> None:
        """Prepare for the settled `self.bed`, whose concentrations are in `self.field`."""

    @property
    def own_step(self) -> float:
        """The stable one."""
        return self.bed.stable_step

    def known(self) -> IntArray:
        """Those of the bed."""
        return self.bed.known_at(self.now)

    def bounds(self) -> tuple[float, float]:
        """Where the bed moves."""
        return self.bed.bounds(self.field.flat)

    def stable_step(self, interval: Interval | None = None) -> float:
        """The bed's, s (collective)."""
        if interval is None or interval.start == self.bed.interval.start:
            return self.bed.stable_step
        return self.make_bed(interval).stable_step

    def enter(self, index: int) -> None:
        """Settle on the bed of an interval and take the field over."""
        before = self.bed
        self._settle(index)
        self.carry_over(before)
        self._begin()

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

    def _settle(self, index: int) -> None:
        flow = self.scene.flow
        self.index, interval = index, flow.intervals[index]
        self.bed: AnyBed = self.make_bed(interval)
        self.updates, self.longest = self.bed.updates, math.inf
        if not (flow.steady and index == flow.prefix):  # that one lasts for ever
            ends = interval.start, interval.end
            _, self.longest = self._steps.equal(*ends, self.own_step, self.longest)
        self.bed.settle(min(self.longest, self.bed.stable_step))
        self.now = interval.start

    def _begin(self) -> None:
        """Take up the field on the bed that was just settled."""
        self.bed.share_within_groups(self.field.flat, self.now)
        self.field.exchange()
        self.entered()


class TransportBackend(Mixing):
    """A `Mixing` whose work a `Transport` does; `Options`, `halo` and `laws` are the plugin's."""

    _transport: Any = None

    @abstractmethod
    def transport(self, scene: MixingScene, concentration: FloatArray, index: int) -> Transport:
        """A transport on a scene, on interval `index`; where heavy modules are imported."""

    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells."""
        self._transport = self.transport(scene, concentration, index)
        self.overshoot = self._transport.overshoot
        self.conservative = self._transport.conservative

    @property
    def running(self) -> Any:
        """The transport that `start` made. Raises RuntimeError before it."""
        if self._transport is None:
            raise RuntimeError("start() comes first")
        return self._transport

    def stable_time_step(self, interval: Interval) -> float:
        """Largest step within the scheme's limit, s (collective)."""
        return float(self.running.stable_step(interval))

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index` in equal steps (collective)."""
        transport: Transport = self.running
        return transport.advance(index, start, end)

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective)."""
        transport: Transport = self.running
        return transport.concentration(interval)
