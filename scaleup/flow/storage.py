"""Files: stored flows and checkpoints.

HDF5 is written by the root, a flow by all ranks, through a temporary name, so that a reader, or a
run that is killed, never meets half a file. Datasets carry their SI unit, files their
`format_version`.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from scaleup.space.compact_intervals import CompactInterval, CompactIntervals, MirroredParts
from scaleup.space.flow_field import Axis, FlowField
from scaleup.space.grid import FloatArray, Grid, IntArray
from scaleup.system import hdf5, source_hash
from scaleup.system.errors import InputError
from scaleup.system.files import remove_leftovers, temporary_name
from scaleup.system.hdf5 import FORMAT_VERSION, DamagedFileError
from scaleup.system.parallel import on_each, on_root

log = logging.getLogger("scaleup")

_UNITS = {
    "cells": "1",
    "fill_start": "m^3",
    "fill_end": "m^3",
    "flux": "m^3/s",
    "shear_rate": "1/s",
    "direction": "1",
    "still": "1",
}


def content_hash(inputs: Mapping[str, Any], *plugins: type) -> str:
    """Hash of JSON-like inputs and of the code that turns them into a flow.

    The code is the source of the plugins' packages and of all of scaleup that a flow can depend on,
    so that a corrected blender or a mended cut cell never meets a flow of before.
    """
    code = source_hash.of_flow_code(*plugins)
    text = f"{json.dumps(inputs, sort_keys=True)} {code} {FORMAT_VERSION}"
    return hashlib.sha256(text.encode()).hexdigest()[:20]


class Store:
    """Expensive results kept between runs, found by the hash of all that they depend on."""

    def __init__(self, folder: Path | None = None):
        """`folder`: default $SCALEUP_CACHE, else ~/.cache/scaleup."""
        default = os.environ.get("SCALEUP_CACHE") or "~/.cache/scaleup"
        self.folder = Path(folder or default).expanduser()

    def path(self, kind: str, key: str) -> Path:
        """Where a result of a kind (`flow`, `part`) is kept."""
        return self.folder / f"{kind}-{key}.h5"

    def check(self) -> None:
        """Raise InputError if nothing can be kept here."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"SCALEUP_CACHE = {self.folder}: {error.strerror}") from error
        if not os.access(self.folder, os.W_OK):
            raise InputError(f"SCALEUP_CACHE = {self.folder}: nothing can be written there")

    def set_aside(self, path: Path, why: object) -> None:
        """Rename a result that is damaged, in place of an older such one, and say so."""
        aside = path.with_name(f"{path.name}.damaged")
        if aside.is_dir() and not aside.is_symlink():
            shutil.rmtree(aside)
        os.replace(path, aside)
        log.warning("store: %s; it was set aside as %s", why, aside.name)

    def memory_of(self, *plugins: type) -> PluginMemory:
        """What `scaleup.contract.Memory` promises, for a flow plugin on a geometry plugin."""
        return PluginMemory(self, *plugins)


