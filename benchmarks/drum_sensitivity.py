"""The paper's drum by `mohr-coulomb`: what its mean bed owes to each numerical parameter and input.

One change at a time from the base (grains of 1 mm with their non-local length, elements of R/24,
the rules of `parameters.py`), beside refinement with the length held and with one that shrinks with
the mesh, the wall's friction, the rheologies and the speed. A case that cannot be solved says why.
Every result is kept in a file of its own, so that the study goes on where it stopped.

    python benchmarks/drum_sensitivity.py [--output DIR] [CASE ...]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import time
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from scaleup.case.composing import compose
from scaleup.contract import RunError
from scaleup_mohr_coulomb.mesh import cross_section_mesh
from scaleup_mohr_coulomb.mid_bed import mid_bed, surface_speed
from scaleup_mohr_coulomb.parameters import Discretisation, Drive, Rheology, SteadyOptions
from scaleup_mohr_coulomb.steady import NotSteady, run_to_steady
from scaleup_mohr_coulomb.stepping import CarefulSteps
from scaleup_mohr_coulomb.swings import SwingAverage
from scaleup_mohr_coulomb.two_phase import FlowDiverged, TwoPhaseFlow

RADIUS = 0.07
GRAIN = 1e-3  # m
H, L = RADIUS / 24, 0.48 * GRAIN / math.sqrt(math.tan(math.radians(23.6)))  # m, of the base
TIME_LIMIT = 140.0  # sqrt(R/g)


@dataclasses.dataclass(frozen=True)
class Case:
    """What differs from the base: factors of parameters, sizes in m, the material, the drive."""

    factors: dict[str, float] = dataclasses.field(default_factory=dict)
    fine_size: float = H
    nonlocal_length: float = L
    material: dict[str, Any] = dataclasses.field(default_factory=dict)
    rheology: str = "mohr-coulomb"
    rpm: float = 6.0


def factor(name: str, value: float) -> Case:
    return Case(factors={name: value})


CASES = {
    "base": Case(),
    "dt x 1/2": factor("time_step", 0.5),
    "dt x 2": factor("time_step", 2.0),
    "dt x 4": factor("time_step", 4.0),
    "predictor length x 0.35": factor("predictor_length", 0.35),
    "predictor length x 1/2": factor("predictor_length", 0.5),
    "predictor length x 0.7": factor("predictor_length", 0.7),
    "predictor length x 1.4": factor("predictor_length", 1.4),
    "predictor length x 2": factor("predictor_length", 2.0),
    "predictor threshold x 1/2": factor("predictor_threshold", 0.5),
    "predictor threshold x 2": factor("predictor_threshold", 2.0),
    "eps x 1/4096": factor("creep_rate", 1 / 4096),
    "eps x 1/256": factor("creep_rate", 1 / 256),
    "eps x 1/16": factor("creep_rate", 1 / 16),
    "eps x 1/4": factor("creep_rate", 0.25),
    "eps x 4": factor("creep_rate", 4.0),
    "eps x 16": factor("creep_rate", 16.0),
    "eps x 64": factor("creep_rate", 64.0),
    "slip speed x 1/4": factor("slip_speed", 0.25),
    "slip speed x 4": factor("slip_speed", 4.0),
    "interface x 1/2": factor("interface_half_width", 0.5),
    "interface x 2": factor("interface_half_width", 2.0),
    "air density x 1/10": factor("air_density", 0.1),
    "air viscosity x 1/10": factor("air_viscosity", 0.1),
    "air viscosity x 10": factor("air_viscosity", 10.0),
    "l x 2": Case(nonlocal_length=2 * L),
    "h = 5.8 mm": Case(fine_size=2 * H),
    "h = 4.1 mm": Case(fine_size=math.sqrt(2) * H),
    "h = 2.1 mm": Case(fine_size=H / math.sqrt(2)),
    "h = 1.5 mm": Case(fine_size=0.5 * H),
    "h = 1.0 mm": Case(fine_size=H / math.sqrt(8)),
    "h = 5.8 mm, l = h/4": Case(fine_size=2 * H, nonlocal_length=2 * L),
    "h = 4.1 mm, l = h/4": Case(fine_size=math.sqrt(2) * H, nonlocal_length=math.sqrt(2) * L),
    "h = 2.1 mm, l = h/4": Case(fine_size=H / math.sqrt(2), nonlocal_length=L / math.sqrt(2)),
    "h = 1.5 mm, l = h/4": Case(fine_size=0.5 * H, nonlocal_length=0.5 * L),
    "no length": Case(nonlocal_length=0.01 * L),
    "wall friction 0.05": Case(material={"wall_friction": 0.05}),
    "wall friction 0.15": Case(material={"wall_friction": 0.15}),
    "wall friction 0.6": Case(material={"wall_friction": 0.6}),
    "sin": Case(material={"friction_measured": "mohr-coulomb"}),
    "mu-i": Case(rheology="mu-i"),
    "regularised-mu-i": Case(rheology="regularised-mu-i"),
    "2 rpm": Case(rpm=2.0),
    "4 rpm": Case(rpm=4.0),
    "10 rpm": Case(rpm=10.0),
    "15 rpm": Case(rpm=15.0),
    "15 rpm, h = 1.5 mm": Case(fine_size=0.5 * H, rpm=15.0),
    "20 rpm": Case(rpm=20.0),
    "20 rpm, h = 1.5 mm": Case(fine_size=0.5 * H, rpm=20.0),
    "30 rpm": Case(rpm=30.0),
}


def solve(name: str, case: Case) -> dict[str, Any]:
    """Figures of the mean bed, or under "failed" why there is none."""
    drum = compose(None, [f"material.{key}={value}" for key, value in case.material.items()])
    geometry, material = drum.geometry, drum.material
    drive = Drive(drum.fill_volume / geometry.depth, case.rpm * math.pi / 30)

    def by_rule(time_step: float | None = None) -> Discretisation:
        sizes = {"fine_size": case.fine_size, "nonlocal_length": case.nonlocal_length}
        return Discretisation.by_rule(material, drive, RADIUS, time_step=time_step, **sizes)

    rules = by_rule()
    changed = {key: value * getattr(rules, key) for key, value in case.factors.items()}
    numerics = dataclasses.replace(by_rule(changed.get("time_step")), **changed)
    mesh = cross_section_mesh(
        geometry.solid(),
        numerics.coarse_size,
        numerics.fine_size,
        drive.bed_area,
        numerics.band_angle,
        numerics.band_depth,
        numerics.band_height,
    )
    rheology = Rheology.by_literature(case.rheology)  # type: ignore[arg-type]
    flow = TwoPhaseFlow(mesh, material, drive, numerics, rheology)
    steps = CarefulSteps(flow, SwingAverage(flow))
    limit = TIME_LIMIT * math.sqrt(RADIUS / drive.gravity)
    began = time.monotonic()

    def progress(share: float, text: str) -> None:
        print(f"{name}: {time.monotonic() - began:4.0f} s, {text}", flush=True)

    try:
        bed = run_to_steady(steps, SteadyOptions(time_limit=limit), progress)
        middle = mid_bed(bed)
    except (FlowDiverged, NotSteady, RunError) as error:
        return {"failed": f"{type(error).__name__}: {error}", "seconds": time.monotonic() - began}
    return {
        "elements": mesh.ne,
        "angle_deg": math.degrees(bed.angle),
        "angle_error_deg": math.degrees(bed.angle_error),
        "converged": bed.converged,
        "velocity_error": bed.velocity_error,
        "layer_mm": 1e3 * middle.reversal_depth,
        "surface_speed": float(surface_speed(bed)[1].max()),
        "shear_rate": float(np.abs(np.gradient(middle.speed, middle.depth)).max()),
        "flux_balance": middle.downflow / middle.upflow,
        "of_rigid": middle.downflow / middle.rigid_upflow,
        "rotation": middle.rotation_ratio,
        "volume": bed.area_correction,
        "ill_posed": bed.ill_posed_share,
        "steps": bed.steps,
        "retries": bed.retries,
        "seconds": bed.seconds,
        "depth": middle.depth.tolist(),
        "speed": middle.speed.tolist(),
    }


def table(results: dict[str, dict[str, Any]]) -> str:
    lines = [
        "| case | angle, deg | layer, mm | surface speed, m/s | greatest shear rate, 1/s | down/up "
        "| bed/wall rotation | volume, % | steps (retries) | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, r in results.items():
        if "failed" in r:
            lines.append(f"| {name} | {r['failed'].split(':')[0]} |")
            continue
        late = "" if r["converged"] else " (time limit)"
        lines.append(
            f"| {name} | {r['angle_deg']:.2f} +- {r['angle_error_deg']:.2f}{late} "
            f"| {r['layer_mm']:.1f} | {r['surface_speed']:.3f} | {r['shear_rate']:.1f} "
            f"| {r['flux_balance']:.3f} | {r['rotation']:.3f} | {100 * r['volume']:.4f} "
            f"| {r['steps']} ({r['retries']}) | {r['seconds']:.0f} |"
        )
    return "\n".join(lines)


def draw(results: dict[str, dict[str, Any]], path: Path) -> None:
    """Refinement with the length held and with one that shrinks: angle and greatest shear rate."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    base = ["base"] if "base" in results else []
    held = [n for n in results if n.startswith("h =") and "l =" not in n] + base
    shrinking = [n for n in results if "l = h/4" in n] + base
    for names, label, colour in (
        (held, "l = 0.73 mm held", "C0"),
        (shrinking, "l = h/4, shrinks with the mesh", "C3"),
    ):
        names = [n for n in names if results[n].get("converged")]
        names.sort(key=lambda n: CASES[n].fine_size)
        sizes = [1e3 * CASES[n].fine_size for n in names]
        for axis, key in zip(axes, ("angle_deg", "layer_mm", "shear_rate"), strict=True):
            values = [results[n][key] for n in names]
            error = [results[n]["angle_error_deg"] for n in names] if key == "angle_deg" else None
            axis.errorbar(sizes, values, error, marker="o", color=colour, label=label, capsize=3)
    for axis, label in zip(
        axes,
        ("surface angle, deg", "layer at mid-bed, mm", "greatest shear rate at mid-bed, 1/s"),
        strict=True,
    ):
        axis.set(xlabel="elements h, mm", ylabel=label, xlim=(0, None))
    axes[0].legend(fontsize="small")
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--output", type=Path, default=Path("runs/drum-sensitivity"))
    parser.add_argument("cases", nargs="*", default=[], help="names; all if none is given")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)

    def place(name: str) -> Path:
        letters = (letter if letter.isalnum() else "-" for letter in name)
        return asked.output / f"{''.join(letters)}.json"

    for name in asked.cases or CASES:
        if not place(name).exists():
            result = solve(name, CASES[name])
            place(name).write_text(json.dumps(result))
    results = {n: json.loads(place(n).read_text()) for n in CASES if place(n).exists()}
    print(table(results))
    draw(results, asked.output / "drum-sensitivity.png")


if __name__ == "__main__":
    main()
