"""A scene computed by the engine: grains poured, settled and turned, in a folder, from any point.

The folder holds all that the engine reads and writes. What is there already is not done again, so
that a run that was ended goes on: after settling from `settled.restart`, later from the last
`state.STEP.restart`, which is written whole at every point of the blend curve.
"""

from __future__ import annotations

import json
import logging
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from scaleup.case.case import Case
from scaleup.case.vessel_shape import is_circle
from scaleup.contract import GRAVITY, FloatArray
from scaleup.particles.contact import Contact
from scaleup.particles.deck import FRAMES, Cylinder, Deck, Wall
from scaleup.particles.dumps import Frame, dumps_in, read_dump, write_grains
from scaleup.particles.engine import Cost, Engine
from scaleup.particles.pouring import poured
from scaleup.particles.schedule import Schedule
from scaleup.particles.walls import smoothness, triangles_of, write_stl
from scaleup.system.files import write_text
from scaleup.system.progress import Reporter

log = logging.getLogger("scaleup")

_STILL = 1e-5  # mean kinetic energy of a grain at rest, over that of a fall by one diameter
_LOOSE_ENDS = 2.0  # diameters of free space around the vessel in the engine's box
_LEAST_LENGTH = 5.0  # diameters, of a slice
_RESTART = re.compile(r"state\.(\d+)\.restart")
_FELL = 1.0  # settling stretch over the time of a fall through the vessel's reach


@dataclass(frozen=True)
class Computed:
    """What the engine left.

    settled -- the level bed before the vessel turns
    frames  -- dumps by the engine's step, ascending; the first one is the level bed
    """

    settled: Frame
    frames: dict[int, Path]


class Computation:
    """The engine's part of a particle twin."""

    def __init__(self, case: Case, folder: Path, ranks: int):
        self.contact = Contact.of(case, case.particles)
        self.schedule = Schedule.of(case, self.contact)
        self.engine = Engine(folder, ranks)
        self._case, self._folder = case, folder
        geometry = case.geometry
        self.length: float | None = None
        """m, of the slice that a cross-section becomes, which repeats along z"""
        if geometry.dimension == 2:
            self.length = max(geometry.depth, _LEAST_LENGTH * self.contact.largest)

    @property
    def share(self) -> float:
        """Volume of what is computed over that of the scene."""
        return self.length / self._case.geometry.depth if self.length is not None else 1.0

    @property
    def mass(self) -> float:
        """Of the grains that are asked for, kg: the powder's, as long as the slice is."""
        return self._case.fill_volume * self._case.material.bulk_density * self.share

    @property
    def count(self) -> int:
        """How many grains that is."""
        return max(1, round(self.mass / self.contact.mean_mass))

    def run(self) -> Computed:
        """Do what is left to be done. Raises RunError if the engine fails."""
        self._folder.mkdir(exist_ok=True)
        (self._folder / FRAMES).mkdir(exist_ok=True)
        if not (self._folder / "settled.restart").exists():
            self._settle()
        settled = read_dump(self._folder / "settled.txt")
        self._turn(settled.step)
        frames = {k: p for k, p in self._frames().items() if k >= settled.step}
        return Computed(settled, frames)

    def costs(self) -> dict[str, Cost]:
        """What the stages took that were run to their end (settling, turning)."""
        path = self._folder / "costs.json"
        table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        return {stage: Cost(**cost) for stage, cost in table.items()}

    def _settle(self) -> None:
        geometry, length = self._case.geometry, self.length
        wall = "a cylinder"
        if not is_circle(geometry):
            triangles = triangles_of(geometry, self.contact.diameter, length or 0.0)
            write_stl(self._folder / "vessel.stl", triangles)
            wall = f"{len(triangles)} triangles"
        seed = self._case.particles.seed
        grains = poured(geometry, self.contact, self.mass, length or 0.0, seed)
        write_grains(self._folder / "grains.data", grains, self.contact.density, self._box())
        log.info("%d grains settle; the wall is %s", len(grains.radius), wall)
        fall = np.sqrt(2 * geometry.reach / GRAVITY)
        steps = self.schedule.settling_steps(_FELL * fall)
        energy = _STILL * self.mass * GRAVITY * self.contact.diameter
        deck = self._deck().settling(self.schedule.time_step, steps, energy)
        self._stage("settling", deck)

    def _turn(self, begin: int) -> None:
        plan = self.schedule
        whole = plan.steps * plan.frames
        reached = max(self._restarts(), default=begin)
        left = plan.stretches - (reached - begin) // whole
        if left <= 0:
            return
        source = f"state.{reached}.restart" if reached > begin else "settled.restart"
        axis = self._case.geometry.axis
        deck = self._deck().turning(
            source, plan.time_step, plan.steps, plan.frames, left, axis, plan.period
        )
        if reached > begin:
            log.info("resumed at revolution %.3f", plan.revolution(reached - begin))
        self._stage("turning", deck, begin, reached)

    def _stage(self, stage: str, deck: str, begin: int | None = None, reached: int = 0) -> None:
        """Run a deck; with progress where the vessel turns, since step `begin`."""
        plan = self.schedule
        end = plan.steps * plan.frames * plan.stretches

        with Reporter(stage, visible=True) as progress:

            def look() -> None:
                done = max(self._frames(), default=0) - begin if begin is not None else 0
                if done > 0:
                    progress(done / end, f"revolution {plan.revolution(done):.2f}")
                    for step in sorted(self._restarts())[:-2]:
                        (self._folder / f"state.{step}.restart").unlink(missing_ok=True)

            cost = self.engine.run(stage, deck, look)
        known = self.costs()
        if begin is None:
            steps = read_dump(self._folder / "settled.txt").step
        else:
            steps = begin + end - reached
        known[stage] = known.get(stage, Cost()) + replace(cost, steps=steps)
        table = {name: asdict(each) for name, each in known.items()}
        write_text(self._folder / "costs.json", json.dumps(table))

    def _deck(self) -> Deck:
        geometry = self._case.geometry
        wall: Wall | Cylinder
        if is_circle(geometry):
            wall = Cylinder(geometry.reach, (0.0, 0.0))
        else:
            wall = Wall("vessel.stl", smoothness(self._triangles()))
        return Deck(self.contact, self._box(), self.length is not None, [wall])

    def _triangles(self) -> FloatArray:
        """Those of `vessel.stl`."""
        text = (self._folder / "vessel.stl").read_text(encoding="ascii")
        found = np.array(re.findall(r"vertex (\S+) (\S+) (\S+)", text), dtype=float)
        return found.reshape(-1, 3, 3)

    def _box(self) -> FloatArray:
        """Room for the vessel as it turns, (2, 3)."""
        geometry = self._case.geometry
        free = _LOOSE_ENDS * self.contact.diameter
        x, y, _ = geometry.axis.point
        reach = geometry.reach + free
        if self.length is not None:
            z = (-0.5 * self.length, 0.5 * self.length)
        else:
            z = (geometry.lower[2] - free, geometry.upper[2] + free)
        return np.array([[x - reach, y - reach, z[0]], [x + reach, y + reach, z[1]]])

    def _frames(self) -> dict[int, Path]:
        return dumps_in(self._folder / FRAMES)

    def _restarts(self) -> list[int]:
        names = (p.name for p in self._folder.glob("state.*.restart"))
        return [int(m[1]) for name in names if (m := _RESTART.fullmatch(name))]
