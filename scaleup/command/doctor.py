"""What is installed, whether it works together, and what to do if it does not."""

from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

from scaleup.case.config import PLUGIN_SECTIONS
from scaleup.particles.engine import ENGINE, where
from scaleup.system.errors import PluginError
from scaleup.system.launch import launch_environment
from scaleup.system.registry import available, load

_IMPORTS = {
    "mpi4py": "apt install python3-mpi4py, or pip install mpi4py",
    "petsc4py": "apt install python3-petsc4py libpetsc-real-dev, or pip install petsc petsc4py",
    "h5py": "apt install python3-h5py-mpi, or pip install h5py",
    "ngsolve": "pip install ngsolve",
    "numba": "pip install numba",
}
_VERSIONS = {
    "mpi4py": "from mpi4py import MPI; print(MPI.Get_library_version().split(chr(10))[0][:60])",
    "petsc4py": "from petsc4py import PETSc; print('PETSc', *PETSc.Sys.getVersion())",
    "h5py": "import h5py; print('HDF5', h5py.version.hdf5_version)",
}


def examine() -> Iterator[tuple[str, bool]]:
    """Findings, each a line and whether it is good. Imports run in processes of their own."""
    for name, remedy in _IMPORTS.items():
        code = _VERSIONS.get(name, f"import {name}; print({name}.__version__)")
        done = subprocess.run(
            [sys.executable, "-P", "-c", code],
            capture_output=True, text=True, check=False, env=launch_environment(os.environ),
        )  # fmt: skip
        if done.returncode == 0:
            yield f"{name}: {done.stdout.strip()}", True
        else:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            yield f"{name}: {last}; {remedy}", False
    mpiexec = shutil.which("mpiexec")
    yield f"mpiexec: {mpiexec or 'not on the PATH; apt install openmpi-bin'}", bool(mpiexec)
    found = where() or "not installed (make particles); scaleup particles alone needs it"
    yield f"{ENGINE}: {found}", True
    for kind in PLUGIN_SECTIONS:
        for name in available(kind):
            try:
                load(kind, name)
            except PluginError as error:
                yield str(error), False
            else:
                yield f"{kind} {name}", True


def greet() -> None:
    """Every rank says hello and a PETSc vector is summed over all of them (collective)."""
    from scaleup.system import parallel

    comm = parallel.start()
    PETSc = importlib.import_module("petsc4py.PETSc")
    vector = PETSc.Vec().createMPI((1, PETSc.DECIDE), comm=comm)
    vector.set(1.0)
    total = vector.sum()
    if comm.rank == 0:
        print(f"ok   {comm.size} rank(s) say hello; PETSc counts {total:.0f}")
