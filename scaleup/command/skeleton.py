"""A third party's plugin to start from: `scaleup plugins new`."""

from __future__ import annotations

import re
from pathlib import Path

import jinja2

from scaleup.system import registry
from scaleup.system.errors import InputError, file_error

_TEMPLATE = "geometry_plugin"
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


def make_skeleton(name: str, parent: Path) -> Path:
    """Write an installable distribution with a blender of the given name to parent/name.

    Raises InputError for a name that cannot be, is taken, or has a folder already.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"NAME = {name!r}: must be lower-case words of letters and digits, joined by hyphens, "
            "as in 'double-cone'"
        )
    if name in registry.available("geometry"):
        raise InputError(f"NAME = {name!r}: a geometry of this name is installed; take another")
    folder = parent / name
    if folder.exists():
        raise InputError(f"NAME = {name!r}: {folder} exists; nothing is overwritten")
    for path, text in skeleton_files(name).items():
        try:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_text(text, encoding="utf-8")
        except OSError as error:
            raise file_error(error) from error
    return folder


def skeleton_files(name: str) -> dict[Path, str]:
    """The distribution's files, by their paths in its folder."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("scaleup.command", f"templates/{_TEMPLATE}"),
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,
    )
    package = "scaleup_" + name.replace("-", "_")
    words = {"name": name, "package": package, "cls": name.title().replace("-", "")}
    files = {}
    for template in environment.list_templates(extensions=["jinja"]):
        path = Path(template.removesuffix(".jinja"))
        parts = [package if part == "package" else part for part in path.parts]
        files[Path(*parts)] = environment.get_template(template).render(words)
    return files
