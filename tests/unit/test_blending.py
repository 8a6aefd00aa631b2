"""Blending runs: when diffusion sets in."""

from dataclasses import asdict

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.run.blending import mix

BACKENDS = ("finite-volume", "lax-wendroff", "implicit-fem", "semi-lagrangian")


@pytest.fixture(scope="module")
def blend(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("SCALEUP_CACHE", str(tmp_path_factory.mktemp("store")))

    def run(mixing, *assignments, **options):
        case = compose(
            None,
            ["grid.cells=1500", "operation.revolutions=0.4", *assignments],
            {"mixing": {"name": mixing}, "flow": {"name": "surface-layer"}},
        )
        flow = obtain_flow(case, MPI.COMM_SELF).flow
        return mix(case, flow, MPI.COMM_SELF, **options)

    yield run
    patch.undo()


@pytest.mark.parametrize("mixing", BACKENDS)
def test_advection_alone_comes_before_diffusion(blend, mixing):
    none = blend(mixing, "diffusion.k1=0")
    later = blend(mixing, "diffusion.k1=1", "diffusion.after=0.23")
    always = blend(mixing, "diffusion.k1=1")
    at = later.revolutions.index(0.23)  # a point of the curve of its own
    assert later.revolutions[:at] + later.revolutions[at + 1 :] == none.revolutions
    before, after = later.intensity[:at], later.intensity[at + 1 :]
    assert before == pytest.approx(none.intensity[:at], abs=1e-12)
    assert np.all(np.array(after) < np.array(none.intensity[at:]) - 0.01)
    assert np.all(np.array(after) > np.array(always.intensity[at:]) + 0.01)
    assert later.mass_drift < 1e-12


def test_a_run_goes_on_where_diffusion_sets_in(blend, tmp_path):
    """Killed at that point of the curve and resumed, a run gives what it gives in one go."""
    asked = ("diffusion.k1=1", "diffusion.after=0.2")
    whole = blend("finite-volume", *asked)
    checkpoint = tmp_path / "checkpoint.h5"
    blend("finite-volume", *asked, "operation.revolutions=0.2", checkpoint=checkpoint)
    resumed = blend("finite-volume", *asked, checkpoint=checkpoint)
    assert resumed.revolutions == whole.revolutions
    assert resumed.intensity == pytest.approx(whole.intensity, abs=1e-12)
    assert asdict(resumed.ledger)["steps"] == whole.ledger.steps
