"""What a rank's local cells hold, as time goes on: from one interval to the next little changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaleup.contract import FloatArray, IntArray


@dataclass(frozen=True)
class Changes:
    """The local cells whose fill changes in an interval.

    position   -- in flattened local arrays, ghosts too, (k,)
    start, end -- their fill fractions at both ends of the interval, (k,)
    """

    position: IntArray
    start: FloatArray
    end: FloatArray

    @property
    def bytes(self) -> int:
        """Memory held."""
        return self.position.nbytes + self.start.nbytes + self.end.nbytes


NO_CHANGES = Changes(np.empty(0, dtype=np.int32), np.empty(0), np.empty(0))


def find_changes(start: FloatArray, end: FloatArray) -> Changes:
    """From the fill fractions of all local cells at both ends of an interval."""
    position = np.flatnonzero(start != end)
    return Changes(position.astype(np.int32), start[position], end[position])


def fill_at(fraction: FloatArray, changes: Changes, share: float) -> None:
    """Set the fill fractions of local cells at a share of the interval; the others stay."""
    if share == 0.0:
        fraction[changes.position] = changes.start
    elif share == 1.0:
        fraction[changes.position] = changes.end
    else:
        fraction[changes.position] = (1.0 - share) * changes.start + share * changes.end
