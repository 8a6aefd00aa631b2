"""Runs that are ended at any moment go on to the fields of an undisturbed one."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from scaleup.run.output_folder import work_folder
from scaleup.system.launch import launch_environment

PROGRAM = """
import os
import sys
from pathlib import Path

from scaleup.system import parallel

comm = parallel.start()
from scaleup.run import pipeline
from scaleup.case.composing import compose

pipeline.write_report = lambda *arguments: None  # figures take longer than all else
Path(f"{sys.argv[1]}.{comm.rank}.pid").write_text(str(os.getpid()))
texts = ["grid.cells=1500", "operation.revolutions=0.55", "output.checkpoint_every=0"]
case = compose(None, [*texts, *sys.argv[3:]],
                 {"geometry": {"name": "drum"}, "flow": {"name": "surface-layer"}})
try:
    pipeline.run(case, Path(sys.argv[1]), comm, resume=sys.argv[2] == "resume")
except Exception as error:
    print(error)
    sys.exit(getattr(error, "exit_code", 1))
"""


class Runner:
    """Starts runs on ranks, ends them and reads what they computed."""

    def __init__(self, folder, store):
        self.folder, self.store = folder, store
        (folder / "program.py").write_text(PROGRAM)

    def start(self, name, ranks, how="simulate", *texts):
        for left in self.folder.glob(f"{name}.*.pid"):
            left.unlink()
        return subprocess.Popen(
            ["mpiexec", "-n", str(ranks), sys.executable, "program.py", name, how, *texts],
            cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env=launch_environment({**os.environ, "SCALEUP_CACHE": str(self.store)}),
        )  # fmt: skip

    def finish(self, *arguments):
        process = self.start(*arguments)
        out, _ = process.communicate(timeout=300)
        assert process.returncode == 0, out

    def ranks_of(self, name, ranks):
        """Process numbers of the ranks, once all of them have started."""
        deadline = time.monotonic() + 120
        files = [self.folder / f"{name}.{rank}.pid" for rank in range(ranks)]
        while time.monotonic() < deadline and not all(f.exists() and f.read_text() for f in files):
            time.sleep(0.01)
        return [int(file.read_text()) for file in files]

    def state(self, name, file="checkpoint.h5"):
        with h5py.File(self.folder / name / file, "r") as stored:
            return stored["arrays/concentration"][()]

    def fields(self, name):
        found = {}
        with h5py.File(self.folder / name / "results.h5", "r") as file:
            file.visititems(
                lambda path, item: found.update({path: item[()]}) if hasattr(item, "shape") else 0
            )
        return found


@pytest.fixture(scope="module")
def runner(tmp_path_factory, store):
    """With an undisturbed run on two ranks, and `duration`, the s that it took."""
    made = Runner(tmp_path_factory.mktemp("killed"), store)
    made.finish("flow", 1)
    process = made.start("whole", 2)
    made.ranks_of("whole", 2)
    began = time.monotonic()
    out, _ = process.communicate(timeout=300)
    made.duration = time.monotonic() - began
    assert process.returncode == 0, out
    return made


def kill_and_resume(runner, fraction, ranks):
    """Kill a run on two ranks at a share of its duration and go on with it; whether it went on."""
    shutil.rmtree(runner.folder / "run", ignore_errors=True)
    process = runner.start("run", 2)
    numbers = runner.ranks_of("run", 2)
    time.sleep(fraction * runner.duration)
    for number in [*numbers, process.pid]:
        try:
            os.kill(number, signal.SIGKILL)
        except ProcessLookupError:  # the run was faster
            continue
    process.communicate()
    folder = runner.folder / "run"
    if not folder.exists():
        begun = (work_folder(folder) / "config.toml").exists()
        runner.finish("run", ranks, "resume" if begun else "simulate")
    assert not work_folder(folder).exists()
    for file in ("checkpoint.h5", "estimate.h5"):
        difference = runner.state("run", file) - runner.state("whole", file)
        assert np.abs(difference).max() <= 1e-12, (fraction, ranks, file)
    one, other = runner.fields("whole"), runner.fields("run")
    assert one.keys() == other.keys()
    for name in one:  # in single precision
        np.testing.assert_allclose(other[name], one[name], rtol=1e-6, atol=1e-6)
    assert sorted(p.name for p in runner.folder.iterdir() if p.name.startswith(".")) == []


@pytest.mark.parametrize(("fraction", "ranks"), [(0.3, 1), (0.6, 3)])
def test_a_killed_run_goes_on_to_the_same_fields(runner, fraction, ranks):
    kill_and_resume(runner, fraction, ranks)


@pytest.mark.slow
def test_thirty_killed_runs_go_on_to_the_same_fields(runner):
    moments = random.Random(7)
    for number in range(30):
        kill_and_resume(runner, moments.random(), 1 + number % 3)
        print(f"{number + 1} of 30", flush=True)


@pytest.mark.parametrize(
    ("number", "ranks", "code"),
    [(signal.SIGTERM, 1, 75), (signal.SIGINT, 1, 130), (signal.SIGUSR1, 2, 75)],
)
def test_a_signal_ends_a_run_with_a_checkpoint(runner, number, ranks, code):
    """The run is sent on for long, so that the signal comes while it mixes."""
    name = f"asked-{number}"
    long = "operation.revolutions=40"
    process = runner.start(name, ranks, "simulate", long)
    numbers = runner.ranks_of(name, ranks)
    checkpoint = work_folder(runner.folder / name) / "checkpoint.h5"
    deadline = time.monotonic() + 120
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    for rank in numbers:
        os.kill(rank, number)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == code, out
    assert f"{signal.Signals(number).name}: ended after revolution" in out
    assert not (runner.folder / f".{name}.lock").exists()
    with h5py.File(checkpoint, "r") as file:
        assert file["arrays/concentration"].shape[0] == 2
