"""What a step of `mohr-coulomb` in space costs, by mesh and ranks, and where its time goes.

Half a drum of 140 by 50 mm, by symmetry, at 20 rpm: steps of 10 ms from a level bed turned to near
the friction angle. The first ones, in which iterations are most, are apart from those timed. The
cost of a revolution on 10^7 unknowns and 256 ranks is extrapolated from the finest mesh, its cost
per unknown being taken to grow with the power of the unknowns that the meshes show (at least
none), once as if nothing were lost to more ranks and once as if each doubling of them lost what it
does here. A release of NGSolve that leaves the first rank without elements works on one fewer.

    python benchmarks/steps_in_space.py [--sizes MM ...] [--ranks R ...]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from on_ranks import on_ranks

SIZES = (14.0, 10.0, 7.0)  # mm
RANKS = (1, 2)
RPM = 20.0
TILT = 18.0  # deg
STEP = 0.01  # s
FIRST, TIMED = 12, 6
UNKNOWNS, MOST_RANKS = 1e7, 256
SLOW_RPM, SLOW_STEPS = 6.0, 20.0  # of the revolution extrapolated to; steps in sqrt(R/g)


def measure(size: float) -> dict[str, Any] | None:
    """On the ranks that call it; ``size`` in mm.  None but on the root."""
    from scaleup.case.composing import compose
    from scaleup.contract import GRAVITY
    from scaleup.system import parallel
    from scaleup_mohr_coulomb.block_solver import BlockSolver
    from scaleup_mohr_coulomb.momentum import Momentum
    from scaleup_mohr_coulomb.parameters import Discretisation, Drive, Rheology
    from scaleup_mohr_coulomb.space_exchange import ExchangingTransport
    from scaleup_mohr_coulomb.space_flow import VesselFlow
    from scaleup_mohr_coulomb.space_level_set import SpaceLevelSet
    from scaleup_mohr_coulomb.space_mesh import vessel_mesh
    from scaleup_mohr_coulomb.viscosity import Viscosity

    comm = parallel.start()
    case = compose(None, ["geometry.length='5 cm'"], {"geometry": {"name": "drum"}})
    geometry, volume = case.geometry, case.fill_volume
    speed = RPM * math.pi / 30.0
    numerics = Discretisation.by_rule(
        case.material, Drive(1.0, speed), geometry.reach, 1e-3 * size, 1e-3 * size, STEP
    ).in_space()
    flow = VesselFlow(
        geometry,
        vessel_mesh(geometry.solid, numerics.fine_size, comm, True),
        case.material,
        Rheology(),
        numerics,
        speed,
        GRAVITY,
        volume,
        math.radians(TILT),
        comm,
        True,
    )
    spent: dict[str, float] = {}

    def timed(owner: type, name: str, part: str) -> None:
        original: Callable[..., Any] = getattr(owner, name)

        def watched(*given: Any, **named: Any) -> Any:
            began = time.perf_counter()
            found = original(*given, **named)
            spent[part] = spent.get(part, 0.0) + time.perf_counter() - began
            return found

        setattr(owner, name, watched)

    def steps(count: int) -> tuple[float, float]:
        before, began = flow.iterations, time.perf_counter()
        for _ in range(count):
            flow.step(STEP)
        comm.Barrier()
        return (flow.iterations - before) / count, (time.perf_counter() - began) / count

    first, _ = steps(FIRST)
    timed(Viscosity, "update", "viscosity")
    timed(Momentum, "step", "momentum")
    timed(BlockSolver, "update", "set-up")
    timed(BlockSolver, "solve", "solve")
    timed(ExchangingTransport, "step", "surface")
    timed(SpaceLevelSet, "redistance", "surface")
    timed(SpaceLevelSet, "restore_volume", "surface")
    later, seconds = steps(TIMED)
    unknowns = flow.unknowns
    parts = {name: value / TIMED for name, value in spent.items()}
    assembled = parts["momentum"] - parts["set-up"] - parts["solve"] + parts["viscosity"]
    workers = comm.allreduce(int(flow.mesh.ne > 0))
    if comm.rank:
        return None
    return {
        "size": size,
        "ranks": comm.size,
        "workers": workers,
        "unknowns": unknowns,
        "first": first,
        "later": later,
        "seconds": seconds,
        "assembly": assembled,
        "set-up": parts["set-up"],
        "solve": parts["solve"],
        "surface": parts["surface"],
    }


def table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| elements, mm | unknowns | ranks (workers) | iterations, first steps | then "
        "| s per step | assembly | set-up | solve | surface |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        parts = " | ".join(f"{r[part]:.2f}" for part in ("assembly", "set-up", "solve", "surface"))
        lines.append(
            f"| {r['size']:g} | {r['unknowns']:,} | {r['ranks']} ({r['workers']}) "
            f"| {r['first']:.0f} | {r['later']:.0f} | {r['seconds']:.2f} | {parts} |"
        )
    return "\n".join(lines)


def extrapolation(rows: list[dict[str, Any]], radius: float = 0.07, gravity: float = 9.81) -> str:
    alone = [r for r in rows if r["workers"] == 1]
    finest = max(alone, key=lambda r: r["unknowns"])
    per_unknown = [r["seconds"] / r["unknowns"] for r in alone]
    power = 0.0
    if len(alone) > 1:
        fitted = np.polyfit(np.log([r["unknowns"] for r in alone]), np.log(per_unknown), 1)
        power = max(0.0, float(fitted[0]))
    one = finest["seconds"] * (UNKNOWNS / finest["unknowns"]) ** (1.0 + power)
    step = math.sqrt(radius / gravity) / SLOW_STEPS
    count = 60.0 / SLOW_RPM / step
    found = [
        f"{finest['seconds'] / finest['unknowns']:.2g} s per unknown and step on the finest mesh, "
        f"growing as unknowns^{power:.2f}: {one:.0f} core seconds per step on {UNKNOWNS:.0e}",
    ]
    losses = {"nothing lost": 1.0}
    gains = []
    for r in rows:
        same = [a for a in alone if a["size"] == r["size"]]
        if r["workers"] == 2 and same:
            gains.append(same[0]["seconds"] / r["seconds"] / 2.0)
    if gains:
        kept = float(np.mean(gains))
        losses[f"each doubling keeping {kept:.2f}"] = kept ** math.log2(MOST_RANKS)
    for name, efficiency in losses.items():
        seconds = one / MOST_RANKS / efficiency
        found.append(
            f"{MOST_RANKS} ranks, {name}: {seconds:.1f} s per step, {count:,.0f} steps of a "
            f"revolution at {SLOW_RPM:g} rpm in {count * seconds / 3600.0:.1f} h"
        )
    return "\n".join(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=float, nargs="+", default=list(SIZES), help="mm")
    parser.add_argument("--ranks", type=int, nargs="+", default=list(RANKS))
    parser.add_argument("--measure", type=float, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        row = measure(arguments.measure)
        if row is not None:
            print(json.dumps(row))
        return
    rows = []
    for size in arguments.sizes:
        for ranks in arguments.ranks:
            rows.append(on_ranks(__file__, size, ranks))
            print(rows[-1], flush=True)
    print(table(rows))
    print(extrapolation(rows))


if __name__ == "__main__":
    main()
