"""From lab-frame bed surfaces to fills and fluxes on the grid that turns with the vessel.

Each interval of the flow:
 1 candidates: cells that the surface or the layer may touch between its start and its end;
 2 their fill at the end: cut by the surface there and by the wall;
 3 the layer's flux F*, its weights, shear rate and direction, as means over the interval's steps;
 4 components: a set of cells that no flux can reach keeps its fill; every other has its fill
   corrected so that it neither gains nor loses volume;
 5 the fluxes are closed to round-off (`continuity`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from scaleup.api import (
    BoolArray,
    CompactInterval,
    FloatArray,
    Geometry,
    Grid,
    IntArray,
    cut_fraction,
    cut_fraction_of_cells,
)
from scaleup_surface_layer.continuity import Segments, close_balance, find_segments
from scaleup_surface_layer.lab_columns import (
    BedStep,
    Columns,
    Layer,
    depth_below,
    layer_at,
    layer_of,
)
from scaleup_surface_layer.layer_flux import add_layer_flux, add_layer_shear

_FLOOR = 1e-3  # weight of a wet face outside the layer, over that of one in it
_STILL = 1e-7  # of omega R^2: a flux below it moves nothing
_CLOSED = 1e-4  # open share of a face below which it counts as wall
_SLIVERS = 1e-7  # of the bed: what may stay in cells that no flux can reach
_MIRROR = 1e-9  # of the reach: what a symmetric vessel's mirror image may be off by
_POCKET = 1e-2  # of the vessel's cells: fewer that hang together are no part of it
_EXACT = 1e-9  # of the room of cells, by which a fill that is known may be corrected
_GROWTH = (1, 2, 4, 0)  # rings of cells by which sets that cannot keep their volume grow
_FARTHER = (1, 2, 4, 8, 16, 32, 64, 0)  # the same, through any cell of the vessel
_CHUNK = 500_000  # cells cut at once


@dataclass
class Quality:
    """How far the closed fluxes are from the model's, over all intervals so far.

    model, correction -- sums of |F*| and |F - F*| over lateral faces and intervals, m^3/s
    stuck -- greatest volume that was to move in cells that no flux can reach, m^3
    level -- m, greatest shift of the surface that kept the volume
    """

    model: float = 0.0
    correction: float = 0.0
    stuck: float = 0.0
    level: float = 0.0


@dataclass
class Draft:
    """An interval in the making, on n candidate cells.

    cells  -- flat grid indices, ascending; before, after -- fill, m^3
    across -- the lateral grid axis in the plane; along -- the other
    flux, weight -- (2, n): lower faces normal to `across`, and to z
    shear  -- 1/s, (n,); motion -- velocity relative to rigid rotation, m/s, (3, n)
    """

    cells: IntArray
    before: FloatArray
    after: FloatArray
    across: int
    flux: FloatArray
    weight: FloatArray
    shear: FloatArray
    motion: FloatArray

    @property
    def along(self) -> int:
        """The grid axis that segments run along."""
        return 1 - self.across


@dataclass
class VesselFrame:
    """The grid, the vessel on it, and the bed's fill as time goes on.

    geometry, grid -- the vessel and the vessel-fixed grid
    columns        -- of the lab-frame fields
    omega          -- rad/s
    volume         -- m^3 of bed
    shear_rate     -- 1/s, of the layer's closure
    """

    geometry: Geometry
    grid: Grid
    columns: Columns
    omega: float
    volume: float
    shear_rate: float
    quality: Quality = field(default_factory=Quality)

    def __post_init__(self) -> None:
        grid = self.grid
        flat = grid.dimension == 2
        wall = self.geometry.signed_distance(grid.corner_points())
        self.capacity: FloatArray = (cut_fraction(wall) * grid.cell_volume).ravel()
        self.vessel: IntArray = np.flatnonzero(self.capacity > 0)
        self.apertures = _apertures(wall)
        self.vessel = self.vessel[self._reachable()]
        self.wall = wall if not flat else wall[None]
        self.counts = np.array([*grid.counts, 1] if flat else grid.counts)
        depth = grid.depth if flat else grid.spacing[2]
        self.spacing = np.array([grid.spacing[0], grid.spacing[1], depth])
        lowest = -0.5 * depth if flat else grid.lower[2]
        axis = self.geometry.axis.point
        self.corner = np.array([grid.lower[0] - axis[0], grid.lower[1] - axis[1], lowest])
        self.fill = np.zeros(grid.cells)
        self._index = np.full(grid.cells, -1, dtype=np.int32)
        self._level = 0.0

    def _reachable(self) -> BoolArray:
        """Which vessel cells hang together by open faces; slivers at the wall stay empty."""
        number = np.full(self.grid.cells, -1)
        number[self.vessel] = np.arange(len(self.vessel))
        pairs = []
        for axis in range(self.grid.dimension):
            upper = self.vessel[self.apertures[axis, self.vessel] > 0]
            lower = number[upper - int(np.prod(self.grid.counts[:axis]))]
            pairs.append(np.stack([number[upper], lower])[:, lower >= 0])
        first, second = np.concatenate(pairs, axis=1)
        n = len(self.vessel)
        graph = csr_matrix((np.ones(len(first), dtype=bool), (first, second)), shape=(n, n))
        _, component = connected_components(graph, directed=False)
        return (np.bincount(component) > _POCKET * n)[component]

    def close_mirror_plane(self) -> bool:
        """Whether the vessel is its own mirror image in z; if so, its halves are cut apart."""
        layers = int(self.counts[2])
        if layers < 2 or layers % 2:
            return False
        if np.abs(self.wall - self.wall[::-1]).max() > _MIRROR * self.geometry.reach:
            return False
        middle = self.apertures.reshape(3, layers, -1)
        middle[2, layers // 2] = 0.0
        return True

    def begin(self, step: BedStep) -> None:
        """Fill the vessel to the surface before a step."""
        for _ in range(50):
            fill = self._cut(self.vessel, self._layer(step, 0.0), step.before.phase)
            room = self._room(self.vessel, fill)
            excess = float(fill.sum() - self.volume)
            if abs(excess) <= 0.3 * room.sum():
                break
            self._level -= self._rise(excess, room)
        self.fill[self.vessel] = fill - excess / room.sum() * room

    def advance(
        self,
        steps: Sequence[BedStep],
        start: float,
        end: float,
        goal: FloatArray | None = None,
        everywhere: bool = False,
    ) -> CompactInterval:
        """The interval, from `start` to `end` (s), that consists of some steps.

        goal       -- the fill (m^3, flat) to end with, if it is known
        everywhere -- let the correction pass through any cell of the vessel
        """
        draft = self._draft(steps, goal, everywhere)
        lateral = (draft.across,) if self.grid.dimension == 2 else (draft.across, 2)
        wet = (draft.before > 0) | (draft.after > 0) | everywhere
        for row, axis in enumerate(lateral):  # a face may be wet for a part of the interval
            passed = np.flatnonzero(draft.weight[row] > 0)
            stride = int(np.prod(self.counts[:axis]))
            wet[passed] = wet[self._index[draft.cells[passed] - stride]] = True
        below = self._neighbours(draft.cells, draft.along, wet)
        beside = tuple(self._neighbours(draft.cells, axis, wet) for axis in lateral)
        self._index[draft.cells] = -1
        tiny = 1e-14 * self.grid.cell_volume
        used = np.abs(draft.after - draft.before) > tiny
        for row, other in enumerate(beside):
            passes = np.flatnonzero((draft.flux[row] != 0) & (other >= 0))
            used[passes] = used[other[passes]] = True
        for rings in _FARTHER if everywhere else _GROWTH:
            segments = find_segments(below, beside, used)
            unbalanced = self._unbalanced(draft, segments, exact=goal is not None)
            stuck = float(np.abs(draft.after - draft.before)[unbalanced].sum())
            if not unbalanced.any() or (goal is None and stuck < _SLIVERS * self.volume):
                break
            for _ in range(rings):
                _grow(used, unbalanced, (below, *beside))
        if unbalanced.any():
            if goal is not None and not everywhere:
                return self.advance(steps, start, end, goal, everywhere=True)
            self.quality.stuck = max(self.quality.stuck, stuck)
            used &= ~unbalanced
            segments = find_segments(below, beside, used)
        self._balance(draft, segments, shift=goal is None)
        through = self._close(draft, segments, below, lateral, end - start)
        return self._finish(draft, used, lateral, through, start, end)

    def _draft(self, steps: Sequence[BedStep], goal: FloatArray | None, everywhere: bool) -> Draft:
        first, last = self._layer(steps[0], 0.0), self._layer(steps[-1], 1.0)
        phases = steps[0].before.phase, steps[-1].after.phase
        where = self.counts, self.corner, self.spacing
        moves = _moves(steps, _STILL * self.omega * self.geometry.reach**2)
        cells = _candidates(
            self.vessel, self.fill, self.capacity, first, phases[0], last, phases[1], moves, *where
        )
        if goal is not None:
            cells = np.union1d(cells, np.flatnonzero(np.abs(goal - self.fill) > 0))
        if everywhere:
            cells = self.vessel
        n = len(cells)
        draft = Draft(
            cells,
            self.fill[cells],
            self._cut(cells, last, phases[1]) if goal is None else goal[cells],
            self._across(steps),
            np.zeros((2, n)),
            np.zeros((2, n)),
            np.zeros(n),
            np.zeros((3, n)),
        )
        self._index[cells] = np.arange(n)
        share = 1 / len(steps)
        for step in steps:
            layer = self._layer(step, 0.5)
            phase = 0.5 * (step.before.phase + step.after.phase)
            add_layer_flux(
                layer,
                phase,
                share,
                cells,
                self._index,
                draft.across,
                self.apertures,
                *where,
                draft.flux,
                draft.weight,
            )
            add_layer_shear(layer, phase, share, cells, *where, draft.shear, draft.motion)
        # rounding is no flux: it would tell a cell from its mirror image
        draft.flux[np.abs(draft.flux) < 1e-9 * np.abs(draft.flux).max(initial=0.0)] = 0.0
        return draft

    def _volumes(
        self, draft: Draft, segments: Segments
    ) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """Component of each used cell, room in each, and the excess and the room of components."""
        used = segments.segment >= 0
        component = segments.component[segments.segment[used]]
        room = self._room(draft.cells[used], draft.after[used])
        gained = draft.after[used] - draft.before[used]
        n = segments.components
        # in extended precision: a fill and a flux must agree in a cell, whatever the bed holds
        order = np.argsort(component, kind="stable")
        starts = np.searchsorted(component[order], np.arange(n))
        wide = gained[order].astype(np.longdouble)
        excess = (np.add.reduceat(wide, starts) if n else np.zeros(0)).astype(float)
        return component, room, excess, np.bincount(component, room, n).astype(float)

    def _unbalanced(self, draft: Draft, segments: Segments, exact: bool) -> BoolArray:
        """Which cells belong to a component that cannot be made to keep its volume."""
        component, _, excess, rooms = self._volumes(draft, segments)
        bound = (_EXACT if exact else 0.9) * rooms
        cells = np.zeros(len(draft.cells), dtype=bool)
        cells[segments.segment >= 0] = (np.abs(excess) > bound)[component]
        return cells

    def _balance(self, draft: Draft, segments: Segments, shift: bool) -> None:
        """Make every component keep its volume, and cells that are not used their fill."""
        used = segments.segment >= 0
        draft.after = np.where(used, draft.after, draft.before)
        for turn in range(3):  # once more, and again, for what rounding left
            component, room, excess, rooms = self._volumes(draft, segments)
            cure = np.divide(excess, rooms, out=np.zeros_like(excess), where=rooms > 0)
            draft.after[used] -= cure[component] * room
            if turn == 0 and shift and len(rooms):
                biggest = int(rooms.argmax())
                self._level -= self._rise(float(excess[biggest]), room[component == biggest])
                self.quality.level = max(self.quality.level, abs(self._level))

    def _close(
        self,
        draft: Draft,
        segments: Segments,
        below: IntArray,
        lateral: tuple[int, ...],
        duration: float,
    ) -> FloatArray:
        rows = len(lateral)
        if segments.count == 0:
            draft.flux[:] = 0.0
            return np.zeros(len(draft.cells))
        for row, axis in enumerate(lateral):
            floor = _FLOOR * self.grid.face_area(axis)
            draft.weight[row] = np.maximum(draft.weight[row], floor)
        model = draft.flux[:rows].copy()
        gain = (draft.after - draft.before) / duration
        through = close_balance(segments, below, draft.flux[:rows], draft.weight[:rows], gain)
        self.quality.model += float(np.abs(model).sum())
        self.quality.correction += float(np.abs(draft.flux[:rows] - model).sum())
        return through

    def _finish(
        self,
        draft: Draft,
        used: BoolArray,
        lateral: tuple[int, ...],
        through: FloatArray,
        start: float,
        end: float,
    ) -> CompactInterval:
        cells, dimension = draft.cells, self.grid.dimension
        flux = np.zeros((dimension, len(cells)))
        for row, axis in enumerate(lateral):
            flux[axis] = draft.flux[row]
        flux[draft.along] = through
        self.fill[cells] = draft.after
        speed = np.sqrt((draft.motion**2).sum(axis=0))
        direction = np.divide(draft.motion, speed, where=speed > 0, out=0.0 * draft.motion)
        draft.shear[~used] = 0.0
        keep = used | (draft.shear > 0)
        # cells at rest that are neither full nor empty are kept one by one as well
        self._index[cells[keep]] = 0
        other, still = _resting(self.vessel, self.fill, self.capacity, self._index)
        self._index[cells[keep]] = -1
        stored = np.concatenate([cells[keep], other])
        order = np.argsort(stored, kind="stable")
        kind = np.int32 if self.grid.cells < 2**31 else np.int64

        def whole(values: FloatArray, elsewhere: FloatArray | float = 0.0) -> FloatArray:
            both = np.zeros((*values.shape[:-1], len(stored)))
            both[..., : keep.sum()] = values[..., keep]
            both[..., keep.sum() :] = elsewhere
            return np.ascontiguousarray(both[..., order])

        return CompactInterval(
            start=start,
            end=end,
            cells=stored[order].astype(kind),
            fill_start=whole(draft.before, self.fill[other]),
            fill_end=whole(draft.after, self.fill[other]),
            flux=whole(flux),
            shear_rate=whole(draft.shear).astype(np.float32),
            direction=whole(direction[:dimension]).astype(np.float32),
            still=still.astype(kind),
        )

    def _neighbours(self, cells: IntArray, axis: int, wet: BoolArray) -> IntArray:
        """Number of the wet candidate below each along an axis, through an open face; else -1."""
        stride = int(np.prod(self.counts[:axis]))
        other = self._index[cells - stride].astype(np.int64)
        closed = (self.apertures[axis, cells] <= 0) | ~wet | (other < 0)
        closed |= ~wet[other]
        return np.where(closed, -1, other)

    def _cut(self, cells: IntArray, layer: Layer, phase: float) -> FloatArray:
        """Fill of cells below a layer's surface, m^3."""
        fill = np.empty(len(cells))
        for begin in range(0, len(cells), _CHUNK):
            some = cells[begin : begin + _CHUNK]
            state, corners = _corner_depths(
                layer, phase, some, self.wall, self.counts, self.corner, self.spacing
            )
            part = np.where(state > 0, self.capacity[some], 0.0)
            cut = cut_fraction_of_cells(corners) * self.grid.cell_volume
            part[state == 0] = np.minimum(cut, self.capacity[some[state == 0]])
            fill[begin : begin + _CHUNK] = part
        return fill

    def _room(self, cells: IntArray, fill: FloatArray) -> FloatArray:
        """By how much a fill may go up and down alike, m^3."""
        return np.minimum(fill, self.capacity[cells] - fill)

    def _rise(self, volume: float, room: FloatArray) -> float:
        """About how far a volume lifts the surface, m: a cut cell has room for a quarter."""
        return 0.25 * volume * self.grid.spacing[0] / max(float(room.sum()), 1e-300)

    def _layer(self, step: BedStep, share: float) -> Layer:
        thinnest = 0.5 * self.grid.spacing[0]
        return layer_of(self.columns, step, share, self._level, self.shear_rate, thinnest)

    def _across(self, steps: Sequence[BedStep]) -> int:
        """The in-plane grid axis that lies closest to the surface: 0 or 1."""
        step = steps[len(steps) // 2]
        middle = 0.5 * (step.before.surface + step.after.surface)
        bed = step.after.depth > 0
        inner = bed[1:] & bed[:-1]
        slope = float(np.diff(middle, axis=0)[inner].mean() / self.columns.dx)
        phase = 0.5 * (steps[0].before.phase + steps[-1].after.phase)
        c, s = math.cos(phase), math.sin(phase)
        # the surface's direction (1, slope) in vessel coordinates
        return 0 if abs(c + s * slope) >= abs(c * slope - s) else 1


def _apertures(wall: FloatArray) -> FloatArray:
    """Open share of every cell's lower faces, (3, cells), single precision; 0 at the edge."""
    dimension = wall.ndim
    shape = tuple(n - 1 for n in wall.shape)
    result = np.zeros((3, int(np.prod(shape))), dtype=np.float32)
    for axis in range(dimension):
        normal = dimension - 1 - axis
        lower = np.take(wall, range(shape[normal]), normal)
        rest = [d for d in range(dimension) if d != normal]
        corners = []
        for number in range(2 ** (dimension - 1)):
            part = lower
            for bit, d in enumerate(reversed(rest)):
                offset = (number >> bit) & 1
                part = np.take(part, range(offset, offset + shape[d]), d)
            corners.append(part.ravel())
        low, high = np.minimum.reduce(corners), np.maximum.reduce(corners)
        result[axis] = low > 0
        cut = (low <= 0) & (high > 0)
        if dimension == 3:
            result[axis, cut] = cut_fraction_of_cells(np.stack([v[cut] for v in corners], axis=-1))
        else:
            result[axis, cut] = high[cut] / (high[cut] - low[cut])
    result[result < _CLOSED] = 0.0
    return result


def _grow(used: BoolArray, seeds: BoolArray, below: tuple[IntArray, ...]) -> None:
    """Mark as used, and as seeds, what lies beyond an open face from the seeds."""
    for other in below:
        here = np.flatnonzero(other >= 0)
        here = here[seeds[here] | seeds[other[here]]]
        used[here] = used[other[here]] = True
        seeds[here] = seeds[other[here]] = True


def _moves(steps: Sequence[BedStep], still: float) -> BoolArray:
    """Which columns a flux touches, themselves or through a neighbour."""
    total = np.zeros_like(steps[0].after.surface)
    for step in steps:
        fx, fz = np.abs(step.flux_x), np.abs(step.flux_z)
        total = np.maximum(total, np.maximum(fx[1:], fx[:-1]))
        total = np.maximum(total, np.maximum(fz[:, 1:], fz[:, :-1]))
    busy = np.pad(total > still, 1)
    spread: BoolArray = busy[1:-1, 1:-1].copy()
    for i in (0, 1, 2):
        for k in (0, 1, 2):
            spread |= busy[i : i + total.shape[0], k : k + total.shape[1]]
    return spread


@njit(cache=True)
def _candidates(
    vessel, fill, capacity, first, phase0, last, phase1, moves, counts, corner, spacing
):
    c0, s0, c1, s1 = np.cos(phase0), np.sin(phase0), np.cos(phase1), np.sin(phase1)
    nx, ny = counts[0], counts[1]
    margin = 1.6 * spacing[0]
    found = np.empty(len(vessel), dtype=np.int64)
    n = 0
    for cell in vessel:
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        vx = corner[0] + (i + 0.5) * spacing[0]
        vy = corner[1] + (j + 0.5) * spacing[1]
        z = corner[2] + (k + 0.5) * spacing[2]
        x0, y0 = c0 * vx - s0 * vy, s0 * vx + c0 * vy
        x1, y1 = c1 * vx - s1 * vy, s1 * vx + c1 * vy
        d0, d1 = depth_below(first, x0, y0, z), depth_below(last, x1, y1, z)
        held = fill[cell]
        if max(d0, d1) < -margin and held == 0:
            continue
        low = min(d0, d1) - margin
        if held == capacity[cell] and low > first.thickest and low > last.thickest:
            continue
        # a cell between two columns counts for both, so that mirror images stay so
        t = 0.5 * (z - first.z0) / first.dz
        k0 = min(max(int(t - 1e-6), 0), moves.shape[1] - 1)
        k1 = min(max(int(t + 1e-6), 0), moves.shape[1] - 1)
        i0 = min(max(int((x0 - first.x0) / first.dx) // 2, 0), moves.shape[0] - 1)
        i1 = min(max(int((x1 - first.x0) / first.dx) // 2, 0), moves.shape[0] - 1)
        if not (moves[i0, k0] or moves[i1, k0] or moves[i0, k1] or moves[i1, k1]):
            continue
        thickness = max(layer_at(first, x0, z)[2], layer_at(last, x1, z)[2])
        if held == capacity[cell] and low > thickness:
            continue
        found[n] = cell
        n += 1
    return found[:n].copy()


@njit(cache=True)
def _resting(vessel, fill, capacity, marked):
    """Cells with material that are not marked (-1): partly filled ones, and runs of full ones."""
    other = np.empty(len(vessel), dtype=np.int64)
    runs = np.empty((len(vessel), 2), dtype=np.int64)
    n, m = 0, 0
    for cell in vessel:
        if marked[cell] >= 0 or fill[cell] <= 0:
            continue
        if fill[cell] < capacity[cell]:
            other[n] = cell
            n += 1
        elif m > 0 and runs[m - 1, 1] == cell:
            runs[m - 1, 1] = cell + 1
        else:
            runs[m, 0], runs[m, 1] = cell, cell + 1
            m += 1
    return other[:n].copy(), runs[:m].copy()


@njit(cache=True)
def _corner_depths(layer, phase, cells, wall, counts, corner, spacing):
    """Which cells are below the surface (1), above it (-1) or cut (0), and the latter's corners.

    Corner values are min(distance below the surface, distance to the wall), x fastest.
    """
    c, s = np.cos(phase), np.sin(phase)
    nx, ny = counts[0], counts[1]
    flat = counts[2] == 1
    number = 4 if flat else 8
    state = np.empty(len(cells), dtype=np.int8)
    corners = np.empty((len(cells), number))
    cut = 0
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        low, high = np.inf, -np.inf
        for m in range(number):
            a, b, e = m & 1, (m >> 1) & 1, m >> 2
            vx = corner[0] + (i + a) * spacing[0]
            vy = corner[1] + (j + b) * spacing[1]
            z = corner[2] + (k + (0.5 if flat else e)) * spacing[2]
            depth = depth_below(layer, c * vx - s * vy, s * vx + c * vy, z)
            low, high = min(low, depth), max(high, depth)
            # the slope of the surface is near 0.4: make it a distance, as the wall's is
            corners[cut, m] = min(0.92 * depth, wall[k + e, j + b, i + a])
        if low > 0:
            state[n] = 1
        elif high <= 0:
            state[n] = -1
        else:
            state[n] = 0
            cut += 1
    return state, corners[:cut].copy()
