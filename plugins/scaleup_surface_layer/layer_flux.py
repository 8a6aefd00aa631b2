"""The layer's velocity, integrated over the faces of a grid that turns with the vessel.

With q the depth-integrated flux relative to rigid rotation, zeta = depth below the surface over
the layer's thickness, and P = q (1 - zeta)^2 (what runs between the layer's bottom and a point),
the velocity relative to rigid rotation is, in lab coordinates (x, y up, z),

    u = dP_x/dy,   u_z = dP_z/dy,   w = -dP_x/dx - dP_z/dz:    u = curl A,  A = (-P_z, 0, P_x):

linear in depth, with w from continuity. The flux through a face is therefore the circulation of A
around its edges: no derivative is taken, and the fluxes of a wet cell sum to zero. Above the
surface P is continued as q, which leaves w = -div q there; that is taken off the dry part of a
face.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from scaleup.contract import FloatArray, IntArray
from scaleup_surface_layer.lab_columns import field_at, layer_at, look_up, place_of


@njit(cache=True)
def _potential(layer, x, y, z):
    """(P_x, P_z, depth below the surface, 1 - zeta within [0, 1]) at a lab point.

    Zero far above the surface, where no wet face has an edge.
    """
    place = place_of(layer, x, z)
    depth = field_at(layer, place, 0) - y
    if depth >= layer.thickest:
        return 0.0, 0.0, depth, 0.0
    if depth < -4 * layer.thinnest:
        return 0.0, 0.0, depth, 1.0
    qx, qz, delta = layer_at(layer, place)
    rest = 1.0 - min(max(depth / delta, 0.0), 1.0)
    return qx * rest * rest, qz * rest * rest, depth, rest


@njit(cache=True)
def _edge(layer, c, s, corner, spacing, i, j, k, kind):
    """(circulation of A, depth, 1 - zeta) of the edge along axis `kind` from corner (i, j, k)."""
    hx, hy, hz = spacing
    vx, vy, z = corner[0] + i * hx, corner[1] + j * hy, corner[2] + k * hz
    if kind == 0:
        vx += 0.5 * hx
    elif kind == 1:
        vy += 0.5 * hy
    else:
        z += 0.5 * hz
    px, pz, depth, rest = _potential(layer, c * vx - s * vy, s * vx + c * vy, z)
    if kind == 0:
        around = -pz * c * hx
    elif kind == 1:
        around = pz * s * hy
    else:
        around = px * hz
    return around, depth, rest


@njit(cache=True)
def _wet_share(d0, d1, d2, d3):
    """Share of a face below the surface, from the depths at the middles of opposite edges."""
    reach = abs(d1 - d0) + abs(d3 - d2)
    mean = 0.25 * (d0 + d1 + d2 + d3)
    if reach <= 1e-30:
        return 1.0 if mean > 0 else 0.0
    return min(max(0.5 + mean / reach, 0.0), 1.0)


@njit(cache=True)
def _edges(layer, c, s, cells, counts, corner, spacing):
    """`_edge` of the three edges at every cell's lower corner, (n, 3, 3)."""
    nx, ny = counts[0], counts[1]
    flat = counts[2] == 1
    edges = np.zeros((len(cells), 3, 3))
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        for kind in range(2 if flat else 0, 3):
            e = _edge(layer, c, s, corner, spacing, i, j, k, kind)
            edges[n, kind, 0], edges[n, kind, 1], edges[n, kind, 2] = e
    return edges


@njit(cache=True)
def _ahead(edges, index, place, strides, cell, kind, axis):
    """The edge of a kind one cell further along an axis."""
    other = index[cell + strides[axis]]
    if other >= 0:
        return edges[other, kind, 0], edges[other, kind, 1], edges[other, kind, 2]
    layer, c, s, corner, spacing = place
    k, rest = cell // strides[2], cell % strides[2]
    i, j = rest % strides[1] + (axis == 0), rest // strides[1] + (axis == 1)
    k += axis == 2
    return _edge(layer, c, s, corner, spacing, i, j, k, kind)


class OpenCells(NamedTuple):
    """Cells and the faces between them.

    cells     -- flat indices, (n,); index -- grid cell -> number in `cells`, or -1
    apertures -- open share of every grid cell's lower faces, (3, cells)
    """

    cells: IntArray
    index: IntArray
    apertures: FloatArray


class LayerSums(NamedTuple):
    """What layers are added up to.

    flux, weight -- (2, n): row 0 for faces normal to `across`, row 1 for those to z; the weights
                    are those of the fluxes' correction
    shear, motion -- (n,) and (3, n): shear rate (1/s) and velocity relative to rigid rotation
                    (m/s, in vessel coordinates) at cell centres
    """

    flux: FloatArray
    weight: FloatArray
    shear: FloatArray
    motion: FloatArray


