"""The Mohr-Coulomb flow in space: surface, rest and yield, solver, and what is put on the grid."""

import math
from types import SimpleNamespace

import ngsolve as ngs
import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.scene.models import GRAVITY
from scaleup.space.grid import Grid
from scaleup.system.errors import InputError
from scaleup.testing import check_flow
from scaleup_mohr_coulomb.closing import GridFaces, balance, closed_fluxes
from scaleup_mohr_coulomb.revolutions import Turned, level_bed
from scaleup_mohr_coulomb.space_exchange import FaceFluxes
from scaleup_mohr_coulomb.space_flow import VesselFlow
from scaleup_mohr_coulomb.space_grid import periodic_flow
from scaleup_mohr_coulomb.space_level_set import _inside_fraction
from scaleup_mohr_coulomb.space_memory import TurnedMemory
from vessel_in_space import NOMINAL_SPEED, drum_flow

COMM = MPI.COMM_SELF
FLOW = {"name": "mohr-coulomb"}


@pytest.fixture(scope="module")
def drum():
    return drum_flow(COMM)


def test_the_part_of_a_tetrahedron_on_one_side_of_a_plane():
    """Against a fine sum over barycentric coordinates, and closed forms, equal values included."""
    rng = np.random.default_rng(1)
    points = rng.dirichlet(np.ones(4), 200_000)
    values = rng.normal(size=(20, 4))
    counted = (points @ values.T > 0).mean(axis=0)
    assert np.abs(_inside_fraction(values) - counted).max() < 6e-3
    assert _inside_fraction(np.array([1.0, -1.0, -1.0, -1.0])) == pytest.approx(1 / 8, rel=1e-12)
    assert _inside_fraction(np.array([1.0, 1.0, 1.0, -1.0])) == pytest.approx(7 / 8, rel=1e-12)
    assert _inside_fraction(np.array([1.0, 1.0, -1.0, -1.0])) == pytest.approx(1 / 2, rel=1e-12)
    assert _inside_fraction(np.array([0.0, 0.0, 1.0, 1.0])) == 1.0
    assert _inside_fraction(np.array([0.0, 0.0, 0.0, -1.0])) == 0.0


def test_the_surface_in_space_is_a_plane_that_redistancing_keeps(drum):
    """A level bed: its volume, the area of its surface, and phi once it was twice the distance."""
    level_set = drum.level_set
    level_set.set_level(-0.02, drum.volume)
    assert level_set.volume() == pytest.approx(drum.volume, rel=1e-6)
    height = float(np.mean(level_set.surface()[..., 1]))
    sides = np.diff(level_set.surface(), axis=1)
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    assert area == pytest.approx(0.05 * 2 * math.sqrt(0.07**2 - height**2), rel=5e-3)
    level_set.field.vec.FV().NumPy()[:] *= 2.0
    level_set.redistance()
    error = level_set.field - (height - ngs.y)
    rms = math.sqrt(ngs.Integrate(error * error, drum.mesh) / ngs.Integrate(1.0, drum.mesh))
    assert rms < 2e-4  # of a vessel of 140 mm, surface and wall included


def test_fluxes_through_faces_are_balanced_and_leave_a_rotation_nearly_alone(drum):
    """Of any velocity: none remains in an element, none passes the wall, neighbours agree."""
    level_set = drum.level_set
    fluxes = FaceFluxes(level_set)
    wild = np.random.default_rng(5).normal(size=level_set.nodes.shape)
    x, y, _ = level_set.nodes.T
    rotation = np.stack([-y, x, 0 * x], axis=1)
    corners = np.sort(fluxes.nodes.reshape(-1, 3), axis=1)
    _, quarter = np.unique(corners, axis=0, return_inverse=True)
    inner = np.bincount(quarter.ravel()) == 2
    for velocity, most in ((wild, math.inf), (rotation, 0.03)):
        found = fluxes.of(velocity)
        unit = np.abs(found).max()
        assert np.abs(found.sum(axis=(1, 2))).max() < 1e-12 * unit
        through = np.bincount(quarter.ravel(), found.ravel())
        assert np.abs(through[inner]).max() < 1e-6 * unit
        assert np.abs(through[~inner]).max() < 1e-6 * unit
        asked = (velocity[fluxes.nodes].mean(axis=-2) * fluxes._normals).sum(axis=-1)
        assert np.abs(found - asked).max() < most * unit


