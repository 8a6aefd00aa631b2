"""Numerical tools for authors of plugins, beside the contract (`scaleup.contract`)."""

from __future__ import annotations

from scaleup.case.vessel_shape import (
    bed_depth,
    froude_number,
    is_circle,
    level_height,
    require_drum,
    require_rolling,
)
from scaleup.flow.bed_support import critical_height, lifted_lean
from scaleup.flow.lattice_gradients import lattice_gradients
from scaleup.flow.nearest_fluxes import Faces, multigrid, nearest_fluxes
from scaleup.flow.stream_function import fit_stream_function, flow_from_stream_function
from scaleup.mixing.conservative_bed import BRIDGE, ConservativeBed, GroupsHere, runs_of
from scaleup.mixing.flux_correction import FluxCorrection
from scaleup.mixing.steps import Steps
from scaleup.mixing.transport import BedTransport, Transport, TransportBackend
from scaleup.scene.surroundings import Surroundings
from scaleup.space.closed_surface import ClosedSurface
from scaleup.space.compact_intervals import CompactInterval, CompactIntervals, MirroredParts
from scaleup.space.convex_hull import mirrored_in_z, outward_hull
from scaleup.space.cut_cells import cut_fraction, cut_fraction_of_cells, fill_to_volume
from scaleup.space.flow_field import interval_from_dense
from scaleup.space.grid import FULL, grid_over
from scaleup.space.merged_cells import neighbours_below
from scaleup.space.spread import spread_outwards
from scaleup.system.parallel import on_each, on_root, on_root_alone
from scaleup.vessels.convex_polyhedron import ConvexPolyhedron, corners_within
from scaleup.vessels.revolved import Revolved

__all__ = [
    "BRIDGE",
    "FULL",
    "BedTransport",
    "ClosedSurface",
    "CompactInterval",
    "CompactIntervals",
    "ConservativeBed",
    "ConvexPolyhedron",
    "Faces",
    "FluxCorrection",
    "GroupsHere",
    "MirroredParts",
    "Revolved",
    "Steps",
    "Surroundings",
    "Transport",
    "TransportBackend",
    "bed_depth",
    "corners_within",
    "critical_height",
    "cut_fraction",
    "cut_fraction_of_cells",
    "fill_to_volume",
    "fit_stream_function",
    "flow_from_stream_function",
    "froude_number",
    "grid_over",
    "interval_from_dense",
    "is_circle",
    "lattice_gradients",
    "level_height",
    "lifted_lean",
    "mirrored_in_z",
    "multigrid",
    "nearest_fluxes",
    "neighbours_below",
    "on_each",
    "on_root",
    "on_root_alone",
    "outward_hull",
    "require_drum",
    "require_rolling",
    "runs_of",
    "spread_outwards",
]
