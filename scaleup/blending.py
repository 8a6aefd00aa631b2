"""Blending: concentration moved on a flow by a mixing backend, and measured along the way."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scaleup import storage
from scaleup.api import Ledger, MixingScene
from scaleup.config import RunConfig
from scaleup.crew import Crew
from scaleup.decomposition import Decomposition
from scaleup.diffusion_tensor import diffusion_tensor
from scaleup.errors import InputError
from scaleup.flow_field import FlowField, Interval
from scaleup.grid import FloatArray
from scaleup.loading import initial_concentration
from scaleup.march import State, march
from scaleup.metrics import Sampler, centre_line
from scaleup.mixing_check import CheckedMixing
from scaleup.parallel import on_each, on_root
from scaleup.progress import Reporter
from scaleup.results import FRAMES, PHASES, Results, instants, require_instants
from scaleup.resumption import identity, read_state
from scaleup.stopping import StoppedError, Stopping

log = logging.getLogger("scaleup")


@dataclass
class Blend:
    """The blend curve of one mixing run; lists have one entry per point of the curve.

    intensity, intensity_sample -- of component 1
    lacey, rsd -- of the component that is blended worst
    volumes  -- of each component, m^3
    sample_volume -- m^3 of powder in a sample, on the average
    ranks    -- how many worked, at the most
    elapsed  -- s of wall-clock time, those before a resumption included
    remarks  -- sentences on how the run went that its reader should know
    profiles -- by revolution: depth below the surface over bed depth, and concentration
    """

    revolutions: list[float] = field(default_factory=list)
    intensity: list[float] = field(default_factory=list)
    intensity_sample: list[float] = field(default_factory=list)
    lacey: list[float] = field(default_factory=list)
    rsd: list[float] = field(default_factory=list)
    volumes: list[list[float]] = field(default_factory=list)
    elapsed: list[float] = field(default_factory=list)
    profiles: dict[str, list[list[float]]] = field(default_factory=dict)
    ledger: Ledger = field(default_factory=Ledger)
    seconds: float = 0.0
    sample_volume: float = 0.0
    ranks: int = 0
    remarks: list[str] = field(default_factory=list)

    @property
    def mass_drift(self) -> float:
        """Greatest relative change of a component's volume."""
        volumes = np.array(self.volumes)
        return float(np.abs(volumes / volumes[0] - 1.0).max())


