"""Plugins found through entry points; this module alone reads them.

Names are listed without importing anything. A plugin is imported when it is used, and an error in
it is reported with its distribution's name.
"""

from __future__ import annotations

import importlib.util
import sys
import warnings
from abc import ABC
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Literal

from pydantic import BaseModel

from scaleup.system.errors import PluginError, did_you_mean, shown

Kind = Literal["geometry", "flow", "mixing"]
GROUPS: dict[Kind, str] = {
    "geometry": "scaleup.geometries",
    "flow": "scaleup.flow",
    "mixing": "scaleup.mixing",
}
_bases: dict[Kind, type[Plugin]] = {}


class Plugin(ABC):
    """What is common to plugins of all kinds. They derive from the base of their kind."""

    Options: ClassVar[type[BaseModel]]

    def __init_subclass__(cls, kind: Kind | None = None):
        """`kind`: of the plugins that this class is the base of."""
        super().__init_subclass__()
        if kind is not None:
            _bases[kind] = cls

    def __init__(self, options: Any):
        self.options = options


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

    Raises PluginError if the name is unknown (listing the known ones), or, naming the distribution
    it came from, if importing it fails or it is no plugin of this kind.
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
    lack = _lack(kind, plugin)
    if lack:
        raise PluginError(f"{described(kind, name)} {lack}")
    return plugin


def _lack(kind: Kind, plugin: Any) -> str:
    """What a registered object lacks to be a plugin of a kind; empty if nothing."""
    base = _bases.get(kind)  # none: what defines it was never imported, nor derived from
    if base is None or not (isinstance(plugin, type) and issubclass(plugin, base)):
        return f"is no class derived from scaleup.contract.{kind.title()}"
    if plugin.__abstractmethods__:
        return f"does not define {', '.join(sorted(plugin.__abstractmethods__))}"
    options = getattr(plugin, "Options", None)
    if not (isinstance(options, type) and issubclass(options, BaseModel)):
        return "has no class Options derived from scaleup.contract.PluginOptions"
    forms = getattr(plugin, "forms", {}).values()
    if not all(isinstance(form, type) and issubclass(form, options) for form in forms):
        return "has forms that do not derive from its Options"
    return ""


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
