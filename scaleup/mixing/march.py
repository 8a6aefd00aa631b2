"""The march of a mixing backend through the intervals of a flow."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from scaleup.contract import Ledger
from scaleup.space.flow_field import FlowField
from scaleup.space.grid import FloatArray


@dataclass(frozen=True)
class State:
    """Where a blend stands.

    concentration -- (components, n) on the cells of the interval
    clock         -- s since the bed began to flow
    index, local  -- number of the interval in the flow, and the time in it, s
    ledger        -- what the backend has said of all its steps
    paused        -- why this is between two of the asked times; 0 at one of them
    """

    concentration: FloatArray
    clock: float = 0.0
    index: int = 0
    local: float = 0.0
    ledger: Ledger = field(default_factory=Ledger)
    paused: int = 0


def march(
    flow: FlowField,
    backend: Any,
    times: Sequence[float],
    state: State,
    *,
    landings: Sequence[float] = (),
    pause: Callable[[], int] = lambda: 0,
) -> Iterator[State]:
    """Advance from a state, yielding the state at every asked time; collective.

    backend  -- started at the state (`Mixing.start`)
    times    -- s of the flow's clock, ascending
    landings -- further times at which no step goes on
    pause    -- unless 0, why to yield a paused state before the next interval (collective)

    The backend gathers a state's concentrations for it, and is asked for nothing else there.

    Half a turn of a flow of eight intervals, by a backend that moves nothing:

    >>> import numpy as np
    >>> from scaleup.flow.sample_flows import rocking_box
    >>> class Still:
    ...     def advance(self, index, start, end):
    ...         return Ledger(steps=1)
    ...     def concentration(self, interval, time):
    ...         return np.ones((1, len(interval.cells)))
    >>> flow = rocking_box(dimension=2, intervals=8)
    >>> begin = State(np.ones((1, len(flow.intervals[0].cells))))
    >>> states = march(flow, Still(), [0.25 * flow.period, 0.5 * flow.period], begin)
    >>> [(state.index, state.clock, state.ledger.steps) for state in states]
    [(1, 0.25, 2), (3, 0.5, 4)]
    """
    ledger, clock, index, local = replace(state.ledger), state.clock, state.index, state.local

    def reached(paused: int = 0) -> State:
        interval = flow.intervals[index]
        # a steady part has no end
        within = min(max(local, interval.start), interval.end)
        concentration = backend.concentration(interval, within)
        return State(concentration, clock, index, within, replace(ledger), paused)

    stops = [(until, False) for until in landings] + [(until, True) for until in times]
    for until, asked in sorted(stops):
        for index, start, local in flow.schedule(clock, until):
            ledger.add(backend.advance(index, start, local))
            clock += local - start
            if clock < until and (why := pause()):
                yield reached(why)
        clock = until
        if asked:
            yield reached()
