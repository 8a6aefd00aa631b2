"""The command line: parsing and printing only."""

from __future__ import annotations

import inspect
import json
import logging
import sys
import textwrap
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

import scaleup
from scaleup.case.case import Case
from scaleup.case.composing import compose, plugin_options
from scaleup.case.config import PLUGIN_SECTIONS
from scaleup.case.forms import options_by_form
from scaleup.command.material import material
from scaleup.system import registry
from scaleup.system.blame import told
from scaleup.system.errors import InputError, ScaleupError, shown
from scaleup.system.launch import check_ranks, is_root, launched_size, relaunch_if_needed
from scaleup.system.registry import Kind

log = logging.getLogger("scaleup")

_SHOWN_REVOLUTIONS = (0, 1, 2, 3, 5, 10, 20, 50, 100)
_shows_tracebacks = False  # --debug


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(scaleup.__version__, prog_name="scaleup")
@click.option("--debug", is_flag=True, help="Show where an error arose (a traceback).")
def cli(debug: bool) -> None:
    """Predict how powders blend in rotating blenders."""
    global _shows_tracebacks
    _shows_tracebacks = debug


cli.add_command(material)

all_ranks_option = click.option(
    "--all-ranks",
    is_flag=True,
    help="Mix on all ranks, those too for which the machine has no free core.",
)


def scene_options(command: Callable[..., None]) -> Callable[..., None]:
    """The arguments and options that say what is run."""
    for decorate in reversed(
        (
            click.argument("config", required=False, type=click.Path(path_type=Path)),
            click.option("--geometry", help="Blender to use, such as drum."),
            click.option("--flow", help="Flow model."),
            click.option("--mixing", help="Mixing backend."),
            click.option("--ranks", type=int, help="Number of MPI ranks."),
            click.option("--revolutions", help="How many revolutions to blend."),
            click.option("--tolerance", help="Wanted error of the segregation intensity."),
            click.option(
                "--set", "assignments", multiple=True, metavar="SECTION.KEY=VALUE",
                help="Set any key.",
            ),
        )
    ):  # fmt: skip
        command = decorate(command)
    return command


def _scene(
    config: Path | None,
    geometry: str | None,
    flow: str | None,
    mixing: str | None,
    revolutions: str | None,
    tolerance: str | None,
    assignments: Sequence[str],
    animate: bool = False,
) -> Case:
    """The case that the arguments of `scene_options` make."""
    flags: dict[str, Any] = {
        section: {"name": name}
        for section, name in (("geometry", geometry), ("flow", flow), ("mixing", mixing))
        if name
    }
    if revolutions is not None:
        flags["operation"] = {"revolutions": _number("--revolutions", revolutions)}
    if tolerance is not None:
        flags["accuracy"] = {"tolerance": _number("--tolerance", tolerance)}
    if animate:
        flags["output"] = {"animate": "first"}
    return compose(config, assignments, flags)


@cli.command()
@scene_options
@click.option("--output", type=click.Path(path_type=Path), help="Run folder [runs/NAME-TIME].")
@click.option("--overwrite", is_flag=True, help="Replace a run that is there already.")
@click.option("--force", is_flag=True, help="Allow mixing steps beyond the limit of stability.")
@click.option("--animate", is_flag=True, help="Animate the first revolution (GIF).")
@all_ranks_option
def simulate(
    ranks: int | None,
    output: Path | None,
    overwrite: bool,
    force: bool,
    all_ranks: bool,
    **scene: Any,
) -> None:
    """Blend a powder: flow, mixing, metrics and report.

    CONFIG is a TOML file; --set and the flags take precedence over it.
    """
    check_ranks(ranks)
    run_case = _scene(**scene)
    from scaleup.run.output_folder import real_folder

    folder = real_folder(
        output or Path("runs") / f"{run_case.name('geometry')}-{time.strftime('%Y%m%d-%H%M%S')}"
    )
    if launched_size() == 1:
        from scaleup.flow.storage import Store
        from scaleup.run.output_folder import check_output

        check_output(folder, overwrite=overwrite, resume=False)
        Store().check()
        if output is None:  # all ranks must agree on the folder's name
            sys.argv += ["--output", str(folder)]
    relaunch_if_needed(ranks)
    _run(run_case, folder, overwrite=overwrite, force=force, all_ranks=all_ranks)


