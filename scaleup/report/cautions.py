"""What a reader should know of a run before it is made: said by `plan` and by the report."""

from __future__ import annotations

from scaleup.case.case import Case
from scaleup.case.vessel_shape import Bed
from scaleup.measure.sampling import Samples, unresolved
from scaleup.space.grid import Grid

_CELLS_DEEP, _GRAINS_DEEP, _SAMPLES = 10, 10, 20  # of a bed, wanted


def cautions(case: Case, grid: Grid, samples: Samples | None = None) -> list[str]:
    """Sentences on the vessel, the grid, the grains and the samples; the flow model has its own.

    samples -- as measured; None before a run
    """
    bed, samples = case.bed, samples or Samples.of(case, grid)
    found = list(bed.geometry.warnings)
    cells, grains = bed.depth / bed.spacing, bed.depth / case.material.grain_diameter
    if cells < _CELLS_DEEP:
        found.append(f"the bed is {cells:.3g} cells deep; {_CELLS_DEEP} or more are wanted")
    if grains < _GRAINS_DEEP:
        found.append(
            f"the bed is {grains:.3g} grains deep; a continuum wants {_GRAINS_DEEP} or more"
        )
    if not samples.resolved:
        found.append(unresolved(samples))
    count = _count(bed, samples)
    if count < _SAMPLES:
        found.append(
            f"the bed holds {count:.3g} {samples}: RSD and Lacey's index of less than {_SAMPLES} "
            "say little"
        )
    return found


def _count(bed: Bed, samples: Samples) -> float:
    """How many samples the bed holds."""
    size = samples.edge**bed.geometry.dimension * bed.geometry.depth
    return float(bed.volume / size)
