"""What flows say of a scene before it is solved: regimes, beds that slide, lumps."""

import math

import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.contract import ContractError, InputError, Material
from scaleup.flow import source as flow_source
from scaleup.flow.bed_support import wall_lever
from scaleup.numerics import critical_height, lifted_lean
from scaleup_drum import Drum
from scaleup_surface_layer import SurfaceLayer

LAYER = ("flow.name=surface-layer", "grid.cells=300")


def said(*settings, geometry="drum"):
    return " ".join(compose(None, settings, {"geometry": {"name": geometry}}).flow_cautions)


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ([], ""),
        (["operation.speed='20 rpm'"], "beyond 0.01 inertia"),
        (["operation.speed='0.5 rpm'"], "below 0.0001 a bed does not roll"),
        (["material.wall_friction=0.23"], "may slide on the wall"),
        (["material.cohesion='30 Pa'"], "comes down in pieces"),
    ],
)
def test_surface_layer_says_where_it_may_not_hold(settings, part):
    found = said(*LAYER, *settings)
    assert part in found
    assert bool(found) == bool(part)


@pytest.mark.parametrize(
    ("setting", "part"),
    [
        ("material.wall_friction=0.05", "5.67 deg, and it yields at 23.6 deg: it slides"),
        ("operation.fill.volume_fraction=0.03", "slides on the wall as a block"),
        ("material.cohesion='1 kPa'", "stand 416 mm high, and the bed is 49 mm deep"),
    ],
)
@pytest.mark.parametrize("model", ["closed-form", "general"])
def test_a_bed_that_cannot_roll_is_refused_with_the_remedy(setting, part, model):
    with pytest.raises(InputError, match=r"set flow\.name = .mohr-coulomb.") as refusal:
        compose(None, [*LAYER, f"flow.model={model}", setting])
    assert part in str(refusal.value)


def test_a_vessel_that_is_not_round_carries_its_bed_by_its_shape():
    assert said(*LAYER, geometry="tote") == ""
    assert "slide on the vessel's walls" in said(
        *LAYER, "material.wall_friction=0.1", geometry="tote"
    )


@pytest.mark.parametrize(
    ("rheology", "speed", "part"),
    [
        ("mohr-coulomb", "6 rpm", ""),
        ("mohr-coulomb", "15 rpm", "set flow.rheology = 'mu-i'"),
        ("mu-i", "6 rpm", "set flow.rheology = 'mohr-coulomb'"),
        ("mu-i", "15 rpm", ""),
        ("mu-i", "30 rpm", "cascades"),
    ],
)
def test_mohr_coulomb_says_where_its_rheology_holds(rheology, speed, part):
    found = said(f"flow.rheology={rheology}", f"operation.speed='{speed}'")
    assert part in found
    assert bool(found) == bool(part)


def test_mohr_coulomb_says_that_a_bed_slides_before_it_is_solved():
    assert "slides on the wall as a block" in said("material.wall_friction=0.15")


def test_the_warnings_of_a_solved_flow_begin_with_the_cautions(tmp_path, monkeypatch):
    monkeypatch.setenv("SCALEUP_CACHE", str(tmp_path))
    case = compose(None, [*LAYER, "operation.speed='20 rpm'"])
    flow = flow_source.obtain_flow(case, MPI.COMM_SELF).flow
    assert flow.warnings[0] == case.flow_cautions[0]


def test_cautions_that_are_no_sentences_break_the_contract(monkeypatch):
    monkeypatch.setattr(SurfaceLayer, "cautions", lambda *given: "one string")
    with pytest.raises(ContractError, match=r"surface-layer.*must return a tuple of sentences"):
        compose(None, LAYER)


def test_a_walls_lever_by_hand():
    """A half full drum: R 2 R^2/(2/3 R^3) = 3; a thin bed: 1; end walls add their share of K."""
    drum = Drum(Drum.Options(diameter=0.2))
    assert wall_lever(drum, 0.5 * drum.volume, 1.0) == pytest.approx(3.0, rel=1e-6)
    assert wall_lever(drum, 1e-5 * drum.volume, 1.0) == pytest.approx(1.0, abs=2e-3)
    closed = Drum(Drum.Options(diameter=0.2, length=0.1))
    # two half discs: integral of r d dA = 2 R^4/4 each, against 2/3 R^3 per length
    for share in (0.0, 0.4):
        lever = 3.0 + share * (2 * 2 * 0.1**4 / 4) / (2 / 3 * 0.1**3 * 0.1)
        assert wall_lever(closed, 0.5 * closed.volume, share) == pytest.approx(lever, rel=5e-3)
    material = Material(wall_friction=0.15)
    paper = Drum(Drum.Options())
    lean = lifted_lean(paper, material, paper.volume_below(-0.3 * paper.radius))
    assert math.degrees(lean) == pytest.approx(17.2, abs=1.0)  # as the finite elements' block
    assert lifted_lean(Drum(Drum.Options(baffles=3)), material, 0.3 * paper.volume) is None


def test_critical_height_of_a_frictionless_powder_is_4c_over_its_weight():
    clay = Material(cohesion=1500.0, friction_angle=1e-9, bulk_density=1000.0)
    assert critical_height(clay) == pytest.approx(4 * 1500.0 / 9800.0)
