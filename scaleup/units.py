"""Physical quantities as pydantic types: values carry units outside and are SI floats inside.

`"140 mm"`, `"6 rpm"` and `"23.6 deg"` are read by pint; a bare number is taken as SI. A value is
written back as a string with its SI unit, exactly enough to be read as the same float.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Annotated, Any

import pint
from pydantic import BeforeValidator, Field, PlainSerializer

_QUANTITY = re.compile(
    r"\s*(?P<number>[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)(?P<unit>(\s*[\w\s*/^().°µ-]*)?)\s*"
)
_ANGLES = ("radian", "degree", "turn", "revolution", "arcminute", "arcsecond", "grade")


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[float]:
    return pint.UnitRegistry()


def to_si(value: Any, unit: str) -> float:
    """The SI magnitude of `value`, a number (SI already) or a string such as `"6 rpm"`.

    A text is a number, then a unit or nothing. Raises ValueError, naming the expected unit, if it
    cannot be read or is of another kind. For a speed of rotation the unit must name an angle: 1 Hz
    might be one turn or one radian a second.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number or a text with a unit, in {unit}")
    if isinstance(value, int | float):
        return float(value)
    match = _QUANTITY.fullmatch(value)
    if match is None:
        raise ValueError(f"not a quantity; expected a number and a unit, in {unit}")
    number, text = float(match["number"]), match["unit"].strip()
    if not text:
        return number
    try:
        given: Any = _registry().Unit(text)
    except Exception as error:  # pint raises whatever its tokenizer does
        raise ValueError(f"no such unit {text!r}; expected a value in {unit}") from error
    names = {str(name) for name in given._units}
    if unit.startswith("rad") and not any(name.startswith(_ANGLES) for name in names):
        raise ValueError(f"wrong unit {text}; expected an angle, as in {unit}")
    try:
        return float(_registry().Quantity(number, given).to(unit).magnitude)
    except pint.DimensionalityError as error:
        raise ValueError(f"wrong unit {text}; expected a value in {unit}") from error


def _quantity(unit: str) -> tuple[BeforeValidator, PlainSerializer]:
    return (
        BeforeValidator(lambda value: to_si(value, unit)),
        PlainSerializer(lambda value: f"{value!r} {unit}", return_type=str),
    )


Length = Annotated[float, *_quantity("m"), Field(gt=0)]
Coordinate = Annotated[float, *_quantity("m")]
Angle = Annotated[float, *_quantity("rad")]
AngularVelocity = Annotated[float, *_quantity("rad/s"), Field(gt=0)]
ShearRate = Annotated[float, *_quantity("1/s"), Field(gt=0)]
Density = Annotated[float, *_quantity("kg/m^3"), Field(gt=0)]
Mass = Annotated[float, *_quantity("kg"), Field(gt=0)]
Pressure = Annotated[float, *_quantity("Pa"), Field(ge=0)]
Time = Annotated[float, *_quantity("s"), Field(gt=0)]
Pause = Annotated[float, *_quantity("s"), Field(ge=0)]