class PluginMemory:
    """Arrays in a store, under the hash of the inputs and the plugins that they came from."""

    def __init__(self, store: Store, *plugins: type):
        self._store, self._plugins = store, plugins

    def recall(self, inputs: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """The arrays kept under these inputs, or None."""
        path = self._path(inputs)
        if not os.path.lexists(path):
            return None
        try:
            with hdf5.reading(path) as file:
                arrays = {name: np.asarray(data) for name, data in file.items()}
                if file.attrs["digest"] != _digest(arrays):
                    raise ValueError("its arrays are not those that were kept")
                return arrays
        except DamagedFileError as error:
            self._store.set_aside(path, error)
            return None

    def keep(self, inputs: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep arrays under these inputs, in place of older ones."""
        path = self._path(inputs)
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path.parent, alone=False)
        with hdf5.replaced(path) as file:
            file.attrs["digest"] = _digest(arrays)
            for name, array in arrays.items():
                file.create_dataset(name, data=array)

    def forget(self, inputs: Mapping[str, Any]) -> None:
        """Drop what is kept under these inputs, if anything is."""
        self._path(inputs).unlink(missing_ok=True)

    def _path(self, inputs: Mapping[str, Any]) -> Path:
        return self._store.path("part", content_hash(inputs, *self._plugins))


def _digest(arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def write_flow(path: Path, flow: FlowField | None, comm: Any) -> None:
    """Store a FlowField; compact intervals stay compact (collective).

    Every rank writes the intervals that it holds; a rank that holds none may have no flow, but
    rank 0, whose word counts for all that is not an interval. Each field of all intervals is one
    dataset, in which `first` and `first_run` say where an interval begins.
    """
    parts, first = _held(flow)
    sizes = on_each(comm, lambda: [(len(p.cells), len(p.still)) for p in parts])
    blocks = sorted(block for block in comm.allgather((first, sizes)) if block[1])
    lengths = np.array([size for _, block in blocks for size in block], dtype=np.int64)
    starts = np.concatenate([[[0, 0]], np.cumsum(lengths, axis=0)])
    header = comm.bcast(_header(flow, parts) if flow is not None and comm.rank == 0 else None)
    temporary: Path = on_root(comm, partial(_temporary, path))
    try:
        with hdf5.written(path), _shared_file(temporary, comm) as file:
            file.attrs.update(header["attributes"])
            file.attrs["name"] = path.name
            write_grid(file, header["grid"])
            file.create_dataset("times", data=header["times"]).attrs["unit"] = "s"
            file.create_dataset("intervals/first", data=starts[:, 0])
            file.create_dataset("intervals/first_run", data=starts[:, 1])
            data = {}
            for name, (lead, kind) in header["fields"].items():
                runs = name == "still"
                shape = (starts[-1, 1], 2) if runs else (*lead, starts[-1, 0])
                data[name] = file.create_dataset(f"intervals/{name}", shape=shape, dtype=kind)
                data[name].attrs["unit"] = _UNITS[name]
            if header["capacity"]:
                capacity = file.create_dataset("capacity", shape=header["capacity"], dtype=float)
                capacity.attrs["unit"] = "m^3"
                if comm.rank == 0:
                    capacity[:] = flow.intervals.capacity  # type: ignore[union-attr]
            on_each(comm, partial(_write_parts, path, data, parts, starts[first:]))
        on_root(comm, partial(os.replace, temporary, path))
    finally:
        if comm.rank == 0:
            temporary.unlink(missing_ok=True)


def _held(flow: FlowField | None) -> tuple[Sequence[CompactInterval], int]:
    """The intervals held here, as they are stored, and the number of the first one."""
    if flow is None:
        return [], 0
    if not isinstance(flow.intervals, CompactIntervals):
        return [CompactInterval.of(interval) for interval in flow.intervals], 0
    parts = flow.intervals.parts
    return parts.halves if isinstance(parts, MirroredParts) else parts, flow.intervals.first


def _header(flow: FlowField, parts: Sequence[CompactInterval]) -> dict[str, Any]:
    """All of a flow that is not an interval, and what its intervals' fields are like."""
    some = parts[0]
    compact = flow.intervals if isinstance(flow.intervals, CompactIntervals) else None
    return {
        "attributes": {
            "format_version": FORMAT_VERSION,
            "frame": flow.frame,
            "angular_velocity": flow.angular_velocity,
            "lift": flow.lift,
            "prefix": flow.prefix,
            "axis_point": flow.axis.point,
            "axis_direction": flow.axis.direction,
            "summary": json.dumps(dict(flow.summary)),
            "warnings": json.dumps(flow.warnings),
            "mirrored": compact is not None and isinstance(compact.parts, MirroredParts),
        },
        "grid": flow.grid,
        "times": flow.times,
        "fields": {
            name: (getattr(some, name).shape[:-1], getattr(some, name).dtype) for name in _UNITS
        },
        "capacity": None if compact is None or compact.capacity is None else len(compact.capacity),
    }


def _temporary(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_leftovers(path.parent, alone=False)
    return temporary_name(path)


def _shared_file(path: Path, comm: Any) -> Any:
    if comm.size == 1:
        return h5py.File(path, "w")
    return h5py.File(path, "w", driver="mpio", comm=comm)


def _write_parts(
    path: Path, data: Mapping[str, Any], parts: Sequence[CompactInterval], starts: IntArray
) -> None:
    for part, (cell, run), (last_cell, last_run) in zip(parts, starts, starts[1:], strict=False):
        for name, dataset in data.items():
            with hdf5.written(path):
                if name == "still":
                    dataset[run:last_run] = part.still
                else:
                    dataset[..., cell:last_cell] = getattr(part, name)


def read_flow(path: Path) -> FlowField:
    """Open a stored FlowField; its intervals are read when asked for.

    The file stays open: whatever becomes of its name, this flow remains. Raises DamagedFileError
    if it is no flow; that it keeps the invariants of one is for `scaleup.flow.check` to see.
    """
    file = hdf5.opened(path)
    with hdf5.understood(path):
        _require(file.attrs["name"] == path.name, f"it was stored as {file.attrs['name']}")
        grid, times = read_grid(file), np.asarray(file["times"], dtype=float)
        parts: Sequence[CompactInterval] = _StoredParts(path, file, grid, times)
        if file.attrs["mirrored"]:
            parts = MirroredParts(parts, grid.counts)
        capacity = None
        if "capacity" in file:
            capacity = np.asarray(file["capacity"], dtype=float)
            _require(capacity.shape == (grid.cells,), "capacity is not one number for each cell")
        frame, prefix = file.attrs["frame"], int(file.attrs["prefix"])
        _require(frame in ("lab", "vessel"), f"frame = {frame!r}")
        _require(0 <= prefix < len(parts) + 1, f"prefix = {prefix}")
        return FlowField(
            grid=grid,
            frame=frame,
            axis=Axis(tuple(file.attrs["axis_point"]), tuple(file.attrs["axis_direction"])),
            angular_velocity=float(file.attrs["angular_velocity"]),
            intervals=CompactIntervals(parts, times, capacity),
            lift=float(file.attrs["lift"]),
            prefix=prefix,
            summary=json.loads(file.attrs["summary"]),
            warnings=tuple(json.loads(file.attrs["warnings"])),
        )


def _require(good: bool, otherwise: str) -> None:
    if not good:
        raise ValueError(otherwise)


class _StoredParts(Sequence[CompactInterval]):
    """Compact intervals in an open file, read when asked for."""

    def __init__(self, path: Path, file: Any, grid: Grid, times: FloatArray):
        """Raises ValueError, KeyError if the file does not hold intervals on the grid."""
        self._path, self._file, self._times = path, file, times
        self._cells = grid.cells // 2 if file.attrs["mirrored"] else grid.cells
        group = file["intervals"]
        self._first = np.asarray(group["first"], dtype=np.int64)
        self._first_run = np.asarray(group["first_run"], dtype=np.int64)
        cells, runs = group["cells"].shape[0], group["still"].shape[0]
        for starts, total in ((self._first, cells), (self._first_run, runs)):
            good = starts.shape == times.shape and starts[0] == 0 and starts[-1] == total
            _require(good and bool(np.all(np.diff(starts) >= 0)), "intervals do not join")
        _require(len(times) > 1 and bool(np.all(np.diff(times) > 0)), "times do not ascend")
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_UNITS, (cells,))
        shapes |= dict.fromkeys(("flux", "direction"), (grid.dimension, cells))
        for name, shape in (shapes | {"still": (runs, 2)}).items():
            integer = name in ("cells", "still")
            _require(group[name].shape == shape, f"intervals/{name} has another shape")
            good = group[name].dtype.kind in ("iu" if integer else "f")
            _require(good, f"intervals/{name} is of another type")

    def __len__(self) -> int:
        return len(self._times) - 1

    @overload
    def __getitem__(self, index: int) -> CompactInterval: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[CompactInterval]: ...
    def __getitem__(self, index: int | slice) -> CompactInterval | Sequence[CompactInterval]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(index)
        cells = slice(*self._first[index : index + 2])
        runs = slice(*self._first_run[index : index + 2])
        with hdf5.understood(self._path):
            group = self._file["intervals"]
            arrays: dict[str, Any] = {
                name: group[name][runs] if name == "still" else group[name][..., cells]
                for name in _UNITS
            }
            active, still = arrays["cells"], arrays["still"]
            for numbers, most in ((active, self._cells - 1), (still, self._cells)):
                good = len(numbers) == 0 or (numbers.min() >= 0 and numbers.max() <= most)
                _require(good, f"interval {index} has cells beyond the grid")
            good = np.all(still[:, 0] < still[:, 1]) and np.all(still[1:, 0] >= still[:-1, 1])
            _require(bool(good), f"interval {index} has runs that do not ascend")
        return CompactInterval(float(self._times[index]), float(self._times[index + 1]), **arrays)


def write_checkpoint(path: Path, arrays: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Store arrays and a JSON-like state; replaces the previous checkpoint at once."""
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    with hdf5.replaced(path) as file:
        file.attrs["digest"] = _digest(arrays)
        file.create_dataset("state", data=json.dumps(state))
        group = file.create_group("arrays")
        for name, array in arrays.items():
            group.create_dataset(name, data=array)


def read_checkpoint(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """The arrays and the state of a checkpoint. Raises DamagedFileError."""
    with hdf5.reading(path) as file:
        arrays = {name: np.asarray(data) for name, data in file["arrays"].items()}
        _require(file.attrs["digest"] == _digest(arrays), "its arrays are not those it was given")
        return arrays, json.loads(file["state"][()])


def write_grid(file: Any, grid: Grid) -> None:
    """Describe a grid in an HDF5 file or group."""
    group = file.create_group("grid")
    group.attrs["lower"], group.attrs["spacing"] = grid.lower, grid.spacing
    group.attrs["counts"], group.attrs["depth"] = grid.counts, grid.depth
    group.attrs["unit"] = "m"


def read_grid(file: Any) -> Grid:
    """The grid that an HDF5 file or group describes."""
    attributes = file["grid"].attrs
    return Grid(
        lower=tuple(float(x) for x in attributes["lower"]),
        spacing=tuple(float(h) for h in attributes["spacing"]),
        counts=tuple(int(n) for n in attributes["counts"]),
        depth=float(attributes["depth"]),
    )
