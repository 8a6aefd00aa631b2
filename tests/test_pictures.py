"""Fields for ParaView, and pictures: what is drawn is what was computed, turned the right way."""

import csv
import json
import math
import shutil

import h5py
import numpy as np
import pytest
from PIL import Image
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

from scaleup.contract import Axis, Grid
from scaleup.flow.sample_flows import rocking_box
from scaleup.report import results as results_module
from scaleup.report.bed_view import Picture, colour_map, cut, see, wall_of
from scaleup.report.results import Results, instants
from vessels import SignedDistanceVessel, TiltedBox

QUICK = ("--flow", "surface-layer", "--set", "grid.spacing=2 mm", "--revolutions", "0.5")


class Ball(SignedDistanceVessel):
    """A ball about the axis."""

    reach = 0.1
    lower, upper = (-0.1,) * 3, (0.1,) * 3

    def signed_distance(self, points):
        return self.reach - np.linalg.norm(points, axis=-1)


def _picture(phase=0.0, cells=60):
    """A ball of bed of radius 0.05 about (0.03, -0.02, 0.01) in the lab, left half component 1."""
    grid = Grid((-0.1,) * 3, (0.2 / cells,) * 3, (cells,) * 3)
    points = grid.centre_points()
    c, s = math.cos(phase), math.sin(phase)
    lab = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
    gap = 0.05 - np.linalg.norm(lab - (0.03, -0.02, 0.01), axis=-1)
    share = np.clip(0.5 + gap / grid.spacing[0], 0, 1).reshape(grid.shape)
    left = (lab[:, 0] < 0.03).astype(float).reshape(grid.shape)
    concentration = np.where(share > 0, left, np.nan)
    return Picture(grid, Axis(), 0.0, phase, share.astype("f4"), concentration.astype("f4"))


@pytest.mark.parametrize("dimension", [2, 3])
def test_paraviews_reader_finds_the_fields_of_the_hdf5_file(tmp_path, dimension):
    flow = rocking_box(dimension)
    stored = Results.of(tmp_path, flow)
    stored.create()
    for index in (0, len(flow.intervals) - 1):
        interval = flow.intervals[index]
        c = np.linspace(0, 1, len(interval.cells))
        stored.add(0.25 * index, interval, interval.start, np.stack([c, 1 - c]))
    stored.finish({"snapshots": [0.0, 0.25 * (len(flow.intervals) - 1)], "pictures": []})
    stored.write_xdmf()

    reader = vtkXdmfReader()
    reader.SetFileName(str(tmp_path / "results.xdmf"))
    reader.UpdateInformation()
    key = reader.GetExecutive().TIME_STEPS()
    information = reader.GetOutputInformation(0)
    times = [information.Get(key, n) for n in range(information.Length(key))]
    revolutions = stored.revolutions()
    assert times == pytest.approx([stored.motion.time(r) for r in revolutions])
    names = {"fill_fraction", "concentration_1", "concentration_2", "velocity_x", "velocity_y"}
    names |= {"velocity_z"} if dimension == 3 else set()
    for time, revolution in zip(times, revolutions, strict=True):
        reader.UpdateTimeStep(time)
        data = reader.GetOutputDataObject(0)
        bounds = np.array(data.GetBounds()).reshape(3, 2)[:dimension]
        lower, spacing = np.array(flow.grid.lower), np.array(flow.grid.spacing)
        assert bounds[:, 0] == pytest.approx(lower)
        assert bounds[:, 1] == pytest.approx(lower + spacing * flow.grid.counts)
        cells = data.GetCellData()
        assert {cells.GetArrayName(n) for n in range(cells.GetNumberOfArrays())} == names
        with h5py.File(tmp_path / "results.h5", "r") as file:
            group = file[f"snapshots/{revolution:012.6f}"]
            for name in names:
                seen = vtk_to_numpy(cells.GetArray(name)).reshape(flow.grid.shape)
                np.testing.assert_array_equal(seen, np.asarray(group[name]))
        # x runs fastest: the cell that VTK finds at a point is the grid's
        number = flow.intervals[0].cells[7]
        centre = np.full(3, 0.5 * flow.grid.depth)
        centre[:dimension] = flow.grid.centre_points(np.array([number]))[0]
        assert data.FindCell(centre, None, 0, 1e-12, _reference_int(), [0] * 3, [0] * 8) == number


