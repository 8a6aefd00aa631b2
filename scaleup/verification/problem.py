"""What a verification problem is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from scaleup.contract import Diffusion, Law
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray

Regime = Literal["smooth", "boundary", "sharp", "sampled"]

Field = Callable[[FloatArray], FloatArray]
"""points (..., dimension) -> values (...)"""
Observed = tuple[FloatArray, FloatArray]
"""(components, m) values and the volume (m^3) that each stands for, (m,)"""


def cells_as_they_are(flow: FlowField, interval: Interval, time: float, c: FloatArray) -> Observed:
    """Every active cell by itself, weighted by its fill at a local time of the interval (s)."""
    return c, interval.fill(min(max(time, interval.start), interval.end))


@dataclass(frozen=True)
class Problem:
    """A flow, concentrations at its start, and what they are later.

    name, sentence -- what it is called, and what it shows
    dimension -- 2 or 3
    regime    -- "smooth": smooth, with the body in full cells, so that a backend's order shows;
                 "boundary": smooth, but up to walls or a moving surface; "sharp": with jumps;
                 "sampled": the reference has a sampling error
    sizes     -- cells per unit length (or per vessel), the sizes of the study in ascending order
    duration  -- s
    flow      -- the flow on a grid of a given size
    initial   -- concentrations (components, n) on the cells of interval 0; sum to 1
    exact     -- (flow, time in s) -> concentrations (components, m) as observed then
    laws      -- what moves components beside the flow
    observe   -- (flow, interval, local time, concentrations) -> what `exact` is compared with
    stops     -- s, times before the end at which the concentrations are observed too
    landings  -- the greatest number of equal parts of the duration in each of which the flow
                 carries cells onto cells, so that a scheme of so long steps has nothing to
                 interpolate; 0 if there are none

    All errors are those of component 0.
    """

    name: str
    sentence: str
    dimension: int
    regime: Regime
    sizes: tuple[int, ...]
    duration: float
    flow: Callable[[int], FlowField]
    initial: Callable[[FlowField], FloatArray]
    exact: Callable[[FlowField, float], FloatArray]
    laws: tuple[Law, ...] = ()
    observe: Callable[[FlowField, Interval, float, FloatArray], Observed] = cells_as_they_are
    stops: tuple[float, ...] = ()
    landings: int = 0


def uniform_diffusion(tensor: FloatArray) -> Diffusion:
    """The same tensor (dimension, dimension), m^2/s, in every cell."""

    def everywhere(flow: FlowField, interval: Interval) -> FloatArray:
        return np.repeat(tensor[:, :, None], len(interval.cells), axis=2)

    return Diffusion(everywhere)


def interval_at(flow: FlowField, time: float) -> tuple[Interval, float]:
    """The interval that holds just before a time of the flow's clock, and the local time, s."""
    if time <= 0.0:
        return flow.intervals[0], 0.0
    index, _, local = list(flow.schedule(0.0, time))[-1]
    return flow.intervals[index], local


def two_components(share: FloatArray) -> FloatArray:
    """A component of concentration `share` (n,) in the rest: (2, n)."""
    return np.stack([share, 1.0 - share])