@cli.command()
@scene_options
@click.option("--output", type=click.Path(path_type=Path), help="Run folder [runs/NAME-TIME].")
@click.option("--overwrite", is_flag=True, help="Replace a run that is there already.")
def particles(ranks: int | None, output: Path | None, overwrite: bool, **scene: Any) -> None:
    """Compute the same scene with grains (LIGGGHTS); takes what simulate takes.

    The grains are those of the table [particles]. --ranks is the engine's.
    """
    check_ranks(ranks)
    case = _scene(**scene)
    from scaleup.run.output_folder import real_folder

    name = f"{case.name('geometry')}-particles-{time.strftime('%Y%m%d-%H%M%S')}"
    folder = real_folder(output or Path("runs") / name)
    _run_particles(case, folder, ranks, overwrite=overwrite)


@cli.command()
@scene_options
@click.option("--measure", is_flag=True, help="Time the scene on small grids first.")
def plan(ranks: int | None, measure: bool, **scene: Any) -> None:
    """Say what a run would model, why, and what it would cost; takes what simulate takes."""
    check_ranks(ranks)
    run_case = _scene(**scene)
    from scaleup.run import planner
    from scaleup.system import parallel

    if measure:
        comm = parallel.start()
        _log_to_terminal(comm.rank == 0)
        planner.measure(run_case, comm)
    for what, how in planner.plan(run_case, ranks or 1):
        click.echo(f"{what:20s} {how}")


@cli.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--ranks", type=int, help="Number of MPI ranks.")
@click.option("--revolutions", help="How many revolutions to blend in all, more than before.")
@click.option("--force", is_flag=True, help="Allow mixing steps beyond the limit of stability.")
@click.option("--changed-code", is_flag=True, help="Go on although the code has changed.")
@all_ranks_option
def resume(folder: Path, ranks: int | None, revolutions: str | None, **how: bool) -> None:
    """Go on with a run that was ended, or is finished; FOLDER is what --output was.

    A finished run goes on to more --revolutions and is replaced when those are complete.
    """
    from scaleup.run.output_folder import (
        begun_configuration,
        check_output,
        holds_grains,
        real_folder,
    )

    check_ranks(ranks)
    folder = real_folder(folder)
    if launched_size() == 1:
        extend = revolutions is not None
        check_output(folder, overwrite=False, resume=True, extend=extend)
    flags: dict[str, Any] = {}
    if revolutions is not None:
        flags["operation"] = {"revolutions": _number("--revolutions", revolutions)}
    case = compose(begun_configuration(folder), flags=flags)
    if holds_grains(folder):
        _run_particles(case, folder, ranks, resume=True)
        return
    relaunch_if_needed(ranks)
    _run(case, folder, resume=True, **how)


@cli.command()
@click.argument("folder", type=click.Path(path_type=Path))
def report(folder: Path) -> None:
    """Make the figures and report.html of a finished run again; FOLDER is what --output was."""
    from scaleup.report.compile import redraw

    _log_to_terminal(True)
    redraw(folder)
    click.echo(f"report               {folder / 'report.html'}")


@cli.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("comparison"),
    show_default=True,
    help="Folder for CSV and PNG.",
)
def compare(folders: Sequence[Path], output: Path) -> None:
    """Put finished runs side by side: where they differ, and what came of it."""
    if len(folders) < 2:
        raise InputError(f"{folders[0]}: give two runs or more to compare")
    from scaleup.report import comparison

    click.echo(comparison.compare(folders, output))
    click.echo(f"\n{output / 'comparison.csv'}, curves.png, beds.png")


