"""MPI: a late start, an abort that leaves no rank waiting, and errors that reach all ranks."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any, TypeVar

from scaleup.system.blame import told
from scaleup.system.errors import ScaleupError
from scaleup.system.launch import check_world

T = TypeVar("T")

_POLL_SECONDS = 0.02
_PATIENCE = 3.0  # s that a rank which ends waits for the others to end too
_end: Any = None  # a communicator for that alone: others may be at any point of the world's


def start() -> Any:
    """Start MPI and PETSc and return the world communicator (mpi4py).

    From here on an exception that nobody catches on one rank ends all of them; without that the
    others would wait for it for ever. Raises InputError if the launcher started more ranks than MPI
    connects.
    """
    global _end
    # Open MPI's waiting ranks spin; on a busy machine they then take the cores of those that work.
    os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    check_world(comm.size)
    if comm.size > 1:
        _end = comm.Dup()
        previous = sys.excepthook

        def abort(kind: Any, error: Any, traceback: Any) -> None:
            previous(kind, error, traceback)
            sys.stderr.flush()
            comm.Abort(1)

        sys.excepthook = abort
    import petsc4py

    # what a .petscrc of the working folder or the home says is not in the run's configuration
    petsc4py.init([*sys.argv[:1], "-skip_petscrc"])
    return comm


def all_end() -> bool:
    """Whether all ranks come here, within some seconds: to end, or for the same error."""
    if _end is None:
        return True
    request, patience = _end.Ibarrier(), time.monotonic() + _PATIENCE
    while not request.Test():
        if time.monotonic() > patience:
            return False
        time.sleep(_POLL_SECONDS)
    return True


def end_all(code: int) -> None:
    """End every rank, wherever it is, with an exit code."""
    if _end is not None:
        _end.Abort(code)


def on_root(comm: Any, work: Callable[[], T]) -> T:
    """Run `work` on rank 0 and return its result on every rank.

    The other ranks sleep meanwhile instead of spinning, so that the root may use their cores. An
    error on the root is raised on every rank.
    """
    result = on_root_alone(comm, work)
    if comm.size > 1:
        result = comm.bcast(result, root=0)
    return result  # type: ignore[return-value]  # every rank has the root's by now


def on_root_alone(comm: Any, work: Callable[[], T]) -> T | None:
    """As `on_root`, but the result stays on rank 0; the others get None."""
    result, failure = _tried(work) if comm.rank == 0 else (None, None)
    if comm.size > 1:
        request = comm.Ibarrier()
        while not request.Test():
            time.sleep(_POLL_SECONDS)
        failure = comm.bcast(failure, root=0)
    if failure is not None:
        raise failure
    return result


def on_each(comm: Any, work: Callable[[], T]) -> T:
    """Run `work`, which must not communicate, on every rank; returns each rank's own result.

    An error on any rank is raised on every rank: that of the lowest one.
    """
    result, failure = _tried(work)
    if comm.size > 1:
        failures = [error for error in comm.allgather(failure) if error is not None]
        failure = failures[0] if failures else None
    if failure is not None:
        raise failure
    return result  # type: ignore[return-value]  # there was no failure


def _tried(work: Callable[[], T]) -> tuple[T | None, ScaleupError | None]:
    try:
        return work(), None
    except (Exception, SystemExit) as error:  # a plugin's work may raise anything
        return None, told(error)
