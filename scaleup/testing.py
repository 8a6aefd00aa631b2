"""Contract checks for plugins: each raises ContractError with the rule and the figure it broke."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from scaleup.compact_intervals import CompactInterval, CompactIntervals, cells_of_runs
from scaleup.cut_cells import cut_fraction
from scaleup.errors import ContractError
from scaleup.flow_field import FlowField, Interval
from scaleup.grid import FloatArray, Grid, grid_over

_ROUND_OFF = 1e-12


def check_flow(flow: FlowField, geometry: Any = None, fill_volume: float | None = None) -> None:
    """Check the invariants of a FlowField.

    1 intervals are contiguous and cells ascending; 2 fill_end = fill_start - dt div(flux) to
    round-off; 3 fills are continuous between intervals and over the period; 4 0 <= fill <= vessel
    volume of the cell (of the whole cell without `geometry`); 5 the
    total is `fill_volume`; 6 no flux touches an inactive cell or the edge of the grid; 7
    directions are unit vectors or zero, shear rates >= 0, all numbers finite.

    Resting cells of compact intervals are as full as the vessel lets them be: they need no look.
    """
    grid = flow.grid
    capacity = np.full(grid.cells, grid.cell_volume)
    if geometry is not None:
        wall = geometry.signed_distance(grid.corner_points())
        capacity = (cut_fraction(wall) * grid.cell_volume).ravel()
    checker = _FlowChecker(grid, capacity, fill_volume)
    if isinstance(flow.intervals, CompactIntervals):
        parts: Sequence[CompactInterval] = flow.intervals.parts
        resting = flow.intervals.capacity
        if resting is not None and np.abs(resting - capacity).max() > _ROUND_OFF * grid.cell_volume:
            raise ContractError("capacity must be the vessel's volume in each cell")
    else:
        parts = _Compacted(flow.intervals)
    first = None
    for number in range(len(parts)):
        part = parts[number]
        checker.check(part, f"interval {number}")
        if number == flow.prefix:
            first = part
    if first is not None:
        checker.check_joined(first, "the periodic part", wrap=True)


class _Compacted(Sequence[CompactInterval]):
    def __init__(self, intervals: Sequence[Interval]):
        self._intervals = intervals

    def __len__(self) -> int:
        return len(self._intervals)

    def __getitem__(self, index: Any) -> Any:
        return CompactInterval.of(self._intervals[index])


class _FlowChecker:
    """Checks one interval after the other; remembers how the last one ended."""

    def __init__(self, grid: Grid, capacity: FloatArray, fill_volume: float | None):
        self._grid, self._capacity, self._fill_volume = grid, capacity, fill_volume
        self._slack = _ROUND_OFF * grid.cell_volume
        self._index = np.full(grid.cells, -1, dtype=np.int64)
        self._end: tuple[float, FloatArray] | None = None

    def check(self, part: CompactInterval, where: str) -> None:
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
        if self._end is not None:
            self.check_joined(part, where)
        ends = np.zeros(grid.cells)
        ends[resting] = self._capacity[resting]
        ends[part.cells] = part.fill_end
        self._end = part.end, ends

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

    def check_joined(self, part: CompactInterval, where: str, wrap: bool = False) -> None:
        """An interval begins when and as the last one that was checked ended."""
        assert self._end is not None
        end, ends = self._end
        if not wrap and end != part.start:
            raise ContractError(f"{where}: starts at {part.start:g} s, not at {end:g} s")
        resting = cells_of_runs(part.still)
        difference = ends.copy()
        difference[resting] -= self._capacity[resting]
        difference[part.cells] -= part.fill_start
        jump = float(np.abs(difference).max()) / self._grid.cell_volume
        if jump > 1e-9:
            raise ContractError(f"{where}: the fill jumps by {jump:.2g} of a cell where it joins")


def check_geometry(geometry: Any) -> None:
    """Check a geometry against itself.

    1 the box lies around the inside; 2 volume equals that below the top and the quadrature of the
    signed distance within 0.1 %; 3 the signed distance has slope 1 near the wall; 4 `reach` is
    the greatest distance from the axis.
    """
    lower, upper = np.array(geometry.lower), np.array(geometry.upper)
    if np.any(upper <= lower) or len(lower) != geometry.dimension:
        raise ContractError("lower and upper must span a box of the geometry's dimension")
    whole, none = geometry.volume_below(upper[1]), geometry.volume_below(lower[1])
    if abs(whole / geometry.volume - 1) > 1e-9 or abs(none) > 1e-9 * geometry.volume:
        raise ContractError(
            f"volume_below(top) = {whole:.6g} and volume_below(bottom) = {none:.2g} must be the "
            f"volume {geometry.volume:.6g} m^3 and 0"
        )
    spacing = float((upper - lower).max()) / (400 if geometry.dimension == 2 else 100)
    grid = grid_over(geometry.lower, geometry.upper, spacing, geometry.depth)
    wall = geometry.signed_distance(grid.corner_points())
    edges = [np.take(wall, index, dim) for dim in range(wall.ndim) for index in (0, -1)]
    if max(float(edge.max()) for edge in edges) > 0:
        raise ContractError("the inside reaches beyond the box from lower to upper")
    quadrature = float(cut_fraction(wall).sum() * grid.cell_volume)
    if abs(quadrature / geometry.volume - 1) > 1e-3:
        raise ContractError(
            f"volume = {geometry.volume:.6g} m^3, but the signed distance encloses "
            f"{quadrature:.6g} m^3"
        )
    points = grid.corner_points().reshape(-1, geometry.dimension)
    _check_slope(geometry, points[np.abs(wall.ravel()) < 2 * spacing], 0.01 * spacing)
    inside = points[wall.ravel() >= 0]
    radius = np.hypot(
        inside[:, 0] - geometry.axis.point[0], inside[:, 1] - geometry.axis.point[1]
    ).max()
    if abs(radius - geometry.reach) > 2 * spacing:
        raise ContractError(f"reach = {geometry.reach:g} m, but the inside reaches {radius:.4g} m")


def _check_slope(geometry: Any, points: FloatArray, step: float) -> None:
    """The signed distance grows by the way gone, but for kinks at edges and corners."""
    slope = np.zeros(len(points))
    for unit in np.eye(geometry.dimension):
        ahead = geometry.signed_distance(points + step * unit)
        slope += ((ahead - geometry.signed_distance(points - step * unit)) / (2 * step)) ** 2
    wrong = float(np.mean(np.abs(np.sqrt(slope) - 1.0) > 0.05))
    if wrong > 0.1:
        raise ContractError(
            f"signed_distance has not slope 1 at {wrong:.0%} of the points near the wall; it must "
            "be the distance to the wall, in m"
        )


def check_mixing(backend: Any, scene: Any, concentration: Any, duration: float) -> None:
    """Check a mixing backend on a scene, from concentrations (components, n): collective.

    1 the stable step is positive and finite; 2 after `duration` (s) components sum to 1; 3 a
    uniform concentration stays uniform to 1e-12.
    """
    flow = scene.flow
    for start in (concentration, np.full_like(concentration, 1.0 / len(concentration))):
        backend.start(scene, start)
        step = backend.stable_time_step(flow.intervals[0])
        if not 0 < step < np.inf:
            raise ContractError(f"stable_time_step = {step}: must be positive and finite")
        interval = flow.intervals[0]
        for index, begin, end in flow.schedule(0.0, duration):
            backend.advance(index, begin, end)
            interval = flow.intervals[index]
        result = backend.concentration(interval)
        error = float(np.abs(result.sum(axis=0) - 1.0).max())
        if error > _ROUND_OFF:
            raise ContractError(f"the components sum to 1 +- {error:.2g}")
    spread = float(np.abs(result - 1.0 / len(concentration)).max())
    if spread > _ROUND_OFF:
        raise ContractError(f"a uniform concentration changed by {spread:.2g}")
