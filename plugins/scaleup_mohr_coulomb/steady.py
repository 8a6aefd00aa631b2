"""The steady bed: from rest through the first avalanche to a mean over whole swings.

After the avalanche the bed swings about its mean inclination, as particles do, for many periods.
A mean cut in mid-swing would hold a flow that is still moving the bed from one side to the other;
means are therefore taken over whole swings, and their scatter is the error estimate.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from .level_set import LevelSet
from .mesh import farthest_wall, surface_normal, wall_distance
from .parameters import SteadyOptions
from .two_phase import TwoPhaseFlow

Progress = Callable[[float, str], None]

# The angle is fitted within this part of the vessel's radius, clear of the curved ends.
_FIT_REACH = 0.48
_AVALANCHE_DROP = math.radians(0.5)
# Hysteresis of a crossing of the mean angle, in settled amplitudes.
_CROSSING_BAND = 0.25
_BLOCKS_PER_PERIOD = 20
_CHECKS_PER_PERIOD = 4
# Natural periods that start-up and one swing usually take, for the progress only.
_START_UP_PERIODS = 2.0
_SWING_PERIODS = 1.5
_FEWEST_SWINGS = 2
_WALL_MARGIN = 0.9999
_SAMPLES = 800
_SURFACE_REACH = 0.85


class NotSteady(RuntimeError):  # noqa: N818
    """The time limit came before there was anything to average over."""


@dataclass(frozen=True)
class Window:
    """Stretch of a run that is averaged over, as sample numbers, and what its mean is worth."""

    first: int
    last: int
    parts: int
    """Whole swings, or natural periods of a bed that no longer swings."""
    swinging: bool
    angle: float
    """Mean inclination of the surface, rad."""
    angle_error: float
    """Standard error of ``angle``, rad: scatter of the parts' means over sqrt(parts)."""


@dataclass(frozen=True)
class SteadyBed:
    """Time-mean flow of a bed that turns steadily, and how well it is known.

    ``angle_error`` is the standard deviation of the means over single swings, divided by the
    square root of their number.
    """

    mesh: Any
    velocity: Any
    """Mean velocity, VectorH1 of order 2, m/s."""
    level_set: LevelSet
    """Mean free surface (redistanced mean of the signed distance)."""
    angular_velocity: float
    """omega, rad/s."""
    angle: float
    """Mean inclination of the free surface, rad."""
    angle_error: float
    """Standard error of ``angle``, rad."""
    converged: bool
    """Whether ``angle_error`` met the tolerance before the time limit."""
    swings: int
    """Whole swings averaged over; 0 if the bed had stopped swinging."""
    window: tuple[float, float]
    """First and last time averaged over, s."""
    times: NDArray[Any]
    """Times of all steps, s."""
    angles: NDArray[Any]
    """Inclination of the free surface at ``times``, rad."""
    area_correction: float
    """Sum of |area restored| over the run, relative to the bed."""
    net_area_correction: float
    """Sum of the area restored over the run, relative to the bed."""
    steps: int
    seconds: float
    """Wall-clock time of the run."""


def natural_period(level_set: LevelSet, gravity: float) -> float:
    """Period (s) of the bed as a rigid pendulum about the axis, 2 pi sqrt(int r^2 / (g |int r|)).

    A bed that flows at its surface swings more slowly, by a factor of about 1.5 in a drum.
    """
    alpha = level_set.fraction
    x, y, square = ngs.Integrate(
        ngs.CoefficientFunction((alpha * ngs.x, alpha * ngs.y, alpha * (ngs.x**2 + ngs.y**2))),
        level_set.mesh,
    )
    return 2.0 * math.pi * math.sqrt(square / (gravity * math.hypot(x, y)))


