"""Vessels from files as they are in the field: what is read, mended and refused, and why."""

import math

import ngsolve as ngs
import numpy as np
import pytest
import trimesh
from mpi4py import MPI
from netgen.meshing import MeshingStep
from netgen.occ import Box, OCCGeometry, Pnt

from scaleup.case.composing import compose
from scaleup.contract import InputError
from scaleup.numerics import cut_fraction, grid_over
from scaleup_mesh import Mesh
from scaleup_mohr_coulomb.space_mesh import vessel_mesh
from scaleup_tote import Tote
from scaleup_v_blender import VBlender

EDGES = (0.2, 0.25, 0.4)  # m
BOX = trimesh.creation.box(EDGES)
LITRES = 20.0


def ascii_stl(corners, name="vessel"):
    """ASCII STL of triangles (n, 3, 3)."""
    facets = (
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in corner)
        + " endloop\nendfacet\n"
        for corner in corners
    )
    return f"solid {name}\n{''.join(facets)}endsolid {name}\n"


def written(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def vessel(file, unit="m"):
    return Mesh(Mesh.Options(file=file, unit=unit))


def of_triangles(folder, mesh):
    return vessel(written(folder / "vessel.stl", mesh.export(file_type="stl")))


def of_shape(folder, shape, size):
    """The vessel of a netgen solid's triangles."""
    mesh = OCCGeometry(shape).GenerateMesh(maxh=size, perfstepsend=MeshingStep.MESHSURFACE)
    faces = [[vertex.nr - 1 for vertex in face.vertices] for face in mesh.Elements2D()]
    return of_triangles(folder, trimesh.Trimesh(np.array(mesh.Coordinates()), faces))


def refusal(file, unit="m"):
    with pytest.raises(InputError) as caught:
        vessel(file, unit)
    sentence = str(caught.value)
    assert sentence.startswith(f"geometry.file = {str(file)!r}: ")
    assert "\n" not in sentence
    return sentence


def cup(wall, radius=0.1, height=0.3):
    """The steel of an open cup, m."""
    outer = radius + wall
    rim = [[0, -wall], [outer, -wall], [outer, height], [radius, height], [radius, 0], [0, 0]]
    return trimesh.creation.revolve(np.array(rim), sections=48)


def shell(inner, wall):
    """The steel of a closed box: its outer surface, and the inner one turned inwards."""
    within = trimesh.creation.box(inner)
    within.invert()
    return trimesh.util.concatenate([trimesh.creation.box(np.array(inner) + 2 * wall), within])


@pytest.mark.parametrize(
    "steel",
    [
        cup(0.002), cup(0.02), cup(0.005, radius=1.0, height=0.3), cup(0.01, radius=0.05),
        shell((0.2, 0.3, 0.4), 0.005), shell((0.3, 0.3, 0.3), 0.03),
        trimesh.creation.annulus(r_min=0.1, r_max=0.105, height=0.8),
    ],
)  # fmt: skip
def test_the_steel_of_a_vessel_is_not_its_inside(tmp_path, steel):
    file = written(tmp_path / "steel.stl", steel.export(file_type="stl"))
    assert "bounds a wall, about" in refusal(file)


def test_what_is_concave_thin_or_cut_up_is_still_an_inside(tmp_path):
    """Their volumes are the closed forms'; plates are as thick as they were made."""
    wide = VBlender(VBlender.Options(arm_length=0.6, angle=math.radians(100)))
    shape = of_shape(tmp_path, wide.solid(), 0.03)
    assert shape.volume == pytest.approx(wide.volume, rel=0.03)
    assert math.isinf(shape.thinnest)
    for radius, height in ((0.02, 1.0), (0.5, 0.02)):
        drum = trimesh.creation.cylinder(radius=radius, height=height, sections=90)
        assert of_triangles(tmp_path, drum).volume == pytest.approx(drum.volume)
    comb = Box(Pnt(-100, -100, -50), Pnt(100, 100, 50))  # mm; nine tenths of the depth, ten plates
    for k in range(10):
        comb = comb - Box(Pnt(-93 + 20 * k, -80, -51), Pnt(-91 + 20 * k, 101, 51))
    shape = of_shape(tmp_path, comb.Scale(Pnt(0, 0, 0), 1e-3), 0.03)
    assert shape.volume == pytest.approx(4e-3 - 10 * 0.002 * 0.18 * 0.1, rel=1e-5)
    assert shape.thinnest == pytest.approx(0.002, rel=1e-4)


def test_a_plate_that_stands_free_is_a_body_within(tmp_path):
    tote = Tote(Tote.Options(baffle=True, edge_radius=0.0))
    shape = of_shape(tmp_path, tote.solid(), 0.05)
    assert shape.volume == pytest.approx(tote.volume, rel=1e-5)
    assert shape.thinnest == pytest.approx(tote.thinnest, rel=1e-4)
    assert "1 closed bodies of 0.109 litres stand in the vessel" in shape.warnings[0]
    centre = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]])  # in the plate, beside it
    assert (tote.signed_distance(centre) > 0).tolist() == [False, True]
    assert (shape.signed_distance(centre) > 0).tolist() == [False, True]


