"""Physical quantities as pydantic types: values carry units outside and are SI floats inside.

`"140 mm"`, `"6 rpm"` and `"23.6 deg"` are read by pint; a bare number is taken as SI. A value is
written back as a string with its SI unit, exactly enough to be read as the same float.

Units may be spelt as people do: `RPM`, `rev/min`, `kg/m3`, `m³`, `g·cm⁻³`, `deg.`. A speed of
rotation in Hz or 1/min counts turns; 1/s is refused, since it might be a turn or a radian.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, get_args

import pint
from pydantic import BeforeValidator, Field, PlainSerializer

from scaleup.system.errors import shown

_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d+,\d+")
_UNIT = re.compile(r"[\w\s*/^().°%-]*")
_LONGEST = 80  # characters of a quantity
_SIGNS = str.maketrans(
    {"−": "-", "–": "-", "·": "*", "⋅": "*", "×": "*", "µ": "u", "μ": "u", "º": "°"}
    | dict.fromkeys('"″”', "in")
)
_NAMES = {"rev": "turn", "revs": "turn", "rotation": "turn", "rotations": "turn", "tr": "turn"}
_CASE = {
    name.lower(): name
    for name in ("rpm", "deg", "rad", "rev", "mm", "cm", "um", "m", "kg", "g", "l", "s", "min", "h")
} | {"kpa": "kPa", "pa": "Pa", "hz": "Hz", "degs": "deg"}
_LONG_NAME = 4  # letters from which a name of a unit means the same in capitals
_ANGLES = ("radian", "degree", "turn", "revolution", "arcminute", "arcsecond", "grade")
_COUNTS_TURNS = ("hertz", "1 / minute")


@dataclass(frozen=True)
class Quantity:
    """What is read as a quantity: its SI unit, and those that people think in."""

    unit: str
    common: tuple[str, ...] = ()
    """units for sentences, the largest first"""
    likely: tuple[str, ...] = ()
    """units that a number without one may have been thought in"""

    def __call__(self, value: Any) -> float:
        """The SI magnitude of a value; see `to_si`."""
        return to_si(value, self.unit)

    def shown(self, magnitude: float) -> str:
        """An SI magnitude in the unit in which it reads best."""
        sizes = [(to_si(f"1 {name}", self.unit), name) for name in self.common]
        least = [size if number == 0 else 0.1 * size for number, (size, _) in enumerate(sizes)]
        fitting = [
            each
            for each, from_there in zip(sizes, least, strict=True)
            if not magnitude or abs(magnitude) >= from_there * (1 - 1e-9)
        ]
        size, name = (fitting or sizes[-1:] or [(1.0, self.unit)])[0]
        return f"{magnitude / size:.4g} {name}".strip()


LENGTH = Quantity("m", ("m", "mm", "um"), ("mm", "um"))
ANGLE = Quantity("rad", ("deg",), ("deg",))
SPEED = Quantity("rad/s", ("rpm",), ("rpm",))
RATE = Quantity("1/s")
DENSITY = Quantity("kg/m^3", ("kg/m^3",), ("g/cm^3",))
MASS = Quantity("kg", ("kg", "g", "mg"), ("g", "mg"))
PRESSURE = Quantity("Pa", ("MPa", "kPa", "Pa"), ("kPa",))
TIME = Quantity("s", ("s",), ("ms",))
SHARE = Quantity("", (), ("%",))


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[float]:
    return pint.UnitRegistry()


def to_si(value: Any, unit: str) -> float:
    """The SI magnitude of `value`, a number (SI already) or a string such as `"6 rpm"`.

    A text is a number, then a unit or nothing. Raises ValueError, naming the expected unit, if it
    cannot be read or is of another kind. For a speed of rotation the unit must name an angle, or
    count turns as Hz and 1/min do.
    """
    wanted = f"in {unit}" if unit else "without a unit or in %"
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number or a text with a unit, {wanted}")
    if not isinstance(value, str):
        return _finite(value)
    number, name = _split(value, wanted)
    if not name:
        return _finite(number)
    for spelt in (name, _respelt(name)):
        given = _known(spelt)
        if given is not None and _of_kind(given, unit):
            counts_turns = unit.startswith("rad/") and str(given) in _COUNTS_TURNS
            factor = 2 * math.pi if counts_turns else 1.0
            wanted_unit = "1/s" if counts_turns else unit
            return _finite(factor * _registry().Quantity(number, given).to(wanted_unit).magnitude)
    given = _known(name) or _known(_respelt(name))
    if given is None:
        raise ValueError(f"no such unit {shown(name)}; expected a value {wanted}")
    if unit.startswith("rad/") and given.is_compatible_with("1/s"):
        raise ValueError(
            f"wrong unit {name}: it may count turns or radians; expected rpm or {unit}"
        )
    if unit == "rad":
        raise ValueError(f"wrong unit {name}; expected an angle, as in deg or rad")
    raise ValueError(f"wrong unit {name}; expected a value {wanted}")


def quantity_of(annotation: Any) -> Quantity | None:
    """The quantity that a field's annotation or metadata reads, if it is one."""
    if isinstance(annotation, BeforeValidator):
        return annotation.func if isinstance(annotation.func, Quantity) else None
    found = (quantity_of(part) for part in get_args(annotation))
    return next((each for each in found if each is not None), None)


