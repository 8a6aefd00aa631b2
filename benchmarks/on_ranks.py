"""Run a benchmark's own script on MPI ranks of their own, and take the figures that it prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

from scaleup.system.launch import launch_environment


def on_ranks(script: str, asked: float | str, ranks: int, **environment: str) -> dict[str, Any]:
    """What ``script --measure asked`` prints as JSON in its last line, on so many ranks."""
    command = [sys.executable, "-m", "mpi4py", script, "--measure", str(asked)]
    done = subprocess.run(
        ["mpiexec", "-n", str(ranks), *command],
        env=launch_environment({**os.environ, "OMP_NUM_THREADS": "1", **environment}),
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    row: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return row
