"""The bed on one interval of a flow as a conservative, bounded scheme needs it.

Content is accounted for as in the flow itself: over a step from s to t,

    phi(t) c(t) = phi(s) c(s) - sum over faces of what leaves through them,

with phi the fill fraction of a cell and what leaves through a face given as a share of the volume
of a cell. The same number is taken from one cell and given to its neighbour, so mass is kept to
round-off; phi(t) follows the fluxes, so a uniform c stays uniform.

Cells that stay full are *regular*: they are updated in contiguous runs. All others that move are
updated in groups (`merged_cells`), so that none of them limits the step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from scaleup.mixing import flux_kernels as kernels
from scaleup.space.flow_field import Interval
from scaleup.space.grid import BoolArray, FloatArray, Grid, IntArray
from scaleup.space.merged_cells import Groups, leaving_rate, merge, neighbours_below

if TYPE_CHECKING:
    from scaleup.space.decomposition import Decomposition

_ROUND_OFF = 1e-14  # of a cell's volume
BRIDGE = 32  # cells: a new run costs about as much as so many
_LEAST = 1e-3  # fill fraction below which a cell never sets the step


@dataclass(frozen=True)
class GroupsHere:
    """Groups of merged cells on a rank; see `merged_cells`.

    members -- positions of the cells in flattened local arrays, group by group
    first   -- where each group starts in `members`, (groups + 1,)
    start, rate -- of the fill fraction of each whole group, on any rank: its value at the
               interval's start and its change per second, (groups,)
    begins  -- s, the interval's start
    """

    members: IntArray
    first: IntArray
    start: FloatArray
    rate: FloatArray
    begins: float

    def fraction(self, time: float) -> FloatArray:
        """Fill fraction of each group at a time (s), (groups,)."""
        return np.asarray(self.start + (time - self.begins) * self.rate)


@dataclass(frozen=True)
class LocalGroups(GroupsHere):
    """The groups that have members among a rank's owned cells, and those members.

    shared   -- groups with members on other ranks too
    mine, slot -- this rank's members of those (positions in `members`), and their places in the
               list of all members of all such groups of the bed
    run      -- where the members of each of `shared` start and stop in that list, (shared, 2)
    listed   -- length of that list
    """

    shared: IntArray
    mine: IntArray
    slot: IntArray
    run: IntArray
    listed: int


def runs_of(positions: IntArray, bridge: int = 0) -> IntArray:
    """Contiguous runs [start, stop) of ascending flat positions, shape (m, 2).

    bridge -- gaps of up to so many positions are swept too, where that does no harm: a short gap
              costs less than another run
    """
    if len(positions) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    breaks = np.flatnonzero(np.diff(positions) > 1 + bridge)
    starts = positions[np.concatenate([[0], breaks + 1])]
    stops = positions[np.concatenate([breaks, [len(positions) - 1]])] + 1
    return np.stack([starts, stops], axis=1)


class ConservativeBed:
    """One interval of a flow on a rank; arrays over cells are flattened local arrays.

    interval -- the flow
    owned    -- positions of the owned active cells in flattened local arrays
    strides  -- offset to the next cell along each axis in a flattened local array
    flux     -- (dimension, cells) volume flux through the lower faces over a cell's volume, 1/s
    spread   -- (dimension, cells) diffusive conductance D_nn aperture/h^2 of the lower faces, 1/s;
                the aperture is the smaller fill fraction beside the face at the start
    tensor   -- (dimension, dimension, cells) m^2/s
    drift    -- (components, dimension, cells) w_n aperture/h of the lower faces, w a component's
                velocity by drift, 1/s; no components if nothing drifts
    full     -- cells that are full all the time
    holds    -- cells that hold material at the start
    moving   -- cells of the whole bed through whose faces anything goes, (n,) bool
    stable_step -- s, largest step of the scheme: `positive_step()` unless the scheme says less
    updates  -- how many cells move; all others keep their concentration

    After `settle`: groups (this rank's part), merged (all of the bed), runs, face_runs.
    """

    def __init__(
        self,
        grid: Grid,
        split: Decomposition,
        interval: Interval,
        tensor: FloatArray,
        drift: FloatArray | None = None,
    ) -> None:
        self.grid, self.split, self.interval = grid, split, interval
        volume, shape = grid.cell_volume, split.local_shape
        self._start, self._end = interval.fill_start / volume, interval.fill_end / volume
        self._below = neighbours_below(grid, interval.cells)
        self._flux = interval.flux / volume
        diagonal = np.array([tensor[a, a] for a in range(grid.dimension)])
        spacing = np.array(grid.spacing)
        # what a cell holds at first sets its aperture: one that is being filled exchanges nothing
        self._spread = _through_faces(self._below, self._start, diagonal, spacing**2)
        velocities = [] if drift is None else list(drift)
        through = [_through_faces(self._below, self._start, w, spacing) for w in velocities]
        self._drift = np.array(through).reshape(len(through), *self._flux.shape)
        # no component changes places with another one faster
        self._swap = np.ptp(self._drift, axis=0) if through else np.zeros_like(self._flux)
        self._full = np.minimum(self._start, self._end) >= 1.0 - _ROUND_OFF
        self.moving = _touched(self._below, self._flux, self._spread + self._swap)
        self.updates = int(self.moving.sum())
        self.strides = tuple(
            int(np.prod(shape[dim + 1 :]))
            for dim in (grid.array_axis(a) for a in range(grid.dimension))
        )
        self._placing = split.placing(interval.cells)
        self.flux = self._placing.local(self._flux)
        self.spread = self._placing.local(self._spread)
        self.drift = self._placing.local(self._drift)
        self.tensor = self._placing.local(tensor)
        self.full = self._placing.local(self._full)
        self.holds = self._placing.local(self._start > _ROUND_OFF)
        self.owned = self._placing.owned
        self.stable_step = self.positive_step()
        self.merged = Groups(np.zeros(0, dtype=np.int64), np.zeros(1, dtype=np.int64))

    def positive_step(self, diffusion: float = 1.0) -> float:
        """Largest dt at which no full cell loses more than it holds, on all ranks, s.

        sum over faces of outflow dt + 2 diffusion sum over axes of D_nn dt/h^2 + sum over faces of
        (the greatest difference of two drifts) dt/h <= 1: with `diffusion` 1 the limit of
        positivity of the upwind scheme, with more a stricter one. Infinite if nothing moves.
        """
        rate = leaving_rate(self._below, self._flux, diffusion * self._spread + self._swap)
        fastest = float(rate[self._full].max(initial=0.0))
        if fastest == 0.0:  # nothing but cut cells
            fastest = float((rate / np.maximum(self._start, _LEAST)).max(initial=0.0))
        return 1.0 / fastest if fastest > 0 else np.inf

    def settle(self, dt: float) -> None:
        """Form the groups for steps of at most dt (s); collective, once per interval.

        Sets `merged`, `groups`, `runs` (of owned regular cells that move, (m, 2)), `sweeps` (the
        same with short gaps bridged) and `face_runs`: runs of positions that hold the lower faces,
        along every axis, of the owned moving cells and of the cells above those, gaps bridged. A
        bridged cell is at rest, merged, a ghost or empty: an update by face fluxes leaves it as it
        is, or it is overwritten after. Closes the faces inside groups.
        """
        # what a cell holds when a step begins, at the first and at the last step of the interval
        lost = np.maximum(self._start - self._end, 0.0)
        least = np.minimum(self._start, self._end + lost * min(1.0, dt / self.interval.duration))
        held = np.stack([self._start, self._end, least])
        held[held <= _ROUND_OFF] = 0.0
        cut = self.moving & ~self._full
        exchange = self._spread + self._swap
        self.merged = merge(self._below, self._flux, exchange, held, cut, dt)
        self.groups = self._local_groups()
        self._close_inner()
        mine = self._placing.mine
        faces = np.zeros(self.full.size, dtype=bool)
        place = self._placing.place[self.moving & mine]
        faces[place] = True
        for s in self.strides:
            faces[place + s] = True
        self.face_runs = runs_of(np.flatnonzero(faces), BRIDGE)
        regular = self.moving & mine
        regular[self.merged.members] = False
        self.runs = runs_of(self._placing.place[regular])
        self.sweeps = runs_of(self._placing.place[regular], BRIDGE)

    def _local_groups(self) -> LocalGroups:
        groups = self.merged
        number, count = groups.number, len(groups)
        start, rate = self._fill_of_groups()
        owned = self._placing.mine[groups.members]
        here = np.bincount(number[owned], minlength=count)
        partly = (here > 0) & (here < np.diff(groups.first))
        straddles = self.split.totals(partly.astype(float)) > 0
        present = np.flatnonzero(here > 0)
        slots = np.cumsum(straddles[number]) - 1  # of every member of the bed
        starts = np.concatenate([[0], np.cumsum(np.where(straddles, np.diff(groups.first), 0))])
        shared = np.flatnonzero(straddles[present])
        in_shared = straddles[number[owned]]
        return LocalGroups(
            members=self._placing.place[groups.members[owned]],
            first=np.concatenate([[0], np.cumsum(here[present])]),
            start=start[present],
            rate=rate[present],
            begins=self.interval.start,
            shared=shared,
            mine=np.flatnonzero(in_shared),
            slot=slots[owned][in_shared],
            run=np.stack([starts[present[shared]], starts[present[shared] + 1]], axis=1),
            listed=int(starts[-1]),
        )

    def groups_in_box(self) -> GroupsHere:
        """The groups that lie in the rank's box with all their members, ghosts included."""
        groups = self.merged
        number = groups.number
        place = self._placing.place[groups.members]
        whole = np.bincount(number, weights=place < 0, minlength=len(groups)) == 0
        start, rate = self._fill_of_groups()
        return GroupsHere(
            members=place[whole[number]],
            first=np.concatenate([[0], np.cumsum(np.diff(groups.first)[whole])]).astype(np.int64),
            start=start[whole],
            rate=rate[whole],
            begins=self.interval.start,
        )

    def _fill_of_groups(self) -> tuple[FloatArray, FloatArray]:
        """Fill fraction at the interval's start and its change per second, of all groups."""
        number, members = self.merged.number, self.merged.members
        start, gain = (
            np.bincount(number, weights=values[members], minlength=len(self.merged)).astype(float)
            for values in (self._start, self._end - self._start)
        )
        return start, gain / self.interval.duration

    def _close_inner(self) -> None:
        """Nothing goes through the faces between cells of one group."""
        place = self._placing.place[self.merged.members]
        here = place >= 0
        place, number = place[here], self.merged.number[here]
        group = np.full(self.full.size, -1, dtype=np.int64)
        group[place] = number
        for axis, stride in enumerate(self.strides):
            behind = place - stride
            inner = place[(behind >= 0) & (group[behind] == number)]
            self.flux[axis, inner] = 0.0
            self.spread[axis, inner] = 0.0
            self.drift[:, axis, inner] = 0.0

    def shifted(self, values: FloatArray, axis: int, by: int) -> FloatArray:
        """values[cell + by] along an axis, in flattened local arrays (edges are not valid)."""
        return np.roll(values, -by * self.strides[axis], axis=-1)

    def share_within_groups(self, values: FloatArray, time: float) -> None:
        """Give the owned cells of each group their mean, in place; values (m, cells); collective.

        The mean is weighted by what the cells hold at `time` (s), so that no content is lost.
        """
        groups = self.groups
        fraction = np.zeros(self.full.size)
        mine = self._placing.mine
        fraction[self.owned] = self.fraction_at(time)[mine]
        weight = fraction[groups.members]
        number = np.repeat(np.arange(len(groups.start)), np.diff(groups.first))
        held_by_member = np.stack([weight, *(weight * row[groups.members] for row in values)])
        sums = sums_over_groups(self.split, groups, held_by_member)
        held = sums[0] > _ROUND_OFF
        for row, content in zip(values, sums[1:], strict=True):
            mean = np.divide(content, sums[0], out=np.zeros_like(content), where=held)
            # a group that holds nothing yet takes any one value
            row[groups.members] = mean[number]

    def bounds(self, values: FloatArray) -> tuple[float, float]:
        """Least and greatest of all components, the last one included, where the bed moves.

        Over all ranks (collective); infinite if any value is not a number.
        """
        low, high = kernels.bounds(values, self.runs, self.groups.members)
        both = self.split.largest_of([-low, high])
        return -both[0], both[1]

    def known_at(self, time: float) -> IntArray:
        """Flat grid indices of the cells that carry a concentration at a time (s)."""
        return self.interval.cells[self.fraction_at(time) > _ROUND_OFF]

    def fraction_at(self, time: float) -> FloatArray:
        """Fill fraction of the interval's cells at a time, (n,)."""
        share = (time - self.interval.start) / self.interval.duration
        return np.asarray((1.0 - share) * self._start + share * self._end)


def sums_over_groups(split: Decomposition, groups: LocalGroups, values: FloatArray) -> FloatArray:
    """Sums over groups, (rows, groups), of values at owned members, (rows, members); collective.

    Members are added in the same order whoever owns them: the sums do not depend on the ranks, to
    the last bit.
    """
    sums: FloatArray = kernels.sums_of_runs(values, groups.first)
    if groups.listed > 0:
        every = np.zeros((len(values), groups.listed))
        every[:, groups.slot] = values[:, groups.mine]
        every = split.totals(every)
        for group, (start, stop) in zip(groups.shared, groups.run, strict=True):
            sums[:, group] = kernels.sums_of_runs(every, np.array([start, stop]))[:, 0]
    return sums


@numba.njit(cache=True)
def _through_faces(
    below: IntArray, fraction: FloatArray, normal: FloatArray, scale: FloatArray
) -> FloatArray:
    """Means of `normal` (dimension, n) at the lower faces times aperture/scale, (dimension, n)."""
    result = np.zeros_like(normal)
    for axis in range(normal.shape[0]):
        for i in range(normal.shape[1]):
            j = below[axis, i]
            if j >= 0:
                mean = 0.5 * (normal[axis, i] + normal[axis, j])
                result[axis, i] = mean * min(fraction[i], fraction[j]) / scale[axis]
    return result


@numba.njit(cache=True)
def _touched(below: IntArray, flux: FloatArray, spread: FloatArray) -> BoolArray:
    """Cells through whose faces anything goes."""
    result = np.zeros(flux.shape[1], dtype=np.bool_)
    for axis in range(flux.shape[0]):
        for i in range(flux.shape[1]):
            j = below[axis, i]
            if j >= 0 and (flux[axis, i] != 0.0 or spread[axis, i] != 0.0):
                result[i] = True
                result[j] = True
    return result
