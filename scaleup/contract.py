"""What a plugin must provide; with `scaleup.numerics`, all that it may import from scaleup.

A plugin is a class registered as an entry point in the group `scaleup.geometries`, `scaleup.flow`
or `scaleup.mixing`, and derives from `Geometry`, `Flow` or `Mixing`: what has a value or a body
there may be left out. It owns a nested class `Options`, a frozen pydantic model derived from
`PluginOptions`; it is made with an instance of it, and keeps that as `self.options`.
`scaleup.testing` checks the rest.

Conventions: SI units; x right, y up, gravity along -y; rotation about +z, counter-clockwise, so
that the bed climbs on +x and its surface flows towards -x. Arrays over points are (n, dimension).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from scaleup.scene import units
from scaleup.scene.laws import Diffusion, Drift, Law, total_drift, total_tensor
from scaleup.scene.models import GRAVITY, Loading, Material
from scaleup.scene.models import Model as PluginOptions
from scaleup.space.flow_field import Axis, FlowField, Interval
from scaleup.space.grid import BoolArray, FloatArray, Grid, IntArray
from scaleup.space.solids import FlatSolid, TurnedSolid
from scaleup.system.errors import ContractError, InputError, RunError
from scaleup.system.registry import Plugin

if TYPE_CHECKING:
    from scaleup.space.decomposition import Decomposition

__all__ = [
    "GRAVITY",
    "Axis",
    "BoolArray",
    "ContractError",
    "Diffusion",
    "Drift",
    "FlatSolid",
    "FloatArray",
    "Flow",
    "FlowField",
    "Geometry",
    "Grid",
    "InputError",
    "IntArray",
    "Interval",
    "Law",
    "Ledger",
    "Loading",
    "Material",
    "Memory",
    "Mixing",
    "MixingScene",
    "PluginOptions",
    "Progress",
    "RunError",
    "Scene",
    "TurnedSolid",
    "units",
]

Progress = Callable[[float, str], None]
"""progress(fraction done in [0, 1], a short message)"""


class Memory(Protocol):
    """Arrays kept between runs under the inputs that they were computed from.

    Inputs are JSON-like; the plugin's own source is part of the key, so that a changed plugin
    never meets its old results. What depends on less than a whole FlowField (a solution before it
    is put on a grid) or is not finished yet (a checkpoint) belongs here.
    """

    def recall(self, inputs: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """The arrays kept under these inputs, or None."""
        ...

    def keep(self, inputs: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep arrays under these inputs, in place of older ones."""
        ...

    def forget(self, inputs: Mapping[str, Any]) -> None:
        """Drop what is kept under these inputs, if anything is."""
        ...


