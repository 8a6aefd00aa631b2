"""Fluxes of a given divergence: exact however loosely they are solved for, nearest if tightly."""

import numpy as np
import pytest

from scaleup.numerics import Faces, lattice_gradients, multigrid, nearest_fluxes


@pytest.fixture
def two_boxes():
    """Neighbours of the cells of a lattice in two parts, and what they give off."""
    random = np.random.default_rng(5)
    solid = np.zeros((9, 10, 11), dtype=bool)
    solid[:4], solid[5:] = True, True
    number = np.full(tuple(n + 2 for n in solid.shape), -1)
    number[1:-1, 1:-1, 1:-1][solid] = np.arange(solid.sum())
    sides = [
        [np.roll(number, step, 2 - axis)[1:-1, 1:-1, 1:-1][solid] for axis in range(3)]
        for step in (1, -1)
    ]
    outflow = random.normal(size=solid.sum())
    for part in (slice(0, 440), slice(440, None)):
        outflow[part] -= outflow[part].mean()
    return *np.array(sides), np.argwhere(solid)[:, ::-1], outflow


def test_solvers_can_be_exchanged(two_boxes):
    below, above, coordinates, outflow = two_boxes
    rows, upper = np.nonzero(below >= 0)
    faces = Faces(len(outflow), below[rows, upper], upper)
    assert np.array_equal(faces.tree.roots, [0, 440])
    given = np.random.default_rng(6).normal(size=len(upper))
    solvers = {"lattice": lambda tolerance: lattice_gradients(below, above, coordinates, tolerance)}
    solvers |= {kind: lambda t, kind=kind: multigrid(t, kind) for kind in ("gamg", "hypre")}
    tight = {}
    for name, solver in solvers.items():
        for tolerance, rest in ((0.1, "tree"), (0.1, "quanta"), (1e-9, "again")):
            flux, potential = nearest_fluxes(
                faces, given, np.ones(len(upper)), outflow, solver(tolerance), rest
            )
            assert np.abs(faces.missing(outflow, flux)).max() < 3e-14 * np.abs(flux).max()
        gradient = potential[faces.lower] - potential[upper]
        assert np.abs(flux - given - gradient).max() < 1e-6
        tight[name] = flux
    for name in solvers:
        assert np.abs(tight[name] - tight["hypre"]).max() < 1e-12
