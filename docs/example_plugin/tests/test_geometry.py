"""The contract of a geometry, checked on this one."""

import math

import pytest
from scaleup_double_cone import DoubleCone

from scaleup.testing import check_geometry

VESSEL = DoubleCone(DoubleCone.Options(diameter=0.2, cylinder=0.1, cone=0.05, opening=0.1))


def test_the_vessel_agrees_with_itself():
    """Volumes, distances, box, axis, mirror plane and solid fit together."""
    check_geometry(VESSEL)


def test_its_volume_in_closed_form():
    """A cylinder between two frusta."""
    cylinder, frusta = 0.1 * 0.1**2, 2 * 0.05 / 3 * (0.1**2 + 0.1 * 0.05 + 0.05**2)
    assert VESSEL.volume == pytest.approx(math.pi * (cylinder + frusta), rel=1e-12)
