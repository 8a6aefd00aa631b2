"""Semi-Lagrangian transport: half the exchange, the carriage, the other half (Strang 1968).

Algorithm of a step from s to t, within an interval of the flow:

1. diffusion over (t - s)/2 with the fills at s (`exchange`);
2. content moved along paths from s to t (`carriage`);
3. diffusion over (t - s)/2 with the fills at t.

No step is unstable: 2. is a mean of values for any step, and 1. and 3. take as many steps of their
own as positivity asks for. Steps are limited for accuracy alone (`MovingCells.greatest_gradient`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from scaleup.api import (
    FloatArray,
    InputError,
    Interval,
    Ledger,
    MixingScene,
    spread_outwards,
)
from scaleup_semi_lagrangian.carriage import Carriage, strides_of
from scaleup_semi_lagrangian.exchange import Exchange, steps
from scaleup_semi_lagrangian.kept import Kept, budget_of_rank
from scaleup_semi_lagrangian.moving_cells import MovingCells, find_moving

if TYPE_CHECKING:
    from scaleup_semi_lagrangian import SemiLagrangian

_EMPTY = 1e-13  # fill fraction


class Transport:
    """State and steps on a rank. All components but the last are moved; it is what remains."""

    def __init__(
        self,
        scene: MixingScene,
        options: SemiLagrangian.Options,
        concentration: FloatArray,
        index: int,
    ):
        self._scene, self._split, self._options = scene, scene.decomposition, options
        self._grid = scene.flow.grid
        self._field = self._split.field(len(concentration) - 1)
        self._owned = np.zeros(self._field.flat.shape[1], dtype=bool)
        self._owned.reshape(self._split.local_shape)[self._split.owned] = True
        self._gain = np.zeros(len(self._owned))
        budget = 1e9 * options.memory if options.memory else budget_of_rank(self._split.comm)
        self._kept = Kept(budget, self._split.largest)
        self._pace: dict[int, tuple[float, int]] = {}  # longest step (s) and moving cells
        self._deformation = options.deformation or (2.0 if self._grid.dimension == 2 else 4.0)
        self._per_edge = options.subcells or (4 if self._grid.dimension == 2 else 2)
        self._enter(index)
        active = self._interval.cells
        local = self._split.placing(active).local(concentration[:-1])
        self._field.flat[...] = local
        self._now = self._interval.start

    def _enter(self, index: int) -> None:
        """Take up an interval: what moves in it, and who exchanges."""
        self._index = index
        self._interval = self._scene.flow.intervals[index]
        self._placing = self._split.placing(self._interval.cells)
        self._moving: MovingCells | None = None
        self._filled: tuple[float, FloatArray] | None = None
        self._exchange = self._kept.get(("exchange", index), self._find_exchange)
        if index not in self._pace:
            moving = self._find_moving()
            longest = self._deformation / max(moving.greatest_gradient(), 1e-300)
            self._pace[index] = longest, len(moving.cells)

    def _find_moving(self) -> MovingCells:
        """The interval's moving cells; looked for where a carriage is built only."""
        if self._moving is None:
            self._moving = find_moving(self._grid, self._interval)
        return self._moving

    def _find_exchange(self) -> Exchange:
        here = self._placing.place >= 0
        exchange = Exchange(
            self._scene.tensor(self._interval)[:, :, here], self._grid.spacing,
            self._placing.place[here], strides_of(self._split), self._owned,
        )  # fmt: skip
        if exchange.reach > self._split.halo:
            raise InputError(
                "mixing.name = 'semi-lagrangian': the diffusion tensor is too anisotropic "
                f"(its exchanges reach {exchange.reach} cells, at most {self._split.halo})"
            )
        return exchange

    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Equal steps (collective)."""
        if index != self._index:
            self._enter(index)
        longest, moving = self._pace[index]
        longest = self._options.time_step or longest
        count = max(1, math.ceil((end - start) / longest - 1e-6))
        dt = (end - start) / count
        ledger = Ledger(steps=count, cell_updates=count * moving * len(self._field.flat))
        for number in range(count):
            self._step(start + number * dt, start + (number + 1) * dt, ledger)
        self._now = end
        return ledger

    def _step(self, start: float, end: float, ledger: Ledger) -> None:
        self._diffuse(start, 0.5 * (end - start))
        if self._pace[self._index][1]:
            carriage = self._carriage(start, end)
            low, high = carriage.apply(self._field.flat)
            ledger.minimum, ledger.maximum = min(ledger.minimum, low), max(ledger.maximum, high)
        self._diffuse(end, 0.5 * (end - start))

    def _carriage(self, start: float, end: float) -> Carriage:
        """The carriage of a step: kept, or built."""
        interval, steady = self._interval, self._lasts
        share = (
            (0.0, 1.0) if steady
            else tuple((t - interval.start) / interval.duration for t in (start, end))
        )  # fmt: skip

        def build() -> Carriage:
            material = self._fraction(start) > _EMPTY
            return Carriage(
                self._grid, self._split, self._find_moving(), material, share, end - start,
                self._per_edge,
            )  # fmt: skip

        key = ("carriage", self._index, self._moment(start), round(end - start, 9))
        return self._kept.get(key, build)

    @property
    def _lasts(self) -> bool:
        """Whether the interval is a steady flow, of any length."""
        flow = self._scene.flow
        return flow.steady and self._index == flow.prefix

    def _moment(self, time: float) -> float:
        """By which what belongs to a time of the interval (s) is found again."""
        return 0.0 if self._lasts else round(time, 9)

    def _fraction(self, time: float) -> FloatArray:
        """Fill fraction in local arrays at a time of the interval, s; the last one is kept."""
        moment = self._moment(time)
        if self._filled is None or self._filled[0] != moment:
            fill = self._interval.fill_start if self._lasts else self._interval.fill(time)
            self._filled = moment, self._placing.local(fill / self._grid.cell_volume)
        return self._filled[1]

    def _diffuse(self, time: float, duration: float) -> None:
        """Exchange over a duration (s) with the fills at a time; collective."""
        fraction = self._fraction(time)
        fastest = self._exchange.fastest(self._moment(time), fraction, self._split.largest)
        if fastest == 0.0:
            return
        count = steps(duration, fastest)
        for _ in range(count):
            self._exchange.step(self._field.flat, self._gain, fraction, duration / count)
            self._field.exchange()

    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on an interval's cells, on every rank; sums to 1 (collective)."""
        now = self._interval
        fill = now.fill_start if self._lasts else now.fill(self._now)
        known = now.cells[fill > _EMPTY * self._grid.cell_volume]
        mine, where = self._split.owned_cells(known)
        place = np.ravel_multi_index(where, self._split.local_shape)
        values = self._split.gather(known, self._field.flat[:, place], mine)
        moved = spread_outwards(self._grid, known, values, interval.cells)
        return np.concatenate([moved, 1.0 - moved.sum(axis=0, keepdims=True)])
