"""The general surface-layer model: against the closed form, and what must hold in any vessel."""

import math

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.contract import Material, Scene
from scaleup.flow.storage import read_flow, write_flow
from scaleup.numerics import grid_over, level_height
from scaleup.testing import check_flow
from scaleup_drum import Drum
from scaleup_surface_layer import SurfaceLayer, sandpile
from scaleup_surface_layer import general as general_model
from scaleup_surface_layer.cell_sets import component_volumes, put_remainder, spread_cure
from scaleup_surface_layer.continuity import close_balance, find_segments
from scaleup_surface_layer.lab_columns import BedState, BedStep, Columns
from scaleup_surface_layer.layer_closing import Quality, close_interval
from scaleup_surface_layer.sandpile import relax, slope_law
from scaleup_surface_layer.turned_vessel import ColumnShape
from scaleup_surface_layer.vessel_frame import VesselFrame
from vessels import TiltedBox, Vee, closed_drum

SPEED = 2 * math.pi / 10
PHI = math.radians(23.6)


def general(vessel, cells, fill, speed=SPEED, **options):
    """The general model's flow in a vessel `cells` across, filled to a share of its volume."""
    grid = grid_over(vessel.lower, vessel.upper, 2 * vessel.reach / cells, vessel.depth)
    scene = Scene(vessel, Material(), speed, fill * vessel.volume, grid)
    plugin = SurfaceLayer(SurfaceLayer.GeneralOptions(**options))
    plugin.check(vessel, speed)
    return plugin.solve(scene, MPI.COMM_SELF, lambda share, message: None, None)


def flux_down_the_surface(flow, number, angle, places, half_width):
    """Depth-integrated flux relative to rigid rotation, per width, m^2/s, at distances s."""
    part, grid = flow.intervals[number], flow.grid
    phase = 0.5 * (part.start + part.end) * flow.angular_velocity
    x, y = grid.centre_points(part.cells).T[:2]
    down = -math.cos(angle - phase), -math.sin(angle - phase)
    moved = np.zeros(len(x))
    for axis, faces in enumerate(part.face_fluxes(grid)[:2]):
        along = grid.array_axis(axis)
        n = grid.shape[along]
        both = np.take(faces, range(n), along) + np.take(faces, range(1, n + 1), along)
        moved += 0.5 * both.ravel()[part.cells] * grid.spacing[axis] * down[axis]
    s = x * down[0] + y * down[1]
    return np.array([moved[abs(s - place) < half_width].sum() for place in places])


def drum_error(flow, angle, b, radius, width):
    """L1 error of the flux against omega/2 (L^2 - s^2), and the relative error at mid-bed."""
    half_chord = math.sqrt(radius**2 - b**2)
    places = np.linspace(-0.9, 0.9, 19) * half_chord
    half = 0.05 * half_chord
    numbers = range(flow.prefix, len(flow.intervals), 5)
    q = np.mean([flux_down_the_surface(flow, n, angle, places, half) for n in numbers], axis=0)
    q /= 2 * half * width
    exact = 0.5 * flow.angular_velocity * (half_chord**2 - places**2 - half**2 / 3)
    return np.abs(q - exact).sum() / exact.sum(), abs(q[9] / exact[9] - 1)


def known_drum(cells, intervals=120):
    """Vessel-frame intervals of the drum whose surface and flux are given in closed form."""
    drum, b = Drum(Drum.Options()), 0.3 * 0.07
    radius, spacing = drum.radius, 2 * drum.radius / cells
    grid = grid_over(drum.lower, drum.upper, spacing, drum.depth)
    columns = Columns(-radius, spacing, cells, -0.5 * drum.depth, drum.depth, 1)
    x = columns.centres_x()
    faces = columns.x0 + spacing * np.arange(cells + 1)
    s = -(faces - b * math.sin(PHI)) / math.cos(PHI)
    flux_x = -0.5 * SPEED * np.maximum(radius**2 - b**2 - s**2, 0.0)[:, None]
    surface = -b * math.cos(PHI) + (x - b * math.sin(PHI)) * math.tan(PHI)
    depth = np.maximum(surface + np.sqrt(np.maximum(radius**2 - x**2, 0.0)), 0.0)
    states = [
        BedState(2 * math.pi * n / intervals, surface[:, None], depth[:, None])
        for n in range(intervals + 1)
    ]
    volume = drum.volume_below(-b)
    frame = VesselFrame(drum, grid, columns, SPEED, volume, 11.1)
    none = np.zeros((cells, 2))
    steps = [BedStep(states[n], states[n + 1], flux_x, none) for n in range(intervals)]
    return frame, steps, volume


