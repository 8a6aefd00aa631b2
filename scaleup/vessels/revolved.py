"""Vessels that are a profile turned about an axis of their own."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from scaleup.contract import Geometry
from scaleup.space.grid import FloatArray
from scaleup.space.solids import TurnedSolid
from scaleup.system.errors import InputError

_ROUND_OFF = 1e-12
_CELLS, _NODES, _RATIO = 7, 16, 0.25


class Revolved(Geometry):
    """A profile turned about the vessel's own axis of symmetry; the axis of rotation is z.

    All but the options and the default scene follows; a plugin hands over corners of its profile,
    and, unless the vessel is turned about its upright, what it is turned about:

        def __init__(self, options):
            super().__init__(options, [(height, radius), ...])
    """

    def __init__(
        self,
        options: Any,
        profile: ArrayLike,
        direction: ArrayLike = (0.0, 1.0, 0.0),
        origin: ArrayLike = (0.0, 0.0, 0.0),
    ):
        """A shape from one lid to the other.

        profile   -- (n, 2), m: along the axis of symmetry, not falling, and from it; straight in
                     between, closed by a flat lid where it begins or ends with a radius
        direction -- of the axis of symmetry, of any length
        origin    -- m, where the height is 0 on it
        Raises InputError if there is no such body.
        """
        super().__init__(options)
        heights, radii = np.asarray(profile, dtype=float).T
        along = np.asarray(direction, dtype=float)
        if not along.any():
            raise InputError("geometry: the direction of the vessel's own axis must not be zero")
        along = along / np.linalg.norm(along)
        if np.any(np.diff(heights) < 0) or radii.min() < 0:
            raise InputError(
                "geometry: the profile's heights must not fall nor its radii be below 0"
            )
        self._solid = TurnedSolid(heights, radii, np.asarray(origin, dtype=float), along)
        self.volume = self._solid.mass
        if not self.volume > 0:
            raise InputError("geometry: the profile of the vessel encloses nothing")
        middles = self._solid.origin + heights[:, None] * along
        across = radii[:, None] * np.sqrt(np.maximum(1.0 - along**2, 0.0))
        self.lower = tuple(float(x) for x in (middles - across).min(axis=0))
        self.upper = tuple(float(x) for x in (middles + across).max(axis=0))
        self.reach = self._greatest_distance(middles)
        self.symmetry = ((0.0, 0.0, 1.0),) if self._is_mirrored() else ()

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside, exact; points (..., 3) in m.

        In the half-plane of a point and the axis of symmetry: that to the nearest straight piece of
        the profile.
        """
        solid = self._solid
        offset = points - solid.origin
        y = offset @ solid.direction
        r = np.linalg.norm(offset - y[..., None] * solid.direction, axis=-1)
        heights = np.pad(solid.heights, 1, mode="edge")
        radii = np.pad(solid.radii, 1)
        squared = np.full(y.shape, np.inf)
        for k in range(len(heights) - 1):
            h, d = heights[k + 1] - heights[k], radii[k + 1] - radii[k]
            if h == d == 0.0:
                continue
            share = ((y - heights[k]) * h + (r - radii[k]) * d) / (h * h + d * d)
            share = np.clip(share, 0.0, 1.0)
            gap = (y - heights[k] - share * h) ** 2 + (r - radii[k] - share * d) ** 2
            np.minimum(squared, gap, out=squared)
        inside = (y > heights[0]) & (y < heights[-1])
        inside &= r < np.interp(y, solid.heights, solid.radii)
        distance: FloatArray = np.where(inside, 1.0, -1.0) * np.sqrt(squared)
        return distance

    def volume_below(self, height: float) -> float:
        """m^3 below the level y = height: frusta of an upright vessel, else by quadrature.

        The level cuts circles square to the axis of symmetry in segments of known area. Along the
        axis that is integrated by Gauss's rule of 16 points in cells that shrink, fourfold each,
        seven times towards the ends of pieces on which the area is analytic: between corners of the
        profile, and where the level touches a circle. The error is round-off.
        """
        solid = self._solid
        rise, level = float(solid.direction[1]), height - float(solid.origin[1])
        lean = math.sqrt(max(1.0 - rise**2, 0.0))
        if lean < _ROUND_OFF:
            return (
                solid.volume_up_to(level) if rise > 0 else solid.mass - solid.volume_up_to(-level)
            )
        y, r = solid.heights, solid.radii
        t = (level - rise * y) / lean  # from a circle's middle up to the level, along its plane
        ends = np.stack([np.zeros(len(y) - 1), *_touches(r, t), np.ones(len(y) - 1)])
        ends = np.sort(ends, axis=0)
        share = ends[:-1, :, None] + np.diff(ends, axis=0)[:, :, None] * _POINTS
        radius = r[:-1, None] + share * np.diff(r)[:, None]
        to_level = t[:-1, None] + share * np.diff(t)[:, None]
        part = np.clip(to_level / np.maximum(radius, 1e-300), -1.0, 1.0)
        area = radius**2 * (np.arccos(-part) + part * np.sqrt(1.0 - part**2))
        return float(np.sum((area @ _WEIGHTS) * np.diff(ends, axis=0) * np.diff(y)))

    def solid(self) -> TurnedSolid:
        """The inside, by its profile."""
        return self._solid

    def _greatest_distance(self, middles: FloatArray) -> float:
        """m, from the axis of rotation, of the profile's circles: uphill from the best of many."""
        one, other = np.linalg.svd(self._solid.direction[None, :])[2][1:, :2]
        angle = np.linspace(0.0, 2 * math.pi, 360, endpoint=False)
        towards = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        best = 0.0
        for middle, radius in zip(middles[:, :2], self._solid.radii, strict=True):
            across = radius * np.stack([one, other], axis=-1)
            middle = middle - self.axis.point[:2]
            unit = towards[np.linalg.norm(middle + towards @ across.T, axis=1).argmax()]
            for _ in range(100):  # a convex function rises along its gradient's own unit vector
                slope = across.T @ (middle + across @ unit)
                unit = slope / max(float(np.linalg.norm(slope)), 1e-300)
            best = max(best, float(np.linalg.norm(middle + across @ unit)))
        return best

    def _is_mirrored(self) -> bool:
        """Whether z = 0 is a mirror plane: it holds the axis of symmetry, or halves it."""
        solid, near = self._solid, _ROUND_OFF * self.reach
        upright, middle = abs(float(solid.direction[2])), float(solid.origin[2])
        if upright < _ROUND_OFF:
            return abs(middle) < near
        z = middle + solid.direction[2] * solid.heights
        same = np.abs(z + z[::-1]).max() < near and np.ptp(solid.radii - solid.radii[::-1]) < near
        return bool(upright > 1 - _ROUND_OFF and same)


def _touches(r: FloatArray, t: FloatArray) -> list[FloatArray]:
    """Where, as shares of each piece in [0, 1], the level touches its circles: t = r and t = -r."""
    found = []
    for gap in (r - t, r + t):
        fall = gap[:-1] - gap[1:]
        share = np.divide(gap[:-1], fall, out=np.zeros(len(fall)), where=fall != 0)
        found.append(np.clip(share, 0.0, 1.0))
    return found


def _graded_rule() -> tuple[FloatArray, FloatArray]:
    """Points and weights on [0, 1], in cells that shrink towards both ends."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)  # type: ignore[no-untyped-call]
    half = np.append(0.0, 0.5 * _RATIO ** np.arange(_CELLS - 1, -1, -1.0))
    ends = np.concatenate([half, 1.0 - half[-2::-1]])
    length = np.diff(ends)[:, None]
    points = ends[:-1, None] + length * (nodes + 1) / 2
    return points.ravel(), (length * weights / 2).ravel()


_POINTS, _WEIGHTS = _graded_rule()
