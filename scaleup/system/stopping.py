"""Ending a run on request: SIGTERM, SIGINT and SIGUSR1.

While a run mixes it ends at the next safe point, all ranks at the same one, with a checkpoint; if
that takes longer than `_PATIENCE`, or while it does something else, it ends at once, and the last
checkpoint counts. A thread watches, since handlers of Python wait for compiled code to return.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from scaleup.system.errors import ScaleupError

log = logging.getLogger("scaleup")

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
_PATIENCE = 7.0  # s; launchers kill after 10 and more


class StoppedError(ScaleupError):
    """The run was asked to end and did; `scaleup resume` goes on with it."""

    def __init__(self, number: int, sentence: str):
        super().__init__(f"{signal.Signals(number).name}: {sentence}")
        self.exit_code = exit_code(number)
        self._told = number, sentence

    def __reduce__(self) -> tuple[type[StoppedError], tuple[int, str]]:
        return StoppedError, self._told  # pickled, it goes to other ranks


def exit_code(number: int) -> int:
    """130 for SIGINT, as every shell has it, else 75, "try again later" of sysexits.h."""
    return 130 if number == signal.SIGINT else 75


class Stopping:
    """Whether this process was asked to end.

    at_once -- whether it then ends without waiting for a safe point
    """

    def __init__(self) -> None:
        self.at_once = True
        self._number = 0
        self._over = threading.Event()

    @contextmanager
    def heeded(self, last_act: Callable[[], None]) -> Iterator[None]:
        """Watch for signals within the block; `last_act` is done before an end at once."""
        if threading.current_thread() is not threading.main_thread():
            yield  # a program that runs scaleup in a thread keeps its own handlers
            return
        read, write = os.pipe()
        os.set_blocking(write, False)
        previous = {number: signal.signal(number, _nothing) for number in SIGNALS}
        before = signal.set_wakeup_fd(write, warn_on_full_buffer=False)
        watcher = threading.Thread(target=self._watch, args=(read, last_act), daemon=True)
        watcher.start()
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)
            for number, handler in previous.items():
                signal.signal(number, handler)
            self._over.set()
            os.close(write)
            watcher.join()
            os.close(read)

    def asked(self, comm: Any) -> int:
        """The signal that came to any rank of `comm`, 0 if none did (collective)."""
        if comm.size == 1:
            return self._number
        from mpi4py import MPI

        return int(comm.allreduce(self._number, op=MPI.MAX))

    def _watch(self, read: int, last_act: Callable[[], None]) -> None:
        while received := os.read(read, 1):
            if received[0] not in set(SIGNALS):
                continue
            self._number = self._number or received[0]
            if self.at_once or not self._over.wait(_PATIENCE):
                last_act()
                name = signal.Signals(self._number).name
                log.error("%s: ended; the run can go on from its last checkpoint, if any", name)
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(exit_code(self._number))
            return


def _nothing(number: int, frame: Any) -> None:
    """The watching thread acts."""
