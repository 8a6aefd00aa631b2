"""From the finite-element mean flow to a FlowField on the mixing grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import ngsolve as ngs
import numpy as np

from scaleup.contract import FloatArray, FlowField, Geometry, Grid, RunError, Scene
from scaleup.numerics import fill_to_volume, fit_stream_function, flow_from_stream_function
from scaleup_mohr_coulomb.layer import layer_shear_rate
from scaleup_mohr_coulomb.mid_bed import mid_bed, sample, surface_speed
from scaleup_mohr_coulomb.nearest_start import described

if TYPE_CHECKING:
    from scaleup_mohr_coulomb.mid_bed import MidBed
    from scaleup_mohr_coulomb.steady import SteadyBed

_SLIDING = 0.8  # rotation of the bed over the vessel's below which it no longer rolls
_RESOLVED = 4.0  # element size over non-local length beyond which that does nothing
_MARGIN = 1e-4  # of the reach: how far inside the wall points are kept, where the mesh is


def flow_field(bed: SteadyBed, scene: Scene) -> FlowField:
    """The steady FlowField nearest to a mean bed.

    1. Fills come from the mean free surface, shifted to hold the asked volume. 2. Each face's
    flux is the normal velocity at the middle of its wet part times its wet length. 3. The stream
    function nearest to these fluxes (`fit_stream_function`) replaces them: no divergence, nothing
    through the wall or the free surface. `projection_change` in the summary is what that changed,
    the rms change of face fluxes over their rms.
    """
    grid, geometry = scene.grid, scene.geometry
    corners = grid.corner_points()
    wall = geometry.signed_distance(corners)
    near = wall > -2 * max(grid.spacing)
    surface = np.full(wall.shape, -geometry.reach)
    surface[near] = sample(bed.mesh, bed.level_set.field, kept_inside(geometry, corners[near]))
    fill, shift = fill_to_volume(grid, surface, wall, scene.fill_volume)
    material = np.minimum(surface + shift, wall)

    wet, flux = [], []
    for axis in (0, 1):
        share, points = wet_part(corners, material, grid, axis)
        velocity = np.zeros(share.shape)
        there = share > 0
        inside = kept_inside(geometry, points[there])
        velocity[there] = sample(bed.mesh, bed.velocity, inside)[:, axis]
        wet.append(share * grid.spacing[1 - axis])
        flux.append(velocity * wet[-1])
    psi = fit_stream_function(grid, material > 0, wet, flux)
    fitted = [np.diff(psi, axis=0), -np.diff(psi, axis=1)]
    change = math.sqrt(
        sum(float(((a - b) ** 2).sum()) for a, b in zip(fitted, flux, strict=True))
        / sum(float((b**2).sum()) for b in flux)
    )
    summary = _summary(bed)
    return flow_from_stream_function(
        grid,
        psi,
        fill,
        _shear_rate(bed, geometry, grid, fill),
        axis=geometry.axis,
        angular_velocity=bed.angular_velocity,
        lift=bed.angle,
        summary=summary | {"projection_change": change},
        warnings=warnings_of(bed, summary["solid_body_ratio"]),
    )


def wet_part(
    corners: FloatArray, material: FloatArray, grid: Grid, axis: int
) -> tuple[FloatArray, FloatArray]:
    """Wet share of the faces normal to an axis, in [0, 1], and the middle of the wet part.

    `material` is a level set at the corners, positive inside, linear along a face.
    """
    along = 1 - grid.array_axis(axis)
    ends = (slice(None, -1), slice(1, None))
    pick = [tuple(e if dim == along else slice(None) for dim in (0, 1)) for e in ends]
    a, b = material[pick[0]], material[pick[1]]
    difference = np.where(a == b, 1.0, a - b)
    zero = np.where((a > 0) == (b > 0), 0.0, a / difference)  # from the first end
    first = np.where(a > 0, 0.0, zero)
    last = np.where(b > 0, 1.0, zero)
    share = np.where((a <= 0) & (b <= 0), 0.0, last - first)
    middle = (0.5 * (first + last))[..., None]
    return share, (1 - middle) * corners[pick[0]] + middle * corners[pick[1]]


def _shear_rate(bed: SteadyBed, geometry: Geometry, grid: Grid, fill: FloatArray) -> FloatArray:
    """sqrt(2 E:E) of the mean velocity at the centres of the cells that hold material, 1/s."""
    strain_rate = ngs.Sym(ngs.Grad(bed.velocity))
    rate = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
    cells = np.flatnonzero(fill)
    points = kept_inside(geometry, grid.centre_points(cells))
    dense = np.zeros(grid.cells)
    dense[cells] = sample(bed.mesh, rate, points)
    return dense.reshape(grid.shape)


def kept_inside(geometry: Geometry, points: FloatArray) -> FloatArray:
    """Points moved along the wall's normal until they are inside the mesh, shape (n, dim)."""
    margin = _MARGIN * geometry.reach
    moved = points.copy()
    for _ in range(3):  # a signed distance that is not exact near edges needs more than one move
        missing = margin - geometry.signed_distance(moved)
        close = missing > 0
        if not close.any():
            break
        step = 1e-6 * geometry.reach
        outward = np.stack(
            [
                geometry.signed_distance(moved[close] - step * unit)
                - geometry.signed_distance(moved[close] + step * unit)
                for unit in np.eye(points.shape[-1])
            ],
            axis=-1,
        )
        outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
        moved[close] -= missing[close, None] * outward
    return moved


