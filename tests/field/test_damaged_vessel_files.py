"""Damaged vessel files: one sentence or a sound vessel, never a traceback, a signal or a hang."""

import subprocess
import sys
from pathlib import Path

import pytest

from scaleup.contract import InputError
from scaleup_mesh import Mesh

PROGRAM = Path(__file__).with_name("fuzz_vessel_files.py")
BY_PYTHON = ("stl", "stl_ascii", "obj", "off", "ply", "ply_ascii")
BY_A_PROCESS = ("vtk", "vtk_binary", "vtu", "vtu_binary", "msh", "msh_binary", "step")


def outcomes(folder, count, number, kinds):
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(folder), str(count), str(number), *kinds],
        capture_output=True,
        text=True,
        timeout=3600,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-3000:]
    found = [line for line in done.stdout.splitlines() if line.endswith((" sound", " refused"))]
    assert {line.split()[0] for line in found} <= set(kinds)
    return found


def test_mutated_files_are_refused_or_sound(tmp_path):
    found = outcomes(tmp_path, 10, 1, BY_PYTHON)
    assert len(found) > 30
    assert {line.split()[1] for line in found} == {"sound", "refused"}


def test_mutated_files_do_not_crash_compiled_readers(tmp_path):
    assert outcomes(tmp_path, 1, 2, ("vtk_binary", "vtu", "msh_binary", "step"))


@pytest.mark.slow
def test_thousands_of_mutated_files_are_refused_or_sound(tmp_path):
    assert len(outcomes(tmp_path, 500, 3, BY_PYTHON)) > 1000
    assert len(outcomes(tmp_path, 40, 4, BY_A_PROCESS)) > 100


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("huge.stl", bytes(80) + (4_000_000_000).to_bytes(4, "little") + bytes(500)),
        ("huge.off", b"OFF\n4000000000 4000000000 0\n0 0 0\n"),
        (
            "huge.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
            b"property float y\nproperty float z\nelement face 4000000000\n"
            b"property list uchar int vertex_indices\nend_header\n",
        ),
        (
            "huge.vtk",
            b"# vtk DataFile Version 3.0\nx\nBINARY\nDATASET POLYDATA\nPOINTS 4000000000 double\n",
        ),
        ("empty.stl", b""),
        ("empty.step", b""),
        ("empty.vtu", b""),
        ("no_suffix", b"solid"),
    ],
)
def test_what_claims_much_and_holds_nothing_is_refused(tmp_path, name, content):
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"^geometry\.file = .*cannot be read as|holds no"):
        Mesh(Mesh.Options(file=file, unit="mm"))
