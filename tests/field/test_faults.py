"""What a run does when something breaks: each row of the table in docs/robustness.md."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow import source as flow_source
from scaleup.flow import storage
from scaleup.flow.source import obtain_flow, stored_flow
from scaleup.flow.storage import Store
from scaleup.run import costs, pipeline
from scaleup.run.blending import mix
from scaleup.run.output_folder import check_output, real_folder, work_folder
from scaleup.run.resumption import read_state
from scaleup.system import processes, run_lock, source_hash
from scaleup.system.errors import InputError, RunError
from scaleup.system.stopping import StoppedError
from synthetic import sloshing

SELF = MPI.COMM_SELF
SCENE = ["grid.cells=1200", "output.checkpoint_every=0"]
NAMES = {"mixing": {"name": "lax-wendroff"}, "flow": {"name": "surface-layer"}}


class KilledError(BaseException):
    """Stands for what ends a process."""


def configure(*assignments, revolutions=0.2):
    return compose(None, [*SCENE, f"operation.revolutions={revolutions}", *assignments], NAMES)


@pytest.fixture
def quick(monkeypatch):
    """No figures are drawn."""
    monkeypatch.setattr(pipeline, "write_report", lambda *arguments: None)


@pytest.fixture
def own_store(store, tmp_path, monkeypatch):
    """A store for one test, with the flow of the scene in it; returns that flow's path."""
    obtain_flow(configure(), SELF)
    solved = stored_flow(configure())
    monkeypatch.setenv("SCALEUP_CACHE", str(tmp_path / "store"))
    (tmp_path / "store").mkdir()
    return Path(shutil.copy(solved, tmp_path / "store"))


def kill_at(monkeypatch, revolution):
    """The process ends when the checkpoint of a revolution has been written."""
    write = storage.write_checkpoint

    def write_and_end(path, arrays, state):
        write(path, arrays, state)
        if state["revolution"] >= revolution:
            raise KilledError

    monkeypatch.setattr(storage, "write_checkpoint", write_and_end)


@pytest.fixture
def killed(store, quick, tmp_path):
    """A run that was killed at revolution 0.1; its folder."""
    with pytest.MonkeyPatch.context() as patch:
        kill_at(patch, 0.1)
        with pytest.raises(KilledError):
            pipeline.run(configure(), tmp_path / "run", SELF)
    return tmp_path / "run"


def fields(path):
    with h5py.File(path, "r") as file:
        found = {}
        file.visititems(
            lambda name, item: found.update({name: item[()]}) if hasattr(item, "shape") else None
        )
        return found


# --- resuming ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("diffusion.k1=0.1", r"diffusion\.k1 = 0\.1 \(was 0\.04\)"),
        ("operation.speed='7 rpm'", r"operation\.speed = 0\.73\d+ rad/s \(was 0\.62\d+ rad/s\)"),
        ("grid.spacing='2 mm'", r"grid\.spacing = 0\.002 m \(was not given\)"),
        ("operation.loading='top-bottom'", r"pattern = top-bottom \(was side-by-side\)"),
        ("output.snapshots_every=0.1", r"output\.snapshots_every = 0\.1 \(was 0\.5\)"),
    ],
)
def test_an_edited_configuration_is_refused_with_what_differs(killed, change, sentence):
    checkpoint = work_folder(killed) / "checkpoint.h5"
    scene = [*SCENE, "operation.revolutions=0.2"]
    if change.startswith("grid"):
        scene.remove("grid.cells=1200")
    with pytest.raises(InputError, match=sentence):
        read_state(checkpoint, compose(None, [*scene, change], NAMES), changed_code=False)
    free = configure("accuracy.tolerance=0.1", "output.checkpoint_every=60", revolutions=0.4)
    assert read_state(checkpoint, free, changed_code=False)[1]["revolution"] == 0.1
    with pytest.raises(InputError, match=r"has turned 0\.1 already"):
        read_state(checkpoint, configure(revolutions=0.05), changed_code=False)


