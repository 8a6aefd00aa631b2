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

from scaleup.api import BoolArray, FloatArray, IntArray

_SHARE = 0.3  # of the limit of positivity that a step uses
_LEAST = 1e-13  # fill fraction of a cell that takes part
_FLIPS = 100


class Exchange:
    """The pairs of an interval in a rank's local arrays.

    first, second -- positions in flattened local arrays; weight -- 1/s
    reach -- greatest whole number in a vector, along any axis
    """

    def __init__(
        self, tensor: FloatArray, spacing: tuple[float, ...], position: IntArray,
        strides: tuple[int, ...],
    ):  # fmt: skip
        """`tensor` (d, d, n) in m^2/s of the cells at `position` in local arrays, ghosts too."""
        active = np.flatnonzero(tensor[range(len(strides)), range(len(strides))].max(axis=0) > 0)
        h = np.array(spacing)
        scaled = tensor[:, :, active] / np.multiply.outer(h, h)[:, :, None]
        vectors, weights = _decompose(np.ascontiguousarray(scaled))
        used = weights > 0.0
        self.reach = int(np.abs(vectors[:, used]).max()) if used.any() else 0
        offsets = np.tensordot(np.array(strides), vectors, axes=1)  # (vectors, n)
        here = np.broadcast_to(position[active], offsets.shape)[used]
        there = offsets[used]
        half = 0.5 * weights[used]
        self.first = np.concatenate([here, here]).astype(np.int32)
        self.second = np.concatenate([here + there, here - there]).astype(np.int32)
        self.weight = np.concatenate([half, half])


class Pairs:
    """The pairs of an `Exchange` that hold material at a time, with an owned cell among the two.

    fastest -- 1/s, what the cell that loses fastest gives over what it holds, on any rank
    """

    def __init__(
        self,
        exchange: Exchange,
        fraction: FloatArray,
        owned: BoolArray,
        largest: Callable[[float], float],
    ):
        """Collective. `fraction`: fill fractions, `owned`: flags, in flattened local arrays."""
        a, b, weight = exchange.first, exchange.second, exchange.weight
        here = (b >= 0) & (b < len(owned))  # ghosts exchange with cells beyond the local arrays too
        a, b, weight = a[here], b[here], weight[here]
        both = np.minimum(fraction[a], fraction[b])
        kept = (both > _LEAST) & (owned[a] | owned[b])
        self._first, self._second = a[kept], b[kept]
        self._conductance = weight[kept] * both[kept]
        loss = sum(
            np.bincount(end, self._conductance, len(fraction))
            for end in (self._first, self._second)
        )
        self._fraction = fraction
        self._owned = np.flatnonzero(owned & (fraction > _LEAST) & (loss > 0.0))
        rates = (loss / np.maximum(fraction, _LEAST))[self._owned]
        self.fastest = largest(float(rates.max(initial=0.0)))

    def steps(self, duration: float) -> int:
        """How many equal steps a time (s) takes."""
        return max(1, int(np.ceil(duration * self.fastest / _SHARE)))

    def step(self, c: FloatArray, gain: FloatArray, dt: float) -> None:
        """One step (s) of c (components, cells) on the owned cells; `gain` is work space."""
        _step(
            c, gain, self._first, self._second, self._conductance, self._fraction, self._owned, dt
        )


@numba.njit(cache=True)
def _step(
    c: FloatArray,
    gain: FloatArray,
    first: IntArray,
    second: IntArray,
    conductance: FloatArray,
    fraction: FloatArray,
    owned: IntArray,
    dt: float,
) -> None:
    for q in range(c.shape[0]):
        gain[owned] = 0.0
        for n in range(len(first)):
            i, j = first[n], second[n]
            moved = dt * conductance[n] * (c[q, j] - c[q, i])
            gain[i] += moved
            gain[j] -= moved
        for i in owned:
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
