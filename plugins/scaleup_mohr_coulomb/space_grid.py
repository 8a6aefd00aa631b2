"""From a turned vessel's finite elements to a periodic FlowField on the mixing grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scaleup.contract import FloatArray, FlowField, Grid, Progress, Scene
from scaleup.numerics import (
    CompactInterval,
    CompactIntervals,
    cut_fraction,
    cut_fraction_of_cells,
    fill_to_volume,
    on_root_alone,
)

from .closing import GridFaces, balance, closed_fluxes
from .on_grid import kept_inside
from .revolutions import REPEATS, SOLVING

if TYPE_CHECKING:
    from .revolutions import Turned
    from .space_flow import VesselFlow

_STILL = 0.01  # of the rim's speed: slower powder between full cells is at rest
_NARROW = 1e-3  # of a face's open area counts as wet at least where both cells hold powder
_MARGIN = 1e-4  # of the reach: how far from the mirror plane points are kept
_MARGIN_CELLS = 2.0  # cells beyond the wall at whose corners the level set is wanted
_DRIFTS = 0.02  # of the bed's volume: sum of corrections beyond which it is said
_SLIDING = 0.8  # rotation of the bed over the vessel's below which it does not turn along
_BALANCED = 1e-12  # of a cell's volume that a group of cells may gain
_DEEP = 1.0 / 3.0  # of the reach below the surface: deep in the bed
_LAYER_ELEMENTS = 3.0  # elements across a layer of reach/5, below which it is not resolved


class Sampler:
    """Values of finite-element functions at points, gathered on the first rank; collective."""

    def __init__(self, mesh: Any, points: FloatArray, comm: Any) -> None:
        self._comm, self._count = comm, len(points)
        self._here = np.zeros(0, dtype=int)
        self._places = None
        if mesh.ne:
            places = mesh(*(np.ascontiguousarray(points[:, i]) for i in range(3)))
            self._here = np.flatnonzero(places["nr"] >= 0)
            self._places = places[self._here]
        found = self._gathered(np.ones((len(self._here), 1)))
        self._nearest: NDArray[Any] | None = None
        if found is not None:
            self._times = found[:, 0]
            known = np.flatnonzero(self._times)
            self._nearest = np.arange(self._count)
            lost = np.flatnonzero(self._times == 0)
            if len(lost):
                self._nearest[lost] = known[cKDTree(points[known]).query(points[lost])[1]]

    def _gathered(self, values: NDArray[Any]) -> NDArray[Any] | None:
        whole = np.zeros((self._count, values.shape[1]))
        whole[self._here] = values
        if self._comm.size == 1:
            return whole
        total = np.zeros_like(whole) if self._comm.rank == 0 else None
        self._comm.Reduce(whole, total)
        return total

    def __call__(self, function: Any, components: int) -> NDArray[Any] | None:
        """Values (points, components) on the first rank, None elsewhere."""
        values = np.zeros((0, components))
        if self._places is not None and len(self._here):
            values = np.asarray(function(self._places)).reshape(-1, components)
        whole = self._gathered(values)
        if whole is None:
            return None
        spread: NDArray[Any] = (whole / np.maximum(self._times, 1)[:, None])[self._nearest]
        return spread


def periodic_flow(
    flow: VesselFlow, run: Turned, scene: Scene, comm: Any, progress: Progress
) -> FlowField | None:
    """The FlowField of a turned vessel, on the first rank (collective).

    1. Fills at the ends of intervals come from the level set, shifted to hold the asked volume; the
    last one is that of a revolution before. 2. The flux through a face is the mean velocity at it
    times its wet area, none where powder is at rest between full cells. 3. Each part of the bed
    that hangs together holds what it held (`closing.balance`), and the nearest fluxes that change
    the fills exactly are taken (`closing.closed_fluxes`).
    """
    geometry, grid = scene.geometry, scene.grid
    corners = grid.corner_points()
    wall = geometry.signed_distance(corners)
    near = wall > -_MARGIN_CELLS * max(grid.spacing)
    points = kept_inside(geometry, corners[near])
    side = np.ones(len(points))
    if flow.mirrored:  # both halves see the one that was solved
        side = np.where(points[:, 2] < 0.0, -1.0, 1.0)
        points[:, 2] = np.maximum(np.abs(points[:, 2]), _MARGIN * geometry.reach)
    sampler = Sampler(flow.mesh, points, comm)
    level, velocity = flow.level_set.field.vec, flow.velocity.vec
    total = len(run.velocities)
    length = 2.0 * math.pi / flow.speed / run.per_revolution
    builder = _Builder(scene, wall, near, length) if comm.rank == 0 else None
    for number in range(total + 1):
        level.FV().NumPy()[:] = run.levels[number]
        surface = sampler(flow.level_set.field, 1)
        motion = None
        mean = run.velocities[number - 1] if number else None
        if mean is not None:
            velocity.FV().NumPy()[:] = mean
            motion = sampler(flow.velocity, 3)
            if motion is not None:
                motion[:, 2] *= side
        _add(builder, comm, surface, motion, number, run.prefix, total)
        progress(SOLVING + (1.0 - SOLVING) * number / max(total, 1), "fluxes on the grid")
    if builder is None:
        return None
    return FlowField(
        grid=grid,
        frame="vessel",
        axis=geometry.axis,
        angular_velocity=flow.speed,
        intervals=CompactIntervals(
            builder.parts, np.arange(total + 1) * length, builder.capacity.ravel()
        ),
        prefix=run.prefix,
        summary=_summary(flow, run, scene, builder),
        warnings=_warnings(flow, run, scene, builder),
    )


def _add(builder: _Builder | None, comm: Any, *given: Any) -> None:
    """Let the first rank add an interval; its error is raised on all."""
    on_root_alone(comm, lambda: builder.add(*given) if builder is not None else None)


class _Rotation:
    """Mean rotation over the vessel's, of motion in the vessel's frame."""

    def __init__(self) -> None:
        self._turned = self._turnable = 0.0

    def add(self, rigid: NDArray[Any], motion: NDArray[Any]) -> None:
        """Velocities (n, 2) in m/s: the vessel's, and the powder's relative to it."""
        self._turned += float((motion * rigid).sum())
        self._turnable += float((rigid**2).sum())

    @property
    def ratio(self) -> float | None:
        """1 for powder that turns with the vessel, None of no powder."""
        return 1.0 + self._turned / self._turnable if self._turnable else None


class _Builder:
    """Builds the intervals one after the other; ``moved`` is the volume that `balance` has moved
    and ``change`` what closing has changed, squared, beside ``square`` of the given fluxes.
    """

    def __init__(self, scene: Scene, wall: FloatArray, near: NDArray[Any], length: float) -> None:
        self._scene, self._wall, self._near, self._length = scene, wall, near, length
        grid = scene.grid
        self.capacity = cut_fraction(wall) * grid.cell_volume
        self._open = [_face_share(wall, grid, axis) for axis in range(3)]
        self._threshold = _STILL * scene.speed * scene.geometry.reach
        self._surface = np.zeros(0)
        self._fill = np.zeros(0)
        self._repeated = np.zeros(0)
        self.parts: list[CompactInterval] = []
        self.moved = self.change = self.square = 0.0
        self._corners = grid.corner_points()[near]
        self.surface_speed = 0.0
        self._deep, self._at_wall = _Rotation(), _Rotation()

    @property
    def rotation_ratio(self) -> float | None:
        """Mean rotation of powder deep in the bed over the vessel's, in the last revolution.

        None if the bed is nowhere that deep.
        """
        return self._deep.ratio

    @property
    def wall_rotation_ratio(self) -> float | None:
        """Of that powder, of what lies within a cell of the wall."""
        return self._at_wall.ratio

    def _look_at(self, level: FloatArray, motion: NDArray[Any]) -> None:
        """Measure speeds (m/s) relative to rigid rotation near the surface and deep in the bed."""
        grid, scene = self._scene.grid, self._scene
        inside = self._wall[self._near] > 0.0
        top = inside & (level > 0.0) & (level < grid.spacing[0])
        speed = np.linalg.norm(motion[top], axis=1)
        self.surface_speed = max(self.surface_speed, float(speed.max(initial=0.0)))
        deep = inside & (level > _DEEP * scene.geometry.reach)
        at_wall = deep & (self._wall[self._near] < grid.spacing[0])
        for rotation, where in ((self._deep, deep), (self._at_wall, at_wall)):
            x, y = self._corners[where, :2].T
            rotation.add(scene.speed * np.stack([-y, x], axis=1), motion[where, :2])

    def add(
        self,
        surface: NDArray[Any],
        motion: NDArray[Any] | None,
        number: int,
        prefix: int,
        total: int,
    ) -> None:
        """Add the interval that ends with a surface, unless it is the first surface (number 0).

        surface, motion -- level set (m) and mean velocity (m/s) at the corners near the vessel
        """
        scene, grid = self._scene, self._scene.grid
        whole = np.full(self._wall.shape, -scene.geometry.reach)
        whole[self._near] = surface[:, 0]
        if number < total:
            fill, shift = fill_to_volume(grid, whole, self._wall, scene.fill_volume)
            whole += shift
            full = np.abs(fill - self.capacity) <= 1e-9 * grid.cell_volume
            fill = np.where(full, self.capacity, np.minimum(fill, self.capacity))
        else:
            fill = self._repeated
        if number > prefix and motion is not None:
            self._look_at(whole[self._near], motion)
        if number:
            mean = np.minimum(0.5 * (whole + self._surface), self._wall)
            fill = self._interval(fill, mean, motion, number, last=number == total)
        self._surface, self._fill = whole, fill
        if number == prefix:
            self._repeated = fill

    def _interval(
        self,
        end: FloatArray,
        material: FloatArray,
        motion: NDArray[Any] | None,
        number: int,
        last: bool,
    ) -> FloatArray:
        """Close an interval and keep it; the fill at its end."""
        grid, start, capacity = self._scene.grid, self._fill, self.capacity
        velocity = np.zeros((3, *self._wall.shape))
        if motion is not None:
            velocity[:, self._near] = motion.T
        else:
            end = start
        centre = np.stack([_cell_mean(component) for component in velocity])
        speed = np.linalg.norm(centre, axis=0)
        active = (start > 0.0) | (end > 0.0)
        full = (start == capacity) & (end == capacity)
        moves = active & (speed > self._threshold)
        region = active & (moves | ~full)
        region |= active & _neighbours(region)
        faces = self._faces(region)
        if last:
            region, faces = self._joined(region, active, start, end)
        cells = faces.cells
        first, final = start.reshape(-1)[cells], end.reshape(-1)[cells]
        if not last:
            final, moved = balance(faces, first, final, capacity.reshape(-1)[cells])
            self.moved += moved
            end = end.copy()
            end.reshape(-1)[cells] = final
        given, wet = self._given(faces, material, velocity, moves | ~full)
        flux = closed_fluxes(
            faces,
            given,
            wet,
            (first - final) / self._length,
            grid.cell_volume / self._length,
        )
        self.change += float(((flux - given) ** 2).sum())
        self.square += float((given**2).sum())
        lower = np.zeros((3, len(cells)))
        lower[faces.axis, faces.upper] = flux
        direction = np.stack([component.reshape(-1)[cells] for component in centre])
        length = np.linalg.norm(direction, axis=0)
        direction = np.divide(direction, length, out=np.zeros_like(direction), where=length > 0)
        at = float(self._length * (number - 1))
        self.parts.append(
            CompactInterval(
                start=at,
                end=float(self._length * number),
                cells=cells.astype(np.int32),
                fill_start=first,
                fill_end=final,
                flux=lower,
                shear_rate=_shear_rate(velocity, grid).reshape(-1)[cells].astype(np.float32),
                direction=direction.astype(np.float32),
                still=_runs(active & ~region),
            )
        )
        return end

    def _joined(
        self, region: NDArray[Any], active: NDArray[Any], start: FloatArray, end: FloatArray
    ) -> tuple[NDArray[Any], GridFaces]:
        """The region, or so much more of the vessel that no group of its cells gains anything.

        The end of the last interval is given, so that what little a group apart from the others
        lacks must pass through cells at rest or empty.
        """
        grid, open_cells = self._scene.grid, self.capacity > 0.0
        faces = self._faces(region)
        wider = region | active
        while self._gains(faces, start, end) > _BALANCED * grid.cell_volume:
            if (wider == region).all():
                break
            region, faces = wider, self._faces(wider)
            wider = region | (open_cells & _neighbours(region))
        return region, faces

    def _faces(self, region: NDArray[Any]) -> GridFaces:
        return GridFaces.between(self._scene.grid, region, [share > 0.0 for share in self._open])

    @staticmethod
    def _gains(faces: GridFaces, start: FloatArray, end: FloatArray) -> float:
        """The greatest change of what a group of cells holds, m^3."""
        count, group = faces.groups()
        change = (end - start).reshape(-1)[faces.cells]
        return float(np.abs(np.bincount(group, change, count)).max(initial=0.0))

    def _given(
        self, faces: GridFaces, material: FloatArray, velocity: FloatArray, moving: NDArray[Any]
    ) -> tuple[FloatArray, FloatArray]:
        """Fluxes (m^3/s) of the solved velocity through the faces, and their wet areas (m^2)."""
        grid = self._scene.grid
        given, wet = np.zeros(len(faces.axis)), np.zeros(len(faces.axis))
        for axis in range(3):
            which = faces.axis == axis
            upper = faces.cells[faces.upper[which]]
            area = grid.face_area(axis)
            share = _face_share(material, grid, axis).reshape(-1)[upper]
            open_share = self._open[axis].reshape(-1)[upper]
            normal = _face_mean(velocity[axis], grid, axis).reshape(-1)[upper]
            either = moving.reshape(-1)[upper] | moving.reshape(-1)[faces.cells[faces.lower[which]]]
            wet[which] = area * np.maximum(share, _NARROW * open_share)
            given[which] = np.where(either, normal * area * share, 0.0)
        return given, wet


def _cell_mean(corner: FloatArray) -> FloatArray:
    """Means over the corners of cells."""
    for axis in range(corner.ndim):
        corner = 0.5 * (
            np.take(corner, range(corner.shape[axis] - 1), axis)
            + np.take(corner, range(1, corner.shape[axis]), axis)
        )
    return corner


def _face_corners(corner: FloatArray, grid: Grid, axis: int) -> list[FloatArray]:
    """Values at the four corners of each cell's lower face normal to an axis."""
    along = grid.array_axis(axis)
    values = np.take(corner, range(grid.counts[axis]), along)
    found = [values]
    for other in range(3):
        if other != along:
            count = values.shape[other] - 1
            found = [
                np.take(part, range(first, first + count), other)
                for part in found
                for first in (0, 1)
            ]
    return found


