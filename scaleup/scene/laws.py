"""Laws of mixing: what moves components beside the flow. A model is a sum of them.

The type of a law says what its flux of a component is made of, and a backend states the types that
it solves (`Mixing.laws`). What a law takes from the flow is a function of the FlowField, one of its
intervals and, where directions turn within it, a time in it (s); `scaleup.numerics.Surroundings`
gives shear, depth and directions there.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import ClassVar

import numpy as np

from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray
from scaleup.system.errors import ContractError, InputError


class Law:
    """A term of the model; `name` is what sentences call it."""

    name: ClassVar[str]


@dataclass(frozen=True)
class Diffusion(Law):
    """Flux -D grad c_k of every component k.

    tensor -- (flow, interval) -> D (dimension, dimension, n), m^2/s
    """

    name = "diffusion"
    tensor: Callable[[FlowField, Interval], FloatArray]


@dataclass(frozen=True)
class Drift(Law):
    """Flux c_k (w_k - sum_j c_j w_j) of component k relative to the bulk, as in segregation.

    The fluxes sum to zero, and vanish where a component is pure.

    velocities -- (flow, interval, time) -> w (components, dimension, n), m/s
    """

    name = "drift"
    velocities: Callable[[FlowField, Interval, float], FloatArray]


def total_tensor(laws: Sequence[Law], flow: FlowField, interval: Interval) -> FloatArray:
    """Tensor of all diffusion on an interval (dimension, dimension, n), m^2/s; zeros if none."""
    tensors = [law.tensor(flow, interval) for law in laws if isinstance(law, Diffusion)]
    dimension, n = interval.direction.shape
    return reduce(add, tensors) if tensors else np.zeros((dimension, dimension, n))


def total_drift(laws: Sequence[Law], flow: FlowField, interval: Interval) -> FloatArray | None:
    """Velocities of all drifts (components, dimension, n), m/s, or None if there is none.

    Those at the interval's middle, for the whole of it, as its fluxes are. Raises ContractError for
    a vessel-frame flow of one interval that lasts for ever: directions turn.
    """
    drifts = [law for law in laws if isinstance(law, Drift)]
    if not drifts:
        return None
    if flow.steady and flow.frame == "vessel" and flow.angular_velocity != 0.0:
        raise ContractError(
            "a drift needs a vessel-frame flow in several intervals: gravity turns in its frame"
        )
    middle = 0.5 * (interval.start + interval.end)
    return reduce(add, [law.velocities(flow, interval, middle) for law in drifts])


def require_solved(laws: Sequence[Law], solved: Collection[type[Law]], name: str) -> None:
    """Raise InputError for a law that a backend, called `name`, does not solve."""
    for law in laws:
        if not isinstance(law, tuple(solved)):
            names = " and ".join(sorted(kind.name for kind in solved)) or "no law but the flow"
            raise InputError(
                f"mixing.name = {name!r}: does not solve {law.name}; it solves {names}"
            )
