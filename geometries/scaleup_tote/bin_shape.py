"""The shape of a bin: a convex polyhedron with all edges rounded, and a plate inside it.

The rounded bin is K + r B: the polyhedron K bounded by the bin's ten planes moved inwards by the
edge radius r, grown by balls of radius r. Hence, exactly,

    distance to the wall = distance to K's boundary + r           (inside K: its nearest plane)
    volume = V(K) + r S(K) + r^2/2 sum(edge length x exterior angle) + 4/3 pi r^3      (Steiner)

Volumes below a level use the convex hull of K's corners plus points of a ball, scaled to it.
Bin coordinates: x, z along length and width, y upright from the outlet; the vessel's are turned
about y, then about x, with the origin on the axis of rotation.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import igl
import numpy as np
from scipy.spatial import ConvexHull, HalfspaceIntersection

from scaleup.contract import FloatArray, InputError
from scaleup.numerics import ClosedSurface, mirrored_in_z, outward_hull

_BALL_POINTS = 4000
_MM = 1e-3  # m
_NEAR = 3.0  # edge radii from K within which distances outside K are exact


class Size(NamedTuple):
    """Dimensions of a bin, m."""

    length: float
    width: float
    height: float
    hopper: float
    outlet: float
    edge_radius: float


# The volumes of the first two are those of Gallay's bins in Alexander et al., Pharmaceutical
# Technology 2004, part 2 of 3, volume and footprint of the third those of the Tote System's bin (42
# by 48 in, 74 cubic feet) in Wright 1950; the other dimensions are typical, not quoted.
SIZES = {
    "lab": Size(0.24, 0.24, 0.19, 0.1, 0.09, 0.02),
    "pilot": Size(0.72, 0.72, 0.45, 0.29, 0.22, 0.05),
    "plant": Size(1.2, 1.05, 1.4, 0.45, 0.35, 0.1),
}


class Bin:
    """A rounded bin, held by its tumbler.

    Dimensions in m as in `Tote.Options`, angles in rad. Raises InputError if the edges are too
    round for the smallest face.
    """

    def __init__(self, size: Size, axis_height: float | None, tilt: float, turn: float):
        self.dimensions = size
        self.radius = size.edge_radius
        self._planes = _planes(self.dimensions)
        core = _core(self._planes, self.dimensions)
        hull, surface = outward_hull(core)
        self._surface = surface
        self.volume = _steiner(hull, core, self.radius)
        skin = (
            outward_hull(core[:, None, :] + self.radius * _ball_points())[1]
            if self.radius
            else None
        )
        whole = ClosedSurface(*(skin or surface))
        self._scale = self.volume / whole.volume
        self.axis_height = axis_height or float(whole.centroid[1])
        self.turning = _rotation(tilt, turn)
        corners = self.to_vessel(core)
        self.lower = tuple(float(x) for x in corners.min(axis=0) - self.radius)
        self.upper = tuple(float(x) for x in corners.max(axis=0) + self.radius)
        self.reach = float(np.hypot(corners[:, 0], corners[:, 1]).max()) + self.radius
        self.is_mirrored = mirrored_in_z(corners)
        vertices, faces = skin or surface
        self._skin = ClosedSurface(self.to_vessel(vertices), faces)

    def to_vessel(self, points: FloatArray) -> FloatArray:
        """Bin coordinates to the vessel's, (..., 3), m."""
        return (points - np.array([0.0, self.axis_height, 0.0])) @ self.turning.T

    def to_bin(self, points: FloatArray) -> FloatArray:
        """Vessel coordinates to the bin's, (..., 3), m."""
        result: FloatArray = points @ self.turning + np.array([0.0, self.axis_height, 0.0])
        return result

    def volume_below(self, height: float) -> float:
        """m^3 below y = height in vessel coordinates."""
        return self._scale * self._skin.volume_below(height)

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """m, positive inside; points (..., 3) in vessel coordinates.

        Exact inside, and outside down to two edge radii from the wall; further out, and outside
        sharp edges, the distance to the farthest plane (of the same sign, never more in size).
        """
        inner = self.to_bin(points).reshape(-1, 3)
        depth = np.full(len(inner), np.inf)
        for plane in self._planes:
            np.minimum(depth, -(inner @ plane[:3] + plane[3]) - self.radius, out=depth)
        near = (depth < 0) & (depth > -_NEAR * self.radius)
        if near.any():
            squared = igl.point_mesh_squared_distance(inner[near], *self._surface)[0]
            depth[near] = -np.sqrt(squared)
        return (depth + self.radius).reshape(points.shape[:-1])

    def solid(self) -> Any:
        """The bin as a netgen OCC solid in vessel coordinates, m."""
        from netgen.occ import Box, Pnt, Segment, ThruSections, Wire

        size = Size(*(x / _MM for x in self.dimensions))  # OCC's fillets fail at edges of 0.01

        def rectangle(length: float, width: float, y: float) -> Any:
            x, z = 0.5 * length, 0.5 * width
            corners = [Pnt(-x, y, -z), Pnt(x, y, -z), Pnt(x, y, z), Pnt(-x, y, z)]
            return Wire([Segment(corners[i], corners[(i + 1) % 4]) for i in range(4)])

        hopper = ThruSections(
            [
                rectangle(size.outlet, size.outlet, 0),
                rectangle(size.length, size.width, size.hopper),
            ]
        )
        x, z = 0.5 * size.length, 0.5 * size.width
        box = Box(Pnt(-x, size.hopper, -z), Pnt(x, size.hopper + size.height, z))
        shape = hopper + box
        if size.edge_radius:
            shape = shape.MakeFillet(list(shape.edges), size.edge_radius)
        return self.turned(shape.Scale(Pnt(0, 0, 0), _MM))

    def turned(self, shape: Any) -> Any:
        """A netgen OCC shape from bin coordinates to the vessel's."""
        from netgen.occ import Axis, Pnt, Vec, X, Y

        origin = Pnt(0, 0, 0)
        moved = shape.Move(Vec(0, -self.axis_height, 0))
        turn = math.atan2(self.turning[0, 2], self.turning[0, 0])
        tilt = math.atan2(self.turning[2, 1], self.turning[1, 1])
        return moved.Rotate(Axis(origin, Y), math.degrees(turn)).Rotate(
            Axis(origin, X), math.degrees(tilt)
        )


