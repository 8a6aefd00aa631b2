"""A bed in its vessel as the eye sees it, and cut open: from fields on the grid to pixels.

Fields of the vessel's frame are looked at in the lab's by turning the eye (or the plane of the cut)
back by the phase, so that nothing is interpolated twice. Rays are cast in compiled code of our own:
that needs no graphics library and gives the same picture on any machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from scaleup.space.flow_field import Axis
from scaleup.space.grid import FloatArray, Grid

_WALL_POINTS = 128  # of the wall's lattice along the vessel's longest side, at least
_MOST_WALL_POINTS = 4e6
# where the eye and the lamp are, seen from the vessel, in the lab: the bed's surface faces -x
_EYE = np.array([-0.55, 0.5, 0.75])
_LAMP = np.array([-0.25, 0.9, 0.65])
_SHADE = 0.6  # brightness of what the lamp does not reach
_WALL_COLOUR = np.array([0.25, 0.3, 0.38])


@dataclass(frozen=True)
class Picture:
    """Fields at one instant.

    revolution -- turns since the start
    phase      -- rad by which the grid has turned in the lab since it stood upright
    fill_fraction, concentration -- of the cells and of component 1, `grid.shape`; without bed 0
                  and NaN
    """

    grid: Grid
    axis: Axis
    revolution: float
    phase: float
    fill_fraction: NDArray[np.float32]
    concentration: NDArray[np.float32]


@dataclass(frozen=True)
class Wall:
    """Distance to the wall (m, positive inside) on a lattice in the vessel at rest.

    low, spacing -- m, first point and steps, (x, y[, z]); values -- ([nz,] ny, nx)
    reach        -- m, of the vessel from its axis
    """

    low: FloatArray
    spacing: FloatArray
    values: FloatArray
    reach: float

    @property
    def middle(self) -> FloatArray:
        """Along the axis to the middle of the vessel, m, (x, y, z)."""
        if self.values.ndim == 2:
            return np.zeros(3)
        return np.array([0.0, 0.0, self.low[2] + self.half_length])

    @property
    def half_length(self) -> float:
        """Half the lattice along the axis, m; the vessel's reach for a cross-section."""
        if self.values.ndim == 2:
            return self.reach
        return float(0.5 * self.spacing[2] * (self.values.shape[0] - 1))

    @cached_property
    def half_picture(self) -> float:
        """Half the edge of a picture in 3-D that holds the vessel at every phase, m."""
        counts = self.values.shape[::-1]
        x, y, z = (
            a + h * np.arange(n) for a, h, n in zip(self.low, self.spacing, counts, strict=True)
        )
        radius = np.where(self.values > 0, np.hypot(x[None, :], y[:, None]), 0.0).max(axis=(1, 2))
        from_middle = np.abs(z - self.middle[2])
        right, up, _ = _directions()
        return 1.05 * max(
            float((math.hypot(*v[:2]) * radius + abs(v[2]) * from_middle).max())
            for v in (right, up)
        )


def wall_of(geometry: Any) -> Wall:
    """The wall's lattice of a Geometry: two points across its thinnest part or more."""
    low, high = np.array(geometry.lower), np.array(geometry.upper)
    step = min(float((high - low).max()) / _WALL_POINTS, 0.5 * geometry.thinnest)
    step = max(step, (float(np.prod(high - low)) / _MOST_WALL_POINTS) ** (1 / len(low)))
    counts = np.ceil((high - low) / step).astype(int) + 5
    lines = [a + step * (np.arange(n) - 2) for a, n in zip(low, counts, strict=True)]
    mesh = np.meshgrid(*reversed(lines), indexing="ij")
    values = geometry.signed_distance(np.stack(list(reversed(mesh)), axis=-1))
    spacing = np.full(len(low), step)
    return Wall(low - 2 * step, spacing, np.ascontiguousarray(values), geometry.reach)


