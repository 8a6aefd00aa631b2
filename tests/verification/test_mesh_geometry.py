"""Vessels from files: the same shape in every format, and files that are no vessel."""

import math

import meshio
import numpy as np
import pytest
import trimesh
from netgen.occ import Box, Cylinder, OCCGeometry, Pnt, X

from scaleup.case.composing import compose
from scaleup.system import registry
from scaleup.system.errors import InputError
from scaleup.testing import check_geometry

LENGTH, RADIUS = 300.0, 100.0  # mm, of a cylinder along x with a square chute at its end


def vessel(**options):
    plugin = registry.load("geometry", "mesh")
    return plugin(plugin.Options.model_validate(options))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The same vessel, in mm, as STEP, STL, OBJ, a tetrahedral MSH and a surface VTU."""
    folder = tmp_path_factory.mktemp("vessels")
    solid = Cylinder(Pnt(0, 0, 0), X, r=RADIUS, h=LENGTH)
    solid += Box(Pnt(-50, -50, -50), Pnt(0, 50, 50))
    solid.WriteStep(str(folder / "vessel.step"))
    mesh = OCCGeometry(solid).GenerateMesh(maxh=20)
    points = np.array(mesh.Coordinates())
    faces, cells = (
        np.array([[v.nr - 1 for v in element.vertices] for element in elements])
        for elements in (mesh.Elements2D(), mesh.Elements3D())
    )
    surface = trimesh.Trimesh(points, faces)
    for suffix in ("stl", "obj", "ply"):
        surface.export(folder / f"vessel.{suffix}")
    both = [("tetra", cells), ("triangle", faces)]
    meshio.Mesh(points, both).write(folder / "vessel.msh", file_format="gmsh22")
    meshio.Mesh(points, [("triangle", faces)]).write(folder / "vessel.vtu")
    return folder


HELD = {"unit": "mm", "axis_direction": [1, 0, 0], "up": [0, 0, 1], "axis_point": [0, 0, 0]}
EXACT = 1e-9 * (math.pi * RADIUS**2 * LENGTH + 100 * 100 * 50)  # m^3


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "msh", "vtu"])
def test_every_format_gives_the_same_vessel(files, suffix):
    shape = vessel(file=files / f"vessel.{suffix}", **HELD)
    reference = vessel(file=files / "vessel.ply", **HELD)
    # STL and OBJ keep seven digits or so; the MSH's outside is that of its tetrahedra
    assert shape.volume == pytest.approx(reference.volume, rel=1e-6)
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (2000, 3))
    gap = np.abs(shape.signed_distance(points) - reference.signed_distance(points))
    assert gap.max() < 1e-6
    assert shape.volume_below(0.0) == pytest.approx(shape.volume / 2, rel=5e-3)


def test_a_mesh_agrees_with_itself_and_with_closed_forms(files):
    shape = vessel(file=files / "vessel.step", **HELD)
    check_geometry(shape)
    assert shape.volume == pytest.approx(EXACT, rel=1e-3)
    assert shape.reach == pytest.approx(0.1, rel=1e-6)
    assert shape.lower == pytest.approx((-0.1, -0.1, -0.05), abs=1e-4)
    # many points (lattice) and few (search) give the same distances near the wall
    points = np.random.default_rng(2).uniform(shape.lower, shape.upper, (200_000, 3))
    many, few = shape.signed_distance(points), shape.signed_distance(points[:50_000])
    near = np.abs(few) < 5e-3
    assert np.array_equal(many[:50_000][near], few[near])
    assert np.abs(many[:50_000] - few).max() < 0.35 / 48
    assert np.array_equal(np.sign(many[:50_000]), np.sign(few))


def test_the_vessel_is_held_as_asked(tmp_path):
    """A cylinder about the file's y, hung off centre: its axis becomes z, `up` becomes y."""
    cylinder = trimesh.creation.cylinder(radius=0.1, height=0.4, sections=180)
    cylinder.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [1, 0, 0]))
    cylinder.export(tmp_path / "c.stl")
    shape = vessel(
        file=tmp_path / "c.stl", unit="m", axis_direction=[0, -2, 0], up=[1, 5, 0],
        axis_point=["30 mm", 0.0, 0.0],
    )  # fmt: skip
    assert shape.upper[2] == pytest.approx(0.2, abs=1e-6)
    assert shape.lower[1] == pytest.approx(-0.13, abs=1e-6)
    assert shape.reach == pytest.approx(0.13, rel=1e-3)
    assert shape.symmetry == ((0.0, 0.0, 1.0),)
    balanced = vessel(file=tmp_path / "c.stl", unit="m", axis_direction=[0, 1, 0], up=[1, 0, 0])
    assert balanced.reach == pytest.approx(0.1, rel=1e-3)
    with pytest.raises(InputError, match="has no solid"):
        balanced.solid()


