"""How a run is started on ranks: what a launcher leaves behind, and what lies about."""

import os
import subprocess
import sys

import pytest

from scaleup.system import launch
from scaleup.system.errors import InputError

TOLD = [name for pair in launch._TOLD for name in pair]


@pytest.fixture
def told(monkeypatch):
    """Set what launchers say of this process, and nothing else of the kind."""
    for name in [*TOLD, "SCALEUP_RANKS"]:
        monkeypatch.delenv(name, raising=False)

    def tell(**environment):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)

    return tell


@pytest.fixture
def started(monkeypatch):
    """The commands that this process would have run and ended with."""
    commands = []
    monkeypatch.setattr(launch, "attended", lambda *started: commands.append(started))
    monkeypatch.setattr(os, "_exit", lambda code: None)
    monkeypatch.setattr(sys, "argv", ["scaleup", "simulate"])
    return commands


@pytest.mark.parametrize(
    "left",
    [
        {},
        {"PMI_SIZE": "1", "PMI_RANK": "0"},
        {"SLURM_STEP_NUM_TASKS": "1", "SLURM_PROCID": "0", "SLURM_JOB_ID": "7"},
        {"OMPI_COMM_WORLD_SIZE": "1", "OMPI_COMM_WORLD_RANK": "0", "OMPI_MCA_ess": "^singleton"},
    ],
)
def test_a_launched_process_that_is_alone_starts_the_ranks(told, started, left):
    told(**left, OMPI_MCA_btl="self,tcp", OMPI_MCA_hwloc_base_binding_policy="core")
    launch.check_ranks(2)
    launch.relaunch_if_needed(2)
    ((command, environment),) = started
    assert command[1:] == ["-n", "2", sys.executable, "-P", "-m", "scaleup", "simulate"]
    assert set(left) & set(environment) <= {
        "SLURM_JOB_ID"
    }  # the allocation is the mpiexec's to see
    assert environment["OMPI_MCA_btl"] == "self,tcp"
    assert environment["OMPI_MCA_hwloc_base_binding_policy"] == "core"


@pytest.mark.parametrize(
    ("environment", "size"),
    [
        ({"OMPI_COMM_WORLD_SIZE": "2", "OMPI_COMM_WORLD_RANK": "1", "PMI_SIZE": "1",
          "PMI_RANK": "0"}, 2),
        ({"PMI_SIZE": "1", "PMI_RANK": "0", "SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": "1"}, 2),
        ({"SCALEUP_RANKS": "2"}, 2),
        ({"SLURM_PROCID": "0"}, 1),
    ],
)  # fmt: skip
def test_ranks_are_not_started_twice(told, started, environment, size):
    told(**environment)
    assert launch.launched_size() == size
    launch.relaunch_if_needed(2)
    assert len(started) == (size == 1)


def test_ranks_that_mpi_does_not_connect_are_refused(told):
    told(SLURM_STEP_NUM_TASKS="2", SLURM_PROCID="1")
    launch.check_world(2)
    with pytest.raises(InputError, match=r"started 2 processes, .* 1 of them.*--mpi=pmix"):
        launch.check_world(1)
    assert not launch.is_root()


def test_more_ranks_than_the_cores_can_bear_are_refused(told, monkeypatch, tmp_path):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(2))
    told()
    launch.check_ranks(8)
    with pytest.raises(
        InputError, match="--ranks = 100000: must be at most 8, 4 for each of the 2"
    ):
        launch.check_ranks(100000)
    told(SLURM_JOB_CPUS_PER_NODE="16(x3),8")
    assert launch.available_cores() == 56
    launch.check_ranks(56)
    nodes = tmp_path / "nodes"
    nodes.write_text("a\n" * 64)
    told(PBS_NODEFILE=str(nodes))
    assert launch.available_cores() == 64


MPI_WITHOUT_LAUNCHER = """
from scaleup.system import parallel
from scaleup.system.errors import InputError
try:
    parallel.start()
except InputError as error:
    print(error)
"""

WAITING = """
import os
from scaleup.system import parallel
comm = parallel.start()
from petsc4py import PETSc
assert comm.size == 2 and os.environ["OMPI_MCA_mpi_yield_when_idle"] == "1"
assert not PETSc.Options().hasName("ksp_type") and PETSc.Options().hasName("mat_type")
count = comm.allreduce(1)
print(count if comm.rank == 0 else "", end="")
"""


def test_ranks_yield_and_obey_no_petscrc_that_lies_about(on_ranks, monkeypatch, tmp_path):
    (tmp_path / ".petscrc").write_text("-ksp_type bogus\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PETSC_OPTIONS", "-mat_type aij")
    assert on_ranks(2, WAITING).strip() == "2"


def test_two_tasks_with_a_world_of_one_each_are_told_apart():
    environment = {**os.environ, "SLURM_STEP_NUM_TASKS": "2", "SLURM_PROCID": "0"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", MPI_WITHOUT_LAUNCHER],
        capture_output=True, text=True, env=environment, check=True,
    )  # fmt: skip
    assert "started 2 processes, but MPI connects 1" in done.stdout


def test_what_lies_in_the_working_folder_is_not_imported(store, tmp_path):
    (tmp_path / "random.py").write_text("raise SystemExit('the file of the user')")
    (tmp_path / "scaleup").mkdir()
    done = subprocess.run(
        ["mpiexec", "-n", "2", sys.executable, "-m", "scaleup", "doctor"],
        capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False,
        env=launch.launch_environment(os.environ),
    )  # fmt: skip
    assert "2 rank(s) say hello" in done.stdout, done.stdout + done.stderr
