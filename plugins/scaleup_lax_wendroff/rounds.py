"""Several steps between two exchanges of ghosts.

A halo of several layers lets a rank do several steps of its own: each uses up one layer, in which
values can no longer be updated right. What a round can update follows from what the one before
left valid; a group of merged cells needs all its members.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from scaleup.api import BRIDGE, BoolArray, FloatArray, IntArray, RunError, runs_of
from scaleup_lax_wendroff.beds import Bed, PaperBed

_ENDLESS = 10**6  # steps of a rank that has no ghosts


@dataclass(frozen=True)
class Round:
    """What one of the steps between two exchanges can still update right.

    runs   -- of updated cells in flattened local arrays, (m, 2)
    groups -- which of the local groups, (groups,)
    copies -- which of the bed's copies, form "paper" (k,)
    """

    runs: IntArray
    groups: BoolArray
    copies: BoolArray


@dataclass(frozen=True)
class LocalGroups:
    """Merged cells that lie in a rank's box with all their members, ghosts included.

    members, first -- positions in flattened local arrays, group by group
    start, rate    -- of the fill fraction: at the interval's start and per second
    begins         -- s, the interval's start
    """

    members: IntArray
    first: IntArray
    start: FloatArray
    rate: FloatArray
    begins: float

    def fraction(self, time: float) -> FloatArray:
        """Fill fraction at a time (s), (groups,)."""
        return np.asarray(self.start + (time - self.begins) * self.rate)


def local_groups(bed: Bed) -> LocalGroups:
    """The groups of a settled bed."""
    merged, split = bed.merged, bed.split
    number, count = merged.number, len(merged)
    start, end = (
        np.bincount(number, weights=bed.fraction_at(time)[merged.members], minlength=count)
        for time in (bed.interval.start, bed.interval.end)
    )
    cells = bed.interval.cells[merged.members]
    inside, where = split.local_position(cells)
    whole = np.bincount(number, weights=~inside, minlength=count) == 0
    keep = whole[number][inside]
    size = np.diff(merged.first)[whole]
    return LocalGroups(
        members=np.ravel_multi_index(where, split.local_shape)[keep],
        first=np.concatenate([[0], np.cumsum(size)]).astype(np.int64),
        start=start[whole],
        rate=((end - start) / bed.interval.duration)[whole],
        begins=bed.interval.start,
    )


def plan_rounds(bed: Bed, groups: LocalGroups) -> tuple[list[Round], int]:
    """(rounds, how many steps can be done in turn, the last round repeated); collective.

    Raises RunError if merged cells reach so far into other ranks that not one step can be done.
    """
    split = bed.split
    cells, shape = bed.interval.cells, split.local_shape
    regular = np.zeros(len(cells), dtype=bool)
    regular[bed.updated] = True
    regular = split.to_local(cells, regular).ravel()
    wanted = regular.copy()
    if not isinstance(bed, PaperBed):
        wanted |= split.to_local(cells, bed.moving).ravel()
    count = len(groups.start)
    number = np.repeat(np.arange(count), np.diff(groups.first))
    valid = np.ones(wanted.size, dtype=bool)
    if isinstance(bed, PaperBed):
        wanted[bed.outer] = True
    wanted_owned = bed.owned[wanted[bed.owned]]
    rounds: list[Round] = []
    steps = 0
    while True:
        around = ndimage.minimum_filter(
            valid.reshape(shape), size=3, mode="constant", cval=False
        ).ravel()
        right = regular & around
        usable = np.bincount(number, weights=~around[groups.members], minlength=count) == 0
        right[groups.members[usable[number]]] = True
        copies = np.zeros(0, dtype=bool)
        if isinstance(bed, PaperBed):
            copies = right[bed.sources]
            right[bed.targets[copies]] = True
        if not right[wanted_owned].all():
            break
        # all that moves but is not updated in the sweep is overwritten after, or no longer valid;
        # form "paper" looks at what it swept, so there no gap is bridged
        bridge = 0 if isinstance(bed, PaperBed) else BRIDGE
        runs = runs_of(np.flatnonzero(regular & around), bridge)
        rounds.append(Round(runs, usable, copies))
        steps += 1
        now = right | ~wanted
        if np.array_equal(now, valid):
            steps = _ENDLESS
            break
        valid = now
    steps = int(-split.largest(-steps))
    if steps == 0:
        raise RunError("--ranks: merged cut cells reach too far into other ranks; use fewer ranks")
    return rounds, steps
