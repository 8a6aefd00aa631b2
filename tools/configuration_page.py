"""Writes docs/configuration.md from the configuration's own models; a test keeps it current."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from scaleup.case.config import PLUGIN_SECTIONS, RunConfig
from scaleup.case.forms import options_by_form
from scaleup.system import registry

PAGE = Path(__file__).resolve().parents[1] / "docs" / "configuration.md"
HEAD = """# Configuration

Every table and key of a run (this page is written by `tools/configuration_page.py`). Quantities
carry units (`"140 mm"`, `"6 rpm"`, `"23.6 deg"`); bare numbers are SI, and defaults below are SI.
Units may be spelt as people do (`RPM`, `rev/min`, `kg/m3`, `m³`, `g·cm⁻³`, `38°`, `35 %`) and
numbers with a decimal comma where it cannot be one of thousands. A speed in Hz or 1/min counts
turns; 1/s is refused, since it may count turns or radians. The file is UTF-8, with or without a
byte order mark, or UTF-16 with one. A misspelt key is an error. The kinds of `operation.fill` and
of `grid` exclude each other: setting one replaces the other. A geometry's default scene comes
before the defaults here.

What cannot be is refused before anything is computed: a bed without room to flow (more than 95 %
of the vessel), less than 4 grains or 3 cells deep, or of less than 30 cells; cells or memory
beyond the machine's; samples that do not fit the bed; more than 10^5 points of the blend curve and
snapshots or 10^8 mixing steps; a layer or region of less than a cell. A vessel turns one way,
counter-clockwise: for the other way mirror the loading.
"""


def _rows(fields: Mapping[str, FieldInfo], prefix: str) -> list[str]:
    rows = []
    for name, field in fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            rows += _rows(field.annotation.model_fields, f"{prefix}{name}.")
            continue
        default = field.get_default(call_default_factory=True)
        shown = "" if field.is_required() or default is None else f"`{_shown(default)}`"
        text = " ".join((field.description or "").split())
        rows.append(f"| `{prefix}{name}` | {shown} | {text} |")
    return rows


def _table(fields: Mapping[str, FieldInfo], prefix: str) -> str:
    return "\n".join(["| key | default | meaning |\n|---|---|---|", *_rows(fields, prefix)]) + "\n"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for name, field in RunConfig.model_fields.items():
        if name in PLUGIN_SECTIONS:
            for plugin in registry.available(name):
                parts.append(f'## [{name}] with name = "{plugin}"\n')
                for title, fields in options_by_form(registry.load(name, plugin)):
                    if title != "options:":
                        parts.append(f"{title[:1].upper()}{title[1:]}\n")
                    parts.append(_table(fields, f"{name}."))
            continue
        model = field.annotation
        assert isinstance(model, type)
        parts.append(f"## [{name}]\n\n{' '.join((model.__doc__ or '').split())}\n")
        parts.append(_table(model.model_fields, f"{name}."))
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
