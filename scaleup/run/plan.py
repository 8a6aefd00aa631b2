"""When a run pauses: where it measures, draws and keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scaleup.case.case import Case
from scaleup.contract import FlowField
from scaleup.report.results import FRAMES, PHASES, instants


@dataclass(frozen=True)
class Plan:
    """The revolutions at which a run pauses, those where steps end among them, ascending.

    points    -- all of them, from 0 to the last
    curve     -- where the blend is measured
    snapshots, pictures -- where fields are stored
    final     -- the last one at which a longer run would pause, too: from there it can be extended
                 with the very steps of a run of that length
    """

    points: tuple[float, ...]
    curve: frozenset[float]
    snapshots: frozenset[float]
    pictures: frozenset[float]
    final: float

    @staticmethod
    def of(case: Case, flow: FlowField, *, with_pictures: bool) -> Plan:
        """The plan of a run.

        The blend is measured at multiples of the asked steps, where diffusion sets in, and at the
        end. Pictures are of the first and the last revolution, but steps end at their phases all
        along, so that what is computed does not depend on which revolution is the last one.
        """
        last, output = round(case.operation.revolutions, 9), case.output
        snapshots = _multiples(output.snapshots_every, last)
        sets_in = round(case.diffusion.after, 9)
        curve = snapshots | _multiples(output.metrics_every, last)
        curve |= {sets_in} if sets_in <= last else set()
        pictures: set[float] = set()
        regular = set(curve)
        for which in ("first", "last") if with_pictures else ():
            animated = output.animate in (which, "both")
            if animated or flow.frame == "vessel":  # a bed that stands still in the lab needs none
                count = FRAMES if animated else PHASES
                pictures |= set(instants(which if last > 1 else "first", last, count))
                regular |= {round(n / count, 9) for n in range(math.floor(last * count + 1e-9) + 1)}
        return Plan(
            points=tuple(sorted(regular | {last})),
            curve=frozenset(curve | {last}),
            snapshots=frozenset(snapshots | {last}),
            pictures=frozenset(pictures),
            final=max(regular),
        )

    def instants(self, until: float) -> dict[str, list[float]]:
        """Revolutions, by kind, whose fields are stored until one."""
        kinds = {"snapshots": self.snapshots, "pictures": self.pictures}
        return {
            kind: sorted(at for at in revolutions if at <= until)
            for kind, revolutions in kinds.items()
        }


def _multiples(every: float, last: float) -> set[float]:
    return {round(n * every, 9) for n in range(math.floor(last / every + 1e-9) + 1)}
