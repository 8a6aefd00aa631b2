"""MPI: a late start, an abort that leaves no rank waiting, and errors that reach all ranks."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, TypeVar

from scaleup.errors import ScaleupError, file_error

T = TypeVar("T")

_POLL_SECONDS = 0.02


def start() -> Any:
    """Start MPI and PETSc and return the world communicator (mpi4py).

    From here on an exception that nobody catches on one rank ends all of them; without that the
    others would wait for it for ever.
    """
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    if comm.size > 1:
        previous = sys.excepthook

        def abort(kind: Any, error: Any, traceback: Any) -> None:
            previous(kind, error, traceback)
            sys.stderr.flush()
            comm.Abort(1)

        sys.excepthook = abort
    import petsc4py

    petsc4py.init(sys.argv[:1])
    return comm


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
    except ScaleupError as error:
        return None, error
    except OSError as error:
        return None, file_error(error)