@njit(cache=True)
def add_layer(layer, phase, share, across, where, grid, sums):
    """Add a layer's flux through lower faces of n cells, and what goes with it.

    phase  -- rad; share -- of the interval that this layer stands for
    across -- 0 or 1: the in-plane grid axis whose faces are wanted, beside those of z
    where, grid, sums -- `OpenCells`, `GridPlace` and `LayerSums`
    """
    c, s = np.cos(phase), np.sin(phase)
    counts, corner, spacing = grid
    place = layer, c, s, corner, spacing
    edges = _edges(layer, c, s, where.cells, counts, corner, spacing)
    _add_flux(place, share, across, where, counts, edges, sums.flux, sums.weight)
    _add_shear(place, share, where.cells, counts, sums.shear, sums.motion)


@njit(cache=True)
def _add_flux(place, share, across, where, counts, edges, flux, weight):
    layer, c, s, corner, spacing = place
    cells, index, apertures = where
    nx, ny = counts[0], counts[1]
    strides = np.array([1, nx, nx * ny])
    flat = counts[2] == 1
    along = 1 - across
    lift = s if across == 0 else c  # of the lab's vertical along `across`
    for n in range(len(cells)):
        cell = cells[n]
        for row in range(1 if flat else 2):
            normal = across if row == 0 else 2
            aperture = apertures[normal, cell]
            if aperture <= 0 or index[cell - strides[normal]] < 0:
                continue
            p, q = (normal + 1) % 3, (normal + 2) % 3
            if flat:  # edges along z alone; the others cancel
                e0 = edges[n, 2]
                e1 = _ahead(edges, index, place, strides, cell, 2, along)
                around = e1[0] - e0[0] if across == 0 else e0[0] - e1[0]
                wet = _wet_share(e0[1], e1[1], 0.5 * (e0[1] + e1[1]), 0.5 * (e0[1] + e1[1]))
                rest = 0.5 * (e0[2] + e1[2])
            else:
                low, left = edges[n, p], edges[n, q]
                high = _ahead(edges, index, place, strides, cell, p, q)
                right = _ahead(edges, index, place, strides, cell, q, p)
                around = low[0] + right[0] - high[0] - left[0]
                wet = _wet_share(low[1], high[1], left[1], right[1])
                rest = 0.25 * (low[2] + high[2] + left[2] + right[2])
            if wet <= 0:
                continue
            area = spacing[p] * spacing[q]
            if wet < 1 and row == 0:
                i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
                x = corner[0] + (i + (0.0 if across == 0 else 0.5)) * spacing[0]
                y = corner[1] + (j + (0.0 if across == 1 else 0.5)) * spacing[1]
                z = corner[2] + (k + 0.5) * spacing[2]
                around += (1 - wet) * area * lift * look_up(layer, c * x - s * y, z, 4)
            flux[row, n] += share * aperture * around
            weight[row, n] += share * aperture * area * wet * rest


@njit(cache=True)
def _add_shear(place, share, cells, counts, shear, motion):
    """The thickness of the layer is smooth, so its slope is left out of the vertical component."""
    layer, c, s, corner, spacing = place
    nx, ny = counts[0], counts[1]
    middle = corner[2] + 0.5 * counts[2] * spacing[2]
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        vx = corner[0] + (i + 0.5) * spacing[0]
        vy = corner[1] + (j + 0.5) * spacing[1]
        z = corner[2] + (k + 0.5) * spacing[2]
        x, y = c * vx - s * vy, s * vx + c * vy
        here = place_of(layer, x, z)
        top = field_at(layer, here, 0)
        depth = top - y
        if depth >= layer.thickest or depth < -4 * layer.thinnest:
            continue
        qx, qz, delta = layer_at(layer, here)
        q = np.sqrt(qx * qx + qz * qz)
        rest = 1.0 - min(max(depth / delta, 0.0), 1.0)
        if rest <= 0 or q == 0:
            continue
        ux, uz = 2 * qx / delta * rest, 2 * qz / delta * rest
        # slopes from the surface a column's width apart, towards the axis of rotation
        e = 2 * layer.dx if x < 0 else -2 * layer.dx
        slope_x = (look_up(layer, x + e, z, 0) - top) / e
        slope_z = 0.0
        if counts[2] > 1:
            e = 2 * layer.dz if z < middle else -2 * layer.dz
            slope_z = (look_up(layer, x, z + e, 0) - top) / e
        w = ux * slope_x + uz * slope_z
        shear[n] += share * 2 * q / delta**2
        motion[0, n] += share * (c * ux + s * w)
        motion[1, n] += share * (-s * ux + c * w)
        motion[2, n] += share * uz
