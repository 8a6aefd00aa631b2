"""The bed through the first revolution and on until it repeats itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

from scaleup_surface_layer.lab_columns import BedState, BedStep
from scaleup_surface_layer.rotation import bed_surface, turn
from scaleup_surface_layer.sandpile import SlopeLaw, relax
from scaleup_surface_layer.turned_vessel import Outline, PhasedVessel

_DRY = 1e-6  # of a column's width: less depth than this is none
_REPEATS = 1e-3  # of the bed's volume may differ from one revolution to the next


@dataclass
class Revolution:
    """Steps from the level bed on; those from `prefix` on are one revolution that repeats.

    steps    -- prefix + one revolution of them; multiple -- of them in an interval
    outlines -- the vessel in the columns, at the phases of one revolution
    mismatch -- share of the bed's volume that differs between the ends of that revolution
    rehomed  -- volume put elsewhere than rotation left it, per revolution, over the bed's
    drift    -- greatest relative change of the bed's volume
    """

    steps: list[BedStep]
    multiple: int
    outlines: list[Outline]
    prefix: int
    mismatch: float
    rehomed: float
    drift: float


def revolve(
    vessel: PhasedVessel,
    law: SlopeLaw,
    omega: float,
    level: float,
    volume: float,
    multiple: int,
    progress: Callable[[float], None],
) -> Revolution:
    """Turn the vessel until the bed repeats itself; there is a step between two phases.

    level    -- m, of the bed at rest, relative to the axis; volume -- m^3
    multiple -- the prefix is one of it in steps, as the revolution is
    """
    columns, shapes, per_revolution = vessel.columns, vessel.shapes, len(vessel.shapes)
    angle = 2 * math.pi / per_revolution
    limit = 1.5 * law.friction
    shape = shapes[0]
    depth = np.clip(level, shape.floor, np.maximum(shape.roof, shape.floor)) - shape.floor
    held = np.where(shape.roof > shape.floor, depth, 0.0).mean(axis=(2, 3), dtype=float)
    held *= volume / (held.sum() * columns.dx * columns.dz)
    total = held.sum()
    tops = bed_surface(shape, held, limit, columns)
    state = _state(columns, shape, held, tops, 0.0, law.friction)
    history, steps = [held], []
    moved, drift = 0.0, 0.0
    for number in range(1, 3 * per_revolution + 1):
        turned = shapes[number % per_revolution]
        landed, misplaced = turn(columns, shape, held, tops, turned, angle)
        held, qx, qz = relax(columns, turned, landed, law, angle / omega)
        moved += misplaced
        drift = max(drift, abs(held.sum() / total - 1))
        shape = turned
        tops = bed_surface(shape, held, limit, columns)
        before, state = state, _state(columns, shape, held, tops, number * angle, law.friction)
        steps.append(BedStep(before, state, qx, qz))
        history.append(held)
        progress(number / (1.5 * per_revolution))
        if number >= per_revolution and number % multiple == 0:
            mismatch = np.abs(held - history[number - per_revolution]).sum() / total
            if mismatch < _REPEATS:
                break
    return Revolution(
        steps=steps,
        multiple=multiple,
        outlines=[shape.outline for shape in shapes],
        prefix=number - per_revolution,
        mismatch=float(mismatch),
        rehomed=float(moved / total * per_revolution / number),
        drift=float(drift),
    )


def _state(columns, shape, held, tops, phase, friction) -> BedState:
    bottom = np.where(shape.roof > shape.floor, shape.floor, np.inf).min(axis=(2, 3))
    top = np.where(shape.roof > shape.floor, shape.roof, -np.inf).max(axis=(2, 3))
    kind = np.where(shape.open <= 0, -1, 0)
    wet = held > _DRY * columns.dx
    full = wet & (held >= (1 - 1e-9) * shape.capacity)
    kind[wet & ~full] = 1
    kind[full] = 2
    surface = _continued(tops[0], kind, bottom, top, 1.2 * friction, columns.dx, columns.dz)
    depth = np.where(wet, held / np.maximum(shape.open, 1e-12), 0.0)
    return BedState(phase, surface, depth)


@njit(cache=True)
def _continued(height, kind, bottom, top, limit, dx, dz):
    """The surface on all columns, continued linearly from the partly filled ones.

    kind -- 1 partly filled, 2 full (the surface is above the roof), 0 empty (below the floor),
    -1 outside the vessel
    """
    nx, nz = height.shape
    surface = height.copy()
    known = kind == 1
    if not known.any():
        known = kind == 2
    fresh = known.copy()
    for _ in range(nx + nz):
        changed = False
        for i in range(nx):
            for k in range(nz):
                if known[i, k]:
                    continue
                total, count = 0.0, 0
                for e in range(4):
                    a = (1, -1, 0, 0)[e]
                    b = (0, 0, 1, -1)[e]
                    m, n = i + a, k + b
                    if not (0 <= m < nx and 0 <= n < nz) or not known[m, n]:
                        continue
                    d = dx if e < 2 else dz
                    rise = 0.0
                    if 0 <= m + a < nx and 0 <= n + b < nz and known[m + a, n + b]:
                        rise = surface[m, n] - surface[m + a, n + b]
                    total += surface[m, n] + min(max(rise, -limit * d), limit * d)
                    count += 1
                if count:
                    value = total / count
                    if kind[i, k] == 2:
                        value = max(value, top[i, k])
                    elif kind[i, k] == 0:
                        value = min(value, bottom[i, k])
                    surface[i, k] = value
                    fresh[i, k] = True
                    changed = True
        for i in range(nx):
            for k in range(nz):
                known[i, k] = fresh[i, k]
        if not changed:
            break
    return surface
