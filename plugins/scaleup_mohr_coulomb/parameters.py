"""Inputs of the finite-element flow: what the powder is, what the vessel does, how it is solved.

All quantities are in SI units, angles in radians.  Every numerical parameter follows a rule
stated beside it; none was fitted to a particle simulation or to an experiment.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal

from scaleup.contract import GRAVITY, Material

# Of glass beads (Henann & Kamrin 2013).
_NONLOCAL_AMPLITUDE = 0.48


@dataclass(frozen=True)
class Drive:
    """How the bed is driven: counter-clockwise about z through the origin, gravity along -y."""

    bed_area: float
    """Area of powder in the cross-section, m^2."""
    angular_velocity: float
    """Angular velocity omega of the vessel, rad/s, positive."""
    gravity: float = GRAVITY
    """Gravitational acceleration g, m/s^2."""


@dataclass(frozen=True)
class Rheology:
    """How friction depends on the inertial number, beyond what a `Material` says."""

    law: Literal["mohr-coulomb", "mu-i", "regularised-mu-i"] = "mohr-coulomb"
    friction_rise: float = 0.0
    """mu_d - mu_s, 1."""
    i_0: float = 1.0
    """Inertial number I0 at which half of the rise is reached, 1."""
    mu_inf: float = 0.0
    """Slope of the friction of fast flow, 1."""
    alpha: float = 1.9
    """Of the regularised law's creep, 1; well-posed below 2."""
    tensile: float | None = None
    """Tension at which powder is pulled apart, Pa; None for the apex of the strength's line."""

    @classmethod
    def by_literature(
        cls,
        law: Literal["mohr-coulomb", "mu-i", "regularised-mu-i"] = "mohr-coulomb",
        friction_rise: float | None = None,
        i_0: float | None = None,
        tensile: float | None = None,
    ) -> Rheology:
        """Published constants, except where given; mu_s always comes from the friction angle.

        mu-i: glass beads, mu_2 - mu_s = tan 32.76 deg - tan 20.9 deg, I0 = 0.279 (Jop, Forterre &
        Pouliquen 2006, Nature 441, 727).  regularised-mu-i: mu_d - mu_s = 0.557 - 0.342, I0 =
        0.069, mu_inf = 0.05, alpha = 1.9 (Barker & Gray 2017).
        """
        rise, scale, mu_inf = {
            "mohr-coulomb": (0.0, 1.0, 0.0),
            "mu-i": (0.261, 0.279, 0.0),
            "regularised-mu-i": (0.215, 0.069, 0.05),
        }[law]
        return cls(
            law=law,
            friction_rise=rise if friction_rise is None else friction_rise,
            i_0=i_0 or scale,
            mu_inf=mu_inf,
            tensile=tensile,
        )


