"""Two ranks against one, alone and beside a process that never waits; prints a Markdown table.

Each mixing backend blends the paper's drum on the same stored flow. Its four runs (one rank and
two, alone and busy) follow each other, three times over, so that what else the machine does falls
on all of them; ratios are the medians of the rounds. `--measure BACKEND` is what a rank runs.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from on_ranks import on_ranks

REVOLUTIONS = {  # five to ten seconds on one core
    "finite-volume": 0.6,
    "lax-wendroff": 6.0,
    "semi-lagrangian": 1.0,
    "implicit-fem": 0.08,
}
CELLS = 20_000
ROUNDS = 3


def measure(backend: str) -> None:
    """Print the seconds of the mixing alone, after a first step or two that compile it."""
    from scaleup.case.composing import compose
    from scaleup.system import parallel

    comm = parallel.start()
    from scaleup.flow.source import obtain_flow
    from scaleup.run.blending import mix

    settings = [f"mixing.name={backend}", f"grid.cells={CELLS}", "output.metrics_every=1"]

    def case(revolutions: float):  # type: ignore[no-untyped-def]
        chosen = [*settings, f"operation.revolutions={revolutions}"]
        return compose(None, chosen, {"flow": {"name": "surface-layer"}})

    flow = obtain_flow(case(1.0), comm).flow
    start_up = flow.lift / 6.28
    mix(case(start_up + 0.01), flow, comm)
    blend = mix(case(start_up + REVOLUTIONS[backend]), flow, comm)
    if comm.rank == 0:
        print(json.dumps({"seconds": blend.seconds, "steps": blend.ledger.steps}))


@contextmanager
def busy() -> Iterator[None]:
    """One process that never waits, bound to no core."""
    spinning = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        spinning.kill()
        spinning.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--measure")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("backends", nargs="*")
    asked = parser.parse_args()
    if asked.measure:
        measure(asked.measure)
        return
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before; {CELLS:,} cells\n")
    heads = ("backend", "one rank, s", "two over one", "one, busy, s", "two over one, busy")
    print(f"| {' | '.join(heads)} |")
    print("|---|---|---|---|---|")
    for backend in asked.backends or REVOLUTIONS:
        times: dict[tuple[int, bool], list[float]] = {}
        for _ in range(asked.rounds):
            for ranks in (1, 2):
                times.setdefault((ranks, False), []).append(seconds(backend, ranks))
            with busy():
                for ranks in (1, 2):
                    times.setdefault((ranks, True), []).append(seconds(backend, ranks))
        columns = []
        for beside in (False, True):
            one, two = times[1, beside], times[2, beside]
            ratio = statistics.median(b / a for a, b in zip(one, two, strict=True))
            columns += [f"{statistics.median(one):.2f}", f"{ratio:.2f}"]
        print(f"| {backend} | {' | '.join(columns)} |", flush=True)


def seconds(backend: str, ranks: int) -> float:
    """Of the mixing."""
    return float(on_ranks(__file__, backend, ranks)["seconds"])


if __name__ == "__main__":
    main()
