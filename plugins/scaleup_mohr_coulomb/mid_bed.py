"""What a mean bed does at mid-bed and along its surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from scaleup.contract import RunError

from .mesh import farthest_wall, surface_normal, wall_distance
from .swings import FIT_REACH

if TYPE_CHECKING:
    from .steady import SteadyBed

_WALL_MARGIN = 0.9999
_SAMPLES = 800
_SURFACE_REACH = 0.85


@dataclass(frozen=True)
class MidBed:
    """Time-mean flow on the line through the axis, normal to the mean surface (raw field).

    Downflow and upflow are weighted with the powder fraction alpha, which reaches the interface
    half width beyond the contour: this is the flux that the level set transports.
    """

    depth: NDArray[Any]
    """Depth below the contour, m, from the surface to the wall."""
    speed: NDArray[Any]
    """Lab streamwise speed at ``depth``, positive down the slope, m/s."""
    axis_distance: float
    """Distance b from the axis down to the surface, m; negative if the axis is in the powder."""
    reversal_depth: float
    """Depth h0 of the active layer, where ``speed`` changes sign, m."""
    downflow: float
    """Flux per unit length above the reversal, m^2/s."""
    upflow: float
    """Flux per unit length below the reversal, m^2/s, positive up the slope."""
    rigid_upflow: float
    """omega/2 [R^2 - (b + h0)^2]: what rigid rotation would bring up below the reversal, m^2/s."""
    rotation_ratio: float
    """Rotation of the bed over that of the wall, in the lower half of the passive region."""


def mid_bed(bed: SteadyBed) -> MidBed:
    """Diagnostics of the mean field at mid-bed.

    Raises RunError where there is no surface, or nothing flows down on what is carried up.
    """
    outward, downhill = _surface_axes(bed)
    radius = wall_distance(bed.mesh, np.zeros(2), -outward)
    ceiling = wall_distance(bed.mesh, np.zeros(2), outward)
    height = _WALL_MARGIN * np.linspace(ceiling, -radius, _SAMPLES)
    points = height[:, None] * outward
    phi = sample(bed.mesh, bed.level_set.field, points)
    alpha = sample(bed.mesh, bed.level_set.fraction, points)
    speed = sample(bed.mesh, bed.velocity, points) @ downhill
    crossings = np.flatnonzero((phi[:-1] <= 0.0) & (phi[1:] > 0.0))
    if not len(crossings):
        raise RunError(
            "no free surface lies across the line through the axis that is normal to its mean: the "
            "bed cataracts, which a mean surface does not show; lower operation.speed"
        )
    surface = _zero(height, phi, crossings[-1])
    below = height < surface
    reverses = below[:-1] & (speed[:-1] > 0.0) & (speed[1:] <= 0.0)
    if not reverses.any():
        raise RunError(
            "at mid-bed no powder flows down the slope on what the wall carries up: the bed slides "
            "on the wall as a block; raise material.wall_friction"
        )
    reversal = _zero(height, speed, np.flatnonzero(reverses)[0])
    upward_part = height < reversal
    flux = alpha * speed
    downflow = -float(trapezoid(np.where(upward_part, 0.0, flux), height))
    upflow = float(trapezoid(np.where(upward_part, flux, 0.0), height))
    lower_half = height < 0.5 * (reversal - radius)
    omega = bed.angular_velocity
    return MidBed(
        depth=surface - height[below],
        speed=speed[below],
        axis_distance=-surface,
        reversal_depth=surface - reversal,
        downflow=downflow,
        upflow=upflow,
        rigid_upflow=0.5 * omega * (radius**2 - reversal**2),
        rotation_ratio=float(speed[lower_half].sum() / (omega * height[lower_half]).sum()),
    )


def _surface_axes(bed: SteadyBed) -> tuple[NDArray[Any], NDArray[Any]]:
    """Unit vectors normal to the mean surface, out of the powder, and down its slope."""
    inclination, _ = bed.level_set.surface_fit(FIT_REACH * farthest_wall(bed.mesh))
    outward = np.array(surface_normal(inclination))
    return outward, np.array([-outward[1], outward[0]])


def _zero(position: NDArray[Any], values: NDArray[Any], before: int) -> float:
    """Zero of the piecewise linear ``values`` between samples ``before`` and ``before`` + 1."""
    weight = values[before] / (values[before] - values[before + 1])
    return float((1.0 - weight) * position[before] + weight * position[before + 1])


def surface_speed(bed: SteadyBed, count: int = 41) -> tuple[NDArray[Any], NDArray[Any]]:
    """Position down the slope from mid-bed (m) and tangential speed (m/s) along the mean surface.

    Both have shape (count,).  The outer 15 % of the surface at either end are left out.
    """
    outward, downhill = _surface_axes(bed)
    start, end = bed.level_set.contour()
    middle = 0.5 * (start + end)
    order = np.argsort(middle @ downhill)
    along, height = (middle @ downhill)[order], (middle @ outward)[order]
    position = np.linspace(_SURFACE_REACH * along[0], _SURFACE_REACH * along[-1], count)
    points = position[:, None] * downhill + np.interp(position, along, height)[:, None] * outward
    return position, sample(bed.mesh, bed.velocity, points) @ downhill


def sample(mesh: Any, function: Any, points: NDArray[Any]) -> NDArray[Any]:
    """Values of a coefficient function at ``points`` (n, 2) inside the mesh: (n,) or (n, dim)."""
    values = np.asarray(function(mesh(points[:, 0], points[:, 1])))
    return values.reshape(len(points), -1).squeeze(axis=1) if function.dim == 1 else values
