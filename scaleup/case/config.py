"""The run configuration: what a complete run is told."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scaleup.scene import units
from scaleup.scene.grains import Particles
from scaleup.scene.models import Diffusion, Material, Model, Operation, SmallShare
from scaleup.system.registry import Kind

PLUGIN_SECTIONS: tuple[Kind, ...] = ("geometry", "flow", "mixing")


class GridChoice(Model):
    """How fine the mixing grid is, in one of two ways."""

    spacing: units.Length | None = None
    """m, edge of a cell"""
    cells: Annotated[float, Field(ge=100, le=1e9)] | None = None
    """wanted number of active cells (those that hold material)"""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.spacing is None) == (self.cells is None):
            raise ValueError("give exactly one of spacing, cells")
        return self


class Accuracy(Model):
    """What the error estimate is and what is asked of it."""

    tolerance: SmallShare = 0.02
    """wanted error of the segregation intensity"""
    estimate: bool = True
    """repeat the mixing on cells twice as large (an eighth of the cost) to see the change"""
    blended_rsd: SmallShare = 0.05
    """relative standard deviation below which the powder counts as blended"""
    scrutiny: Annotated[float, Field(ge=1, le=1000)] = 5.0
    """scale of scrutiny: edge of a sample, in grain diameters"""
    sample_mass: units.Mass | None = None
    """kg, of a sample, in place of scrutiny"""


class Output(Model):
    """What is kept."""

    metrics_every: Annotated[float, Field(ge=1e-3, le=1)] = 0.05
    """revolutions between points of the blend curve"""
    snapshots_every: Annotated[float, Field(ge=1e-3)] = 0.5
    """revolutions between stored concentration fields"""
    animate: Literal["no", "first", "last", "both"] = "no"
    """which revolution becomes an animation (GIF): 32 pictures of it are then stored, not 8"""
    checkpoint_every: units.Pause = 20.0
    """s of wall-clock time between checkpoints, at points of the blend curve"""


class RunConfig(Model):
    """A complete run. `geometry`, `flow` and `mixing` hold `name` and that plugin's options."""

    geometry: dict[str, Any]
    material: Material = Material()
    operation: Operation = Operation()
    flow: dict[str, Any]
    diffusion: Diffusion = Diffusion()
    mixing: dict[str, Any]
    grid: GridChoice
    accuracy: Accuracy = Accuracy()
    output: Output = Output()
    particles: Particles = Particles()
