"""Collapse of a granular column on a rough floor, against published scaling laws.

A column of width d0 and height h0 = a d0 beside a smooth wall is let go. In channels, Lube et al.
(2005, Phys. Rev. E 72, 041301) found, whatever the grains,

    run-out d - d0 = 1.2 a d0 for a < 1.8, 1.9 a^(2/3) d0 for a > 2.8;  rest after 3.3 sqrt(h0/g).

Lajeunesse et al. (2005, Phys. Fluids 17, 103302): run-out as a up to 3 and as a^(2/3) beyond, with
factors that depend on the grains; height as a up to 0.7 and as a^(1/3) beyond.

The run-out is taken where the deposit is d0/20 thick, a few grains: of a low column the film before
it, which rides on air that the front has overrun, is thinner.
"""

import math
import sys
import time
from dataclasses import dataclass, replace

import ngsolve as ngs
import numpy as np
from netgen.occ import OCCGeometry, Rectangle, X

from scaleup.scene.models import Material
from scaleup_mohr_coulomb.parameters import Discretisation, Drive
from scaleup_mohr_coulomb.two_phase import TwoPhaseFlow

WIDTH, GRAVITY = 0.1, 9.81
FILM = 0.05  # thickness over d0 below which the deposit counts as ended
FRICTION = math.radians(31.0)  # of Lube et al.'s sand


@dataclass(frozen=True)
class Deposit:
    """What is left, over the column's width d0, and when it came to rest, over sqrt(h0/g)."""

    run_out: float
    film: float
    """Run-out of the film before it."""
    height: float
    rest: float
    volume_drift: float
    steps: int


def lube_run_out(aspect: float) -> float:
    """(d - d0)/d0; between its two branches the lower one."""
    return min(1.2 * aspect, 1.9 * aspect ** (2 / 3)) if aspect < 2.8 else 1.9 * aspect ** (2 / 3)


def collapse(aspect: float, elements: float, steps_per_fall: float = 80.0) -> Deposit:
    """With elements of d0/``elements`` and steps of sqrt(h0/g)/``steps_per_fall``."""
    height, size = aspect * WIDTH, WIDTH / elements
    fall = math.sqrt(height / GRAVITY)
    tank = (1.0 + 1.8 * lube_run_out(aspect)) * WIDTH, 1.1 * height + 3 * size
    face = Rectangle(*tank).Face()
    face.edges.name = "floor"
    face.edges.Min(X).name = "back"
    mesh = ngs.Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=size))
    material = Material(friction_angle=FRICTION, wall_friction=1.0)
    drive = Drive(WIDTH * height, 1e-6, GRAVITY)
    rules = Discretisation.by_rule(
        material, drive, height, size, size, fall / steps_per_fall, size / 3
    )
    numerics = replace(rules, creep_rate=1e-3 / fall, slip_speed=1e-3 * height / fall)

    def column(points):
        return np.minimum(WIDTH - points[:, 0], height - points[:, 1])

    flow = TwoPhaseFlow(mesh, material, drive, numerics, surface=column, rough="floor")
    start = flow.time
    bed = flow.level_set.fraction
    energy = bed * ngs.InnerProduct(flow.velocity, flow.velocity) / 2
    moved = False
    for _ in range(int(10 * steps_per_fall)):
        flow.step()
        share = ngs.Integrate(energy, mesh) / (drive.bed_area * GRAVITY * height / 2)
        moved = moved or share > 1e-3
        if moved and share < 1e-4:
            break
    x, y = np.concatenate(flow.level_set.contour()).T / WIDTH
    return Deposit(
        run_out=x[y > FILM].max() - 1.0,
        film=x.max() - 1.0,
        height=y.max(),
        rest=(flow.time - start) / fall,
        volume_drift=flow.area_correction,
        steps=flow.steps,
    )


def main() -> None:
    """The table for the aspect ratios and element sizes given, e.g. ``0.5 1 2 4 / 8 12``."""
    split = sys.argv.index("/")
    print(
        "| a | elements of d0 | run-out / d0 | Lube | film | height / d0 | rest | volume | cost |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for aspect in map(float, sys.argv[1:split]):
        for elements in map(float, sys.argv[split + 1 :]):
            began = time.monotonic()
            found = collapse(aspect, elements)
            seconds = time.monotonic() - began
            print(
                f"| {aspect:g} | 1/{elements:g} | {found.run_out:.2f} | {lube_run_out(aspect):.2f} "
                f"| {found.film:.2f} | {found.height:.2f} | {found.rest:.2f} "
                f"| {found.volume_drift:.1e} | {found.steps} steps, {seconds:.0f} s |",
                flush=True,
            )


if __name__ == "__main__":
    main()
