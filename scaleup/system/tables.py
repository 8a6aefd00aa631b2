"""Tables as spreadsheets save them: names in the first line, entries in all others."""

from __future__ import annotations

import csv
from pathlib import Path

from scaleup.system.files import read_text


def read_table(file: Path) -> tuple[list[str], list[list[str]]]:
    """Names of the columns, and the entries of each row, as texts without space around them.

    Split at commas, or at semicolons or tabs, where numbers may have decimal commas (they become
    points). Empty lines do not count, nor do those that begin with `#`; both
    lists are empty without others.
    Raises OSError, and ValueError if it is no such table.
    """
    lines = [line for line in read_text(file).splitlines() if not line.lstrip().startswith("#")]
    filled = [line for line in lines if line.strip(" ,;\t")]
    mark = next((mark for mark in ";\t" if filled and mark in filled[0]), ",")
    try:
        rows = [[entry.strip() for entry in row] for row in csv.reader(filled, delimiter=mark)]
    except csv.Error as error:
        raise ValueError(f"is no table ({error})") from error
    if not rows:
        return [], []
    names, entries = rows[0], rows[1:]
    if not entries or any(len(row) != len(names) for row in entries):
        raise ValueError(f"not every line holds {len(names)} numbers")
    if mark != ",":
        entries = [[entry.replace(",", ".") for entry in row] for row in entries]
    return names, entries
