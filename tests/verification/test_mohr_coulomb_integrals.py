"""The flow's integrals over elements, against NGSolve's own assembly with the same quadrature."""

from types import SimpleNamespace

import ngsolve as ngs
import numpy as np
import pytest
from netgen.occ import Circle, Cylinder, OCCGeometry, Pnt, Z

from scaleup_mohr_coulomb.element_shapes import ElementShapes
from scaleup_mohr_coulomb.field_system import FieldSystem
from scaleup_mohr_coulomb.level_set import LevelSet
from scaleup_mohr_coulomb.surface_kernels import distances, positive_shares
from scaleup_mohr_coulomb.surface_transport import Transport
from scaleup_mohr_coulomb.velocity_terms import VelocityTerms
from scaleup_mohr_coulomb.vertex_shifts import vertex_shifts

TIME_STEP = 0.01


@pytest.fixture(scope="module", params=[2, 3])
def mesh(request):
    """A disc, or a short cylinder, with curved walls."""
    if request.param == 2:
        geometry = OCCGeometry(Circle(Pnt(0, 0), 1).Face(), dim=2)
    else:
        geometry = OCCGeometry(Cylinder(Pnt(0, 0, 0), Z, 1, 1))
    return ngs.Mesh(geometry.GenerateMesh(maxh=0.5)).Curve(2)


def random(space, seed):
    function = ngs.GridFunction(space)
    function.vec.FV().NumPy()[:] = np.random.default_rng(seed).normal(size=space.ndof)
    return function


def same_quadrature():
    rules = {kind: ngs.IntegrationRule(kind, 6) for kind in (ngs.TRIG, ngs.TET)}
    return ngs.dx(intrules=rules)


def dense(matrix, size):
    rows, columns, values = (np.array(part) for part in matrix.COO())
    full = np.zeros((size, size))
    full[rows, columns] = values
    return full


def test_momentum_matrix_and_load(mesh):
    """All terms, with a density, a viscosity and a velocity that vary."""
    space = ngs.VectorH1(mesh, order=2) * ngs.H1(mesh, order=1)
    (u, _), (v, _) = space.TnT()
    old = random(space.components[0], 1)
    rho, eta, factor = 2.0 + ngs.x, 1.0 + ngs.y * ngs.y, 3.0 + ngs.x * ngs.y
    forced = 1.0 + ngs.x
    force = (ngs.x + old[1], 2.0 * old[0], 0.5)[: mesh.dim]
    strain_rate = ngs.Sym(ngs.Grad(u))
    expected, load = ngs.BilinearForm(space), ngs.LinearForm(space)
    expected += (
        rho / TIME_STEP * ngs.InnerProduct(u, v)
        + 0.5 * TIME_STEP * rho * ngs.InnerProduct(ngs.Grad(u) * old, ngs.Grad(v) * old)
        + 2.0 * eta * ngs.InnerProduct(strain_rate, ngs.Grad(v))
        + factor * ngs.div(u) * ngs.div(v)
    ) * same_quadrature()
    push = forced * ngs.CoefficientFunction(force) + rho * (old / TIME_STEP - ngs.Grad(old) * old)
    load += ngs.InnerProduct(push, v) * same_quadrature()
    expected.Assemble()
    load.Assemble()

    shapes = ElementShapes(mesh)
    empty = ngs.BilinearForm(space, symmetric=True)
    empty += 0.0 * ngs.InnerProduct(u, v) * ngs.dx
    empty.Assemble()
    found = np.zeros(space.ndof)

    def acceleration(points, velocity):
        parts = points[..., 0] + velocity[..., 1], 2.0 * velocity[..., 0], 0.5 + 0 * points[..., 0]
        return np.stack(parts[: mesh.dim], axis=-1)

    VelocityTerms(space.components[0], empty.mat, shapes).add(
        found,
        *(shapes.sampled(ngs.CoefficientFunction(c)) for c in (rho, forced, eta, factor)),
        old.vec.FV().NumPy(),
        TIME_STEP,
        acceleration,
    )
    wanted = dense(expected.mat, space.ndof)
    error = np.abs(dense(empty.mat, space.ndof) - wanted).max()
    assert error < 1e-12 * np.abs(wanted).max()
    wanted = load.vec.FV().NumPy()
    assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_a_step_of_transport_minimises_the_residual(mesh):
    """The derivative of its square with respect to phi vanishes, by NGSolve's own integrals."""
    field = random(ngs.H1(mesh, order=2), 2)
    before = field.vec.FV().NumPy().copy()
    velocity = ngs.CoefficientFunction((ngs.y, -ngs.x, ngs.x * ngs.y)[: mesh.dim])
    level_set = SimpleNamespace(field=field, space=field.space)
    Transport(level_set, velocity, ngs.Parameter(TIME_STEP), ElementShapes(mesh)).step()
    old = ngs.GridFunction(field.space)
    old.vec.FV().NumPy()[:] = before
    s = field.space.TestFunction()
    half = 0.5 * TIME_STEP
    residual = field - old + half * ngs.InnerProduct(velocity, ngs.grad(field) + ngs.grad(old))
    derivative, scale = ngs.LinearForm(field.space), ngs.LinearForm(field.space)
    derivative += (
        residual * (s + half * ngs.InnerProduct(velocity, ngs.grad(s))) * same_quadrature()
    )
    scale += old * s * same_quadrature()
    derivative.Assemble()
    scale.Assemble()
    most = np.abs(scale.vec.FV().NumPy()).max()
    assert np.abs(derivative.vec.FV().NumPy()).max() < 1e-7 * most  # iterative in space