@lru_cache(maxsize=8)
def held_bin(size: Size, axis_height: float | None, tilt: float, turn: float) -> Bin:
    """The bin of these dimensions; a run asks for the same one many times."""
    return Bin(size, axis_height, tilt, turn)


class Baffle:
    """A plate inside a bin, centred on the axis of rotation, along the bin's width.

    thickness, height, width -- m; angle -- rad, from the bin's upright
    Raises InputError if the plate does not lie inside the bin.
    """

    def __init__(self, bin_: Bin, thickness: float, height: float, width: float, angle: float):
        self._bin, self.thickness = bin_, thickness
        self._half = 0.5 * np.array([thickness, height, width])
        cosine, sine = math.cos(angle), math.sin(angle)
        self._own = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        self._angle = angle
        signs = np.array(list(product((-1.0, 1.0), repeat=3)))
        in_bin = (signs * self._half) @ self._own + np.array([0.0, bin_.axis_height, 0.0])
        corners = bin_.to_vessel(in_bin)
        if bin_.signed_distance(corners).min() <= 0:
            raise InputError(
                f"geometry.baffle: a plate of {thickness:.3g} x {height:.3g} x {width:.3g} m "
                "across the axis does not lie inside the bin; make it smaller"
            )
        self.is_mirrored = mirrored_in_z(corners)
        self._offset = np.array([0.0, bin_.axis_height, 0.0])
        self._surface = ClosedSurface(corners, outward_hull(corners)[1][1])

    def cut_from(self, wall: FloatArray, points: FloatArray) -> FloatArray:
        """The lesser of `wall` and the distance to the plate, m; points (..., 3) of the vessel."""
        beyond = np.abs((self._bin.to_bin(points) - self._offset) @ self._own.T) - self._half
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        result: FloatArray = np.minimum(wall, outside + np.minimum(beyond.max(axis=-1), 0.0))
        return result

    def volume_below(self, height: float) -> float:
        """m^3 of the plate below y = height in vessel coordinates."""
        return self._surface.volume_below(height)

    def solid(self) -> Any:
        """The plate as a netgen OCC solid in vessel coordinates, m."""
        from netgen.occ import Axis, Box, Pnt, Vec, Z

        plate = Box(Pnt(*-self._half), Pnt(*self._half))
        plate = plate.Rotate(Axis(Pnt(0, 0, 0), Z), math.degrees(self._angle))
        return self._bin.turned(plate.Move(Vec(*self._offset)))


