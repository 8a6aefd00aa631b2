"""The FlowField of a run: from the store, or solved, checked and stored."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from scaleup import registry, storage
from scaleup.api import Scene
from scaleup.config import RunConfig, fill_volume, grid_spacing
from scaleup.flow_check import check_shared_flow
from scaleup.flow_field import FlowField
from scaleup.grid import Grid, grid_over
from scaleup.parallel import on_each, on_root
from scaleup.progress import Reporter
from scaleup.storage import Store

log = logging.getLogger("scaleup")


@dataclass(frozen=True)
class FlowOutcome:
    """A FlowField and how it was come by."""

    flow: FlowField
    seconds: float
    reused: bool
    key: str


def obtain_flow(config: RunConfig, comm: Any) -> FlowOutcome:
    """The FlowField of a run, from the store or solved and stored; collective."""
    store = Store()
    grid = make_grid(config)
    flow_plugin = registry.load("flow", config.flow["name"])
    geometry_plugin = registry.load("geometry", config.geometry["name"])
    scene_inputs = {
        "geometry": {
            "name": config.geometry["name"],
            **_dump(config.options("geometry")),
            "fingerprint": getattr(config.plugin("geometry"), "fingerprint", ""),
        },
        "material": _dump(config.material),
        "speed": config.operation.speed,
        "fill_volume": fill_volume(config),
    }
    flow_options = {"name": config.flow["name"], **_dump(config.options("flow"))}
    key = storage.content_hash(
        scene_inputs | {"flow": flow_options, "grid": asdict(grid)}, flow_plugin, geometry_plugin
    )
    path = store.path("flow", key)

    if on_root(comm, path.exists):
        log.info("flow: reused from the store (%s)", path.name)
        return FlowOutcome(on_each(comm, partial(storage.read_flow, path)), 0.0, True, key)
    began = time.monotonic()
    scene = Scene(
        geometry=config.plugin("geometry"),
        material=config.material,
        speed=config.operation.speed,
        fill_volume=fill_volume(config),
        grid=grid,
        inputs=scene_inputs,
    )
    with Reporter("flow", visible=comm.rank == 0) as progress:
        memory = store.memory_of(flow_plugin, geometry_plugin)
        flow = config.plugin("flow").solve(scene, comm, progress, memory)
    check_shared_flow(flow, scene.geometry, scene.fill_volume, comm)
    storage.write_flow(path, flow, comm)
    del flow
    seconds = time.monotonic() - began
    log.info("flow: solved in %.1f s and stored (%s)", seconds, path.name)
    return FlowOutcome(on_each(comm, partial(storage.read_flow, path)), seconds, False, key)


def make_grid(config: RunConfig) -> Grid:
    """The grid of a run: equal cells over the vessel."""
    geometry = config.plugin("geometry")
    return grid_over(geometry.lower, geometry.upper, grid_spacing(config), geometry.depth)


def _dump(model: Any) -> dict[str, Any]:
    dumped: dict[str, Any] = model.model_dump(mode="json")
    return dumped
