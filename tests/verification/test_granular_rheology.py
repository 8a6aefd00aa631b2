"""Friction laws against published constants, and Bagnold flow against its exact profile."""

import math

import ngsolve as ngs
import numpy as np
import pytest
from ngsolve.meshes import MakeStructured2DMesh

from bagnold import SURFACE_SPEED, bagnold_error
from column import collapse, lube_run_out
from scaleup.case.composing import compose
from scaleup.scene.models import Material
from scaleup.system.errors import InputError
from scaleup_mohr_coulomb.parameters import Rheology
from scaleup_mohr_coulomb.rheology import (
    Friction,
    InertialFriction,
    RegularisedFriction,
    Strength,
    ill_posedness,
)

MESH = MakeStructured2DMesh(quads=False, nx=1, ny=1)
BARKER_GRAY = {"mu_s": 0.342, "mu_d": 0.557, "i_0": 0.069}


def value(expression) -> float:
    """A coefficient function that is the same everywhere."""
    return float(ngs.CoefficientFunction(expression)(MESH(0.3, 0.3)))


def test_the_regularised_law_has_the_published_constants():
    law = RegularisedFriction(InertialFriction(**BARKER_GRAY, mu_inf=0.05), 1.9)
    assert law.i_1 == pytest.approx(0.0039628, rel=1e-4)
    assert law.a == pytest.approx(15641, rel=1e-4)
    plain = RegularisedFriction(InertialFriction(**BARKER_GRAY), 1.9)
    assert plain.i_1 == pytest.approx(0.003972, rel=2e-4)


LAWS = [
    InertialFriction(0.382, 0.643, 0.279),
    InertialFriction(**BARKER_GRAY, mu_inf=0.05),
    RegularisedFriction(InertialFriction(**BARKER_GRAY, mu_inf=0.05), 1.9),
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("i", [1e-5, 1e-3, 0.02, 1.0])
def test_exponents_are_logarithmic_slopes(law, i):
    up, down = value(law.coefficient(i * 1.001)), value(law.coefficient(i * 0.999))
    slope = math.log(up / down) / math.log(1.001 / 0.999)
    assert value(law.exponent(i)) == pytest.approx(slope, rel=1e-5, abs=1e-9)


def test_where_laws_are_ill_posed():
    """Constant friction everywhere; mu(I) in slow and in very fast flow; the regularised law up to
    I of about 17, as published."""

    def ill_posed(law, i):
        return value(ill_posedness(law.coefficient(i), law.exponent(i))) > 0

    numbers = np.logspace(-6, 1.2, 30)
    assert all(ill_posed(Friction(0.4), i) for i in numbers)
    jop, _, regularised = LAWS
    assert ill_posed(jop, 1e-3)
    assert not ill_posed(jop, 0.1)
    assert ill_posed(jop, 10.0)
    assert not any(ill_posed(regularised, i) for i in numbers)
    assert ill_posed(regularised, 20.0)
    at = value(regularised.coefficient(regularised.i_1))
    assert value(regularised.coefficient(regularised.i_1 * 1.0001)) == pytest.approx(at, rel=1e-4)


@pytest.mark.parametrize(
    ("cohesion", "tensile", "pressure", "share"),
    [
        (10.0, None, -10.0, 1 - 10 * 0.43689 / 9.16363),
        (10.0, None, -30.0, 0.0),
        (10.0, 4.0, -2.0, 0.5),
        (10.0, 0.0, -0.1, 0.0),
        (10.0, 0.0, 0.0, 1.0),
        (0.0, None, -1.0, 0.0),
    ],
)
def test_tension_is_cut_off(cohesion, tensile, pressure, share):
    """Strength under tension, as a share of c cos(phi)."""
    strength = Strength.of(Material(cohesion=cohesion), Rheology(tensile=tensile))
    carried = value(strength(1.0, ngs.CoefficientFunction(pressure)))
    assert carried == pytest.approx(share * 9.16363, abs=1e-3)


def test_the_ill_posed_share_of_a_law():
    mu_i = Rheology.by_literature("mu-i")
    for rheology, rate, expected in [(Rheology(), 1.0, 1), (mu_i, 0.1, 1), (mu_i, 20.0, 0)]:
        strength = Strength.of(Material(), rheology)
        assert value(strength.ill_posed(rate, ngs.CoefficientFunction(100.0))) == expected


def test_constant_friction_takes_no_constants_of_mu_i():
    with pytest.raises(InputError, match="constant friction"):
        compose(None, ["flow.friction_rise=0.2"])


@pytest.mark.parametrize(("dimension", "layers"), [(2, (4, 8, 16)), (3, (2, 4, 6))])
def test_bagnold_flow(dimension, layers):
    """The surface is a lid without pressure, and so without friction."""
    assert pytest.approx(2.06631, rel=1e-5) == SURFACE_SPEED
    errors = [bagnold_error(dimension, n) for n in layers]
    order = -np.polyfit(np.log(layers), np.log(errors), 1)[0]
    assert errors[-1] < 0.01
    assert order > 1.5


def test_a_column_collapses_as_far_as_sand_does():
    """As wide as high, on a coarse mesh: run-out, height and time of Lube et al. and Lajeunesse."""
    deposit = collapse(1.0, elements=8)
    assert deposit.run_out == pytest.approx(lube_run_out(1.0), rel=0.15)
    assert 0.75 < deposit.height < 1.0
    assert 2.5 < deposit.rest < 5.0
    assert deposit.volume_drift < 1e-4


@pytest.mark.slow
def test_higher_columns_leave_the_heights_of_the_scaling_law():
    """Their run-out is too long, by a tongue that rides on air, but by no more on a finer mesh."""
    low, middle, high = (collapse(a, elements=8) for a in (1.0, 2.0, 4.0))
    assert 1.0 < middle.run_out / lube_run_out(2.0) < 1.25
    assert 1.0 < high.run_out / lube_run_out(4.0) < 1.3
    assert collapse(2.0, elements=12).run_out == pytest.approx(middle.run_out, rel=0.1)
    power = math.log2(high.height / low.height) / 2
    assert power == pytest.approx(1 / 3, abs=0.15)  # of Lajeunesse et al.
