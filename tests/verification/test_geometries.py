"""Vessels: volumes in closed form, distances, symmetry, sizes, and shapes that cannot be."""

import math

import numpy as np
import pytest

from scaleup.case.composing import compose
from scaleup.system import registry
from scaleup.system.errors import ContractError, InputError
from scaleup.testing import check_geometry

THREE_D = [("drum", {"end_walls": True}), ("tote", {}), ("v-blender", {})]


def vessel(name, **options):
    plugin = registry.load("geometry", name)
    return plugin(plugin.Options.model_validate(options))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *THREE_D,
        ("drum", {"baffles": 4}),
        ("drum", {"baffles": 3, "length": "0.1 m", "baffle_height": "20 mm"}),
        ("tote", {"edge_radius": 0}),
        ("tote", {"size": "plant", "tilt": "20 deg", "turn": "30 deg"}),
        ("tote", {"size": "pilot", "baffle": True, "tilt": "15 deg"}),
        ("v-blender", {"size": "plant", "angle": "60 deg", "axis_height": "1 m"}),
    ],
)
def test_a_vessel_agrees_with_itself_and_with_its_solid(name, options):
    check_geometry(vessel(name, **options))


def test_volumes_in_closed_form():
    drum = vessel("drum", diameter=0.2, length=0.5)
    assert drum.volume == pytest.approx(math.pi * 0.01 * 0.5, rel=1e-12)
    assert drum.volume_below(0.0) == pytest.approx(drum.volume / 2, rel=1e-12)
    v = vessel("v-blender", arm_diameter=0.2, arm_length=0.4, outlet=1e-9)
    assert v.volume == pytest.approx(2 * math.pi * 0.01 * 0.4, rel=1e-8)
    sharp = {"length": 1.2, "width": 1, "height": 0.9, "hopper": 0.5, "outlet": 0.3}
    a, b = 1.2, 0.09
    frustum = 0.5 / 6 * (a + b + (1.2 + 0.3) * (1 + 0.3))  # prismatoid: middle section halfway
    tote = vessel("tote", **sharp, edge_radius=0, tilt="25 deg", turn="10 deg")
    assert tote.volume == pytest.approx(1.2 * 0.9 + frustum, rel=1e-12)
    upright = vessel("tote", **sharp, edge_radius=0, axis_height=0.5)
    assert upright.volume_below(0.0) == pytest.approx(frustum, rel=1e-12)


def test_rounded_edges_take_away_what_a_quarter_circle_leaves():
    """Of a slim bin nearly all edge is upright: four times (1 - pi/4) r^2 a length."""
    sizes = {"length": 1, "width": 1, "hopper": 0.5, "outlet": 0.6, "edge_radius": 0.1}
    low, high = (vessel("tote", **sizes, height=h) for h in (10, 11))
    assert high.volume - low.volume == pytest.approx(1 - (4 - math.pi) * 0.01, rel=1e-9)


@pytest.mark.parametrize(("name", "options"), [*THREE_D, ("tote", {"baffle": True, "tilt": 0.3})])
def test_distances_are_those_to_the_nearest_wall(name, options):
    """A ball of that radius is inside, and a slightly larger one is not."""
    shape, rng = vessel(name, **options), np.random.default_rng(3)
    points = rng.uniform(shape.lower, shape.upper, (4000, 3))
    distance = shape.signed_distance(points)
    points, distance = points[distance > 0][:300], distance[distance > 0][:300]
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    smaller = points[:, None] + 0.999 * distance[:, None, None] * directions
    assert shape.signed_distance(smaller).min() > 0
    larger = points[:, None] + 1.05 * distance[:, None, None] * directions
    # the V's crotch is farther away than the cylinders that meet in it
    assert np.mean(shape.signed_distance(larger).min(axis=1) < 0) > 0.98


def test_the_axis_is_where_it_is_asked_to_be():
    upright, tilted = vessel("tote", axis_height=0.1), vessel("tote", axis_height=0.1, tilt=0.4)
    assert upright.lower[1] == pytest.approx(-0.1, abs=1e-12)
    assert upright.symmetry == ((0.0, 0.0, 1.0),)
    assert tilted.symmetry == ()
    assert tilted.volume == pytest.approx(upright.volume, rel=1e-12)
    top = np.array([0.0, 0.15, 0.0])  # in the bin's own frame
    there = [0.0, 0.15 * math.cos(0.4), 0.15 * math.sin(0.4)]  # the top leans towards +z
    assert tilted.signed_distance(np.array(there)) == pytest.approx(upright.signed_distance(top))
    balanced = vessel("v-blender")
    below = [
        balanced.volume_below(y) for y in np.linspace(*(balanced.lower[1], balanced.upper[1]), 2001)
    ]
    moment = np.trapz(below, dx=(balanced.upper[1] - balanced.lower[1]) / 2000)
    # integral of y dV = y_top V - integral of V_below dy
    assert balanced.upper[1] * balanced.volume - moment == pytest.approx(0, abs=1e-6 * moment)


