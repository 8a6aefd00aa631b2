"""Running a mixing backend on a problem, and what came out."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI

from scaleup.contract import Ledger, MixingScene
from scaleup.mixing.march import State, march
from scaleup.mixing.scene import mixing_scene
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray
from scaleup.verification.problem import Problem

_SHORT = 0.2  # s: shorter runs are timed again
_REPEATS = 3
_WARM_UP = 1e-3  # of the duration, at most
PARTS = 7
"""of a turn: cos(2 pi/7) is irrational, so that no turn by 1/(7 k) carries a grid onto itself"""


@dataclass(frozen=True)
class Result:
    """What a backend made of a problem; errors and mass are those of component 0.

    cells        -- active at the start
    l1, l2       -- sum |c - exact| V / sum |exact| V, and the square root of the same with squares
    minimum, maximum -- over all components and all steps, before any clipping
    mass_drift   -- relative change of the component's volume
    variance_ratio -- second central moment over that of the exact solution; None unless the
                    problem is observed cell by cell
    segregation_error -- greatest difference of the intensity of segregation at the problem's
                    stops and its end, None without stops
    steps, cell_updates -- of `advance`
    seconds, core_seconds -- of `advance` after a warm-up: the clock's, and the processor time of
                    this process (the greatest of the ranks')
    flow, interval -- at the end
    concentration, exact, volumes -- (components, m), (components, m), (m,), as observed at the end
    """

    problem: str
    n: int
    cells: int
    l1: float
    l2: float
    minimum: float
    maximum: float
    mass_drift: float
    variance_ratio: float | None
    segregation_error: float | None
    steps: int
    seconds: float
    core_seconds: float
    cell_updates: int
    flow: FlowField = field(repr=False)
    interval: Interval = field(repr=False)
    concentration: FloatArray = field(repr=False)
    exact: FloatArray = field(repr=False)
    volumes: FloatArray = field(repr=False)

    @property
    def cell_updates_per_second(self) -> float:
        """1/s of processor time."""
        return self.cell_updates / max(self.core_seconds, 1e-9)


def run(
    problem: Problem, backend: Any, n: int, comm: Any = MPI.COMM_SELF, *, parts: int = 0
) -> Result:
    """Run a mixing backend on a problem at size n; collective on `comm`.

    A short stretch is run first and thrown away, so that nothing is compiled on the clock; of a run
    of less than 0.2 s the shortest time of four counts.

    parts -- equal parts of the time that the backend is asked for one by one. By default 7 where
             the problem has `landings`, which none of its steps then are, however long; else 1.

    Whatever the backend raises is passed on: InputError where it does not cover the problem.
    """
    flow = problem.flow(n)
    scene = mixing_scene(backend, flow, comm, problem.laws)
    start = problem.initial(flow)
    first = flow.intervals[0]
    backend.start(scene, start)
    warm_up = min(first.duration, _WARM_UP * problem.duration)
    backend.advance(0, 0.0, min(backend.stable_time_step(first), warm_up))
    parts = parts or (PARTS if problem.landings else 1)
    states, *cost = _marched(problem, backend, scene, start, parts)
    for _ in range(_REPEATS if cost[0] < _SHORT else 0):
        again = _marched(problem, backend, scene, start, parts)[1:]
        cost = [min(pair) for pair in zip(cost, again, strict=True)]
    segregation = []
    for state in states:
        interval, concentration = flow.intervals[state.index], state.concentration
        values, volumes = problem.observe(flow, interval, state.local, concentration)
        exact = problem.exact(flow, state.clock)
        segregation.append(abs(intensity(values[0], volumes) - intensity(exact[0], volumes)))

    ledger = state.ledger
    difference = np.abs(values[0] - exact[0])
    held = float((concentration[0] * interval.fill(state.local)).sum())
    initially = float((start[0] * first.fill_start).sum())
    return Result(
        problem=problem.name,
        n=n,
        cells=len(first.cells),
        l1=float(difference @ volumes / (np.abs(exact[0]) @ volumes)),
        l2=float(np.sqrt(difference**2 @ volumes / (exact[0] ** 2 @ volumes))),
        minimum=min(ledger.minimum, float(concentration.min())),
        maximum=max(ledger.maximum, float(concentration.max())),
        mass_drift=held / initially - 1.0,
        variance_ratio=_variance_ratio(flow, interval, values[0], exact[0], volumes),
        segregation_error=max(segregation) if problem.stops else None,
        steps=ledger.steps,
        seconds=cost[0],
        core_seconds=cost[1],
        cell_updates=ledger.cell_updates,
        flow=flow,
        interval=interval,
        concentration=values,
        exact=exact,
        volumes=volumes,
    )


class _Timed:
    """A backend as a march has it; what `advance` takes is added up.

    seconds, core_seconds -- the clock's, and processor time of this process
    """

    def __init__(self, backend: Any):
        self._backend = backend
        self.seconds = self.core_seconds = 0.0

    def advance(self, index: int, start: float, end: float) -> Ledger:
        began, core_began = clock.perf_counter(), clock.process_time()
        ledger: Ledger = self._backend.advance(index, start, end)
        self.seconds += clock.perf_counter() - began
        self.core_seconds += clock.process_time() - core_began
        return ledger

    def concentration(self, interval: Interval, time: float) -> FloatArray:
        concentration: FloatArray = self._backend.concentration(interval)
        return concentration


def _marched(
    problem: Problem, backend: Any, scene: MixingScene, start: FloatArray, parts: int
) -> tuple[list[State], float, float]:
    """States at every stop and the end, and what it took: seconds, and those of the processor."""
    backend.start(scene, start)
    stops, timed = (*problem.stops, problem.duration), _Timed(backend)
    landings = [
        time
        for stretch in pairwise((0.0, *stops))
        for time in np.linspace(*stretch, parts + 1)[1:-1].tolist()
    ]
    states = list(march(scene.flow, timed, stops, State(start), landings=landings))
    comm = scene.decomposition.comm
    times = (timed.seconds, timed.core_seconds)
    seconds, core_seconds = (float(comm.allreduce(time, op=MPI.MAX)) for time in times)
    return states, seconds, core_seconds


def fitted_order(results: Sequence[Result], norm: str = "l1") -> float:
    """Order of convergence: the slope of log error over log size, by least squares."""
    sizes = np.log([result.n for result in results])
    errors = np.log([getattr(result, norm) for result in results])
    return -float(np.polyfit(sizes, errors, 1)[0])


def intensity(c: FloatArray, volumes: FloatArray) -> float:
    """Intensity of segregation: variance of c over that of the unmixed state, by volume."""
    mean = float(c @ volumes / volumes.sum())
    return float((c - mean) ** 2 @ volumes / volumes.sum() / (mean * (1.0 - mean)))


def _variance_ratio(
    flow: FlowField, interval: Interval, c: FloatArray, exact: FloatArray, volumes: FloatArray
) -> float | None:
    if len(volumes) != len(interval.cells):
        return None
    points = flow.grid.centre_points(interval.cells)

    def second_moment(weight: FloatArray) -> float:
        mean = weight @ points / weight.sum()
        return float(weight @ ((points - mean) ** 2).sum(axis=1) / weight.sum())

    return second_moment(c * volumes) / second_moment(exact * volumes)
