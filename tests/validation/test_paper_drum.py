"""The drum of Liu, Gonzalez & Wassgren 2018 at its defaults. Minutes long: `make verify`."""

import math

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.run.blending import mix

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def outcomes(store):
    return {
        measured: obtain_flow(
            compose(None, [f"material.friction_measured={measured}"]), MPI.COMM_SELF
        )
        for measured in ("shear-plane", "mohr-coulomb")
    }


def test_surface_angles(outcomes):
    """The paper: 24.5 deg by particles (which know tan), 23.3 deg by its finite elements (sin)."""
    tan, sin = (outcomes[m].flow.summary for m in ("shear-plane", "mohr-coulomb"))
    assert tan["surface_angle_deg"] == pytest.approx(24.5, abs=1.0)
    assert sin["surface_angle_deg"] == pytest.approx(23.3, abs=1.0)
    difference = tan["surface_angle_deg"] - sin["surface_angle_deg"]
    assert difference == pytest.approx(1.8, abs=0.5)
    assert math.hypot(tan["surface_angle_error_deg"], sin["surface_angle_error_deg"]) < 0.35


def test_downflow_is_what_rigid_rotation_brings_up(outcomes):
    for outcome in outcomes.values():
        figures = outcome.flow.summary
        assert figures["flux_midbed"] == pytest.approx(figures["rigid_upflow_midbed"], rel=0.10)


def test_blend_curve_is_converged(outcomes):
    curves = {}
    for spacing in ("0.45 mm", "0.3 mm"):
        case = compose(None, [f"grid.spacing='{spacing}'"])
        blend = mix(case, obtain_flow(case, MPI.COMM_SELF).flow, MPI.COMM_SELF)
        at = [blend.revolutions.index(r) for r in (0, 1, 2, 3)]
        curves[spacing] = np.array(blend.intensity)[at]
    assert curves["0.3 mm"][0] > 0.9
    assert np.all(np.diff(curves["0.3 mm"]) < 0)
    assert np.abs(curves["0.45 mm"] - curves["0.3 mm"])[1:].max() < 0.03
