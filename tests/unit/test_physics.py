"""Loading, diffusion tensor, metrics and the drum, against closed forms."""

import math

import numpy as np
import pytest

from scaleup.case.composing import compose
from scaleup.measure.metrics import Sampler, blend_time, decay_rate
from scaleup.mixing.loading import initial_concentration
from scaleup.scene.models import Diffusion, Loading, Material
from scaleup.scene.shear_diffusion import diffusion_tensor
from scaleup.space.flow_field import Axis, FlowField, Interval
from scaleup.space.grid import Grid
from scaleup.system.errors import ContractError, InputError
from scaleup.testing import check_geometry
from synthetic import sloshing


def box_of_powder(u, v, cells=40, size=0.04) -> tuple[FlowField, Interval]:
    """A full square of powder in the lab frame with a given velocity field (closed or not)."""
    h = size / cells
    grid = Grid((-size / 2, -size / 2), (h, h), (cells, cells), depth=0.01)
    x, y = np.meshgrid(grid.centres(0), grid.centres(1))
    xf, yf = grid.corners(0)[:-1], grid.corners(1)[:-1]
    flux = np.stack(
        [
            u(*np.meshgrid(xf, grid.centres(1))).ravel() * grid.face_area(0),
            v(*np.meshgrid(grid.centres(0), yf)).ravel() * grid.face_area(1),
        ]
    )
    relative = np.stack([u(x, y) + y, v(x, y) - x]).reshape(2, -1)  # minus rotation at 1 rad/s
    length = np.linalg.norm(relative, axis=0)
    direction = np.divide(relative, length, out=np.zeros_like(relative), where=length > 1e-12)
    fill = np.full(grid.cells, grid.cell_volume)
    rate = np.abs(np.gradient(u(x, y), h, axis=0) + np.gradient(v(x, y), h, axis=1)).ravel()
    part = Interval(0.0, 1.0, np.arange(grid.cells), fill, fill, flux, rate, direction)
    return FlowField(grid, "lab", Axis(), 1.0, [part]), part


def inner(grid: Grid) -> np.ndarray:
    mask = np.zeros(grid.shape, dtype=bool)
    mask[2:-2, 2:-2] = True
    return mask.ravel()


def test_rigid_rotation_diffuses_in_the_paper_model_only():
    flow, part = box_of_powder(lambda x, y: -y, lambda x, y: x)
    d, inside = 1e-3, inner(flow.grid)
    objective = diffusion_tensor(flow, part, Diffusion(), d)
    assert np.abs(objective[:, :, inside]).max() < 1e-18
    paper = diffusion_tensor(flow, part, Diffusion(model="paper"), d)
    assert paper[0, 0][inside] == pytest.approx(0.04 * 2.9 * d**2, rel=1e-9)


def test_simple_shear_diffuses_k2_along_and_k1_across():
    rate, d = 10.0, 1e-3
    flow, part = box_of_powder(lambda x, y: rate * y - y, lambda x, y: x)
    tensor = diffusion_tensor(flow, part, Diffusion(k1=0.05, k2_ratio=2.0), d)
    inside = inner(flow.grid)
    assert tensor[0, 0][inside] == pytest.approx(0.1 * rate * d**2, rel=1e-9)
    assert tensor[1, 1][inside] == pytest.approx(0.05 * rate * d**2, rel=1e-9)
    assert np.abs(tensor[0, 1][inside]).max() < 1e-18


def test_the_paper_model_refuses_a_vessel_frame():
    flow = sloshing()
    with pytest.raises(InputError, match="lab frame only"):
        diffusion_tensor(flow, flow.intervals[0], Diffusion(model="paper"), 1e-3)


def test_layers_share_the_volume_as_asked():
    flow = sloshing(columns=40, rows=30)
    first = flow.intervals[0]
    for pattern in ("side-by-side", "top-bottom"):
        shares = (0.2, 0.5, 0.3)
        c = initial_concentration(Loading(pattern=pattern, shares=shares), flow)
        assert c.sum(axis=0) == pytest.approx(1.0, abs=1e-15)
        assert (c @ first.fill_start) / first.fill_start.sum() == pytest.approx(shares, abs=0.02)


