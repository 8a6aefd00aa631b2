"""What a mixing backend did, to be added up over a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Ledger:
    """What a mixing backend did to bounds, over all components, seen before any clipping.

    All shares are of the bed's volume; `clipped` is the sum of the absolute changes by clipping;
    `step_share` is the longest step over the stable one; `iterations` are those of linear solvers.
    """

    steps: int = 0
    cell_updates: int = 0
    minimum: float = np.inf
    maximum: float = -np.inf
    clipped: float = 0.0
    step_share: float = 0.0
    iterations: int = 0

    def add(self, other: Ledger) -> None:
        """Add what a further stretch of time did."""
        self.steps += other.steps
        self.cell_updates += other.cell_updates
        self.minimum = min(self.minimum, other.minimum)
        self.maximum = max(self.maximum, other.maximum)
        self.clipped += other.clipped
        self.iterations += other.iterations
        self.step_share = max(self.step_share, other.step_share)