def test_fluxes_of_a_known_surface_need_a_correction_that_falls_faster_than_the_grid():
    corrections = []
    for cells in (32, 64, 128):
        frame, steps, volume = known_drum(cells)
        frame.begin(steps[0])
        quality = Quality()
        seconds = 2 * math.pi / SPEED / len(steps)
        assert frame.fill.sum() == pytest.approx(volume, rel=1e-13)
        for n, step in enumerate(steps[:6]):
            draft = frame.move([step])
            part = close_interval(frame, draft, [step], n * seconds, (n + 1) * seconds, quality)
            moves = np.abs(part.flux).max(axis=0) > 0
            # the passive bed has exactly no flux
            assert moves.sum() < 0.75 * (frame.fill > 0).sum()
        corrections.append(quality.correction / quality.model)
    orders = np.log2(np.array(corrections[:-1]) / corrections[1:])
    assert orders.min() > 1.0
    assert corrections[-1] < 0.005


def test_general_model_converges_to_the_closed_form_of_the_drum():
    """The default, 467 cells across, is finer."""
    sizes = (40, 80, 160, 320)
    drum, b = Drum(Drum.Options()), 0.3 * 0.07
    fill = drum.volume_below(-b) / drum.volume
    errors = []
    for cells in sizes:
        flow = general(drum, cells, fill)
        check_flow(flow, drum, fill * drum.volume)
        angle = math.radians(flow.summary["surface_angle_deg"])
        assert math.degrees(angle) == pytest.approx(23.6, abs=0.5)
        errors.append(drum_error(flow, angle, b, drum.radius, drum.depth))
    l1, midbed = np.array(errors).T
    assert -np.polyfit(np.log(sizes), np.log(l1), 1)[0] >= 1.0
    assert l1[-1] < 0.005
    assert midbed[-1] < 0.005
    assert not flow.warnings


VESSELS = {"closed drum": closed_drum, "tilted box": TiltedBox, "vee": Vee}


@pytest.fixture(scope="module", params=VESSELS)
def solved(request):
    vessel = VESSELS[request.param]()
    return vessel, general(vessel, 28, 0.4, intervals=40)


def test_flow_in_any_vessel_keeps_the_contract(solved, tmp_path):
    vessel, flow = solved
    check_flow(flow, vessel, 0.4 * vessel.volume)
    assert (flow.frame, len(flow.intervals) - flow.prefix) == ("vessel", 40)
    assert flow.summary["volume_drift"] < 1e-13
    assert flow.summary["flux_correction"] < 0.12
    assert flow.summary["volume_stuck"] < 1e-3
    assert flow.period == pytest.approx(2 * math.pi / SPEED)
    last = flow.intervals[len(flow.intervals) - 1]
    assert 0 < (last.shear_rate > 0).sum() < 0.8 * len(last.cells)
    write_flow(tmp_path / "flow.h5", flow, MPI.COMM_SELF)
    stored = read_flow(tmp_path / "flow.h5")
    check_flow(stored, vessel, 0.4 * vessel.volume)
    again = stored.intervals[flow.prefix]
    assert np.array_equal(again.flux, flow.intervals[flow.prefix].flux)
    assert np.array_equal(stored.ever_active(), flow.ever_active())


def test_coarse_cells_of_a_lazy_flow_keep_the_contract(solved):
    vessel, flow = solved
    check_flow(flow.coarsened(2), fill_volume=0.4 * vessel.volume)


