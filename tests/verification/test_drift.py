"""A law beside diffusion: component 1 drifts along gravity in `finite-volume`.

At rest dc/dt + div(w c (1 - c)) = 0: characteristics move at w (1 - 2 c), jumps at w (1 - a - b).
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.contract import Axis, ContractError, Drift, FlowField, Grid, InputError, Ledger
from scaleup.numerics import Surroundings, interval_from_dense
from scaleup.system import registry
from scaleup.system.errors import RunError
from scaleup.testing import mixing_scene
from scaleup.verification.problem import two_components, uniform_diffusion
from scaleup_finite_volume import FiniteVolume
from synthetic import sloshing

ROUND_OFF = 1e-12
SPEED = 0.2  # m/s


def settling(speed: float = SPEED, components: int = 2) -> Drift:
    """Component 1 drifts along gravity, the others with the bulk."""

    def velocities(flow, interval, time):
        down = Surroundings(flow, interval, time).down
        found = np.zeros((components, *interval.direction.shape))
        found[0] = speed * down[:, None]
        return found

    return Drift(velocities)


def box(counts: tuple[int, ...], size: float, frame: str = "lab", intervals: int = 1) -> FlowField:
    """A full box of `size` (m) along y, at rest; in the vessel's frame it turns once in 1 s."""
    h = size / counts[1]
    grid = Grid((-h,) * len(counts), (h,) * len(counts), tuple(n + 2 for n in counts))
    full = np.pad(np.full(counts[::-1], grid.cell_volume), 1)
    shapes = [np.add(grid.shape, np.eye(len(counts), dtype=int)[grid.array_axis(a)])
              for a in range(len(counts))]  # fmt: skip
    still, none = [np.zeros(shape) for shape in shapes], np.zeros((len(counts), *grid.shape))
    times = np.linspace(0.0, 1.0, intervals + 1)
    parts = [
        interval_from_dense(a, b, grid, full, full, still, none[0], none)
        for a, b in pairwise(times)
    ]
    return FlowField(grid, frame, Axis(), 2 * math.pi if frame == "vessel" else 0.0, parts)


def march(flow, laws, c, end, **options):
    """(concentrations at the end, ledger, last interval) from c (components, n)."""
    backend, ledger = FiniteVolume(FiniteVolume.Options(**options)), Ledger()
    backend.start(mixing_scene(backend, flow, MPI.COMM_SELF, laws), c)
    for index, begin, stop in flow.schedule(0.0, end):
        ledger.add(backend.advance(index, begin, stop))
    return backend.concentration(flow.intervals[index]), ledger, flow.intervals[index]


def column(n: int, initial, end: float):
    """(heights, c after, c before) in a column of n cells, 1 m high."""
    flow = box((3, n), 1.0)
    height = flow.grid.centre_points(flow.intervals[0].cells)[:, 1]
    start = initial(height)
    c, ledger, _ = march(flow, [settling()], two_components(start), end)
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF
    assert c[0].sum() == pytest.approx(start.sum(), rel=ROUND_OFF)
    return height, c[0], start


def test_the_heavy_on_top_of_the_light_fans_out():
    errors, end = [], 2.0
    for n in (32, 64, 128):
        y, c, _ = column(n, lambda y: (y > 0.5) * 1.0, end)
        exact = np.clip(0.5 * (1.0 + (y - 0.5) / (SPEED * end)), 0.0, 1.0)
        errors.append(np.abs(c - exact).mean())
    assert errors[0] < 0.02
    assert errors[2] < errors[0] / 3.5


def test_the_light_on_top_of_the_heavy_rests():
    _, c, start = column(32, lambda y: (y < 0.5) * 1.0, 2.0)
    assert np.abs(c - start).max() < ROUND_OFF


def test_jumps_move_at_their_speeds_from_the_middle_the_floor_and_the_lid():
    """0.9 below 0.3: the middle rises at 0.2 w, the pure floor at 0.9 w, the lid sinks at 0.7 w."""
    end, errors = 1.0, []
    for n in (40, 80, 160):
        y, c, _ = column(n, lambda y: np.where(y < 0.5, 0.9, 0.3), end)
        reach = SPEED * end
        exact = np.where(y < 0.5 + 0.2 * reach, 0.9, 0.3)
        exact[y < 0.9 * reach], exact[y > 1.0 - 0.7 * reach] = 1.0, 0.0
        errors.append(np.abs(c - exact).mean())
    assert errors[0] < 0.02
    assert errors[2] < errors[0] / 3


