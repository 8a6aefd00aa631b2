"""Time steps that recover: back to a kept state with a smaller step, and then longer again.

The lagged viscosity and the explicit convection can run away within a few steps, most easily in an
avalanche.  Shorter steps end that.  Time is counted in nominal steps, each taken as 2^k equal
substeps, so that whatever is recorded once in a nominal step stays evenly spaced in time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .krylov import NotSolved
from .swings import SwingAverage
from .two_phase import FlowDiverged, TwoPhaseFlow

# Blocks kept to go back to; a second failure soon after the first goes back farther.
_KEPT = 4
# Substeps are at most 2^-4 of the nominal step; a flow that needs less is beyond the method.
_MOST_HALVINGS = 4
# Blocks without failure, beyond where it failed, after which the substep is doubled: so many for
# each retry of the run, lest a flow that is always close to failure be retried without end.
_CALM_BLOCKS = 4


@dataclass
class Recovery:
    """How the time step stands, and what it took; all integers."""

    halvings: int = 0
    """Present k: a nominal step is taken as 2^k substeps."""
    calm: int = 0
    """Blocks still to pass before the substep is doubled."""
    retries: int = 0
    """Times the flow diverged and was taken back."""
    most_halvings: int = 0


class CarefulSteps:
    """Advances a flow and its average block by block, going back where the flow diverges."""

    def __init__(self, flow: TwoPhaseFlow, average: SwingAverage) -> None:
        self.flow, self.average = flow, average
        self._kept: deque[tuple[int, dict[str, NDArray[Any]]]] = deque(maxlen=_KEPT)
        self.recovery = Recovery()

    def block(self) -> None:
        """Advance by one block of nominal steps, in this algorithm.

        1. Keep the state. 2. Take and record the nominal steps, each as 2^k substeps. 3. If the
        flow diverges: go back to the state two blocks before (one more at each further failure,
        as far as kept), halve the substep and stay with it until past the failure and for a while
        more; give up after four halvings.  4. Otherwise double the substep, when due, up to the
        nominal step.
        """
        flow, average, recovery = self.flow, self.average, self.recovery
        self._kept.append((len(average.times), flow.state()))
        substeps = 2**recovery.halvings
        flow.time_step = flow.discretisation.time_step / substeps
        try:
            for _ in range(average.block):
                for _ in range(substeps):
                    flow.step()
                average.record(flow)
        except (FlowDiverged, NotSolved):
            if recovery.halvings == _MOST_HALVINGS:
                raise
            self._go_back()
            return
        recovery.calm -= 1
        if recovery.halvings and recovery.calm <= 0:
            recovery.halvings -= 1
            recovery.calm = _CALM_BLOCKS * recovery.retries

    def _go_back(self) -> None:
        recovery = self.recovery
        blocks = min(len(self._kept), 2 + recovery.halvings)
        for _ in range(blocks):
            samples, state = self._kept.pop()
        self.flow.restore(state)
        self.average.forget_after(samples)
        recovery.halvings += 1
        recovery.most_halvings = max(recovery.most_halvings, recovery.halvings)
        recovery.retries += 1
        recovery.calm = blocks + _CALM_BLOCKS * recovery.retries

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs."""
        r = self.recovery
        return {"recovery": np.array([r.halvings, r.calm, r.retries, r.most_halvings])}

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up the step of a run that was broken off."""
        self.recovery = Recovery(*state["recovery"].tolist())
