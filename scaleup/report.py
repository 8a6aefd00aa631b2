"""`report.json` for programs and `report.html` for people, from one set of figures."""

from __future__ import annotations

import base64
import json
import math
import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

import scaleup
from scaleup import figures
from scaleup.blending import Blend
from scaleup.config import RunConfig, fill_in_all_kinds
from scaleup.files import write_text
from scaleup.flow_source import FlowOutcome
from scaleup.metrics import blend_time, decay_rate
from scaleup.storage import Results
from scaleup.vessel_shape import froude_number

SCHEMA = "scaleup-report/1"
_FLOW_KEYS = (
    "surface_angle_deg",
    "surface_speed_max",
    "active_layer_thickness",
    "solid_body_ratio",
    "flux_midbed",
    "volume_drift",
)
_OVERSHOOT, _MASS_DRIFT, _CELLS_PER_LAYER = 0.05, 2e-3, 10
_LIBRARIES = ("numpy", "mpi4py", "petsc4py", "ngsolve", "h5py", "numba", "pydantic")


def write_report(
    folder: Path,
    config: RunConfig,
    outcome: FlowOutcome,
    blend: Blend,
    coarse: Blend | str,
    results: Results,
    ranks: int,
) -> None:
    """Write figures/, report.html and, last, report.json; called on the root.

    `coarse` is the blend on cells twice as large, or why there is none.
    """
    report = compile_report(config, outcome, blend, coarse, ranks)
    pictures = _draw(folder / "figures", outcome, blend, coarse, results)
    write_text(folder / "report.html", _html(report, pictures))
    write_text(folder / "report.json", json.dumps(_finite(report), indent=2) + "\n")


def compile_report(
    config: RunConfig,
    outcome: FlowOutcome,
    blend: Blend,
    coarse: Blend | str,
    ranks: int,
) -> dict[str, Any]:
    """All figures of a run, SI; a value that cannot be given is None with `<key>_reason`."""
    flow, interval = outcome.flow, outcome.flow.intervals[0]
    blended_at = blend_time(blend.revolutions, blend.rsd, config.accuracy.blended_rsd)
    mixing: dict[str, Any] = {
        "revolutions": blend.revolutions,
        "segregation_intensity": blend.intensity,
        "segregation_intensity_at_scrutiny": blend.intensity_sample,
        "lacey": blend.lacey,
        "rsd": blend.rsd,
        "blend_time_revolutions": blended_at,
        "decay_rate_per_revolution": decay_rate(blend.revolutions, blend.intensity),
        "centre_line": blend.profiles,
        "definitions": {
            "segregation_intensity": "Eq. 22-25 over nodes (cells at least half full), component 1",
            "lacey, rsd, blend_time": "of the component that is blended worst",
            "at_scrutiny": f"fill-weighted samples of edge {config.accuracy.scrutiny:g} grain "
            f"diameters, {blend.sample_volume:.3g} m^3 each",
            "blend_time": f"first revolution with RSD at scrutiny below "
            f"{config.accuracy.blended_rsd:g} for good",
        },
    }
    if blended_at is None:
        mixing["blend_time_revolutions_reason"] = (
            f"the RSD is {blend.rsd[-1]:.3g} after {blend.revolutions[-1]:g} revolutions, still "
            f"above {config.accuracy.blended_rsd:g}"
        )
    if mixing["decay_rate_per_revolution"] is None:
        mixing["decay_rate_per_revolution_reason"] = "fewer than four points of I below 0.8"
    ledger = blend.ledger
    estimate = _error_estimate(config, outcome, blend, coarse)
    estimate_seconds = 0.0 if isinstance(coarse, str) else coarse.seconds
    return {
        "schema": SCHEMA,
        "warnings": _warnings(config, outcome, blend, estimate),
        "model": {
            "dimension": flow.grid.dimension,
            "frame": flow.frame,
            "flow": config.flow["name"],
            "mixing": config.mixing["name"],
            "reasons": _reasons(config, outcome),
        },
        "operation": {
            "geometry": config.geometry["name"],
            "loading": config.operation.loading.pattern,
            "speed_rad_per_s": config.operation.speed,
            "speed_rpm": config.operation.speed * 60 / (2 * math.pi),
            "froude_number": froude_number(config.plugin("geometry"), config.operation.speed),
            "froude_definition": "omega^2 R / g, R the reach of the vessel from the axis",
            "fill": fill_in_all_kinds(config),
            "lift_revolutions": flow.lift / (2 * math.pi),
        },
        "grid": {
            "spacing": list(flow.grid.spacing),
            "counts": list(flow.grid.counts),
            "active_cells": len(interval.cells),
        },
        "flow": _flow_figures(outcome),
        "mixing": mixing,
        "ledger": {
            "mass_drift": blend.mass_drift,
            "minimum": ledger.minimum if ledger.steps else None,
            "maximum": ledger.maximum if ledger.steps else None,
            "clipped_mass": ledger.clipped,
            "steps": ledger.steps,
            "iterations": ledger.iterations,
            "step_over_stable_step": ledger.step_share if ledger.steps else None,
        },
        "error_estimate": estimate,
        "timing": {
            "flow_s": outcome.seconds,
            "mixing_s": blend.seconds,
            "estimate_s": estimate_seconds,
            "total_s": outcome.seconds + blend.seconds + estimate_seconds,
            "ranks": ranks,
            "cell_updates_per_s": ledger.cell_updates / max(blend.seconds, 1e-9),
        },
        "machine": {
            "processor": _processor(),
            "cores": os.cpu_count(),
            "system": platform.platform(),
        },
        "versions": {
            "scaleup": scaleup.__version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in _LIBRARIES},
        },
    }


