"""Running the engine: LIGGGHTS, under mpiexec on more than one rank, watched until it ends."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from scaleup.system.errors import InputError, RunError
from scaleup.system.files import write_text
from scaleup.system.launch import end_with_parent, launch_environment

ENGINE = "liggghts"
_LOOK = 0.5  # s between two looks at what the engine has written


@dataclass(frozen=True)
class Cost:
    """What the engine took: s of CPU on all its ranks, s of wall-clock time; steps it made."""

    cpu: float = 0.0
    wall: float = 0.0
    steps: int = 0

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.cpu + other.cpu, self.wall + other.wall, self.steps + other.steps)


def where() -> str | None:
    """The engine's path; None if it is not installed."""
    return shutil.which(ENGINE)


def require_engine(ranks: int) -> None:
    """Raise InputError if the engine cannot be started on so many ranks."""
    if where() is None:
        raise InputError(
            f"scaleup particles needs the engine {ENGINE!r}, which is not installed; 'make "
            "particles' or 'apt install liggghts' installs it"
        )
    if ranks > 1 and shutil.which("mpiexec") is None:
        raise InputError("--ranks: there is no mpiexec on the PATH; install an MPI (openmpi-bin)")


class Engine:
    """The engine in a folder, one stage after the other.

    folder -- where decks, walls and restart files are
    """

    def __init__(self, folder: Path, ranks: int = 1):
        self._folder, self._ranks = folder, ranks
        self._child: subprocess.Popen[bytes] | None = None

    def run(self, stage: str, deck: str, look: Callable[[], None] = lambda: None) -> Cost:
        """Run a deck to its end; `look` is called from time to time.

        Leaves `STAGE.in` and `STAGE.out`. Raises RunError with what the engine complained of.
        """
        engine = where()
        assert engine is not None  # require_engine was asked
        write_text(self._folder / f"{stage}.in", deck)
        # a line at a time: else what it complains of is lost when it aborts
        buffered = ["stdbuf", "-oL"] if shutil.which("stdbuf") else []
        command = [*buffered, engine, "-in", f"{stage}.in", "-nocite", "-log", "none"]
        if self._ranks > 1:
            command = [shutil.which("mpiexec") or "mpiexec", "-n", str(self._ranks), *command]
        environment = launch_environment(os.environ)
        environment.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")  # waiting ranks spin otherwise
        began, before = time.monotonic(), _cpu_of_children()
        output = self._folder / f"{stage}.out"
        with output.open("wb") as stream:
            self._child = subprocess.Popen(
                command, cwd=self._folder, env=environment, stdout=stream,
                stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, start_new_session=True,
                preexec_fn=end_with_parent,
            )  # fmt: skip
            try:
                while self._child.poll() is None:
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        self._child.wait(timeout=_LOOK)
                    look()
            finally:
                self.end()
                for left in self._folder.glob("restart_forced_*"):  # asked to end, it leaves one
                    left.unlink(missing_ok=True)
        if self._child.returncode != 0:
            raise RunError(f"the engine failed in the stage {stage!r}: {_complaint(output)}")
        return Cost(_cpu_of_children() - before, time.monotonic() - began)

    def end(self) -> None:
        """End the engine if it runs; its ranks end with mpiexec."""
        child = self._child
        if child is not None and child.poll() is None:
            child.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(timeout=3)
            if child.poll() is None:
                child.kill()
                child.wait()


def _cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _complaint(output: Path) -> str:
    lines = output.read_text(encoding="utf-8", errors="replace").splitlines()
    errors = [line for line in lines if "ERROR" in line] or lines[-1:]
    return " ".join(errors[:1]) or "it said nothing"
