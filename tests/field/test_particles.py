"""Particle twins: grains, samples, fields and the engine against what is known exactly."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scaleup.case.composing import compose
from scaleup.contract import Axis, Grid, InputError, Loading
from scaleup.particles.coarse_graining import coarse_grained
from scaleup.particles.colouring import components_of
from scaleup.particles.computing import Computation
from scaleup.particles.contact import Contact
from scaleup.particles.deck import FRAMES, Deck, Wall
from scaleup.particles.dumps import dumps_in, read_dump, write_dump, write_grains
from scaleup.particles.engine import Engine, where
from scaleup.particles.overlaps import overlaps
from scaleup.particles.pouring import Grains, poured
from scaleup.particles.samples import measure, noise
from scaleup.particles.twin import run_particles
from scaleup.particles.walls import smoothness, triangles_of, write_stl
from scaleup.report.comparison import compare
from scaleup.report.results import Results
from scaleup.run.output_folder import check_output, open_folder
from scaleup.system.errors import RunError

needs_engine = pytest.mark.skipif(
    where() is None, reason="the engine liggghts is not installed ('make particles' installs it)"
)
RNG = np.random.default_rng(3)


def some_grains(count, low=0.0, high=1.0):
    position = RNG.uniform(low, high, (count, 3))
    return Grains(position, RNG.standard_normal((count, 3)), RNG.uniform(0.01, 0.03, count))


@pytest.mark.parametrize("dimension", [2, 3])
def test_fields_hold_what_grains_do(dimension):
    """Mass, content and momentum; grains beyond the vessel and the grid's edge included."""
    grid = Grid((0.0,) * dimension, (0.1,) * dimension, (10,) * dimension)
    grains = some_grains(200)
    component = RNG.integers(0, 3, 200)
    inside = np.linalg.norm(grid.centre_points() - 0.5, axis=1) < 0.45
    fields = coarse_grained(grid, inside, grains, component, width=0.05)
    volume = grains.volume
    assert fields.volume.sum() == pytest.approx(volume.sum(), rel=1e-13)
    for number, content in enumerate(fields.content):
        assert content.sum() == pytest.approx(volume[component == number].sum(), rel=1e-13)
    momentum = (volume[:, None] * grains.velocity).sum(axis=0)[:dimension]
    assert fields.momentum.sum(axis=1) == pytest.approx(momentum, rel=1e-11)


def test_noise_is_that_of_binomial_draws():
    """Over all outcomes of three samples, each with its own chance and number of grains."""
    numbers, chances = np.array([2, 3, 5]), np.array([0.2, 0.9, 0.5])
    weight = numbers / numbers.sum()
    true = weight @ (chances - weight @ chances) ** 2
    expected = 0.0
    for drawn in itertools.product(*(range(n + 1) for n in numbers)):
        probability = math.prod(
            math.comb(n, k) * p**k * (1 - p) ** (n - k)
            for n, k, p in zip(numbers.tolist(), drawn, chances, strict=True)
        )
        c = np.array(drawn) / numbers
        seen = weight @ (c - weight @ c) ** 2 - noise(weight, c, numbers)
        expected += probability * seen
    assert expected == pytest.approx(true, rel=1e-12)


def test_random_mixtures_and_unmixed_powder():
    places = np.stack(np.meshgrid(np.arange(40), np.arange(40)), axis=-1).reshape(-1, 2) + 0.5
    volume, lower = np.ones(1600), np.zeros(2)
    mixed = measure(places, volume, RNG.integers(0, 2, 1600).astype(float), lower, 5.0, 10.0)
    apart = measure(places, volume, (places[:, 0] < 20).astype(float), lower, 5.0, 10.0)
    assert mixed.raw == pytest.approx(mixed.floor, rel=0.5)
    assert abs(mixed.intensity) < 0.5 * mixed.floor
    assert 0.85 < apart.intensity <= apart.raw <= 1.0