def _flow_figures(outcome: FlowOutcome) -> dict[str, Any]:
    summary = dict(outcome.flow.summary)
    figures_of_flow: dict[str, Any] = {"reused": outcome.reused, "content_hash": outcome.key}
    for key in _FLOW_KEYS:
        figures_of_flow[key] = summary.pop(key, None)
        if figures_of_flow[key] is None and f"{key}_reason" not in summary:
            figures_of_flow[f"{key}_reason"] = "the flow model does not state it"
    return figures_of_flow | summary


def _reasons(config: RunConfig, outcome: FlowOutcome) -> list[str]:
    flow = outcome.flow
    reasons = []
    if flow.grid.dimension == 2:
        reasons.append(f"2-D: the geometry {config.geometry['name']!r} is a cross-section")
    if flow.steady:
        reasons.append("steady: the bed stands still in the lab frame once it flows")
    reasons.append(f"flow {config.flow['name']!r} and mixing {config.mixing['name']!r} as asked")
    if outcome.reused:
        reasons.append("the flow was solved before and reused from the store")
    return reasons


def _error_estimate(
    config: RunConfig, outcome: FlowOutcome, blend: Blend, coarse: Blend | str
) -> dict[str, Any]:
    estimate: dict[str, Any] = {
        "method": "greatest change of I over the run when cells are twice as large",
        "tolerance": config.accuracy.tolerance,
        "surface_angle_deg": outcome.flow.summary.get("surface_angle_error_deg"),
    }
    if estimate["surface_angle_deg"] is None:
        estimate["surface_angle_deg_reason"] = "the flow model states no error of its angle"
    if isinstance(coarse, str):
        return estimate | {
            "segregation_intensity": None,
            "segregation_intensity_reason": coarse,
            "within_tolerance": None,
            "within_tolerance_reason": coarse,
        }
    worst = max(_band(blend, coarse))
    return estimate | {
        "segregation_intensity": worst,
        "within_tolerance": worst <= config.accuracy.tolerance,
    }


def _warnings(
    config: RunConfig, outcome: FlowOutcome, blend: Blend, estimate: dict[str, Any]
) -> list[str]:
    """What a reader should know before using the figures."""
    found = list(outcome.flow.warnings)
    ledger, grid = blend.ledger, outcome.flow.grid
    if estimate["within_tolerance"] is False:
        found.append(
            f"I changes by up to {estimate['segregation_intensity']:.2g} on cells twice as large, "
            f"more than the tolerance {config.accuracy.tolerance:g}: take smaller cells"
        )
    if ledger.step_share > 1.0 + 1e-9:
        found.append(
            f"FORCED: mixing steps were {ledger.step_share:.3g} times the stable one; the result "
            "may be an artefact of instability"
        )
    beyond = max(0.0, -ledger.minimum, ledger.maximum - 1.0) if ledger.steps else 0.0
    if beyond > _OVERSHOOT:
        found.append(
            f"concentrations left [0, 1] by up to {beyond:.2g} on the way (sharp fronts, unlimited "
            "scheme)"
        )
    if blend.mass_drift > _MASS_DRIFT:
        found.append(f"a component's volume drifted by {blend.mass_drift:.2g} of itself")
    thickness = outcome.flow.summary.get("active_layer_thickness")
    if isinstance(thickness, float) and thickness < _CELLS_PER_LAYER * min(grid.spacing):
        found.append(
            f"the active layer is {thickness / min(grid.spacing):.1f} cells thick; "
            f"{_CELLS_PER_LAYER} or more are wanted"
        )
    return found


def _band(blend: Blend, coarse: Blend) -> list[float]:
    return [abs(a - b) for a, b in zip(blend.intensity, coarse.intensity, strict=True)]


def _draw(
    folder: Path, outcome: FlowOutcome, blend: Blend, coarse: Blend | str, results: Results
) -> list[tuple[str, Path]]:
    folder.mkdir(exist_ok=True)
    flow = outcome.flow
    drawn = []

    def add(caption: str, name: str) -> Path:
        drawn.append((caption, folder / f"{name}.png"))
        return folder / f"{name}.png"

    stored = results.snapshots()
    figures.snapshots(add("Concentration as the vessel turns", "snapshots"), flow.grid, stored)
    figures.blend_curve(
        add("Segregation intensity against revolutions", "blend_curve"),
        blend.revolutions,
        {"over nodes": blend.intensity, "at the scale of scrutiny": blend.intensity_sample},
        None if isinstance(coarse, str) else _band(blend, coarse),
    )
    figures.speed_map(add("Speed of the powder", "speed"), flow)
    angle = flow.summary.get("surface_angle_deg")
    if flow.frame == "lab" and flow.grid.dimension == 2 and isinstance(angle, float):
        figures.velocity_profiles(
            add("Velocity along the surface and at mid-bed", "velocity_profiles"),
            flow,
            math.radians(angle),
        )
    if blend.profiles:
        figures.centre_profiles(
            add("Concentration along the centre line of the bed", "centre_line"), blend.profiles
        )
    return drawn


def _html(report: dict[str, Any], pictures: list[tuple[str, Path]]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("scaleup", "templates"), autoescape=True
    )
    environment.filters["figure"] = _shown
    embedded = [
        (caption, base64.b64encode(path.read_bytes()).decode()) for caption, path in pictures
    ]
    return environment.get_template("report.html").render(report=report, pictures=embedded)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(_shown(item) for item in value)
    return str(value)


def _finite(value: Any) -> Any:
    """JSON has no infinities: they become null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        return platform.processor() or "unknown"


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        # Debian ships h5py under another distribution name
        return getattr(__import__(name), "__version__", None)
