"""Runs the verification suite on every registered mixing backend; writes docs/verification.md.

Every value of an option `form`, where a backend has one, is a row of its own. Figures go to
docs/figures/. `--backend NAME` (repeatable) runs some of them, `--output DIR` writes elsewhere.
"""

from __future__ import annotations

import argparse
import gc
import os
import platform
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter, NullLocator

from scaleup.space.flow_field import FlowField
from scaleup.system import registry
from scaleup.system.errors import InputError, RunError
from scaleup.verification import Problem, Result, fitted_order, problems, run
from scaleup.verification.random_walk import random_walks
from scaleup.verification.study import PARTS

DOCS = Path(__file__).resolve().parents[1] / "docs"
DRUM = "drum-layer"
SECTIONS = {"zalesak": (1, 0.75), "three-bodies": (0, 0.5)}  # which coordinate is held, and where

HEAD = """# Verification of the mixing backends

Written by `make tables`; nobody edits it by hand. Every registered mixing backend is run on the
problems of `scaleup.verification`, whose answers are known. Errors are those of the first
component, relative to the exact cell means: L1 = sum |c - exact| V / sum |exact| V, L2 likewise
with squares. The order is the slope of log L1 over log N by least squares over all sizes of the
table. Minimum and maximum are over all components and steps, before any clipping; [0, 1] is where
they should lie. Drift is the relative change of the component's volume. The variance ratio is the
second central moment over the exact one. Seconds are processor time of the transport alone after a
warm-up, on one core (the shortest of four runs where it takes less than 0.2 s).

A quarter turn of a round bed, and a whole turn of a ball, carry cells onto cells: a scheme whose
steps are that long has nothing to interpolate, and its error says nothing of it. On the problems of
rotation every backend is therefore asked for one seventh of the turn after another, none of whose
fractions carries a grid onto itself; elsewhere no such step exists. What a backend gains where its
steps do land cells on cells stands below such a problem's table, as an aside.

The flows are closed; their face fluxes are exact and free of divergence to round-off. Bodies with
jumps converge slower than order 1 whatever the scheme. `full-drum` and the sloshing beds are smooth
up to cut cells and a moving surface, where a scheme's treatment of those counts. In
`swirl-reversed` the way back undoes dispersive errors: judge schemes by the one-way problems.
"""


@dataclass
class Study:
    """One backend on one problem: results by ascending size, and why there are no more.

    aside -- results with steps that land cells on cells, if the backend would take such long ones
    """

    results: list[Result]
    aside: list[Result] = field(default_factory=list)
    reason: str = ""

    @property
    def order(self) -> str:
        """As written in tables; empty if there are too few sizes."""
        return f"{fitted_order(self.results):.2f}" if len(self.results) > 1 else ""


