"""Samples that the cells resolve, and samples that they do not."""

import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.flow.source import obtain_flow
from scaleup.measure.metrics import sample_edge
from scaleup.report.cautions import cautions
from scaleup.report.compile import _html as report_html
from scaleup.report.compile import compile_report
from scaleup.run.blending import mix
from scaleup.run.planner import plan

FAST = {"flow": {"name": "surface-layer"}, "mixing": {"name": "finite-volume"}}


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """The report of a short, coarse run of the drum."""
    patch = pytest.MonkeyPatch()
    patch.setenv("SCALEUP_CACHE", str(tmp_path_factory.mktemp("store")))

    def run(*assignments):
        asked = ["grid.spacing=2 mm", "operation.revolutions=0.1", *assignments]
        case = compose(None, asked, FAST)
        outcome = obtain_flow(case, MPI.COMM_SELF)
        blend = mix(case, outcome.flow, MPI.COMM_SELF)
        return case, compile_report(case, outcome, blend, "not asked for", 1)

    yield run
    patch.undo()


def test_a_sample_finer_than_the_cells_is_said_and_gets_no_blend_time(reported):
    case, report = reported("material.grain_diameter=100 um", "accuracy.blended_rsd=0.999")
    mixing, edge = report["mixing"], sample_edge(case.grid, 5e-4)
    samples = mixing["samples"]
    assert samples["asked_edge"] == pytest.approx(5e-4)
    assert samples["asked_mass"] == pytest.approx(5e-4**3 * 1500)
    assert samples["edge"] == edge > 1.5e-3  # a whole cell
    assert samples["mass"] == pytest.approx(edge**3 * 1500, rel=0.1)
    assert not samples["resolved"]
    assert mixing["rsd"][-1] < 0.999  # of the larger samples
    assert mixing["blend_time_of_samples_revolutions"] is not None
    assert mixing["blend_time_revolutions"] is None
    assert "the cells do not resolve the samples of" in mixing["blend_time_revolutions_reason"]
    (said,) = [w for w in report["warnings"] if "asked for" in w]
    assert "samples of 0.1875 mg (0.5 mm) are asked for" in said
    assert "accuracy.sample_mass" in said
    html = report_html(report, [])
    assert "grain diameters" not in html
    assert "samples of 0.1875 mg (0.5 mm)" in html


def test_a_sample_of_whole_cells_is_what_was_asked_for(reported):
    _, report = reported("accuracy.sample_mass=1.5 g", "accuracy.blended_rsd=0.999")
    mixing, samples = report["mixing"], report["mixing"]["samples"]
    assert samples["asked_edge"] == pytest.approx(0.01)
    assert samples["edge"] == pytest.approx(0.01, rel=0.1)
    assert samples["resolved"]
    assert mixing["blend_time_revolutions"] == mixing["blend_time_of_samples_revolutions"]
    assert not [w for w in report["warnings"] if "asked for" in w]
    # what a random mixture shows, by drawing grains of 1 mm, 60 % of the volume
    assert samples["grains"] == pytest.approx(samples["mass"] / 2500 / 0.5236e-9, rel=1e-3)
    assert samples["random_mixture_rsd"] == pytest.approx(samples["grains"] ** -0.5, rel=1e-6)
    assert max(mixing["lacey"]) <= 1
    assert "samples of" in mixing["definitions"]["at_scrutiny"]


@pytest.mark.parametrize(
    ("assignments", "sentence"),
    [
        (["material.grain_diameter=100 um", "grid.spacing=2 mm"], "cells resolve samples of"),
        (["grid.spacing=8 mm"], "the bed is 6.12 cells deep; 10 or more"),
        (["material.grain_diameter=7 mm", "accuracy.scrutiny=1"], "the bed is 7 grains deep"),
        (["accuracy.sample_mass=8 g"], "the bed holds 15.9 samples of"),
        (["operation.speed=20 rpm"], "the Froude number is 0.031"),
    ],
)
def test_plan_warns_of_what_the_report_warns_of(assignments, sentence):
    case = compose(None, assignments, FAST)
    said = [how for what, how in plan(case, 1) if what == "warning"]
    assert any(sentence in each for each in said)
    if "Froude" not in sentence:
        assert any(sentence in each for each in cautions(case, case.grid))
    quiet = compose(None, [], FAST)
    assert not [how for what, how in plan(quiet, 1) if what == "warning"]