def _face_mean(corner: FloatArray, grid: Grid, axis: int) -> FloatArray:
    return np.mean(_face_corners(corner, grid, axis), axis=0)


def _face_share(level: FloatArray, grid: Grid, axis: int) -> FloatArray:
    """Share of each cell's lower face normal to an axis where a level set is positive."""
    corners = np.stack(_face_corners(level, grid, axis), axis=-1)
    share: FloatArray = (corners.min(axis=-1) > 0.0).astype(float)
    cut = (share == 0.0) & (corners.max(axis=-1) > 0.0)
    share[cut] = cut_fraction_of_cells(corners[cut])
    return share


def _neighbours(flags: NDArray[Any]) -> NDArray[Any]:
    """Cells that share a face with a flagged one."""
    found = np.zeros_like(flags)
    for axis in range(flags.ndim):
        low = [slice(None)] * flags.ndim
        high = list(low)
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        found[tuple(low)] |= flags[tuple(high)]
        found[tuple(high)] |= flags[tuple(low)]
    return found


def _shear_rate(velocity: FloatArray, grid: Grid) -> FloatArray:
    """sqrt(2 E:E) at the cells' centres from the velocity (3, ...) at their corners, 1/s."""
    gradient = []
    for component in velocity:
        row = []
        for axis in range(3):
            along = grid.array_axis(axis)
            slope = np.diff(component, axis=along) / grid.spacing[axis]
            for other in range(3):
                if other != along:
                    count = slope.shape[other]
                    slope = 0.5 * (
                        np.take(slope, range(count - 1), other)
                        + np.take(slope, range(1, count), other)
                    )
            row.append(slope)
        gradient.append(row)
    square = sum((0.5 * (gradient[i][j] + gradient[j][i])) ** 2 for i in range(3) for j in range(3))
    rate: FloatArray = np.sqrt(2.0 * square)
    return rate