def in_likely_units(value: Any, quantity: Quantity) -> Iterator[str]:
    """A bare number with the units that may have been thought of, the likeliest first."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return
    for name in quantity.likely:
        if name != "%":
            yield f"{number:g} {name}"
        elif number >= 1:
            yield f"{number:g}%"


def _split(text: str, wanted: str) -> tuple[float, str]:
    """Number and unit of a text, its signs plain. Raises ValueError."""
    if len(text) > _LONGEST:
        raise ValueError(f"{len(text)} characters are no quantity; expected a number, {wanted}")
    # compatibility forms: no-break spaces, superscripts, full-width signs
    raised = re.sub("(?<=[^\\W\\d])(?=[⁻¹²³⁰-⁹])", "^", text)
    plain = unicodedata.normalize("NFKC", raised.translate(_SIGNS)).translate(_SIGNS)
    comma = _DECIMAL_COMMA.match(plain)
    if comma:
        whole, part = comma.group().split(",")
        if len(part) == 3 and whole.strip("+- ") != "0":
            raise ValueError(
                f"the comma may be of decimals or of thousands; write {whole.strip()}.{part} or "
                f"{whole.strip()}{part}, {wanted}"
            )
        plain = f"{whole}.{part}{plain[comma.end() :]}"
    number = _NUMBER.match(plain)
    unit = plain[number.end() :].strip() if number else ""
    if number is None or not _UNIT.fullmatch(unit):
        raise ValueError(f"not a quantity; expected a number and a unit, {wanted}")
    if unit.startswith("/"):  # "6 /min"
        unit = f"1{unit}"
    return float(number.group(1)), re.sub(r"(?<=[^\W\d])\.(?=\s|/|$)", "", unit)


@lru_cache(maxsize=1000)
def _known(name: str) -> Any:
    """The unit of a name, or None; pint raises whatever its tokenizer does."""
    if any(len(digits) > 2 for digits in re.findall(r"\d+", name)):
        return None  # no power that a unit has
    try:
        return _registry().Unit(name)
    except Exception:
        return None


def _respelt(name: str) -> str:
    """The name with other people's spellings of units and powers replaced by pint's."""

    def word(match: re.Match[str]) -> str:
        symbol, power = match["symbol"], match["power"] or ""
        lower = symbol.lower()
        symbol = _CASE.get(lower, lower if len(symbol) >= _LONG_NAME else symbol)
        return _NAMES.get(symbol, symbol) + (f"^{power}" if power else "")

    name = re.sub(r"^r(?=\s*/)", "turn", name)
    return re.sub(r"(?P<symbol>[^\W\d_]+)(?P<power>-?\d+)?", word, name)


def _of_kind(given: Any, unit: str) -> bool:
    """Whether a unit that was given measures what is wanted in `unit`."""
    if not given.is_compatible_with(unit or "dimensionless"):
        return False
    names = {str(name) for name in given._units}
    angular = any(name.startswith(_ANGLES) for name in names)
    if unit.startswith("rad/"):
        return angular or str(given) in _COUNTS_TURNS
    return angular == (unit == "rad")  # an angle is no share and no rate


def _finite(value: Any) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("expected a finite number")
    return number


def _quantity(quantity: Quantity) -> tuple[BeforeValidator, PlainSerializer]:
    unit = quantity.unit
    return (
        BeforeValidator(quantity),
        PlainSerializer(
            lambda value: f"{value!r} {unit}" if unit else value, return_type=str | float
        ),
    )


# Bounds beyond which a value is in another unit than was thought, and arithmetic breaks down.
Length = Annotated[float, *_quantity(LENGTH), Field(ge=1e-9, le=100)]
Coordinate = Annotated[float, *_quantity(LENGTH), Field(ge=-100, le=100)]
Angle = Annotated[float, *_quantity(ANGLE), Field(ge=-1e3, le=1e3)]
AngularVelocity = Annotated[float, *_quantity(SPEED), Field(ge=1e-6, le=1e6)]
ShearRate = Annotated[float, *_quantity(RATE), Field(ge=1e-9, le=1e9)]
Density = Annotated[float, *_quantity(DENSITY), Field(ge=10, le=3e4)]
Mass = Annotated[float, *_quantity(MASS), Field(ge=1e-12, le=1e9)]
Pressure = Annotated[float, *_quantity(PRESSURE), Field(ge=0, le=1e9)]
Time = Annotated[float, *_quantity(TIME), Field(ge=1e-15, le=1e9)]
Pause = Annotated[float, *_quantity(TIME), Field(ge=0, le=1e9)]
Share = Annotated[float, *_quantity(SHARE)]
