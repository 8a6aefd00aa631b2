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

import numpy as np
from numba import njit

from scaleup_surface_layer.lab_columns import bilinear, depth_below, layer_at


@njit(cache=True)
def _potential(layer, x, y, z):
    """(P_x, P_z, depth below the surface, 1 - zeta within [0, 1]) at a lab point."""
    depth = depth_below(layer, x, y, z)
    qx, qz, delta = layer_at(layer, x, z)
    rest = 1.0 - min(max(depth / delta, 0.0), 1.0)
    return qx * rest * rest, qz * rest * rest, depth, rest


@njit(cache=True)
def _wet_share(d0, d1, d2, d3):
    """Share of a face below the surface, from the depths at the middles of opposite edges."""
    reach = abs(d1 - d0) + abs(d3 - d2)
    mean = 0.25 * (d0 + d1 + d2 + d3)
    if reach <= 1e-30:
        return 1.0 if mean > 0 else 0.0
    return min(max(0.5 + mean / reach, 0.0), 1.0)


@njit(cache=True)
def add_layer_flux(
    layer, phase, share, cells, index, across, apertures, counts, corner, spacing, flux, weight
):
    """Add a layer's flux through the lower faces of cells, and the weights for its correction.

    phase     -- rad; share -- of the interval that this layer stands for
    cells     -- flat indices; index -- grid cell -> number in `cells`, or -1
    corner    -- lower corner of the grid relative to the axis; counts, spacing -- (3,)
    across    -- 0 or 1: the in-plane grid axis whose faces are wanted, beside those of z
    apertures -- open share of every grid cell's lower faces, (3, cells)
    flux, weight -- (2, n), added to: row 0 for faces normal to `across`, row 1 for those to z
    """
    c, s = np.cos(phase), np.sin(phase)
    hx, hy, hz = spacing
    nx, ny = counts[0], counts[1]
    along = 1 - across
    lift = s if across == 0 else c  # of the lab's vertical along `across`
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        x0, y0 = corner[0] + i * hx, corner[1] + j * hy
        zl = corner[2] + k * hz
        zm = zl + 0.5 * hz
        below = cell - (1 if across == 0 else nx)
        aperture = apertures[across, cell]
        if aperture > 0 and index[below] >= 0:
            # edges along z at both ends of the face, and along `along` at both ends in z
            dx, dy = (0.0, hy) if across == 0 else (hx, 0.0)
            x1, y1 = x0 + dx, y0 + dy
            xm, ym = x0 + 0.5 * dx, y0 + 0.5 * dy
            pa, _, da, ra = _potential(layer, c * x0 - s * y0, s * x0 + c * y0, zm)
            pb, _, db, rb = _potential(layer, c * x1 - s * y1, s * x1 + c * y1, zm)
            ql, qu = 0.0, 0.0
            dl, du, rl, ru = 0.5 * (da + db), 0.5 * (da + db), 0.5 * (ra + rb), 0.5 * (ra + rb)
            lx, ly = c * xm - s * ym, s * xm + c * ym
            if counts[2] > 1:
                _, ql, dl, rl = _potential(layer, lx, ly, zl)
                _, qu, du, ru = _potential(layer, lx, ly, zl + hz)
            # A along the edges: P_x on z, P_z sin(phase) on y, -P_z cos(phase) on x
            if across == 0:
                around = (pb - pa) * hz - (qu - ql) * s * hy
            else:
                around = -(pb - pa) * hz - (qu - ql) * c * hx
            wet = _wet_share(da, db, dl, du)
            if wet > 0:
                area = hz * (hy if across == 0 else hx)
                if wet < 1:
                    u, v = (lx - layer.x0) / layer.dx - 0.5, (zm - layer.z0) / layer.dz - 0.5
                    falling = -bilinear(layer.divergence, u, v)
                    around -= (1 - wet) * area * falling * lift
                flux[0, n] += share * aperture * around
                weight[0, n] += share * aperture * area * wet * 0.25 * (ra + rb + rl + ru)
        if counts[2] == 1:
            continue
        below = cell - nx * ny
        aperture = apertures[2, cell]
        if aperture > 0 and index[below] >= 0:
            x, y = x0 + 0.5 * hx, y0 + 0.5 * hy
            _, pl, dl, rl = _potential(layer, c * x0 - s * y, s * x0 + c * y, zl)
            _, pr, dr, rr = _potential(layer, c * (x0 + hx) - s * y, s * (x0 + hx) + c * y, zl)
            _, pd, dd, rd = _potential(layer, c * x - s * y0, s * x + c * y0, zl)
            _, pu, du, ru = _potential(layer, c * x - s * (y0 + hy), s * x + c * (y0 + hy), zl)
            wet = _wet_share(dl, dr, dd, du)
            if wet > 0:
                around = (pr - pl) * s * hy + (pu - pd) * c * hx
                flux[1, n] += share * aperture * around
                weight[1, n] += share * aperture * hx * hy * wet * 0.25 * (rl + rr + rd + ru)


@njit(cache=True)
def add_layer_shear(layer, phase, share, cells, counts, corner, spacing, shear, motion):
    """Add a layer's shear rate (n,) and velocity relative to rigid rotation (3, n) at cell centres.

    The velocity is in vessel coordinates; the thickness of the layer is smooth, so its slope is
    left out of the vertical component.
    """
    c, s = np.cos(phase), np.sin(phase)
    nx, ny = counts[0], counts[1]
    for n in range(len(cells)):
        cell = cells[n]
        i, j, k = cell % nx, (cell // nx) % ny, cell // (nx * ny)
        vx = corner[0] + (i + 0.5) * spacing[0]
        vy = corner[1] + (j + 0.5) * spacing[1]
        z = corner[2] + (k + 0.5) * spacing[2]
        x, y = c * vx - s * vy, s * vx + c * vy
        px, pz, depth, rest = _potential(layer, x, y, z)
        if rest <= 0 or (px == 0 and pz == 0):
            continue
        qx, qz, delta = layer_at(layer, x, z)
        q = np.sqrt(qx * qx + qz * qz)
        ux, uz = 2 * qx / delta * rest, 2 * qz / delta * rest
        e = 0.5 * layer.dx
        slope_x = (depth_below(layer, x + e, y, z) - depth_below(layer, x - e, y, z)) / (2 * e)
        slope_z = 0.0
        if counts[2] > 1:
            e = 0.5 * layer.dz
            slope_z = (depth_below(layer, x, y, z + e) - depth_below(layer, x, y, z - e)) / (2 * e)
        w = ux * slope_x + uz * slope_z
        shear[n] += share * 2 * q / delta**2
        motion[0, n] += share * (c * ux + s * w)
        motion[1, n] += share * (-s * ux + c * w)
        motion[2, n] += share * uz
