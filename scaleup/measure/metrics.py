"""Measures of mixedness.

Over nodes, as Liu, Gonzalez & Wassgren 2018 (Eq. 22-25):

    I = sigma^2 / sigma_0^2,  sigma^2 = sum (c_mean - c_m)^2 / (M - 1),  sigma_0^2 = c (1 - c).

At a scale of scrutiny the bed is cut into boxes of that edge; a sample's concentration is the
fill-weighted mean in its box, samples are weighted by their fill, and boxes less than half full
are left out.

Lacey's index compares the variance s^2 of samples of N grains with that of unmixed powder,
s0^2 = c (1 - c), and of a random mixture, sr^2 = s0^2/N: (s0^2 - s^2)/(s0^2 - sr^2) (Lacey 1954,
J. Appl. Chem. 4, 257). A continuum's concentrations are those that grains are drawn from: the
variance v of samples over concentrations lacks what the drawing adds, the mean of c_i (1 - c_i)/N,
that is (s0^2 - v)/N, and can fall below sr^2. With s^2 = v + (s0^2 - v)/N the index is 1 - v/s0^2,
whatever N: between 0 and 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from scaleup.scene.units import LENGTH
from scaleup.space.flow_field import Interval
from scaleup.space.grid import FloatArray, Grid
from scaleup.system.errors import InputError


@dataclass(frozen=True)
class Mixedness:
    """Measures of one component at one time, all dimensionless.

    intensity        -- segregation intensity over nodes (cells at least half full)
    intensity_sample -- the same at the scale of scrutiny
    lacey            -- Lacey's index of the grains in the samples, 0 to 1
    rsd              -- standard deviation over mean, at the scale of scrutiny
    """

    intensity: float
    intensity_sample: float
    lacey: float
    rsd: float


def sample_cells(grid: Grid, edge: float) -> list[int]:
    """Cells along the edges of a sample that is wanted `edge` (m) long, in the arrays' order."""
    return [
        max(1, round(edge / grid.spacing[grid.array_axis(dim)])) for dim in range(grid.dimension)
    ]


def sample_edge(grid: Grid, edge: float) -> float:
    """Edge, m, of the cube (or square) as large as a sample that is wanted `edge` (m) long."""
    cells = math.prod(sample_cells(grid, edge)) * math.prod(grid.spacing)
    return float(cells ** (1 / grid.dimension))


class Sampler:
    """Cuts the bed of one interval into samples at a scale of scrutiny.

    A box of powder, its left half of one kind, in samples of 4 by 4 cells:

    >>> from scaleup.flow.sample_flows import circulating_box
    >>> flow = circulating_box(dimension=2)
    >>> bed = flow.intervals[0]
    >>> left = (flow.grid.centre_points(bed.cells)[:, 0] < 0.09).astype(float)
    >>> sampler = Sampler(flow.grid, bed, time=0.0, edge=0.04)
    >>> round(sampler.measure(left).intensity_sample, 2)  # samples across the border are mixed
    0.8
    >>> sampler.measure(np.full(len(left), 0.5)).lacey
    1.0
    """

    def __init__(self, grid: Grid, interval: Interval, time: float, edge: float):
        """`edge`: wanted edge of a sample, m; rounded to whole cells, at least one.

        Raises InputError if no sample is at least half full.
        """
        fill = interval.fill(time)
        self._node = fill >= 0.5 * grid.cell_volume
        position = np.unravel_index(interval.cells, grid.shape)
        block = sample_cells(grid, edge)
        shape = [n // b + 1 for n, b in zip(grid.shape, block, strict=True)]
        box = np.ravel_multi_index([p // b for p, b in zip(position, block, strict=True)], shape)
        _, self._box = np.unique(box, return_inverse=True)
        held = np.bincount(self._box, weights=fill)
        full = held >= 0.5 * grid.cell_volume * math.prod(block)
        if not full.any() or self._node.sum() < 2:
            raise InputError(
                f"accuracy.scrutiny: no sample of {LENGTH.shown(edge)} is half full on cells of "
                f"{LENGTH.shown(min(grid.spacing))}; take smaller samples or smaller cells"
            )
        self._fill, self._held, self._full = fill, held, full
        # a cross-section stands for any depth: its samples are as deep as they are wide
        depth = 1.0 if grid.dimension == 3 else sample_edge(grid, edge) / grid.depth
        self.sample_volume = float(held[full].mean()) * depth

    def measure(self, concentration: FloatArray) -> Mixedness:
        """Mixedness of a component, (n,) on the active cells."""
        at_nodes = concentration[self._node]
        intensity = _ratio(float(at_nodes.var(ddof=1)), float(at_nodes.mean()))
        content = np.bincount(self._box, weights=concentration * self._fill)
        weight = self._held[self._full]
        samples = content[self._full] / weight
        mean = float(np.average(samples, weights=weight))
        variance = float(np.average((samples - mean) ** 2, weights=weight))
        of_samples = _ratio(variance, mean)
        return Mixedness(
            intensity=intensity,
            intensity_sample=of_samples,
            lacey=1.0 - of_samples,
            rsd=math.sqrt(variance) / mean if mean > 0 else math.inf,
        )


def blend_time(revolutions: list[float], rsd: list[float], limit: float) -> float | None:
    """First revolution at which the RSD is below `limit` for good; None if never (or not yet)."""
    below = [value < limit for value in rsd]
    if not below or not below[-1]:
        return None
    first = len(below) - 1
    while first > 0 and below[first - 1]:
        first -= 1
    if first == 0:
        return revolutions[0]
    a, b = math.log(rsd[first - 1]), math.log(max(rsd[first], 1e-300))
    share = (a - math.log(limit)) / (a - b)
    return revolutions[first - 1] + share * (revolutions[first] - revolutions[first - 1])


def decay_rate(revolutions: list[float], intensity: list[float]) -> float | None:
    """Rate r of I ~ exp(-r rev), fitted where I < 0.8; None with fewer than four such points."""
    points = [(x, math.log(y)) for x, y in zip(revolutions, intensity, strict=True) if 0 < y < 0.8]
    if len(points) < 4:
        return None
    x, y = np.array(points).T
    return float(-np.polyfit(x, y, 1)[0])


def centre_line(
    grid: Grid, interval: Interval, concentration: FloatArray, angle: float
) -> tuple[FloatArray, FloatArray]:
    """Concentration along the line through the axis normal to a plane surface in the lab frame.

    Bilinear between cell centres.

    concentration -- (n,) on the active cells; angle -- rad, of the surface
    Returns (depth below the surface over the bed's depth, concentration); the paper's Fig. 15.
    """
    dense = np.full(grid.cells, np.nan)
    dense[interval.cells] = concentration
    normal = np.array([-math.sin(angle), math.cos(angle)])
    reach = np.abs(np.array(grid.lower)).max()
    along = np.arange(-reach, reach, 0.5 * min(grid.spacing))
    position = (along[:, None] * normal - np.array(grid.lower)) / np.array(grid.spacing) - 0.5
    values = map_coordinates(dense.reshape(grid.shape), position.T[::-1], order=1, cval=np.nan)
    in_bed = np.isfinite(values)
    along, values = along[in_bed][::-1], values[in_bed][::-1]
    return (along[0] - along) / (along[0] - along[-1]), values


def _ratio(variance: float, mean: float) -> float:
    unmixed = mean * (1 - mean)
    return variance / unmixed if unmixed > 0 else 0.0
