"""What is built once and used again each time the flow comes back to it, within a budget."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from typing import Any, Protocol, TypeVar

from mpi4py import MPI

_SHARE = 0.5  # of the machine's memory


def budget_of_rank(comm: Any) -> float:
    """Bytes that every rank may keep, the same on all (collective)."""
    here = comm.Split_type(MPI.COMM_TYPE_SHARED)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    budget = _SHARE * memory / here.Get_size()
    here.Free()
    return float(comm.allreduce(budget, op=MPI.MIN))


class Sized(Protocol):
    """Something that knows the memory it holds, in bytes."""

    @property
    def bytes(self) -> int:
        """Memory held."""
        ...


T = TypeVar("T", bound=Sized)


class Kept:
    """A store that every rank fills alike, so that what is built collectively stays so.

    What does not fit is built anew each time: a periodic flow comes back to the oldest first, so
    the oldest are the ones worth keeping.
    """

    def __init__(self, budget: float, largest: Callable[[float], float]):
        """`budget`: bytes on a rank; `largest`: the greatest of the ranks' values (collective)."""
        self._left, self._largest = budget, largest
        self._held: dict[Hashable, Any] = {}

    def get(self, key: Hashable, build: Callable[[], T]) -> T:
        """The one of this key: kept, or built (collective)."""
        if key in self._held:
            found: T = self._held[key]
            return found
        built = build()
        size = self._largest(built.bytes)
        if size <= self._left:
            self._left -= size
            self._held[key] = built
        return built
