"""A rolling drum blended by its layer, against random walks."""

from __future__ import annotations

import numpy as np

from scaleup.contract import Diffusion
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray
from scaleup.verification.drum_layer import (
    COARSE,
    REVOLUTION,
    bed_level,
    drum_flow,
    layer_tensor,
    surface_coordinates,
)
from scaleup.verification.fields import cell_means
from scaleup.verification.problem import Observed, Problem, two_components
from scaleup.verification.random_walk import QUARTERS, random_walks

_LEAST = 0.05  # of a coarse cell: those that hold less are left out


def halves_side_by_side(flow: FlowField) -> FloatArray:
    """Component 0 where x < 0, the upper half of the surface."""

    def upper(points: FloatArray) -> FloatArray:
        return (surface_coordinates(points)[..., 0] < 0).astype(float)

    cells = flow.intervals[0].cells
    return two_components(cell_means(flow.grid, cells, upper, sharp=True, inside=bed_level))


def in_coarse_cells(flow: FlowField, interval: Interval, time: float, c: FloatArray) -> Observed:
    """Concentrations in coarse cells, by fill; those that hold next to nothing weigh nothing."""
    grid = flow.grid
    per_coarse = (grid.counts[0] - 2) // COARSE
    position = np.stack(np.unravel_index(interval.cells, grid.shape)) - 1
    target = np.ravel_multi_index(tuple(position // per_coarse), (COARSE, COARSE))
    volumes = np.bincount(target, interval.fill_start, COARSE**2)
    contents = [np.bincount(target, part * interval.fill_start, COARSE**2) for part in c]
    shares = np.divide(contents, volumes, out=np.zeros((len(c), COARSE**2)), where=volumes > 0)
    kept = volumes > _LEAST * grid.cell_volume * per_coarse**2
    return shares, np.where(kept, volumes, 0.0)


def drum_layers() -> list[Problem]:
    """The rolling drum."""
    return [
        Problem(
            name="drum-layer",
            sentence="Halves of a rolling drum blended for one revolution by a sheared layer with "
            "an anisotropic diffusivity, against random walks, on cells of 10 mm.",
            dimension=2,
            regime="sampled",
            sizes=(70, 140, 280),
            duration=REVOLUTION,
            flow=drum_flow,
            initial=halves_side_by_side,
            exact=lambda flow, time: two_components(random_walks().concentration_at(time)),
            laws=(Diffusion(layer_tensor),),
            observe=in_coarse_cells,
            stops=tuple(REVOLUTION * share for share in QUARTERS[:-1]),
        )
    ]
