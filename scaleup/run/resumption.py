"""Going on with a run: only as it was begun.

A checkpoint names the configuration and the code that it was computed with. What may differ when
the run goes on is what has no part in the fields and the blend curve so far (`_FREE`), and the
number of revolutions, if the run has not turned further already.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scaleup.case.case import Case
from scaleup.case.config import PLUGIN_SECTIONS
from scaleup.flow import storage
from scaleup.space.grid import FloatArray
from scaleup.system import source_hash
from scaleup.system.errors import InputError
from scaleup.system.hdf5 import DamagedFileError

_FREE = {
    "accuracy.blended_rsd",
    "accuracy.estimate",
    "accuracy.tolerance",
    "operation.revolutions",
    "output.checkpoint_every",
}
_FREE_TABLES = ("material.provenance.", "particles.")
_ABSENT = "not given"


def identity(case: Case) -> dict[str, Any]:
    """What makes a run the one that it is, JSON-like: `config` and `code`."""
    plugins = [case.plugin_class(kind) for kind in PLUGIN_SECTIONS]
    return {
        "config": tomllib.loads(case.to_toml()),
        "shape": case.geometry.fingerprint,
        "code": source_hash.of_run_code(*plugins),
    }


def read_state(path: Path, case: Case, *, changed_code: bool) -> tuple[FloatArray, dict[str, Any]]:
    """Concentration and state of a checkpoint. Raises InputError unless it is of this run.

    changed_code -- whether it is of this run, too, if it was computed with other code
    """
    again = "simulate it again (scaleup simulate FOLDER.partial/config.toml --output FOLDER "
    again += "--overwrite)"
    try:
        arrays, state = storage.read_checkpoint(path)
        begun, reached = state["run"], state["revolution"]
        concentration = arrays["concentration"]
    except (DamagedFileError, KeyError) as error:
        raise InputError(f"{error}; {again}") from error
    now = identity(case)
    changes = _changes(_flat(begun["config"]), _flat(now["config"]))
    if changes:
        raise InputError(
            f"{path.with_name('config.toml')}: {', '.join(changes)}: a run goes on only as it was "
            "begun; put the old values back, or simulate the new ones into another folder"
        )
    if begun["shape"] != now["shape"]:
        raise InputError(f"{path}: the file of the vessel's shape has changed; {again}")
    if begun["code"] != now["code"] and not changed_code:
        raise InputError(
            f"{path}: was computed with other code (scaleup or a plugin has changed); go on with "
            f"that one, or with --changed-code with this one, or {again}"
        )
    if case.operation.revolutions < reached - 1e-9:
        raise InputError(
            f"operation.revolutions = {case.operation.revolutions:g}: the run has turned "
            f"{reached:g} already"
        )
    if begun["code"] != now["code"]:
        state["blend"]["remarks"].append(
            f"the code has changed at revolution {reached:g}, where this run was resumed"
        )
    return concentration, state


def _changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return [
        f"{key} = {new.get(key, _ABSENT)} (was {old.get(key, _ABSENT)})"
        for key in sorted(old.keys() | new.keys())
        if key not in _FREE
        and not key.startswith(_FREE_TABLES)
        and old.get(key, _ABSENT) != new.get(key, _ABSENT)
    ]


def _flat(tables: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found
