"""`report.json` of a particle twin: the keys of a continuum run where they exist, and more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from scaleup.case.case import Case
from scaleup.case.vessel_shape import is_circle
from scaleup.measure.metrics import blend_time, decay_rate
from scaleup.particles.computing import Computation
from scaleup.particles.measuring import FINE_EDGE, Measured
from scaleup.particles.rolling_bed import RollingBed
from scaleup.report.compile import SCHEMA, made_by, operation_of
from scaleup.scene.units import LENGTH, MASS

_NO_ESTIMATE = "particles have no cells; run again with another particles.seed or larger grains"
_FEW = 20.0  # grains in a sample


def compile_particle_report(
    case: Case, computation: Computation, measured: Measured, ranks: int, seconds: float
) -> dict[str, Any]:
    """All figures of a particle twin, SI; a value that cannot be given has `<key>_reason`.

    seconds -- of measuring
    """
    contact = computation.contact
    costs = computation.costs()
    turning, settling = costs.get("turning"), costs.get("settling")
    engine_seconds = sum(cost.wall for cost in costs.values())
    reasons = ["grains: computed one by one, by LIGGGHTS"]
    if computation.length is not None:
        reasons.append(
            f"the cross-section is a slice of {LENGTH.shown(computation.length)}, periodic along z"
        )
    mixing = _mixing(case, measured, computation)
    return {
        "schema": SCHEMA,
        "warnings": _warnings(case, computation, measured),
        "model": {
            "dimension": case.geometry.dimension,
            "frame": "lab" if is_circle(case.geometry) else "vessel",
            "flow": "particles",
            "mixing": "particles",
            "reasons": reasons,
        },
        "operation": operation_of(case),
        "grid": {
            "spacing": list(case.grid.spacing),
            "counts": list(case.grid.counts),
            "active_cells": measured.active_cells,
        },
        "flow": _flow(measured),
        "mixing": mixing,
        "particles": {
            "count": len(measured.component),
            "diameter": contact.diameter,
            "spread": contact.spread,
            "mass_of_grains": computation.mass,
            "slice_length": computation.length,
            "solid_fraction": measured.solid_fraction,
            "level": measured.level,
            "level_of_fill": case.bed.top,
            "packing": "as many grains as have the mass of powder of the fill; `level` is where "
            "their surface came to rest, `level_of_fill` that of the fill at material.bulk_density",
            "shear_modulus_asked": case.particles.shear_modulus,
            "shear_modulus": contact.shear_modulus,
            "time_step": computation.schedule.time_step,
            "steps": 0 if turning is None else turning.steps,
            "overlap_greatest": measured.overlap_greatest,
            "overlap_99_percent": measured.overlap_99,
            "overlap_mean": measured.overlap_mean,
            "overlap_wall_greatest": measured.overlap_wall,
            "overlap_definition": "in mean diameters, of the contacts in 20 frames; at the wall "
            "that of the vessel itself, whose edges the triangles cut off in space",
            "contacts_per_grain": measured.contacts_per_grain,
            "particle_steps_per_core_s": None if turning is None else
            len(measured.component) * turning.steps / max(turning.cpu, 1e-9),
            "settling_cpu_s": None if settling is None else settling.cpu,
            "turning_cpu_s": None if turning is None else turning.cpu,
            "frames": len(measured.revolutions),
            "centre_of_mass_angle_deg": [math.degrees(a) for a in measured.centre_angle],
            "frame_revolutions": measured.revolutions,
        },
        "ledger": {
            "mass_drift": 0.0,
            "minimum": None,
            "maximum": None,
            "clipped_mass": 0.0,
            "steps": 0 if turning is None else turning.steps,
        },
        "error_estimate": {
            "method": "none",
            "tolerance": case.accuracy.tolerance,
            "surface_angle_deg": None,
            "surface_angle_deg_reason": _NO_ESTIMATE,
            "segregation_intensity": None,
            "segregation_intensity_reason": _NO_ESTIMATE,
            "within_tolerance": None,
            "within_tolerance_reason": _NO_ESTIMATE,
        },
        "timing": {
            "flow_s": engine_seconds,
            "mixing_s": seconds,
            "total_s": engine_seconds + seconds,
            "ranks": ranks,
            "mixing_ranks": 1,
        },
        **made_by(),
    }  # fmt: skip


def _flow(measured: Measured) -> dict[str, Any]:
    keys = (
        "surface_angle_deg", "surface_speed_max", "active_layer_thickness", "solid_body_ratio",
        "flux_midbed",
    )  # fmt: skip
    flowing = [
        math.degrees(a)
        for r, a in zip(measured.revolutions, measured.centre_angle, strict=True)
        if r >= measured.mean_from
    ]
    common = {
        "mean_from_revolution": measured.mean_from,
        "centre_of_mass_angle_deg": float(np.mean(flowing)),
        "centre_of_mass_angle_sd_deg": float(np.std(flowing)),
        "volume_drift": 0.0,
    }
    bed = measured.bed
    if not isinstance(bed, RollingBed):
        return {k: v for key in keys for k, v in ((key, None), (f"{key}_reason", bed))} | common
    depth, speed, solid = bed.profile
    return {
        "surface_angle_deg": math.degrees(bed.angle),
        "surface_speed_max": bed.speed_max,
        "surface_speed_midbed": bed.surface_speed,
        "active_layer_thickness": bed.layer,
        "bed_depth_midbed": bed.depth,
        "solid_body_ratio": bed.rotation[1],
        "wall_rotation_ratio": bed.rotation[0],
        "flux_midbed": bed.flux,
        "bed_solid_fraction": bed.solid_fraction,
        "profile_depth": depth,
        "profile_speed": speed,
        "profile_solid_fraction": solid,
        "definitions": "surface: mean solid fraction passes half of the settled bed's; rotation of "
        "the bed over the wall's: near the wall at 0.95 to 1 R, solid_body_ratio at 0.64 to 0.86 R",
    } | common


def _mixing(case: Case, measured: Measured, computation: Computation) -> dict[str, Any]:
    curve = measured.curve
    worst = [max(point, key=lambda one: one.intensity) for point in curve.sample]
    rsd = [max(one.rsd for one in point) for point in curve.sample]
    blended_at = blend_time(curve.revolutions, rsd, case.accuracy.blended_rsd)
    intensity = [point[0].intensity for point in curve.fine]
    grains = worst[-1].grains
    bulk = worst[-1].volume / measured.solid_fraction
    if computation.length is not None:
        bulk *= measured.edge / computation.length  # samples as deep as they are wide
        grains_of_cube = grains * measured.edge / computation.length
    else:
        grains_of_cube = grains
    shares = np.bincount(measured.component) / len(measured.component)
    asked = case.sample_edge
    mixing: dict[str, Any] = {
        "revolutions": curve.revolutions,
        "segregation_intensity": intensity,
        "segregation_intensity_raw": [point[0].raw for point in curve.fine],
        "segregation_intensity_floor": [point[0].floor for point in curve.fine],
        "segregation_intensity_at_scrutiny": [point[0].intensity for point in curve.sample],
        "segregation_intensity_at_scrutiny_raw": [point[0].raw for point in curve.sample],
        "segregation_intensity_at_scrutiny_floor": [point[0].floor for point in curve.sample],
        "lacey": [1.0 - one.intensity for one in worst],
        "rsd": rsd,
        "rsd_raw": [max(one.raw_rsd for one in point) for point in curve.sample],
        "blend_time_revolutions": blended_at,
        "blend_time_of_samples_revolutions": blended_at,
        "decay_rate_per_revolution": decay_rate(curve.revolutions, intensity),
        "centre_line": {},
        "samples": {
            "asked_edge": asked,
            "asked_mass": asked**3 * case.material.bulk_density,
            "edge": measured.edge,
            "mass": bulk * case.material.bulk_density,
            "grains": grains_of_cube,
            "grains_as_measured": grains,
            "random_mixture_rsd": math.sqrt((1 - shares.min()) / shares.min() / grains_of_cube),
            "resolved": (measured.edge / asked) ** 3 <= 2.0,
        },
        "definitions": {
            "segregation_intensity": f"of component 1 over samples of {FINE_EDGE:g} grains across, "
            "the smallest that show a variance; a continuum's is over cells",
            "at_scrutiny": "samples as asked for, where grains are fine enough; in a cross-section "
            "as deep as the slice",
            "raw, floor": "raw holds the noise of finite numbers of grains, which the others do "
            "not (unbiased estimate for independent draws); floor is raw of a random mixture",
            "lacey, rsd, blend_time": "of the component that is blended worst, noise removed",
        },
    }
    for key in ("blend_time_revolutions", "blend_time_of_samples_revolutions"):
        if mixing[key] is None:
            mixing[f"{key}_reason"] = (
                f"the RSD is {rsd[-1]:.3g} after {curve.revolutions[-1]:g} revolutions, still "
                f"above {case.accuracy.blended_rsd:g}"
            )
    if mixing["decay_rate_per_revolution"] is None:
        mixing["decay_rate_per_revolution_reason"] = "fewer than four points of I below 0.8"
    return mixing


def _warnings(case: Case, computation: Computation, measured: Measured) -> list[str]:
    found = list(getattr(case.geometry, "warnings", ()))
    particles, contact = case.particles, computation.contact
    if particles.coarse > 1:
        found.append(
            f"particles.coarse = {particles.coarse:g}: grains are so many times larger than the "
            "powder's, which falsifies what depends on their size: diffusion (as its square), the "
            "layer's thickness where it is a few grains, flow through gaps, the noise of samples"
        )
    if measured.overlap_greatest > 2 * particles.overlap:
        found.append(
            f"grains overlap by up to {100 * measured.overlap_greatest:.2g} % of a diameter, more "
            f"than twice particles.overlap = {particles.overlap:g}: raise particles.shear_modulus, "
            "or lower particles.overlap"
        )
    if measured.revolutions[-1] < 2 * measured.mean_from + 1e-9:
        found.append(
            f"means of the bed are over revolutions {measured.mean_from:.3g} to "
            f"{measured.revolutions[-1]:.3g} only, in which it may still swing"
        )
    if not is_circle(case.geometry):
        found.append(
            "the wall is made of triangles, on whose curved parts a bed slides more easily than it "
            "should (docs/particles.md)"
        )
    deep = (measured.level - case.geometry.lower[1]) / contact.diameter
    if deep < 10:
        found.append(f"the bed is {deep:.3g} grains deep: walls order the grains that far")
    grains = measured.curve.sample[-1][0].grains
    if grains < _FEW:
        found.append(
            f"samples hold {grains:.3g} grains: I and RSD without noise have a wide scatter of "
            "their own"
        )
    if measured.edge > case.sample_edge * (1 + 1e-9):
        asked, mass = case.sample_edge, case.sample_edge**3 * case.material.bulk_density
        found.append(
            f"samples of {MASS.shown(mass)} ({LENGTH.shown(asked)}) are asked for, and grains "
            f"resolve {LENGTH.shown(measured.edge)} only"
        )
    return found
