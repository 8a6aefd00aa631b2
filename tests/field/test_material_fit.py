"""A [material] table from measured tables: known powders are found again, others refused."""

import math

import numpy as np
import pytest
from scipy.stats import binom

from scaleup.case.composing import compose
from scaleup.command.cli import cli
from scaleup.flow.source import stored_flow
from scaleup.material.compression import fit_unloading
from scaleup.material.measured import COMPRESSION_TABLE, SHEAR_TABLE, read_measured
from scaleup.material.yield_locus import fit_yield_locus
from scaleup.system.errors import InputError

SIGMA = np.array([0.5e3, 1e3, 2e3, 3e3, 5e3])  # Pa
TRIALS = 400
YOUNG, NU = 3.65e6, 0.065


def loaded_and_unloaded(young=YOUNG, nu=NU, rows=40, bend=0.0):
    """Strain, axial and radial stress of a bed that yields, then unloads as an elastic body.

    bend -- relative loss of stiffness over the unloading
    """
    stiff, ratio = young * (1 - nu) / ((1 + nu) * (1 - 2 * nu)), nu / (1 - nu)
    loading = np.linspace(0, 0.02, rows)
    axial, radial = 40e3 * (loading / 0.02) ** 2, 9e3 * (loading / 0.02) ** 2
    released = np.linspace(0, 30e3 / stiff, rows)[1:]
    fall = stiff * released * (1 - bend * released / released[-1])
    strain = np.append(loading, 0.02 - released)
    return strain, np.append(axial, 40e3 - fall), np.append(radial, 9e3 - ratio * fall)


def held(estimates, truth):
    """Whether limits held the truth as often as 95 % limits do, in all but 1 of 1000 tests."""
    count = sum(each.low <= truth <= each.high for each in estimates)
    low, high = binom.interval(0.999, TRIALS, 0.95)
    return low <= count <= high


def written(path, **columns):
    """A CSV file of columns, their heads in words with underscores."""
    rows = [columns.keys(), *zip(*columns.values(), strict=True)]
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")
    return path


@pytest.mark.parametrize("cohesion", [0.0, 250.0])
def test_a_yield_locus_without_noise_is_found_to_round_off(cohesion):
    friction = math.tan(math.radians(23.6))
    locus = fit_yield_locus(SIGMA, cohesion + friction * SIGMA)
    assert locus.friction_angle.value == pytest.approx(math.radians(23.6), rel=1e-14)
    assert locus.cohesion.value == pytest.approx(cohesion, rel=1e-12)
    assert locus.friction.high - locus.friction.low < 1e-12
    assert locus.line.through_origin == (cohesion == 0)
    assert locus.remarks == ()
    two = fit_yield_locus(SIGMA[:2], cohesion + friction * SIGMA[:2])  # as in the paper
    assert two.friction.value == pytest.approx(friction, rel=1e-14)
    assert two.friction.low is None
    assert two.line.through_origin == (cohesion == 0)
    assert "2 points give no limits" in two.remarks[0]


def test_elastic_constants_without_noise_are_found_to_round_off():
    found = fit_unloading(*loaded_and_unloaded())
    assert found.modulus.value == pytest.approx(YOUNG, rel=1e-12)
    assert found.poisson.value == pytest.approx(NU, rel=1e-11)
    assert found.remarks == ()
    bent = fit_unloading(*loaded_and_unloaded(bend=0.4), part=0.5)
    assert "the unloading bends" in bent.remarks[0]
    assert fit_unloading(*loaded_and_unloaded(bend=0.4, rows=400), part=0.1).remarks == ()


@pytest.mark.parametrize("cohesionless", [False, True])
def test_limits_hold_as_often_as_they_say_however_cohesion_is_decided(cohesionless):
    """A cohesion of 2.5 standard errors: taken in some tests, set to zero in others."""
    random, loci = np.random.default_rng(1), []
    friction, cohesion = 0.45, 0.0 if cohesionless else 60.0
    for _ in range(TRIALS):
        shear = cohesion + friction * SIGMA + random.normal(0, 30, len(SIGMA))
        loci.append(fit_yield_locus(SIGMA, shear, cohesionless=cohesionless))
    assert held([locus.friction for locus in loci], friction)
    assert all(locus.friction.low < locus.friction.value < locus.friction.high for locus in loci)
    if not cohesionless:
        assert 0.1 < np.mean([locus.line.through_origin for locus in loci]) < 0.95
        assert held([locus.cohesion for locus in loci], cohesion)


def test_limits_of_elastic_constants_hold_as_often_as_they_say():
    random, found = np.random.default_rng(2), []
    strain, axial, radial = loaded_and_unloaded()
    for _ in range(TRIALS):
        noise = random.multivariate_normal([0, 0], [[1e4, 6e3], [6e3, 1e4]], len(strain)).T
        found.append(fit_unloading(strain, axial + noise[0], radial + noise[1]))
    assert held([each.modulus for each in found], YOUNG)
    assert held([each.poisson for each in found], NU)


