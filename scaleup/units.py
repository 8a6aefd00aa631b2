"""Physical quantities as pydantic types: values carry units outside and are SI floats inside.

`"140 mm"`, `"6 rpm"` and `"23.6 deg"` are read by pint; a bare number is taken as SI. A value is
written back as a string with its SI unit, exactly enough to be read as the same float.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

import pint
from pydantic import BeforeValidator, Field, PlainSerializer


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[float]:
    return pint.UnitRegistry()


def to_si(value: Any, unit: str) -> float:
    """The SI magnitude of `value`, a number (SI already) or a string such as `"6 rpm"`.

    Raises ValueError, naming the expected unit, if the text cannot be read or is of another kind.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"expected a number in {unit or 'SI'} or a text with a unit")
    if isinstance(value, int | float):
        return float(value)
    try:
        quantity: Any = _registry().Quantity(value)
    except (pint.PintError, AttributeError, TypeError, ValueError, AssertionError) as error:
        raise ValueError(f"not a quantity; expected {unit or 'a number'}") from error
    if quantity.dimensionless and unit:
        bare = quantity.units == _registry().dimensionless
        if bare:
            return float(quantity.magnitude)
    try:
        return float(quantity.to(unit or "dimensionless").magnitude)
    except pint.DimensionalityError as error:
        raise ValueError(f"wrong unit {quantity.units:~P}; expected a value in {unit}") from error


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
