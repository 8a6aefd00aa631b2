"""The case: a configuration resolved once into what all below it takes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import tomli_w

from scaleup.case.config import PLUGIN_SECTIONS, Accuracy, Output, RunConfig
from scaleup.case.validating import validated_options
from scaleup.case.vessel_shape import Bed, level_height
from scaleup.contract import Flow, Geometry, Grid, Law, Material, Mixing, Scene
from scaleup.scene.grains import Particles
from scaleup.scene.models import Diffusion, Operation
from scaleup.scene.shear_diffusion import shear_diffusion
from scaleup.space.grid import grid_over
from scaleup.system import registry
from scaleup.system.blame import blamed_on
from scaleup.system.errors import ContractError, InputError, shown
from scaleup.system.registry import Kind


class Case:
    """Vessel, flow model, bed and grid of a configuration, each built once, when it is first asked.

    config -- the configuration, validated. Its tables are at hand as `material`, `operation`,
              `diffusion`, `accuracy` and `output`

    >>> from scaleup.case.composing import compose
    >>> case = compose(None, ["operation.fill.depth_ratio=0.5", "grid.spacing=5 mm"])
    >>> case.name("geometry"), case.grid.counts
    ('drum', (30, 30))
    >>> round(case.fill_volume / case.geometry.volume, 6)
    0.5
    >>> finer = case.changed(grid={"spacing": 0.0025})
    >>> finer.grid.counts
    (58, 58)
    """

    def __init__(self, config: RunConfig):
        self.config = config

    def changed(self, **tables: Mapping[str, Any]) -> Case:
        """The case with other values of some keys of some tables (not validated)."""
        update = {
            name: getattr(self.config, name).model_copy(update=values)
            for name, values in tables.items()
        }
        return Case(self.config.model_copy(update=update))

    @property
    def material(self) -> Material:
        """The powder."""
        return self.config.material

    @property
    def operation(self) -> Operation:
        """How the vessel is filled and turned."""
        return self.config.operation

    @property
    def diffusion(self) -> Diffusion:
        """The constants of the law of diffusion, and when it sets in."""
        return self.config.diffusion

    def laws(self, revolution: float = math.inf) -> tuple[Law, ...]:
        """What moves components beside the flow after so many revolutions; by default all laws."""
        if self.diffusion.k1 == 0 or revolution < round(self.diffusion.after, 9):
            return ()
        return (shear_diffusion(self.diffusion, self.material.grain_diameter),)

    @property
    def accuracy(self) -> Accuracy:
        """What is asked of the error, and of samples."""
        return self.config.accuracy

    @property
    def output(self) -> Output:
        """What is kept."""
        return self.config.output

    @property
    def particles(self) -> Particles:
        """Grains of a particle twin."""
        return self.config.particles

    def name(self, kind: Kind) -> str:
        """What the chosen plugin is registered under."""
        return str(getattr(self.config, kind)["name"])

    def plugin_class(self, kind: Kind) -> Any:
        """The chosen plugin."""
        return registry.load(kind, self.name(kind))

    def form(self, kind: Kind) -> str:
        """The form in which the chosen plugin takes its options; "" of one that has a single one.

        Raises ContractError.
        """
        plugin = self.plugin_class(kind)
        if kind != "flow" or not plugin.forms:
            return ""
        name = plugin.form(self.geometry, self._given(kind))
        if name not in plugin.forms:
            known = ", ".join(plugin.forms)
            raise ContractError(f"form must return one of {known}, not {shown(name)}")
        return str(name)

    def options(self, kind: Kind) -> Any:
        """The chosen plugin's Options. Raises InputError: key = value: rule."""
        plugin = self.plugin_class(kind)
        with blamed_on(kind, self.name(kind)):
            return validated_options(plugin, self.form(kind), self._given(kind), kind)

    def _given(self, kind: Kind) -> dict[str, Any]:
        return {key: value for key, value in getattr(self.config, kind).items() if key != "name"}

    def to_toml(self) -> str:
        """The whole configuration; read again it gives this same run."""
        tables: dict[str, Any] = self.config.model_dump(mode="json", exclude_none=True)
        for kind in PLUGIN_SECTIONS:
            options = self.options(kind).model_dump(mode="json", exclude_none=True)
            tables[kind] = {"name": self.name(kind), **options}
        if self.particles == Particles():  # a continuum run need not tell of grains
            del tables["particles"]
        return tomli_w.dumps(tables)

    @cached_property
    def geometry(self) -> Geometry:
        """The vessel."""
        vessel: Geometry = self._built("geometry")
        return vessel

    @cached_property
    def flow(self) -> Flow:
        """The flow model."""
        model: Flow = self._built("flow")
        return model

    def new_mixing(self) -> Mixing:
        """A mixing backend that nothing was started on yet."""
        backend: Mixing = self._built("mixing")
        return backend

    def _built(self, kind: Kind) -> Any:
        with blamed_on(kind, self.name(kind)):
            return self.plugin_class(kind)(self.options(kind))

    @cached_property
    def fill_volume(self) -> float:
        """The bed's volume, m^3. Raises InputError if the vessel cannot hold it."""
        geometry, fill = self.geometry, self.operation.fill
        if fill.depth_ratio is not None:
            bottom, top = geometry.lower[1], geometry.upper[1]
            return float(geometry.volume_below(bottom + fill.depth_ratio * (top - bottom)))
        if fill.volume_fraction is not None:
            return float(fill.volume_fraction * geometry.volume)
        assert fill.mass is not None  # the model's validator has seen to it
        volume = float(fill.mass / self.material.bulk_density)
        if volume >= geometry.volume:
            most = geometry.volume * self.material.bulk_density
            raise InputError(
                f"operation.fill.mass = {fill.mass:g} kg: the vessel holds {most:.4g} kg"
            )
        return volume

    @cached_property
    def fill_in_all_kinds(self) -> dict[str, float]:
        """The fill as depth ratio, volume fraction and mass (kg), whichever was given."""
        geometry, volume = self.geometry, self.fill_volume
        bottom, top = geometry.lower[1], geometry.upper[1]
        return {
            "depth_ratio": (level_height(geometry, volume) - bottom) / (top - bottom),
            "volume_fraction": volume / geometry.volume,
            "mass": volume * self.material.bulk_density,
        }

    @cached_property
    def spacing(self) -> float:
        """Edge of a cell, m; from the wanted number of active cells if that was given."""
        choice = self.config.grid
        if choice.spacing is not None:
            return float(choice.spacing)
        assert choice.cells is not None  # the model's validator has seen to it
        if self.geometry.dimension == 2:
            return math.sqrt(self.fill_volume / self.geometry.depth / choice.cells)
        return float((self.fill_volume / choice.cells) ** (1 / 3))

    @cached_property
    def grid(self) -> Grid:
        """Equal cells over the vessel."""
        geometry = self.geometry
        return grid_over(geometry.lower, geometry.upper, self.spacing, geometry.depth)

    def scene(self, inputs: Mapping[str, Any]) -> Scene:
        """What the flow model is asked to solve; `inputs`: as in `Scene`."""
        return Scene(
            geometry=self.geometry,
            material=self.material,
            speed=self.operation.speed,
            fill_volume=self.fill_volume,
            grid=self.grid,
            inputs=inputs,
        )

    @cached_property
    def bed(self) -> Bed:
        """The level bed in the vessel before it turns. Raises InputError if there can be none."""
        return Bed(self.geometry, self.fill_volume, self.spacing)

    @property
    def sample_edge(self) -> float:
        """Edge, m, of the samples that are asked for: cubes."""
        if self.accuracy.sample_mass is not None:
            return float((self.accuracy.sample_mass / self.material.bulk_density) ** (1 / 3))
        return float(self.accuracy.scrutiny * self.material.grain_diameter)

    @cached_property
    def flow_cautions(self) -> tuple[str, ...]:
        """What the flow model says of the scene before it is solved.

        Raises InputError if it refuses, ContractError if it says no sentences.
        """
        speed, volume = self.operation.speed, self.fill_volume
        said = self.flow.cautions(self.geometry, self.material, speed, volume)
        if not isinstance(said, (tuple, list)) or not all(isinstance(text, str) for text in said):
            raise ContractError(f"cautions must return a tuple of sentences, not {shown(said)}")
        return tuple(said)