def test_half_of_a_symmetric_vessel_equals_the_whole(monkeypatch):
    halved = general(Vee(), 24, 0.3, intervals=60)
    monkeypatch.setattr(general_model, "upper_half", lambda geometry, grid: None)
    whole = general(Vee(), 24, 0.3, intervals=60)
    layers = whole.grid.counts[2] // 2
    for number in (10, 30, 50):
        one, other = (flow.intervals[number].face_fluxes(flow.grid) for flow in (halved, whole))
        peak = max(np.abs(faces).max() for faces in one)
        assert peak > 0
        assert np.abs(one[2][layers]).max() == 0.0  # nothing crosses the plane of symmetry
        for faces, others in zip(one[:2], other[:2], strict=True):
            assert np.abs(faces - faces[::-1]).max() < 1e-6 * peak
            assert np.abs(faces - others).sum() < 0.02 * np.abs(faces).sum()


def test_a_heap_is_a_cone_in_every_direction():
    n, width, mu = 48, 1.0, math.tan(PHI)
    columns = Columns(-0.5, width / n, n, -0.5, width / n, n)
    lines = (n, n, 1, 1)
    shape = ColumnShape(
        np.zeros(lines), np.ones(lines), np.ones((n, n)), np.zeros((n, n)), np.ones((n, n)), 0.0
    )
    x, z = np.meshgrid(columns.centres_x(), columns.centres_z(), indexing="ij")
    r = np.hypot(x, z)
    source = np.where(r < 1.1 * columns.dx, 0.2, 0.0)
    law = slope_law(mu, 1.0, 1.0, 0.01)
    held, total = np.zeros((n, n)), 60 * source.sum()
    for step in range(80):
        held, _, _ = relax(columns, shape, held + (source if step < 60 else 0.0), law, 0.02)
    assert held.sum() == pytest.approx(total, rel=1e-13)
    height = (3 * total * columns.dx * columns.dz * mu**2 / math.pi) ** (1 / 3)
    cone = np.maximum(height - mu * r, 0.0)
    assert np.abs(held - cone).sum() / total < 0.02
    mirrored = (held[::-1], held[:, ::-1], held.T)
    assert max(np.abs(held - other).max() for other in mirrored) < 1e-6
    ring = abs(r - 0.5 * height / mu) < 0.1 * height / mu
    slope = np.hypot(*np.gradient(held, columns.dx))
    assert 0.97 * mu < slope[ring].min()
    assert slope[ring].max() < 1.02 * mu
    diagonal = ring & (np.abs(np.abs(x) - np.abs(z)) < 0.2 * r)
    straight = ring & (np.minimum(np.abs(x), np.abs(z)) < 0.2 * r)
    assert slope[diagonal].mean() == pytest.approx(slope[straight].mean(), rel=0.01)