@dataclass(frozen=True)
class Discretisation:
    """Numerical parameters in SI units; :meth:`by_rule` supplies the defaults of the method."""

    coarse_size: float
    """Element size in the passive region and in the air, m.  Rule: R/9."""
    fine_size: float
    """Element size h in the band about the free surface, m.  Rule: 4 l, at most R/24,
    so that an active layer of R/5 is five quadratic elements deep, and at least R/27."""
    band_depth: float
    """Depth of the refined band below the surface, m.  Rule: R/5, that of a drum's active layer."""
    band_height: float
    """Height of the refined band above the surface, m.  Rule: R/10, where an avalanche's surface
    is that lies 6 deg steeper than the band."""
    band_angle: float
    """Inclination of the refined band, rad.  Rule: the friction angle."""
    start_angle: float
    """Inclination of the bed at time 0, rad.  Rule: 3/4 of the friction angle.  A level bed turns
    rigidly with the vessel until it yields, so that starting nearer to yield only saves time."""
    time_step: float
    """Time step dt, s.  Rule: sqrt(R/g)/10, as the bed's swings last about 9 sqrt(R/g), and at most
    1/(150 omega), a fifth over the greatest shear rate of a rolling layer, some 30 omega."""
    nonlocal_length: float
    """Non-local length l of the shear rate, m.  Rule: A d/sqrt(mu_s), or R/108 if that is more.

    A = 0.48 is the non-local amplitude of glass beads (Henann & Kamrin 2013, PNAS 110, 6730, by
    shear in other geometries).  That is physical, and taken where elements of R/27 resolve it.
    R/108 is numerical: a quarter of those elements, for grains below R/75.  Neither follows the
    mesh, so that refinement converges to the flow of one l; a mesh of h > 4 l no longer sees it."""
    predictor_length: float
    """Length l over which stress beyond yield accelerates powder in the predictor of the shear
    rate, m.  Rule: R/10, half an active layer.  It shapes the first avalanche; 0.7 and 1.4 times
    of it leave the mean flow as it is.  A third overcorrects: stress swings from step to step, and
    the mean layer thickens."""
    predictor_threshold: float
    """Relative excess of stress over strength below which the predictor stays off, 1.  Rule:
    dt / sqrt(R/g).  The lagged viscosity by itself lets the shear rate grow by this ratio in each
    step, that is by e within the free-fall time sqrt(R/g); only faster yielding needs prediction.
    A predictor that also answers to slow swings rectifies them into creep: without a threshold the
    drum's mean flux loses another 7 %, with 0.4 to 2 times this one it changes by 0.5 %."""
    creep_rate: float
    """Shear rate eps below which unyielded powder creeps viscously, 1/s.  Rule: 2 % of omega,
    which bounds the error of the passive region's rotation by about as much."""
    slip_speed: float
    """Speed v_e that regularises Coulomb friction at the wall, m/s.  Rule: 1 % of omega R."""
    interface_half_width: float
    """Half width W of the smoothed powder-air interface, m.  Rule: h/2, the distance of the
    level set's nodes.  An interface of h blurs the surface: a drum's is then 47 % faster than
    what refinement converges to, and columns run up to a quarter farther."""
    air_density: float
    """Density of the light phase, kg/m^3.  Rule: 1/500 of the powder's."""
    air_viscosity: float
    """Viscosity of the light phase and lower bound of the powder's, Pa s.  Rule: 2.5e-5 rho
    sqrt(g R^3); with a tenth of it a drum's layer is 1 % thinner and its surface 2 % faster, with
    ten times 9 % thicker and 20 % slower: air then drags on the surface with 0.4 Pa."""
    grad_div: float
    """Factor of the grad-div term, Pa s.  Rule: 0.035 rho sqrt(g R^3), about the viscosity of the
    flowing layer.  It acts on the error of div u = 0 only; thrice as much changes nothing."""
    redistance_every: int = 5
    """Steps between two redistancings of the level set."""

    @classmethod
    def by_rule(
        cls,
        material: Material,
        drive: Drive,
        radius: float,
        fine_size: float | None = None,
        coarse_size: float | None = None,
        time_step: float | None = None,
        nonlocal_length: float | None = None,
        predictor_length: float | None = None,
    ) -> Discretisation:
        """The defaults for a vessel whose farthest wall is ``radius`` (m) from the axis.

        Lengths scale with R, times with sqrt(R/g) and viscosities with rho sqrt(g R^3), so that
        vessels of equal Froude number and equal R/d are solved alike. A size or step that is given
        replaces its own rule; the rules that build on it follow.
        """
        omega, gravity = drive.angular_velocity, drive.gravity
        density = material.bulk_density
        viscosity_scale = density * math.sqrt(gravity * radius**3)
        fall_time = math.sqrt(radius / gravity)
        time_step = time_step or min(fall_time / 10.0, 1.0 / (150.0 * omega))
        nonlocal_length = nonlocal_length or max(grain_nonlocal_length(material), radius / 108.0)
        fine_size = fine_size or min(radius / 24.0, max(4.0 * nonlocal_length, radius / 27.0))
        return cls(
            coarse_size=max(fine_size, coarse_size or radius / 9.0),
            fine_size=fine_size,
            band_depth=radius / 5.0,
            band_height=radius / 10.0,
            band_angle=material.friction_angle,
            start_angle=0.75 * material.friction_angle,
            time_step=time_step,
            nonlocal_length=nonlocal_length,
            predictor_length=predictor_length or radius / 10.0,
            predictor_threshold=time_step / fall_time,
            creep_rate=0.02 * omega,
            slip_speed=0.01 * omega * radius,
            interface_half_width=0.5 * fine_size,
            air_density=density / 500.0,
            air_viscosity=2.5e-5 * viscosity_scale,
            grad_div=0.035 * viscosity_scale,
        )

    def in_space(self) -> Discretisation:
        """What differs on the meshes of space, which are far from resolving grains.

        A non-local length of at least h/4: numerical, and shrinking with the mesh.
        """
        return dataclasses.replace(
            self, nonlocal_length=max(self.nonlocal_length, self.fine_size / 4.0)
        )


def grain_nonlocal_length(material: Material) -> float:
    """Length over which flowing grains loosen their neighbours, A d/sqrt(mu_s), m."""
    return _NONLOCAL_AMPLITUDE * material.grain_diameter / math.sqrt(material.friction)


@dataclass(frozen=True)
class SteadyOptions:
    """When a bed counts as steady, and when to give up."""

    angle_tolerance: float = math.radians(0.25)
    """Standard error of the mean surface angle at which the run stops, rad."""
    velocity_tolerance: float = 0.02
    """Standard error of the mean velocity at which the run stops, relative."""
    minimum_swings: int = 4
    """Swings of the bed averaged over, at least."""
    settled_amplitude: float = math.radians(0.1)
    """Amplitude below which the bed no longer swings, rad."""
    settled_periods: int = 3
    """Natural periods of the bed averaged over, at least, once it no longer swings."""
    time_limit: float = math.inf
    """Time of flow after which the run stops anyway, s.  Rule: 140 sqrt(R/g), about 16 swings."""
    start_up: bool = False
    """Whether the means before the stretch averaged over are wanted too."""
