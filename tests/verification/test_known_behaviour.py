"""What is known of tumbling blenders, with the default mixing on coarse 3-D grids."""

from itertools import pairwise

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.mixing.scene import mixing_scene
from scaleup.run.blending import mix
from scaleup.scene.laws import total_tensor
from scaleup_finite_volume import FiniteVolume
from scaleup_surface_layer import general

COMM = MPI.COMM_SELF
V = ("v-blender", "grid.cells=6e3", "flow.intervals=40")


def scene(geometry, *settings):
    return compose(None, list(settings), {"geometry": {"name": geometry}})


def blended(loading, revolutions, geometry, *settings):
    """The intensity of segregation, every half revolution, after a loading."""
    settings = [
        *settings,
        f"operation.loading.pattern={loading}",
        f"operation.revolutions={revolutions}",
        "output.metrics_every=0.5",
    ]
    case = scene(geometry, *settings)
    flow = obtain_flow(case, COMM).flow
    return np.array(mix(case, flow, COMM).intensity)


@pytest.mark.parametrize(("mixing", "bound"), [("finite-volume", 0.05), ("semi-lagrangian", 0.2)])
def test_a_v_blender_mixes_along_its_axis_much_slower_than_top_to_bottom(store, mixing, bound):
    axial = blended("front-back", 2, *V, f"mixing.name={mixing}")
    cascade = blended("top-bottom", 2, *V, f"mixing.name={mixing}")
    assert axial[-1] > 0.95  # 2 revolutions: only diffusion crosses the plane between the arms
    assert cascade[-1] < bound  # on so few cells a matter of numerical mixing too
    assert axial[-1] < axial[0] - 1e-3


def test_without_diffusion_nothing_at_all_crosses_the_mirror_plane_of_a_v_blender(store):
    case = scene(*V, "diffusion.k1=0")
    flow = obtain_flow(case, COMM).flow
    grid = flow.grid
    front = grid.centre_points(np.arange(grid.cells))[:, 2] > 0
    backend, end = start(case, flow, lambda cells: front[cells].astype(float))
    for index, begin, stop in flow.schedule(0.0, end):
        backend.advance(index, begin, stop)
    last = flow.intervals[index]
    c = backend.concentration(last)[0]
    assert np.abs(c - front[last.cells])[last.fill_end > 0].max() < 1e-9
    assert np.array_equal(np.unique(front[last.cells]), [False, True])


def start(case, flow, concentration, index=0):
    """Finite volumes on an interval, from a concentration of cells; and 1 revolution, s."""
    backend = FiniteVolume(FiniteVolume.Options())
    first = concentration(flow.intervals[index].cells)
    whole = np.stack([first, 1.0 - first])
    backend.start(mixing_scene(backend, flow, COMM, case.laws()), whole, index)
    return backend, case.operation.period


def test_a_long_drum_mixes_along_its_axis_by_diffusion_alone(store):
    """d(variance along z)/dt = 2 <D_zz>, the mean over the bed of what the model says."""
    case = scene(
        "drum",
        "geometry.length='30 cm'",
        "flow.name=surface-layer",
        "flow.intervals=40",
        "grid.spacing='10 mm'",
        "material.grain_diameter='6 mm'",
    )
    flow = obtain_flow(case, COMM).flow
    z = flow.grid.centre_points(np.arange(flow.grid.cells))[:, 2]
    band = np.exp(-0.5 * (z / 0.03) ** 2)
    backend, period = start(case, flow, lambda cells: band[cells], flow.prefix)

    def variance(interval):
        held = backend.concentration(interval)[0] * interval.fill_end
        return float(held @ z[interval.cells] ** 2 / held.sum())

    def spreads(interval):
        tensor = total_tensor(case.laws(), flow, interval)
        fill = 0.5 * (interval.fill_start + interval.fill_end)
        return float(tensor[2, 2] @ fill / fill.sum())

    times, variances = flow.times[flow.prefix] + 0.5 * period * np.arange(7), []
    for before, now in pairwise(times):
        for index, first, last in flow.schedule(before, now):
            backend.advance(index, first, last)
        variances.append(variance(flow.intervals[index]))
    expected = 2 * np.mean([spreads(part) for part in flow.intervals[flow.prefix :]])
    slope, at_start = np.polyfit(times[1:], variances, 1)
    line = at_start + slope * times[1:]
    assert slope == pytest.approx(expected, rel=0.02)
    assert np.abs(variances - line).max() < 0.02 * slope * 3 * period


def test_a_tote_mixes_along_its_axis_slower_than_along_the_cascade(store):
    tote = ("tote", "grid.cells=6e3", "flow.intervals=40")
    axial = blended("front-back", 3, *tote)
    cascade = blended("top-bottom", 3, *tote)
    assert np.log(axial[0] / axial[-1]) < 0.5 * np.log(cascade[0] / cascade[-1])


def test_half_of_a_symmetric_vessel_blends_as_the_whole(store, monkeypatch, tmp_path):
    half = blended("top-bottom", 1, *V)
    monkeypatch.setenv("SCALEUP_CACHE", str(tmp_path))
    monkeypatch.setattr(general, "upper_half", lambda geometry, grid: None)
    whole = blended("top-bottom", 1, *V)
    assert half == pytest.approx(whole, abs=5e-3)
