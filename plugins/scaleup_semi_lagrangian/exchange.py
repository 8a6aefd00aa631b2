"""Diffusion as exchange between pairs of cells, conservative and bounded for any tensor.

In units of cells the tensor of a cell is a sum of non-negative weights times squares of vectors of
whole numbers (Selling 1874; Fehrenbach & Mirebeau 2014, J. Math. Imaging Vis. 49, 123),

    D_ab/(h_a h_b) = sum over e of w_e e_a e_b,

so that div(D grad c) is the sum over e of w_e (c(x + e) - 2 c(x) + c(x - e)): three vectors in the
plane, six in space, among the nearest cells unless D is very anisotropic. A pair exchanges what the
smaller fill fraction of the two allows. Forward Euler; limit of positivity: what leaves a cell in a
step is at most what it holds.
"""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray

_SHARE = 0.3  # of the limit of positivity that a step uses
_LEAST = 1e-13  # fill fraction of a cell that takes part
_FLIPS = 100


class Exchange:
    """The pairs of an interval in a rank's local arrays: each cell's with those at +-e.

    reach -- greatest whole number in a vector, along any axis
    """

    def __init__(
        self, tensor: FloatArray, spacing: tuple[float, ...], position: IntArray,
        strides: tuple[int, ...], owned: BoolArray,
    ):  # fmt: skip
        """Exchanges of the cells at `position` in flattened local arrays, ghosts too.

        tensor -- (d, d, n) of these cells, m^2/s; owned -- flags of all local cells
        """
        h = np.array(spacing)
        scaled = tensor / np.multiply.outer(h, h)[:, :, None]
        vectors, weights = _decompose(np.ascontiguousarray(scaled))
        used = weights > 0.0
        self.reach = int(np.abs(vectors[:, used]).max()) if used.any() else 0
        # single precision is enough for rates: what one cell loses the other gets, to round-off
        self._weight = np.ascontiguousarray(weights.T, dtype=np.float32)
        along = np.tensordot(np.array(strides), vectors, axes=1)
        self._along = np.ascontiguousarray(along.T, dtype=np.int32)
        self._cell = position.astype(np.int32)
        self._touched = _touched(self._cell, self._along, self._weight, owned)
        self._fastest: dict[float, float] = {}

    def fastest(
        self, share: float, fraction: FloatArray, largest: Callable[[float], float]
    ) -> float:
        """What the cell that loses fastest gives over what it holds, on any rank, 1/s; collective.

        With the fill fractions (in local arrays) at a share of the interval, known from then on.
        """
        if share not in self._fastest:
            loss = np.zeros(len(fraction))
            _add_losses(loss, self._cell, self._along, self._weight, fraction)
            here = self._touched[fraction[self._touched] > _LEAST]
            rates = loss[here] / fraction[here]
            self._fastest[share] = largest(float(rates.max(initial=0.0)))
        return self._fastest[share]

    def step(self, c: FloatArray, gain: FloatArray, fraction: FloatArray, dt: float) -> None:
        """A step (s) of c (components, cells) on the owned cells; `gain` is work space."""
        _step(c, gain, self._cell, self._along, self._weight, fraction, self._touched, dt)

    @property
    def bytes(self) -> int:
        """Memory held."""
        held = (self._weight, self._along, self._cell, self._touched)
        return sum(array.nbytes for array in held)


def steps(duration: float, fastest: float) -> int:
    """How many equal steps a time (s) takes."""
    return max(1, int(np.ceil(duration * fastest / _SHARE)))


@numba.njit(cache=True)
def _touched(cell: IntArray, along: IntArray, weight: FloatArray, owned: BoolArray) -> IntArray:
    """Positions of the owned cells that exchange with any, ascending."""
    flags = np.zeros(len(owned), dtype=np.bool_)
    for n in range(len(cell)):
        for e in range(weight.shape[1]):
            if weight[n, e] == 0.0:
                continue
            for side in range(-1, 2):
                other = cell[n] + side * along[n, e]
                if 0 <= other < len(owned) and owned[other]:
                    flags[other] = True
    return np.flatnonzero(flags).astype(np.int32)


