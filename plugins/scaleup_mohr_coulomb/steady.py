"""The steady bed: from rest through the first avalanche to a mean over whole swings."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .level_set import LevelSet
from .parameters import SteadyOptions
from .start_up import StartUp
from .stepping import CarefulSteps
from .swings import Window

Progress = Callable[[float, str], None]

_CHECKS_PER_PERIOD = 4
# Natural periods that start-up and one swing usually take, for the progress only.
_START_UP_PERIODS = 2.0
_SWING_PERIODS = 1.5
_FEWEST_SWINGS = 2


class NotSteady(RuntimeError):  # noqa: N818
    """The time limit came before there was anything to average over."""


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
    """Times of all nominal steps, s."""
    angles: NDArray[Any]
    """Inclination of the free surface at ``times``, rad."""
    area_correction: float
    """Sum of |area restored| over the run, relative to the bed."""
    air_drained: float
    """Sum of the area of air below the surface that drained over the run, relative to the bed."""
    velocity_error: float
    """Standard error of the mean velocity, relative, see `SwingAverage.velocity_errors`."""
    velocity_drift: float
    """Relative change of the mean velocity per revolution within the averaging."""
    nonlocal_length: float
    """Non-local length of the friction law, m."""
    fine_size: float
    """Element size about the surface, m."""
    ill_posed_share: float
    """Share of the flowing layer where the friction law is ill-posed, at the end of the run."""
    steps: int
    """Time steps that led to the result."""
    retries: int
    """Times the flow diverged and was taken back."""
    most_halvings: int
    """Halvings of the nominal time step that the recovery needed at most."""
    seconds: float
    """Wall-clock time of the run."""
    began: NDArray[Any]
    """Friction angle (rad), logarithms of speed (rad/s) and fill (m^3) of the flow that it began
    with, (3,); NaN if it began at rest."""
    start_up: StartUp | None = None
    """The flow before the stretch averaged over, if asked for."""


def run_to_steady(steps: CarefulSteps, options: SteadyOptions, progress: Progress) -> SteadyBed:
    """Advance the flow until the means of surface angle and velocity are known to the tolerances.

    The state of the ``steps`` may be saved from within ``progress``, which is called several times
    per period.
    """
    flow, average = steps.flow, steps.average
    began, first_time = clock.perf_counter(), flow.time
    expected = average.period * (_START_UP_PERIODS + _SWING_PERIODS * options.minimum_swings)
    block_time = average.block * flow.discretisation.time_step
    check = max(1, round(average.period / (_CHECKS_PER_PERIOD * block_time)))
    window = average.window(options)
    velocity_errors = _velocity_errors(steps, window)
    last_time = flow.discretisation.start_angle / flow.drive.angular_velocity + options.time_limit
    while flow.time < last_time and not _known(window, velocity_errors[0], options):
        for _ in range(check):
            steps.block()
        window = average.window(options)
        velocity_errors = _velocity_errors(steps, window)
        fraction = min(0.99, (flow.time - first_time) / expected)
        progress(fraction, _message(steps, window))
    seconds = clock.perf_counter() - began
    converged = _known(window, velocity_errors[0], options)
    window = window or average.window(replace(options, minimum_swings=_FEWEST_SWINGS))
    if window is None:
        raise NotSteady(
            f"The bed had not swung {_FEWEST_SWINGS} times at the time limit of "
            f"{options.time_limit:.3g} s, after {flow.steps} steps: raise the time limit."
        )
    progress(1.0, _message(steps, window) + ("" if converged else ", time limit reached"))
    bed = _steady_bed(steps, window, converged, seconds)
    return replace(bed, start_up=_start_up(steps, window)) if options.start_up else bed


def _known(window: Window | None, velocity_error: float, options: SteadyOptions) -> bool:
    return (
        window is not None
        and window.angle_error <= options.angle_tolerance
        and velocity_error <= options.velocity_tolerance
    )


def _velocity_errors(steps: CarefulSteps, window: Window | None) -> tuple[float, float]:
    if window is None:
        return math.inf, math.inf
    return steps.average.velocity_errors(window, steps.flow)


def _message(steps: CarefulSteps, window: Window | None) -> str:
    angle = math.degrees(steps.average.angles[-1]) if steps.average.angles else math.nan
    now = f"t = {steps.flow.time:.2f} s, surface {angle:.1f} deg"
    if steps.recovery.retries:
        now += f", {steps.recovery.retries} retries"
    if window is None:
        return f"{now}, start-up"
    angle, error = math.degrees(window.angle), math.degrees(window.angle_error)
    kind = "swings" if window.swinging else "natural periods"
    return f"{now}, mean {angle:.2f} +- {error:.2f} deg over {window.parts} {kind}"


def _start_up(steps: CarefulSteps, window: Window) -> StartUp:
    flow, average = steps.flow, steps.average
    velocities, levels = np.split(average.means_before(window), [len(flow.velocity.vec)], axis=1)
    numerics = flow.discretisation
    block = average.block * numerics.time_step
    return StartUp(velocities, levels, block, numerics.start_angle)


def _steady_bed(steps: CarefulSteps, window: Window, converged: bool, seconds: float) -> SteadyBed:
    flow, average = steps.flow, steps.average
    means = average.mean_fields(window)
    velocity_error, velocity_drift = average.velocity_errors(window, flow)
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
        air_drained=flow.air_drained,
        velocity_error=velocity_error,
        velocity_drift=velocity_drift,
        nonlocal_length=flow.discretisation.nonlocal_length,
        fine_size=flow.discretisation.fine_size,
        ill_posed_share=flow.ill_posed_share(),
        steps=flow.steps,
        retries=steps.recovery.retries,
        most_halvings=steps.recovery.most_halvings,
        seconds=seconds,
        began=np.full(3, math.nan),
    )