def test_smooth_waves_are_second_order_until_they_break():
    """On c = a + b sin, c is what it was where its characteristic comes from."""
    end, errors, a, b = 0.2, [], 0.3, 0.05

    def initial(y):
        return a + b * np.exp(-0.5 * ((y - 0.5) / 0.08) ** 2)

    for n in (64, 128):
        y, c, _ = column(n, initial, end)
        from_y = y.copy()
        for _ in range(50):
            from_y = y + SPEED * end * (1.0 - 2.0 * initial(from_y))
        inner = np.abs(y - 0.5) < 0.35
        errors.append(np.abs(c - initial(from_y))[inner].mean())
    assert math.log2(errors[0] / errors[1]) > 1.7


@pytest.mark.parametrize("counts", [(24, 24), (16, 16, 4)])
def test_in_a_turning_vessel_what_drifts_goes_round_in_a_circle(counts):
    """A thin component moves at w along gravity: after half a turn it lies 2 w/omega aside."""
    flow = box(counts, 1.0, "vessel", 24)
    points = flow.grid.centre_points(flow.intervals[0].cells)
    thin = 1e-6 * np.exp(-(((points[:, :2] - 0.5) / 0.12) ** 2).sum(axis=1))
    c, _, part = march(flow, [settling(0.4)], two_components(thin), 0.5)
    moved = (c[0] - thin) @ points / thin.sum()
    # from phase 0 to pi gravity points along -y, -x, +y
    assert moved == pytest.approx([-0.4 / math.pi, 0.0, 0.0][: len(counts)], abs=1e-3)
    assert c[0] @ part.fill_end == pytest.approx(thin @ part.fill_start, rel=ROUND_OFF)


@pytest.mark.parametrize("components", [2, 4])
def test_mass_and_bounds_with_a_moving_fill_diffusion_and_several_components(components):
    flow = sloshing(columns=24, rows=12)
    start = np.random.default_rng(1).integers(0, components, len(flow.intervals[0].cells))
    c = (start == np.arange(components)[:, None]).astype(float)
    drift = settling(0.02, components)
    laws = [drift, uniform_diffusion(1e-6 * np.eye(2)), drift]  # they add up
    after, ledger, interval = march(flow, laws, c, 8 * flow.period)
    change = after @ interval.fill_end / (c @ flow.intervals[0].fill_start) - 1.0
    assert np.abs(change).max() <= ROUND_OFF
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF
    assert np.abs(after[0] - c[0]).max() > 0.5


def test_the_stable_step_counts_the_drift_and_beyond_it_bounds_break():
    flow = box((3, 32), 1.0)
    backend = FiniteVolume(FiniteVolume.Options())
    layers = two_components((np.arange(96) >= 48) * 1.0)
    backend.start(mixing_scene(backend, flow, MPI.COMM_SELF, [settling()]), layers)
    step = backend.stable_time_step(flow.intervals[0])
    assert step == pytest.approx(0.5 / 32 / SPEED)
    with pytest.raises(RunError, match="limit of stability"):
        march(flow, [settling()], layers, 1.0, time_step=1.1 * step)
    forced = FiniteVolume(FiniteVolume.Options(time_step=2.5 * step))
    scene = mixing_scene(forced, flow, MPI.COMM_SELF, [settling()], force=True)
    forced.start(scene, layers)
    assert forced.advance(0, 0.0, 5 * step).minimum < -0.1


@pytest.mark.parametrize("name", ["lax-wendroff", "semi-lagrangian", "implicit-fem"])
def test_a_backend_that_does_not_solve_a_drift_says_so(name):
    plugin = registry.load("mixing", name)
    with pytest.raises(InputError, match=r"does not solve drift; it solves diffusion"):
        mixing_scene(plugin(plugin.Options()), box((3, 8), 1.0), MPI.COMM_SELF, [settling()])


def test_a_drift_that_cannot_be_is_refused():
    cells = np.zeros((2, 24))
    with pytest.raises(ContractError, match="gravity turns in its frame"):
        march(box((3, 8), 1.0, "vessel"), [settling()], cells, 0.1)
    with pytest.raises(ContractError, match="a drift of 3 components in a bed of 2"):
        march(box((3, 8), 1.0), [settling(components=3)], cells, 0.1)
