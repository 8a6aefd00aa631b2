"""Several steps between two exchanges of ghosts.

A halo of several layers lets a rank do several steps of its own: each uses up one layer, in which
values can no longer be updated right. What a round can update follows from what the one before
left valid; a group of merged cells needs all its members.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from scaleup.contract import BoolArray, IntArray, RunError
from scaleup.numerics import BRIDGE, GroupsHere, runs_of
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


def plan_rounds(bed: Bed, groups: GroupsHere) -> tuple[list[Round], int]:
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