def test_a_vessel_whose_file_has_changed_is_another_run(killed, monkeypatch):
    case = configure()
    monkeypatch.setattr(type(case.geometry), "fingerprint", "of another shape")
    with pytest.raises(InputError, match="the file of the vessel's shape has changed"):
        read_state(work_folder(killed) / "checkpoint.h5", case, changed_code=False)


def test_changed_code_goes_on_only_when_told_and_the_report_says_so(killed, monkeypatch):
    monkeypatch.setattr(source_hash, "of_run_code", lambda *plugins: "another")
    with pytest.raises(InputError, match="--changed-code"):
        pipeline.run(configure(), killed, SELF, resume=True)
    pipeline.run(configure(), killed, SELF, resume=True, changed_code=True)
    warnings = json.loads((killed / "report.json").read_text())["warnings"]
    assert any("code has changed at revolution 0.1" in sentence for sentence in warnings)


def damage_version(path, version):
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = version


@pytest.mark.parametrize(
    ("name", "damage", "sentence"),
    [
        ("checkpoint.h5", lambda p: damage_version(p, 99), "newer version of scaleup"),
        ("checkpoint.h5", lambda p: damage_version(p, 1), "older version of scaleup"),
        ("checkpoint.h5", lambda p: os.truncate(p, 3000), "checkpoint.h5: is damaged"),
        ("fields/snapshots-00000.000000.h5", os.unlink, "is missing, so that fields"),
        ("fields/snapshots-00000.000000.h5", lambda p: os.truncate(p, 900), "fields of this run"),
    ],
)
def test_what_a_run_cannot_go_on_from_is_said_before_anything_is_computed(
    killed, monkeypatch, name, damage, sentence
):
    damage(work_folder(killed) / name)
    monkeypatch.setattr(pipeline, "obtain_flow", None)  # nothing is computed
    with pytest.raises(InputError, match=sentence) as caught:
        pipeline.run(configure(), killed, SELF, resume=True)
    assert "\n" not in str(caught.value)
    assert "config.toml --output FOLDER --overwrite" in str(caught.value)


def test_results_of_a_finished_run_that_were_cut_are_found_before_it_goes_on(
    store, quick, tmp_path, monkeypatch
):
    folder = pipeline.run(configure(), tmp_path / "run", SELF)
    os.truncate(folder / "results.h5", 5000)
    monkeypatch.setattr(pipeline, "obtain_flow", None)
    with pytest.raises(InputError, match=r"results\.h5: is damaged"):
        pipeline.run(configure(revolutions=0.3), folder, SELF, resume=True)
    assert (folder / "report.json").exists()


# --- extending --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "kill", "total", "animate"),
    [
        (0.2, 0.35, 0.5, "no"),
        (0.23, 0.35, 0.5, "no"),  # the end of the first run is no point of a longer one
        (1.1, 1.2, 1.3, "last"),  # another revolution is the last one
    ],
)
def test_a_finished_run_goes_on_as_if_run_in_one_go(
    store, quick, tmp_path, first, kill, total, animate
):
    shown = f"output.animate={animate}"
    whole = pipeline.run(configure(shown, revolutions=total), tmp_path / "whole", SELF)
    folder = pipeline.run(configure(shown, revolutions=first), tmp_path / "run", SELF)
    before = {name: (folder / name).read_bytes() for name in ("report.json", "results.h5")}
    longer = configure(shown, revolutions=total)
    with pytest.MonkeyPatch.context() as patch:
        kill_at(patch, kill)
        with pytest.raises(KilledError):
            pipeline.run(longer, folder, SELF, resume=True)
    assert before == {name: (folder / name).read_bytes() for name in before}
    pipeline.run(longer, folder, SELF, resume=True)
    assert not work_folder(folder).exists()
    one, other = (json.loads((f / "report.json").read_text()) for f in (whole, folder))
    for section in ("mixing", "error_estimate", "ledger"):
        assert _close(one[section], other[section]), section
    assert (folder / "config.toml").read_text() == (whole / "config.toml").read_text()
    for name in ("results.h5", "checkpoint.h5", "estimate.h5"):
        one, other = fields(whole / name), fields(folder / name)
        assert one.keys() == other.keys()
        for key in one.keys() - {"state"}:
            np.testing.assert_allclose(other[key], one[key], rtol=0, atol=1e-12)


