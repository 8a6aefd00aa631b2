"""The Lax-Wendroff schemes on the exact drum flow and on whole-plane fields."""

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.contract import FlowField, MixingScene
from scaleup.flow.source import obtain_flow
from scaleup.mixing.scene import mixing_scene
from scaleup.run.blending import mix
from scaleup.scene.models import Diffusion
from scaleup.scene.shear_diffusion import shear_diffusion
from scaleup.testing import check_flow, check_mixing
from scaleup.verification import Result, fitted_order, problems, run
from scaleup.verification.deformations import vortex_flow
from scaleup.verification.problem import uniform_diffusion
from scaleup_lax_wendroff import LaxWendroff
from synthetic import sloshing

FAST = {"flow": {"name": "surface-layer"}}


def scene_of(flow: FlowField, k1: float = 0.0, grain: float = 1e-3) -> MixingScene:
    laws = [shear_diffusion(Diffusion(k1=k1), grain)]
    return mixing_scene(LaxWendroff(LaxWendroff.Options()), flow, MPI.COMM_SELF, laws)


def bump(flow: FlowField) -> np.ndarray:
    points = flow.grid.centre_points(flow.intervals[0].cells)
    c = np.exp(-((points - [0.5, 0.3]) ** 2).sum(axis=1) / (2 * 0.1**2))
    return np.stack([c, 1 - c])


def study(form: str, sizes: tuple[int, ...]) -> list[Result]:
    backend = LaxWendroff(LaxWendroff.Options(form=form, courant=0.9))
    return [run(problems()["vortex"], backend, n) for n in sizes]


def test_corrected_form_is_second_order_in_space_and_time_where_velocity_varies():
    results = study("corrected", (32, 64, 128))
    assert fitted_order(results) > 1.85
    assert results[-1].l1 < 0.02
    assert all(abs(result.mass_drift) < 1e-12 for result in results)


def test_paper_form_is_first_order_in_time_and_loses_mass():
    # steps halve with the cells, so an error of first order in time shows as order one
    results = study("paper", (32, 64, 128))
    assert 0.7 < fitted_order(results) < 1.4
    assert abs(results[0].mass_drift) > 1e-3


def test_paper_form_of_solid_rotation_loses_mass_as_its_missing_term_says():
    """Inside the vortex' core v = (-w y, w x): mass decays as exp(-w^2 dt T)."""
    n, time, omega = 128, 0.4, np.pi  # psi ~ (1 - pi^2 r^2)/(2 pi): w = pi at the centre
    flow = vortex_flow(n)
    points = flow.grid.centre_points(flow.intervals[0].cells)
    c = np.exp(-((points - 0.5) ** 2).sum(axis=1) / (2 * 0.03**2))
    backend = LaxWendroff(LaxWendroff.Options(form="paper", courant=0.9))
    backend.start(scene_of(flow), np.stack([c, 1 - c]))
    ledger = backend.advance(0, 0.0, time)
    dt = time / ledger.steps
    mass = backend.concentration(flow.intervals[0])[0].sum() / c.sum()
    assert np.log(mass) == pytest.approx(-(omega**2) * dt * time, rel=0.1)


def test_diffusion_spreads_a_gaussian_as_the_exact_solution():
    """No flow, uniform anisotropic tensor with D_xy: variances grow by 2 D t."""
    flow = vortex_flow(64)
    part = flow.intervals[0]
    law = uniform_diffusion(np.array([[2.0, 0.7], [0.7, 1.0]]) * 1e-3)
    part = type(part)(
        0.0, 1.0, part.cells, part.fill_start, part.fill_end, 0 * part.flux,
        part.shear_rate, part.direction,
    )  # fmt: skip
    still = FlowField(flow.grid, "lab", flow.axis, 0.0, [part])
    scene = mixing_scene(LaxWendroff(LaxWendroff.Options()), still, MPI.COMM_SELF, [law])
    p = flow.grid.centre_points(part.cells) - 0.5
    c = np.exp(-(p**2).sum(axis=1) / (2 * 0.08**2))
    backend = LaxWendroff(LaxWendroff.Options())
    backend.start(scene, np.stack([c, 1 - c]))
    backend.advance(0, 0.0, 2.0)
    after = backend.concentration(part)[0]
    for i, j, expected in ((0, 0, 2.0), (1, 1, 1.0), (0, 1, 0.7)):
        grown = np.average(p[:, i] * p[:, j], weights=after) - np.average(
            p[:, i] * p[:, j], weights=c
        )
        assert grown == pytest.approx(2 * expected * 1e-3 * 2.0, rel=0.01)


