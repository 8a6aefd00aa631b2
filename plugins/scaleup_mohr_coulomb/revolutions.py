"""A vessel's bed turned from rest until it repeats itself from one revolution to the next."""

from __future__ import annotations

import math
import time as clock
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from scaleup.contract import RunError

from .krylov import NotSolved
from .two_phase import FlowDiverged

if TYPE_CHECKING:
    from scaleup.contract import Progress

    from .space_flow import VesselFlow

# Share of the bed's volume that may lie elsewhere after a revolution that repeats the one before.
REPEATS = 0.02
# Share of the whole work, by which progress is counted; the rest is putting it on the grid.
SOLVING = 0.9
# Halvings of the step after which an interval that still diverges is given up.
_MOST_HALVINGS = 4
# Intervals kept to go back to.
_KEPT = 2


@dataclass
class Turned:
    """Intervals from the level bed on; those from ``prefix`` on are the revolution that repeats.

    ``levels`` holds this rank's coefficients of the level set at the ends of all intervals (one
    more than there are), ``velocities`` those of the mean velocity in each (None while the bed
    turns rigidly), ``angles`` (rad) the inclination of the plane through the surface at each end.
    """

    levels: list[NDArray[Any]]
    velocities: list[NDArray[Any] | None]
    angles: list[float]
    per_revolution: int
    prefix: int = 0
    mismatch: float = math.inf
    """Share of the bed's volume that lies elsewhere at the two ends of that revolution."""
    retries: int = 0
    seconds: float = 0.0


def level_bed(flow: VesselFlow, per_revolution: int, still: int) -> Turned:
    """The run that begins with ``still`` intervals in which the level bed turns rigidly."""
    level = flow.level_set.field.vec.FV().NumPy()
    return Turned(
        levels=[level.copy() for _ in range(still + 1)],
        velocities=[None] * still,
        angles=[0.0] * (still + 1),
        per_revolution=per_revolution,
    )


def revolve(
    flow: VesselFlow,
    run: Turned,
    most_revolutions: int,
    progress: Progress,
    keep: Callable[[Turned], None],
) -> None:
    """Turn the vessel by whole revolutions until the last two agree; collective.

    Each interval is taken in equal steps, no longer than the method's; where the flow diverges, the
    run goes back by up to two intervals and halves the step for a while.  At the end of each
    revolution but the first the bed is compared with that of one before.  ``run`` is added to, from
    where ``flow`` is, and ``keep`` is called after every interval.
    """
    began = clock.perf_counter() - run.seconds
    per_revolution = run.per_revolution
    length = 2.0 * math.pi / flow.speed / per_revolution
    nominal = max(1, math.ceil(length / flow.numerics.time_step - 1e-9))
    level = flow.level_set.field.vec.FV().NumPy
    kept: deque[dict[str, NDArray[Any]]] = deque(maxlen=_KEPT)
    halvings = calm = 0
    while True:
        done = len(run.velocities)
        if done % per_revolution == 0 and done >= 2 * per_revolution:
            run.prefix = done - per_revolution
            run.mismatch = flow.level_set.difference(run.levels[run.prefix]) / flow.volume
            if run.mismatch <= REPEATS or done >= most_revolutions * per_revolution:
                break
        kept.append(flow.state())
        try:
            mean = _interval(flow, length, nominal * 2**halvings)
        except (FlowDiverged, NotSolved) as error:
            if halvings == _MOST_HALVINGS:
                raise RunError(f"{error} (It had been halved {halvings} times.)") from error
            back = len(kept) - 1
            for _ in range(back + 1):
                state = kept.pop()
            flow.restore(state)
            del run.velocities[len(run.velocities) - back :]
            del run.levels[len(run.levels) - back :]
            del run.angles[len(run.angles) - back :]
            halvings += 1
            calm = back + 2
            run.retries += 1
            continue
        run.velocities.append(mean)
        run.levels.append(level().copy())
        run.angles.append(flow.surface_angle())
        calm -= 1
        if halvings and calm <= 0:
            halvings -= 1
            calm = 2
        progress(
            min(SOLVING, SOLVING * len(run.velocities) / (2 * per_revolution)),
            f"phase {math.degrees(flow.phase):.0f} deg, surface "
            f"{math.degrees(run.angles[-1]):.1f} deg, {flow.iterations / flow.steps:.0f} "
            f"iterations a step" + (f", {run.retries} retries" if run.retries else ""),
        )
        run.seconds = clock.perf_counter() - began
        keep(run)


def _interval(flow: VesselFlow, length: float, steps: int) -> NDArray[Any]:
    """Mean velocity coefficients over ``steps`` equal steps of an interval of ``length`` (s)."""
    velocity = flow.velocity.vec.FV().NumPy
    total = 0.5 * velocity()
    for number in range(steps):
        flow.step(length / steps)
        total += velocity() if number < steps - 1 else 0.5 * velocity()
    mean: NDArray[Any] = total / steps
    return mean
