"""Values carried to cells without any."""

import numpy as np
import pytest

from scaleup.numerics import spread_outwards
from scaleup.space.grid import Grid


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_line_of_cells_takes_the_value_at_its_end(dimension):
    grid = Grid((0.0,) * dimension, (1.0,) * dimension, (9,) * dimension)
    line = np.ravel_multi_index((np.full(9, 4),) * (dimension - 1) + (np.arange(9),), grid.shape)
    assert spread_outwards(grid, line[:1], np.array([[0.3]]), line) == pytest.approx(0.3)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_cell_apart_takes_the_mean_of_the_nearest(dimension):
    grid = Grid((0.0,) * dimension, (1.0,) * dimension, (9,) * dimension)
    middle = (4,) * (dimension - 1)
    known = [np.ravel_multi_index((*middle, x), grid.shape) for x in (0, 8)]
    apart = [np.ravel_multi_index((*middle, x), grid.shape) for x in (3, 4)]
    found = spread_outwards(grid, np.array(known), np.array([[0.2, 0.6]]), np.array(apart))
    assert found[0] == pytest.approx([0.2, 0.4])


def test_nothing_known_gives_zero():
    grid = Grid((0.0, 0.0), (1.0, 1.0), (4, 4))
    empty = np.array([], dtype=int)
    assert (spread_outwards(grid, empty, np.zeros((2, 0)), np.arange(16)) == 0.0).all()
