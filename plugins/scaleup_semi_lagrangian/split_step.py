"""Semi-Lagrangian transport: half the exchange, the carriage, the other half (Strang 1968).

Algorithm of a step from s to t, within an interval of the flow:

1. diffusion over (t - s)/2 with the fills at s (`exchange`);
2. content moved along paths from s to t (`carriage`);
3. diffusion over (t - s)/2 with the fills at t.

No step is unstable: 2. stays in [0, 1] for any step, and 1. and 3. take as many steps of their
own as positivity asks for. Steps are limited for accuracy alone (`MovingCells.greatest_gradient`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from scaleup import numerics
from scaleup.contract import FloatArray, InputError, IntArray, Interval, Ledger, MixingScene
from scaleup_semi_lagrangian.carriage import Carriage, strides_of
from scaleup_semi_lagrangian.exchange import Exchange, steps
from scaleup_semi_lagrangian.fills import NO_CHANGES, Changes, fill_at, find_changes
from scaleup_semi_lagrangian.kept import Kept, Sized, budget_of_rank
from scaleup_semi_lagrangian.moving_cells import MovingCells, find_moving

if TYPE_CHECKING:
    from scaleup_semi_lagrangian import SemiLagrangian

_EMPTY = 1e-13  # fill fraction

T = TypeVar("T", bound=Sized)


class Transport(numerics.Transport):
    """The algorithm above on a rank."""

    def __init__(
        self,
        scene: MixingScene,
        options: SemiLagrangian.Options,
        concentration: FloatArray,
        index: int,
    ):
        self._grid = scene.flow.grid
        deformation = options.deformation or (2.0 if self._grid.dimension == 2 else 5.0)
        policy = numerics.Steps(
            scene.decomposition, deformation, options.time_step, self.overshoot, scene.force,
            option="deformation",
        )  # fmt: skip
        super().__init__(scene, concentration, policy)
        self._owned = np.zeros(self.field.flat.shape[1], dtype=bool)
        self._owned.reshape(self.split.local_shape)[self.split.owned] = True
        self._gain = np.zeros(len(self._owned))
        budget = 1e9 * options.memory if options.memory else budget_of_rank(self.split.comm)
        self._kept = Kept(budget, self.split.largest)
        self._pace: dict[int, tuple[float, int]] = {}  # of a deformation by 1 (s); moving cells
        self._per_edge = options.subcells or (4 if self._grid.dimension == 2 else 2)
        self._times = scene.flow.times.tolist()
        self._placed: tuple[int, Any] | None = None
        self._share = 0.0  # of the interval that has passed...
        self._fraction = np.zeros(len(self._owned))  # ...with which local cells are filled so much
        self.enter(index)
        self.field.flat[...] = self._placing.local(concentration[:-1])

    def enter(self, index: int) -> None:
        """Take up an interval: what changes and moves in it, and who exchanges."""
        before, self.index = self.index, index
        self._start, self._end = self._times[index], self._times[index + 1]
        self._moving: MovingCells | None = None
        self._changes = self._keep(("changes", index), self._find_changes)
        if before < 0 or self._share != 1.0 or index != self._next(before):
            # what does not change in this interval is not known either
            start = self._interval.fill_start / self._grid.cell_volume
            self._fraction[...] = self._placing.local(start)
        self._fill_at(self._start)
        self._exchange = self._keep(("exchange", index), self._find_exchange)
        if index not in self._pace:
            moving = self._find_moving()
            self._pace[index] = 1.0 / max(moving.greatest_gradient(), 1e-300), len(moving.cells)
        self.updates = self._pace[index][1]

    def _keep(self, key: Hashable, build: Callable[[], T]) -> T:
        """The one of this key: kept if the flow comes back to it, or built (collective)."""
        if self.index < self.scene.flow.prefix:
            return build()
        return self._kept.get(key, build)

    def _next(self, index: int) -> int:
        """The interval after this one."""
        return index + 1 if index + 2 < len(self._times) else self.scene.flow.prefix

    @property
    def _interval(self) -> Interval:
        """The present one. Asked for only where something is built from it: that takes time."""
        return self.scene.flow.intervals[self.index]

    @property
    def _placing(self) -> Any:
        """Of its cells; the last one is kept."""
        if self._placed is None or self._placed[0] != self.index:
            self._placed = self.index, self.split.placing(self._interval.cells)
        return self._placed[1]

    def _find_changes(self) -> Changes:
        interval = self._interval
        if self._lasts:
            return NO_CHANGES
        fills = np.stack([interval.fill_start, interval.fill_end]) / self._grid.cell_volume
        return find_changes(*self._placing.local(fills))

    def _find_moving(self) -> MovingCells:
        """The interval's moving cells; looked for where a carriage is built only."""
        if self._moving is None:
            self._moving = find_moving(self._grid, self._interval)
        return self._moving

    def _find_exchange(self) -> Exchange:
        place = self._placing.place
        tensor = self.scene.tensor(self._interval)
        diffuses = (place >= 0) & (np.einsum("aai->i", tensor) > 0.0)
        exchange = Exchange(
            tensor[:, :, diffuses], self._grid.spacing, place[diffuses],
            strides_of(self.split), self._owned,
        )  # fmt: skip
        if exchange.reach > self.split.halo:
            raise InputError(
                "mixing.name = 'semi-lagrangian': the diffusion tensor is too anisotropic "
                f"(its exchanges reach {exchange.reach} cells, at most {self.split.halo})"
            )
        return exchange

    @property
    def own_step(self) -> float:
        """In which the fastest cell is deformed by 1."""
        return self._pace[self.index][0]

    def steps(self, start: float, dt: float, count: int, ledger: Ledger) -> None:
        """Steps of the algorithm above."""
        self._found = math.inf, -math.inf
        for number in range(count):
            self._step(start + number * dt, start + (number + 1) * dt)

    def bounds(self) -> tuple[float, float]:
        """After every step since the last look."""
        return self._found

    def _step(self, start: float, end: float) -> None:
        self._diffuse(start, 0.5 * (end - start))
        if self.updates:
            low, high = self._carriage(start, end).apply(self.field.flat)
            self._found = min(self._found[0], low), max(self._found[1], high)
        self._diffuse(end, 0.5 * (end - start))

    def _carriage(self, start: float, end: float) -> Carriage:
        """The carriage of a step: kept, or built."""
        share = (0.0, 1.0) if self._lasts else (self._share_at(start), self._share_at(end))

        def build() -> Carriage:
            return Carriage(
                self._grid, self.split, self._find_moving(), self._fraction > _EMPTY, share,
                end - start, self._per_edge,
            )  # fmt: skip

        key = ("carriage", self.index, *(round(s, 9) for s in share), round(end - start, 9))
        return self._keep(key, build)

    @property
    def _lasts(self) -> bool:
        """Whether the interval is a steady flow, of any length."""
        flow = self.scene.flow
        return flow.steady and self.index == flow.prefix

    def _share_at(self, time: float) -> float:
        """Share of the interval that has passed at a time, s; its ends are met exactly."""
        if self._lasts:
            return 0.0
        share = (time - self._start) / (self._end - self._start)
        return round(share) if abs(share - round(share)) < 1e-9 else share

    def _fill_at(self, time: float) -> None:
        """Fill the local cells as at a time of the interval, s."""
        self._share = self._share_at(time)
        fill_at(self._fraction, self._changes, self._share)

    def _diffuse(self, time: float, duration: float) -> None:
        """Exchange over a duration (s) with the fills at a time; collective."""
        self._fill_at(time)
        share = round(self._share, 9)
        fastest = self._exchange.fastest(share, self._fraction, self.split.largest)
        if fastest == 0.0:
            return
        count = steps(duration, fastest)
        for _ in range(count):
            self._exchange.step(self.field.flat, self._gain, self._fraction, duration / count)
            self.field.exchange()

    def known(self) -> IntArray:
        """Cells that hold material."""
        now = self._interval
        fill = (1.0 - self._share) * now.fill_start + self._share * now.fill_end
        return now.cells[fill > _EMPTY * self._grid.cell_volume]