def test_cells_that_do_not_resolve_a_baffle_are_refused(tmp_path):
    trough = Box(Pnt(0, 0, 0), Pnt(300, 20, 20))
    for k in (1, 2):
        trough = trough - Box(Pnt(100 * k - 1.5, -1, -1), Pnt(100 * k + 1.5, 15, 21))
    trough.WriteStep(str(tmp_path / "small.step"))
    file = (tmp_path / "small.step").rename(tmp_path / "TROUGH.STP")
    shape = vessel(file, "mm")
    assert shape.thinnest == pytest.approx(0.003, rel=1e-6)
    assert 1e9 * shape.volume == pytest.approx(300 * 20 * 20 - 2 * 3 * 15 * 20, rel=1e-6)
    with pytest.raises(InputError, match=r"do not resolve .* 3 mm thick; take cells of 1\.5 mm"):
        compose(
            None,
            [f"geometry.file={file}", "geometry.unit=mm", "grid.spacing=2 mm"],
            {"geometry": {"name": "mesh"}},
        )
    assert refusal(file.rename(tmp_path / "drum.stl")).count("cannot be read as .stl") == 1


def folded():
    ball = trimesh.creation.icosphere(3, 0.07)
    ball.vertices[ball.vertices[:, 0] > 0.05, 0] -= 0.15
    return ball


def overlapping():
    one, other = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    other.apply_translation((0.5, 0.3, 0.2))
    return trimesh.util.concatenate([one, other])


def touching():
    """Two boxes of which one stands on the other, not united."""
    one, other = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((0.5, 0.5, 0.5))
    other.apply_translation((0.1, 0.1, 0.75))
    return trimesh.util.concatenate([one, other])


def apart():
    one, other = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    other.apply_translation((3, 0, 0))
    return trimesh.util.concatenate([one, other])


def sheet():
    """A box with a plate without thickness, whose two triangles lie back to back."""
    edge = BOX.edges_unique[0]
    plate = [*edge, len(BOX.vertices)]
    vertices = np.vstack([BOX.vertices, [0.0, 0.0, 0.0]])
    return trimesh.Trimesh(vertices, [*BOX.faces, plate, plate[::-1]], process=False)


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (folded(), "passes through itself"),
        (overlapping(), "passes through itself"),
        (touching(), "passes through itself"),
        (apart(), "holds 2 separate surfaces, side by side"),
        (sheet(), "two triangles lie back to back"),
    ],
)
def test_what_is_no_single_inside_is_refused(tmp_path, mesh, reason):
    assert reason in refusal(written(tmp_path / "it.stl", mesh.export(file_type="stl")))


def test_names_and_the_bytes_behind_the_end_do_not_matter(tmp_path):
    text = ascii_stl(BOX.triangles, "Behälter").encode("latin-1")
    binary = BOX.export(file_type="stl")
    named = "# Behälter\n".encode("latin-1")
    files = {
        "text.stl": text,
        "TAIL.STL": text + b"\x00\xff\x1a",
        "binary.Stl": b"solid \xe4" + binary[7:],
        "padded.stl": binary + bytes(300),
        "V.OBJ": named + BOX.export(file_type="obj").encode(),
        "V.OFF": BOX.export(file_type="off")
        .replace("OFF\n", "OFF\n# Behälter\n")
        .encode("latin-1"),
        "V.PLY": BOX.export(file_type="ply").replace(b"comment ", b"comment \xe4"),
        "vertex.stl": ascii_stl(BOX.triangles, "vertex 1 of an endsolid"),
    }
    for name, content in files.items():
        shape = vessel(written(tmp_path / name, content))
        assert 1e3 * shape.volume == pytest.approx(LITRES, rel=1e-6), name
        assert not shape.warnings


