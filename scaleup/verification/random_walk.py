"""Random walks in the rolling drum: a reference that knows no grid.

A walk is the Ito process dX = (v + div D) dt + sqrt(2 D) dW, which spreads as dc/dt = -v.grad c +
div(D grad c) does: Runge-Kutta along v, then Euler-Maruyama, reflected at the surface and at the
wall. Where it is right the density of the walks stays uniform, as the powder's does; that and the
difference of two independent halves tell how far it can be trusted. See `drum_layer` for v and D.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numba
import numpy as np

from scaleup.space.grid import BoolArray, FloatArray
from scaleup.verification.drum_layer import (
    COARSE,
    DISTANCE,
    HALF_CHORD,
    K1,
    K2,
    LAYER_SPEED,
    OMEGA,
    RADIUS,
    REVOLUTION,
    STRENGTH,
    THICKNESS,
    bed_level,
    lab_coordinates,
    surface_coordinates,
)

_SHEAR_OF_STEP = 0.2  # by which the layer shears during a Runge-Kutta step
_THINNEST = 0.01  # of the layer at mid-bed: thinner ones shorten steps no more
_NOTHING = 1e-9  # of the diffusivity on the surface
QUARTERS = (0.25, 0.5, 0.75, 1.0)  # revolutions at which walks are looked at


@dataclass(frozen=True)
class Walks:
    """What walks gave, one row per quarter of a revolution.

    concentration -- of component 0 in the coarse cells, (quarters, cells)
    halves        -- the same from two independent halves of the walks, (2, quarters, cells)
    count         -- walks in the coarse cells, at the start and at the quarters
    """

    concentration: FloatArray
    halves: FloatArray
    count: FloatArray

    def concentration_at(self, time: float) -> FloatArray:
        """Component 0 in the coarse cells at one of the quarters, s."""
        row = int(np.argmin(np.abs(np.array(QUARTERS) * REVOLUTION - time)))
        if not math.isclose(QUARTERS[row] * REVOLUTION, time):
            raise ValueError(f"walks are seen at quarters of a revolution, not at {time:g} s")
        return np.asarray(self.concentration[row])

    def sampling_error(self, volumes: FloatArray) -> float:
        """Relative L1 error of the last concentration by its halves, with weights (cells,)."""
        # each half differs from the truth by sqrt(2) of what the whole does, their difference by 2
        difference = 0.5 * np.abs(self.halves[0, -1] - self.halves[1, -1])
        return float(difference @ volumes / (self.concentration[-1] @ volumes))


@lru_cache(maxsize=2)
def random_walks(particles: int = 500_000, steps: int = 400, seed: int = 7) -> Walks:
    """Walks over one revolution in a number of steps, a multiple of 4.

    They start on a jittered lattice in the bed; component 0 is what starts at x < 0.
    """
    rng = np.random.default_rng(seed)
    state = _spread_evenly(particles, rng)
    first, one_half = state[:, 0] < 0, rng.random(len(state)) < 0.5
    everyone = np.ones(len(state), dtype=bool)
    counts, shares, halves = [_count(state, everyone)], [], []
    for _ in QUARTERS:
        advance(state, REVOLUTION / steps, steps // len(QUARTERS), rng)
        counts.append(_count(state, everyone))
        shares.append(_share(state, first, everyone))
        halves.append([_share(state, first, one_half), _share(state, first, ~one_half)])
    return Walks(np.array(shares), np.swapaxes(np.array(halves), 0, 1), np.array(counts))


def _spread_evenly(particles: int, rng: np.random.Generator) -> FloatArray:
    """Surface coordinates of a jittered lattice of about so many points in the bed."""
    segment = RADIUS**2 * math.acos(DISTANCE / RADIUS) - DISTANCE * HALF_CHORD
    spacing = math.sqrt(segment / particles)
    line = np.arange(-RADIUS, RADIUS, spacing)
    lattice = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    points = lattice + spacing * rng.random(lattice.shape)
    return surface_coordinates(points[bed_level(points) > 0])


def _count(state: FloatArray, which: BoolArray) -> FloatArray:
    place = (lab_coordinates(state[which]) + RADIUS) * (COARSE / (2 * RADIUS))
    column, row = np.clip(place.astype(np.int64), 0, COARSE - 1).T
    return np.bincount(row * COARSE + column, minlength=COARSE**2).astype(float)


def _share(state: FloatArray, first: BoolArray, which: BoolArray) -> FloatArray:
    total = _count(state, which)
    share: FloatArray = _count(state, which & first) / np.maximum(total, 1.0)
    return share


@numba.njit(cache=True)  # type: ignore[untyped-decorator,misc]
def velocity(x: float, y: float) -> tuple[float, float]:
    """Along and across the surface, m/s."""
    along, out = OMEGA * (y - DISTANCE), -OMEGA * x
    delta = THICKNESS * (1.0 - (x / HALF_CHORD) ** 2)
    if y > -delta and delta > 0.0:
        along += 2.0 * LAYER_SPEED * (1.0 + y / delta)
        out *= (y / delta) ** 2
    return along, out


@numba.njit(cache=True)  # type: ignore[untyped-decorator,misc]
def carried(x: float, y: float, dt: float) -> tuple[float, float]:
    """Where the flow takes a point in dt (s): Runge-Kutta steps, short where the layer is thin."""
    left = dt
    while left > 0.0:
        delta = THICKNESS * max(1.0 - (x / HALF_CHORD) ** 2, _THINNEST)
        shear_rate = 2.0 * LAYER_SPEED / delta
        h = min(left, _SHEAR_OF_STEP / shear_rate)
        if y < -delta:  # rigid below: no faster than to its top
            h = min(left, max(h, 0.5 * (-delta - y) / (OMEGA * RADIUS)))
        u1, v1 = velocity(x, y)
        u2, v2 = velocity(x + 0.5 * h * u1, y + 0.5 * h * v1)
        u3, v3 = velocity(x + 0.5 * h * u2, y + 0.5 * h * v2)
        u4, v4 = velocity(x + h * u3, y + h * v3)
        x += h / 6.0 * (u1 + 2.0 * u2 + 2.0 * u3 + u4)
        y += h / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        x, y = _reflected(x, y)
        left -= h
    return x, y


@numba.njit(cache=True)  # type: ignore[untyped-decorator,misc]
def _reflected(x: float, y: float) -> tuple[float, float]:
    y = -abs(y)
    r = math.hypot(x, y - DISTANCE)
    if r > RADIUS:
        back = (2.0 * RADIUS - r) / r
        x, y = x * back, DISTANCE + (y - DISTANCE) * back
    return x, y


@numba.njit(cache=True)  # type: ignore[untyped-decorator,misc]
def advance(state: FloatArray, dt: float, steps: int, rng: np.random.Generator) -> None:
    """Move all walks on by `steps` of dt (s)."""
    for p in range(state.shape[0]):
        x, y = state[p, 0], state[p, 1]
        for _ in range(steps):
            x, y = carried(x, y, dt)
            taper = max(1.0 - (x / HALF_CHORD) ** 2, 0.0)
            depth = y / THICKNESS
            profile = STRENGTH * math.exp(-(depth**2))
            if profile > _NOTHING * STRENGTH:
                d = profile * taper**2
                drift_x = -K2 * profile * taper * 4.0 * x / HALF_CHORD**2
                drift_y = -K1 * d * 2.0 * depth / THICKNESS
                x += drift_x * dt + math.sqrt(2.0 * K2 * d * dt) * rng.standard_normal()
                y += drift_y * dt + math.sqrt(2.0 * K1 * d * dt) * rng.standard_normal()
                x, y = _reflected(x, y)
        state[p, 0], state[p, 1] = x, y
