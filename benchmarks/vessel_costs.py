"""What a 3-D vessel costs, from 10^5 cells up, on one and two ranks: time and memory.

`surface-layer` and `semi-lagrangian` on the V-blender. Parted into the flow, the intervals of the
start-up and the first revolution (whose paths are searched for) and those that come back; cost is
core seconds per 10^6 cells and revolution. 10^9 cells on 256 ranks are extrapolated from the
finest mesh and the power of the cells that the meshes show (at least 1), as if all of it scaled
with the ranks, which it does not: moving cells and settling are the same on every rank. Beyond
2 10^6 cells only the beginning of a revolution is run, with few carriages kept, so that it fits
into 23 GB.

    python benchmarks/vessel_costs.py [--output DIR] [--cells N ...] [--ranks R ...]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from on_ranks import on_ranks

CELLS = (100_000, 300_000, 1_000_000)
RANKS = (1, 2)
PREFIX = 0.25  # revolutions before the flow repeats
BUILT = 1.0 + PREFIX
LAST = BUILT + 0.5
BIG, BIG_REVOLUTIONS, BIG_STEP, BIG_MEMORY = 2_000_000, 0.15, 0.05, 0.25  # cells, rev, rev, GB
PARTS = {"flow": "flow, once", "built": "mixing, first time round", "kept": "mixing, again"}


def measure(cells: int) -> dict[str, Any] | None:
    """On the ranks that call it: seconds, peak memory of all ranks in bytes. None but on root."""
    from scaleup.case.composing import compose
    from scaleup.flow.source import obtain_flow
    from scaleup.run.blending import mix
    from scaleup.run.costs import peak_memory
    from scaleup.system import parallel

    comm = parallel.start()
    big = cells > BIG
    revolutions, every = (BIG_REVOLUTIONS, BIG_STEP) if big else (LAST, 0.125)
    asked = [f"grid.cells={cells}", f"operation.revolutions={revolutions}"]
    asked += [f"output.metrics_every={every}", "flow.intervals=120"]
    asked += [f"mixing.memory={BIG_MEMORY}"] if big else []
    case = compose(None, ["geometry.name=v-blender", *asked])
    began = time.monotonic()
    flow = obtain_flow(case, comm).flow
    flow_seconds = time.monotonic() - began
    blend = mix(case, flow, comm)
    memory = comm.reduce(peak_memory())
    if comm.rank:
        return None
    at = dict(zip(blend.revolutions, blend.elapsed, strict=True))
    first = blend.elapsed[0]
    if big:
        built, kept = (blend.elapsed[-1] - blend.elapsed[-2]) / BIG_STEP, None
    else:
        built, kept = (at[BUILT] - first) / BUILT, (at[LAST] - at[BUILT]) / (LAST - BUILT)
    return {
        "ranks": comm.size,
        "cells": len(flow.intervals[0].cells),
        "intervals": len(flow.intervals) - flow.prefix,
        "flow": flow_seconds,
        "built": built,
        "kept": kept,
        "memory": memory,
    }


def run(cells: int, ranks: int) -> dict[str, Any]:
    """In processes of their own, with an empty store."""
    with tempfile.TemporaryDirectory() as store:
        return on_ranks(__file__, cells, ranks, SCALEUP_CACHE=store)


def table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| active cells | ranks | flow, s | first revolution, s | later ones, s "
        "| core s per 10^6 cells: first | later | memory, kB per cell |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        each = r["ranks"] * 1e6 / r["cells"]
        kept = ("", "") if r["kept"] is None else (f"{r['kept']:.1f}", f"{r['kept'] * each:.0f}")
        lines.append(
            f"| {r['cells']:,} | {r['ranks']} | {r['flow']:.0f} | {r['built']:.0f} "
            f"| {kept[0]} | {r['built'] * each:.0f} | {kept[1]} "
            f"| {r['memory'] / r['cells'] / 1e3:.1f} |"
        )
    return "\n".join(lines)


def extrapolation(rows: list[dict[str, Any]], cells: float = 1e9, ranks: int = 256) -> str:
    """From the finest mesh of the most ranks by the fitted power of the cells, if ranks scaled."""
    most = max(r["ranks"] for r in rows)
    of_most = [r for r in rows if r["ranks"] == most and r["kept"] is not None]
    finest = max(of_most, key=lambda r: r["cells"])
    lines = []
    for part, label in PARTS.items():
        n = np.log([r["cells"] for r in of_most])
        power = max(1.0, float(np.polyfit(n, np.log([r[part] for r in of_most]), 1)[0]))
        seconds = finest[part] * (cells / finest["cells"]) ** power * most / ranks
        lines.append(f"{label}: cells^{power:.2f}, {seconds:,.0f} s on {cells:.0e} cells")
    memory = finest["memory"] / finest["cells"] * cells
    return "\n".join(
        [*lines, f"memory: {memory / 1e12:.1f} TB, {memory / ranks / 1e9:.0f} GB a rank"]
    )


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    figure, (cost, memory) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    styles = {1: ":", 2: "-", 4: "--"}
    for number, (part, label) in enumerate(PARTS.items()):
        for ranks in sorted({r["ranks"] for r in rows}):
            measured = [r for r in rows if r["ranks"] == ranks and r[part] is not None]
            chosen = sorted(measured, key=lambda r: r["cells"])
            cost.loglog(
                [r["cells"] for r in chosen],
                [r[part] for r in chosen],
                styles.get(ranks, "-."),
                color=f"C{number}",
                marker="o",
                ms=4,
                label=f"{label}, {ranks} rank" + "s" * (ranks > 1),
            )
    for ranks in sorted({r["ranks"] for r in rows}):
        chosen = sorted((r for r in rows if r["ranks"] == ranks), key=lambda r: r["cells"])
        cells = [r["cells"] for r in chosen]
        held = [r["memory"] / r["cells"] / 1e3 for r in chosen]
        memory.semilogx(cells, held, styles.get(ranks, "-."), color="k", marker="o", ms=4,
                        label=f"{ranks} rank" + "s" * (ranks > 1))  # fmt: skip
    cost.set(xlabel="active cells", ylabel="s (mixing: per revolution)", title="V-blender, time")
    memory.set(xlabel="active cells", ylabel="kB per cell, all ranks", title="memory at the peak")
    memory.set_ylim(bottom=0)
    for axes in (cost, memory):
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(fontsize=7, frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("docs/figures"))
    parser.add_argument("--cells", type=int, nargs="+", default=list(CELLS))
    parser.add_argument("--ranks", type=int, nargs="+", default=list(RANKS))
    parser.add_argument("--known", type=Path, help="JSON lines of runs; new ones are added")
    parser.add_argument("--measure", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        row = measure(arguments.measure)
        if row is not None:
            print(json.dumps(row))
        return
    known: Path | None = arguments.known
    rows = []
    if known and known.exists():
        rows = [json.loads(line) for line in known.read_text().splitlines()]
    for cells in arguments.cells:
        for ranks in arguments.ranks:
            rows.append(run(cells, ranks))
            print(rows[-1], flush=True)
            if known:
                with known.open("a") as stream:
                    stream.write(json.dumps(rows[-1]) + "\n")
    rows.sort(key=lambda r: (r["ranks"], r["cells"]))
    print(table(rows))
    print(extrapolation(rows))
    draw(rows, arguments.output / "vessel-costs.png")


if __name__ == "__main__":
    main()
