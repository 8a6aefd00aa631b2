"""What fits have found, in words and as entries of a [material] table."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from scaleup.material.compression import Elasticity
from scaleup.material.line import CONFIDENCE, Estimate, Line
from scaleup.material.yield_locus import YieldLocus
from scaleup.scene.units import ANGLE, PRESSURE


@dataclass(frozen=True)
class Finding:
    """A property of the powder.

    key     -- under which it is told
    entries -- of the [material] table; empty if no model takes it
    told    -- the value with its limits, and how it was found
    """

    key: str
    entries: dict[str, str | float]
    told: str


def of_yield_locus(locus: YieldLocus, source: str) -> list[Finding]:
    """Friction angle and cohesion. source -- what was measured, such as the file's name."""
    angle = _told(locus.friction_angle, ANGLE.shown)
    through = f"{locus.line.points} points of {source}, {_range(locus)}"
    return [
        Finding(
            "friction_angle",
            {
                "friction_angle": f"{math.degrees(locus.friction_angle.value):.6g} deg",
                "friction_measured": "shear-plane",
            },
            f"{angle}: least squares of tau = c + sigma tan(phi) through {through}"
            f"{_explained(locus.line)}",
        ),
        Finding(
            "cohesion",
            {"cohesion": f"{locus.line.intercept:.6g} Pa"},
            f"{_intercept(locus, 'cohesion')}; {source}",
        ),
    ]


def of_wall_locus(locus: YieldLocus, source: str) -> list[Finding]:
    """Wall friction; adhesion is told, since no model takes it."""
    friction = _told(locus.friction, _number)
    through = f"{locus.line.points} points of {source}, {_range(locus)}"
    neglected = "" if locus.line.through_origin else ", which is neglected: no model takes it"
    return [
        Finding(
            "wall_friction",
            {"wall_friction": float(f"{locus.friction.value:.6g}")},
            f"{friction}: least squares of tau = a + sigma mu through {through}"
            f"{_explained(locus.line)}; adhesion {_intercept(locus, 'adhesion')}{neglected}",
        )
    ]


def of_unloading(elasticity: Elasticity, source: str) -> list[Finding]:
    """Young's modulus and Poisson's ratio, which are told alone: beds flow without elasticity."""
    rows = f"initial unloading, {elasticity.axial_line.points} rows of {source}; no model takes it"
    return [
        Finding("youngs_modulus", {}, f"{_told(elasticity.modulus, PRESSURE.shown)}: {rows}"),
        Finding("poissons_ratio", {}, f"{_told(elasticity.poisson, _number)}: {rows}"),
    ]


def _told(estimate: Estimate, shown: Callable[[float], str]) -> str:
    return f"{shown(estimate.value)} ({_limits(estimate, shown)})"


def _limits(estimate: Estimate, shown: Callable[[float], str]) -> str:
    if estimate.low is None or estimate.high is None:
        return "no limits"
    return f"{100 * CONFIDENCE:g} % limits {shown(estimate.low)} to {shown(estimate.high)}"


def _intercept(locus: YieldLocus, name: str) -> str:
    if locus.limiting.through_origin:
        return "0 Pa: taken as zero, as told (--cohesionless)"
    if not locus.line.through_origin:
        return _told(locus.cohesion, _pascals)
    fitted = _pascals(locus.free.intercept)
    why = (
        "its limits include zero"
        if locus.cohesion.low is not None
        else "within 5 % of the greatest shear stress"
    )
    return (
        f"0 Pa ({_limits(locus.cohesion, _pascals)}): the fitted {name} of {fitted} is set "
        f"to zero, since {why}, and the slope fitted again through the origin"
    )


def _range(locus: YieldLocus) -> str:
    low, high = float(locus.normal.min()), float(locus.normal.max())
    return f"normal stress {PRESSURE.shown(low)} to {PRESSURE.shown(high)}"


def _explained(line: Line) -> str:
    return "" if line.r2 is None else f", r^2 {line.r2:.4f}"


def _number(value: float) -> str:
    return f"{value:.4g}"


def _pascals(value: float) -> str:
    return f"{value:.4g} Pa"