@pytest.mark.parametrize(
    "text",
    [
        "normal stress [kPa],shear stress [kPa]\n1,0.5\n2,1\n",
        "\ufeff# ring shear tester\npoint;σ_n / kPa;τ / (kN/m²)\n1;1,0;0,5\n2;2,0;1,0\n",
        "shear displacement (mm)\tnormal stress (KPA)\tshear stress at steady flow (N/mm²)\n"
        "3\t1\t0.0005\n3\t2\t0.001\n\n",
        "Normal_Stress_Pa,TAU in mbar\n1000,5\n2000,10\n",
        '"normal stress, kPa","tau, Pa"\n1,500\n2,1000\n',
    ],
)
def test_tables_are_read_as_people_write_them(tmp_path, text):
    (tmp_path / "t.csv").write_text(text, encoding="utf-8")
    table = read_measured(tmp_path / "t.csv", SHEAR_TABLE)
    np.testing.assert_allclose(table["normal"], [1e3, 2e3], rtol=1e-12)
    np.testing.assert_allclose(table["shear"], [5e2, 1e3], rtol=1e-12)


@pytest.mark.parametrize(
    ("strain", "value"), [("axial strain [-]", 0.02), ("strain / %", 2), ("ε_zz (mm/m)", 20)]
)
def test_strains_are_read_in_their_units(tmp_path, strain, value):
    (tmp_path / "t.csv").write_text(f"{strain}\tsigma_zz [kPa]\tradial stress [psi]\n{value}\t1\t1")
    table = read_measured(tmp_path / "t.csv", COMPRESSION_TABLE)
    assert table["strain"][0] == pytest.approx(0.02)
    assert table["axial"][0] == pytest.approx(1e3)
    assert table["radial"][0] == pytest.approx(6894.757, rel=1e-6)


HEAD = "normal stress [kPa],shear stress [kPa]\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("normal stress [kPa],shear\n1,1\n2,2\n", "'shear' carries no unit; write 'shear stress ["),
        ("normal stress,tau [Pa]\n1,1\n2,2\n", "'normal stress' carries no unit"),
        ("normal stress [mm],tau [Pa]\n1,1\n2,2\n", "the unit of 'normal stress [mm]': wrong unit"),
        ("normal stress [],tau [Pa]\n1,1\n2,2\n", "'normal stress []' carries no unit"),
        ("normal [kPa],tau (steady)\n1,1\n2,2\n", "the unit of 'tau (steady)': no such unit"),
        ("load [kPa],tau [Pa]\n1,1\n2,2\n", "names no column for the normal stress"),
        ("normal [kPa],tau [Pa],shear [Pa]\n1,1,1\n", "may each be the shear stress"),
        (HEAD + "1,nan\n2,1\n", "'shear stress [kPa]' = 'nan' in row 1: must be a finite"),
        (HEAD + "1,0.4\n2,inf\n", "= 'inf' in row 2: must be a finite number"),
        (HEAD + "1,0.4\n,0.8\n", "'normal stress [kPa]' = '' in row 2"),
        (HEAD + "1,0.4\n2\n", "not every line holds 2 numbers"),
        (HEAD, "not every line holds 2 numbers"),
        ("# none\n", "names no column for the normal stress in its first line ('')"),
        (HEAD + "1,0.4\n", "1 point is no line; measure two or more, three for limits"),
        (HEAD + "2,0.8\n2,0.9\n2,0.85\n", "the normal stresses are all 2 kPa"),
        (HEAD + "1,0.8\n2,0.6\n3,0.5\n", "the shear stress does not rise with the normal stress"),
        (HEAD + "1,0.5\n2,0.5\n3,0.5\n", "the shear stress does not rise with the normal stress"),
        (HEAD + "1,0.2\n2,0.7\n3,1.201\n4,1.7\n", "cohesion is -0.3 kPa +- 3.118 Pa, below"),
        (HEAD + "1,0.3\n2,0.8\n", "cohesion is -0.2 kPa +- 40 Pa, below zero; check the zero"),
        (HEAD + "-1,0.3\n-2,0.8\n", "the normal stress -2 kPa is negative; compression and"),
        (HEAD + "1e9,0.3e9\n2e9,0.8e9\n", "is more than 1000 MPa; check its unit"),
        (HEAD + "1,3\n2,6\n3,9\n", "material.friction_angle = '71.5651 deg': must be below 60 deg"),
    ],
)
def test_what_is_no_yield_locus_is_refused_in_a_sentence(refused, tmp_path, text, sentence):
    (tmp_path / "t.csv").write_text(text)
    said = refused("material", "fit", "--yield-locus", "t.csv")
    assert sentence in said
    assert "t.csv" in said
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (lambda e, a, r: (e[:40], a[:40], r[:40]), "there is no unloading: the axial strain"),
        (lambda e, a, r: (-e, -a, -r), "the axial stress -40 kPa is negative; compression"),
        (lambda e, a, r: (-e, a, r), "the axial stress is not positive where"),
        (lambda e, a, r: (e, r, a), "would be 0.935, not between 0 and 0.5"),
        (lambda e, a, r: (e, a, 20e3 - r), "Poisson's ratio would be -0.0747"),
        (lambda e, a, r: (e[::20], a[::20], r[::20]), "only 1 row(s) until the axial stress has"),
        (lambda e, a, r: (100 * e, a, r), "the axial strain 2 is more than 1; check its unit"),
        (lambda e, a, r: (e[:2], a[:2], r[:2]), "2 row(s) are no loading and unloading"),
        (
            lambda e, a, r: (e, np.append(a[:40], 80e3 - a[40:]), r),
            "the axial stress does not fall",
        ),
        (lambda e, a, r: (e, a, r * np.nan), "must hold finite numbers alone"),
    ],
)
def test_what_is_no_unloading_is_refused_in_a_sentence(columns, sentence):
    with pytest.raises(InputError) as caught:
        fit_unloading(*columns(*loaded_and_unloaded()))
    assert sentence in str(caught.value)


