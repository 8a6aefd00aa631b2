"""Elastic constants from uniaxial compression (Liu, Gonzalez & Wassgren 2018, Eq. 20 and 21).

The initial slopes of the unloading curves, a = d sigma_zz / d epsilon and r = d sigma_rr / d
epsilon, give Poisson's ratio nu = r / (r + a) and Young's modulus E = a - 2 nu r.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scaleup.material.line import Estimate, Line, fit_line, limits, require_measured
from scaleup.scene.units import PRESSURE
from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError

UNLOADING_PART = 0.3  # of the greatest axial stress, over whose release a curve counts as straight
_FEWEST = 3  # rows of the initial unloading
_BEND = 0.1  # relative change of slope along the initial unloading from which it is said


@dataclass(frozen=True)
class Elasticity:
    """Young's modulus (Pa) and Poisson's ratio of a bed, and what they were read from.

    strain, axial, radial   -- the whole test; stresses in Pa
    part                    -- rows of the initial unloading
    axial_line, radial_line -- fitted to the stresses there
    """

    strain: FloatArray
    axial: FloatArray
    radial: FloatArray
    part: slice
    axial_line: Line
    radial_line: Line
    modulus: Estimate
    poisson: Estimate
    remarks: tuple[str, ...]


def fit_unloading(
    strain: FloatArray, axial: FloatArray, radial: FloatArray, *, part: float = UNLOADING_PART
) -> Elasticity:
    """Elastic constants from a test in the order in which it was run, loaded and then unloaded.

    strain, axial, radial -- of one shape; compression positive, stresses in Pa
    part -- share of the axial stress at the turning point over whose release the curves are fitted

    The limits are those of the two slopes to first order: E and nu change with the slopes as one
    combination of the two stresses each, whose own slope has the same limits.
    Raises InputError if the table holds no unloading or the slopes are those of no elastic body.
    """
    strain, axial, radial = (np.asarray(each, dtype=float) for each in (strain, axial, radial))
    require_measured({"axial stress": axial, "radial stress": radial}, strain)
    rows = _initial_unloading(strain, axial, part)
    x, a, r = strain[rows], axial[rows], radial[rows]
    try:
        axial_line, radial_line = fit_line(x, a), fit_line(x, r)
    except InputError:
        raise InputError("the axial strain does not change while it is unloaded") from None
    along, across = axial_line.slope, radial_line.slope
    if along <= 0:
        raise InputError(
            f"the axial stress does not fall with the axial strain in the unloading (slope "
            f"{PRESSURE.shown(along)}); compression counts positive"
        )
    poisson = across / (across + along)
    if not 0 < poisson < 0.5:
        raise InputError(
            f"Poisson's ratio would be {poisson:.3g}, not between 0 and 0.5 (in the unloading the "
            f"radial stress changes {across / along:.3g} times as much as the axial one); check "
            "that the columns are not exchanged and that the radial stress was unloaded, too"
        )
    modulus = along - 2 * poisson * across
    whole = (along + across) ** 2
    nu = fit_line(x, along / whole * r - across / whole * a).slope_margin
    by_along = 1 + 2 * across**2 / whole
    by_across = -2 * across * (across + 2 * along) / whole
    young = fit_line(x, by_along * a + by_across * r).slope_margin
    return Elasticity(
        strain=strain,
        axial=axial,
        radial=radial,
        part=rows,
        axial_line=axial_line,
        radial_line=radial_line,
        modulus=limits(modulus, modulus, young),
        poisson=limits(poisson, poisson, nu),
        remarks=_remarks(x, a, axial_line),
    )


def _initial_unloading(strain: FloatArray, axial: FloatArray, part: float) -> slice:
    """Rows from the turning point until a part of its axial stress is released.

    The turning point is the last row of the greatest strain, so that stress that relaxes at rest
    does not count as unloading.
    """
    if not 0 < part <= 1:
        raise InputError(f"the part {part:g} of the unloading must be above 0 and at most 1")
    if len(strain) < _FEWEST:
        raise InputError(f"{len(strain)} row(s) are no loading and unloading")
    if np.abs(strain).max() > 1:
        most = float(np.abs(strain).max())
        raise InputError(f"the axial strain {most:.4g} is more than 1; check its unit (% or -)")
    turn = len(strain) - 1 - int(np.argmax(strain[::-1]))
    top = float(axial[turn])
    released = np.flatnonzero(axial[turn:] < (1 - part) * top)
    if top <= 0:
        raise InputError("the axial stress is not positive where the axial strain is greatest")
    if turn == len(strain) - 1:
        raise InputError(
            "there is no unloading: the axial strain (compression positive) is greatest in the "
            "last row"
        )
    end = turn + int(released[0]) if len(released) else len(strain)
    if end - turn < _FEWEST:
        raise InputError(
            f"only {end - turn} row(s) until the axial stress has fallen by {100 * part:g} % from "
            f"{PRESSURE.shown(top)}, of {_FEWEST} or more; record the unloading more finely or fit "
            "a greater part of it (--unloading-part)"
        )
    return slice(turn, end)


def _remarks(strain: FloatArray, axial: FloatArray, line: Line) -> tuple[str, ...]:
    """Whether the curve bends so much that its slope at the turning point is another one."""
    if len(strain) == _FEWEST:
        wide = f"{line.width:.3g} standard errors wide"
        return (f"only {_FEWEST} rows of unloading: the limits are {wide}",)
    span = float(np.ptp(strain))
    curved = np.polyfit((strain - strain[0]) / span, axial, 2)
    change = float(curved[1]) / span / line.slope - 1
    # where a parabola starts, its slope is four times as uncertain as a line's
    if abs(change) <= max(_BEND, 4 * (line.slope_margin or 0.0) / line.slope):
        return ()
    return (
        f"the unloading bends: at its very start the axial slope is {100 * change:+.0f} % off the "
        "fitted one; fit a smaller part of it (--unloading-part)",
    )
