"""What a particle (DEM) twin of a scene is made of: the table `[particles]`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from scaleup.scene import units
from scaleup.scene.models import Model

Friction = Annotated[float, Field(ge=0, le=5)]


class Particles(Model):
    """Grains of a particle twin (`scaleup particles`); the defaults are the paper's Table 1."""

    diameter: units.Length | None = None
    """m, mean; default material.grain_diameter"""
    spread: Annotated[units.Share, Field(ge=0, le=0.5)] = 0.05
    """of the diameters about their mean, uniform to both sides; equal grains would crystallise"""
    coarse: Annotated[float, Field(ge=1, le=100)] = 1.0
    """scale-up factor: grains are so many times larger than `diameter`"""
    density: units.Density | None = None
    """kg/m^3, of a grain; default material.grain_density"""
    shear_modulus: Annotated[units.Pressure, Field(ge=1e3)] = 1e7
    """Pa, of a grain"""
    soften: bool = True
    """lower the modulus as far as `overlap` allows: the time step grows as 1/sqrt(modulus)"""
    overlap: Annotated[units.Share, Field(ge=1e-4, le=0.1)] = 0.02
    """of the diameter: what grains may be pressed into each other when the modulus is lowered"""
    poisson_ratio: Annotated[float, Field(ge=0, le=0.49)] = 0.3
    """of a grain"""
    restitution: Annotated[float, Field(ge=0.05, le=1)] = 0.8
    """coefficient of restitution, between grains and at the wall"""
    friction: Friction = 0.4
    """coefficient of friction between grains"""
    wall_friction: Friction = 0.3
    """coefficient of friction between grain and wall"""
    rolling_friction: Friction = 0.01
    """torque against rolling over normal force and effective radius, at any speed"""
    time_step: Annotated[units.Share, Field(gt=0, le=0.4)] = 0.2
    """of the Rayleigh time of the smallest grain"""
    seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    """of diameters, places and velocities before settling"""
