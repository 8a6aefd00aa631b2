"""Lengths of steps, and a run stopped as soon as its values show that the scheme broke."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scaleup.system.errors import RunError

if TYPE_CHECKING:
    from scaleup.space.decomposition import Decomposition

LOOK_EVERY = 50  # steps between looks at the values
_BEYOND_USE = 1e6  # a value that no forced run goes on with


@dataclass(frozen=True)
class Steps:
    """Chooses equal steps, and judges them before (the limit) and after (the values).

    split     -- the decomposition, for where things happen
    share     -- of the backend's own step that is used; its option `option`
    time_step -- s, a step asked for in its place, or None
    overshoot -- how far beyond [0, 1] the scheme may go while it is stable
    force     -- go on beyond the limit and the overshoot; what is not a number stops all the same
    """

    split: Decomposition
    share: float
    time_step: float | None
    overshoot: float
    force: bool
    option: str = "courant"

    def equal(
        self, start: float, end: float, own: float, longest: float, limit: float = math.inf
    ) -> tuple[int, float]:
        """(number, length in s) of equal steps from start to end, s.

        own     -- s, the backend's step on this interval of the flow
        longest -- s, no step may be longer
        limit   -- s, of stability. Raises RunError if `time_step` is beyond it, unless forced.
        """
        wanted = self.time_step
        if wanted is not None and wanted > limit * (1 + 1e-9) and not self.force:
            raise RunError(
                f"mixing.time_step = {wanted:.4g} s: the limit of stability from t = "
                f"{start:.4g} s on is {limit:.4g} s; take a smaller step, or --force it"
            )
        longest = min(longest, self.share * own if wanted is None else wanted)
        count = max(1, math.ceil((end - start) / longest - 1e-9))
        return count, (end - start) / count

    def judge(
        self,
        low: float,
        high: float,
        time: float,
        dt: float,
        stable: float,
        worst: Callable[[], tuple[float, int]],
    ) -> None:
        """Raise RunError if the least or greatest value says that the scheme broke; collective.

        low, high -- over all ranks, before any clipping (infinite for what is not a number)
        worst     -- gives (how far beyond [0, 1], position in flattened local arrays) on a rank
        """
        excess = max(-low, high - 1.0)
        allowed = _BEYOND_USE if self.force else self.overshoot
        if excess <= allowed:
            return
        found = self.split.comm.allgather(self._located(*worst()))
        _, where = max(found)
        what = (
            f"reached {low if -low > high - 1 else high:.4g}"
            if excess < math.inf
            else ("is not a number")
        )
        bound = f" (it may leave [0, 1] by {self.overshoot:g})" if excess < math.inf else ""
        share = f", {dt / stable:.3g} times the stable one" if stable < math.inf else ""
        raise RunError(
            f"the concentration {what}{bound} at {where} and t = {time:.4g} s with steps of "
            f"{dt:.3g} s{share}; {self._advice()}"
        )

    def _advice(self) -> str:
        if self.time_step is not None:
            return f"reduce mixing.time_step (now {self.time_step:g} s)"
        return f"reduce mixing.{self.option} (now {self.share:g})"

    def _located(self, excess: float, position: int) -> tuple[float, str]:
        centre = self.split.centre(position)
        return excess, ", ".join(f"{n} = {x:.4g} m" for n, x in zip("xyz", centre, strict=False))