def test_what_points_cannot_tell_is_said():
    three = fit_yield_locus(SIGMA[:3], np.array([200.0, 500.0, 800.0]))
    assert three.remarks[0] == "only 3 points: the limits are 12.7 standard errors wide"
    assert "the limits of the slope include zero" in three.remarks[-1]
    assert "hardly a line (r^2 0." in fit_yield_locus(SIGMA, SIGMA % 1200 + 0.2 * SIGMA).remarks[0]
    cohesive = fit_yield_locus(SIGMA, 250 + 0.4 * SIGMA, cohesionless=True)
    assert "they speak against a line through the origin" in cohesive.remarks[0]


def test_arguments_that_cannot_be_are_refused(refused, tmp_path):
    written(tmp_path / "t.csv", **{"normal [Pa]": SIGMA, "shear [Pa]": 0.4 * SIGMA})
    fit = ("material", "fit", "--yield-locus", "t.csv")
    assert "gone.csv: cannot be read (No such file" in refused(*fit[:-1], "gone.csv")
    assert "name a file that ends in .toml" in refused(*fit, "--output", "t.csv")
    assert "only keys of material" in refused(*fit, "--set", "grid.cells=1")
    assert "material.cohesion: is fitted here" in refused(*fit, "--set", "material.cohesion=1")
    assert "material.provenance = 1: must be a table" in refused(
        *fit, "--set", "material.provenance=1"
    )
    assert "'--unloading-part': 2.0 is not in the range" in refused(*fit, "--unloading-part", "2")
    assert "material.colour = 1: unknown key" in refused(*fit, "--set", "material.colour=1")
    (tmp_path / "material.png").write_text("mine")
    assert "material.png: is there already; give --overwrite" in refused(*fit)
    assert (tmp_path / "material.png").read_text() == "mine"


def test_a_run_takes_the_table_and_knows_where_it_comes_from(store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / "y.csv", **{"normal [Pa]": SIGMA, "shear [Pa]": 0.45 * SIGMA})
    written(tmp_path / "w.csv", **{"normal [Pa]": SIGMA, "shear [Pa]": 0.3 * SIGMA})
    names = ("strain [-]", "axial stress [Pa]", "radial stress [Pa]")
    written(tmp_path / "c.csv", **dict(zip(names, loaded_and_unloaded(), strict=True)))
    cli(
        ["material", "fit", "--yield-locus", "y.csv", "--wall", "w.csv", "--compression", "c.csv",
         "--set", "material.bulk_density=620 kg/m3", "--output", "powders/mine.toml"],
        standalone_mode=False,
    )  # fmt: skip
    file = tmp_path / "powders" / "mine.toml"
    assert (tmp_path / "powders" / "mine.png").read_bytes().startswith(b"\x89PNG")
    case = compose(file, flags={"geometry": {"name": "drum"}})
    assert math.tan(case.material.friction_angle) == pytest.approx(0.45, rel=1e-5)
    assert (case.material.wall_friction, case.material.bulk_density) == (0.3, 620)
    told = case.material.provenance
    assert told.keys() == {
        "friction_angle", "cohesion", "wall_friction", "youngs_modulus", "poissons_ratio",
        "bulk_density",
    }  # fmt: skip
    assert told["youngs_modulus"].startswith("3.65 MPa (95 % limits ")
    assert "5 points of y.csv (sha256 " in told["friction_angle"]

    # another value loses the provenance of the one before; flows do not depend on it
    other = compose(file, ["material.friction_angle=30 deg"], {"geometry": {"name": "drum"}})
    assert other.material.provenance.keys() == told.keys() - {"friction_angle"}
    text = file.read_text(encoding="utf-8")
    bare = file.with_name("bare.toml")
    bare.write_text(text[: text.index("[material.provenance]")], encoding="utf-8")
    untold = compose(bare, flags={"geometry": {"name": "drum"}})
    assert untold.material.provenance is None
    assert stored_flow(untold) == stored_flow(case)
    (tmp_path / "config.toml").write_text(case.to_toml(), encoding="utf-8")
    assert compose(tmp_path / "config.toml").material == case.material