@pytest.mark.parametrize("order", [1, 2])
def test_a_field_system_solves_for_what_its_blocks_say(mesh, order):
    """The projection of a function of the space is that function."""
    space = ngs.H1(mesh, order=order)
    wanted = random(space, 3)
    shapes, system = ElementShapes(mesh), FieldSystem(space)
    values = shapes.values[:, : system.dofs.shape[1]]
    system.blocks[:] = np.einsum("eq,qi,qj->eij", shapes.weights, values, values)
    system.update()
    loads = (shapes.weights * shapes.sampled(wanted)) @ values
    found = system.solve(loads, np.zeros(space.ndof))
    assert found == pytest.approx(wanted.vec.FV().NumPy(), abs=1e-6)


@pytest.fixture(scope="module")
def wavy():
    """A level set with a wave and an island on a disc."""
    disc = Circle(Pnt(0, 0), 1).Face()
    disc = ngs.Mesh(OCCGeometry(disc, dim=2).GenerateMesh(maxh=0.2)).Curve(2)
    level_set = LevelSet(disc, 0.1)

    def distance(points):
        island = 0.15 - np.hypot(points[:, 0], points[:, 1] - 0.6)
        return np.maximum(0.1 * np.sin(5.0 * points[:, 0]) - points[:, 1], island)

    level_set.set_surface(1.6, distance)
    return level_set


def test_areas_contour_and_weights_on_the_lattice_agree(wavy):
    """The divergence theorem of what is inside; weights are derivatives of the area."""
    lattice, values = wavy.lattice, wavy.lattice_values()
    corners = lattice.points[:, lattice.triangles]
    inside = np.where(values[:, lattice.triangles] > 0.0, 1.0, 0.0).mean(axis=(1, 2))
    areas = lattice.areas(values)
    whole = lattice.areas(np.ones_like(values))
    assert np.array_equal(areas[inside == 1.0], whole[inside == 1.0])
    assert not areas[inside == 0.0].any()
    assert np.all((areas >= 0.0) & (areas <= whole * (1 + 1e-12)))

    a, b, c = np.moveaxis(values[:, lattice.triangles], -1, 0)
    alone = (a > 0.0) & (b <= 0.0) & (c <= 0.0)
    share = np.zeros(a.shape)
    share[alone] = (a**2 / ((a - b) * (a - c)))[alone]
    found = positive_shares(np.stack([a, b, c], axis=-1)[alone])
    assert found == pytest.approx(share[alone], rel=1e-12)
    assert positive_shares(-np.stack([a, b, c], axis=-1)[alone]) == pytest.approx(1.0 - found)

    start, end = wavy.contour()
    away = distances(0.5 * (start + end), start, end)
    assert away == pytest.approx(0.0, abs=1e-12)
    points, along = corners.reshape(-1, 2)[:50], np.linspace(0.0, 1.0, 2001)[:, None, None]
    dense = (along * start + (1.0 - along) * end).reshape(-1, 2)
    apart = np.array([np.linalg.norm(dense - point, axis=1).min() for point in points])
    assert distances(points, start, end) == pytest.approx(apart, abs=1e-4)
    length = np.linalg.norm(end - start, axis=1).sum()
    weights = lattice.contour_weights(values, 1e-6)
    assert weights.sum() == pytest.approx(length, rel=0.1)  # |grad phi| is not 1


def test_shifts_at_vertices_solve_their_equations(wavy):
    """Against a dense solution on all vertices near; all that is missing is given back."""
    triangles, count, spread = wavy._corners, wavy.mesh.nv, 0.1
    lengths = wavy.lattice.contour_weights(wavy.lattice_values(), 1e-4)
    missing = 1e-4 * np.random.default_rng(1).normal(size=len(triangles)) * lengths.any(axis=1)
    found = vertex_shifts(triangles, missing, lengths, spread, count)

    near = np.isin(triangles, triangles[lengths.any(axis=1)]).any(axis=1)
    matrix, wanted = np.zeros((count, count)), np.zeros(count)
    for triangle, want, length in zip(triangles[near], missing[near], lengths[near], strict=True):
        matrix[np.ix_(triangle, triangle)] += 0.5 * spread * (3.0 * np.eye(3) - 1.0)
        matrix[triangle, triangle] += length
        wanted[triangle] += want / 3.0
    used = np.unique(triangles[near])
    assert found[used] == pytest.approx(
        np.linalg.solve(matrix[np.ix_(used, used)], wanted[used]), rel=1e-6, abs=1e-12
    )
    assert np.delete(found, used) == pytest.approx(0.0)
    assert (lengths * found[triangles]).sum() == pytest.approx(missing.sum(), rel=1e-6)
    assert not vertex_shifts(triangles, 0.0 * missing, 0.0 * lengths, spread, count).any()
