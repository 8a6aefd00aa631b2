"""Hashes of source code: what a stored result was computed with."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
from collections.abc import Iterable
from functools import cache
from pathlib import Path

_CORE = Path(__file__).parents[1]
_FLOW_STARTS = ("contract", "flow/storage")
"""modules of scaleup that a flow passes through on its way from a plugin into the store"""


@cache
def of_flow_code(*plugins: type) -> str:
    """Hash of the plugins' packages and of all modules of scaleup that their flow can depend on.

    Those are the ones that `scaleup.contract`, the store or the packages themselves import,
    directly or not: not the command line, the report or the figures.
    """
    files = [file for plugin in plugins for file in package_files(plugin)]
    return _digest([*files, *_reached(files)])


@cache
def of_run_code(*plugins: type) -> str:
    """Hash of the plugins' packages and of all of scaleup."""
    files = [file for plugin in plugins for file in package_files(plugin)]
    return _digest([*files, *_CORE.rglob("*.py")])


def package_files(plugin: type) -> list[Path]:
    """Files of the top-level package, or the one module, that a plugin comes from."""
    spec = importlib.util.find_spec(plugin.__module__.partition(".")[0])
    if spec is None or not spec.submodule_search_locations:
        return [Path(inspect.getfile(plugin))]
    return [
        file
        for place in spec.submodule_search_locations
        for file in Path(place).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    ]


def _digest(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in sorted(set(files)):
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)} ".encode())
        digest.update(content)
    return digest.hexdigest()


def _reached(sources: Iterable[Path]) -> set[Path]:
    """Modules of scaleup that are imported from `_FLOW_STARTS` and `sources`, directly or not."""
    found: set[Path] = set()
    waiting = {_CORE / f"{name}.py" for name in _FLOW_STARTS}
    for file in sources:
        waiting |= _imported(file)
    while waiting:
        file = waiting.pop()
        found.add(file)
        waiting |= _imported(file) - found
    return found


def _imported(file: Path) -> set[Path]:
    """Modules of scaleup that a source file imports, anywhere in it."""
    if file.suffix != ".py":
        return set()
    found: set[Path] = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            top, *rest = name.split(".")
            if top == "scaleup":
                place = _CORE.joinpath(*rest)
                found |= {
                    p for p in (place.with_suffix(".py"), place / "__init__.py") if p.exists()
                }
    return found