def test_a_changed_file_is_another_vessel(tmp_path):
    file = tmp_path / "v.stl"
    trimesh.creation.box((0.2, 0.2, 0.2)).export(file)
    first = vessel(file=file, unit="m")
    trimesh.creation.box((0.2, 0.3, 0.2)).export(file)
    second = vessel(file=file, unit="m")
    assert second.volume == pytest.approx(1.5 * first.volume)
    assert second.fingerprint != first.fingerprint


def _box(path, change):
    mesh = trimesh.creation.box((0.2, 0.3, 0.4)).subdivide()
    faces, vertices = np.array(mesh.faces), np.array(mesh.vertices)
    if change == "hole":
        faces = faces[1:]
    elif change == "turned":
        faces[0] = faces[0][::-1]
    elif change == "inside out":
        faces = faces[:, ::-1]
    elif change == "flat":  # a vertex on its neighbour's edge: a triangle without area
        middle = vertices[faces[0][:2]].mean(axis=0)
        vertices = np.vstack([vertices, middle])
        faces = np.vstack([faces, [*faces[0][:2], len(vertices) - 1]])
    elif change == "two":
        faces = np.vstack([faces, faces + len(vertices)])
        vertices = np.vstack([vertices, 0.5 * vertices])
    elif change == "mm":
        vertices = 1e3 * vertices
    trimesh.Trimesh(vertices, faces, process=False).export(path)


@pytest.mark.parametrize(
    ("change", "assignments", "sentence"),
    [
        ("hole", [], "not watertight; 3 edges do not lie between two triangles"),
        ("turned", [], "neighbouring triangles have opposite orientations"),
        ("flat", [], "1 triangles are degenerate (no area)"),
        ("two", [], "holds 2 separate surfaces"),
        ("mm", [], "reaches 180.3 m from its axis and holds 2.4e+10 litres, but must reach 5 mm"),
        ("", ["geometry.unit=mm"], "holds 2.4e-08 litres, but must reach 5 mm to 20 m; check"),
        ("", ["operation.fill.volume_fraction=1.1"], "volume_fraction = 1.1: must be below 1"),
        ("", ["geometry.unit=furlong"], "geometry.unit = 'furlong': must be 'm', 'cm'"),
        ("", ["geometry.axis_point=[0.5, 0, 0]"], "the axis of rotation misses the vessel"),
        ("", ["geometry.up=[0, 0, 3]"], "geometry.up = [0.0, 0.0, 3.0]: must not be zero"),
        ("", ["geometry.axis_direction=[0, 0, 0]"], "geometry.axis_direction = [0.0, 0.0, 0.0]"),
        ("", ["operation.fill.mass=100"], "operation.fill.mass = 100 kg: the vessel holds 36 kg"),
        ("", ["geometry.file=gone.stl"], "geometry.file = 'gone.stl': path does not point"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_vessel_is_one_sentence(tmp_path, change, assignments, sentence):
    _box(tmp_path / "box.stl", change)
    flags = {"geometry": {"name": "mesh"}, "mixing": {"name": "lax-wendroff"}}
    base = [f"geometry.file={tmp_path / 'box.stl'}", "geometry.unit=m"]
    with pytest.raises(InputError) as caught:
        compose(None, [*base, *assignments], flags)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_unit_must_be_given_and_an_unreadable_file_is_said(tmp_path):
    _box(tmp_path / "box.stl", "inside out")
    assert vessel(file=tmp_path / "box.stl", unit="m").volume == pytest.approx(0.024)  # turned
    flags = {"geometry": {"name": "mesh", "file": str(tmp_path / "box.stl")}}
    with pytest.raises(InputError, match=r"geometry\.unit: field required"):
        compose(None, [], flags)
    (tmp_path / "noise.msh").write_text("not a mesh")
    (tmp_path / "noise.xyz").write_text("not a mesh")
    for name in ("noise.msh", "noise.xyz"):
        with pytest.raises(InputError, match="cannot be read as"):
            vessel(file=tmp_path / name, unit="m")
    (tmp_path / "v.step").write_text("")
    with pytest.raises(InputError, match="must be 'mm' for STEP"):
        vessel(file=tmp_path / "v.step", unit="m")


@pytest.mark.parametrize(
    ("change", "settings", "sentence"),
    [
        ("hole", [], "not watertight"),
        ("", ["geometry.axis_point=['1 m', 0, 0]"], "the axis of rotation misses the vessel"),
    ],
)
def test_the_command_line_says_it_and_writes_nothing(refused, tmp_path, change, settings, sentence):
    _box(tmp_path / "box.stl", change)
    texts = ["geometry.file=box.stl", "geometry.unit=m", "mixing.name=lax-wendroff", *settings]
    arguments = [word for text in texts for word in ("--set", text)]
    assert sentence in refused("simulate", "--geometry", "mesh", *arguments, "--output", "run")
    assert [p.name for p in tmp_path.iterdir()] == ["box.stl"]
