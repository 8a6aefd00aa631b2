"""Where the material of a cell goes: paths through the cells, from the face fluxes alone.

In a cell of fill fraction phi(t), taken as of uniform density, the velocity in cells per second
along each axis is

    dx/dt = [f_0 + (f_1 - f_0) x] / phi(t),     x in [0, 1],

with f_0 and f_1 the fluxes through the lower and the upper face over the volume of a cell (Pollock
1988, Ground Water 26, 743). Density times velocity is continuous through faces and
d(phi)/dt = f_0 - f_1 summed over the axes, so that the motion carries the fills of an interval into
each other exactly, whatever the cells hold: no path leaves the bed, and a cut cell limits nothing.

Among full cells the fluxes are those at the path's transverse place, f + sum over transverse axes
b of shear_b (x_b - 1/2), and a path takes steps of the classical Runge-Kutta method, of at most a
cell. Everywhere else the equation is solved exactly, in the time tau, d(tau) = dt/phi, from face to
face, with the mean of x_b on the way through the cell.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from scaleup.contract import BoolArray, FloatArray, IntArray

_MOST = 100_000  # faces on a path
_EMPTY = 1e-13  # fill fraction
_TURN = 0.4  # greatest velocity gradient times a Runge-Kutta step


def lattice(per_edge: int, dimension: int) -> FloatArray:
    """Middles of the `per_edge`^dimension equal sub-cells of the unit cell, x fastest."""
    line = (np.arange(per_edge) + 0.5) / per_edge
    mesh = np.meshgrid(*[line] * dimension, indexing="ij")
    return np.stack([part.ravel() for part in reversed(mesh)], axis=-1)


@numba.njit(cache=True, error_model="numpy")
def follow(
    below: IntArray,
    above: IntArray,
    flux: FloatArray,
    shear: FloatArray,
    full: BoolArray,
    start: FloatArray,
    rate: FloatArray,
    sources: IntArray,
    points: FloatArray,
    duration: float,
    axes: tuple[int, ...],
) -> tuple[IntArray, FloatArray]:
    """Follow points of cells for a time (s); see the module.

    full -- (m,) cells that are so all the time
    axes -- 0, 1, ...: so that their number is known to the compiler (a sixth faster)
    start, rate -- fill fraction at the beginning of the time and its change per second
    """
    dimension, count = len(axes), points.shape[0]
    landed = np.empty((len(sources), count), dtype=np.int32)
    places = np.empty((len(sources), count, dimension), dtype=np.float32)
    x, v, grows = np.empty(dimension), np.empty(dimension), np.empty(dimension)
    f0, f1 = np.empty(dimension), np.empty(dimension)
    stages, at = np.empty((4, dimension)), np.empty(dimension)
    for n in range(len(sources)):
        for p in range(count):
            i, now = sources[n], 0.0
            for a in range(dimension):
                x[a] = points[p, a]
            stuck = 0
            for _ in range(_MOST):
                if full[i]:
                    ahead, taken = _runge_kutta(
                        i, x, duration - now, below, above, flux, shear, full, stages, at, axes
                    )
                    if ahead >= 0:
                        i, now = ahead, now + taken
                        if now >= duration:
                            break
                        continue
                phi = start[i] + rate[i] * now
                last = start[i] + rate[i] * duration
                left = duration - now
                # the time left, in tau
                change = rate[i] * left
                if last <= _EMPTY:
                    tau_left = np.inf
                elif abs(change) < 1e-6 * phi:
                    tau_left = left / (phi + 0.5 * change)
                else:
                    tau_left = math.log(last / max(phi, 1e-300)) / rate[i]
                quick = tau_left
                for a in range(dimension):
                    up = above[a, i]
                    f0[a] = flux[a, i]
                    f1[a] = flux[a, up] if up >= 0 else 0.0
                    if stuck < 3:
                        for b in range(dimension):
                            if b != a:
                                f0[a] += shear[a, b, i] * (x[b] - 0.5)
                                if up >= 0:
                                    f1[a] += shear[a, b, up] * (x[b] - 0.5)
                    v[a] = f0[a] + (f1[a] - f0[a]) * x[a]
                for a in range(dimension if stuck < 3 else 0):
                    up = above[a, i]
                    grows[a] = (f1[a] - f0[a]) * v[a]
                    for b in range(dimension):
                        if b != a:
                            here = shear[a, b, i]
                            if up >= 0:
                                here += (shear[a, b, up] - here) * x[a]
                            grows[a] += here * v[b]
                    if v[a] != 0.0:
                        t = ((1.0 - x[a]) if v[a] > 0.0 else -x[a]) / v[a]
                        bend = 0.5 * grows[a] * t / v[a]
                        quick = min(quick, t * min(max(1.0 - bend, 0.5), 2.0))
                # the mean transverse place until then, to third order
                for b in range(dimension if stuck < 3 else 0):
                    y = x[b] + quick * (0.5 * v[b] + quick * grows[b] / 6)
                    y = min(max(y, 0.0), 1.0) - x[b]
                    for a in range(dimension):
                        if b != a:
                            up = above[a, i]
                            f0[a] += shear[a, b, i] * y
                            if up >= 0:
                                f1[a] += shear[a, b, up] * y
                tau, through = tau_left, -1
                for a in range(dimension):
                    w = f0[a] + (f1[a] - f0[a]) * x[a]
                    v[a] = w
                    if w > 0.0 and f1[a] > 0.0:
                        t = _time_to(1.0 - x[a], w, f1[a])
                    elif w < 0.0 and f0[a] < 0.0:
                        t = _time_to(x[a], -w, -f0[a])
                    else:
                        continue
                    if t < tau:
                        tau, through = t, a
                if through < 0 and tau == np.inf:
                    break
                for a in range(dimension):
                    k = f1[a] - f0[a]
                    if a != through:
                        x[a] = min(max(x[a] + v[a] * _grown(k, tau), 0.0), 1.0)
                if through < 0:
                    break
                if rate[i] == 0.0:
                    now += tau * phi
                else:
                    now += phi * _grown(rate[i], tau)
                stuck = stuck + 1 if tau == 0.0 else 0
                if v[through] > 0.0:
                    i = above[through, i]
                    x[through] = 0.0
                else:
                    i = below[through, i]
                    x[through] = 1.0
                if now >= duration:
                    break
            landed[n, p] = i
            for a in range(dimension):
                places[n, p, a] = x[a]
    return landed, places


@numba.njit(inline="always")
def _runge_kutta(i, x, left, below, above, flux, shear, full, stages, at, axes):
    """Move x, in cell i, by a step of at most `left` (s); returns the cell that it is in then.

    And the step; -1, and x as it was, if the step would touch a cell that is not full.
    """
    dimension = len(axes)
    at[:] = x
    if _velocity(i, at, below, above, flux, shear, full, stages[0], axes) < 0:
        return -1, 0.0
    fastest = 0.0
    for a in range(dimension):
        up = above[a, i]
        growth = abs((flux[a, up] if up >= 0 else 0.0) - flux[a, i]) / _TURN
        fastest = max(fastest, abs(stages[0, a]), growth)
        for b in range(dimension):
            fastest = max(fastest, abs(shear[a, b, i]) / _TURN)
    dt = left if fastest * left <= 1.0 else 1.0 / fastest
    for stage in range(1, 4):
        ahead = dt if stage == 3 else 0.5 * dt
        for a in range(dimension):
            at[a] = x[a] + ahead * stages[stage - 1, a]
        if _velocity(i, at, below, above, flux, shear, full, stages[stage], axes) < 0:
            return -1, 0.0
    for a in range(dimension):
        slope = stages[0, a] + 2.0 * (stages[1, a] + stages[2, a]) + stages[3, a]
        at[a] = x[a] + dt / 6.0 * slope
    cell = _cell_of(i, at, below, above, full, axes)
    if cell >= 0:
        x[:] = at
    return cell, dt


@numba.njit(inline="always")
def _velocity(i, x, below, above, flux, shear, full, v, axes):
    """Put the velocity (cells/s) at x, counted from cell i, into v; x is counted from its own cell.

    Returns that cell, or -1 if full cells do not lead there.
    """
    i = _cell_of(i, x, below, above, full, axes)
    if i < 0:
        return i
    dimension = len(axes)
    for a in range(dimension):
        up = above[a, i]
        low = flux[a, i]
        high = flux[a, up] if up >= 0 else 0.0
        for b in range(dimension):
            if b != a:
                low += shear[a, b, i] * (x[b] - 0.5)
                if up >= 0:
                    high += shear[a, b, up] * (x[b] - 0.5)
        v[a] = low + (high - low) * x[a]
    return i


@numba.njit(inline="always")
def _cell_of(i, x, below, above, full, axes):
    """The cell where x is, counted from cell i; x is counted from it then. -1 as `_velocity`."""
    for a in range(len(axes)):
        while x[a] > 1.0 and i >= 0:
            i = above[a, i]
            x[a] -= 1.0
        while x[a] < 0.0 and i >= 0:
            i = below[a, i]
            x[a] += 1.0
    if i >= 0 and not full[i]:
        return -1
    return i


@numba.njit(inline="always")
def _time_to(way: float, speed: float, at_face: float) -> float:
    """Tau for `way` (in cells) from `speed` to the speed `at_face`, linear in between."""
    z = (at_face - speed) / (at_face + speed)
    if abs(z) < 0.3:  # log(at_face/speed) = 2 artanh(z)
        s = z * z
        return way * 2.0 * (1.0 + s * (1 / 3 + s * (0.2 + s * (1 / 7 + s / 9)))) / (at_face + speed)
    return way * math.log(at_face / speed) / (at_face - speed)


@numba.njit(inline="always")
def _grown(k: float, tau: float) -> float:
    """(exp(k tau) - 1)/k."""
    z = k * tau
    if abs(z) < 0.1:
        return tau * (1.0 + z * (0.5 + z * (1 / 6 + z * (1 / 24 + z * (1 / 120 + z / 720)))))
    return (math.exp(z) - 1.0) / k
