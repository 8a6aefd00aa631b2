"""The contract of a geometry, checked on this one."""

from scaleup_double_cone import DoubleCone

from scaleup.testing import check_geometry


def test_the_vessel_agrees_with_itself():
    """Volumes, distances, box, axis and mirror plane fit together."""
    check_geometry(DoubleCone(DoubleCone.Options()))
