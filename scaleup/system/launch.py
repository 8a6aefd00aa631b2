"""`--ranks N`: start this same command again under mpiexec.

Never imports mpi4py: a process that has initialised MPI cannot start mpiexec.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping

from scaleup.system.errors import InputError, RunError
from scaleup.system.stopping import SIGNALS, exit_code

_PATIENCE = 8.5
"""s that ranks are given to end when they are asked to"""

RANKS_PER_CORE = 4
"""how many ranks --ranks starts on a core at most"""

# Variables by which a launcher tells a process how many it started, and which one it is. What an
# inner launcher says goes before what an outer one left behind.
_TOLD_BY_US = "SCALEUP_RANKS"
_TOLD = (
    ("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"),
    ("PMI_SIZE", "PMI_RANK"),
    ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID"),
)
# What belongs to one launched process and would mislead the mpiexec that this one starts: an
# interactive `srun` or `mpiexec -n 1` leaves it. What the user may have set (OMPI_MCA_btl) stays.
_OF_ONE_PROCESS = re.compile(
    r"OMPI_(?!ALLOW_|MCA_)|OMPI_MCA_(ess|orte_(?!.*hostfile)|pmix|initial_wdir|mpi_oversubscribe)"
    r"|PMI_|PMI2_|PMIX_(?!MCA_)|SLURM_(PROCID|LOCALID|STEP_NUM_TASKS)$"
)


def launched_size() -> int:
    """Number of ranks that mpiexec or srun says it started with this one; 1 without them."""
    told = _told()
    return 1 if told is None else told[0]


def is_root() -> bool:
    """Whether this is the first of the launched processes, or the only one."""
    told = _told()
    return told is None or told[1] == 0


def check_ranks(ranks: int | None) -> None:
    """Raise InputError if `--ranks` cannot be."""
    if ranks is None:
        return
    if ranks < 1:
        raise InputError(f"--ranks = {ranks}: must be 1 or more")
    size = launched_size()
    if size > 1 and ranks != size:
        raise InputError(f"--ranks = {ranks}: the launcher started {size}; leave --ranks out")
    cores = available_cores()
    if size == 1 and ranks > RANKS_PER_CORE * cores:
        raise InputError(
            f"--ranks = {ranks}: must be at most {RANKS_PER_CORE * cores}, {RANKS_PER_CORE} for "
            f"each of the {cores} cores there are; start more with mpiexec or srun"
        )


def check_world(size: int) -> None:
    """Raise InputError if MPI connects fewer ranks (`size`) than the launcher started."""
    told = launched_size()
    if size < told:
        raise InputError(
            f"the launcher started {told} processes, but MPI connects {size} of them: start them "
            "with the mpiexec of the MPI that mpi4py uses, or with 'srun --mpi=pmix'"
        )


def relaunch_if_needed(ranks: int | None) -> None:
    """Run `mpiexec -n ranks` of the same command and end with it, unless already launched."""
    if ranks is None or ranks == 1 or launched_size() > 1:
        return
    mpiexec = shutil.which("mpiexec")
    if mpiexec is None:
        raise RunError("--ranks: there is no mpiexec on the PATH; install an MPI (openmpi-bin)")
    # -P: what lies in the working folder is not imported
    command = [mpiexec, "-n", str(ranks), sys.executable, "-P", "-m", "scaleup", *sys.argv[1:]]
    sys.stdout.flush()
    os._exit(attended(command, launch_environment(os.environ) | {_TOLD_BY_US: str(ranks)}))


def attended(command: list[str], environment: Mapping[str, str]) -> int:
    """Run mpiexec and return its exit code.

    Signals that ask to end (`scaleup.system.stopping`) reach the ranks as SIGUSR1, which mpiexec
    passes on: at SIGTERM and SIGINT it kills them within a second. So it gets a session of its own,
    out of the terminal's reach, and ends with this process.
    """
    asked: list[int] = []
    child: subprocess.Popen[bytes] | None = None

    def pass_on(number: int, frame: object) -> None:
        asked.append(number)
        if child is not None:
            child.send_signal(signal.SIGUSR1)

    for number in SIGNALS:
        signal.signal(number, pass_on)
    child = subprocess.Popen(
        command, env=environment, start_new_session=True, preexec_fn=end_with_parent
    )
    if asked:
        child.terminate()
    patience = math.inf
    while child.poll() is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(timeout=0.5)
        if asked and patience == math.inf:
            patience = time.monotonic() + _PATIENCE
        if time.monotonic() > patience:
            child.terminate()
    code = child.returncode
    if asked and code:
        return exit_code(asked[0])
    return code if code >= 0 else 128 - code  # as a shell has it


def end_with_parent() -> None:
    """Called in mpiexec's process before it begins: Linux ends it when its parent is killed."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG


def launch_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment that mpiexec is started with; what the user has set goes before ours."""
    kept = {name: value for name, value in environment.items() if not _OF_ONE_PROCESS.match(name)}
    if os.geteuid() == 0:  # Open MPI refuses root otherwise; containers run as root
        kept.setdefault("OMPI_ALLOW_RUN_AS_ROOT", "1")
        kept.setdefault("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")
    # The root's flow solver uses the cores of ranks that wait for it: do not bind ranks to cores.
    kept.setdefault("OMPI_MCA_hwloc_base_binding_policy", "none")
    # Open MPI counts cores, not hardware threads, and would refuse two ranks on one such core.
    kept.setdefault("OMPI_MCA_rmaps_base_oversubscribe", "1")
    return kept


def available_cores() -> int:
    """Cores of the batch system's allocation, on all its nodes, else those of this machine."""
    return max(_allocated_cores(os.environ), len(os.sched_getaffinity(0)))


def _allocated_cores(environment: Mapping[str, str]) -> int:
    """Cores that Slurm, PBS, Grid Engine or LSF says the job has; 0 if none does."""
    # Slurm writes "16(x3),8" for nodes of 16, 16, 16 and 8
    nodes = re.findall(r"(\d+)(?:\(x(\d+)\))?", environment.get("SLURM_JOB_CPUS_PER_NODE", ""))
    slurm = sum(int(cores) * int(count or 1) for cores, count in nodes)
    others = [environment.get(name, "") for name in ("NCPUS", "NSLOTS", "LSB_DJOB_NUMPROC")]
    hosts = environment.get("PBS_NODEFILE", "")  # a line for each MPI process that was asked for
    lines = 0
    if hosts and os.path.isfile(hosts):
        with open(hosts, encoding="utf-8") as file:
            lines = sum(1 for line in file if line.strip())
    return max(slurm, lines, *(int(text) if text.isdigit() else 0 for text in others))


def _told() -> tuple[int, int] | None:
    """(how many were started, which one this is) by the launcher's word.

    The first launcher that says more than one is believed: an interactive step leaves 1 behind.
    """
    said = []
    for names in _TOLD:
        size, rank = (os.environ.get(name, "") for name in names)
        if size.isdigit() and rank.isdigit():
            said.append((int(size), int(rank)))
    ours = os.environ.get(_TOLD_BY_US, "")
    if ours.isdigit() and not said:  # by an mpiexec that says nothing: never start another
        said.append((int(ours), 0))
    return next((pair for pair in said if pair[0] > 1), said[0] if said else None)
