"""The blend curve of grains: samples of finite numbers, and what their finiteness adds.

The bed is cut into boxes (in a cross-section as deep as the slice), and those count that hold half
of what a box in the settled bed does. Sample i has N_i grains and a concentration c_i by volume.
Were grains drawn independently with a chance p_i, the weighted variance of the c_i about their
mean would exceed that of the p_i by sum w_i (1 - w_i) p_i (1 - p_i)/N_i, of which
sum w_i (1 - w_i) c_i (1 - c_i)/(N_i - 1) is the unbiased estimate: it is what is taken off (of
unlike grains N_i is (sum V)^2/sum V^2). Values are means over 3^dimension offsets of the boxes.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields

import numpy as np

from scaleup.contract import FloatArray, IntArray

_OFFSETS = 3
_LEAST_GRAINS = 2.0  # in a sample: one shows no variance


@dataclass(frozen=True)
class Mixedness:
    """Of one component at one time, dimensionless.

    raw       -- segregation intensity variance/(c (1 - c)) of the samples
    intensity -- the same without the noise of finite numbers; may fall below 0 by chance
    floor     -- what `raw` is of a random mixture
    rsd, raw_rsd -- standard deviation over mean, without and with that noise
    grains    -- in a sample, on the average
    volume    -- of grains in a sample, m^3
    samples   -- how many
    """

    raw: float
    intensity: float
    floor: float
    rsd: float
    raw_rsd: float
    grains: float
    volume: float
    samples: float


def measure(
    position: FloatArray,
    volume: FloatArray,
    component: FloatArray,
    lower: FloatArray,
    edge: float,
    least: float,
) -> Mixedness | None:
    """Mixedness of a component in boxes of an edge (m); None if no two samples count.

    position  -- (n, dimension), m
    volume    -- of the grains, m^3; component -- 1 for grains of the component, 0 for others
    lower     -- corner of the boxes' lattice, m
    least     -- volume of grains (m^3) from which a box counts
    """
    found = []
    for offset in itertools.product(range(_OFFSETS), repeat=position.shape[1]):
        corner = lower - edge * np.array(offset) / _OFFSETS
        box = np.floor((position - corner) / edge).astype(np.int64)
        _, place = np.unique(box, axis=0, return_inverse=True)
        one = _of_samples(place.reshape(-1), volume, component, least)
        if one is not None:
            found.append(one)
    if not found:
        return None
    means = {f.name: float(np.mean([getattr(m, f.name) for m in found])) for f in fields(Mixedness)}
    return Mixedness(**means)


def _of_samples(
    place: IntArray, volume: FloatArray, component: FloatArray, least: float
) -> Mixedness | None:
    held = np.bincount(place, weights=volume)
    number = held**2 / np.bincount(place, weights=volume**2)
    content = np.bincount(place, weights=volume * component)
    counts = (held >= least) & (number >= _LEAST_GRAINS - 1e-9)
    if counts.sum() < 2:
        return None
    held, number = held[counts], number[counts]
    concentration = content[counts] / held
    weight = held / held.sum()
    mean = float(weight @ concentration)
    variance = float(weight @ (concentration - mean) ** 2)
    true = variance - noise(weight, concentration, number)
    unmixed = mean * (1 - mean)
    if unmixed <= 0:
        return None
    return Mixedness(
        raw=variance / unmixed,
        intensity=true / unmixed,
        floor=float(weight @ ((1 - weight) / number)),
        rsd=float(np.sqrt(max(true, 0.0)) / mean),
        raw_rsd=float(np.sqrt(variance) / mean),
        grains=float(number.mean()),
        volume=float(held.mean()),
        samples=float(len(held)),
    )


def noise(weight: FloatArray, concentration: FloatArray, number: FloatArray) -> float:
    """Unbiased estimate of what drawing grains adds to the weighted variance of samples.

    weight -- sums to 1; number -- of grains in a sample, above 1
    """
    spread = concentration * (1 - concentration) / (number - 1)
    return float(weight @ ((1 - weight) * spread))
