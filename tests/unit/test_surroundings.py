"""What laws of mixing may depend on, against closed forms: gravity, depth, shear."""

import math
from dataclasses import replace

import numpy as np
import pytest

from scaleup.contract import Axis, FlowField, Grid
from scaleup.numerics import Surroundings, cut_fraction, interval_from_dense

EDGE, LEVEL = 0.3, 0.08  # m: of the box; of the surface above its middle


def bed(dimension: int, angle: float, cells: int = 24) -> FlowField:
    """A level bed in a square box that has turned by `angle` (rad), in the vessel's frame.

    The shear rate is 3 x - 2 y (+ z), its flow along x.
    """
    low = -EDGE / 2 - EDGE / cells  # one cell around the box
    grid = Grid((low,) * dimension, (EDGE / cells,) * dimension, (cells + 2,) * dimension)
    up = np.array([math.sin(angle), math.cos(angle), 0.0])[:dimension]
    inside = np.pad(np.ones((cells,) * dimension), 1)
    full = cut_fraction(LEVEL - grid.corner_points() @ up) * inside * grid.cell_volume
    still = [np.zeros(np.add(grid.shape, np.eye(dimension, dtype=int)[grid.array_axis(a)]))
             for a in range(dimension)]  # fmt: skip
    slopes = np.array([3.0, -2.0, 1.0])[:dimension]
    shear = 5.0 + (grid.centre_points() @ slopes).reshape(grid.shape)
    along = np.zeros((dimension, *grid.shape))
    along[0] = 1.0
    part = interval_from_dense(0.0, 2.0, grid, full, full, still, shear, along)
    return FlowField(grid, "vessel", Axis(), angle, [part])  # turned by `angle` at 1 s


@pytest.mark.parametrize("dimension", [2, 3])
def test_gravity_stands_still_in_the_lab_and_turns_against_the_rotation_in_the_vessel(dimension):
    flow = bed(dimension, math.pi / 2)
    for time, (x, y) in ((0.0, (0, -1)), (1.0, (-1, 0)), (2.0, (0, 1)), (3.0, (1, 0))):
        assert flow.down(time) == pytest.approx([x, y, 0][:dimension], abs=1e-15)
        assert replace(flow, frame="lab").down(time) == pytest.approx([0, -1, 0][:dimension])
    late = replace(flow, lift=math.pi / 2)  # had turned before its clock began
    assert late.down(0.5) == pytest.approx(flow.down(1.5))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_depth_below_a_level_surface_is_exact_along_the_grid(dimension, quarters):
    flow = bed(dimension, quarters * math.pi / 2)
    for frame in ("vessel", "lab") if quarters == 0 else ("vessel",):
        part, around = (
            flow.intervals[0],
            Surroundings(replace(flow, frame=frame), flow.intervals[0], 1.0),
        )
        height = -flow.grid.centre_points(part.cells) @ around.down
        assert around.depth == pytest.approx(np.maximum(LEVEL - height, 0.0), abs=1e-12)
        assert around.pressure(1500.0) == pytest.approx(1500 * 9.8 * around.depth)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("degrees", [24.0, 45.0, 130.0, 250.0])
def test_depth_in_a_box_that_has_turned_is_within_a_cell_however_fine(dimension, degrees):
    """Where the line against gravity meets the surface inside the box."""
    for cells in (12, 36):
        flow = bed(dimension, math.radians(degrees), cells)
        part = flow.intervals[0]
        around = Surroundings(flow, part, 1.0)
        points, up = flow.grid.centre_points(part.cells), -around.down
        depth = np.maximum(LEVEL - points @ up, 0.0)
        inside = (np.abs(points + depth[:, None] * up) < EDGE / 2 - EDGE / cells).all(axis=1)
        assert inside.sum() > 0.2 * len(depth)
        error = np.abs(around.depth - depth)[inside]
        assert error.max() < EDGE / cells
        assert error.mean() < 0.4 * EDGE / cells


@pytest.mark.parametrize("dimension", [2, 3])
def test_shear_its_gradient_and_the_flow_s_direction_are_those_of_the_interval(dimension):
    flow = bed(dimension, 0.4)
    part = flow.intervals[0]
    around = Surroundings(flow, part, 0.3)
    assert around.shear_rate is part.shear_rate
    assert around.direction is part.direction
    gradient = np.array([3.0, -2.0, 1.0])[:dimension, None]
    assert np.abs(around.shear_rate_gradient - gradient).max() < 1e-9