class SwingAverage:
    """History of the surface angle and running sums of the fields, block by block."""

    def __init__(self, flow: TwoPhaseFlow) -> None:
        self.period = natural_period(flow.level_set, flow.drive.gravity)
        step = flow.discretisation.time_step
        self.block = max(1, round(self.period / (_BLOCKS_PER_PERIOD * step)))
        self.times: list[float] = []
        self.angles: list[float] = []
        self._sums: list[NDArray[Any]] = []

    def record(self, flow: TwoPhaseFlow) -> None:
        """Take in the flow after a step."""
        fields = np.concatenate(
            [flow.velocity.vec.FV().NumPy(), flow.level_set.field.vec.FV().NumPy()]
        )
        if len(self.times) % self.block == 0:
            self._sums.append(fields)
        else:
            self._sums[-1] += fields
        self.times.append(flow.time)
        self.angles.append(flow.level_set.surface_fit(_FIT_REACH * flow.radius)[0])

    def mean_fields(self, window: Window) -> NDArray[Any]:
        """Mean of velocity and level-set coefficients, the window rounded to whole blocks."""
        whole = len(self.times) // self.block  # the block under way is left out
        first, last = round(window.first / self.block), round(window.last / self.block)
        last = min(last, whole)
        mean: NDArray[Any] = np.sum(self._sums[first:last], axis=0)
        mean /= (last - first) * self.block
        return mean

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs."""
        return {
            "times": np.array(self.times),
            "angles": np.array(self.angles),
            "sums": np.array(self._sums),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up the record of a run that was broken off."""
        self.times, self.angles = state["times"].tolist(), state["angles"].tolist()
        self._sums = [row.copy() for row in state["sums"]]

    def window(self, options: SteadyOptions) -> Window | None:
        """The stretch to average over, or None while the bed is still starting up.

        1. The start-up ends with the first avalanche.  2. If the angle has kept within the settled
        amplitude for enough natural periods, these are the parts.  3. Otherwise the parts are the
        whole swings since, between upward crossings of the mean angle; as many leading swings are
        left out as makes the standard error least (the marginal standard error rule), down to the
        fewest allowed.
        """
        times, angles = np.array(self.times), np.array(self.angles)
        start = avalanche_end(times, angles, self.period)
        if start is None:
            return None
        still = settled_since(angles, options.settled_amplitude)
        per_period = self.period / (times[1] - times[0])
        periods = int((len(angles) - max(still, start)) / per_period)
        if periods >= options.settled_periods:
            last = len(angles) - len(angles) % self.block
            edges = np.round(last - per_period * np.arange(periods, -1, -1)).astype(int)
            return _window(angles, edges[edges >= 0], swinging=False)
        edges = upward_crossings(angles, start, _CROSSING_BAND * options.settled_amplitude)
        candidates = [
            _window(angles, edges[skipped:], swinging=True)
            for skipped in range(len(edges) - options.minimum_swings)
        ]
        return min(candidates, key=lambda window: window.angle_error, default=None)


def _window(angles: NDArray[Any], edges: NDArray[Any], swinging: bool) -> Window:
    means = np.array([angles[a:b].mean() for a, b in pairwise(edges)])
    return Window(
        first=int(edges[0]),
        last=int(edges[-1]),
        parts=len(means),
        swinging=swinging,
        angle=float(angles[edges[0] : edges[-1]].mean()),
        angle_error=float(means.std(ddof=1) / math.sqrt(len(means))),
    )


def avalanche_end(times: NDArray[Any], angles: NDArray[Any], period: float) -> int | None:
    """Sample at the foot of the first avalanche, or None before it.

    The avalanche begins when the angle has dropped 0.5 deg below its maximum, and ends at the
    minimum within one natural ``period`` (s) of that maximum.
    """
    dropped = np.flatnonzero(angles < np.maximum.accumulate(angles) - _AVALANCHE_DROP)
    if not len(dropped):
        return None
    peak = int(angles[: dropped[0]].argmax())
    within = np.flatnonzero(times > times[peak] + period)
    return peak + int(angles[peak : within[0]].argmin()) if len(within) else None


def settled_since(angles: NDArray[Any], amplitude: float) -> int:
    """First sample from which the angle keeps within +- ``amplitude`` (rad) of a constant."""
    backward = angles[::-1]
    spread = np.maximum.accumulate(backward) - np.minimum.accumulate(backward)
    return len(angles) - int((spread <= 2.0 * amplitude).sum())


def upward_crossings(angles: NDArray[Any], start: int, band: float) -> NDArray[Any]:
    """Samples after ``start`` where the angle rises through its mean since then.

    A crossing counts once the angle has been ``band`` (rad) below and is ``band`` above the mean.
    """
    deviation = angles[start:] - angles[start:].mean()
    crossings, below, candidate = [], False, 0
    for sample, value in enumerate(deviation):
        if value < -band:
            below, candidate = True, 0
        elif below and value >= 0.0 and not candidate:
            candidate = sample
        if below and value > band:
            crossings.append(start + candidate)
            below, candidate = False, 0
    return np.array(crossings, dtype=int)


