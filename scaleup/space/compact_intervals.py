"""Intervals that store what moves, and rebuild the rest when asked for.

In the vessel's frame most of a bed is at rest and every cell of that part is as full as the vessel
lets it be, so that a few runs of cell numbers describe it. An interval then needs room for the
flowing layer alone: about 60 bytes per cell of the layer instead of 80 per cell of the bed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from scaleup.space.flow_field import Interval, IntervalSequence
from scaleup.space.grid import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class CompactInterval:
    """One interval: the cells that carry flux or change their fill, and runs of resting ones.

    start, end           -- s
    cells                -- flat grid indices, ascending, shape (m,), any integer type
    fill_start, fill_end -- m^3, shape (m,)
    flux                 -- m^3/s, shape (dimension, m), as in `Interval`
    shear_rate           -- 1/s, shape (m,); direction -- (dimension, m); single precision will do
    still                -- (runs, 2): first and one past the last flat index of runs of cells
                            that are as full as the vessel lets them be and carry no flux;
                            ascending, without any of `cells`
    """

    start: float
    end: float
    cells: NDArray[Any]
    fill_start: FloatArray
    fill_end: FloatArray
    flux: FloatArray
    shear_rate: NDArray[Any]
    direction: NDArray[Any]
    still: NDArray[Any]

    @staticmethod
    def of(interval: Interval) -> CompactInterval:
        """A full Interval, with no cell left out."""
        return CompactInterval(
            interval.start,
            interval.end,
            interval.cells,
            interval.fill_start,
            interval.fill_end,
            interval.flux,
            interval.shear_rate,
            interval.direction,
            np.empty((0, 2), dtype=np.int64),
        )

    def expand(self, capacity: FloatArray | None) -> Interval:
        """The Interval; `capacity` (m^3 per grid cell) is needed for resting cells."""
        direction = self.direction.astype(float)
        if self.direction.dtype != np.float64:  # unit vectors again, to double precision
            length = np.sqrt((direction**2).sum(axis=0))
            direction = np.divide(direction, length, where=length > 0.5, out=0.0 * direction)
        moving = self.cells.astype(np.int64)
        if len(self.still) == 0 or capacity is None:
            return Interval(
                self.start,
                self.end,
                moving,
                self.fill_start,
                self.fill_end,
                self.flux,
                self.shear_rate.astype(float),
                direction,
            )
        resting = cells_of_runs(self.still)
        total = len(moving) + len(resting)
        at = np.searchsorted(resting, moving) + np.arange(len(moving))
        rests = np.ones(total, dtype=bool)
        rests[at] = False
        cells = np.empty(total, dtype=np.int64)
        cells[at], cells[rests] = moving, resting
        held = capacity[resting]

        def spread(values: FloatArray, elsewhere: FloatArray | float) -> FloatArray:
            whole = np.empty((*values.shape[:-1], total))
            whole[..., at], whole[..., rests] = values, elsewhere
            return whole

        return Interval(
            self.start,
            self.end,
            cells,
            spread(self.fill_start, held),
            spread(self.fill_end, held),
            spread(self.flux, 0.0),
            spread(self.shear_rate.astype(float), 0.0),
            spread(direction, 0.0),
        )


class CompactIntervals(IntervalSequence):
    """A sequence of Intervals over CompactIntervals, in memory or read one by one from a file.

    parts    -- the compact intervals that this rank holds: all of them, unless a parallel flow
                model has shared them out
    times    -- boundaries of all, s, shape (K + 1,)
    capacity -- m^3 of vessel in every grid cell, flat; None if no part has resting cells
    first    -- number of the first one held
    The Interval that was asked for last is kept.
    """

    def __init__(
        self,
        parts: Sequence[CompactInterval],
        times: FloatArray,
        capacity: FloatArray | None,
        first: int = 0,
    ):
        self.parts, self.capacity, self.first = parts, capacity, first
        self._times = times
        self._last: tuple[int, Interval] | None = None

    @property
    def times(self) -> FloatArray:
        """Boundaries, s, shape (K + 1,)."""
        return self._times

    def __len__(self) -> int:
        return len(self._times) - 1

    @overload
    def __getitem__(self, index: int) -> Interval: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Interval]: ...
    def __getitem__(self, index: int | slice) -> Interval | Sequence[Interval]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        number = index % len(self)
        if not 0 <= number - self.first < len(self.parts):
            raise IndexError(f"interval {number} is held by another rank")
        if self._last is None or self._last[0] != number:
            self._last = number, self.parts[number - self.first].expand(self.capacity)
        return self._last[1]

    def mark_active(self, active: BoolArray) -> None:
        """Set the flag of every cell that is active in any interval held here."""
        for part in self.parts:
            active[part.cells] = True
            active[cells_of_runs(part.still)] = True


def cells_of_runs(runs: NDArray[Any]) -> IntArray:
    """All indices of runs (n, 2) of first and one past the last, in order."""
    first, stop = runs[:, 0].astype(np.int64), runs[:, 1].astype(np.int64)
    lengths = stop - first
    ends = np.cumsum(lengths)
    offsets = np.repeat(first - (ends - lengths), lengths)
    cells: IntArray = offsets + np.arange(len(offsets))
    return cells


class MirroredParts(Sequence[CompactInterval]):
    """Compact intervals of a flow that is its own mirror image in z; only one half is kept.

    halves -- those of the half at greater z, on the upper half of the grid's layers
    counts -- of the whole grid: an even number of layers in z
    """

    def __init__(self, halves: Sequence[CompactInterval], counts: Sequence[int]):
        self.halves, self.counts = halves, tuple(counts)

    def __len__(self) -> int:
        return len(self.halves)

    @overload
    def __getitem__(self, index: int) -> CompactInterval: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[CompactInterval]: ...
    def __getitem__(self, index: int | slice) -> CompactInterval | Sequence[CompactInterval]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        half = self.halves[index]
        layer, middle = self.counts[0] * self.counts[1], self.counts[2] // 2
        upper = half.cells.astype(np.int64)
        # the image of layer k is layer -1 - k, counted from the middle: the last one comes first
        starts = np.searchsorted(upper, layer * np.arange(middle + 1))
        order = np.concatenate(
            [np.arange(starts[k], starts[k + 1]) for k in range(middle - 1, -1, -1)]
        )
        image = upper[order]
        cells = np.concatenate([image + layer * (-1 - 2 * (image // layer)), upper])
        cells += layer * middle

        def both(values: NDArray[Any]) -> NDArray[Any]:
            return np.concatenate([values[..., order], values], axis=-1)

        flux, direction = both(half.flux), both(half.direction)
        n = len(upper)
        direction[2, :n] *= -1
        # the image's lower face is that of the upper face, which is the next layer's lower one
        above = np.searchsorted(upper, upper + layer)
        found = above < n
        found[found] = upper[above[found]] == upper[found] + layer
        through = np.zeros(n)
        through[found] = -half.flux[2, above[found]]
        flux[2, :n] = through[order]
        return CompactInterval(
            half.start,
            half.end,
            cells.astype(half.cells.dtype),
            both(half.fill_start),
            both(half.fill_end),
            flux,
            both(half.shear_rate),
            direction,
            _mirrored_runs(half.still, layer, middle),
        )


def _mirrored_runs(half: NDArray[Any], layer: int, middle: int) -> NDArray[Any]:
    """Runs of both halves, from those of the upper half; none reaches over a layer's end."""
    runs = half.astype(np.int64)
    shift = (layer * (-1 - 2 * (runs[:, 0] // layer)))[:, None]
    image = runs + shift
    image = image[np.argsort(image[:, 0], kind="stable")]
    whole: NDArray[Any] = np.concatenate([image, runs]) + layer * middle
    return whole.astype(half.dtype)
