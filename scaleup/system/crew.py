"""The ranks that work: as many as a machine has cores for, beside what else runs on it.

Ranks meet several times a step. One whose core is taken by another process comes late to every
meeting and keeps all the others waiting: two ranks that share two cores with a busy process take
twice as long as one rank. So ranks for which the machine has no core to spare sit out, asleep, and
are called back when it has one again.
"""

from __future__ import annotations

import logging
import math
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from scaleup.system.blame import told
from scaleup.system.errors import ScaleupError

log = logging.getLogger("scaleup")

ALL_RANKS = "SCALEUP_ALL_RANKS"
"""environment variable; unless empty, nobody sits out"""

_PROCESSOR_TIMES = Path("/proc/stat")
_LOOK = 0.25  # s for which all ranks sleep, to see what the machine does without them
_POLL = 0.02  # s between two looks of a rank that sleeps
_LEAST_SHARE = 0.7  # of a core, for which it is worth to have a rank more
_LEAST_STAY = 2.0  # s until a crew is looked at again
_DEAREST_CHANGE = 0.05  # what a change may take, as a part of the time since the last one


class Crew:
    """Which ranks of a communicator work; all methods but `rest` and `call` are collective.

    comm -- the communicator of the ranks that work, None on one that sits out
    size -- how many work; on every machine at least one, and the root always
    due  -- whether to `muster` anew

    Used in a `with` block: a ScaleupError that leaves it on the root reaches those that sit out.
    """

    def __init__(self, world: Any, *, all_ranks: bool = False):
        """`all_ranks`: nobody sits out, whatever else the machines do."""
        self.comm, self.size = world, world.size
        self._world, self._resting = world, list[int]()
        self._fixed = (
            all_ranks
            or world.size == 1
            or bool(os.environ.get(ALL_RANKS))
            or not _PROCESSOR_TIMES.exists()
        )
        self.due = True
        if not self._fixed:
            from mpi4py import MPI

            self._world = world.Dup()  # for calls: others may be anywhere in the given one
            self._machine = self._here = self._world.Split_type(MPI.COMM_TYPE_SHARED)
            bound = self._machine.allgather(os.sched_getaffinity(0))
            self._clock = _Clock(set().union(*bound))
            self._changed = self._cost = 0.0

    def muster(self) -> None:
        """Choose who works, if that is due; collective over all, those called who sat out."""
        if self._fixed or not self.due:
            return
        began = time.monotonic()
        _all_asleep(self._world)
        self._clock.start()
        time.sleep(_LOOK)
        works = self._machine.rank < self._wanted(self._machine)
        working = self._world.Split(0 if works else 1, self._world.rank)
        everybody = self._world.allgather(works)
        self._resting = [rank for rank, one_works in enumerate(everybody) if not one_works]
        self.comm, size = (working if works else None), sum(everybody)
        self._here = self._machine.Split(0 if works else 1, self._machine.rank)
        if size != self.size:
            log.info("%d of %d ranks mix: other processes use this machine's cores "
                     "(--all-ranks: all do)" if size < self.size else "%d of %d ranks mix",
                     size, self._world.size)  # fmt: skip
        self.size, self.due = size, False
        self._changed = time.monotonic()
        self._cost = self._changed - began
        self._clock.start()

    def wants_change(self, restart: float) -> bool:
        """Whether fewer or more ranks should work; collective over `comm`.

        restart -- s that this rank's work takes to begin anew
        """
        if self._fixed:
            return False
        patience = max(_LEAST_STAY, (self._cost + restart) / _DEAREST_CHANGE)
        if not self.comm.bcast(time.monotonic() - self._changed > patience):
            return False
        differs = self._wanted(self._here) != self._here.size
        self._changed = time.monotonic()
        self._clock.start()
        self.due = any(self.comm.allgather(differs))
        return self.due

    def call(self, message: Any) -> None:
        """Wake the ranks that sit out with a message; does nothing but on the root."""
        if self._world.rank == 0:
            for rank in self._resting:
                self._world.send((message, self.due), dest=rank)

    def rest(self) -> Any:
        """Sleep until the root calls, and return its message. Raises the root's ScaleupError."""
        while not self._world.Iprobe(source=0):
            time.sleep(_POLL)
        message, self.due = self._world.recv(source=0)
        if isinstance(message, ScaleupError):
            raise message
        return message

    def _wanted(self, ranks: Any) -> int:
        """How many should work on this machine: those there, by what they get and what is idle."""
        own = sum(ranks.allgather(self._clock.own()))
        spare: float = own + ranks.bcast(self._clock.idle())
        enough = max(1, math.floor(spare + 1.0 - _LEAST_SHARE))
        return min(int(self._machine.size), enough)

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        if isinstance(error, Exception):
            self.call(told(error))


class _Clock:
    """What this process has had of the processor, and how idle its cores were, since a start."""

    def __init__(self, cores: set[int]):
        self._lines = {f"cpu{core}" for core in cores}
        self.start()

    def start(self) -> None:
        self._wall, self._own, self._idle = time.monotonic(), time.process_time(), self._idle_time()

    def own(self) -> float:
        """Cores that this process has used on the average."""
        return (time.process_time() - self._own) / (time.monotonic() - self._wall)

    def idle(self) -> float:
        """Cores that nobody has used on the average."""
        return (self._idle_time() - self._idle) / (time.monotonic() - self._wall)

    def _idle_time(self) -> float:
        """Time (s) that the cores have been idle in all, those that wait for a disk included."""
        rows = [line.split() for line in _PROCESSOR_TIMES.read_text().splitlines()]
        ticks = sum(int(row[4]) + int(row[5]) for row in rows if row[0] in self._lines)
        return ticks / float(os.sysconf("SC_CLK_TCK"))


def _all_asleep(comm: Any) -> None:
    """Wait for all ranks, asleep (collective)."""
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(_POLL)
