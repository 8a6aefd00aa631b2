"""The start-up of a bed: from the first slip through avalanche and swings to the mean flow.

A run's means over blocks of time steps (`SwingAverage`) are the intervals. The surface between two
blocks is the mean of theirs, second order in the block, a twentieth of a pendulum period.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from scaleup.contract import FloatArray, FlowField, Interval, Progress, Scene
from scaleup.numerics import cut_fraction, fill_to_volume, interval_from_dense
from scaleup_mohr_coulomb.closing import GridFaces, balance, closed_fluxes
from scaleup_mohr_coulomb.on_grid import kept_inside, wet_part

if TYPE_CHECKING:
    from scaleup_mohr_coulomb.steady import SteadyBed

_NARROW = 1e-3  # of an open face that counts as wet at least
_STILL = 1e-9  # of the greatest relative speed: below it a direction would be rounding


@dataclass(frozen=True)
class StartUp:
    """Means over the K blocks before the averaged ones.

    velocities, levels -- coefficients of velocity and level set, (K, n)
    block -- s, length of a block; angle -- rad, to which the level bed had been turned rigidly
    """

    velocities: NDArray[Any]
    levels: NDArray[Any]
    block: float
    angle: float


def with_start_up(
    steady: FlowField, bed: SteadyBed, start_up: StartUp, scene: Scene, progress: Progress
) -> FlowField:
    """The steady flow with the start-up as its prefix.

    1. Fills between blocks come from the level set, shifted to hold the asked volume; the last one
    is that of the mean bed. 2. The flux through a face is the block's velocity at the middle of its
    wet part times its wet area. 3. What hangs together keeps its volume (`balance`), and the
    nearest fluxes that change the fills exactly are taken (`closed_fluxes`); the summary's
    `start_up_projection_change` is the rms change over their rms.
    """
    count = len(start_up.levels)
    if count == 0:
        return steady
    mean = steady.intervals[0]
    last = np.zeros(scene.grid.cells)
    last[mean.cells] = mean.fill_start
    builder = _Builder(bed, start_up, scene)
    for number in range(count):
        builder.add(number, last if number == count - 1 else None)
        progress(number / count, "start-up on the grid")
    at = count * start_up.block
    moved = replace(mean, start=at, end=at + mean.duration)
    change = math.sqrt(builder.change / builder.square)
    return replace(
        steady,
        intervals=[*builder.intervals, moved],
        prefix=count,
        lift=start_up.angle,
        summary={**steady.summary, "start_up_s": at, "start_up_projection_change": change},
    )


class _Builder:
    """Builds the intervals one after the other; fills and fluxes are per depth times the depth."""

    def __init__(self, bed: SteadyBed, start_up: StartUp, scene: Scene) -> None:
        self._scene, self._start_up = scene, start_up
        grid, geometry = scene.grid, scene.geometry
        self._corners = grid.corner_points()
        self._wall = geometry.signed_distance(self._corners)
        self._capacity = cut_fraction(self._wall) * grid.cell_volume
        self._open = [wet_part(self._corners, self._wall, grid, axis)[0] for axis in (0, 1)]
        self._near = self._wall > -2 * max(grid.spacing)
        self._vessel = np.flatnonzero(self._capacity)
        self._mesh = bed.mesh
        self._velocity = ngs.GridFunction(bed.velocity.space)
        self._level = ngs.GridFunction(bed.level_set.field.space)
        strain_rate = ngs.Sym(ngs.Grad(self._velocity))
        self._rate = ngs.sqrt(2.0 * ngs.InnerProduct(strain_rate, strain_rate))
        self._at_corners = self._places(self._corners[self._near])
        self._at_centres = self._places(grid.centre_points(self._vessel))
        self.intervals: list[Interval] = []
        self.change = self.square = 0.0
        self._surface, self._fill = self._between(0)

    def _places(self, points: FloatArray) -> Any:
        x, y = np.ascontiguousarray(kept_inside(self._scene.geometry, points).T)
        return self._mesh(x, y)

    def _between(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Surface and fill at the beginning of a block."""
        levels = self._start_up.levels
        if 0 < number < len(levels):
            values = 0.5 * (levels[number - 1] + levels[number])
        elif number:
            values = levels[-1]
        else:
            values = 1.5 * levels[0] - 0.5 * levels[min(1, len(levels) - 1)]
        self._level.vec.FV().NumPy()[:] = values
        grid, geometry = self._scene.grid, self._scene.geometry
        surface = np.full(self._wall.shape, -geometry.reach)
        surface[self._near] = np.asarray(self._level(self._at_corners)).ravel()
        fill, shift = fill_to_volume(grid, surface, self._wall, self._scene.fill_volume)
        return surface + shift, np.minimum(fill, self._capacity)

    def add(self, number: int, goal: FloatArray | None) -> None:
        """The interval of a block, which ends with a fill (flat, m^3) if one is given."""
        grid, scene, block = self._scene.grid, self._scene, self._start_up.block
        surface, fill = self._between(number + 1)
        if goal is not None:
            fill = goal.reshape(grid.shape)
        start, capacity = self._fill, self._capacity
        region = (start > 0.0) | (fill > 0.0)
        if goal is not None:  # what little a group lacks may have to pass through empty cells
            region = capacity > 0.0
        faces = GridFaces.between(grid, region, [share > 0.0 for share in self._lower_faces()])
        cells = faces.cells
        before, after = start.reshape(-1)[cells], fill.reshape(-1)[cells]
        if goal is None:
            after, _ = balance(faces, before, after, capacity.reshape(-1)[cells])
        self._velocity.vec.FV().NumPy()[:] = self._start_up.velocities[number]
        material = np.minimum(0.5 * (self._surface + surface), self._wall)
        given, wet = self._given(faces, material)
        flux = closed_fluxes(faces, given, wet, (before - after) / block, grid.cell_volume / block)
        self.change += float(((flux - given) ** 2).sum())
        self.square += float((given**2).sum())
        end = np.zeros(grid.cells)
        end[cells] = after
        self._fill, self._surface = end.reshape(grid.shape), surface
        shear_rate = np.zeros(grid.cells)
        shear_rate[self._vessel] = np.asarray(self._rate(self._at_centres)).ravel()
        interval = interval_from_dense(
            number * block,
            (number + 1) * block,
            grid,
            start,
            self._fill,
            self._dense(faces, flux),
            shear_rate.reshape(grid.shape),
            self._direction(scene),
        )
        self.intervals.append(interval)

    def _lower_faces(self) -> list[FloatArray]:
        """Open share of each cell's lower faces."""
        return [self._open[0][:, :-1], self._open[1][:-1, :]]

    def _given(self, faces: GridFaces, material: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The block's fluxes (m^3/s) through the faces, and their wet areas (m^2)."""
        grid = self._scene.grid
        velocity = np.zeros((2, *self._wall.shape))
        velocity[:, self._near] = np.asarray(self._velocity(self._at_corners)).T
        given, wet = np.zeros(len(faces.axis)), np.zeros(len(faces.axis))
        for axis in (0, 1):
            share, middle = wet_part(self._corners, material, grid, axis)
            normal = _along_face(velocity[axis], middle, self._corners, grid.array_axis(1 - axis))
            which = faces.axis == axis
            upper = faces.cells[faces.upper[which]]
            pick = (slice(None), slice(0, -1)) if axis == 0 else (slice(0, -1), slice(None))
            area = grid.face_area(axis)
            open_share = self._open[axis][pick].reshape(-1)[upper]
            wet_share = share[pick].reshape(-1)[upper]
            wet[which] = area * np.maximum(wet_share, _NARROW * open_share)
            given[which] = area * wet_share * normal[pick].reshape(-1)[upper]
        return given, wet

    def _dense(self, faces: GridFaces, flux: FloatArray) -> list[FloatArray]:
        """Face fluxes as dense arrays, one per axis, longer by one along it."""
        grid = self._scene.grid
        dense = []
        for axis in (0, 1):
            which = faces.axis == axis
            lower = np.zeros(grid.cells)
            lower[faces.cells[faces.upper[which]]] = flux[which]
            pad = ((0, 0), (0, 1)) if axis == 0 else ((0, 1), (0, 0))
            dense.append(np.pad(lower.reshape(grid.shape), pad))
        return dense

    def _direction(self, scene: Scene) -> FloatArray:
        """Unit vectors of the velocity relative to rigid rotation, (2, *grid.shape)."""
        grid = scene.grid
        arm = grid.centre_points(self._vessel) - np.array(scene.geometry.axis.point[:2])
        relative = np.asarray(self._velocity(self._at_centres)).T
        relative = relative + scene.speed * np.stack([arm[:, 1], -arm[:, 0]])
        speed = np.linalg.norm(relative, axis=0)
        moves = speed > _STILL * speed.max(initial=0.0)
        unit = np.zeros((2, grid.cells))
        unit[:, self._vessel] = np.divide(relative, speed, out=np.zeros_like(relative), where=moves)
        return unit.reshape(2, *grid.shape)


def _along_face(
    values: FloatArray, points: FloatArray, corners: FloatArray, along: int
) -> FloatArray:
    """Values at points on faces, linear between the corners at both ends."""
    ends = (slice(None, -1), slice(1, None))
    first, second = (tuple(end if dim == along else slice(None) for dim in (0, 1)) for end in ends)
    component = 1 - along  # arrays run (y, x), points (x, y)
    length = corners[second][..., component] - corners[first][..., component]
    share = (points[..., component] - corners[first][..., component]) / length
    mixed: FloatArray = (1.0 - share) * values[first] + share * values[second]
    return mixed
