"""Where a mixing backend is stable: what it states, and what is measured.

A uniform flow with uniform isotropic diffusion in a periodic box has, at a step dt, the Courant
number |v| dt/h, the cell diffusion number D dt/h^2 and the angle between flow and grid. On rays in
the plane of the first two, for several angles,

stated  -- the backend's own `stable_time_step`
growth  -- the longest step at which small noise does not grow: the norm of its deviation from the
           mean, between a third and the end of the run
bounds  -- the longest step at which random zeros and ones stay within [0, 1]; only for backends
           that keep bounds at all

are found, the last two by bisection on real runs of the backend, forced beyond its limit.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from scaleup.contract import MixingScene
from scaleup.mixing.scene import mixing_scene
from scaleup.space.flow_field import Axis, FlowField, interval_from_dense
from scaleup.space.grid import FloatArray, Grid
from scaleup.system.errors import RunError
from scaleup.system.files import write_text
from scaleup.verification.problem import uniform_diffusion

ANGLES = (0.0, 15.0, 30.0, 45.0)  # degrees
_RAYS = 9
_CELLS = 24  # along an edge of the box
_STEPS = 90
_FARTHEST = 8.0  # times the stated limit: beyond it a backend counts as stable for any step
_BISECTIONS = 7
_GROWS = 1.0 + 1e-4  # a step
_KEEPS_BOUNDS = 1e-9
_DIED_OUT = 1e-9  # noise of 1e-6 that has come down to what round-off or a solver leaves


@dataclass(frozen=True)
class Boundary:
    """Limits along one ray, as multiples of (courant, diffusion_number); inf: none was found.

    angle -- degrees; courant, diffusion_number -- the ray's direction, greatest of both 1
    stated, growth, bounds -- see above; bounds is None for a backend that leaves [0, 1] anyway
    """

    angle: float
    courant: float
    diffusion_number: float
    stated: float
    growth: float
    bounds: float | None


def map_stability(
    make: Callable[[float | None], Any],
    comm: Any,
    angles: Iterable[float] = ANGLES,
    rays: int = _RAYS,
    progress: Callable[[float, str], None] = lambda *_: None,
) -> list[Boundary]:
    """Boundaries of a backend; `make` constructs it with a time step (s) or with its own."""
    wanted = [(angle, share * math.pi / 2) for angle in angles for share in np.linspace(0, 1, rays)]
    found = []
    for number, (angle, turn) in enumerate(wanted):
        # a cell diffusion number of 1/4 limits as much as a Courant number of 1
        courant, diffusion_number = math.cos(turn), 0.25 * math.sin(turn)
        if courant < 1e-12:
            courant, angle = 0.0, 0.0
        largest = max(courant, diffusion_number)
        found.append(_boundary(make, comm, angle, courant / largest, diffusion_number / largest))
        progress((number + 1) / len(wanted), f"angle {angle:g} deg")
    return found


def maker(plugin: Any, options: Any) -> Callable[[float | None], Any]:
    """Constructs a backend with these options and a time step (s), or with none of its own."""
    return lambda step: plugin(options.model_copy(update={"time_step": step}))


def uniform_scene(
    backend: Any,
    courant: float,
    diffusion_number: float,
    angle: float,
    comm: Any,
    cells: int = _CELLS,
) -> MixingScene:
    """A uniform flow in a periodic box of unit cells with the given numbers for a step of 1 s.

    angle -- degrees between the flow and the x axis
    """
    grid = Grid((0.0, 0.0), (1.0, 1.0), (cells, cells), periodic=True)
    direction = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
    full, none = np.ones(grid.shape), np.zeros(grid.shape)
    faces = [np.full((cells, cells + 1), courant * direction[0])]
    faces.append(np.full((cells + 1, cells), courant * direction[1]))
    part = interval_from_dense(0.0, 1.0, grid, full, full, faces, none, np.stack([none, none]))
    flow = FlowField(grid, "lab", Axis(), 0.0, [part])
    laws = [uniform_diffusion(diffusion_number * np.eye(2))] if diffusion_number else []
    return mixing_scene(backend, flow, comm, laws, force=True)


def write_csv(path: Path, boundaries: list[Boundary]) -> None:
    """One row for each boundary."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(Boundary)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in boundaries)
    write_text(path, text.getvalue())


def grows(make: Callable[[float | None], Any], scene: MixingScene, step: float) -> bool:
    """Whether small noise grows when steps of `step` (s) are forced."""
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, scene.flow.grid.cells)
    start = 0.5 + 1e-6 * noise
    early = _after(make, scene, start, step, _STEPS // 3)
    late = _after(make, scene, start, step, _STEPS)
    if early is None or late is None:
        return True
    ratio = float(np.std(late)) / max(float(np.std(early)), _DIED_OUT)
    return ratio > _GROWS ** (_STEPS - _STEPS // 3)


def breaks_bounds(make: Callable[[float | None], Any], scene: MixingScene, step: float) -> bool:
    """Whether random zeros and ones leave [0, 1] when steps of `step` (s) are forced."""
    start = np.random.default_rng(0).integers(0, 2, scene.flow.grid.cells).astype(float)
    c = _after(make, scene, start, step, _STEPS // 3)
    return c is None or bool(max(-c.min(), c.max() - 1.0) > _KEEPS_BOUNDS)


def _after(
    make: Callable[[float | None], Any],
    scene: MixingScene,
    start: FloatArray,
    step: float,
    count: int,
) -> FloatArray | None:
    """Concentration after a number of forced steps; None if the backend stopped."""
    backend = make(step)
    backend.start(scene, np.stack([start, 1.0 - start]))
    try:
        backend.advance(0, 0.0, count * step)
        return np.asarray(backend.concentration(scene.flow.intervals[0])[0])
    except RunError:
        return None


def _boundary(
    make: Callable[[float | None], Any],
    comm: Any,
    angle: float,
    courant: float,
    diffusion_number: float,
) -> Boundary:
    backend = make(None)
    scene = uniform_scene(backend, courant, diffusion_number, angle, comm)
    half = np.full((2, scene.flow.grid.cells), 0.5)
    backend.start(scene, half)
    stated = float(backend.stable_time_step(scene.flow.intervals[0]))
    scale = stated if math.isfinite(stated) else 1.0
    bounded = not breaks_bounds(make, scene, 0.5 * scale)
    return Boundary(
        angle=angle,
        courant=courant,
        diffusion_number=diffusion_number,
        stated=stated,
        growth=_longest(lambda step: grows(make, scene, step), scale),
        bounds=_longest(lambda step: breaks_bounds(make, scene, step), scale) if bounded else None,
    )


def _longest(fails: Callable[[float], bool], scale: float) -> float:
    """Longest step that does not fail, by bisection between 0 and `_FARTHEST` scales, s."""
    low, high = 0.0, scale
    while not fails(high):
        low, high = high, 1.5 * high
        if high > _FARTHEST * scale:
            return math.inf
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if fails(middle) else (middle, high)
    return low
