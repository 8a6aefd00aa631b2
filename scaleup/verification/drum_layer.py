"""A rolling drum with a sheared layer: the flow, its diffusion, and what is compared.

The bed of Khakhar et al. (1997) in surface coordinates, x down the surface from mid-bed, y along
its outward normal, the axis at y = b above the surface, half chord L = sqrt(R^2 - b^2):

    -delta < y < 0:  v_x = omega (y - b) + 2 u (1 + y/delta),  v_y = -omega x (y/delta)^2,
    below:           v_x = omega (y - b),                      v_y = -omega x,

delta = delta0 (1 - x^2/L^2), u = omega L^2/(2 delta0): continuous and free of divergence. (The
drum turns clockwise in these coordinates; the grid sees them mirrored and tilted.)

Diffusion is that of the layer at mid-bed, k d^2 times its shear rate 2 u/delta0, along the surface
k2 and across it k1, made smooth so that walks need no special care:

    D = d^2 (2 u/delta0) exp(-(y/delta0)^2) (1 - x^2/L^2)^2 diag(k2, k1).

It is flat in y at the surface and vanishes where the wall comes near, so that walks are reflected
without error of the first order.
"""

from __future__ import annotations

import math

import numpy as np

from scaleup.space.flow_field import FlowField, Interval
from scaleup.space.grid import FloatArray, Grid
from scaleup.verification.closed_flows import plane_flow

RADIUS = 0.07  # m
DISTANCE = 0.021  # m, b: the paper's fill, depth over diameter 0.35
OMEGA = 2 * math.pi / 10  # rad/s, 6 rpm
THICKNESS = 0.01  # m, delta0
ANGLE = math.radians(23.6)  # of the surface
GRAIN = 2e-3  # m
K1, K2 = 0.1, 0.19
HALF_CHORD = math.sqrt(RADIUS**2 - DISTANCE**2)
LAYER_SPEED = OMEGA * HALF_CHORD**2 / (2 * THICKNESS)
STRENGTH = GRAIN**2 * 2 * LAYER_SPEED / THICKNESS  # m^2/s, D_xx/k2 at mid-bed on the surface
REVOLUTION = 2 * math.pi / OMEGA
COARSE = 14  # coarse cells across the drum, of 10 mm, in which concentrations are compared


def surface_coordinates(points: FloatArray) -> FloatArray:
    """(x, y) as above of lab points (..., 2) about the drum's axis, m."""
    cosine, sine = math.cos(ANGLE), math.sin(ANGLE)
    along = -cosine * points[..., 0] - sine * points[..., 1]
    out = -sine * points[..., 0] + cosine * points[..., 1]
    return np.stack([along, out + DISTANCE], axis=-1)


def lab_coordinates(state: FloatArray) -> FloatArray:
    """Lab points of (x, y) as above, m: the same mirror and turn, which is its own inverse."""
    axis = np.array([0.0, DISTANCE])
    points: FloatArray = surface_coordinates(state - axis) - axis
    return points


def bed_level(points: FloatArray) -> FloatArray:
    """Level set of the bed, m, of lab points."""
    wall: FloatArray = RADIUS - np.linalg.norm(points, axis=-1)
    return np.minimum(wall, -surface_coordinates(points)[..., 1])


def stream_function(points: FloatArray) -> FloatArray:
    """Of lab points, m^2/s: omega/2 (R^2 - r^2) - omega/2 (L^2 - x^2) (1 + y/delta)^2."""
    x, y = np.moveaxis(surface_coordinates(points), -1, 0)
    chord = np.maximum(HALF_CHORD**2 - x**2, 0.0)
    delta = np.maximum(THICKNESS * chord / HALF_CHORD**2, 1e-30)
    squared: FloatArray = (points**2).sum(axis=-1)
    rigid = 0.5 * OMEGA * (RADIUS**2 - squared)
    psi: FloatArray = rigid - 0.5 * OMEGA * chord * np.maximum(1.0 + y / delta, 0.0) ** 2
    return psi


def drum_flow(n: int) -> FlowField:
    """The flow on n cells across the drum (a multiple of 14) and a layer around them."""
    h = 2 * RADIUS / n
    grid = Grid((-RADIUS - h,) * 2, (h,) * 2, (n + 2,) * 2)
    return plane_flow(grid, stream_function, bed_level)


def layer_tensor(flow: FlowField, interval: Interval) -> FloatArray:
    """D in lab coordinates at the cells' centres, m^2/s."""
    x, y = surface_coordinates(flow.grid.centre_points(interval.cells)).T
    taper = np.maximum(1.0 - x**2 / HALF_CHORD**2, 0.0) ** 2
    strength = STRENGTH * np.exp(-((np.minimum(y, 0.0) / THICKNESS) ** 2)) * taper
    along = np.array([-math.cos(ANGLE), -math.sin(ANGLE)])
    across = np.array([-math.sin(ANGLE), math.cos(ANGLE)])
    directions = K2 * np.outer(along, along) + K1 * np.outer(across, across)
    tensor: FloatArray = directions[:, :, None] * strength
    return tensor
