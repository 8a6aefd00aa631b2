"""`report.json` for programs and `report.html` for people, from one set of figures."""

from __future__ import annotations

import base64
import json
import math
import os
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import jinja2
import numpy as np

import scaleup
from scaleup.case.case import Case
from scaleup.case.composing import compose
from scaleup.case.vessel_shape import froude_number
from scaleup.flow.source import FlowOutcome
from scaleup.measure.blend import Blend
from scaleup.measure.metrics import blend_time, decay_rate
from scaleup.measure.sampling import Samples, samples_of
from scaleup.report import bed_figures, figures, grain_figures
from scaleup.report.bed_view import Picture, Wall, wall_of
from scaleup.report.cautions import cautions
from scaleup.report.results import FRAMES, PHASES, Results, instants
from scaleup.system.errors import InputError
from scaleup.system.files import write_text
from scaleup.system.progress import Reporter

SCHEMA = "scaleup-report/1"
_FLOW_KEYS = (
    "surface_angle_deg",
    "surface_speed_max",
    "active_layer_thickness",
    "solid_body_ratio",
    "flux_midbed",
    "volume_drift",
)
_UNITS = {
    "surface_speed_max": "m/s",
    "active_layer_thickness": "m",
    "flux_midbed": "m^2/s",
    "shear_rate": "1/s",
    "spacing": "m",
    "mass": "kg",
    "edge": "m",
    "asked_mass": "kg",
    "asked_edge": "m",
}
_LONG = 12  # values of a list that a table still shows
_OVERSHOOT, _MASS_DRIFT, _CELLS_PER_LAYER = 0.05, 2e-3, 10
_LIBRARIES = ("numpy", "mpi4py", "petsc4py", "ngsolve", "h5py", "numba", "pydantic")


def write_report(folder: Path, report: dict[str, Any], results: Results, geometry: Any) -> None:
    """Write figures/ and report.html; called on the root.

    report -- of `compile_report`, or as read again from report.json; all else is drawn from results
    """
    report = _finite(report)
    pictures = _draw(folder / "figures", report, results, geometry)
    write_text(folder / "report.html", _html(report, pictures))


def write_json(folder: Path, report: dict[str, Any]) -> None:
    """Write report.json; called on the root."""
    write_text(folder / "report.json", json.dumps(_finite(report), indent=2) + "\n")


def redraw(folder: Path) -> None:
    """Make figures/ and report.html of a finished run again. Raises InputError if it is none."""
    results = Results.open(folder)
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: is not a finished run (report.json: {error})") from error
    write_report(folder, report, results, compose(folder / "config.toml").geometry)


def compile_report(
    case: Case,
    outcome: FlowOutcome,
    blend: Blend,
    coarse: Blend | str,
    ranks: int,
) -> dict[str, Any]:
    """All figures of a run, SI; a value that cannot be given is None with `<key>_reason`."""
    flow, interval = outcome.flow, outcome.flow.intervals[0]
    samples = _samples(case, outcome, blend)
    blended_at = blend_time(blend.revolutions, blend.rsd, case.accuracy.blended_rsd)
    mixing: dict[str, Any] = {
        "revolutions": blend.revolutions,
        "segregation_intensity": blend.intensity,
        "segregation_intensity_at_scrutiny": blend.intensity_sample,
        "lacey": blend.lacey,
        "rsd": blend.rsd,
        "blend_time_revolutions": blended_at if samples.resolved else None,
        "blend_time_of_samples_revolutions": blended_at,
        "decay_rate_per_revolution": decay_rate(blend.revolutions, blend.intensity),
        "centre_line": blend.profiles,
        "samples": samples.as_table(),
        "definitions": {
            "segregation_intensity": "Eq. 22-25 over nodes (cells at least half full), component 1",
            "lacey, rsd, blend_time": "of the component that is blended worst",
            "at_scrutiny": f"fill-weighted {samples}, {samples.grains:.3g} grains each; asked "
            f"for: {samples.asked}",
            "rsd": "of the concentrations; which grains are drawn adds what a random mixture shows",
            "lacey": "of the grains in the samples, that is 1 - I at scrutiny",
            "blend_time": f"first revolution with RSD at scrutiny below "
            f"{case.accuracy.blended_rsd:g} for good",
        },
    }
    if blended_at is None:
        mixing["blend_time_of_samples_revolutions_reason"] = (
            f"the RSD is {blend.rsd[-1]:.3g} after {blend.revolutions[-1]:g} revolutions, still "
            f"above {case.accuracy.blended_rsd:g}"
        )
    if mixing["blend_time_revolutions"] is None:
        mixing["blend_time_revolutions_reason"] = _not_blended(mixing, samples)
    if mixing["decay_rate_per_revolution"] is None:
        mixing["decay_rate_per_revolution_reason"] = "fewer than four points of I below 0.8"
    ledger = blend.ledger
    estimate = _error_estimate(case, outcome, blend, coarse)
    estimate_seconds = 0.0 if isinstance(coarse, str) else coarse.seconds
    return {
        "schema": SCHEMA,
        "warnings": _warnings(case, outcome, blend, estimate, samples),
        "model": {
            "dimension": flow.grid.dimension,
            "frame": flow.frame,
            "flow": case.name("flow"),
            "mixing": case.name("mixing"),
            "reasons": _reasons(case, outcome),
        },
        "operation": operation_of(case) | {"lift_revolutions": flow.lift / (2 * math.pi)},
        "grid": {
            "spacing": list(flow.grid.spacing),
            "counts": list(flow.grid.counts),
            "active_cells": len(interval.cells),
        },
        **({"material": {"provenance": told}} if (told := case.material.provenance) else {}),
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
            "mixing_ranks": blend.ranks,
            "cell_updates_per_s": ledger.cell_updates / max(blend.seconds, 1e-9),
        },
        **made_by(),
    }