def test_dumps_and_what_is_wrong_with_them(tmp_path):
    grains, box = some_grains(7), np.array([[0.0, 0, 0], [1, 1, 1]])
    write_dump(tmp_path / "grains.120.txt", 120, grains, box)
    frame = read_dump(dumps_in(tmp_path)[120])
    assert frame.step == 120
    for name in ("position", "velocity", "radius"):
        np.testing.assert_allclose(getattr(frame.grains, name), getattr(grains, name), rtol=1e-8)
    text = (tmp_path / "grains.120.txt").read_text()
    (tmp_path / "grains.240.txt").write_text(text[: len(text) // 2])
    with pytest.raises(RunError, match=r"grains\.240\.txt: is no whole dump"):
        read_dump(tmp_path / "grains.240.txt")


@pytest.mark.parametrize("geometry", ["drum", "v-blender"])
def test_walls_are_closed_and_on_the_vessel(geometry):
    vessel = compose(None, [f"geometry.name={geometry}"]).geometry
    length = vessel.depth if vessel.dimension == 2 else 0.0
    corners = triangles_of(vessel, 0.05 * vessel.reach, length)
    away = np.abs(vessel.signed_distance(corners.reshape(-1, 3)[:, : vessel.dimension]))
    assert np.quantile(away, 0.9) < 1e-6 * vessel.reach
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(across, axis=1)
    if vessel.dimension == 2:
        assert area.sum() == pytest.approx(2 * math.pi * vessel.reach * length, rel=1e-3)
    else:  # closed: the volume by Gauss' theorem is the vessel's
        volume = abs(np.einsum("ij,ij->i", corners.mean(axis=1), 0.5 * across).sum()) / 3
        assert volume == pytest.approx(vessel.volume, rel=0.02)
    assert smoothness(corners) > 0


def test_poured_grains_have_the_mass_and_touch_nothing():
    case = compose(None, ["geometry.name=drum", "material.grain_diameter=4 mm"])
    computation = Computation(case, Path("unused"), 1)
    length, contact = computation.length, computation.contact
    grains = poured(case.geometry, contact, computation.mass, length, seed=1)
    mass = case.fill_volume * case.material.bulk_density * length / case.geometry.depth
    assert contact.density * grains.volume.sum() == pytest.approx(mass, rel=1e-3)
    found = overlaps(grains, case.geometry, phase=0.0, length=length)
    assert len(found.pairs) == len(found.wall) == 0


def test_loading_has_its_shares():
    grains = some_grains(2000)
    loading = Loading(pattern="layered", order=(1, 2, 1), shares=(0.2, 0.5, 0.3), along="y")
    component = components_of(loading, grains, dimension=2, seed=1)
    shares = np.bincount(component, weights=grains.volume) / grains.volume.sum()
    assert shares == pytest.approx([0.5, 0.5], abs=2 / 2000)
    height = grains.position[:, 1]
    assert 0.7 < height[component == 1].max() < 0.9  # the top fifth is of component 1


def test_grains_too_large_for_the_bed_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("scaleup.particles.twin.require_engine", lambda ranks: None)
    case = compose(None, ["particles.coarse=20"])
    with pytest.raises(InputError, match=r"particles\.diameter = 20 mm .* less than 4 grains"):
        run_particles(case, tmp_path / "run", 1)
    assert not list(tmp_path.iterdir())


def contact(**changes):
    plain = Contact(0.01, 0.0, 2500.0, 1e6, 0.3, 0.7, 0.5, 0.5, 0.0, time_step_limit=2e-5)
    return replace(plain, **changes)


def floor_run(folder, grains, gravity, steps, frames, **changes):
    """Grains on a plate at y = 0, of strips of 5 mm, that does not turn in the time; the frames."""
    ends = itertools.pairwise(np.linspace(-0.5, 0.5, 201))
    strips = [[[a, 0, -0.02], [b, 0, -0.02], [b, 0, 0.02], [a, 0, 0.02]] for a, b in ends]
    write_stl(folder / "plate.stl", np.array(strips)[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3))
    box = np.array([[-1.1, -0.1, -1.1], [1.1, 0.5, 1.1]])
    write_grains(folder / "grains.data", grains, 2500.0, box)
    (folder / FRAMES).mkdir()
    deck = Deck(contact(**changes), box, False, [Wall("plate.stl", 5.0)], gravity)
    text = deck.turning("none", 2e-5, steps, frames, 1, Axis(), 1e9)
    Engine(folder).run("trial", text.replace("read_restart none", "read_data grains.data"))
    return [read_dump(path).grains for path in dumps_in(folder / FRAMES).values()]


@needs_engine
def test_a_grain_bounces_with_its_restitution(tmp_path):
    grains = Grains(np.array([[0.1, 0.02, 0.0]]), np.array([[0.0, -0.5, 0.0]]), np.array([0.005]))
    last = floor_run(tmp_path, grains, (0.0, 0.0, 0.0), 400, 6)[-1]
    assert last.velocity[0, 1] == pytest.approx(0.7 * 0.5, rel=0.02)


@needs_engine
def test_a_sliding_grain_ends_up_rolling(tmp_path):
    """Slowed down by mu g over the edges of triangles, from v to 5/7 v, at which it rolls."""
    grains = Grains(
        np.array([[-0.4, 0.00499, 0.0]]), np.array([[0.5, 0.0, 0.0]]), np.array([0.005])
    )
    frames = floor_run(tmp_path, grains, (0.0, -9.8, 0.0), 400, 6)
    slowed = frames[1].velocity[0, 0] - frames[2].velocity[0, 0]
    assert slowed == pytest.approx(0.5 * 9.8 * 400 * 2e-5, rel=0.01)
    assert frames[-1].velocity[0, 0] == pytest.approx(5 / 7 * 0.5, rel=0.01)


@needs_engine
def test_a_small_drum_from_grains_to_report(tmp_path):
    """The whole of it, ended on the way and gone on with, and laid beside itself."""
    asked = [
        "geometry.diameter=100 mm", "material.grain_diameter=6 mm", "grid.spacing=3 mm",
        "operation.fill.depth_ratio=0.3", "operation.speed=40 rpm", "output.metrics_every=0.01",
        "accuracy.scrutiny=3", "particles.shear_modulus=1 MPa",
    ]  # fmt: skip
    begun, case = (
        compose(None, [*asked, f"operation.revolutions={turns}"]) for turns in (0.02, 0.05)
    )
    work = open_folder(tmp_path / "run", begun.to_toml(), resume=False)
    Computation(begun, work / "engine", 1).run()
    folder = run_particles(case, tmp_path / "run", 1, resume=True)
    report = json.loads((folder / "report.json").read_text())
    assert report["mixing"]["revolutions"] == pytest.approx(np.arange(6) / 100)
    assert report["particles"]["overlap_greatest"] < 0.1
    fields = Results.open(folder).snapshot(0.0)
    grid = case.grid
    solid = report["particles"]["solid_fraction"]
    held = fields["fill_fraction"].sum() * grid.cell_volume * solid
    grains = case.fill_volume * case.material.solid_fraction
    assert held == pytest.approx(grains, rel=1e-3)  # as long as the cross-section stands for
    with pytest.raises(InputError, match="this run of grains is finished"):
        check_output(folder, overwrite=False, resume=True, extend=True)
    table = compare([folder, folder], tmp_path / "both")
    assert "surface angle" in table
    assert (folder / "figures" / "grains.png").exists()
