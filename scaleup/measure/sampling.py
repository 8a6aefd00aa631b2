"""The samples that a blend is judged by: those asked for, and those that the cells can show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from scaleup.case.case import Case
from scaleup.measure.metrics import sample_edge
from scaleup.scene.units import LENGTH, MASS
from scaleup.space.grid import Grid

_LARGER = 2.0  # volume over that asked for, from which samples do not stand for those asked for


@dataclass(frozen=True)
class Samples:
    """Edge (m) and mass (kg) of a sample as asked for and as measured, a cube.

    grains             -- in a sample that is measured
    random_mixture_rsd -- relative standard deviation of such samples of a random mixture, by the
                          chance of which grains are in them: not part of `rsd`, and on top of it
    resolved           -- whether the samples measured stand for those asked for
    """

    asked_edge: float
    asked_mass: float
    edge: float
    mass: float
    grains: float
    random_mixture_rsd: float | None
    resolved: bool

    @classmethod
    def of(
        cls, case: Case, grid: Grid, volume: float | None = None, share: float | None = None
    ) -> Samples:
        """The samples of a run.

        volume -- m^3 of powder in a sample as measured; None for that of its box
        share  -- of the bed, the least component's
        """
        material = case.material
        asked = case.sample_edge
        edge = sample_edge(grid, asked)
        volume = edge**3 if volume is None else volume
        grains = max(
            1.0, volume * material.solid_fraction * 6 / math.pi / material.grain_diameter**3
        )
        return cls(
            asked_edge=asked,
            asked_mass=asked**3 * material.bulk_density,
            edge=edge,
            mass=volume * material.bulk_density,
            grains=grains,
            random_mixture_rsd=math.sqrt((1 - share) / share / grains) if share else None,
            resolved=(edge / asked) ** 3 <= _LARGER,
        )

    def __str__(self) -> str:
        """Such as "samples of 0.19 mg (0.5 mm)"."""
        return _named(self.mass, self.edge)

    @property
    def asked(self) -> str:
        """The same of those asked for."""
        return _named(self.asked_mass, self.asked_edge)

    def as_table(self) -> dict[str, Any]:
        """For report.json."""
        return asdict(self)


def unresolved(samples: Samples) -> str:
    """What is to be said where the samples measured are larger than those asked for."""
    times = (samples.edge / samples.asked_edge) ** 3
    return (
        f"{samples.asked} are asked for, and the cells resolve {samples} only, {times:.3g} times "
        "as large: RSD, Lacey's index and I at scrutiny are of these, and what is asked for is "
        "blended later; take smaller cells, or larger samples (accuracy.sample_mass)"
    )


def samples_of(mixing: Mapping[str, Any]) -> str:
    """What samples the section `mixing` of a report.json is of; older ones do not state it."""
    if "samples" not in mixing:
        return "at the scale of scrutiny"
    return _named(mixing["samples"]["mass"], mixing["samples"]["edge"])


def _named(mass: float, edge: float) -> str:
    return f"samples of {MASS.shown(mass)} ({LENGTH.shown(edge)})"
