"""What a scene is made of: material, operation and the physics of diffusion."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FilePath, field_validator, model_validator

from scaleup.scene import units

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
    grain_diameter: Annotated[units.Length, Field(ge=1e-7)] = 1e-3
    """m"""
    grain_density: units.Density = 2500.0
    """kg/m^3"""
    provenance: dict[str, Annotated[str, Field(max_length=1000)]] | None = None
    """where the values come from, a text for each key, as `scaleup material fit` writes them; kept
    with the run and in its report, without a part in what is computed"""

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


SmallShare = Annotated[units.Share, Field(gt=0, lt=1)]


class Fill(Model):
    """How much powder, in exactly one of three ways."""

    depth_ratio: SmallShare | None = None
    """greatest depth of the level bed over the height of the vessel at rest"""
    volume_fraction: SmallShare | None = None
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


Pattern = Literal["side-by-side", "front-back", "top-bottom", "layered", "region", "file"]
Direction = Literal["x", "y", "z"]
_LAYERS: dict[str, Direction] = {"side-by-side": "x", "front-back": "z", "top-bottom": "y"}


class Loading(Model):
    """How the components lie in the settled level bed before the vessel turns.

    The vessel is seen along its axis of rotation: x to the right, y up, z (the axis) towards the
    viewer. Layers are counted from left to right, from front to back (from one end of the axis to
    the other) and from top to bottom.
    """

    pattern: Pattern = "side-by-side"
    """"side-by-side" along x, "front-back" along z (the axis: what is called left-right of a
    V-blender), "top-bottom" along y: one component a layer; "layered": components in any order;
    "region": a disc or ball of one component in the rest; "file": as measured or computed"""
    shares: tuple[SmallShare, ...] | None = None
    """of the bed's volume, layer by layer; default halves, for "layered" thirds"""
    along: Direction | None = None
    """for "layered": the direction across the layers; default "y" (on top of each other)"""
    order: tuple[Annotated[int, Field(ge=1, le=20)], ...] | None = None
    """for "layered": the number of each layer's component; default 1, 2, 1, 2, ..."""
    centre: tuple[units.Coordinate, ...] | None = None
    """of the region, m (x, y or x, y, z), from the axis of rotation"""
    radius: units.Length | None = None
    """of the region, m"""
    file: FilePath | None = None
    """for "file": CSV with columns x, y, z (m, from the axis, in the vessel at rest) and one for
    each component's concentration; a results.h5 (its last state); or what meshio reads, with
    fields named concentration_1, ... Each cell takes the nearest point's"""

    @field_validator("file")
    @classmethod
    def _found_from_anywhere(cls, file: Path | None) -> Path | None:
        return None if file is None else file.resolve()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        kinds = {
            "layered": ("along", "order"),
            "region": ("centre", "radius"),
            "file": ("file",),
        }
        for kind, keys in kinds.items():
            given = [key for key in keys if getattr(self, key) is not None]
            if self.pattern != kind and given:
                raise ValueError(f"the pattern {self.pattern!r} takes no {' and no '.join(keys)}")
            if self.pattern == kind != "layered" and len(given) < len(keys):
                raise ValueError(f"the pattern {kind!r} needs {' and '.join(keys)}")
        if self.pattern in ("region", "file") and self.shares is not None:
            raise ValueError(f"the pattern {self.pattern!r} takes no shares; it sets them itself")
        if len(self.layers) < 2 or abs(sum(self.layers) - 1.0) > 1e-9:
            raise ValueError("shares must be two or more numbers that sum to 1")
        numbers = set(self.layer_components)
        if len(self.layer_components) != len(self.layers) or numbers != set(
            range(1, max(numbers) + 1)
        ):
            raise ValueError(
                f"order must hold one number for each of the {len(self.layers)} shares, and every "
                "number from 1 to the greatest"
            )
        return self

    @property
    def direction(self) -> Direction | None:
        """Across the layers, if the pattern has any."""
        return self.along or "y" if self.pattern == "layered" else _LAYERS.get(self.pattern)

    @property
    def layers(self) -> tuple[float, ...]:
        """Volume shares of the layers."""
        count = 2 if self.pattern != "layered" else len(self.order or (1, 2, 1))
        return self.shares or (1 / count,) * count

    @property
    def layer_components(self) -> tuple[int, ...]:
        """Number of each layer's component, from 1."""
        if self.pattern == "layered":
            return self.order or tuple(1 + k % 2 for k in range(len(self.layers)))
        return tuple(range(1, len(self.layers) + 1))


_REVERSALS = ("reversal", "reversals", "reverse", "reverse_every", "reverse_after", "direction")


class Operation(Model):
    """How the vessel is filled and turned."""

    speed: units.AngularVelocity = 2 * math.pi * 6 / 60
    """rad/s, counter-clockwise about +z"""
    fill: Fill = Fill(depth_ratio=0.35)
    loading: Loading = Loading()
    revolutions: Annotated[float, Field(ge=1e-3, le=10000)] = 3.0
    """how long to blend"""
    start: Literal["level-bed", "steady"] = "level-bed"
    """revolution 0: the settled level bed (lifted rigidly until it flows), or the steady flow"""

    @model_validator(mode="before")
    @classmethod
    def _turns_one_way(cls, data: Any) -> Any:
        reversals = [key for key in data if key in _REVERSALS] if isinstance(data, dict) else []
        if reversals:
            raise ValueError(
                f"{reversals[0]} is not supported: the vessel turns one way, counter-clockwise, at "
                "one speed"
            )
        return data

    @field_validator("speed", mode="before")
    @classmethod
    def _turns_counter_clockwise(cls, speed: Any) -> Any:
        if isinstance(speed, int | float | str) and units.to_si(speed, "rad/s") < 0:
            raise ValueError(
                "the vessel turns counter-clockwise; for the other way mirror the loading, left "
                "for right, and give the speed without its sign"
            )
        return speed

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
    after: Annotated[float, Field(ge=0)] = 0.0
    """revolutions of advection alone, before diffusion sets in (the paper's mixing: 0.25)"""
