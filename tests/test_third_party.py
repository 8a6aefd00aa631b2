"""A third party's distribution, installed in an environment of its own, is found and runs."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

SOURCE = Path(__file__).parent / "third_party"


def test_an_installed_distribution_appears_and_runs(store, tmp_path):
    environment = tmp_path / "env"
    subprocess.run(
        [sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", environment],
        check=True,
    )
    python = environment / "bin" / "python"
    packages = next((environment / "lib").glob("python3*/site-packages"))
    ours = sysconfig.get_paths()["purelib"]
    (packages / "ours.pth").write_text(f"import site; site.addsitedir({ours!r})\n")
    source = shutil.copytree(SOURCE, tmp_path / "source")
    installed = subprocess.run(
        [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps",
         "--no-build-isolation", "--no-index", source],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert installed.returncode == 0, installed.stderr

    def scaleup(*arguments):
        return subprocess.run(
            [python, "-m", "scaleup", *arguments],
            capture_output=True, text=True, cwd=tmp_path, check=False,
            env={**os.environ, "SCALEUP_CACHE": str(store)},
        )  # fmt: skip

    listed = scaleup("plugins", "list")
    assert "tin                  scaleup-tin 0.3" in listed.stdout
    assert "drum" in listed.stdout
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
