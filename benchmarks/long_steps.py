"""What an error costs: `semi-lagrangian` against `finite-volume` on the paper's drum.

Three revolutions (flow mohr-coulomb, k1 = 0.04 and 0.005) on meshes from 12,500 to 50,000 active
cells, both methods in one run, in turns, on one core. Cost: core seconds of the mixing, set-up
included. Errors against `semi-lagrangian` on 200,000 cells: greatest distance of the curves of I;
and the mean of |c - c_ref| over the bed after the last revolution, with contents summed over
squares of 1 mm, over the mean of c. Then the cost of both for 1, 3 and 10 revolutions.

    python benchmarks/long_steps.py [--output DIR] [--revolutions X] [--reference CELLS]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from scaleup.flow import storage
from scaleup.system import parallel

METHODS = ("semi-lagrangian", "finite-volume")
OPTIONS = {"semi-lagrangian": ["mixing.deformation=4"], "finite-volume": []}
CELLS = (12_500, 25_000, 50_000)
K1 = (0.04, 0.005)
SQUARE = 1e-3  # m
REACH = 0.08  # m: squares cover this around the axis, more than the drum's radius and a cell


@dataclass
class Run:
    intensity: list[float]
    content: np.ndarray  # m^2 of component 1 in squares
    seconds: float
    steps: int
    drift: float
    bounds: tuple[float, float]
    active: int


def overlaps(lower: float, spacing: float, count: int, low: float, squares: int) -> csr_matrix:
    """Share of each cell (columns) along an axis that lies in each square (rows)."""
    edges = (lower + spacing * np.arange(count + 1) - low) / SQUARE
    rows, columns, shares = [], [], []
    for n in range(count):
        for row in range(int(np.floor(edges[n])), int(np.floor(edges[n + 1] - 1e-12)) + 1):
            share = min(edges[n + 1], row + 1) - max(edges[n], row)
            rows.append(row)
            columns.append(n)
            shares.append(share * SQUARE / spacing)
    return csr_matrix((shares, (rows, columns)), shape=(squares, count))


def run(comm: Any, method: str, k1: float, cells: int, revolutions: float) -> Run:
    from scaleup.case.composing import compose
    from scaleup.flow.source import obtain_flow
    from scaleup.run.blending import mix

    asked = [
        f"mixing.name={method}", *OPTIONS[method], f"diffusion.k1={k1}", f"grid.cells={cells}",
        f"operation.revolutions={revolutions}",
    ]  # fmt: skip
    case = compose(None, asked, {"flow": {"name": "mohr-coulomb"}})
    flow = obtain_flow(case, comm).flow
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / "checkpoint.h5"
        began = time.process_time()
        blend = mix(case, flow, comm, checkpoint=kept)
        seconds = time.process_time() - began
        concentration = storage.read_checkpoint(kept)[0]["concentration"][0]
    grid, interval = flow.grid, flow.intervals[-1]
    dense = np.zeros(grid.cells)
    dense[interval.cells] = concentration * interval.fill_start
    squares = round(2 * REACH / SQUARE)
    along = [
        overlaps(grid.lower[a], grid.spacing[a], grid.counts[a], -REACH, squares) for a in (0, 1)
    ]
    content = along[1] @ dense.reshape(grid.shape) @ along[0].T
    return Run(
        blend.intensity, np.asarray(content), seconds, blend.ledger.steps, blend.mass_drift,
        (blend.ledger.minimum, blend.ledger.maximum), len(interval.cells),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("runs/long-steps"))
    parser.add_argument("--revolutions", type=float, default=3.0)
    parser.add_argument("--reference", type=int, default=200_000)
    options = parser.parse_args()
    comm = parallel.start()
    options.output.mkdir(parents=True, exist_ok=True)
    for method in METHODS:  # compiles
        run(comm, method, K1[0], 3000, 0.1)
    rows = []
    for k1 in K1:
        best = run(comm, "semi-lagrangian", k1, options.reference, options.revolutions)
        print(f"reference, k1 = {k1}: {best.active:,} cells, {best.seconds:.0f} s", flush=True)
        for cells in CELLS:
            for method in METHODS:
                found = run(comm, method, k1, cells, options.revolutions)
                curve = np.abs(np.array(found.intensity) - best.intensity).max()
                apart = np.abs(found.content - best.content).sum() / best.content.sum()
                rows.append(
                    {
                        "k1": k1, "method": method, "active": found.active, "of_I": curve,
                        "of_field": apart, "seconds": found.seconds, "steps": found.steps,
                        "drift": found.drift, "low": found.bounds[0], "high": found.bounds[1],
                    }
                )  # fmt: skip
                print(
                    f"| {k1} | {method} | {found.active:,} | {curve:.4f} | {apart:.4f} | "
                    f"{found.seconds:.1f} | {found.steps:,} | {found.drift:.0e} | "
                    f"{found.bounds[0]:.0e} .. 1 + {found.bounds[1] - 1:.0e} |",
                    flush=True,
                )
    for revolutions in (1, 3, 10):
        cost = [run(comm, m, 0.005, 25_000, revolutions).seconds for m in METHODS]
        rows.append({"revolutions": revolutions, **dict(zip(METHODS, cost, strict=True))})
        print(
            f"{revolutions} revolutions, 25,000 cells, k1 = 0.005: {cost[0]:.1f}, {cost[1]:.1f} s"
        )
    (options.output / "results.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
