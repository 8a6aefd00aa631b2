"""What a run would model, why, and what it would cost: `scaleup plan`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from scaleup.case.case import Case
from scaleup.case.feasibility import machine_memory
from scaleup.case.vessel_shape import froude_number, require_resolved
from scaleup.flow.source import FlowOutcome, obtain_flow, stored_flow
from scaleup.flow.storage import Store
from scaleup.measure.blend import Blend
from scaleup.measure.sampling import Samples
from scaleup.report.cautions import cautions
from scaleup.run import costs
from scaleup.run.blending import mix
from scaleup.scene.units import LENGTH, SPEED
from scaleup.system.crew import Crew

_TRIALS = (4000.0, 16000.0)  # cells of the runs that are timed
_TRIAL_REVOLUTIONS = 0.5
_FAR = 4.0  # factor in cells beyond which an estimate is a guess
_SNAPSHOT = 10.0  # bytes per active cell and snapshot of results.h5, compressed, at most


def plan(case: Case, ranks: int) -> Iterator[tuple[str, str]]:
    """Lines (what, how it is) on a run; nothing is solved."""
    geometry, operation = case.geometry, case.operation
    name, flow, mixing = (case.name("geometry"), case.name("flow"), case.name("mixing"))
    grid, spacing, fill = case.grid, case.spacing, case.fill_in_all_kinds
    cells = case.fill_volume / grid.cell_volume
    kind = "a cross-section, every other is alike" if grid.dimension == 2 else "a vessel in space"
    yield "model", f"{grid.dimension}-D, because the geometry {name!r} is {kind} as it is set"
    froude = froude_number(geometry, operation.speed)
    yield "flow", f"{flow}, at {SPEED.shown(operation.speed)} (Froude number {froude:.3g})"
    yield "mixing", f"{mixing}, {operation.revolutions:g} revolutions"
    if geometry.symmetry:
        yield "symmetry", "the vessel mirrors in a plane across its axis; a flow model may use it"
    yield "vessel", f"{1e3 * geometry.volume:.4g} litres, reach {1e3 * geometry.reach:.4g} mm"
    yield (
        "bed",
        f"{fill['mass']:.4g} kg, {100 * fill['volume_fraction']:.3g} % of the vessel, loaded "
        f"{operation.loading.pattern}",
    )
    yield (
        "grid",
        f"cells of {LENGTH.shown(spacing)}: {cells:.3g} full ones in the bed, "
        f"{grid.cells:.3g} in the box",
    )
    yield "samples", str(Samples.of(case, grid)).removeprefix("samples of ")
    for sentence in (*case.flow_cautions, *cautions(case, grid)):
        yield "warning", sentence
    snapshots = 2 + operation.revolutions / case.output.snapshots_every
    yield "results", f"up to {1e-6 * snapshots * _SNAPSHOT * cells:.3g} MB in results.h5"
    stored = stored_flow(case).exists()
    expected = costs.estimate(
        costs.known(Store()), geometry=name, flow=flow, mixing=mixing, dimension=grid.dimension,
        cells=cells, ranks=ranks, revolutions=operation.revolutions,
    )  # fmt: skip
    if stored:
        yield "flow time", "none: it is in the store"
    elif expected is None or expected.flow_s is None:
        yield "flow time", "not known: no such flow was solved here; --measure times small ones"
    else:
        yield "flow time", f"about {_duration(expected.flow_s)}, on one rank"
    if expected is None:
        yield "mixing time", "not known: no such run was made here; --measure times small ones"
        return
    total = expected.mixing_s
    words = f"about {_duration(total)} on {ranks} rank(s), {expected.steps:.3g} steps"
    if case.accuracy.estimate:
        share = 0.5 ** (grid.dimension + 1)
        words += f"; the error estimate adds {_duration(share * total)}"
    yield "mixing time", words
    there = machine_memory()
    words = f"about {1e-9 * expected.memory:.2g} GB on the first rank, of {1e-9 * there:.3g} GB"
    yield "memory", words + ("; that is not enough" if expected.memory > there else "")
    sizes = [run.cells for run in expected.basis]
    words = f"{len(sizes)} run(s) on this machine with {min(sizes):,} to {max(sizes):,} cells"
    beyond = max(cells / max(sizes), min(sizes) / cells)
    if beyond > _FAR:
        words += (
            f"; {beyond:.2g} times as many or as few are far off, so it may be wrong by as much"
        )
    yield "scaled from", words


def measure(case: Case, comm: Any) -> None:
    """Run the scene on small grids, for half a revolution, and put on record what that costs."""
    for number, cells in enumerate(_TRIALS):
        trial = case.changed(
            grid={"spacing": None, "cells": cells},
            operation={"revolutions": _TRIAL_REVOLUTIONS},
            accuracy={"estimate": False},
        )
        require_resolved(case.geometry, trial.spacing)
        outcome = obtain_flow(trial, comm)
        blend = mix(trial, outcome.flow, comm, crew=Crew(comm, all_ranks=True))
        if number == 0:  # compiled loops are built in the first run, so its times are not true
            blend = mix(trial, outcome.flow, comm, crew=Crew(comm, all_ranks=True))
        if comm.rank == 0:
            record_run(trial, outcome, blend)


def record_run(case: Case, outcome: FlowOutcome, blend: Blend) -> None:
    """Put on record what a finished run has cost."""
    if blend.ledger.steps == 0:
        return
    flow = outcome.flow
    cost = costs.Cost(
        geometry=case.name("geometry"),
        flow=case.name("flow"),
        mixing=case.name("mixing"),
        dimension=flow.grid.dimension,
        cells=len(flow.intervals[0].cells),
        ranks=blend.ranks,
        revolutions=blend.revolutions[-1],
        steps=blend.ledger.steps,
        flow_s=None if outcome.reused else outcome.seconds,
        mixing_s=blend.seconds,
        memory=costs.peak_memory(),
    )
    costs.record(cost, Store())


def _duration(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"