def _summary(bed: SteadyBed) -> dict[str, Any]:
    try:
        middle = mid_bed(bed)
    except IndexError:
        raise RunError(
            "the bed at mid-vessel has no free surface or no layer that flows: is the speed in the "
            "rolling range?"
        ) from None
    _, speed = surface_speed(bed)
    return {
        "surface_angle_deg": math.degrees(bed.angle),
        "surface_angle_error_deg": math.degrees(bed.angle_error),
        "surface_speed_max": float(speed.max()),
        "active_layer_thickness": middle.reversal_depth,
        "active_layer_definition": "depth at mid-bed where the lab streamwise velocity reverses",
        "solid_body_ratio": middle.rotation_ratio,
        "flux_midbed": middle.downflow,
        "upflow_midbed": middle.upflow,
        "rigid_upflow_midbed": middle.rigid_upflow,
        "axis_to_surface": middle.axis_distance,
        **_layer(middle, bed.angular_velocity),
        "volume_drift": bed.area_correction,
        "air_drained": bed.air_drained,
        "velocity_error": bed.velocity_error,
        "velocity_drift_per_revolution": bed.velocity_drift,
        "nonlocal_length": bed.nonlocal_length,
        "ill_posed_share": bed.ill_posed_share,
        "swings_averaged": bed.swings,
        "surface_angle_source": "solved; the error is the scatter between swings",
        "steady_within_tolerance": bed.converged,
        "began_from": described(bed.began),
        "time_steps": bed.steps,
        "retries": bed.retries,
        "time_step_halvings": bed.most_halvings,
        "time_stepping_s": bed.seconds,
    }


def _layer(middle: MidBed, speed: float) -> dict[str, Any]:
    """What `surface-layer` may take as its `shear_rate` for the same material."""
    b, depth = middle.axis_distance, middle.reversal_depth
    flux = middle.rigid_upflow + 0.5 * speed * ((b + depth) ** 2 - b**2)
    found: dict[str, Any] = {"layer_shear_rate": layer_shear_rate(flux, b, depth, speed)}
    if found["layer_shear_rate"] is None:
        found["layer_shear_rate_reason"] = "no linear layer with this flux reverses so deep"
    return found


def warnings_of(bed: SteadyBed, rotation_ratio: float) -> tuple[str, ...]:
    """Sentences on where the model or its mean may not hold."""
    found = []
    if rotation_ratio < _SLIDING:
        found.append(
            f"the bed turns at {rotation_ratio:.2f} of the vessel's speed below its layer: it "
            "slides on the wall instead of rolling"
        )
    if bed.fine_size > _RESOLVED * bed.nonlocal_length * (1 + 1e-9):
        found.append(
            f"elements of {1e3 * bed.fine_size:.3g} mm do not see the non-local length of "
            f"{1e3 * bed.nonlocal_length:.3g} mm (at most {_RESOLVED:g} times that would): the "
            "layer is regularised by the mesh, and changes with it"
        )
    if not bed.converged:
        found.append(
            f"the surface angle is known to {math.degrees(bed.angle_error):.2f} deg and the mean "
            f"velocity to {100 * bed.velocity_error:.2g} % only: the time limit came first; raise "
            "flow.time_limit to go on"
        )
    return tuple(found)
