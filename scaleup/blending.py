"""Blending: concentration moved on a flow by a mixing backend, and measured along the way."""

from __future__ import annotations

import logging
import math
import time
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scaleup import storage
from scaleup.api import Ledger, MixingScene
from scaleup.config import RunConfig
from scaleup.decomposition import Decomposition
from scaleup.diffusion_tensor import diffusion_tensor
from scaleup.flow_field import FlowField, Interval
from scaleup.grid import FloatArray
from scaleup.loading import initial_concentration
from scaleup.metrics import Sampler, centre_line
from scaleup.mixing_check import CheckedMixing
from scaleup.progress import Reporter
from scaleup.results import FRAMES, PHASES, Results, instants

log = logging.getLogger("scaleup")


@dataclass
class Blend:
    """The blend curve of one mixing run; lists have one entry per point of the curve.

    intensity, intensity_sample -- of component 1
    lacey, rsd -- of the component that is blended worst
    volumes  -- of each component, m^3
    sample_volume -- m^3 of powder in a sample, on the average
    elapsed  -- s of wall-clock time, those before a resumption included
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
) -> Blend:
    """Blend on a flow and measure it along the way; collective.

    force      -- go on with steps beyond the limit of stability
    results    -- where snapshots go, or None
    checkpoint -- where the state is kept; if the file exists the run goes on from it
    """
    root = comm.rank == 0
    period = config.operation.period
    # The clock of the flow starts when the bed begins to flow; rigid lifting comes before.
    waited = flow.lift / (2 * math.pi) if config.operation.start == "level-bed" else 0.0
    curve = _curve_points(config)
    pictures = _picture_points(config, flow) if results is not None else set()
    points = sorted(curve | pictures)
    blend, first, index, local = Blend(), 0, 0, 0.0
    concentration = initial_concentration(config.operation.loading, flow)
    resumed = checkpoint is not None and checkpoint.exists()
    if checkpoint is not None and resumed:
        arrays, state = storage.read_checkpoint(checkpoint)
        concentration, first = arrays["concentration"], state["point"]
        index, local = state["interval"], state["time"]
        blend = Blend(**{**state["blend"], "ledger": Ledger(**state["blend"]["ledger"])})
        log.info("resumed at revolution %.3f", points[first])
    backend = CheckedMixing(config.plugin("mixing"), config.mixing["name"])
    split = Decomposition(flow.grid, flow.ever_active(), comm, halo=backend.halo)
    tensor = partial(_tensor, flow=flow, config=config)
    grain = config.material.grain_diameter

    def begin(revolution: float) -> None:
        law = tensor if revolution >= round(config.diffusion.after, 9) else _no_diffusion
        scene = MixingScene(flow, config.diffusion, grain, split, law, force)
        backend.start(scene, concentration, index, local)

    begin(points[first])
    began = last_kept = time.monotonic() - blend.seconds
    with Reporter("mixing", visible=root and results is not None) as progress:
        for number in range(first, len(points)):
            revolution = points[number]
            now = max(0.0, (revolution - waited) * period)
            if number > first:
                before = max(0.0, (points[number - 1] - waited) * period)
                for index, start, local in flow.schedule(before, now):
                    blend.ledger.add(backend.advance(index, start, local))
            interval = flow.intervals[index]
            local = min(max(local, interval.start), interval.end)  # a steady part has no end
            concentration = backend.concentration(interval, local)
            if revolution in curve and not (resumed and number == first):
                _measure(blend, config, flow, interval, local, revolution, concentration)
                blend.elapsed.append(time.monotonic() - began)
            if results is not None and root:
                if number == 0:
                    results.create()
                if revolution in pictures:
                    results.add_picture(revolution, interval, local, concentration)
                if _is_snapshot(config, revolution, number, len(points)):
                    results.add(revolution, interval, local, concentration)
                    _profile(blend, flow, interval, revolution, concentration)
            progress(
                (number + 1) / len(points),
                f"revolution {revolution:.2f}, I = {blend.intensity[-1]:.3f}",
            )
            if number > first and revolution == round(config.diffusion.after, 9):
                begin(revolution)
            blend.seconds = time.monotonic() - began
            due = time.monotonic() - last_kept >= config.output.checkpoint_every
            if checkpoint is not None and root and (due or number == len(points) - 1):
                last_kept = time.monotonic()
                storage.write_checkpoint(
                    checkpoint,
                    {"concentration": concentration},
                    {"point": number, "interval": index, "time": local, "blend": asdict(blend)},
                )
    return blend


def _tensor(interval: Interval, flow: FlowField, config: RunConfig) -> FloatArray:
    return diffusion_tensor(flow, interval, config.diffusion, config.material.grain_diameter)


def _no_diffusion(interval: Interval) -> FloatArray:
    dimension, n = interval.direction.shape
    return np.zeros((dimension, dimension, n))


def _measure(
    blend: Blend,
    config: RunConfig,
    flow: FlowField,
    interval: Interval,
    time_in_interval: float,
    revolution: float,
    concentration: FloatArray,
) -> None:
    sampler = Sampler(flow.grid, interval, time_in_interval, config.sample_edge)
    components = [sampler.measure(component) for component in concentration]
    blend.revolutions.append(revolution)
    blend.intensity.append(components[0].intensity)
    blend.intensity_sample.append(components[0].intensity_sample)
    blend.lacey.append(min(component.lacey for component in components))
    blend.rsd.append(max(component.rsd for component in components))
    # numpy's pairwise sum: a dot product of as many equal terms is off by 1e-12
    held = (concentration * interval.fill(time_in_interval)).sum(axis=1)
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


def _curve_points(config: RunConfig) -> set[float]:
    """Revolutions at which the blend is measured: multiples of the asked steps, and the last.

    Also where diffusion sets in.
    """
    last, every = config.operation.revolutions, config.output.metrics_every
    points = {round(n * every, 9) for n in range(math.floor(last / every + 1e-9) + 1)}
    snapshots = config.output.snapshots_every
    points |= {round(n * snapshots, 9) for n in range(math.floor(last / snapshots + 1e-9) + 1)}
    sets_in = round(config.diffusion.after, 9)
    return points | {last} | ({sets_in} if sets_in < last else set())


def _picture_points(config: RunConfig, flow: FlowField) -> set[float]:
    """Revolutions at which pictures are taken: of the first and the last one, in equal steps.

    A bed that stands still in the lab needs none but for an animation.
    """
    last, asked = config.operation.revolutions, config.output.animate
    points: set[float] = set()
    for name in ("first", "last"):
        animated = asked in (name, "both")
        if animated or flow.frame == "vessel":
            points |= set(instants(name, last, FRAMES if animated else PHASES))
    return points


def _is_snapshot(config: RunConfig, revolution: float, number: int, count: int) -> bool:
    turns = revolution / config.output.snapshots_every
    return number in (0, count - 1) or abs(turns - round(turns)) < 1e-6
