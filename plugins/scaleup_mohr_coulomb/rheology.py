"""Friction law and effective viscosity of the powder.

A powder flows when the shear stress reaches its strength

    tau_y(g, p) = mu(g, p) max(p, 0) + c cos(phi),

with g = sqrt(2 E:E) the shear rate (1/s), p the pressure (Pa) and c the cohesion (Pa).  Tension
is cut off: powder pulled apart keeps its cohesion only.  In coaxial, incompressible flow this is
the fluid of viscosity tau_y / g.

The expressions take and return NGSolve coefficient functions (or numbers).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import ngsolve as ngs

from scaleup.api import Material


class FrictionLaw(Protocol):
    """The ratio mu(g, p) of shear stress to pressure in flowing powder."""

    def coefficient(self, shear_rate: Any, pressure: Any) -> Any:
        """mu, 1, for the shear rate (1/s) and the non-negative pressure (Pa)."""
        ...


@dataclass(frozen=True)
class Friction:
    """Constant friction: the Mohr-Coulomb powder of the source paper."""

    mu: float

    def coefficient(self, shear_rate: Any, pressure: Any) -> Any:
        """The constant mu, whatever the shear rate and the pressure."""
        return ngs.CoefficientFunction(self.mu)


@dataclass(frozen=True)
class Strength:
    """Shear stress tau_y at which the powder flows, Pa."""

    friction: FrictionLaw
    cohesive: float
    """The part c cos(phi) that needs no pressure, Pa."""

    @classmethod
    def of(cls, material: Material) -> Strength:
        """The strength of a powder of constant friction."""
        cohesive = material.cohesion * math.cos(material.friction_angle)
        return cls(Friction(material.friction), cohesive)

    def __call__(self, shear_rate: Any, pressure: Any) -> Any:
        """tau_y(g, p), with the tension cut off."""
        compression = ngs.IfPos(pressure, pressure, 0.0)
        return self.friction.coefficient(shear_rate, compression) * compression + self.cohesive


def effective_viscosity(strength: Any, shear_rate: Any, creep_rate: float) -> Any:
    """Regularised viscosity tau_y / sqrt(g^2 + eps^2), Pa s.

    Powder below yield creeps at less than the ``creep_rate`` eps (1/s) instead of resting.
    """
    return strength / ngs.sqrt(shear_rate**2 + creep_rate**2)


def predicted_shear_rate(
    shear_rate: Any,
    stress: Any,
    strength: Any,
    acceleration: float,
    threshold: float,
) -> Any:
    """Shear rate (1/s) that the next step is expected to have.

    The viscosity of a step is taken from the step before; powder that has just come to yield
    would therefore soften by the ratio stress/strength only in each step, and yield late.  Where
    the ``stress`` carried exceeds the ``strength`` (Pa), the excess accelerates the powder, and

        g + dt / (rho l^2) max(stress - (1 + threshold) strength, 0)

    is the shear rate at the end of the step, with ``acceleration`` = dt/(rho l^2), 1/(Pa s).  In
    steady flow the excess vanishes, and so does the correction; the ``threshold`` keeps it off in
    slow changes, see :attr:`parameters.Discretisation.predictor_threshold`.
    """
    excess = stress - (1.0 + threshold) * strength
    return shear_rate + acceleration * ngs.IfPos(excess, excess, 0.0)
