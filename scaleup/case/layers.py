"""Layers of a configuration: read from TOML and from assignments, merged one over the other."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scaleup.system.errors import InputError, shown
from scaleup.system.files import read_text

_DEEPEST = 6  # tables within each other; no key needs as many
_EXCLUSIVE = {("operation", "fill"), ("grid",)}
_CHOICE: dict[tuple[str, ...], str] = {
    ("geometry",): "name",
    ("flow",): "name",
    ("mixing",): "name",
    ("operation", "loading"): "pattern",
}
_PROVENANCE = "provenance"  # texts that tell where a table's other values come from


def read_layer(file: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises InputError."""
    try:
        tables = tomllib.loads(read_text(file))
    except OSError as error:
        raise InputError(f"the configuration {file} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        byte = error.object[error.start]
        raise InputError(
            f"the configuration {file} is no text in UTF-8 (byte 0x{byte:02x} at {error.start}); "
            "save it as UTF-8"
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"the configuration {file} is not TOML: {error}") from error
    _require_shallow(tables, f"the configuration {file}")
    return tables


def _require_shallow(value: Any, what: str) -> None:
    level: list[Any] = [value]
    for _ in range(_DEEPEST):
        inner = [i.values() if isinstance(i, Mapping) else i for i in level]
        level = [x for i in inner for x in i if isinstance(x, Mapping | list)]
    if level:
        raise InputError(f"{what} holds tables more than {_DEEPEST} deep; no key is")


def spelt_out(layer: Mapping[str, Any]) -> dict[str, Any]:
    """The layer with `loading = "name"` written as the table it stands for."""
    operation = layer.get("operation")
    if isinstance(operation, Mapping) and isinstance(operation.get("loading"), str):
        return {**layer, "operation": {**operation, "loading": {"pattern": operation["loading"]}}}
    return dict(layer)


def assigned(text: str) -> dict[str, Any]:
    """The tables of `section.key=value`; a value is read as TOML, else taken as text."""
    key, equals, value = text.partition("=")
    path = key.strip().split(".")
    if not equals or not 2 <= len(path) <= _DEEPEST or not all(path):
        raise InputError(f"--set {shown(text)}: write it as section.key=value")
    try:
        table = tomllib.loads(f"value = {value}")
        parsed: Any = table["value"] if len(table) == 1 else value.strip()
    except (ValueError, RecursionError):
        parsed = value.strip()
    _require_shallow([parsed], f"--set {shown(text)}")
    return nested(path, parsed)


def nested(path: Sequence[str], value: Any) -> dict[str, Any]:
    """Tables within each other that hold a value at a path of keys."""
    for part in reversed(path):
        value = {part: value}
    return dict(value)


def merged(
    base: Mapping[str, Any],
    over: Mapping[str, Any],
    path: tuple[str, ...] = (),
    within_layer: bool = False,
) -> dict[str, Any]:
    """The tables of `base` with those of `over` on top; a value loses the provenance of another.

    within_layer -- whether tables whose keys exclude each other are merged, too
    """
    result = dict(base)
    for key, value in over.items():
        here, old = (*path, key), result.get(key)
        merge = isinstance(value, Mapping) and isinstance(old, Mapping)
        if merge and (within_layer or not _replaces(here, old or {}, value)):
            value = merged(old or {}, value, here, within_layer)
        result[key] = value
    told = result.get(_PROVENANCE)
    if isinstance(told, Mapping) and not within_layer:  # of values that are no longer there
        stale = over.keys() - set(over.get(_PROVENANCE, ()))
        result[_PROVENANCE] = {key: text for key, text in told.items() if key not in stale}
    return result


def _replaces(path: tuple[str, ...], old: Mapping[str, Any], new: Mapping[str, Any]) -> bool:
    choice = _CHOICE.get(path)
    return path in _EXCLUSIVE or (
        choice is not None and new.get(choice, old.get(choice)) != old.get(choice)
    )