@cli.command()
@click.argument("backend", required=False)
@click.option(
    "--set", "assignments", multiple=True, metavar="mixing.KEY=VALUE", help="Set its options."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("stability"),
    show_default=True,
    help="Folder for CSV and PNG.",
)
def stability(backend: str | None, assignments: Sequence[str], output: Path) -> None:
    """Draw where a mixing backend is stable: stated limit against measured growth.

    BACKEND is an installed mixing backend; without it all are drawn.
    """
    names = [backend] if backend else list(registry.available("mixing"))
    chosen = {name: plugin_options("mixing", name, assignments) for name in names}
    for name, options in chosen.items():
        if "time_step" not in type(options).model_fields:
            raise InputError(
                f"BACKEND = {name!r}: has no option time_step, so that it cannot be driven beyond "
                "its limit"
            )
    from scaleup.system import parallel

    comm = parallel.start()
    from scaleup.report import figures
    from scaleup.system.progress import Reporter
    from scaleup.verification import stability_map

    _log_to_terminal(True)
    output.mkdir(parents=True, exist_ok=True)
    for name, options in chosen.items():
        make = stability_map.maker(registry.load("mixing", name), options)
        with Reporter(f"stability of {name}", visible=True) as progress:
            boundaries = stability_map.map_stability(make, comm, progress=progress)
        stability_map.write_csv(output / f"{name}.csv", boundaries)
        figures.stability(output / f"{name}.png", name, boundaries)
        wrong = [b for b in boundaries if b.stated > b.growth * (1 + 1e-2)]
        click.echo(
            f"{name}: {len(boundaries)} rays, stated limit beyond the measured one on "
            f"{len(wrong)}; {output / name}.csv, .png"
        )


@cli.group()
def plugins() -> None:
    """What is installed."""


@plugins.command("list")
def list_plugins() -> None:
    """Names of the installed blenders, flow models and mixing backends."""
    for kind in PLUGIN_SECTIONS:
        click.echo(f"{kind}:")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            registry.warn_of_broken(kind)
        for name, point in registry.available(kind).items():
            click.echo(f"  {name:20s} {registry.distribution(point)}")
        for warning in caught:
            click.echo(f"Warning: {warning.message}", err=True)


@plugins.command("show")
@click.argument("name")
def show_plugin(name: str) -> None:
    """What a plugin is and its options, with units and defaults."""
    for kind in _kinds_of(name):
        plugin = registry.load(kind, name)
        click.echo(f"{kind} {name}")
        click.echo(_indented(plugin.__doc__))
        for title, fields in options_by_form(plugin):
            click.echo(title)
            for key, field in fields.items():
                default = "(required)" if field.is_required() else repr(field.default)
                click.echo(f"  {kind}.{key} = {default}")
                if field.description:
                    click.echo(f"      {' '.join(field.description.split())}")


@plugins.command("new")
@click.argument("name")
@click.option(
    "--kind",
    type=click.Choice(PLUGIN_SECTIONS),
    default="geometry",
    show_default=True,
    help="Of the plugin: a blender, a flow model or a mixing backend.",
)
def new_plugin(name: str, kind: Kind) -> None:
    """Make a plugin of your own: an installable distribution in ./NAME that runs as it is."""
    from scaleup.command.skeleton import make_skeleton

    folder = make_skeleton(name, Path(), kind)
    click.echo(
        f"{folder}/ holds a {kind} that runs. Next:\n"
        f"  {sys.executable} -m pip install -e {folder} --no-deps --no-build-isolation\n"
        f"  scaleup plugins check {name}\n"
        f"  scaleup simulate --{kind} {name}\n"
        f"and make {folder}/scaleup_{name.replace('-', '_')}/__init__.py your own"
    )


@plugins.command("check")
@click.argument("name")
@click.option(
    "--set", "assignments", multiple=True, metavar="SECTION.KEY=VALUE", help="Set any key."
)
def check_plugin_named(name: str, assignments: Sequence[str]) -> None:
    """Run the contract tests on an installed plugin, one line each; exit code 1 if one fails."""
    kinds = _kinds_of(name)
    from scaleup.system import parallel

    comm = parallel.start()
    from scaleup.run.plugin_check import check_plugin

    failed = 0
    for kind in kinds:
        for finding in check_plugin(kind, name, assignments, comm):
            click.echo(f"{finding}")
            sys.stdout.flush()
            failed += finding.outcome == "FAIL"
    if failed:
        raise ScaleupError(f"{failed} check(s) of {name!r} failed")


@cli.command()
@click.option("--ranks", type=int, default=2, show_default=True, help="Ranks of the hello.")
def doctor(ranks: int) -> None:
    """Check MPI, PETSc, NGSolve and HDF5, and let the ranks greet each other."""
    from scaleup.command.doctor import examine, greet

    check_ranks(ranks)
    if launched_size() > 1:
        greet()
        return
    healthy = True
    for line, good in examine():
        click.echo(f"{'ok  ' if good else 'FAIL'} {line}")
        healthy &= good
    sys.stdout.flush()
    if not healthy:
        raise ScaleupError("something is missing; see the lines marked FAIL")
    relaunch_if_needed(ranks)
    greet()


