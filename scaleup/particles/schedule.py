"""When a particle twin writes what: frames between points of the blend curve, steps between frames.

Frames are spaced evenly, a hundred or more to a revolution, every point of the blend curve is one,
and the time step divides the time between frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scaleup.case.case import Case
from scaleup.particles.contact import Contact

_FRAMES = 100  # in a revolution, at least: what means over time are made of


@dataclass(frozen=True)
class Schedule:
    """Steps, frames and stretches of a run; one stretch ends at each point of the blend curve.

    time_step -- s
    steps     -- between two frames
    frames    -- in a stretch
    stretches -- in the run
    period    -- s of a revolution
    """

    time_step: float
    steps: int
    frames: int
    stretches: int
    period: float

    @classmethod
    def of(cls, case: Case, contact: Contact) -> Schedule:
        """The schedule of a case; it ends at the first point of the curve not before its end."""
        every, period = case.output.metrics_every, case.operation.period
        frames = max(1, math.ceil(every * _FRAMES - 1e-9))
        between = every * period / frames
        steps = max(1, math.ceil(between / contact.time_step_limit))
        stretches = max(1, math.ceil(case.operation.revolutions / every - 1e-9))
        return cls(between / steps, steps, frames, stretches, period)

    def revolution(self, steps: int) -> float:
        """Revolutions after some steps."""
        return round(steps * self.time_step / self.period, 9)

    def at_point(self, steps: int) -> bool:
        """Whether this frame is a point of the blend curve."""
        return steps % (self.steps * self.frames) == 0

    def settling_steps(self, seconds: float) -> int:
        """Steps of about a time, s: a multiple of those between frames."""
        return self.steps * max(1, round(seconds / self.time_step / self.steps))
