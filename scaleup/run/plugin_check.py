"""The contract tests of an installed plugin: `scaleup plugins check`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from scaleup.case.case import Case
from scaleup.case.composing import compose
from scaleup.flow.sample_flows import circulating_box, rocking_box
from scaleup.flow.source import FlowOutcome, obtain_flow
from scaleup.mixing.scene import mixing_scene
from scaleup.run.blending import mix
from scaleup.scene.models import Diffusion
from scaleup.scene.shear_diffusion import shear_diffusion
from scaleup.space.flow_field import FlowField
from scaleup.system import registry
from scaleup.system.blame import told
from scaleup.system.errors import InputError, ScaleupError
from scaleup.system.registry import Kind
from scaleup.testing import check_mixing, geometry_checks

_SMOKE_CELLS, _SMOKE_REVOLUTIONS = 4000.0, 0.1
_CELLS_ACROSS = 2.0  # the thinnest part of a vessel
_GRAIN, _SMOKE_TIME = 1e-3, 0.3  # m, s, of the small flows
_INTENSITY = 1.05  # above which a segregation intensity cannot be, rounding and overshoot apart


@dataclass(frozen=True)
class Finding:
    """What came of one check: its title, and a sentence if it failed or was not made."""

    outcome: Literal["ok", "FAIL", "skip"]
    title: str
    sentence: str = ""

    def __str__(self) -> str:
        return f"{self.outcome:4s} {self.title}" + (f": {self.sentence}" if self.sentence else "")


def check_plugin(kind: Kind, name: str, assignments: Sequence[str], comm: Any) -> Iterator[Finding]:
    """Check a plugin of a kind, with `section.key=value` settings; yields as checks are made."""
    checks = {"geometry": _check_geometry, "flow": _check_flow, "mixing": _check_mixing}
    yield from checks[kind](name, assignments, comm)


def _check_geometry(name: str, assignments: Sequence[str], comm: Any) -> Iterator[Finding]:
    flags = {"geometry": {"name": name}}
    try:
        case = compose(None, assignments, flags, flow_must_accept=False)
        geometry = case.geometry
    except (Exception, SystemExit) as error:
        yield Finding("FAIL", "it is made with its default scene", str(told(error)))
        return
    yield Finding("ok", "it is made with its default scene")
    flow, failed = case.name("flow"), False
    for title, check in geometry_checks(geometry):
        finding = _tried(title, check)
        failed |= finding.outcome == "FAIL"
        yield finding
    if failed:  # compiled loops trust the box and the distances: a flow could crash on them
        yield Finding("skip", f"the flow {flow!r} solves it", "first mend what failed above")
        return
    try:
        case.flow.check(geometry, case.operation.speed)
    except InputError as refusal:
        yield Finding("skip", f"the flow {flow!r} solves it", str(refusal))
        return
    smoke = compose(None, [*assignments, *_small(case)], flags)
    yield from _smoke_run(smoke, comm)


def _check_flow(name: str, assignments: Sequence[str], comm: Any) -> Iterator[Finding]:
    """On the geometry that the settings name, else on the first one that the flow accepts."""
    given = any(text.replace(" ", "").startswith("geometry.name=") for text in assignments)
    refusals = []
    for geometry in [None] if given else registry.available("geometry"):
        flags: dict[str, Any] = {"flow": {"name": name}}
        if geometry is not None:
            flags["geometry"] = {"name": geometry}
        try:
            case = compose(None, assignments, flags)
        except ScaleupError as error:
            refusals.append(str(error))
            continue
        chosen = case.name("geometry")
        yield Finding("ok", f"it accepts the geometry {chosen!r}")
        smoke = compose(None, [*assignments, *_small(case)], flags)
        yield from _smoke_run(smoke, comm)
        return
    yield Finding("FAIL", "it accepts an installed geometry", refusals[0] if refusals else "")


def _check_mixing(name: str, assignments: Sequence[str], comm: Any) -> Iterator[Finding]:
    """On small flows, steady and with a moving fill, in the plane and in space."""
    try:
        flags = {"mixing": {"name": name}, "diffusion": {"k1": 0.0}}  # a law it may not solve
        options = compose(None, assignments, flags, flow_must_accept=False).options("mixing")
    except ScaleupError as error:
        yield Finding("FAIL", "it is made with its default options", str(error))
        return
    plugin = registry.load("mixing", name)
    makers: Mapping[str, Callable[[int], FlowField]] = {
        "a steady flow": circulating_box,
        "a moving fill": rocking_box,
    }
    refused = 0
    for dimension in (2, 3):
        for title, make in makers.items():
            work = partial(_mix_small, plugin, options, make(dimension), comm)
            finding = _tried(f"{title} in {dimension}-D: sums to 1, keeps a uniform blend", work)
            refused += finding.outcome == "skip"
            yield finding
    if refused == 2 * len(makers):
        yield Finding("FAIL", "it accepts one of these flows or more")


def _mix_small(plugin: Any, options: Any, flow: FlowField, comm: Any) -> None:
    backend, first = plugin(options), flow.intervals[0]
    law = shear_diffusion(Diffusion(), _GRAIN)
    laws = [law] if type(law) in plugin.laws else []
    scene = mixing_scene(backend, flow, comm, laws)
    left = flow.grid.centre_points(first.cells)[:, 0] < flow.grid.centres(0).mean()
    concentration = np.stack([left, ~left]).astype(float)
    check_mixing(backend, scene, concentration, _SMOKE_TIME)


def _smoke_run(case: Case, comm: Any) -> Iterator[Finding]:
    """A short, coarse run: the flow keeps its invariants, and mixing on it its bounds."""
    found: list[FlowOutcome] = []
    flow = case.name("flow")
    yield _tried(
        f"the flow {flow!r} solves {case.name('geometry')!r} and keeps its invariants",
        lambda: found.append(obtain_flow(case, comm)),
    )
    if found:
        title = f"the mixing {case.name('mixing')!r} blends on it"
        yield _tried(title, partial(_blend, case, found[0], comm))


def _blend(case: Case, outcome: FlowOutcome, comm: Any) -> None:
    intensity = mix(case, outcome.flow, comm).intensity
    if not all(0 <= value <= _INTENSITY for value in intensity):
        raise ScaleupError(f"the segregation intensity runs to {max(intensity):.3g}; it is 0 to 1")


def _small(case: Case) -> list[str]:
    """Settings that make a run short and coarse, but for what the vessel needs."""
    geometry, volume = case.geometry, case.fill_volume
    if geometry.dimension == 2:
        spacing = math.sqrt(volume / geometry.depth / _SMOKE_CELLS)
    else:
        spacing = (volume / _SMOKE_CELLS) ** (1 / 3)
    spacing = min(spacing, geometry.thinnest / _CELLS_ACROSS)
    return [f"grid.spacing={spacing!r}", f"operation.revolutions={_SMOKE_REVOLUTIONS}"]


def _tried(title: str, check: Callable[[], object]) -> Finding:
    """A plugin's InputError is a refusal of this scene; any other error is a failure."""
    try:
        check()
    except InputError as refusal:
        return Finding("skip", title, str(refusal))
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        return Finding("FAIL", title, str(told(error)))
    return Finding("ok", title)
