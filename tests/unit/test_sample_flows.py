"""The small flows that mixing backends are tried on satisfy the contract themselves."""

import numpy as np
import pytest

from scaleup.flow.sample_flows import circulating_box, rocking_box
from scaleup.testing import check_flow


@pytest.mark.parametrize("make", [circulating_box, rocking_box])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_small_flow_keeps_the_contract_and_moves(make, dimension):
    flow = make(dimension)
    check_flow(flow, fill_volume=float(flow.intervals[0].fill_start.sum()))
    assert flow.grid.dimension == dimension
    assert np.abs(flow.intervals[0].flux).max() > 0
    moved = [np.abs(part.fill_end - part.fill_start).max() for part in flow.intervals]
    assert (max(moved) > 0) == (make is rocking_box)
