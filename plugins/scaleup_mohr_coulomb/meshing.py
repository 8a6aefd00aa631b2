"""Netgen at work: what it fails at is said in one sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from netgen.occ import OCCGeometry

from scaleup.contract import InputError


def occ_geometry(shape: Callable[[], Any], **settings: Any) -> Any:
    """The netgen geometry of an OCC shape. Raises InputError if there is none."""
    try:
        return OCCGeometry(shape(), **settings)
    except InputError:
        raise
    except Exception as error:  # OCC's own classes
        raise InputError(
            f"geometry: OCC cannot make a solid of the vessel ({error}); change its dimensions"
        ) from error


def meshed(geometry: Any, size: float, **settings: Any) -> Any:
    """The netgen mesh of a geometry with elements of `size` (m). Raises InputError if it fails."""
    try:
        return geometry.GenerateMesh(**settings)
    except Exception as error:  # netgen's own class
        raise InputError(
            f"flow.fine_size = {size:.4g} m: netgen cannot fill the vessel with elements of that "
            f"size ({error}); take smaller ones, or leave out of the geometry what is much smaller "
            "than they are"
        ) from error
