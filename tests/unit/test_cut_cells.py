import math

import numpy as np
import pytest

from scaleup.space.cut_cells import cut_fraction, fill_to_volume
from scaleup.space.grid import Grid, grid_over
from scaleup.system.errors import InputError


def ball(dimension: int, cells: int) -> tuple[Grid, np.ndarray]:
    grid = grid_over((-1.0,) * dimension, (1.0,) * dimension, 2.0 / cells, 1.0)
    return grid, 1.0 - np.linalg.norm(grid.corner_points(), axis=-1)


@pytest.mark.parametrize(("dimension", "exact"), [(2, math.pi), (3, 4 / 3 * math.pi)])
def test_volume_of_a_ball_converges_with_second_order(dimension, exact):
    errors = []
    for cells in (10, 20, 40):
        grid, distance = ball(dimension, cells)
        errors.append(abs(cut_fraction(distance).sum() * grid.cell_volume - exact))
    order = np.polyfit(np.log([1 / 10, 1 / 20, 1 / 40]), np.log(errors), 1)[0]
    assert order > 1.8
    assert errors[-1] / exact < 3e-3


@pytest.mark.parametrize("dimension", [2, 3])
def test_half_spaces_are_cut_exactly(dimension):
    rng = np.random.default_rng(1)
    corners = Grid((0.0,) * dimension, (1.0,) * dimension, (1,) * dimension).corner_points()
    points = rng.random((200_000, dimension))
    for _ in range(20):
        normal = rng.normal(size=dimension)
        offset = rng.uniform(-0.2, 0.2) - 0.5 * normal.sum()
        fraction = cut_fraction(corners @ normal + offset).item()
        sampled = np.mean(points @ normal + offset > 0)
        assert fraction == pytest.approx(sampled, abs=5e-3)


def test_fill_holds_the_volume_to_round_off_and_never_more_than_the_vessel():
    grid, wall = ball(2, 60)
    level = 0.1 - grid.corner_points()[..., 1]
    fill, _ = fill_to_volume(grid, level, wall, 1.234)
    vessel = cut_fraction(wall) * grid.cell_volume
    assert fill.sum() == pytest.approx(1.234, rel=1e-14)
    assert np.all(fill <= vessel * (1 + 1e-13))
    with pytest.raises(InputError, match="does not fit"):
        fill_to_volume(grid, level, wall, 4.0)