def operation_of(case: Case) -> dict[str, Any]:
    """How the vessel is filled and turned, for the report."""
    return {
        "geometry": case.name("geometry"),
        "loading": case.operation.loading.pattern,
        "speed_rad_per_s": case.operation.speed,
        "speed_rpm": case.operation.speed * 60 / (2 * math.pi),
        "froude_number": froude_number(case.geometry, case.operation.speed),
        "froude_definition": "omega^2 R / g, R the reach of the vessel from the axis",
        "fill": case.fill_in_all_kinds,
    }


def made_by() -> dict[str, Any]:
    """`machine` and `versions`, for the report."""
    return {
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


def _samples(case: Case, outcome: FlowOutcome, blend: Blend) -> Samples:
    volumes = blend.volumes[-1]
    share = min(volumes) / sum(volumes)
    return Samples.of(case, outcome.flow.grid, blend.sample_volume, share)


def _not_blended(mixing: dict[str, Any], samples: Samples) -> str:
    """Why no blend time can be given; of smaller samples than are measured there is a bound."""
    blended_at = mixing["blend_time_of_samples_revolutions"]
    if blended_at is None:
        return str(mixing["blend_time_of_samples_revolutions_reason"])
    return (
        f"{samples} are blended after {blended_at:.3g} revolutions; the cells do not resolve the "
        f"{samples.asked} asked for, which are blended later"
    )


def _flow_figures(outcome: FlowOutcome) -> dict[str, Any]:
    summary = dict(outcome.flow.summary)
    figures_of_flow: dict[str, Any] = {"reused": outcome.reused, "content_hash": outcome.key}
    for key in _FLOW_KEYS:
        figures_of_flow[key] = summary.pop(key, None)
        if figures_of_flow[key] is None and f"{key}_reason" not in summary:
            figures_of_flow[f"{key}_reason"] = "the flow model does not state it"
    return figures_of_flow | summary


def _reasons(case: Case, outcome: FlowOutcome) -> list[str]:
    flow = outcome.flow
    reasons = []
    if flow.grid.dimension == 2:
        reasons.append(f"2-D: the geometry {case.name('geometry')!r} is a cross-section")
    else:
        reasons.append(f"3-D: the geometry {case.name('geometry')!r} is a vessel in space")
    if flow.frame == "vessel":
        turns = (flow.times[flow.prefix] - flow.times[0]) / case.operation.period
        reasons.append(
            "periodic, in the frame of the vessel: the resting part of the bed is not smeared; one "
            f"revolution is repeated after a start-up of {turns:.2f}"
        )
    elif flow.steady:
        reasons.append("steady: the bed stands still in the lab frame once it flows")
    reasons.append(f"flow {case.name('flow')!r} and mixing {case.name('mixing')!r} as asked")
    if outcome.reused:
        reasons.append("the flow was solved before and reused from the store")
    return reasons


def _error_estimate(
    case: Case, outcome: FlowOutcome, blend: Blend, coarse: Blend | str
) -> dict[str, Any]:
    estimate: dict[str, Any] = {
        "method": "greatest change of I over the run when cells are twice as large",
        "tolerance": case.accuracy.tolerance,
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
        "segregation_intensity_by_point": _band(blend, coarse),
        "within_tolerance": worst <= case.accuracy.tolerance,
    }


def _warnings(
    case: Case,
    outcome: FlowOutcome,
    blend: Blend,
    estimate: dict[str, Any],
    samples: Samples,
) -> list[str]:
    """What a reader should know before using the figures."""
    found = [
        *outcome.flow.warnings,
        *blend.remarks,
        *cautions(case, outcome.flow.grid, samples),
    ]
    ledger, grid = blend.ledger, outcome.flow.grid
    if estimate["within_tolerance"] is False:
        found.append(
            f"I changes by up to {estimate['segregation_intensity']:.2g} on cells twice as large, "
            f"more than the tolerance {case.accuracy.tolerance:g}: take smaller cells"
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
    folder: Path, report: dict[str, Any], results: Results, geometry: Any
) -> list[tuple[str, Path]]:
    """Draw all figures of a run; returns (caption, file)."""
    folder.mkdir(exist_ok=True)
    drawn = []

    def add(caption: str, name: str) -> Path:
        drawn.append((caption, folder / name))
        return folder / name

    mixing = report["mixing"]
    in_lab = results.motion.frame == "lab" and results.grid.dimension == 2
    if in_lab:
        _draw_in_lab(add, report, results)
    else:
        _draw_turning(add, report, results, wall_of(geometry))
    figures.blend_curve(
        add("Segregation intensity against revolutions", "blend_curve.png"),
        mixing["revolutions"],
        {
            "over nodes": mixing["segregation_intensity"],
            samples_of(mixing): mixing["segregation_intensity_at_scrutiny"],
        },
        report["error_estimate"].get("segregation_intensity_by_point"),
    )
    stored_grains = folder.parent / "grains.h5"
    if stored_grains.exists():
        picture = add("Grains, coloured by component", "grains.png")
        grain_figures.grains(picture, grain_figures.read_grains(stored_grains))
    if mixing["centre_line"]:
        figures.centre_profiles(
            add("Concentration along the centre line of the bed", "centre_line.png"),
            mixing["centre_line"],
        )
    stored = results.revolutions("pictures")
    for which in ("first", "last"):
        wanted = instants(which, mixing["revolutions"][-1], FRAMES)
        if wanted[1:2] and wanted[1] in stored:  # in steps of a frame, not of a phase
            frames = _pictures(results, which, FRAMES, report)
            name = f"{which}_revolution.gif"
            path = add(f"The {which} revolution, played in {len(frames) / 10:.1f} s", name)
            with Reporter(f"animation of the {which} revolution", visible=True) as progress:
                bed_figures.animation(path, frames, wall_of(geometry), progress)
    return drawn


def _draw_in_lab(add: Callable[[str, str], Path], report: dict[str, Any], results: Results) -> None:
    """A cross-section that stands still in the lab."""
    grid, stored = results.grid, results.revolutions()
    shown = [stored[i] for i in np.unique(np.linspace(0, len(stored) - 1, 6).round().astype(int))]
    fields = [(at, results.snapshot(at)["concentration_1"].astype(float)) for at in shown]
    figures.snapshots(add("Concentration as the vessel turns", "snapshots.png"), grid, fields)
    last = results.snapshot(stored[-1])
    velocity = np.stack([last[f"velocity_{axis}"] for axis in "xy"]).astype(float)
    figures.speed_map(add("Speed of the powder", "speed.png"), grid, velocity)
    angle = report["flow"]["surface_angle_deg"]
    if isinstance(angle, float):
        figures.velocity_profiles(
            add("Velocity along the surface and at mid-bed", "velocity_profiles.png"),
            grid,
            velocity,
            math.radians(angle),
        )


def _draw_turning(
    add: Callable[[str, str], Path], report: dict[str, Any], results: Results, wall: Wall
) -> None:
    """A bed whose fields are kept in the frame of its vessel."""
    of_component = "coloured by the concentration of component 1"
    for which in ("first", "last"):
        pictures = _pictures(results, which, PHASES, report)
        if pictures:
            path = add(f"The bed in the {which} revolution, {of_component}", f"bed_{which}.png")
            bed_figures.phases(path, pictures, wall)
    stored = results.revolutions()
    chosen = [stored[i] for i in np.unique(np.linspace(0, len(stored) - 1, 4).round().astype(int))]
    bed_figures.cuts(
        add("The bed cut open", "snapshots.png"),
        [results.picture(at, "snapshots") for at in chosen],
        wall,
    )
    last = results.snapshot(stored[-1])
    speed = np.sqrt(sum(v.astype(float) ** 2 for k, v in last.items() if k.startswith("velocity")))
    bed_figures.speed_cuts(
        add("Speed of the powder relative to the vessel", "speed.png"),
        results.picture(stored[-1], "snapshots"),
        speed,
        wall,
    )


def _pictures(
    results: Results, which: Literal["first", "last"], count: int, report: dict[str, Any]
) -> list[Picture]:
    """Those pictures of a revolution that were stored, without the end that repeats the phase."""
    stored = set(results.revolutions("pictures"))
    wanted = instants(which, report["mixing"]["revolutions"][-1], count)
    return [results.picture(at) for at in wanted[:count] if at in stored]


def _html(report: dict[str, Any], pictures: list[tuple[str, Path]]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("scaleup.report", "templates"), autoescape=True
    )
    environment.filters["figure"] = _shown
    environment.filters["label"] = _label
    environment.filters["of_samples"] = samples_of
    embedded = [
        (caption, path.suffix[1:], base64.b64encode(path.read_bytes()).decode())
        for caption, path in pictures
    ]
    return environment.get_template("report.html").render(report=report, pictures=embedded)


def _label(key: str) -> str:
    """A key in words, with its unit."""
    unit = _UNITS.get(key)
    return key.replace("_", " ") + (f", {unit}" if unit else "")


def _shown(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple) and len(value) > _LONG:
        return f"{len(value)} values, in report.json"
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