def _close(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_close(one[k], other[k]) for k in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_close, one, other))
    if isinstance(one, float):
        return abs(one - other) <= 1e-12 * max(1.0, abs(one))
    return one == other


class AskedAt:
    """Stands for a signal that comes before the n-th safe point."""

    def __init__(self, count):
        self.left = count

    def asked(self, comm):
        self.left -= 1
        return signal.SIGTERM if self.left == 0 else 0


@pytest.mark.parametrize(
    "mixing", ["finite-volume", "lax-wendroff", "semi-lagrangian", "implicit-fem"]
)
def test_a_run_that_is_asked_to_end_goes_on_where_it_was(tmp_path, mixing):
    flow, scene = sloshing(prefix=2), [*SCENE, "operation.revolutions=0.2"]
    case = compose(None, [*scene, "accuracy.scrutiny=20"], {"mixing": {"name": mixing}})
    whole, part = tmp_path / "whole.h5", tmp_path / "part.h5"
    one = mix(case, flow, SELF, checkpoint=whole)
    for count in (3, 5, 9):  # between points of the blend curve, and at one
        with pytest.raises(StoppedError, match="SIGTERM: ended after revolution") as caught:
            mix(case, flow, SELF, checkpoint=part, stopping=AskedAt(count))
        assert caught.value.exit_code == 75
    other = mix(case, flow, SELF, checkpoint=part)
    assert _close(one.intensity, other.intensity)
    assert _close(one.volumes, other.volumes)
    assert one.ledger.steps == other.ledger.steps
    fields_one, fields_other = (
        storage.read_checkpoint(p)[0]["concentration"] for p in (whole, part)
    )
    np.testing.assert_allclose(fields_other, fields_one, rtol=0, atol=1e-12)


ENDED = """
import os, signal, sys, time
from scaleup.system import stopping
stopping._PATIENCE = 0.3
stop = stopping.Stopping()
stop.at_once = sys.argv[1] == "at once"
with stop.heeded(lambda: print("unlocked")):
    os.kill(os.getpid(), getattr(signal, sys.argv[2]))
    time.sleep(60)
"""