def _runs(flags: NDArray[Any]) -> NDArray[Any]:
    """First and one past the last flat index of runs of flagged cells, none over a row's end."""
    padded = np.zeros((*flags.shape[:-1], flags.shape[-1] + 2), dtype=np.int8)
    padded[..., 1:-1] = flags
    step = np.diff(padded, axis=-1)
    rows = np.arange(math.prod(flags.shape[:-1])).reshape(*flags.shape[:-1], 1) * flags.shape[-1]
    places = rows + np.arange(flags.shape[-1] + 1)
    runs: NDArray[Any] = np.stack([places[step == 1], places[step == -1]], axis=1).astype(np.int32)
    return runs


def _summary(flow: VesselFlow, run: Turned, scene: Scene, builder: _Builder) -> dict[str, Any]:
    angles = np.degrees(run.angles[run.prefix + 1 :])
    reason = "not measured in a vessel in space"
    steps = max(flow.steps, 1)
    return {
        "surface_angle_deg": float(angles.mean()),
        "surface_angle_spread_deg": float(angles.std()),
        "surface_angle_source": "solved: mean over the last revolution of the inclination of the "
        "plane through the free surface",
        "surface_speed_max": builder.surface_speed,
        "surface_speed_definition": "greatest of the last revolution within a cell of the surface, "
        "relative to the vessel",
        "active_layer_thickness": None,
        "active_layer_thickness_reason": reason,
        "solid_body_ratio": builder.rotation_ratio,
        "solid_body_ratio_definition": "rotation over the vessel's of powder deeper than a third "
        "of the reach",
        "wall_rotation_ratio": builder.wall_rotation_ratio,
        "wall_rotation_ratio_definition": "the same of powder within a cell of the wall",
        **(
            {"solid_body_ratio_reason": "the bed is nowhere that deep"}
            if builder.rotation_ratio is None
            else {}
        ),
        "flux_midbed": None,
        "flux_midbed_reason": reason,
        "volume_drift": flow.volume_moved,
        "repeat_mismatch": run.mismatch,
        "projection_change": math.sqrt(builder.change / max(builder.square, 1e-300)),
        "volume_balanced": builder.moved / scene.fill_volume,
        "nonlocal_length": flow.numerics.nonlocal_length,
        "element_size": flow.numerics.fine_size,
        "unknowns": flow.unknowns,
        "half_of_vessel_solved": flow.mirrored,
        "time_steps": flow.steps,
        "iterations_per_step": flow.iterations / steps,
        "seconds_per_step": run.seconds / steps,
        "retries": run.retries,
        "intervals_per_revolution": run.per_revolution,
    }


