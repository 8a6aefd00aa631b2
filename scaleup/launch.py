"""`--ranks N`: start this same command again under mpiexec.

Never imports mpi4py: a process that has initialised MPI cannot start mpiexec.
"""

from __future__ import annotations

import os
import shutil
import sys

from scaleup.errors import InputError, RunError

# variables by which a launcher tells a process how many it started
_SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_SIZE", "MPI_LOCALNRANKS")


def launched_size() -> int | None:
    """Number of ranks if this process was started by mpiexec or srun, else None."""
    for name in _SIZE_VARIABLES:
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    if "SLURM_PROCID" in os.environ and "SLURM_STEP_NUM_TASKS" in os.environ:
        return int(os.environ["SLURM_STEP_NUM_TASKS"])
    return None


def check_ranks(ranks: int | None) -> None:
    """Raise InputError if `--ranks` cannot be."""
    if ranks is not None and ranks < 1:
        raise InputError(f"--ranks = {ranks}: must be 1 or more")
    size = launched_size()
    if size is not None and ranks is not None and ranks != size:
        raise InputError(f"--ranks = {ranks}: the launcher started {size}; leave --ranks out")


def relaunch_if_needed(ranks: int | None) -> None:
    """Replace this process by `mpiexec -n ranks` of the same command, unless already launched."""
    if launched_size() is not None or ranks is None or ranks == 1:
        return
    mpiexec = shutil.which("mpiexec")
    if mpiexec is None:
        raise RunError("--ranks: there is no mpiexec on the PATH; install an MPI (openmpi-bin)")
    environment = dict(os.environ)
    if os.geteuid() == 0:  # Open MPI refuses root otherwise; containers run as root
        environment.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
        environment.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
    # The root's flow solver uses the cores of ranks that wait for it: do not bind ranks to cores.
    environment.setdefault("OMPI_MCA_hwloc_base_binding_policy", "none")
    # Open MPI counts cores, not hardware threads, and would refuse two ranks on one such core.
    environment.setdefault("OMPI_MCA_rmaps_base_oversubscribe", "1")
    command = [mpiexec, "-n", str(ranks), sys.executable, "-m", "mpi4py", "-m", "scaleup"]
    sys.stdout.flush()
    os.execve(mpiexec, command + sys.argv[1:], environment)
