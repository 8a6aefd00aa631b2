"""How fine a mesh the paper's drum needs: its Fig. 17 redone for form "paper" and for the default.

Segregation intensity against revolutions on the paper's drum (flow mohr-coulomb, k1 = 0.04 and
0.005), on meshes from 25,000 to 800,000 active bed cells, for `lax-wendroff` form "paper" with the
paper's diffusion (Eq. 6), the same with form "corrected", and `finite-volume`, both with the
objective tensor. The error of a curve is its greatest distance from that of the same physics on
the finest mesh. Results are kept in a JSON file per k1, so that the study goes on where it stopped
and both values of k1 can run side by side.

    python benchmarks/mesh_study.py [--output DIR] [--revolutions X] [--finest CELLS] [--k1 K1]
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

from scaleup.system import parallel

CELLS = (25_000, 50_000, 100_000, 200_000, 400_000, 800_000)
K1 = (0.04, 0.005)
METHODS = {
    "paper": ["mixing.name=lax-wendroff", "mixing.form=paper", "diffusion.model=paper"],
    "corrected": ["mixing.name=lax-wendroff", "mixing.form=corrected"],
    "finite-volume": ["mixing.name=finite-volume"],
}
PAPER_CELLS = {0.04: 74_000, 0.005: 147_000}
"""the paper's 300,000 and 600,000 elements of the square, as cells of the bed"""


def run(comm: Any, method: str, k1: float, cells: int, revolutions: float) -> dict[str, Any]:
    from scaleup.case.composing import compose
    from scaleup.flow.source import obtain_flow
    from scaleup.run.blending import mix

    asked = [f"grid.cells={cells}", f"diffusion.k1={k1}", f"operation.revolutions={revolutions}"]
    case = compose(None, [*METHODS[method], *asked], {"flow": {"name": "mohr-coulomb"}})
    flow = obtain_flow(case, comm).flow
    blend = mix(case, flow, comm)
    return {
        "active": len(flow.intervals[0].cells),
        "revolutions": blend.revolutions,
        "intensity": blend.intensity,
        "seconds": blend.seconds,
        "ranks": comm.size,
        "steps": blend.ledger.steps,
        "minimum": blend.ledger.minimum,
        "maximum": blend.ledger.maximum,
        "mass_drift": blend.mass_drift,
    }


def errors(results: dict[str, Any], method: str, k1: float) -> dict[int, float]:
    """Greatest distance of each mesh's curve from the reference of the same physics.

    The reference is the finest curve of the method itself for "paper" (its Eq. 6 is other physics),
    that of `finite-volume` for the others.
    """
    own = "paper" if method == "paper" else "finite-volume"
    known = {c: results[key] for c in CELLS if (key := f"{own} {k1} {c}") in results}
    if not known:
        return {}
    finest = known[max(known)]["intensity"]
    found = {}
    for cells in CELLS:
        curve = results.get(f"{method} {k1} {cells}")
        if curve is not None and not (own == method and cells == max(known)):
            found[cells] = float(np.abs(np.array(curve["intensity"]) - finest).max())
    return found


def draw(results: dict[str, Any], path: Path) -> None:
    figure, axes = plt.subplots(len(K1), 3, figsize=(12, 7), layout="constrained", squeeze=False)
    for row, k1 in zip(axes, K1, strict=True):
        for axis, method in zip(row, ("paper", "finite-volume"), strict=False):
            for cells in CELLS:
                curve = results.get(f"{method} {k1} {cells}")
                if curve is not None:
                    label = f"{curve['active']:,}"
                    axis.plot(curve["revolutions"], curve["intensity"], label=label, lw=1.2)
            axis.set_title(f"{method}, k1 = {k1}", fontsize=10)
            axis.set_xlabel("revolutions")
            axis.set_ylabel("segregation intensity")
            axis.legend(title="active bed cells", fontsize=7, title_fontsize=7)
        for method in METHODS:
            found = errors(results, method, k1)
            if found:
                row[2].loglog(list(found), list(found.values()), "o-", label=method, ms=4)
        row[2].axvline(PAPER_CELLS[k1], color="grey", lw=0.8, ls=":")
        row[2].text(PAPER_CELLS[k1], row[2].get_ylim()[0], " the paper's mesh", fontsize=7)
        row[2].set_xlabel("active bed cells asked for")
        row[2].set_ylabel("greatest error of I")
        row[2].legend(fontsize=7)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def table(results: dict[str, Any]) -> str:
    lines = ["| k1 | method | active cells | greatest error of I | steps | seconds | bounds |"]
    lines.append("|---|---|---|---|---|---|---|")
    for k1 in K1:
        for method in METHODS:
            found = errors(results, method, k1)
            for cells in CELLS:
                curve = results.get(f"{method} {k1} {cells}")
                if curve is None:
                    continue
                error = f"{found[cells]:.4f}" if cells in found else "reference"
                lines.append(
                    f"| {k1} | {method} | {curve['active']:,} | {error} | {curve['steps']:,} | "
                    f"{curve['seconds']:.1f} | {curve['minimum']:.2g} .. {curve['maximum']:.4g} |"
                )
    return "\n".join(lines)


def known_results(folder: Path) -> dict[str, Any]:
    results: dict[str, Any] = {}
    for kept in sorted(folder.glob("results-*.json")):
        results |= json.loads(kept.read_text())
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/mesh-study"))
    parser.add_argument("--revolutions", type=float, default=3.0)
    parser.add_argument("--finest", type=int, default=CELLS[-1], help="for finite-volume")
    parser.add_argument("--k1", type=float, choices=K1, help="one value alone")
    asked = parser.parse_args()
    comm = parallel.start()
    asked.output.mkdir(parents=True, exist_ok=True)
    results = known_results(asked.output)
    for cells in CELLS:
        for k1 in K1 if asked.k1 is None else (asked.k1,):
            kept = asked.output / f"results-{k1}.json"
            for method in METHODS:
                key = f"{method} {k1} {cells}"
                if key in results or (method == "finite-volume" and cells > asked.finest):
                    continue
                results[key] = run(comm, method, k1, cells, asked.revolutions)
                if comm.rank == 0:
                    print(key, f"{results[key]['seconds']:.1f} s", flush=True)
                    own = {k: v for k, v in results.items() if k.split()[1] == str(k1)}
                    kept.write_text(json.dumps(own))
                    results = known_results(asked.output)
                    draw(results, asked.output / "mesh_study.png")
                    (asked.output / "table.md").write_text(table(results) + "\n")


if __name__ == "__main__":
    main()
