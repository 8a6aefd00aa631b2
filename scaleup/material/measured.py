"""Measured tables: columns found by what they measure, read in the units that their heads carry.

The fits take arrays and know no files; this module alone reads them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scaleup.scene.units import to_si
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError, shown
from scaleup.system.tables import read_table


@dataclass(frozen=True)
class Column:
    """What a column measures: its name in sentences, how heads tell it, and its SI unit.

    words, symbol -- regular expressions, found anywhere in a head, or all of it; in lower case, the
                     words parted by single spaces
    example       -- of a unit that a head may carry
    """

    name: str
    words: str
    symbol: str
    unit: str = "Pa"
    example: str = "kPa"


SHEAR_TABLE = {
    "normal": Column("normal stress", r"\bnormal\b", "(sigma|σ)( ?[nv])?"),
    "shear": Column("shear stress", r"\bshear\b", r"(tau|τ)( ?\w+)?"),
}
COMPRESSION_TABLE = {
    "strain": Column("axial strain", r"\bstrain\b", "(epsilon|eps|ε)( ?(zz|[za1]))?", "", "%"),
    "axial": Column("axial stress", r"\b(axial|vertical) stress\b", "(sigma|σ) ?(zz|[zav1])"),
    "radial": Column(
        "radial stress", r"\b(radial|lateral|horizontal) stress\b", "(sigma|σ) ?(rr|[rh3])"
    ),
}

_WITH_UNIT = (  # the ways in which a head marks its unit
    r"(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]",
    r"(?P<name>.*?\S)\s*\((?P<unit>(?:[^()]|\([^()]*\))*)\)",
    r"(?P<name>[^/]*[^/\s])\s*/\s*(?P<unit>.+)",
    r"(?P<name>.*\S)\s*[,;:]\s*(?P<unit>\S.*)",
    r"(?P<name>.*\S)\s+in\s+(?P<unit>.+)",
)
_LAST_WORD = r"(?P<name>.*[^\W_])[\s_]+(?P<unit>\S+)"  # if that is a unit
_NO_UNIT = ("-", "–", "1")  # of a pure number


def read_measured(file: Path, columns: Mapping[str, Column]) -> dict[str, FloatArray]:
    """The columns of a table by their keys, in SI units, each of shape (rows,).

    Columns that measure something else are left alone. Raises InputError: file and rule.
    """
    try:
        heads, rows = read_table(file)
        places = {key: _place(heads, column) for key, column in columns.items()}
        if len(set(places.values())) < len(places):
            names = " and ".join(column.name for column in columns.values())
            raise ValueError(f"needs a column each for {names}")
        return {
            key: np.array([*_numbers(rows, place, heads[place], columns[key])])
            for key, place in places.items()
        }
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: is no text in UTF-8; save it as UTF-8") from error
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _place(heads: list[str], column: Column) -> int:
    """Number of the column that a table has for what is wanted. Raises ValueError."""
    found = [place for place, head in enumerate(heads) if _measures(head, column)]
    if len(found) > 1:  # a displacement under shear is no stress
        found = [place for place in found if _has_unit(heads[place], column)] or found
    if len(found) == 1:
        return found[0]
    if found:
        names = " and ".join(shown(heads[place]) for place in found)
        raise ValueError(f"{names} may each be the {column.name}; rename or remove all but one")
    raise ValueError(
        f"names no column for the {column.name} in its first line ({shown(', '.join(heads))}); "
        f"call it '{column.name} [{column.example}]'"
    )


def _measures(head: str, column: Column) -> bool:
    """Whether a head names what is wanted."""
    for name in (head, *(name for name, _, _ in _split(head))):
        words = re.sub(r"[\s_]+", " ", name).strip().lower()
        if re.search(column.words, words) or re.fullmatch(column.symbol, words):
            return True
    return False


def _split(head: str) -> Iterator[tuple[str, str, bool]]:
    """Name and unit of a head in each way in which it may carry one, and whether it is marked."""
    for form in (*_WITH_UNIT, _LAST_WORD):
        match = re.fullmatch(form, head)
        if match and match["unit"].strip():
            yield match["name"].strip(), match["unit"].strip(), form is not _LAST_WORD


def _factor(head: str, column: Column) -> float:
    """What a column's numbers are multiplied with to be in SI units. Raises ValueError."""
    refused: list[ValueError] = []
    for _, unit, marked in _split(head):
        if marked and not column.unit and unit in _NO_UNIT:
            return 1.0
        try:
            return to_si(f"1 {unit}", column.unit)
        except ValueError as error:
            refused += [error] if marked else []
    if refused:
        raise ValueError(f"the unit of {shown(head)}: {refused[0]}")
    raise ValueError(
        f"{shown(head)} carries no unit; write '{column.name} [{column.example}]'"
        + ("" if column.unit else f" or '{column.name} [-]'")
    )


def _has_unit(head: str, column: Column) -> bool:
    try:
        _factor(head, column)
    except ValueError:
        return False
    return True


def _numbers(rows: list[list[str]], place: int, head: str, column: Column) -> Iterator[float]:
    """The entries of a column in SI units. Raises ValueError."""
    factor = _factor(head, column)
    for number, row in enumerate(rows, 1):
        try:
            value = factor * float(row[place])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(
                f"{shown(head)} = {shown(row[place])} in row {number}: must be a finite number"
            )
        yield value