def test_almost_closed_surfaces_are_closed_and_it_is_said(tmp_path):
    corners = BOX.triangles.copy()
    corners[0, 0] += 1e-6  # along each axis
    shape = vessel(written(tmp_path / "gap.stl", ascii_stl(corners)))
    assert 1e3 * shape.volume == pytest.approx(LITRES, rel=1e-5)
    assert "gaps of up to 0.00173 mm were closed: vertices within 0.004 mm" in shape.warnings[0]
    corners[0, 0] += 1e-4
    sentence = refusal(written(tmp_path / "gap.stl", ascii_stl(corners)))
    assert 0.05 < float(sentence.split("gap is about ")[1].split(" mm wide, at (")[0]) < 0.2
    x, y, z = (float(t) for t in sentence.split("at (")[1].split(")")[0].split(","))
    assert np.linalg.norm(corners[0, 0] - (x, y, z)) < 2e-4
    twice = np.concatenate([BOX.triangles, BOX.triangles[3:4]])
    shape = vessel(written(tmp_path / "twice.stl", ascii_stl(twice)))
    assert 1e3 * shape.volume == pytest.approx(LITRES, rel=1e-6)
    assert "1 triangles that are listed more than once count once" in shape.warnings[0]
    lid = trimesh.creation.cylinder(radius=0.1, height=0.4, sections=90)
    lid = lid.triangles[~(lid.triangles[:, :, 2] > 0.1).all(axis=1)]
    sentence = refusal(written(tmp_path / "open.stl", ascii_stl(lid)))
    assert "not watertight; 90 edges" in sentence
    assert "the widest gap is about 200 mm wide" in sentence
    hanging = BOX.triangles.copy()
    middle = 0.5 * (hanging[0, 0] + hanging[0, 1])
    split = [[hanging[0, 0], middle, hanging[0, 2]], [middle, hanging[0, 1], hanging[0, 2]]]
    file = written(tmp_path / "hanging.stl", ascii_stl([*split, *hanging[1:]]))
    assert "a vertex lies within another triangle's edge, at (" in refusal(file)


# VTK's numbers of kinds of cells
STRIP, POLYGON, PIXEL, VOXEL, WEDGE, PYRAMID, CURVED, POLYHEDRON = 6, 7, 8, 11, 13, 14, 22, 42


