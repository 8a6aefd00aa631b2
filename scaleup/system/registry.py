"""Plugins found through entry points; this module alone reads them.

Names are listed without importing anything. A plugin is imported when it is used, and an error in
it is reported with its distribution's name.
"""

from __future__ import annotations

import importlib.util
import sys
import warnings
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from pydantic import BaseModel

from scaleup.system.errors import PluginError, did_you_mean, shown

Kind = Literal["geometry", "flow", "mixing"]
GROUPS: dict[Kind, str] = {
    "geometry": "scaleup.geometries",
    "flow": "scaleup.flow",
    "mixing": "scaleup.mixing",
}


def available(kind: Kind) -> dict[str, EntryPoint]:
    """Registered names of one kind, in alphabetical order, without importing any plugin.

    Raises PluginError if two distributions register the same name.
    """
    found: dict[str, EntryPoint] = {}
    for point in registered(GROUPS[kind], tuple(sys.path)):
        other = found.get(point.name)
        if other is None:
            found[point.name] = point
        elif (other.value, distribution(other)) != (point.value, distribution(point)):
            raise PluginError(
                f"the {kind} {point.name!r} is registered twice, by {distribution(other)} and by "
                f"{distribution(point)}; uninstall one of them"
            )
    return found


@lru_cache
def registered(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Entry points of a group by name, read once: a search of all that is installed on `path`."""
    return tuple(sorted(entry_points(group=group), key=lambda point: point.name))


def load(kind: Kind, name: str) -> Any:
    """The plugin class registered under a name.

    Raises PluginError if the name is unknown (listing the known ones) or if importing it fails
    (naming the distribution it came from).
    """
    known = available(kind)
    if name not in known:
        raise PluginError(unknown(f"{kind}.name", name, kind, list(known)))
    point = known[name]
    try:
        plugin = point.load()
    except (Exception, SystemExit) as error:
        raise PluginError(
            f"{described(kind, name)} cannot be imported ({type(error).__name__}: {error})"
        ) from error
    options = getattr(plugin, "Options", None)
    if options is None:
        raise PluginError(f"{described(kind, name)} has no Options class")
    if not (isinstance(options, type) and issubclass(options, BaseModel)):
        raise PluginError(f"{described(kind, name)} has Options that are no PluginOptions")
    return plugin


def unknown(key: str, name: str, what: str, known: list[str]) -> str:
    """The sentence on a name that is not registered: the nearest one, and all there are."""
    meant, installed = did_you_mean(name, known), ", ".join(known) or "none"
    return f"{key} = {shown(name)}: no such {what}{meant}; installed are: {installed}"


def described(kind: Kind, name: str) -> str:
    """A plugin with the distribution that it comes from, for errors."""
    return f"the {kind} {name!r} of the distribution {distribution(available(kind)[name])}"


def warn_of_broken(kind: Kind) -> None:
    """Warn of registered plugins whose package is not there, without importing any."""
    for name, point in available(kind).items():
        if importlib.util.find_spec(point.module.partition(".")[0]) is None:
            warnings.warn(
                f"{described(kind, name)} is broken: there is no module {point.module!r}",
                stacklevel=2,
            )


def distribution(point: EntryPoint) -> str:
    """Name and version of the distribution that registers an entry point."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else "unknown"
