"""What surrounds grains in a flowing bed: what a law of mixing may depend on.

The depth of a cell is how far below the bed's surface its centre lies, along the line against
gravity up to the first place without material. Planes of cells are gone through from above; the
line meets the plane above at most one cell aside, and takes there the mean of the cells that hold
material (short characteristics), so that it follows walls. Under a level surface exact where
gravity is along a grid axis, else within about a cell; a wall that hangs over counts as a surface.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product

import numpy as np

from scaleup.scene.models import GRAVITY
from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.gradient import slope
from scaleup.space.grid import FloatArray


class Surroundings:
    """On the n active cells of an interval at a time (s), in the frame of the flow; found if asked.

    Laws call it in `velocities(flow, interval, time)`:

        around = Surroundings(flow, interval, time)
        speed = constant * around.shear_rate * (1 - ...)
        return np.stack([speed * around.down[:, None], 0 * ...])
    """

    def __init__(self, flow: FlowField, interval: Interval, time: float):
        self._flow, self._interval, self._time = flow, interval, time

    @property
    def shear_rate(self) -> FloatArray:
        """1/s, (n,)."""
        return self._interval.shear_rate

    @property
    def direction(self) -> FloatArray:
        """Of the flow relative to rigid rotation, unit vectors or zero, (dimension, n)."""
        return self._interval.direction

    @property
    def down(self) -> FloatArray:
        """Unit vector along gravity, (dimension,)."""
        return self._flow.down(self._time)

    @cached_property
    def shear_rate_gradient(self) -> FloatArray:
        """1/(m s), (dimension, n): central differences, one-sided at the bed's edge."""
        grid, interval = self._flow.grid, self._interval
        axes = range(grid.dimension)
        return np.stack([slope(grid, interval.cells, self.shear_rate, axis) for axis in axes])

    @cached_property
    def depth(self) -> FloatArray:
        """M of bed above each cell's centre, (n,); see above."""
        grid, interval = self._flow.grid, self._interval
        fill = np.zeros(grid.cells)
        fill[interval.cells] = interval.fill(self._time) / grid.cell_volume
        climb = -self.down * np.array(grid.spacing)  # m against gravity from cell to cell
        per_cell = climb / np.array(grid.spacing) ** 2
        along = int(np.abs(per_cell).argmax())
        length = 1.0 / abs(per_cell[along])  # of the line from plane to plane
        others = [a for a in range(grid.dimension) if a != along][::-1]
        planes = np.moveaxis(fill.reshape(grid.shape), grid.array_axis(along), 0)
        under = np.zeros_like(planes)  # depth of the middle of each cell's lower face
        weight = above = np.zeros_like(planes[0])
        for number in range(len(planes)) if climb[along] < 0 else range(len(planes))[::-1]:
            total, weights = np.zeros_like(above), np.zeros_like(above)
            for corner in product((0, 1), repeat=len(others)):
                aside = [c * int(np.sign(climb[a])) for c, a in zip(corner, others, strict=True)]
                parts = [abs(per_cell[a]) * length for a in others]
                share = math.prod(p if c else 1 - p for c, p in zip(corner, parts, strict=True))
                rise = abs(climb[along]) + sum(
                    by * climb[a] for by, a in zip(aside, others, strict=True)
                )
                back, dims = [-by for by in aside], range(len(others))
                there = share * np.roll(weight, back, dims)
                total += there * (np.roll(above, back, dims) + rise)
                weights += there
            weight = planes[number]
            above = np.divide(total, weights, out=length * weight, where=weights > 0)
            above[weight <= 0] = 0.0
            under[number] = above
        depth = np.moveaxis(under, 0, grid.array_axis(along)).reshape(-1)[interval.cells]
        return np.asarray(np.maximum(depth - 0.5 * abs(climb[along]), 0.0))

    def pressure(self, bulk_density: float) -> FloatArray:
        """Weight of the bed above, Pa, (n,); bulk density in kg/m^3."""
        return bulk_density * GRAVITY * self.depth
