"""Convex polyhedra and turned profiles: volumes, distances, solids, and shapes that cannot be."""

import math

import numpy as np
import pytest
from mpi4py import MPI
from scipy.spatial import KDTree

from scaleup.contract import FlatSolid
from scaleup.numerics import ConvexPolyhedron, Revolved, corners_within
from scaleup.system.errors import InputError
from scaleup.testing import check_geometry
from scaleup_mohr_coulomb.meshing import occ_shape
from scaleup_mohr_coulomb.space_mesh import vessel_mesh

CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
OCTAHEDRON = np.vstack([np.eye(3), -np.eye(3)])
WEDGE = 0.1 * np.array([(-1, 1, -1), (1, 1, -1), (-1, 1, 1), (1, 1, 1), (0, -1, -1), (0.2, -1, 1)])
CONES = [(-0.2, 0.03), (-0.05, 0.15), (0.05, 0.15), (0.2, 0.0)]
WAIST = [(-0.2, 0.1), (-0.1, 0.1), (-0.1, 0.08), (0.0, 0.06), (0.15, 0.1)]
ASKEW = (1.0, 2.0, -1.5)


def lying(profile=CONES, **how):
    return Revolved(None, profile, direction=(0, 0, 1), **how)


SHAPES = {
    "cube": ConvexPolyhedron(None, 0.1 * CUBE),
    "wedge": ConvexPolyhedron(None, WEDGE),
    "octahedron": ConvexPolyhedron(None, corners_within([(*n, -0.3) for n in CUBE])),
    "upright cones": Revolved(None, CONES),
    "hanging cones": Revolved(None, CONES, direction=(0, -2, 0)),
    "lying cones": lying(),
    "askew": Revolved(None, CONES, direction=ASKEW, origin=(0.01, 0.02, -0.03)),
    "waist": Revolved(None, WAIST, direction=ASKEW),
}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_shape_agrees_with_itself_and_its_solid_with_netgens(shape):
    check_geometry(shape)
    solid, occ = shape.solid(), occ_shape(shape.solid())
    assert occ.mass == pytest.approx(solid.mass, rel=1e-6)
    assert tuple(occ.center) == pytest.approx(solid.center, abs=1e-6 * shape.reach)
    assert {face.name for face in occ.faces} == {"wall"}


def test_volumes_of_polyhedra_in_closed_form():
    assert ConvexPolyhedron(None, CUBE).volume == pytest.approx(8, rel=1e-14)
    octahedron = ConvexPolyhedron(None, OCTAHEDRON)
    for level in (-0.8, -0.3, 0.0):
        assert octahedron.volume_below(level) == pytest.approx(2 / 3 * (1 + level) ** 3, rel=1e-13)
    assert len(octahedron.faces) == 8
    assert [len(face) for face in ConvexPolyhedron(None, CUBE).faces] == [4] * 6


@pytest.mark.parametrize("level", [-0.999999, -0.5, 0.0, 0.3, 1 - 1e-9])
def test_a_lying_cylinder_is_filled_to_the_segment_of_its_circle(level):
    drum = lying([(-0.2, 1.0), (0.3, 1.0)])
    half = math.acos(-level)
    exact = 0.5 * (half - math.sin(half) * math.cos(half))
    assert drum.volume_below(level) == pytest.approx(exact, rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("lean", [1e-6, 0.3, 0.8, 0.96])
def test_a_leaning_cone_is_filled_to_an_ellipse(lean):
    """Of half-angle a and lean t, to the height h: pi/3 h^3 sin^2 a cos a (cos^2 a - sin^2 t)^-1.5.

    At a lean of 0.96 the lowest generator all but lies level.
    """
    half, level = 0.6, 0.01
    cone = Revolved(
        None, [(0.0, 0.0), (9.0, 9 * math.tan(half))], (math.sin(lean), math.cos(lean), 0)
    )
    spread = (math.cos(half) ** 2 - math.sin(lean) ** 2) ** -1.5
    exact = math.pi / 3 * level**3 * math.sin(half) ** 2 * math.cos(half) * spread
    assert cone.volume_below(level) == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("name", ["askew", "waist"])
def test_what_lies_below_a_level_lies_above_it_in_the_mirror(name):
    solid, flip = SHAPES[name].solid(), np.array([1, -1, 1])
    profile = np.stack([solid.heights, solid.radii], axis=1)
    image = Revolved(None, profile, flip * solid.direction, flip * solid.origin)
    for level in np.linspace(SHAPES[name].lower[1], SHAPES[name].upper[1], 50):
        both = SHAPES[name].volume_below(level) + image.volume_below(-level)
        assert both == pytest.approx(image.volume, rel=1e-13)


@pytest.mark.parametrize("name", ["wedge", "octahedron", "askew", "waist"])
def test_distances_are_those_to_the_nearest_of_many_points_of_the_wall(name):
    shape, rng = SHAPES[name], np.random.default_rng(1)
    solid, count = shape.solid(), 20000
    if isinstance(solid, FlatSolid):
        fans = [face[[0, k, k + 1]] for face in solid.faces for k in range(1, len(face) - 1)]
        wall = np.concatenate([rng.dirichlet((1, 1, 1), count) @ corners for corners in fans])
    else:
        share, angle = rng.random(count), rng.uniform(0, 2 * math.pi, count)
        h, r = np.pad(solid.heights, 1, mode="edge"), np.pad(solid.radii, 1)
        across = np.linalg.svd(solid.direction[None, :])[2][1:]
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ across
        pieces = [
            (h[k] + share * (h[k + 1] - h[k]))[:, None] * solid.direction
            + (r[k] + share * (r[k + 1] - r[k]))[:, None] * ring
            for k in range(len(h) - 1)
        ]
        wall = solid.origin + np.concatenate(pieces)
    low, high = np.array(shape.lower), np.array(shape.upper)
    points = rng.uniform(1.5 * low - 0.5 * high, 1.5 * high - 0.5 * low, (2000, 3))
    nearest, _ = KDTree(wall).query(points)
    distance = np.abs(shape.signed_distance(points))
    assert np.all(nearest > distance - 1e-12)
    assert np.all(nearest < distance + 0.05 * shape.reach)


def test_a_mirrored_half_of_a_polyhedron_is_meshed():
    mesh = vessel_mesh(SHAPES["octahedron"].solid, 0.1, MPI.COMM_SELF, mirrored=True)
    assert set(mesh.GetBoundaries()) == {"wall", "mirror"}


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: ConvexPolyhedron(None, [*CUBE, (0.5, 0.9, 0.0)]), "(0.5, 0.9, 0) m lies within"),
        (lambda: ConvexPolyhedron(None, CUBE * (1, 1, 0)), "corners of the vessel span no body"),
        (lambda: corners_within([(*n, -1) for n in OCTAHEDRON[:5]]), "walls enclose no body"),
        (lambda: corners_within([(*n, 1) for n in OCTAHEDRON]), "walls enclose no body"),
        (lambda: Revolved(None, [(0, 1), (-1, 1)]), "heights must not fall"),
        (lambda: Revolved(None, [(0, 1), (1, -1)]), "nor its radii be below 0"),
        (lambda: Revolved(None, CONES, direction=(0, 0, 0)), "own axis must not be zero"),
        (lambda: Revolved(None, [(0, 0), (1, 0)]), "profile of the vessel encloses nothing"),
    ],
)
def test_a_shape_that_cannot_be_is_one_sentence(make, sentence):
    with pytest.raises(InputError) as caught:
        make()
    assert sentence in str(caught.value)
