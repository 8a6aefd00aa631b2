"""A third party's distribution, installed in an environment of its own, is found and runs."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.case.config import PLUGIN_SECTIONS
from scaleup.command.cli import cli
from scaleup.command.skeleton import make_skeleton, skeleton_files
from scaleup.run.pipeline import run
from scaleup.run.plugin_check import check_plugin
from scaleup.system import registry

HERE = Path(__file__).parent
EXAMPLE = HERE.parent / "docs" / "example_plugin"


@pytest.fixture
def third_party(store, tmp_path):
    """Install distributions beside ours; returns the command line there and site-packages."""

    def install(*sources):
        environment = tmp_path / "env"
        subprocess.run(
            [sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", environment],
            check=True,
        )
        python = environment / "bin" / "python"
        packages = next((environment / "lib").glob("python3*/site-packages"))
        ours = sysconfig.get_paths()["purelib"]
        (packages / "ours.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
        copies = [shutil.copytree(source, tmp_path / "sources" / source.name) for source in sources]
        installed = subprocess.run(
            [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
             "--no-build-isolation", "--no-index", *copies],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert installed.returncode == 0, installed.stderr

        def scaleup(*arguments):
            return subprocess.run(
                [python, "-m", "scaleup", *arguments],
                capture_output=True, text=True, cwd=tmp_path, check=False,
                env={**os.environ, "SCALEUP_CACHE": str(store)},
            )  # fmt: skip

        return scaleup, packages

    return install


def test_installed_distributions_appear_and_run(third_party, tmp_path):
    new = [make_skeleton(f"new-{kind}", tmp_path, kind) for kind in PLUGIN_SECTIONS]
    scaleup, packages = third_party(HERE / "third_party", *new)
    listed = scaleup("plugins", "list")
    assert "tin                  scaleup-tin 0.3" in listed.stdout
    assert "drum" in listed.stdout
    for kind in PLUGIN_SECTIONS:
        assert f"new-{kind}".ljust(21) + f"scaleup-new-{kind} 0.1.0" in listed.stdout
    checked = scaleup("plugins", "check", "tin")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert "skip" not in checked.stdout
    assert "ok   the flow 'surface-layer' solves 'tin' and keeps its invariants" in checked.stdout
    assert "ok   the mixing 'lax-wendroff' blends on it" in checked.stdout
    done = scaleup("simulate", "--geometry", "tin", "--output", "run")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "report.json").exists()

    # its package gone: still listed, with a warning that names the distribution
    shutil.rmtree(packages / "scaleup_tin")
    listed = scaleup("plugins", "list")
    assert "the geometry 'tin' of the distribution scaleup-tin 0.3 is broken" in listed.stderr
    broken = scaleup("simulate", "--geometry", "tin", "--output", "other")
    assert broken.returncode == 2
    assert "scaleup-tin 0.3 cannot be imported" in broken.stderr


@pytest.fixture
def registered(monkeypatch, tmp_path):
    """Make a plugin and put it on the path with the entry point of its pyproject.toml."""

    def register(name, kind):
        folder = make_skeleton(name, tmp_path, kind)
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        info.mkdir()
        metadata = (
            f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        )
        (info / "METADATA").write_text(metadata)
        ((group, points),) = project["entry-points"].items()
        lines = [f"[{group}]", *(f"{name} = {where}" for name, where in points.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(folder)
        return folder

    return register


@pytest.mark.parametrize("kind", PLUGIN_SECTIONS)
def test_a_new_plugin_of_each_kind_passes_its_checks_and_its_tests(store, registered, kind):
    folder = registered(f"new-{kind}", kind)
    settings = ["mixing.name=lax-wendroff"] if kind == "geometry" else []
    found = list(check_plugin(kind, f"new-{kind}", settings, MPI.COMM_SELF))
    assert {finding.outcome for finding in found} == {"ok"}, found
    tests = runpy.run_path(str(folder / "tests" / f"test_{kind}.py"))
    for name, test in tests.items():
        if name.startswith("test_"):
            test()


def test_new_flow_and_mixing_plugins_carry_a_run(store, registered, tmp_path):
    registered("slab", "flow")
    registered("donor", "mixing")
    flags = {"flow": {"name": "slab"}, "mixing": {"name": "donor"}}
    case = compose(None, ["grid.cells=2000", "operation.revolutions=0.5"], flags)
    run(case, tmp_path / "run", MPI.COMM_SELF)
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert 0.2 < report["mixing"]["segregation_intensity"][-1] < 0.5
    assert abs(report["ledger"]["mass_drift"]) < 1e-12


def test_a_geometry_that_fails_its_checks_is_not_given_to_a_flow(store, monkeypatch):
    plugin = registry.load("geometry", "tote")
    right = plugin.signed_distance
    monkeypatch.setattr(plugin, "signed_distance", lambda self, points: -right(self, points) + 0.1)
    found = {each.title: each for each in check_plugin("geometry", "tote", [], MPI.COMM_SELF)}
    assert found["the box lies around the inside"].outcome == "FAIL"
    skipped = found["the flow 'surface-layer' solves it"]
    assert str(skipped).startswith("skip")
    assert skipped.sentence == "first mend what failed above"


def test_the_command_says_what_comes_next(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = CliRunner().invoke(cli, ["plugins", "new", "slab", "--kind", "flow"])
    assert "pip install -e slab --no-deps --no-build-isolation" in made.output
    assert "scaleup simulate --flow slab" in made.output
    assert (tmp_path / "slab" / "scaleup_slab" / "__init__.py").exists()


def test_the_page_on_plugins_shows_what_is_made():
    """Every example of a class in it is part of a file that `scaleup plugins new` writes."""
    page = (EXAMPLE.parent / "writing_a_plugin.md").read_text(encoding="utf-8")
    made = [text for kind in PLUGIN_SECTIONS for text in skeleton_files("tin", kind).values()]
    shown = [block for block in re.findall(r"```python\n(.*?)```", page, re.S) if "class " in block]
    assert len(shown) >= 3
    for block in shown:
        for part in block.split("\n    ...\n"):
            assert any(part.strip("\n") in text for text in made), part


def test_the_example_in_the_documentation_is_the_skeleton():
    files = skeleton_files("double-cone", "geometry")
    for path, text in files.items():
        assert (EXAMPLE / path).read_text(encoding="utf-8") == text, path
    code = next(text for path, text in files.items() if path.name == "__init__.py")
    assert len(code.splitlines()) <= 100
    assert set(files) == {p.relative_to(EXAMPLE) for p in EXAMPLE.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("Double_Cone", "NAME = 'Double_Cone': must be lower-case words"),
        ("../elsewhere", "must be lower-case words"),
        ("tote", "a geometry of this name is installed"),
        ("taken", "taken exists; nothing is overwritten"),
    ],
)
def test_a_skeleton_that_cannot_be_made_is_one_sentence(refused, tmp_path, name, sentence):
    (tmp_path / "taken").mkdir()
    assert sentence in refused("plugins", "new", name)
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_flows_and_mixing_backends_are_checked_too(scaleup, refused):
    flow = scaleup("plugins", "check", "surface-layer", "--set", "mixing.name=lax-wendroff")
    assert flow.returncode == 0, flow.stdout + flow.stderr
    assert "keeps its invariants" in flow.stdout
    mixing = scaleup("plugins", "check", "lax-wendroff")
    assert mixing.returncode == 0, mixing.stdout + mixing.stderr
    assert "ok   a steady flow in 2-D" in mixing.stdout
    assert "no such plugin" in refused("plugins", "check", "nothing")
