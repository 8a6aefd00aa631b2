"""Conjugate gradients on one rank, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from .krylov import NotSolved
from .shared_matrix import Share

_RESIDUAL = 1.0e-10
_MOST = 1000


class ConjugateGradients:
    """Solves systems of a symmetric, positive definite matrix near a mass matrix.

    ``share`` gives its values, columns and row starts; preconditioned by the diagonal, to a
    residual of 1e-10. Sums are in one order, so that the same load gives the same solution.
    """

    def __init__(self, share: Callable[[], Share]) -> None:
        self._share = share
        self._matrix: Share | None = None

    def update(self) -> None:
        """Follow the matrix as it stands; to be called before the first solve."""
        self._matrix = self._share()

    def solve(self, load: NDArray[Any], start: NDArray[Any]) -> NDArray[Any]:
        """Solution (n_unknowns,) for a ``load``, with ``start`` as a first guess."""
        assert self._matrix is not None
        found, residual = _iterate(*self._matrix, load, start)
        if not residual <= _RESIDUAL:
            raise NotSolved(
                f"The linear system of the fluidity or the level set was not solved in {_MOST} "
                f"iterations (residual {residual:.2g}): halve flow.time_step."
            )
        solution: NDArray[Any] = found
        return solution


@numba.njit(cache=True)
def _iterate(
    values: NDArray[Any],
    columns: NDArray[Any],
    starts: NDArray[Any],
    load: NDArray[Any],
    start: NDArray[Any],
) -> tuple[NDArray[Any], float]:
    """The solution and its residual relative to the load's, in the preconditioner's norm."""
    count = len(load)
    inverse = np.empty(count)
    for row in range(count):
        for k in range(starts[row], starts[row + 1]):
            if columns[k] == row:
                inverse[row] = 1.0 / values[k]
    found, residual, direction, image = start.copy(), load.copy(), start.copy(), start.copy()
    _multiply(values, columns, starts, found, image)
    whole, square = 0.0, 0.0
    for n in range(count):
        residual[n] -= image[n]
        direction[n] = inverse[n] * residual[n]
        square += residual[n] * direction[n]
        whole += load[n] * inverse[n] * load[n]
    for _ in range(_MOST):
        if not square > _RESIDUAL**2 * whole:
            break
        _multiply(values, columns, starts, direction, image)
        curvature = 0.0
        for n in range(count):
            curvature += direction[n] * image[n]
        step, before, square = square / curvature, square, 0.0
        for n in range(count):
            found[n] += step * direction[n]
            residual[n] -= step * image[n]
            square += residual[n] * inverse[n] * residual[n]
        for n in range(count):
            direction[n] = inverse[n] * residual[n] + square / before * direction[n]
    return found, np.sqrt(square / whole) if square > 0.0 else square


@numba.njit(cache=True)
def _multiply(
    values: NDArray[Any],
    columns: NDArray[Any],
    starts: NDArray[Any],
    vector: NDArray[Any],
    image: NDArray[Any],
) -> None:
    for row in range(len(vector)):
        total = 0.0
        for k in range(starts[row], starts[row + 1]):
            total += values[k] * vector[columns[k]]
        image[row] = total