def _planes(size: Size) -> FloatArray:
    """The ten planes as rows (n, d) with n.x + d <= 0 inside; n a unit vector, outwards."""
    planes = [[0.0, 1.0, 0.0, -(size.hopper + size.height)], [0.0, -1.0, 0.0, 0.0]]
    for axis, edge in ((0, size.length), (2, size.width)):
        run = 0.5 * (edge - size.outlet)
        slope = np.array([size.hopper, -run]) / math.hypot(size.hopper, run)
        for sign in (-1.0, 1.0):
            side = [0.0, 0.0, 0.0, -0.5 * edge]
            side[axis] = sign
            chute = [0.0, slope[1], 0.0, -slope[0] * 0.5 * size.outlet]
            chute[axis] = sign * slope[0]
            planes += [side, chute]
    return np.array(planes)


def _core(planes: FloatArray, size: Size) -> FloatArray:
    """Corners of the polyhedron within planes moved inwards by the edge radius, (n, 3), m."""
    inwards = planes + np.array([0.0, 0.0, 0.0, size.edge_radius])
    middle = np.array([0.0, size.hopper + 0.5 * size.height, 0.0])
    rule = (
        f"geometry.edge_radius = {size.edge_radius:g} m: too round for the smallest side of the "
        "bin; take less, or a larger outlet"
    )
    if np.any(inwards[:, :3] @ middle + inwards[:, 3] >= 0):
        raise InputError(rule)
    corners = HalfspaceIntersection(inwards, middle).intersections
    on_plane = np.abs(corners @ inwards[:, :3].T + inwards[:, 3]) < 1e-9 * size.length
    for plane in on_plane.T:
        if len(np.unique(corners[plane].round(9), axis=0)) < 3:
            raise InputError(rule)
    return np.asarray(corners)


def _steiner(hull: ConvexHull, points: FloatArray, radius: float) -> float:
    """Volume of the hull grown by balls of `radius`, m^3."""
    bend = 0.0  # every edge lies between two triangles, each of which counts half of it
    for face, neighbours in enumerate(hull.neighbors):
        for opposite, other in enumerate(neighbours):
            edge = np.delete(hull.simplices[face], opposite)
            length = float(np.linalg.norm(np.subtract(*points[edge])))
            cosine = float(hull.equations[face, :3] @ hull.equations[other, :3])
            bend += 0.5 * length * math.acos(min(1.0, max(-1.0, cosine)))
    return float(
        hull.volume + radius * hull.area + radius**2 / 2 * bend + 4 / 3 * math.pi * radius**3
    )


def _ball_points() -> FloatArray:
    """Points spread evenly over the unit sphere (a Fibonacci lattice), (n, 3)."""
    number = np.arange(_BALL_POINTS) + 0.5
    up = 1.0 - 2.0 * number / _BALL_POINTS
    turn = math.pi * (1.0 + math.sqrt(5.0)) * number
    flat = np.sqrt(1.0 - up**2)
    return np.stack([flat * np.cos(turn), up, flat * np.sin(turn)], axis=-1)


def _rotation(tilt: float, turn: float) -> FloatArray:
    """Rotation about y by `turn`, then about x by `tilt` (rad), (3, 3)."""
    about_y = np.array(
        [
            [math.cos(turn), 0.0, math.sin(turn)],
            [0.0, 1.0, 0.0],
            [-math.sin(turn), 0.0, math.cos(turn)],
        ]
    )
    about_x = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, math.cos(tilt), -math.sin(tilt)],
            [0.0, math.sin(tilt), math.cos(tilt)],
        ]
    )
    return about_x @ about_y
