"""Stated limits of the explicit backends: never too long a step, and what lies beyond fails."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.system import registry
from scaleup.system.errors import RunError
from scaleup.verification.stability_map import breaks_bounds, grows, maker, uniform_scene

SCHEMES = {
    "lax-wendroff corrected": ("lax-wendroff", {}),
    "lax-wendroff flux-corrected": ("lax-wendroff", {"form": "flux-corrected"}),
    "lax-wendroff paper": ("lax-wendroff", {"form": "paper"}),
    "finite-volume": ("finite-volume", {}),
}
BOUNDED = ("lax-wendroff flux-corrected", "finite-volume")


def make(scheme: str):
    name, options = SCHEMES[scheme]
    plugin = registry.load("mixing", name)
    return maker(plugin, plugin.Options(**options))


def theory(scheme: str):
    return import_module(f"scaleup_{SCHEMES[scheme][0].replace('-', '_')}.stability")


def random_numbers(rng, dimension: int, count: int):
    """Courant numbers in random directions and random symmetric positive tensors."""
    nu = rng.standard_normal((dimension, count)) * rng.random(count) ** 2
    root = rng.standard_normal((dimension, dimension, count)) * rng.random(count)
    return nu, np.einsum("ikn,jkn->ijn", root, root) * rng.random(count) ** 2


def greatest_amplification(scheme: str, nu, mu, waves: int) -> np.ndarray:
    dimension = len(nu)
    angles = np.linspace(-np.pi, np.pi, waves)
    every = np.stack(np.meshgrid(*[angles] * dimension)).reshape(dimension, -1)
    if nu.shape[1] == 1:
        return theory(scheme).amplification(nu, mu, every).max(keepdims=True)
    worst = np.zeros(nu.shape[1])
    for theta in every.T:
        worst = np.maximum(worst, theory(scheme).amplification(nu, mu, theta[:, None]))
    return worst


@pytest.mark.parametrize("scheme", ["lax-wendroff corrected", "finite-volume"])
@pytest.mark.parametrize(("dimension", "count", "waves"), [(2, 6_000, 33), (3, 1_000, 15)])
def test_the_stated_condition_has_no_false_stable(scheme, dimension, count, waves):
    nu, mu = random_numbers(np.random.default_rng(3), dimension, count)
    low, high = np.zeros(count), np.full(count, 1e3)
    for _ in range(60):  # scale every case to the condition's boundary
        middle = 0.5 * (low + high)
        inside = theory(scheme).stability_number(nu * middle, mu * middle) <= 1.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    worst = greatest_amplification(scheme, nu * low, mu * low, waves)
    assert worst.max() <= 1.0 + 1e-9


def scene_and_limit(scheme: str, courant: float, number: float, angle: float):
    backend = make(scheme)(None)
    scene = uniform_scene(backend, courant, number, angle, MPI.COMM_SELF)
    backend.start(scene, np.full((2, scene.flow.grid.cells), 0.5))
    return scene, backend.stable_time_step(scene.flow.intervals[0])


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_stated_limit_holds_in_random_directions(scheme):
    rng = np.random.default_rng(5)
    for _ in range(12):
        angle, number = float(rng.uniform(0, 360)), float(rng.choice([0.0, 0.05, 0.5]))
        scene, limit = scene_and_limit(scheme, 1.0, number, angle)
        assert not grows(make(scheme), scene, 0.98 * limit), (angle, number)
        if scheme in BOUNDED:
            assert not breaks_bounds(make(scheme), scene, 0.98 * limit), (angle, number)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("angle", "number"), [(0.0, 0.05), (24.0, 0.01), (45.0, 0.01)])
def test_beyond_the_exact_limit_noise_grows(scheme, angle, number):
    """The exact limit is von Neumann's, by bisection on the amplification of all waves."""
    direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])[:, None]
    mu = number * np.eye(2)[:, :, None]
    low, high = 0.1, 5.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        grown = greatest_amplification(scheme, direction * middle, mu * middle, 49)[0] > 1 + 1e-9
        low, high = (low, middle) if grown else (middle, high)
    scene, stated = scene_and_limit(scheme, 1.0, number, angle)
    assert stated <= low * (1 + 1e-6)
    assert not grows(make(scheme), scene, 0.98 * low)
    assert grows(make(scheme), scene, 1.1 * low)


@pytest.mark.parametrize("scheme", BOUNDED)
def test_a_bounded_scheme_breaks_its_bounds_beyond_its_limit(scheme):
    scene, limit = scene_and_limit(scheme, 1.0, 0.0, 0.0)
    assert breaks_bounds(make(scheme), scene, 1.1 * limit)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_step_beyond_the_limit_is_refused_and_growth_is_caught_within_100_steps(scheme):
    scene, limit = scene_and_limit(scheme, 1.0, 0.0, 45.0)
    careful = replace(scene, force=False)
    rough = np.random.default_rng(0).integers(0, 2, scene.flow.grid.cells).astype(float)
    start = np.stack([rough, 1.0 - rough])
    with pytest.raises(RunError, match=r"time_step = .* limit of stability .* is "):
        run_for(make(scheme)(1.3 * limit), careful, start, 1.0)
    # a backend whose limit were wrong: the values alone must stop it
    step = 2.5 * limit
    backend = make(scheme)(step)
    backend.start(careful, start)
    transport = backend.running
    transport.bed.stable_step = 1.01 * step
    with pytest.raises(RunError, match=r"(x = .* m.* reduce mixing\.time_step|the scheme grows)"):
        backend.advance(0, 0.0, 100 * step)


def run_for(backend, scene, start, duration):
    backend.start(scene, start)
    backend.advance(0, 0.0, duration)
