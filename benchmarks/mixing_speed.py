"""Speed of mixing: kernels against memory bandwidth, methods against each other, and ranks.

1. The Lax-Wendroff kernel on one core: cell updates per second, and the bytes that a step must move
   (all weights and c read, c written with its write-allocate) over the bandwidth of a triad
   a = b + s c (32 bytes an element) measured in the same run on arrays of the same total size.
2. Cost per cell and step of every method, relative to Lax-Wendroff, on the paper's drum.
3. The whole mixing on one and on two ranks, in turn, three pairs, on the paper's drum and on a
   rotation in 3-D; and two independent runs side by side against one alone, which bounds what two
   ranks can reach on this machine.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numba
import numpy as np

from scaleup.numerics import BRIDGE, runs_of
from scaleup_lax_wendroff import stencil

DRUM = """
import sys
from scaleup.system import parallel
from scaleup.case.composing import compose
comm = parallel.start()
from scaleup.run.blending import mix
from scaleup.flow.source import obtain_flow
case = compose(None, sys.argv[1:], {"flow": {"name": "surface-layer"}})
flow = obtain_flow(case, comm).flow
mix(case.changed(operation={"revolutions": 0.3}), flow, comm)
blend = mix(case, flow, comm)
if comm.rank == 0:
    print(blend.seconds, 1e9 * blend.seconds / blend.ledger.cell_updates)
"""

BALL = """
import sys
from scaleup.system import parallel, registry
comm = parallel.start()
from scaleup.verification import problems, run
plugin = registry.load("mixing", sys.argv[1])
result = run(problems()["gaussian-3d"], plugin(plugin.Options()), int(sys.argv[2]), comm)
if comm.rank == 0:
    print(result.seconds, 1e9 * result.seconds / result.cell_updates)
"""

LAX_WENDROFF = ["mixing.name=lax-wendroff"]
FINITE_VOLUME = ["mixing.name=finite-volume", "operation.revolutions=0.5"]


@numba.njit(cache=True)
def triad(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    for i in range(a.shape[0]):
        a[i] = b[i] + 3.0 * c[i]


def best(work: Callable[[], None], repeats: int) -> float:
    work()
    times = []
    for _ in range(7):
        began = time.perf_counter()
        for _ in range(repeats):
            work()
        times.append((time.perf_counter() - began) / repeats)
    return min(times)


def kernel(shape: tuple[int, ...]) -> tuple[int, float, float]:
    """(cells, seconds a step, share of the bandwidth of a triad on as much memory)."""
    padded = np.ones([n + 2 for n in shape])
    neighbours = np.array(stencil.neighbours(len(shape)))
    strides = np.array(padded.strides)[::-1] // 8
    c = np.random.default_rng(0).random(padded.size)
    new = np.zeros_like(c)
    weights = np.full((len(neighbours), c.size), 0.05 / len(neighbours))
    inside = np.pad(np.ones(shape, dtype=bool), 1).ravel()
    runs = runs_of(np.flatnonzero(inside), BRIDGE)
    cells = int(inside.sum())
    bytes_per_cell = 8 * (len(neighbours) + 3)
    repeats = max(1, 20_000_000 // cells)
    offsets = neighbours @ strides
    seconds = best(lambda: stencil.step(c, new, weights, runs, offsets), repeats)
    elements = cells * bytes_per_cell // 24
    a, b, d = np.zeros(elements), np.ones(elements), np.ones(elements)
    bandwidth = 32 * elements / best(lambda: triad(a, b, d), max(1, repeats // 4))
    return cells, seconds, cells * bytes_per_cell / seconds / bandwidth


def start(program: str, ranks: int, arguments: list[str]) -> subprocess.Popen[str]:
    file = tempfile.NamedTemporaryFile("w", suffix=".py", delete=False)  # noqa: SIM115
    file.write(program)
    file.close()
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return subprocess.Popen(
        ["mpiexec", "--bind-to", "none", "--oversubscribe", "-n", str(ranks), sys.executable,
         "-m", "mpi4py", file.name, *arguments],
        stdout=subprocess.PIPE, text=True, env=os.environ | root,
    )  # fmt: skip


def figures(process: subprocess.Popen[str]) -> tuple[float, float]:
    """(seconds, ns per cell update)."""
    output, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"a benchmark run failed with code {process.returncode}")
    seconds, each = map(float, output.split()[-2:])
    return seconds, each


def main() -> None:
    print("Lax-Wendroff kernel, one core      cells   Mcells/s   ns/cell   share of triad")
    for name, shape in (
        ("paper's drum", (160, 338)),
        ("2-D beyond the cache", (4000, 4000)),
        ("3-D in the cache", (38, 38, 38)),
        ("3-D beyond the cache", (220, 220, 220)),
    ):
        cells, seconds, share = kernel(shape)
        print(
            f"{name:28s} {cells:11,} {cells / seconds / 1e6:10.0f} {1e9 * seconds / cells:9.2f} "
            f"{share:12.2f}"
        )
    print("whole mixing, one core, paper's drum")
    reference = 0.0
    for name, arguments in (
        ("lax-wendroff corrected", LAX_WENDROFF),
        ("lax-wendroff paper", [*LAX_WENDROFF, "mixing.form=paper", "operation.revolutions=1"]),
        (
            "lax-wendroff flux-corrected",
            [*LAX_WENDROFF, "mixing.form=flux-corrected", "operation.revolutions=1"],
        ),
        ("finite-volume", FINITE_VOLUME),
    ):
        _, each = figures(start(DRUM, 1, arguments))
        reference = reference or each
        print(f"{name:28s} {each:6.2f} ns per cell and step, {each / reference:5.1f} x", flush=True)
    for name, program, arguments in (
        ("lax-wendroff, paper's drum", DRUM, LAX_WENDROFF),
        ("finite-volume, paper's drum", DRUM, FINITE_VOLUME),
        ("lax-wendroff, ball of 137,000 cells", BALL, ["lax-wendroff", "64"]),
        ("finite-volume, ball of 137,000 cells", BALL, ["finite-volume", "64"]),
    ):
        ratios, alone = [], []
        for _ in range(3):
            one = figures(start(program, 1, arguments))[0]
            ratios.append(one / figures(start(program, 2, arguments))[0])
            both = [start(program, 1, arguments) for _ in range(2)]
            alone.append(max(figures(process)[0] for process in both) / one)
        print(
            f"{name}: 2 ranks over 1 {statistics.median(ratios):.2f} x; two independent runs at "
            f"once take {statistics.median(alone):.2f} times as long as one, so at most "
            f"{2 / statistics.median(alone):.2f} x is there to have",
            flush=True,
        )


if __name__ == "__main__":
    main()
