"""Configuration files and quantities as people save and write them."""

import codecs
import math

import pytest

from scaleup.case.composing import compose
from scaleup.scene.loading_file import read_loading
from scaleup.scene.units import to_si
from scaleup.system.errors import InputError

FAST = {"flow": {"name": "surface-layer"}}
SCENE = '[material]\nfriction_angle = "25 °"\n[operation]\nspeed = "5 RPM"\n'


def refusal(*assignments, flags=FAST):
    with pytest.raises(InputError) as caught:
        compose(None, assignments, flags)
    return str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        codecs.BOM_UTF8 + SCENE.encode(),
        codecs.BOM_UTF16_LE + SCENE.encode("utf-16-le"),
        codecs.BOM_UTF16_BE + SCENE.replace("\n", "\r\n").encode("utf-16-be"),
        SCENE.replace("\n", "\r").encode(),
    ],
    ids=["utf-8 with its mark", "utf-16", "utf-16 big-endian, CR LF", "CR"],
)
def test_a_file_is_read_as_editors_save_it(tmp_path, content):
    (tmp_path / "run.toml").write_bytes(content)
    case = compose(tmp_path / "run.toml", [], FAST)
    assert case.material.friction_angle == pytest.approx(math.radians(25))
    assert case.operation.speed == pytest.approx(math.pi / 6)


def test_a_file_that_is_no_text_says_how_to_save_it(tmp_path):
    (tmp_path / "run.toml").write_bytes(SCENE.encode("cp1252"))
    with pytest.raises(InputError, match=r"no text in UTF-8 .byte 0xb0 at 32.; save it as UTF-8"):
        compose(tmp_path / "run.toml", [], FAST)


@pytest.mark.parametrize(
    "content",
    [b"x,y,a\n0.5,1,0.25\n\n", codecs.BOM_UTF8 + b"x;y;a\r\n0,5;1;0,25\r\n",
     codecs.BOM_UTF16_LE + "x\ty\ta\n0,5\t1\t0,25\n".encode("utf-16-le")],
    ids=["commas", "semicolons", "tabs in UTF-16"],
)  # fmt: skip
def test_a_table_is_read_as_spreadsheets_save_it(tmp_path, content):
    (tmp_path / "table.csv").write_bytes(content)
    points, concentration = read_loading(tmp_path / "table.csv", 2)
    assert points.tolist() == [[0.5, 1.0]]
    assert concentration.tolist() == [[0.25], [0.75]]


@pytest.mark.parametrize(
    ("unit", "size", "spellings"),
    [
        ("rad/s", 0.2 * math.pi,
         ["6 rpm", "6 RPM", "6rpm", "6 rev/min", "6 Rev/Min", "6 r/min", "6 tr/min", "6 1/min",
          "6 min⁻¹", "6/min", "0.1 Hz", "0,1 Hz", "36 °/s", "36 deg/s", "6 revolutions per minute",
          "6\u00a0rpm", "6\u202frpm", "６ rpm"]),
        ("kg/m^3", 500.0,
         ["500 kg/m3", "500 kg/m^3", "500 kg/m³", "500 kg m^-3", "500 kg m-3", "500 kg·m⁻³",
          "500 KG/M3", "0.5 g/cm3", "0,5 g/cm³", "0.5 kg/l", "0.5 kg/L", "0.5 t/m3"]),
        ("m", 0.14,
         ["140 mm", "140mm", "140 MM", "14 CM", "0,14 m", "0.14 Meters", "140000 µm", "140000 μm",
          "140000 um", "140.0 millimetres"]),
        ("m", 0.1397, ["5.5 in", '5.5"', "5.5 inches"]),
        ("rad", math.radians(38), ["38 deg", "38°", "38 °", "38º", "38 deg.", "38 DEG"]),
        ("Pa", 1000.0, ["1 kPa", "1 KPA", "1 kN/m2", "10 mbar", "0.001 N/mm²"]),
        ("", 0.35, ["35 %", "35%", "0,35", "35 percent"]),
    ],
    ids=["speed", "density", "length", "inch", "angle", "pressure", "share"],
)  # fmt: skip
def test_quantities_are_read_as_people_write_them(unit, size, spellings):
    for text in spellings:
        assert to_si(text, unit) == pytest.approx(size, rel=1e-12), text


@pytest.mark.parametrize(
    ("text", "unit", "reason"),
    [
        ("1 1/s", "rad/s", "may count turns or radians"),
        ("1,500 kg/m3", "kg/m^3", "write 1.500 or 1500"),
        ("1.500,5 m", "m", "not a quantity"),
        ("1 500 mm", "m", "no such unit '500 mm'"),
        ("1 MPA", "Pa", "no such unit 'MPA'"),  # mega or milli
        ("2 mm^2", "m", "wrong unit mm"),
        ("30 deg", "", "wrong unit deg"),
        ("1e400 mm", "m", "finite"),
        ("2 kg/m^99999999", "m", "no such unit"),
        (10**400, "m", "finite"),
    ],
)
def test_what_may_mean_two_things_is_not_read(text, unit, reason):
    with pytest.raises(ValueError, match=reason):
        to_si(text, unit)


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        ("material.friction_angle=38", '= 38: must be below 60 deg; did you mean "38 deg"?'),
        ("geometry.diameter=140", '= 140: must be at most 100 m; did you mean "140 mm"?'),
        ("material.grain_diameter=2", 'less than 4 grains; did you mean "2 mm"?'),
        ("material.bulk_density=1.5", 'at least 10 kg/m^3; did you mean "1.5 g/cm^3"?'),
        ("operation.fill.volume_fraction=35", 'must be below 1; did you mean "35%"?'),
        ("operation.fill.mass=50", 'holds 0.2309 kg; did you mean "50 g"?'),
        ("operation.speed=20", 'such a bed does not roll; did you mean "20 rpm"?'),
        ("grid.spacing=2", 'did you mean "2 mm"?'),
        ("flow.angle_difference=3", 'below 28.65 deg; did you mean "3 deg"?'),
        ("material.friction_angle=38 rad", "must be below 60 deg"),
        ("operation.spede=1", "operation.spede = 1: unknown key; did you mean 'speed'?"),
        ("geometry.diametre=1", "geometry.diametre = 1: unknown key; did you mean 'diameter'?"),
        ("materail.k=1", "unknown key; did you mean 'material'?"),
        ("operation.speed=-6 rpm", "turns counter-clockwise; for the other way mirror the loading"),
        ("operation.reverse_every=2", "reverse_every is not supported: the vessel turns one way"),
    ],
)
def test_a_refusal_says_what_was_likely_meant(assignment, sentence):
    said = refusal(assignment)
    assert sentence in said
    assert ("did you mean" in said) == ("did you mean" in sentence)


@pytest.mark.parametrize(
    "assignment",
    [f"operation.speed={'x' * 12000}", f"geometry.name={'x' * 12000}", f"flow.{'k' * 12000}=1",
     f"operation.revolutions={'9' * 6000}", f"material.cohesion={'[' * 3000}", f"{'x' * 12000}",
     "operation.loading.file=" + "a" * 12000, ".".join("abcdefgh" * 500) + "=1",
     "material.cohesion='''1\n\n2'''"],
    ids=lambda text: text[:24],
)  # fmt: skip
def test_no_sentence_is_longer_than_can_be_read(assignment):
    said = refusal(assignment)
    assert len(said) <= 400
    assert "\n" not in said
