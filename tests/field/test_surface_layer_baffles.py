"""Beds that hang and layers faster than a fall are said, or are no result."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.contract import FlowField, Interval, RunError
from scaleup.flow import source as flow_source
from scaleup.flow.bed_lean import LeanOfBed, require_held
from scaleup.flow.check import check_shared_flow
from scaleup.numerics import cut_fraction, grid_over
from scaleup.run.blending import mix
from scaleup_drum import Drum

BAFFLED = (
    "flow.name=surface-layer",
    "flow.model=general",
    "flow.intervals=40",
    "geometry.diameter='160 mm'",
    "geometry.baffle_thickness='6 mm'",
    "operation.speed='15 rpm'",
    "operation.revolutions=0.5",
    "mixing.name=semi-lagrangian",
    "material.grain_diameter='2 mm'",
    "grid.spacing='2.8 mm'",
)


@pytest.fixture(scope="module", autouse=True)
def store(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SCALEUP_CACHE", str(tmp_path_factory.mktemp("store")))
        yield


def solved(*settings, geometry="drum"):
    case = compose(None, settings, {"geometry": {"name": geometry}})
    return case, flow_source.obtain_flow(case, MPI.COMM_SELF).flow


def test_a_baffled_bed_rolls_at_all_times_and_blends_about_as_without():
    intensity = []
    for baffles in (0, 3):
        case, flow = solved(
            *BAFFLED, f"geometry.baffles={baffles}", "geometry.baffle_height='20 mm'"
        )
        intensity.append(mix(case, flow, MPI.COMM_SELF).intensity[-1])
        assert flow.summary["bed_lean_deg"][1] < 23.6 + 3
    assert flow.summary["volume_stuck"] < 2e-3
    assert 0.01 < flow.summary["volume_detoured"] < 0.15
    assert flow.summary["flux_correction"] < 0.15
    assert "lifts no powder" in " ".join(flow.warnings)
    assert intensity[1] == pytest.approx(intensity[0], rel=0.3)


def test_baffles_that_take_the_layers_way_are_refused():
    with pytest.raises(RunError, match=r"no result: .* around parts inside .*volume_detoured"):
        solved(*BAFFLED, "geometry.baffles=3", "geometry.baffle_height='60 mm'")


def test_both_forms_have_the_same_detectors():
    """Fine grains in a large, slow drum: faster than half of a frictionless fall."""
    large = ("flow.name=surface-layer", "geometry.size=plant", "grid.cells=600")
    fine = "material.grain_diameter='50 um'"
    said, figures = [], []
    for form in (["flow.model=closed-form"], ["flow.model=general", "flow.intervals=40"]):
        _, flow = solved(*large, fine, *form)
        said.append(" ".join(flow.warnings))
        figures.append(flow.summary)
    names = [name for name in figures[1] if name.startswith("detector_")]
    assert len(names) == 5
    for name in names:
        assert figures[0][name] == pytest.approx(figures[1][name], rel=0.1, abs=0.02)
    assert figures[0]["detector_slump"] > 0.5
    assert all("of free fall" in text and "set flow.shear_rate" in text for text in said)


def drum_bed(angle):
    """A drum's grid, capacity and the fill of a plane bed that leans by an angle."""
    drum = Drum(Drum.Options())
    grid = grid_over(drum.lower, drum.upper, drum.radius / 24, drum.depth)
    volume, corners = drum.volume_below(-0.3 * drum.radius), grid.corner_points()
    wall = drum.signed_distance(corners)
    normal = np.array([-math.sin(angle), math.cos(angle)])
    capacity = (cut_fraction(wall) * grid.cell_volume).ravel()
    low, high = -drum.radius, drum.radius
    for _ in range(60):
        level = 0.5 * (low + high)
        fill = (cut_fraction(np.minimum(wall, level - corners @ normal)) * grid.cell_volume).ravel()
        low, high = (level, high) if fill.sum() < volume else (low, level)
    return drum, grid, capacity, fill


@pytest.mark.parametrize("degrees", [-120.0, 0.0, 24.0, 80.0, 150.0])
def test_the_lean_of_a_plane_bed_is_its_slope_however_the_grid_has_turned(degrees):
    drum, grid, capacity, fill = drum_bed(math.radians(degrees))
    lean = LeanOfBed(grid, capacity, drum.axis, fill.sum())
    some = np.flatnonzero(fill)
    none = np.zeros(0, dtype=np.int64)
    found = lean.of(some, fill[some], none, np.zeros(0), phase=0.3)
    off = math.degrees(found - 0.3) - degrees
    assert (off + 180) % 360 == pytest.approx(180, abs=1.0)


def test_a_bed_that_turns_with_the_vessel_hangs_and_is_refused():
    drum, grid, _, fill = drum_bed(0.0)
    cells = np.flatnonzero(fill)
    n, omega = len(cells), 2 * math.pi / 10
    held = fill[cells]
    intervals = [
        Interval(t, t + 1.0, cells, held, held, np.zeros((2, n)), np.zeros(n), np.zeros((2, n)))
        for t in (0.0, 1.0, 2.0)
    ]
    flow = FlowField(grid, "vessel", drum.axis, omega, intervals)
    lowest, highest = check_shared_flow(flow, drum, float(fill.sum()), MPI.COMM_SELF)
    assert math.degrees(lowest) == pytest.approx(36.0, abs=1.0)
    assert math.degrees(highest) == pytest.approx(108.0, abs=1.0)
    with pytest.raises(RunError, match="its bed leans by 108 deg"):
        require_held(lowest, highest, math.radians(23.6), 0.003)
    standing = replace(flow, frame="lab")
    assert check_shared_flow(standing, drum, float(fill.sum()), MPI.COMM_SELF)[1] < 0.02


def test_fast_beds_that_inertia_lifts_are_no_fault():
    """37.5 deg at a Froude number of 0.07 and twice the friction angle at 0.5."""
    require_held(0.0, math.radians(37.5), math.radians(23.6), 0.07)
    require_held(-0.1, math.radians(90.0), math.radians(23.6), 0.5)
