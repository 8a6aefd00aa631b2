"""Means over whole swings of the bed, and their scatter as the error estimate.

After the avalanche the bed swings about its mean inclination, as particles do, for many periods.
A mean cut in mid-swing would hold a flow that is still moving the bed from one side to the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import ngsolve as ngs
import numpy as np
from numpy.typing import NDArray

from .level_set import LevelSet
from .parameters import SteadyOptions
from .two_phase import TwoPhaseFlow

# The angle is fitted within this part of the vessel's radius, clear of the curved ends.
FIT_REACH = 0.48
_AVALANCHE_DROP = math.radians(0.5)
# Hysteresis of a crossing of the mean angle, in settled amplitudes.
_CROSSING_BAND = 0.25
_BLOCKS_PER_PERIOD = 20
# Natural periods that a bed takes to forget the flow that it began with.
_FORGETS = 2.0


@dataclass(frozen=True)
class Window:
    """Stretch of a run that is averaged over, as sample numbers, and what its mean is worth."""

    edges: tuple[int, ...]
    """Where the parts begin and the last one ends. Parts are whole swings, or natural periods of a
    bed that no longer swings."""
    swinging: bool
    angle: float
    """Mean inclination of the surface, rad."""
    angle_error: float
    """Standard error of ``angle``, rad: scatter of the parts' means over sqrt(parts)."""

    @property
    def first(self) -> int:
        """First sample."""
        return self.edges[0]

    @property
    def last(self) -> int:
        """Sample after the last."""
        return self.edges[-1]

    @property
    def parts(self) -> int:
        """Number of swings or periods."""
        return len(self.edges) - 1


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

    def __init__(self, flow: TwoPhaseFlow, flowing: bool = False) -> None:
        """``flowing``: the bed flows from the first, so that no avalanche ends its start-up."""
        self.flowing = flowing
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
        self.angles.append(flow.level_set.surface_fit(FIT_REACH * flow.radius)[0])

    def forget_after(self, samples: int) -> None:
        """Drop all but the first ``samples``, a whole number of blocks."""
        del self.times[samples:], self.angles[samples:], self._sums[samples // self.block :]

    def _part_means(self, window: Window) -> NDArray[Any]:
        """Mean coefficients (parts, n) of velocity and level set, in whole blocks."""
        whole = len(self.times) // self.block  # the block under way is left out
        edges = [min(round(edge / self.block), whole) for edge in window.edges]
        return np.array(
            [np.mean(self._sums[a:b], axis=0) / self.block for a, b in pairwise(edges) if b > a]
        )

    def mean_fields(self, window: Window) -> NDArray[Any]:
        """Mean of velocity and level-set coefficients, the window rounded to whole blocks."""
        whole = len(self.times) // self.block
        first, last = round(window.first / self.block), round(window.last / self.block)
        last = min(last, whole)
        mean: NDArray[Any] = np.sum(self._sums[first:last], axis=0)
        mean /= (last - first) * self.block
        return mean

    def means_before(self, window: Window) -> NDArray[Any]:
        """Mean coefficients (blocks, n) of velocity and level set in each block before a window."""
        return np.array(self._sums[: round(window.first / self.block)]) / self.block

    def velocity_errors(self, window: Window, flow: TwoPhaseFlow) -> tuple[float, float]:
        """Standard error of the mean velocity, and its drift per revolution; both relative.

        In the norm |u|^2 = integral of alpha u.u over the powder: the scatter of the parts' mean
        velocities over sqrt(parts), and the change from the first half of the parts to the second
        over the revolutions from one half's middle to the other's.
        """
        velocities = self._part_means(window)[:, : len(flow.velocity.vec)]
        norm = flow.powder_norm
        parts, mean = len(velocities), velocities.mean(axis=0)
        scatter = math.sqrt(sum(norm(part - mean) ** 2 for part in velocities) / (parts - 1))
        half = parts // 2
        change = norm(velocities[-half:].mean(axis=0) - velocities[:half].mean(axis=0))
        span = self.times[window.last - 1] - self.times[window.first]
        turned = flow.drive.angular_velocity * span * (1.0 - half / parts) / (2.0 * math.pi)
        return scatter / math.sqrt(parts) / norm(mean), change / norm(mean) / turned

    def state(self) -> dict[str, NDArray[Any]]:
        """All that :meth:`restore` needs."""
        return {
            "times": np.array(self.times),
            "angles": np.array(self.angles),
            "sums": np.array(self._sums),
            "begun": np.array([self.flowing, self.period, self.block]),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Take up the record of a run that was broken off."""
        self.times, self.angles = state["times"].tolist(), state["angles"].tolist()
        self._sums = [row.copy() for row in state["sums"]]
        flowing, self.period, block = state["begun"].tolist()
        self.flowing, self.block = bool(flowing), int(block)

    def window(self, options: SteadyOptions) -> Window | None:
        """The stretch to average over, or None while the bed is still starting up.

        1. The start-up ends with the first avalanche, that of a bed that flows from the first after
        two natural periods.  2. If the angle has kept within the settled
        amplitude for enough natural periods, these are the parts.  3. Otherwise the parts are the
        whole swings since, between upward crossings of the mean angle; as many leading swings are
        left out as makes the standard error least (the marginal standard error rule), down to the
        fewest allowed, and to as many natural periods as a bed that has settled needs: ripples are
        quicker than swings, and their means no independent ones.
        """
        times, angles = np.array(self.times), np.array(self.angles)
        if self.flowing:
            after = np.flatnonzero(times > times[:1] + _FORGETS * self.period)
            start = int(after[0]) if len(after) else None
        else:
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
            if edges[-1] - edges[skipped] >= options.settled_periods * per_period
        ]
        return min(candidates, key=lambda window: window.angle_error, default=None)


def _window(angles: NDArray[Any], edges: NDArray[Any], swinging: bool) -> Window:
    means = np.array([angles[a:b].mean() for a, b in pairwise(edges)])
    return Window(
        edges=tuple(int(edge) for edge in edges),
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
    """Samples after ``start`` where the angle rises through its mean of the later half since then.

    A crossing counts once the angle has been ``band`` (rad) below and is ``band`` above the mean;
    the earlier half's would count no more swings of a bed whose first were large and one-sided.
    """
    deviation = angles[start:] - angles[(start + len(angles)) // 2 :].mean()
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