def _warnings(flow: VesselFlow, run: Turned, scene: Scene, builder: _Builder) -> tuple[str, ...]:
    """Sentences on where the model or its periodic part may not hold."""
    found = []
    reach = scene.geometry.reach
    size = flow.numerics.fine_size
    if _LAYER_ELEMENTS * size > reach / 5.0:
        found.append(
            f"elements of {1e3 * size:.3g} mm do not resolve a flowing layer of about "
            f"{200 * reach:.3g} mm: speeds and angles change with the mesh; refine flow.fine_size "
            f"to {1e3 * reach / 15.0:.2g} mm"
        )
    if flow.volume_moved > _DRIFTS:
        found.append(
            f"volume corrections of the level set add up to {100 * flow.volume_moved:.2g} % of the "
            "bed: the surface is not resolved; refine flow.fine_size"
        )
    ratio = builder.rotation_ratio
    if ratio is not None and ratio < _SLIDING:
        at_wall = builder.wall_rotation_ratio
        slides = at_wall is not None and at_wall < _SLIDING
        found.append(
            f"the bed turns at {ratio:.2f} of the vessel's speed deep below its surface: it "
            + ("slides on the wall" if slides else "creeps")
            + " instead of turning with the vessel"
        )
    if run.mismatch > REPEATS:
        found.append(
            f"{100 * run.mismatch:.2g} % of the bed lies elsewhere after the last revolution: the "
            "flow had not come to repeat itself; raise flow.revolutions"
        )
    return tuple(found)
