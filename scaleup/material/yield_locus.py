"""The yield locus of a shear test: friction and cohesion.

Source: Liu, Gonzalez & Wassgren 2018, Eq. 19.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scaleup.material.line import (
    ROUND_OFF,
    Estimate,
    Line,
    fit_line,
    limits,
    require_measured,
)
from scaleup.scene.units import PRESSURE
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

_NEGLIGIBLE = 0.05  # of the greatest shear stress: a cohesion that two points cannot tell from none
_ALIKE = 1e-3  # of the greatest normal stress, within which all are the same
_STRAIGHT = 0.95  # r^2 below which points are hardly a line
_FEW = 2  # degrees of freedom up to which limits are wide


@dataclass(frozen=True)
class YieldLocus:
    """tau = cohesion + friction sigma through the points of a shear test; stresses in Pa.

    free     -- the line of least squares with a cohesion
    line     -- the line that is taken: free, or through the origin
    limiting -- the line whose limits are stated: free, unless told that there is no cohesion
    friction -- tan(phi), the slope of `line`
    cohesion -- Pa, the intercept of `line`
    remarks  -- sentences on what a reader should know
    """

    normal: FloatArray
    shear: FloatArray
    free: Line
    line: Line
    limiting: Line
    friction: Estimate
    cohesion: Estimate
    remarks: tuple[str, ...]

    @property
    def friction_angle(self) -> Estimate:
        """phi, rad."""
        slopes = (self.friction.value, self.friction.low, self.friction.high)
        value, low, high = (None if slope is None else math.atan(slope) for slope in slopes)
        assert value is not None
        return Estimate(value, low, high)


def fit_yield_locus(
    normal: FloatArray,
    shear: FloatArray,
    *,
    cohesionless: bool = False,
    intercept: str = "cohesion",
) -> YieldLocus:
    """Fit a yield locus, or a wall yield locus.

    normal, shear -- Pa, compression positive, of one shape; two points or more, three for limits
    cohesionless  -- the powder is known to have no cohesion: the line goes through the origin
    intercept     -- what the intercept is called, such as "adhesion" on a wall

    An intercept within its 95 % limits of zero (of two points: within 5 % of the greatest shear
    stress) is set to zero and the slope fitted again, through the origin. The slope's limits stay
    those of the first fit: they hold with 95 % whichever way that decision falls, and the new
    slope always lies within them. Raises InputError if the points are no yield locus.

    >>> sigma = np.array([1e3, 2e3, 3e3, 4e3])
    >>> locus = fit_yield_locus(sigma, 150 + 0.5 * sigma)
    >>> round(locus.friction.value, 6), round(locus.cohesion.value, 6)
    (0.5, 150.0)
    """
    normal, shear = np.asarray(normal, dtype=float), np.asarray(shear, dtype=float)
    _require_points(normal, shear)
    free = fit_line(normal, shear)
    size = float(shear.max())
    if free.slope <= ROUND_OFF * size / float(normal.max()):
        raise InputError(
            f"the shear stress does not rise with the normal stress (slope {free.slope:.3g}); "
            "check that the columns are not exchanged and hold steady flow"
        )
    margin = free.margin(0.0)
    zero = max(_NEGLIGIBLE * size if margin is None else float(margin), ROUND_OFF * size)
    told = f"the points' {intercept} is {PRESSURE.shown(free.intercept)} +- {PRESSURE.shown(zero)}"
    if free.intercept < -zero and not cohesionless:
        raise InputError(
            f"{told}, below zero; check the zero of the shear force, the weight of lid and powder "
            "in the normal stress, and that flow was steady (or give --cohesionless)"
        )
    line = free
    if free.intercept <= zero or cohesionless:
        line = fit_line(normal, shear, through_origin=True)
    limiting = line if cohesionless else free
    remarks = _remarks(limiting)
    if cohesionless and margin is not None and abs(free.intercept) > zero:
        remarks += (f"{told}: they speak against a line through the origin",)
    return YieldLocus(
        normal=normal,
        shear=shear,
        free=free,
        line=line,
        limiting=limiting,
        friction=limits(line.slope, limiting.slope, limiting.slope_margin),
        cohesion=limits(line.intercept, limiting.intercept, limiting.margin(0.0)),
        remarks=remarks,
    )


def _require_points(normal: FloatArray, shear: FloatArray) -> None:
    require_measured({"normal stress": normal, "shear stress": shear})
    if len(normal) < 2:
        raise InputError(f"{len(normal)} point is no line; measure two or more, three for limits")
    if np.ptp(normal) <= _ALIKE * normal.max():
        raise InputError(
            f"the normal stresses are all {PRESSURE.shown(float(normal[0]))}; a line needs two or "
            "more of them"
        )


def _remarks(line: Line) -> tuple[str, ...]:
    found = []
    if line.freedom == 0:
        found.append("2 points give no limits of confidence; measure three or more")
    elif line.freedom <= _FEW:
        found.append(
            f"only {line.points} points: the limits are {line.width:.3g} standard errors wide"
        )
    if line.r2 is not None and line.r2 < _STRAIGHT:
        found.append(f"the points are hardly a line (r^2 {line.r2:.3f})")
    margin = line.slope_margin
    if margin is not None and margin >= line.slope:
        found.append("the limits of the slope include zero: more points are needed")
    return tuple(found)
