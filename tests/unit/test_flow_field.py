"""The contract between flow and mixing, proved on a vessel-frame flow with a moving fill."""

import dataclasses

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.flow.storage import read_flow, write_flow
from scaleup.system.errors import ContractError
from scaleup.testing import check_flow
from synthetic import donor_cell, sloshing


def test_a_moving_fill_passes_and_keeps_its_volume():
    flow = sloshing(prefix=2)
    check_flow(flow, fill_volume=float(flow.intervals[0].fill_start.sum()))
    moved = [np.abs(part.fill_end - part.fill_start).max() for part in flow.intervals]
    assert max(moved) > 0.02 * flow.grid.cell_volume


def test_fluxes_and_fills_make_transport_conservative_bounded_and_constant_preserving():
    flow = sloshing()
    interval = flow.intervals[0]
    rng = np.random.default_rng(0)
    concentration = rng.random(len(interval.cells))
    content = concentration * interval.fill_start
    uniform = 0.3 * interval.fill_start
    total = content.sum()
    for _ in range(5):
        for part in flow.intervals:
            content, uniform = donor_cell(flow, part, content), donor_cell(flow, part, uniform)
            after = content / part.fill_end
            assert after.min() >= concentration.min() - 1e-12
            assert after.max() <= concentration.max() + 1e-12
            assert np.allclose(uniform, 0.3 * part.fill_end, rtol=1e-12, atol=0)
    assert content.sum() == pytest.approx(total, rel=1e-13)
    assert after.std() < 0.8 * concentration.std()  # it did mix


@pytest.mark.parametrize(
    ("field", "change", "rule"),
    [
        ("flux", lambda v: v * 1.001, "fill and flux disagree"),
        ("fill_end", lambda v: v * 1.5, "disagree|fill must lie"),
        ("fill_start", lambda v: v - 1e-6, "disagree|fill must lie"),
        ("shear_rate", lambda v: -v, "shear_rate"),
        ("direction", lambda v: 2 * v, "unit vectors"),
        ("cells", lambda v: v[::-1], "ascending"),
        ("flux", lambda v: v * np.nan, "not finite"),
    ],
)
def test_broken_flows_are_caught(field, change, rule):
    flow = sloshing()
    parts = list(flow.intervals)
    parts[3] = dataclasses.replace(parts[3], **{field: change(getattr(parts[3], field))})
    with pytest.raises(ContractError, match=rule):
        check_flow(dataclasses.replace(flow, intervals=parts))


def test_flux_that_leaves_the_bed_is_caught():
    flow = sloshing()
    part = flow.intervals[0]
    flux = part.flux.copy()
    flux[0, 0] = 1e-9  # the lower left cell: its west neighbour is empty
    broken = dataclasses.replace(part, flux=flux)
    with pytest.raises(ContractError, match="leaves the bed"):
        check_flow(dataclasses.replace(flow, intervals=[broken, *flow.intervals[1:]]))


def test_schedule_walks_the_prefix_once_and_then_repeats():
    flow = sloshing(intervals=8, prefix=2)
    steps = list(flow.schedule(0.05, 2.05))
    assert [index for index, _, _ in steps] == [0, 1, *range(2, 10), *range(2, 10), *range(2, 5)]
    assert sum(end - start for _, start, end in steps) == pytest.approx(2.0)
    assert steps[0][1:] == pytest.approx((0.05, 0.1))
    again = list(flow.schedule(2.05, 2.1))
    assert again[0][0] == 4
    assert again[0][1:] == pytest.approx((0.45, 0.5))


def test_coarsening_keeps_the_invariants():
    flow = sloshing()
    coarse = flow.coarsened(2)
    check_flow(coarse, fill_volume=float(flow.intervals[0].fill_start.sum()))
    assert coarse.grid.shape == (5, 9)


def test_a_stored_flow_is_the_same_flow(tmp_path):
    flow = sloshing(prefix=1)
    write_flow(tmp_path / "flow.h5", flow, MPI.COMM_SELF)
    stored = read_flow(tmp_path / "flow.h5")
    assert (stored.grid, stored.prefix, stored.frame) == (flow.grid, 1, "vessel")
    assert np.array_equal(stored.times, flow.times)
    for one, other in zip(flow.intervals, stored.intervals, strict=True):
        for field in dataclasses.fields(one):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    assert [p.name for p in tmp_path.iterdir()] == ["flow.h5"]