def backends(only: list[str]) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Label -> (plugin class, options)."""
    found: dict[str, tuple[Any, dict[str, Any]]] = {}
    for name in only or registry.available("mixing"):
        plugin = registry.load("mixing", name)
        forms = plugin.Options.model_fields.get("form")
        for form in get_args(forms.annotation) if forms else ():
            found[f"{name} ({form})"] = (plugin, {"form": form})
        if not forms:
            found[name] = (plugin, {})
    return found


def with_known_answers(problem: Problem) -> Problem:
    """The problem, with flows and answers kept: they take longer than most backends do."""

    def kept(answer: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
        known: dict[tuple[Any, ...], np.ndarray] = {}

        def answered(flow: FlowField, *time: float) -> np.ndarray:
            key = id(flow), *time  # flows are kept, so that none takes the place of another
            if key not in known:
                known[key] = answer(flow, *time)
            return known[key]

        return answered

    return replace(
        problem,
        flow=cache(problem.flow),
        initial=kept(problem.initial),
        exact=kept(problem.exact),
    )


def study(problem: Problem, plugin: Any, options: dict[str, Any]) -> Study:
    """Run a backend on all sizes of a problem, as far as it goes."""
    done = Study([])

    def measure(n: int, **parts: int) -> Result:
        return run(problem, plugin(plugin.Options(**options)), n, **parts)

    for n in problem.sizes:
        try:
            found = measure(n)
            done.results.append(found)
            if problem.landings and found.steps == PARTS:  # it would take longer ones
                done.aside.append(measure(n, parts=problem.landings))
        except InputError as error:
            done.reason = f"not available: {error}"
            break
        except RunError as error:
            done.reason = f"stopped at N = {n}: {error}"
            break
    return done


def summary(table: dict[str, dict[str, Study]]) -> str:
    """L1 at the finest size and the order: problems down, backends across."""
    labels = list(table)
    lines = [
        "## L1 at the largest N, and order\n",
        "| problem | N | " + " | ".join(labels) + " |",
        "|---|---|" + "---|" * len(labels),
    ]
    for name, problem in problems().items():
        cells = []
        for label in labels:
            done = table[label][name]
            if done.results and not done.reason:
                cells.append(f"{done.results[-1].l1:.2e} ({done.order})")
            else:
                cells.append(done.reason.partition(":")[0])
        lines.append(f"| `{name}` | {problem.sizes[-1]} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def section(problem: Problem, table: dict[str, dict[str, Study]]) -> str:
    """All figures of one problem."""
    lines = [
        f"## `{problem.name}`\n\n{problem.sentence} ({problem.dimension}-D, {problem.regime})\n",
        "| backend | N | cells | L1 | order | L2 | minimum | maximum | mass drift | variance ratio "
        "| steps | seconds | 10^6 updates/s |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    reasons = []
    for label, studies in table.items():
        done = studies[problem.name]
        if done.reason:
            reasons.append(f"{label}: {done.reason}.")
        for place, r in enumerate(done.results):
            ratio = "" if r.variance_ratio is None else f"{r.variance_ratio:.4f}"
            order = done.order if place == len(done.results) - 1 else ""
            lines.append(
                f"| {label} | {r.n} | {r.cells:,} | {r.l1:.3e} | {order} | {r.l2:.3e} "
                f"| {r.minimum:.4f} | {r.maximum:.4f} | {r.mass_drift:.1e} | {ratio} "
                f"| {r.steps:,} | {r.core_seconds:.2f} | {r.cell_updates_per_second / 1e6:.1f} |"
            )
    for label, studies in table.items():
        aside = studies[problem.name].aside
        if aside:
            errors = ", ".join(
                f"{r.l1:.1e} (N = {r.n}, {r.steps} step{'s' * (r.steps > 1)})" for r in aside
            )
            lines.append(f"\nAside, steps that land cells on cells: {label} L1 {errors}.")
    if problem.name == DRUM:
        lines.append("\n" + against_walks(table))
    return "\n".join(lines + [f"\n{reason}" for reason in reasons]) + "\n"


def against_walks(table: dict[str, dict[str, Study]]) -> str:
    """Segregation over the revolution, with the sampling error of the walks."""
    lines = ["| backend | N | greatest error of the intensity of segregation |", "|---|---|---|"]
    volumes = None
    for label, studies in table.items():
        for r in studies[DRUM].results:
            volumes = r.volumes
            lines.append(f"| {label} | {r.n} | {r.segregation_error:.4f} |")
    if volumes is not None:
        error = random_walks().sampling_error(volumes)
        lines.append(f"\nThe walks' own sampling error (L1, from two halves) is {error:.1e}.")
    return "\n".join(lines)


def dense(result: Result, values: np.ndarray) -> np.ndarray:
    """Values of the active cells on the whole grid, nan elsewhere."""
    whole = np.full(result.flow.grid.cells, np.nan)
    whole[result.interval.cells] = values
    return whole.reshape(result.flow.grid.shape)


def draw_end_states(table: dict[str, dict[str, Study]], name: str, path: Path) -> None:
    """End states of a plane problem at its second size, and a section through them."""
    size = problems()[name].sizes[1]
    ends = {
        label: next((r for r in studies[name].results if r.n == size), None)
        for label, studies in table.items()
    }
    shown = {label: result for label, result in ends.items() if result is not None}
    if not shown:
        return
    first = next(iter(shown.values()))
    grid = first.flow.grid
    panels = {"exact": first.exact[0]} | {k: r.concentration[0] for k, r in shown.items()}
    columns = len(panels)
    figure = plt.figure(figsize=(2.7 * columns + 0.6, 5.4), layout="constrained")
    layout = figure.add_gridspec(2, columns, height_ratios=(1.0, 0.8))
    x, y = grid.centres(0), grid.centres(1)
    held, at = SECTIONS[name]
    line = int(np.argmin(np.abs(grid.centres(held) - at)))
    across = figure.add_subplot(layout[1, :])
    maps, image = [], None
    for column, (label, values) in enumerate(panels.items()):
        picture = dense(first, values)
        axis = figure.add_subplot(layout[0, column])
        image = axis.pcolormesh(x, y, picture, vmin=-0.1, vmax=1.1, cmap="viridis", rasterized=True)
        axis.set(title=label, aspect="equal", xlim=(0, 1), ylim=(0, 1), xticks=[], yticks=[])
        axis.title.set_fontsize(9)
        maps.append(axis)
        values_on_line = picture[line] if held == 1 else picture[:, line]
        style = {"color": "black", "lw": 1.0} if column == 0 else {"lw": 1.2}
        across.plot(x if held == 1 else y, values_on_line, label=label, **style)
    along = "xy"[1 - held]
    across.set(xlabel=f"{along} at {'xy'[held]} = {at:g}", ylabel="concentration", xlim=(0, 1))
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    figure.colorbar(image, ax=maps, shrink=0.8, label="concentration")
    figure.suptitle(f"{name}, N = {size}", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def draw_convergence(table: dict[str, dict[str, Study]], against: str, path: Path) -> None:
    """L1 over an attribute of the results, one panel a problem."""
    names = [
        name
        for name in problems()
        if any(len(studies[name].results) > 1 for studies in table.values())
    ]
    columns = 4
    rows = -(-len(names) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(3.0 * columns, 2.5 * rows), squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes.flat, names, strict=False):
        for number, (label, studies) in enumerate(table.items()):
            results = studies[name].results
            axis.loglog(
                [getattr(r, against) for r in results],
                [r.l1 for r in results],
                "o-",
                ms=4,
                color=f"C{number}",
                label=label,
            )
        if against == "n":
            sizes = np.array(problems()[name].sizes)
            axis.set_xticks(sizes, [str(n) for n in sizes])
            axis.xaxis.set_minor_locator(NullLocator())
        axis.xaxis.set_minor_formatter(NullFormatter())
        low, high = axis.get_ylim()
        if high < 20 * low:  # one decade at least, so that slopes can be read
            middle = np.sqrt(low * high)
            axis.set_ylim(middle / np.sqrt(20), middle * np.sqrt(20))
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.grid(True, which="both", alpha=0.25)
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=9)
    figure.supxlabel("N" if against == "n" else "processor seconds of transport", fontsize=10)
    figure.supylabel("relative L1 error", fontsize=10)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Run everything, then write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", action="append", default=[], help="only this one; repeatable")
    parser.add_argument("--output", type=Path, default=DOCS)
    arguments = parser.parse_args()
    folder = arguments.output / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    table: dict[str, dict[str, Study]] = {}
    for name, problem in problems().items():
        known = with_known_answers(problem)
        for label, (plugin, options) in backends(arguments.backend).items():
            table.setdefault(label, {})[name] = done = study(known, plugin, options)
            errors = " ".join(f"{r.l1:.3g}" for r in done.results)
            print(f"{name:20s} {label:32s} {errors} {done.reason}", flush=True)
        del known
        gc.collect()  # flows of many intervals are large
    for name in SECTIONS:
        draw_end_states(table, name, folder / f"verification-{name}.png")
    draw_convergence(table, "n", folder / "verification-convergence.png")
    draw_convergence(table, "core_seconds", folder / "verification-cost.png")
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    figures = "\n".join(
        f"![{text}](figures/verification-{name}.png)\n"
        for name, text in (
            ("zalesak", "Zalesak's disc after one turn"),
            ("three-bodies", "LeVeque's three bodies after one turn"),
            ("convergence", "error over size"),
            ("cost", "error over seconds"),
        )
    )
    parts = [HEAD, f"Machine: {machine}; other load possible.\n", summary(table), figures]
    parts += [section(problem, table) for problem in problems().values()]
    (arguments.output / "verification.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