def run_to_steady(
    flow: TwoPhaseFlow,
    options: SteadyOptions,
    progress: Progress,
    average: SwingAverage | None = None,
) -> SteadyBed:
    """Advance the flow until the mean surface angle is known to the tolerance.

    Give the ``average`` of a broken-off run, beside a restored flow, to go on with it; its state
    may be saved from within ``progress``, which is called several times per period.  On these
    small meshes one thread is fastest: inside ``ngsolve.TaskManager()`` waiting threads spin.
    """
    average = average or SwingAverage(flow)
    began, first_time = clock.perf_counter(), flow.time
    expected = average.period * (_START_UP_PERIODS + _SWING_PERIODS * options.minimum_swings)
    check = max(1, round(average.period / (_CHECKS_PER_PERIOD * flow.discretisation.time_step)))
    window = average.window(options)
    last_time = flow.discretisation.start_angle / flow.drive.angular_velocity + options.time_limit
    while flow.time < last_time and not _known(window, options):
        for _ in range(check):
            flow.step()
            average.record(flow)
        window = average.window(options)
        fraction = min(0.99, (flow.time - first_time) / expected)
        progress(fraction, _message(flow, average, window))
    seconds, converged = clock.perf_counter() - began, _known(window, options)
    window = window or average.window(replace(options, minimum_swings=_FEWEST_SWINGS))
    if window is None:
        raise NotSteady(
            f"The bed had not swung {_FEWEST_SWINGS} times at the time limit of "
            f"{options.time_limit:.3g} s, after {flow.steps} steps: raise the time limit."
        )
    progress(1.0, _message(flow, average, window) + ("" if converged else ", time limit reached"))
    return _steady_bed(flow, average, window, converged, seconds)


def _known(window: Window | None, options: SteadyOptions) -> bool:
    return window is not None and window.angle_error <= options.angle_tolerance


def _message(flow: TwoPhaseFlow, average: SwingAverage, window: Window | None) -> str:
    now = f"t = {flow.time:.2f} s, surface {math.degrees(average.angles[-1]):.1f} deg"
    if window is None:
        return f"{now}, start-up"
    angle, error = math.degrees(window.angle), math.degrees(window.angle_error)
    kind = "swings" if window.swinging else "natural periods"
    return f"{now}, mean {angle:.2f} +- {error:.2f} deg over {window.parts} {kind}"


def _steady_bed(
    flow: TwoPhaseFlow, average: SwingAverage, window: Window, converged: bool, seconds: float
) -> SteadyBed:
    means = average.mean_fields(window)
    velocity = ngs.GridFunction(flow.velocity.space)
    n_velocity = len(velocity.vec)
    velocity.vec.FV().NumPy()[:] = means[:n_velocity]
    level_set = LevelSet(flow.mesh, flow.discretisation.interface_half_width)
    level_set.field.vec.FV().NumPy()[:] = means[n_velocity:]
    level_set.redistance()
    level_set.restore_area(flow.drive.bed_area)
    return SteadyBed(
        mesh=flow.mesh,
        velocity=velocity,
        level_set=level_set,
        angular_velocity=flow.drive.angular_velocity,
        angle=window.angle,
        angle_error=window.angle_error,
        converged=converged,
        swings=window.parts if window.swinging else 0,
        window=(average.times[window.first], average.times[window.last - 1]),
        times=np.array(average.times),
        angles=np.array(average.angles),
        area_correction=flow.area_correction,
        net_area_correction=flow.net_area_correction,
        steps=len(average.times),
        seconds=seconds,
    )


