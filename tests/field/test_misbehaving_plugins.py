"""A plugin that raises, ends the program or returns nonsense: one sentence that names it."""

import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from scaleup.case.composing import compose
from scaleup.command import cli
from scaleup.contract import Flow, Geometry, Ledger, Mixing, PluginOptions
from scaleup.flow.sample_flows import circulating_box
from scaleup.flow.source import obtain_flow
from scaleup.mixing.check import CheckedMixing
from scaleup.mixing.scene import mixing_scene
from scaleup.run import plugin_check
from scaleup.run.blending import mix
from scaleup.system import blame, registry
from scaleup.system.errors import (
    ContractError,
    InputError,
    PluginError,
    ScaleupError,
    UnforeseenError,
)
from scaleup.system.parallel import on_each


class Still(Mixing):
    """A backend that moves nothing, which no rule forbids."""

    class Options(PluginOptions):
        pass

    halo = 1

    def start(self, scene, concentration, index=0):
        self.c = concentration.copy()

    def stable_time_step(self, interval):
        return np.inf

    def advance(self, index, start, end):
        return Ledger(steps=1, minimum=0.0, maximum=1.0)

    def concentration(self, interval):
        return self.c


class Drifting(Still):
    def concentration(self, interval):
        return np.stack([0.9 * self.c[0], 1.0 - 0.9 * self.c[0]])


class Ringing(Still):
    def concentration(self, interval):
        ring = np.where(self.c[0] == self.c[0].max(), 0.2, -0.2)
        return self.c + np.stack([ring, -ring])


