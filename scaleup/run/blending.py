"""Blending: concentration moved on a flow by a mixing backend, and what observers make of it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scaleup.case.case import Case
from scaleup.contract import FlowField
from scaleup.measure.blend import Blend
from scaleup.mixing.check import CheckedMixing
from scaleup.mixing.loading import initial_concentration
from scaleup.mixing.march import State, march
from scaleup.mixing.scene import mixing_scene
from scaleup.report.results import Results, require_instants
from scaleup.run.observers import (
    Checkpoint,
    Curve,
    Moment,
    Observer,
    Pictures,
    Progress,
    Snapshots,
)
from scaleup.run.plan import Plan
from scaleup.run.resumption import identity, read_state
from scaleup.system.crew import Crew
from scaleup.system.errors import InputError
from scaleup.system.parallel import on_each, on_root
from scaleup.system.progress import Reporter
from scaleup.system.stopping import StoppedError, Stopping

log = logging.getLogger("scaleup")


def mix(
    case: Case,
    flow: FlowField,
    comm: Any,
    *,
    results: Results | None = None,
    checkpoint: Path | None = None,
    force: bool = False,
    changed_code: bool = False,
    stopping: Stopping | None = None,
    crew: Crew | None = None,
) -> Blend:
    """Blend on a flow and measure it along the way; collective.

    force        -- go on with steps beyond the limit of stability
    results      -- where snapshots go, or None
    checkpoint   -- where the state is kept; if the file exists the run goes on from it
    changed_code -- go on from it even if it was computed with other code
    stopping     -- whether the run is asked to end. Raises StoppedError when it is, with a
                    checkpoint kept
    crew         -- the ranks of `comm` that work; by default those that have a core

    A whole blend from a script, without a run folder:

    >>> from mpi4py import MPI
    >>> from scaleup.case.composing import compose
    >>> from scaleup.flow.source import obtain_flow
    >>> asked = ["flow.name=surface-layer", "grid.cells=300", "operation.revolutions=0.5"]
    >>> case = compose(None, asked)
    >>> flow = obtain_flow(case, MPI.COMM_WORLD).flow
    >>> blend = mix(case, flow, MPI.COMM_WORLD)
    >>> blend.revolutions[-1], blend.mass_drift < 1e-12
    (0.5, True)
    >>> blend.intensity[-1] < blend.intensity[0]
    True
    """
    root = comm.rank == 0
    plan = Plan.of(case, flow, with_pictures=results is not None)
    blend, reached = Blend(), -1
    if checkpoint is not None and on_root(comm, checkpoint.exists):
        begin, blend, reached = on_each(
            comm, partial(_resumed_state, checkpoint, case, flow, changed_code, plan)
        )
        log.info("resumed at revolution %.3f", plan.points[reached])
    else:
        begin = State(initial_concentration(case.operation.loading, flow))
    with (
        crew or Crew(comm) as crew,
        Reporter("mixing", visible=root and results is not None) as reporter,
    ):

        def asked() -> int:
            return stopping.asked(crew.comm) if stopping is not None else 0

        observers: list[Observer] = [Curve(plan, blend, flow, case.sample_edge)]
        if results is not None and root:
            observers += [Pictures(plan, flow, results), Snapshots(plan, blend, flow, results)]
        observers.append(Progress(plan, blend, reporter))
        if checkpoint is not None and root:
            every, fields = case.output.checkpoint_every, results is not None
            observers.append(Checkpoint(checkpoint, plan, blend, identity(case), every, fields))
        began = time.monotonic() - blend.seconds
        for number, state in _states(case, flow, plan, begin, reached, crew, asked, force):
            if results is not None and root and number == 0 and not state.paused:
                results.create()
            blend.seconds, blend.ledger = time.monotonic() - began, state.ledger
            blend.ranks = max(blend.ranks, crew.size)
            stop = state.paused or asked()
            moment = Moment(state, number, plan.points[number], stop)
            for observer in observers:
                if observer.due(moment):
                    observer.observe(moment)
            if stop and moment.revolution <= plan.final:
                kept = "no checkpoint was asked for"
                if checkpoint is not None:
                    kept = "the run can go on from its checkpoint (scaleup resume)"
                raise StoppedError(stop, f"ended after revolution {moment.revolution:g}; {kept}")
        blend.seconds = time.monotonic() - began
    if results is not None:
        on_root(comm, partial(results.finish, plan.instants(plan.points[-1])))
    # a rank that sat out has seen but a part
    return blend if comm.size == 1 else comm.bcast(blend)


def _states(
    case: Case,
    flow: FlowField,
    plan: Plan,
    state: State,
    reached: int,
    crew: Crew,
    asked: Callable[[], int],
    force: bool,
) -> Iterator[tuple[int, State]]:
    """(number of the last point reached, state) from point to point, on the ranks that work.

    The backend starts again when a law sets in and when other ranks work. Where the run is
    asked to end there is a paused state, too.
    """
    backend = CheckedMixing(case.new_mixing(), case.name("mixing"))
    period, last = case.operation.period, len(plan.points) - 1
    # The clock of the flow starts when the bed begins to flow; rigid lifting comes before.
    waited = flow.lift / (2 * math.pi) if case.operation.start == "level-bed" else 0.0
    times = [max(0.0, (revolution - waited) * period) for revolution in plan.points]
    while reached < last:
        crew.muster()
        if crew.comm is None:
            state, reached = crew.rest()
            continue
        began = time.monotonic()
        laws = case.laws(plan.points[max(reached, 0)])
        scene = mixing_scene(backend, flow, crew.comm, laws, force=force)
        backend.start(scene, state.concentration, state.index, state.local)
        restart = time.monotonic() - began
        steps = march(flow, backend, times[reached + 1 :], state, pause=asked)
        for state in steps:
            reached += not state.paused
            yield reached, state
            sets_in = len(case.laws(plan.points[reached])) > len(laws)
            if crew.wants_change(restart) or sets_in:
                break
        if crew.due or reached == last:
            crew.call((state, reached))


def check_resumable(case: Case, checkpoint: Path, *, changed_code: bool) -> None:
    """Raise InputError if a run cannot go on from its checkpoint, before anything is computed."""
    if not checkpoint.exists():
        return
    _, state = read_state(checkpoint, case, changed_code=changed_code)
    require_instants(checkpoint.parent, state["instants"])


def _resumed_state(
    checkpoint: Path, case: Case, flow: FlowField, changed_code: bool, plan: Plan
) -> tuple[State, Blend, int]:
    """State, curve and number of the last point reached of a checkpoint."""
    concentration, kept = read_state(checkpoint, case, changed_code=changed_code)
    index = kept["interval"]
    cells = len(flow.intervals[index].cells) if 0 <= index < len(flow.intervals) else -1
    if concentration.shape[1:] != (cells,) or not np.isfinite(concentration).all():
        raise InputError(f"{checkpoint}: does not fit the flow; simulate the run again")
    blend = Blend.from_table(kept["blend"])
    blend.profiles = {
        key: profile for key, profile in blend.profiles.items() if float(key) in plan.snapshots
    }
    state = State(concentration, kept["clock"], index, kept["time"], blend.ledger)
    return state, blend, plan.points.index(kept["revolution"])
