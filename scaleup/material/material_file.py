"""The [material] table as a file that any run takes, each value with its provenance."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

import scaleup
from scaleup.case.validating import validated
from scaleup.material.findings import Finding
from scaleup.scene.models import Material
from scaleup.system.errors import InputError
from scaleup.system.files import write_text


def material_table(findings: Sequence[Finding], given: dict[str, Any]) -> dict[str, Any]:
    """The [material] table of what was found, and of values that are given beside.

    Raises InputError if a value is given and found, or is none that a powder has.
    """
    table: dict[str, Any] = {}
    for finding in findings:
        table |= finding.entries
    twice = sorted(table.keys() & given.keys())
    if twice:
        raise InputError(f"--set material.{twice[0]}: is fitted here; set it in the run instead")
    validated(Material, table | given, "material.")
    told = {finding.key: finding.told for finding in findings}
    told |= {key: "as given (--set), not measured here" for key in given if key != "provenance"}
    return {**table, **given, "provenance": told | given.get("provenance", {})}


def left_to_defaults(table: Mapping[str, Any]) -> str:
    """The values of a powder that a table does not hold, with what a run takes for them."""
    defaults = Material().model_dump(mode="json", exclude_none=True)
    return ", ".join(f"{key} = {value}" for key, value in defaults.items() if key not in table)


def write_material(file: Path, table: Mapping[str, Any]) -> None:
    """Write the table as TOML. Raises OSError."""
    lines = [f"Written by scaleup {scaleup.__version__}. Put it into a run: scaleup simulate FILE."]
    missing = left_to_defaults(table)
    if missing:
        lines.append(f"Not here, so that a run takes its defaults, another powder's: {missing}.")
    head = "\n".join(textwrap.fill(line, 96, initial_indent="# ", subsequent_indent="# ")
                     for line in lines)  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, f"{head}\n{tomli_w.dumps({'material': dict(table)})}")
