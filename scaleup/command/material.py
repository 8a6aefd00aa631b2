"""`scaleup material`: what a powder is, from measurements; parsing and printing only."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from scaleup.case.layers import assigned, merged
from scaleup.system.errors import InputError

_Table = click.Path(path_type=Path)


@click.group()
def material() -> None:
    """The powder: a [material] table from measurements."""


@material.command()
@click.option(
    "--yield-locus",
    type=_Table,
    required=True,
    help="Table of a shear test: normal stress, shear stress at steady flow.",
)
@click.option("--wall", type=_Table, help="The same on a sample of the vessel's wall.")
@click.option(
    "--compression",
    type=_Table,
    help="Table of a uniaxial compression with unloading: axial strain, axial stress, "
    "radial stress.",
)
@click.option("--cohesionless", is_flag=True, help="Fit lines through the origin.")
@click.option(
    "--unloading-part",
    type=click.FloatRange(0, 1, min_open=True),
    default=0.3,
    show_default=True,
    help="Share of the axial stress over whose release the unloading is fitted.",
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="material.KEY=VALUE",
    help="Write another value into the table, such as the bulk density.",
)
@click.option(
    "--output",
    type=_Table,
    default=Path("material.toml"),
    show_default=True,
    help="File for the table; its figure goes beside it.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that is there already.")
def fit(
    assignments: Sequence[str], output: Path, overwrite: bool, **tables: Any
) -> None:  # fmt: skip
    """Fit friction, cohesion and elasticity to measured tables (CSV).

    Columns carry their units in their heads: 'normal stress [kPa]'.
    """
    picture = output.with_suffix(".png")
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output = {str(output)!r}: name a file that ends in .toml")
    for file in (output, picture):
        if file.exists() and not overwrite:
            raise InputError(f"{file}: is there already; give --overwrite to replace it")
    from scaleup.material import figure
    from scaleup.material.fitting import fit_tables
    from scaleup.material.material_file import left_to_defaults, material_table, write_material

    fits = fit_tables(**tables)
    table = material_table(fits.findings, _given(assignments))
    write_material(output, table)
    figure.draw(picture, fits.drawn)
    for finding in fits.findings:
        click.echo(f"{finding.key.replace('_', ' '):20s} {finding.told}")
    for remark in fits.remarks:
        click.echo(f"{'warning':20s} {remark}")
    missing = left_to_defaults(table)
    if missing:
        click.echo(f"{'not measured here':20s} a run takes its defaults: {missing}")
    click.echo(f"{'written':20s} {output}, {picture}")


def _given(assignments: Sequence[str]) -> dict[str, Any]:
    tables: dict[str, Any] = {}
    for text in assignments:
        tables = merged(tables, assigned(text), within_layer=True)
    for section in tables:
        if section != "material":
            raise InputError(f"--set {section}: only keys of material can be set here")
    return dict(tables.get("material", {}))