def test_a_step_that_begins_on_wide_columns_ends_as_one_on_fine_columns_alone(monkeypatch):
    """The same heap on a floor with a wall, to the error of the grid; volume to round-off."""
    n, mu = 40, math.tan(PHI)
    columns = Columns(0.0, 1 / n, n, 0.0, 1 / (n - 6), n - 6)
    opened = np.ones((n, n - 6))
    opened[:, -1] = 0.0
    opened[n // 2, : n // 3] = 0.0
    lines = (n, n - 6, 1, 1)
    low, high = np.zeros(opened.shape), np.full(opened.shape, 0.3)
    shape = ColumnShape(np.zeros(lines), np.full(lines, 0.3), opened, low, high, 0.0)
    start = np.zeros(opened.shape)
    start[8:14, 4:12] = 0.25
    law = slope_law(mu, 1.0, 1.0, 0.01)
    by_levels, qx, qz = relax(columns, shape, start, law, 0.02)
    balance = start - np.diff(0.02 * qx, axis=0) / columns.dx
    balance -= np.diff(0.02 * qz, axis=1) / columns.dz
    assert np.abs(balance - by_levels).max() < 1e-14
    assert by_levels.sum() == pytest.approx(start.sum(), rel=1e-13)
    assert by_levels.min() >= 0.0
    assert np.abs(by_levels[opened == 0]).max() == 0.0
    monkeypatch.setattr(sandpile, "FEWEST", 1000)
    at_once, _, _ = relax(columns, shape, start, law, 0.02)
    difference = np.abs(by_levels - at_once).sum() / start.sum()
    assert 1e-9 < difference < 0.05


def test_a_drum_in_wide_and_fine_columns_has_the_exact_flux():
    """72 columns across, of which steps begin on 36: omega/2 (R^2 - b^2) at mid-bed, to 0.2 %."""
    drum = closed_drum()
    flow = general(drum, 20, 0.3, intervals=40, column_spacing=2 * drum.radius / 72)
    assert flow.summary["columns"][0] == 72
    b = -level_height(drum, 0.3 * drum.volume)
    exact = 0.5 * SPEED * (drum.radius**2 - b**2)
    assert flow.summary["flux_midbed"] == pytest.approx(exact, rel=2e-3)
    assert flow.summary["detector_steep"] < 0.02


def test_segments_without_a_neighbour_are_balanced_too():
    """Two cells one above the other and nothing beside: continuity alone."""
    below, beside = np.array([-1, 0]), np.full((1, 2), -1)
    segments = find_segments(below, beside)
    flux, gain = np.ones((1, 2)), np.array([-3.0, 3.0])
    through = close_balance(segments, below, flux, np.ones((1, 2)), gain)
    assert segments.faces.count == 1
    assert np.array_equal(through, [0.0, 3.0])
    assert np.abs(flux).max() == 0.0


def test_a_million_cells_keep_their_volume_to_the_round_off_of_one():
    """Shares of a remainder would be less than the round-off of each cell's fill."""
    after = np.random.default_rng(3).uniform(0.2, 0.8, 1_000_000)
    capacity, component = np.ones_like(after), np.zeros(len(after), dtype=np.int32)
    before = after.copy()
    before[7] += 3e-11
    gain, room = component_volumes(component, 1, before, after, capacity)
    assert gain[0] == pytest.approx(-3e-11, rel=1e-4)
    spread_cure(component, gain / room, after, capacity)
    gain, _ = component_volumes(component, 1, before, after, capacity)
    assert abs(gain[0]) > 1e-11
    put_remainder(component, gain, after, capacity)
    assert abs(component_volumes(component, 1, before, after, capacity)[0][0]) < 1e-15


def test_a_balance_of_many_segments_closes_in_every_cell():
    """90,000 cells in 900 segments of great fluxes: every cell closes to its own fluxes' digits."""
    n, ids = 90_000, np.arange(90_000).reshape(30, 30, 100)
    below = np.full((3, 30, 30, 100), -1, dtype=np.int32)
    below[0, 1:], below[1, :, 1:], below[2, :, :, 1:] = ids[:-1], ids[:, :-1], ids[..., :-1]
    below = below.reshape(3, n)
    random = np.random.default_rng(1)
    flux, gain = random.normal(size=(2, n)), 1e-3 * random.normal(size=n)
    gain -= gain.mean()
    gain[n // 2] -= math.fsum(gain)
    segments = find_segments(below[2], below[:2])
    along = close_balance(segments, below[2], flux, random.uniform(1e-3, 1, (2, n)), gain)
    net = np.zeros(n)
    for row, through in zip(below, (*flux, along), strict=True):
        inner = row >= 0
        np.add.at(net, np.flatnonzero(inner), through[inner])
        np.subtract.at(net, row[inner], through[inner])
    assert np.abs(net - gain).max() < 2e-14 * np.abs(flux).max()


def test_detectors_tell_what_is_wrong_and_when():
    fast = general(Vee(radius=0.3), 24, 0.4, speed=2 * math.pi * 20 / 60, intervals=24)
    said = " ".join(fast.warnings)
    assert "free fall" in said
    assert " deg" in said
    assert fast.summary["detector_slump"] > 0.3
    calm = general(closed_drum(), 24, 0.3, intervals=40, shear_rate=100.0)
    assert calm.summary["detector_slump"] < fast.summary["detector_slump"]