@dataclass(frozen=True)
class MidBed:
    """Time-mean flow on the line through the axis, normal to the mean surface (raw field).

    Downflow and upflow are weighted with the powder fraction alpha, which reaches the interface
    half width beyond the contour: this is the flux that the level set transports.
    """

    depth: NDArray[Any]
    """Depth below the contour, m, from the surface to the wall."""
    speed: NDArray[Any]
    """Lab streamwise speed at ``depth``, positive down the slope, m/s."""
    axis_distance: float
    """Distance b from the axis down to the surface, m; negative if the axis is in the powder."""
    reversal_depth: float
    """Depth h0 of the active layer, where ``speed`` changes sign, m."""
    downflow: float
    """Flux per unit length above the reversal, m^2/s."""
    upflow: float
    """Flux per unit length below the reversal, m^2/s, positive up the slope."""
    rigid_upflow: float
    """omega/2 [R^2 - (b + h0)^2]: what rigid rotation would bring up below the reversal, m^2/s."""
    rotation_ratio: float
    """Rotation of the bed over that of the wall, in the lower half of the passive region."""


def mid_bed(bed: SteadyBed) -> MidBed:
    """Diagnostics of the mean field at mid-bed."""
    outward, downhill = _surface_axes(bed)
    radius = wall_distance(bed.mesh, np.zeros(2), -outward)
    ceiling = wall_distance(bed.mesh, np.zeros(2), outward)
    height = _WALL_MARGIN * np.linspace(ceiling, -radius, _SAMPLES)
    points = height[:, None] * outward
    phi = sample(bed.mesh, bed.level_set.field, points)
    alpha = sample(bed.mesh, bed.level_set.fraction, points)
    speed = sample(bed.mesh, bed.velocity, points) @ downhill
    surface = _zero(height, phi, np.flatnonzero((phi[:-1] <= 0.0) & (phi[1:] > 0.0))[-1])
    below = height < surface
    reverses = below[:-1] & (speed[:-1] > 0.0) & (speed[1:] <= 0.0)
    reversal = _zero(height, speed, np.flatnonzero(reverses)[0])
    upward_part = height < reversal
    flux = alpha * speed
    downflow = -float(trapezoid(np.where(upward_part, 0.0, flux), height))
    upflow = float(trapezoid(np.where(upward_part, flux, 0.0), height))
    lower_half = height < 0.5 * (reversal - radius)
    omega = bed.angular_velocity
    return MidBed(
        depth=surface - height[below],
        speed=speed[below],
        axis_distance=-surface,
        reversal_depth=surface - reversal,
        downflow=downflow,
        upflow=upflow,
        rigid_upflow=0.5 * omega * (radius**2 - reversal**2),
        rotation_ratio=float(speed[lower_half].sum() / (omega * height[lower_half]).sum()),
    )


def _surface_axes(bed: SteadyBed) -> tuple[NDArray[Any], NDArray[Any]]:
    """Unit vectors normal to the mean surface, out of the powder, and down its slope."""
    inclination, _ = bed.level_set.surface_fit(_FIT_REACH * farthest_wall(bed.mesh))
    outward = np.array(surface_normal(inclination))
    return outward, np.array([-outward[1], outward[0]])


def _zero(position: NDArray[Any], values: NDArray[Any], before: int) -> float:
    """Zero of the piecewise linear ``values`` between samples ``before`` and ``before`` + 1."""
    weight = values[before] / (values[before] - values[before + 1])
    return float((1.0 - weight) * position[before] + weight * position[before + 1])


def surface_speed(bed: SteadyBed, count: int = 41) -> tuple[NDArray[Any], NDArray[Any]]:
    """Position down the slope from mid-bed (m) and tangential speed (m/s) along the mean surface.

    Both have shape (count,).  The outer 15 % of the surface at either end are left out.
    """
    outward, downhill = _surface_axes(bed)
    start, end = bed.level_set.contour()
    middle = 0.5 * (start + end)
    order = np.argsort(middle @ downhill)
    along, height = (middle @ downhill)[order], (middle @ outward)[order]
    position = np.linspace(_SURFACE_REACH * along[0], _SURFACE_REACH * along[-1], count)
    points = position[:, None] * downhill + np.interp(position, along, height)[:, None] * outward
    return position, sample(bed.mesh, bed.velocity, points) @ downhill


def sample(mesh: Any, function: Any, points: NDArray[Any]) -> NDArray[Any]:
    """Values of a coefficient function at ``points`` (n, 2) inside the mesh: (n,) or (n, dim)."""
    values = np.asarray(function(mesh(points[:, 0], points[:, 1])))
    return values.reshape(len(points), -1).squeeze(axis=1) if function.dim == 1 else values
