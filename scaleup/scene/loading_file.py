"""Concentrations at points, read from a file that a loading names."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import numpy as np

from scaleup.space.grid import FloatArray
from scaleup.system.errors import InputError
from scaleup.system.tables import read_table

_SUM = 1e-3  # by which concentrations at a point may miss 1; they are then scaled
_AXES = ("x", "y", "z")
_NAME = "concentration"


def read_loading(file: Path, dimension: int) -> tuple[FloatArray, FloatArray]:
    """Points (n, dimension) in m and concentrations (components, n) that sum to 1 at each.

    A file that gives one component leaves the rest to a second one. Raises InputError if the file
    cannot be read or its concentrations cannot be.
    """
    where = f"operation.loading.file = {str(file)!r}"
    readers = {".csv": _from_csv, ".h5": _from_results, ".hdf5": _from_results}
    try:
        points, columns = readers.get(file.suffix.lower(), _from_meshio)(file, dimension)
    except (Exception, SystemExit) as error:  # the readers raise whatever their parsers do
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be read ({reason})") from error
    if not columns:
        raise InputError(f"{where}: holds no concentrations")
    concentration = np.stack(columns)
    known = np.isfinite(concentration).all(axis=0) & np.isfinite(points).all(axis=1)
    points, concentration = points[known], concentration[:, known]
    if len(points) == 0:
        raise InputError(f"{where}: holds no point with a concentration")
    if concentration.min() < -_SUM or concentration.max() > 1 + _SUM:
        raise InputError(
            f"{where}: concentrations must lie between 0 and 1; they run from "
            f"{concentration.min():.4g} to {concentration.max():.4g}"
        )
    concentration = np.clip(concentration, 0.0, 1.0)
    if len(concentration) == 1:
        concentration = np.vstack([concentration, 1.0 - concentration])
    total = concentration.sum(axis=0)
    if np.abs(total - 1.0).max() > _SUM:
        raise InputError(
            f"{where}: the concentrations at a point must sum to 1; one sum is "
            f"{total[np.abs(total - 1.0).argmax()]:.4g}"
        )
    return points, concentration / total


def _from_csv(file: Path, dimension: int) -> tuple[FloatArray, list[FloatArray]]:
    """Columns named in the first line: x, y, z, and any others are concentrations."""
    heads, entries = read_table(file)
    names = [name.lower() for name in heads]
    missing = [axis for axis in _AXES[:dimension] if axis not in names]
    if missing:
        raise ValueError(f"the first line names no column {', '.join(missing)}")
    rows = np.array([[float(entry) for entry in row] for row in entries])
    points = rows[:, [names.index(axis) for axis in _AXES[:dimension]]]
    return points, [rows[:, k] for k, name in enumerate(names) if name not in _AXES]


def _from_results(file: Path, dimension: int) -> tuple[FloatArray, list[FloatArray]]:
    """The last snapshot of a run's results.h5."""
    import h5py

    with h5py.File(file, "r") as data:
        stored = data["grid"].attrs
        group = data["snapshots"][max(data["snapshots"])]
        fields = [np.asarray(group[name]) for name in sorted(group) if name.startswith(_NAME)]
        lower, spacing, counts = (np.array(stored[key]) for key in ("lower", "spacing", "counts"))
    if len(counts) != dimension:
        raise ValueError(f"its grid has {len(counts)} dimensions, the vessel {dimension}")
    lines = [
        low + h * (np.arange(n) + 0.5) for low, h, n in zip(lower, spacing, counts, strict=True)
    ]
    mesh = np.meshgrid(*reversed(lines), indexing="ij")
    points = np.stack([axis.ravel() for axis in reversed(mesh)], axis=-1)
    return points, [values.ravel().astype(float) for values in fields]


def _from_meshio(file: Path, dimension: int) -> tuple[FloatArray, list[FloatArray]]:
    """Fields named concentration... on points, else on cells (at their centres)."""
    import meshio

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        mesh = meshio.read(file)
    points = np.asarray(mesh.points, dtype=float)[:, :dimension]
    on_points = [np.ravel(mesh.point_data[name]) for name in _named(mesh.point_data)]
    if on_points:
        return points, on_points
    centres = [points[np.asarray(block.data)].mean(axis=1) for block in mesh.cells]
    on_cells = [np.concatenate(mesh.cell_data[name]).ravel() for name in _named(mesh.cell_data)]
    return np.concatenate(centres), on_cells


def _named(fields: object) -> list[str]:
    assert isinstance(fields, dict)
    return sorted(name for name in fields if name.startswith(_NAME))
