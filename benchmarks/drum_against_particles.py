"""The paper's drum with 2 mm grains, by each rheology, beside a particle simulation of it.

Surface angle and shape, active layer, surface speed and the streamwise velocity at mid-bed, for the
three rheologies with the non-local length of the grains (1.45 mm, elements of 2.9 mm: defaults),
mu(I) with all constants of glass beads from the literature, and constant friction with finer
elements, half and twice the non-local length, and other predictor lengths. Nothing is fitted.
Results are kept in a JSON file, so that the study goes on where it stopped; one solve takes about a
minute.

    python benchmarks/drum_against_particles.py --reference reference.json [--output DIR] [CASE ...]

The reference holds, under "run_B": "midbed_profile" with "depth_m" and "v_streamwise_m_per_s", and
"surface" with "dynamic_angle_of_repose_deg", "x_m", "y_m" and "angle_vs_time" with "time_s" and
"angle_deg".
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from scaleup.case.composing import compose
from scaleup.contract import Scene
from scaleup.flow.storage import Store
from scaleup_mohr_coulomb.mid_bed import mid_bed, surface_speed
from scaleup_mohr_coulomb.solve import steady_bed

BASE = ("material.grain_diameter=2 mm",)
CASES = {
    "mohr-coulomb": (),
    "mohr-coulomb, h = 2 mm": ("flow.fine_size=2 mm",),
    "mohr-coulomb, h = 1.5 mm": ("flow.fine_size=1.46 mm",),
    "mu-i": ("flow.rheology=mu-i",),
    "mu-i, glass beads": ("flow.rheology=mu-i", "material.friction_angle=20.9 deg"),
    "regularised-mu-i": ("flow.rheology=regularised-mu-i",),
    "l x 1/2": ("flow.nonlocal_length=0.726 mm",),
    "l x 2": ("flow.nonlocal_length=2.904 mm",),
    "predictor x 0.7": ("flow.predictor_length=5 mm",),
    "predictor x 1.4": ("flow.predictor_length=10 mm",),
}
COMPARED = (1e-3, 12e-3)  # m of depth


def solve(name: str, changes: tuple[str, ...]) -> dict[str, Any]:
    case = compose(None, [*BASE, *changes])
    scene = Scene(
        geometry=case.geometry,
        material=case.material,
        speed=case.operation.speed,
        fill_volume=case.fill_volume,
        grid=case.grid,
        inputs={"study": "drum against particles", "case": name},
    )
    flow = case.flow
    memory = Store().memory_of(type(flow), type(scene.geometry))
    bed = steady_bed(scene, flow.options, lambda share, text: print(f"{name}: {text}"), memory)
    middle = mid_bed(bed)
    start, end = bed.level_set.contour()
    return {
        "angle_deg": float(np.degrees(bed.angle)),
        "angle_error_deg": float(np.degrees(bed.angle_error)),
        "velocity_error": bed.velocity_error,
        "layer_m": middle.reversal_depth,
        "surface_speed": float(surface_speed(bed)[1].max()),
        "flux_balance": middle.downflow / middle.upflow,
        "volume": bed.area_correction,
        "rotation": middle.rotation_ratio,
        "seconds": bed.seconds,
        "surface": (0.5 * (start + end)).tolist(),
        "depth": middle.depth.tolist(),
        "speed": middle.speed.tolist(),
        "times": bed.times.tolist(),
        "angles_deg": np.degrees(bed.angles).tolist(),
    }


def profile_error(result: dict[str, Any], reference: dict[str, Any]) -> float:
    """Root mean square difference over the compared depths, over the reference's range there."""
    profile = reference["midbed_profile"]
    depth, speed = np.array(profile["depth_m"]), np.array(profile["v_streamwise_m_per_s"])
    there = (depth > COMPARED[0]) & (depth < COMPARED[1])
    order = np.argsort(result["depth"])
    ours = np.interp(
        depth[there], np.array(result["depth"])[order], np.array(result["speed"])[order]
    )
    return float(np.sqrt(((ours - speed[there]) ** 2).mean()) / np.ptp(speed[there]))


def levelled(points: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Position along a surface turned level by its ``angle`` (rad), ascending, and height, m."""
    along, up = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ points
    order = np.argsort(along)
    return along[order], up[order]


def shape_errors(result: dict[str, Any], reference: dict[str, Any]) -> tuple[float, float]:
    """Greatest and root mean square distance of the surfaces, each turned level, m."""
    surface = reference["surface"]
    theirs = levelled(
        np.array([surface["x_m"], surface["y_m"]]),
        np.radians(surface["dynamic_angle_of_repose_deg"]),
    )
    ours = levelled(np.array(result["surface"]).T, np.radians(result["angle_deg"]))
    gap = np.interp(theirs[0], *ours) - theirs[1]
    return float(np.abs(gap).max()), float(np.sqrt((gap**2).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--reference", type=Path, required=True)
    parser.add_argument("--output", type=Path, default=Path("runs/drum-against-particles"))
    parser.add_argument("cases", nargs="*", default=list(CASES))
    asked = parser.parse_args()
    reference = json.loads(asked.reference.read_text())["run_B"]
    asked.output.mkdir(parents=True, exist_ok=True)
    store = asked.output / "results.json"
    results = json.loads(store.read_text()) if store.exists() else {}
    for name in asked.cases:
        if name not in results:
            results[name] = solve(name, CASES[name])
            store.write_text(json.dumps(results))
    print(
        "| case | angle, deg | layer, mm | surface speed, m/s | profile rms | shape: most, rms, mm "
        "| down/up | bed/wall | first peak, trough, deg | volume | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    figure, (profiles, angles) = plt.subplots(1, 2, figsize=(10, 4))
    for name, result in results.items():
        most, rms = shape_errors(result, reference)
        early = np.array(result["angles_deg"])[np.array(result["times"]) < 2.0]
        peak = int(early.argmax())
        print(
            f"| {name} | {result['angle_deg']:.2f} +- {result['angle_error_deg']:.2f} "
            f"| {1e3 * result['layer_m']:.1f} | {result['surface_speed']:.3f} "
            f"| {100 * profile_error(result, reference):.1f} % | {1e3 * most:.1f}, {1e3 * rms:.1f} "
            f"| {result['flux_balance']:.3f} | {result['rotation']:.3f} "
            f"| {early[peak]:.1f}, {early[peak:].min():.1f} "
            f"| {100 * result['volume']:.4f} % | {result['seconds']:.0f} |"
        )
        profiles.plot(1e3 * np.array(result["depth"]), result["speed"], label=name)
        angles.plot(result["times"], result["angles_deg"], label=name)
    particles, history = reference["midbed_profile"], reference["surface"]["angle_vs_time"]
    depth = 1e3 * np.array(particles["depth_m"])
    profiles.plot(depth, particles["v_streamwise_m_per_s"], "k.", label="particles")
    angles.plot(history["time_s"], history["angle_deg"], "k.", label="particles")
    profiles.set(xlim=(0, 30), xlabel="depth at mid-bed, mm", ylabel="streamwise speed, m/s")
    angles.set(xlim=(0.4, 5), ylim=(15, 35), xlabel="time, s", ylabel="surface angle, deg")
    profiles.legend(fontsize="small")
    for axes in (profiles, angles):
        axes.locator_params(axis="x", nbins=6)
    figure.tight_layout(w_pad=3)
    figure.savefig(asked.output / "drum-against-particles.png", dpi=120)


if __name__ == "__main__":
    main()