def test_a_square_bin_turned_by_an_eighth_is_still_its_mirror_image():
    assert vessel("tote", turn="45 deg").symmetry
    assert not vessel("tote", turn="30 deg").symmetry
    assert not vessel("tote", length=0.3, turn="45 deg").symmetry


def test_sizes_grow_at_one_froude_number_and_given_dimensions_win():
    litres = {"drum": (3, 200, 4000), "tote": (14, 300, 2000), "v-blender": (8, 100, 1500)}
    for name, wanted in litres.items():
        closed = {"end_walls": True} if name == "drum" else {}
        for size, litre in zip(("lab", "pilot", "plant"), wanted, strict=True):
            shape = vessel(name, size=size, **closed)
            assert 1e3 * shape.volume == pytest.approx(litre, rel=0.1)
            options = type(shape).Options(size=size, **closed)
            speed = float(shape.default_scene(options)["operation"]["speed"].removesuffix(" rpm"))
            froude = (speed * 2 * math.pi / 60) ** 2 * shape.reach / 9.8
            assert 1e-4 < froude < 1e-2  # the rolling regime
    assert vessel("drum", size="plant", diameter="1 m").reach == 0.5
    assert vessel("tote", size="plant", height="0.5 m").volume < vessel("tote", size="plant").volume


@pytest.mark.parametrize(
    ("name", "assignments", "sentence"),
    [
        ("drum", ["geometry.baffles=4", "geometry.baffle_thickness=1 mm", "grid.spacing=2 mm"],
         "grid: cells of 2 mm do not resolve a part of the vessel that is 1 mm thick"),
        ("drum", ["geometry.diameter=50 m"], "the vessel reaches 25 m from its axis"),
        ("drum", ["geometry.baffles=20", "geometry.baffle_height=6 cm"], "meet at their tips"),
        ("drum", ["geometry.baffles=4"], "holds for a circular cross-section about the axis"),
        ("drum", ["geometry.end_walls=true", "geometry.width=1"], "takes a length, not a width"),
        ("tote", ["geometry.axis_height=1"], "the axis of rotation misses the vessel"),
        ("tote", ["geometry.outlet=0.5"], "geometry.outlet = 0.5 m: must be below geometry.length"),
        ("tote", ["geometry.edge_radius=0.1"], "geometry.edge_radius = 0.1 m: too round"),
        ("tote", ["geometry.baffle=true", "geometry.baffle_width=1"], "not lie inside the bin"),
        ("tote", ["operation.fill.mass=40"], "operation.fill.mass = 40 kg: the vessel holds"),
        ("v-blender", ["geometry.arm_length=5 cm"], "geometry.arm_length = 0.05 m: must be above"),
        ("v-blender", ["geometry.angle=10 deg"], "geometry.angle = '10 deg'"),
        ("v-blender", ["operation.fill.volume_fraction=1.1"], "fill.volume_fraction = 1.1"),
    ],
)  # fmt: skip
def test_a_vessel_that_cannot_be_is_one_sentence(name, assignments, sentence):
    flags = {"geometry": {"name": name}, "mixing": {"name": "lax-wendroff"}}
    with pytest.raises(InputError) as caught:
        compose(None, assignments, flags)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"volume": 1.01}, "volume_below(top)"),
        ({"symmetry": ((0.0, 0.0, 1.0),)}, "differs from its mirror image"),
        ({"reach": 1.2}, "the inside reaches"),
        ({"upper": (0.1, 0.9, 0.1)}, "beyond the box"),
    ],
)
def test_the_checks_see_what_is_wrong(change, sentence):
    shape = vessel("tote", tilt=0.3)
    for key, value in change.items():
        setattr(shape, key, value if isinstance(value, tuple) else value * getattr(shape, key))
    with pytest.raises(ContractError) as caught:
        check_geometry(shape)
    assert sentence in str(caught.value)


def test_a_solid_that_lies_elsewhere_is_seen():
    shape = vessel("v-blender")
    moved = shape.solid().Move((0.0, 0.004, 0.0))
    shape.solid = lambda: moved
    with pytest.raises(ContractError, match="centre of volume is at"):
        check_geometry(shape)
