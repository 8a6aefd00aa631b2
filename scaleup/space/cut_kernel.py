"""Compiled kernel of `cut_cells`: the positive share of a cell, simplex by simplex.

Values live on the lattice of a cell's corners, edge middles, facet middles and centre (3 per
axis, the middles being means of corners), flattened with x fastest. Importing this module loads
numba, so `cut_cells` does it when first asked.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numba import njit

from scaleup.space.grid import FloatArray, IntArray


def simplices(dimension: int) -> IntArray:
    """The barycentric subdivision of the unit cell: lattice numbers, shape (n, dimension + 1).

    Each simplex runs from the centre to the middle of a facet, of an edge of it, ... to a corner.
    """
    result = []
    for order in permutations(range(dimension)):
        for signs in product((0, 2), repeat=dimension):
            place = [1] * dimension
            chain = [_number(place)]
            for axis in order:
                place[axis] = signs[axis]
                chain.append(_number(place))
            result.append(chain)
    return np.array(result)


def lattice_corners(dimension: int) -> IntArray:
    """Which corners each lattice point is the mean of, padded with -1, x fastest."""
    table = np.full((3**dimension, 2**dimension), -1)
    for reversed_place in product(range(3), repeat=dimension):
        place = reversed_place[::-1]
        choices = [(0, 1) if p == 1 else (p // 2,) for p in place]
        corners = [sum(c << axis for axis, c in enumerate(pick)) for pick in product(*choices)]
        table[_number(list(place)), : len(corners)] = corners
    return table


def _number(place: list[int]) -> int:
    return sum(p * 3**axis for axis, p in enumerate(place))


@njit(cache=True)  # type: ignore[untyped-decorator]
def fractions(corners: FloatArray, table: IntArray, chains: IntArray) -> FloatArray:
    """Positive fraction of cells with corner values (n, 2^dimension), x fastest; shape (n,)."""
    result = np.empty(len(corners))
    lattice = np.empty(len(table))
    vertices = chains.shape[1]
    v = np.empty(vertices)
    for cell in range(len(corners)):
        values = corners[cell]
        low, high = values.min(), values.max()
        if low > 0 or high <= 0:
            result[cell] = 1.0 if low > 0 else 0.0
            continue
        for point in range(len(table)):
            total, count = 0.0, 0
            for corner in table[point]:
                if corner >= 0:
                    total += values[corner]
                    count += 1
            lattice[point] = total / count
        share = 0.0
        for chain in range(len(chains)):
            for i in range(vertices):  # sorted, greatest first
                value = lattice[chains[chain, i]]
                j = i
                while j > 0 and v[j - 1] < value:
                    v[j] = v[j - 1]
                    j -= 1
                v[j] = value
            share += min(1.0, max(0.0, _positive_share(v)))
        result[cell] = share / len(chains)
    return result


@njit(cache=True)  # type: ignore[untyped-decorator]
def _corner(v: FloatArray, i: int) -> float:
    """Share of the simplex cut off at vertex i: the product over the others of v_i/(v_i - v_j)."""
    share: float = 1.0
    for j in range(len(v)):
        if j != i:
            share *= v[i] / (v[i] - v[j])
    return share


@njit(cache=True)  # type: ignore[untyped-decorator]
def _positive_share(v: FloatArray) -> float:
    """Share of a simplex where the linear function with descending vertex values is positive.

    With two positive vertices A >= B of a tetrahedron the wedge is cut into the tetrahedra
    (A,B,bc,bd), (A,ac,ad,bd), (A,ac,bc,bd) along its edges: no difference A - B, which may vanish.
    """
    n = len(v)
    positive = 0
    for value in v:
        if value > 0:
            positive += 1
    if positive == 0:
        return 0.0
    if positive == n:
        return 1.0
    share: float
    if positive == 1:
        share = _corner(v, 0)
    elif positive == n - 1:
        share = 1.0 - _corner(v, n - 1)
    else:
        ac, ad = v[0] / (v[0] - v[2]), v[0] / (v[0] - v[3])
        bc, bd = v[1] / (v[1] - v[2]), v[1] / (v[1] - v[3])
        share = bc * bd + ac * ad * (1 - bd) + ac * bd * (1 - bc)
    return share
