"""Kernels that tell which cells of the vessel's grid move in an interval, and what hangs together.

Cells are flat grid indices. Neighbours are numbers within a list of cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from scaleup.contract import FloatArray, IntArray
from scaleup_surface_layer.lab_columns import depth_below, field_at, layer_at, place_of


class GridPlace(NamedTuple):
    """The grid (x, y, z): its counts, the lower corner relative to the axis, and the spacing, m."""

    counts: IntArray
    corner: FloatArray
    spacing: FloatArray


@njit(cache=True)
def find_moving(vessel, fill, capacity, layers, phases, moves, grid):
    """Cells that the surface or the layer may touch, ascending, and how far each takes part.

    layers -- the layer at the start, at the end, and as a mean; phases -- rad, at start and end
    moves -- which columns a flux touches; grid -- `GridPlace`
    part  -- 0: it may be cut by the surface; 1: the layer runs through it; 2: and is wet half-way
    """
    first, last, mean = layers
    phase0, phase1 = phases
    counts, corner, spacing = grid
    c0, s0, c1, s1 = np.cos(phase0), np.sin(phase0), np.cos(phase1), np.sin(phase1)
    half = 0.5 * (phase0 + phase1)
    cm, sm = np.cos(half), np.sin(half)
    nx, ny = counts[0], counts[1]
    h = spacing[0]
    margin = 1.6 * h
    thickest = max(first.thickest, last.thickest)
    found = np.empty(len(vessel), dtype=np.int64)
    part = np.empty(len(vessel), dtype=np.int8)
    n = 0
    for cell in vessel:
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        vx = corner[0] + (i + 0.5) * h
        vy = corner[1] + (j + 0.5) * spacing[1]
        z = corner[2] + (k + 0.5) * spacing[2]
        x0, y0 = c0 * vx - s0 * vy, s0 * vx + c0 * vy
        x1, y1 = c1 * vx - s1 * vy, s1 * vx + c1 * vy
        d0, d1 = depth_below(first, x0, y0, z), depth_below(last, x1, y1, z)
        held = fill[cell]
        if max(d0, d1) < -margin and held == 0:
            continue
        low = min(d0, d1) - margin
        full = held == capacity[cell]
        if full and low > thickest:
            continue
        # a cell between two columns counts for both, so that mirror images stay so
        t = 0.5 * (z - first.z0) / first.dz
        k0 = min(max(int(t - 1e-6), 0), moves.shape[1] - 1)
        k1 = min(max(int(t + 1e-6), 0), moves.shape[1] - 1)
        i0 = min(max(int((x0 - first.x0) / first.dx) // 2, 0), moves.shape[0] - 1)
        i1 = min(max(int((x1 - first.x0) / first.dx) // 2, 0), moves.shape[0] - 1)
        if not (moves[i0, k0] or moves[i1, k0] or moves[i0, k1] or moves[i1, k1]):
            continue
        xm, ym = cm * vx - sm * vy, sm * vx + cm * vy
        place = place_of(mean, xm, z)
        depth = field_at(mean, place, 0) - ym
        thickness = layer_at(mean, place)[2]
        if full and min(low, depth - margin) > thickness:
            continue
        found[n] = cell
        part[n] = 0
        if -0.75 * h < depth < thickness + 0.75 * h:
            part[n] = 2 if depth > -0.25 * h else 1
        n += 1
    return found[:n].copy(), part[:n].copy()


@njit(cache=True)
def neighbours_below(cells, index, apertures, strides, wet):
    """Number of the neighbour below each cell along each axis, through an open face; else -1.

    index -- grid cell -> number in `cells`, or -1; strides -- of the flat index, one per axis
    wet   -- which of the cells count, (n,)
    """
    below = np.full((len(strides), len(cells)), -1, dtype=np.int32)
    for n in range(len(cells)):
        if not wet[n]:
            continue
        for axis in range(len(strides)):
            if apertures[axis, cells[n]] > 0:
                m = index[cells[n] - strides[axis]]
                if m >= 0 and wet[m]:
                    below[axis, n] = m
    return below


@njit(cache=True)
def find_components(used, below):
    """Which used cells hang together: a component's number for each (else -1), and how many."""
    n = len(used)
    parent = np.arange(n)
    for cell in range(n):
        if not used[cell]:
            continue
        for axis in range(len(below)):
            other = below[axis, cell]
            if other < 0 or not used[other]:
                continue
            a, b = cell, np.int64(other)
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            parent[max(a, b)] = min(a, b)
    component = np.full(n, -1, dtype=np.int32)
    count = 0
    for cell in range(n):  # a root is the first of its component
        if not used[cell]:
            continue
        if parent[cell] == cell:
            component[cell] = count
            count += 1
        else:
            component[cell] = component[parent[cell]]
    return component, count