def _reference_int():
    from vtkmodules.vtkCommonCore import reference

    return reference(0)


def test_a_ball_of_bed_casts_its_own_disc():
    wall, pixels = wall_of(Ball(None)), 200
    seen = see(_picture(), wall, pixels)
    first, other = (np.array(colour_map()(value)[:3]) for value in (1.0, 0.0))

    def like(colour):  # of that hue: brightness and the wall's veil apart
        direction = seen / np.linalg.norm(seen, axis=-1, keepdims=True)
        return (direction @ (colour / np.linalg.norm(colour))) > 0.93

    bed = like(first) | like(other)
    radius = math.sqrt(bed.sum() / math.pi) * 2 * wall.half_picture / pixels
    assert radius == pytest.approx(0.05, rel=0.03)
    columns = np.arange(pixels)[None, :] + np.zeros((pixels, 1))
    assert columns[like(first)].mean() < columns[like(other)].mean()


@pytest.mark.parametrize("phase", [0.7, 2.0, -1.2])
def test_a_bed_in_its_vessels_frame_is_turned_into_the_lab(phase):
    wall = wall_of(Ball(None))
    still, turned = see(_picture(), wall, 120), see(_picture(phase), wall, 120)
    assert np.abs(still - turned).mean() < 0.01
    for plane, centre in (("z", (0.03, -0.02)), ("x", (0.01, -0.02))):
        view = cut(_picture(phase), wall, plane, 200)
        rows, columns = np.nonzero(np.isfinite(view.values))
        left, right, low, high = view.extent
        assert left + (right - left) * (columns.mean() + 0.5) / 200 == pytest.approx(
            centre[0], abs=2e-3
        )
        assert low + (high - low) * (rows.mean() + 0.5) / 200 == pytest.approx(centre[1], abs=2e-3)


def test_a_cut_shows_the_wall_where_it_is():
    vessel = TiltedBox()
    wall = wall_of(vessel)
    grid = Grid((-0.15,) * 3, (0.01,) * 3, (30,) * 3)
    none = np.zeros(grid.shape, dtype="f4")
    view = cut(Picture(grid, Axis(), 0.0, 0.0, none, none), wall, "z", 300)
    left, right, low, high = view.extent
    area = (view.gap > 0).mean() * (right - left) * (high - low)
    assert area == pytest.approx(0.1 * 0.14, rel=0.01)


def test_velocities_of_a_repeated_interval_are_stored_once(tmp_path):
    flow = rocking_box(3)
    stored = Results.of(tmp_path, flow)
    stored.create()
    for revolution, index in ((0.0, 1), (1.0, 1), (1.5, 5)):
        interval = flow.intervals[index]
        c = np.full((2, len(interval.cells)), 0.5)
        stored.add(revolution, interval, interval.end, c)
    stored.finish({"snapshots": [0.0, 1.0, 1.5], "pictures": []})
    for revolution, index in ((0.0, 1), (1.0, 1), (1.5, 5)):
        interval, seen = flow.intervals[index], stored.snapshot(revolution)
        for axis, wanted in enumerate(interval.velocity(flow.grid)):
            field = seen["velocity_" + "xyz"[axis]].ravel()
            np.testing.assert_array_equal(field[interval.cells], wanted.astype("f4"))
    with h5py.File(tmp_path / "results.h5", "r") as file:
        first, again, other = (group["velocity_x"] for group in file["snapshots"].values())
        assert first == again  # the same object
        assert first != other


