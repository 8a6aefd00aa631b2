"""From measured tables to a [material] table: read, fit, tell."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from scaleup.material.compression import Elasticity, fit_unloading
from scaleup.material.findings import Finding, of_unloading, of_wall_locus, of_yield_locus
from scaleup.material.material_file import material_table
from scaleup.material.measured import COMPRESSION_TABLE, SHEAR_TABLE, Column, read_measured
from scaleup.material.yield_locus import YieldLocus, fit_yield_locus
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

Fit = TypeVar("Fit", YieldLocus, Elasticity)


@dataclass
class Fits:
    """Fits by the files they are of, what they found, and remarks on them."""

    drawn: dict[str, YieldLocus | Elasticity] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add(
        self,
        what: str,
        file: Path,
        columns: dict[str, Column],
        fit: Callable[[dict[str, FloatArray]], Fit],
        told: Callable[[Fit, str], list[Finding]],
    ) -> None:
        """Read a table and fit it. Raises InputError: the file and the rule."""
        measured = read_measured(file, columns)
        try:
            found = fit(measured)
            findings = told(found, f"{file.name} (sha256 {_hash(file)})")
            material_table(findings, {})  # values that no powder has are of this file
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        self.drawn[f"{what}: {file.name}"] = found
        self.findings += findings
        self.remarks += [f"{file.name}: {remark}" for remark in found.remarks]


def fit_tables(
    yield_locus: Path,
    wall: Path | None = None,
    compression: Path | None = None,
    *,
    cohesionless: bool = False,
    unloading_part: float,
) -> Fits:
    """Fit the tables that were measured. Raises InputError."""
    fits = Fits()
    fits.add(
        "yield locus", yield_locus, SHEAR_TABLE,
        lambda table: fit_yield_locus(
                table["normal"], table["shear"], cohesionless=cohesionless
            ),
        of_yield_locus,
    )  # fmt: skip
    if wall:
        fits.add(
            "wall yield locus", wall, SHEAR_TABLE,
            lambda table: fit_yield_locus(
                table["normal"], table["shear"], cohesionless=cohesionless, intercept="adhesion"
            ),
            of_wall_locus,
        )  # fmt: skip
    if compression:
        fits.add(
            "uniaxial compression", compression, COMPRESSION_TABLE,
            lambda table: fit_unloading(**table, part=unloading_part),
            of_unloading,
        )  # fmt: skip
    return fits


def _hash(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()[:12]