def mix(
    config: RunConfig,
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
    """
    root = comm.rank == 0
    plan = Plan.of(config, flow, with_pictures=results is not None)
    blend, reached = Blend(), -1
    if checkpoint is not None and on_root(comm, checkpoint.exists):
        begin, blend, reached = on_each(
            comm, partial(_resumed_state, checkpoint, config, flow, changed_code, plan)
        )
        log.info("resumed at revolution %.3f", plan.points[reached])
    else:
        begin = State(initial_concentration(config.operation.loading, flow))

    def keep(state: State, revolution: float) -> None:
        if checkpoint is not None and root:
            kept = {
                "run": identity(config),
                "revolution": revolution,
                "interval": state.index,
                "time": state.local,
                "clock": state.clock,
                "blend": asdict(blend),
                "instants": plan.instants(revolution) if results is not None else {},
            }
            storage.write_checkpoint(checkpoint, {"concentration": state.concentration}, kept)

    with (
        crew or Crew(comm) as crew,
        Reporter("mixing", visible=root and results is not None) as progress,
    ):

        def asked() -> int:
            return stopping.asked(crew.comm) if stopping is not None else 0

        last_kept = time.monotonic()
        began = last_kept - blend.seconds
        for number, state in _states(config, flow, plan, begin, reached, crew, asked, force):
            revolution, interval = plan.points[number], flow.intervals[state.index]
            if results is not None and root and number == 0 and not state.paused:
                results.create()
            if revolution in plan.curve and not state.paused:
                _measure(blend, config, flow, state, revolution)
                blend.elapsed.append(time.monotonic() - began)
            if results is not None and root and not state.paused:
                if revolution in plan.pictures:
                    results.add_picture(revolution, interval, state.local, state.concentration)
                if revolution in plan.snapshots:
                    results.add(revolution, interval, state.local, state.concentration)
                    _profile(blend, flow, interval, revolution, state.concentration)
            progress(
                (number + 1) / len(plan.points),
                f"revolution {revolution:.2f}, I = {blend.intensity[-1]:.3f}",
            )
            blend.seconds, blend.ledger = time.monotonic() - began, state.ledger
            blend.ranks = max(blend.ranks, crew.size)
            if revolution > plan.final:
                continue
            stop = state.paused or asked()
            due = time.monotonic() - last_kept >= config.output.checkpoint_every
            if stop or due or revolution == plan.final:
                last_kept = time.monotonic()
                keep(state, revolution)
            if stop:
                kept = "no checkpoint was asked for"
                if checkpoint is not None:
                    kept = "the run can go on from its checkpoint (scaleup resume)"
                raise StoppedError(stop, f"ended after revolution {revolution:g}; {kept}")
    if results is not None:
        on_root(comm, partial(results.finish, plan.instants(plan.points[-1])))
    # a rank that sat out has seen but a part
    return blend if comm.size == 1 else comm.bcast(blend)


def _states(
    config: RunConfig,
    flow: FlowField,
    plan: Plan,
    state: State,
    reached: int,
    crew: Crew,
    asked: Callable[[], int],
    force: bool,
) -> Iterator[tuple[int, State]]:
    """(number of the last point reached, state) from point to point, on the ranks that work.

    The backend starts again when diffusion sets in and when other ranks work. Where the run is
    asked to end there is a paused state, too.
    """
    backend = CheckedMixing(config.plugin("mixing"), config.mixing["name"])
    period, sets_in = config.operation.period, round(config.diffusion.after, 9)
    # The clock of the flow starts when the bed begins to flow; rigid lifting comes before.
    waited = flow.lift / (2 * math.pi) if config.operation.start == "level-bed" else 0.0
    times = [max(0.0, (revolution - waited) * period) for revolution in plan.points]
    tensor = partial(_tensor, flow=flow, config=config)
    grain, last = config.material.grain_diameter, len(times) - 1
    while reached < last:
        crew.muster()
        if crew.comm is None:
            state, reached = crew.rest()
            continue
        began = time.monotonic()
        split = Decomposition(flow.grid, flow.ever_active(), crew.comm, halo=backend.halo)
        diffuses = plan.points[max(reached, 0)] >= sets_in
        law = tensor if diffuses else _no_diffusion
        scene = MixingScene(flow, config.diffusion, grain, split, law, force)
        backend.start(scene, state.concentration, state.index, state.local)
        restart = time.monotonic() - began
        steps = march(flow, backend, times[reached + 1 :], state, pause=asked)
        for state in steps:
            reached += not state.paused
            yield reached, state
            sets_in_now = plan.points[reached] >= sets_in and not diffuses
            if crew.wants_change(restart) or sets_in_now:
                break
        if crew.due or reached == last:
            crew.call((state, reached))


def check_resumable(config: RunConfig, checkpoint: Path, *, changed_code: bool) -> None:
    """Raise InputError if a run cannot go on from its checkpoint, before anything is computed."""
    if not checkpoint.exists():
        return
    _, state = read_state(checkpoint, config, changed_code=changed_code)
    require_instants(checkpoint.parent, state["instants"])


def _resumed_state(
    checkpoint: Path, config: RunConfig, flow: FlowField, changed_code: bool, plan: Plan
) -> tuple[State, Blend, int]:
    """State, curve and number of the last point reached of a checkpoint."""
    concentration, kept = read_state(checkpoint, config, changed_code=changed_code)
    index = kept["interval"]
    cells = len(flow.intervals[index].cells) if 0 <= index < len(flow.intervals) else -1
    if concentration.shape[1:] != (cells,) or not np.isfinite(concentration).all():
        raise InputError(f"{checkpoint}: does not fit the flow; simulate the run again")
    blend = Blend(**{**kept["blend"], "ledger": Ledger(**kept["blend"]["ledger"])})
    blend.profiles = {
        key: profile for key, profile in blend.profiles.items() if float(key) in plan.snapshots
    }
    state = State(concentration, kept["clock"], index, kept["time"], blend.ledger)
    return state, blend, plan.points.index(kept["revolution"])


def _tensor(interval: Interval, flow: FlowField, config: RunConfig) -> FloatArray:
    return diffusion_tensor(flow, interval, config.diffusion, config.material.grain_diameter)


def _no_diffusion(interval: Interval) -> FloatArray:
    dimension, n = interval.direction.shape
    return np.zeros((dimension, dimension, n))


def _measure(
    blend: Blend,
    config: RunConfig,
    flow: FlowField,
    state: State,
    revolution: float,
) -> None:
    interval = flow.intervals[state.index]
    sampler = Sampler(flow.grid, interval, state.local, config.sample_edge)
    components = [sampler.measure(component) for component in state.concentration]
    blend.revolutions.append(revolution)
    blend.intensity.append(components[0].intensity)
    blend.intensity_sample.append(components[0].intensity_sample)
    blend.lacey.append(min(component.lacey for component in components))
    blend.rsd.append(max(component.rsd for component in components))
    # numpy's pairwise sum: a dot product of as many equal terms is off by 1e-12
    held = (state.concentration * interval.fill(state.local)).sum(axis=1)
    blend.volumes.append(held.tolist())
    blend.sample_volume = sampler.sample_volume


def _profile(
    blend: Blend, flow: FlowField, interval: Interval, revolution: float, c: FloatArray
) -> None:
    angle = flow.summary.get("surface_angle_deg")
    if flow.frame != "lab" or flow.grid.dimension != 2 or not isinstance(angle, float):
        return
    depth, values = centre_line(flow.grid, interval, c[0], math.radians(angle))
    blend.profiles[f"{revolution:.4f}"] = [depth.tolist(), values.tolist()]


@dataclass(frozen=True)
class Plan:
    """The revolutions at which a run pauses, those where steps end among them, ascending.

    points    -- all of them, from 0 to the last
    curve     -- where the blend is measured
    snapshots, pictures -- where fields are stored
    final     -- the last one at which a longer run would pause, too: from there it can be extended
                 with the very steps of a run of that length
    """

    points: tuple[float, ...]
    curve: frozenset[float]
    snapshots: frozenset[float]
    pictures: frozenset[float]
    final: float

    @staticmethod
    def of(config: RunConfig, flow: FlowField, *, with_pictures: bool) -> Plan:
        """The plan of a run.

        The blend is measured at multiples of the asked steps, where diffusion sets in, and at the
        end. Pictures are of the first and the last revolution, but steps end at their phases all
        along, so that what is computed does not depend on which revolution is the last one.
        """
        last, output = round(config.operation.revolutions, 9), config.output
        snapshots = _multiples(output.snapshots_every, last)
        sets_in = round(config.diffusion.after, 9)
        curve = snapshots | _multiples(output.metrics_every, last)
        curve |= {sets_in} if sets_in <= last else set()
        pictures: set[float] = set()
        regular = set(curve)
        for which in ("first", "last") if with_pictures else ():
            animated = output.animate in (which, "both")
            if animated or flow.frame == "vessel":  # a bed that stands still in the lab needs none
                count = FRAMES if animated else PHASES
                pictures |= set(instants(which if last > 1 else "first", last, count))
                regular |= {round(n / count, 9) for n in range(math.floor(last * count + 1e-9) + 1)}
        return Plan(
            points=tuple(sorted(regular | {last})),
            curve=frozenset(curve | {last}),
            snapshots=frozenset(snapshots | {last}),
            pictures=frozenset(pictures),
            final=max(regular),
        )

    def instants(self, until: float) -> dict[str, list[float]]:
        """Revolutions, by kind, whose fields are stored until one."""
        kinds = {"snapshots": self.snapshots, "pictures": self.pictures}
        return {
            kind: sorted(at for at in revolutions if at <= until)
            for kind, revolutions in kinds.items()
        }


def _multiples(every: float, last: float) -> set[float]:
    return {round(n * every, 9) for n in range(math.floor(last / every + 1e-9) + 1)}
