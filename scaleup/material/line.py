"""Straight lines through measured points: least squares, with limits of confidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from scaleup.scene.units import PRESSURE
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

CONFIDENCE = 0.95
_GREATEST = 1e9  # Pa
_SLACK = 0.05  # of the greatest stress, by which a sensor's zero may be off below
ROUND_OFF = 1e-9  # of the greatest ordinate, below which a figure is rounding


@dataclass(frozen=True)
class Estimate:
    """A value and its limits of confidence; None where the points give none."""

    value: float
    low: float | None = None
    high: float | None = None


def limits(value: float, middle: float, margin: FloatArray | float | None) -> Estimate:
    """A value with limits at a distance from what may be another value."""
    if margin is None:
        return Estimate(value)
    return Estimate(value, middle - float(margin), middle + float(margin))


@dataclass(frozen=True)
class Line:
    """y = intercept + slope x by ordinary least squares; errors are in y alone, independent.

    scatter -- standard deviation of y about the line; None without freedom
    r2      -- share of the variance of y that the line explains; None without freedom
    centre  -- abscissa at which the line is known best: the mean, or 0 if it is through the origin
    spread  -- sum of squared distances of the abscissae from the centre
    """

    slope: float
    intercept: float
    points: int
    through_origin: bool
    scatter: float | None
    r2: float | None
    centre: float
    spread: float

    def __call__(self, x: FloatArray) -> FloatArray:
        """Ordinates of the line."""
        return self.intercept + self.slope * x

    @property
    def freedom(self) -> int:
        """Points less the parameters that were fitted."""
        return self.points - (1 if self.through_origin else 2)

    @property
    def width(self) -> float:
        """Standard errors from a value to its limit: Student's t for `CONFIDENCE`."""
        return float(stdtrit(self.freedom, 0.5 + 0.5 * CONFIDENCE)) if self.freedom else math.inf

    @property
    def slope_margin(self) -> float | None:
        """Distance of the slope from its limits."""
        return None if self.scatter is None else self.width * self.scatter / math.sqrt(self.spread)

    def margin(self, x: FloatArray | float) -> FloatArray | None:
        """Distance of the mean ordinate at x from its limits; at 0 that of the intercept."""
        if self.scatter is None:
            return None
        own = 0.0 if self.through_origin else 1 / self.points
        off = np.asarray(x, dtype=float) - self.centre
        return np.asarray(self.width * self.scatter * np.sqrt(own + off**2 / self.spread))


def fit_line(x: FloatArray, y: FloatArray, *, through_origin: bool = False) -> Line:
    """The line of least squares through points whose abscissae differ.

    Raises InputError if there are fewer points than parameters or the abscissae are all alike.

    >>> line = fit_line(np.array([1.0, 2.0, 3.0]), np.array([3.1, 4.9, 7.0]))
    >>> round(line.slope, 3), round(line.intercept, 3), round(line.slope_margin, 3)
    (1.95, 1.1, 1.1)
    """
    centre, level = (0.0, 0.0) if through_origin else (float(x.mean()), float(y.mean()))
    freedom = len(x) - (1 if through_origin else 2)
    spread = float(np.sum((x - centre) ** 2))
    if freedom < 0 or spread <= len(x) * (ROUND_OFF * float(np.abs(x).max())) ** 2:
        raise InputError("a line needs two points or more that differ in their abscissae")
    slope = float(np.sum((x - centre) * (y - level))) / spread
    intercept = level - slope * centre
    left = float(np.sum((y - intercept - slope * x) ** 2))
    whole = float(np.sum((y - y.mean()) ** 2))
    return Line(
        slope=slope,
        intercept=intercept,
        points=len(x),
        through_origin=through_origin,
        scatter=math.sqrt(left / freedom) if freedom else None,
        r2=1 - left / whole if freedom and whole else None,
        centre=centre,
        spread=spread,
    )


def require_measured(stresses: Mapping[str, FloatArray], *others: FloatArray) -> None:
    """Raises InputError unless columns are of one length and finite, and stresses ones of powders.

    stresses -- Pa, compression positive
    """
    columns = (*stresses.values(), *others)
    if len({values.shape for values in columns}) > 1 or columns[0].ndim != 1:
        raise InputError("the columns must be lists of the same length")
    if not all(np.isfinite(values).all() for values in columns):
        raise InputError("the columns must hold finite numbers alone")
    for name, values in stresses.items():
        least, most = (float(limit(values, initial=0.0)) for limit in (np.min, np.max))
        if least < -_SLACK * most:
            raise InputError(
                f"the {name} {PRESSURE.shown(least)} is negative; compression and the sense of "
                "shear count positive"
            )
        if most > _GREATEST:
            raise InputError(
                f"the {name} {PRESSURE.shown(most)} is more than {PRESSURE.shown(_GREATEST)}; "
                "check its unit"
            )
