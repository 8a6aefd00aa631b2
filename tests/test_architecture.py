"""Data flows one way, and imports follow it: the contracts in pyproject.toml, and a late MPI."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
HEAVY = {"mpi4py", "petsc4py", "ngsolve", "netgen"}
BEFORE_THE_LAUNCH = [
    *sorted((REPOSITORY / "scaleup").glob("*.py")),
    *(REPOSITORY / "scaleup" / path for path in ("command/cli.py", "system/launch.py")),
    *sorted((REPOSITORY / "scaleup/case").glob("*.py")),
    *sorted((REPOSITORY / "scaleup/scene").glob("*.py")),
    *sorted((REPOSITORY / "scaleup/vessels").glob("*.py")),
    *sorted(REPOSITORY.glob("plugins/*/__init__.py")),
    *sorted(REPOSITORY.glob("geometries/*/__init__.py")),
]


def imports_at_top(path: Path) -> set[str]:
    """Top-level packages that a module imports when it is imported itself."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
    return {name.split(".")[0] for name in found}


def test_imports_run_one_way():
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert done.returncode == 0, done.stdout


def test_modules_that_plugins_import_from_their_own_package_exist():
    """Also where they do so late, as what needs NGSolve or PETSc does."""
    for path in (*REPOSITORY.glob("plugins/*/*.py"), *REPOSITORY.glob("geometries/*/*.py")):
        package = path.parent
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not node.module:
                continue
            first, _, rest = node.module.partition(".")
            module = node.module if node.level == 1 else rest if first == package.name else ""
            if module:
                wanted = package / module.replace(".", "/")
                assert wanted.is_dir() or wanted.with_suffix(".py").exists(), (path, node.module)


@pytest.mark.parametrize(
    "path", BEFORE_THE_LAUNCH, ids=lambda path: str(path.relative_to(REPOSITORY))
)
def test_what_runs_before_the_launch_does_not_start_mpi(path):
    assert not imports_at_top(path) & HEAVY