class Dividing(Still):
    def advance(self, index, start, end):
        return Ledger(steps=1 // 0)


class Leaving(Still):
    def __init__(self, options):
        sys.exit(0)


class Haloless(Still):
    halo = property(lambda self: self.layers)


class Underived:
    Options = Still.Options


class Loose(Still):
    Options = dict


class Unfinished(Mixing):
    Options = Still.Options


class Aimless(Flow):
    """A flow that returns no flow."""

    Options = Still.Options

    def solve(self, scene, comm, progress, memory):
        return {"speed": 1.0}


class Doubtful(Aimless):
    def check(self, geometry, speed):
        return {}["speed"]


class Astray(Aimless):
    __init__ = Leaving.__init__


class Crooked(registry.load("geometry", "drum")):
    """A geometry that fails at the corners of a grid, not when it is made."""

    def signed_distance(self, points):
        if points.ndim > 2:
            raise KeyError("corner")
        return super().signed_distance(points)


class Bottomless(Geometry):
    Options = Still.Options
    signed_distance = volume_below = None

    @staticmethod
    def default_scene(options):
        operation = {"speed": 1.0, "fill": {"volume_fraction": 0.4}}
        return {"operation": operation, "mixing": {"name": "lax-wendroff"}}


def returning(**values):
    return type("Returning", (Still,), {name: lambda *_, v=v: v for name, v in values.items()})


@pytest.fixture
def registered(monkeypatch):
    """Put a class of this module under its name in lower case, beside what is installed."""
    installed = registry.registered

    def register(kind, plugin):
        value, group = f"{__name__}:{plugin.__name__}", registry.GROUPS[kind]
        point = EntryPoint(plugin.__name__.lower(), value, group)
        point = point._for(SimpleNamespace(name="mine", version="1"))

        def found(group, path):
            return [*installed(group, path), *([point] if group == point.group else [])]

        monkeypatch.setattr(registry, "registered", found)
        return point.name

    return register


def config_with(kind, name):
    settings = ["grid.cells=600", "operation.revolutions=0.1", "diffusion.k1=0"]
    return compose(None, settings, {"flow": {"name": "surface-layer"}, kind: {"name": name}})


def blend(name):
    case = config_with("mixing", name)
    return mix(case, obtain_flow(case, MPI.COMM_SELF).flow, MPI.COMM_SELF)


@pytest.fixture(scope="module")
def scene():
    flow = circulating_box(2)
    return mixing_scene(Still(None), flow, MPI.COMM_SELF)


def test_a_law_that_a_backend_does_not_solve_is_refused_before_anything_is_computed(registered):
    name = registered("mixing", Still)
    with pytest.raises(InputError, match=f"mixing.name = '{name}': does not solve diffusion; it"):
        compose(None, [], {"mixing": {"name": name}})
    assert compose(None, ["diffusion.k1=0"], {"mixing": {"name": name}}).laws() == ()


HALVES = np.repeat([[1.0, 0.0], [0.0, 1.0]], 64, axis=1)


@pytest.mark.parametrize(
    ("concentration", "rule"),
    [
        (1.7 * HALVES, "the components sum to 1.7 in a cell"),
        (HALVES[:, 1:], r"is \(2, 127\), and must be an array \(2, 128\)"),
        (HALVES.astype(int), "holds int64, not real numbers"),
        (np.where(HALVES > 0, np.nan, 0.0), "not finite"),
        ([1.0], "the concentration is list"),
        (
            Ringing.concentration(SimpleNamespace(c=HALVES), None),
            r"from -0.2 to 1.2, and may leave",
        ),
        (Drifting.concentration(SimpleNamespace(c=HALVES), None), "component 1 went from"),
    ],
)
def test_what_a_backend_must_not_return_is_refused(scene, concentration, rule):
    plugin = returning(concentration=concentration)
    checked = CheckedMixing(plugin(None))
    checked.start(scene, HALVES)
    with pytest.raises(ContractError, match=rule):
        checked.concentration(scene.flow.intervals[0], 0.0)


@pytest.mark.parametrize(
    ("ledger", "rule"),
    [
        (None, "advance returned NoneType"),
        (Ledger(clipped=np.nan), "ledger.clipped = nan: must be a number"),
        (Ledger(step_share=-1.0), "ledger.step_share = -1.0: must be finite, not negative"),
        (Ledger(minimum=-0.5, maximum=1.0), "runs from -0.5 to 1"),
    ],
)
def test_a_ledger_that_cannot_be_is_refused(scene, ledger, rule):
    checked = CheckedMixing(returning(advance=ledger)(None))
    checked.start(scene, HALVES)
    with pytest.raises(ContractError, match=rule):
        checked.advance(0, 0.0, 0.1)


def test_a_backend_is_held_to_what_it_states(scene):
    stated = type("Stated", (Drifting,), {"conservative": False})
    ringing = type("RingingAsStated", (Ringing,), {"overshoot": 0.25})
    for plugin in (stated, ringing):
        checked = CheckedMixing(plugin(None))
        checked.start(scene, HALVES)
        checked.concentration(scene.flow.intervals[0], 0.0)
    with pytest.raises(ContractError, match="component 1 went"):
        plugin_check.check_mixing(Drifting(None), scene, HALVES, 0.1)


@pytest.mark.parametrize(
    ("plugin", "error", "sentence"),
    [
        (Drifting, ContractError, "broke its contract: component 1 went from"),
        (Dividing, UnforeseenError, r"ZeroDivisionError: .*test_misbehaving_plugins.py, line "),
        (Leaving, UnforeseenError, "failed with SystemExit: 0 "),
        (Haloless, UnforeseenError, "no attribute 'layers'"),
        (Underived, PluginError, "is no class derived from scaleup.contract.Mixing"),
        (Aimless, PluginError, "is no class derived from scaleup.contract.Mixing"),
        (Loose, PluginError, "has no class Options derived from scaleup.contract.PluginOptions"),
        (Unfinished, PluginError, "does not define advance, concentration, stable_time_step, st"),
    ],
)
def test_a_run_names_the_mixing_backend_that_fails(store, registered, plugin, error, sentence):
    name = registered("mixing", plugin)
    with pytest.raises(error, match=f"{name}' of the distribution mine 1 .*{sentence}"):
        blend(name)


@pytest.mark.parametrize(
    ("plugin", "sentence"),
    [
        (Aimless, "broke its contract: solve returned dict, and must a FlowField"),
        (Doubtful, "failed with KeyError: 'speed'"),
        (Astray, "failed with SystemExit: 0"),
    ],
)
def test_a_run_names_the_flow_that_fails(store, registered, plugin, sentence):
    name = registered("flow", plugin)
    with pytest.raises(
        ScaleupError, match=f"the flow '{name}' of the distribution mine 1.*{sentence}"
    ):
        obtain_flow(config_with("flow", name), MPI.COMM_SELF)


def test_a_geometry_is_named_wherever_it_fails(store, registered):
    """Asked by a flow or its check, deep in their work: the traceback tells whose line it was."""
    name = registered("geometry", Crooked)
    with pytest.raises(UnforeseenError, match=r"the geometry 'crooked' .*KeyError: 'corner'"):
        obtain_flow(config_with("geometry", name), MPI.COMM_SELF)
    name = registered("geometry", Bottomless)
    with pytest.raises(UnforeseenError, match=r"'bottomless' .* has no attribute 'volume'"):
        config_with("geometry", name)


def test_plugins_check_reports_them(registered):
    for kind, plugin, sentence in (
        ("mixing", Drifting, "component 1 went from"),
        ("mixing", Leaving, "SystemExit"),
        ("flow", Doubtful, "KeyError"),
        ("geometry", Leaving, "is no class derived from scaleup.contract.Geometry"),
    ):
        name = registered(kind, plugin)
        found = list(plugin_check.check_plugin(kind, name, [], MPI.COMM_SELF))
        failed = [finding.sentence for finding in found if finding.outcome == "FAIL"]
        assert failed, found
        assert all(sentence in each for each in failed), failed


def test_an_error_of_our_own_is_said_to_be_ours():
    def work():
        raise ZeroDivisionError("by design")

    with pytest.raises(ScaleupError, match="unexpected ZeroDivisionError: by design"):
        on_each(MPI.COMM_SELF, work)
    assert isinstance(blame.told(OSError(28, "No space left on device", "x")), ScaleupError)


def test_a_plugin_that_ends_the_program_on_import_does_not(monkeypatch, tmp_path):
    (tmp_path / "leaving_at_once.py").write_text("import sys\nsys.exit(0)\n")
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("gone", "leaving_at_once:Gone", registry.GROUPS["mixing"])
    monkeypatch.setattr(registry, "registered", lambda group, path: [point])
    with pytest.raises(PluginError, match=r"'gone' .* cannot be imported \(SystemExit: 0\)"):
        registry.load("mixing", "gone")


@pytest.mark.parametrize("debug", [True, False])
def test_a_traceback_is_shown_when_asked_for(monkeypatch, capsys, debug):
    monkeypatch.setattr(cli, "_kinds_of", lambda name: [1 // 0])
    given = ["--debug"] if debug else []
    monkeypatch.setattr(sys, "argv", ["scaleup", *given, "plugins", "show", "drum"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 1
    shown = capsys.readouterr().err
    assert ("Traceback" in shown) == debug
    assert "Error: unexpected ZeroDivisionError" in shown.splitlines()[-1]


PLUGIN = """
from scaleup.contract import Mixing, PluginOptions

class Alone(Mixing):
    class Options(PluginOptions):
        pass
    halo = 1
    def start(self, scene, concentration, index=0):
        if scene.decomposition.comm.rank == 1:
            raise ZeroDivisionError("on one rank")
        scene.decomposition.total(1.0)  # where the others wait
    advance = concentration = stable_time_step = start
"""


def test_a_rank_that_fails_alone_says_so_and_ends_all(store, tmp_path):
    info = tmp_path / "site" / "lonely-2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lonely\nVersion: 2\n")
    (info / "entry_points.txt").write_text("[scaleup.mixing]\nalone = lonely:Alone\n")
    (info.parent / "lonely.py").write_text(PLUGIN)
    path = os.pathsep.join([str(info.parent), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "scaleup", "simulate", "--flow", "surface-layer", "--mixing",
         "alone", "--set", "grid.cells=600", "--set", "diffusion.k1=0", "--output", "run",
        "--ranks", "2"],
        capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 1
    sentences = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert len(sentences) == 1
    assert "the mixing 'alone' of the distribution lonely 2 failed with Zero" in sentences[0]
    assert "Traceback" not in done.stderr
