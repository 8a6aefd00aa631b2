"""The FlowField of a run: from the store, or solved, checked and stored."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scaleup.case.case import Case
from scaleup.case.vessel_shape import bed_depth, froude_number
from scaleup.contract import Scene
from scaleup.flow import storage
from scaleup.flow.bed_lean import require_held
from scaleup.flow.bed_support import critical_height
from scaleup.flow.check import check_shared_flow
from scaleup.flow.storage import Store
from scaleup.space.compact_intervals import CompactInterval, CompactIntervals
from scaleup.space.flow_field import FlowField
from scaleup.system.blame import blamed_on
from scaleup.system.errors import ContractError
from scaleup.system.hdf5 import DamagedFileError
from scaleup.system.parallel import on_each, on_root
from scaleup.system.progress import Reporter

_LOOSE = 0.1  # critical height over the bed's depth, below which the powder is as good as loose

log = logging.getLogger("scaleup")


@dataclass(frozen=True)
class FlowOutcome:
    """A FlowField and how it was come by."""

    flow: FlowField
    seconds: float
    reused: bool
    key: str


@dataclass(frozen=True)
class _Wanted:
    """A flow that a run needs: its inputs but for the grid, and where it is kept."""

    inputs: dict[str, Any]
    key: str
    path: Path


def stored_flow(case: Case) -> Path:
    """Where the store keeps the flow of a run, once it is solved."""
    return _wanted(case).path


def obtain_flow(case: Case, comm: Any) -> FlowOutcome:
    """The FlowField of a run, from the store or solved and stored; collective.

    A stored flow is checked as a new one is; one that fails is set aside and solved again.

    >>> from mpi4py import MPI
    >>> from scaleup.case.composing import compose
    >>> case = compose(None, ["flow.name=surface-layer", "grid.cells=300"])
    >>> outcome = obtain_flow(case, MPI.COMM_WORLD)
    >>> outcome.flow.frame, outcome.flow.summary["surface_angle_deg"]
    ('lab', 23.6)
    >>> obtain_flow(case, MPI.COMM_WORLD).reused
    True
    """
    store, wanted = Store(), _wanted(case)
    path, scene = wanted.path, case.scene(wanted.inputs)
    if on_root(comm, partial(os.path.lexists, path)):
        try:
            flow = _reused(path, scene, comm)
            log.info("flow: reused from the store (%s)", path.name)
            return FlowOutcome(flow, 0.0, True, wanted.key)
        except (DamagedFileError, ContractError) as error:
            on_root(comm, partial(store.set_aside, path, f"{path.name} cannot be used: {error}"))
            log.info("flow: solving it again")
    began = time.monotonic()
    memory, model = store.memory_of(*_plugins(case)), case.flow
    with blamed_on("flow", case.name("flow")):
        with Reporter("flow", visible=comm.rank == 0) as progress:
            solved = model.solve(scene, comm, progress, memory)
        if isinstance(solved, FlowField):
            solved = replace(solved, warnings=(*case.flow_cautions, *solved.warnings))
        leans = check_shared_flow(solved, scene.geometry, scene.fill_volume, comm)
    solved = _judged(solved, leans, scene)
    storage.write_flow(path, solved, comm)
    del solved
    flow = on_each(comm, partial(storage.read_flow, path))
    seconds = time.monotonic() - began
    log.info("flow: solved in %.1f s and stored (%s)", seconds, path.name)
    return FlowOutcome(flow, seconds, False, wanted.key)


def _judged(flow: FlowField | None, leans: tuple[float, float], scene: Scene) -> FlowField | None:
    """A flow that states how far its bed leans. Raises RunError, on all ranks, if it hangs.

    leans -- least and greatest, rad. Cohesive powder may hang.
    """
    if critical_height(scene.material) < _LOOSE * bed_depth(scene.geometry, scene.fill_volume):
        froude = froude_number(scene.geometry, scene.speed)
        require_held(*leans, scene.material.friction_angle, froude)
    if flow is None:
        return None
    degrees = [math.degrees(lean) for lean in leans]
    return replace(flow, summary={**flow.summary, "bed_lean_deg": degrees})


def _reused(path: Path, scene: Scene, comm: Any) -> FlowField:
    """A stored flow; every rank checks its share of the intervals.

    Raises DamagedFileError or ContractError, on all ranks.
    """

    def open_own() -> FlowField:
        flow = storage.read_flow(path)
        if flow.grid != scene.grid:
            raise DamagedFileError(f"{path}: is of another grid")
        return flow

    flow = on_each(comm, open_own)
    whole, bounds = flow.intervals, np.linspace(0, len(flow.intervals), comm.size + 1).astype(int)
    assert isinstance(whole, CompactIntervals)  # as stored flows are
    own = range(bounds[comm.rank], bounds[comm.rank + 1])
    share = CompactIntervals(_Share(whole.parts, own), whole.times, whole.capacity, own.start)
    check_shared_flow(replace(flow, intervals=share), scene.geometry, scene.fill_volume, comm)
    return flow


class _Share(Sequence[CompactInterval]):
    """Consecutive ones of many intervals, read when asked for."""

    def __init__(self, parts: Sequence[CompactInterval], numbers: range):
        self._parts, self._numbers = parts, numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        return self._parts[self._numbers[index]]


def _wanted(case: Case) -> _Wanted:
    inputs = {
        "geometry": {
            "name": case.name("geometry"),
            **_dump(case.options("geometry")),
            "fingerprint": case.geometry.fingerprint,
        },
        "material": _dump(case.material, exclude={"provenance"}),
        "speed": case.operation.speed,
        "fill_volume": case.fill_volume,
    }
    flow_options = {"name": case.name("flow"), **_dump(case.options("flow"))}
    key = storage.content_hash(
        inputs | {"flow": flow_options, "grid": asdict(case.grid)}, *_plugins(case)
    )
    return _Wanted(inputs, key, Store().path("flow", key))


def _plugins(case: Case) -> tuple[Any, Any]:
    """The classes that a flow comes from."""
    return case.plugin_class("flow"), case.plugin_class("geometry")


def _dump(model: Any, **how: Any) -> dict[str, Any]:
    dumped: dict[str, Any] = model.model_dump(mode="json", **how)
    return dumped