def mean_speed(flow):
    """Of the powder, m/s."""
    powder = flow.level_set.fraction
    speed = ngs.Integrate(powder * ngs.Norm(flow.velocity), flow.mesh)
    return speed / ngs.Integrate(powder, flow.mesh)


@pytest.mark.parametrize(("tilt", "most"), [(0.0, 2e-6), (15.0, 1e-3)])
def test_a_bed_below_its_friction_angle_rests_under_hydrostatic_pressure(tilt, most):
    """2.8e-3 m/s is the creep that the regularisation allows at the wall; friction angle 23.6."""
    flow = drum_flow(COMM, tilt=tilt, speed=0.0)
    for _ in range(12):
        flow.step(0.01)
    assert mean_speed(flow) < most
    deep = ngs.IfPos(flow.level_set.field - 0.02, 1.0, 0.0)  # below the blurred surface
    slope = ngs.Integrate(deep * ngs.grad(flow.pressure)[1], flow.mesh)
    hydrostatic = -1500 * GRAVITY * math.cos(math.radians(tilt))
    assert slope / ngs.Integrate(deep, flow.mesh) == pytest.approx(hydrostatic, rel=0.02)


def test_a_bed_above_its_friction_angle_avalanches():
    """From 40 deg the same bed falls towards 23.6 deg, at ten times the creep and more."""
    flow = drum_flow(COMM, tilt=40.0, speed=0.0)
    for _ in range(12):
        flow.step(0.01)
    assert mean_speed(flow) > 2.8e-2
    assert math.degrees(flow.surface_angle()) < 37.0
    assert flow.volume_moved < 1e-5  # by elements that exchange what they lose


def test_air_far_from_the_bed_does_not_matter(monkeypatch):
    """An avalanche with all of the air, and with that within three elements of the bed alone."""
    part = drum_flow(COMM, size=0.014, tilt=40.0, speed=0.0, mirrored=True)
    whole = drum_flow(COMM, size=0.014, tilt=40.0, speed=0.0, mirrored=True)
    for _ in range(6):
        part.step(0.01)
    monkeypatch.setattr("scaleup_mohr_coulomb.space_flow._FAR", math.inf)
    for _ in range(6):
        whole.step(0.01)
    at_rest = np.linalg.norm(part.velocity.vec.FV().NumPy().reshape(3, -1), axis=0) == 0.0
    assert at_rest.mean() > 0.15
    assert mean_speed(part) == pytest.approx(mean_speed(whole), rel=0.01)
    assert part.surface_angle() == pytest.approx(whole.surface_angle(), abs=math.radians(0.1))


@pytest.mark.parametrize(
    ("size", "steps", "differ"),
    [(0.014, 4, 0.25), pytest.param(0.01, 10, 0.1, marks=pytest.mark.slow)],
)
def test_half_of_a_vessel_that_is_its_own_mirror_image_flows_as_the_whole(size, steps, differ):
    """An avalanche in both, to the difference of two meshes; no powder crosses the plane.

    Speeds on two meshes of 10 mm differ by 2 %, of 14 or 20 mm by up to 20 %.
    """
    whole, half = (
        drum_flow(COMM, size=size, tilt=40.0, speed=0.0, mirrored=m) for m in (False, True)
    )
    assert half.unknowns < 0.7 * whole.unknowns
    assert half.volume == pytest.approx(0.5 * whole.volume)
    for flow in (whole, half):
        for _ in range(steps):
            flow.step(0.01)
    assert mean_speed(half) == pytest.approx(mean_speed(whole), rel=differ)
    assert half.surface_angle() == pytest.approx(whole.surface_angle(), abs=math.radians(0.3))
    plane = half.mesh.Boundaries("mirror")
    across = ngs.Integrate(half.velocity[2] ** 2, half.mesh, definedon=plane)
    along = ngs.Integrate(half.velocity * half.velocity, half.mesh, definedon=plane)
    assert across < 0.02 * along