@njit(cache=True)
def component_volumes(component, count, before, after, capacity):
    """What each component gains, and by how much its cells' fills may go up and down alike, m^3.

    The gains are sums with a carry: a fill and a flux must agree in a cell, whatever the bed holds.
    """
    gain, carry, room = np.zeros(count), np.zeros(count), np.zeros(count)
    for n in range(len(component)):
        c = component[n]
        if c < 0:
            continue
        for value in (after[n], -before[n]):
            total = gain[c] + value
            if abs(gain[c]) >= abs(value):
                carry[c] += (gain[c] - total) + value
            else:
                carry[c] += (value - total) + gain[c]
            gain[c] = total
        room[c] += min(after[n], capacity[n] - after[n])
    return gain + carry, room


@njit(cache=True)
def spread_cure(component, cure, after, capacity):
    """Take `cure` of each component's room off its cells' fills."""
    for n in range(len(component)):
        if component[n] >= 0:
            after[n] -= cure[component[n]] * min(after[n], capacity[n] - after[n])


@njit(cache=True)
def put_remainder(component, gain, after, capacity):
    """Take each component's gain off the fill of its roomiest cell.

    A part of it for each of millions of cells would be less than the round-off of their fills.
    """
    roomiest = np.full(len(gain), -1)
    most = np.zeros(len(gain))
    for n in range(len(component)):
        c = component[n]
        if c >= 0 and min(after[n], capacity[n] - after[n]) > most[c]:
            roomiest[c], most[c] = n, min(after[n], capacity[n] - after[n])
    for c in range(len(gain)):
        if abs(gain[c]) < most[c]:
            after[roomiest[c]] -= gain[c]


@njit(cache=True)
def grow(used, seeds, below):
    """Mark as used, and as seeds, the neighbours of seeds through open faces."""
    fresh = seeds.copy()
    for axis in range(len(below)):
        for n in range(len(used)):
            m = below[axis, n]
            if m >= 0 and (seeds[n] or seeds[m]):
                fresh[n] = fresh[m] = True
    for n in range(len(used)):
        seeds[n] = fresh[n]
        used[n] = used[n] or fresh[n]


@njit(cache=True)
def join(used, main, others, below):
    """Mark as used the cells on a shortest way from each of the others to the main set."""
    dimension, n = below.shape
    above = np.full_like(below, -1)
    for axis in range(dimension):
        for cell in range(n):
            if below[axis, cell] >= 0:
                above[axis, below[axis, cell]] = cell
    towards = np.full(n, -1, dtype=np.int32)
    line = np.empty(n, dtype=np.int32)
    end = 0
    for cell in range(n):
        if main[cell]:
            towards[cell], line[end] = cell, cell
            end += 1
    now = 0
    while now < end:
        cell = line[now]
        now += 1
        for axis in range(dimension):
            for neighbour in (below[axis, cell], above[axis, cell]):
                if neighbour >= 0 and towards[neighbour] < 0:
                    towards[neighbour], line[end] = cell, neighbour
                    end += 1
    for cell in range(n):
        if others[cell] and not main[cell]:
            on_way = cell
            while towards[on_way] >= 0 and not main[on_way]:
                used[on_way] = True
                on_way = towards[on_way]


@njit(cache=True)
def find_resting(vessel, fill, capacity, index, layer):
    """Cells with material that have no number in `index`: partly filled ones, and runs of full.

    layer -- cells in a layer of the grid, over whose end no run reaches
    """
    other = np.empty(len(vessel), dtype=np.int64)
    runs = np.empty((len(vessel), 2), dtype=np.int64)
    n, m, end = 0, 0, -1
    for cell in vessel:
        if index[cell] >= 0 or fill[cell] <= 0:
            continue
        if fill[cell] < capacity[cell]:
            other[n] = cell
            n += 1
        elif cell == end and cell % layer != 0:
            end = cell + 1
            runs[m - 1, 1] = end
        else:
            end = cell + 1
            runs[m, 0], runs[m, 1] = cell, end
            m += 1
    return other[:n].copy(), runs[:m].copy()


@njit(cache=True)
def corner_depths(layer, phase, cells, wall, grid):
    """Which cells are below the surface (1), above it (-1) or cut (0), and the latter's corners.

    Corner values are min(distance below the surface, distance to the wall), x fastest.
    grid -- `GridPlace`
    """
    counts, corner, spacing = grid
    c, s = np.cos(phase), np.sin(phase)
    nx, ny = counts[0], counts[1]
    flat = counts[2] == 1
    number = 4 if flat else 8
    state = np.empty(len(cells), dtype=np.int8)
    corners = np.empty((len(cells), number))
    cut = 0
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        low, high = np.inf, -np.inf
        for m in range(number):
            a, b, e = m & 1, (m >> 1) & 1, m >> 2
            vx = corner[0] + (i + a) * spacing[0]
            vy = corner[1] + (j + b) * spacing[1]
            z = corner[2] + (k + (0.5 if flat else e)) * spacing[2]
            depth = depth_below(layer, c * vx - s * vy, s * vx + c * vy, z)
            low, high = min(low, depth), max(high, depth)
            # the slope of the surface is near 0.4: make it a distance, as the wall's is
            corners[cut, m] = min(0.92 * depth, wall[k + e, j + b, i + a])
        if low > 0:
            state[n] = 1
        elif high <= 0:
            state[n] = -1
        else:
            state[n] = 0
            cut += 1
    return state, corners[:cut].copy()
