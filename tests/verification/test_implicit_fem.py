"""Implicit finite elements: order, any step, bounds, mass, solver, ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.contract import FlowField, InputError, Ledger, MixingScene, RunError
from scaleup.mixing.scene import mixing_scene
from scaleup.scene.models import Diffusion
from scaleup.scene.shear_diffusion import shear_diffusion
from scaleup.testing import check_mixing
from scaleup.verification import fitted_order, problems, run
from scaleup.verification.stability_map import breaks_bounds, grows, maker, uniform_scene
from scaleup_finite_volume import FiniteVolume
from scaleup_implicit_fem import ImplicitFem
from scaleup_implicit_fem.stability import amplification
from synthetic import sloshing

ROUND_OFF = 1e-12
DIRECT = "-ksp_type preonly -pc_type lu"


def backend(**options) -> ImplicitFem:
    return ImplicitFem(ImplicitFem.Options(**options))


def scene_of(flow: FlowField, grain: float = 3e-3) -> MixingScene:
    laws = [shear_diffusion(Diffusion(), grain)]
    return mixing_scene(backend(), flow, MPI.COMM_SELF, laws)


def started(problem, n: int, **options):
    """A backend at the start of a problem, and its flow."""
    flow, solver = problem.flow(n), backend(**options)
    scene = mixing_scene(solver, flow, MPI.COMM_SELF, problem.laws)
    solver.start(scene, problem.initial(flow))
    return solver, flow


@pytest.mark.parametrize(("name", "sizes"), [("gaussian", (64, 128)), ("vortex", (32, 64, 128))])
def test_second_order_in_space_and_more_without_strain(name, sizes):
    results = [run(problems()[name], backend(), n) for n in sizes]
    assert fitted_order(results) >= (3.5 if name == "gaussian" else 1.9)


def test_order_in_time():
    """Against a much smaller step on the same cells; c within (0, 1): nothing is limited."""
    problem = problems()["sheared-disc"]
    flow = problem.flow(32)
    body = 0.3 + 0.4 * problem.initial(flow)[0]
    problem = replace(problem, initial=lambda flow: np.stack([body, 1 - body]), duration=0.5)
    ends = {}
    for steps in (8, 16, 32, 256):
        solver, flow = started(problem, 32, time_step=0.5 / steps, tolerance=1e-12)
        assert solver.advance(0, 0.0, 0.5).steps == steps
        ends[steps] = solver.concentration(flow.intervals[0])[0]
    errors = [np.abs(ends[steps] - ends[256]).mean() for steps in (8, 16, 32)]
    assert np.log2(errors[1] / errors[2]) >= 1.9, errors
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]


def test_at_five_explicit_steps_the_error_is_that_of_the_explicit_default():
    problem = problems()["gaussian"]
    explicit = run(problem, FiniteVolume(FiniteVolume.Options()), 128)
    implicit = run(problem, backend(courant=5), 128)
    assert implicit.steps < explicit.steps / 4.5
    assert implicit.l1 < 2 * explicit.l1


@pytest.mark.parametrize("courant", [20, 100])
@pytest.mark.parametrize("name", ["gaussian", "zalesak"])
def test_far_longer_steps_are_stable_and_bounded(name, courant):
    result = run(problems()[name], backend(courant=courant, petsc_options=DIRECT), 64)
    assert result.minimum >= -ROUND_OFF
    assert result.maximum <= 1 + ROUND_OFF
    assert abs(result.mass_drift) <= ROUND_OFF
    assert result.l1 < 2.0  # what lies elsewhere altogether has 2


def test_jumps_are_kept_sharp_within_bounds():
    result = run(problems()["zalesak"], backend(), 100)
    assert result.l1 <= 0.21
    assert result.minimum >= -ROUND_OFF
    assert result.maximum <= 1 + ROUND_OFF


def test_diffusion_with_mixed_derivatives():
    result = run(problems()["anisotropic"], backend(), 64)
    assert result.l1 < 0.006
    assert result.variance_ratio == pytest.approx(1.0, abs=1e-3)


def test_a_wave_on_a_uniform_flow_is_multiplied_as_stated():
    """Fluxes, mass, diffusion, filter and time scheme at once, by one step of a single wave."""
    cells, turns = 24, (5, 3)
    scene = uniform_scene(backend(), 2.0, 0.3, 30.0, MPI.COMM_SELF, cells)
    grid, flow = scene.flow.grid, scene.flow
    theta = 2 * np.pi * np.array(turns) / cells
    phase = np.arange(cells)[None, :] * theta[0] + np.arange(cells)[:, None] * theta[1]
    c = 0.5 + 0.3 * np.cos(phase).ravel()
    solver = backend(time_step=1.0, tolerance=1e-13)
    solver.start(scene, np.stack([c, 1 - c]))
    solver.advance(0, 0.0, 1.0)
    after = solver.concentration(flow.intervals[0])[0]
    measured = 2 * abs(np.mean((after - 0.5) * np.exp(-1j * phase.ravel()))) / 0.3
    nu = flow.intervals[0].flux[:, 0] / grid.cell_volume
    mu = scene.tensor(flow.intervals[0])[:, :, 0]
    assert measured == pytest.approx(float(amplification(nu, mu, theta)), rel=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_no_wave_grows_at_any_step(dimension):
    rng, count = np.random.default_rng(3), 4000
    nu = rng.standard_normal((dimension, count)) * 10 ** rng.uniform(-2, 3, count)
    root = rng.standard_normal((dimension, dimension, count))
    mu = np.einsum("ikn,jkn->ijn", root, root) * 10 ** rng.uniform(-4, 3, count)
    mu *= rng.random(count) < 0.5
    for _ in range(200):
        theta = rng.uniform(-np.pi, np.pi, (dimension, count))
        assert amplification(nu, mu, theta).max() <= 1 + 1e-9


@pytest.mark.parametrize("step", [3.0, 60.0])
def test_noise_does_not_grow_and_bounds_hold_whatever_the_step(step):
    make = maker(ImplicitFem, ImplicitFem.Options(petsc_options=DIRECT))
    for angle, number in ((0.0, 0.0), (33.0, 0.0), (45.0, 0.2)):
        scene = uniform_scene(backend(), 1.0, number, angle, MPI.COMM_SELF)
        assert not grows(make, scene, step)
        assert not breaks_bounds(make, scene, step)


def test_the_matrices_are_what_they_should_be():
    """On cut cells and a moving fill: rows, columns, signs."""
    for name, n in (("full-drum", 24), ("sloshing", 24), ("sloshing-3d", 12)):
        solver, _ = started(problems()[name], n)
        transport = solver.running
        bed = transport.bed
        gain = bed.interval.duration * 1e-3
        begins = bed.interval.start
        fraction = bed.unknowns.fraction
        loss = (fraction(begins) - fraction(begins + gain)) / gain
        low, mass = transport._low.toarray(), transport._mass.toarray()
        high = transport._high.toarray()
        off = ~np.eye(len(low), dtype=bool)
        assert low[off].max() <= 0  # of positive type
        scale = np.abs(low).max()
        for matrix in (low, high):  # uniform stays uniform; nothing is lost
            assert np.abs(matrix.sum(axis=1) - loss).max() < 1e-9 * scale
            assert np.abs(matrix.sum(axis=0)).max() < 1e-12 * scale
        assert np.abs(mass.sum(axis=0)).max() < 1e-14
        middle = begins + 0.5 * bed.interval.duration
        whole = mass + np.diag(fraction(middle))
        assert np.linalg.eigvalsh(whole).min() > -1e-14  # round-off
        if name == "full-drum":  # no diffusion, steady: energy is kept
            assert np.abs(high + high.T).max() < 1e-12 * scale


@pytest.mark.parametrize("components", [2, 5])
def test_mass_and_bounds_on_a_moving_fill_with_diffusion(components):
    flow = sloshing(columns=24, rows=12)
    start = np.random.default_rng(1).integers(0, components, len(flow.intervals[0].cells))
    c = (start == np.arange(components)[:, None]).astype(float)
    solver, ledger = backend(), Ledger()
    solver.start(scene_of(flow), c)
    for index, begin, end in flow.schedule(0.0, 4 * flow.period):
        ledger.add(solver.advance(index, begin, end))
    interval = flow.intervals[index]
    after = solver.concentration(interval)
    drift = after @ interval.fill_end / (c @ flow.intervals[0].fill_start) - 1.0
    assert np.abs(drift).max() <= ROUND_OFF
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF
    assert after.sum(axis=0) == pytest.approx(1.0, abs=ROUND_OFF)
    assert ledger.iterations > 5 * ledger.steps


def test_mass_and_bounds_on_a_moving_fill_in_3d():
    flow = problems()["sloshing-3d"].flow(12)
    rough = np.random.default_rng(2).integers(0, 2, len(flow.intervals[0].cells)).astype(float)
    solver, ledger = backend(), Ledger()
    solver.start(scene_of(flow, grain=2e-2), np.stack([rough, 1.0 - rough]))
    for index, begin, end in flow.schedule(0.0, flow.period):
        ledger.add(solver.advance(index, begin, end))
    interval = flow.intervals[index]
    after = solver.concentration(interval)[0] @ interval.fill_end
    assert after == pytest.approx(rough @ flow.intervals[0].fill_start, rel=ROUND_OFF)
    assert ledger.minimum >= -ROUND_OFF
    assert ledger.maximum <= 1.0 + ROUND_OFF


def test_contract_with_several_components():
    flow = sloshing(columns=24, rows=12)
    c = np.random.default_rng(1).random((4, len(flow.intervals[0].cells)))
    check_mixing(backend(), scene_of(flow), c / c.sum(axis=0), 1.6)


def test_a_bed_at_rest_stays_as_it_is():
    flow = sloshing(columns=24, rows=12)
    part = flow.intervals[0]
    still = replace(part, flux=np.zeros_like(part.flux), fill_end=part.fill_start)
    flow = replace(flow, intervals=[still], prefix=0)
    c = np.random.default_rng(4).random(len(part.cells))
    solver = backend()
    solver.start(mixing_scene(solver, flow, MPI.COMM_SELF), np.stack([c, 1 - c]))
    assert solver.advance(0, part.start, part.end).iterations == 0
    assert solver.concentration(still)[0] == pytest.approx(c, abs=1e-15)


def test_iterations_do_not_grow_with_the_number_of_cells():
    counts = []
    for n in (64, 256):
        solver, _ = started(problems()["gaussian"], n)
        step = 5 * solver.running.bed.explicit_step
        counts.append(solver.advance(0, 0.0, 4 * step).iterations)
    assert 0.5 < counts[1] / counts[0] < 2


def test_the_solver_can_be_chosen_and_a_direct_one_agrees():
    results = [
        run(problems()["sheared-disc"], backend(petsc_options=options), 32)
        for options in ("", DIRECT, "-ksp_type bcgs -pc_type jacobi")
    ]
    for other in results[1:]:
        assert other.concentration == pytest.approx(results[0].concentration, abs=1e-7)


def test_a_solve_that_does_not_converge_is_an_error():
    solver, _ = started(problems()["gaussian"], 32, petsc_options="-ksp_max_it 1")
    with pytest.raises(
        RunError, match=r"did not converge in 1 iterations .* reduce mixing\.courant"
    ):
        solver.advance(0, 0.0, 0.1)


def test_values_that_petsc_does_not_know_are_refused():
    solver, _ = started(problems()["gaussian"], 32, petsc_options="-ksp_type nonsense")
    with pytest.raises(InputError, match=r"petsc_options = .*nonsense"):
        solver.advance(0, 0.0, 0.1)


RANKS = """
import sys
import numpy as np
from mpi4py import MPI
from scaleup.verification import problems, run
from scaleup_implicit_fem import ImplicitFem

for name, n in (("full-drum", 16), ("sloshing-3d", 6)):
    backend = ImplicitFem(ImplicitFem.Options(tolerance=1e-13))
    result = run(problems()[name], backend, n, MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        np.save(f"{sys.argv[1]}/{name}.npy", result.concentration)
"""


def test_one_two_and_three_ranks_agree_to_the_solvers_tolerance(on_ranks, tmp_path):
    fields = {}
    for ranks in (1, 2, 3):
        on_ranks(ranks, RANKS, str(tmp_path))
        fields[ranks] = [np.load(tmp_path / f"{name}.npy") for name in ("full-drum", "sloshing-3d")]
    for ranks in (2, 3):
        for one, several in zip(fields[1], fields[ranks], strict=True):
            assert np.abs(several - one).max() < 1e-9
