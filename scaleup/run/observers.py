"""What is done with the states of a blend on the way, each thing on a schedule of its own.

An observer has `due(moment)` and `observe(moment)`; both are called on every rank that mixes, and
for every moment, so that either may communicate. None of them knows of another.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from scaleup.contract import FlowField
from scaleup.flow import storage
from scaleup.measure.blend import Blend
from scaleup.mixing.march import State
from scaleup.report.results import Results
from scaleup.run.plan import Plan
from scaleup.system.progress import Reporter


@dataclass(frozen=True)
class Moment:
    """A state of a blend that is under way.

    number, revolution -- of the last point of the plan that was reached
    stop -- the signal that asks the run to end here, 0 if none does
    """

    state: State
    number: int
    revolution: float
    stop: int = 0

    @property
    def at_point(self) -> bool:
        """Whether this is a point of the plan."""
        return not self.state.paused


class Observer(Protocol):
    """Something that is done with some of the moments."""

    def due(self, moment: Moment) -> bool:
        """Whether it is to be done now."""
        ...

    def observe(self, moment: Moment) -> None:
        """Do it."""
        ...


class AtRevolutions:
    """A schedule: when some revolutions are reached."""

    def __init__(self, revolutions: frozenset[float]):
        self._revolutions = revolutions

    def due(self, moment: Moment) -> bool:
        """Whether one of them is."""
        return moment.at_point and moment.revolution in self._revolutions


class Curve(AtRevolutions):
    """The blend curve."""

    def __init__(self, plan: Plan, blend: Blend, flow: FlowField, sample_edge: float):
        super().__init__(plan.curve)
        self._blend, self._flow, self._edge = blend, flow, sample_edge
        self._began = time.monotonic() - blend.seconds

    def observe(self, moment: Moment) -> None:
        """Measure."""
        self._blend.measure(self._flow, moment.state, moment.revolution, self._edge)
        self._blend.elapsed.append(time.monotonic() - self._began)


class Pictures(AtRevolutions):
    """Fields for pictures and animations; on the root alone."""

    def __init__(self, plan: Plan, flow: FlowField, results: Results):
        super().__init__(plan.pictures)
        self._flow, self._results = flow, results

    def observe(self, moment: Moment) -> None:
        """Store."""
        state = moment.state
        interval = self._flow.intervals[state.index]
        self._results.add_picture(moment.revolution, interval, state.local, state.concentration)


class Snapshots(AtRevolutions):
    """All fields, and the profile along the bed's centre line; on the root alone."""

    def __init__(self, plan: Plan, blend: Blend, flow: FlowField, results: Results):
        super().__init__(plan.snapshots)
        self._blend, self._flow, self._results = blend, flow, results

    def observe(self, moment: Moment) -> None:
        """Store."""
        state = moment.state
        interval = self._flow.intervals[state.index]
        self._results.add(moment.revolution, interval, state.local, state.concentration)
        self._blend.add_profile(self._flow, state, moment.revolution)


class Progress:
    """How far the run is; at every point."""

    def __init__(self, plan: Plan, blend: Blend, reporter: Reporter):
        self._points, self._blend, self._reporter = len(plan.points), blend, reporter

    def due(self, moment: Moment) -> bool:
        """At points of the plan."""
        return moment.at_point

    def observe(self, moment: Moment) -> None:
        """Say so."""
        words = f"revolution {moment.revolution:.2f}, I = {self._blend.intensity[-1]:.3f}"
        self._reporter((moment.number + 1) / self._points, words)


class Checkpoint:
    """The state from which a run can go on: now and then, where it is extended, and at an end."""

    def __init__(
        self,
        path: Path,
        plan: Plan,
        blend: Blend,
        identity: dict[str, Any],
        every: float,
        with_fields: bool,
    ):
        """`every`: s of wall-clock time; `with_fields`: whether instants were stored, too."""
        self._path, self._plan, self._blend = path, plan, blend
        self._identity, self._every, self._with_fields = identity, every, with_fields
        self._last = time.monotonic()

    def due(self, moment: Moment) -> bool:
        """Not beyond the point from which a longer run would go on."""
        if moment.revolution > self._plan.final:
            return False
        often = time.monotonic() - self._last >= self._every
        return bool(moment.stop) or often or moment.revolution == self._plan.final

    def observe(self, moment: Moment) -> None:
        """Keep."""
        self._last = time.monotonic()
        state, revolution = moment.state, moment.revolution
        kept = {
            "run": self._identity,
            "revolution": revolution,
            "interval": state.index,
            "time": state.local,
            "clock": state.clock,
            "blend": self._blend.as_table(),
            "instants": self._plan.instants(revolution) if self._with_fields else {},
        }
        storage.write_checkpoint(self._path, {"concentration": state.concentration}, kept)
