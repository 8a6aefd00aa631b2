"""A third party's distribution, installed in an environment of its own, is found and runs."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from scaleup.command.skeleton import skeleton_files

HERE = Path(__file__).parent
EXAMPLE = HERE.parent / "docs" / "example_plugin"


@pytest.fixture
def third_party(store, tmp_path):
    """Install a distribution beside ours; returns the command line there and site-packages."""

    def install(source):
        environment = tmp_path / "env"
        subprocess.run(
            [sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", environment],
            check=True,
        )
        python = environment / "bin" / "python"
        packages = next((environment / "lib").glob("python3*/site-packages"))
        ours = sysconfig.get_paths()["purelib"]
        (packages / "ours.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
        copy = shutil.copytree(source, tmp_path / "source")
        installed = subprocess.run(
            [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
             "--no-build-isolation", "--no-index", copy],
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


def test_an_installed_distribution_appears_and_runs(third_party, tmp_path):
    scaleup, packages = third_party(HERE / "third_party")
    listed = scaleup("plugins", "list")
    assert "tin                  scaleup-tin 0.3" in listed.stdout
    assert "drum" in listed.stdout
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


def test_a_new_plugin_passes_its_checks_until_it_is_broken(third_party, scaleup, tmp_path):
    made = scaleup("plugins", "new", "lens-drum")
    assert made.returncode == 0, made.stderr
    assert "pip install -e lens-drum" in made.stdout
    installed, packages = third_party(tmp_path / "lens-drum")
    command = ("plugins", "check", "lens-drum", "--set", "mixing.name=lax-wendroff")
    checked = installed(*command)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    lines = checked.stdout.splitlines()
    assert sum(line.startswith("ok ") for line in lines) >= 10
    assert "ok   the mirror planes mirror the vessel" in lines

    code = packages / "scaleup_lens_drum" / "__init__.py"
    code.write_text(code.read_text().replace("np.pi / 3", "np.pi / 2"))
    checked = installed(*command)
    assert checked.returncode == 1
    assert "FAIL volume agrees with quadrature" in checked.stdout
    assert checked.stderr.startswith("Error: ")
    good = code.read_text().replace("np.pi / 2", "np.pi / 3")
    code.write_text(good.replace("return np.minimum(np", "return -np.minimum(np"))  # inside out
    checked = installed(*command)
    assert checked.returncode == 1
    assert "FAIL the box lies around the inside" in checked.stdout
    assert "skip the flow 'surface-layer' solves it: first mend what failed" in checked.stdout
    code.write_text(code.read_text() + "\nraise RuntimeError('half done')\n")
    checked = installed(*command)
    assert checked.returncode in (1, 2)
    assert "half done" in checked.stdout + checked.stderr
    assert "Traceback" not in checked.stderr


def test_the_example_in_the_documentation_is_the_skeleton():
    files = skeleton_files("double-cone")
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