def main() -> None:
    """Entry point: an error is one sentence, without a traceback, on one of the ranks."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Abort:
        _complain("interrupted")
        sys.exit(130)
    except click.ClickException as error:
        _complain(str(InputError(error.format_message())))
        sys.exit(2)
    except (Exception, SystemExit) as error:
        if _shows_tracebacks:
            traceback.print_exception(error)
        failure = told(error)
        _fail(str(failure), failure.exit_code)


def _run(case: Case, folder: Path, **how: bool) -> None:
    from scaleup.system import parallel

    comm = parallel.start()
    from scaleup.run.pipeline import run

    _log_to_terminal(comm.rank == 0)
    run(case, folder, comm, **how)
    if comm.rank == 0 and (folder / "report.json").exists():
        _print_summary(folder)


def _run_particles(case: Case, folder: Path, ranks: int | None, **how: bool) -> None:
    from scaleup.particles.twin import run_particles

    if launched_size() > 1:
        raise InputError("scaleup particles starts the engine's ranks itself: give it --ranks N")
    _log_to_terminal(True)
    run_particles(case, folder, ranks or 1, **how)
    _print_summary(folder)


def _print_summary(folder: Path) -> None:
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    flow, mixing, timing = report["flow"], report["mixing"], report["timing"]
    angle, error = flow["surface_angle_deg"], flow.get("surface_angle_error_deg")
    if angle is not None:
        known = f" +- {error:.2f}" if error is not None else ""
        click.echo(f"surface angle        {angle:.2f}{known} deg")
    curve = zip(mixing["revolutions"], mixing["segregation_intensity"], strict=True)
    for revolution, value in curve:
        if revolution in _SHOWN_REVOLUTIONS or revolution == mixing["revolutions"][-1]:
            click.echo(f"I after {revolution:3g} rev      {value:.4f}")
    estimate = report["error_estimate"]["segregation_intensity"]
    if estimate is not None:
        click.echo(f"change on 2x cells   {estimate:.4f}")
    click.echo(f"mass drift           {report['ledger']['mass_drift']:.2e}")
    for sentence in report["warnings"]:
        click.echo(f"warning              {sentence}")
    if grains := report.get("particles"):
        click.echo(
            f"grains               {grains['count']} of {1e3 * grains['diameter']:.3g} mm, "
            f"{grains['particle_steps_per_core_s']:.3g} particle-steps per core-second on "
            f"{timing['ranks']} rank(s); total {timing['total_s']:.1f} s"
        )
        click.echo(f"report               {folder / 'report.html'}")
        return
    click.echo(
        f"time                 flow {timing['flow_s']:.1f} s, mixing {timing['mixing_s']:.1f} s "
        f"({timing['cell_updates_per_s']:.3g} cell updates/s on {timing['mixing_ranks']} rank(s)), "
        f"total {timing['total_s']:.1f} s"
    )
    click.echo(f"report               {folder / 'report.html'}")


def _log_to_terminal(root: bool) -> None:
    log.setLevel(logging.INFO)
    handler: logging.Handler = logging.StreamHandler() if root else logging.NullHandler()
    handler.setFormatter(logging.Formatter("%(message)s"))
    log.addHandler(handler)
    log.propagate = False


def _kinds_of(name: str) -> list[Kind]:
    """What kinds of plugins are registered under a name. Raises InputError if there are none."""
    found = [kind for kind in PLUGIN_SECTIONS if name in registry.available(kind)]
    if not found:
        known = [n for kind in PLUGIN_SECTIONS for n in registry.available(kind)]
        raise InputError(registry.unknown("NAME", name, "plugin", known))
    return found


def _number(key: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{key} = {shown(text)}: must be a number") from None


def _indented(text: str | None) -> str:
    return textwrap.indent(inspect.cleandoc(text or "(undocumented)"), "  ")


def _complain(sentence: str) -> None:
    if is_root():
        click.echo(f"Error: {sentence}", err=True)


def _fail(sentence: str, code: int) -> None:
    """Say once what all ranks failed at; a rank that fails alone says it, and ends the others."""
    parallel = sys.modules.get("scaleup.system.parallel")  # else MPI was not started
    if parallel is not None and not parallel.all_end():
        click.echo(f"Error: {sentence}", err=True)
        sys.stderr.flush()
        parallel.end_all(code)
    _complain(sentence)
    sys.exit(code)
