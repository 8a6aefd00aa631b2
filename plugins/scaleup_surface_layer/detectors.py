"""Where the general model may not hold, told from its own solution, with the phase angles.

Phases are angles that the vessel has turned since it stood upright, modulo a revolution.

- slump     S = sqrt(2 q shear_rate)/sqrt(2 g H), the layer's surface speed over that of free fall
            through the bed's height range H: near 1 the powder falls, it does not flow steadily
- thick     thickness of the layer over the bed's depth below the greatest flux: it should be thin
- steep     slope above the friction slope where there is flux: the steep law stands in for a bound
- roof      share of the flux in columns that are full to the vessel's wall
- overhang  share of vertical lines that leave the vessel in between: the bed is no graph there
The bounds of S, thick and roof are proposals that no experiment has calibrated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from scaleup.api import GRAVITY, FloatArray, Scene
from scaleup_surface_layer.lab_columns import BedStep
from scaleup_surface_layer.layer_closing import Quality
from scaleup_surface_layer.revolution import Revolution
from scaleup_surface_layer.turned_vessel import Outline
from scaleup_surface_layer.vessel_frame import VesselFrame

_BOUNDS = {"slump": 0.3, "thick": 0.5, "steep": 0.05, "roof": 0.02, "overhang": 0.01}
_SENTENCES = {
    "slump": "the layer's speed reaches {worst:.2g} of free fall through the bed's height",
    "thick": "the flowing layer takes {worst:.0%} of the bed's depth: it is not thin",
    "steep": "the surface is {worst:.0%} steeper than the friction angle allows",
    "roof": "{worst:.1%} of the flux runs in columns that are full to the wall",
    "overhang": "{worst:.0%} of vertical lines leave the vessel in between: the bed is no graph",
}
_FLOWS = 0.1  # of the greatest flux: what counts as flowing


@dataclass
class Findings:
    """The solution of a scene, and what there is to say of it."""

    scene: Scene
    frame: VesselFrame
    revolution: Revolution
    quality: Quality

    def __post_init__(self) -> None:
        revolution = self.revolution
        self._steps = revolution.steps[revolution.prefix :]
        per_revolution = len(self._steps)
        looks = [
            self._look(step, revolution.outlines[(revolution.prefix + n + 1) % per_revolution])
            for n, step in enumerate(self._steps)
        ]
        self._phases = np.degrees([step.after.phase for step in self._steps]) % 360.0
        self._series = {name: np.array([look[name] for look in looks]) for name in looks[0]}

    def _look(self, step: BedStep, shape: Outline) -> dict[str, float]:
        """The detectors' values, and some figures, for one step."""
        flux = np.hypot(
            0.5 * (step.flux_x[1:] + step.flux_x[:-1]),
            0.5 * (step.flux_z[:, 1:] + step.flux_z[:, :-1]),
        )
        bed = step.after.depth > 0
        peak = float(flux.max())
        if peak <= 0 or not bed.any():
            return dict.fromkeys([*_BOUNDS, "flux", "speed", "thickness", "slope"], 0.0)
        shear_rate = self.frame.shear_rate
        height = np.where(bed, np.minimum(step.after.surface, shape.high), np.nan)
        fall = float(np.nanmax(height) - np.nanmin(height))
        flows = flux > _FLOWS * peak
        slope = self._slope(step.after.surface)[flows]
        busiest = np.unravel_index(int(flux.argmax()), flux.shape)
        thickness = math.sqrt(2 * peak / shear_rate)
        full = step.after.depth >= (1 - 1e-6) * (shape.high - shape.low)
        speed = math.sqrt(2 * peak * shear_rate)
        mean_slope = float(np.average(slope, weights=flux[flows]))
        return {
            "slump": speed / math.sqrt(2 * GRAVITY * max(fall, 1e-12)),
            "thick": thickness / max(float(step.after.depth[busiest]), 1e-12),
            "steep": mean_slope / self.scene.material.friction - 1.0,
            "roof": float(flux[full & bed].sum() / flux.sum()),
            "overhang": shape.broken,
            "flux": peak,
            "speed": speed,
            "thickness": min(thickness, float(step.after.depth[busiest])),
            "slope": mean_slope,
        }

    def _slope(self, surface: FloatArray) -> FloatArray:
        """|grad h| at column centres."""
        x = np.gradient(surface, self.frame.columns.dx, axis=0)
        if self.frame.columns.nz == 1:
            return np.abs(x)
        return np.hypot(x, np.gradient(surface, self.frame.columns.dz, axis=1))

    def summary(self) -> dict[str, Any]:
        """Figures of the periodic part."""
        series, revolution, quality = self._series, self.revolution, self.quality
        return {
            "surface_angle_deg": math.degrees(math.atan(float(series["slope"].mean()))),
            "surface_angle_source": "input: the friction angle (mean of the flowing surface)",
            "surface_speed_max": float(series["speed"].max()),
            "active_layer_thickness": float(series["thickness"].mean()),
            "active_layer_definition": "sqrt(2 q/shear rate) under the greatest flux, mean over "
            "the revolution",
            "solid_body_ratio": None,
            "solid_body_ratio_reason": "the model assumes rigid rotation below the layer",
            "flux_midbed": float(series["flux"].mean()),
            "flux_midbed_definition": "greatest depth-integrated flux relative to rigid rotation, "
            "mean over the revolution",
            "volume_drift": revolution.drift,
            "shear_rate": self.frame.shear_rate,
            "columns": [self.frame.columns.nx, self.frame.columns.nz],
            "intervals_per_revolution": round(len(self._steps) / self._per_interval),
            "flux_correction": quality.correction / max(quality.model, 1e-300),
            "volume_misplaced": revolution.rehomed,
            "volume_stuck": self.frame.stuck / self.frame.volume,
            "volume_detoured": self.frame.detoured / self.frame.volume,
            "surface_shift": self.frame.greatest_shift,
            "repeat_mismatch": revolution.mismatch,
            **{f"detector_{name}": float(series[name].max()) for name in _BOUNDS},
        }

    @property
    def _per_interval(self) -> int:
        return self.revolution.multiple

    def warnings(self) -> tuple[str, ...]:
        """Sentences on where the model's assumptions do not hold."""
        found = []
        for name, bound in _BOUNDS.items():
            values = self._series[name]
            beyond = values > bound
            if beyond.any():
                what = _SENTENCES[name].format(worst=float(values.max()))
                found.append(f"{what} (bound {bound:g}), at {_ranges(self._phases, beyond)} deg")
        return tuple(found)


def _ranges(phases: FloatArray, beyond: FloatArray) -> str:
    """Phases at which something holds, as ranges in degrees."""
    order = np.argsort(phases)
    angles, flags = np.round(phases[order]).astype(int), beyond[order]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    parts = []
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        low, high = angles[first], angles[stop - 1]
        parts.append(f"{low}" if low == high else f"{low}-{high}")
    return ", ".join(parts)
