"""How long a step may be: error, cost and iterations of `implicit-fem`, against explicit backends.

    python benchmarks/implicit_steps.py [--output PNG]        error over the length of the step
    python benchmarks/implicit_steps.py --iterations          iterations over the number of cells
    mpiexec -n 2 python -m mpi4py benchmarks/implicit_steps.py --seconds     of a step, on ranks

The first turns a Gaussian of 16 cells (one standard deviation) once in a round bed and draws its L1
error over the step, a multiple of the largest at which the explicit upwind scheme is positive.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from scaleup.mixing.scene import mixing_scene
from scaleup.system import registry
from scaleup.verification import problems, run

CELLS_ACROSS = 320  # sigma = 0.05 of the diameter: 16 cells
MULTIPLES = (2, 5, 10, 20, 50, 100)
EXPLICIT = {
    "finite-volume": ("finite-volume", {}),
    "lax-wendroff (flux-corrected)": ("lax-wendroff", {"form": "flux-corrected"}),
}
DIRECT = "-ksp_type preonly -pc_type lu -pc_factor_mat_solver_type umfpack"
SIZES = (256, 512, 1024)
STEPS = 4


def make(name: str, **options: Any) -> Any:
    plugin = registry.load("mixing", name)
    return plugin(plugin.Options(**options))


def errors(path: Path) -> None:
    problem = problems()["gaussian"]
    rows, found = [], []
    for label, (name, options) in EXPLICIT.items():
        rows.append((label, run(problem, make(name, **options), CELLS_ACROSS)))
    for multiple in MULTIPLES:
        options = {"courant": multiple, "petsc_options": DIRECT if multiple > 10 else ""}
        result = run(problem, make("implicit-fem", **options), CELLS_ACROSS)
        rows.append((f"implicit-fem, {multiple}", result))
        found.append(result.l1)
    print("| backend, step | L1 | minimum | maximum | mass drift | steps | seconds |")
    print("|---|---|---|---|---|---|---|")
    for label, r in rows:
        print(
            f"| {label} | {r.l1:.2e} | {r.minimum:.1e} | 1 {r.maximum - 1:+.0e} "
            f"| {r.mass_drift:.0e} | {r.steps:,} | {r.seconds:.1f} |"
        )
    figure, axis = plt.subplots(figsize=(5.5, 3.8), layout="constrained")
    axis.loglog(MULTIPLES, found, "o-", label="implicit-fem")
    for number, (label, result) in enumerate(rows[: len(EXPLICIT)]):
        axis.axhline(result.l1, color=f"C{number + 1}", ls="--", label=label)
    axis.set(xlabel="step over the explicit limit", ylabel="relative L1 error after one turn")
    axis.grid(True, which="both", alpha=0.25)
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def steps(name: str, n: int, comm: Any, **options: Any) -> tuple[int, float, int]:
    """(active cells, seconds, iterations) of a step after the first."""
    problem = problems()[name]
    flow, backend = problem.flow(n), make("implicit-fem", **options)
    backend.start(mixing_scene(backend, flow, comm, problem.laws), problem.initial(flow))
    step = backend.running.bed.explicit_step * backend.options.courant
    backend.advance(0, 0.0, step)
    comm.Barrier()
    began = time.perf_counter()
    ledger = backend.advance(0, step, (1 + STEPS) * step)
    comm.Barrier()
    seconds = time.perf_counter() - began
    return len(flow.intervals[0].cells), seconds / STEPS, ledger.iterations // STEPS


def iterations() -> None:
    print("| problem | cells | iterations per step | of five stages and a bounded solution |")
    print("|---|---|---|---|")
    for n in SIZES:
        cells, seconds, count = steps("zalesak", n, MPI.COMM_SELF)
        print(f"| zalesak | {cells:,} | {count} | {seconds:.2f} s |", flush=True)


def seconds_on_ranks() -> None:
    comm = MPI.COMM_WORLD
    for name, n in (("zalesak", 256), ("sphere-3d", 48)):
        least = np.inf
        for _ in range(3):
            cells, seconds, _ = steps(name, n, comm)
            least = min(least, seconds)
        if comm.rank == 0:
            print(f"{name}, {cells:,} cells, {comm.size} rank(s): {least:.3f} s a step", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/figures/implicit-fem-steps.png"))
    parser.add_argument("--iterations", action="store_true")
    parser.add_argument("--seconds", action="store_true")
    asked = parser.parse_args()
    if asked.iterations:
        iterations()
    elif asked.seconds:
        seconds_on_ranks()
    else:
        errors(asked.output)


if __name__ == "__main__":
    main()
