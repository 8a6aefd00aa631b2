"""The blend curve: how well a bed is blended, from time to time."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from scaleup.contract import FlowField, Ledger
from scaleup.measure.metrics import Sampler, centre_line
from scaleup.mixing.march import State


@dataclass
class Blend:
    """The blend curve of one mixing run; lists have one entry per point of the curve.

    intensity, intensity_sample -- of component 1
    lacey, rsd -- of the component that is blended worst
    volumes  -- of each component, m^3
    sample_volume -- m^3 of powder in a sample, on the average
    ranks    -- how many worked, at the most
    elapsed  -- s of wall-clock time, those before a resumption included
    seconds  -- the same of all that was done
    remarks  -- sentences on how the run went that its reader should know
    profiles -- by revolution: depth below the surface over bed depth, and concentration

    >>> from scaleup.flow.sample_flows import circulating_box
    >>> flow = circulating_box(dimension=2)
    >>> left = flow.grid.centre_points(flow.intervals[0].cells)[:, 0] < 0.09
    >>> blend = Blend()
    >>> for number, shade in enumerate((0.0, 0.25, 0.5)):  # ever more of one kind in the other
    ...     first = np.where(left, 1.0 - shade, shade)
    ...     blend.measure(flow, State(np.stack([first, 1.0 - first])), number, edge=0.02)
    >>> [round(value, 3) for value in blend.intensity]
    [1.008, 0.252, 0.0]
    >>> blend.mass_drift < 1e-12
    True
    """

    revolutions: list[float] = field(default_factory=list)
    intensity: list[float] = field(default_factory=list)
    intensity_sample: list[float] = field(default_factory=list)
    lacey: list[float] = field(default_factory=list)
    rsd: list[float] = field(default_factory=list)
    volumes: list[list[float]] = field(default_factory=list)
    elapsed: list[float] = field(default_factory=list)
    profiles: dict[str, list[list[float]]] = field(default_factory=dict)
    ledger: Ledger = field(default_factory=Ledger)
    seconds: float = 0.0
    sample_volume: float = 0.0
    ranks: int = 0
    remarks: list[str] = field(default_factory=list)

    @property
    def mass_drift(self) -> float:
        """Greatest relative change of a component's volume."""
        volumes = np.array(self.volumes)
        return float(np.abs(volumes / volumes[0] - 1.0).max())

    def measure(self, flow: FlowField, state: State, revolution: float, edge: float) -> None:
        """Add a point to the curve; `edge` of a sample, m."""
        interval = flow.intervals[state.index]
        sampler = Sampler(flow.grid, interval, state.local, edge)
        components = [sampler.measure(component) for component in state.concentration]
        self.revolutions.append(revolution)
        self.intensity.append(components[0].intensity)
        self.intensity_sample.append(components[0].intensity_sample)
        self.lacey.append(min(component.lacey for component in components))
        self.rsd.append(max(component.rsd for component in components))
        # numpy's pairwise sum: a dot product of as many equal terms is off by 1e-12
        held = (state.concentration * interval.fill(state.local)).sum(axis=1)
        self.volumes.append(held.tolist())
        self.sample_volume = sampler.sample_volume

    def add_profile(self, flow: FlowField, state: State, revolution: float) -> None:
        """Add the profile along the bed's centre line, of a cross-section that stands still."""
        angle = flow.summary.get("surface_angle_deg")
        if flow.frame != "lab" or flow.grid.dimension != 2 or not isinstance(angle, float):
            return
        interval = flow.intervals[state.index]
        radians = math.radians(angle)
        depth, values = centre_line(flow.grid, interval, state.concentration[0], radians)
        self.profiles[f"{revolution:.4f}"] = [depth.tolist(), values.tolist()]

    def as_table(self) -> dict[str, Any]:
        """JSON-like."""
        return asdict(self)

    @classmethod
    def from_table(cls, table: dict[str, Any]) -> Blend:
        """What `as_table` was made of."""
        return cls(**{**table, "ledger": Ledger(**table["ledger"])})
