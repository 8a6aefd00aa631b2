"""An interval of the flow from which cells move in it: the layer's fluxes, closed to round-off.

1 the layer's flux F*, its weights, shear rate and direction, as means over the interval's steps;
2 the fluxes that agree with the change of fill and are nearest to F* (`continuity`);
3 the cells at rest, from the fill at the interval's end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scaleup.contract import FloatArray
from scaleup.numerics import CompactInterval
from scaleup_surface_layer.cell_sets import find_resting, neighbours_below
from scaleup_surface_layer.continuity import close_balance, find_segments
from scaleup_surface_layer.lab_columns import BedStep
from scaleup_surface_layer.layer_flux import LayerSums, OpenCells, add_layer
from scaleup_surface_layer.vessel_frame import Draft, VesselFrame

_FLOOR = 1e-3  # weight of a wet face outside the layer, over that of one in it


@dataclass
class Quality:
    """How far the closed fluxes are from the model's: sums of |F*| and |F - F*| so far, m^3/s."""

    model: float = 0.0
    correction: float = 0.0

    @staticmethod
    def over_ranks(parts: Sequence[Quality]) -> Quality:
        """The sums over all ranks' intervals."""
        return Quality(sum(p.model for p in parts), sum(p.correction for p in parts))


def close_interval(
    frame: VesselFrame,
    draft: Draft,
    steps: Sequence[BedStep],
    start: float,
    end: float,
    quality: Quality,
) -> CompactInterval:
    """The interval from `start` to `end` (s) that `frame` has just gone through."""
    cells, n, dimension = draft.cells, len(draft.cells), frame.grid.dimension
    across = _across(frame, steps)
    along = 1 - across
    lateral = (across,) if dimension == 2 else (across, 2)
    frame.index[cells] = np.arange(n)
    below = neighbours_below(
        cells, frame.index, frame.apertures, frame.strides, np.ones(n, dtype=bool)
    )
    model, weight = np.zeros((2, n)), np.zeros((2, n))
    shear, motion = np.zeros(n), np.zeros((3, n))
    for step in steps:
        add_layer(
            frame.layer(step, 0.5),
            0.5 * (step.before.phase + step.after.phase),
            1 / len(steps),
            across,
            OpenCells(cells, frame.index, frame.apertures),
            frame.place,
            LayerSums(model, weight, shear, motion),
        )
    other, still = find_resting(
        frame.vessel, frame.fill, frame.capacity, frame.index, int(frame.strides[-1])
    )
    frame.index[cells] = -1
    flux = np.zeros((dimension, n))
    if n:
        for row, axis in enumerate(lateral):
            floor = _FLOOR * frame.grid.face_area(axis)
            np.maximum(weight[row], floor, out=weight[row])
        closed = model[: len(lateral)].copy()
        segments = find_segments(below[along], below[list(lateral)])
        gain = (draft.after - draft.before) / (end - start)
        flux[along] = close_balance(segments, below[along], closed, weight, gain)
        flux[list(lateral)] = closed
        quality.model += float(np.abs(model).sum())
        quality.correction += float(np.abs(closed - model[: len(lateral)]).sum())
    speed = np.sqrt((motion**2).sum(axis=0))
    direction = np.divide(motion, speed, where=speed > 0, out=np.zeros_like(motion))[:dimension]
    # cells at rest that are neither full nor empty are kept one by one as well
    stored = np.concatenate([cells, other])
    order = np.argsort(stored, kind="stable")
    kind = np.int32 if frame.grid.cells < 2**30 else np.int64  # halves are put together later

    def whole(values: FloatArray, elsewhere: FloatArray | float, dtype: type = float) -> FloatArray:
        both = np.empty((*values.shape[:-1], len(stored)), dtype=dtype)
        both[..., :n], both[..., n:] = values, elsewhere
        return np.ascontiguousarray(both[..., order]) if len(other) else both

    held = frame.fill[other]
    return CompactInterval(
        start=start,
        end=end,
        cells=stored[order].astype(kind),
        fill_start=whole(draft.before, held),
        fill_end=whole(draft.after, held),
        flux=whole(flux, 0.0),
        shear_rate=whole(shear, 0.0, np.float32),
        direction=whole(direction, 0.0, np.float32),
        still=still.astype(kind),
    )


def _across(frame: VesselFrame, steps: Sequence[BedStep]) -> int:
    """The in-plane grid axis that lies closest to the surface: 0 or 1."""
    step = steps[len(steps) // 2]
    middle = 0.5 * (step.before.surface + step.after.surface)
    bed = step.after.depth > 0
    inner = bed[1:] & bed[:-1]
    slope = float(np.diff(middle, axis=0)[inner].mean() / frame.columns.dx)
    phase = 0.5 * (steps[0].before.phase + steps[-1].after.phase)
    c, s = math.cos(phase), math.sin(phase)
    # the surface's direction (1, slope) in vessel coordinates
    return 0 if abs(c + s * slope) >= abs(c * slope - s) else 1
