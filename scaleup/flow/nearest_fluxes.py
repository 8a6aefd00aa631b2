"""The fluxes nearest to given ones that have a given divergence.

Between cells that share open faces, with F* the given fluxes and w > 0 their weights,

    minimise  sum over faces of (F - F*)^2 / w    such that    each cell gives off what it is to,

whose solution is F = F* + w (phi_lower - phi_upper): a potential phi with a weighted graph
Laplacian, solved for by an exchangeable `Solver`. What that leaves over it gets again, or it goes
along a spanning tree of each part that hangs together, from its leaves to its root, so that the
divergence is exact to round-off however loosely phi was solved for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.sparse import csr_matrix

from scaleup.flow.spanning_tree import (
    SpanningTree,
    breadth_first,
    in_quanta,
    missing_outflow,
    send_down,
)
from scaleup.space.grid import FloatArray, IntArray
from scaleup.system.errors import RunError

_AGAIN = 2  # times
_ROUND_OFF = 2.0**-53  # of the greatest flux
_QUANTUM = 2.0**-48  # over the greatest flux; sums up to 32 times that one are exact


@dataclass(frozen=True)
class Faces:
    """Open faces between cells, which hang together in parts.

    count        -- of cells
    lower, upper -- the cell on either side of each face: fluxes run from the one to the other
    """

    count: int
    lower: IntArray
    upper: IntArray

    @cached_property
    def tree(self) -> SpanningTree:
        """A spanning tree of each part."""
        return SpanningTree(*breadth_first(self.count, self.lower, self.upper))

    def missing(self, outflow: FloatArray, flux: FloatArray) -> FloatArray:
        """What each cell still has to give off beyond what the fluxes carry, m^3/s."""
        missing: FloatArray = missing_outflow(self.lower, self.upper, outflow, flux)
        return missing


Solver = Callable[[Faces, FloatArray], AbstractContextManager[Callable[[FloatArray], FloatArray]]]
"""`with solver(faces, weight) as solve`: solve(outflow) is the phi with which the sum over a cell's
faces of w (phi - phi_other) is its outflow, to the solver's own tolerance. Raises RunError."""


def nearest_fluxes(
    faces: Faces,
    given: FloatArray,
    weight: FloatArray,
    outflow: FloatArray,
    solver: Solver,
    rest: Literal["again", "tree", "quanta"],
) -> tuple[FloatArray, FloatArray]:
    """The fluxes (m^3/s), and the potential of their change as it was solved for at first.

    given   -- m^3/s through each face; weight -- > 0, of each face
    outflow -- m^3/s that each cell gives off, zero in total over every part
    rest    -- where what the solver leaves over goes. "again": back to it, until each cell is off
               by the round-off of its own fluxes; what a part lacks is shared out among its cells.
               "tree": along the tree; a root gets the round-off of its part. "quanta": the same in
               whole numbers of a quantum of flux, 2^-48 of the greatest, whose sums are exact: a
               root of millions of faces gets no more than other cells
    Raises RunError if the solver does. Runs on this process alone.

    Two cells give off what a third one takes:

    >>> faces = Faces(3, np.array([0, 1]), np.array([1, 2]))
    >>> outflow = np.array([1.0, 1.0, -2.0])
    >>> flux, _ = nearest_fluxes(faces, np.zeros(2), np.ones(2), outflow, multigrid(1e-8), "tree")
    >>> flux
    array([1., 2.])
    """
    tree = faces.tree
    with solver(faces, weight) as solve:
        missing = faces.missing(outflow, given)
        potential = solve(tree.evened(missing) if rest == "again" else missing)
        flux = given + weight * (potential[faces.lower] - potential[faces.upper])
        greatest = max(np.abs(flux).max(initial=0.0), np.abs(outflow).max(initial=0.0))
        for _ in range(_AGAIN if rest == "again" else 0):
            missing = tree.evened(faces.missing(outflow, flux))
            if np.abs(missing).max(initial=0.0) <= _ROUND_OFF * greatest:
                break
            more = solve(missing)
            flux += weight * (more[faces.lower] - more[faces.upper])
    if rest == "again":
        return flux, potential
    if rest == "quanta" and greatest > 0:
        quantum = _QUANTUM * 2.0 ** np.ceil(np.log2(greatest))
        flux = quantum * np.rint(flux / quantum)
        outflow = in_quanta(outflow, tree.part, len(tree.roots), quantum)
    missing = faces.missing(outflow, flux)
    send_down(tree.order, tree.link, faces.lower, faces.upper, flux, missing)
    return flux, potential


def multigrid(tolerance: float, kind: str = "gamg", most: int = 1000) -> Solver:
    """Conjugate gradients with algebraic multigrid, of PETSc: for any faces and weights.

    tolerance -- residual that is left, relative to the right side
    kind      -- PETSc's preconditioner: "gamg" or "hypre"
    """

    @contextmanager
    def prepared(faces: Faces, weight: FloatArray) -> Iterator[Callable[[FloatArray], FloatArray]]:
        n = faces.count
        if len(weight) == 0:
            yield np.zeros_like
            return
        ends = np.bincount(faces.lower, weight, n), np.bincount(faces.upper, weight, n)
        diagonal = (ends[0] + ends[1]).astype(float)
        roots = faces.tree.roots  # where the potential is held
        diagonal[roots] += np.where(diagonal[roots] > 0, diagonal[roots], 1.0)
        matrix = laplacian(diagonal, faces.lower, faces.upper, weight)
        with conjugate_gradients(matrix, tolerance, kind, most) as solve:
            yield solve

    return prepared


def laplacian(diagonal: FloatArray, lower: IntArray, upper: IntArray, weight: FloatArray) -> Any:
    """The matrix of a weighted graph with a given diagonal, in scipy's CSR format."""
    ids = np.arange(len(diagonal))
    rows, columns = np.concatenate([ids, lower, upper]), np.concatenate([ids, upper, lower])
    entries = np.concatenate([diagonal, -weight, -weight])
    return csr_matrix((entries, (rows, columns)), shape=(len(ids), len(ids)))


@contextmanager
def conjugate_gradients(
    matrix: Any, tolerance: float, kind: str = "gamg", most: int = 1000
) -> Iterator[Callable[[FloatArray], FloatArray]]:
    """Solves with a symmetric positive definite matrix; see `multigrid`."""
    from petsc4py import PETSc

    index = PETSc.IntType
    csr = (matrix.indptr.astype(index), matrix.indices.astype(index), matrix.data)
    operator = PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)
    method = PETSc.KSP().create(PETSc.COMM_SELF)
    method.setOperators(operator)
    method.setType("cg")
    method.getPC().setType(kind)
    method.setTolerances(rtol=tolerance, max_it=most)
    solution, load = operator.createVecs()

    def solve(right: FloatArray) -> FloatArray:
        load.setArray(right)
        method.solve(load, solution)
        if method.getConvergedReason() <= 0:
            raise RunError("the fluxes nearest to the flow's were not found: no convergence")
        found: FloatArray = solution.getArray().copy()
        return found

    try:
        yield solve
    finally:
        for handle in (method, operator, solution, load):  # they outlive their last use otherwise
            handle.destroy()
