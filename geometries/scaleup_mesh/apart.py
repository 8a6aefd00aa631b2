"""Runs the program `outside`, which limits its time and memory, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from scaleup.contract import FloatArray, IntArray

_PROGRAM = Path(__file__).with_name("outside.py")
_SECONDS = 3600.0  # after which it is taken to wait for ever
_LAUNCHED = ("OMPI_", "PMI_", "PMIX_", "SLURM_")  # what would make the process a rank


class UselessFileError(ValueError):
    """The file was read well, but holds no surface that could be a vessel."""


def outside_of(file: Path) -> tuple[FloatArray, IntArray, bool]:
    """Vertices (v, 3), triangles (n, 3), and whether they bound volume cells.

    Raises ValueError with the reason if the file cannot be read, UselessFileError if its content is
    of no use.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(_LAUNCHED)}
    with tempfile.TemporaryDirectory(prefix="scaleup-") as name:
        folder = Path(name)
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(_PROGRAM), str(file.resolve()), name],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=_SECONDS,
                env=environment,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"its reader did not come to an end in {_SECONDS:g} s") from None
        if (folder / "reason.txt").exists():
            reason = (folder / "reason.txt").read_text(encoding="utf-8")
            if reason.startswith("refused: "):
                raise UselessFileError(reason.removeprefix("refused: "))
            raise ValueError(reason)
        try:
            with np.load(folder / "surface.npz") as held:
                return held["vertices"], held["triangles"], bool(held["bound_cells"])
        except (OSError, ValueError, BadZipFile):
            raise ValueError(
                f"its reader crashed or took too long, and ended with exit code {done.returncode}: "
                "the file is damaged or too large"
            ) from None
