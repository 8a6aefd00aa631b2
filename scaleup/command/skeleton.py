"""A third party's plugin to start from: `scaleup plugins new`."""

from __future__ import annotations

import re
from pathlib import Path

import jinja2

from scaleup.system import registry
from scaleup.system.errors import InputError, file_error
from scaleup.system.registry import Kind

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_WORDS: dict[Kind, dict[str, str]] = {
    "geometry": {
        "what": "Blender",
        "start": "a double cone to start from",
        "change": "make its options, its profile and its default scene your vessel's",
    },
    "flow": {
        "what": "Flow model",
        "start": "a bed that turns as one body below a flowing layer",
        "change": "put your own model into `_steady_bed`",
    },
    "mixing": {
        "what": "Mixing backend",
        "start": "explicit upwind fluxes",
        "change": "put your own scheme into `_through_faces`, and state its order and limit",
    },
}


def make_skeleton(name: str, parent: Path, kind: Kind = "geometry") -> Path:
    """Write an installable distribution with a plugin of the given name to parent/name.

    Raises InputError for a name that cannot be, is taken, or has a folder already.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"NAME = {name!r}: must be lower-case words of letters and digits, joined by hyphens, "
            "as in 'double-cone'"
        )
    if name in registry.available(kind):
        raise InputError(f"NAME = {name!r}: a {kind} of this name is installed; take another")
    folder = parent / name
    if folder.exists():
        raise InputError(f"NAME = {name!r}: {folder} exists; nothing is overwritten")
    for path, text in skeleton_files(name, kind).items():
        try:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text, encoding="utf-8")
        except OSError as error:
            raise file_error(error) from error
    return folder


def skeleton_files(name: str, kind: Kind) -> dict[Path, str]:
    """The distribution's files, by their paths in its folder: those of all kinds, then its own."""
    package = "scaleup_" + name.replace("-", "_")
    words = {
        "name": name,
        "package": package,
        "cls": name.title().replace("-", ""),
        "kind": kind,
        "group": registry.GROUPS[kind],
        **_WORDS[kind],
    }
    files = {}
    for folder in ("plugin", f"{kind}_plugin"):
        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("scaleup.command", f"templates/{folder}"),
            keep_trailing_newline=True,
            undefined=jinja2.StrictUndefined,
            autoescape=False,
        )
        for template in environment.list_templates(extensions=["jinja"]):
            path = Path(template.removesuffix(".jinja"))
            parts = [package if part == "package" else part for part in path.parts]
            files[Path(*parts)] = environment.get_template(template).render(words)
    return files
