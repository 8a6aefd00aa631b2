"""Grains as the engine reads and writes them: data files and dumps, text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scaleup.contract import FloatArray
from scaleup.particles.pouring import Grains
from scaleup.system.errors import RunError
from scaleup.system.files import write_text

COLUMNS = "id x y z vx vy vz radius"
FORMAT = "%d" + 7 * " %.9g"
_NAME = re.compile(r"grains\.(\d+)\.txt")


def write_grains(path: Path, grains: Grains, density: float, box: FloatArray) -> None:
    """A data file: grains of type 1 in a box (2, 3) of lower and upper corner, m."""
    head = [
        "grains", "", f"{len(grains.radius)} atoms", "2 atom types", "",
        *(f"{box[0, a]:.9g} {box[1, a]:.9g} {n}lo {n}hi" for a, n in enumerate("xyz")),
    ]  # fmt: skip
    number = np.arange(1, len(grains.radius) + 1)
    atoms = [
        f"{n} 1 {2 * r:.12g} {density:.9g} {x:.12g} {y:.12g} {z:.12g}"
        for n, r, (x, y, z) in zip(number, grains.radius, grains.position, strict=True)
    ]
    speeds = [
        f"{n} {u:.9g} {v:.9g} {w:.9g} 0 0 0"
        for n, (u, v, w) in zip(number, grains.velocity, strict=True)
    ]
    sections = [*head, "", "Atoms", "", *atoms, "", "Velocities", "", *speeds]
    write_text(path, "\n".join(sections) + "\n")


def write_dump(path: Path, step: int, grains: Grains, box: FloatArray) -> None:
    """A dump as the engine writes them."""
    table = np.column_stack([grains.position, grains.velocity, grains.radius])
    rows = "\n".join(FORMAT % (number, *row) for number, row in enumerate(table, start=1))
    bounds = "\n".join(f"{low:.9g} {high:.9g}" for low, high in box.T)
    write_text(
        path,
        f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{len(table)}\n"
        f"ITEM: BOX BOUNDS ff ff pp\n{bounds}\nITEM: ATOMS {COLUMNS} \n{rows}\n",
    )


@dataclass(frozen=True)
class Frame:
    """A dump: the engine's step, and the grains in the order of their numbers."""

    step: int
    grains: Grains


def read_dump(path: Path) -> Frame:
    """The grains of a dump. Raises RunError if it is damaged."""
    try:
        head, _, body = path.read_text(encoding="ascii").partition("ITEM: ATOMS ")
        names, _, rows = body.partition("\n")
        lines = head.splitlines()
        step, count = int(lines[1]), int(lines[3])
        columns = names.split()
        table = np.array(rows.split(), dtype=float).reshape(count, len(columns))
        wanted = table[:, [columns.index(name) for name in COLUMNS.split()]]
    except (OSError, ValueError, IndexError) as error:
        raise RunError(f"{path}: is no whole dump of the engine ({error})") from error
    wanted = wanted[np.argsort(wanted[:, 0], kind="stable")]
    return Frame(step, Grains(wanted[:, 1:4], wanted[:, 4:7], wanted[:, 7]))


def dumps_in(folder: Path) -> dict[int, Path]:
    """The dumps of a folder by step, ascending."""
    found = {int(m[1]): p for p in folder.glob("grains.*.txt") if (m := _NAME.fullmatch(p.name))}
    return dict(sorted(found.items()))
