"""`results.h5`: fields over time, pictures of single revolutions, and `results.xdmf` for ParaView.

While a run goes on, every instant is a file of its own in `fields/` of the work folder, so that a
run may be killed at any time; at the end the root joins them into `results.h5`. Fields are in
single precision (the checkpoint keeps the state in double), dense over the grid and compressed, so
that they are a uniform grid to every reader; the part without bed costs next to nothing. Datasets
carry their SI unit.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from scaleup.flow.storage import read_grid, write_grid
from scaleup.report.bed_view import Picture
from scaleup.space.flow_field import Axis, FlowField, Interval
from scaleup.space.grid import FloatArray, Grid, IntArray
from scaleup.system import hdf5
from scaleup.system.errors import InputError, RunError
from scaleup.system.files import replacing, write_text
from scaleup.system.hdf5 import FORMAT_VERSION, DamagedFileError

KINDS = ("snapshots", "pictures")
PHASES, FRAMES = 8, 32  # pictures of a revolution: to be seen side by side, and one by one
_PICTURE_CELLS = 2e6  # of the grid of pictures, at most: more is not seen
_FIELD = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


@dataclass(frozen=True)
class Motion:
    """How the grid of a run moves: what turns its fields into the lab's frame.

    frame, axis, angular_velocity -- as of the FlowField
    """

    frame: str
    axis: Axis
    angular_velocity: float

    def phase(self, revolution: float) -> float:
        """Rad by which the grid has turned."""
        return 2 * math.pi * revolution if self.frame == "vessel" else 0.0

    def time(self, revolution: float) -> float:
        """S since the start."""
        return 2 * math.pi * revolution / self.angular_velocity


class Results:
    """The fields of a run, written as it goes on and read one instant at a time."""

    def __init__(self, folder: Path, grid: Grid, motion: Motion):
        self._path, self._xdmf = folder / "results.h5", folder / "results.xdmf"
        self._parts = folder / "fields"
        self.grid, self.motion = grid, motion
        shares = (grid.cells / _PICTURE_CELLS) ** (1 / grid.dimension)
        self._factor = max(1, math.ceil(shares - 1e-9))
        self._coarse = grid.coarsened(self._factor)
        self._with_velocity: dict[tuple[float, float], float] = {}  # snapshot, by its interval

    @classmethod
    def of(cls, folder: Path, flow: FlowField) -> Results:
        """The results of a run on a flow, to be written to a folder."""
        return cls(folder, flow.grid, Motion(flow.frame, flow.axis, flow.angular_velocity))

    @classmethod
    def open(cls, folder: Path) -> Results:
        """The results that a run folder holds. Raises InputError if it holds none."""
        path = folder / "results.h5"
        if not path.exists():
            raise InputError(f"{folder}: is not a run folder ({path.name} is missing)")
        try:
            with hdf5.reading(path) as file:
                at, along = file.attrs["axis_point"], file.attrs["axis_direction"]
                axis = Axis((*map(float, at),), (*map(float, along),))  # type: ignore[arg-type]
                omega = float(file.attrs["angular_velocity"])
                return cls(folder, read_grid(file), Motion(file.attrs["frame"], axis, omega))
        except DamagedFileError as error:
            raise InputError(str(error)) from error

    def create(self) -> None:
        """Begin without any instant."""
        shutil.rmtree(self._parts, ignore_errors=True)
        self._path.unlink(missing_ok=True)
        self._parts.mkdir()

    def add(
        self, revolution: float, interval: Interval, time: float, concentration: FloatArray
    ) -> None:
        """Append all fields at one time; cells without bed hold NaN, and no fill.

        A flow that repeats has the same velocities every turn: they are stored once, and linked.
        """
        fields = {"fill_fraction": interval.fill(time) / self.grid.cell_volume}
        fields |= {f"concentration_{k + 1}": c for k, c in enumerate(concentration)}
        span = (interval.start, interval.end)
        if self._with_velocity.setdefault(span, revolution) == revolution:
            for axis, component in enumerate(interval.velocity(self.grid)):
                fields["velocity_" + "xyz"[axis]] = component
        self.store("snapshots", revolution, interval.cells, fields, span)

    def add_picture(
        self, revolution: float, interval: Interval, time: float, concentration: FloatArray
    ) -> None:
        """Append what pictures show: fill and component 1, on cells merged to 2e6 at most."""
        fill = interval.fill(time)
        cells, content = interval.cells, fill * concentration[0]
        if self._factor > 1:
            position = np.unravel_index(cells, self.grid.shape)
            merged = np.ravel_multi_index(
                tuple(p // self._factor for p in position), self._coarse.shape
            )
            cells, place = np.unique(merged, return_inverse=True)
            fill, content = (np.bincount(place, weights=w).astype(float) for w in (fill, content))
        share = np.divide(content, fill, out=np.full(len(fill), np.nan), where=fill > 0)
        fields = {"fill_fraction": fill / self._coarse.cell_volume, "concentration_1": share}
        span = (interval.start, interval.end)
        self.store("pictures", revolution, cells, fields, span)

    def finish(self, wanted: Mapping[str, Iterable[float]]) -> None:
        """Join the instants that are wanted (revolutions by kind) into `results.h5`.

        Of the snapshots of a flow that repeats, the first on each interval has the velocities.
        """
        stored = _joined(self._path.parent)
        source = hdf5.opened(self._path) if any(stored.values()) else None
        with hdf5.written(self._path), replacing(self._path) as temporary:
            with h5py.File(temporary, "w") as file:
                file.attrs["format_version"] = FORMAT_VERSION
                file.attrs["frame"] = self.motion.frame
                file.attrs["axis_point"] = self.motion.axis.point
                file.attrs["axis_direction"] = self.motion.axis.direction
                file.attrs["angular_velocity"] = self.motion.angular_velocity
                write_grid(file, self.grid)
                file.create_group("snapshots")
                write_grid(file.create_group("pictures"), self._coarse)
                for kind in KINDS:
                    velocities: dict[bytes, Any] = {}
                    for name in map(_name, sorted(wanted[kind])):
                        part = self._part(kind, name)
                        if part.exists():  # newer than what may be in an older results.h5
                            with hdf5.reading(part) as instant:
                                _copy(instant, file[kind].create_group(name), velocities)
                        elif source is not None:
                            instant = source[kind][name]
                            _copy(instant, file[kind].create_group(name), velocities)
            if source is not None:
                source.close()
        shutil.rmtree(self._parts, ignore_errors=True)

    def revolutions(self, kind: str = "snapshots") -> list[float]:
        """When snapshots (or "pictures") were taken, ascending."""
        with hdf5.reading(self._path) as file:
            return [
                float(group.attrs["revolution"])
                for group in file[kind].values()
                if isinstance(group, h5py.Group) and "revolution" in group.attrs
            ]

    def snapshot(self, revolution: float) -> dict[str, NDArray[np.float32]]:
        """All fields at one of the revolutions, by name, `grid.shape`."""
        with hdf5.reading(self._path) as file:
            group = file["snapshots"][_name(revolution)]
            return {name: np.asarray(data) for name, data in group.items()}

    def picture(self, revolution: float, kind: str = "pictures") -> Picture:
        """What a picture shows at one of the revolutions of a kind."""
        with hdf5.reading(self._path) as file:
            group = file[kind][_name(revolution)]
            return Picture(
                self._coarse if kind == "pictures" else self.grid,
                self.motion.axis,
                revolution,
                self.motion.phase(revolution),
                np.asarray(group["fill_fraction"]),
                np.asarray(group["concentration_1"]),
            )

    def write_xdmf(self) -> None:
        """Describe the snapshots as a time series (s) of a uniform grid.

        A cross-section is one layer of cells as thick as it stands for: VTK's readers put meshes
        in the plane into the plane of y and z.
        """
        grid = self.grid
        layers, origin, edges = grid.shape, grid.lower[::-1], grid.spacing[::-1]
        if grid.dimension == 2:
            layers, origin, edges = (1, *layers), (0.0, *origin), (grid.depth, *edges)
        nodes = " ".join(str(n + 1) for n in layers)
        shape = " ".join(str(n) for n in layers)
        lower, spacing = (" ".join(repr(float(x)) for x in triple) for triple in (origin, edges))
        item = '<DataItem Dimensions="3" NumberType="Float" Precision="8" Format="XML">'
        parts = []
        with hdf5.reading(self._path) as file:
            for name, group in file["snapshots"].items():
                attributes = "".join(
                    f'<Attribute Name="{field}" AttributeType="Scalar" Center="Cell">'
                    f'<DataItem Dimensions="{shape}" NumberType="Float" Precision="4" '
                    f'Format="HDF">results.h5:/snapshots/{name}/{field}</DataItem></Attribute>'
                    for field in group
                )
                time = self.motion.time(float(group.attrs["revolution"]))
                parts.append(
                    f'<Grid Name="bed" GridType="Uniform"><Time Value="{time!r}"/>'
                    f'<Topology TopologyType="3DCoRectMesh" Dimensions="{nodes}"/>'
                    '<Geometry GeometryType="ORIGIN_DXDYDZ">'
                    f"{item}{lower}</DataItem>{item}{spacing}</DataItem>"
                    f"</Geometry>{attributes}</Grid>"
                )
        write_text(
            self._xdmf,
            '<?xml version="1.0"?>\n<Xdmf Version="3.0"><Domain>'
            '<Grid Name="blend" GridType="Collection" CollectionType="Temporal">\n'
            + "\n".join(parts)
            + "\n</Grid></Domain></Xdmf>\n",
        )

    def store(
        self,
        kind: str,
        revolution: float,
        cells: IntArray,
        fields: Mapping[str, FloatArray],
        span: tuple[float, float],
    ) -> None:
        """Append fields (n,) on some cells at one time, under one of KINDS.

        span -- of the interval that they are of: the velocities of two instants of one are the same
        """
        grid = self._coarse if kind == "pictures" else self.grid
        self._parts.mkdir(exist_ok=True)
        with hdf5.replaced(self._part(kind, _name(revolution))) as file:
            file.attrs["revolution"], file.attrs["interval"] = revolution, span
            for field, values in fields.items():
                empty = 0.0 if field == "fill_fraction" else np.nan
                whole = np.full(grid.cells, empty, dtype=np.float32)
                whole[cells] = values
                data = file.create_dataset(field, data=whole.reshape(grid.shape), **_FIELD)
                data.attrs["unit"] = "m/s" if field.startswith("velocity") else "1"

    def _part(self, kind: str, name: str) -> Path:
        return _part(self._parts.parent, kind, name)


def require_instants(folder: Path, wanted: Mapping[str, Iterable[float]]) -> None:
    """Raise InputError if a run folder lacks an instant or holds it damaged.

    wanted -- revolutions by kind
    """
    try:
        stored = _joined(folder)
        for kind, revolutions in wanted.items():
            for name in map(_name, revolutions):
                part = _part(folder, kind, name)
                if part.exists() or name not in stored[kind]:
                    with hdf5.reading(part) as file:
                        file["fill_fraction"], file["concentration_1"]
    except RunError as error:
        raise InputError(
            f"{error}, so that fields of this run are lost; simulate it again (scaleup simulate "
            f"{folder / 'config.toml'} --output FOLDER --overwrite)"
        ) from error


def _part(folder: Path, kind: str, name: str) -> Path:
    return folder / "fields" / f"{kind}-{name}.h5"


def _joined(folder: Path) -> dict[str, set[str]]:
    """Names by kind of the instants in `results.h5`, which a run that is extended has."""
    path = folder / "results.h5"
    if not os.path.lexists(path):
        return {kind: set() for kind in KINDS}
    with hdf5.reading(path) as file:
        return {kind: {name for name in file[kind] if name != "grid"} for kind in KINDS}


def _copy(instant: Any, group: Any, velocities: dict[bytes, Any]) -> None:
    """Copy an instant; velocities that are there already, by interval, are linked."""
    group.attrs["revolution"] = instant.attrs["revolution"]
    group.attrs["interval"] = span = instant.attrs["interval"]
    known = velocities.get(span.tobytes())
    for field in instant:
        if known is None or not field.startswith("velocity"):
            instant.copy(instant[field], group, field)
    if known is None and any(field.startswith("velocity") for field in group):
        velocities[span.tobytes()] = group
    elif known is not None:
        for field in [f for f in known if f.startswith("velocity")]:
            group[field] = known[field]


def instants(which: Literal["first", "last"], last: float, count: int) -> list[float]:
    """Revolutions at which pictures are taken: `count` to a turn, from start to end of one.

    last -- revolutions of the whole run. All are multiples of 1/count, so that a run that is
    extended has met them: the last turn ends at the last such multiple. One of a single turn or
    less has no last turn.
    """
    if which == "last" and last <= 1.0:
        return []
    final = math.floor(last * count + 1e-9)
    start = 0 if which == "first" else max(0, final - count)
    return [round(n / count, 9) for n in range(start, min(start + count, final) + 1)]


def _name(revolution: float) -> str:
    return f"{revolution:012.6f}"