class Geometry(Plugin, kind="geometry"):
    """A vessel, at rest and upright (phase 0)."""

    default_scene: ClassVar[Mapping[str, Any] | Callable[[Any], Mapping[str, Any]]]
    """configuration sections that make `simulate --geometry NAME` work in minutes; a static method
    from the Options to such sections where they depend on the vessel's size or kind"""

    dimension: int = 3
    """2 (a cross-section) or 3"""
    depth: float = 1.0
    """m, extent along z that a cross-section stands for; 1.0 in 3-D"""
    axis: Axis = Axis()
    reach: float
    """m, greatest distance of the vessel's inside from the axis"""
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    """m, corners of the box around the inside"""
    volume: float
    """m^3"""
    symmetry: tuple[tuple[float, ...], ...] = ()
    """unit normals of the mirror planes, through the axis' point, that the flow shares with the
    vessel: those across the axis, that is ((0.0, 0.0, 1.0),) or ()"""
    thinnest: float = math.inf
    """m, thickness of the thinnest part inside, such as a baffle, which the grid must resolve"""
    fingerprint: str = ""
    """a hash of what the shape depends on beside the Options, such as the content of a file"""
    warnings: tuple[str, ...] = ()
    """sentences for the report on what was mended or should be known of the vessel"""

    @abstractmethod
    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the wall, m, positive inside; points (..., dimension) in m."""

    @abstractmethod
    def volume_below(self, height: float) -> float:
        """m^3 of the vessel at rest below the level y = height (m)."""

    def solid(self) -> Any:
        """The inside, for meshing, in m: a `FlatSolid`, a `TurnedSolid` or a netgen OCC shape.

        A cross-section's is an OCC face. Raises InputError if there is none.
        """
        raise InputError(
            f"geometry: {type(self).__name__} gives no solid to mesh; take a flow that needs none"
        )


@dataclass(frozen=True)
class Scene:
    """What a flow model is asked to solve.

    geometry     -- the vessel
    material     -- as configured
    speed        -- rad/s, of the vessel
    fill_volume  -- m^3 of bed
    grid         -- the grid that the FlowField is wanted on
    inputs       -- all of the above but the grid, JSON-like: the key for a `Memory`
    """

    geometry: Geometry
    material: Material
    speed: float
    fill_volume: float
    grid: Grid
    inputs: Mapping[str, Any] = field(default_factory=dict)


class Flow(Plugin, kind="flow"):
    """A flow model: from a scene to a FlowField."""

    forms: ClassVar[Mapping[str, type[PluginOptions]]] = {}
    """where options exclude each other, the Options of each form that the model takes, by name:
    they derive from `Options`, and the model is made with those of the form that a scene takes"""

    @staticmethod
    def form(geometry: Geometry, given: Mapping[str, Any]) -> str:
        """The form for a vessel; `given`: the keys as they were written, not validated yet."""
        return ""

    def check(self, geometry: Geometry, speed: float) -> None:
        """Raise InputError if the model cannot hold for this vessel and speed (rad/s). Cheap."""

    def cautions(
        self, geometry: Geometry, material: Material, speed: float, fill_volume: float
    ) -> tuple[str, ...]:
        """Sentences on where the model may not hold, as far as is known before it is solved. Cheap.

        geometry, material -- as in `Scene`; speed -- rad/s; fill_volume -- m^3 of bed
        `plan` says them, and the warnings of the solved flow begin with them. Raises InputError,
        in one sentence that names the remedy, if the model cannot hold for such a bed.
        """
        return ()

    @abstractmethod
    def solve(
        self, scene: Scene, comm: Any, progress: Progress, memory: Memory
    ) -> FlowField | None:
        """The flow on `scene.grid`; called on all ranks of `comm` (collective).

        A serial model does its work in `on_root_alone(comm, work)` and returns what that does: the
        FlowField on rank 0, None elsewhere. A parallel one returns, on every rank, a FlowField that
        differs in `intervals` alone: CompactIntervals of consecutive ones that this rank holds,
        rank by rank. The ranks meet only where all of them come to; what may fail on one of them
        belongs in `on_each(comm, work)`, which raises its error on all.

        Must satisfy `scaleup.testing.check_flow`. `summary` should hold surface_angle_deg,
        surface_speed_max, active_layer_thickness, solid_body_ratio, flux_midbed, volume_drift and
        `<key>_reason` for those that it cannot give. Raises RunError if it fails.
        """


@dataclass(frozen=True)
class MixingScene:
    """What a mixing backend moves concentration on.

    flow          -- the FlowField, the same on every rank
    decomposition -- which cells this rank owns
    laws          -- what moves components beside the flow; of types that the backend solves
    force         -- whether steps beyond the limit of stability are allowed
    """

    flow: FlowField
    decomposition: Decomposition
    laws: tuple[Law, ...] = ()
    force: bool = False

    def tensor(self, interval: Interval) -> FloatArray:
        """Tensor of all diffusion, (dimension, dimension, n) in m^2/s; zeros if there is none."""
        return total_tensor(self.laws, self.flow, interval)

    def drift(self, interval: Interval) -> FloatArray | None:
        """Velocities of all drifts, (components, dimension, n) in m/s, or None if there are none.

        They hold for the whole interval.
        """
        return total_drift(self.laws, self.flow, interval)


@dataclass
class Ledger:
    """What a mixing backend did to bounds, over all components, seen before any clipping.

    All shares are of the bed's volume; `clipped` is the sum of the absolute changes by clipping;
    `step_share` is the longest step over the stable one; `iterations` are those of linear solvers.
    """

    steps: int = 0
    cell_updates: int = 0
    minimum: float = np.inf
    maximum: float = -np.inf
    clipped: float = 0.0
    step_share: float = 0.0
    iterations: int = 0

    def add(self, other: Ledger) -> None:
        """Add what a further stretch of time did."""
        self.steps += other.steps
        self.cell_updates += other.cell_updates
        self.minimum = min(self.minimum, other.minimum)
        self.maximum = max(self.maximum, other.maximum)
        self.clipped += other.clipped
        self.iterations += other.iterations
        self.step_share = max(self.step_share, other.step_share)


class Mixing(Plugin, kind="mixing"):
    """A mixing backend; `start` binds it to a scene."""

    halo: ClassVar[int]
    """layers of ghost cells that the backend reads"""
    order: ClassVar[float | None] = None
    """of the scheme on smooth problems in full cells, which `scaleup.verification` measures"""
    laws: ClassVar[frozenset[type[Law]]] = frozenset()
    """types of the laws that the backend solves; a scene with others is refused"""

    # A run is held to these two.
    overshoot: float = 1e-9
    """how far beyond [0, 1] concentrations may go while the scheme is stable"""
    conservative: bool = True
    """whether the content of each component stays what it was, to round-off"""

    def check(self, geometry: Geometry, components: int) -> None:
        """Raise InputError if the backend cannot blend so many components in this vessel. Cheap."""

    @abstractmethod
    def start(self, scene: MixingScene, concentration: FloatArray, index: int = 0) -> None:
        """Begin on interval `index` from concentrations (components, n) on its cells, all ranks."""

    @abstractmethod
    def stable_time_step(self, interval: Interval) -> float:
        """Largest stable step on an interval, s; the same on every rank (collective)."""

    @abstractmethod
    def advance(self, index: int, start: float, end: float) -> Ledger:
        """Move on over part of interval `index`, in its local clock, s (collective)."""

    @abstractmethod
    def concentration(self, interval: Interval) -> FloatArray:
        """(components, n) on the interval's cells, on every rank (collective); sums to 1."""
