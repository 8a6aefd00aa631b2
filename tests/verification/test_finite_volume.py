"""The default mixing backend: conservative, bounded, of high order and not anti-diffusive."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.contract import FlowField, Ledger, MixingScene
from scaleup.flow.source import obtain_flow
from scaleup.mixing.scene import mixing_scene
from scaleup.run.blending import mix
from scaleup.scene.models import Diffusion
from scaleup.scene.shear_diffusion import shear_diffusion
from scaleup.space.merged_cells import leaving_rate, merge, neighbours_below
from scaleup.testing import check_mixing
from scaleup.verification import fitted_order, problems, run
from scaleup_finite_volume import FiniteVolume
from synthetic import sloshing

ROUND_OFF = 1e-12


def backend(**options) -> FiniteVolume:
    return FiniteVolume(FiniteVolume.Options(**options))


def scene_of(flow: FlowField, k1: float = 0.04, grain: float = 3e-3) -> MixingScene:
    laws = [shear_diffusion(Diffusion(k1=k1), grain)]
    return mixing_scene(backend(), flow, MPI.COMM_SELF, laws)


def test_order_and_error_of_a_rotating_gaussian():
    results = [run(problems()["gaussian"], backend(), n) for n in (64, 128)]
    assert results[0].l1 <= 0.06
    assert results[1].l1 <= 0.010
    assert fitted_order(results) >= 2.5


@pytest.mark.slow
def test_order_and_error_of_a_rotating_gaussian_on_fine_cells():
    results = [run(problems()["gaussian"], backend(), n) for n in (128, 256)]
    assert results[1].l1 <= 0.0015
    assert fitted_order(results) >= 2.5


@pytest.mark.parametrize(
    ("name", "n", "most"), [("zalesak", 100, 0.30), ("three-bodies", 128, 0.16)]
)
def test_jumps_are_kept_sharp_within_bounds(name, n, most):
    result = run(problems()[name], backend(), n)
    assert result.l1 <= most
    assert result.minimum >= -ROUND_OFF
    assert result.maximum <= 1.0 + ROUND_OFF
    assert abs(result.mass_drift) <= ROUND_OFF


@pytest.mark.parametrize(
    ("name", "n"), [("gaussian-diffusing", 64), ("sheared-disc", 64), ("anisotropic", 64)]
)
def test_diffusion_is_neither_lost_nor_added(name, n):
    result = run(problems()[name], backend(), n)
    assert result.variance_ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("name", "n"), [("full-drum", 64), ("sloshing", 64), ("sloshing-3d", 24)])
def test_smooth_humps_are_not_squared_on_cut_cells_and_moving_fills(name, n):
    """A scheme that steepens would raise the second moment of c about its mean."""
    result = run(problems()[name], backend(), n)
    volumes = result.volumes
    moments = []
    for c in (result.concentration[0], result.exact[0]):
        mean = np.average(c, weights=volumes)
        moments.append(np.average((c - mean) ** 2, weights=volumes))
    assert 0.95 * moments[1] < moments[0] < 1.005 * moments[1]
    assert result.variance_ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("components", [2, 5])
def test_mass_and_bounds_on_a_moving_fill_with_diffusion(components):
    flow = sloshing(columns=24, rows=12)
    start = np.random.default_rng(1).integers(0, components, len(flow.intervals[0].cells))
    c = (start == np.arange(components)[:, None]).astype(float)
    solver, ledger = backend(), Ledger()
    solver.start(scene_of(flow), c)
    for index, begin, end in flow.schedule(0.0, 8 * flow.period):
        ledger.add(solver.advance(index, begin, end))
    interval = flow.intervals[index]
    after = solver.concentration(interval)
    drift = after @ interval.fill_end / (c @ flow.intervals[0].fill_start) - 1.0
    assert np.abs(drift).max() <= ROUND_OFF
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF
    assert after.min() >= -ROUND_OFF
    assert after.sum(axis=0) == pytest.approx(1.0, abs=ROUND_OFF)


def test_mass_and_bounds_on_a_moving_fill_in_3d():
    problem = problems()["sloshing-3d"]
    flow = problem.flow(16)
    cells = len(flow.intervals[0].cells)
    rough = np.random.default_rng(2).integers(0, 2, cells).astype(float)
    solver, ledger = backend(), Ledger()
    solver.start(scene_of(flow, grain=2e-2), np.stack([rough, 1.0 - rough]))
    for index, begin, end in flow.schedule(0.0, 3 * flow.period):
        ledger.add(solver.advance(index, begin, end))
    interval = flow.intervals[index]
    after = solver.concentration(interval)[0] @ interval.fill_end
    assert after == pytest.approx(rough @ flow.intervals[0].fill_start, rel=ROUND_OFF)
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF


def test_contract_with_several_components():
    flow = sloshing(columns=24, rows=12)
    c = np.random.default_rng(1).random((4, len(flow.intervals[0].cells)))
    check_mixing(backend(), scene_of(flow), c / c.sum(axis=0), 1.6)


def test_ten_revolutions_of_the_drum_keep_mass_and_bounds(store):
    asked = ["grid.spacing='2 mm'", "operation.revolutions=10", "mixing.name=finite-volume"]
    case = compose(None, asked, {"flow": {"name": "surface-layer"}})
    blend = mix(case, obtain_flow(case, MPI.COMM_SELF).flow, MPI.COMM_SELF)
    assert blend.mass_drift <= ROUND_OFF
    assert blend.ledger.minimum >= -ROUND_OFF
    assert blend.ledger.maximum <= 1.0 + ROUND_OFF


def test_cut_cells_do_not_set_the_step(store):
    """The step is that of full cells, and after merging no group loses more than it holds."""
    case = compose(None, ["grid.spacing='1 mm'"], {"flow": {"name": "surface-layer"}})
    flow = obtain_flow(case, MPI.COMM_SELF).flow
    interval, grid = flow.intervals[0], flow.grid
    solver = backend()
    n = len(interval.cells)
    solver.start(scene_of(flow, grain=1e-3), np.full((2, n), 0.5))
    dt = solver.stable_time_step(interval)
    flux = interval.flux / grid.cell_volume
    fill = interval.fill_start / grid.cell_volume
    below, none = neighbours_below(grid, interval.cells), np.zeros_like(flux)
    rate = leaving_rate(below, flux, none)
    assert (rate * dt / np.maximum(fill, 1e-30)).max() > 5  # cut cells would need smaller steps
    cut = fill < 1 - 1e-14
    groups = merge(below, flux, none, np.stack([fill] * 3), cut, dt)
    number = np.arange(len(groups), len(groups) + n)
    number[groups.members] = groups.number
    leaves = np.zeros(len(groups) + n)
    for axis in range(2):
        outer = (below[axis] >= 0) & (number != number[below[axis]])
        f = flux[axis, outer]
        np.add.at(leaves, number[outer], np.maximum(-f, 0))
        np.add.at(leaves, number[below[axis][outer]], np.maximum(f, 0))
    held = np.bincount(number, weights=fill, minlength=len(leaves))
    assert (leaves * dt <= held * (1 + 1e-6) + 1e-6).all()
