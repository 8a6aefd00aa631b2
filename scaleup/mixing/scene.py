"""The scene that a mixing backend is started on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from scaleup.contract import FlowField, Law, Mixing, MixingScene
from scaleup.mixing.check import CheckedMixing
from scaleup.scene.laws import require_solved
from scaleup.space.decomposition import Decomposition


def mixing_scene(
    backend: Mixing | CheckedMixing,
    flow: FlowField,
    comm: Any,
    laws: Sequence[Law] = (),
    *,
    force: bool = False,
) -> MixingScene:
    """A flow and laws, shared out among the ranks as the backend's halo asks for; collective.

    Raises InputError for a law that the backend does not solve.
    """
    require_solved(laws, backend.laws, type(backend).__name__)
    split = Decomposition(flow.grid, flow.ever_active(), comm, halo=backend.halo)
    return MixingScene(flow, split, tuple(laws), force)
