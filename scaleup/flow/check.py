"""The invariants of a FlowField, checked on what each rank holds of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain, pairwise
from typing import Any

import numpy as np

from scaleup.flow.bed_lean import LeanOfBed
from scaleup.space.compact_intervals import CompactInterval, CompactIntervals, cells_of_runs
from scaleup.space.cut_cells import cut_fraction
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray, IntArray
from scaleup.system.errors import ContractError
from scaleup.system.parallel import on_each

_ROUND_OFF = 1e-12

_End = tuple[float, FloatArray]
"""When an interval ends, s, and what every cell of the grid then holds, m^3."""


def check_flow(flow: FlowField, geometry: Any = None, fill_volume: float | None = None) -> None:
    """Check the invariants of a FlowField, all of whose intervals are held here.

    1 intervals are contiguous and cells ascending; 2 fill_end = fill_start - dt div(flux) to
    round-off; 3 fills are continuous between intervals and over the period; 4 0 <= fill <= vessel
    volume of the cell (of the whole cell without `geometry`); 5 the
    total is `fill_volume`; 6 no flux touches an inactive cell or the edge of the grid; 7
    directions are unit vectors or zero, shear rates >= 0, all numbers finite.

    Resting cells of compact intervals are as full as the vessel lets them be: they need no look.
    """
    checker = _FlowChecker(flow, geometry, fill_volume)
    end = checker.check_all()
    checker.check_wrap(end)


def check_shared_flow(
    flow: FlowField | None, geometry: Any, fill_volume: float, comm: Any
) -> tuple[float, float]:
    """`check_flow` of a flow whose intervals are shared out among ranks (collective).

    Each rank looks at its own, and at how they join those of the rank before. Returns, on every
    rank, the least and the greatest lean of the bed at the ends of all intervals, rad (without a
    geometry 0).
    """

    def check_own() -> tuple[_FlowChecker | None, _End | None]:
        if flow is None:
            return None, None
        if not isinstance(flow, FlowField):
            raise ContractError(f"solve returned {type(flow).__name__}, and must a FlowField")
        own = _FlowChecker(flow, geometry, fill_volume)
        return own, own.check_all()

    checker, end = on_each(comm, check_own)
    held = comm.allgather((0, 0, 0) if checker is None else checker.held)
    if not any(total for *_, total in held):
        raise ContractError("solve returned no FlowField on any rank, or one without intervals")
    stop = 0
    for first, count, _ in held:
        if count and first != stop:
            raise ContractError(f"interval {stop} is held by no rank, or not in the ranks' order")
        stop += count
    if stop != max(total for *_, total in held):
        raise ContractError(f"interval {stop} is held by no rank")
    holders = [rank for rank, holds in enumerate(comm.allgather(end is not None)) if holds]
    wraps = comm.allgather(checker is not None and checker.begins_period)
    before = None
    for rank, following in pairwise(holders):
        if comm.rank == rank:
            comm.send(end, following)
        elif comm.rank == following:
            before = comm.recv(source=rank)

    def check_join() -> None:
        if checker is not None and before is not None:
            checker.check_first(before)

    on_each(comm, check_join)
    leans = list(chain.from_iterable(comm.allgather([] if checker is None else checker.leans)))
    extremes = min(leans, default=0.0), max(leans, default=0.0)
    if not any(wraps):
        return extremes
    last, holder = holders[-1], wraps.index(True)
    if last != holder:
        if comm.rank == last:
            comm.send(end, holder)
        elif comm.rank == holder:
            end = comm.recv(source=last)

    def check_wrap() -> None:
        if checker is not None:
            checker.check_wrap(end)

    on_each(comm, check_wrap)
    return extremes


class _Compacted(Sequence[CompactInterval]):
    def __init__(self, intervals: Sequence[Interval]):
        self._intervals = intervals

    def __len__(self) -> int:
        return len(self._intervals)

    def __getitem__(self, index: Any) -> Any:
        return CompactInterval.of(self._intervals[index])


class _FlowChecker:
    """Checks the intervals of a flow that are held here, one after the other."""

    def __init__(self, flow: FlowField, geometry: Any, fill_volume: float | None):
        grid = flow.grid
        capacity = np.full(grid.cells, grid.cell_volume)
        if geometry is not None:
            wall = geometry.signed_distance(grid.corner_points())
            capacity = (cut_fraction(wall) * grid.cell_volume).ravel()
        self._first, self._prefix, self._total = 0, flow.prefix, len(flow.intervals)
        if isinstance(flow.intervals, CompactIntervals):
            self._parts: Sequence[CompactInterval] = flow.intervals.parts
            self._first = flow.intervals.first
            held = flow.intervals.capacity
            if held is not None and np.abs(held - capacity).max() > _ROUND_OFF * grid.cell_volume:
                raise ContractError("capacity must be the vessel's volume in each cell")
        else:
            self._parts = _Compacted(flow.intervals)
        self._grid, self._capacity, self._fill_volume = grid, capacity, fill_volume
        self._lean: LeanOfBed | None = None
        if geometry is not None and fill_volume is not None:
            self._lean = LeanOfBed(grid, capacity, flow.axis, fill_volume)
        self._speed = flow.angular_velocity if flow.frame == "vessel" else 0.0
        self.leans: list[float] = []
        self._slack = _ROUND_OFF * grid.cell_volume
        self._index = np.full(grid.cells, -1, dtype=np.int64)
        self._marked = np.zeros(grid.cells, dtype=bool)
        self._end: _End | None = None
        self._active: IntArray = np.zeros(0, dtype=np.int64)

    @property
    def held(self) -> tuple[int, int, int]:
        """First interval held here, how many are, and how many there are."""
        return self._first, len(self._parts), self._total

    @property
    def begins_period(self) -> bool:
        """Whether the first interval of the repeating part is held here."""
        return 0 <= self._prefix - self._first < len(self._parts)

    def check_all(self) -> _End | None:
        """Check every interval held, and how they join; returns how the last one ends."""
        for number in range(len(self._parts)):
            self._check(self._parts[number], f"interval {self._first + number}")
        return self._end

    def check_first(self, before: _End) -> None:
        """The first interval held here begins when and as the one before it ended."""
        self._check_begins(self._parts[0], before, f"interval {self._first}")

    def check_wrap(self, end: _End | None) -> None:
        """The repeating part begins as it ends."""
        if end is not None and self.begins_period:
            part = self._parts[self._prefix - self._first]
            self._check_begins(part, (part.start, end[1]), "the periodic part")

    def _check(self, part: CompactInterval, where: str) -> None:
        grid, duration = self._grid, part.end - part.start
        resting = cells_of_runs(part.still)
        if len(part.cells) + len(resting) == 0 or np.any(np.diff(part.cells) <= 0):
            raise ContractError(f"{where}: cells must be ascending and not empty")
        if duration <= 0:
            raise ContractError(f"{where}: must last longer than 0 s")
        for name in ("fill_start", "fill_end", "flux", "shear_rate", "direction"):
            if not np.all(np.isfinite(getattr(part, name))):
                raise ContractError(f"{where}: {name} has values that are not finite")
        scale = max(grid.cell_volume, duration * float(np.abs(part.flux).max(initial=0.0)))
        gap = part.fill_end - part.fill_start + duration * self._outflow(part, where)
        # a steady part holds for ever, so its divergence is judged against the fluxes alone
        if float(np.abs(gap).max(initial=0.0)) > _ROUND_OFF * scale:
            raise ContractError(
                f"{where}: fill and flux disagree by {np.abs(gap).max() / grid.cell_volume:.2g} of "
                "a cell; fill_end must be fill_start - dt div(flux)"
            )
        rest = float(self._capacity[resting].sum())
        for fill in (part.fill_start, part.fill_end):
            low = float(fill.min(initial=0.0))
            over = float((fill - self._capacity[part.cells]).max(initial=0.0))
            if low < -self._slack or over > self._slack:
                raise ContractError(
                    f"{where}: fill must lie in [0, vessel volume of the cell]; it is below by "
                    f"{max(0.0, -low) / grid.cell_volume:.2g} or above by "
                    f"{max(0.0, over) / grid.cell_volume:.2g} of a cell"
                )
            if self._fill_volume is not None:
                drift = (float(fill.sum()) + rest) / self._fill_volume - 1.0
                if abs(drift) > _ROUND_OFF:
                    raise ContractError(f"{where}: the fill is off by {drift:.2g} of the bed")
        if np.any(part.shear_rate < 0):
            raise ContractError(f"{where}: shear_rate must not be negative")
        length = np.linalg.norm(part.direction, axis=0)
        exact = 1e-9 if part.direction.dtype == np.float64 else 1e-5
        if np.any((np.abs(length - 1.0) > exact) & (length > exact)):
            raise ContractError(f"{where}: direction must be unit vectors or zero")
        if self._lean is not None:
            phase, held = self._speed * part.end, self._capacity[resting]
            self.leans.append(self._lean.of(part.cells, part.fill_end, resting, held, phase))
        active = np.concatenate([part.cells, resting])
        if self._end is None:
            self._end = part.end, np.zeros(grid.cells)
        else:
            self._check_joined(part, resting, self._end, self._active, where)
        fill = self._end[1]
        fill[self._active] = 0.0
        fill[resting] = self._capacity[resting]
        fill[part.cells] = part.fill_end
        self._end, self._active = (part.end, fill), active

    def _outflow(self, part: CompactInterval, where: str) -> FloatArray:
        """div(flux) of each cell, m^3/s; every face with flux must lie between two of them."""
        grid, cells = self._grid, part.cells.astype(np.int64)
        self._index[cells] = np.arange(len(cells))
        total = np.zeros(len(cells))
        leak = 0.0
        for axis in range(grid.dimension):
            flux, stride = part.flux[axis], math.prod(grid.counts[:axis])
            place = cells // stride % grid.counts[axis]
            lower = np.where(place > 0, self._index[cells - stride], -1)
            leak = max(leak, float(np.abs(flux[lower < 0]).max(initial=0.0)))
            total -= flux
            total += np.bincount(lower[lower >= 0], flux[lower >= 0], len(cells))
        self._index[cells] = -1
        if leak > 0:
            raise ContractError(f"{where}: a flux of {leak:.2g} m^3/s leaves the bed")
        return total

    def _check_joined(
        self, part: CompactInterval, resting: IntArray, before: _End, held: IntArray, where: str
    ) -> None:
        """The fill before an interval, in cells `held` and no others, is what it begins with."""
        end, fill = before
        if end != part.start:
            raise ContractError(f"{where}: starts at {part.start:g} s, not at {end:g} s")
        self._marked[resting] = self._marked[part.cells] = True
        gone = held[~self._marked[held]]
        self._marked[resting] = self._marked[part.cells] = False
        differences = (
            fill[part.cells] - part.fill_start,
            fill[resting] - self._capacity[resting],
            fill[gone],
        )
        jump = max(float(np.abs(d).max(initial=0.0)) for d in differences) / self._grid.cell_volume
        if jump > 1e-9:
            raise ContractError(f"{where}: the fill jumps by {jump:.2g} of a cell where it joins")

    def _check_begins(self, part: CompactInterval, before: _End, where: str) -> None:
        held = np.flatnonzero(before[1])
        self._check_joined(part, cells_of_runs(part.still), before, held, where)