def test_a_region_holds_its_area():
    flow = sloshing(columns=40, rows=30)
    loading = Loading(pattern="region", centre=("0.2 m", "0.15 m"), radius="0.08 m")
    with pytest.raises(InputError, match="there is nothing to blend"):
        initial_concentration(loading.model_copy(update={"radius": 5.0}), flow)
    c = initial_concentration(loading, flow)
    volume = c[0] @ flow.intervals[0].fill_start
    assert volume == pytest.approx(math.pi * 0.08**2 * flow.grid.depth, rel=5e-3)


def test_loading_is_laid_in_the_level_bed_and_lifted():
    lift = math.radians(30)
    flow, _ = box_of_powder(lambda x, y: 0 * x, lambda x, y: 0 * x)
    lifted = FlowField(flow.grid, "lab", Axis(), 1.0, flow.intervals, lift=lift)
    c = initial_concentration(Loading(), lifted)[0]
    points = flow.grid.centre_points()
    side = points @ np.array([math.cos(lift), math.sin(lift)])
    clear = np.abs(side) > 2e-3
    assert np.array_equal(c[clear] > 0.5, side[clear] < 0)


def test_metrics_of_known_states():
    flow, part = box_of_powder(lambda x, y: 0 * x, lambda x, y: 0 * x, cells=60)
    sampler = Sampler(flow.grid, part, 0.0, edge=3 * flow.grid.spacing[0])
    segregated = (flow.grid.centre_points()[:, 0] < 0).astype(float)
    state = sampler.measure(segregated)
    assert state.intensity == pytest.approx(1.0, abs=1e-3)
    assert state.rsd == pytest.approx(1.0, abs=1e-6)
    assert state.lacey == pytest.approx(0.0, abs=1e-6)
    uniform = sampler.measure(np.full(flow.grid.cells, 0.5))
    assert (uniform.intensity, uniform.rsd) == pytest.approx((0.0, 0.0), abs=1e-12)
    rng = np.random.default_rng(0)
    noise = rng.random(flow.grid.cells)
    state = sampler.measure(noise)
    assert state.intensity == pytest.approx(1 / 3, rel=0.05)  # var 1/12 over 1/4
    assert state.intensity_sample == pytest.approx(1 / 27, rel=0.15)  # nine cells a sample


def test_laceys_index_is_that_of_grains_drawn_from_the_concentrations():
    flow, part = box_of_powder(lambda x, y: 0 * x, lambda x, y: 0 * x, cells=100)
    sampler = Sampler(flow.grid, part, 0.0, edge=flow.grid.spacing[0])
    rng, grains = np.random.default_rng(2), 20
    for spread in (0.0, 0.1, 0.4):
        c = np.clip(0.5 + spread * rng.standard_normal(flow.grid.cells), 0, 1)
        drawn = rng.binomial(grains, c) / grains
        unmixed = drawn.mean() * (1 - drawn.mean())
        index = (unmixed - drawn.var()) / (unmixed - unmixed / grains)
        state = sampler.measure(c)
        assert state.lacey == pytest.approx(index, abs=0.01)
        assert 0 <= state.lacey <= 1


def test_blend_time_is_the_last_crossing_and_decay_is_the_rate():
    revolutions = list(np.linspace(0, 6, 61))
    rsd = [math.exp(-r) for r in revolutions]
    assert blend_time(revolutions, rsd, 0.05) == pytest.approx(-math.log(0.05), rel=1e-6)
    assert blend_time(revolutions[:20], rsd[:20], 0.05) is None
    assert decay_rate(revolutions, rsd) == pytest.approx(1.0)
    rsd[50] = 0.2  # above once more
    assert blend_time(revolutions, rsd, 0.05) > 5.0


def test_the_drum_is_what_it_says():
    case = compose(None, [], {"flow": {"name": "surface-layer"}})
    drum = case.geometry
    check_geometry(drum)
    true_distance = drum.signed_distance
    drum.signed_distance = lambda points: 7 * true_distance(points)
    with pytest.raises(ContractError, match="slope 1"):
        check_geometry(drum)
    assert drum.volume == pytest.approx(math.pi * 0.07**2 * 0.01)
    assert drum.volume_below(0.0) == pytest.approx(drum.volume / 2)
    assert case.fill_volume / drum.volume == pytest.approx(0.31192, abs=1e-5)


def test_friction_conventions():
    assert Material().friction == pytest.approx(math.tan(math.radians(23.6)))
    coaxial = Material(friction_measured="mohr-coulomb")
    assert coaxial.friction == pytest.approx(math.sin(math.radians(23.6)))
