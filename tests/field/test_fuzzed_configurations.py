"""Configurations of all kinds, changed at random: each is a run, or a sentence naming a key."""

import datetime
import json
import shutil
import struct
from typing import get_args

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.case.config import PLUGIN_SECTIONS, RunConfig
from scaleup.case.forms import forms_of
from scaleup.run import pipeline
from scaleup.scene.units import quantity_of
from scaleup.system import registry
from scaleup.system.errors import InputError, ScaleupError

GEOMETRIES, FLOWS, MIXINGS = (sorted(registry.available(kind)) for kind in PLUGIN_SECTIONS)
SECTIONS = tuple(RunConfig.model_fields)


def keys_of(model, prefix=()):
    """Paths and fields of all keys of a model."""
    for name, field in model.model_fields.items():
        inner = field.annotation
        yield (*prefix, name), field
        if hasattr(inner, "model_fields"):
            yield from keys_of(inner, (*prefix, name))


KEYS = sorted(
    {key for key, _ in keys_of(RunConfig)}
    | {
        (kind, *key)
        for kind in PLUGIN_SECTIONS
        for name in registry.available(kind)
        for form in forms_of(registry.load(kind, name)).values()
        for key, _ in keys_of(form)
    }
)
NUMBERS = (
    st.floats(allow_nan=True, allow_infinity=True)
    | st.floats(1e-4, 100)
    | st.integers(-5, 500)
    | st.integers(-(10**400), 10**400)
    | st.sampled_from([0, -0.0, 1e-300, 1e300, 0.5, 0.9999, 1, 3, 140, 38])
)
UNITS = st.sampled_from(
    ["", "mm", "m", "rpm", "RPM", "deg", "°", "kg/m3", "kg/m³", "Pa", "kPa", "s", "1/s", "Hz",
     "rad/s", "kg", "%", "mm^2", "m^-3", "furlong", "mm mm", "/", "^", "m^99999", "(", "degC", "dB"]
)  # fmt: skip
QUANTITIES = st.builds(lambda n, gap, u: f"{n}{gap}{u}", NUMBERS, st.sampled_from(["", " "]), UNITS)
WORDS = st.sampled_from(
    ["side-by-side", "top-bottom", "front-back", "layered", "region", "file", "auto", "general",
     "closed-form", "paper", "mu-i", "plant", "level-bed", "steady", "both", "z", ".", "/dev/null",
     *GEOMETRIES, *FLOWS, *MIXINGS]
)  # fmt: skip
TEXTS = WORDS | QUANTITIES | st.text(max_size=20) | st.text(min_size=1, max_size=3).map(
    lambda text: text * 3000
)  # fmt: skip
SCALARS = NUMBERS | TEXTS | st.booleans() | st.just(datetime.date(2026, 1, 1))
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.sampled_from([key[-1] for key in KEYS]) | st.text(max_size=8), inner,
                      max_size=3),
    max_leaves=6,
)  # fmt: skip
PATHS = (
    st.sampled_from(KEYS)
    | st.lists(st.sampled_from(SECTIONS) | st.text(max_size=12), min_size=1, max_size=4).map(tuple)
    | st.sampled_from(KEYS).map(lambda path: (*path[:-1], path[-1][:-1]))
)
MAGNITUDES = st.builds(lambda a, n: float(f"{a:.3g}e{n}"), st.floats(1, 10), st.integers(-4, 3))


def fitting(field):
    """Values of the kind that a field takes, likely and unlikely ones."""
    quantity = quantity_of(field.annotation) or next(
        filter(None, map(quantity_of, field.metadata)), None
    )
    if quantity is not None:
        unit = st.sampled_from([quantity.unit, *quantity.common, *quantity.likely])
        return st.builds(lambda number, name: f"{number} {name}", MAGNITUDES | NUMBERS, unit)
    choices = [
        x for part in (field.annotation, *get_args(field.annotation)) for x in get_args(part)
    ]
    words = [x for x in choices if isinstance(x, str)]
    return st.sampled_from(words) if words else MAGNITUDES | NUMBERS | st.booleans()


