"""The bed's fill on the grid that turns with the vessel, interval by interval.

Each interval of the flow:
 1 candidates: cells that the surface or the layer may touch between its start and its end;
 2 their fill at the end: cut by the surface there and by the wall;
 3 those that are used: that change, or that the layer runs through;
 4 components: a set of used cells that hangs together neither gains nor loses volume: their fills
   are corrected; where that cannot be done the set grows, and if that does not help either it keeps
   its fill, if that is little, or exchanges it with the others along the shortest ways.
This is a chain, since cells that nothing moves keep what they hold, but a cheap one: every rank
goes through it. What an interval's fluxes are (`layer_closing`) depends on its Draft alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from scaleup.contract import BoolArray, FloatArray, Geometry, Grid, IntArray
from scaleup.numerics import cut_fraction, cut_fraction_of_cells
from scaleup_surface_layer.cell_sets import (
    GridPlace,
    component_volumes,
    corner_depths,
    find_components,
    find_moving,
    grow,
    join,
    neighbours_below,
    put_remainder,
    spread_cure,
)
from scaleup_surface_layer.lab_columns import BedStep, Columns, Layer, layer_of

_STILL = 1e-7  # of omega R^2: a flux below it moves nothing
_CLOSED = 1e-4  # open share of a face below which it counts as wall
_SLIVERS = 1e-7  # of the bed: what may stay in cells that no flux can reach
_MIRROR = 1e-13  # of the reach: what a symmetric vessel's mirror image may be off by
_POCKET = 1e-2  # of the vessel's cells: fewer that hang together are no part of it
_EXACT = 1e-9  # of the room of cells, by which a fill that is known may be corrected
_ROOM = 0.9  # of the room of cells, by which another fill may be corrected
_STAYS = 1e-3  # of the bed: more does not keep its fill where it should move
_LEVELS = 20  # attempts at a surface that keeps the volume
_GROWTH = (1, 2, 4, 0)  # rings of cells by which sets that cannot keep their volume grow
_CHUNK = 500_000  # cells cut at once


@dataclass
class Draft:
    """Which n cells move in an interval: they carry flux or change their fill.

    cells -- flat grid indices, ascending; before, after -- fill, m^3
    """

    cells: IntArray
    before: FloatArray
    after: FloatArray


@dataclass
class Tally:
    """What was done to the bed's fill that is not the model's, so far.

    stuck          -- greatest volume that was to move in cells that no flux can reach, m^3
    detoured       -- volume that went other ways than the layer's, m^3
    greatest_shift -- m, of the surface that kept the volume
    """

    stuck: float = 0.0
    detoured: float = 0.0
    greatest_shift: float = 0.0


@dataclass
class VesselFrame:
    """The grid, the vessel on it, and the bed's fill as time goes on.

    geometry, grid -- the vessel and the vessel-fixed grid, over it or over its upper half in z
    columns        -- of the lab-frame fields
    omega          -- rad/s
    volume         -- m^3 of bed
    shear_rate     -- 1/s, of the layer's closure
    tally          -- what was done to the fill beyond that
    """

    geometry: Geometry
    grid: Grid
    columns: Columns
    omega: float
    volume: float
    shear_rate: float
    tally: Tally = field(default_factory=Tally, init=False)

    def __post_init__(self) -> None:
        grid = self.grid
        flat = grid.dimension == 2
        wall = self.geometry.signed_distance(grid.corner_points())
        self.capacity: FloatArray = (cut_fraction(wall) * grid.cell_volume).ravel()
        self.apertures = _apertures(wall)
        self.vessel: IntArray = np.flatnonzero(self.capacity > 0)
        self.vessel = self.vessel[self._reachable()]
        self.wall = wall if not flat else wall[None]
        self.counts = np.array([*grid.counts, 1] if flat else grid.counts)
        self.strides = np.cumprod([1, *grid.counts[:-1]])
        depth = grid.depth if flat else grid.spacing[2]
        self.spacing = np.array([grid.spacing[0], grid.spacing[1], depth])
        lowest = -0.5 * depth if flat else grid.lower[2]
        axis = self.geometry.axis.point
        self.corner = np.array([grid.lower[0] - axis[0], grid.lower[1] - axis[1], lowest])
        self.fill = np.zeros(grid.cells)
        self.index = np.full(grid.cells, -1, dtype=np.int32)
        self._level = 0.0

    @property
    def place(self) -> GridPlace:
        """The grid, for the kernels."""
        return GridPlace(self.counts, self.corner, self.spacing)

    def begin(self, step: BedStep) -> None:
        """Fill the vessel to the surface before a step."""
        for _ in range(50):
            fill = self._cut(self.vessel, self.layer(step, 0.0), step.before.phase)
            room = np.minimum(fill, self.capacity[self.vessel] - fill)
            excess = float(fill.sum() - self.volume)
            if abs(excess) <= 0.3 * room.sum():
                break
            self._level -= self._rise(excess, float(room.sum()))
        self.fill[self.vessel] = fill - excess / room.sum() * room

    def move(self, steps: Sequence[BedStep], goal: FloatArray | None = None) -> Draft:
        """Go on by the interval that consists of some steps; `goal`: the fill it must end with."""
        cells, part = self._find(steps)
        if goal is None:
            draft = self._moved(steps[-1], cells, part)
        else:
            draft = self._brought_to(goal, cells, part)
        self.fill[draft.cells] = draft.after
        return draft

    def layer(self, step: BedStep, share: float) -> Layer:
        """The layer at a share (0 to 1) of a step."""
        thinnest = 0.5 * self.grid.spacing[0]
        return layer_of(self.columns, step, share, self._level, self.shear_rate, thinnest)

    def _find(self, steps: Sequence[BedStep]) -> tuple[IntArray, IntArray]:
        flux_x = np.mean([step.flux_x for step in steps], axis=0)
        flux_z = np.mean([step.flux_z for step in steps], axis=0)
        whole = BedStep(steps[0].before, steps[-1].after, flux_x, flux_z)
        return find_moving(  # type: ignore[no-any-return]
            self.vessel,
            self.fill,
            self.capacity,
            (self.layer(steps[0], 0.0), self.layer(steps[-1], 1.0), self.layer(whole, 0.5)),
            (steps[0].before.phase, steps[-1].after.phase),
            _moves(steps, _STILL * self.omega * self.geometry.reach**2),
            self.place,
        )

    def _moved(self, last: BedStep, cells: IntArray, part: IntArray) -> Draft:
        """The draft on these candidates that ends with the bed's surface after the last step."""
        before, capacity = self.fill[cells], self.capacity[cells]
        after = self._cut(cells, self.layer(last, 1.0), last.after.phase)
        used, wet = self._used(before, after, part)
        below = self._below(cells, wet)
        for rings in _GROWTH:
            component, count = find_components(used, below)
            gain, room = component_volumes(component, count, before, after, capacity)
            stays = np.append(np.abs(gain) > _ROOM * room, False)[component]
            lost = float(np.abs(after - before)[stays].sum())
            if lost < _SLIVERS * self.volume:
                break
            for _ in range(rings):
                grow(used, stays, below)
        if lost > _STAYS * self.volume:
            return self._exchanged(last, cells, part)
        if stays.any():
            self.tally.stuck = max(self.tally.stuck, lost)
            used &= ~stays
            component, count = find_components(used, below)
        self._balance(component, count, before, after, capacity, shift=True)
        return Draft(cells[used], before[used], after[used])

    def _exchanged(self, last: BedStep, candidates: IntArray, part: IntArray) -> Draft:
        """As `_moved`, where a part inside the vessel (a baffle) keeps sets of cells apart.

        What rotation and the layer brought to one side and took from the other goes around that
        part. The surface is then moved until the bed keeps its volume.
        """
        cells, parts = _with_more(candidates, part, self.vessel)
        places = np.searchsorted(cells, candidates)
        before, capacity = self.fill[cells], self.capacity[cells]
        for _ in range(_LEVELS):
            after = before.copy()
            after[places] = self._cut(candidates, self.layer(last, 1.0), last.after.phase)
            used, component, count, detoured = self._joined(
                cells, parts, before, after, capacity, _ROOM
            )
            gain, room = component_volumes(component, count, before, after, capacity)
            biggest = int(room.argmax())
            if abs(gain[biggest]) <= _ROOM * room[biggest]:
                break
            self._level -= self._rise(float(gain[biggest]), float(room[biggest]))
        self.tally.detoured += detoured
        return self._settled(cells, used, component, count, before, after, capacity, _ROOM)

    def _brought_to(self, goal: FloatArray, cells: IntArray, part: IntArray) -> Draft:
        """The draft that ends with a goal."""
        cells, part = _with_more(cells, part, self.vessel)
        before, after, capacity = self.fill[cells], goal[cells], self.capacity[cells]
        used, component, count, _ = self._joined(cells, part, before, after, capacity, _EXACT)
        return self._settled(cells, used, component, count, before, after, capacity, _EXACT)

    def _joined(
        self,
        cells: IntArray,
        part: IntArray,
        before: FloatArray,
        after: FloatArray,
        capacity: FloatArray,
        share: float,
    ) -> tuple[BoolArray, IntArray, int, float]:
        """Used cells, what hangs together, how many sets do, and the volume that was joined, m^3.

        Sets of cells that must exchange volume, by more than a share of their room, are joined
        along the shortest ways: through material, or else through any cell of the vessel.
        """
        used, wet = self._used(before, after, part)
        volume = 0.0
        for passable in (wet, np.ones_like(wet)):
            below = self._below(cells, passable)
            for joined in (False, True):
                component, count = find_components(used, below)
                gain, room = component_volumes(component, count, before, after, capacity)
                sets = np.abs(gain) > share * room
                if not sets.any():
                    break
                if not joined:
                    sets[room.argmax()] = False
                    volume = max(volume, float(np.abs(gain[sets]).sum()))
                    main = component == room.argmax()
                    join(used, main, np.append(sets, False)[component], below)
        return used, component, count, volume

    def _settled(
        self,
        cells: IntArray,
        used: BoolArray,
        component: IntArray,
        count: int,
        before: FloatArray,
        after: FloatArray,
        capacity: FloatArray,
        share: float,
    ) -> Draft:
        """The draft in which sets that cannot keep their volume keep their fill."""
        gain, room = component_volumes(component, count, before, after, capacity)
        stays = np.append(np.abs(gain) > share * room, False)[component]
        if stays.any():
            self.tally.stuck = max(self.tally.stuck, float(np.abs(after - before)[stays].sum()))
            used = used & ~stays
            kept = np.unique(component[used])
            component = np.where(used, np.searchsorted(kept, component), -1)
            count = len(kept)
        self._balance(component, count, before, after, capacity, shift=share > _EXACT)
        return Draft(cells[used], before[used], after[used])

    def _used(
        self, before: FloatArray, after: FloatArray, part: IntArray
    ) -> tuple[BoolArray, BoolArray]:
        """Which candidates change or are run through by the layer, and which hold material."""
        wet = (before > 0) | (after > 0) | (part == 2)
        changes = np.abs(after - before) > 1e-14 * self.grid.cell_volume
        return changes | (wet & (part > 0)), wet

    def _below(self, cells: IntArray, passable: BoolArray) -> IntArray:
        """Neighbours below of cells, along each axis, where both are passable."""
        self.index[cells] = np.arange(len(cells))
        below: IntArray = neighbours_below(
            cells, self.index, self.apertures, self.strides, passable
        )
        self.index[cells] = -1
        return below

    def _balance(
        self,
        component: IntArray,
        count: int,
        before: FloatArray,
        after: FloatArray,
        capacity: FloatArray,
        shift: bool,
    ) -> None:
        """Make every component keep its volume."""
        for turn in range(2):  # once more for what rounding left
            gain, room = component_volumes(component, count, before, after, capacity)
            cure = np.divide(gain, room, out=np.zeros_like(gain), where=room > 0)
            spread_cure(component, cure, after, capacity)
            if turn == 0 and shift and count:
                biggest = int(room.argmax())
                self._level -= self._rise(float(gain[biggest]), float(room[biggest]))
                self.tally.greatest_shift = max(self.tally.greatest_shift, abs(self._level))
        gain, _ = component_volumes(component, count, before, after, capacity)
        put_remainder(component, gain, after, capacity)

    def _cut(self, cells: IntArray, layer: Layer, phase: float) -> FloatArray:
        """Fill of cells below a layer's surface, m^3."""
        fill = np.empty(len(cells))
        for begin in range(0, len(cells), _CHUNK):
            some = cells[begin : begin + _CHUNK]
            state, corners = corner_depths(layer, phase, some, self.wall, self.place)
            part = np.where(state > 0, self.capacity[some], 0.0)
            cut = cut_fraction_of_cells(corners) * self.grid.cell_volume
            part[state == 0] = np.minimum(cut, self.capacity[some[state == 0]])
            fill[begin : begin + _CHUNK] = part
        return fill

    def _rise(self, volume: float, room: float) -> float:
        """About how far a volume lifts the surface, m: a cut cell has room for a quarter."""
        return 0.25 * volume * self.grid.spacing[0] / max(room, 1e-300)

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


def upper_half(geometry: Geometry, grid: Grid) -> Grid | None:
    """The half at greater z of a grid over a vessel that is its own mirror image in z, if it is."""
    if grid.dimension == 2 or grid.counts[2] % 2:
        return None
    wall = geometry.signed_distance(grid.corner_points())
    if np.abs(wall - wall[::-1]).max() > _MIRROR * geometry.reach:
        return None
    layers = grid.counts[2] // 2
    middle = grid.lower[2] + layers * grid.spacing[2]
    return replace(grid, lower=(*grid.lower[:2], middle), counts=(*grid.counts[:2], layers))


def _with_more(cells: IntArray, part: IntArray, others: IntArray) -> tuple[IntArray, IntArray]:
    """Candidates and what part they take, with others that take none."""
    both = np.union1d(cells, others)
    parts = np.zeros(len(both), dtype=part.dtype)
    parts[np.searchsorted(both, cells)] = part
    return both, parts


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
    for axis in range(dimension):  # nothing passes the edge of the grid, whatever the vessel does
        faces = result[axis].reshape(shape)
        faces[(slice(None),) * (dimension - 1 - axis) + (0,)] = 0.0
    return result


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