def vtu(points, cells, faces=()):
    """VTU of cells (kind, vertex numbers); faces of polyhedra as VTK's streams."""
    ids = [k for _, corners in cells for k in corners]
    ends = np.cumsum([len(corners) for _, corners in cells])
    arrays = {"connectivity": ids, "offsets": ends, "types": [kind for kind, _ in cells]}
    if faces:
        streams = iter(faces)
        lengths = [len(stream) for stream in faces]
        assert all(next(streams) for _ in lengths)
        total = iter(np.cumsum(lengths))
        arrays["faces"] = [k for stream in faces for k in stream]
        arrays["faceoffsets"] = [next(total) if k == POLYHEDRON else -1 for k, _ in cells]

    def array(name, values, kind="Int64", more=""):
        text = " ".join(str(value) for value in np.ravel(values))
        return f'<DataArray type="{kind}" Name="{name}" format="ascii"{more}>{text}</DataArray>'

    return (
        '<VTKFile type="UnstructuredGrid" version="1.0"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}"><Points>'
        + array("Points", points, "Float64", ' NumberOfComponents="3"')
        + "</Points><Cells>"
        + "".join(array(name, values) for name, values in arrays.items())
        + "</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


def test_volume_cells_of_all_kinds_have_an_outside(tmp_path):
    """A voxel with a pyramid, a wedge and a polyhedron (a prism) on its sides, and a loose line."""
    points = np.array(
        [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
        + [(0.5, 0.5, 2), (2, 0, 0), (2, 0, 1), (-1, 0, 0), (-1, 0, 1)],
        dtype=float,
    )
    prism = [(0, 2, 6, 4), (0, 2, 11), (4, 6, 12), (0, 4, 12, 11), (2, 6, 12, 11)]
    stream = [len(prism), *(k for face in prism for k in (len(face), *face))]
    cells = [
        (VOXEL, range(8)),
        (PYRAMID, (4, 5, 7, 6, 8)),
        (WEDGE, (1, 3, 9, 5, 7, 10)),
        (POLYHEDRON, (0, 2, 4, 6, 11, 12)),
        (3, (0, 8)),
    ]
    file = written(tmp_path / "cells.vtu", vtu(points, cells, [stream]))
    assert vessel(file).volume == pytest.approx(1 + 1 / 3 + 1 / 2 + 1 / 2, rel=1e-12)


def test_surfaces_of_polygons_and_strips_are_read(tmp_path):
    corners = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    points = "\n".join(f"{x} {y} {z}" for x, y, z in corners)
    text = (
        f"# vtk DataFile Version 3.0\nBehälter\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n{points}\n"
        "POLYGONS 2 10\n4 0 4 6 2\n4 1 3 7 5\nTRIANGLE_STRIPS 1 11\n10 0 1 4 5 6 7 2 3 0 1\n"
    )
    file = written(tmp_path / "box.vtk", text.encode("latin-1"))
    assert vessel(file).volume == pytest.approx(1.0)


def test_curved_triangles_are_cut_at_their_nodes(tmp_path):
    """Six-node triangles of a sphere hold what four flat ones each hold, not one."""
    ball = trimesh.creation.icosphere(1, 0.1)
    middles = ball.vertices[ball.edges_unique].mean(axis=1)
    middles *= 0.1 / np.linalg.norm(middles, axis=1, keepdims=True)
    nodes = np.hstack([ball.faces, len(ball.vertices) + ball.faces_unique_edges])
    cells = [(CURVED, row) for row in nodes]
    file = written(tmp_path / "ball.vtu", vtu(np.vstack([ball.vertices, middles]), cells))
    assert vessel(file).volume == pytest.approx(trimesh.creation.icosphere(2, 0.1).volume, rel=1e-6)


def test_an_image_is_no_vessel_and_that_is_said(tmp_path):
    text = (
        "# vtk DataFile Version 3.0\nimage\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 3 3 3\n"
        "ORIGIN 0 0 0\nSPACING 1 1 1\n"
    )
    sentence = refusal(written(tmp_path / "image.vtk", text))
    assert "a surface mesh or a volume mesh is needed" in sentence


def test_a_point_of_a_v_may_be_sharp():
    """The whole V holds 2 pi R^2 L, and the count of cells comes to that, to second order."""
    shape = VBlender(VBlender.Options.model_validate({"outlet": "0 mm"}))
    exact = 2 * math.pi * shape.radius**2 * shape.length
    assert shape.volume == pytest.approx(exact, rel=1e-8)
    gaps = []
    for cells in (30, 60):
        grid = grid_over(shape.lower, shape.upper, 2 * shape.reach / cells, 1.0)
        wall = shape.signed_distance(grid.corner_points())
        gaps.append(abs(float(cut_fraction(wall).sum()) * grid.cell_volume / exact - 1))
    assert gaps[1] < 4e-3
    assert gaps[0] / gaps[1] > 2.8
    mesh = vessel_mesh(shape.solid, 0.03, MPI.COMM_SELF, mirrored=True)
    assert 2 * ngs.Integrate(ngs.CF(1), mesh) == pytest.approx(exact, rel=1e-3)


def test_a_vessel_that_cannot_be_filled_with_elements_is_one_sentence():
    shape = VBlender(VBlender.Options(outlet=0.002))
    with pytest.raises(InputError) as caught:
        vessel_mesh(shape.solid, 0.03, MPI.COMM_SELF, mirrored=True)
    assert "flow.fine_size = 0.03 m: netgen cannot fill the vessel" in str(caught.value)
