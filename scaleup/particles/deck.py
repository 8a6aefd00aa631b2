"""Input decks for LIGGGHTS: what is pressed, turned and written, stage by stage.

A deck is text. `Deck` holds what all stages of a computation share; `settling` and `turning` are
the stages of a vessel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scaleup.contract import GRAVITY, Axis, FloatArray
from scaleup.particles.contact import Contact
from scaleup.particles.dumps import COLUMNS, FORMAT

_LAW = "hertz tangential history rolling_friction cdt"
_SKIN = 0.25  # of a diameter: how far grains move before neighbours are looked for again
_TRIES = 60

RESTART = "state.{step}.restart"
FRAMES = "frames"


@dataclass(frozen=True)
class Wall:
    """An STL file in the folder of the run.

    smooth -- deg between triangles up to which their common edge is not felt; must be less than
              the least angle of a triangle
    """

    file: str
    smooth: float


@dataclass(frozen=True)
class Cylinder:
    """The inside of a cylinder of a radius (m) about an axis along z through `centre` (m)."""

    radius: float
    centre: tuple[float, float]

    def touch(self, law: str, spin: float, diameter: float) -> str:
        """What follows the name of a fix; spin in rad/s.

        The engine's wall moves by the spin times the distance of a grain's centre from the axis,
        not that of the contact: it is made faster by as much, exactly for a mean `diameter`.
        """
        faster = spin * self.radius / (self.radius - 0.5 * diameter)
        shear = f" shear x {faster!r}" if spin else ""
        x, y = self.centre
        return (
            f"all wall/gran model {law} primitive type 2 zcylinder {self.radius!r} {x!r} {y!r}"
            + shear
        )


@dataclass(frozen=True)
class Deck:
    """A box of grains of one kind, and walls.

    contact  -- of the grains
    box      -- m, lower and upper corner, (2, 3)
    periodic -- whether the box repeats along z
    walls    -- of triangles, or cylinders along z
    gravity  -- m/s^2, (x, y, z)
    """

    contact: Contact
    box: FloatArray
    periodic: bool
    walls: Sequence[Wall | Cylinder]
    gravity: tuple[float, float, float] = (0.0, -GRAVITY, 0.0)

    def common(self, source: str, time_step: float, spin: float = 0.0) -> list[str]:
        """The lines before a stage begins.

        source -- the command that reads the grains; spin -- of cylinders, rad/s
        """
        c = self.contact
        skin = _SKIN * c.diameter
        pairs = f"{c.friction!r} {c.wall_friction!r} {c.wall_friction!r} {c.wall_friction!r}"
        bounce, rolling = (
            " ".join([repr(value)] * 4) for value in (c.restitution, c.rolling_friction)
        )
        modulus, ratio = (" ".join([repr(v)] * 2) for v in (c.youngs_modulus, c.poisson_ratio))
        size = math.sqrt(sum(g * g for g in self.gravity))
        way = " ".join(repr(g / size) for g in self.gravity) if size else ""
        meshes = [
            f"fix {name} all mesh/surface file {wall.file} type 2 curvature {wall.smooth:.4g} "
            "curvature_tolerant yes"
            for name, wall in self._meshes.items()
        ]
        touches = [
            wall.touch(_LAW, spin, c.diameter) for wall in self.walls if isinstance(wall, Cylinder)
        ]
        if meshes:
            names = " ".join(self._meshes)
            touches.append(f"all wall/gran model {_LAW} mesh n_meshes {len(meshes)} meshes {names}")
        return [
            "atom_style granular",
            "atom_modify map array",
            f"boundary f f {'p' if self.periodic else 'f'}",
            "newton off",
            "communicate single vel yes",
            "units si",
            "soft_particles yes",
            *(["processors * * 1"] if self.periodic else []),
            source,
            f"neighbor {skin:.9g} bin",
            "neigh_modify delay 0",
            f"fix law1 all property/global youngsModulus peratomtype {modulus}",
            f"fix law2 all property/global poissonsRatio peratomtype {ratio}",
            f"fix law3 all property/global coefficientRestitution peratomtypepair 2 {bounce}",
            f"fix law4 all property/global coefficientFriction peratomtypepair 2 {pairs}",
            f"fix law5 all property/global coefficientRollingFriction peratomtypepair 2 {rolling}",
            f"pair_style gran model {_LAW}",
            "pair_coeff * *",
            f"timestep {time_step!r}",
            *([f"fix weight all gravity {size!r} vector {way}"] if size else []),
            *meshes,
            *(f"fix touch{n} {touch}" for n, touch in enumerate(touches)),
            "fix motion all nve/sphere",
            "thermo_style custom step atoms ke",
        ]

    @property
    def _meshes(self) -> dict[str, Wall]:
        """Walls of triangles by name."""
        return {f"wall{n}": w for n, w in enumerate(self.walls) if isinstance(w, Wall)}

    def settling(self, time_step: float, steps: int, energy: float) -> str:
        """From `grains.data`: stretches of some steps until the kinetic energy (J) is small.

        Leaves `settled.restart` and `settled.txt`.
        """
        return _text(
            [
                *self.common("read_data grains.data", time_step),
                f"thermo {steps}",
                "variable tries loop " + str(_TRIES),
                "variable energy equal ke",
                "label stretch",
                f"run {steps}",
                f'if "${{energy}} < {energy:.9g}" then "jump SELF settled"',
                "next tries",
                "jump SELF stretch",
                "label settled",
                f'write_dump all custom settled.txt {COLUMNS} modify sort id format "{FORMAT}"',
                "write_restart settling.restart",
                "shell mv settling.restart settled.restart",
            ]
        )

    def turning(
        self,
        source: str,
        time_step: float,
        steps: int,
        frames: int,
        stretches: int,
        axis: Axis,
        period: float,
    ) -> str:
        """The walls turn, from a restart file: stretches of `frames` dumps, `steps` steps apart.

        source -- name of the restart file, at a multiple of `steps`
        period -- s of a revolution
        Every stretch leaves a `state.STEP.restart`, whole.
        """
        point = " ".join(repr(float(x)) for x in axis.point)
        direction = " ".join(repr(float(x)) for x in axis.direction)
        turns = [
            f"fix turn_{name} all move/mesh mesh {name} rotate origin {point} axis {direction} "
            f"period {period!r}"
            for name in self._meshes
        ]
        return _text(
            [
                *self.common(f"read_restart {source}", time_step, 2 * math.pi / period),
                *turns,
                f"thermo {steps}",
                f"dump frames all custom {steps} {FRAMES}/grains.*.txt {COLUMNS}",
                f'dump_modify frames sort id format "{FORMAT}"',
                f"variable left loop {stretches}",
                "variable at equal step",
                "label stretch",
                f"run {steps * frames}",
                "write_restart next.restart",
                "shell mv next.restart " + RESTART.format(step="${at}"),
                "next left",
                "jump SELF stretch",
            ]
        )


def _text(lines: Sequence[str]) -> str:
    return "\n".join(lines) + "\n"
