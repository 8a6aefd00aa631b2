"""Keeps a turned vessel between runs: a checkpoint to go on from, or the end for any grid."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scaleup.contract import Memory
from scaleup.numerics import on_root, on_root_alone

from .revolutions import Turned

if TYPE_CHECKING:
    from .space_flow import VesselFlow

_SECONDS_BETWEEN = 120.0
_NUMBERS = ("per_revolution", "prefix", "mismatch", "retries", "seconds")
_INTEGERS = ("per_revolution", "prefix", "retries")


class TurnedMemory:
    """What is kept of a scene; collective, and of use to as many ranks as have kept it alone."""

    def __init__(self, memory: Memory, inputs: Mapping[str, Any], flow: VesselFlow, comm: Any):
        self._memory, self._flow, self._comm = memory, flow, comm
        self._inputs = {**inputs, "stage": "turned", "ranks": comm.size}
        points = [vertex.point for vertex in flow.mesh.vertices]
        self._vertices = np.array(points).reshape(-1, 3)
        self._last = time.monotonic()

    def recall(self) -> Turned | None:
        """What was kept of this mesh, with the flow put where it then was; None if nothing."""
        comm = self._comm
        whole = on_root(comm, lambda: self._memory.recall(self._inputs))
        if whole is None:
            return None
        prefix = f"{comm.rank}."
        own = {name[len(prefix) :]: a for name, a in whole.items() if name.startswith(prefix)}
        if not comm.allreduce(bool(np.array_equal(own.get("vertices"), self._vertices)), _both):
            return None
        self._flow.restore({n[5:]: a for n, a in own.items() if n.startswith("flow.")})
        numbers = dict(zip(_NUMBERS, own["numbers"].tolist(), strict=True))
        still = len(own["levels"]) - 1 - len(own["velocities"])
        return Turned(
            levels=list(own["levels"]),
            velocities=[*[None] * still, *own["velocities"]],
            angles=own["angles"].tolist(),
            **{n: int(v) if n in _INTEGERS else v for n, v in numbers.items()},
        )

    def keep(self, run: Turned, *, now: bool) -> None:
        """Keep the run as it stands; unless ``now``, only if the last time was long ago."""
        comm = self._comm
        if not comm.bcast(now or time.monotonic() - self._last > _SECONDS_BETWEEN):
            return
        moving: list[NDArray[Any]] = [v for v in run.velocities if v is not None]
        own: dict[str, NDArray[Any]] = {
            "vertices": self._vertices,
            "levels": np.stack(run.levels),
            "velocities": np.array(moving).reshape(len(moving), -1),
            "angles": np.array(run.angles),
            "numbers": np.array([getattr(run, name) for name in _NUMBERS], dtype=float),
        }
        own |= {f"flow.{name}": data for name, data in self._flow.state().items()}
        parts = comm.gather(own)

        def write() -> None:
            named = {f"{rank}.{n}": a for rank, part in enumerate(parts) for n, a in part.items()}
            self._memory.keep(self._inputs, named)

        on_root_alone(comm, write)
        self._last = time.monotonic()


def _both(first: bool, second: bool) -> bool:
    return first and second