@st.composite
def scenes(draw):
    """Names of plugins, changes of their keys and the others, and assignments."""
    names = [draw(st.sampled_from(known)) for known in (GEOMETRIES, FLOWS, MIXINGS)]
    fields = {key: field for key, field in keys_of(RunConfig) if key[0] not in PLUGIN_SECTIONS}
    for kind, name in zip(PLUGIN_SECTIONS, names, strict=True):
        for form in forms_of(registry.load(kind, name)).values():
            fields |= {(kind, *k): field for k, field in keys_of(form)}
    leaves = sorted(
        key for key, field in fields.items() if not hasattr(field.annotation, "model_fields")
    )
    changes, assignments = [], []
    for _ in range(draw(st.integers(1, 4))):
        key = draw(st.sampled_from(leaves))
        changes.append((key, draw(fitting(fields[key]))))
    if draw(st.integers(0, 3)) == 0:
        changes.append((draw(PATHS), draw(VALUES)))
    if draw(st.integers(0, 7)) == 0:
        key = draw(PATHS | st.sampled_from(leaves))
        assignments = [draw(st.just(f"{'.'.join(key)}={draw(TEXTS)}") | st.text(max_size=30))]
    return (*names, changes, assignments)


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """A closed box of 0.2 m as binary STL."""
    corners = [(x, y, z) for x in (0, 0.2) for y in (0, 0.2) for z in (0, 0.2)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    content = bytes(80) + struct.pack("<I", len(triangles))
    for triangle in triangles:
        numbers = [0.0] * 3 + [x for corner in triangle for x in corners[corner]]
        content += struct.pack("<12fH", *numbers, 0)
    path = tmp_path_factory.mktemp("fuzz") / "box.stl"
    path.write_bytes(content)
    return path


def changed(tables, changes):
    """The tables with values put at paths, through whatever is there."""
    for path, value in changes:
        place = tables
        for key in path[:-1]:
            if not isinstance(place.get(key), dict):
                place[key] = {}
            place = place[key]
        place[path[-1]] = value
    return tables


def outcome_is_sound(box, geometry, flow, mixing, changes, assignments):
    tables = {"geometry": {"name": geometry}, "flow": {"name": flow}, "mixing": {"name": mixing}}
    if geometry == "mesh":
        tables["geometry"] |= {"file": str(box), "unit": "m"}
    try:
        case = compose(None, assignments, changed(tables, changes))
    except InputError as error:
        said = str(error)
        assert 0 < len(said) <= 400
        assert said.splitlines() == [said]
        named = [*SECTIONS, "--set", *(path[0][:20] for path, _ in changes)]
        assert any(name in said for name in named), said
        return
    written = case.to_toml()
    file = box.with_name("config.toml")
    file.write_text(written, encoding="utf-8")
    again = compose(file)
    assert again.to_toml() == written
    assert [again.options(kind) for kind in PLUGIN_SECTIONS] == [
        case.options(kind) for kind in PLUGIN_SECTIONS
    ]


QUIET = {"deadline": 60_000, "suppress_health_check": list(HealthCheck)}


@pytest.mark.filterwarnings("error")
@settings(max_examples=300, derandomize=True, database=None, **QUIET)
@given(scene=scenes())
def test_a_changed_configuration_is_a_run_or_a_sentence(box, scene):
    outcome_is_sound(box, *scene)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@settings(max_examples=3000, **QUIET)
@given(scene=scenes())
def test_many_changed_configurations_are_runs_or_sentences(box, scene):
    outcome_is_sound(box, *scene)


SMALL = ("flow.name=surface-layer", "grid.cells=600", "operation.revolutions=0.1")


def run_ends_well(box, scene):
    geometry, _, mixing, changes, _ = scene
    tables = {"geometry": {"name": geometry}, "mixing": {"name": mixing}}
    if geometry == "mesh":
        tables["geometry"] |= {"file": str(box), "unit": "m"}
    kept = [(key, value) for key, value in changes if key[0] not in ("flow", "grid")]
    try:
        case = compose(None, SMALL, changed(tables, kept))
    except InputError:
        assume(False)
    folder = box.with_name("run")
    shutil.rmtree(folder, ignore_errors=True)
    try:
        pipeline.run(case, folder, MPI.COMM_SELF, overwrite=True)
    except ScaleupError as error:
        said = str(error)
        assert 0 < len(said) <= 400
        assert said.splitlines() == [said]
        return
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    curve = report["mixing"]["segregation_intensity"]
    assert all(-0.01 <= value <= 1.01 for value in curve)
    assert all(0 <= value <= 1 for value in report["mixing"]["lacey"])
    assert report["mixing"]["samples"]["mass"] > 0
    assert not [name for name in report["warnings"] if "could not" in name]


@pytest.mark.slow
@settings(max_examples=40, **QUIET | {"deadline": None})
@given(scene=scenes())
def test_small_runs_of_changed_configurations_end_in_a_result_or_a_sentence(box, store, scene):
    run_ends_well(box, scene)