def test_pictures_on_merged_cells_hold_the_same_volume(tmp_path, monkeypatch):
    flow = rocking_box(3)
    interval = flow.intervals[0]
    c = np.random.default_rng(1).random(len(interval.cells))
    monkeypatch.setattr(results_module, "_PICTURE_CELLS", flow.grid.cells / 7)
    stored = Results.of(tmp_path, flow)
    stored.create()
    stored.add_picture(0.5, interval, interval.start, np.stack([c, 1 - c]))
    stored.finish({"snapshots": [], "pictures": [0.5]})
    picture = Results.open(tmp_path).picture(0.5)
    assert picture.grid.cells < flow.grid.cells / 7
    assert picture.phase == pytest.approx(math.pi)
    volume = picture.fill_fraction.astype(float) * picture.grid.cell_volume
    assert volume.sum() == pytest.approx(interval.fill_start.sum(), rel=1e-6)
    content = np.nansum(volume * picture.concentration)
    assert content == pytest.approx((interval.fill_start * c).sum(), rel=1e-6)


def test_pictures_are_taken_in_the_first_and_the_last_turn():
    assert instants("first", 3.0, 4) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert instants("last", 3.0, 4) == [2.0, 2.25, 2.5, 2.75, 3.0]
    assert instants("first", 0.6, 4) == [0.0, 0.25, 0.5]
    assert instants("last", 1.0, 4) == []


def test_report_makes_the_figures_of_a_run_again(scaleup, tmp_path):
    done = scaleup("simulate", *QUICK, "--animate", "--output", "run")
    assert done.returncode == 0, done.stderr
    run = tmp_path / "run"
    made = {path.name: path.read_bytes() for path in (run / "figures").iterdir()}
    page = (run / "report.html").read_text()
    with Image.open(run / "figures" / "first_revolution.gif") as animation:
        assert animation.n_frames == 17
        assert animation.info["loop"] == 0
    shutil.rmtree(run / "figures")
    (run / "report.html").unlink()
    done = scaleup("report", "run")
    assert done.returncode == 0, done.stderr
    assert {path.name: path.read_bytes() for path in (run / "figures").iterdir()} == made
    assert (run / "report.html").read_text() == page


@pytest.mark.parametrize("name", ["nothing", "."])
def test_report_of_no_run_is_said(refused, name):
    assert "is not a run folder" in refused("report", name)


def test_a_run_in_3d_leaves_its_pictures(scaleup, tmp_path):
    done = scaleup(
        "simulate", "--geometry", "v-blender", "--set", "grid.cells=3000", "--revolutions", "0.3",
        "--set", "accuracy.scrutiny=20", "--output", "run",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert figures == {"bed_first.png", "snapshots.png", "speed.png", "blend_curve.png"}
    stored = Results.open(tmp_path / "run")
    assert stored.revolutions("pictures") == [0.0, 0.125, 0.25]
    first = stored.picture(0.0)
    assert first.fill_fraction.max() <= 1 + 1e-6
    assert (tmp_path / "run" / "report.html").read_text().count("<img") == 4


def test_runs_are_compared_side_by_side(scaleup, tmp_path):
    for name, k1 in (("little", "0.04"), ("much", "0.2")):
        done = scaleup(
            "simulate", *QUICK, "--set", f"diffusion.k1={k1}", "--set", "accuracy.estimate=false",
            "--output", name,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    done = scaleup("compare", "little", "much", "--output", "side")
    assert done.returncode == 0, done.stderr
    with (tmp_path / "side" / "comparison.csv").open() as stream:
        rows = {row[0]: row[1:] for row in csv.reader(stream)}
    assert rows[""] == ["little", "much"]
    assert rows["diffusion.k1"] == ["0.04", "0.2"]
    assert not [key for key in rows if key.startswith(("geometry.", "material.", "operation."))]
    little, much = map(float, rows["I after 0.5 rev"])
    assert much < little
    report = json.loads((tmp_path / "much" / "report.json").read_text())
    assert much == pytest.approx(report["mixing"]["segregation_intensity"][-1], rel=1e-3)
    for picture in ("curves.png", "beds.png"):
        with Image.open(tmp_path / "side" / picture) as image:
            assert image.size[0] > 600
    for arguments, sentence in (
        (("little",), "give two runs or more"),
        (("little", "side"), "side: is not a finished run"),
    ):
        refused = scaleup("compare", *arguments, "--output", "other")
        assert refused.returncode == 2
        assert sentence in refused.stderr
        assert not (tmp_path / "other").exists()
