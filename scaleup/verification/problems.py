"""The suite: every verification problem by name."""

from __future__ import annotations

from functools import lru_cache

from scaleup.verification.blending_drum import drum_layers
from scaleup.verification.deformations import deformations
from scaleup.verification.moving_fill import moving_fills
from scaleup.verification.problem import Problem
from scaleup.verification.rotations import rotations
from scaleup.verification.spreading import spreading


@lru_cache(maxsize=1)
def problems() -> dict[str, Problem]:
    """All problems, in the order of the tables."""
    every = [*rotations(), *deformations(), *spreading(), *moving_fills(), *drum_layers()]
    return {problem.name: problem for problem in every}
