"""Runs side by side: `scaleup compare`."""

from __future__ import annotations

import csv
import io
import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scaleup.case.composing import compose
from scaleup.measure.sampling import samples_of
from scaleup.report import bed_figures, figures
from scaleup.report.bed_view import wall_of
from scaleup.report.results import Results
from scaleup.system.errors import InputError
from scaleup.system.files import write_text

_MARKS = (1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # revolutions that all runs are read at
_FIGURES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("active cells", ("grid", "active_cells")),
    ("Froude number", ("operation", "froude_number")),
    ("surface angle, deg", ("flow", "surface_angle_deg")),
    ("surface speed, m/s", ("flow", "surface_speed_max")),
    ("active layer, m", ("flow", "active_layer_thickness")),
    ("blended after, rev", ("mixing", "blend_time_revolutions")),
    ("decay of I, 1/rev", ("mixing", "decay_rate_per_revolution")),
    ("change of I on 2x cells", ("error_estimate", "segregation_intensity")),
    ("mass drift", ("ledger", "mass_drift")),
    ("time, s", ("timing", "total_s")),
    ("ranks", ("timing", "ranks")),
)


@dataclass(frozen=True)
class Run:
    """A finished run: its folder, its report.json and its settings as `section.key` to value."""

    folder: Path
    report: Mapping[str, Any]
    settings: Mapping[str, Any]

    @property
    def name(self) -> str:
        """What it is called in tables and legends."""
        return self.folder.resolve().name


def read_run(folder: Path) -> Run:
    """Read a run folder. Raises InputError if it holds no finished run."""
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        tables = tomllib.loads((folder / "config.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: is not a finished run ({error})") from error
    return Run(folder, report, dict(_flattened(tables)))


def compare(folders: Sequence[Path], output: Path) -> str:
    """Write comparison.csv, curves.png and beds.png to `output`; returns the table as text.

    The table holds the settings in which the runs differ, then what came of them.
    """
    runs = [read_run(folder) for folder in folders]
    rows = [["", *_names(runs)], *_differences(runs), *_outcomes(runs)]
    output.mkdir(parents=True, exist_ok=True)
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    write_text(output / "comparison.csv", stream.getvalue())
    curves = [(name, run.report["mixing"]) for name, run in zip(_names(runs), runs, strict=True)]
    figures.blend_curves(output / "curves.png", curves)
    beds = []
    for name, run in zip(_names(runs), runs, strict=True):
        stored = Results.open(run.folder)
        geometry = compose(run.folder / "config.toml").geometry
        last = stored.picture(stored.revolutions()[-1], "snapshots")
        beds.append((name, last, wall_of(geometry)))
    bed_figures.beds(output / "beds.png", beds)
    return _text(rows)


def _names(runs: Sequence[Run]) -> list[str]:
    """Folder names, longer where two are alike."""
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        names = [str(run.folder) for run in runs]
    return names


def _differences(runs: Sequence[Run]) -> list[list[str]]:
    keys = sorted(set().union(*(run.settings for run in runs)))
    rows = []
    for key in keys:
        values = [run.settings.get(key) for run in runs]
        if any(value != values[0] for value in values[1:]):
            rows.append([key, *(_shown(value) for value in values)])
    return rows


def _outcomes(runs: Sequence[Run]) -> list[list[str]]:
    rows = []
    last = min(run.report["mixing"]["revolutions"][-1] for run in runs)
    for mark in sorted({mark for mark in _MARKS if mark <= last} | {last}):
        rows.append([f"I after {mark:g} rev", *(_shown(_intensity(run, mark)) for run in runs)])
    for title, (section, key) in _FIGURES:
        rows.append([title, *(_shown(run.report[section].get(key)) for run in runs)])
    rows.append(["measured on", *(samples_of(run.report["mixing"]) for run in runs)])
    rows.append(["warnings", *(str(len(run.report["warnings"])) for run in runs)])
    return rows


def _intensity(run: Run, revolution: float) -> float | None:
    """I at a revolution, linear between the points of the curve."""
    at, values = run.report["mixing"]["revolutions"], run.report["mixing"]["segregation_intensity"]
    for n in range(1, len(at)):
        if at[n] >= revolution - 1e-9:
            share = (revolution - at[n - 1]) / (at[n] - at[n - 1])
            return float(values[n - 1] + share * (values[n] - values[n - 1]))
    return None


def _flattened(tables: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    found = []
    for key, value in tables.items():
        if isinstance(value, Mapping):
            found += _flattened(value, f"{prefix}{key}.")
        else:
            found.append((prefix + key, value))
    return found


def _shown(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, str):  # a quantity, such as "0.41887902047863906 rad/s"
        number, space, unit = value.partition(" ")
        try:
            return f"{float(number):.6g}{space}{unit}"
        except ValueError:
            return value
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _text(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [f"{row[0]:{widths[0]}}"]
        cells += [f"{cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
