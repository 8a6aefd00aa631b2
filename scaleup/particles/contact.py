"""Contacts of grains: how soft they may be, and the time step that they take.

Hertz: two like spheres of diameter d pressed by F overlap by delta = d (3 F/(2 E* d^2))^(2/3), with
E* = E/(2 (1 - nu^2)); those that meet at a speed v by delta = d (0.49 rho v^2/E*)^(2/5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scaleup.case.case import Case
from scaleup.contract import GRAVITY
from scaleup.scene.grains import Particles

_CHAIN = 4.0  # times the mean load: what the grains of force chains carry
_MEETING = 15 * math.pi / 96  # 0.49: (15/16) m*/(rho d^3) of two like spheres, m* = pi rho d^3/12


@dataclass(frozen=True)
class Contact:
    """The law of contact of a scene's grains, SI.

    diameter, spread, density -- of grains; uniform within diameter (1 +- spread)
    shear_modulus             -- as computed with, after softening
    time_step_limit           -- s
    """

    diameter: float
    spread: float
    density: float
    shear_modulus: float
    poisson_ratio: float
    restitution: float
    friction: float
    wall_friction: float
    rolling_friction: float
    time_step_limit: float

    @classmethod
    def of(cls, case: Case, particles: Particles) -> Contact:
        """The contact of the grains of a case."""
        diameter = (particles.diameter or case.material.grain_diameter) * particles.coarse
        density = particles.density or case.material.grain_density
        modulus = particles.shear_modulus
        if particles.soften:
            modulus = min(modulus, softest(case, particles, density, diameter))
        smallest = diameter * (1 - particles.spread)
        step = particles.time_step * rayleigh_time(
            smallest, density, modulus, particles.poisson_ratio
        )
        return cls(
            diameter=diameter,
            spread=particles.spread,
            density=density,
            shear_modulus=modulus,
            poisson_ratio=particles.poisson_ratio,
            restitution=particles.restitution,
            friction=particles.friction,
            wall_friction=particles.wall_friction,
            rolling_friction=particles.rolling_friction,
            time_step_limit=step,
        )

    @property
    def youngs_modulus(self) -> float:
        """Pa."""
        return 2 * (1 + self.poisson_ratio) * self.shear_modulus

    @property
    def largest(self) -> float:
        """Diameter of the largest grain, m."""
        return self.diameter * (1 + self.spread)

    @property
    def mean_mass(self) -> float:
        """Of a grain, kg: mean of rho pi d^3/6 over the uniform diameters."""
        return self.density * math.pi / 6 * self.diameter**3 * (1 + self.spread**2)


def softest(case: Case, particles: Particles, density: float, diameter: float) -> float:
    """The least shear modulus, Pa, at which grains overlap by `particles.overlap` at most.

    Of two loads: four times (force chains) the mean pressure at the bottom of the level bed under
    gravity and the rim's acceleration; and a collision of two grains at the rim's speed plus that
    of a fall by one diameter.
    """
    geometry, speed = case.geometry, case.operation.speed
    weight = case.material.bulk_density * (GRAVITY + speed**2 * geometry.reach) * case.bed.depth
    pressed = 1.5 * _CHAIN * weight / particles.overlap**1.5
    meeting = speed * geometry.reach + math.sqrt(2 * GRAVITY * diameter)
    struck = _MEETING * density * meeting**2 / particles.overlap**2.5
    # E* = E/(2 (1 - nu^2)) = G/(1 - nu)
    return float((1 - particles.poisson_ratio) * max(pressed, struck))


def rayleigh_time(
    diameter: float, density: float, shear_modulus: float, poisson_ratio: float
) -> float:
    """Time that a Rayleigh wave takes around half a grain, s: the scale of stable steps.

    >>> f"{rayleigh_time(2e-3, 2500.0, 1e6, 0.3):.3g}"
    '0.00017'
    """
    wave = 0.163 * poisson_ratio + 0.8766
    return math.pi * 0.5 * diameter * math.sqrt(density / shear_modulus) / wave
