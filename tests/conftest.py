"""Shared fixtures: a private store, MPI launches and small flows with known answers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from scaleup.command.cli import main
from scaleup.system.crew import ALL_RANKS
from scaleup.system.launch import launch_environment

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def store(tmp_path_factory):
    """A store of flows that all tests of a session share, apart from the user's own."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:  # workers share what lies above their own folders
        folder = folder.parent
    folder = folder / "store"
    folder.mkdir(exist_ok=True)
    os.environ["SCALEUP_CACHE"] = str(folder)
    return folder


@pytest.fixture(scope="session", autouse=True)
def all_ranks_mix():
    """Ranks are tested whatever else the machine does; those that sit out have their own test."""
    os.environ[ALL_RANKS] = "1"


@pytest.fixture
def scaleup(store, tmp_path):
    """Run the command line in an empty folder; returns the finished process."""

    def run(*arguments: str, timeout: float = 300, cwd: Path = tmp_path):
        return subprocess.run(
            [sys.executable, "-m", "scaleup", *arguments],
            capture_output=True,
            text=True,
            timeout=timeout,
            cwd=cwd,
            env={**os.environ, "SCALEUP_CACHE": str(store)},
            check=False,
        )

    return run


@pytest.fixture
def refused(store, tmp_path, monkeypatch, capsys):
    """Run a command that is refused, in an empty folder; returns the one sentence that it says.

    In this process: nothing that is refused comes as far as starting MPI.
    """

    def run(*arguments: str) -> str:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["scaleup", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        said = capsys.readouterr()
        assert end.value.code == 2
        assert said.out == ""
        assert said.err.startswith("Error: ")
        assert len(said.err.strip().splitlines()) == 1
        return said.err

    return run


@pytest.fixture(scope="session")
def on_ranks(tmp_path_factory):
    """Run a Python program on a number of ranks; returns what it printed."""

    def run(ranks: int, program: str, *arguments: str) -> str:
        script = tmp_path_factory.mktemp("ranks") / "program.py"
        script.write_text(program, encoding="utf-8")
        path = [str(REPOSITORY / "tests"), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
        done = subprocess.run(
            ["mpiexec", "-n", str(ranks), sys.executable, "-m", "mpi4py", str(script), *arguments],
            capture_output=True,
            text=True,
            timeout=300,
            cwd=REPOSITORY / "tests",
            env=launch_environment({**os.environ, "PYTHONPATH": os.pathsep.join(path)}),
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        # where the system has colorama, numba leaves this behind when a process ends
        return done.stdout.replace("\x1b[0m", "")

    return run
