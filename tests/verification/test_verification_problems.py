"""The verification problems are right, and every registered mixing backend converges on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scaleup.contract import Ledger, Mixing
from scaleup.scene.laws import total_tensor
from scaleup.system import registry
from scaleup.system.errors import InputError
from scaleup.testing import check_flow
from scaleup.verification import fitted_order, problems, run
from scaleup.verification.bodies import gaussian, spread_gaussian, turned
from scaleup.verification.drum_layer import (
    drum_flow,
    lab_coordinates,
    layer_tensor,
    surface_coordinates,
)
from scaleup.verification.moving_fill import carried, surface
from scaleup.verification.problem import interval_at
from scaleup.verification.random_walk import advance, random_walks, velocity
from scaleup.verification.sheared_disc import ShearedDisc
from upwind import Upwind

EVERY = problems()
SMOOTH = [name for name, p in EVERY.items() if p.regime in ("smooth", "boundary")]
FEW_WALKS = 40_000


@pytest.mark.parametrize("name", EVERY)
def test_the_flow_keeps_its_contract(name):
    flow = EVERY[name].flow(EVERY[name].sizes[0])
    check_flow(flow, fill_volume=float(flow.intervals[0].fill_start.sum()))


@pytest.mark.parametrize("name", [name for name in EVERY if name != "drum-layer"])
def test_the_exact_solution_keeps_mass_and_bounds(name):
    problem = EVERY[name]
    flow = problem.flow(problem.sizes[0])
    masses = []
    for time in (0.0, problem.duration):
        interval, local = interval_at(flow, time)
        c = problem.exact(flow, time)
        assert c.min() > -1e-7
        assert c.max() < 1 + 1e-7
        masses.append(c[0] @ interval.fill(min(local, interval.end)))
    # samples of jumps and of cut cells are no better than this
    assert masses[1] == pytest.approx(masses[0], rel=1e-5 if problem.regime == "smooth" else 3e-3)


@pytest.mark.parametrize("name", ["gaussian", "full-drum", "gaussian-3d"])
def test_the_study_takes_no_step_that_lands_cells_on_cells(name):
    """Where cells land on cells, values only change places; at a part of the study they do not."""
    problem = EVERY[name]
    n = problem.sizes[0]
    asked = Asked(None)
    with pytest.raises(EndError):
        run(problem, asked, n)
    flow = problem.flow(n)

    def sorted_values(time):
        return np.sort(problem.exact(flow, time)[0])

    start = sorted_values(0.0)
    landed = sorted_values(problem.duration / problem.landings)
    assert landed == pytest.approx(start, abs=1e-9)
    assert np.abs(sorted_values(asked.end) - start).max() > 1e-3


class EndError(Exception):
    """No need to go on."""


class Asked(Mixing):
    """A backend that only says until when it was asked to go first, after the warm-up."""

    halo = 1
    end = 0.0

    def start(self, scene, concentration, index=0):
        """Nothing to do."""

    concentration = start

    def stable_time_step(self, interval):
        return np.inf

    def advance(self, index, start, end):
        self.end = end
        if end > 0.01:
            raise EndError
        return Ledger()


def residual(problem, n: int) -> float:
    """How far the exact solution is from dc/dt = -div(F c) + div(D grad c), by central differences.

    Over cells whose neighbours are full; relative to the greatest |dc/dt|.
    """
    flow = problem.flow(n)
    grid = flow.grid
    index, _, _ = list(flow.schedule(0.0, 0.4 * problem.duration))[-1]
    part = flow.intervals[index]
    steady = len(flow.intervals) == 1
    time = 0.4 * problem.duration if steady else 0.5 * (part.start + part.end)
    step = 1e-3 * problem.duration if steady else 0.25 * part.duration

    def dense(values):
        whole = np.full((*values.shape[:-1], grid.cells), np.nan)
        whole[..., part.cells] = values
        return whole.reshape(*values.shape[:-1], *grid.shape)

    def exact(at):
        return dense(problem.exact(flow, at)[0])

    full = np.minimum(part.fill_start, part.fill_end) > (1 - 1e-9) * grid.cell_volume
    c = np.where(dense(full.astype(float)) == 1, exact(time), np.nan)
    tensor = dense(total_tensor(problem.laws, flow, part))
    right = np.zeros(grid.shape)
    for axis, faces in enumerate(part.face_fluxes(grid)):
        along = grid.array_axis(axis)
        behind = np.roll(c, 1, along)
        lower = np.take(faces, range(grid.shape[along]), along)
        flux = lower * 0.5 * (c + behind) / grid.cell_volume
        for other in range(grid.dimension):
            d = 0.5 * (tensor[axis, other] + np.roll(tensor[axis, other], 1, along))
            if other == axis:
                slope = (c - behind) / grid.spacing[axis]
            else:
                across = grid.array_axis(other)
                slope = (np.roll(c, -1, across) - np.roll(c, 1, across)) / (2 * grid.spacing[other])
                slope = 0.5 * (slope + np.roll(slope, 1, along))
            flux = flux - d * slope / grid.spacing[axis]
        right -= np.roll(flux, -1, along) - flux
    left = (exact(time + step) - exact(time - step)) / (2 * step)
    known = np.isfinite(right) & np.isfinite(left)
    assert known.sum() > 0.3 * len(part.cells)
    return float(np.abs(left - right)[known].mean() / np.abs(left[known]).max())


@pytest.mark.parametrize("name", SMOOTH)
def test_flow_tensor_and_exact_solution_satisfy_the_equation_to_second_order(name):
    problem = EVERY[name]
    sizes = {"gaussian-3d": (24, 48), "sloshing-3d": (16, 32)}.get(name, (48, 96))
    coarse, fine = (residual(problem, n) for n in sizes)
    assert np.log2(coarse / fine) > 1.7
    assert fine < 0.01


def test_a_column_of_the_sloshing_bed_moves_as_its_velocity_says():
    """The closed map against Runge-Kutta steps along u = a g sin(pi x), v = -pi a g cos(pi x) y."""

    def rate(p, t):
        speed = 0.4 / np.pi * 2 * np.pi * np.cos(2 * np.pi * t)
        x, y = p.T
        return np.stack([speed * np.sin(np.pi * x), -np.pi * speed * np.cos(np.pi * x) * y], axis=1)

    start = np.random.default_rng(5).random((50, 2)) * [1.0, 0.5]
    p, h = start, 0.3 / 200
    for n in range(200):
        t = n * h
        k1 = rate(p, t)
        k2 = rate(p + h / 2 * k1, t + h / 2)
        k3 = rate(p + h / 2 * k2, t + h / 2)
        p = p + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(p + h * k3, t + h))
    for place in (0, 1):
        back = carried(lambda points, place=place: points[..., place], 0.3)(p)
        assert back == pytest.approx(start[:, place], abs=1e-9)
    top = np.stack([start[:, 0], np.full(50, 0.5)], axis=1)
    assert np.all(surface(p, 0.3) > p[:, 1])
    assert surface(top, 0.0) == pytest.approx(0.5)


def test_the_sheared_disc_is_resolved_and_has_the_right_limits():
    points = np.random.default_rng(2).random((800, 2))
    points = points[np.hypot(*(points - 0.5).T) < 0.5]
    disc = ShearedDisc(0.5, 2 * np.pi, 5e-4, (0.25, 0.0), 0.06)
    finer = replace(disc, collocation=151, modes=70)
    assert disc.concentration(1.0)(points) == pytest.approx(
        finer.concentration(1.0)(points), abs=1e-7
    )
    # at rest it spreads as in the open
    still = replace(disc, rate=0.0, centre=(0.1, 0.05)).concentration(1.0)(points)
    open_space = spread_gaussian((0.6, 0.55), 0.06, 5e-4 * np.eye(2), 1.0)
    assert still == pytest.approx(open_space(points), abs=1e-6)
    # without diffusion each circle turns by omega(r) t
    sheared = replace(disc, diffusivity=1e-12).concentration(0.3)(points)
    r = np.hypot(*(points - 0.5).T)
    turn = 2 * np.pi * (1 - 4 * r**2) * 0.3
    moved = [turned(gaussian((0.75, 0.5), 0.06), a)(p) for a, p in zip(turn, points, strict=True)]
    assert sheared == pytest.approx(np.array(moved), abs=1e-6)


def test_the_drums_face_fluxes_are_the_published_velocity():
    flow = drum_flow(280)
    part = flow.intervals[0]
    points = flow.grid.centre_points(part.cells)
    surface_points = surface_coordinates(points)
    deep = (surface_points[:, 1] < -2e-3) & (np.hypot(*points.T) < 0.068)
    published = np.array([velocity(x, y) for x, y in surface_points[deep]])
    still = lab_coordinates(np.zeros(2))
    expected = lab_coordinates(published) - still  # the mirror and turn, of a vector
    error = part.velocity(flow.grid).T[deep] - expected
    assert np.abs(error).mean() < 1e-3 * np.abs(published).max()


def test_walks_from_a_point_drift_and_spread_as_the_tensor_says():
    """For a short time: mean v t + div D t, covariance 2 D t (in surface coordinates)."""
    rng, time, count = np.random.default_rng(11), 0.002, 400_000
    place = np.array([0.01, -0.006])
    state = np.tile(place, (count, 1))
    advance(state, time / 4, 4, rng)
    flow = drum_flow(280)
    part = flow.intervals[0]
    cell = np.argmin(
        np.linalg.norm(surface_coordinates(flow.grid.centre_points(part.cells)) - place, axis=1)
    )
    lab = layer_tensor(flow, part)[:, :, cell]
    moved = lab_coordinates(state)
    spread = np.cov(moved.T)
    assert spread == pytest.approx(2 * lab * time, rel=0.03, abs=0.02 * spread.max())
    drift = state.mean(axis=0) - place - time * np.array(velocity(*place))
    normal = lab_coordinates(np.array([0.0, 1.0])) - lab_coordinates(np.zeros(2))
    across = normal @ lab @ normal
    expected = -2 * place[1] / 0.01**2 * across * time  # of exp(-(y/delta0)^2)
    noise = np.sqrt(2 * across * time / count)
    assert drift[1] == pytest.approx(expected, abs=3 * noise)
    assert expected > 6 * noise


def test_the_density_of_walks_stays_uniform():
    walks = random_walks(FEW_WALKS, 200)
    kept = walks.count[0] > 0.95 * walks.count[0].max()
    assert kept.sum() > 20
    deviation = walks.count[-1][kept] / walks.count[0][kept] - 1
    assert deviation.std() < 1.5 / np.sqrt(walks.count[0][kept].mean())
    inside = walks.concentration[-1][kept]
    assert walks.concentration.min() >= 0
    assert inside.std() > 0.01


@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("vortex", (32, 64)),
        ("gaussian-3d", (16, 32)),
        ("sloshing", (32, 64)),
        ("sloshing-3d", (16, 24)),
    ],
)
def test_implicit_upwind_is_first_order_conservative_and_bounded(name, sizes):
    """The suite finds what is known of a scheme, in 3-D and on moving fills too."""
    # a tenth of the time, so that so diffusive a scheme leaves something to compare
    problem = replace(EVERY[name], duration=0.1 * EVERY[name].duration)
    results = [run(problem, Upwind(Upwind.Options()), n) for n in sizes]
    assert 0.5 < fitted_order(results) < 1.3
    for result in results:
        assert abs(result.mass_drift) < 1e-10
        assert result.minimum > -1e-10
        assert result.maximum < 1 + 1e-10
        assert result.steps > 0
        assert result.cell_updates_per_second > 0


def backend_of(name: str):
    """The registered plugin class, and an instance with its defaults."""
    plugin = registry.load("mixing", name)
    return plugin, plugin(plugin.Options())


def results_of(backend, problem, sizes):
    try:
        return [run(problem, backend, n) for n in sizes]
    except InputError as error:
        pytest.skip(f"not available: {error}")


def converges(plugin, problem, results) -> None:
    """Order above one half; that which the plugin claims where nothing but its scheme matters."""
    order = fitted_order(results)
    assert order > 0.5, [result.l1 for result in results]
    if plugin.order is not None and problem.regime == "smooth":
        assert order > plugin.order - 0.35, [result.l1 for result in results]


@pytest.mark.parametrize("name", registry.available("mixing"))
@pytest.mark.parametrize("problem", ["vortex", "anisotropic", "sheared-disc", "full-drum"])
def test_registered_backends_converge(name, problem):
    plugin, backend = backend_of(name)
    problem = EVERY[problem]
    converges(plugin, problem, results_of(backend, problem, problem.sizes))


@pytest.mark.slow
@pytest.mark.parametrize("name", registry.available("mixing"))
@pytest.mark.parametrize(
    "problem", ["gaussian", "gaussian-diffusing", "gaussian-3d", "sloshing", "sloshing-3d"]
)
def test_registered_backends_converge_on_larger_problems(name, problem):
    plugin, backend = backend_of(name)
    problem = EVERY[problem]
    results = results_of(backend, problem, problem.sizes)
    converges(plugin, problem, results)
    if problem.name == "gaussian-diffusing":
        assert results[-1].variance_ratio == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", registry.available("mixing"))
@pytest.mark.parametrize("problem", ["zalesak", "three-bodies", "swirl-reversed", "sphere-3d"])
def test_registered_backends_reduce_the_error_of_jumps(name, problem):
    _, backend = backend_of(name)
    problem = EVERY[problem]
    coarse, *_, fine = results_of(backend, problem, problem.sizes[:2])
    assert fine.l1 < 0.85 * coarse.l1


@pytest.mark.slow
@pytest.mark.parametrize("name", registry.available("mixing"))
def test_registered_backends_agree_with_random_walks(name):
    """On the finest cells within a few sampling errors, and on coarser ones within more."""
    _, backend = backend_of(name)
    problem = EVERY["drum-layer"]
    results = results_of(backend, problem, problem.sizes)
    walks = random_walks()
    assert results[-1].l1 < 4 * walks.sampling_error(results[-1].volumes)
    assert results[-1].l1 < results[0].l1
    assert results[-1].segregation_error < 0.01
