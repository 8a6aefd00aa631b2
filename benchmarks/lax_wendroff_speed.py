"""Speed of the Lax-Wendroff kernel against this machine's memory bandwidth, and of two ranks.

For the paper's drum and for a bed beyond the cache: cell updates per second, the bytes that a step
must move (eight weights and c read, c written with its write-allocate: 88 bytes a cell) over the
bandwidth of a triad a = b + s c (32 bytes an element) measured in the same run. Then the whole
mixing on one and on two ranks, in turn, three pairs.
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

from scaleup_lax_wendroff import stencil

BYTES_PER_CELL = 8 * (8 + 3)

BLEND = """
import sys
from scaleup import parallel
from scaleup.config import compose
comm = parallel.start()
from scaleup.blending import mix
from scaleup.flow_source import obtain_flow
config = compose(None, sys.argv[1:], {"flow": {"name": "surface-layer"}})
flow = obtain_flow(config, comm).flow
mix(config, flow, comm)
blend = mix(config, flow, comm)
if comm.rank == 0:
    print(blend.seconds, blend.ledger.cell_updates / blend.seconds)
"""


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


def kernel(rows: int, columns: int) -> tuple[float, float, float]:
    """(cells, seconds a step, bandwidth of a triad whose arrays fill as much memory, B/s)."""
    width = columns + 4
    c = np.random.default_rng(0).random((rows + 4) * width)
    new = np.zeros_like(c)
    weights = np.full((8, c.size), 0.05)
    runs = np.array([[(r + 2) * width + 2, (r + 2) * width + 2 + columns] for r in range(rows)])
    repeats = max(1, 20_000_000 // (rows * columns))
    seconds = best(lambda: stencil.step(c, new, weights, runs, width), repeats)
    elements = rows * columns * BYTES_PER_CELL // 24
    a, b, d = np.zeros(elements), np.ones(elements), np.ones(elements)
    bandwidth = 32 * elements / best(lambda: triad(a, b, d), max(1, repeats // 4))
    return rows * columns, seconds, bandwidth


def on_ranks(ranks: int, arguments: list[str]) -> tuple[float, float]:
    with tempfile.NamedTemporaryFile("w", suffix=".py") as file:
        file.write(BLEND)
        file.flush()
        command = [sys.executable, "-m", "mpi4py", file.name, *arguments]
        launcher = ["mpiexec", "--bind-to", "none", "--oversubscribe", "-n", str(ranks)]
        root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
        done = subprocess.run(
            [*launcher, *command], capture_output=True, text=True, check=True, env=os.environ | root
        )
    seconds, rate = map(float, done.stdout.split()[-2:])
    return seconds, rate


def main() -> None:
    print("kernel, one core        cells   Mcells/s   ns/cell   share of triad bandwidth")
    for name, rows, columns in (("paper's drum", 160, 338), ("beyond cache", 4000, 4000)):
        cells, seconds, bandwidth = kernel(rows, columns)
        share = cells * BYTES_PER_CELL / seconds / bandwidth
        print(
            f"{name:18s} {cells:10d} {cells / seconds / 1e6:10.0f} {1e9 * seconds / cells:9.2f} "
            f"{share:12.2f}  (triad {bandwidth / 1e9:.1f} GB/s)"
        )
    for name, arguments in (
        ("paper's drum, 3 revolutions", []),
        ("0.1 mm cells, 0.1 revolutions", ["grid.spacing='0.1 mm'", "operation.revolutions=0.1"]),
    ):
        pairs = [(on_ranks(1, arguments), on_ranks(2, arguments)) for _ in range(3)]
        ratio = statistics.median(one[0] / two[0] for one, two in pairs)
        one, two = (statistics.median(p[i][0] for p in pairs) for i in (0, 1))
        print(f"{name}: 1 rank {one:.2f} s, 2 ranks {two:.2f} s, ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
