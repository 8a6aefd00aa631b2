"""What a scene is made of: material, operation and the physics of diffusion."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from scaleup import units

GRAVITY = 9.8  # m/s^2, the paper's value; along -y


class Model(BaseModel):
    """Base of all configuration: frozen, and a misspelt key is an error."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True
    )


class Material(Model):
    """The powder. The defaults are the paper's Tables 1 and 2."""

    bulk_density: units.Density = 1500.0
    """kg/m^3, of the settled bed"""
    friction_angle: Annotated[units.Angle, Field(gt=0, lt=math.radians(60))] = math.radians(23.6)
    """rad"""
    friction_measured: Literal["shear-plane", "mohr-coulomb"] = "shear-plane"
    """what the angle means: tau = sigma tan(phi) on the shear plane, or tau_max = p sin(phi)"""
    cohesion: units.Pressure = 0.0
    """Pa"""
    wall_friction: Annotated[float, Field(ge=0, le=2)] = 0.324
    """coefficient of friction between bed and wall"""
    grain_diameter: units.Length = 1e-3
    """m"""
    grain_density: units.Density = 2500.0
    """kg/m^3"""

    @model_validator(mode="after")
    def _bed_is_lighter_than_grains(self) -> Self:
        if self.bulk_density >= self.grain_density:
            raise ValueError(
                f"bulk_density {self.bulk_density:g} kg/m^3 must be below grain_density "
                f"{self.grain_density:g} kg/m^3"
            )
        return self

    @property
    def solid_fraction(self) -> float:
        """Volume of grains per volume of bed."""
        return self.bulk_density / self.grain_density

    @property
    def friction(self) -> float:
        """Effective friction coefficient mu: tan(phi) or sin(phi), by `friction_measured`."""
        if self.friction_measured == "shear-plane":
            return math.tan(self.friction_angle)
        return math.sin(self.friction_angle)


Share = Annotated[float, Field(gt=0, lt=1)]


class Fill(Model):
    """How much powder, in exactly one of three ways."""

    depth_ratio: Share | None = None
    """greatest depth of the level bed over the height of the vessel at rest"""
    volume_fraction: Share | None = None
    """bed volume over vessel volume"""
    mass: units.Mass | None = None
    """kg"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [name for name, value in self if value is not None]
        if len(given) != 1:
            raise ValueError(
                f"give exactly one of depth_ratio, volume_fraction, mass; got {len(given)}"
            )
        return self


class Loading(Model):
    """How the components lie in the settled level bed before the vessel turns."""

    pattern: Literal["side-by-side", "top-bottom", "region"] = "side-by-side"
    """layers side by side or on top of each other, or a disc or ball in the rest"""
    shares: tuple[Share, ...] | None = None
    """volume shares of the components, from left to right or top to bottom; default halves"""
    centre: tuple[units.Coordinate, ...] | None = None
    """of the region, m (x, y or x, y, z)"""
    radius: units.Length | None = None
    """of the region, m"""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if self.pattern == "region" and (self.centre is None or self.radius is None):
            raise ValueError("the pattern 'region' needs centre and radius")
        if self.pattern != "region" and (self.centre is not None or self.radius is not None):
            raise ValueError(f"the pattern {self.pattern!r} takes no centre and no radius")
        if self.pattern == "region" and self.shares is not None:
            raise ValueError("the pattern 'region' takes no shares; its radius sets them")
        if len(self.layers) < 2 or abs(sum(self.layers) - 1.0) > 1e-9:
            raise ValueError("shares must be two or more numbers that sum to 1")
        return self

    @property
    def layers(self) -> tuple[float, ...]:
        """Volume shares of the layers."""
        return self.shares or (0.5, 0.5)

    @property
    def components(self) -> int:
        """Number of ingredients; a region has two, the one inside first."""
        return 2 if self.pattern == "region" else len(self.layers)


class Operation(Model):
    """How the vessel is filled and turned."""

    speed: units.AngularVelocity = 2 * math.pi * 6 / 60
    """rad/s, counter-clockwise about +z"""
    fill: Fill = Fill(depth_ratio=0.35)
    loading: Loading = Loading()
    revolutions: Annotated[float, Field(gt=0, le=10000)] = 3.0
    """how long to blend"""
    start: Literal["level-bed", "steady"] = "level-bed"
    """revolution 0: the settled level bed (lifted rigidly until it flows), or the steady flow"""

    @property
    def period(self) -> float:
        """Time of one revolution, s."""
        return 2 * math.pi / self.speed


class Diffusion(Model):
    """Shear-induced self-diffusion, shared by all mixing backends.

    k1 = 0.04 follows Fan et al. (spanwise, heap flow), k2 = 1.9 k1 Utter & Behringer, both as used
    in Liu, Gonzalez & Wassgren 2018; published k1 spans 0.04 to 0.25.
    """

    model: Literal["objective", "paper"] = "objective"
    """frame-independent tensor with D_xy, or Eq. 6 of the paper (2-D, lab frame)"""
    k1: Annotated[float, Field(ge=0, le=10)] = 0.04
    """diffusion across the flow over shear rate times grain diameter squared"""
    k2_ratio: Annotated[float, Field(ge=0, le=100)] = 1.9
    """diffusion along the flow over that across it"""