@numba.njit(cache=True)
def _add_losses(
    loss: FloatArray, cell: IntArray, along: IntArray, weight: FloatArray, fraction: FloatArray
) -> None:
    for n in range(len(cell)):
        i = cell[n]
        if fraction[i] <= _LEAST:
            continue
        for e in range(weight.shape[1]):
            if weight[n, e] == 0.0:
                continue
            for j in (i + along[n, e], i - along[n, e]):
                # ghosts exchange with cells beyond the local arrays too
                if 0 <= j < len(fraction) and fraction[j] > _LEAST:
                    conductance = 0.5 * weight[n, e] * min(fraction[i], fraction[j])
                    loss[i] += conductance
                    loss[j] += conductance


# The loop of `_add_losses` again: with one function for a pair's conductance in both, a step took
# 0.86 ms instead of 0.36 (25,000 cells).
@numba.njit(cache=True)
def _step(
    c: FloatArray,
    gain: FloatArray,
    cell: IntArray,
    along: IntArray,
    weight: FloatArray,
    fraction: FloatArray,
    touched: IntArray,
    dt: float,
) -> None:
    for q in range(c.shape[0]):
        gain[touched] = 0.0
        for n in range(len(cell)):
            i = cell[n]
            if fraction[i] <= _LEAST:
                continue
            for e in range(weight.shape[1]):
                if weight[n, e] == 0.0:
                    continue
                for j in (i + along[n, e], i - along[n, e]):
                    if 0 <= j < len(fraction) and fraction[j] > _LEAST:
                        conductance = 0.5 * weight[n, e] * min(fraction[i], fraction[j])
                        moved = dt * conductance * (c[q, j] - c[q, i])
                        gain[i] += moved
                        gain[j] -= moved
        for i in touched:
            if fraction[i] > _LEAST:
                c[q, i] += gain[i] / fraction[i]


@numba.njit(cache=True)
def _decompose(tensor: FloatArray) -> tuple[IntArray, FloatArray]:
    """Vectors (d, number, n) and weights (number, n) of tensors (d, d, n)."""
    d, n = tensor.shape[0], tensor.shape[2]
    number = 3 if d == 2 else 6
    vectors = np.zeros((d, number, n), dtype=np.int64)
    weights = np.zeros((number, n))
    base = np.zeros((d + 1, d), dtype=np.int64)
    products = np.zeros((d + 1, d + 1))
    for cell in range(n):
        base[:] = 0
        for a in range(d):
            base[a, a] = 1
            base[d, a] = -1
        trace = 0.0
        for a in range(d):
            trace += tensor[a, a, cell]
        for _ in range(_FLIPS):
            worst, wi, wj = 1e-12 * trace, -1, -1
            for i in range(d + 1):
                for j in range(i):
                    value = 0.0
                    for a in range(d):
                        for b in range(d):
                            value += base[i, a] * tensor[a, b, cell] * base[j, b]
                    products[i, j] = products[j, i] = value
                    if value > worst:
                        worst, wi, wj = value, i, j
            if wi < 0:
                break
            # the pair (i, j) is made obtuse; the vectors still sum to 0
            for a in range(d):
                if d == 2:
                    base[3 - wi - wj, a] = base[wi, a] - base[wj, a]
                else:
                    for k in range(4):
                        if k != wi and k != wj:
                            base[k, a] += base[wi, a]
                base[wi, a] = -base[wi, a]
        count = 0
        for i in range(d + 1):
            for j in range(i):
                if d == 2:
                    k = 3 - i - j
                    vectors[0, count, cell] = -base[k, 1]
                    vectors[1, count, cell] = base[k, 0]
                else:
                    k = -1
                    m = -1
                    for other in range(4):
                        if other != i and other != j:
                            if k < 0:
                                k = other
                            else:
                                m = other
                    for a in range(3):
                        b, e = (a + 1) % 3, (a + 2) % 3
                        vectors[a, count, cell] = base[k, b] * base[m, e] - base[k, e] * base[m, b]
                weights[count, cell] = max(-products[i, j], 0.0)
                count += 1
    return vectors, weights
