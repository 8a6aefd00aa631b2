"""The uniform Cartesian grid that every field of the project lives on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FULL = 1.0 - 1e-6  # fill fraction from which a cell counts as full of material


@dataclass(frozen=True)
class Grid:
    """A box of equal cells, 2-D (a cross-section) or 3-D.

    Axes are counted x = 0, y = 1, z = 2. Arrays over cells are C-ordered with x fastest:
    `shape` is (ny, nx) or (nz, ny, nx), and a flat index runs over that shape.

    lower    -- the corner with the smallest coordinates, m, one per axis
    spacing  -- edge lengths of a cell, m, one per axis
    counts   -- number of cells along each axis (x first)
    depth    -- m, the extent along z that one 2-D cell stands for; 1.0 in 3-D
    periodic -- whether the box repeats along every axis; no vessel does, but the uniform flows do
                on which the stability of a scheme is measured
    """

    lower: tuple[float, ...]
    spacing: tuple[float, ...]
    counts: tuple[int, ...]
    depth: float = 1.0
    periodic: bool = False

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return len(self.counts)

    @property
    def shape(self) -> tuple[int, ...]:
        """Array shape of a cell field: the counts, slowest axis first."""
        return self.counts[::-1]

    @property
    def cells(self) -> int:
        """Number of cells in the box, active or not."""
        return math.prod(self.counts)

    @property
    def cell_volume(self) -> float:
        """m^3."""
        return math.prod(self.spacing) * self.depth

    def face_area(self, axis: int) -> float:
        """Area of a cell's face normal to `axis`, m^2."""
        return self.cell_volume / self.spacing[axis]

    def array_axis(self, axis: int) -> int:
        """Which dimension of an array of `shape` runs along `axis`."""
        return self.dimension - 1 - axis

    def centres(self, axis: int) -> FloatArray:
        """Cell centres along one axis, m, shape (counts[axis],)."""
        return self.lower[axis] + self.spacing[axis] * (np.arange(self.counts[axis]) + 0.5)

    def corners(self, axis: int) -> FloatArray:
        """Cell corners along one axis, m, shape (counts[axis] + 1,)."""
        return self.lower[axis] + self.spacing[axis] * np.arange(self.counts[axis] + 1)

    def corner_points(self) -> FloatArray:
        """All corners, m, shape (*(shape + 1), dimension)."""
        lines = [self.corners(axis) for axis in range(self.dimension)]
        return _lattice(lines)

    def centre_points(self, cells: IntArray | None = None) -> FloatArray:
        """Centres of the given flat cell indices (default: of all), m, shape (n, dimension)."""
        index = np.arange(self.cells) if cells is None else cells
        position = np.unravel_index(index, self.shape)
        return np.stack(
            [self.centres(axis)[position[self.array_axis(axis)]] for axis in range(self.dimension)],
            axis=-1,
        )

    def sample_points(self, cells: IntArray, per_edge: int) -> FloatArray:
        """`per_edge`^dimension regular points inside each cell, m, shape (n, points, dimension)."""
        offsets = (np.arange(per_edge) + 0.5) / per_edge - 0.5
        stencil = _lattice([offsets * h for h in self.spacing]).reshape(-1, self.dimension)
        return self.centre_points(cells)[:, None, :] + stencil[None, :, :]

    def coarsened(self, factor: int) -> Grid:
        """The grid whose cells are blocks of factor^dimension of these; the last may overhang."""
        return Grid(
            lower=self.lower,
            spacing=tuple(h * factor for h in self.spacing),
            counts=tuple(-(-n // factor) for n in self.counts),
            depth=self.depth,
            periodic=self.periodic,
        )


def grid_over(
    lower: tuple[float, ...], upper: tuple[float, ...], spacing: float, depth: float
) -> Grid:
    """A grid of square or cubic cells centred on the box lower..upper and covering it.

    At least one cell lies outside the box on every side, so that every cell of the bed has all its
    neighbours; the counts are even, so that the grid can be halved once without overhang.

    >>> grid = grid_over((0.0, 0.0), (0.10, 0.05), spacing=0.01, depth=0.02)
    >>> grid.counts, grid.shape  # along x and y; as numpy arrays have it
    ((12, 8), (8, 12))
    >>> round(grid.cell_volume * 1e6, 9)  # cm^3
    2.0
    """
    counts, corner = [], []
    for low, high in zip(lower, upper, strict=True):
        count = 2 * math.ceil((high - low) / spacing / 2 - 1e-9) + 2
        counts.append(count)
        corner.append(0.5 * (low + high) - 0.5 * count * spacing)
    return Grid(tuple(corner), (spacing,) * len(counts), tuple(counts), depth)


def _lattice(lines: list[FloatArray]) -> FloatArray:
    mesh = np.meshgrid(*reversed(lines), indexing="ij")
    return np.stack(list(reversed(mesh)), axis=-1)
