"""Contract checks for plugins: each raises ContractError with the rule and the figure it broke."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from scaleup.case.composing import compose
from scaleup.case.vessel_shape import axis_meets
from scaleup.contract import Scene
from scaleup.flow.check import check_flow as check_flow
from scaleup.mixing.check import CheckedMixing
from scaleup.mixing.scene import mixing_scene as mixing_scene
from scaleup.space.cut_cells import cut_fraction
from scaleup.space.grid import FloatArray, Grid, grid_over
from scaleup.system.errors import ContractError, InputError

_ROUND_OFF = 1e-12
_CENTRE = 3e-3  # of the reach: how far apart the centres of one body may be


def check_geometry(geometry: Any) -> None:
    """Check a geometry against itself: every check of `geometry_checks`."""
    for _, check in geometry_checks(geometry):
        check()


def geometry_checks(geometry: Any) -> list[tuple[str, Callable[[], None]]]:
    """The checks of a geometry as (what holds, a function that raises ContractError if not)."""
    sampled = _SampledGeometry(geometry)
    return [
        ("the box lies around the inside", sampled.check_box),
        ("volume and volume_below agree", sampled.check_ends),
        ("volume agrees with quadrature of the signed distance to 0.1 %", sampled.check_volume),
        ("volume_below agrees with quadrature at every level to 0.2 %", sampled.check_levels),
        ("signed_distance is a distance near the wall", sampled.check_slope),
        ("reach is the greatest distance from the axis", sampled.check_reach),
        ("the axis passes through the inside", sampled.check_axis),
        ("the mirror planes mirror the vessel", sampled.check_symmetry),
        ("the solid has the same volume, to 0.1 %, and centre", sampled.check_solid),
    ]


class _SampledGeometry:
    """A geometry and its signed distance on a fine grid."""

    def __init__(self, geometry: Any):
        self._geometry = geometry
        self._box = np.array(geometry.lower), np.array(geometry.upper)

    @cached_property
    def _grid(self) -> Grid:
        lower, upper = self._box
        geometry = self._geometry
        if len(lower) != geometry.dimension or np.any(upper <= lower):
            raise ContractError("lower and upper must span a box of the geometry's dimension")
        spacing = float((upper - lower).max()) / (400 if geometry.dimension == 2 else 100)
        spacing = min(spacing, geometry.thinnest)
        return grid_over(geometry.lower, geometry.upper, spacing, geometry.depth)

    @cached_property
    def _wall(self) -> FloatArray:
        points = self._grid.corner_points()
        wall = self._geometry.signed_distance(points)
        if wall.shape != points.shape[:-1] or not np.all(np.isfinite(wall)):
            raise ContractError(
                "signed_distance must take points (..., dimension) and return finite values (...)"
            )
        return np.asarray(wall)

    @cached_property
    def _fill(self) -> FloatArray:
        return cut_fraction(self._wall) * self._grid.cell_volume

    @property
    def _points(self) -> FloatArray:
        return self._grid.corner_points().reshape(-1, self._geometry.dimension)

    def check_box(self) -> None:
        wall = self._wall
        edges = [np.take(wall, index, dim) for dim in range(wall.ndim) for index in (0, -1)]
        if max(float(edge.max()) for edge in edges) > 0:
            raise ContractError("the inside reaches beyond the box from lower to upper")

    def check_ends(self) -> None:
        geometry, (lower, upper) = self._geometry, self._box
        whole, none = geometry.volume_below(upper[1]), geometry.volume_below(lower[1])
        if abs(whole / geometry.volume - 1) > 1e-9 or abs(none) > 1e-9 * geometry.volume:
            raise ContractError(
                f"volume_below(top) = {whole:.6g} and volume_below(bottom) = {none:.2g} must be "
                f"the volume {geometry.volume:.6g} m^3 and 0"
            )

    def check_volume(self) -> None:
        volume, quadrature = self._geometry.volume, float(self._fill.sum())
        if abs(quadrature / volume - 1) > 1e-3:
            raise ContractError(
                f"volume = {volume:.6g} m^3, but the signed distance encloses {quadrature:.6g} m^3"
            )

    def check_levels(self) -> None:
        """At the faces of the grid's layers, and never falling in between."""
        geometry, grid = self._geometry, self._grid
        across = tuple(dim for dim in range(grid.dimension) if dim != grid.array_axis(1))
        counted = np.concatenate([[0.0], np.cumsum(self._fill.sum(axis=across))])
        stated = np.array([geometry.volume_below(float(y)) for y in grid.corners(1)])
        if np.any(np.diff(stated) < -1e-9 * geometry.volume):
            raise ContractError("volume_below must not fall as the level rises")
        gap = np.abs(stated - counted)
        if gap.max() > 2e-3 * geometry.volume:
            worst = int(gap.argmax())
            raise ContractError(
                f"volume_below({grid.corners(1)[worst]:.4g}) = {stated[worst]:.6g} m^3, but the "
                f"signed distance encloses {counted[worst]:.6g} m^3 there"
            )

    def check_slope(self) -> None:
        """The signed distance grows by the way gone, but for kinks at edges and corners."""
        geometry, spacing = self._geometry, self._grid.spacing[0]
        points, step = self._points[np.abs(self._wall.ravel()) < 2 * spacing], 0.01 * spacing
        slope = np.zeros(len(points))
        for unit in np.eye(geometry.dimension):
            ahead = geometry.signed_distance(points + step * unit)
            slope += ((ahead - geometry.signed_distance(points - step * unit)) / (2 * step)) ** 2
        wrong = float(np.mean(np.abs(np.sqrt(slope) - 1.0) > 0.05))
        if wrong > 0.1:
            raise ContractError(
                f"signed_distance has not slope 1 at {wrong:.0%} of the points near the wall; it "
                "must be the distance to the wall, in m"
            )

    def check_reach(self) -> None:
        geometry, inside = self._geometry, self._points[self._wall.ravel() >= 0]
        offset = inside[:, :2] - np.array(geometry.axis.point[:2])
        radius = float(np.linalg.norm(offset, axis=1).max())
        if abs(radius - geometry.reach) > 2 * self._grid.spacing[0]:
            raise ContractError(
                f"reach = {geometry.reach:g} m, but the inside reaches {radius:.4g} m"
            )

    def check_axis(self) -> None:
        if self._geometry.axis.direction != (0.0, 0.0, 1.0):
            raise ContractError(
                f"axis.direction = {self._geometry.axis.direction}: must be (0, 0, 1); turn the "
                "vessel in its own frame instead"
            )
        if not axis_meets(self._geometry):
            raise ContractError("the axis of rotation misses the vessel")

    def check_symmetry(self) -> None:
        geometry = self._geometry
        centre = np.array(geometry.axis.point[: geometry.dimension])
        points = self._points[:: max(1, len(self._points) // 20000)]
        for normal in geometry.symmetry:
            if geometry.dimension != 3 or np.abs(np.abs(normal) - [0, 0, 1]).max() > 1e-12:
                raise ContractError(
                    f"symmetry: {normal} must be (0, 0, 1), across the axis, in 3-D"
                )
            image = points - 2 * ((points - centre) @ np.array(normal))[:, None] * np.array(normal)
            gap = np.abs(geometry.signed_distance(points) - geometry.signed_distance(image))
            if gap.max() > 1e-6 * geometry.reach:
                raise ContractError(
                    f"symmetry: the vessel differs from its mirror image by {gap.max():.2g} m"
                )

    def check_solid(self) -> None:
        geometry = self._geometry
        try:
            solid = geometry.solid()
        except InputError:
            return
        volume = float(solid.mass) * geometry.depth
        if abs(volume / geometry.volume - 1) > 1e-3:
            raise ContractError(
                f"volume = {geometry.volume:.6g} m^3, but the solid's is {volume:.6g} m^3"
            )
        fill = self._fill.ravel()
        centre = (fill / fill.sum()) @ self._grid.centre_points()
        stated = np.array([solid.center.x, solid.center.y, solid.center.z])[: geometry.dimension]
        if np.abs(centre - stated).max() > _CENTRE * geometry.reach:
            raise ContractError(
                f"the solid's centre of volume is at {_point(stated)} m, but that of the inside by "
                f"signed_distance at {_point(centre)} m"
            )


def small_scene(geometry: str, cells: float = 2000) -> Scene:
    """The default scene of an installed geometry on few cells, to try a flow model on."""
    flags = {"geometry": {"name": geometry}, "grid": {"cells": cells}}
    return compose(None, flags=flags, flow_must_accept=False).scene({})


def check_mixing(backend: Any, scene: Any, concentration: Any, duration: float) -> None:
    """Check a mixing backend on a scene, from concentrations (components, n): collective.

    1 what it returns is as `CheckedMixing` asks in a run: shape, bounds, content; 2 the stable step
    is positive, infinite if none is too long; 3 after `duration` (s) components sum to 1; 4 a
    uniform concentration stays uniform to 1e-12.
    """
    flow = scene.flow
    checked = CheckedMixing(backend)
    for start in (concentration, np.full_like(concentration, 1.0 / len(concentration))):
        interval = flow.intervals[0]
        end = interval.start
        checked.start(scene, start, 0, end)
        checked.stable_time_step(interval)
        checked.concentration(interval, end)
        for index, begin, end in flow.schedule(0.0, duration):
            checked.advance(index, begin, end)
            interval = flow.intervals[index]
        result = checked.concentration(interval, min(max(end, interval.start), interval.end))
        error = float(np.abs(result.sum(axis=0) - 1.0).max())
        if error > _ROUND_OFF:
            raise ContractError(f"the components sum to 1 +- {error:.2g}")
    spread = float(np.abs(result - 1.0 / len(concentration)).max())
    if spread > _ROUND_OFF:
        raise ContractError(f"a uniform concentration changed by {spread:.2g}")


def _point(coordinates: FloatArray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in coordinates) + ")"
