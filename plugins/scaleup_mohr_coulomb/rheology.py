"""Friction laws, strength and effective viscosity of the powder.

A powder flows when the shear stress reaches its strength

    tau_y(g, p) = mu(I) P(p),          I = g d / sqrt(p / rho_s),
    P(p) = p + P0                      p >= 0,
    P(p) = P0 max(1 + p/T, 0)          p < 0 (tension),          P0 = c cos(phi) / mu_s,

with g = sqrt(2 E:E) the shear rate (1/s), p the pressure (Pa), I the inertial number, d and rho_s
the grains' diameter and density, mu_s the friction of slow flow, c the cohesion (Pa) and T the
tensile strength (Pa), beyond which powder is pulled apart and carries no shear stress.  Without
cohesion it never carries tension.  The default T = P0 continues the line of p >= 0 to its apex; a
smaller one cuts it off.  In coaxial, incompressible flow this is the fluid of viscosity tau_y / g.

In 3-D, with tau = sqrt(T:T/2) of the deviatoric stress T and p the mean pressure, tau = mu p is a
Drucker-Prager cone.  It is matched to Mohr-Coulomb in plane strain without dilation, where the
intermediate stress is the mean one and mu = sin(phi) is exact.  Mohr-Coulomb would have
2 sqrt(3) sin(phi)/(3 -+ sin(phi)) in place of mu in triaxial compression and extension: a third and
a fiftieth more at 23.6 deg.

The expressions take and return NGSolve coefficient functions (or numbers).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import ngsolve as ngs
from scipy.optimize import brentq

from scaleup.contract import Material

from .parameters import Rheology

# Pressure (Pa) that keeps the inertial number finite where there is none: nothing beside a grain's.
_LEAST_PRESSURE = 1.0e-6
_LEAST_TENSION = 1.0e-9


class FrictionLaw(Protocol):
    """The ratio mu of shear stress to pressure in flowing powder, by the inertial number I."""

    def coefficient(self, inertial_number: Any) -> Any:
        """mu(I), 1."""
        ...

    def exponent(self, inertial_number: Any) -> Any:
        """N = (I/mu) dmu/dI, 1."""
        ...


@dataclass(frozen=True)
class Friction:
    """Constant friction: the Mohr-Coulomb powder of the source paper."""

    mu: float

    def coefficient(self, inertial_number: Any) -> Any:
        """The constant mu."""
        return ngs.CoefficientFunction(self.mu)

    def exponent(self, inertial_number: Any) -> Any:
        """0."""
        return ngs.CoefficientFunction(0.0)


@dataclass(frozen=True)
class InertialFriction:
    """mu(I) = (mu_s I0 + mu_d I + mu_inf I^2)/(I0 + I), after Jop, Forterre & Pouliquen (2006).

    Their law has mu_inf = 0; Holyoake & McElwaine (2012) and Barker & Gray (2017) let the friction
    of fast flow rise.
    """

    mu_s: float
    mu_d: float
    i_0: float
    mu_inf: float = 0.0

    def coefficient(self, inertial_number: Any) -> Any:
        """mu(I)."""
        i = inertial_number
        return (self.mu_s * self.i_0 + self.mu_d * i + self.mu_inf * i * i) / (self.i_0 + i)

    def exponent(self, inertial_number: Any) -> Any:
        """n(I)."""
        i = inertial_number
        rise = self.mu_d + 2.0 * self.mu_inf * i - self.coefficient(i)
        return i * rise / (self.mu_s * self.i_0 + self.mu_d * i + self.mu_inf * i * i)


@dataclass(frozen=True)
class RegularisedFriction:
    """Partially regularised mu(I) of Barker & Gray (2017), J. Fluid Mech. 828, 5-32.

    Below I1, where :class:`InertialFriction` becomes ill-posed, mu = sqrt(alpha / ln(A/I)) is as
    close to it as well-posedness allows (alpha < 2); A makes mu continuous.  mu(0) = 0: such powder
    creeps below its friction angle.  mu_inf > 0 keeps fast flow well-posed, up to I of about 17.
    """

    above: InertialFriction
    alpha: float

    @cached_property
    def i_1(self) -> float:
        """The least I at which the unregularised law is well-posed, 1."""
        law = self.above

        def measure(logarithm: float) -> float:
            i = math.exp(logarithm)
            return float(ill_posedness(law.coefficient(i), law.exponent(i)))

        return math.exp(brentq(measure, math.log(1e-9 * law.i_0), math.log(law.i_0), xtol=1e-12))

    @cached_property
    def a(self) -> float:
        """A = I1 exp(alpha / mu(I1)^2), 1."""
        return self.i_1 * math.exp(self.alpha / self.above.coefficient(self.i_1) ** 2)

    def _logarithm(self, inertial_number: Any) -> Any:
        """ln(A/I) of I no more than I1."""
        low = ngs.IfPos(inertial_number - self.i_1, self.i_1, inertial_number)
        return ngs.log(self.a / (low + 1.0e-12 * self.i_1))

    def coefficient(self, inertial_number: Any) -> Any:
        """mu(I)."""
        below = ngs.sqrt(self.alpha / self._logarithm(inertial_number))
        return ngs.IfPos(inertial_number - self.i_1, self.above.coefficient(inertial_number), below)

    def exponent(self, inertial_number: Any) -> Any:
        """n(I), which is 1/(2 ln(A/I)) below I1."""
        below = 0.5 / self._logarithm(inertial_number)
        return ngs.IfPos(inertial_number - self.i_1, self.above.exponent(inertial_number), below)


def ill_posedness(mu: Any, exponent: Any) -> Any:
    """C = 4 n^2 - 4 n + mu^2 (1 - n/2)^2 of incompressible mu(I) flow: ill-posed where C > 0.

    Barker & Gray (2017), eq. 2.16 f. after Barker, Schaeffer, Bohorquez & Gray (2015).  Constant
    friction has n = 0 and C = mu^2: ill-posed everywhere.
    """
    n = exponent
    return 4.0 * n * n - 4.0 * n + mu * mu * (1.0 - 0.5 * n) * (1.0 - 0.5 * n)


def friction_law(mu_s: float, rheology: Rheology) -> FrictionLaw:
    """The law of a rheology for powder whose friction in slow flow is mu_s."""
    if rheology.law == "mohr-coulomb":
        return Friction(mu_s)
    law = InertialFriction(mu_s, mu_s + rheology.friction_rise, rheology.i_0, rheology.mu_inf)
    return law if rheology.law == "mu-i" else RegularisedFriction(law, rheology.alpha)


@dataclass(frozen=True)
class Strength:
    """Shear stress tau_y at which the powder flows, Pa."""

    friction: FrictionLaw
    mu_s: float
    """Friction of slow flow, 1."""
    apex: float
    """P0 = c cos(phi)/mu_s: the pressure that cohesion is worth, Pa."""
    tensile: float
    """Tension T at which powder is pulled apart, Pa."""
    grain_diameter: float
    """m."""
    grain_density: float
    """kg/m^3."""

    @classmethod
    def of(cls, material: Material, rheology: Rheology) -> Strength:
        """The strength of a powder."""
        apex = material.cohesion * math.cos(material.friction_angle) / material.friction
        return cls(
            friction=friction_law(material.friction, rheology),
            mu_s=material.friction,
            apex=apex,
            tensile=apex if rheology.tensile is None else min(rheology.tensile, apex),
            grain_diameter=material.grain_diameter,
            grain_density=material.grain_density,
        )

    def inertial_number(self, shear_rate: Any, pressure: Any) -> Any:
        """I = g d / sqrt(p/rho_s), 1."""
        compression = ngs.IfPos(pressure, pressure, 0.0) + _LEAST_PRESSURE
        return shear_rate * self.grain_diameter / ngs.sqrt(compression / self.grain_density)

    def coefficient(self, shear_rate: Any, pressure: Any) -> Any:
        """mu(I), 1."""
        return self.friction.coefficient(self.inertial_number(shear_rate, pressure))

    def support(self, pressure: Any) -> Any:
        """The pressure P(p) that friction acts on, Pa."""
        compression = ngs.IfPos(pressure, pressure, 0.0)
        if not self.apex:
            return compression
        left = 1.0 + (pressure - compression) / max(self.tensile, _LEAST_TENSION)
        return compression + self.apex * ngs.IfPos(left, left, 0.0)

    def __call__(self, shear_rate: Any, pressure: Any) -> Any:
        """tau_y(g, p), Pa."""
        return self.coefficient(shear_rate, pressure) * self.support(pressure)

    def ill_posed(self, shear_rate: Any, pressure: Any) -> Any:
        """1 where the local law is ill-posed, 0 elsewhere; length and creep do not count."""
        i = self.inertial_number(shear_rate, pressure)
        measure = ill_posedness(self.friction.coefficient(i), self.friction.exponent(i))
        return ngs.IfPos(measure, 1.0, 0.0)


def effective_viscosity(strength: Any, shear_rate: Any, creep_rate: float) -> Any:
    """Regularised viscosity tau_y / sqrt(g^2 + eps^2), Pa s.

    Powder below yield creeps at less than the ``creep_rate`` eps (1/s) instead of resting.
    """
    return strength / ngs.sqrt(shear_rate**2 + creep_rate**2)


def predicted_shear_rate(
    shear_rate: Any,
    stress: Any,
    strength: Any,
    acceleration: Any,
    threshold: Any,
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
