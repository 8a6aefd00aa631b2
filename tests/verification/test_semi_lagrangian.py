"""Mixing `semi-lagrangian`: paths, balances, exchange; what it promises whatever the step."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.mixing.scene import mixing_scene
from scaleup.verification import fitted_order, problems, run
from scaleup_semi_lagrangian import SemiLagrangian
from scaleup_semi_lagrangian.centring import balance
from scaleup_semi_lagrangian.exchange import _decompose
from scaleup_semi_lagrangian.middles import ends_of_subcells
from scaleup_semi_lagrangian.moving_cells import find_moving
from scaleup_semi_lagrangian.paths import follow, lattice


def backend(**options):
    return SemiLagrangian(SemiLagrangian.Options(**options))


def test_paths_in_rigid_rotation_come_back():
    problem = problems()["gaussian"]
    flow = problem.flow(64)
    moving = find_moving(flow.grid, flow.intervals[0])
    centre = flow.grid.centre_points(moving.cells)
    radius = np.linalg.norm(centre - 0.5, axis=1)
    sources = np.flatnonzero((radius > 0.1) & (radius < 0.4)).astype(np.int32)
    rest = np.zeros_like(moving.start)
    landed, places = follow(
        moving.below, moving.above, moving.flux, moving.shear, moving.full, moving.start, rest,
        sources, lattice(2, 2), 1.0, (0, 1),
    )  # fmt: skip
    end = centre[landed] + (places - 0.5) / 64
    begin = centre[sources][:, None] + (lattice(2, 2) - 0.5) / 64
    assert np.abs(end - begin).max() < 0.02 / 64


@pytest.mark.parametrize(("name", "n"), [("gaussian", 64), ("gaussian-3d", 24)])
def test_middles_tell_where_subcells_of_full_cells_end(name, n):
    problem = problems()[name]
    flow = problem.flow(n)
    moving = find_moving(flow.grid, flow.intervals[0])
    dimension, duration = flow.grid.dimension, 0.2 * problem.duration
    radius = np.linalg.norm(flow.grid.centre_points(moving.cells) - 0.5, axis=1)
    sources = np.flatnonzero(radius < 0.35).astype(np.int32)
    rest, points = np.zeros_like(moving.start), lattice(2, dimension)
    landed, places = ends_of_subcells(
        flow.grid, moving, (moving.start, moving.end), duration, sources, points
    )
    landed_by_path, places_by_path = follow(
        moving.below, moving.above, moving.flux, moving.shear, moving.full, moving.start, rest,
        sources, points, duration, tuple(range(points.shape[1])),
    )  # fmt: skip
    corner = moving.coordinates
    apart = corner[landed] + places - corner[landed_by_path] - places_by_path
    assert np.abs(apart).max() < 0.02


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_exchange_is_the_tensor(dimension):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(dimension, dimension, 200))
    tensor = np.einsum("abn,cbn->acn", root, root) + 0.05 * np.eye(dimension)[:, :, None]
    vectors, weights = _decompose(tensor)
    assert weights.min() >= 0
    again = np.einsum("akn,bkn,kn->abn", vectors, vectors, weights)
    assert np.abs(again - tensor).max() < 1e-9 * np.abs(tensor).max()


@pytest.mark.parametrize("deformation", [0.5, 2.0, 20.0])
@pytest.mark.parametrize(("name", "n"), [("zalesak", 50), ("sloshing", 32), ("sloshing-3d", 16)])
def test_mass_and_bounds_hold_for_any_step(name, n, deformation):
    result = run(problems()[name], backend(deformation=deformation), n)
    assert abs(result.mass_drift) < 1e-12
    assert result.minimum > -1e-12
    assert result.maximum < 1 + 1e-12


@pytest.mark.parametrize(
    ("name", "sizes", "error"), [("gaussian", (64, 128), 2e-4), ("gaussian-3d", (24, 36), 4e-3)]
)
def test_order_of_long_steps_that_land_cells_between_cells(name, sizes, error):
    """As many steps on every grid: what is left is the error of laying cells down on cells."""
    results = [run(problems()[name], backend(), n) for n in sizes]
    assert [result.steps for result in results] == [7, 7]
    assert fitted_order(results) > 2.5
    assert results[-1].l1 < error


def test_balanced_changes_sum_to_nothing_and_only_shrink():
    rng = np.random.default_rng(3)
    raw = rng.normal(size=(3, 500)) + np.array([[0.05], [0.02], [0.0]])
    changes = raw.copy()
    balance(changes)
    assert np.abs(changes.sum(axis=1)).max() < 1e-12
    kept = changes / raw
    assert kept == pytest.approx(np.broadcast_to(kept[0], kept.shape), abs=1e-12)
    assert kept.min() >= 0
    assert kept.max() <= 1
    assert kept.mean() > 0.8
    one_sided = np.array([[1.0, 2.0]])
    balance(one_sided)
    assert not one_sided.any()


def test_three_components_keep_mass_and_bounds():
    problem = problems()["zalesak"]

    def thirds(flow):
        share = problem.initial(flow)[0]
        y = flow.grid.centre_points(flow.intervals[0].cells)[:, 1]
        return np.stack([share * y, share * (1 - y), 1 - share])

    flow = problem.flow(50)
    engine, start = backend(), thirds(flow)
    engine.start(mixing_scene(engine, flow, MPI.COMM_SELF, problem.laws), start)
    ledger = engine.advance(0, 0.0, 0.9)
    end, fill = engine.concentration(flow.intervals[0]), flow.intervals[0].fill_start
    assert end @ fill == pytest.approx(start @ fill, rel=1e-12)
    assert ledger.minimum > -1e-12
    assert end.min() > -1e-12
    assert end.sum(axis=0) == pytest.approx(1.0, abs=1e-12)


def test_order_on_a_moving_surface():
    problem = problems()["sloshing"]
    results = [run(problem, backend(), n) for n in (16, 32, 64)]
    assert fitted_order(results) > 1.0
    assert results[-1].l1 < 2e-3


def test_variance_grows_as_the_diffusivity_says():
    result = run(problems()["gaussian-diffusing"], backend(deformation=0.5), 64)
    assert result.variance_ratio == pytest.approx(1.0, abs=0.02)