def test_iterations_hardly_depend_on_the_mesh():
    """Within a factor of two over a factor of five in unknowns."""
    counts = {}
    for size in (0.02, 0.0098):
        flow = drum_flow(COMM, size, tilt=28.0)
        for _ in range(2):
            flow.step(0.01)
        counts[flow.unknowns] = flow.iterations / flow.steps
    assert max(counts) > 5 * min(counts)
    assert max(counts.values()) < 2.0 * min(counts.values()), counts


def test_closed_fluxes_are_exact_and_leave_a_balanced_flow_alone():
    """Random fills and fluxes on two separate parts; then the demand those fluxes have already."""
    rng = np.random.default_rng(3)
    grid = Grid((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (8, 6, 6))
    region = np.zeros(grid.shape, dtype=bool)
    region[1:5, 1:5, 1:3] = region[1:5, 1:5, 4:7] = True
    faces = GridFaces.between(grid, region, [np.ones(grid.shape, dtype=bool)] * 3)
    assert faces.groups()[0] == 2
    n = len(faces.cells)
    start, capacity = rng.uniform(0.2, 1.0, n), np.ones(n)
    end, moved = balance(faces, start, rng.uniform(0.0, 1.0, n), capacity)
    count, group = faces.groups()
    assert np.abs(np.bincount(group, end - start, count)).max() < 1e-12
    assert end.min() >= 0.0
    assert end.max() <= 1.0
    assert moved > 0.0
    given, wet = rng.normal(size=len(faces.axis)), rng.uniform(0.1, 1.0, len(faces.axis))
    flux = closed_fluxes(faces, given, wet, start - end, 1.0)
    assert np.abs(faces.missing(start - end, flux)).max() < 1e-12
    demand = -faces.missing(np.zeros(n), given)
    assert np.abs(closed_fluxes(faces, given, wet, demand, 1.0) - given).max() < 1e-12
    # nearest: the change is a gradient, so no circulation round the four cells of a square
    loop = (flux - given) / wet
    number = np.full(grid.cells, -1)
    number[faces.cells] = np.arange(n)
    at = {
        (a, lo, up): v
        for a, lo, up, v in zip(faces.axis, faces.lower, faces.upper, loop, strict=True)
    }
    a, b, c, d = (number[np.ravel_multi_index(p, grid.shape)] for p in
                  ((2, 2, 4), (2, 2, 5), (2, 3, 5), (2, 3, 4)))  # fmt: skip
    assert at[0, a, b] + at[1, b, c] - at[0, d, c] - at[1, a, d] == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_turned_bed_becomes_a_periodic_flow_field(drum, mirrored):
    """A plane bed that stays at 25 deg in the lab: contract, volume, mirror image."""
    drum = drum_flow(COMM, mirrored=True) if mirrored else drum
    case = compose(
        None, ["geometry.length='5 cm'", "grid.cells=4000"], {"geometry": {"name": "drum"}}
    )
    per_revolution, level = 24, drum.level_set
    levels, angle = [], math.radians(25.0)
    for number in range(2 * per_revolution + 1):
        lean = angle - 2 * math.pi * number / per_revolution if number > 1 else 0.0
        plane = -math.sin(lean) * ngs.x + math.cos(lean) * ngs.y
        level.field.Set(-0.02 - plane)
        level.restore_volume(drum.volume)
        levels.append(level.field.vec.FV().NumPy().copy())
    drum.velocity.Set((0.0, 0.0, ngs.z * (0.025 - ngs.z)))
    still = drum.velocity.vec.FV().NumPy().copy()
    run = Turned(
        levels=levels,
        velocities=[None, *[still] * (2 * per_revolution - 1)],
        angles=[angle] * len(levels),
        per_revolution=per_revolution,
        prefix=per_revolution,
        mismatch=0.0,
    )
    scene = SimpleNamespace(
        geometry=case.geometry,
        grid=case.grid,
        fill_volume=case.fill_volume,
        speed=NOMINAL_SPEED,
        material=case.material,
    )
    flow = periodic_flow(drum, run, scene, COMM, lambda *_: None)
    check_flow(flow, scene.geometry, scene.fill_volume)
    assert flow.frame == "vessel"
    assert len(flow.intervals[0].flux[0]) > 1000
    assert not flow.intervals[0].flux.any()  # turns rigidly
    assert flow.period == pytest.approx(2 * math.pi / NOMINAL_SPEED)
    assert all(flow.intervals[k].flux.any() for k in range(2, 2 * per_revolution))
    if mirrored:
        through = flow.intervals[30].face_fluxes(flow.grid)[2]
        assert np.abs(through + through[::-1]).max() < 1e-4 * np.abs(through).max()


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (["flow.coarse_size='20 mm'"], "belongs to the form 'plane' .* takes the form 'space'"),
        (["flow.fine_size='30 mm'"], "must be from 1.167 mm to 23.33 mm"),
        (["flow.time_step='1 us'"], "must be from 4.2e-05 s"),
    ],
)
def test_what_a_mesh_in_space_cannot_be(asked, says):
    asked = ["geometry.length='5 cm'", *asked]
    with pytest.raises(InputError, match=says):
        compose(None, asked, {"geometry": {"name": "drum"}, "flow": FLOW})


