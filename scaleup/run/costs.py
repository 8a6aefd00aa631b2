"""What runs have cost on this machine, and what a run like them will cost.

Every finished run adds a line to `costs.jsonl` in the store. An estimate scales what runs of the
same flow, mixing and dimension have cost (those of the same geometry, if there are any), from the
one nearest in cells N:

- mixing, per revolution and rank: as N^(1 + 1/dimension), since the stable step is a share of the
  time in which a cell is crossed; less if the runs say so
- flow (on one rank): as N, or the power that the runs say, 0 to 1 + 1/dimension
- memory: a straight line fitted to the peaks of the first rank
"""

from __future__ import annotations

import json
import math
import resource
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scaleup.flow.storage import Store

_APART = 1.5  # factor between cells from which a power of them can be fitted
_BARE = 0.25e9  # bytes that a run takes whatever its cells, where one run is all that is known


@dataclass(frozen=True)
class Cost:
    """What one run has cost.

    cells -- active ones; steps -- of the mixing; flow_s -- None if the flow came from the store
    memory -- bytes, peak of the first rank
    """

    geometry: str
    flow: str
    mixing: str
    dimension: int
    cells: int
    ranks: int
    revolutions: float
    steps: int
    flow_s: float | None
    mixing_s: float
    memory: float


@dataclass(frozen=True)
class Estimate:
    """What a run is expected to cost: s and bytes; None where nothing is known.

    basis -- the runs that it is scaled from; steps -- of the mixing
    """

    flow_s: float | None
    mixing_s: float
    steps: float
    memory: float
    basis: Sequence[Cost]


def peak_memory() -> float:
    """Bytes, of this process so far (Linux counts them in units of 1024)."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def record(cost: Cost, store: Store) -> None:
    """Add a run to what is known."""
    with _file(store).open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(asdict(cost)) + "\n")


def known(store: Store) -> list[Cost]:
    """All runs on record; lines that no run can have written are passed over."""
    try:
        lines = _file(store).read_text(encoding="utf-8", errors="replace").splitlines()
    except FileNotFoundError:
        return []
    found = []
    for line in lines:
        try:
            found.append(_cost(json.loads(line)))
        except (ValueError, TypeError):
            continue
    return found


def _cost(values: Any) -> Cost:
    """Raises ValueError, TypeError for what cannot be the cost of a run."""
    cost = Cost(**values)
    positive = (cost.cells, cost.ranks, cost.revolutions, cost.mixing_s, cost.memory)
    solved = cost.flow_s is None or (math.isfinite(cost.flow_s) and cost.flow_s > 0)
    if not (solved and all(math.isfinite(value) and value > 0 for value in positive)):
        raise ValueError("a run has cells, takes time and needs memory")
    return cost


def estimate(
    runs: Sequence[Cost],
    *,
    geometry: str,
    flow: str,
    mixing: str,
    dimension: int,
    cells: float,
    ranks: int,
    revolutions: float,
) -> Estimate | None:
    """Scale what is known to a run; None if no run of this flow, mixing and dimension is."""
    alike = [r for r in runs if (r.flow, r.mixing, r.dimension) == (flow, mixing, dimension)]
    alike = [r for r in alike if r.geometry == geometry] or alike
    if not alike:
        return None
    nearest = min(alike, key=lambda r: abs(math.log(r.cells / cells)))
    edge = (cells / nearest.cells) ** (1 / dimension)
    mixed = [(float(r.cells), r.mixing_s * r.ranks / r.revolutions) for r in alike]
    solved = [(float(r.cells), r.flow_s) for r in alike if r.flow_s is not None]
    most = 1 + 1 / dimension
    return Estimate(
        flow_s=_by_power(solved, cells, 1.0, most) if solved else None,
        mixing_s=_by_power(mixed, cells, most, most) * revolutions / ranks,
        steps=nearest.steps / nearest.revolutions * revolutions * edge,
        memory=_by_line([(float(r.cells), r.memory) for r in alike], cells),
        basis=alike,
    )


def _by_power(
    points: Sequence[tuple[float, float]], cells: float, power: float, most: float
) -> float:
    """Through the nearest point in cells; `power` gives way to a fitted one within 0..most."""
    x, y = np.log(np.array(points)).T
    if x.max() - x.min() > math.log(_APART):
        power = float(np.clip(np.polyfit(x, y, 1)[0], 0.0, most))
    near = int(np.abs(x - math.log(cells)).argmin())
    return float(math.exp(y[near]) * (cells / math.exp(x[near])) ** power)


def _by_line(points: Sequence[tuple[float, float]], cells: float) -> float:
    x, y = np.array(points).T
    if x.max() > _APART * x.min():
        slope, bare = np.polyfit(x, y, 1)
    else:
        bare = min(_BARE, float(y.min()))
        slope = float(np.mean((y - bare) / x))
    return float(max(bare, 0.0) + max(slope, 0.0) * cells)


def _file(store: Store) -> Path:
    return store.folder / "costs.jsonl"
