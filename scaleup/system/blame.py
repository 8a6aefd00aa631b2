"""Errors that nobody foresaw, as one sentence that names the plugin that they came from.

A plugin may raise anything, anywhere: when it is made, when a flow asks a geometry for a distance,
while it solves. The traceback tells whose code it was; where that holds no line of the plugin (it
cannot be made, it lacks a method, it returns what it must not), `blamed_on` says who was asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import walk_tb

from scaleup.system.errors import ContractError, ScaleupError, UnforeseenError, file_error
from scaleup.system.registry import GROUPS, Kind, available, described


@contextmanager
def blamed_on(kind: Kind, name: str) -> Iterator[None]:
    """Errors that a plugin raises within, or that come of what it returned, name it."""
    try:
        yield
    except ContractError as error:
        raise ContractError(f"{described(kind, name)} broke its contract: {error}") from error
    except (Exception, SystemExit) as error:
        raise told(error, (kind, name)) from error


def told(error: BaseException, asked: tuple[Kind, str] | None = None) -> ScaleupError:
    """The error if it was made for the user, else a sentence on it.

    asked -- kind and name of the plugin to name if the traceback does not show another
    """
    if isinstance(error, ScaleupError):
        return error
    plugin, where = _raised_in(error, asked)
    if isinstance(error, OSError) and plugin is None:
        return file_error(error)
    what = f"{type(error).__name__}: {error}"
    if plugin is None:
        sentence = f"unexpected {what} ({where}): this is a defect of scaleup"
    else:
        sentence = f"{described(*plugin)} failed with {what} ({where})"
    found = UnforeseenError(f"{sentence}; 'scaleup --debug ...' shows the traceback")
    found.__cause__ = error
    return found


def _raised_in(
    error: BaseException, asked: tuple[Kind, str] | None
) -> tuple[tuple[Kind, str] | None, str]:
    """The plugin whose code an error came from, else the one that was asked; and the line."""
    owners = _packages()
    frames = [
        (str(frame.f_globals.get("__name__", "")).partition(".")[0], frame.f_code.co_filename, line)
        for frame, line in walk_tb(error.__traceback__)
    ]
    ours = [entry for entry in frames if entry[0] in owners or entry[0] == "scaleup"]
    if isinstance(error, OSError) and ours and ours[-1][0] == "scaleup":
        return None, ""  # a full disk is no plugin's fault
    of_plugins = [entry for entry in ours if entry[0] in owners]
    package, file, line = (of_plugins or ours or frames or [("", "no file", 0)])[-1]
    if isinstance(error, AttributeError) and not of_plugins:  # a plugin's object may lack it
        package = type(error.obj).__module__.partition(".")[0]
    owned = owners.get(package, [])
    found = asked if asked in owned or not owned else owned[0]
    return found, f"{Path(file).parent.name}/{Path(file).name}, line {line}"


def _packages() -> dict[str, list[tuple[Kind, str]]]:
    """The plugins that each top package registers, no others."""
    found: dict[str, list[tuple[Kind, str]]] = {}
    for kind in GROUPS:
        try:
            points = available(kind)
        except ScaleupError:  # a name registered twice is said where it is used
            continue
        for name, point in points.items():
            found.setdefault(point.module.partition(".")[0], []).append((kind, name))
    return found