class Kept(dict):
    """A Memory in a dictionary."""

    def recall(self, inputs):
        return self.get(repr(inputs))

    def keep(self, inputs, arrays):
        self[repr(inputs)] = arrays


def test_a_run_that_was_broken_off_goes_on_where_it_was(drum):
    """What is kept brings back all intervals and the flow's state; another mesh takes none."""
    memory = Kept()
    drum.step(0.005)
    run = level_bed(drum, 24, 2)
    run.velocities.append(drum.velocity.vec.FV().NumPy().copy())
    run.levels.append(drum.level_set.field.vec.FV().NumPy().copy())
    run.angles.append(0.3)
    TurnedMemory(memory, {"scene": 1}, drum, COMM).keep(run, now=False)
    assert not memory  # not so soon
    TurnedMemory(memory, {"scene": 1}, drum, COMM).keep(run, now=True)
    phase, steps = drum.phase, drum.steps
    drum.step(0.005)
    back = TurnedMemory(memory, {"scene": 1}, drum, COMM).recall()
    assert (drum.phase, drum.steps) == (phase, steps)
    assert back.per_revolution == 24
    assert back.velocities[:2] == [None, None]
    assert all(np.array_equal(a, b) for a, b in zip(back.levels, run.levels, strict=True))
    assert np.array_equal(back.velocities[2], run.velocities[2])
    assert TurnedMemory(memory, {"scene": 2}, drum, COMM).recall() is None
    other = drum_flow(COMM, size=0.023)
    assert TurnedMemory(memory, {"scene": 1}, other, COMM).recall() is None


@pytest.mark.slow
def test_a_coarse_drum_with_end_walls_comes_to_repeat_itself(store, monkeypatch):
    """End to end at 20 rpm: the contract, a bed that turns, and no second solve on a grid."""

    def asked(cells):
        settings = [
            "geometry.length='5 cm'",
            "operation.speed='20 rpm'",
            "flow.fine_size='20 mm'",
            "flow.intervals=36",
            f"grid.cells={cells}",
        ]
        return compose(None, settings, {"geometry": {"name": "drum"}, "flow": FLOW})

    flow = obtain_flow(asked(6000), COMM).flow
    figures = flow.summary
    assert flow.prefix == 36
    assert figures["repeat_mismatch"] < 0.05
    assert figures["projection_change"] < 0.2
    assert 23.0 < figures["surface_angle_deg"] < 38.0
    assert figures["solid_body_ratio"] > 0.75  # it creeps by the length of so coarse a mesh
    assert figures["wall_rotation_ratio"] > 0.93
    assert figures["iterations_per_step"] < 60
    monkeypatch.setattr(VesselFlow, "step", None)
    coarser = obtain_flow(asked(3000), COMM).flow
    assert coarser.summary["surface_angle_deg"] == figures["surface_angle_deg"]