@pytest.mark.parametrize(
    ("form", "components"), [("corrected", 3), ("flux-corrected", 5), ("paper", 2)]
)
def test_contract_on_a_moving_fill_and_with_several_components(form, components):
    flow = sloshing(columns=24, rows=12)
    rng = np.random.default_rng(1)
    c = rng.random((components, len(flow.intervals[0].cells)))
    scene = scene_of(flow, k1=0.04)
    check_mixing(LaxWendroff(LaxWendroff.Options(form=form)), scene, c / c.sum(axis=0), 1.6)


@pytest.mark.parametrize("closure", ["shear-rate", "parabolic"])
def test_the_surface_layer_flow_keeps_its_contract(store, closure):
    case = compose(None, ["grid.spacing='1 mm'", f"flow.closure={closure}"], FAST)
    flow = obtain_flow(case, MPI.COMM_SELF).flow
    check_flow(flow, case.geometry, case.fill_volume)
    assert flow.lift == pytest.approx(np.radians(23.6))


def test_the_parabolic_layer_is_the_published_velocity_field(store):
    """In the layer v_s = 2u(1 - depth/delta) - w(b + depth) (Khakhar et al. 1997), order >= 1.8."""
    errors, spacings = [], (2e-3, 1e-3, 5e-4)
    for spacing in spacings:
        case = compose(
            None,
            [f"grid.spacing={spacing}", "flow.closure=parabolic", "flow.thickness=0.012"],
            FAST,
        )
        flow = obtain_flow(case, MPI.COMM_SELF).flow
        part, omega, b, angle = flow.intervals[0], flow.angular_velocity, 0.3 * 0.07, flow.lift
        p = flow.grid.centre_points(part.cells)
        down, out = np.array([-np.cos(angle), -np.sin(angle)]), [-np.sin(angle), np.cos(angle)]
        s, depth = p @ down, -(p @ out) - b
        chord = 0.07**2 - b**2
        delta = 0.012 * (1 - s**2 / chord)
        u = omega * chord / (2 * 0.012)
        layer = (depth > 2e-3) & (depth < delta - 2e-3) & (np.abs(s) < 0.04)
        streamwise = 2 * u * (1 - depth / delta) - omega * (b + depth)
        error = (part.velocity(flow.grid).T @ down - streamwise)[layer]
        errors.append(np.abs(error).max())
        rigid = (depth > delta + 2e-3) & (part.fill_start > (1 - 1e-9) * flow.grid.cell_volume)
        turning = np.stack([-omega * p[:, 1], omega * p[:, 0]])
        assert part.velocity(flow.grid)[:, rigid] == pytest.approx(turning[:, rigid], abs=1e-12)
    assert np.polyfit(np.log(spacings), np.log(errors), 1)[0] > 1.8


def test_blending_the_drum_converges_and_conserves(store):
    curves = {}
    for spacing in ("2 mm", "1 mm", "0.5 mm"):
        asked = [f"grid.spacing='{spacing}'", "operation.revolutions=1", "mixing.name=lax-wendroff"]
        case = compose(None, asked, FAST)
        blend = mix(case, obtain_flow(case, MPI.COMM_SELF).flow, MPI.COMM_SELF)
        assert blend.mass_drift < 1e-12
        curves[spacing] = np.array(blend.intensity)
    coarse, middle, fine = curves.values()
    assert np.abs(middle - fine).max() < 0.6 * np.abs(coarse - fine).max()
    assert curves["0.5 mm"][0] > 0.99
    assert fine[-1] < 0.6
