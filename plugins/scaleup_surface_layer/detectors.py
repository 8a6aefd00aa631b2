"""Where the model may not hold, told from its own solution, in closed form or for any vessel.

- slump     S = sqrt(2 q shear_rate)/sqrt(2 g H), the layer's surface speed over that of free fall
            through the bed's height range H: near 1 the powder falls, it does not flow steadily
- thick     thickness of the layer over the bed's depth below the greatest flux: it should be thin
- steep     slope above the friction slope where there is flux: the steep law stands in for a bound
- roof      share of the flux in columns that are full to the vessel's wall
- overhang  share of vertical lines that leave the vessel in between: the bed is no graph there
The bounds of S, thick and roof are proposals that no experiment has calibrated. Beyond the bounds
of `_NO_RESULT` the solution is not that of the model's equations, and the flow is refused.
Phases are angles that the vessel has turned since it stood upright, modulo a revolution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from scaleup.contract import GRAVITY, FloatArray, RunError, Scene

if TYPE_CHECKING:  # the closed form does without their compiled loops
    from scaleup_surface_layer.lab_columns import BedStep
    from scaleup_surface_layer.layer_closing import Quality
    from scaleup_surface_layer.revolution import Revolution
    from scaleup_surface_layer.turned_vessel import Outline
    from scaleup_surface_layer.vessel_frame import Tally, VesselFrame

_BOUNDS = {"slump": 0.3, "thick": 0.5, "steep": 0.05, "roof": 0.02, "overhang": 0.01}
_SENTENCES = {
    "slump": "the layer's speed reaches {worst:.2g} of free fall through the bed's height",
    "thick": "the flowing layer takes {worst:.0%} of the bed's depth: it is not thin",
    "steep": "the surface is {worst:.0%} steeper than the friction angle allows",
    "roof": "{worst:.1%} of the flux runs in columns that are full to the wall",
    "overhang": "{worst:.0%} of vertical lines leave the vessel in between: what stands inside "
    "lifts no powder here",
}
_REMEDIES = {
    "slump": "set flow.shear_rate to that of a mohr-coulomb run of a drum (flow.layer_shear_rate "
    "in its report), lower operation.speed, or set flow.name = 'mohr-coulomb'",
    "thick": "lower operation.speed, or set flow.name = 'mohr-coulomb'",
    "steep": "raise flow.intervals or lower flow.slope_excess",
    "roof": "lower the fill",
    "overhang": "what baffles add to the mixing is not told; set flow.name = 'mohr-coulomb', in a "
    "vessel in space",
}
_FLOWS = 0.1  # of the greatest flux: what counts as flowing
_NO_RESULT = {
    "volume_stuck": (0.01, "{value:.1%} of the bed hangs where it should move"),
    "volume_detoured": (
        0.25,
        "{value:.0%} of the bed a revolution gets around parts inside the vessel on ways that are "
        "not the layer's",
    ),
    "flux_correction": (0.3, "its fluxes were corrected by {value:.0%} of themselves"),
    "detector_steep": (0.5, "its surface is {value:.0%} steeper than the friction angle allows"),
}


def layer_figures(flux: float, shear_rate: float, fall: float, depth: float) -> dict[str, float]:
    """Figures of the layer where its flux is greatest, among them the detectors of any form.

    flux -- m^2/s; shear_rate -- 1/s; fall -- m, height range of the bed's surface; depth -- m of
    bed there
    """
    thickness, speed = math.sqrt(2 * flux / shear_rate), math.sqrt(2 * flux * shear_rate)
    return {
        "slump": speed / math.sqrt(2 * GRAVITY * max(fall, 1e-12)),
        "thick": thickness / max(depth, 1e-12),
        "flux": flux,
        "speed": speed,
        "thickness": min(thickness, depth),
    }


def warnings_of(series: Mapping[str, FloatArray], phases: FloatArray | None) -> tuple[str, ...]:
    """Sentences on detectors that are beyond their bounds.

    series -- values of each detector through a revolution; phases -- deg; None: the bed is steady
    """
    found = []
    for name, bound in _BOUNDS.items():
        values = series[name]
        beyond = values > bound
        if beyond.any():
            what = _SENTENCES[name].format(worst=float(values.max()))
            when = "" if phases is None else f", at {_ranges(phases, beyond)} deg"
            found.append(f"{what} (bound {bound:g}){when}; {_REMEDIES[name]}")
    return tuple(found)


def maxima(series: Mapping[str, FloatArray]) -> dict[str, float]:
    """The detectors for the summary."""
    return {f"detector_{name}": float(series[name].max()) for name in _BOUNDS}


def require_result(summary: Mapping[str, Any]) -> None:
    """Raise RunError for a solution that does not satisfy the model's own equations."""
    for name, (bound, sentence) in _NO_RESULT.items():
        if summary[name] > bound:
            raise RunError(
                f"the flow is no result: {sentence.format(value=summary[name])} ({name}, at most "
                f"{bound:g}); set flow.name = 'mohr-coulomb', in a vessel in space, or take "
                "smaller cells or lower baffles"
            )


@dataclass
class Findings:
    """The solution of a scene, and what there is to say of it."""

    scene: Scene
    frame: VesselFrame
    revolution: Revolution
    quality: Quality
    tally: Tally

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
        height = np.where(bed, np.minimum(step.after.surface, shape.high), np.nan)
        fall = float(np.nanmax(height) - np.nanmin(height))
        flows = flux > _FLOWS * peak
        slope = self._slope(step.after.surface)[flows]
        busiest = np.unravel_index(int(flux.argmax()), flux.shape)
        full = step.after.depth >= (1 - 1e-6) * (shape.high - shape.low)
        mean_slope = float(np.average(slope, weights=flux[flows]))
        return {
            **layer_figures(peak, self.frame.shear_rate, fall, float(step.after.depth[busiest])),
            "steep": mean_slope / self.scene.material.friction - 1.0,
            "roof": float(flux[full & bed].sum() / flux.sum()),
            "overhang": shape.broken,
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
            "volume_stuck": self.tally.stuck / self.frame.volume,
            "volume_detoured": self.tally.detoured / self.frame.volume / self._revolutions,
            "surface_shift": self.tally.greatest_shift,
            "repeat_mismatch": revolution.mismatch,
            **maxima(series),
        }

    @property
    def _per_interval(self) -> int:
        return self.revolution.multiple

    @property
    def _revolutions(self) -> float:
        return len(self.revolution.steps) / len(self._steps)

    def warnings(self) -> tuple[str, ...]:
        """Sentences on where the model's assumptions do not hold."""
        return warnings_of(self._series, self._phases)


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
