"""FlowField: the contract between a flow model and a mixing model.

Material is accounted for by volume: `fill` is the bulk volume in each cell and `flux` the volume
that crosses each face per second, so that on every interval

    fill_end = fill_start - (end - start) * div(flux)            (to round-off)
    0 <= fill <= vessel volume of the cell,   no flux through vessel walls or the free surface.

Schemes that use fills and fluxes are conservative and bounded by construction; nodal schemes take
`Interval.velocity`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, overload

import numpy as np

from scaleup.space.grid import FULL, BoolArray, FloatArray, Grid, IntArray
from scaleup.space.spread import spread_outwards

Frame = Literal["lab", "vessel"]


@dataclass(frozen=True)
class Axis:
    """The axis of rotation: a point on it (m) and its unit direction, both (x, y, z)."""

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Interval:
    """The flow between two times, on the active cells alone (n of them).

    start, end   -- s, within the flow's own clock
    cells        -- flat indices into the grid, ascending, shape (n,): every cell that holds
                    material at the start or the end, or passes any in between
    fill_start, fill_end -- m^3, shape (n,)
    flux         -- m^3/s through each active cell's LOWER face normal to each axis, positive
                    towards +axis, shape (dimension, n). A face with flux lies between two active
                    cells, so the lower faces of the active cells hold every flux there is.
    shear_rate   -- sqrt(2 D:D) of the symmetric velocity gradient, 1/s, shape (n,)
    direction    -- unit vector of v - Omega x r (flow relative to rigid rotation), zero where
                    that vanishes, shape (dimension, n)
    """

    start: float
    end: float
    cells: IntArray
    fill_start: FloatArray
    fill_end: FloatArray
    flux: FloatArray
    shear_rate: FloatArray
    direction: FloatArray

    @property
    def duration(self) -> float:
        """S."""
        return self.end - self.start

    def fill(self, time: float) -> FloatArray:
        """Fill at a time of the interval, m^3, shape (n,): linear, since fluxes are constant."""
        share = (time - self.start) / self.duration
        return (1.0 - share) * self.fill_start + share * self.fill_end

    def face_fluxes(self, grid: Grid) -> list[FloatArray]:
        """All face fluxes as dense arrays, one per axis, longer by one along that axis, m^3/s."""
        dense = []
        for axis in range(grid.dimension):
            shape = list(grid.shape)
            shape[grid.array_axis(axis)] += 1
            faces = np.zeros(shape)
            faces[np.unravel_index(self.cells, grid.shape)] = self.flux[axis]
            if grid.periodic:
                along = np.moveaxis(faces, grid.array_axis(axis), 0)
                along[-1] = along[0]
            dense.append(faces)
        return dense

    def outflow(self, grid: Grid) -> FloatArray:
        """Net volume leaving each active cell per second, div(flux), m^3/s, shape (n,)."""
        total = np.zeros(grid.shape)
        for axis, faces in enumerate(self.face_fluxes(grid)):
            total += np.diff(faces, axis=grid.array_axis(axis))
        return total.reshape(-1)[self.cells]

    def velocity(self, grid: Grid) -> FloatArray:
        """Velocity of the material in each active cell, m/s, shape (dimension, n).

        In full cells the mean of the two face fluxes over the face area, second order. The fill of
        a cut cell does not tell how much of its faces is wet, so that flux over area times fill can
        be off by any factor: cut cells take the mean of the cells around them that have a velocity,
        layer by layer from the full cells outwards (first order); zero where there is no full cell.
        """
        mean_fill = 0.5 * (self.fill_start + self.fill_end)
        full = self.cells[mean_fill >= FULL * grid.cell_volume]
        known = []
        for axis, faces in enumerate(self.face_fluxes(grid)):
            along = grid.array_axis(axis)
            count = grid.shape[along]
            both = np.take(faces, range(count), along) + np.take(faces, range(1, count + 1), along)
            known.append(0.5 * both.reshape(-1)[full] / grid.face_area(axis))
        return spread_outwards(grid, full, np.stack(known), self.cells)


class IntervalSequence(Sequence[Interval]):
    """Intervals that know their times and active cells without being built one by one."""

    @property
    @abstractmethod
    def times(self) -> FloatArray:
        """Boundaries, s, shape (K + 1,)."""

    @abstractmethod
    def mark_active(self, active: BoolArray) -> None:
        """Set the flag (one per grid cell) of every cell that is active in any interval."""


class _Coarsened(IntervalSequence):
    """Intervals summed onto a coarser grid when asked for; the last one is kept."""

    def __init__(self, flow: FlowField, factor: int):
        self._flow, self._factor = flow, factor
        self._last: tuple[int, Interval] | None = None

    @property
    def times(self) -> FloatArray:
        return self._flow.times

    def __len__(self) -> int:
        return len(self._flow.intervals)

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
        if self._last is None or self._last[0] != number:
            part = self._flow.intervals[number]
            self._last = number, _coarsened(part, self._flow.grid, self._factor)
        return self._last[1]

    def mark_active(self, active: BoolArray) -> None:
        grid = self._flow.grid
        coarse = grid.coarsened(self._factor)
        position = np.unravel_index(self._flow.ever_active(), grid.shape)
        target = np.ravel_multi_index(tuple(p // self._factor for p in position), coarse.shape)
        active[target] = True


@dataclass(frozen=True)
class FlowField:
    """A flow through time: a start-up prefix, then a part that repeats (or is steady).

    grid             -- where it lives
    frame            -- "lab" (the bed stands still in space) or "vessel" (grid fixed to the wall)
    axis             -- of rotation
    angular_velocity -- rad/s, positive counter-clockwise
    lift             -- rad, how far the settled level bed has been turned rigidly before the
                        first interval begins (a steady lab-frame bed is reached that way)
    intervals        -- K intervals, contiguous in time; any sequence, so that they can be read
                        one by one from a file (`CompactIntervals`)
    prefix           -- how many of them are start-up; the others repeat for ever (none: the flow
                        ends with its prefix)
    summary          -- figures that the flow model states of itself (surface angle, ...)
    warnings         -- sentences on where the model may not hold
    """

    grid: Grid
    frame: Frame
    axis: Axis
    angular_velocity: float
    intervals: Sequence[Interval]
    lift: float = 0.0
    prefix: int = 0
    summary: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @cached_property
    def times(self) -> FloatArray:
        """Interval boundaries, s, shape (K + 1,)."""
        if isinstance(self.intervals, IntervalSequence):
            return self.intervals.times
        first = [interval.start for interval in self.intervals]
        return np.array([*first, self.intervals[len(self.intervals) - 1].end])

    def ever_active(self) -> IntArray:
        """Flat indices, ascending, of all cells that are active in any interval."""
        active = np.zeros(self.grid.cells, dtype=bool)
        if isinstance(self.intervals, IntervalSequence):
            self.intervals.mark_active(active)
        else:
            for interval in self.intervals:
                active[interval.cells] = True
        return np.flatnonzero(active)

    @property
    def period(self) -> float:
        """Length of the repeating part, s (0 if there is none)."""
        return float(self.times[-1] - self.times[self.prefix])

    @property
    def steady(self) -> bool:
        """True if the repeating part is one interval, which then lasts for any time."""
        return len(self.intervals) - self.prefix == 1

    def schedule(self, start: float, end: float) -> Iterator[tuple[int, float, float]]:
        """Which interval holds from when to when between two times of the flow's clock.

        Yields (interval number, local start, local end) in order, s; local times lie within the
        interval, except in a steady part, where the local end may be later. Raises ValueError if
        the flow ends before `end`.
        """
        times, prefix = self.times, self.prefix
        tolerance = 1e-12 * max(abs(end), 1.0)
        now = start
        while end - now > tolerance:
            if now < times[prefix] - tolerance:
                index = int(np.searchsorted(times, now + tolerance, side="right")) - 1
                base = 0.0
            elif prefix == len(self.intervals):
                raise ValueError(f"the flow ends at {times[-1]:g} s and has no repeating part")
            elif self.steady:
                yield prefix, now, end
                return
            else:
                turns = math.floor((now - times[prefix] + tolerance) / self.period)
                base = turns * self.period
                index = int(np.searchsorted(times, now - base + tolerance, side="right")) - 1
            local = max(now - base, float(times[index]))
            stop = min(end - base, float(times[index + 1]))
            yield index, local, stop
            now = base + stop

    def down(self, time: float) -> FloatArray:
        """Unit vector along gravity in this frame at a time of the flow's clock, s, (dimension,).

        Along -y in the lab; in the vessel it turns against the rotation.
        """
        phase = self.lift + self.angular_velocity * time if self.frame == "vessel" else 0.0
        return np.array([-math.sin(phase), -math.cos(phase), 0.0])[: self.grid.dimension]

    def level_coordinates(self, points: FloatArray) -> FloatArray:
        """Where points of the first instant were in the settled level bed, m, shape (n, dim).

        Turns lab coordinates back by `lift`; vessel coordinates are already those at rest.
        """
        if self.frame == "vessel" or self.lift == 0.0:
            return points
        cosine, sine = math.cos(self.lift), math.sin(self.lift)
        back = points.copy()
        x = points[..., 0] - self.axis.point[0]
        y = points[..., 1] - self.axis.point[1]
        back[..., 0] = self.axis.point[0] + cosine * x + sine * y
        back[..., 1] = self.axis.point[1] - sine * x + cosine * y
        return back

    def coarsened(self, factor: int) -> FlowField:
        """The same flow on cells `factor` times larger: fills and fluxes are summed exactly."""
        return FlowField(
            grid=self.grid.coarsened(factor),
            frame=self.frame,
            axis=self.axis,
            angular_velocity=self.angular_velocity,
            intervals=_Coarsened(self, factor),
            lift=self.lift,
            prefix=self.prefix,
            summary=self.summary,
            warnings=self.warnings,
        )


def interval_from_dense(
    start: float,
    end: float,
    grid: Grid,
    fill_start: FloatArray,
    fill_end: FloatArray,
    faces: Sequence[FloatArray],
    shear_rate: FloatArray,
    direction: FloatArray,
) -> Interval:
    """An Interval from arrays over the whole grid; keeps the active cells.

    fill_*, shear_rate -- `grid.shape`; direction -- (dimension, *grid.shape)
    faces -- one array per axis, longer by one along it, as `Interval.face_fluxes` returns
    Raises ValueError if a flux crosses the edge of the grid (which a periodic one has not).

    Two full cells side by side between empty ones; the left one passes half of what it holds to the
    right one, which had room:

    >>> grid = Grid(lower=(0.0, 0.0), spacing=(0.01, 0.01), counts=(4, 3), depth=0.01)
    >>> before, after = np.zeros(grid.shape), np.zeros(grid.shape)
    >>> before[1, 1:3] = 1e-6, 0.5e-6  # m^3
    >>> after[1, 1:3] = 0.5e-6, 1e-6
    >>> across, upward = np.zeros((3, 5)), np.zeros((4, 4))
    >>> across[1, 2] = 0.5e-6 / 0.1  # m^3/s, between the two
    >>> rate, direction = np.zeros(grid.shape), np.zeros((2, *grid.shape))
    >>> part = interval_from_dense(0.0, 0.1, grid, before, after, [across, upward], rate, direction)
    >>> part.cells.tolist()
    [5, 6]
    >>> bool(np.allclose(part.fill_start - part.duration * part.outflow(grid), part.fill_end))
    True
    """
    active = (fill_start > 0) | (fill_end > 0)
    for axis, values in enumerate(faces):
        along = grid.array_axis(axis)
        edge = max(
            np.abs(np.take(values, 0, along)).max(), np.abs(np.take(values, -1, along)).max()
        )
        if edge > 0 and not grid.periodic:
            raise ValueError(f"a flux of {edge:.3g} m^3/s crosses the edge of the grid")
        moving = values != 0
        active |= np.take(moving, range(grid.shape[along]), along)
        active |= np.take(moving, range(1, grid.shape[along] + 1), along)
    cells = np.flatnonzero(active)
    position = np.unravel_index(cells, grid.shape)
    return Interval(
        start=start,
        end=end,
        cells=cells,
        fill_start=fill_start[position],
        fill_end=fill_end[position],
        flux=np.stack([values[position] for values in faces]),
        shear_rate=shear_rate[position],
        direction=np.stack([component[position] for component in direction]),
    )


def _coarsened(part: Interval, grid: Grid, factor: int) -> Interval:
    coarse = grid.coarsened(factor)
    fine_position = np.unravel_index(part.cells, grid.shape)
    target = np.ravel_multi_index(tuple(p // factor for p in fine_position), coarse.shape)

    def summed(values: FloatArray, where: slice | BoolArray = slice(None)) -> FloatArray:
        total = np.bincount(target[where], weights=values[where], minlength=coarse.cells)
        return total.astype(float)

    fill_start, fill_end = summed(part.fill_start), summed(part.fill_end)
    weight = 0.5 * (part.fill_start + part.fill_end)
    total = np.maximum(summed(weight), 1e-300)
    faces = []
    for axis in range(grid.dimension):
        # only the fine faces that lie on a coarse face count
        on_face = fine_position[grid.array_axis(axis)] % factor == 0
        shape = list(coarse.shape)
        shape[coarse.array_axis(axis)] += 1
        dense = np.zeros(shape)
        dense[tuple(slice(0, n) for n in coarse.shape)] = summed(part.flux[axis], on_face).reshape(
            coarse.shape
        )
        faces.append(dense)
    direction = np.stack([summed(weight * component) for component in part.direction])
    length = np.linalg.norm(direction, axis=0)
    direction = np.divide(direction, length, out=np.zeros_like(direction), where=length > 0)
    return interval_from_dense(
        part.start,
        part.end,
        coarse,
        fill_start.reshape(coarse.shape),
        fill_end.reshape(coarse.shape),
        faces,
        (summed(weight * part.shear_rate) / total).reshape(coarse.shape),
        direction.reshape(-1, *coarse.shape),
    )