@pytest.mark.parametrize("how", [("at once", "SIGTERM", 75), ("patiently", "SIGINT", 130)])
def test_a_step_without_end_does_not_keep_a_process_that_is_asked_to_end(how):
    done = subprocess.run(
        [sys.executable, "-c", ENDED, *how[:2]],
        capture_output=True, text=True, check=False, timeout=50,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (how[2], "unlocked\n"), done.stderr


# --- locks ------------------------------------------------------------------------------------


def test_a_live_run_cannot_be_resumed_or_overwritten(tmp_path):
    (tmp_path / "run").mkdir()
    holder = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    lock = tmp_path / ".run.lock"
    words = {"host": processes.host(), "pid": holder.pid, "started": processes.started(holder.pid)}
    lock.write_text(json.dumps(words))
    with pytest.raises(InputError, match=f"under way there, as process {holder.pid} on "):
        check_output(tmp_path / "run", overwrite=True, resume=False)
    with pytest.raises(InputError, match="under way"):
        run_lock.RunLock(tmp_path / "run").take()
    lock.write_text(json.dumps(words | {"started": "1"}))  # the number was given to another process
    check_output(tmp_path / "run", overwrite=True, resume=False)
    lock.write_text(json.dumps(words))
    holder.communicate(b"\n")
    with run_lock.RunLock(tmp_path / "run").held():
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    assert list(tmp_path.iterdir()) == [tmp_path / "run"]


@pytest.mark.parametrize("content", ['{"host": "far-00000000", "pid": 1, "started": "1"}', ""])
def test_the_lock_of_another_host_counts_as_long_as_it_is_touched(tmp_path, content):
    lock = tmp_path / ".run.lock"
    lock.write_text(content)
    with pytest.raises(InputError, match="under way"):
        run_lock.RunLock(tmp_path / "run").take()
    os.utime(lock, (0, lock.stat().st_mtime - 700))
    run_lock.RunLock(tmp_path / "run").take()


# --- stored flows -----------------------------------------------------------------------------


def overwrite(path, offset, count):
    with path.open("r+b") as stream:
        stream.seek(offset if offset >= 0 else path.stat().st_size // 2)
        stream.write(np.random.default_rng(3).bytes(count))


def edit(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def replace_by_directory(path):
    path.unlink()
    path.mkdir()
    (path / "something").touch()


def replace_by(path, content):
    path.write_bytes(content)


def reshape(file, name, data):
    del file[name]
    file[name] = data


def other_file(path):
    path.unlink()
    with h5py.File(path, "w") as file:
        file["x"] = 1.0


def scale_flux(file):
    flux = file["intervals/flux"]
    flux[...] = 1.001 * flux[...]
    flux[0, np.abs(flux[0]).argmax()] *= 1.1


def put_nan(file):
    file["intervals/shear_rate"][3] = np.nan


DAMAGE = {
    "truncated": lambda p: os.truncate(p, p.stat().st_size // 2),
    "cut by a byte": lambda p: os.truncate(p, p.stat().st_size - 1),
    "empty": lambda p: os.truncate(p, 0),
    "random header": lambda p: overwrite(p, 0, 400),
    "random middle": lambda p: overwrite(p, -1, 4000),
    "text": lambda p: replace_by(p, b"not a flow\n" * 100),
    "other HDF5": other_file,
    "dataset missing": lambda p: edit(p, lambda f: f.__delitem__("intervals/flux")),
    "attribute missing": lambda p: edit(p, lambda f: f.attrs.__delitem__("frame")),
    "wrong shape": lambda p: edit(p, lambda f: reshape(f, "intervals/flux", np.zeros((3, 4)))),
    "wrong type": lambda p: edit(p, lambda f: reshape(f, "times", b"abc")),
    "NaN": lambda p: edit(p, put_nan),
    "fluxes altered": lambda p: edit(p, scale_flux),
    "cells beyond": lambda p: edit(p, lambda f: f["intervals/cells"].__setitem__(5, 10**6)),
    "other version": lambda p: damage_version(p, 99),
    "of another key": lambda p: edit(p, lambda f: f.attrs.__setitem__("name", "flow-0.h5")),
    "directory": replace_by_directory,
    "dangling link": lambda p: (p.unlink(), p.symlink_to("nowhere")),
    "pipe": lambda p: (p.unlink(), os.mkfifo(p)),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_flow_is_set_aside_and_solved_again(own_store, damage, caplog):
    good = fields(own_store)
    damage(own_store)
    caplog.set_level("INFO", "scaleup")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flow_source.log, "propagate", True)
        outcome = obtain_flow(configure(), SELF)
    assert not outcome.reused
    assert os.path.lexists(own_store.with_name(own_store.name + ".damaged"))
    assert "was set aside as" in caplog.text
    assert "solving it again" in caplog.text
    again = fields(own_store)
    assert all(np.array_equal(again[key], good[key]) for key in good)
    assert obtain_flow(configure(), SELF).reused


def test_two_runs_that_solve_the_same_flow_leave_one_that_is_whole(store, tmp_path):
    program = (
        "import sys\nfrom mpi4py import MPI\n"
        "from scaleup.case.composing import compose\nfrom scaleup.flow.source import obtain_flow\n"
        f"case = compose(None, {SCENE!r}, {NAMES!r})\n"
        "sys.stdout.write('ready\\n')\nsys.stdout.flush()\nsys.stdin.readline()\n"
        "assert not obtain_flow(case, MPI.COMM_SELF).reused\n"
    )
    environment = {**os.environ, "SCALEUP_CACHE": str(tmp_path)}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )
        for _ in range(2)
    ]
    for process in both:
        assert process.stdout.readline() == "ready\n"
    for process in both:  # both look into the store before either has solved
        process.stdin.write("go\n")
        process.stdin.flush()
    assert [process.wait(timeout=120) for process in both] == [0, 0]
    (kept,) = tmp_path.iterdir()
    flow = storage.read_flow(kept)
    assert len(flow.intervals[0].cells) > 1000


def test_a_flow_in_use_outlives_its_name(own_store):
    flow = obtain_flow(configure(), SELF).flow
    before = flow.intervals[0].flux
    storage.write_flow(own_store, flow, SELF)  # by a process that has solved the same
    own_store.unlink()
    fresh = dataclasses.replace(flow)
    fresh.intervals._last = None
    assert np.array_equal(fresh.intervals[0].flux, before)


def test_kept_arrays_that_are_damaged_are_not_recalled(tmp_path):
    store = Store(tmp_path)
    memory = store.memory_of()
    memory.keep({"a": 1}, {"x": np.arange(400.0)})
    (path,) = tmp_path.iterdir()
    edit(path, lambda file: file["x"].__setitem__(3, 7.0))
    assert memory.recall({"a": 1}) is None
    assert path.with_name(path.name + ".damaged").exists()


def test_the_key_of_a_flow_holds_all_code_that_it_can_depend_on(tmp_path, monkeypatch):
    from scaleup_surface_layer import SurfaceLayer

    files = source_hash._reached(source_hash.package_files(SurfaceLayer))
    names = {file.stem for file in files}
    assert {"nearest_fluxes", "cut_kernel", "parallel", "grid"} <= names
    assert not {"cli", "report", "figures", "blending"} & names
    package = tmp_path / "scaleup_own"
    package.mkdir()
    (package / "__init__.py").write_text("class Own:\n    pass\n")
    (package / "table.csv").write_text("1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    from scaleup_own import Own

    before = source_hash.of_flow_code.__wrapped__(Own)
    (package / "table.csv").write_text("2\n")
    assert source_hash.of_flow_code.__wrapped__(Own) != before


def test_leftovers_of_killed_processes_go_and_those_of_live_ones_stay(own_store, monkeypatch):
    ended = subprocess.Popen(["true"])
    ended.wait()
    names = {
        number: own_store.with_name(f".flow-1.h5.{processes.host()}.{number}.tmp")
        for number in (ended.pid, os.getpid())
    }
    for path in names.values():
        path.touch()
    flow = obtain_flow(configure(), SELF).flow
    storage.write_flow(own_store.with_name("flow-2.h5"), flow, SELF)
    assert not names[ended.pid].exists()
    assert names[os.getpid()].exists()
    monkeypatch.setenv("SCALEUP_CACHE", "~/x")
    assert str(Store().folder) == os.path.expanduser("~/x")


def test_leftovers_are_not_published(killed):
    left = work_folder(killed) / ".checkpoint.h5.far-00000000.7.tmp"
    left.touch()
    pipeline.run(configure(), killed, SELF, resume=True)
    assert [path.name for path in killed.iterdir() if path.name.startswith(".")] == []
    assert not (killed / "fields").exists()


# --- disks ------------------------------------------------------------------------------------


@pytest.fixture
def full_disk():
    """Files may not grow beyond 20 kB."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_names_the_file_and_leaves_the_last_checkpoint(tmp_path, full_disk):
    path = tmp_path / "checkpoint.h5"
    storage.write_checkpoint(path, {"concentration": np.zeros((2, 10))}, {})
    with pytest.raises(OSError, match="File too large") as caught:
        storage.write_checkpoint(path, {"concentration": np.zeros((2, 10000))}, {})
    assert caught.value.filename == str(path)
    assert storage.read_checkpoint(path)[0]["concentration"].shape == (2, 10)
    assert list(tmp_path.iterdir()) == [path]


FULL = """
import os, resource, signal, sys
from pathlib import Path
from mpi4py import MPI
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from scaleup.flow import storage
from scaleup.command.cli import cli, main
from synthetic import sloshing
flow = sloshing(columns=80, rows=30)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), -1))
path, sys.argv[1:] = Path(sys.argv[1]), ["fill"]
cli.command("fill")(lambda: storage.write_flow(path, flow, MPI.COMM_SELF))
main()
"""


@pytest.mark.parametrize("limit", [20_000, 200_000])
def test_a_flow_that_finds_no_room_ends_in_one_sentence(tmp_path, limit):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "flow.h5"), str(limit)],
        capture_output=True, text=True, check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith(f"Error: {tmp_path / 'flow.h5'}: File too large"), done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


# --- what comes after a run ------------------------------------------------------------------


def fail(*arguments, **named):
    raise RuntimeError("it broke")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("write_report", "the figures could not be written: it broke"),
        ("record_run", "costs.jsonl, for estimates of later runs could not be written"),
        ("compile_report", None),
    ],
)
def test_a_finished_run_is_published_whatever_fails_afterwards(
    store, quick, tmp_path, monkeypatch, name, what
):
    monkeypatch.setattr(pipeline, name, fail)
    folder = pipeline.run(configure("accuracy.estimate=false"), tmp_path / "run", SELF)
    assert (folder / "results.h5").exists()
    if what is not None:
        warnings = json.loads((folder / "report.json").read_text())["warnings"]
        assert any(what in sentence for sentence in warnings)


def test_an_error_estimate_that_fails_leaves_the_run(store, quick, tmp_path, monkeypatch):
    blend = pipeline.mix

    def mix(case, flow, **how):
        if how.get("results") is None:
            raise RunError("it broke")
        return blend(case, flow, **how)

    monkeypatch.setattr(pipeline, "mix", mix)
    folder = pipeline.run(configure(), tmp_path / "run", SELF)
    estimate = json.loads((folder / "report.json").read_text())["error_estimate"]
    assert "it broke" in estimate["segregation_intensity_reason"]


@pytest.mark.parametrize("content", [b"\xff\xfe\n", b"garbage\n{}\n[1]\n", b'{"cells": 0}\n'])
def test_records_of_costs_that_are_damaged_do_no_harm(tmp_path, content):
    line = {
        "geometry": "drum", "flow": "a", "mixing": "b", "dimension": 2, "cells": 0, "ranks": 1,
        "revolutions": 1.0, "steps": 3, "flow_s": None, "mixing_s": 1.0, "memory": 1e9,
    }  # fmt: skip
    good = json.dumps(line | {"cells": 7}).encode() + b"\n"
    path = tmp_path / "costs.jsonl"
    path.write_bytes(content + json.dumps(line).encode() + b"\n" + good)
    assert [cost.cells for cost in costs.known(Store(tmp_path))] == [7]


def test_records_of_costs_that_cannot_be_written_do_no_harm(own_store, quick, tmp_path):
    (own_store.parent / "costs.jsonl").mkdir()
    pipeline.run(configure(revolutions=0.1), tmp_path / "run", SELF)
    warnings = json.loads((tmp_path / "run/report.json").read_text())["warnings"]
    assert any("costs.jsonl" in sentence for sentence in warnings)


@pytest.mark.parametrize("full", [True, False])
def test_an_output_that_is_a_link_is_written_where_it_leads(store, quick, tmp_path, full):
    (tmp_path / "disk").mkdir()
    if full:
        (tmp_path / "disk" / "target").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "disk" / "target")
    pipeline.run(configure("accuracy.estimate=false"), real_folder(link), SELF)
    assert link.is_symlink()
    assert (link / "report.json").exists()
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["target"]


def test_an_output_that_is_a_file_system_is_refused_at_the_start():
    with pytest.raises(InputError, match="is a file system of its own"):
        check_output(Path("/proc"), overwrite=True, resume=False)