def see(picture: Picture, wall: Wall, pixels: int) -> FloatArray:
    """A 3-D bed lit in its translucent vessel, colours (pixels, pixels, 3) in 0..1, first row up.

    The picture's edge is 2 `wall.half_picture`. The colour is that of the concentration in
    `colour_map`, darker where the light falls askew.
    """
    from scaleup.report.ray_kernel import Bed, Rays, Vessel, cast

    grid, half = picture.grid, wall.half_picture
    turn = _turned(-picture.phase)
    right, up, eye = (turn @ v for v in _directions())
    lamp = turn @ (_LAMP / np.linalg.norm(_LAMP))
    size, far = 2 * half / pixels, 2 * half
    middle = np.array(picture.axis.point) + wall.middle
    corner = middle + far * eye - (half - 0.5 * size) * (right + up)
    share = np.asarray(picture.fill_fraction)
    content = share * np.nan_to_num(picture.concentration)
    edge = np.array(grid.spacing)
    step = 0.5 * float(edge.min())
    concentration, light, veil = cast(
        Bed(share, content, gaussian_filter(share, 1.0), np.array(grid.lower) + 0.5 * edge, edge),
        Vessel(wall.values, wall.low, wall.spacing),
        Rays(corner, size * right, size * up, -eye, lamp, (pixels, pixels), 2 * far, step),
    )
    colours = colour_map()(np.nan_to_num(concentration))[..., :3]
    colours *= (_SHADE + (1 - _SHADE) * np.nan_to_num(light))[..., None]
    colours[~np.isfinite(concentration)] = 1.0
    veiled = (1 - veil)[..., None] * colours + veil[..., None] * _WALL_COLOUR
    return np.asarray(veiled[::-1])


@dataclass(frozen=True)
class Cut:
    """Values on a plane through the middle of the vessel, in the lab; the first row is lowest.

    extent -- m: left, right, bottom, top
    values -- NaN where no bed is; gap -- m, distance to the wall, positive inside
    """

    extent: tuple[float, float, float, float]
    values: FloatArray
    gap: FloatArray


def cut(
    picture: Picture,
    wall: Wall,
    across: Literal["x", "z"],
    pixels: int,
    values: NDArray[Any] | None = None,
) -> Cut:
    """The bed cut by the plane z = middle, or by x = 0 (then z runs to the right); y is up.

    Each pixel in the vessel takes the value (default: the concentration) of the cell that it lies
    in, if half of what the vessel leaves of that cell is full.
    """
    half = 1.04 * wall.reach
    aside = half if across == "z" else 1.04 * wall.half_length
    upward = (np.arange(pixels) + 0.5) / pixels * 2 * half - half
    sideways = (np.arange(pixels) + 0.5) / pixels * 2 * aside - aside
    side, height = np.meshgrid(sideways, upward)
    along = (side, height, 0 * side) if across == "z" else (0 * side, height, side)
    points = np.stack(along, axis=-1) @ _turned(-picture.phase).T
    points = (points + np.array(picture.axis.point) + wall.middle)[..., : picture.grid.dimension]
    shown = picture.concentration if values is None else values
    low, edge = np.array(picture.grid.lower), np.array(picture.grid.spacing)
    cell = np.floor((points - low) / edge)
    gap = _gap(wall, points)
    room = np.clip(0.5 + _gap(wall, low + edge * (cell + 0.5)) / edge[0], 0.05, 1.0)
    share, seen = (
        map_coordinates(field, _rows_first(cell), order=0, cval=cval)
        for field, cval in ((picture.fill_fraction, 0.0), (shown, np.nan))
    )
    seen = np.where((gap > 0) & (share >= 0.5 * room), seen, np.nan)
    return Cut((-aside, aside, -half, half), seen, gap)


def colour_map() -> Any:
    """Colours of the concentration from 0 to 1, the same in every picture."""
    import matplotlib

    return matplotlib.colormaps["viridis"]


def _directions() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors in the lab: to the right and up in the picture, and to the eye."""
    eye = _EYE / np.linalg.norm(_EYE)
    right = np.cross([0.0, 1.0, 0.0], eye)
    right /= np.linalg.norm(right)
    return right, np.cross(eye, right), eye


def _gap(wall: Wall, points: FloatArray) -> FloatArray:
    """Distance to the wall at points (rows, columns, dimension), m."""
    place = _rows_first((points - wall.low) / wall.spacing)
    return np.asarray(map_coordinates(wall.values, place, order=1, cval=-1.0))


def _rows_first(place: FloatArray) -> FloatArray:
    """Lattice positions (rows, columns, (x, y[, z])) as `map_coordinates` takes them."""
    return np.moveaxis(place, -1, 0)[::-1]


def _turned(angle: float) -> FloatArray:
    """Rotation (3, 3) about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
